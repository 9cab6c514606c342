"""A policy that gives commands in turn, at times that are known beforehand."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sayd_env.config.units import Array32
from sayd_env.envs.interface import Interface
from sayd_env.runs.policies import PolicySpec


@dataclass(frozen=True)
class Schedule:
    """Gives commands in turn to all valves, each for so many seconds: what a `PolicySpec` can hold.

    The state of the policy is the number of control periods so far.
    """

    commands: tuple[float, ...]
    """0 to 1."""
    until: tuple[float, ...]
    """Time from step 0 at which each of them ends, s; the last one stays."""
    interface: Interface | None = None
    """Of the vehicles, once it is bound to them."""
    where: str = "schedule"
    needs: Mapping[str, Any] = field(default_factory=lambda: {"damper": "sayd"})
    name = "schedule"

    def identity(self) -> Any:
        """What changes with its content."""
        return {"schedule": [self.commands, self.until]}

    def bound(self, interface: Interface) -> Schedule:
        """The policy for vehicles with this interface."""
        return replace(self, interface=interface)

    def predict(
        self,
        observation: Any,
        state: Any | None = None,
        episode_start: Any | None = None,
        deterministic: bool = True,
    ) -> tuple[Array32, int]:
        """Commands for N vehicles, which have all begun together."""
        assert self.interface is not None  # it is bound
        period = 0 if state is None else int(state)
        time = (period + 0.5) * self.interface.control_period
        command = self.commands[bisect_right(self.until, time, hi=len(self.until) - 1)]
        shape = (len(observation), self.interface.actions)
        return np.full(shape, command, dtype=np.float32), period + 1


def schedule_spec(commands: Sequence[float], ends: Sequence[float], label: str) -> PolicySpec:
    """The policy of commands in turn, each until a time from step 0 (s)."""
    content = Schedule(tuple(map(float, commands)), tuple(map(float, ends)))
    return PolicySpec("schedule", label=label, stored=content)
