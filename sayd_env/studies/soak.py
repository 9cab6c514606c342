"""Do the environments hold under any command? Millions of random and extreme control steps, all checked.

Besides, the largest cost J of one second over all that an episode may draw: twice of it is the charge that an
environment takes for each second that a terminated episode did not run (`termination_cost`).
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError
from sayd_env.config.palette import BLUE, VERMILION
from sayd_env.config.units import KMH, Array, Array32, Flags, Integers
from sayd_env.envs.loop import NOT_FINITE, RUNNING
from sayd_env.envs.vector import SaydVectorEnv
from sayd_env.report.columns import Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, legend_below, limit_line, log_axis, panels
from sayd_env.runs.context import Progress, silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console


KINDS = {"held": 0.4, "fresh": 0.2, "open": 0.1, "closed": 0.1, "bang-bang": 0.2}
"""Stretches of commands and how often they come: random and held, random anew at each step, all valves open,
all closed, each valve between its ends in turn."""
_NAMES = list(KINDS)
LONGEST = 2000
"""Steps of the longest stretch: 20 s, in which hunting grows to its full size."""
LONGEST_SIDE = 50
"""Steps for which a bang-bang command stays at one end, at most."""
DEFECTS = {
    "observations": "observations that are not finite",
    "observations_out_of_range": "observations out of range",
    "rewards": "rewards that are not finite",
    "states": "states that are not finite",
    "diverged": "episodes that diverged",
}
"""What must not be and what it is called; counted by vehicle and step, the last by episode."""
MARGIN = 2.0
"""J_term over the largest J of a second: ending early never pays."""
QUANTILES = (0.5, 0.9, 0.99, 0.999)
"""Of J of a second, in the result."""
SHOWN = 5
"""Seconds that the summary prints."""
KEPT = 50
"""Seconds that the table of the worst holds."""


WORST = (
    # Mean of the bogies' J; what came together until then, where the episode was terminated within it.
    Column("J", "J", digits=4),
    # The episode was terminated within this second.
    Column("cut", "cut"),
    # Number of the second in its episode, from 0.
    Column("second", "second", wide=True),
    Column("seed", "seed"),
    Column("episode", "episode", wide=True),
    Column("speed_kmh", "km/h", digits=0),
    Column("wear", "wear", digits=2),
    Column("friction", "friction", digits=2),
    Column("track", "track"),
    # Kinds of the episode's faults that had happened.
    Column("faults", "faults"),
    # The last kind of command in this second.
    Column("commands", "commands"),
)
"""Of the table of the worst seconds: one second of an episode, and what it ran under."""
_COUNTS = (Column("what", "what"), Column("count", "count"))
_DEFECT_COUNTS = (Column("what", "what"), Column("count", "count", limit=0))


@dataclass(frozen=True)
class SoakResult:
    """What a soak found."""

    environment: str
    steps: int
    """Control steps, without those at which an episode begins."""
    environments: int
    episodes: int
    """Episodes that began."""
    truncated: int
    endings: dict[str, int]
    """Terminated episodes by their reason."""
    defects: dict[str, int]
    """Counts by the keys of `DEFECTS`."""
    costs: Array
    """J of every whole second."""
    worst: Sequence[Mapping[str, Any]]
    """By `WORST`: the seconds of the largest J, cut ones among them, largest first."""
    termination_cost: float
    """What the environment charges now."""
    wall_s: float

    @property
    def largest(self) -> float:
        """Largest J of a second; NaN where none was run."""
        return float(self.worst[0]["J"]) if self.worst else math.nan

    @property
    def recommended(self) -> float:
        """Twice of it, the recommended `termination_cost`."""
        return MARGIN * self.largest

    @property
    def failures(self) -> str:
        """Defects in words; empty without any."""
        return ", ".join(f"{DEFECTS[name]}: {count}" for name, count in self.defects.items() if count)

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd soak --json``."""
        names = ("environment", "steps", "environments", "episodes", "truncated", "endings")
        return {
            **{name: getattr(self, name) for name in names},
            "terminated": sum(self.endings.values()),
            "defects": self.defects,
            "seconds": len(self.costs),
            "largest_j": self.largest,
            "quantiles_j": {f"{q:g}": value for q, value in self.quantiles.items()},
            "worst": self.worst[:SHOWN],
            "termination_cost": self.termination_cost,
            "recommended_termination_cost": self.recommended,
            "wall_s": self.wall_s,
            "steps_per_s": self.steps / self.wall_s,
        }

    def tables(self) -> dict[str, Table]:
        """Worst seconds with their conditions, and how often J lies within which bounds."""
        counts, edges = self._histogram()
        bins = list(zip(edges[:-1], edges[1:], counts, strict=True))
        return {
            "worst_seconds": csv_table(WORST, self.worst),
            "histogram": (("J_from", "J_to", "seconds"), bins),
        }

    def plots(self) -> dict[str, Plot]:
        """How often which J of a second comes, unless no second is whole."""
        return {"soak": self._draw} if np.any(self.costs > 0.0) else {}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print what was run and found, the worst seconds and the recommended charge."""
        counts = {"episodes": self.episodes, "ran to their end": self.truncated}
        counts |= {f"terminated: {reason}": count for reason, count in self.endings.items()}
        about = (
            f"{self.steps:,} control steps of {self.environments} vehicles, environment {self.environment}"
        )
        Listing(about, _COUNTS, [{"what": k, "count": n} for k, n in counts.items()]).print(console)
        found = [{"what": DEFECTS[name], "count": count} for name, count in self.defects.items()]
        Listing("what must not be", _DEFECT_COUNTS, found).print(console)
        Listing("seconds of the largest J", WORST, self.worst[:SHOWN]).print(console, wide)
        quantiles = ", ".join(f"{100 * q:g} %: {value:.3g}" for q, value in self.quantiles.items())
        console.print(f"J of {len(self.costs):,} whole seconds: {quantiles}, largest {self.largest:.4g}")
        console.print(
            f"recommended termination_cost, {MARGIN:g} times the largest J: [bold]{self.recommended:.4g}[/] "
            f"(configured: {self.termination_cost:g})"
        )
        console.print(f"{self.wall_s:.0f} s, {self.steps / self.wall_s:,.0f} steps/s with resets")

    @property
    def quantiles(self) -> dict[float, float]:
        """J of whole seconds by `QUANTILES`; NaN without any."""
        costs = self.costs if len(self.costs) else [math.nan]
        return dict(zip(QUANTILES, map(float, np.quantile(costs, QUANTILES)), strict=True))

    def _histogram(self) -> tuple[Integers, Array]:
        """Counts of seconds in bins of equal ratio, ten in a decade."""
        positive = self.costs[self.costs > 0.0]
        if not len(positive):
            return np.zeros(0, dtype=np.int64), np.ones(1)
        first = math.floor(10.0 * math.log10(positive.min()))
        last = math.floor(10.0 * math.log10(positive.max())) + 1
        edges = 10.0 ** (np.arange(first, last + 1) / 10.0)
        counts, _ = np.histogram(positive, edges)
        return counts, edges

    def _draw(self, figure: Figure) -> None:
        counts, edges = self._histogram()
        (axes,) = panels(figure, 1, size=(8.0, 4.5))
        axes.stairs(counts, edges, fill=True, color=BLUE, alpha=0.7, label="whole seconds")
        axes.axvline(self.largest, color=VERMILION, label=f"largest: {self.largest:.3g}")
        limit_line(axes, self.recommended, f"recommended charge: {self.recommended:.3g}", vertical=True)
        axes.set(xlabel="J of a second", ylabel="seconds")
        axes.set_title(f"{self.environment}: {self.steps:,} steps of random and extreme commands")
        log_axis(axes, "x")
        log_axis(axes, "y")
        legend_below(figure, axes)


def soak(
    environment: str = "faults",
    steps: int = 2_000_000,
    *,
    environments: int = 64,
    seed: int = 0,
    settings: Sequence[str] = (),
    workers: int | None = None,
    progress: Progress = silent,
) -> SoakResult:
    """Run random and extreme commands through the batch environment and check every number that comes out.

    Parameters
    ----------
    environment : str
        A packaged environment or a path to a YAML file.
    steps : int
        Control steps of all vehicles together, at least; whole steps of the batch are run.
    environments : int
        Vehicles side by side. Vehicle i has the seed ``seed + i``.
    seed : int
        Seed of the episodes and of the commands.
    settings : sequence of str
        ``key=value`` assignments for the scenario; what they set is not drawn.
    workers : int, optional
        Threads; results do not depend on it.
    progress : Progress
        Called after each step of the batch.

    Raises
    ------
    ConfigError
        An environment that cannot be used, no steps or no vehicles.
    """
    if steps < 1 or environments < 1:
        raise ConfigError(f"found {steps} steps of {environments} vehicles; expected at least one of one")
    begin = time.perf_counter()
    env = SaydVectorEnv(environment, num_envs=environments, num_threads=workers, settings=settings)
    commands = RandomCommands(
        environments, env.interface.actions, np.random.default_rng([seed, environments])
    )
    watch = _Watch(env, commands)
    try:
        observations, _ = env.reset(seed=seed)
        watch.begun(np.ones(environments, dtype=np.bool_))
        watch.check(observations, np.zeros(environments))
        while watch.steps < steps:
            watch.take(*env.step(commands.next())[:4])
            progress(min(watch.steps, steps), steps, f"{watch.episodes} episodes")
    finally:
        env.close()
    return watch.result(environment, time.perf_counter() - begin)


class RandomCommands:
    """Valve commands of several vehicles: stretches of random length, each of a random kind of `KINDS`.

    `kind` is the place of each vehicle's present kind in `KINDS`.
    """

    def __init__(self, environments: int, valves: int, random: np.random.Generator) -> None:
        self._random = random
        self.kind, self._left, self._age = np.zeros((3, environments), dtype=np.int64)
        self._side = np.ones(environments, dtype=np.int64)
        self._ends = np.zeros((2, environments, valves), dtype=np.float32)

    def names(self) -> list[str]:
        """Each vehicle's present kind."""
        return [_NAMES[kind] for kind in self.kind]

    def next(self) -> Array32:
        """Commands of the next step, a new array of shape (environments, valves)."""
        over = np.flatnonzero(self._left == 0)
        if over.size:
            self._begin(over)
        fresh = self.kind == _NAMES.index("fresh")
        second = (self._age // self._side) % 2 == 1
        command: Array32 = np.where(second[:, None], self._ends[1], self._ends[0])
        if fresh.any():
            command[fresh] = self._random.random(command[fresh].shape, dtype=np.float32)
        self._age += 1
        self._left -= 1
        return command

    def _begin(self, which: npt.NDArray[np.intp]) -> None:
        """Draw new stretches for some vehicles."""
        random, count, valves = self._random, len(which), self._ends.shape[2]
        kind = random.choice(len(KINDS), size=count, p=list(KINDS.values()))
        self.kind[which], self._age[which] = kind, 0
        self._left[which] = _lengths(random, LONGEST, count)
        self._side[which] = _lengths(random, LONGEST_SIDE, count)
        held = random.random((count, valves), dtype=np.float32)
        side = random.integers(2, size=(count, valves)).astype(np.float32)
        shut = np.zeros_like(held)
        for end, bang in enumerate((side, 1.0 - side)):
            of_kinds = np.stack([held, held, shut + 1.0, shut, bang])  # in the order of `KINDS`
            self._ends[end, which] = of_kinds[kind, np.arange(count)]


def _lengths(random: np.random.Generator, longest: int, count: int) -> Integers:
    """Lengths from 1 to the longest, short ones more often: uniform in their logarithms."""
    drawn = np.exp(random.uniform(0.0, math.log(longest + 1), count)).astype(np.int64)
    return np.clip(drawn, 1, longest)


class _Watch:
    """Counts what comes out of an environment whose episodes begin at the next step."""

    def __init__(self, env: SaydVectorEnv, commands: RandomCommands) -> None:
        self.env, self.commands = env, commands
        self.steps = self.episodes = self.truncated = 0
        self.endings: Counter[str] = Counter()
        self.defects = dict.fromkeys(DEFECTS, 0)
        self._ended = np.zeros(env.num_envs, dtype=np.bool_)
        self._sum = np.zeros(env.num_envs)
        self._per_second = round(1.0 / env.interface.control_period)
        self._costs: list[Array] = []
        self._worst: list[dict[str, Any]] = []
        space: Any = env.observation_space
        self._low, self._high = space.low, space.high

    def begun(self, which: Flags) -> None:
        """Note that episodes began."""
        self.episodes += int(np.count_nonzero(which))
        self._sum[which] = 0.0

    def check(self, observations: Array32, rewards: Array) -> None:
        """Count numbers that are not finite, or beyond their space."""
        states = self.env.batch.vehicles.state
        found = {
            "observations": ~np.isfinite(observations).all(axis=1),
            "observations_out_of_range": ((observations < self._low) | (observations > self._high)).any(
                axis=1
            ),
            "rewards": ~np.isfinite(rewards),
            "states": [not all(np.isfinite(values).all() for values in state) for state in states],
        }
        for name, flags in found.items():
            self.defects[name] += int(np.count_nonzero(flags))

    def take(self, observations: Array32, rewards: Array, terminated: Flags, truncated: Flags) -> None:
        """Count one step of the batch."""
        if self._ended.any():
            self.begun(self._ended)
        self.check(observations, rewards)
        stepped = ~self._ended
        self.steps += int(np.count_nonzero(stepped))
        self._add_costs(stepped, terminated)
        self.truncated += int(np.count_nonzero(truncated))
        for i in map(int, np.flatnonzero(terminated)):
            self.endings[self.env.batch.ending(i)] += 1
            self.defects["diverged"] += int(self.env.batch.vehicles.status[i] == NOT_FINITE)
        self._ended = terminated | truncated

    def _add_costs(self, stepped: Flags, terminated: Flags) -> None:
        """Add the steps' costs to their seconds, the charge for a termination left out."""
        batch = self.env.batch
        ran = stepped & (batch.elapsed > 0) & (batch.vehicles.status != NOT_FINITE)
        self._sum[ran] -= batch.vehicles.rewards[ran]
        whole = stepped & (batch.elapsed % self._per_second == 0) & (batch.vehicles.status == RUNNING)
        done = whole | terminated
        if not done.any():
            return
        self._costs.append(self._sum[whole])
        least = self._worst[-1]["J"] if len(self._worst) >= KEPT else -math.inf
        high = [int(i) for i in np.flatnonzero(done) if self._sum[i] > least]
        if high:
            names = self.commands.names()
            self._worst += [self._second(i, bool(terminated[i]), names[i]) for i in high]
            self._worst = sorted(self._worst, key=lambda second: -second["J"])[:KEPT]
        self._sum[done] = 0.0

    def _second(self, i: int, cut: bool, commands: str) -> dict[str, Any]:
        """A second by `WORST`."""
        batch = self.env.batch
        episode, scenario, elapsed = batch.episodes[i], batch.scenario, int(batch.elapsed[i])
        assert episode is not None  # it has been run
        time_s = elapsed * batch.config.control_period
        happened = [fault.kind for fault in episode.faults if fault.start_s <= time_s]
        return {
            "J": float(self._sum[i]),
            "cut": cut,
            "second": max(elapsed - 1, 0) // self._per_second,
            "seed": episode.seed,
            "episode": episode.number,
            "speed_kmh": episode.speed * KMH,
            "wear": scenario.wear if episode.wear is None else episode.wear,
            "friction": scenario.friction if episode.friction is None else episode.friction,
            "track": "of the study" if episode.track is None else episode.track,
            "faults": " ".join(happened),
            "commands": commands,
        }

    def result(self, environment: str, wall: float) -> SoakResult:
        """What was counted."""
        return SoakResult(
            environment=environment,
            steps=self.steps,
            environments=self.env.num_envs,
            episodes=self.episodes,
            truncated=self.truncated,
            endings=dict(self.endings),
            defects=self.defects,
            costs=np.concatenate([np.zeros(0), *self._costs]),
            worst=self._worst,
            termination_cost=self.env.config.termination_cost,
            wall_s=wall,
        )
