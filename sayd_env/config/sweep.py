"""Sweeps: assignments ``key=a,b,c``, each value of which makes a configuration of its own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import shown
from sayd_env.config.loader import parse_yaml
from sayd_env.config.scenario import STUDY

RULE = "a list is [1, 2], a text with commas is in quotes"
"""How a value is written that has commas itself."""


@dataclass(frozen=True)
class Variant:
    """One configuration of a sweep."""

    assignments: tuple[str, ...]
    """All ``key=value``, each with one value."""
    swept: Mapping[str, Any]
    """Values of the keys that have several; a list is the text that was typed."""

    @property
    def title(self) -> str:
        """``wear=0.5, friction=0.3``; empty if nothing is swept."""
        return ", ".join(f"{key}={value}" for key, value in self.swept.items())


def variants(
    assignments: Iterable[str] | None,
    runs: int = 1,
    *,
    option: str = "--set",
    most: int = 10_000,
) -> list[Variant]:
    """All configurations of some assignments, the last swept key changing fastest.

    Parameters
    ----------
    assignments : iterable of str, optional
        ``key=value`` or ``key=value,value,...``.
    runs : int
        Runs of each configuration.
    option : str
        What a message calls their place.
    most : int
        Runs of all configurations together.

    Returns
    -------
    list of Variant
        One, if nothing is swept.

    Raises
    ------
    ConfigError
        An empty place between commas, one value twice, a swept key that is set twice, or too many runs.
    """
    items = list(assignments or ())
    choices = [_choices(item, option) for item in items]
    swept = {key: values for key, values in choices if len(values) > 1}
    keys = [key for key, _ in choices]
    for key in swept:
        if keys.count(key) > 1:
            raise ConfigError(
                f"{option} {key}: has several values here and is set once more; expected one of both"
            )
    _check_count({key: len(values) for key, values in swept.items()}, runs, most, option)
    return [
        Variant(
            tuple(
                f"{key}={text}" if key in swept else item
                for item, key, (text, _) in zip(items, keys, row, strict=True)
            ),
            {key: value for key, (_, value) in zip(keys, row, strict=True) if key in swept},
        )
        for row in product(*(values for _, values in choices))
    ]


def split_values(text: str) -> list[str]:
    """Values between commas, those in brackets, braces and quotes of YAML left whole.

    Examples
    --------
    >>> split_values("0, 0.5,[1, 2],'a,b'")
    ['0', '0.5', '[1, 2]', "'a,b'"]
    """
    parts, depth, quote, fresh = [""], 0, "", True
    for sign in text:
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"" and fresh:  # within a word it is an apostrophe
            quote = sign
        else:
            depth += (sign in "[{") - (sign in "]}")
        if sign == "," and not quote and depth <= 0:
            parts.append("")
        else:
            parts[-1] += sign
        fresh = sign in "[{,:" or (fresh and sign.isspace())
    return [part.strip() for part in parts] if len(parts) > 1 else parts


def _choices(item: str, option: str) -> tuple[str, list[tuple[str, Any]]]:
    """Key of an assignment, and its values: each as it is written and as it is shown."""
    key, _, text = (part.strip() for part in item.partition("="))
    texts = split_values(text)
    if len(texts) == 1:
        return key, [(text, text)]
    found: list[tuple[str, Any]] = []
    for each in texts:
        if not each:
            raise ConfigError(
                f"{option} {shown(item)}: an empty place; expected values between commas; {RULE}"
            )
        value = parse_yaml(each, f"{option} {key}")
        name = key in STUDY.parts and isinstance(value, int | float)  # such as 60e1
        value = each if name or isinstance(value, list | dict) else value
        if any(value == other for _, other in found):
            raise ConfigError(f"{option} {key}: found {each} twice")
        found.append((each, value))
    return key, found


def _check_count(sizes: Mapping[str, int], runs: int, most: int, option: str) -> None:
    total = math.prod(sizes.values()) * runs
    if sizes and total > most:
        values = " x ".join(f"{size} values of {key}" for key, size in sizes.items())
        each = f", {runs} runs each," if runs > 1 else ""
        raise ConfigError(f"{option}: {values}{each} make {total:,} runs; at most {most:,} are allowed")
