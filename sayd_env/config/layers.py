"""Files on top of files: one layering for studies, environments and the parts that they name.

A file need only say in what it differs from its ``base``: the name of a packaged file of its kind, a path
relative to the file, or null. Its keys overlay those of the base; last come single numbers under ``set``, as
key: value with dotted keys. A part of a study may stand there by name, by path or by content.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel

from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import Origin, nearest, shown
from sayd_env.config.loader import (
    DATA,
    YAML,
    apply_overrides,
    assigned,
    beside,
    from_anywhere,
    is_path,
    packaged_names,
    parse_yaml,
    placed,
    read_config,
    section,
    validate,
)

M = TypeVar("M", bound=BaseModel)
_WHOLE = frozenset({"name", "type", "algorithm", "distribution"})
"""Keys of sections that say what they are."""

_KEYS_OF: Mapping[str, tuple[str, ...]] = {
    "vehicle": ("bodies", "elements", "wheel_radius"),
    "line": ("sections", "section_length"),
    "lines": ("sections", "curves"),
    "track": ("irregularity",),
    "damper": ("curve", "series_stiffness", "throttle", "cylinder"),
}
"""Keys by which a kind of file is recognised; those of a line and of a distribution over lines are alike."""


@dataclass(frozen=True)
class Kind:
    """A kind of file, and what in it names other files.

    Attributes
    ----------
    folder : str
        Where its packaged files lie in configs/.
    parts : mapping
        Keys under which a part may stand by name, by path or by content, and the kind of each.
    names : tuple of str
        Dotted places of names or paths that stay such; ``*`` is each entry of a list.
    data : tuple of str
        Dotted places of data files.
    base : str, optional
        On what a file stands that names no base.
    only : tuple of str, optional
        A key and its value, where the folder holds other kinds as well: ``("kind", "wheel")``.
    mark : str, optional
        A key that its packaged files have, where the folder holds other kinds as well.
    optional : tuple of str
        Parts that may be null.
    sided : bool
        May stand as ``{left: ..., right: ...}`` of parts by these keys: the left one's content, with the
        right one under its key.
    measured : str, optional
        A path that is not YAML is a data file at the first of `data`: with the rest of a section from this
        file of configs/measured/, in which a name stands for that of the file.
    """

    folder: str
    parts: Mapping[str, Kind] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    data: tuple[str, ...] = ()
    base: str | None = None
    only: tuple[str, str] | None = None
    mark: str | None = None
    optional: tuple[str, ...] = ()
    sided: bool = False
    measured: str | None = None


class Draft(NamedTuple):
    """Raw content of a file with all that it stands on, and what in it comes from where."""

    data: dict[str, Any]
    source: str
    origins: tuple[Origin, ...] = ()


def read_layered(
    model: type[M], kind: Kind, name_or_path: str, overrides: Iterable[str] = (), option: str = "--set"
) -> M:
    """Read a file with all that it stands on, apply ``key=value`` assignments one by one, and validate it.

    Parameters
    ----------
    model : type
        The schema.
    kind : Kind
        What the file is.
    name_or_path : str
        A packaged name or a path to a YAML file.
    overrides : iterable of str
        A part may be named and then changed: ``track=china``, ``track.irregularity.scale=0.5``.
    option : str
        What a message calls the place of the assignments.

    Raises
    ------
    ConfigError
        A file, a key or a value cannot be used.
    """
    draft = layered(kind, name_or_path)
    if isinstance(overrides, str):
        raise ConfigError(f"overrides: found the text {shown(overrides)}; expected a list of key=value")
    for item in overrides:
        draft = _with_assignment(kind, draft, item, option)
    return validate(model, draft.data, draft.source, draft.origins)


def layered(kind: Kind, name_or_path: str) -> Draft:
    """Raw content of a file with all that it stands on.

    Raises
    ------
    ConfigError
        A file or a key cannot be used, a file stands on itself or on one of another kind.
    """
    return _with_parts(kind, _overlaid(kind, name_or_path, ()))


def _overlaid(kind: Kind, name: str, users: tuple[str, ...]) -> Draft:
    """A file over its base; parts that nothing was set in are still names."""
    files = "a YAML file" if kind.measured is None else "a YAML file or a measured one"
    content, source = _measured(kind, name) or read_config(kind.folder, name, files, partial(names_of, kind))
    own, folder = dict(section(content, source)), Path(source).parent
    _refuse_another_kind(kind, own, source)
    _refuse_other(kind, own, name, source)
    below = _base(kind, own, source, (*users, from_anywhere(name)))
    numbers = own.pop("set", None)
    own = _placed(kind, own, folder)
    _check_parts(kind, own, source)
    if any(isinstance(own.get(key), dict) for key in kind.parts):
        below = _with_parts(kind, below)
    set_here = tuple(Origin(path, source) for path in _paths(own))
    referring = {place.removesuffix(".name") for place in kind.names}
    draft = Draft(_merged(below.data, own, referring), source, below.origins + set_here)
    if numbers is None:
        return draft
    if not isinstance(numbers, dict):
        raise ConfigError(
            f"{source}: set: expected keys and values, for example damper.series_stiffness: 4.0e6"
        )
    for key, value in numbers.items():
        text = json.dumps(_placed_at(kind, str(key).split("."), value, folder), default=str)
        draft = _with_assignment(kind, _with_parts(kind, draft), f"{key}={text}", f"{source}: set:")
    return draft


def _measured(kind: Kind, name: str) -> tuple[dict[str, Any], str] | None:
    """Content that makes a part of a data file, and its path; None for what is no data file."""
    if not is_path(name) or name.lower().endswith(YAML):
        return None
    if kind.measured is None:
        if name.lower().endswith(DATA):
            option = f" (curve: {{file: {name}}}), or --damper {name}" if kind.folder == "damper" else ""
            raise ConfigError(
                f"{name}: is a table; expected YAML of a {kind.folder}, which may name it{option}"
            )
        return None
    path = Path(name)
    content = section(*read_config("measured", kind.measured))
    if "name" in content:
        content["name"] = path.stem
    value: Any = path.name
    for key in reversed(kind.data[0].split(".")):
        value = {key: value}
    return _merged(content, value), name


def _base(kind: Kind, own: dict[str, Any], source: str, users: tuple[str, ...]) -> Draft:
    """What a file stands on; its key leaves the file's own content."""
    base = own.pop("base", kind.base)
    if base is None:
        return Draft({}, source)
    if not isinstance(base, str):
        raise ConfigError(f"{source}: base: found {shown(base)}; expected a name, a path or null")
    base = beside(base, Path(source).parent)
    if not is_path(base) and base not in packaged_names(kind.folder):
        names = names_of(kind)
        other = next((each for each in _KEYS_OF if base in packaged_names(each)), None)
        hint = nearest(base, names) if other is None else f", which is a {other}"
        raise ConfigError(
            f"{source}: base: unknown {kind.folder} {shown(base)}{hint}; available: {', '.join(names)}, or a "
            "path to a YAML file"
        )
    if from_anywhere(base) in users:
        raise ConfigError(f"{source}: base: '{base}' refers back to this file")
    below = _overlaid(kind, base, users)
    kept = below.data.get("type")
    if "type" in own and kept not in (None, own["type"]):
        raise ConfigError(f"{source}: type: found {shown(own['type'])}; its base '{base}' is a {kept} one")
    return below


def _refuse_another_kind(kind: Kind, own: dict[str, Any], source: str) -> None:
    """Refuse a vehicle where a damper is expected, and the like, by keys that only one kind has."""
    if any(key in own for key in _KEYS_OF.get(kind.folder, ())):
        return
    for other, keys in _KEYS_OF.items():
        found = [key for key in keys if key in own]
        if found and other != kind.folder:
            raise ConfigError(
                f"{source}: seems to be a {other}, by its keys {', '.join(found)}; expected a {kind.folder}"
            )


def _refuse_other(kind: Kind, own: dict[str, Any], name: str, source: str) -> None:
    """Refuse a rail where a wheel is expected, the plan of a study where a scenario is, and the like."""
    if kind.mark is not None and kind.mark not in own and not is_path(name):
        raise ConfigError(
            f"{source}: has no {kind.mark}; with one are available: {', '.join(names_of(kind))}"
        )
    if kind.only is None:
        return
    key, expected = kind.only
    found = own.get(key, expected)
    if found != expected:
        raise ConfigError(
            f"{source}: is a {found} {kind.folder}; as {expected} are available: {', '.join(names_of(kind))}"
        )


def names_of(kind: Kind) -> list[str]:
    """Packaged names of a kind: of profiles the wheels alone or the rails, of studies the scenarios."""
    names = packaged_names(kind.folder)
    if kind.mark is not None:
        return [name for name in names if kind.mark in read_config(kind.folder, name)[0]]
    if kind.only is None:
        return names
    key, expected = kind.only
    return [name for name in names if layered(Kind(kind.folder), name).data.get(key) == expected]


def _with_assignment(kind: Kind, draft: Draft, item: str, option: str) -> Draft:
    where = option.removesuffix(":")
    changed = apply_overrides(draft.data, [item], option)
    key, _, text = (part.strip() for part in item.partition("="))
    if key in kind.parts and isinstance(changed[key], int | float):
        changed[key] = text  # a name such as 60e1, which YAML reads as a number
    _check_parts(kind, changed, where)
    origins = (*draft.origins, assigned(draft.data, item, where))
    return _with_parts(kind, Draft(changed, draft.source, origins))


def _with_parts(kind: Kind, draft: Draft) -> Draft:
    """Names and paths of parts replaced by their content."""
    data, origins = dict(draft.data), draft.origins
    for key, part in kind.parts.items():
        value = data.get(key)
        if isinstance(value, str):
            found = layered(part, value)
            root = Origin((key,), found.source, depth=1)
        elif isinstance(value, dict):
            found = _with_parts(part, Draft(value, draft.source))
            root = None
        else:
            continue
        data[key] = _left_first(found, key) if part.sided else found.data
        inner = (Origin((key, *_without_left(part, o.path)), o.source, o.depth + 1) for o in found.origins)
        origins = (*origins, *(() if root is None else (root,)), *inner)
    return Draft(data, draft.source, origins)


def _left_first(draft: Draft, key: str) -> dict[str, Any]:
    """The left one's content with the right one beside it."""
    data, left = draft.data, draft.data.get("left")
    if not isinstance(left, dict):
        return data
    others = [name for name in data if name not in ("left", "right")]
    if others and "kind" not in others:  # with it, they are the content that `left` replaces
        raise ConfigError(
            f"{draft.source}: {key}: found {', '.join(map(str, others))} beside left; expected left and right"
        )
    return {**left, "right": data.get("right")}


def _without_left(part: Kind, path: tuple[int | str, ...]) -> tuple[int | str, ...]:
    return path[1:] if part.sided and path[:1] == ("left",) else path


def _check_parts(kind: Kind, data: Mapping[str, Any], source: str, above: str = "") -> None:
    """Refuse a part that is neither named nor content."""
    for key, part in kind.parts.items():
        value = data.get(key)
        if isinstance(value, dict):
            _check_parts(part, value, source, f"{above}{key}.")
        elif key in data and not isinstance(value, str) and not (value is None and key in kind.optional):
            raise ConfigError(f"{source}: {above}{key}: found {shown(value)}; {_expected(key, part, value)}")


def _expected(key: str, part: Kind, found: Any) -> str:
    names = packaged_names(part.folder)
    number = isinstance(found, int | float)
    same = [name for name in names if number and parse_yaml(name, key) == found]
    quoted = f"; did you mean '{same[0]}', in quotes?" if same else ""
    return f"expected a name ({', '.join(names)}), a path or keys and values{quoted}"


def _placed(kind: Kind, own: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Content with the paths in it relative to the folder of its file."""
    for place in (*kind.parts, *kind.names):
        own = placed(own, place, partial(beside, folder=folder))
    for place in kind.data:
        own = placed(own, place, lambda path: path and str(folder / path))  # the schema refuses an empty one
    inner = {key: value for key, value in own.items() if key in kind.parts and isinstance(value, dict)}
    return own | {key: _placed(kind.parts[key], value, folder) for key, value in inner.items()}


def _placed_at(kind: Kind, keys: list[str], value: Any, folder: Path) -> Any:
    """The value of a dotted key, placed."""
    for key in reversed(keys):
        value = {key: value}
    value = _placed(kind, value, folder)
    for key in keys:
        value = value[key]
    return value


def _alone(key: str, own: Mapping[str, Any], below: Mapping[str, Any]) -> bool:
    """Whether a section replaces the base's as a whole: by its name, distribution or kind."""
    return (
        key == "provenance"
        or "name" in own
        or "distribution" in own
        or any(own.get(kind) not in (None, below.get(kind)) for kind in ("type", "algorithm"))
    )


def _merged(
    below: Mapping[str, Any], own: Mapping[str, Any], referring: Collection[str] = ()
) -> dict[str, Any]:
    """Overlay nested sections; those of `referring` have a name that is another file's, not their own."""
    result = dict(below)
    for key, value in own.items():
        under = below.get(key)
        sections = isinstance(value, dict) and isinstance(under, dict)
        nested = sections and (key in referring or not _alone(key, value, under))  # type: ignore[arg-type]
        result[key] = _merged(under, value) if nested else value  # type: ignore[arg-type]
    return result


def _paths(own: Mapping[str, Any], above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Paths of what a section sets."""
    found = []
    for key, value in own.items():
        path = (*above, key)
        # What a section that replaces the base's lacks is not taken from there: it is blamed for that.
        if not isinstance(value, dict) or not value or not _WHOLE.isdisjoint(value):
            found.append(path)
        if isinstance(value, dict):
            found += _paths(value, path)
    return found
