"""What is adaptation worth along lines? The best command of each section, single ones, controllers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.conditions import Line
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.hindsight import HindsightConfig
from sayd_env.config.palette import BLACK, policy_style
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.units import KMH, Array
from sayd_env.envs.draw import draw_episode
from sayd_env.physics.throttle import overlap
from sayd_env.report.columns import PERCENT, Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, ratio_rows
from sayd_env.report.html import Grid, Page, Picture, Section, Verdict
from sayd_env.runs.along import LineRecord, Trip, along_lines, line_runs, resolved
from sayd_env.runs.context import RunContext
from sayd_env.runs.policies import PolicySpec, constant_spec, for_policy
from sayd_env.runs.schedule import schedule_spec
from sayd_env.studies.adaptation import CLOSED, halfway, spread_out

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

HINDSIGHT = "best by section"
"""The best constant command of each section, changed where the next one begins."""
SINGLE = "best for the line"
"""The best constant command of each line."""
FOR_ALL = "best for all lines"
"""The one constant command with the lowest geometric mean of J over the lines."""
_PICTURE_WORDS = "Points: lines; bar: geometric mean over the lines."


class Gap(NamedTuple):
    """What a rule costs beside the best command of each section."""

    rule: str
    gap: float
    """Geometric mean over the lines of J over that of the best commands by section, less 1."""
    worst: float
    """Largest of these ratios, less 1."""
    by_section: float
    """The same over all sections of all lines, where bad sections count no more than good ones."""
    derailed: int
    """Runs that ended early."""


@dataclass(frozen=True)
class OnLine:
    """What is known of one line."""

    name: str
    sections: tuple[str, ...]
    time: Array
    """(s,) of each section, s."""
    constants: Mapping[float, Array]
    """(s,) J of each section by command, means over the tracks."""
    chosen: tuple[float, ...]
    """Best command of each section."""
    J: Mapping[str, Array]
    """(s,) J of each section by rule or policy, means over the tracks."""
    derailed: Mapping[str, int]
    """Runs that ended early by rule or policy."""

    @property
    def costs(self) -> dict[str, float]:
        """J of the whole line by rule or policy."""
        return {rule: _whole(values, self.time) for rule, values in self.J.items()}

    @property
    def single(self) -> float:
        """Best command of the whole line."""
        return min(self.constants, key=lambda current: _whole(self.constants[current], self.time))

    @property
    def composed(self) -> float:
        """J of the line from each section's lowest J: what the schedule would cost if nothing lasted."""
        return _whole(np.min(list(self.constants.values()), axis=0), self.time)


@dataclass(frozen=True)
class HindsightResult:
    """J of commands, schedules and controllers on lines."""

    lines: tuple[OnLine, ...]
    current: float
    """Best single command for all lines."""
    policies: tuple[str, ...]

    @property
    def rules(self) -> tuple[str, ...]:
        """What is compared."""
        return (HINDSIGHT, SINGLE, FOR_ALL, *self.policies)

    def gaps(self) -> list[Gap]:
        """What each rule costs beside the best command of each section."""
        found = []
        for rule in self.rules:
            ratios = [line.costs[rule] / line.costs[HINDSIGHT] for line in self.lines]
            sections = np.concatenate([line.J[rule] / line.J[HINDSIGHT] for line in self.lines])
            derailed = sum(line.derailed[rule] for line in self.lines)
            found.append(Gap(rule, _mean_ratio(ratios), max(ratios) - 1.0, _mean_ratio(sections), derailed))
        return found

    @property
    def notes(self) -> list[str]:
        """On which lines the schedule, found section by section, is not the best of the commands."""
        names = [line.name for line in self.lines if line.costs[SINGLE] < line.costs[HINDSIGHT]]
        if not names:
            return []
        why = "what a section leaves to the next one counts more than its own best command"
        return [f"{', '.join(names)}: one command costs less than the best by section: {why}."]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd hindsight --json``."""
        return {
            "gaps": [gap._asdict() for gap in self.gaps()],
            "best_for_all": self.current,
            "lines": [
                {
                    "line": line.name,
                    "J": line.costs,
                    "J_composed": line.composed,
                    "best": line.single,
                    "sections": [
                        {"section": name, "time_s": line.time[k], "best": line.chosen[k]}
                        | {"J": {rule: values[k] for rule, values in line.J.items()}}
                        for k, name in enumerate(line.sections)
                    ],
                }
                for line in self.lines
            ],
        }

    def tables(self) -> dict[str, Table]:
        """Gaps; J by line and rule; J by line, section and command."""
        by_line = [
            {"line": line.name, "rule": rule, "J": line.costs[rule], "derailed": line.derailed[rule]}
            for line in self.lines
            for rule in self.rules
        ]
        by_section = [
            {
                "line": line.name,
                "section": name,
                "time_s": line.time[k],
                "current": current,
                "J": costs[k],
                "best": current == line.chosen[k],
            }
            for line in self.lines
            for k, name in enumerate(line.sections)
            for current, costs in sorted(line.constants.items())
        ]
        return {
            "gaps": csv_table([Column(name) for name in Gap._fields], self.gaps()),
            "lines": csv_table([Column(name) for name in by_line[0]], by_line),
            "sections": csv_table([Column(name) for name in by_section[0]], by_section),
        }

    def plots(self) -> dict[str, Plot]:
        """J of each rule over that of the best commands by section, line by line."""
        return {"hindsight": partial(self._draw)}

    def page(self) -> Page:
        """What adaptation is worth, by rule and by line."""
        gaps = self.gaps()
        words = [
            f"{gap.rule}: {100.0 * gap.gap:.0f} % more than the best command of each section"
            f" (geometric mean of {len(self.lines)} lines, at most {100.0 * gap.worst:.0f} %)."
            for gap in gaps
            if gap.rule != HINDSIGHT
        ] + self.notes
        picture = Picture(
            "hindsight", "J of each rule over that of the best commands by section", [_PICTURE_WORDS]
        )
        tables = [Grid.of(each, lambda _: "hindsight") for each in self._listings()]
        sections = [Section("Lines", [picture]), Section("In numbers", tables)]
        return Page("What adaptation is worth along lines", Verdict(words), sections)

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the gaps, J by line, and the best commands."""
        for listing in self._listings():
            listing.print(console, wide)
        for note in self.notes:
            console.print(note)

    def _listings(self) -> Iterator[Listing]:
        columns = (
            Column("rule", "commands"),
            Column("gap", "costs more", **PERCENT),
            Column("worst", "at most", **PERCENT),
            Column("by_section", "section by section", **PERCENT),
            Column("derailed", "derailed", limit=0.0),
        )
        title = f"J over that of the best commands by section: geometric mean of {len(self.lines)} lines"
        yield Listing(title, columns, self.gaps())
        of_line = [Column(f"J_{k}", line.name, digits=4, best=True) for k, line in enumerate(self.lines)]
        rows = [
            {"rule": rule} | {f"J_{k}": line.costs[rule] for k, line in enumerate(self.lines)}
            for rule in self.rules
        ]
        yield Listing("J", [Column("rule", "commands"), *of_line], rows)
        best = [
            {
                "line": line.name,
                "single": line.single,
                "sections": ", ".join(f"{current:.2f}" for current in line.chosen),
                "composed": line.composed,
            }
            for line in self.lines
        ]
        names = (
            Column("line", "line"),
            Column("single", "best", digits=2),
            Column("sections", "best by section"),
            Column("composed", "J, composed", digits=4, wide=True),
        )
        yield Listing(f"best constant commands; for all lines {self.current:.2f}", names, best)

    def _draw(self, figure: Figure) -> None:
        ratios = {
            rule: [line.costs[rule] / line.costs[HINDSIGHT] for line in self.lines] for rule in self.rules[1:]
        }
        colours = {rule: policy_style(rule).colour if rule in self.policies else BLACK for rule in ratios}
        about = "J over that of the best commands by section; points: lines, bar: geometric mean"
        ratio_rows(figure, ratios, colours, about)


def hindsight(
    config: HindsightConfig, policies: Sequence[PolicySpec], *, context: RunContext | None = None
) -> HindsightResult:
    """Find what adaptation is worth along lines.

    Constant commands on a grid run over each line; the best one of each section, of each line and of all
    lines is looked for, with steps halved around them. The best ones by section are then really run.

    Parameters
    ----------
    policies : sequence of PolicySpec
        Controllers that are compared.

    Raises
    ------
    ConfigError
        A line that cannot be, a policy that does not fit.
    StudyError
        A run that diverged.
    """
    study = _Study(config, context or RunContext())
    found = study.constants()
    commands = set.intersection(*(set(each) for each in found.values()))
    single = min(sorted(commands), key=study.mean_log)
    specs = {each.title: each for each in policies}
    lines = []
    for name in found:
        chosen = study.chosen(name)
        ends = np.cumsum(study.time(name)).tolist()
        schedule = schedule_spec(chosen, ends, HINDSIGHT)
        records = study.run(name, [schedule, *policies])
        costs = {each: study.mean(name, of) for each, of in records.items()}
        derailed = {each: _ended_early(of) for each, of in records.items()}
        best = min(found[name], key=lambda current, name=name: study.cost(name, current))  # type: ignore[misc]
        costs |= {SINGLE: found[name][best], FOR_ALL: found[name][single]}
        derailed |= {SINGLE: study.derailed(name, best), FOR_ALL: study.derailed(name, single)}
        sections = tuple(section.name for section in study.lines[name].sections)
        lines.append(OnLine(name, sections, study.time(name), found[name], tuple(chosen), costs, derailed))
    return HindsightResult(tuple(lines), single, tuple(specs))


class _Study:
    """Runs along the lines: each once, whoever asks for it."""

    def __init__(self, config: HindsightConfig, context: RunContext) -> None:
        self._config, self._context, self._rounds = config, context, 0
        self._environment = load_environment(config.environment)
        self._scenario = load_scenario(config.study)
        self.lines = dict(_lines(config, self._scenario))
        fitted = for_policy(self._scenario, constant_spec(CLOSED))
        assert isinstance(fitted.damper, SaydDamperConfig)  # `for_policy` sees to it
        self._closed = overlap(fitted.damper.throttle)
        self._records: dict[str, dict[float, list[LineRecord]]] = {name: {} for name in self.lines}

    def constants(self) -> dict[str, dict[float, Array]]:
        """J of the sections of each line by constant command: a grid, and more around its best ones."""
        grid = spread_out(self._config.openings, self._closed)
        self._try({name: grid for name in self.lines})
        for _ in range(self._config.refinements):
            shared = sorted(set.intersection(*(set(each) for each in self._records.values())))
            for_all = halfway(min(shared, key=self.mean_log), shared, self._closed)
            self._try(
                {
                    name: {*for_all, *self._halfway(name, [min(of, key=lambda c, n=name: self.cost(n, c))])}  # type: ignore[misc]
                    | self._halfway(name, self.chosen(name))
                    for name, of in self._records.items()
                }
            )
        return {
            name: {current: self._by_section(name, current) for current in of}
            for name, of in self._records.items()
        }

    def chosen(self, name: str) -> list[float]:
        """Best command of each section."""
        return best_by_section({current: self._by_section(name, current) for current in self._records[name]})

    def cost(self, name: str, current: float) -> float:
        """J of a constant command on a line."""
        return _whole(self._by_section(name, current), self.time(name))

    def derailed(self, name: str, current: float) -> int:
        """Runs of a constant command on a line that ended early."""
        return _ended_early(self._records[name][current])

    def mean_log(self, current: float) -> float:
        """Mean over the lines of the logarithm of J of a constant command."""
        return float(np.mean([math.log(self.cost(name, current)) for name in self.lines]))

    def time(self, name: str) -> Array:
        """Time in each section (s)."""
        return next(iter(self._records[name].values()))[0].time

    def mean(self, name: str, records: Sequence[LineRecord]) -> Array:
        """J of each section, mean over the tracks."""
        environment = self._along(name)
        return np.asarray(np.mean([each.cost(environment, self._scenario.cost) for each in records], axis=0))

    def run(self, name: str, policies: Sequence[PolicySpec]) -> dict[str, list[LineRecord]]:
        """Runs of policies on a line by title."""
        return self._run([(name, policy) for policy in policies])[name]

    def _halfway(self, name: str, currents: Iterable[float]) -> set[float]:
        tried = self._records[name]
        return {new for current in currents for new in halfway(current, tried, self._closed)}

    def _by_section(self, name: str, current: float) -> Array:
        return self.mean(name, self._records[name][current])

    def _along(self, name: str) -> EnvironmentConfig:
        trip = Trip(self.lines[name], self._config.speed_kmh / KMH)
        return self._environment.model_copy(update={"episode_s": float(trip.seconds)})

    def _try(self, commands: Mapping[str, Iterable[float]]) -> None:
        """Run constant commands that have not been run before."""
        new = [
            (name, current)
            for name, currents in commands.items()
            for current in sorted(currents)
            if current not in self._records[name]
        ]
        specs = {current: constant_spec(current) for _, current in new}
        found = self._run([(name, specs[current]) for name, current in new])
        for name, current in new:
            self._records[name][current] = found[name][specs[current].title]

    def _run(self, which: Sequence[tuple[str, PolicySpec]]) -> dict[str, dict[str, list[LineRecord]]]:
        """Runs of policies on lines, on all tracks."""
        speed, seeds = self._config.speed_kmh / KMH, self._config.seeds
        runs = [
            run
            for name, policy in which
            for run in line_runs(
                [policy], self._scenario, self.lines[name], [speed], seeds, self._environment
            )
        ]
        self._rounds += 1
        what = f"along lines, round {self._rounds}"
        records = iter(self._context.records(along_lines, runs, LineRecord, what))
        found: dict[str, dict[str, list[LineRecord]]] = {}
        for name, policy in which:
            found.setdefault(name, {})[policy.title] = [next(records) for _ in seeds]
        return found


def _lines(config: HindsightConfig, scenario: Scenario) -> Iterable[tuple[str, Line]]:
    """The lines by name."""
    for name in config.lines:
        yield name, resolved(name, scenario, config.speed_kmh / KMH)
    environment = load_environment(config.drawn.environment)
    if config.drawn.seeds and environment.lines is None:
        raise ConfigError(f"drawn.environment: '{config.drawn.environment}' draws no lines")
    for seed in config.drawn.seeds:
        line = draw_episode(environment, seed, 0).line
        assert isinstance(line, Line)  # it has been drawn
        yield f"drawn {seed}", line


def _ended_early(records: Iterable[LineRecord]) -> int:
    """How many runs ended before the line."""
    return sum(each.ending is not None for each in records)


def best_by_section(costs: Mapping[float, Array]) -> list[float]:
    """Command with the lowest J in each section, of the J of the sections by command, each of shape (s,)."""
    currents = sorted(costs)
    return [currents[k] for k in np.argmin([costs[current] for current in currents], axis=0)]


def _mean_ratio(ratios: Sequence[float] | Array) -> float:
    """Geometric mean of ratios, less 1."""
    return math.expm1(float(np.mean(np.log(ratios))))


def _whole(costs: Array, time: Array) -> float:
    """J of a line from those of its sections."""
    return float(np.dot(np.where(time > 0.0, costs, 0.0), time) / time.sum())
