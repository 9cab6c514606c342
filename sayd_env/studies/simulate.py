"""Time histories of one run: a file of the signals that were asked for, and a page that shows them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.conditions import Line
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.line import LineConfig
from sayd_env.config.palette import cycled
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array
from sayd_env.envs.rollout import assessed_steps
from sayd_env.report import histories as files
from sayd_env.report.columns import Column, Listing, Table, csv_table, json_rows
from sayd_env.report.figures import Plot, label, panels, reference_line
from sayd_env.report.html import Grid, Page, Picture, Section, Text, Verdict
from sayd_env.report.live import extremes
from sayd_env.runs.along import line_runs
from sayd_env.runs.histories import QUANTITIES, History, HistorySignal, chosen, history, signals_of
from sayd_env.runs.policies import PolicySpec
from sayd_env.runs.rollouts import Run, conditions, own_policy, policy_runs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

MOST_NUMBERS = 200_000_000
"""Numbers of one history: 1.6 GB of memory."""
DRAWN = 1500
"""Points of a curve: more cannot be told apart in a picture."""
MOST_CURVES = 4
"""In one panel."""
CLOSE = 2.0
"""Time at the end of a run that is drawn once more, where curves can be told apart, s."""
COLUMNS = (
    Column("name", "signal"),
    Column("unit", "unit"),
    Column("minimum", "least"),
    Column("maximum", "largest"),
    Column("mean", "mean"),
    Column("rms", "RMS"),
)
"""Of each signal, from step 0 on."""
_GROUPS = (
    Column("quantity", "quantity"),
    Column("unit", "unit"),
    Column("count", "signals"),
    Column("minimum", "least"),
    Column("maximum", "largest"),
    Column("rms", "largest RMS"),
)
_OVERVIEW = (
    Column("file", "file"),
    Column("seconds", "time", "s", digits=1),
    Column("lateral_acceleration", "acc.", "m/s²", digits=2),
    Column("track_shift", "ΣY", "kN", 1e-3, 1),
    Column("damper_force", "damper", "kN", 1e-3, 1),
    Column("ending", "ended early"),
)
"""Of a run among others: the largest absolute values of some quantities."""


@dataclass(frozen=True, eq=False)
class Target:
    """Where a history goes."""

    file: Path
    kind: str
    """One of `sayd_env.report.histories.FORMATS`."""

    def numbered(self, number: int) -> Target:
        """The file of one run of several."""
        return replace(self, file=self.file.with_stem(f"{self.file.stem}_{number}"))


def chosen_target(file: Path | None, kind: str | None, folder: Path) -> Target:
    """File and format by what was asked for: the ending says the format, or the format the ending.

    Raises
    ------
    ConfigError
        An ending or a format that is none, or both that differ; a library that is missing.
    """
    if file is None:
        kind = files.checked_format(kind or "csv")
        return Target(folder / f"simulate{files.FORMATS[kind]}", kind)
    endings = {ending: known for known, ending in files.FORMATS.items()}
    by_ending = endings.get(file.suffix.lower())
    if by_ending is None:
        raise ConfigError(f"-o {file}: expected a file that ends in {', '.join(endings)}")
    if kind not in (None, by_ending):
        files.checked_format(str(kind))
        raise ConfigError(f"--format {kind}: the file '{file.name}' is {by_ending}; leave out one of both")
    return Target(file, files.checked_format(by_ending, f"-o {file}"))


@dataclass(frozen=True, eq=False)
class SimulateResult:
    """What a history holds; the history itself is in its file."""

    target: Target
    run: Run
    line: str | None
    time: Array
    """(2,) first and last time, counted from step 0, s."""
    sample_rate: float
    """Hz."""
    rows: tuple[dict[str, Any], ...]
    """One for each signal, by `COLUMNS`."""
    curves: Mapping[str, tuple[Array, Array]]
    """Time and values of each signal, as they are drawn."""
    close: Mapping[str, tuple[Array, Array]]
    """The same of the last seconds."""
    ending: str | None

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd simulate --json``."""
        return {
            "file": str(self.target.file),
            "format": self.target.kind,
            "policy": self.run.policy.title,
            "speed_kmh": self.run.speed * KMH,
            "line": self.line,
            "wear": self.run.scenario.wear,
            "friction": self.run.scenario.friction,
            "track_seed": self.run.seed,
            "time_s": self.time.tolist(),
            "sample_rate_hz": self.sample_rate,
            "ending": self.ending,
            "signals": json_rows(COLUMNS, self.rows),
        }

    def tables(self) -> Mapping[str, Table]:
        """Each signal: least and largest value, mean, RMS."""
        return {"signals": csv_table(COLUMNS, self.rows)}

    def plots(self) -> Mapping[str, Plot]:
        """One picture for each quantity."""
        return {quantity: partial(self._draw, rows) for quantity, rows in self._quantities.items()}

    def page(self) -> Page:
        """The run: what it was, all quantities over time, all signals in numbers."""
        first, last = self.time.tolist()
        ended = "to its end" if self.ending is None else f"and ended early: {self.ending}"
        words = f"{self._title}: {last:g} s {ended}."
        known = {
            key: value for key, value in self.as_dict().items() if key not in ("signals", "time_s", "ending")
        }
        span = f"Time: {first:g} to {last:g} s; at 0 s the policy begins to act, before it is the run-in."
        pictures = [
            Picture(quantity, f"{quantity} over time", self._words(quantity)) for quantity in self._quantities
        ]
        shown = [{**row, "unit": _shown(str(row["unit"]))} for row in self.rows]
        numbers = Grid.of(Listing("", COLUMNS, shown), lambda row: str(row["name"]).partition(".")[0])
        sections = [
            Section("Run", [Grid.facts(known), Text(span)]),
            Section("Signals over time", pictures),
            Section("Signals in numbers, from 0 s on", [numbers]),
        ]
        return Page(self._title, Verdict([words], None if self.ending is None else False), sections)

    def overview(self) -> tuple[Sequence[Column], list[dict[str, Any]]]:
        """The run as one of many."""
        peaks = {
            quantity: max(max(-row["minimum"], row["maximum"]) for row in rows)
            for quantity, rows in self._quantities.items()
        }
        row: dict[str, Any] = dict.fromkeys(column.name for column in _OVERVIEW) | peaks
        row |= {"file": self.target.file.name, "seconds": float(self.time[1]), "ending": self.ending}
        shown = [c for c in _OVERVIEW if c.name in peaks or c.name in ("file", "seconds", "ending")]
        return shown, [row]

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the quantities, and where they are."""
        groups = [
            {
                "quantity": quantity,
                "unit": _shown(QUANTITIES[quantity].unit),
                "count": len(rows),
                "minimum": min(row["minimum"] for row in rows),
                "maximum": max(row["maximum"] for row in rows),
                "rms": max(row["rms"] for row in rows),
            }
            for quantity, rows in self._quantities.items()
        ]
        Listing(f"{self._title}: from 0 s on", _GROUPS, groups).print(console, wide)
        if self.ending is not None:
            console.print(f"ended early: {self.ending}", style="red", highlight=False, markup=False)
        size = self.target.file.stat().st_size / 1e6 if self.target.file.exists() else 0.0
        console.print(
            f"{self.target.file}: {self.time[0]:g} to {self.time[1]:g} s, {len(self.rows)} signals at "
            f"{self.sample_rate:g} Hz, {size:.1f} MB",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )

    @property
    def _title(self) -> str:
        where = f"{self.run.speed * KMH:g} km/h" if self.line is None else f"line '{self.line}'"
        return f"{self.run.policy.title}, {where}, seed {self.run.seed}"

    @cached_property
    def _quantities(self) -> dict[str, list[dict[str, Any]]]:
        """Signals by quantity."""
        grouped = groupby(self.rows, lambda row: str(row["name"]).partition(".")[0])
        return {quantity: list(rows) for quantity, rows in grouped}

    def _words(self, quantity: str) -> list[str]:
        about = QUANTITIES[quantity]
        return [f"{quantity} ({_shown(about.unit)}): {about.meaning}", f"Right: the last {CLOSE:g} s."]

    def _draw(self, rows: Sequence[Mapping[str, Any]], figure: Figure) -> None:
        parts = list(_panels(rows))
        axes = panels(figure, 2 * len(parts), 2, size=(5.5, 2.2), sharex="col")
        for row, part in enumerate(parts):
            whole, close = axes[2 * row : 2 * row + 2]
            _draw_panel(whole, part, self.curves)
            _draw_panel(close, part, self.close)
            reference_line(whole, 0.0, vertical=True)
            whole.set_ylabel(_shown(str(part[0]["unit"])))
            close.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        for axis in axes[-2:]:
            axis.set_xlabel("time (s)")


def simulate(
    scenario: Scenario,
    target: Target,
    *,
    policy: PolicySpec | None = None,
    speed: float = 300.0 / KMH,
    line: str | LineConfig | Line | None = None,
    seed: int = 0,
    seconds: float | None = None,
    signals: Sequence[str] = (),
    run_in: bool = True,
    environment: EnvironmentConfig | None = None,
    initial_current: float = 0.0,
    about: Mapping[str, str] | None = None,
) -> SimulateResult:
    """Make a run, and write its history.

    Parameters
    ----------
    scenario, policy, speed, line, seed, seconds, environment, initial_current
        As for `run_of`.
    signals : sequence of str
        As for `sayd_env.runs.histories.chosen`.
    run_in : bool
        Write the run-in, too.
    about : mapping, optional
        What the file says of itself, where its format has a place for it.

    Raises
    ------
    ConfigError
        A run or signals that cannot be, a history that is too long, a library that is missing.
    StudyError
        A run that diverged, a file that cannot be written.
    """
    files.checked_format(target.kind)
    run = run_of(
        scenario,
        policy=policy,
        speed=speed,
        line=line,
        seed=seed,
        seconds=seconds,
        environment=environment,
        initial_current=initial_current,
    )
    wanted, episode = chosen(signals_of(run), signals), seconds is not None or line is not None
    _check_size(run, wanted, episode=episode)
    found = history(run, wanted, episode=episode)
    found = found if run_in else found.behind_run_in()
    columns = list(zip(found.signals, found.values, strict=True))
    files.write_history(target.file, target.kind, found.time, columns, about or {})
    late = slice(max(0, len(found.time) - round(CLOSE * found.sample_rate)), None)
    return SimulateResult(
        target=target,
        run=run,
        line=line if isinstance(line, str) or line is None else "line",
        time=found.time[[0, -1]],
        sample_rate=found.sample_rate,
        rows=tuple(_statistics(found)),
        curves={signal.name: extremes(found.time, values, DRAWN) for signal, values in columns},
        close={signal.name: (found.time[late], values[late].copy()) for signal, values in columns},
        ending=found.ending,
    )


def run_of(
    scenario: Scenario,
    *,
    policy: PolicySpec | None = None,
    speed: float = 300.0 / KMH,
    line: str | LineConfig | Line | None = None,
    seed: int = 0,
    seconds: float | None = None,
    environment: EnvironmentConfig | None = None,
    initial_current: float = 0.0,
) -> Run:
    """One run as `sayd_env.studies.evaluate.evaluate` makes it, or along a line.

    Parameters
    ----------
    policy : PolicySpec, optional
        By default what the scenario's dampers do by themselves.
    speed : float
        m/s; does not count on a line with speeds of its own.
    line : str, LineConfig or Line, optional
        A name, a path or a content.
    seed : int
        Of the track.
    seconds : float, optional
        From step 0 on; by default the assessed length, or the whole line.
    environment : EnvironmentConfig, optional
        Sensors and clock; ``nominal`` by default.
    initial_current : float
        Valve command of the run-in.

    Raises
    ------
    ConfigError
        A line that cannot be, a speed outside the vehicle's range, a policy that does not fit; no time.
    """
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise ConfigError(f"seconds: found {seconds}; expected a number above 0")
    spec, setup = policy or own_policy(scenario), environment or load_environment()
    (here,) = conditions(scenario)
    given: dict[str, Any] = {"initial_current": initial_current}
    if line is None:
        (run,) = policy_runs([spec], [here], [speed], [seed], setup, **given)
    else:
        (run,) = line_runs([spec], here, line, [speed], [seed], setup, **given)
    if seconds is None:
        return run
    period = spec.environment(run.environment).control_period
    whole = round(max(1, math.ceil(seconds / period - 1e-9)) * period, 9)
    return replace(run, environment=run.environment.model_copy(update={"episode_s": whole}))


def _draw_panel(
    axis: Axes, rows: Sequence[Mapping[str, Any]], curves: Mapping[str, tuple[Array, Array]]
) -> None:
    for place, row in enumerate(rows):
        quantity, _, where = str(row["name"]).partition(".")
        name = label(where or quantity)
        axis.plot(*curves[row["name"]], color=cycled(place).colour, linewidth=0.7, label=name)


def _check_size(run: Run, signals: Sequence[HistorySignal], *, episode: bool) -> None:
    """Refuse a history that would fill the memory."""
    settings = run.scenario.assessment
    time = run.environment.episode_s
    if not episode:
        period = run.policy.environment(run.environment)
        time = assessed_steps(period, run.scenario, run.speed) * period.control_period
    samples = (time + settings.run_in / run.speed) * settings.sample_rate
    if samples * len(signals) > MOST_NUMBERS:
        raise ConfigError(
            f"{len(signals)} signals of {samples:,.0f} samples are {samples * len(signals):,.0f} numbers; at "
            f"most {MOST_NUMBERS:,} are allowed: choose fewer with --signals or less time with --seconds"
        )


def _statistics(found: History) -> Iterator[dict[str, Any]]:
    """Rows by `COLUMNS`; of a run that did not reach step 0 over its run-in."""
    behind = found.time > 0.0
    part = behind if behind.any() else ~behind
    for signal, values in zip(found.signals, found.values, strict=True):
        these = values[part]
        yield {
            "name": signal.name,
            "unit": signal.unit,
            "minimum": float(these.min()),
            "maximum": float(these.max()),
            "mean": float(these.mean()),
            "rms": float(np.sqrt(np.mean(these**2))),
        }


def _shown(unit: str) -> str:
    """A unit as pictures and words have it; files keep to ASCII."""
    return unit.replace("s2", "s²")


def _panels(rows: Sequence[Mapping[str, Any]]) -> Iterator[list[Mapping[str, Any]]]:
    """Signals of one unit and of one bogie or kind of body, few at a time."""

    def kind(row: Mapping[str, Any]) -> tuple[str, str]:
        return str(row["unit"]), f"{row['name']}.".split(".")[1]

    for _, group in groupby(sorted(rows, key=kind), kind):
        part = list(group)
        for first in range(0, len(part), MOST_CURVES):
            yield part[first : first + MOST_CURVES]
