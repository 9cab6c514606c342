"""Learned policies on the disk: one file of weights and a description, that holds no code.

The file is an ``.npz`` archive: NumPy arrays of the weights, and beside them the text ``policy.yaml``, which
says how the network is built, what it sees and what it commands. Reading it unpickles nothing, and neither
reading nor running it needs torch.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import yaml
from pydantic import Field
from sayd_env.agents.bogie_encoding import make_encoding
from sayd_env.agents.config import InputConfig, NetworkConfig, OutputConfig, View
from sayd_env.agents.disk import write_file
from sayd_env.agents.encoding import Encoding, Observation
from sayd_env.agents.products import layer

from sayd_env.config import DataError, Model, parse_yaml, quantity, validate
from sayd_env.config.assessment import load_assessment
from sayd_env.config.control import load_online
from sayd_env.config.damper import load_sayd
from sayd_env.config.errors import ConfigError
from sayd_env.envs.interface import Interface, Signal

Array = npt.NDArray[np.float64]
Layers = tuple[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]], ...]

DESCRIPTION = "policy.yaml"
LARGEST = 256 * 2**20
"""Bytes that a file may unpack to."""
_FIRST_DAY = (1980, 1, 1, 0, 0, 0)  # the same policy is the same file, whenever it is written


class PolicyDescription(Model):
    """What a policy is, beside its weights."""

    format: Literal[1] = Field(description="Version of this format")
    name: str = Field(min_length=1)
    observation: Literal["signals", "history", "features"]
    signals: tuple[str, ...] = Field(min_length=1, description="Signals of a vector, in order")
    history: int = Field(strict=True, ge=1, description="Vectors in an observation")
    valves: Literal["bogie", "damper", "vehicle"]
    control_period: float = quantity("s", "Time for which a command holds", gt=0.0)
    view: View = "vehicle"
    inputs: dict[str, InputConfig] = Field(min_length=1)
    clip: float = quantity("-", "Largest input of the network", gt=0.0)
    output: OutputConfig
    network: NetworkConfig
    squash: Literal["tanh", "clip"] = Field(description="What keeps the output within -1 and 1")
    made: dict[str, Any] = Field({}, description="Where it comes from: configuration, versions, evaluation")


@dataclass(frozen=True, eq=False)
class StoredPolicy:
    """Content of a policy file."""

    description: PolicyDescription
    layers: Layers
    """Weights (out, in) and biases (out) of each layer."""
    source: str = "policy"
    """Where it was read, for messages."""

    def bound(self, interface: Interface) -> LearnedPolicy:
        """The policy, ready to act in an environment.

        Raises
        ------
        ConfigError
            The policy has learned from other signals, commands or another clock.
        """
        return LearnedPolicy(self, interface)


def describe(interface: Interface, **content: Any) -> PolicyDescription:
    """Description of a policy for an environment; what is not told by its interface comes by keyword."""
    return PolicyDescription(
        format=1,
        observation=interface.observation,
        signals=tuple(signal.name for signal in interface.signals),
        history=interface.history,
        valves=interface.valves,
        control_period=interface.control_period,
        **content,
    )


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
    stream = io.BytesIO()
    arrays: dict[str, Any] = {}
    for i, (weight, bias) in enumerate(policy.layers):
        arrays |= {f"weight_{i}": weight, f"bias_{i}": bias}
    np.savez(stream, **arrays)
    text = yaml.safe_dump(policy.description.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr(zipfile.ZipInfo(DESCRIPTION, _FIRST_DAY), text)
    return stream.getvalue()


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
        There is no such file.
    DataError
        The file is damaged, is no policy, or holds weights that do not fit its description.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from None
    try:
        text, arrays = _unpacked(content)
    except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, OSError, NotImplementedError):
        raise DataError(
            f"{path}: is damaged or no policy; expected an archive of '{DESCRIPTION}' and weights, as "
            "'sayd train' and 'sayd export' write it"
        ) from None
    where = f"{path}: {DESCRIPTION}"
    description = validate(PolicyDescription, parse_yaml(text, where), where)
    return StoredPolicy(description, _layers(description, arrays, str(path)), str(path))


def load_policy(path: Path | str, interface: Interface) -> LearnedPolicy:
    """Read a policy and make it ready to act in an environment.

    Raises
    ------
    ConfigError, DataError
        See `read_policy` and `StoredPolicy.bound`.
    """
    return read_policy(path).bound(interface)


def _unpacked(content: bytes) -> tuple[str, dict[str, Any]]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        if sum(member.file_size for member in archive.infolist()) > LARGEST:
            raise ValueError("too large")
        text = archive.read(DESCRIPTION).decode()
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return text, {name: file[name] for name in file.files if name != DESCRIPTION}


def _layers(description: PolicyDescription, arrays: Mapping[str, Any], source: str) -> Layers:
    """The weights, checked against the description."""
    widths = _widths(description)
    expected: dict[str, tuple[int, ...]] = {}
    for i, (before, after) in enumerate(pairwise(widths)):
        expected |= {f"weight_{i}": (after, before), f"bias_{i}": (after,)}
    found = {name: np.shape(value) for name, value in arrays.items()}
    if found != expected:
        raise DataError(f"{source}: found weights of shapes {found}; the description asks for {expected}")
    for name, value in arrays.items():
        if value.dtype != np.float32 or not np.all(np.isfinite(value)):
            raise DataError(f"{source}: {name}: expected finite numbers of type float32")
    return tuple((arrays[f"weight_{i}"], arrays[f"bias_{i}"]) for i in range(len(widths) - 1))


def _widths(description: PolicyDescription) -> list[int]:
    """Units from the inputs to the outputs."""
    encoding = _encoding(description, interface_like(description))
    return [encoding.size, *description.network.hidden, encoding.actions]


def _encoding(description: PolicyDescription, interface: Interface) -> Encoding:
    return make_encoding(
        interface, description.view, description.inputs, description.clip, description.output
    )


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
        _check(description, interface, stored.source)
        self.name = description.name
        self.parameters = description
        self.interface = interface
        self.encoding = _encoding(description, interface)
        self.sensors = self.encoding.sensors
        # In double precision, so that the number of vehicles side by side does not show in the commands.
        self.layers = [
            (np.ascontiguousarray(weight.T, dtype=np.float64), bias.astype(np.float64))
            for weight, bias in stored.layers
        ]
        self._activate = np.tanh if description.network.activation == "tanh" else _relu
        self._squash = description.squash == "tanh"

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Any | None = None,
        episode_start: Any | None = None,
        deterministic: bool = True,
    ) -> tuple[Observation, None]:
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
        rows, single = self.encoding.rows(observation)
        commands = self.encoding.decode(self.outputs(self.encoding.encode(rows)), rows)
        return (commands[0] if single else commands), None

    def outputs(self, inputs: Observation) -> Array:
        """What the network makes of its inputs, a row for each; `Encoding.decode` cuts it off at -1 and 1."""
        values = inputs.astype(np.float64)
        for weight, bias in self.layers[:-1]:
            values = self._activate(layer(values, weight, bias))
        values = layer(values, *self.layers[-1])
        outputs: Array = np.tanh(values) if self._squash else values
        return outputs


def _relu(values: Array) -> Array:
    positive: Array = np.maximum(values, 0.0)
    return positive


def _check(description: PolicyDescription, interface: Interface, source: str) -> None:
    """Refuse an environment with other signals, commands or another clock."""
    for name in ("observation", "history", "valves", "control_period"):
        mine, found = getattr(description, name), getattr(interface, name)
        if mine != found:
            raise ConfigError(
                f"{source}: the policy has learned with {name}={mine!r}, the environment has {found!r}"
            )
    signals = tuple(signal.name for signal in interface.signals)
    if signals != description.signals:
        place = next(
            (i for i, (a, b) in enumerate(zip(signals, description.signals, strict=False)) if a != b),
            min(len(signals), len(description.signals)),
        )
        mine = description.signals[place] if place < len(description.signals) else "nothing"
        theirs = signals[place] if place < len(signals) else "nothing"
        raise ConfigError(
            f"{source}: the policy has learned from other signals: number {place} was {mine}, here it is "
            f"{theirs}"
        )
