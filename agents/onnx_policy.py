"""Policies as ONNX models, ours or others', run by onnxruntime."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.agents.policy_archive import read_bytes, shown_path
from sayd_env.agents.state import NEXT_STATE, OUTPUT, STATE, run_in_periods, started
from sayd_env.config import ConfigError, DataError
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.explain import shown
from sayd_env.config.units import Array, Array32
from sayd_env.envs.episode_batch import checked_actions
from sayd_env.envs.interface import Interface, RunIn


@dataclass(frozen=True, eq=False)
class OnnxPolicy:
    """Content of an ONNX file."""

    where: str
    content: bytes
    needs: Mapping[str, Any]
    """Keywords of the environments in which it can act; empty for a model that does not say."""
    signals: tuple[str, ...] = ()
    """Names of what it observes, in order; empty for a model that does not say."""
    remembered: int = 0
    """Numbers, the first ones of its state, that come from what it has observed, in the run-in as well."""
    piston_area: float | None = None
    """Of the damper whose pressures it takes for forces, m2; None for a model that does not say."""

    def identity(self) -> str:
        """SHA-256 of the file."""
        return hashlib.sha256(self.content).hexdigest()

    def bound(self, interface: Interface) -> OnnxRunner:
        """The model, ready to act in an environment.

        Raises
        ------
        ConfigError
            It takes other observations, or says that it needs another environment or damper.
        """
        interface.check(self.where, self.needs, self.signals)
        damper = interface.damper
        own = damper.cylinder.area if isinstance(damper, SaydDamperConfig) else None
        if None not in (own, self.piston_area) and own != self.piston_area:
            raise ConfigError(
                f"{self.where}: takes pressures for forces of a piston of {self.piston_area:g} m2, found one "
                f"of {own:g} m2; the .npz of the policy fits any damper"
            )
        return (RememberingRunner if self.remembered else OnnxRunner)(self, interface)


def read_onnx(path: Path) -> OnnxPolicy:
    """Read an ONNX file; its metadata, as `agents.export` writes it, says what environment it needs.

    Raises
    ------
    ConfigError
        No such file, or onnxruntime is not installed.
    DataError
        It is no ONNX model, or its metadata cannot be used.
    """
    where, content = shown_path(path), read_bytes(path)
    metadata = _session(content, where).get_modelmeta().custom_metadata_map
    if "observation" not in metadata:
        return OnnxPolicy(where, content, {})
    try:
        needs = {
            "observation": metadata["observation"],
            "valves": metadata["valves"],
            "control_period": float(metadata["control_period"]),
        }
        rows = {"history": int(metadata["history"])} if metadata["observation"] == "history" else {}
        signals = tuple(metadata["signals"].split())
        remembered = int(metadata.get("remembered", 0))
        area = float(metadata["piston_area"]) if "piston_area" in metadata else None
    except (KeyError, ValueError) as error:
        raise DataError(f"{where}: its metadata cannot be used ({shown(str(error))})") from None
    return OnnxPolicy(where, content, needs | rows, signals, remembered, area)


def _session(content: bytes, where: str) -> Any:
    try:
        import onnxruntime  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise ConfigError(
            f"{where}: onnxruntime is not installed; install it with pip install 'sayd-env[onnx]'"
        ) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no common base
        raise DataError(f"{where}: is no ONNX model that runs here ({shown(str(error))})") from None


class OnnxRunner:
    """An ONNX model with the `predict` of all policies.

    Parameters
    ----------
    policy : OnnxPolicy
    interface : Interface
        The environment's.

    Raises
    ------
    ConfigError
        The model takes other observations.
    """

    def __init__(self, policy: OnnxPolicy, interface: Interface) -> None:
        self.name, self.interface, self._where = Path(policy.where).stem, interface, policy.where
        self._session = _session(policy.content, policy.where)
        inputs = self._session.get_inputs()
        self._width = _state_width(inputs, self._session.get_outputs())
        seen = [each for each in inputs if not self._width or each.name != STATE]
        flat = (int(np.prod(interface.shape)),)
        shapes = [
            shape
            for shape in (interface.shape, flat)
            if len(seen) == 1 and _fits(tuple(seen[0].shape), shape)
        ]
        if not shapes or seen[0].type != "tensor(float)":
            raise ConfigError(
                f"{self._where}: takes {', '.join(f'{each.type} {each.shape}' for each in inputs)}; the "
                f"environment's observation '{interface.observation}' is float32 of shape (N, "
                f"{', '.join(map(str, interface.shape))})"
            )
        self._input, self._shape = seen[0].name, shapes[0]

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Any | None = None,
        episode_start: Any | None = None,
        deterministic: bool = True,
    ) -> tuple[Array32, Any]:
        """Valve commands for the next control period, as `agents.policy_file.LearnedPolicy.predict`.

        The state is that of a model with an input ``state`` and an output ``next_state``; else there is none.

        Raises
        ------
        ConfigError
            An observation or a state of another shape, or a model that gives no valve commands.
        """
        values, single = self.interface.rows(observation, self._where)
        rows = values.astype(np.float32).reshape(-1, 1, *self._shape)
        before = started(state, episode_start, len(rows), self._width, self._where)
        # Row by row: the bits of a vehicle's commands must not depend on how many are side by side.
        found = [self._command(row, memory) for row, memory in zip(rows, before[:, None], strict=True)]
        actions = np.concatenate([action for action, _ in found])
        after = np.concatenate([memory for _, memory in found]) if self._width else None
        return (actions[0] if single else actions), after

    def _command(self, row: Array32, memory: Array) -> tuple[Array32, Array]:
        given = {self._input: row} | ({STATE: memory} if self._width else {})
        try:
            found, *after = self._session.run([OUTPUT, NEXT_STATE] if self._width else None, given)
            action = checked_actions(found, (1, self.interface.actions)).astype(np.float32)
            return action, (after[0] if self._width else memory)
        except ConfigError as error:
            raise ConfigError(f"{self._where}: {error}") from None
        except Exception as error:
            raise ConfigError(f"{self._where}: {shown(str(error))}") from None


class RememberingRunner(OnnxRunner):
    """A model that remembers what it has observed, and takes the run-in."""

    def __init__(self, policy: OnnxPolicy, interface: Interface) -> None:
        super().__init__(policy, interface)
        self._remembered = policy.remembered
        if not 0 < self._remembered <= self._width:
            raise ConfigError(
                f"{self._where}: remembers {self._remembered} numbers in a state of {self._width}"
            )
        if interface.history < 2:
            raise ConfigError(
                f"{self._where}: remembers observations; it needs observation=history of 2 or more"
            )

    def state_after(self, run_in: RunIn) -> Array:
        """State at step 0 after a run-in."""
        count = run_in.observations.shape[1]
        memory = np.zeros((count, self._width))
        for own, seen in run_in_periods(run_in, self.interface):
            memory[own] = self.predict(seen, memory[own])[1]
            memory[:, self._remembered :] = 0.0  # an output that is held begins at step 0
        return memory


def _state_width(inputs: Any, outputs: Any) -> int:
    """Numbers of the state of a model that remembers, as `agents.export` writes it; 0 for any other."""
    shapes = {each.name: each.shape for each in inputs}
    remembers = STATE in shapes and NEXT_STATE in {each.name for each in outputs}
    width = shapes[STATE][-1] if remembers else 0
    return width if isinstance(width, int) else 0


def _fits(found: tuple[Any, ...], shape: tuple[int, ...]) -> bool:
    """Whether a model takes one observation at a time; names of dimensions stand for any number."""
    expected = (1, *shape)
    return len(found) == len(expected) and all(
        not isinstance(a, int) or a == b for a, b in zip(found, expected, strict=True)
    )
