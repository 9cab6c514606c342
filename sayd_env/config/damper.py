"""Schema of the yaw dampers that stand in a vehicle's yaw-damper places."""

from __future__ import annotations

from typing import Literal

from sayd_env.config.vehicle import MaxwellLaw


class PassiveDamperConfig(MaxwellLaw):
    """The passive yaw damper: piecewise-linear damper in series with a spring (paper, section 2.1)."""

    type: Literal["passive"]
    name: str
    description: str = ""
