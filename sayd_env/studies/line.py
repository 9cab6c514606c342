"""How do policies run a vehicle along a line? Cost, limits and wheel loads by section, side by side."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.conditions import CANT_BASE, Line
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.line import LineConfig
from sayd_env.config.palette import BLACK, SHADE, VERMILION, policy_style
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import GRAVITY, KMH, Array
from sayd_env.envs.vehicle import model_limits
from sayd_env.measured.lines import own_line, refuse_said
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import DERAILED, LIMITED, Column, Listing, Table, csv_table, json_rows
from sayd_env.report.figures import Plot, label, legend_below, limit_line, log_axis, panels
from sayd_env.report.html import Grid, Page, Picture, Section
from sayd_env.runs.along import LineRecord, Trip, along_lines, line_runs
from sayd_env.runs.context import RunContext, refuse_empty
from sayd_env.runs.metrics import RATIOS
from sayd_env.runs.policies import PolicySpec, refuse_duplicates
from sayd_env.runs.rollouts import Run, conditions, own_policy
from sayd_env.studies.evaluate import GridPoint
from sayd_env.studies.standing import Standing, verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

WHOLE = "whole line"
"""What tables call all sections together."""
_STEP = 20.0  # m, of what pictures show of a line
_NO_STRAIGHT = (
    "Sliding RMS of acceleration and track shift force were not judged: no section has 500 m of straight "
    "track."
)


PLACE = {"wear": "wear", "friction": "scenario_friction", "speed_kmh": "first_speed_kmh"}
"""What the sections of several places call them: along the way friction and speed are others."""


@dataclass(frozen=True)
class SectionRow:
    """One run on one section, or on the whole line; ratios are to the limits of EN 14363."""

    policy: str
    wear: float
    friction: float
    speed_kmh: float
    """Where the line begins."""
    seed: int
    section: str
    time_s: float
    J: float
    """Mean cost of the bogies, eq. (27), on-line filter, with the charge for a derailment."""
    J_acceleration: float
    """(psi_y / y_lim)^2 of it, unweighted."""
    J_force: float
    """(psi_F / F_max)^2 of it, unweighted."""
    J_curve: float
    """Part of J in the means of the damper forces over whole seconds: what the line itself asks for."""
    acceleration_ratio: float
    """Largest sliding RMS of the section's straight part; NaN where it is curved or shorter than 500 m."""
    track_shift_ratio: float
    """The same of the track shift force."""
    quotient_ratio: float
    """Largest Y/Q, mean over 2 m, over its limit for safety."""
    mean_shift_ratio: float
    """Largest track shift force, mean over 2 m, over Prud'homme's limit."""
    unloading: float
    """Largest share of its static load that a wheel has lost, mean over 2 m."""
    derailed: float
    """1 where the run ended early in this section or before, else 0."""


_RATIOS = (*RATIOS, "quotient_ratio", "mean_shift_ratio")
VALUES = ("J", "J_acceleration", "J_force", "J_curve", *_RATIOS, "unloading")
_PICTURE_WORDS = (
    "Above: speed, curve and cant, gauge and friction along the line, the value of a dashed line on the "
    "right. Below: command, J and sliding values over their limits, one line for each policy, on the first "
    "track; the acceleration's RMS is that of the on-line filter, which knows no section, while the table "
    "has that by EN 14363. Every second section is shaded."
)
_LIMIT: dict[str, Any] = {"best": True, **LIMITED}
COLUMNS = (
    Column("section", "section"),
    Column("policy", "policy"),
    Column("J", "J", digits=4, best=True),
    Column("J_curve", "of curve", digits=4, best=True),
    Column("J_acceleration", "acceleration", digits=4, best=True, wide=True),
    Column("J_force", "force", digits=4, best=True, wide=True),
    Column("acceleration_ratio", "acc. RMS", **_LIMIT),
    Column("track_shift_ratio", "ΣY RMS", **_LIMIT),
    Column("quotient_ratio", "Y/Q", **_LIMIT),
    Column("mean_shift_ratio", "ΣY", **_LIMIT),
    Column("unloading", "ΔQ/Q", digits=2, best=True),
    Column("time_s", "time", "s", digits=1, wide=True),
    Column("derailed", "derailed", limit=0.0, wide=True),
)
SECTIONS = (
    Column("section", "section"),
    Column("from_m", "from", "km", 1e-3, 2),
    Column("to_m", "to", "km", 1e-3, 2),
    Column("speed_kmh", "km/h", digits=0),
    Column("radius_m", "radius", "m", digits=0),
    Column("cant_m", "cant", "mm", 1e3, 0),
    Column("deficiency_m", "deficiency", "mm", 1e3, 0, wide=True),
    Column("gauge_m", "gauge", "mm", 1e3, 0),
    Column("friction", "friction", digits=2),
    Column("rail", "rail", digits=1, wide=True),
    Column("track_scale", "track", digits=2, wide=True),
)
"""What lies along a line, where each section is tightest, or at its end."""


@dataclass(frozen=True)
class LineResult:
    """Runs of policies along a line."""

    name: str
    scenario: Scenario
    runs: tuple[Run, ...]
    records: tuple[LineRecord, ...]
    rows: list[SectionRow] = field(init=False)

    def __post_init__(self) -> None:
        rows = [
            row for run, record in zip(self.runs, self.records, strict=True) for row in _rows(run, record)
        ]
        object.__setattr__(self, "rows", rows)

    @cached_property
    def policies(self) -> tuple[str, ...]:
        """Policies in the order in which they were asked for."""
        return tuple(dict.fromkeys(run.policy.title for run in self.runs))

    @cached_property
    def places(self) -> tuple[GridPoint, ...]:
        """Wear, friction and first speed of the runs."""
        return tuple(sorted({_place(run) for run in self.runs}))

    @cached_property
    def medians(self) -> list[dict[str, Any]]:
        """Medians over the seeds, by place, section and policy."""
        found = []
        for place in self.places:
            of_place = [row for row in self.rows if (row.wear, row.friction, row.speed_kmh) == place]
            for section in dict.fromkeys(row.section for row in of_place):
                for policy in self.policies:
                    chosen = [row for row in of_place if (row.section, row.policy) == (section, policy)]
                    found.append(_median(chosen))
        return found

    def line(self, place: GridPoint) -> Trip:
        """The line as it is at a place of the table."""
        run = next(run for run in self.runs if _place(run) == place)
        assert run.line is not None
        return Trip(run.line, run.speed)

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd evaluate --line --json``."""
        return {
            "line": self.name,
            "rows": [vars(row) for row in self.rows],
            "medians": self.medians,
            "sections": json_rows(self._section_columns, self._all_sections()),
        }

    def tables(self) -> dict[str, Table]:
        """All runs and the medians over the seeds, by section; what lies along the line; runs over time."""
        columns = [Column(name) for name in vars(self.rows[0])]
        medians = [column for column in columns if column.name != "seed"]
        return {
            "runs": csv_table(columns, [vars(row) for row in self.rows]),
            "medians": csv_table(medians, self.medians),
            "sections": csv_table(self._section_columns, self._all_sections()),
            "seconds": self._seconds(),
        }

    def plots(self) -> dict[str, Plot]:
        """What lies along the line and what policies make of it, over distance: runs of the first seed."""
        return {self._figure(place): partial(self._draw, place=place) for place in self.places}

    def page(self) -> Page:
        """Which policy is best, what lies along the line, what policies make of it by section."""
        whole = [row for row in self.medians if row["section"] == WHOLE]
        standings = [
            Standing(
                policy,
                float(np.mean([row["J"] for row in own])),
                max(_most(np.array([row[name] for name in _RATIOS])) for row in own),
                sum(row["derailed"] for row in own),
            )
            for policy in self.policies
            for own in ([row for row in whole if row["policy"] == policy],)
        ]
        parts = []
        for place in self.places:
            name = self._figure(place)
            tables = [Grid.of(each, lambda _, name=name: name) for each in self._listings(place)]  # type: ignore[misc]
            heading = f"Wear {place.wear:g}, friction {place.friction:.3g}, {place.speed_kmh:g} km/h"
            about = (
                f"Line '{self.name}' at wear {place.wear:g}: what lies along it, and what policies make of it"
            )
            parts.append(Section(heading, [Picture(name, about, [_PICTURE_WORDS]), *tables]))
        straight = any(not math.isnan(row["acceleration_ratio"]) for row in whole)
        found = verdict(standings, "the whole line", "" if straight else _NO_STRAIGHT)
        return Page(f"Policies along line '{self.name}'", found, parts)

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print what lies along the line, then policies by section."""
        for place in self.places:
            for listing in self._listings(place):
                listing.print(console, wide)
        for run, record in zip(self.runs, self.records, strict=True):
            if record.ending is not None:
                where = int(np.argmax(record.lost > 0.0))
                assert run.line is not None
                console.print(
                    f"{DERAILED}: {run.policy.title}, seed {run.seed}, section "
                    f"'{run.line.sections[where].name}': {record.ending}",
                    markup=False,
                    style="red",
                )

    def _listings(self, place: GridPoint) -> Iterator[Listing]:
        """What lies along the line, and the policies by section."""
        sections = self._sections(place)
        whole = len(sections) == 1
        shown = [c for c in SECTIONS if whole or c.name in ("section", "to_m") or _varied(sections, c)]
        about = f"line '{self.name}', {self.scenario.vehicle.name}, wear {place.wear:g}"
        yield Listing(about, shown, sections)
        count = len({row.seed for row in self.rows})
        title = (
            "J and its part that the curve needs; ratios to limits: "
            f"medians of {count} track{'s' * (count > 1)}"
        )
        rows = [row for row in self.medians if all(row[k] == v for k, v in place._asdict().items())]
        yield Listing(title, COLUMNS, _named_once(rows), "part")

    def _figure(self, place: GridPoint) -> str:
        return "line" + "".join(f"_{each:g}" for each in place) * (len(self.places) > 1)

    def overview(self) -> tuple[Sequence[Column], list[dict[str, Any]]]:
        """Medians over the seeds on the whole line, as one of many results is shown."""
        whole = [row for row in self.medians if row["section"] == WHOLE]
        return [Column("speed_kmh", "km/h"), *COLUMNS[1:]], whole

    def _sections(self, place: GridPoint) -> list[dict[str, Any]]:
        trip = self.line(place)
        gauge, friction = self.scenario.track.gauge, place.friction
        return [_described(trip, k, gauge, friction) for k in range(len(trip.line.sections))]

    @property
    def _section_columns(self) -> Sequence[Column]:
        """Of the sections of all places: which place, where there are several."""
        several = len(self.places) > 1
        return [*(Column(PLACE[name]) for name in GridPoint._fields if several), *SECTIONS]

    def _all_sections(self) -> list[dict[str, Any]]:
        return [
            {PLACE[name]: value for name, value in place._asdict().items()} | section
            for place in self.places
            for section in self._sections(place)
        ]

    def _seconds(self) -> Table:
        header = ("policy", "wear", "friction", "speed_kmh", "seed", "distance_m", "command_mean")
        values = ("cost_acceleration", "cost_force", "peak_quotient", "peak_track_shift")
        rows = []
        for run, record in zip(self.runs, self.records, strict=True):
            assert run.line is not None
            t = np.arange(len(record.command)) + 0.5
            for k, s in enumerate(Trip(run.line, run.speed).distance(t).tolist()):
                numbers = [float(getattr(record, name)[k]) for name in values]
                mean = float(record.command[k].mean())
                rows.append([run.policy.title, *_place(run), run.seed, s, mean, *numbers])
        return (*header, *values), rows

    def _draw(self, figure: Figure, place: GridPoint) -> None:
        trip = self.line(place)
        figure.suptitle(f"line '{self.name}', {self.scenario.vehicle.name}, wear {place.wear:g}")
        axes = panels(figure, 8, 1, (10.0, 1.7), sharex=True)
        for axis in axes:
            _shade(axis, trip.line)
        _draw_line(axes[:3], trip, self.scenario.track.gauge, place.friction)
        seed = self.runs[0].seed
        for run, record in zip(self.runs, self.records, strict=True):
            if _place(run) == place and run.seed == seed:
                _draw_run(axes[3:], run, record)
        for axis, name in zip(
            axes[3:], ("command (-)", "J", "on-line RMS of\nacceleration", "Y/Q, 2 m", "ΣY, 2 m"), strict=True
        ):
            axis.set_ylabel(name if name in ("command (-)", "J") else f"{name}\nover limit")
        axes[3].set_ylim(-0.05, 1.05)
        log_axis(axes[4])
        for axis in axes[5:]:
            limit_line(axis, 1.0)
            axis.set_ylim(bottom=0.0)
        axes[-1].set_xlabel("distance (km)")
        axes[-1].set_xlim(0.0, 1e-3 * trip.line.length)
        legend_below(figure, axes[4])


def evaluate_line(
    scenario: Scenario,
    line: str | LineConfig | Line,
    speeds: Sequence[float],
    seeds: Sequence[int] = range(10),
    *,
    name: str = "",
    policies: Sequence[PolicySpec] = (),
    wear: Sequence[float] = (),
    friction: Sequence[float] = (),
    environment: EnvironmentConfig | None = None,
    initial_current: float = 0.0,
    context: RunContext | None = None,
) -> LineResult:
    """Run policies over the whole of a line, all of them on the same tracks.

    Parameters
    ----------
    line : str, LineConfig or Line
        A name, a path to a YAML or CSV file, a content, or a line that has been resolved.
    speeds : sequence of float
        m/s; of a line that has speeds of its own at most one, which does not count.
    seeds : sequence of int
        Track seeds.
    name : str
        What the result calls the line; a text by default as it is.
    policies, wear, friction, environment, initial_current, context
        As for `sayd_env.studies.evaluate.evaluate`; wear and friction where the line leaves friction out.

    Raises
    ------
    ConfigError
        A line that cannot be, or one that says the friction itself beside those given; a speed outside the
        vehicle's range, a duplicate policy or one that does not fit; no speed or no seed.
    StudyError
        A run that diverged.
    """
    refuse_empty(speeds=speeds, seeds=seeds)
    if friction and not isinstance(line, Line):
        refuse_said(line, {"friction": "friction"})
    specs, setup = tuple(policies) or (own_policy(scenario),), environment or load_environment()
    refuse_duplicates(specs)
    runs = [
        run
        for chosen in conditions(scenario, wear, friction)
        for run in line_runs(specs, chosen, line, speeds, seeds, setup, initial_current=initial_current)
    ]
    records = (context or RunContext()).records(along_lines, runs, LineRecord)
    called = name or (line if isinstance(line, str) else "line")
    return LineResult(called, scenario, tuple(runs), tuple(records))


def line_speeds(
    line: str | LineConfig, given: Sequence[float] | None, default: Sequence[float]
) -> Sequence[float]:
    """Speeds (m/s) for a line: its own, the given ones, or the default.

    Raises
    ------
    ConfigError
        Speeds are given for a line that has its own; or a line that cannot be.
    DataError
        A measured file that cannot be used.
    """
    own = own_line(line).speed_at(0.0)
    if own is None:
        return given or default
    if given:
        raise ConfigError(f"line '{line}' has speeds of its own: leave out those of the command")
    return [float(own)]


def _place(run: Run) -> GridPoint:
    return GridPoint(run.scenario.wear, run.scenario.friction, round(run.speed * KMH, 6))


def _rows(run: Run, record: LineRecord) -> list[SectionRow]:
    """A run by section, and on the whole line."""
    assert run.line is not None
    bounds, safe = model_limits(VehicleModel(run.scenario)), run.environment.derailment.safe_quotient
    costs = record.cost(run.environment, run.scenario.cost)
    by_section: dict[str, Any] = {
        "time_s": record.time,
        "J": costs,
        "J_acceleration": record.acceleration,
        "J_force": record.force,
        "J_curve": run.scenario.cost.force_weight * record.curve_force,
        "acceleration_ratio": record.acceleration_rms / bounds.acceleration,
        "track_shift_ratio": record.track_shift_rms / bounds.track_shift_force,
        "quotient_ratio": record.quotient / safe,
        # The RMS has half of Prud'homme's limit, which holds for the mean.
        "mean_shift_ratio": record.track_shift / bounds.mean_track_shift,
        "unloading": record.unloading,
        "derailed": (record.lost > 0.0).astype(float),
    }
    whole = {
        name: record.mean(values) if name.startswith("J") else _most(values)
        for name, values in by_section.items()
    } | {"time_s": float(record.time.sum())}
    who: dict[str, Any] = {"policy": run.policy.title, **_place(run)._asdict(), "seed": run.seed}
    each: list[dict[str, Any]] = [
        {"section": section.name} | {name: float(values[k]) for name, values in by_section.items()}
        for k, section in enumerate(run.line.sections)
    ]
    return [SectionRow(**who, **values) for values in (*each, {"section": WHOLE} | whole)]


def _most(values: Array) -> float:
    return float(np.fmax.reduce(values))


def _median(rows: Sequence[SectionRow]) -> dict[str, Any]:
    """Median of the seeds of one section and policy; NaN where there is none."""
    values = {name: float(np.median([getattr(row, name) for row in rows])) for name in ("time_s", *VALUES)}
    derailed = sum(row.derailed for row in rows)
    return vars(rows[0]) | values | {"derailed": int(derailed)}


def _named_once(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of which only the first of each section has its name."""
    found, before = [], None
    for row in rows:
        name = row["section"]
        found.append(row | {"section": "" if name == before else name, "part": name})
        before = name
    return found


def _varied(rows: Sequence[dict[str, Any]], column: Column) -> bool:
    """Whether a column says something: not the same in all of several rows."""
    return len({column.words(column.of(row)) for row in rows}) > 1


def _described(trip: Trip, k: int, gauge: float, friction: float) -> dict[str, Any]:
    """What lies where a section is tightest; where straight, at its end before the next one's changes."""
    line, section = trip.line, trip.line.sections[k]
    s = _tightest(line, section.start, section.end)
    curvature, cant = float(line.curvature.at(s)), float(line.cant.at(s))
    speed = float(trip.speed_at(np.array([s]))[0])
    return {
        "section": section.name,
        "from_m": section.start,
        "to_m": section.end,
        "speed_kmh": speed * KMH,
        "radius_m": 1.0 / curvature if curvature else None,
        "cant_m": abs(cant),
        "deficiency_m": (speed**2 * curvature * CANT_BASE / GRAVITY - cant) * math.copysign(1.0, curvature),
        "gauge_m": gauge if line.gauge is None else float(line.gauge.at(s)),
        "friction": friction if line.friction is None else float(line.friction.at(s)),
        "rail": 0.0 if line.rail_blend is None else float(line.rail_blend.at(s)),
        "track_scale": next((piece.scale for piece in line.tracks if piece.start <= s < piece.end), None),
    }


def _tightest(line: Line, start: float, end: float) -> float:
    """Where the curve of a section from start to end is tightest (m), of several such places the last one.

    Where it begins does not count: that is still the curve before it.
    """
    last, knots = max(start, end - 0.5 * line.blend - 1e-6), np.array(line.curvature.s)
    backwards = np.append(knots[(knots > start) & (knots < last)], last)[::-1]
    return float(backwards[np.argmax(np.abs(line.curvature.at(backwards)))])


def _shade(axis: Axes, line: Line) -> None:
    """Every second section in grey."""
    for section in line.sections[1::2]:
        axis.axvspan(1e-3 * section.start, 1e-3 * section.end, color=SHADE, linewidth=0.0, zorder=0)


def _draw_line(axes: Sequence[Axes], trip: Trip, gauge: float, friction: float) -> None:
    """Speed; curvature and cant; gauge and friction."""
    line = trip.line
    s = np.union1d(np.arange(0.0, line.length, _STEP), line.length)
    km, first, second = 1e-3 * s, BLACK, VERMILION
    axes[0].plot(km, KMH * trip.speed_at(s), color=first)
    axes[0].set_ylabel("speed (km/h)")
    pairs = (
        (
            axes[1],
            "curvature\n(1/km, left +)",
            1e3 * line.curvature.at(s),
            "cant (mm)",
            1e3 * line.cant.at(s),
        ),
        (
            axes[2],
            "gauge (mm)",
            1e3 * (np.full(s.shape, gauge) if line.gauge is None else line.gauge.at(s)),
            "friction (-)",
            np.full(s.shape, friction) if line.friction is None else line.friction.at(s),
        ),
    )
    for axis, name, values, other_name, others in pairs:
        axis.plot(km, values, color=first)
        axis.set_ylabel(name)
        twin = axis.twinx()
        twin.plot(km, others, color=second, linestyle="--")
        twin.set_ylabel(other_name, color=second)
        low, high = twin.get_ylim()
        twin.set_ylim(low - 0.1 * (high - low), high + 0.5 * (high - low))  # apart where both change alike
    top = axes[0].get_ylim()[1]
    for section in line.sections:
        axes[0].text(
            0.5e-3 * (section.start + section.end),
            top,
            label(section.name),
            ha="center",
            va="bottom",
            fontsize="small",
            clip_on=False,
        )


def _draw_run(axes: Sequence[Axes], run: Run, record: LineRecord) -> None:
    """Command, J and sliding RMS values over their limits of one run."""
    assert run.line is not None
    bounds, cost = model_limits(VehicleModel(run.scenario)), run.scenario.cost
    km = 1e-3 * Trip(run.line, run.speed).distance(np.arange(len(record.command)) + 0.5)
    style = policy_style(run.policy.title).plain
    style["linewidth"], name = 1.0, label(run.policy.title)
    J = cost.acceleration_weight * record.cost_acceleration + cost.force_weight * record.cost_force
    safe = run.environment.derailment.safe_quotient
    if run.scenario.damper.type != "passive":
        axes[0].plot(km, record.command.mean(axis=1), **style)
    axes[1].plot(km, J, label=name, **style)
    axes[2].plot(1e-3 * record.position, record.sliding_rms_acceleration / bounds.acceleration, **style)
    axes[3].plot(km, record.peak_quotient / safe, **style)
    axes[4].plot(km, record.peak_track_shift / bounds.mean_track_shift, **style)
