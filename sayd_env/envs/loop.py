"""One compiled control period: physics, true signals, cost, sensors, in this order.

Time steps are shorter than samples (1 ms), samples shorter than control periods. The physics of several
vehicles runs side by side and writes down each sample's true signals (`sayd_env.envs.trace`); then they
are looked at for one vehicle after another. The cost counts them through the on-line filter, the sensors
make their readings of them. What an observer gets is the mean of the readings over the period: integrating
sampling, which keeps the multiples of the control rate out, and by which accelerations add up to exact
changes of velocity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sayd_env.config.units import Array, Integers
from sayd_env.envs import trace
from sayd_env.envs.trace import BODY_ROWS, DAMPERS, POINTS, command_valves, trace_period
from sayd_env.physics.formation import References, interleave, plant_of, put_back, state_of, work_of
from sayd_env.physics.kernel import kernel, named
from sayd_env.physics.plant import LANES, Plant, State, Work
from sayd_env.physics.ragged import Matrix, vehicle_from
from sayd_env.physics.rows import ABREAST, SINGLE, Lanes
from sayd_env.stability.online import Band, BandState, follow_speed, push, replay, retune
from sayd_env.stability.sliding import add_up, slide

BOGIES = 2

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
RAIL_QUOTIENT = 0  # Y/Q of each wheel
RAIL_TRACK_SHIFT = RAIL_QUOTIENT + LANES  # of each wheelset, N
RAIL_FORCES = RAIL_TRACK_SHIFT + POINTS

# Columns of the log: true values at each sample.
LOG_ACCELERATION = 0  # lateral, of the bogie frame above each wheelset, m/s2
LOG_TRACK_SHIFT = LOG_ACCELERATION + POINTS  # N
LOG_FORCE = LOG_TRACK_SHIFT + POINTS  # of each damper on the bogie, N
LOG_HYDRAULIC = LOG_FORCE + DAMPERS  # A (p_A - p_B), N
LOG_CURRENT = LOG_HYDRAULIC + DAMPERS  # acting current
LOG_FILTERED = LOG_CURRENT + DAMPERS  # acceleration behind the on-line filter, m/s2
LOG_BODY = LOG_FILTERED + POINTS  # carbody accelerations of `trace.BODY`, m/s2
LOG = LOG_BODY + BODY_ROWS

# How a period ended.
RUNNING, CLIMBED, OVERLOADED, NOT_FINITE = range(4)


class Loop(NamedTuple):
    """Constants of one vehicle's sensors, cost and limits."""

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
    """Distance over which forces on the rails are averaged, m."""
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

    counter: Integers
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
    squares: Matrix
    """(periods in a second, POINTS + DAMPERS) sums of squares of each period, for the features."""
    averaging: Array
    """(1,) samples over this distance, at least 1; the last one may count in part."""
    rail: Array
    """(RAIL_FORCES,) this sample's Y/Q and track shift forces."""
    rail_mean: Array
    """(RAIL_FORCES,) their means over the averaging distance."""
    rail_sum: Array
    """(RAIL_FORCES,) sums over the whole samples of this distance."""
    rail_ring: Matrix
    """(whole samples of this distance at the lowest speed + 1, RAIL_FORCES) their last values."""
    rail_place: Integers
    """(1,) row that the next ones take."""
    true: Array
    """(SIGNALS,) scratch: true values."""
    passed: Array
    """(POINTS,) scratch: filtered acceleration."""
    felt: Array
    """(POINTS,) scratch: filtered readings of acceleration."""


@kernel(allocates=False)
def take_signals(row: Array, loop: Loop, memory: LoopState) -> None:
    """Take the true signals from a row of the trace."""
    true = memory.true
    for k in range(POINTS):
        true[LATERAL + k] = row[trace.ACCELERATION + k]
        true[LONGITUDINAL + k] = row[trace.LONGITUDINAL + k]
    passive = loop.area == 0.0
    for k in range(DAMPERS):
        true[PRESSURE_A + k] = loop.tank if passive else row[trace.PRESSURE_A + k]
        true[PRESSURE_B + k] = loop.tank if passive else row[trace.PRESSURE_B + k]
        true[STROKE + k] = row[trace.STROKE + k]
        true[CURRENT + k] = 0.0 if passive else row[trace.COIL_CURRENT + k]
    true[SPEED] = row[trace.SPEED]


@kernel(allocates=False)
def hydraulic_force(row: Array, loop: Loop, k: int) -> float:
    """A (p_A - p_B) of a damper, eq. (28), or the force of a passive one."""
    if loop.area == 0.0:
        return float(row[trace.FORCE + k])
    return float(loop.area * (row[trace.PRESSURE_A + k] - row[trace.PRESSURE_B + k]))


@kernel(allocates=False)
def count_cost(row: Array, loop: Loop, memory: LoopState, per_second: float, terms: Array) -> None:
    """Add this sample's share of the cost of a second, eq. (27), unweighted."""
    for k in range(POINTS):
        scaled = memory.passed[k] * loop.per_acceleration
        terms[COST_ACCELERATION + k * BOGIES // POINTS] += scaled * scaled * (per_second * BOGIES / POINTS)
    for k in range(DAMPERS):
        force = hydraulic_force(row, loop, k)
        scaled = force * loop.per_force
        terms[COST_FORCE + k * BOGIES // DAMPERS] += scaled * scaled * (per_second * BOGIES / DAMPERS)
        terms[PEAK_FORCE] = max(terms[PEAK_FORCE], abs(force))


@kernel(allocates=False)
def sense(loop: Loop, memory: LoopState, noise: Array, sample: int) -> None:
    """Make the sensors' readings of this sample, and add them to the period's sums."""
    noisy = noise.shape[0] > 0
    _read(
        float(memory.counter[0]),
        noisy,
        noise[sample] if noisy else memory.true,
        loop.noise,
        loop.share,
        loop.low,
        loop.high,
        loop.resolution,
        loop.hold,
        memory.gain,
        memory.bias,
        memory.frozen,
        memory.true,
        memory.filtered,
        memory.reading,
        memory.total,
    )


@kernel(distinct=True, allocates=False)
def _read(
    count: float,
    noisy: bool,
    random: Array,
    spread: Array,
    share: Array,
    low: Array,
    high: Array,
    resolution: Array,
    hold: Array,
    gain: Array,
    bias: Array,
    frozen: Array,
    true: Array,
    filtered: Array,
    reading: Array,
    total: Array,
) -> None:
    """Readings of all sensors; without branches, so that they become vector instructions."""
    for k in range(true.shape[0]):
        behind = filtered[k] + share[k] * (true[k] - filtered[k])
        filtered[k] = behind
        value = gain[k] * behind + bias[k]
        value += spread[k] * random[k] if noisy else -0.0  # adding this leaves all numbers as they are
        least, most, last = low[k], high[k], reading[k]
        value = value if value < most else most
        value = value if value > least else least
        quantum = resolution[k]
        whole = np.floor(value / (quantum if quantum > 0.0 else 1.0) + 0.5) * quantum
        whole = whole if whole < most else most
        whole = whole if whole > least else least
        value = whole if quantum > 0.0 else value
        held = count - np.floor(count / hold[k]) * hold[k] + frozen[k]
        last = value if held == 0.0 else last
        reading[k] = last
        total[k] += last


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
def average_rail_forces(row: Array, loop: Loop, memory: LoopState, terms: Array) -> None:
    """Take this sample's Y/Q and track shift forces into their sliding means, and find the largest means."""
    for i in range(2 * POINTS):
        vertical = row[trace.WHEEL_VERTICAL + i]
        # Towards the flange: the left wheel presses its rail to the left.
        side = 1.0 - 2.0 * (i % 2)
        lateral = side * row[trace.WHEEL_LATERAL + i]
        memory.rail[RAIL_QUOTIENT + i] = lateral / vertical if vertical > 0.0 else 0.0
    for k in range(POINTS):
        memory.rail[RAIL_TRACK_SHIFT + k] = row[trace.TRACK_SHIFT + k]
    slide(
        memory.rail,
        memory.averaging[0],
        memory.rail_place,
        memory.rail_ring,
        memory.rail_sum,
        memory.rail_mean,
    )
    for i in range(2 * POINTS):
        terms[PEAK_QUOTIENT] = max(terms[PEAK_QUOTIENT], memory.rail_mean[RAIL_QUOTIENT + i])
    for k in range(POINTS):
        terms[PEAK_TRACK_SHIFT] = max(terms[PEAK_TRACK_SHIFT], abs(memory.rail_mean[RAIL_TRACK_SHIFT + k]))


@kernel(allocates=False)
def judge(row: Array, loop: Loop, memory: LoopState, terms: Array) -> int:
    """Say whether the vehicle runs on: finite, no wheel over the rail, no mean Y/Q beyond its limit."""
    felt = row[trace.ACCELERATION] + row[trace.PULSE] + row[trace.PRESSURE_A] + memory.passed[0]
    if not math.isfinite(felt):
        return NOT_FINITE
    if row[trace.CLIMB] >= 1.0:
        return CLIMBED
    average_rail_forces(row, loop, memory, terms)
    # The peak over the period so far: at the first sample beyond the limit the run ends.
    return OVERLOADED if terms[PEAK_QUOTIENT] > loop.quotient_limit else RUNNING


@kernel(allocates=False)
def begin_second(
    band: Band,
    passed: BandState,
    felt: BandState,
    loop: Loop,
    memory: LoopState,
    samples: int,
    per_second: int,
    speed: float,
) -> None:
    """Look for f_0 at the end of the run-in and of each second, and take distances at the present speed.

    At step 0 the features' RMS of the last second is taken anew, in the band that the run-in has shown: that
    of a train which has been running.
    """
    averaging = max(1.0, loop.averaging / speed * per_second)
    if averaging != memory.averaging[0] and averaging < memory.rail_ring.shape[0]:
        memory.averaging[0] = averaging
        add_up(averaging, memory.rail_place, memory.rail_ring, memory.rail_sum)
    for group in range(BOGIES):
        follow_speed(band, passed, group, speed)
        follow_speed(band, felt, group, speed)
    retune(band, passed)
    if loop.features > 0.0:
        retune(band, felt)
        if memory.counter[0] == 0:
            replay(band, felt, samples, memory.counter[1] % memory.squares.shape[0], memory.squares)


@kernel(allocates=False)
def write_log(row: Array, loop: Loop, memory: LoopState, log: Array) -> None:
    """Write this sample's true values."""
    for k in range(2 * POINTS + DAMPERS):
        log[LOG_ACCELERATION + k] = row[trace.ACCELERATION + k]
    for k in range(DAMPERS):
        log[LOG_HYDRAULIC + k] = hydraulic_force(row, loop, k)
        log[LOG_CURRENT + k] = row[trace.VALVE_CURRENT + k]
    for k in range(POINTS):
        log[LOG_FILTERED + k] = memory.passed[k]
    for k in range(BODY_ROWS):
        log[LOG_BODY + k] = row[trace.BODY + k]


@kernel(allocates=False)
def observe_period(
    rows: Array,
    loop: Loop,
    memory: LoopState,
    passed: BandState,
    felt: BandState,
    band: Band,
    per_second: int,
    command: Array,
    noise: Array,
    signals: Array,
    features: Array,
    terms: Array,
    log: Array,
) -> int:
    """Look at one vehicle's control period: cost, sensors, limits.

    Parameters
    ----------
    rows : ndarray, shape (samples, TRACE)
        The period's true values; the last row becomes that at which the run ended, if it did.
    loop, memory : Loop, LoopState
        The vehicle's sensors and cost.
    passed, felt : BandState
        On-line filters of the true accelerations and of the accelerometers' readings.
    band : Band
        Their constants.
    per_second : int
        Samples in a second.
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
    samples = rows.shape[0]
    status, taken = RUNNING, 0
    for t in range(samples):
        row = rows[t]
        take_signals(row, loop, memory)
        push(band, passed, row[trace.ACCELERATION : trace.ACCELERATION + POINTS], memory.passed)
        count_cost(row, loop, memory, 1.0 / per_second, terms)
        sense(loop, memory, noise, t)
        if loop.features > 0.0:
            count_features(band, felt, loop, memory)
        if log.shape[0] > 0:
            write_log(row, loop, memory, log[t])
        memory.counter[0] += 1
        taken += 1
        status = judge(row, loop, memory, terms)
        if status != RUNNING:
            break
        if memory.counter[0] >= 0 and memory.counter[0] % per_second == 0:
            begin_second(band, passed, felt, loop, memory, samples, per_second, row[trace.SPEED])
    # What is reported of a run that has ended is its last sample, whatever the period went on to.
    for j in range(rows.shape[1]):
        rows[samples - 1, j] = rows[taken - 1, j]
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


class Period(NamedTuple):
    """What goes into a call and comes out of it, for v vehicles."""

    command: Array
    """(v, DAMPERS) valve commands, for all periods of the call."""
    noise: Array
    """(v, samples or 0, SIGNALS) standard normal numbers, for every period of the call."""
    trace: Array
    """(v, samples, TRACE) receives the last period's true values."""
    signals: Array
    """(v, SIGNALS), (v, FEATURES), (v, TERMS): those of the last period stay, as in `observe_period`."""
    features: Array
    terms: Array
    rewards: Array
    """(v,) receives the reward of the last period."""
    log: Array
    """(v, samples of all periods or 0, LOG)."""
    status: Integers
    """(v,) receives how the last period ended."""


loop_of = vehicle_from(Loop)
memory_of = vehicle_from(LoopState)
filters_of = vehicle_from(BandState)


class OnBoard(NamedTuple):
    """What looks at the vehicles of a batch: each one's tuples by `RaggedBatch`."""

    loops: References
    memories: References
    passed: References
    felt: References


@kernel(allocates=False)
def _observe(i: int, p: int, on_board: OnBoard, band: Band, per_second: int, period: Period) -> None:
    """Look at period p of vehicle i."""
    loop = loop_of(on_board.loops, i)
    samples = period.trace.shape[1] if period.log.shape[1] > 0 else 0
    period.status[i] = observe_period(
        period.trace[i],
        loop,
        memory_of(on_board.memories, i),
        filters_of(on_board.passed, i),
        filters_of(on_board.felt, i),
        band,
        per_second,
        period.command[i],
        period.noise[i],
        period.signals[i],
        period.features[i],
        period.terms[i],
        period.log[i, p * samples : (p + 1) * samples],
    )
    period.rewards[i] = reward(loop, period.terms[i])


@kernel(allocates=False)
def _run(
    lanes: Lanes,
    plant: Plant,
    states: References,
    together: State,
    work: Work,
    members: Integers,
    substeps: int,
    periods: Integers,
    on_board: OnBoard,
    band: Band,
    per_second: int,
    period: Period,
) -> None:
    """Run vehicles side by side over each one's number of control periods, or to the end of its run.

    `members` loses those that have arrived.
    """
    longest = np.int64(0)
    for k in range(len(lanes)):
        if members[k] >= 0:
            longest = max(longest, periods[members[k]])
            command_valves(lanes, k, together, period.command[members[k]])
    for p in range(longest):
        trace_period(lanes, plant, together, work, members, substeps, period.trace)
        for k in range(len(lanes)):
            i = members[k]
            if i >= 0:
                _observe(i, p, on_board, band, per_second, period)
                if p + 1 == periods[i] or period.status[i] != RUNNING:
                    put_back(lanes, k, states, i, together)
                    members[k] = -1


def _run_units(
    groups: Integers | None,
    members: Integers | None,
    alone: Integers | None,
    plants: References,
    states: References,
    works: References,
    group_plants: References,
    group_states: References,
    group_works: References,
    substeps: Integers,
    periods: Integers,
    on_board: OnBoard,
    band: Band,
    per_second: int,
    period: Period,
) -> None:
    """Run vehicles over a number of control periods each, all periods of a call with the same command.

    Parameters
    ----------
    groups, members, alone
        Who runs, one of `sayd_env.physics.formation.calls`: where groups or vehicles alone are None, their
        half of the loop is not compiled.
    plants, states, works, group_plants, group_states, group_works
        From `Formation.arguments`.
    substeps : ndarray, shape (v,)
        Each vehicle's steps in a sample.
    periods : ndarray, shape (v,)
        Control periods for each vehicle that runs, at least 1.
    on_board : OnBoard
    band : Band
        Constants of the on-line filters.
    per_second : int
        Samples in a second.
    period : Period
    """
    first_alone = 0 if groups is None else groups.shape[0]
    count = first_alone + (0 if alone is None else alone.shape[0])
    for u in numba.prange(count):
        if u < first_alone:
            if groups is not None and members is not None:
                g, who = groups[u], members[u].copy()
                together = state_of(group_states, g)
                interleave(ABREAST, who, states, together)
                plant, work, each = plant_of(group_plants, g), work_of(group_works, g), substeps[np.max(who)]
                _run(
                    ABREAST,
                    plant,
                    states,
                    together,
                    work,
                    who,
                    each,
                    periods,
                    on_board,
                    band,
                    per_second,
                    period,
                )
        elif alone is not None:
            who = alone[u - first_alone : u - first_alone + 1].copy()
            i = who[0]
            plant, together, work = plant_of(plants, i), state_of(states, i), work_of(works, i)
            _run(
                SINGLE,
                plant,
                states,
                together,
                work,
                who,
                substeps[i],
                periods,
                on_board,
                band,
                per_second,
                period,
            )


run_units = kernel(announce="the control loop of groups or of single vehicles (first use of each)")(
    named(_run_units, "run_units")
)
"""`_run_units`, one unit after another."""
run_units_in_parallel = kernel(
    parallel=True, announce="the control loop of many vehicles (first use, one to three minutes)"
)(named(_run_units, "run_units_in_parallel"))
"""`_run_units` on all threads: the results are the same bits."""
