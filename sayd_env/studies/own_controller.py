"""A controller of one's own, which opens a bogie's valves the more, the more pressure its dampers hold.

A controller gets what the sensors measure every 10 ms, and answers with valve commands from 0 (closed,
strongest damping) to 1 (open). `controller` makes it for an environment; change `OwnController.command`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

BOGIES = ("front", "rear")
DAMPERS = ("left.upper", "left.lower", "right.upper", "right.lower")


class OwnController:
    """Opens the valves in proportion to the pressure across the pistons.

    Parameters
    ----------
    interface : Interface
        What the controller may know: ``interface.signals`` (each with name, unit, range), ``control_period``
        (s), ``valves`` (here one command for each bogie), ``damper`` (the damper's numbers).
    start : float
        Command without pressure.
    per_bar : float
        By how much more it opens for each bar.
    """

    def __init__(self, interface: Any, start: float = 0.40, per_bar: float = 0.0056) -> None:
        def places(quantity: str) -> npt.NDArray[np.intp]:
            """Where an observation has a quantity of all dampers, shape (bogies, dampers of a bogie)."""
            names = [[f"{quantity}.{bogie}.{damper}" for damper in DAMPERS] for bogie in BOGIES]
            return np.array([[interface.index(name) for name in row] for row in names])

        # Other signals: lateral_acceleration (m/s2), longitudinal_acceleration, stroke (m), current, speed.
        self.pressure_a, self.pressure_b = places("pressure_a"), places("pressure_b")  # Pa
        self.start, self.per_bar = start, per_bar

    def command(self, observation: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
        """Valve commands of both bogies, from one observation or many of them, one a row."""
        across = np.abs(observation[..., self.pressure_a] - observation[..., self.pressure_b])
        bar = across.mean(axis=-1) / 1e5
        return np.asarray(np.clip(self.start + self.per_bar * bar, 0.0, 1.0))

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Act as policies of Stable-Baselines3 do; `state`, None at first, is what it remembers."""
        return self.command(observation).astype(np.float32), state


def controller(interface: Any) -> OwnController:
    """Make the controller for an environment."""
    return OwnController(interface)


# What it needs of its environment, where that is not the usual: here another control period (s) and a
# command for each damper.
# controller.environment = {"control_period": 0.02, "valves": "damper"}
