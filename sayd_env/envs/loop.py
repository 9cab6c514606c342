"""One compiled control period of one vehicle: physics, true signals, cost, sensors, in this order.

Time steps are shorter than samples (1 ms), samples shorter than control periods. At each sample the true
signals are taken; the cost counts them through the on-line filter, the sensors make their readings of them.
What an observer gets is the mean of the readings over the period: integrating sampling, which keeps the
multiples of the control rate out, and by which accelerations add up to exact changes of velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from sayd_env.physics import sayd
from sayd_env.physics.contact.geometry import WIDTH
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import LANES, Plant, State, Work
from sayd_env.physics.stack import vehicle_of
from sayd_env.physics.step import FORCE_Y, FORCE_Z, largest_shift, record, step
from sayd_env.stability.online import Band, BandState, push, replay, retune
from sayd_env.stability.sliding import slide

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

POINTS = 4
"""Measuring points of the lateral acceleration, two on each bogie."""
BOGIES = 2
DAMPERS = 8

# Places of the signals.
LATERAL = 0
LONGITUDINAL = LATERAL + POINTS
PRESSURE_A = LONGITUDINAL + 4
PRESSURE_B = PRESSURE_A + DAMPERS
STROKE = PRESSURE_B + DAMPERS
CURRENT = STROKE + DAMPERS
SPEED = CURRENT + DAMPERS
SIGNALS = SPEED + 1

# Places of the features.
ACCELERATION_RMS = 0
FORCE_RMS = ACCELERATION_RMS + POINTS
FREQUENCY = FORCE_RMS + DAMPERS
FED_BACK = FREQUENCY + BOGIES
COMMANDED = FED_BACK + DAMPERS
FEATURE_SPEED = COMMANDED + DAMPERS
FEATURES = FEATURE_SPEED + 1

# Places of what a period adds up or finds at most.
(
    COST_ACCELERATION,  # mean over a bogie's points of (y / y_lim)^2, over a second's samples: one each bogie
    _,
    COST_FORCE,  # mean over a bogie's dampers of (A (p_A - p_B) / F_max)^2, over a second's samples
    _,
    PEAK_FORCE,  # largest hydraulic force, N
    PEAK_QUOTIENT,  # largest Y/Q of a wheel, mean over the averaging distance
    PEAK_TRACK_SHIFT,  # largest track shift force of a wheelset, mean over the same distance, N
    TERMS,
) = range(8)

# Channels of the forces on the rails that are averaged along the track.
QUOTIENT = 0  # Y/Q of each wheel
TRACK_SHIFT = QUOTIENT + LANES  # of each wheelset, N
RAIL_FORCES = TRACK_SHIFT + POINTS

# Columns of the log: true values at each sample.
LOG_ACCELERATION = 0  # lateral, of the bogie frame above each wheelset, m/s2
LOG_TRACK_SHIFT = LOG_ACCELERATION + POINTS  # N
LOG_FORCE = LOG_TRACK_SHIFT + POINTS  # of each damper on the bogie, N
LOG_HYDRAULIC = LOG_FORCE + DAMPERS  # A (p_A - p_B), N
LOG_CURRENT = LOG_HYDRAULIC + DAMPERS  # acting current
LOG_FILTERED = LOG_CURRENT + DAMPERS  # acceleration behind the on-line filter, m/s2
LOG_BODY = LOG_FILTERED + POINTS  # carbody accelerations of `Loop.body`, m/s2
BODY_ROWS = 9
LOG = LOG_BODY + BODY_ROWS

# How a period ended.
RUNNING, CLIMBED, OVERLOADED, NOT_FINITE = range(4)


class Loop(NamedTuple):
    """Constants of one vehicle's sensors, cost and limits."""

    longitudinal: Array
    """(4, n) rows that give the longitudinal motion of the bogie frames at the damper mounts."""
    body: Array
    """(BODY_ROWS, n) rows that give the carbody's motion: x, y, z above the front bogie, mid, rear bogie."""
    area: float
    """A, m2; 0 with passive dampers, whose force counts as it is."""
    tank: float
    """Pressure that the sensors of passive dampers read, Pa."""
    per_acceleration: float
    """1 / y_lim, s2/m."""
    per_force: float
    """1 / F_max, 1/N."""
    acceleration_weight: float
    """k_y."""
    force_weight: float
    """k_F."""
    quotient_limit: float
    """Mean Y/Q beyond which a wheel is about to climb."""
    averaging: float
    """Samples over which forces on the rails are averaged, at least 1; the last one may count in part."""
    features: float
    """1 if the features are computed, else 0."""
    low: Array
    """(SIGNALS,) lower end of each sensor's range."""
    high: Array
    """(SIGNALS,) upper end."""
    noise: Array
    """(SIGNALS,) RMS of a sample's noise."""
    share: Array
    """(SIGNALS,) share of the way to the true value that a reading goes in a sample: the bandwidth."""
    resolution: Array
    """(SIGNALS,) quantum, 0 for none."""
    hold: Array
    """(SIGNALS,) samples for which a reading is held."""


class LoopState(NamedTuple):
    """State of sensors and counters of one vehicle."""

    counter: Index
    """(2,) samples since step 0, negative during the run-in; periods in the features' ring."""
    filtered: Array
    """(SIGNALS,) behind the sensors' bandwidth."""
    reading: Array
    """(SIGNALS,) last reading."""
    total: Array
    """(SIGNALS,) sum of the readings of the period."""
    gain: Array
    """(SIGNALS,) 1; 0 for a dead sensor."""
    bias: Array
    """(SIGNALS,)."""
    frozen: Array
    """(SIGNALS,) 1 for a sensor that repeats its last reading, else 0."""
    squares: Array
    """(periods in a second, POINTS + DAMPERS) sums of squares of each period, for the features."""
    rail: Array
    """(RAIL_FORCES,) this sample's Y/Q and track shift forces."""
    rail_mean: Array
    """(RAIL_FORCES,) their means over the averaging distance."""
    rail_sum: Array
    """(RAIL_FORCES,) sums over the whole samples of this distance."""
    rail_ring: Array
    """(whole samples of this distance + 1, RAIL_FORCES) their last values."""
    rail_place: Index
    """(1,) row of the oldest ones."""
    true: Array
    """(SIGNALS,) scratch: true values."""
    row: Array
    """(2 POINTS + DAMPERS,) scratch: acceleration, track shift force, damper force."""
    passed: Array
    """(POINTS,) scratch: filtered acceleration."""
    felt: Array
    """(POINTS,) scratch: filtered readings of acceleration."""


@kernel(allocates=False)
def measure(plant: Plant, state: State, work: Work, loop: Loop, memory: LoopState) -> None:
    """Take the true signals of this instant."""
    record(plant, state, work, memory.row)
    true = memory.true
    for k in range(POINTS):
        true[LATERAL + k] = memory.row[k]
    for k in range(4):
        total, g = 0.0, loop.longitudinal[k]
        for i in range(g.shape[0]):
            total += g[i] * state.a[i]
        true[LONGITUDINAL + k] = total
    semi_active = state.sayd.shape[0] > 0
    for k in range(DAMPERS):
        true[PRESSURE_A + k] = state.sayd[sayd.PRESSURE_A * LANES + k] if semi_active else loop.tank
        true[PRESSURE_B + k] = state.sayd[sayd.PRESSURE_B * LANES + k] if semi_active else loop.tank
        true[STROKE + k] = state.sayd[sayd.STROKE * LANES + k] if semi_active else state.elongation[k]
        true[CURRENT + k] = state.sayd[sayd.COIL * LANES + k] if semi_active else 0.0
    true[SPEED] = plant.speed


@kernel(allocates=False)
def hydraulic_force(loop: Loop, memory: LoopState, k: int) -> float:
    """A (p_A - p_B) of a damper, eq. (28), or the force of a passive one."""
    if loop.area == 0.0:
        return float(memory.row[2 * POINTS + k])
    return float(loop.area * (memory.true[PRESSURE_A + k] - memory.true[PRESSURE_B + k]))


@kernel(allocates=False)
def count_cost(loop: Loop, memory: LoopState, per_second: float, terms: Array) -> None:
    """Add this sample's share of the cost of a second, eq. (27), unweighted."""
    for k in range(POINTS):
        scaled = memory.passed[k] * loop.per_acceleration
        terms[COST_ACCELERATION + k * BOGIES // POINTS] += scaled * scaled * (per_second * BOGIES / POINTS)
    for k in range(DAMPERS):
        force = hydraulic_force(loop, memory, k)
        scaled = force * loop.per_force
        terms[COST_FORCE + k * BOGIES // DAMPERS] += scaled * scaled * (per_second * BOGIES / DAMPERS)
        terms[PEAK_FORCE] = max(terms[PEAK_FORCE], abs(force))


@kernel(allocates=False)
def sense(loop: Loop, memory: LoopState, noise: Array, sample: int) -> None:
    """Make the sensors' readings of this sample, and add them to the period's sums."""
    count = memory.counter[0]
    noisy = noise.shape[0] > 0
    for k in range(SIGNALS):
        memory.filtered[k] += loop.share[k] * (memory.true[k] - memory.filtered[k])
        value = memory.gain[k] * memory.filtered[k] + memory.bias[k]
        if noisy:
            value += loop.noise[k] * noise[sample, k]
        value = max(loop.low[k], min(loop.high[k], value))
        quantum = loop.resolution[k]
        if quantum > 0.0:
            value = math.floor(value / quantum + 0.5) * quantum
            value = max(loop.low[k], min(loop.high[k], value))
        fresh = memory.frozen[k] == 0.0 and count % int(loop.hold[k]) == 0
        memory.reading[k] = value if fresh else memory.reading[k]
        memory.total[k] += memory.reading[k]


@kernel(allocates=False)
def count_features(band: Band, felt: BandState, loop: Loop, memory: LoopState) -> None:
    """Add the squares of this sample's band-passed readings and forces to the features' ring."""
    push(band, felt, memory.reading[LATERAL : LATERAL + POINTS], memory.felt)
    squares = memory.squares[memory.counter[1] % memory.squares.shape[0]]
    for k in range(POINTS):
        squares[k] += memory.felt[k] * memory.felt[k]
    for k in range(DAMPERS):
        force = loop.area * (memory.reading[PRESSURE_A + k] - memory.reading[PRESSURE_B + k])
        squares[POINTS + k] += force * force


@kernel(allocates=False)
def write_features(
    band: Band, felt: BandState, memory: LoopState, command: Array, samples: int, out: Array
) -> None:
    """Write the features at the end of a period."""
    window = memory.squares.shape[0]
    for k in range(POINTS + DAMPERS):
        total = 0.0
        for j in range(window):
            total += memory.squares[j, k]
        out[ACCELERATION_RMS + k] = math.sqrt(total / (window * samples))
    for k in range(BOGIES):
        out[FREQUENCY + k] = band.frequency[felt.choice[k]]
    for k in range(DAMPERS):
        out[FED_BACK + k] = memory.reading[CURRENT + k]
        out[COMMANDED + k] = command[k]
    out[FEATURE_SPEED] = memory.reading[SPEED]


@kernel(allocates=False)
def average_rail_forces(work: Work, loop: Loop, memory: LoopState, terms: Array) -> None:
    """Take this sample's Y/Q and track shift forces into their sliding means, and find the largest means."""
    for i in range(2 * POINTS):
        vertical = work.lane_out[FORCE_Z * LANES + i]
        # Towards the flange: the left wheel presses its rail to the left.
        side = 1.0 - 2.0 * (i % 2)
        lateral = -side * work.lane_out[FORCE_Y * LANES + i]
        memory.rail[QUOTIENT + i] = lateral / vertical if vertical > 0.0 else 0.0
    for k in range(POINTS):
        memory.rail[TRACK_SHIFT + k] = memory.row[POINTS + k]
    slide(memory.rail, loop.averaging, memory.rail_place, memory.rail_ring, memory.rail_sum, memory.rail_mean)
    for i in range(2 * POINTS):
        terms[PEAK_QUOTIENT] = max(terms[PEAK_QUOTIENT], memory.rail_mean[QUOTIENT + i])
    for k in range(POINTS):
        terms[PEAK_TRACK_SHIFT] = max(terms[PEAK_TRACK_SHIFT], abs(memory.rail_mean[TRACK_SHIFT + k]))


@kernel(allocates=False)
def judge(plant: Plant, state: State, work: Work, loop: Loop, memory: LoopState, terms: Array) -> int:
    """Say whether the vehicle runs on: finite, no wheel over the rail, no mean Y/Q beyond its limit."""
    if not math.isfinite(memory.row[0] + state.v[0] + memory.true[PRESSURE_A] + memory.passed[0]):
        return NOT_FINITE
    widest = plant.table_start + plant.table_step * (plant.table.shape[0] // WIDTH - 1)
    if largest_shift(plant, work) >= widest:
        return CLIMBED
    average_rail_forces(work, loop, memory, terms)
    # The peak over the period so far: at the first sample beyond the limit the run ends.
    return OVERLOADED if terms[PEAK_QUOTIENT] > loop.quotient_limit else RUNNING


@kernel(allocates=False)
def begin_second(
    band: Band, passed: BandState, felt: BandState, loop: Loop, memory: LoopState, samples: int
) -> None:
    """Look for f_0 at the end of the run-in and of each second.

    At step 0 the features' RMS of the last second is taken anew, in the band that the run-in has shown: that
    of a train which has been running.
    """
    retune(band, passed)
    if loop.features > 0.0:
        retune(band, felt)
        if memory.counter[0] == 0:
            replay(band, felt, samples, memory.counter[1] % memory.squares.shape[0], memory.squares)


@kernel(allocates=False)
def write_log(state: State, loop: Loop, memory: LoopState, row: Array) -> None:
    """Write this sample's true values."""
    for k in range(2 * POINTS + DAMPERS):
        row[LOG_ACCELERATION + k] = memory.row[k]
    for k in range(DAMPERS):
        row[LOG_HYDRAULIC + k] = hydraulic_force(loop, memory, k)
        row[LOG_CURRENT + k] = state.sayd[sayd.CURRENT * LANES + k] if state.sayd.shape[0] > 0 else 0.0
    for k in range(POINTS):
        row[LOG_FILTERED + k] = memory.passed[k]
    for k in range(BODY_ROWS):
        total, g = 0.0, loop.body[k]
        for i in range(g.shape[0]):
            total += g[i] * state.a[i]
        row[LOG_BODY + k] = total


@kernel(allocates=False)
def control_period(
    plant: Plant,
    state: State,
    work: Work,
    loop: Loop,
    memory: LoopState,
    passed: BandState,
    felt: BandState,
    band: Band,
    substeps: int,
    samples: int,
    per_second: int,
    command: Array,
    noise: Array,
    signals: Array,
    features: Array,
    terms: Array,
    log: Array,
) -> int:
    """Run one vehicle over one control period.

    Parameters
    ----------
    plant, state, work : Plant, State, Work
        The vehicle.
    loop, memory : Loop, LoopState
        Its sensors and cost.
    passed, felt : BandState
        On-line filters of the true accelerations and of the accelerometers' readings.
    band : Band
        Their constants.
    substeps, samples, per_second : int
        Steps in a sample, samples in the period, samples in a second.
    command : ndarray, shape (DAMPERS,)
        Valve commands.
    noise : ndarray, shape (samples or 0, SIGNALS)
        Standard normal numbers; empty for none.
    signals, features, terms : ndarray, shapes (SIGNALS,), (FEATURES,), (TERMS,)
        Receive the observation, the features if wanted, and the period's cost.
    log : ndarray, shape (samples or 0, LOG)
        Receives the true values of each sample, unless it is empty.

    Returns
    -------
    int
        RUNNING, or how the run ended.
    """
    for k in range(TERMS):
        terms[k] = 0.0
    for k in range(SIGNALS):
        memory.total[k] = 0.0
    memory.squares[memory.counter[1] % memory.squares.shape[0], :] = 0.0
    if state.sayd.shape[0] > 0:
        for k in range(DAMPERS):
            state.sayd[sayd.COMMAND * LANES + k] = command[k]
    status, taken = RUNNING, 0
    for t in range(samples):
        for _ in range(substeps):
            step(plant, state, work)
        measure(plant, state, work, loop, memory)
        push(band, passed, memory.row[:POINTS], memory.passed)
        count_cost(loop, memory, 1.0 / per_second, terms)
        sense(loop, memory, noise, t)
        if loop.features > 0.0:
            count_features(band, felt, loop, memory)
        if log.shape[0] > 0:
            write_log(state, loop, memory, log[t])
        memory.counter[0] += 1
        taken += 1
        status = judge(plant, state, work, loop, memory, terms)
        if status != RUNNING:
            break
        if memory.counter[0] >= 0 and memory.counter[0] % per_second == 0:
            begin_second(band, passed, felt, loop, memory, samples)
    for k in range(SIGNALS):
        signals[k] = memory.total[k] / taken
    if loop.features > 0.0:
        write_features(band, felt, memory, command, samples, features)
    memory.counter[1] += 1
    return status


@kernel(allocates=False)
def reward(loop: Loop, terms: Array) -> float:
    """Minus the mean of the bogies' J of a period, eq. (27)."""
    total = 0.0
    for k in range(BOGIES):
        total += loop.acceleration_weight * terms[COST_ACCELERATION + k]
        total += loop.force_weight * terms[COST_FORCE + k]
    return -total / BOGIES


def _run_lanes(
    plant: Plant,
    plant_spans: Index,
    state: State,
    state_spans: Index,
    work: Work,
    work_spans: Index,
    loop: Loop,
    loop_spans: Index,
    memory: LoopState,
    memory_spans: Index,
    passed: BandState,
    passed_spans: Index,
    felt: BandState,
    felt_spans: Index,
    band: Band,
    clock: Index,
    periods: Index,
    command: Array,
    noise: Array,
    signals: Array,
    features: Array,
    terms: Array,
    rewards: Array,
    log: Array,
    status: Index,
) -> None:
    """Run v lanes over a number of control periods each, all periods of a call with the same command.

    Parameters
    ----------
    plant, plant_spans, ..., felt, felt_spans
        The vehicles' tuples, by `Stack`. (A parallel loop takes no nested tuples.)
    band : Band
        Constants of the on-line filters.
    clock : ndarray, shape (2 + v,)
        Samples in a period, samples in a second, then each lane's steps in a sample.
    periods : ndarray, shape (v,)
        Control periods for each lane; 0 leaves it alone.
    command, signals, features, terms : ndarray, shapes (v, ...)
        As in `control_period`; those of the last period stay.
    noise : ndarray, shape (v, samples or 0, SIGNALS)
        Serves every period of the call.
    rewards, status : ndarray, shape (v,)
        Receive the reward of the last period and how it ended.
    log : ndarray, shape (v, samples of all periods or 0, LOG)
    """
    for i in numba.prange(periods.shape[0]):
        one_plant, one_state = vehicle_of(plant, plant_spans, i), vehicle_of(state, state_spans, i)
        one_work, one_loop = vehicle_of(work, work_spans, i), vehicle_of(loop, loop_spans, i)
        one_memory = vehicle_of(memory, memory_spans, i)
        one_passed, one_felt = vehicle_of(passed, passed_spans, i), vehicle_of(felt, felt_spans, i)
        samples = clock[0] if log.shape[1] > 0 else 0
        running = periods[i]
        for p in range(periods[i]):
            if p < running:
                status[i] = control_period(
                    one_plant,
                    one_state,
                    one_work,
                    one_loop,
                    one_memory,
                    one_passed,
                    one_felt,
                    band,
                    clock[2 + i],
                    clock[0],
                    clock[1],
                    command[i],
                    noise[i],
                    signals[i],
                    features[i],
                    terms[i],
                    log[i, p * samples : (p + 1) * samples],
                )
                rewards[i] = reward(one_loop, terms[i])
                running = p + 1 if status[i] != RUNNING else running


def _named(function: Callable[..., None], name: str) -> Callable[..., None]:
    """The same function under another name: Numba's cache tells its kernels apart by theirs."""
    copy = FunctionType(function.__code__, function.__globals__, name)
    copy.__qualname__, copy.__doc__, copy.__module__ = name, function.__doc__, function.__module__
    return copy


run_lanes: Any = kernel(announce="the control loop (first use, about 20 s)")(_named(_run_lanes, "run_lanes"))
"""`_run_lanes`, one lane after another."""
run_lanes_in_parallel: Any = kernel(
    parallel=True, announce="the control loop of many vehicles (first use, about 20 s)"
)(_named(_run_lanes, "run_lanes_in_parallel"))
"""`_run_lanes` on all threads: the results are the same bits."""
