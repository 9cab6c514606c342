"""Which gains make a classical controller as good as it can be? Opponents for learned policies."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.control import load_controller
from sayd_env.config.loader import packaged_names
from sayd_env.config.palette import policy_style
from sayd_env.config.software import git_state
from sayd_env.config.tuning import Gains, TuningConfig, TuningScenario
from sayd_env.config.units import Array
from sayd_env.report.columns import Column, Table, print_table
from sayd_env.report.figures import Plot, label, legend_below, log_axis, panels
from sayd_env.runs.cache import fingerprint
from sayd_env.runs.context import RunContext
from sayd_env.runs.evaluator import Costs, PolicyEvaluator
from sayd_env.runs.policies import PolicySpec, policy_spec
from sayd_env.studies.tuning.search import best_of, draw_costs, minimise, provenance_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

REFERENCE = "reference"
COMMENT_COLUMN = 28
"""Where the comments of a file of parameters stand."""


@dataclass(frozen=True)
class Evaluation:
    """A policy on all scenarios."""

    policy: str
    stage: str
    """What asked for it: ``reference``, ``search`` or ``polish``."""
    gains: Gains
    """What was tuned; empty for a reference."""
    costs: tuple[float, ...]
    """J of each scenario, with the charge for a derailment."""
    derailed: int
    """Scenarios that ended early."""

    @property
    def cost(self) -> float:
        """Mean of J."""
        return float(np.mean(self.costs))


@dataclass(frozen=True)
class TuneResult:
    """All evaluations, in the order in which they were asked for, and the file that they make."""

    controller: str
    settings: TuningConfig
    name: str
    """The list of scenarios: a packaged name or a path."""
    command: str
    commit: str | None
    evaluations: list[Evaluation]

    @property
    def title(self) -> str:
        """Name of the tuned controller."""
        return f"{self.controller}-tuned"

    @property
    def references(self) -> dict[str, Evaluation]:
        """Policies as they are, by name; the controller itself is among them."""
        return {e.policy: e for e in self.evaluations if e.stage == REFERENCE}

    @property
    def shown(self) -> dict[str, Evaluation]:
        """The references, then the tuned controller."""
        return self.references | {self.title: self.best}

    @property
    def tried(self) -> list[Evaluation]:
        """Sets of gains."""
        return [e for e in self.evaluations if e.stage != REFERENCE]

    @property
    def best(self) -> Evaluation:
        """The gains with the lowest mean J."""
        return best_of(self.tried)

    @property
    def before(self) -> Evaluation:
        """The controller with its own gains."""
        return self.references[self.controller]

    def as_dict(self) -> dict[str, Any]:
        """Gains, mean J before and after and of the references, and J of each scenario."""
        return {
            "controller": self.controller,
            "gains": self.best.gains,
            "J_before": self.before.cost,
            "J_after": self.best.cost,
            "J": {name: e.cost for name, e in self.shown.items()},
            "J_by_scenario": {name: e.costs for name, e in self.shown.items()},
            "derailed": {name: e.derailed for name, e in self.shown.items()},
            "scenarios": self.settings.scenarios,
            "evaluations": len(self.tried),
        }

    def tables(self) -> dict[str, Table]:
        """J by scenario and policy, the tuned controller last; the evaluations."""
        rows = [
            [*case.model_dump().values(), *(e.costs[i] for e in self.shown.values())]
            for i, case in enumerate(self.settings.scenarios)
        ]
        gains = list(self.best.gains)
        costs = [f"J_{case.seed}" for case in self.settings.scenarios]
        tried = [
            [e.policy, e.stage, *map(e.gains.get, gains), e.cost, e.derailed, *e.costs]
            for e in self.evaluations
        ]
        return {
            "scenarios": ((*TuningScenario.model_fields, *self.shown), rows),
            "evaluations": (("policy", "stage", *gains, "J", "derailed", *costs), tried),
        }

    def plots(self) -> dict[str, Plot]:
        """The search, and J over speed before and after."""
        return {"tune": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the gains, and mean J beside that of the references."""
        own = load_controller(self.controller)
        rows = [
            {"gain": name, "before": getattr(own, name), "tuned": self.best.gains[name], "range": gain.text}
            for name, gain in self.settings.of(self.controller).gains.items()
        ]
        print_table(console, f"{self.title}: {len(self.tried)} evaluations", GAINS, rows, wide=wide)
        costs = [
            {"policy": name, "J": e.cost, "change": e.cost / self.before.cost - 1.0}
            | {"better": int(np.less(e.costs, self.before.costs).sum()), "derailed": e.derailed}
            for name, e in self.shown.items()
        ]
        title = f"mean J of {len(self.settings.scenarios)} scenarios"
        print_table(console, title, COSTS, costs, wide=wide)

    def control_file(self) -> str:
        """Text of a file of parameters: the controller's own, with the tuned gains in their places."""
        ranges = self.settings.of(self.controller).gains
        own = load_controller(self.controller)
        seeds = [case.seed for case in self.settings.scenarios]
        about = {
            "command": self.command,
            "scenarios": f"{len(seeds)} of {self.name}, {self.settings.episode_s:g} s, "
            f"seeds {min(seeds)} to {max(seeds)}",
            "evaluations": len(self.tried),
            "J_before": f"{self.before.cost:.6g}",
            "J_after": f"{self.best.cost:.6g}",
            "commit": self.commit or "null",
        }
        lines = [HEAD.format(controller=self.controller)]
        for name, info in type(own).model_fields.items():
            if name == "provenance":
                continue
            extra = info.json_schema_extra
            unit = extra.get("unit") if isinstance(extra, dict) else None
            value: Any = self.best.gains.get(name, getattr(own, name))
            tag = f"calibrated: from {ranges[name].text}" if name in ranges else f"as {self.controller}"
            text = f"{name}: {'null' if value is None else value}"
            lines.append(f"{text:<{COMMENT_COLUMN - 1}} # {f'{unit}; ' if unit else ''}{tag}")
        return "\n".join([*lines, *provenance_lines(about)]) + "\n"

    def _draw(self, figure: Figure) -> None:
        left, right = panels(figure, 2, 2, (5.0, 4.2))
        self._draw_search(left)
        speeds = [case.speed_kmh for case in self.settings.scenarios]
        for e, name in ((self.before, self.controller), (self.best, self.title)):
            style = policy_style(name)
            # No lines: two scenarios of neighbouring speeds have other wear and friction.
            right.plot(speeds, e.costs, style.marker, color=style.colour, markersize=4, label=label(name))
        right.set(xlabel="speed (km/h)", ylabel="J of a scenario")
        log_axis(right)
        legend_below(figure, left, right)

    def _draw_search(self, axes: Axes) -> None:
        names = list(self.best.gains)
        if len(names) == 1:
            places = [e.gains[names[0]] for e in self.tried]
            axes.plot(places, [e.cost for e in self.tried], "o", markersize=4)
            axes.set_xlabel(names[0])
        else:
            draw_costs(axes, self.tried)
        for name, e in self.references.items():
            if e.cost < 2.0 * self.before.cost:
                axes.axhline(e.cost, linewidth=1.0, label=label(name), **policy_style(name).plain)
        axes.set(ylabel="mean J", title=self.title)
        log_axis(axes)


HEAD = """\
# The controller {controller} with the gains of the smallest mean J, by `sayd tune`.
# Tags: calibrated = found so, in the named range; the rest is as in {controller}.yaml.
"""
GAINS = tuple(Column(name, name) for name in ("gain", "before", "tuned", "range"))
COSTS = (
    Column("policy", "policy"),
    Column("J", "J", digits=5, best=True),
    Column("change", "to before", "%", 100.0, 1),
    Column("better", "scenarios better"),
    Column("derailed", "derailed", limit=0),
)
"""Of the printed tables."""


def tune(
    controller: str,
    settings: TuningConfig,
    *,
    name: str = "tuning",
    seed: int = 0,
    command: str = "",
    context: RunContext | None = None,
) -> TuneResult:
    """Find the gains of a controller with the smallest mean J over a list of scenarios.

    `name` is what the scenarios are called in the controller's file, `seed` that of the global search (not of
    the scenarios), `command` how to repeat it. The context's cache keeps evaluations, its executor gives the
    number of threads.

    Raises
    ------
    ConfigError
        An unknown controller or reference, conditions that are not allowed.
    StudyError
        A run that diverged.
    """
    tuning = settings.of(controller)
    commit, _ = git_state()  # of the software that runs, not of its end
    asked = [policy_spec(reference) for reference in dict.fromkeys((*settings.references, controller))]
    total = len(asked) + tuning.search + tuning.polish
    run = _Tuning(controller, settings, total, context or RunContext())
    for spec in asked:
        run.evaluate(spec, REFERENCE, {})
    own = load_controller(controller).model_dump()
    own |= {k: settings.initial_current for k in ("initial",) if k in own and own[k] is None}
    minimise(tuning, own, run.cost_at, seed)
    command = command or f"sayd tune {controller}"
    return TuneResult(controller, settings, name, command, commit, run.evaluations)


class _Tuning:
    """A tuning under way."""

    def __init__(self, controller: str, settings: TuningConfig, total: int, context: RunContext) -> None:
        self.evaluations: list[Evaluation] = []
        self._controller, self._settings, self._context = controller, settings, context
        self._evaluator = PolicyEvaluator(
            settings.environment,
            [case.model_dump() for case in settings.scenarios],
            episode_s=settings.episode_s,
            reward=settings.reward,
            initial_current=settings.initial_current,
            executor=context.executor,
            kept=context.kept,
        )
        self._asked, self._total = 0, total
        self._seen: dict[tuple[float, ...], Evaluation] = {}

    def cost_at(self, stage: str, place: Array) -> float:
        """Mean J of the controller at a place of the ranges."""
        gains = self._settings.of(self._controller).values(place, self._settings.digits)
        key = tuple(gains.values())
        if key in self._seen:  # a place that rounds to the same gains
            self._tell(stage)
        else:
            spec = PolicySpec(self._controller, gains, f"{self._controller}-tuned")
            self._seen[key] = self.evaluate(spec, stage, gains)
        return self._seen[key].cost

    def evaluate(self, spec: PolicySpec, stage: str, gains: Gains) -> Evaluation:
        """Evaluate a policy, unless it is in the cache."""
        key = fingerprint(*self._evaluator.inputs(spec))
        found = self._context.cache.get(key, Costs)
        if found is None:
            found = self._evaluator.costs(spec)
            self._context.cache.put(key, found)
        evaluation = Evaluation(spec.title, stage, gains, tuple(map(float, found.costs)), found.derailed)
        self.evaluations.append(evaluation)
        self._tell(stage)
        return evaluation

    def _tell(self, stage: str) -> None:
        self._asked += 1
        tried = [e for e in self.evaluations if e.stage != REFERENCE]
        best = f", best J {best_of(tried).cost:.5f}" if tried else ""
        self._context.progress(min(self._asked, self._total), self._total, f"{stage}{best}")


def refuse_packaged(file: Path) -> None:
    """Refuse to write into the packaged files of parameters.

    Raises
    ------
    ConfigError
        The file is one of these, or would become one.
    """
    folder = resources.files("sayd_env.configs").joinpath("control")
    if Path(str(folder)).resolve() == file.resolve().parent:
        known = ", ".join(packaged_names("control"))
        raise ConfigError(f"{file}: lies among the packaged files ({known}); take another -o")
