"""From YAML to a validated model: packaged files by name, user files by path, `key=value` overrides."""

from __future__ import annotations

import codecs
import re
import unicodedata
from collections.abc import Callable, Hashable, Iterable
from copy import deepcopy
from functools import lru_cache, partial
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import Origin, absurd_numbers, explain, nearest, shown
from sayd_env.config.files import MIB, read_bytes

__all__ = [
    "apply_overrides",
    "assigned",
    "assigned_keys",
    "beside",
    "is_path",
    "nearest",
    "packaged_names",
    "packaged_text",
    "parse_yaml",
    "placed",
    "read_config",
    "read_study",
    "read_text",
    "section",
    "validate",
    "validated",
]

M = TypeVar("M", bound=BaseModel)

LONGEST_TEXT = 2**18
"""Characters of a YAML text: 35 times the longest packaged one, read in seconds."""
MOST_VALUES = 50_000
"""Values in it, counted wherever an alias repeats them."""
MOST_LEVELS = 50
"""Levels of nesting in it."""
_MERGE, _INTEGER, _FLOAT = (f"tag:yaml.org,2002:{kind}" for kind in ("merge", "int", "float"))


class _Loader(yaml.SafeLoader):
    """Safe YAML that refuses duplicate keys and reads numbers as YAML 1.2 does: 1e5, and 0500 as 500.

    The underscores of 1.1 stay, 250_000; its octal and sexagesimal numbers, 8:20, do not.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012 - PyYAML's own
        first: [(tag, form) for tag, form in found if tag not in (_INTEGER, _FLOAT)]
        for first, found in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        merged = 0
        for key_node, value_node in node.value:
            if key_node.tag == _MERGE:
                for part in value_node.value if isinstance(value_node, yaml.SequenceNode) else [value_node]:
                    if isinstance(part, yaml.MappingNode):
                        self.flatten_mapping(part)
                        merged += len(part.value)
                    if merged > MOST_VALUES:  # merged sections grow before anybody can count what they hold
                        raise ConfigError(_too_much(node.start_mark.name))
        super().flatten_mapping(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == _MERGE:  # <<: *anchor, whose keys the mapping's own may override
                continue
            key = self.construct_object(key_node, deep=True)
            where = f"{node.start_mark.name}: line {key_node.start_mark.line + 1}"
            if not isinstance(key, Hashable):
                raise ConfigError(f"{where}: found {shown(key)}; expected a name as key")
            if key in seen:
                raise ConfigError(f"{where}: key '{key}' appears twice")
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


_DIGITS = r"[0-9](?:_?[0-9])*"
_WHOLE = re.compile(rf"(?:[-+]?{_DIGITS}|0x[0-9a-fA-F]+|0o[0-7]+)$")


def _whole(loader: _Loader, node: yaml.ScalarNode) -> int:
    text = str(loader.construct_scalar(node))
    if not _WHOLE.match(text):
        raise TypeError(text)  # a tag says that it is a number
    return int(text, 0) if text[:2] in ("0x", "0o") else int(text)


_Loader.add_implicit_resolver(_INTEGER, _WHOLE, list("-+0123456789"))
_Loader.add_implicit_resolver(
    _FLOAT,
    re.compile(
        rf"^(?:[-+]?(?:{_DIGITS}\.(?:{_DIGITS})?|\.{_DIGITS})(?:[eE][-+]?[0-9]+)?|[-+]?{_DIGITS}[eE][-+]?[0-9]+"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
    list("-+0123456789."),
)
_Loader.add_constructor(_INTEGER, _whole)


def parse_yaml(text: str, source: str) -> Any:
    """Parse YAML text.

    Raises
    ------
    ConfigError
        It is no YAML, too long or too deep, holds too much (aliases of aliases), or text that no file or
        terminal takes. The message names the source and, where there is one, the line.
    """
    if len(text) > LONGEST_TEXT:
        raise ConfigError(
            f"{source}: is longer than {LONGEST_TEXT} characters, the most that is read of YAML"
        )
    return deepcopy(_parsed(text, source))


@lru_cache(maxsize=64)
def _parsed(text: str, source: str) -> Any:
    """Parse and check a text; the parts that a scenario stands on are read many times."""
    content = _constructed(text, source)
    _check_content(content, source)
    return content


def _constructed(text: str, source: str) -> Any:
    try:
        loader = _Loader(text)
    except yaml.YAMLError:  # a character that YAML does not allow
        raise ConfigError(f"{source}: is not a text file") from None
    loader.name = source
    # Content that contains itself (`&a [*a]`) is then an error, not an infinite loop.
    loader.deep_construct = True
    try:
        return loader.get_single_data()
    except ValueError as error:  # for example a date that does not exist
        digits = "int_max_str_digits" in str(error)
        raise ConfigError(f"{source}: {'has a number too long to read' if digits else error}") from None
    except (LookupError, TypeError, AttributeError, ArithmeticError):  # a tag such as !!int on text
        raise ConfigError(f"{source}: has a value that does not fit its tag") from None
    except RecursionError:
        raise ConfigError(f"{source}: is nested too deeply") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark is not None else ""
        problem = getattr(error, "problem", None) or "cannot be read as YAML"
        raise ConfigError(f"{source}: {where}{problem}") from None
    finally:
        loader.dispose()


def _check_content(content: Any, source: str) -> None:
    """Refuse what holds or nests more than any configuration, and control characters and half characters."""
    todo: list[tuple[tuple[Any, ...], Any]] = [((), content)]
    count = 0
    while todo:
        path, value = todo.pop()
        count += 1
        if isinstance(value, dict | list | tuple | set):
            inner = value.items() if isinstance(value, dict) else enumerate(value)
            keys = value if isinstance(value, dict) else ()
            todo += [((*path, key), child) for key, child in inner] + [(path, key) for key in keys]
            if len(path) == MOST_LEVELS:
                raise ConfigError(f"{source}: is nested too deeply, beyond {MOST_LEVELS} levels")
            if count + len(todo) > MOST_VALUES:
                raise ConfigError(_too_much(source))
        elif isinstance(value, str) and any(_is_control(sign) for sign in value):
            key = ".".join(map(str, path)) + ": " * bool(path)
            raise ConfigError(
                f"{source}: {key}found {shown(value)}; expected text without control characters"
            )


def _too_much(source: str) -> str:
    return f"{source}: holds more than {MOST_VALUES} values, counted wherever an alias repeats them"


def _is_control(sign: str) -> bool:
    return unicodedata.category(sign) in ("Cc", "Cs") and sign not in "\n\t\r"


def packaged_names(kind: str) -> list[str]:
    """Names of the packaged configurations of a kind (`vehicle`, `damper`, `profile`, ...)."""
    folder = resources.files("sayd_env.configs").joinpath(kind)
    return sorted(item.name.removesuffix(".yaml") for item in folder.iterdir() if item.name.endswith(".yaml"))


def read_text(path: Path, what: str = "file", largest: int = 64 * MIB) -> str:
    """Read a user's text file of at most so many bytes.

    Raises
    ------
    ConfigError
        It cannot be read, is larger or is no text.
    """
    try:
        content = read_bytes(path, what, largest)
        marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return content.decode("utf-16" if marked else "utf-8")
    except UnicodeDecodeError as error:
        if b"\0" in content:
            raise ConfigError(f"{path}: is not a text file") from None
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}: line {line}: is not in UTF-8; save the file as such") from None


YAML = (".yaml", ".yml")
DATA = (".csv", ".txt", ".dat", ".tsv", ".asc", ".prw", ".prr", ".whl", ".ban", ".rail")
"""Ends of files' names."""


def is_path(name_or_path: str) -> bool:
    """Whether a reference is a path to a file: it ends as one of YAML or data does, or has a separator."""
    return name_or_path.lower().endswith((*YAML, *DATA)) or "/" in name_or_path


def beside(name_or_path: str, folder: Path) -> str:
    """A path relative to the folder of its file resolved; a name unchanged."""
    return str(folder / name_or_path) if is_path(name_or_path) else name_or_path


def from_anywhere(name_or_path: str) -> str:
    """A path that leads to the file from every directory; a name unchanged."""
    return str(Path(name_or_path).resolve()) if is_path(name_or_path) else name_or_path


def read_config(
    kind: str,
    name_or_path: str,
    files: str = "a YAML file",
    fitting: Callable[[], list[str]] | None = None,
) -> tuple[Any, str]:
    """Raw content of a configuration and where it came from.

    Parameters
    ----------
    kind : str
        Folder of configs/, such as ``vehicle``.
    name_or_path : str
        A packaged name (``emu``) or a path to a YAML file.
    files : str
        What else a path may lead to, as a message says it.
    fitting : callable, optional
        Gives the names that a message offers; by default all of the kind.

    Raises
    ------
    ConfigError
        An unknown name, or a file that cannot be read or is not YAML.
    """
    if is_path(name_or_path):
        return parse_yaml(read_text(Path(name_or_path), largest=MIB), name_or_path), name_or_path
    if name_or_path not in packaged_names(kind):
        names = packaged_names(kind) if fitting is None else fitting()
        raise ConfigError(
            f"unknown {kind} {shown(name_or_path)}{nearest(name_or_path, names)}; "
            f"available: {', '.join(names)}, or a path to {files}"
        )
    source, text = packaged_text(kind, name_or_path)
    return parse_yaml(text, source), source


def packaged_text(kind: str, name: str) -> tuple[str, str]:
    """What messages call a packaged configuration, and its text."""
    file = resources.files("sayd_env.configs").joinpath(kind, f"{name}.yaml")
    return f"configs/{kind}/{name}.yaml", file.read_text(encoding="utf-8")


def section(data: Any, source: str) -> dict[str, Any]:
    """Return data that consists of keys and values.

    Raises
    ------
    ConfigError
        They are something else.
    """
    if isinstance(data, dict):
        return data
    found = "is empty" if data is None else f"found {shown(data)}"
    raise ConfigError(f"{source}: {found}; expected keys and values (YAML)")


def validate(model: type[M], data: Any, source: str, origins: Iterable[Origin] = ()) -> M:
    """Validate raw data.

    `origins` says which parts of the data come from other files than `source`, or from options.

    Raises
    ------
    ConfigError
        With one line for each problem, which names the file, the key, what was found and what is allowed
        (with its unit).
    """
    known = list(origins)
    try:
        found = model.model_validate(section(data, source))
    except ValidationError as error:
        raise ConfigError(explain(model, data, error, source, known)) from None
    except ArithmeticError:  # a check of ours that cannot compute with such a number
        if not (problems := absurd_numbers(data, source, known)):
            raise
        raise ConfigError(problems) from None
    if problems := absurd_numbers(data, source, known):
        raise ConfigError(problems)
    return found


def validated(model: type[M], data: dict[str, Any], source: str, overrides: Iterable[str]) -> M:
    """Apply ``key=value`` assignments to raw data, then validate it.

    Raises
    ------
    ConfigError
        A key or a value cannot be used.
    """
    origins = []
    for item in overrides:
        changed = apply_overrides(data, [item])
        origins.append(assigned(data, item))
        data = changed
    return validate(model, data, source, origins)


def read_study(model: type[M], name_or_path: str, overrides: Iterable[str], *references: str) -> M:
    """Read a study that is no scenario, apply ``key=value`` assignments, and validate it.

    References are the keys under which other files are named, relative to its file: see `placed`.

    Raises
    ------
    ConfigError
        The file, a key or a value cannot be used.
    """
    content, source = read_config("study", name_or_path)
    data = section(content, source)
    for reference in references:
        data = placed(data, reference, partial(beside, folder=Path(source).parent))
    return validated(model, data, source, overrides)


def placed(node: Any, place: str, move: Callable[[str], str]) -> Any:
    """Copy of nested data with the text at a place moved.

    The place is ``a.b`` in a section and ``a.*.b`` in each section of a list, or of what names its entries;
    where there is no text, nothing changes.
    """
    if not place:
        return move(node) if isinstance(node, str) else node
    key, _, rest = place.partition(".")
    if key == "*":
        if isinstance(node, dict):
            return {name: placed(each, rest, move) for name, each in node.items()}
        return [placed(each, rest, move) for each in node] if isinstance(node, list) else node
    if isinstance(node, dict) and key in node:
        return node | {key: placed(node[key], rest, move)}
    return node


def apply_overrides(data: dict[str, Any], overrides: Iterable[str], option: str = "--set") -> dict[str, Any]:
    """Return a copy of nested data with ``a.b.c=value`` assignments applied; values are YAML.

    `option` is what a message calls the place of the assignments.

    Raises
    ------
    ConfigError
        An assignment without ``=``, or a path through something that is not a section.
    """
    result: dict[str, Any] = _copy(data)
    for item in overrides:
        path, sep, text = item.partition("=")
        if not sep or not path.strip():
            raise ConfigError(f"{option} {item}: expected key=value, for example wear=0.5")
        where = f"{option} {path}"
        _assign(result, path.strip().split("."), parse_yaml(text, where), f"{option} {item}")
    return result


def assigned(data: dict[str, Any], item: str, option: str = "--set") -> Origin:
    """Where an assignment goes in data for which `apply_overrides` has accepted it."""
    node: Any = data
    path: list[int | str] = []
    for key in item.partition("=")[0].strip().split("."):
        part = _list_index(node, key, key, item) if isinstance(node, list) else key
        path.append(part)
        # What the last key names may be new.
        node = node.get(part) if isinstance(node, dict) else node[part]
    return Origin(tuple(path), option)


def assigned_keys(assignments: Iterable[str] | None) -> list[str]:
    """Keys to which assignments give values."""
    return [item.partition("=")[0].strip() for item in assignments or ()]


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
                    f"{item}: no key '{where}'{nearest(key, known)}; here: {', '.join(known)}"
                    f"{_other_type(keys[:depth], node)}"
                )
            node = node[key]
        else:
            raise ConfigError(f"{item}: '{'.'.join(keys[:depth])}' is a value, not a section")


def _other_type(keys: list[str], node: dict[str, Any]) -> str:
    """Where keys of another type are looked for in a part of a scenario, say how it becomes one of it."""
    if len(keys) != 1 or not isinstance(node.get("type"), str):
        return ""
    return f". It is of type '{node['type']}'; for keys of another, set {keys[0]}=NAME first"


def _list_index(node: list[Any], key: str, where: str, item: str) -> int:
    names = [str(entry.get("name")) for entry in node if isinstance(entry, dict) and "name" in entry]
    if key in names:
        return next(i for i, entry in enumerate(node) if isinstance(entry, dict) and entry.get("name") == key)
    if key.isascii() and key.isdigit() and int(key) < len(node):
        return int(key)
    raise ConfigError(
        f"{item}: no entry '{where}'{nearest(key, names)}; use a number below {len(node)}"
        + (f" or a name: {', '.join(names)}" if names else "")
    )


def _copy(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: _copy(value) for key, value in node.items()}
    return [_copy(value) for value in node] if isinstance(node, list) else node
