"""How fast does a policy learn here: batch environment alone, PPO and SAC end to end, and who takes the time.

The packaged trainings without evaluations and checkpoints, SAC without its random steps before it learns.
Counted are the control steps of vehicles, whether one network commands a vehicle or two. Rates are those over
whole episodes: from the time of steps within them and of a reset, since a window of fixed length would hold
now one reset, now none. Simulator and torch take turns; beside the threads that the trainings give to torch
stands, measured once and briefly, what it does with all cores.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sayd_env.studies.bench.spread import Spread, in_turn

if TYPE_CHECKING:
    from sayd_env.agents.config import TrainConfig

Single = npt.NDArray[np.float32]

ALGORITHMS = ("ppo", "sac")
ENVIRONMENT, SHARE, UNCAPPED = "environment", "_share", "_uncapped"


@dataclass(frozen=True)
class TrainingEffort:
    """How much is measured."""

    repetitions: int
    steps: int
    """Steps of all vehicles together in one repetition, rounded up to what the algorithm does at a time."""
    uncapped: bool = True
    """Measure with all threads for torch, too."""


@dataclass(frozen=True)
class TrainingRates:
    """Figures of the trainings."""

    rates: dict[str, Spread]
    """Steps of all vehicles together per second: ``environment``, `ALGORITHMS`, the same with `UNCAPPED`."""
    environment_share: dict[str, Spread]
    """Share of an algorithm's time that is the environment's (-); the rest is the learner's."""
    vehicles: dict[str, int]
    """Vehicles side by side; ``environment`` has those of the first algorithm."""
    threads: dict[str, int]
    """Threads of the simulator, of torch, and of torch uncapped."""

    def as_dict(self) -> dict[str, Any]:
        """Medians by their keys."""
        return {
            **{name: spread.median for name, spread in self.rates.items()},
            "environment_share": {name: spread.median for name, spread in self.environment_share.items()},
            "lanes": self.vehicles,
            "threads": self.threads,
        }

    def note(self) -> str:
        """Return a sentence about the shares."""
        shares = ", ".join(f"{k.upper()} {s.median:.0%}" for k, s in self.environment_share.items())
        return (
            f"training: packaged configurations, simulator on {self.threads['simulator']} threads; the "
            f"environment's share of the time: {shares}, the rest is the learner's"
        )

    def label(self, name: str) -> str:
        """What a rate is called."""
        if name == ENVIRONMENT:
            return f"training: environment alone, {self.vehicles[name]} vehicles"
        algorithm = name.removesuffix(UNCAPPED)
        torch = self.threads["torch_uncapped" if name.endswith(UNCAPPED) else "torch"]
        return f"training: {algorithm.upper()}, {self.vehicles[algorithm]} vehicles, torch on {torch}"


def measure_training(
    effort: TrainingEffort, threads: int, did: Callable[[], None] = lambda: None
) -> TrainingRates | None:
    """Measure the packaged trainings on this machine.

    Parameters
    ----------
    effort : TrainingEffort
    threads : int
        Threads of the simulator.
    did : callable
        Told after each repetition.

    Returns
    -------
    TrainingRates or None
        None where torch or Stable-Baselines3 are not installed.
    """
    try:
        import torch  # noqa: PLC0415 - may be missing

        configs = {name: _config(name, threads) for name in ALGORITHMS}
        learners = {name: _learner(config) for name, config in configs.items()}
    except ModuleNotFoundError:
        for _ in range(effort.repetitions):
            did()
        return None
    before = torch.get_num_threads()
    first, *_ = learners.values()
    probes: dict[str, Callable[[], float]] = {}
    for name, learner in learners.items():
        own = configs[name].torch_threads
        probes[name] = lambda learner=learner, own=own: learner.rate(effort.steps, own)  # type: ignore[misc]
        probes[name + SHARE] = lambda learner=learner: learner.share  # type: ignore[misc]
    probes[ENVIRONMENT] = lambda: first.random_steps(effort.steps)
    try:
        measured = in_turn(probes, effort.repetitions, did)
        if effort.uncapped:
            few = effort.steps // 20  # on busy cores it is up to a hundred times slower
            for name, learner in learners.items():
                measured[name + UNCAPPED] = [learner.rate(few, before)]
    finally:
        torch.set_num_threads(before)
        for learner in learners.values():
            learner.env.close()
    order = (ENVIRONMENT, *ALGORITHMS, *(name + UNCAPPED for name in ALGORITHMS))
    return TrainingRates(
        rates={name: Spread.of(measured[name]) for name in order if name in measured},
        environment_share={name: Spread.of(measured[name + SHARE]) for name in ALGORITHMS},
        vehicles={ENVIRONMENT: first.vehicles}
        | {name: learner.vehicles for name, learner in learners.items()},
        threads={
            "simulator": threads,
            "torch": max(config.torch_threads for config in configs.values()),
            "torch_uncapped": before,
        },
    )


def _config(name: str, threads: int) -> TrainConfig:
    """A packaged training, as costly at each step, but in short strides and learning from the start."""
    from sayd_env.agents.config import PpoConfig, load_train  # noqa: PLC0415 - keeps the import of studies light

    changes = [f"environment.threads={threads}"]
    config = load_train(name, changes)
    if isinstance(config.learning, PpoConfig):
        networks = config.environment.vehicles * (2 if config.view == "bogie" else 1)
        changes.append(f"learning.n_steps={math.lcm(config.learning.batch_size, networks) // networks}")
    else:
        changes.append("learning.learning_starts=0")
    return load_train(name, changes)


def _learner(config: TrainConfig) -> Learner:
    from sayd_env.agents.learner import make_model  # noqa: PLC0415 - imports torch, which may be missing
    from sayd_env.agents.learning_env import make_learning_env  # noqa: PLC0415

    env, settings = make_learning_env(config)[0], config.environment
    episode = round(settings.episode_s / settings.control_period)
    return Learner(env, make_model(config, env), settings.vehicles, episode)


class Learner:
    """A training that is timed.

    Parameters
    ----------
    env : VecEnv
        Of `agents.learning_env`.
    model
        The algorithm of Stable-Baselines3 on it.
    vehicles : int
        Vehicles side by side.
    episode : int
        Control steps of an episode.

    Attributes
    ----------
    share : float
        The environment's share of the time in the last `rate`.
    """

    def __init__(self, env: Any, model: Any, vehicles: int, episode: int) -> None:
        self.env, self.model, self.vehicles = env, model, vehicles
        self.clock = StepClock(env)
        self.share = float("nan")
        self._networks = env.num_envs // vehicles
        self._episode = episode
        self._random = np.random.default_rng(0)

    def rate(self, steps: int, torch_threads: int) -> float:
        """Steps of all vehicles per second, learning on so many threads."""
        import torch  # noqa: PLC0415 - may be missing

        torch.set_num_threads(torch_threads)
        self.clock.clear()
        before, begin = self.model.num_timesteps, time.perf_counter()
        self.model.learn(steps * self._networks, log_interval=None, reset_num_timesteps=False)
        elapsed = time.perf_counter() - begin
        done = (self.model.num_timesteps - before) / self._networks
        learner = (elapsed - self.clock.total) / done
        environment = self._environment_s()
        together: float = environment + learner
        self.share = environment / together
        return 1.0 / together

    def random_steps(self, steps: int) -> float:
        """Steps of all vehicles per second with random actions and no learner, after the first `rate`."""
        env = self.env
        self.clock.clear()
        for _ in range(-(-steps // self.vehicles)):
            actions = self._random.uniform(-1.0, 1.0, (env.num_envs, *env.action_space.shape))
            env.step(actions.astype(np.float32))
        return 1.0 / self._environment_s()

    def _environment_s(self) -> float:
        """Time of one vehicle's step, with its part of a reset (s)."""
        seconds: float = (self.clock.step_s + self.clock.reset_s / self._episode) / self.vehicles
        return seconds


class StepClock:
    """Times steps and resets of a vector environment, which it changes.

    Parameters
    ----------
    env : VecEnv

    Attributes
    ----------
    total : float
        Time spent in the environment since `clear` (s).
    reset_s : float
        Time of the last reset (s).
    """

    def __init__(self, env: Any) -> None:
        self._step, self._reset = env.step, env.reset
        env.step, env.reset = self._timed_step, self._timed_reset
        self.reset_s = float("nan")
        self.clear()

    def clear(self) -> None:
        """Forget the steps that have been timed."""
        self.total, self._within, self._count = 0.0, 0.0, 0

    @property
    def step_s(self) -> float:
        """Mean time of a step in which no episode ended (s)."""
        mean: float = self._within / self._count
        return mean

    def _timed_step(self, actions: Single) -> Any:
        begin = time.perf_counter()
        result = self._step(actions)
        elapsed = time.perf_counter() - begin
        self.total += elapsed
        if not np.any(result[2]):
            self._within += elapsed
            self._count += 1
        return result

    def _timed_reset(self) -> Any:
        begin = time.perf_counter()
        result = self._reset()
        self.reset_s = time.perf_counter() - begin
        self.total += self.reset_s
        return result
