"""Calibrated numbers as the files of parts that `configs/` holds: a base, provenance, and what is set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from sayd_env.config.calibration import SKYHOOKS, CalibrationConfig, Stage
from sayd_env.config.loader import from_anywhere
from sayd_env.studies.tuning.search import as_yaml, provenance_lines


class _Part(NamedTuple):
    """A file of calibrated numbers."""

    keys: str
    """Beginning of the assignments' keys that belong to it; the rest is a key of the file."""
    path: str
    """In configs/."""
    about: str
    base: str
    more: str = ""
    """Further lines."""


_ESTIMATES = "estimates"
_PASSIVE = (
    _Part(
        "vehicle.",
        "vehicle/emu.yaml",
        "The electric multiple unit of the paper.",
        "emu-estimate",
        "name: emu",
    ),
    _Part("damper.", "damper/passive.yaml", "The passive yaw damper.", "passive-estimate", "name: passive"),
    _Part("wheel.", "profile/s1002cn.yaml", "Wheel profile S1002CN.", "s1002cn-estimate", "name: s1002cn"),
    _Part("track.section.", "section/slab.yaml", "Slab track under a wheelset.", "slab-estimate"),
    _Part(
        "track.",
        "track/german_low.yaml",
        "Straight slab track, German spectrum of low disturbance (ERRI B176).",
        "german_low-estimate",
        "section: slab",
    ),
    _Part(
        "",
        "study/nominal.yaml",
        "The paper's conditions: the parts, and what belongs to no part.",
        _ESTIMATES,
        "description: the EMU of the paper with passive yaw dampers\n"
        "vehicle: emu\ndamper: passive\nwheel: s1002cn\ntrack: german_low",
    ),
)
_CONTROLLERS = {
    "mppt1": "MPPT1, eq. (27) to (31) of Wang et al. (2022): weighs running stability alone.",
    "mppt2": "MPPT2, eq. (27) to (31) of Wang et al. (2022): weighs running stability and damper force.",
    "skyhook": "The estimator of bogie velocity and stroke rate that both skyhooks read.",
}


def passive_parts(config: CalibrationConfig) -> tuple[_Part, ...]:
    """Where the numbers of the passive stage belong; the first part whose keys fit takes one.

    A base of one's own may name any parts: what is found over it is one study.
    """
    if config.base == _ESTIMATES:
        return _PASSIVE
    return (_Part("", "study/calibrated.yaml", f"Over {config.base}.", from_anywhere(config.base)),)


def _base(part: str, name_or_path: str) -> str:
    """What a part stands on: not on itself, where the packaged one of its name was calibrated anew."""
    return f"{part}-estimate" if name_or_path == part else from_anywhere(name_or_path)


def semi_active_parts(config: CalibrationConfig) -> tuple[_Part, ...]:
    """The same for the semi-active stage: over the damper and the controllers with which it ran.

    What both skyhooks share goes into their estimator, and into each file of one's own.
    """
    damper = _base("sayd", config.semi_active_damper)
    files = {name: _base(name, file) for name, file in config.controller_files.items()}
    own = [name for name in SKYHOOKS if name in files]
    names = {name: [name] for name in _CONTROLLERS}
    names["skyhook"] = own if len(own) == len(SKYHOOKS) else ["skyhook", *own]
    return (
        _Part("damper.", "damper/sayd.yaml", "The semi-active yaw damper.", damper, "name: sayd"),
        *(
            _Part(
                f"control.{controller}.",
                f"control/{name}.yaml",
                _CONTROLLERS[controller],
                files.get(name, f"{name}-estimate"),
            )
            for controller, of_it in names.items()
            for name in of_it
        ),
    )


_STAGES = {
    "passive": ("P1 to P10", passive_parts),
    "semi_active": ("M1 to M9 and S1 to S5", semi_active_parts),
}


def part_files(
    config: CalibrationConfig, name: str, values: Mapping[str, float], about: Mapping[str, object]
) -> dict[str, str]:
    """Text of each part that a stage calibrates, by its path in `configs/`.

    Parameters
    ----------
    name : str
        Of the stage: ``passive`` or ``semi_active``.
    values : mapping
        Calibrated value of each parameter by name.
    about : mapping
        What stands under `provenance`.
    """
    stage: Stage = getattr(config, name)
    rows, parts_of = _STAGES[name]
    parts = parts_of(config)
    lines: dict[_Part, list[str]] = {}
    for key, number in stage.assignments(values).items():
        begins = next(part.keys for part in parts if key.startswith(part.keys))
        for part in (part for part in parts if part.keys == begins):
            own = lines.setdefault(part, [])
            for parameter in stage.parameters_of(key):
                comment = (
                    f"  # {parameter.name}: {values[parameter.name]:.5g} {parameter.unit}, "
                    f"from {parameter.low:g} to {parameter.high:g}"
                )
                if comment not in own:
                    own.append(comment)
            own.append(f"  {key.removeprefix(begins)}: {number!r}")
    return {part.path: _text(part, rows, about, own) for part, own in lines.items()}


def _text(part: _Part, rows: str, about: Mapping[str, object], numbers: list[str]) -> str:
    return "\n".join(
        [
            f"# {part.about} Calibrated.",
            "#",
            f"# Written by `sayd calibrate`, which found the numbers under `set` from rows {rows}",
            "# of the paper's statements, within the ranges of configs/study/calibration.yaml, or of",
            "# the study that its command names.",
            f"base: {as_yaml(part.base)}",
            *([part.more] if part.more else []),
            *provenance_lines(about),
            "set:",
            *numbers,
            "",
        ]
    )
