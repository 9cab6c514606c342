"""What is wrong with a configuration, in the user's terms: which file, which key, what is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

Path = tuple[int | str, ...]
"""Path to a value in nested data."""

LONGEST_FOUND = 60
SMALLEST, LARGEST = 1e-40, 1e40
"""Magnitudes of numbers but 0: beyond all quantities, and far from where products leave the floats."""
TAGS = ("type", "distribution", "kind", "algorithm")
"""Fields by which the members of a union are distinguished."""


@dataclass(frozen=True)
class Origin:
    """Where the content below a path comes from."""

    path: Path
    source: str
    """A file, or the option that set it."""
    depth: int = 0
    """Leading keys that the source leaves out: it holds just this section, and keys are named as in it."""


def nearest(word: str, candidates: Iterable[str]) -> str:
    """Return ", did you mean 'x'?" for the closest candidate, or nothing."""
    match = _closest(word, candidates)
    return "" if match is None else f", did you mean '{match}'?"


def explain(
    model: type[BaseModel], data: Any, error: ValidationError, source: str, origins: Iterable[Origin] = ()
) -> str:
    """Say what is wrong, one line for each problem.

    Parameters
    ----------
    model : type
        The schema.
    data : mapping
        What did not fit.
    error : ValidationError
        What Pydantic says.
    source : str
        Where the data comes from.
    origins : iterable of Origin
        Parts of it that come from elsewhere; the last one that a problem touches counts.
    """
    known = list(origins)
    problems = [
        _Problem(detail, path, _origin(known, path) or Origin((), source))
        for detail in _without_consequences(error.errors(include_url=False))
        for path in [_data_path(data, detail["loc"])]
    ]
    lines = []
    for group in _grouped(model, problems):
        first = group[0]
        text = _sentence(model, data, first) if len(group) == 1 else _several(model, data, group)
        lines.append(f"{first.origin.source}: {text}")
    return "\n".join(lines)


def absurd_numbers(data: Any, source: str, origins: Iterable[Origin] = ()) -> str:
    """Say which numbers anywhere in data are beyond `SMALLEST` and `LARGEST`, one line for each."""
    known, lines = list(origins), []
    todo: list[tuple[Path, Any]] = [((), data)]
    while todo:
        path, value = todo.pop()
        if isinstance(value, Mapping):
            todo += [((*path, key), child) for key, child in list(value.items())[::-1]]
        elif isinstance(value, list | tuple):
            todo += [((*path, place), child) for place, child in list(enumerate(value))[::-1]]
        elif isinstance(value, int | float) and value and not SMALLEST <= abs(value) <= LARGEST:
            origin = _origin(known, path) or Origin((), source)
            lines.append(
                f"{origin.source}: {_named(data, path, origin)}: found {shown(value)}; expected 0 or a "
                f"number of a magnitude from {SMALLEST:g} to {LARGEST:g}"
            )
    return "\n".join(lines)


class _Problem(NamedTuple):
    detail: ErrorDetails
    path: Path
    origin: Origin


def _grouped(model: type[BaseModel], problems: list[_Problem]) -> list[list[_Problem]]:
    """Put together the missing keys of a section, and unknown ones that resemble no allowed one."""
    groups: dict[object, list[_Problem]] = {}
    for number, problem in enumerate(problems):
        detail, path, origin = problem
        kind: object = detail["type"]
        alone = kind not in ("missing", "extra_forbidden") or not isinstance(path[-1], str)
        if not alone and kind == "extra_forbidden":
            alone = _closest(str(path[-1]), _fields_at(model, detail["loc"][:-1])) is not None
        groups.setdefault(number if alone else (kind, origin.source, path[:-1]), []).append(problem)
    return list(groups.values())


def _several(model: type[BaseModel], data: Any, group: list[_Problem]) -> str:
    detail, path, origin = group[0]
    section = _named(data, path[:-1], origin)
    place = f" in '{section}'" if section else ""
    names = ", ".join(str(problem.path[-1]) for problem in group)
    if detail["type"] == "missing":
        return f"keys are missing{place}: {names}"
    allowed = ", ".join(sorted(_fields_at(model, detail["loc"][:-1])))
    return f"unknown keys{place}: {names}; allowed here: {allowed}"


def shown(value: Any) -> str:
    """Return a value as a message shows it: not longer than a line."""
    try:
        text = repr(value)
    except Exception:  # a number of more than 4300 digits, lists in lists without end, a class of one's own
        text = f"a {type(value).__name__} too long to write"
    return text if len(text) <= LONGEST_FOUND else text[: LONGEST_FOUND - 3] + "..."


def _without_consequences(details: list[ErrorDetails]) -> list[ErrorDetails]:
    """Leave out what only follows from another problem: a list without its bad entries, a misspelt key."""
    kept = []
    for detail in details:
        loc, kind = detail["loc"], detail["type"]
        inside = any(len(other["loc"]) > len(loc) and other["loc"][: len(loc)] == loc for other in details)
        siblings = [
            str(other["loc"][-1])
            for other in details
            if other["type"] == "extra_forbidden" and other["loc"][:-1] == loc[:-1]
        ]
        if kind == "too_short" and inside:
            continue
        if kind == "missing" and any(_closest(name, [str(loc[-1])]) for name in siblings):
            continue
        kept.append(detail)
    return kept


def _sentence(model: type[BaseModel], data: Any, problem: _Problem) -> str:
    detail, path, origin = problem
    kind, key = detail["type"], _named(data, path, origin)
    about = _description(model, detail["loc"])
    if kind == "missing" and isinstance(path[-1], int):
        section = _named(data, path[:-1], origin)
        return f"{section}: found {shown(detail['input'])}; entry {path[-1] + 1} is missing{about}"
    if kind == "missing":
        return f"key '{key}' is missing{about}"
    if kind == "extra_forbidden":
        allowed = sorted(_fields_at(model, detail["loc"][:-1]))
        return f"unknown key '{key}'{nearest(str(path[-1]), allowed)}; allowed here: {', '.join(allowed)}"
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        return _wrong_tag(model, detail, key)
    value = detail["input"]
    if kind == "value_error" and (isinstance(value, Mapping) or len(shown(value)) == LONGEST_FOUND):
        return f"{key}: {_expectation(detail)}{about}" if key else _expectation(detail)
    return f"{key}: found {shown(value)}; {_expectation(detail)}{about}"


def _wrong_tag(model: type[BaseModel], detail: ErrorDetails, key: str) -> str:
    allowed = [word.strip(" '") for word in str(detail["ctx"].get("expected_tags", "")).split(",") if word]
    field = str(detail["ctx"]["discriminator"]).strip("'")
    members = [m for m in _walk(model, detail["loc"]) if field in m.model_fields]
    allowed = allowed or [tag for m in members for tag in get_args(m.model_fields[field].annotation)]
    tags = f"; expected {', '.join(allowed)}" if allowed else ""
    key = f"{key}." if key else ""
    if detail["type"] == "union_tag_invalid":
        found = str(detail["ctx"]["tag"])
        return f"{key}{field}: found '{found}'{nearest(found, allowed)}{tags}"
    names = detail["input"] if isinstance(detail["input"], Mapping) else {}
    known = _fields_at(model, detail["loc"])
    close = _closest(field, [str(name) for name in names if name not in known])
    if close is not None:
        return f"unknown key '{key}{close}', did you mean '{field}'?"
    return f"key '{key}{field}' is missing: it says of which kind the entry is{tags}"


_EXPECTATIONS = {
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number greater than or equal to {ge:g}",
    "less_than": "a number less than {lt:g}",
    "less_than_equal": "a number less than or equal to {le:g}",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "finite_number": "a finite number",
    "model_type": "keys and values",
    "model_attributes_type": "keys and values",
    "dict_type": "keys and values",
    "tuple_type": "a list",
    "list_type": "a list",
    "literal_error": "{expected}",
    "string_type": "text (in quotes if it reads as a number)",
    "string_too_short": "text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "invalid_key": "text as key",
    "too_short": "at least {min_length} entries, found {actual_length}",
    "too_long": "at most {max_length} entries, found {actual_length}",
}
"""What is allowed, for each of Pydantic's types of error, with its context's names."""


def _expectation(detail: ErrorDetails) -> str:
    kind, context = detail["type"], detail.get("ctx", {})
    if kind in _EXPECTATIONS:
        found = detail["input"]
        close = nearest(found, _quoted(str(context.get("expected", "")))) if isinstance(found, str) else ""
        return f"expected {_EXPECTATIONS[kind].format_map(context)}{close}"
    message = detail["msg"].removeprefix("Value error, ")
    return message[0].lower() + message[1:]


def _quoted(text: str) -> list[str]:
    return text.split("'")[1::2]


def _closest(word: str, candidates: Iterable[str]) -> str | None:
    match = difflib.get_close_matches(word, list(candidates), n=1, cutoff=0.6)
    return match[0] if match else None


def _origin(origins: Iterable[Origin], path: Path) -> Origin | None:
    """Return the last origin on the way to a path, or below it."""
    found = None
    for origin in origins:
        shorter = min(len(origin.path), len(path))
        # Everything is below the root, so it says nothing about a part.
        if shorter and origin.path[:shorter] == path[:shorter]:
            found = origin
    return found


def _data_path(data: Any, location: Path) -> Path:
    """Return Pydantic's location without the tags of unions, which are in no file."""
    node, path = data, []
    for place, part in enumerate(location):
        last = place == len(location) - 1
        if isinstance(node, Mapping):
            if part in [node.get(tag) for tag in TAGS] and not (last and part in node):
                continue
            node = node.get(part)
        elif isinstance(node, list | tuple) and isinstance(part, int) and part < len(node):
            node = node[part]
        else:
            node = None
        path.append(part)
    return tuple(path)


def _named(data: Any, path: Path, origin: Origin) -> str:
    """Write a path with dots, entries of lists by their names where they have one."""
    node, parts = data, []
    for part in path:
        if isinstance(node, list | tuple) and isinstance(part, int) and part < len(node):
            node = node[part]
            name = node.get("name") if isinstance(node, Mapping) else None
            parts.append(name if isinstance(name, str) else str(part))
        else:
            node = node.get(part) if isinstance(node, Mapping) else None
            parts.append(str(part))
    return ".".join(parts[origin.depth :])


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is None:
        return []
    return [found for part in get_args(annotation) for found in _models_in(part)]


def _walk(model: type[BaseModel], location: Path) -> list[type[BaseModel]]:
    """Models that may stand at a location (several where the field is a union)."""
    models = [model]
    for part in location:
        if isinstance(part, int):
            continue
        fields = [m.model_fields[part] for m in models if part in m.model_fields]
        if fields:
            models = [found for field in fields for found in _models_in(field.annotation)]
        else:
            # A discriminated union puts the tag (`bush`) into the location.
            models = [m for m in models if part in _tags(m)] or models
    return models


def _fields_at(model: type[BaseModel], location: Path) -> set[str]:
    return {name for m in _walk(model, location) for name in m.model_fields}


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    fields = [model.model_fields[tag] for tag in TAGS if tag in model.model_fields]
    return tuple(value for field in fields for value in get_args(field.annotation))


def _description(model: type[BaseModel], location: Path) -> str:
    """Return ": what the quantity is (its unit)" of the nearest described field."""
    names = list(location)
    while names and isinstance(names[-1], int):
        names.pop()
    if not names or not isinstance(names[-1], str):
        return ""
    for owner in _walk(model, tuple(names[:-1])):
        field = owner.model_fields.get(names[-1])
        if field is not None and field.description:
            return f": {field.description}"
    return ""
