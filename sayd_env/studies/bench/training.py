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
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.studies.bench.spread import Effort, Measurement, Spread, Timed, in_turn, quantities

if TYPE_CHECKING:
    from sayd_env.agents.config import TrainConfig

ALGORITHMS = ("ppo", "sac")
ENVIRONMENT, SHARE, UNCAPPED = "environment", "_share", "_uncapped"


@dataclass(frozen=True)
class TrainingRates:
    """Figures of the trainings."""

    rates: dict[str, Measurement]
    """Steps of all vehicles together per second: ``environment``, `ALGORITHMS`, the same with `UNCAPPED`."""
    environment_share: dict[str, float]
    """Share of an algorithm's time that is the environment's (-); the rest is the learner's."""
    vehicles: dict[str, int]
    """Vehicles side by side; ``environment`` has those of the first algorithm."""
    threads: dict[str, int]
    """Threads of the simulator, of torch, and of torch uncapped."""

    def as_dict(self) -> dict[str, Any]:
        """Medians by their keys."""
        rates = {name: rate.spread.median for name, rate in self.rates.items()}
        return rates | {
            "environment_share": self.environment_share,
            "vehicles": self.vehicles,
            "threads": self.threads,
        }

    def note(self) -> str:
        """Return a sentence about the shares."""
        shares = ", ".join(f"{name.upper()} {share:.0%}" for name, share in self.environment_share.items())
        return (
            f"training: packaged configurations, simulator on {self.threads['simulator']} threads; the "
            f"environment's share of the time: {shares}, the rest is the learner's"
        )


def measure_training(
    effort: Effort, threads: int, did: Callable[[], None] = lambda: None
) -> TrainingRates | None:
    """Measure the packaged trainings with so many threads of the simulator; `did` is called for repetitions.

    Returns
    -------
    TrainingRates or None
        None where torch or Stable-Baselines3 are not installed.
    """
    try:
        import torch  # noqa: PLC0415 - may be missing

        configs = {name: _config(name, threads) for name in ALGORITHMS}
        learners = {name: make_learner(config) for name, config in configs.items()}
    except ModuleNotFoundError:
        for _ in range(effort.training_rounds):
            did()
        return None
    before = torch.get_num_threads()
    capped = {name: config.torch_threads for name, config in configs.items()}
    first, steps = learners[ALGORITHMS[0]], effort.training_steps
    probes = [partial(learner.rate, steps, capped[name], name) for name, learner in learners.items()]
    try:
        measured = in_turn(
            [*probes, lambda: {ENVIRONMENT: first.random_steps(steps)}], effort.training_rounds, did
        )
        if effort.uncapped:
            few = steps // 20  # on busy cores it is up to a hundred times slower
            for name, learner in learners.items():
                measured[name + UNCAPPED] = list(learner.rate(few, before, name).values())[:1]
    finally:
        torch.set_num_threads(before)
        for learner in learners.values():
            learner.env.close()
    labels = {ENVIRONMENT: f"training: environment alone, {first.vehicles} vehicles"}
    for end, torches in (("", max(capped.values())), (UNCAPPED, before)):
        for name, learner in learners.items():
            labels[name + end] = f"training: {name.upper()}, {learner.vehicles} vehicles, torch on {torches}"
    return TrainingRates(
        rates=quantities(measured, labels, "steps/s"),
        environment_share={name: Spread.of(measured[name + SHARE]).median for name in ALGORITHMS},
        vehicles={ENVIRONMENT: first.vehicles} | {name: each.vehicles for name, each in learners.items()},
        threads={"simulator": threads, "torch": max(capped.values()), "torch_uncapped": before},
    )


def _config(name: str, threads: int) -> TrainConfig:
    """A packaged training, as costly at each step, but in short strides and learning from the start."""
    from sayd_env.agents.config import PpoConfig, load_train  # noqa: PLC0415 - keeps the import of studies light

    changes = [f"environment.threads={threads}"]
    config = load_train(name, changes)
    if isinstance(config.learning, PpoConfig):
        networks = config.networks
        changes.append(f"learning.n_steps={math.lcm(config.learning.batch_size, networks) // networks}")
    else:
        changes.append("learning.learning_starts=0")
    return load_train(name, changes)


def make_learner(config: TrainConfig) -> Learner:
    """A training that is timed."""
    from sayd_env.agents.learner import make_model  # noqa: PLC0415 - imports torch, which may be missing
    from sayd_env.agents.learning_env import make_learning_env  # noqa: PLC0415

    (env, encoding), settings = make_learning_env(config), config.environment
    # An earlier commit, which `tests/bench` measures, has neither of both.
    hold, beside = getattr(config.output, "hold", 1), getattr(settings, "beside", ())
    parts = [(each.vehicles, each.episode_s) for each in (settings, *beside)]
    # Resets of a second: each kind of episode has its own length.
    mean = sum(count for count, _ in parts) / sum(count / seconds for count, seconds in parts)
    episode = mean / settings.control_period / hold
    return Learner(env, make_model(config, env), env.num_envs // encoding.units, episode, hold)


class Learner:
    """A training that is timed: its environment's steps and resets, and all of it.

    Parameters
    ----------
    env : VecEnv
        Of `agents.learning_env`; its `step` and `reset` are replaced.
    model
        The algorithm of Stable-Baselines3 on it.
    vehicles : int
        Vehicles side by side.
    episode : float
        Steps of the environment in an episode, over all vehicles.
    hold : int
        Control periods of a step of the environment: an output of the network holds for so long.
    """

    def __init__(self, env: Any, model: Any, vehicles: int, episode: float, hold: int = 1) -> None:
        self.env, self.model, self.vehicles, self.episode = env, model, vehicles, episode
        self.hold = hold
        self._networks = env.num_envs // vehicles
        self._random = np.random.default_rng(0)
        self._steps, self._resets = Timed(env, "step"), Timed(env, "reset")

    def rate(self, steps: int, torch_threads: int, name: str = "value") -> dict[str, float]:
        """Steps of all vehicles per second, learning on so many threads, by a name, and the share by another.

        The share, by the name with `SHARE` behind it, is the environment's part of the time.
        """
        import torch  # noqa: PLC0415 - may be missing

        torch.set_num_threads(torch_threads)
        self._steps.seconds.clear()
        before, begin, resets = self.model.num_timesteps, time.perf_counter(), len(self._resets.seconds)
        asked = -(-steps // self.hold) * self._networks
        self.model.learn(asked, log_interval=None, reset_num_timesteps=False)
        learner = time.perf_counter() - begin - sum(self._steps.seconds) - sum(self._resets.seconds[resets:])
        environment = self._environment_s()
        together = environment + learner * self._networks / (self.model.num_timesteps - before)
        return {name: self.hold / together, name + SHARE: environment / together}

    def random_steps(self, steps: int) -> float:
        """Steps of all vehicles per second with random actions and no learner, after the first `rate`."""
        env = self.env
        self._steps.seconds.clear()
        for _ in range(-(-steps // (self.vehicles * self.hold))):
            actions = self._random.uniform(-1.0, 1.0, (env.num_envs, *env.action_space.shape))
            env.step(actions.astype(np.float32))
        return self.hold / self._environment_s()

    def _environment_s(self) -> float:
        """Time of one vehicle's step, the median, which ends no episode, with its part of a reset (s)."""
        step, reset = np.median(self._steps.seconds), self._resets.seconds[-1]
        return float(step + reset / self.episode) / self.vehicles
