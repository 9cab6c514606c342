"""Which gains make a classical controller as good as it can be? Opponents for learned policies."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.agents.config import load_train
from sayd_env.config import ConfigError
from sayd_env.config.control import gains_of, load_controller
from sayd_env.config.loader import packaged_names
from sayd_env.config.palette import policy_style
from sayd_env.config.software import git_state
from sayd_env.config.tuning import Gains, TuningConfig, TuningScenario
from sayd_env.config.units import Array
from sayd_env.envs.cost import mean_cost
from sayd_env.report.columns import Column, Listing, Table
from sayd_env.report.figures import Plot, label, legend_below, log_axis, panels
from sayd_env.runs.cache import fingerprint
from sayd_env.runs.context import RunContext
from sayd_env.runs.evaluator import PolicyCosts, PolicyEvaluator
from sayd_env.runs.policies import PolicySpec, policy_spec
from sayd_env.studies.tuning.search import best_of, draw_costs, minimise, provenance_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pydantic.fields import FieldInfo
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
    """J of each scenario and line, with the charge for a derailment."""
    derailed: int
    """Runs that ended early."""
    cost: float
    """The mean of J that is to be small."""

    @property
    def mean(self) -> float:
        """Arithmetic mean of J."""
        return mean_cost(self.costs, "arithmetic")


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

    @property
    def simulated(self) -> float:
        """Time that all sets of gains have been simulated, s."""
        return len(self.tried) * self.settings.seconds

    def as_dict(self) -> dict[str, Any]:
        """Gains, mean J before and after and of the references, J of each scenario and line, budget."""
        return {
            "controller": self.controller,
            "gains": self.best.gains,
            "J_before": self.before.cost,
            "J_after": self.best.cost,
            "mean": self.settings.mean,
            "J": {name: e.cost for name, e in self.shown.items()},
            "J_arithmetic": {name: e.mean for name, e in self.shown.items()},
            "J_by_scenario": {name: e.costs for name, e in self.shown.items()},
            "derailed": {name: e.derailed for name, e in self.shown.items()},
            "scenarios": self.settings.scenarios,
            "lines": self.settings.lines,
            "evaluations": len(self.tried),
            "simulated_s": self.simulated,
            "ppo_training_s": training_seconds(),
        }

    def tables(self) -> dict[str, Table]:
        """J by scenario and policy, the tuned controller last; the evaluations."""
        fields = [name for name in TuningScenario.model_fields if name != "seed"]
        about = [[None, *(getattr(c, name) for name in fields), c.seed] for c in self.settings.scenarios]
        if (lines := self.settings.lines) is not None:
            about += [[lines.environment, *(None for _ in fields), seed] for seed in lines.seeds]
        rows = [[*each, *(e.costs[i] for e in self.shown.values())] for i, each in enumerate(about)]
        gains = list(self.best.gains)
        costs = [f"J_{each[-1]}" for each in about]
        tried = [
            [e.policy, e.stage, *map(e.gains.get, gains), e.cost, e.derailed, *e.costs]
            for e in self.evaluations
        ]
        return {
            "scenarios": (("line", *fields, "seed", *self.shown), rows),
            "evaluations": (("policy", "stage", *gains, "J", "derailed", *costs), tried),
        }

    def plots(self) -> dict[str, Plot]:
        """The search, and J over speed before and after."""
        return {"tune": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the gains, and mean J beside that of the references."""
        own = gains_of(load_controller(self.controller))
        rows = [
            {"gain": name, "before": own[name], "tuned": self.best.gains[name], "range": gain.text}
            for name, gain in self.settings.of(self.controller).gains.items()
        ]
        Listing(f"{self.title}: {len(self.tried)} evaluations", GAINS, rows).print(console, wide)
        costs = [
            {"policy": name, "J": e.cost, "mean": e.mean, "change": e.cost / self.before.cost - 1.0}
            | {"better": int(np.less(e.costs, self.before.costs).sum()), "derailed": e.derailed}
            for name, e in self.shown.items()
        ]
        lines = self.settings.lines
        along = "" if lines is None else f" and {len(lines.seeds)} lines"
        judged_on = f"{len(self.settings.scenarios)} scenarios{along}"
        title = f"J of {judged_on}: {self.settings.mean} mean, and plain mean"
        Listing(title, COSTS, costs).print(console, wide)
        if self.best.cost >= self.before.cost:
            console.print(f"no better than before: '{self.controller}' as it is has the lower J")
        console.print(
            f"simulated: {self.simulated:,.0f} s; one PPO training: {training_seconds():,.0f} s",
            highlight=False,
        )

    def control_file(self) -> str:
        """Text of a file of parameters: the controller's own, with the tuned gains in their places."""
        ranges = self.settings.of(self.controller).gains
        own = load_controller(self.controller)
        tuned = load_controller(self.controller, self.best.gains)
        seeds = [case.seed for case in self.settings.scenarios]
        where = (
            f"{len(seeds)} of {self.name}, {self.settings.episode_s:g} s, seeds {min(seeds)} to {max(seeds)}"
        )
        if (lines := self.settings.lines) is not None:
            where += (
                f"; {len(lines.seeds)} lines, {lines.episode_s:g} s, "
                f"seeds {min(lines.seeds)} to {max(lines.seeds)}"
            )
        about = {
            "command": self.command,
            "scenarios": where,
            "evaluations": len(self.tried),
            "simulated_s": f"{self.simulated:.0f}",
            "mean": self.settings.mean,
            "J_before": f"{self.before.cost:.6g}",
            "J_after": f"{self.best.cost:.6g}",
            "commit": self.commit or "null",
        }
        text = [HEAD.format(controller=self.controller)]
        for name, info in type(own).model_fields.items():
            if name == "provenance":
                continue
            unit = _unit(info)
            value: Any = getattr(tuned, name)
            found = [gain for gain in ranges if gain.partition(".")[0] == name]
            spans = dict.fromkeys(ranges[gain].text for gain in found)
            tag = f"calibrated: from {' and '.join(spans)}" if found else f"as {self.controller}"
            shown = list(value) if isinstance(value, tuple) else value
            entry = f"{name}: {'null' if value is None else shown}"
            text.append(f"{entry:<{COMMENT_COLUMN - 1}} # {f'{unit}; ' if unit else ''}{tag}")
        return "\n".join([*text, *provenance_lines(about)]) + "\n"

    def _draw(self, figure: Figure) -> None:
        left, right = panels(figure, 2, 2, (5.0, 4.2))
        self._draw_search(left)
        speeds = [case.speed_kmh for case in self.settings.scenarios]
        for e, name in ((self.before, self.controller), (self.best, self.title)):
            style = policy_style(name)
            # No lines: two scenarios of neighbouring speeds have other wear and friction.
            right.plot(
                speeds,
                e.costs[: len(speeds)],
                style.marker,
                color=style.colour,
                markersize=4,
                label=label(name),
            )
        right.set(xlabel="speed (km/h)", ylabel="J of a scenario")
        log_axis(right)
        legend_below(figure, left, right)

    def _draw_search(self, axes: Axes) -> None:
        names = list(self.best.gains)
        if len(names) == 1:
            places = [e.gains[names[0]] for e in self.tried]
            axes.plot(places, [e.cost for e in self.tried], "o", markersize=4)
            fields = type(load_controller(self.controller)).model_fields
            axes.set_xlabel(f"{names[0]} ({_unit(fields[names[0].partition('.')[0]]) or '-'})")
        else:
            draw_costs(axes, self.tried)
        for name, e in self.references.items():
            if e.cost < 2.0 * self.before.cost:
                axes.axhline(e.cost, linewidth=1.0, label=label(name), **policy_style(name).plain)
        axes.set(ylabel=f"{self.settings.mean} mean of J", title=self.title)
        log_axis(axes)


def _unit(field: FieldInfo) -> str | None:
    """Of a number of a configuration."""
    extra = field.json_schema_extra
    return str(extra["unit"]) if isinstance(extra, dict) and "unit" in extra else None


HEAD = """\
# The controller {controller} with the parameters of the smallest mean J, by `sayd tune`.
# Tags: calibrated = found so, in the named range; the rest is as in {controller}.yaml.
"""
GAINS = tuple(Column(name, name) for name in ("gain", "before", "tuned", "range"))
COSTS = (
    Column("policy", "policy"),
    Column("J", "J", digits=5, best=True),
    Column("mean", "mean J", digits=5),
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
    """Find the gains of a controller with the smallest mean J over a list of scenarios and lines.

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
    own = gains_of(load_controller(controller))
    own |= {k: settings.initial_current for k in ("initial",) if k in own and own[k] is None}
    minimise(tuning, own, run.cost_at, seed)
    command = command or f"sayd tune {controller}"
    return TuneResult(controller, settings, name, command, commit, run.evaluations)


class _Tuning:
    """A tuning under way."""

    def __init__(self, controller: str, settings: TuningConfig, total: int, context: RunContext) -> None:
        self.evaluations: list[Evaluation] = []
        self._controller, self._settings, self._context = controller, settings, context
        cases = [case.case for case in settings.scenarios]
        self._evaluators = [self._evaluator(settings.environment, cases, settings.episode_s)]
        if (lines := settings.lines) is not None:
            seeds = [{"seed": seed} for seed in lines.seeds]
            self._evaluators.append(self._evaluator(lines.environment, seeds, lines.episode_s))
        self._asked, self._total = 0, total
        self._seen: dict[tuple[float, ...], Evaluation] = {}

    def _evaluator(self, environment: str, cases: list[dict[str, Any]], episode_s: float) -> PolicyEvaluator:
        return PolicyEvaluator(
            environment,
            cases,
            episode_s=episode_s,
            reward=self._settings.reward,
            initial_current=self._settings.initial_current,
            executor=self._context.executor,
            kept=self._context.kept,
        )

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
        found = [self._costs(evaluator, spec) for evaluator in self._evaluators]
        costs = np.concatenate([each.costs for each in found])
        evaluation = Evaluation(
            spec.title,
            stage,
            gains,
            tuple(map(float, costs)),
            sum(each.derailed for each in found),
            mean_cost(costs, self._settings.mean),
        )
        self.evaluations.append(evaluation)
        self._tell(stage)
        return evaluation

    def _costs(self, evaluator: PolicyEvaluator, spec: PolicySpec) -> PolicyCosts:
        key = fingerprint(*evaluator.inputs(spec))
        found = self._context.cache.get(key, PolicyCosts)
        if found is None:
            found = evaluator.costs(spec)
            self._context.cache.put(key, found)
        return found

    def _tell(self, stage: str) -> None:
        self._asked += 1
        tried = [e for e in self.evaluations if e.stage != REFERENCE]
        best = f", best J {best_of(tried).cost:.5f}" if tried else ""
        self._context.progress(min(self._asked, self._total), self._total, f"{stage}{best}")


def training_seconds() -> float:
    """Time that one training of PPO simulates by its configuration, s: of vehicles, not of their bogies."""
    config = load_train("ppo")
    return config.vehicle_seconds(config.total_steps)


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
