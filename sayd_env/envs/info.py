"""Contents of `info`: a vehicle's episode, cost, forces and valves."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.config.conditions import Line
from sayd_env.config.units import KMH, Array
from sayd_env.envs import trace
from sayd_env.envs.cost import squares
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.loop import (
    BOGIES,
    COST_ACCELERATION,
    COST_FORCE,
    NOT_FINITE,
    RAIL_QUOTIENT,
    RAIL_TRACK_SHIFT,
    RUNNING,
)
from sayd_env.envs.sliding_rms import SlidingRms
from sayd_env.envs.trace import DAMPERS, POINTS
from sayd_env.physics.plant import LANES

NO_PERIOD = 0.0
"""What the costs of a period are at a reset, when there has been none."""


def period_info(batch: EpisodeBatch, i: int) -> dict[str, Any]:
    """Cost of a vehicle's last period, its frequency and place; why its run ended early, if it did."""
    terms, begun = batch.vehicles.terms[i].tolist(), batch.elapsed[i] > 0
    acceleration = (terms[COST_ACCELERATION] + terms[COST_ACCELERATION + 1]) / BOGIES
    force = (terms[COST_FORCE] + terms[COST_FORCE + 1]) / BOGIES
    status = int(batch.vehicles.status[i])
    return {
        "cost_acceleration": acceleration if begun and math.isfinite(acceleration) else NO_PERIOD,
        "cost_force": force if begun and math.isfinite(force) else NO_PERIOD,
        "dominant_frequency": batch.dominant_frequency()[i],
        "distance": float(batch.distance()[i]),
        "speed": float(batch.vehicles.trace[i, -1, trace.SPEED]),
        "ending": "" if status == RUNNING else batch.ending(i),
        "error": batch.ending(i) if status == NOT_FINITE else "",
    }


def period_infos(batch: EpisodeBatch) -> dict[str, npt.NDArray[Any]]:
    """`period_info` of all vehicles at once: new arrays with a row for each."""
    status, costs = batch.vehicles.status, np.array(squares(batch.vehicles.terms))
    costs[~(np.isfinite(costs) & (batch.elapsed > 0))] = NO_PERIOD
    ending, error = np.full((2, batch.count), "", dtype=object)
    for i in map(int, np.flatnonzero(status)):
        ending[i] = batch.ending(i)
        error[i] = ending[i] if status[i] == NOT_FINITE else ""
    return {
        "cost_acceleration": costs[0],
        "cost_force": costs[1],
        "dominant_frequency": batch.dominant_frequency(),
        "distance": batch.distance(),
        "speed": batch.vehicles.trace[:, -1, trace.SPEED].copy(),
        "ending": ending,
        "error": error,
    }


def episode_info(batch: EpisodeBatch, i: int) -> dict[str, Any]:
    """Conditions of a vehicle's episode; the key `episode` is that of Gymnasium's statistics."""
    episode, scenario = batch.episodes[i], batch.scenario
    assert episode is not None  # the reset has set it
    wheel = scenario.wheel if episode.wheel is None else episode.wheel
    track = "of the study" if episode.track is None else episode.track
    gauge = scenario.track.gauge if episode.gauge is None else episode.gauge
    friction = scenario.friction if episode.friction is None else episode.friction
    line = batch.lines[i]
    if line is not None:  # what it says, where it begins
        track = "of the line" if line.tracks else track
        gauge = gauge if line.gauge is None else float(line.gauge.at(0.0))
        friction = friction if line.friction is None else float(line.friction.at(0.0))
    return {
        "seed": episode.seed,
        "episode_number": episode.number,
        "speed_kmh": float(episode.speed * KMH),
        "profile": wheel.name if episode.profile is None else episode.profile,
        "wheel_shift": float(wheel.shift if episode.wheel_shift is None else episode.wheel_shift),
        "gauge": float(gauge),
        "wear": float(scenario.wear if episode.wear is None else episode.wear),
        "friction": float(friction),
        "track": track,
        "line": _line_name(episode.line),
        # A text, for it has one type whatever is in it: what collects infos can keep no lists of mappings.
        "faults": json.dumps([fault.model_dump(mode="json") for fault in episode.faults]),
    }


def _line_name(line: object) -> str:
    """Name or path of an episode's line; "drawn" and "given" where it has none, "" where there is no line."""
    if line is None or isinstance(line, str):
        return line or ""
    return "drawn" if isinstance(line, Line) else "given"


def vehicle_info(batch: EpisodeBatch, i: int, sliding: SlidingRms) -> dict[str, Any]:
    """Forces, valves, flow, power and sliding RMS values of a vehicle at the end of the last period."""
    vehicles, limits = batch.vehicles, batch.limits[i]
    state, row, mean = vehicles.state.view(i), vehicles.trace[i, -1], vehicles.memory.view(i).rail_mean
    acceleration, shift = sliding.rms()
    values_of = {
        "damper_force": row[trace.FORCE : trace.FORCE + DAMPERS],
        "track_shift_force": row[trace.TRACK_SHIFT : trace.TRACK_SHIFT + POINTS],
        "wheel_lateral_force": row[trace.WHEEL_LATERAL : trace.WHEEL_LATERAL + LANES],
        "wheel_vertical_force": row[trace.WHEEL_VERTICAL : trace.WHEEL_VERTICAL + LANES],
        "valve_command": vehicles.command[i],
        **_hydraulics(batch, i, state),
        "sliding_rms_acceleration": acceleration,
        "sliding_rms_track_shift": shift,
        "mean_quotient": mean[RAIL_QUOTIENT:RAIL_TRACK_SHIFT],
        "mean_track_shift": mean[RAIL_TRACK_SHIFT:],
    }
    finite = {name: np.nan_to_num(value, posinf=0.0, neginf=0.0) for name, value in values_of.items()}
    return (
        finite
        | line_info(batch, i)
        | {
            "limit_acceleration": limits.acceleration,
            "limit_track_shift": limits.track_shift_force,
            "limit_quotient": batch.config.derailment.safe_quotient,
            "limit_mean_track_shift": limits.mean_track_shift,
        }
    )


def line_info(batch: EpisodeBatch, i: int) -> dict[str, Any]:
    """What lies along the way where a vehicle is; without a line what its episode has."""
    vehicles, line, distance = batch.vehicles, batch.lines[i], float(batch.distance()[i])
    found: dict[str, Any] = {
        "line_section": "",
        "line_curvature": 0.0,
        "line_cant": 0.0,
        "line_gauge": vehicles.vehicle(i).gauge,
        "line_friction": vehicles.vehicle(i).friction,
    }
    if line is None:
        return found
    knots = {
        "line_curvature": line.curvature,
        "line_cant": line.cant,
        "line_gauge": line.gauge,
        "line_friction": line.friction,
    }
    values = {name: float(each.at(distance)) for name, each in knots.items() if each is not None}
    return found | {"line_section": line.section_at(distance).name} | values


def _hydraulics(batch: EpisodeBatch, i: int, state: Any) -> dict[str, Array]:
    """Acting current, oil that the piston displaces (m3/s), and power that goes into it (W)."""
    row = batch.vehicles.trace[i, -1]
    if state.sayd.size == 0:
        power = _of_dampers(row, trace.FORCE) * _of_dampers(row, trace.STROKE_RATE)
        still = np.zeros(DAMPERS)
        return {"valve_current": still, "hydraulic_flow": still, "hydraulic_power": power}
    flow = batch.vehicles.loop.view(i).area * _of_dampers(row, trace.STROKE_RATE)
    drop = _of_dampers(row, trace.PRESSURE_A) - _of_dampers(row, trace.PRESSURE_B)
    return {
        "valve_current": _of_dampers(row, trace.VALVE_CURRENT),
        "hydraulic_flow": flow,
        "hydraulic_power": -drop * flow,
    }


def _of_dampers(row: Array, first: int) -> Array:
    return row[first : first + DAMPERS]
