"""The tables of docs/environments.md, made from what the environments themselves say.

    python docs/environment_tables.py

prints them, to be put into the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby

from sayd_env.config.distribution import (
    ChoiceDistribution,
    Distribution,
    FixedDistribution,
    NormalDistribution,
)
from sayd_env.config.environment import EnvironmentConfig, ProfileClass, load_environment
from sayd_env.config.fault import SensorErrorClass, ValveStuckClass
from sayd_env.config.learner import LearnerConfig, load_learner
from sayd_env.config.limits import LIMITS
from sayd_env.config.sensors import KINDS, UNITS, SensorsConfig, load_sensors
from sayd_env.config.track import TrackClass
from sayd_env.envs.interface import ACTIONS, BOGIES, DAMPERS, Signal
from sayd_env.envs.options import NUMBERS
from sayd_env.envs.registration import IDS
from sayd_env.envs.single import SaydEnv

LAYOUTS = {
    "bogie": [f"the four valves of the {bogie} bogie" for bogie in BOGIES],
    "damper": [f"{bogie}.{place}" for bogie in BOGIES for place in DAMPERS],
    "vehicle": ["all eight valves"],
}
"""What the numbers of an action command."""


def tables() -> dict[str, str]:
    """All tables of the page, by name."""
    environments = {name: load_environment(name) for name in IDS.values()}
    return {
        "action": action_table(),
        "signals": observation_table(SaydEnv().signals),
        "features": observation_table(SaydEnv(observation="features").signals),
        "scaled": scaled_table(load_learner()),
        "sensors": sensor_table(load_sensors("realistic")),
        "options": option_table(),
        # What a line does not say is drawn as in Randomized.
        "draws": draw_table({name: each for name, each in environments.items() if each.lines is None}),
        "tolerances": tolerance_table(environments["randomized"]),
        "faults": fault_table(environments["faults"]),
    }


def observation_table(signals: Sequence[Signal]) -> str:
    """Table of an observation's numbers, one row for each quantity."""
    rows, first = [], 0
    for quantity, group in groupby(signals, key=lambda signal: signal.name.partition(".")[0]):
        members = list(group)
        numbers = str(first) if len(members) == 1 else f"{first} to {first + len(members) - 1}"
        places = [member.name.partition(".")[2] for member in members]
        head = members[0]
        rows.append((numbers, quantity, _places(places), head.unit, f"{head.low:g}", f"{head.high:g}"))
        first += len(members)
    return _table(("number", "quantity", "places, the last changes first", "unit", "low", "high"), rows)


def scaled_table(config: LearnerConfig) -> str:
    """Table of the maps of a scaled environment, one row for each quantity."""
    maps = {"linear": "(x - middle) / half", "log": "ln(x / middle) / half"}
    rows = [
        (quantity, maps[each.scale], f"{each.middle:g}", f"{each.half:g}")
        for quantity, each in config.inputs.items()
    ]
    return _table(("quantity x", "becomes", "middle", "half"), rows)


def action_table() -> str:
    """Table of an action's numbers for each layout of the valves."""
    rows = [
        (f"'{valves}'", str(number), what, "0", "1")
        for valves in ACTIONS
        for number, what in enumerate(LAYOUTS[valves])
    ]
    return _table(("valves", "number", "command of", "closed", "open"), rows)


def sensor_table(sensors: SensorsConfig) -> str:
    """Table of the errors of a set of sensors."""
    rows = []
    for kind in KINDS:
        sensor = getattr(sensors, kind)
        corner = "-" if sensor.bandwidth is None else f"{sensor.bandwidth:g}"
        numbers = (sensor.noise, sensor.bias_spread, sensor.resolution)
        rows.append((kind, UNITS[kind], *(f"{n:g}" for n in numbers), corner, f"{1e3 * sensor.sampling:g}"))
    head = ("sensor", "unit", "noise, RMS", "bias, up to", "resolution", "corner (Hz)", "sampling (ms)")
    return _table(head, rows)


def option_table() -> str:
    """Table of the options of `reset` that are numbers."""
    rows = [
        (name, LIMITS[name].unit, f"{LIMITS[name].low:g}", f"{LIMITS[name].high:g}")
        for name in (*NUMBERS, "track_scale")
    ]
    return _table(("option", "unit", "from", "to"), rows)


def draw_table(environments: Mapping[str, EnvironmentConfig]) -> str:
    """Table of what episodes draw, one column for each environment."""
    rows = []
    for name in (*NUMBERS, "sensor_bias", "sensor_noise"):
        columns = [getattr(config.randomisation, name) for config in environments.values()]
        rows.append(
            (
                name,
                LIMITS[name].unit,
                *("the study's" if each is None else in_words(each) for each in columns),
            )
        )
    drawn = [config.randomisation for config in environments.values()]
    profiles = [{_profile(each): f"weight {each.weight:g}" for each in one.profiles} for one in drawn]
    tracks = [{f"track {each.name}, scale": _track(each) for each in one.tracks} for one in drawn]
    for columns in (profiles, tracks):
        for name in dict.fromkeys(name for cells in columns for name in cells):
            rows.append((name, "-", *(cells.get(name, "-") for cells in columns)))
    return _table(("quantity", "unit", *environments), rows)


def _profile(drawn: ProfileClass) -> str:
    shift = "" if drawn.shift is None else f", shift {1e3 * drawn.shift:g} mm"
    return f"profile {drawn.name or 'of the study'}{shift}"


def _track(drawn: TrackClass) -> str:
    return f"weight {drawn.weight:g}" + (f", {in_words(drawn.scale)}" if drawn.scale else "")


def tolerance_table(config: EnvironmentConfig) -> str:
    """Table of the factors that an episode draws."""
    groups = config.randomisation.tolerances
    rows = [
        (name, ", ".join(f"`{key}`" for key in group.keys), in_words(group.factor))
        for name, group in groups.items()
    ]
    return _table(("group", "numbers", "factor"), rows)


def fault_table(config: EnvironmentConfig) -> str:
    """Table of the faults that an episode draws, with the share of each kind."""
    faults = config.faults
    if faults is None:
        return ""
    total = sum(each.weight for each in faults.kinds)
    rows = []
    for fault in faults.kinds:
        measure = "-"
        if isinstance(fault, ValveStuckClass):
            measure = f"current {in_words(fault.current)}"
        elif isinstance(fault, SensorErrorClass):
            measure = f"{in_words(fault.share)} of half the range"
        rows.append((fault.kind, f"{100.0 * fault.weight / total:.0f} %", measure))
    return _table(("fault", "share", "measure"), rows)


def in_words(drawn: Distribution) -> str:
    """A distribution in words."""
    if isinstance(drawn, FixedDistribution):
        return f"{drawn.value:g}"
    if isinstance(drawn, ChoiceDistribution):
        weights = drawn.weights or (1.0,) * len(drawn.values)
        pairs = zip(drawn.values, weights, strict=True)
        return ", ".join(f"{value:g} ({100.0 * weight / sum(weights):.0f} %)" for value, weight in pairs)
    if isinstance(drawn, NormalDistribution):
        return f"{drawn.mean:g} ± {drawn.deviation:g}, {drawn.low:g} to {drawn.high:g}"
    grid = "" if drawn.step is None else f" in steps of {drawn.step:g}"
    return f"{drawn.low:g} to {drawn.high:g}{grid}"


def _places(places: Sequence[str]) -> str:
    """Places in a row: the values of each part of their names."""
    parts = [
        list(dict.fromkeys(column)) for column in zip(*(place.split(".") for place in places), strict=True)
    ]
    return ", ".join("/".join(part) for part in parts if part != [""]) or "-"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = [head, ["-" * width for width in widths], *rows]
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |"
        for line in lines
    )


if __name__ == "__main__":
    print("\n\n".join(tables().values()))
