"""Options that several commands share: one name, one meaning, one check."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import typer

from sayd_env.config.errors import ConfigError

MAX_SPEEDS = 1000
MAX_SEEDS = 10_000
LARGEST_SEED = 2**32 - 1
MAX_WORKERS = 1024
OUTPUT = "Output"
SCENARIO = "Scenario"


class Speeds(tuple[float, ...]):
    """Running speeds in km/h, positive and rising."""

    __slots__ = ()


class Numbers(tuple[float, ...]):
    """Finite numbers, at least one."""

    __slots__ = ()


class Names(tuple[str, ...]):
    """Names as they were typed, at least one."""

    __slots__ = ()


class PolicyNames(tuple[str, ...]):
    """Policies as they were typed, at least one."""

    __slots__ = ()


class Damper(StrEnum):
    """The yaw damper's kind."""

    PASSIVE = "passive"
    SAYD = "sayd"


def speed_list(option: str) -> Callable[[str], Speeds]:
    """Make the reader of an option that takes speeds: see `parse_speeds`."""
    return lambda text: parse_speeds(text, option)


def parse_speeds(text: str, option: str = "--speeds") -> Speeds:
    """Read ``300,350,400`` or ``320:445:25`` (first, last, step; last included when a step meets it).

    Parameters
    ----------
    text : str
        Speeds in km/h.
    option : str
        What a message names.

    Raises
    ------
    ConfigError
        Not a number, not positive, not finite, not rising, empty, or more than `MAX_SPEEDS` values.
    """
    given = f"{option} '{text}'"
    if ":" in text:
        return Speeds(_grid(text, given))
    speeds = Speeds(_speed(part, given) for part in text.split(","))
    for before, after in pairwise(speeds):
        if after <= before:
            raise _speeds_error(given, f"{after:g} follows {before:g}; speeds must rise")
    return speeds


def _grid(text: str, given: str) -> list[float]:
    parts = text.split(":")
    if len(parts) != 3:
        raise _speeds_error(given, "expected first:last:step, for example 320:445:25")
    first, last, step = (_speed(part, given) for part in parts)
    if last < first:
        raise _speeds_error(given, f"the last speed {last:g} is below the first {first:g}")
    # Half a millionth of a step forgives the rounding of decimal steps such as 0.1.
    steps = (last - first) / step + 5e-7
    if steps >= MAX_SPEEDS:
        raise _speeds_error(given, f"gives {steps + 1:.4g} speeds; at most {MAX_SPEEDS} are allowed")
    return [first + index * step for index in range(math.floor(steps) + 1)]


def _speed(part: str, given: str) -> float:
    try:
        value = float(part)
    except ValueError:
        found = f"'{part.strip()}'" if part.strip() else "an empty place"
        raise _speeds_error(given, f"found {found}; expected numbers in km/h") from None
    if not (value > 0.0 and math.isfinite(value)):
        raise _speeds_error(given, f"found {part.strip()}; expected a finite number above 0 km/h")
    return value


def _speeds_error(given: str, problem: str) -> ConfigError:
    return ConfigError(f"{given}: {problem} (use 300,350,400 or 320:445:25)")


def parse_policies(text: str) -> PolicyNames:
    """Read ``passive,mppt1,constant:0.3``; whether there are such policies is checked where they are made."""
    return PolicyNames(_names(text, "--policies", "passive,mppt1,constant:0.3"))


def names(option: str, example: str) -> Callable[[str], Names]:
    """Make the reader of an option that takes names, separated by commas."""
    return lambda text: Names(_names(text, option, example))


def _names(text: str, option: str, example: str) -> list[str]:
    found = [part.strip() for part in text.split(",")]
    if not all(found):
        raise ConfigError(f"{option} '{text}': found an empty place; expected names (use {example})")
    return found


def parse_wear(text: str) -> float:
    """Read the wear of the wheel profile: 0 (new) to 1 (worn)."""
    return _bounded("--wear", text, 0.0, 1.0)


def parse_friction(text: str) -> float:
    """Read the friction coefficient of wheel and rail: above 0, at most 1."""
    return positive("--friction", "", 1.0)(text)


def whole(option: str, least: int, most: int) -> Callable[[str], int]:
    """Make the reader of an option that takes one whole number."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if not least <= value <= most:
            raise ConfigError(f"{option} {text}: expected a whole number from {least} to {most}")
        return value

    return read


def positive(option: str, unit: str, most: float = math.inf) -> Callable[[str], float]:
    """Make the reader of an option that takes one finite number above 0; `unit` may be empty."""
    allowed = f"above 0 {unit}".rstrip() + ("" if math.isinf(most) else f", at most {most:g}")

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (0.0 < value <= most and math.isfinite(value)):
            raise ConfigError(f"{option} {text}: expected a finite number {allowed}")
        return value

    return read


def positive_list(option: str, unit: str, most: float = math.inf) -> Callable[[str], Numbers]:
    """Make the reader of an option that takes finite numbers above 0, separated by commas."""
    one = positive(option, unit, most)
    return lambda text: Numbers(one(part) for part in text.split(","))


def share(option: str) -> Callable[[str], float]:
    """Make the reader of an option that takes one number from 0 to 1."""
    return lambda text: _bounded(option, text, 0.0, 1.0)


def share_list(option: str) -> Callable[[str], Numbers]:
    """Make the reader of an option that takes numbers from 0 to 1, separated by commas."""
    return lambda text: Numbers(_bounded(option, part, 0.0, 1.0) for part in text.split(","))


def several(one: Callable[[str], float], option: str) -> Callable[[str], Numbers]:
    """Make the reader of an option that takes different numbers, separated by commas, each read by `one`."""

    def read(text: str) -> Numbers:
        values = Numbers(one(part.strip()) for part in text.split(","))
        if len(set(values)) < len(values):
            raise ConfigError(f"{option} {text}: a number stands there twice")
        return values

    return read


def _bounded(option: str, text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise ConfigError(f"{option} {text}: expected a number from {low:g} to {high:g}")
    return value


Config = Annotated[
    str | None,
    typer.Option("--config", metavar="NAME|FILE", help="Configuration: a packaged name or a YAML file."),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override one key of the configuration; repeatable."),
]
Seed = Annotated[
    int,
    typer.Option("--seed", parser=whole("--seed", 0, LARGEST_SEED), metavar="S", help="First random seed."),
]
Seeds = Annotated[
    int,
    typer.Option(
        "--seeds",
        parser=whole("--seeds", 1, MAX_SEEDS),
        metavar="N",
        help="Number of track realisations: seeds S to S+N-1.",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        parser=whole("--workers", 1, MAX_WORKERS),
        metavar="N",
        help="Threads (default: all cores); results do not change.",
    ),
]
Executor = Annotated[
    str | None,
    typer.Option(
        "--executor",
        metavar="KIND",
        help="Who computes: threads, processes, ray, ray://ADDRESS, dask or dask://ADDRESS; results do not "
        "change. Default: processes where there are many runs, else threads.",
    ),
]
NoSeed = Annotated[
    int,
    typer.Option(
        "--seed",
        metavar="S",
        parser=whole("--seed", 0, LARGEST_SEED),
        help="Accepted; nothing here is random.",
    ),
]
NoWorkers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        parser=whole("--workers", 1, MAX_WORKERS),
        help="Accepted; this is one short computation.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        rich_help_panel=OUTPUT,
        help="Directory of result.json, tables and plots. Default: results/COMMAND (none with --json).",
    ),
]
Json = Annotated[
    bool,
    typer.Option("--json", rich_help_panel=OUTPUT, help="Print the result as JSON and nothing else."),
]
SpeedList = Annotated[
    Speeds | None,
    typer.Option(
        "--speeds",
        parser=parse_speeds,
        metavar="KMH",
        rich_help_panel=SCENARIO,
        help="Speeds in km/h: 300,350,400 or 320:445:25.",
    ),
]
Profile = Annotated[
    str | None,
    typer.Option(
        "--profile",
        metavar="NAME",
        rich_help_panel=SCENARIO,
        help="Wheel profile: new, worn or a name.",
    ),
]
Wear = Annotated[
    float | None,
    typer.Option(
        "--wear",
        parser=parse_wear,
        metavar="0..1",
        rich_help_panel=SCENARIO,
        help="Tread wear, 0 is new.",
    ),
]
Friction = Annotated[
    float | None,
    typer.Option(
        "--friction",
        parser=parse_friction,
        metavar="MU",
        rich_help_panel=SCENARIO,
        help="Friction coefficient of wheel and rail.",
    ),
]
Wears = Annotated[
    Numbers | None,
    typer.Option(
        "--wear",
        parser=several(parse_wear, "--wear"),
        metavar="0..1,...",
        rich_help_panel=SCENARIO,
        help="Tread wear, 0 is new; one or several.",
    ),
]
Frictions = Annotated[
    Numbers | None,
    typer.Option(
        "--friction",
        parser=several(parse_friction, "--friction"),
        metavar="MU,...",
        rich_help_panel=SCENARIO,
        help="Friction coefficient of wheel and rail; one or several.",
    ),
]
Policies = Annotated[
    PolicyNames | None,
    typer.Option(
        "--policies",
        parser=parse_policies,
        metavar="A,B,...",
        help="Names ('sayd policies' lists all), constant:V, files of learned policies (.npz, .onnx, .zip) "
        "or of controllers (.yaml), or code of one's own: module:factory, file.py:factory.",
    ),
]
TrustPickles = Annotated[
    bool,
    typer.Option(
        "--trust-pickles",
        help="Load a policy that Stable-Baselines3 saved (.zip, PPO or SAC with MlpPolicy). Such a file can "
        "run any code on this machine while it is loaded.",
    ),
]
TrainedPeriod = Annotated[
    float | None,
    typer.Option(
        "--trained-period",
        parser=positive("--trained-period", "s", 1.0),
        metavar="S",
        help="With --trust-pickles: control period of its training (s), which the file does not say. "
        "Default: the environment's.",
    ),
]
VecNormalize = Annotated[
    Path | None,
    typer.Option(
        "--vec-normalize",
        metavar="FILE",
        help="With --trust-pickles: statistics of the VecNormalize behind which it has learned (.pkl), which "
        "can run any code, too.",
    ),
]
Reward = Annotated[
    str | None,
    typer.Option(
        "--reward",
        metavar="NAME",
        help="Weights of the cost J: mppt1 (acceleration alone) or mppt2 (the study's). "
        "Others by --set cost.force_weight=0.3.",
    ),
]
Environment = Annotated[
    str,
    typer.Option(
        "--environment",
        metavar="NAME|FILE",
        help="Sensors, control period and length of an episode: nominal, randomized, faults or a YAML file.",
    ),
]
Track = Annotated[
    str | None,
    typer.Option(
        "--track", metavar="NAME|FILE", rich_help_panel=SCENARIO, help="Track: a name or a YAML file."
    ),
]
DamperKind = Annotated[
    Damper | None, typer.Option("--damper", rich_help_panel=SCENARIO, help="The yaw dampers.")
]
