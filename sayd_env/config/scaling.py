"""Factors on nested numbers of a configuration; the result is validated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from sayd_env.config.base import Model
from sayd_env.config.errors import ConfigError
from sayd_env.config.loader import nearest, validate

M = TypeVar("M", bound=Model)
Path = tuple[str, ...]


def scaled(config: M, factors: Mapping[Path, float], above: Path = ()) -> M:
    """Copy of a configuration with some of its numbers multiplied.

    Parameters
    ----------
    config : Model
        The configuration, which stays as it is; what is not touched is shared with the copy.
    factors : mapping
        Factor for each path; the parts of a path are fields, names or places of entries of a list. A list is
        scaled as a whole, a curve of points (x, y) in its ordinates y.
    above : tuple of str
        Where the configuration itself stands, for messages.

    Raises
    ------
    ConfigError
        A path that leads to no number, or a product that is not allowed.
    """
    if not factors:
        return config
    changes = {}
    for head, below in _by_head(factors).items():
        if head not in type(config).model_fields:
            raise _unknown((*above, head), type(config).model_fields)
        changes[head] = _changed(getattr(config, head), below, (*above, head))
    return validate(type(config), dict(config) | changes, f"scaled '{'.'.join(above) or 'configuration'}'")


def _by_head(factors: Mapping[Path, float]) -> dict[str, dict[Path, float]]:
    groups: dict[str, dict[Path, float]] = {}
    for path, factor in factors.items():
        groups.setdefault(path[0], {})[path[1:]] = factor
    return groups


def _changed(value: Any, factors: dict[Path, float], where: Path) -> Any:
    rest = dict(factors)
    value = _times(value, rest.pop((), 1.0), where)
    if not rest:
        return value
    if isinstance(value, Model):
        return scaled(value, rest, where)
    if isinstance(value, tuple):
        return _changed_entries(value, rest, where)
    raise _unknown((*where, next(iter(rest))[0]), ())


def _changed_entries(entries: tuple[Any, ...], factors: dict[Path, float], where: Path) -> tuple[Any, ...]:
    names = [str(getattr(entry, "name", place)) for place, entry in enumerate(entries)]
    result = list(entries)
    for head, below in _by_head(factors).items():
        if head not in names and not (head.isdigit() and int(head) < len(entries)):
            raise _unknown((*where, head), names)
        place = names.index(head) if head in names else int(head)
        result[place] = _changed(entries[place], below, (*where, head))
    return tuple(result)


def _times(value: Any, factor: float, where: Path) -> Any:
    if factor == 1.0:
        return value
    if isinstance(value, Model) and "scale" in type(value).model_fields:
        return value.model_copy(update={"scale": factor * getattr(value, "scale")})  # noqa: B009
    if isinstance(value, int | float) and not isinstance(value, bool):
        return factor * value
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return tuple((x, factor * y) for x, y in value)
    if isinstance(value, tuple) and value and isinstance(value[0], int | float):
        return tuple(factor * entry for entry in value)
    raise ConfigError(
        f"'{'.'.join(where)}' is not a number, a list of numbers or a curve: it cannot be scaled"
    )


def _unknown(path: Path, known: Any) -> ConfigError:
    names = [str(name) for name in known]
    here = f"; here: {', '.join(names)}" if names else ""
    return ConfigError(f"nothing to scale at '{'.'.join(path)}'{nearest(path[-1], names)}{here}")
