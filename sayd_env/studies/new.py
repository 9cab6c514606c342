"""Templates of one's own: the packaged files, commented as they are, under another name."""

from __future__ import annotations

import json
import re
import sys
import sysconfig
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from rich.console import Console

from sayd_env.config import ConfigError, nearest
from sayd_env.config.explain import shown
from sayd_env.config.layers import Kind, layered
from sayd_env.config.loader import packaged_names, packaged_text
from sayd_env.config.storage import reported, write_file
from sayd_env.report.files import Result

LONGEST_NAME = 64
_NAME = re.compile(r"[^\W_][\w-]*")


@dataclass(frozen=True)
class Template:
    """What a kind of file starts from, and what can be done with it."""

    start: str
    """Packaged file that it is a copy of, unless another one is asked for."""
    uses: tuple[str, ...]
    """Commands to run next; ``{file}`` is the new file."""
    others: tuple[str, ...] | None = None
    """Packaged files of the kind that are such; all by default."""
    special: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Commands to run next for some of them, by what they have under ``kind``."""


TEMPLATES: Mapping[str, Template] = {
    "vehicle": Template(
        "emu-estimate",
        (
            "sayd modes --set vehicle={file} --speeds 200:400:40",
            "sayd critical-speed --set vehicle={file} --speeds 280:400:40 --seeds 2",
        ),
    ),
    "damper": Template(
        "passive-estimate",
        ("sayd hysteresis --damper {file}", "sayd evaluate --damper {file} --speeds 300 --seeds 2"),
    ),
    "profile": Template(
        "s1002",
        (
            "sayd conicity --profile {file}",
            "sayd critical-speed --profile {file} --speeds 280:400:40 --seeds 2",
        ),
        special={
            "rail": (
                "sayd conicity --set rail={file}",
                "sayd critical-speed --set rail={file} --speeds 280:400:40 --seeds 2",
            )
        },
    ),
    "line": Template(
        "curve_400",
        (
            "sayd evaluate --line {file} --policies passive,mppt2 --seeds 1",
            "sayd simulate --line {file} --policy mppt2",
        ),
    ),
    "controller": Template(
        "own_controller",
        (
            "sayd evaluate --policies {file}:controller,mppt2 --speeds 300 --seeds 2",
            "sayd simulate --policy {file}:controller --seconds 10",
        ),
        others=("own_controller",),
    ),
    "study": Template(
        "estimates",
        (
            "sayd critical-speed --config {file} --speeds 280:400:40 --seeds 2",
            "sayd evaluate --config {file} --policies passive,mppt2 --speeds 300 --seeds 2",
        ),
        special={"manchester": ("sayd critical-speed --config {file} --speeds 180:300:20 --seeds 2",)},
        others=("estimates", "manchester", "nominal"),
    ),
}


_CALIBRATED = {
    "emu-estimate": "emu",
    "passive-estimate": "passive",
    "sayd-estimate": "sayd",
    "estimates": "nominal",
}
"""Files with the numbers from which calibration began, and those with what it found."""


@dataclass(frozen=True)
class NewResult(Result):
    """A file that was written."""

    kind: str
    file: Path
    start: str
    """What it is a copy of."""
    next: tuple[str, ...]
    """Commands that use it."""
    calibrated: str | None = None
    """Packaged file with the calibrated numbers, where the copy has those from which calibration began."""

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd new --json``."""
        return {"kind": self.kind, "file": str(self.file), "from": self.start, "next": list(self.next)}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Say what was written and what to do with it."""
        lines = (f"{self.file}: a {self.kind}, copied from {self.start}. Change it, then:", *self.next)
        for number, line in enumerate(lines):
            console.print(f"  {line}" if number else line, highlight=False, markup=False, soft_wrap=True)
        if self.calibrated is not None:
            console.print(
                f"Its numbers are estimates, and results differ from the packaged ones: "
                f"--from {self.calibrated} has what calibration made of them.",
                markup=False,
                soft_wrap=True,
            )


def new(kind: str, name: str, start: str | None = None, folder: Path | None = None) -> NewResult:
    """Write a template into a folder.

    Parameters
    ----------
    kind : str
        One of `TEMPLATES`.
    name : str
        What is described, and the file's name without its ending.
    start : str, optional
        Packaged file of this kind that it is a copy of.
    folder : Path, optional
        The working directory by default.

    Raises
    ------
    ConfigError
        A name that is none, or of a module that a controller's file would hide; no such packaged file; or
        there is a file of this name already.
    StudyError
        The file cannot be written.
    """
    template = TEMPLATES[kind]
    if len(name) > LONGEST_NAME or not _NAME.fullmatch(name):
        raise ConfigError(
            f"NAME {shown(name)}: expected at most {LONGEST_NAME} letters, digits, - and _, no sign first; "
            "neither a folder nor an ending"
        )
    source, text = _text(kind, template, name, start or template.start)
    file = (folder or Path()) / f"{name}{Path(source).suffix}"
    installed = [sysconfig.get_path(place) for place in ("purelib", "platlib")]
    if kind == "controller" and (name in sys.stdlib_module_names or PathFinder.find_spec(name, installed)):
        raise ConfigError(f"NAME {shown(name)}: is a module already, which {file.name} would hide")
    _create(file, text)
    uses = template.uses
    if template.special:
        own = layered(Kind(kind), str(file)).data.get("kind")
        uses = template.special.get(start or "", template.special.get(str(own), uses))
    next_ = tuple(use.format(file=file.name) for use in uses)
    return NewResult(kind, file, source, next_, _CALIBRATED.get(start or template.start))


def _text(kind: str, template: Template, name: str, start: str) -> tuple[str, str]:
    """Where the text comes from, and the text with the new name in it."""
    known = template.others or tuple(packaged_names(kind))
    if start not in known:
        raise ConfigError(
            f"--from {shown(start)}: no such {kind}{nearest(start, known)}; available: {', '.join(known)}"
        )
    if kind == "controller":
        code = resources.files("sayd_env.studies").joinpath(f"{start}.py").read_text(encoding="utf-8")
        return f"sayd_env/studies/{start}.py", code
    source, text = packaged_text(kind, start)
    quoted = json.dumps(name, ensure_ascii=False)
    text = re.sub(r"^name: .*$", lambda _: f"name: {quoted}", text, count=1, flags=re.MULTILINE)
    # Where numbers were found is no longer so when they are changed.
    text = re.sub(r"^provenance:\n(?:[ ].*\n)*", "", text, flags=re.MULTILINE)
    return source, f"# Copied from {source} by `sayd new {kind} {name}`.\n{text}"


def _create(file: Path, text: str) -> None:
    """Write a file that is not there yet."""
    with reported(file):
        try:
            file.open("x").close()
        except FileExistsError:
            raise ConfigError(f"{file}: is there already; nothing is overwritten") from None
    try:
        write_file(file, text.encode())
    except BaseException:
        file.unlink(missing_ok=True)
        raise
