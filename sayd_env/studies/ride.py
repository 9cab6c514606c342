"""One vehicle on its way: a policy commands it, a recorder watches, its cost adds up."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.envs.cost import squares, weighted
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch, checked_actions
from sayd_env.envs.loop import RUNNING
from sayd_env.envs.recorder import WINDOW, Recorder
from sayd_env.envs.rollout import first_state, uses_run_in
from sayd_env.physics.simulator import VehicleModel

COLUMNS = (
    *("time_s", "speed_kmh", "distance_m", "J"),
    *("acceleration_rms_front_m_s2", "acceleration_rms_rear_m_s2"),
    *("force_rms_front_n", "force_rms_rear_n"),
    *("valve_front", "valve_rear"),
)
"""Of `Ride.row`: RMS and J of the last second, means of a bogie's valves."""


class Ride:
    """An episode that goes on step by step.

    Parameters
    ----------
    policy : object
        Something with `make`, as `PolicySpec`, which gets the vehicle's batch.
    scenario : Scenario
        The vehicle, with the yaw dampers that the policy needs.
    environment : EnvironmentConfig
        Sensors, control period, and distributions by which episodes are drawn.
    window : float
        Time that the recorder's frames look back, s.

    Attributes
    ----------
    recorder : Recorder
    steps : int
        Control periods since the last `begin`.
    """

    def __init__(
        self, policy: Any, scenario: Scenario, environment: EnvironmentConfig, window: float = WINDOW
    ) -> None:
        config = environment.model_copy(update={"damper": scenario.damper.type})
        self.batch = EpisodeBatch(config, 1, scenario=scenario, num_threads=1)
        self.policy = policy.make(self.batch)
        self.recorder = Recorder(self.batch, window=window)
        self.steps = 0
        self._scenario = scenario

    def begin(self, seed: int, number: int = 0, options: Mapping[str, Any] | None = None) -> None:
        """Draw an episode and run the vehicle in.

        Parameters
        ----------
        seed, number : int
            Of the episode.
        options : mapping, optional
            As for `draw_episode`.

        Raises
        ------
        ConfigError
            Options that are not allowed, or a speed beyond the vehicle's; nothing has changed then.
        """
        episode = draw_episode(self.batch.config, seed, number, options, self._scenario)
        VehicleModel(self._scenario).check_speed(episode.speed)
        self.batch.reset([0], [episode], keep_run_in=uses_run_in(self.policy))
        self.recorder.begin()
        self._seen, self._shape = self.batch.observations(), (1, self.batch.interface.actions)
        self._state, self._start = first_state(self.policy, self.batch)
        self.steps, self._sums = 0, np.zeros(2)

    @property
    def running(self) -> bool:
        """Whether the vehicle has not derailed or diverged."""
        return int(self.batch.vehicles.status[0]) == RUNNING

    @property
    def seconds(self) -> float:
        """Time since step 0, s."""
        return self.steps * self.batch.config.control_period

    def step(self) -> None:
        """Run a control period."""
        action, self._state = self.policy.predict(self._seen, self._state, self._start, deterministic=True)
        self._start = np.zeros(1, dtype=np.bool_)
        self._seen, _, _, _ = self.batch.step(checked_actions(action, self._shape))
        self.recorder.take()
        self.steps += 1
        self._sums += squares(np.nan_to_num(self.batch.vehicles.terms[0], posinf=0.0))

    def advance(self, seconds: float) -> None:
        """Run up to a time (s), or to the end of a run that ends early."""
        until = round(seconds / self.batch.config.control_period)
        while self.steps < until and self.running:
            self.step()

    def costs(self) -> dict[str, float]:
        """Mean J of eq. (27) since step 0, and its squares of acceleration and force, on-line filter."""
        acceleration, force = (self._sums / self.seconds).tolist() if self.steps else (0.0, 0.0)
        total = weighted(self.batch.scenario.cost, acceleration, force)
        return {"J": total, "J_acceleration": acceleration, "J_force": force}

    def row(self) -> tuple[float | None, ...]:
        """Values of this moment, by `COLUMNS`."""
        frame = self.recorder.frame()
        valves = [None, None] if frame.valve is None else np.asarray(frame.valve[-1], dtype=float).tolist()
        distance = frame.speed * frame.time if frame.place is None else frame.place.distance
        signals = (frame.speed * KMH, distance, frame.cost[-1], *frame.acceleration[-1], *frame.force[-1])
        return (frame.time, *(float(value) for value in signals), *valves)
