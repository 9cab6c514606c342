"""What `info` tells of a vehicle: its episode, its cost, its forces and valves."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.envs import trace
from sayd_env.envs.fleet import Fleet
from sayd_env.envs.loop import (
    BOGIES,
    COST_ACCELERATION,
    COST_FORCE,
    NOT_FINITE,
    RAIL_QUOTIENT,
    RAIL_TRACK_SHIFT,
    RUNNING,
)
from sayd_env.envs.running import RunningValues
from sayd_env.envs.trace import DAMPERS, POINTS
from sayd_env.physics.plant import LANES

Array = npt.NDArray[np.float64]


def costs(fleet: Fleet) -> tuple[Array, Array]:
    """Terms of the cost of the last period, unweighted, means of the bogies: new arrays of shape (count,)."""
    terms = fleet.lanes.terms
    acceleration = (terms[:, COST_ACCELERATION] + terms[:, COST_ACCELERATION + 1]) / BOGIES
    force = (terms[:, COST_FORCE] + terms[:, COST_FORCE + 1]) / BOGIES
    if np.count_nonzero(fleet.lanes.status):
        return np.nan_to_num(acceleration, posinf=0.0), np.nan_to_num(force, posinf=0.0)
    return acceleration, force


def of_the_step(fleet: Fleet, i: int) -> dict[str, Any]:
    """Cost and frequency of a vehicle's last period."""
    terms = fleet.lanes.terms[i].tolist()
    acceleration = (terms[COST_ACCELERATION] + terms[COST_ACCELERATION + 1]) / BOGIES
    force = (terms[COST_FORCE] + terms[COST_FORCE + 1]) / BOGIES
    return {
        "cost_acceleration": acceleration if math.isfinite(acceleration) else 0.0,
        "cost_force": force if math.isfinite(force) else 0.0,
        "dominant_frequency": fleet.dominant_frequency()[i],
    }


def of_the_end(fleet: Fleet, i: int) -> dict[str, Any]:
    """Why a vehicle's run ended early; nothing if it did not."""
    status = int(fleet.lanes.status[i])
    if status == RUNNING:
        return {}
    ending = fleet.ending(i)
    return {"ending": ending, "error": ending} if status == NOT_FINITE else {"ending": ending}


def of_the_episode(fleet: Fleet, i: int) -> dict[str, Any]:
    """Conditions of a vehicle's episode."""
    episode, scenario = fleet.episodes[i], fleet.scenario
    assert episode is not None  # the reset has set it
    return {
        "seed": episode.seed,
        "episode": episode.number,
        "speed_kmh": episode.speed * 3.6,
        "wear": scenario.wear if episode.wear is None else episode.wear,
        "friction": scenario.friction if episode.friction is None else episode.friction,
        "track": "of the study" if episode.track is None else episode.track,
        "faults": [fault.model_dump() for fault in episode.faults],
    }


def of_the_vehicle(fleet: Fleet, i: int, running: RunningValues) -> dict[str, Any]:
    """Forces, valves, flow, power and running values of a vehicle at the end of the last period."""
    lanes, limits = fleet.lanes, fleet.limits[i]
    state, row, mean = lanes.state.view(i), lanes.trace[i, -1], lanes.memory.view(i).rail_mean
    acceleration, shift = running.rms()
    told = {
        "damper_force": row[trace.FORCE : trace.FORCE + DAMPERS],
        "track_shift_force": row[trace.TRACK_SHIFT : trace.TRACK_SHIFT + POINTS],
        "wheel_lateral_force": row[trace.WHEEL_LATERAL : trace.WHEEL_LATERAL + LANES],
        "wheel_vertical_force": row[trace.WHEEL_VERTICAL : trace.WHEEL_VERTICAL + LANES],
        "valve_command": lanes.command[i],
        **_hydraulics(fleet, i, state),
        "running_acceleration": acceleration,
        "running_track_shift": shift,
        "mean_quotient": mean[RAIL_QUOTIENT:RAIL_TRACK_SHIFT],
        "mean_track_shift": mean[RAIL_TRACK_SHIFT:],
    }
    finite = {name: np.nan_to_num(value, posinf=0.0, neginf=0.0) for name, value in told.items()}
    return finite | {
        "limit_acceleration": limits.acceleration,
        "limit_track_shift": limits.track_shift_force,
        "limit_quotient": fleet.config.derailment.safe_quotient,
        # The RMS has half of Prud'homme's limit, which holds for the mean.
        "limit_mean_track_shift": 2.0 * limits.track_shift_force,
    }


def _hydraulics(fleet: Fleet, i: int, state: Any) -> dict[str, Array]:
    """Acting current, oil that the piston displaces (m3/s), and power that goes into it (W)."""
    row = fleet.lanes.trace[i, -1]
    if state.sayd.size == 0:
        power = _of_dampers(row, trace.FORCE) * _of_dampers(row, trace.STROKE_RATE)
        still = np.zeros(DAMPERS)
        return {"valve_current": still, "hydraulic_flow": still, "hydraulic_power": power}
    flow = fleet.lanes.loop.view(i).area * _of_dampers(row, trace.STROKE_RATE)
    drop = _of_dampers(row, trace.PRESSURE_A) - _of_dampers(row, trace.PRESSURE_B)
    return {
        "valve_current": _of_dampers(row, trace.VALVE_CURRENT),
        "hydraulic_flow": flow,
        "hydraulic_power": -drop * flow,
    }


def _of_dampers(row: Array, first: int) -> Array:
    return row[first : first + DAMPERS]
