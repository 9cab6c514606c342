"""Schema of a training: environment, the network's inputs and outputs, algorithm, evaluation."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from sayd_env.config import ConfigError, Model, quantity
from sayd_env.config.base import Number
from sayd_env.config.control import SpeedScheduleConfig, load_controller
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.learner import WIDEST, InputConfig
from sayd_env.config.loader import from_anywhere
from sayd_env.config.reward import RewardName

Count = Annotated[int, Field(strict=True, ge=1)]
"""A whole number of 1 or more."""
View = Literal["vehicle", "bogie"]
"""What one network sees and commands."""
TRAIN = Kind("train", names=("environment.name", "environment.beside.*.name", "output.schedule"))
MAY_CHANGE = {"total_steps"}
"""Keys that a run may have otherwise when it is taken up again."""


class BesideConfig(Model):
    """Further vehicles in another environment of the same signals, valves and clock."""

    name: str = Field(min_length=1, description="Name of an environment, or a path to its YAML file")
    vehicles: int = Field(description="Vehicles side by side", strict=True, ge=1, le=4096)
    episode_s: float = quantity("s", "Time at which an episode is truncated", gt=0.0)

    @property
    def title(self) -> str:
        """Its name in the columns of evaluations."""
        return Path(self.name).stem


class LearningEnvironmentConfig(Model):
    """The environment in which a policy learns; what is null stays as the environment has it."""

    name: str = Field(min_length=1, description="Name of an environment, or a path to its YAML file")
    vehicles: int = Field(description="Vehicles side by side", strict=True, ge=1, le=4096)
    threads: Count | None = Field(None, description="Threads of the simulator; null: all cores")
    valves: Literal["bogie", "damper", "vehicle"]
    observation: Literal["signals", "history", "features"]
    history: Count | None = Field(None, description="Vectors in an observation of type 'history'")
    control_period: float = quantity("s", "Time for which a command holds", gt=0.0, le=1.0)
    episode_s: float = quantity("s", "Time at which an episode is truncated", gt=0.0)
    reward: RewardName = Field(description="Weights of the cost, by name; null: the study's")
    beside: tuple[BesideConfig, ...] = Field(
        (), max_length=8, description="Vehicles in other environments that learn along, such as on lines"
    )

    @property
    def together(self) -> int:
        """Vehicles of all environments."""
        return self.vehicles + sum(each.vehicles for each in self.beside)


class OutputConfig(Model):
    """What the network's output, -1 to 1, does to the valve command."""

    kind: Literal["command", "change"] = Field(
        description="command: 0 gives the middle, -1 and 1 the ends of a range. change: added to the command "
        "that holds, which the observation must contain"
    )
    middle: float = quantity("-", "Command at output 0, for 'command'", default=0.5, ge=0.0, le=1.0)
    schedule: SpeedScheduleConfig | None = Field(
        None,
        description="Command at output 0 over the observed speed, in place of `middle`: a table, or the name "
        "of a speed-schedule",
    )
    half: float = quantity("-", "Half the range of commands, for 'command'", default=0.5, gt=0.0, le=1.0)
    rate: float = quantity("1/s", "Fastest change of a command, for 'change'", default=1.0, gt=0.0)
    hold: int = Field(1, description="Control periods for which an output holds", strict=True, ge=1, le=1000)

    @field_validator("schedule", mode="before")
    @classmethod
    def _read(cls, given: Any) -> Any:
        if not isinstance(given, str):
            return given
        found = load_controller(given)
        if not isinstance(found, SpeedScheduleConfig):
            raise ValueError(f"'{given}' is no speed-schedule")
        return found.model_dump()

    @model_validator(mode="after")
    def _holds_commands(self) -> OutputConfig:
        if self.kind == "change" and self.hold > 1:
            raise ValueError("hold: needs kind 'command'; slow changes come by a smaller rate")
        if self.kind == "change" and self.schedule is not None:
            raise ValueError("schedule: needs kind 'command'")
        return self

    @model_validator(mode="after")
    def _says_nothing_idle(self) -> OutputConfig:
        """Refuse what would have no effect; a default may be named, as stored policies do."""
        idle = {"rate": "kind 'command'"} if self.kind == "command" else {"half": "kind 'change'"}
        if self.kind == "change" or self.schedule is not None:
            idle["middle"] = "kind 'change'" if self.kind == "change" else "a schedule"
        for name, other in idle.items():
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"{name}: has no effect with {other}")
        return self


class MemoryConfig(Model):
    """What a policy remembers beside the history of its observation: averages over the past seconds."""

    times_s: tuple[Annotated[float, Field(gt=0.0, le=1000.0)], ...] = Field(
        min_length=1, max_length=8, description="Times of the averages (s)"
    )
    inputs: dict[str, InputConfig] = Field(min_length=1, description="How each remembered quantity enters")


class EstimatorConfig(Model):
    """A network that estimates conditions from a policy's inputs; its estimates are further inputs."""

    conditions: dict[str, InputConfig] = Field(
        min_length=1, description="What is estimated: maps of `sayd_env.envs.privileged.CONDITIONS`"
    )
    hidden: tuple[Annotated[int, Field(strict=True, ge=1, le=4096)], ...] = Field(
        max_length=8, description="Units of each hidden layer"
    )


class EstimateConfig(Model):
    """An estimator and how it learns: regression on the true conditions that the simulator tells."""

    conditions: tuple[str, ...] = Field(min_length=1, description="Some of `privileged`")
    hidden: tuple[Annotated[int, Field(strict=True, ge=1, le=4096)], ...] = Field(
        max_length=8, description="Units of each hidden layer"
    )
    learning_rate: float = quantity("-", "Step of Adam", gt=0.0, le=1.0)
    batch_size: int = Field(description="Samples in a minibatch", strict=True, ge=2)


class NetworkConfig(Model):
    """A network of layers that are all connected."""

    hidden: tuple[Annotated[int, Field(strict=True, ge=1, le=4096)], ...] = Field(
        max_length=8, description="Units of each hidden layer; value functions have the same"
    )
    activation: Literal["tanh", "relu"]


class PpoConfig(Model):
    """Settings of PPO, as `stable_baselines3.PPO` calls them."""

    algorithm: Literal["ppo"]
    learning_rate: float = quantity("-", "Step of Adam at the start", gt=0.0, le=1.0)
    anneal: bool = Field(
        False, description="The step falls linearly over `total_steps`, to 0 after the last update"
    )
    n_steps: Count = Field(description="Steps of each vehicle between updates")
    batch_size: int = Field(description="Samples in a minibatch", strict=True, ge=2)
    n_epochs: Count = Field(description="Passes over the samples in an update")
    gae_lambda: float = quantity("-", "Lambda of the generalised advantage", ge=0.0, le=1.0)
    clip_range: float = quantity("-", "Clipping of the ratio of probabilities", gt=0.0)
    ent_coef: float = quantity("-", "Weight of the entropy", ge=0.0)
    vf_coef: float = quantity("-", "Weight of the value's loss", ge=0.0)
    max_grad_norm: float = quantity("-", "Largest norm of a gradient", gt=0.0)
    log_std_init: float = quantity("-", "Logarithm of the first standard deviation of the output")


class SacConfig(Model):
    """Settings of SAC, as `stable_baselines3.SAC` calls them; the entropy's weight is tuned."""

    algorithm: Literal["sac"]
    learning_rate: float = quantity("-", "Step of Adam at the start", gt=0.0, le=1.0)
    anneal: bool = Field(
        False, description="The step falls linearly over `total_steps`, to 0 after the last update"
    )
    buffer_size: Count = Field(description="Steps that are kept")
    learning_starts: int = Field(description="Random steps before learning", strict=True, ge=0)
    batch_size: int = Field(description="Samples in a minibatch", strict=True, ge=2)
    tau: float = quantity("-", "Share of the way that the target networks go", gt=0.0, le=1.0)
    train_freq: Count = Field(description="Steps of each vehicle between updates")
    gradient_steps: Count = Field(description="Updates each time")
    target_entropy: Number = Field(description="Entropy of an output to which its weight is tuned")
    ent_coef_init: float = quantity("-", "First weight of the entropy", default=1.0, gt=0.0)
    n_steps: Count = Field(1, description="Steps whose rewards are added up before the critic is asked")
    use_sde: bool = Field(
        False, description="Explore by a function of the state, which holds for a while, not by white noise"
    )
    sde_sample_freq: int = Field(
        -1, description="Steps after which this function is drawn anew; -1: never", strict=True, ge=-1
    )

    @model_validator(mode="after")
    def _says_nothing_idle(self) -> SacConfig:
        if self.sde_sample_freq != -1 and not self.use_sde:
            raise ValueError("sde_sample_freq: has no effect without use_sde")
        return self


MEANS = {"mean": "J", "geometric": "J_geometric"}
"""Columns of a run's evaluations with the means of J over the scenarios."""


class EvaluationConfig(Model):
    """The scenarios on which a policy is evaluated while it learns: all combinations."""

    every: Count = Field(description="Steps between evaluations")
    speeds_kmh: tuple[Number, ...] = Field(min_length=1, description="Speeds (km/h)")
    wear: tuple[Number, ...] = Field(min_length=1, description="Wear of the treads (-)")
    seeds: tuple[Annotated[int, Field(strict=True, ge=0, lt=1_000_000)], ...] = Field(
        min_length=1, description="Seeds of tracks; those of the training are a million and more"
    )
    initial_current: float = quantity("-", "Valve command of the run-in", ge=0.0, le=1.0)
    episode_s: float = quantity("s", "Time over which J is taken", gt=0.0)
    beside_seeds: tuple[Annotated[int, Field(strict=True, ge=0, lt=1_000_000)], ...] = Field(
        (), description="Seeds of episodes of each environment beside the first, whole as they learn there"
    )
    criterion: Literal["mean", "geometric"] = Field(
        "mean",
        description="Mean of J over the scenarios by which a policy is the best; in the geometric one, rough "
        "and smooth conditions count alike",
    )
    references: tuple[str, ...] = Field((), description="Policies that are evaluated once, to compare with")

    @field_validator("speeds_kmh", "wear", "seeds", "beside_seeds", "references")
    @classmethod
    def _distinct(cls, found: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(set(found)) < len(found):
            raise ValueError("names something twice; it would count twice")
        return found

    @property
    def cases(self) -> list[dict[str, Any]]:
        """All scenarios: the seed and the options of an episode."""
        combinations = product(self.speeds_kmh, self.wear, self.seeds)
        return [{"speed_kmh": speed, "wear": wear, "seed": seed} for speed, wear, seed in combinations]


class CheckpointConfig(Model):
    """How often what has been learned is put on the disk."""

    every: Count = Field(description="Steps between checkpoints")
    keep: Count = Field(description="Checkpoints that are kept")


class TrainConfig(Model):
    """A training: everything but the number of the run."""

    description: str = ""
    seed: int = Field(description="Of weights, exploration and episodes", strict=True, ge=0, lt=1_000_000)
    total_steps: Count = Field(description="Steps of all vehicles together")
    torch_threads: Count = Field(description="Threads of torch; small networks want one")
    discount_s: float = quantity("s", "Time after which a reward counts 1/e", gt=0.0)
    reward_scale: float = quantity(
        "-", "Factor on the reward per second, in multiples of an ordinary J", gt=0.0
    )
    worst_s: float = quantity(
        "s",
        "Largest cost of a control period, in seconds of an ordinary J: bounds that of a derailment",
        gt=0.0,
    )
    environment: LearningEnvironmentConfig
    view: View = Field(
        "vehicle", description="vehicle: one network for all. bogie: the same network for each bogie"
    )
    inputs: dict[str, InputConfig] = Field(min_length=1, description="Quantities that the network sees")
    memory: MemoryConfig | None = Field(None, description="What is remembered; null: nothing")
    clip: float = quantity("-", "Largest input of the network", gt=0.0, le=WIDEST)
    output: OutputConfig
    network: NetworkConfig
    estimate: EstimateConfig | None = Field(None, description="Conditions that are estimated; null: none")
    critic: tuple[str, ...] = Field(
        (), description="Some of `privileged`, which the critic sees beside the policy's inputs"
    )
    privileged: dict[str, InputConfig] = Field(
        {},
        description="True conditions that training may use: maps of `sayd_env.envs.privileged.CONDITIONS`",
    )
    learning: PpoConfig | SacConfig = Field(discriminator="algorithm")
    evaluation: EvaluationConfig
    checkpoint: CheckpointConfig

    @property
    def gamma(self) -> float:
        """Discount of one step."""
        return math.exp(-self.decision_period / self.discount_s)

    @property
    def decision_period(self) -> float:
        """Time for which an output of the network holds (s)."""
        return self.environment.control_period * self.output.hold

    @property
    def networks(self) -> int:
        """Networks at work side by side: steps count each of them."""
        return self.environment.together * (2 if self.view == "bogie" else 1)

    def vehicle_seconds(self, steps: float) -> float:
        """Time on the road of all vehicles together (s) after so many steps."""
        return steps / self.networks * self.environment.together * self.decision_period

    @property
    def update_steps(self) -> int:
        """Steps from one update to the next."""
        learning = self.learning
        return self.networks * (learning.n_steps if isinstance(learning, PpoConfig) else learning.train_freq)

    @field_validator("inputs")
    @classmethod
    def _named(cls, inputs: dict[str, InputConfig]) -> dict[str, InputConfig]:
        for name in inputs:
            if "." in name:
                raise ValueError(f"'{name}' is a signal; expected a quantity, such as '{name.split('.')[0]}'")
        return inputs

    @property
    def estimator(self) -> EstimatorConfig | None:
        """The estimator as a policy needs it."""
        found = self.estimate
        if found is None:
            return None
        conditions = {name: self.privileged[name] for name in found.conditions}
        return EstimatorConfig(conditions=conditions, hidden=found.hidden)

    @model_validator(mode="after")
    def _knows_conditions(self) -> TrainConfig:
        estimated = () if self.estimate is None else self.estimate.conditions
        for key, names in (("estimate.conditions", estimated), ("critic", self.critic)):
            for name in names:
                if name not in self.privileged:
                    raise ValueError(f"{key}: '{name}' is not among privileged")
            if len(set(names)) < len(names):
                raise ValueError(f"{key}: names a condition twice")
        return self

    @model_validator(mode="after")
    def _tells_environments_apart(self) -> TrainConfig:
        names = [each.title for each in self.environment.beside]
        if len(set(names)) < len(names):
            raise ValueError(f"environment.beside: two are named '{max(names, key=names.count)}'")
        if self.evaluation.beside_seeds and not names:
            raise ValueError("evaluation.beside_seeds: has no effect without environment.beside")
        return self

    @model_validator(mode="after")
    def _fits(self) -> TrainConfig:
        learning = self.learning
        if isinstance(learning, PpoConfig) and self.update_steps % learning.batch_size:
            raise ValueError(
                f"learning.batch_size ({learning.batch_size}) must divide n_steps x networks "
                f"({learning.n_steps} x {self.networks})"
            )
        if isinstance(learning, SacConfig) and learning.buffer_size < self.networks:
            raise ValueError(
                f"learning.buffer_size ({learning.buffer_size}) must hold a step of all vehicles"
            )
        first = self.update_steps if isinstance(learning, PpoConfig) else learning.learning_starts + 1
        if self.total_steps < first:
            raise ValueError(
                f"total_steps ({self.total_steps}) makes no update: the first one comes after {first} steps"
            )
        return self


def load_train(name: str = "ppo", overrides: Iterable[str] = ()) -> TrainConfig:
    """Read a training.

    Parameters
    ----------
    name : str
        A packaged training (``ppo``, ``sac``) or a path to a YAML file.
    overrides : iterable of str
        ``key=value`` assignments, applied last, for example ``seed=3``.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used; the message names it and what is allowed.
    """
    config = read_layered(TrainConfig, TRAIN, name, overrides)
    environment = config.environment
    beside = tuple(each.model_copy(update={"name": from_anywhere(each.name)}) for each in environment.beside)
    # A run that goes on elsewhere reads its configuration in its own folder.
    changes = {"name": from_anywhere(environment.name), "beside": beside}
    return config.model_copy(update={"environment": environment.model_copy(update=changes)})


def refuse_changes(begun: TrainConfig, found: TrainConfig, where: str) -> None:
    """Refuse to go on with a run otherwise than it began, but for `MAY_CHANGE`.

    Parameters
    ----------
    begun, found : TrainConfig
        Of the run, and with which it would go on.
    where : str
        What the message begins with.

    Raises
    ------
    ConfigError
        Other differences; the message names each.
    """
    ours, theirs = (_flat(each.model_dump(mode="json")) for each in (begun, found))
    changed = [key for key in sorted(ours | theirs) if ours.get(key) != theirs.get(key)]
    refused = [
        f"{key}: the run has {ours.get(key)!r}, found {theirs.get(key)!r}"
        for key in changed
        if key not in MAY_CHANGE
    ]
    if refused:
        raise ConfigError(f"{where}: {'; '.join(refused)}. Only {', '.join(sorted(MAY_CHANGE))} may change")


def _flat(content: Any, above: str = "") -> dict[str, Any]:
    if not isinstance(content, dict):
        return {above: content}
    return {
        k: v for key, part in content.items() for k, v in _flat(part, f"{above}.{key}".strip(".")).items()
    }
