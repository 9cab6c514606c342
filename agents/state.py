"""The state of policies that remember, as their `predict` takes and gives it and as ONNX models name it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.explain import shown
from sayd_env.config.units import Array, Array32, Flags
from sayd_env.envs.interface import Interface, RunIn

INPUT, OUTPUT = "observation", "command"
"""Of an ONNX model."""
STATE, NEXT_STATE = "state", "next_state"
"""Of one that remembers: zeros at the start of an episode, then what the call before gave."""


def started(state: Any | None, episode_start: Any | None, count: int, width: int, source: str) -> Array:
    """The state before a call, a new array of shape (count, width): zeros of vehicles that begin.

    Parameters
    ----------
    state : ndarray, shape (count, width), optional
        What the call before returned; None begins.
    episode_start : array_like of bool, shape (count,), optional
        Vehicles that begin an episode.
    count, width : int
        Vehicles, and numbers of one's state.
    source : str
        Names the policy in the message.

    Raises
    ------
    ConfigError
        A state of another shape.
    """
    if state is None:
        return np.zeros((count, width))
    try:
        before = np.array(state, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(
            f"{source}: state: found {shown(state)}; expected what the last call returned"
        ) from None
    if before.shape != (count, width):
        raise ConfigError(
            f"{source}: found a state of shape {before.shape}; expected {(count, width)}, what the call "
            "before has returned"
        )
    if episode_start is not None:
        before[np.broadcast_to(np.asarray(episode_start, dtype=np.bool_), (count,))] = 0.0
    return before


def run_in_periods(run_in: RunIn, interface: Interface) -> Iterator[tuple[Flags, Array32]]:
    """Vehicles on their way to step 0, and what they observed, period by period.

    Of a history these are the two newest rows, which is all that memories read. The last observation is left
    out: it comes with the first call of a policy.

    Yields
    ------
    own : ndarray of bool, shape (count,)
        Vehicles whose run-in has begun.
    seen : ndarray of float32, shape (own, *interface.shape)
    """
    count = run_in.observations.shape[1]
    seen = np.zeros((count, *interface.shape), dtype=np.float32)
    for p in range(1, len(run_in.observations) - 1):
        seen[:, -2:] = run_in.observations[p - 1 : p + 1].swapaxes(0, 1)
        own = run_in.begins < p
        yield own, seen[own]
