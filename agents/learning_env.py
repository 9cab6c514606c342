"""The batch environment as a learner sees it: encoded observations, outputs from -1 to 1, scaled rewards."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor

from sayd_env.agents.bogie_encoding import make_encoding
from sayd_env.agents.config import BesideConfig, TrainConfig
from sayd_env.agents.encoding import Encoding
from sayd_env.agents.sb3_vec import SaydVecEnv, Step
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.errors import ConfigError
from sayd_env.config.learner import InputConfig
from sayd_env.config.units import Array, Array32, Flags
from sayd_env.envs.interface import Interface
from sayd_env.envs.privileged import Conditions, check_conditions
from sayd_env.envs.scaled import Scaling, ordinary_costs

Numbers = Callable[[], Array]

SEEDS_APART = 1_000_000
"""Seeds of a training begin here, those of evaluations and comparisons lie below."""
SEEDS_OF_A_START = 4096
"""Seeds from one start of a training to the next: as many as there may be environments."""
STARTS = SEEDS_APART // SEEDS_OF_A_START


class JoinedVecEnv(VecEnv):
    """Batches of vehicles in several environments as one: those of the first come first.

    Parameters
    ----------
    parts : sequence of SaydVecEnv
        Of the same signals, valves and clock.
    """

    def __init__(self, parts: Sequence[SaydVecEnv]) -> None:
        self.parts = tuple(parts)
        first = self.parts[0]
        super().__init__(sum(part.num_envs for part in parts), first.observation_space, first.action_space)
        ends = np.cumsum([part.num_envs for part in parts]).tolist()
        self.slices = [slice(end - part.num_envs, end) for part, end in zip(parts, ends, strict=True)]

    def reset(self) -> Array32:
        """Begin an episode of every vehicle."""
        for part, own in zip(self.parts, self.slices, strict=True):
            part._seeds, part._options = self._seeds[own], self._options[own]
        seen = np.concatenate([part.reset() for part in self.parts])
        self.reset_infos = [info for part in self.parts for info in part.reset_infos]
        self._reset_seeds()
        self._reset_options()
        return seen

    def step_async(self, actions: Array32) -> None:
        """Keep the valve commands for `step_wait`."""
        for part, own in zip(self.parts, self.slices, strict=True):
            part.step_async(actions[own])

    def step_wait(self) -> Step:
        """Hold the valve commands for one control period."""
        steps = [part.step_wait() for part in self.parts]
        seen, rewards, dones = (np.concatenate([step[i] for step in steps]) for i in range(3))
        return seen, rewards, dones, [info for step in steps for info in step[3]]

    def together(self, numbers: Callable[[SaydVecEnv], Array]) -> Array:
        """What a function gives of each part, one behind the other."""
        return np.concatenate([numbers(part) for part in self.parts])

    def close(self) -> None:
        """Close the parts."""
        for part in self.parts:
            part.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each vehicle's environment."""
        every = [value for part in self.parts for value in part.get_attr(attr_name)]
        return [every[i] for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all environments, as the parts do.

        Raises
        ------
        ConfigError
            Only some vehicles are meant.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ConfigError(f"{attr_name}: the vehicles of a part are one object; set it for all of them")
        for part in self.parts:
            part.set_attr(attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> Any:
        """Refuse to call a method of one vehicle, as the parts do."""
        return self.parts[0].env_method(method_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Nothing lies around a vehicle."""
        return [False] * len(list(self._get_indices(indices)))


class EncodedVecEnv(VecEnvWrapper):
    """Networks at work: encoded observations, actions that are a network's outputs, scaled rewards.

    A vehicle has one network or, in the view of a bogie, two; then vehicle i has the rows 2 i and 2 i + 1,
    and each is paid for its own bogie. Behind a network's inputs an observation holds the true conditions
    that a critic or an estimator learns with.

    Parameters
    ----------
    venv : VecEnv
        Vehicles with observations in SI units, actions from 0 to 1 and rewards as the environment gives them.
    encoding : Encoding
    factors : callable
        Gives what each vehicle's rewards are multiplied with in its episode, shape (N).
    costs : callable, optional
        Gives the share of the last period in the J of each bogie, shape (N, 2).
    privileged : Privileged, optional
        Gives the true conditions.
    remembered : callable, optional
        Gives what vehicles that have just begun remember of their run-in, shape (N, memory_width).
    least : float
        Smallest scaled reward of a control period. A derailment is charged with the whole rest of its
        episode, a thousand times what a command is worth: unbounded, one drowns all else in a rollout.

    Attributes
    ----------
    inputs : int
        Inputs of a network.
    """

    def __init__(
        self,
        venv: VecEnv,
        encoding: Encoding,
        factors: Numbers,
        costs: Numbers | None = None,
        privileged: Privileged | None = None,
        remembered: Callable[[Flags], Array] | None = None,
        least: float = -np.inf,
    ) -> None:
        super().__init__(venv)
        self.inputs = encoding.size
        width = self.inputs + (0 if privileged is None else privileged.size)
        VecEnv.__init__(
            self,
            venv.num_envs * encoding.units,
            Box(-encoding.clip, encoding.clip, (width,), np.float32),
            Box(-1.0, 1.0, (encoding.actions,), np.float32),
        )
        self._encoding, self._privileged, self._remembered = encoding, privileged, remembered
        self._factors, self._factor = factors, np.ones(venv.num_envs)
        self._costs, self._least = costs, least
        self._seen: Array32 = np.zeros(0, np.float32)
        self._memory = np.zeros((venv.num_envs, encoding.memory_width))
        self._outputs: Array32 = np.zeros(0, np.float32)
        self._conditions: Array32 = np.zeros(0, np.float32)

    def reset(self) -> Array32:
        """Begin an episode of every vehicle."""
        self._seen = self.venv.reset()
        self._begin(np.ones(self.venv.num_envs, dtype=np.bool_))
        self._memory = self._encoding.remember(self._memory, self._seen)
        return self._observed()

    def _begin(self, which: Flags) -> None:
        """Take over the episodes of vehicles that have just begun."""
        self._factor = self._factors()
        self._memory[which] = 0.0
        if self._remembered is not None:
            self._memory[which] = self._remembered(which)[which]
        if self._privileged is not None:
            self._privileged.begin(np.flatnonzero(which))

    def _observed(self) -> Array32:
        inputs = self._encoding.encode(self._seen, self._memory)
        if self._privileged is None:
            return inputs
        self._conditions = self._privileged(self._encoding.units)
        return np.concatenate([inputs, self._conditions], axis=1)

    def step_async(self, actions: Array32) -> None:
        """Keep outputs of the network for `step_wait`."""
        self._outputs = actions

    def step_wait(self) -> Step:
        """Hold the commands as long as an output holds; an episode is paid for its own periods."""
        count, units = self.venv.num_envs, self._encoding.units
        paid, over = np.zeros((count, units)), np.zeros(count, dtype=np.bool_)
        last: dict[int, dict[str, Any]] = {}
        infos: list[dict[str, Any]] = []
        for _ in range(self._encoding.output.hold):
            commands = self._encoding.decode(self._outputs, self._seen)
            self._seen, rewards, dones, infos = self.venv.step(commands)
            scaled = np.maximum(self._paid(rewards, dones) * self._factor[:, None], self._least)
            paid += np.where(over[:, None], 0.0, scaled)
            if dones.any():
                for i in map(int, np.flatnonzero(dones & ~over)):
                    last[i] = infos[i] | {"terminal_observation": self._last(i, infos[i])}
                over |= dones
                self._begin(dones)
            self._memory = self._encoding.remember(self._memory, self._seen)
        each = [info for info in infos for _ in range(units)] if units > 1 else infos
        for i, info in last.items():
            rows = info["terminal_observation"]
            for j in range(units):
                each[i * units + j] = info | {"terminal_observation": rows[j]}
        return self._observed(), paid.astype(np.float32).reshape(-1), np.repeat(over, units), each

    def _last(self, i: int, info: dict[str, Any]) -> Array32:
        """What vehicle i observed last; its conditions are those of its last decision."""
        seen, units = info["terminal_observation"][None], self._encoding.units
        memory = self._encoding.remember(self._memory[i : i + 1], seen)
        inputs = self._encoding.encode(seen, memory)
        if self._privileged is None:
            return inputs
        return np.concatenate([inputs, self._conditions[i * units : (i + 1) * units]], axis=1)

    def _paid(self, rewards: Array32, dones: Flags) -> Array:
        """Rewards of the networks, shape (N, units): their mean over a vehicle is the vehicle's."""
        if self._costs is None or self._encoding.units == 1:
            return np.repeat(rewards[:, None].astype(np.float64), self._encoding.units, axis=1)
        costs = self._costs()
        apart = costs - costs.mean(axis=1, keepdims=True)
        apart[dones] = 0.0  # these costs are of the next episode already
        paid: Array = rewards[:, None] - apart
        return paid


class Privileged:
    """True conditions of vehicles by fixed maps: what a critic and an estimator learn with.

    Parameters
    ----------
    vehicles : JoinedVecEnv
    conditions : mapping
        Map of each of `sayd_env.envs.privileged.CONDITIONS`.
    clip : float
        Numbers are cut off at plus and minus this.

    Attributes
    ----------
    size : int
        Number of conditions.

    Raises
    ------
    ConfigError
        An unknown condition.
    """

    def __init__(self, vehicles: JoinedVecEnv, conditions: Mapping[str, InputConfig], clip: float) -> None:
        self.size = len(conditions)
        self._parts = [Conditions(part.vector.batch, tuple(conditions)) for part in vehicles.parts]
        self._firsts = np.cumsum([0, *(part.num_envs for part in vehicles.parts)])
        self._scaling = Scaling.of(conditions.values(), clip)

    def begin(self, which: npt.NDArray[np.intp]) -> None:
        """Take over the episodes of vehicles that have just begun."""
        for part, (first, end) in zip(self._parts, pairwise(self._firsts), strict=True):
            part.begin([int(i - first) for i in which if first <= i < end])

    def __call__(self, units: int) -> Array32:
        """Conditions where the vehicles are, a row for each network, shape (N units, size)."""
        return np.repeat(self._scaling(np.concatenate([part() for part in self._parts])), units, axis=0)


def _check_dampers(interfaces: Sequence[Interface]) -> None:
    """Refuse dampers that no command moves, and others than those by which commands are encoded."""
    for interface in interfaces:
        if not isinstance(interface.damper, SaydDamperConfig):
            raise ConfigError("a training needs semi-active dampers; found passive ones in its environments")
        if interface.damper != interfaces[0].damper:
            raise ConfigError("the environments of a training have different dampers; expected the same")


def environment_keywords(config: TrainConfig, beside: BesideConfig | None = None) -> dict[str, Any]:
    """Keywords of the environment in which a policy learns, or of one beside it."""
    settings = config.environment
    return {
        "environment": settings.name if beside is None else beside.name,
        "valves": settings.valves,
        "observation": settings.observation,
        "history": settings.history if settings.observation == "history" else None,
        "control_period": settings.control_period,
        "episode_s": settings.episode_s if beside is None else beside.episode_s,
        "reward": settings.reward,
    }


def make_learning_env(config: TrainConfig) -> tuple[EncodedVecEnv, Encoding]:
    """The environment of a training, and the encoding between it and the network.

    Raises
    ------
    ConfigError
        Keywords, inputs or outputs that do not fit the environment.
    """
    settings = config.environment
    check_conditions([*config.privileged])
    every = [(settings.vehicles, None), *((each.vehicles, each) for each in settings.beside)]
    vehicles = JoinedVecEnv(
        [
            SaydVecEnv(
                num_envs=count,
                num_threads=settings.threads,
                info="none",  # nobody reads it, and it takes its time
                **environment_keywords(config, beside),
            )
            for count, beside in every
        ]
    )
    interface = vehicles.parts[0].interface
    _check_dampers([part.interface for part in vehicles.parts])
    encoding = make_encoding(interface, config.view, config.inputs, config.clip, config.output, config.memory)
    for part in vehicles.parts:
        part.vector.keeps_run_in = encoding.memory is not None

    per_second = config.reward_scale / settings.control_period

    def factors() -> Array:
        return per_second / vehicles.together(lambda part: ordinary_costs(part.vector.batch))

    def remembered(which: Flags) -> Array:
        return np.concatenate(
            [
                _remembered(part, encoding, which[own])
                for part, own in zip(vehicles.parts, vehicles.slices, strict=True)
            ]
        )

    # The monitor is below: it adds up what the environment gives, minus J.
    env = EncodedVecEnv(
        VecMonitor(vehicles),
        encoding,
        factors,
        lambda: vehicles.together(SaydVecEnv.bogie_costs),
        Privileged(vehicles, config.privileged, config.clip) if config.privileged else None,
        remembered if encoding.memory is not None else None,
        -config.worst_s * per_second,
    )
    return env, encoding


def _remembered(part: SaydVecEnv, encoding: Encoding, which: Flags) -> Array:
    """What vehicles of a batch that have just begun remember of their run-in."""
    run_in = part.vector.batch.observed_run_in
    if not which.any() or run_in is None:
        return np.zeros((part.num_envs, encoding.memory_width))
    return encoding.memory_after(run_in)


def seed_environments(env: EncodedVecEnv, seed: int, restarts: int) -> None:
    """Seed the environments of a training.

    Parameters
    ----------
    env : EncodedVecEnv
    seed : int
        Of the training.
    restarts : int
        How often the training was resumed: each time its episodes are others.
    """
    env.seed((seed + 1) * SEEDS_APART + (restarts % STARTS) * SEEDS_OF_A_START)
