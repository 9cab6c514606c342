"""The vehicle as a co-simulation unit: our own simulator, stepped in a Python process beside the tool."""

from __future__ import annotations

import math

import numpy as np

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.sensors import DAMPERS, MOUNTS, POINTS
from sayd_env.config.units import KMH, Array
from sayd_env.fmu.variable import INPUT, OUTPUT, PARAMETER, TIME, Variable
from sayd_env.physics import sayd
from sayd_env.physics.layout import longitudinal_rows
from sayd_env.physics.plant import LANES
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.physics.step import advance

_OWN = (
    ("stroke", "m", "Stroke of the vehicle's own damper", sayd.STROKE),
    ("p_A", "Pa", "Pressure in its chamber A, absolute", sayd.PRESSURE_A),
    ("p_B", "Pa", "Pressure in its chamber B, absolute", sayd.PRESSURE_B),
    ("acting_current", "1", "Current that its spool's place corresponds to", sayd.CURRENT),
    ("force", "N", "F_1, its tension on the bogie's side", sayd.FORCE_1),
)

LARGEST_SEED = 2**31 - 1
"""FMI's Integer, which is an xs:int, ends there."""


def vehicle_variables(scenario: Scenario, speed: float, seed: int) -> tuple[Variable, ...]:
    """Variables of a vehicle's unit.

    Parameters
    ----------
    scenario : Scenario
        With semi-active dampers.
    speed : float
        m/s; becomes a parameter.
    seed : int
        Of the track's irregularities; becomes a parameter.

    Raises
    ------
    ConfigError
        Passive dampers: they have no command, and cannot be left to another tool. A speed beyond the
        vehicle's, a seed beyond a unit's numbers.
    """
    damper = scenario.damper
    if not isinstance(damper, SaydDamperConfig):
        raise ConfigError(
            f"damper '{damper.name}': the vehicle's unit needs semi-active dampers: --damper sayd (their "
            "forces can come from outside)"
        )
    low, high = scenario.vehicle.speed_range
    if not low <= speed <= high:
        raise ConfigError(
            f"--speed: found {speed * KMH:g} km/h; vehicle '{scenario.vehicle.name}' runs at "
            f"{low * KMH:g} to {high * KMH:g}"
        )
    if seed > LARGEST_SEED:
        raise ConfigError(f"--seed: found {seed}; a unit's whole numbers end at {LARGEST_SEED}")
    tank = damper.oil.tank_pressure
    inputs = [
        *((f"current.{d}", "1", "Command of the vehicle's own damper", damper.current) for d in DAMPERS),
        *(
            (f"F_1.{d}", "N", "Tension of an outside damper on its rod; the bogie gets -F_1", 0.0)
            for d in DAMPERS
        ),
        *((f"F_2.{d}", "N", "Force of an outside damper's mount on its housing", 0.0) for d in DAMPERS),
    ]
    outputs = [
        *((f"x_1.{d}", "m", "Displacement of a damper's end on the bogie") for d in DAMPERS),
        *((f"v_1.{d}", "m/s", "Velocity of a damper's end on the bogie") for d in DAMPERS),
        *((f"x_2.{d}", "m", "Displacement of a damper's end on the carbody") for d in DAMPERS),
        *((f"v_2.{d}", "m/s", "Velocity of a damper's end on the carbody") for d in DAMPERS),
        *((f"lateral_acceleration.{p}", "m/s2", "Of the bogie frame above a wheelset") for p in POINTS),
        *((f"longitudinal_acceleration.{m}", "m/s2", "Of the bogie frame at its dampers") for m in MOUNTS),
        *((f"track_shift.{p}", "N", "Sum of a wheelset's lateral forces on the rails") for p in POINTS),
        *((f"{name}.{d}", unit, text) for name, unit, text, _ in _OWN for d in DAMPERS),
    ]
    return (
        Variable("time", "s", "Time", TIME),
        *(Variable(name, unit, text, INPUT, start) for name, unit, text, start in inputs),
        *(Variable(n, unit, text, OUTPUT, tank if n[:2] == "p_" else 0.0) for n, unit, text in outputs),
        Variable("speed", "m/s", "Running speed", PARAMETER, speed, low, high),
        Variable(
            "seed",
            "1",
            "Of the track's irregularities",
            PARAMETER,
            float(seed),
            0.0,
            2.0**31 - 1,
            integer=True,
        ),
        Variable(
            "outside_dampers",
            "1",
            "0: the vehicle's own dampers act, on the commands; 1: they are off, and F_1 and F_2 act",
            PARAMETER,
            0.0,
            0.0,
            1.0,
            integer=True,
        ),
    )


class VehicleUnit:
    """A vehicle that a simulation tool steps.

    Parameters
    ----------
    scenario : Scenario
        With semi-active dampers, a vehicle with two bogies.

    Attributes
    ----------
    variables : tuple of Variable
        In the order of the values.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.model = VehicleModel(scenario)
        self.variables = vehicle_variables(scenario, scenario.vehicle.speed_range[0], 0)
        names = [v.name for v in self.variables]
        self._first = {name.partition(".")[0]: i for i, name in reversed(list(enumerate(names)))}
        ends = self.model.multibody.yaw_dampers
        self._bogie = np.array([bogie for _, bogie, _ in ends])
        self._car = np.array([car for _, _, car in ends])
        self._points = longitudinal_rows(self.model.multibody.arrangement)

    def begin(self, value: Array) -> None:
        """Put the vehicle on its track; `value` holds all variables, the outputs are set.

        Raises
        ------
        ConfigError
            A speed outside the vehicle's range.
        """
        speed, seed = float(value[self._first["speed"]]), int(value[self._first["seed"]])
        self._outside = value[self._first["outside_dampers"]] > 0.5
        self._run = Simulator(self.model, speed, seed)
        self._plant = self.model.plant(speed, self._run.track, points=self._points)
        self._work = self.model.work(len(self._points))
        self._static = self._plant.load.copy()
        rows = self._run.state.sayd.reshape(sayd.STATES, LANES)
        if self._outside:
            rows[sayd.ATTACHED] = 0.0
        self._signals = np.zeros(self._run.channels)
        self._write_outputs(value)

    def step(self, h: float, value: Array) -> None:
        """Advance over a communication step (s), over which the inputs hold.

        Raises
        ------
        ConfigError
            A step that is no multiple of the simulator's.
        StudyError
            A derailment, or a state that did not stay finite.
        """
        own, _ = self.model.step(self._run.speed)
        count = round(h / own)
        if count < 1 or abs(h - count * own) > 1e-6 * own:
            raise ConfigError(
                f"found a communication step of {h:g} s; expected a multiple of {own:g} s, the vehicle's "
                "own at this speed (numerics.step)"
            )
        state = self._run.state
        rows = state.sayd.reshape(sayd.STATES, LANES)
        if self._outside:
            first, second = self._input(value, "F_1"), self._input(value, "F_2")
            self._plant.load[:] = self._static - first @ self._bogie - second @ self._car
        else:
            rows[sayd.COMMAND] = np.clip(self._input(value, "current"), 0.0, 1.0)
        none = np.empty((0, 0))
        signals = self._signals[None, :]
        if advance(self._plant, state, self._work, count, signals, none, none, none) < 1:
            raise StudyError(self._run.divergence())
        self._write_outputs(value)

    def _input(self, value: Array, name: str) -> Array:
        return value[self._first[name] : self._first[name] + LANES]

    def _write_outputs(self, value: Array) -> None:
        state, count = self._run.state, len(self.model.multibody.wheelset_x)
        outputs = {
            "x_1": self._bogie @ state.q,
            "v_1": self._bogie @ state.v,
            "x_2": self._car @ state.q,
            "v_2": self._car @ state.v,
            "lateral_acceleration": self._signals[:count],
            "longitudinal_acceleration": self._points @ state.a,
            "track_shift": self._signals[count : 2 * count],
        }
        rows = state.sayd.reshape(sayd.STATES, LANES)
        attached = 0.0 if self._outside else 1.0
        outputs |= {name: rows[row] * (attached if name == "force" else 1.0) for name, _, _, row in _OWN}
        for name, numbers in outputs.items():
            value[self._first[name] : self._first[name] + len(numbers)] = numbers
        if not math.isfinite(float(np.sum(value))):
            raise StudyError(self._run.divergence())
