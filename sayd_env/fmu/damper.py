"""The semi-active damper as a co-simulation unit: its variables, and what its compiled code starts from."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.units import Array
from sayd_env.fmu.variable import INPUT, OUTPUT, PARAMETER, TIME, Variable
from sayd_env.physics import sayd
from sayd_env.physics.coupled import PARAMETERS, at_rest
from sayd_env.physics.plant import LANES

_PARAMETERS = (
    ("rod_mass", "kg", "m_1, piston rod"),
    ("housing_mass", "kg", "m_2, housing"),
    ("bogie_mount.stiffness", "N/m", "c_b1"),
    ("bogie_mount.damping", "N.s/m", "d_b1"),
    ("carbody_mount.stiffness", "N/m", "c_b2"),
    ("carbody_mount.damping", "N.s/m", "d_b2"),
    ("friction.stiction", "N", "F_C, friction at standstill"),
    ("friction.sliding", "N", "F_S, friction while sliding"),
    ("cylinder.area", "m2", "A, piston area less the rod's"),
    ("cylinder.volume_a", "m3", "V_A0, chamber A at stroke 0, dead volume included"),
    ("cylinder.volume_b", "m3", "V_B0, chamber B at stroke 0, dead volume included"),
    ("oil.bulk_modulus", "Pa", "E, effective bulk modulus"),
    ("oil.tank_pressure", "Pa", "Pressure in the tank, absolute"),
    ("bleed", "m3/(s.Pa)", "Conductance from each chamber to the tank"),
    ("failsafe_current", "1", "Current that the unpowered valve's opening corresponds to"),
    ("valve.delay", "s", "Delay of the driver"),
    ("valve.frequency", "rad/s", "omega, undamped natural frequency of the spool"),
    ("valve.damping_ratio", "1", "zeta of the spool"),
    ("valve.rate", "1/s", "Largest rate of the acting current"),
)
"""Name, unit and meaning of each of `sayd_env.physics.coupled.PARAMETERS`."""

_DRY = (sayd.FRICTION_SLIDING, sayd.FRICTION_STICTION)
_ZERO_ALLOWED = (sayd.DAMPING_1, sayd.DAMPING_2, *_DRY, sayd.BLEED, sayd.FAILSAFE, sayd.DRIVER_DELAY)


class DamperModel(NamedTuple):
    """A damper's variables and what its step starts from."""

    variables: tuple[Variable, ...]
    memory: Array
    """(MEMORY,) at rest."""
    table: Array
    """Of `sayd_env.physics.sayd.SaydArrays`."""


def damper_model(config: SaydDamperConfig) -> DamperModel:
    """Describe a damper as a unit.

    Parameters
    ----------
    config : SaydDamperConfig
        Throttle, rectifier, relief and suction valves are baked in; the other numbers become parameters.

    Raises
    ------
    DataError
        A throttle table that cannot be used.
    """
    arrays = sayd.sayd_arrays(config, config.step)
    tank = config.oil.tank_pressure
    variables = [
        Variable("time", "s", "Time", TIME),
        Variable("x_1", "m", "x'_1, displacement of the end on the bogie", INPUT),
        Variable("v_1", "m/s", "v'_1, velocity of the end on the bogie", INPUT),
        Variable("x_2", "m", "x'_2, displacement of the end on the carbody", INPUT),
        Variable("v_2", "m/s", "v'_2, velocity of the end on the carbody", INPUT),
        Variable("current", "1", "Commanded valve current: 0 closed, 1 open", INPUT, config.current),
        Variable("powered", "1", "1 with power, 0 without: the valve goes to failsafe_current", INPUT, 1.0),
        Variable("F_1", "N", "F_1, tension on the piston rod; the bogie gets -F_1", OUTPUT),
        Variable("F_2", "N", "F_2, on the housing; the carbody gets -F_2", OUTPUT),
        Variable("p_A", "Pa", "Pressure in chamber A, absolute", OUTPUT, tank),
        Variable("p_B", "Pa", "Pressure in chamber B, absolute", OUTPUT, tank),
        Variable("stroke", "m", "x_St, stroke of the piston", OUTPUT),
        Variable("acting_current", "1", "Current that the spool's place corresponds to", OUTPUT),
        Variable(
            "motion",
            "1",
            "Ends within a communication step: 0 go on at the velocities of its start, 1 go on as in the "
            "step before, 2 arrive at the inputs, which are those of its end",
            PARAMETER,
            1.0,
            low=0.0,
            high=2.0,
            integer=True,
        ),
        Variable("stroke_start", "m", "Stroke at the ends' displacements at the start", PARAMETER),
    ]
    variables += [
        Variable(
            name,
            unit,
            text,
            PARAMETER,
            float(arrays.constant[row * LANES]),
            low=0.0 if row in _ZERO_ALLOWED else np.finfo(float).tiny,
            high=1.0 if row == sayd.FAILSAFE else math.inf,
        )
        for (name, unit, text), row in zip(_PARAMETERS, PARAMETERS, strict=True)
    ]
    return DamperModel(tuple(variables), at_rest(config, arrays.constant), arrays.table)
