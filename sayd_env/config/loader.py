"""From YAML to a validated model: packaged files by name, user files by path, `key=value` overrides."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from sayd_env.config.errors import ConfigError

M = TypeVar("M", bound=BaseModel)

KINDS = ("vehicle", "damper", "profile", "track", "sensors", "control", "train", "study")


class _Loader(yaml.SafeLoader):
    """Safe YAML that refuses duplicate keys and reads 1e5 as a number (YAML 1.2, unlike PyYAML's 1.1)."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                line = key_node.start_mark.line + 1
                raise ConfigError(f"{node.start_mark.name}: line {line}: key '{key}' appears twice")
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+0123456789."),
)


def parse_yaml(text: str, source: str) -> Any:
    """Parse YAML text; raise `ConfigError` naming the source and the line."""
    loader = _Loader(text)
    loader.name = source
    try:
        return loader.get_single_data()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark is not None else ""
        problem = getattr(error, "problem", None) or "cannot be read as YAML"
        raise ConfigError(f"{source}: {where}{problem}") from None
    finally:
        loader.dispose()


def packaged_names(kind: str) -> list[str]:
    """Names of the packaged configurations of a kind (`vehicle`, `damper`, `profile`, ...)."""
    folder = resources.files("configs").joinpath(kind)
    return sorted(item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml"))


def read_text(path: Path, what: str = "file") -> str:
    """Read a user's text file; raise `ConfigError` with one clear sentence when that fails."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such {what}") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a directory, expected a {what}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not a text file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None


def read_config(kind: str, name_or_path: str) -> tuple[Any, str]:
    """Raw content of a configuration and where it came from.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    name_or_path : str
        A packaged name (``emu``) or a path to a YAML file (it ends in .yaml or .yml, or has a separator).
    """
    if name_or_path.endswith((".yaml", ".yml")) or "/" in name_or_path:
        return parse_yaml(read_text(Path(name_or_path)), name_or_path), name_or_path
    names = packaged_names(kind)
    if name_or_path not in names:
        raise ConfigError(
            f"unknown {kind} '{name_or_path}'{nearest(name_or_path, names)}; "
            f"available: {', '.join(names)}, or a path to a YAML file"
        )
    source = f"configs/{kind}/{name_or_path}.yaml"
    text = resources.files("configs").joinpath(kind, f"{name_or_path}.yaml").read_text(encoding="utf-8")
    return parse_yaml(text, source), source


def nearest(word: str, candidates: Iterable[str]) -> str:
    """Return ", did you mean 'x'?" for the closest candidate, or nothing."""
    match = difflib.get_close_matches(word, list(candidates), n=1, cutoff=0.5)
    return f", did you mean '{match[0]}'?" if match else ""


def validate(model: type[M], data: Any, source: str) -> M:
    """Validate raw data; raise `ConfigError` with one line for each problem.

    Each line names the file, the key, what was found and what is allowed (with its unit).
    """
    if not isinstance(data, Mapping):
        raise ConfigError(f"{source}: expected keys and values, found {_shown(data)}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        lines = [_explain(model, detail) for detail in error.errors(include_url=False)]
        raise ConfigError("\n".join(f"{source}: {line}" for line in lines)) from None


def apply_overrides(data: dict[str, Any], overrides: Iterable[str]) -> dict[str, Any]:
    """Return a copy of nested data with ``a.b.c=value`` assignments applied; values are YAML.

    Raises
    ------
    ConfigError
        An assignment without ``=``, or a path through something that is not a section.
    """
    result: dict[str, Any] = _copy(data)
    for item in overrides:
        path, sep, text = item.partition("=")
        if not sep or not path.strip():
            raise ConfigError(f"--set {item}: expected key=value, for example numerics.step=0.00025")
        _assign(result, path.strip().split("."), parse_yaml(text, f"--set {path}"), item)
    return result


def _assign(data: Any, keys: list[str], value: Any, item: str) -> None:
    node = data
    for depth, key in enumerate(keys):
        last = depth == len(keys) - 1
        where = ".".join(keys[: depth + 1])
        if isinstance(node, list):
            index = _list_index(node, key, where, item)
            if last:
                node[index] = value
                return
            node = node[index]
        elif isinstance(node, dict):
            if last:
                node[key] = value
                return
            if key not in node:
                known = [str(name) for name in node]
                raise ConfigError(
                    f"--set {item}: no key '{where}'{nearest(key, known)}; here: {', '.join(known)}"
                )
            node = node[key]
        else:
            raise ConfigError(f"--set {item}: '{'.'.join(keys[:depth])}' is a value, not a section")


def _list_index(node: list[Any], key: str, where: str, item: str) -> int:
    names = [str(entry.get("name")) for entry in node if isinstance(entry, dict) and "name" in entry]
    if key in names:
        return next(i for i, entry in enumerate(node) if isinstance(entry, dict) and entry.get("name") == key)
    if key.isdigit() and int(key) < len(node):
        return int(key)
    raise ConfigError(
        f"--set {item}: no entry '{where}'{nearest(key, names)}; use a number below {len(node)}"
        + (f" or a name: {', '.join(names)}" if names else "")
    )


def _copy(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: _copy(value) for key, value in node.items()}
    return [_copy(value) for value in node] if isinstance(node, list) else node


def _explain(model: type[BaseModel], detail: ErrorDetails) -> str:
    location = [str(part) for part in _path(model, detail["loc"])]
    key = ".".join(location) or "(top level)"
    found = _shown(detail["input"])
    kind = detail["type"]
    if kind == "extra_forbidden":
        known = sorted(_fields_at(model, detail["loc"][:-1]))
        return f"unknown key '{key}'{nearest(location[-1], known)}; allowed here: {', '.join(known)}"
    if kind == "missing":
        return f"key '{key}' is missing{_unit_at(model, detail['loc'])}"
    message = detail["msg"].removeprefix("Value error, ")
    if kind in ("float_type", "int_type"):
        message = "expected a number"
    return f"{key}: found {found}; {message[0].lower() + message[1:]}{_unit_at(model, detail['loc'])}"


def _path(model: type[BaseModel], location: tuple[int | str, ...]) -> list[int | str]:
    """Keys that a user types: without the tags that a discriminated union puts into a location."""
    return [
        part
        for depth, part in enumerate(location)
        if not any(part in _tags(owner) for owner in _walk(model, location[:depth]))
    ]


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is None:
        return []
    return [found for part in get_args(annotation) for found in _models_in(part)]


def _walk(model: type[BaseModel], location: tuple[int | str, ...]) -> list[type[BaseModel]]:
    """Models that may stand at a location (several where the field is a union)."""
    models = [model]
    for part in location:
        if isinstance(part, int):
            continue
        fields = [m.model_fields[part] for m in models if part in m.model_fields]
        if fields:
            models = [found for field in fields for found in _models_in(field.annotation)]
    return models


def _fields_at(model: type[BaseModel], location: tuple[int | str, ...]) -> set[str]:
    # A discriminated union puts the tag (`linear`) into the location: keep the models that carry it.
    models = _walk(model, location)
    tags = {part for part in location if isinstance(part, str)}
    tagged = [m for m in models if tags & set(_tags(m))]
    return {name for m in (tagged or models) for name in m.model_fields}


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    field = model.model_fields.get("type")
    return get_args(field.annotation) if field is not None else ()


def _unit_at(model: type[BaseModel], location: tuple[int | str, ...]) -> str:
    if not location or not isinstance(location[-1], str):
        return ""
    for owner in _walk(model, location[:-1]):
        field = owner.model_fields.get(location[-1])
        if field is not None and field.description:
            return f": {field.description}"
    return ""


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
