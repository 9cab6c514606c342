"""Learned policies on the disk: one file of weights and a description, that holds no code.

The file is an ``.npz`` archive: NumPy arrays of the weights, and beside them the text ``policy.yaml``, which
says how the network is built, what it sees and what it commands. Reading it unpickles nothing, and neither
reading nor running it needs torch.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import yaml
from pydantic import AfterValidator, Field, field_validator

from sayd_env.agents.bogie_encoding import make_encoding
from sayd_env.agents.config import EstimatorConfig, MemoryConfig, NetworkConfig, OutputConfig, View
from sayd_env.agents.encoding import Encoding, VehicleEncoding
from sayd_env.agents.policy_archive import PolicyArchive, pack, shown_path
from sayd_env.agents.products import layer
from sayd_env.agents.state import started
from sayd_env.config import Model, quantity, validate
from sayd_env.config.assessment import load_assessment
from sayd_env.config.control import CONTROLLERS, load_online
from sayd_env.config.damper import load_sayd
from sayd_env.config.environment import LONGEST_HISTORY, whole_period
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import shown
from sayd_env.config.learner import WIDEST, InputConfig
from sayd_env.config.storage import write_file
from sayd_env.config.units import Array, Array32
from sayd_env.envs.interface import Interface, RunIn, Signal
from sayd_env.envs.scaled import Scaling

Layers = tuple[tuple[Array32, Array32], ...]

Weights = list[tuple[Array, Array]]
"""The same in double precision, (in, out)."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_NORMALISATION = ("input_middle", "input_half")
_ESTIMATOR = "estimator_"
"""Begins the names of the arrays of the network that estimates."""


def checked_name(name: str) -> str:
    """The name of a learned policy, after which files are called.

    Raises
    ------
    ValueError
        It has other characters than letters, digits and ``_ . -``, more than 64, or is a controller's.
    """
    if not NAME.fullmatch(name):
        raise ValueError(f"found {shown(name)}; a policy's name has at most 64 letters, digits and _ . -")
    if name in CONTROLLERS:
        raise ValueError(f"found '{name}', which is a controller's name")
    return name


class PolicyDescription(Model):
    """What a policy is, beside its weights."""

    format: Literal[1] = Field(description="Version of this format")
    name: Annotated[str, AfterValidator(checked_name)]
    observation: Literal["signals", "history", "features"]
    signals: tuple[Annotated[str, Field(max_length=64)], ...] = Field(
        min_length=1, max_length=256, description="Signals of a vector, in order"
    )
    history: int = Field(strict=True, ge=1, le=LONGEST_HISTORY, description="Vectors in an observation")
    valves: Literal["bogie", "damper", "vehicle"]
    control_period: float = quantity("s", "Time for which a command holds", gt=0.0, le=1.0)
    view: View = "vehicle"
    inputs: dict[str, InputConfig] = Field(min_length=1)
    memory: MemoryConfig | None = Field(None, description="What is remembered beside the observation")
    clip: float = quantity("-", "Largest input of the network", gt=0.0, le=WIDEST)
    output: OutputConfig
    network: NetworkConfig
    estimate: EstimatorConfig | None = Field(
        None, description="Conditions that a second network estimates: further inputs of the policy's"
    )
    squash: Literal["tanh", "clip"] = Field(description="What keeps the output within -1 and 1")
    made: dict[str, Any] = Field({}, description="Where it comes from: configuration, versions, evaluation")

    @field_validator("control_period")
    @classmethod
    def _divides_a_second(cls, period: float) -> float:
        return whole_period(period)


@dataclass(frozen=True, eq=False)
class StoredPolicy:
    """Content of a policy file."""

    description: PolicyDescription
    layers: Layers
    """Weights (out, in) and biases (out) of each layer."""
    where: str = "policy"
    """Where it was read, for messages."""
    normalisation: tuple[Array, Array] | None = None
    """Middle and half of each number of an observation, in place of those of its quantity."""
    estimator: Layers = ()
    """Layers of the network that estimates conditions, if there is one."""

    @property
    def needs(self) -> dict[str, Any]:
        """Keywords of the environments in which it can act."""
        needs = self.description.model_dump(include={"observation", "valves", "control_period", "history"})
        if needs["observation"] != "history":
            del needs["history"]
        return needs

    @property
    def algorithm(self) -> str | None:
        """How it was trained, if it says so."""
        found = self.made("config", "learning", "algorithm")
        return found if isinstance(found, str) else None

    @property
    def seed(self) -> int | None:
        """Of its training, if it says so."""
        found = self.made("config", "seed")
        return found if isinstance(found, int) else None

    @property
    def environment_version(self) -> Any:
        """`sayd_env.envs.registration.VERSION` of its training, if it says where it was trained."""
        trained = self.made("environment_sha256") is not None
        return self.description.made.get("environment_version", 0 if trained else None)

    def made(self, *keys: str) -> Any:
        """What nested keys say about where it comes from; None if they say nothing."""
        content: Any = self.description.made
        for key in keys:
            content = content.get(key) if isinstance(content, Mapping) else None
        return content

    def identity(self) -> str:
        """SHA-256 of all that it is."""
        return hashlib.sha256(policy_bytes(self)).hexdigest()

    def bound(self, interface: Interface) -> LearnedPolicy:
        """The policy, ready to act in an environment.

        Raises
        ------
        ConfigError
            The policy has learned from other signals, commands or another clock.
        """
        about = self.description
        remembers = about.memory is not None or about.output.hold > 1
        return (RememberingPolicy if remembers else LearnedPolicy)(self, interface)

    def encoding(self, interface: Interface) -> Encoding:
        """What its network sees and commands in an environment.

        Raises
        ------
        ConfigError
            Inputs or outputs that do not fit the environment.
        """
        about = self.description
        try:
            encoding = make_encoding(
                interface, about.view, about.inputs, about.clip, about.output, about.memory
            )
        except ConfigError as error:
            raise ConfigError(f"{self.where}: {error}") from None
        if self.normalisation is not None and isinstance(encoding, VehicleEncoding):
            middle, half = self.normalisation
            encoding.scaling = Scaling(middle, half, about.clip, encoding.scaling.logarithmic)
        return encoding


def describe(interface: Interface, where: str = "policy", **content: Any) -> PolicyDescription:
    """Description of a policy for an environment; what its interface does not say comes by keyword.

    Raises
    ------
    ConfigError
        Content that is not allowed; the message begins with `where`.
    """
    known = {
        "format": 1,
        "observation": interface.observation,
        "signals": tuple(signal.name for signal in interface.signals),
        "history": interface.history,
        "valves": interface.valves,
        "control_period": interface.control_period,
    }
    return validate(PolicyDescription, known | content, where)


def interface_like(description: PolicyDescription) -> Interface:
    """An interface that a policy fits where there is no environment; ranges and limits are unknown to it."""
    return Interface(
        observation=description.observation,
        signals=tuple(Signal(name, "", -np.inf, np.inf) for name in description.signals),
        history=description.history,
        valves=description.valves,
        control_period=description.control_period,
        damper=load_sayd("sayd"),
        acceleration_limit=np.nan,
        force_reference=np.nan,
        online=load_online(),
        assessment=load_assessment(),
    )


def policy_bytes(policy: StoredPolicy) -> bytes:
    """Content of a policy's file."""
    arrays: dict[str, Any] = {}
    for of, layers in (("", policy.layers), (_ESTIMATOR, policy.estimator)):
        for i, (weight, bias) in enumerate(layers):
            arrays |= {f"{of}weight_{i}": weight, f"{of}bias_{i}": bias}
    arrays |= dict(zip(_NORMALISATION, policy.normalisation or (), strict=False))
    text = yaml.safe_dump(policy.description.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    return pack(text, arrays)


def save_policy(path: Path, policy: StoredPolicy) -> None:
    """Write a policy; the file is complete or as it was before.

    Raises
    ------
    StudyError
        It cannot be written.
    """
    write_file(path, policy_bytes(policy))


def read_policy(path: Path | str) -> StoredPolicy:
    """Read a policy. Nothing in the file is run.

    Raises
    ------
    ConfigError
        There is no such file, or its description is not allowed.
    DataError
        The file is damaged, is no policy, or holds weights that do not fit its description.
    """
    archive, where = PolicyArchive(Path(path)), shown_path(path)
    description = validate(PolicyDescription, archive.description(), f"{where}: policy.yaml")
    policy = StoredPolicy(description, (), where)
    encoding = policy.encoding(interface_like(description))
    estimated = () if description.estimate is None else tuple(description.estimate.conditions)
    widths = [encoding.size + len(estimated), *description.network.hidden, encoding.actions]
    expected = _shapes("", widths)
    if description.estimate is not None:
        expected |= _shapes(_ESTIMATOR, [encoding.size, *description.estimate.hidden, len(estimated)])
    if archive.optional(_NORMALISATION) and isinstance(encoding, VehicleEncoding):
        rows = () if description.observation != "history" else (description.history,)
        expected |= dict.fromkeys(_NORMALISATION, ((*rows, len(encoding.columns)), "float64"))
    arrays = archive.arrays(expected)
    layers = _layers(arrays, "")
    estimator = _layers(arrays, _ESTIMATOR)
    middle, half = (arrays.get(name) for name in _NORMALISATION)
    normalisation = None if middle is None or half is None else (middle, half)
    return StoredPolicy(description, layers, where, normalisation, estimator)


def _shapes(of: str, widths: list[int]) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape and type of the arrays of a network with so many inputs, units and outputs."""
    found: dict[str, tuple[tuple[int, ...], str]] = {}
    for i, (before, after) in enumerate(pairwise(widths)):
        found |= {f"{of}weight_{i}": ((after, before), "float32"), f"{of}bias_{i}": ((after,), "float32")}
    return found


def _layers(arrays: Mapping[str, Any], of: str) -> Layers:
    count = sum(name.startswith(f"{of}weight_") for name in arrays)
    return tuple((arrays[f"{of}weight_{i}"], arrays[f"{of}bias_{i}"]) for i in range(count))


def load_policy(path: Path | str, interface: Interface) -> LearnedPolicy:
    """Read a policy and make it ready to act in an environment.

    Raises
    ------
    ConfigError, DataError
        See `read_policy` and `StoredPolicy.bound`.
    """
    return read_policy(path).bound(interface)


class LearnedPolicy:
    """A learned policy, run by NumPy, with the `predict` of all policies.

    Parameters
    ----------
    stored : StoredPolicy
    interface : Interface
        The environment's.

    Raises
    ------
    ConfigError
        The policy has learned from other signals, commands or another clock.

    Attributes
    ----------
    name : str
    parameters : PolicyDescription
    sensors : tuple of str
        Signals that it reads.
    """

    def __init__(self, stored: StoredPolicy, interface: Interface) -> None:
        description = stored.description
        interface.check(stored.where, stored.needs, description.signals)
        self.name = description.name
        self.parameters = description
        self.interface = interface
        self.encoding = stored.encoding(interface)
        self.sensors = self.encoding.sensors
        self.layers, self.estimator = _in_double(stored.layers), _in_double(stored.estimator)
        self._activate = np.tanh if description.network.activation == "tanh" else _relu
        self._squash = description.squash == "tanh"

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Any | None = None,
        episode_start: Any | None = None,
        deterministic: bool = True,
    ) -> tuple[Array32, Any]:
        """Valve commands for the next control period.

        Parameters
        ----------
        observation : array_like, shape (obs) or (N, obs)
            What one vehicle or N vehicles observe, in SI units.
        state, episode_start, deterministic
            Without effect: the policy remembers nothing and draws no random numbers.

        Returns
        -------
        action : ndarray of float32, shape (A,) or (N, A)
            Valve commands V: 0 closed, 1 open.
        state : None

        Raises
        ------
        ConfigError
            An observation of another shape.
        """
        values, single = self.interface.rows(observation, self.name)
        rows = values.astype(np.float32)
        commands = self.encoding.decode(self.outputs(self.encoding.encode(rows)), rows)
        return (commands[0] if single else commands), None

    def outputs(self, inputs: Array32) -> Array:
        """What the network makes of its inputs, a row for each; `Encoding.decode` cuts it off at -1 and 1."""
        values = inputs.astype(np.float64)
        if self.estimator:
            values = np.concatenate([values, self.estimates(inputs)], axis=1)
        values = self._through(self.layers, values)
        outputs: Array = np.tanh(values) if self._squash else values
        return outputs

    def estimates(self, inputs: Array32) -> Array:
        """Conditions as they are estimated from inputs, as the maps of the description make them."""
        clip = self.parameters.clip
        return np.clip(self._through(self.estimator, inputs.astype(np.float64)), -clip, clip)

    def _through(self, layers: Weights, values: Array) -> Array:
        for weight, bias in layers[:-1]:
            values = self._activate(layer(values, weight, bias))
        return layer(values, *layers[-1])


class RememberingPolicy(LearnedPolicy):
    """A learned policy with a state: what it remembers of each vehicle, and the output that it holds.

    The state is an array of shape (N, memory_width), behind it, where outputs hold for several periods, the
    periods since the last one and the outputs.
    """

    def __init__(self, stored: StoredPolicy, interface: Interface) -> None:
        super().__init__(stored, interface)
        self.hold = stored.description.output.hold
        held = self.encoding.units * self.encoding.actions
        self.width = self.encoding.memory_width + (1 + held if self.hold > 1 else 0)

    def state_after(self, run_in: RunIn) -> Array:
        """State at step 0 after a run-in."""
        state = np.zeros((run_in.observations.shape[1], self.width))
        state[:, : self.encoding.memory_width] = self.encoding.memory_after(run_in)
        return state

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Any | None = None,
        episode_start: Any | None = None,
        deterministic: bool = True,
    ) -> tuple[Array32, Any]:
        """Valve commands for the next control period.

        Parameters
        ----------
        observation : array_like, shape (obs) or (N, obs)
            What one vehicle or N vehicles observe, in SI units.
        state : ndarray, shape (N, width), optional
            What the call before returned; None begins.
        episode_start : array_like of bool, shape (N,), optional
            Vehicles that begin an episode: what was remembered of them is dropped.
        deterministic
            Without effect: the policy draws no random numbers.

        Returns
        -------
        action : ndarray of float32, shape (A,) or (N, A)
            Valve commands V: 0 closed, 1 open.
        state : ndarray, shape (N, width)

        Raises
        ------
        ConfigError
            An observation or a state of another shape.
        """
        values, single = self.interface.rows(observation, self.name)
        rows = values.astype(np.float32)
        before = started(state, episode_start, len(rows), self.width, self.name)
        split, after = self.encoding.memory_width, np.empty_like(before)
        memory = after[:, :split] = self.encoding.remember(before[:, :split], rows)
        outputs = self.outputs(self.encoding.encode(rows, memory))
        if self.hold > 1:
            elapsed, held = before[:, split], before[:, split + 1 :]
            outputs = np.where(elapsed[:, None] == 0.0, outputs.reshape(held.shape), held)
            after[:, split], after[:, split + 1 :] = (elapsed + 1.0) % self.hold, outputs
        commands = self.encoding.decode(outputs, rows)
        return (commands[0] if single else commands), after


def _in_double(layers: Layers) -> Weights:
    """Layers in double precision, so that the number of vehicles side by side shows in no command."""
    return [
        (np.ascontiguousarray(weight.T, dtype=np.float64), bias.astype(np.float64)) for weight, bias in layers
    ]


def _relu(values: Array) -> Array:
    positive: Array = np.maximum(values, 0.0)
    return positive
