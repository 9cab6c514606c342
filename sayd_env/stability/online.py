"""The band-pass filter around the dominant frequency while a vehicle runs, compiled.

The assessment looks back at a whole run; a controller and its cost cannot. Here every sample is filtered as
it comes: a causal Butterworth band-pass of the assessment's order and width around f_0, which `retune` takes
from the spectrum of the last 500 m, once a second. f_0 stands on a grid, so that all filters are made before.

Where f_0 moves, the filter of the new band runs from rest over the last two seconds of kept samples. Its
state is then that of a filter which has been there for a while: no transient from switching, and whoever
wants to check a cost needs just the signal and the moments at which f_0 moved.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.signal import get_window

from sayd_env.config import ConfigError
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.control import OnlineConfig
from sayd_env.config.units import Array, Integers
from sayd_env.physics.kernel import kernel
from sayd_env.physics.ragged import Cube, IndexMatrix, Matrix
from sayd_env.stability.signals import ROUNDING, band_sections

CHUNK = 16
"""Block means that the spectrum takes at once, their phases from a table; a multiple of four."""

SLOWEST = 1.0
"""Lowest speed (m/s): 500 m then take more than eight minutes."""

RECENT, HISTORY, STARTED, KEPT, MEANS = range(5)
"""Columns of `BandState.place`."""


class Band(NamedTuple):
    """Constants of the on-line filter at one sampling rate (f grid frequencies, s biquads)."""

    sections: Array
    """(f, s, 5) b0, b1, b2, a1, a2 of the biquads of each grid frequency's band."""
    frequency: Array
    """(f,) grid of f_0, Hz."""
    counts: Integers
    """(3,) samples in a block, samples kept for settling, index of the start frequency."""
    segment: Array
    """(2,) distance behind f_0 (m) and sampling rate (Hz)."""
    phase: Array
    """(CHUNK + 1, 2, f + 2) cosine and -sine of each grid frequency's phase after so many blocks; the grid is
    longer by one step at both ends, so that a component at an end still is a peak."""


class BandState(NamedTuple):
    """What changes: c channels in g equal groups, each with its own f_0 and its own clock.

    Channel j belongs to group j // (c // g).
    """

    filters: Cube
    """(c, s, 2) states of the biquads, transposed direct form II."""
    recent: Matrix
    """(settling, c) ring of samples."""
    block: Array
    """(c,) sum over the block under way."""
    history: Matrix
    """(capacity, c) ring of block means."""
    window: Matrix
    """(capacity, g) Hann window of the spectrum, scaled so that a harmonic gives its RMS."""
    length: Integers
    """(g,) block means that make 500 m, at most `capacity`."""
    choice: Integers
    """(g,) index of f_0."""
    place: IndexMatrix
    """(g, 5) next row of `recent`, of `history`; samples in the block; samples kept, block means kept."""
    weighted: Array
    """(capacity rounded up to whole chunks,) scratch: windowed means of a channel."""
    spectrum: Matrix
    """(3, f + 2) scratch: power of a group, real and imaginary part of a channel."""


def band(online: OnlineConfig, assessment: AssessmentConfig, rate: float) -> Band:
    """Make the filters of all bands at a sampling rate.

    Parameters
    ----------
    online : OnlineConfig
        Grid, blocks and settling.
    assessment : AssessmentConfig
        Order and width of the band, range of f_0.
    rate : float
        Samples per second (Hz).

    Raises
    ------
    ConfigError
        A sampling rate or blocks too slow for the highest band, or a start frequency out of range.
    """
    low, high, half = assessment.frequency_min, assessment.frequency_max, assessment.band_half_width
    if not (math.isfinite(rate) and rate > 2 * (high + half)):
        raise ConfigError(
            f"the on-line filter cannot work at {rate:g} samples per second: its highest band ends at"
            f" {high + half:g} Hz, so it needs more than {2 * (high + half):g} Hz"
        )
    if not low <= online.start_frequency <= high:
        raise ConfigError(
            f"start_frequency: found {online.start_frequency:g}; expected {low:g} to {high:g} Hz,"
            " the assessment's range of dominant frequencies"
        )
    samples = max(1, round(online.block * rate))
    if rate / samples <= 2 * (high + online.frequency_step):
        raise ConfigError(
            f"block: found {online.block:g}; expected less than {0.5 / (high + online.frequency_step):.3g} s,"
            f" because a spectrum to {high:g} Hz needs two blocks in a period"
        )
    count = math.floor((high - low) / online.frequency_step + 1e-6) + 1
    frequency: Array = low + online.frequency_step * np.arange(count, dtype=np.float64)
    start = int(np.argmin(np.abs(frequency - online.start_frequency)))
    settling = max(1, round(online.settling * rate))
    return Band(
        # Contiguous: a copy of an environment would have it so, and compile its kernels for it.
        sections=np.ascontiguousarray([_sections(f, assessment, rate) for f in frequency]),
        frequency=frequency,
        counts=np.array([samples, settling, start]),
        segment=np.array([assessment.segment_length, rate]),
        phase=_phases(frequency, online.frequency_step, samples / rate),
    )


def _sections(f0: float, assessment: AssessmentConfig, rate: float) -> Array:
    return band_sections(float(f0), assessment, rate)[:, [0, 1, 2, 4, 5]]  # without a0, which is one


def _phases(frequency: Array, step: float, interval: float) -> Array:
    grid = np.concatenate([[frequency[0] - step], frequency, [frequency[-1] + step]])
    angle = 2 * np.pi * interval * np.arange(CHUNK + 1)[:, None] * grid
    return np.stack([np.cos(angle), -np.sin(angle)], axis=1)


def band_state(
    constants: Band,
    speed: float | Array,
    channels: int,
    groups: int,
    slowest: float | None = None,
) -> BandState:
    """Make the state of filters at rest, before the first sample.

    Parameters
    ----------
    constants : Band
        The filters.
    speed : float or ndarray, shape (groups,)
        Speed of each group's vehicle (m/s).
    channels, groups : int
        Number of channels, and of the groups that share an f_0; the first are a multiple of the second.
    slowest : float, optional
        Lowest speed at which a group may be restarted (m/s); by default the lowest of `speed`.

    Raises
    ------
    ConfigError
        Channels that do not make equal groups, or a speed that is too low.
    """
    if groups < 1 or channels < groups or channels % groups:
        raise ConfigError(f"{channels} channels in {groups} groups; expected the same number in each group")
    speeds = np.broadcast_to(np.asarray(speed, dtype=np.float64), (groups,))
    length = np.array([_length(constants, v) for v in speeds])
    capacity = int(length.max())
    if slowest is not None:
        capacity = max(capacity, _length(constants, slowest))
    settling, start = int(constants.counts[1]), int(constants.counts[2])
    window = np.zeros((capacity, groups))
    for group, n in enumerate(length):
        window[:n, group] = _window(int(n))
    return BandState(
        filters=np.zeros((channels, constants.sections.shape[1], 2)),
        recent=np.zeros((settling, channels)),
        block=np.zeros(channels),
        history=np.zeros((capacity, channels)),
        window=window,
        length=length,
        choice=np.full(groups, start),
        place=np.zeros((groups, 5), dtype=np.int64),
        weighted=np.zeros(-(-capacity // CHUNK) * CHUNK),
        spectrum=np.zeros((3, constants.phase.shape[2])),
    )


def restart(constants: Band, state: BandState, group: int, speed: float) -> None:
    """Put one group back to rest, in place, as if it had been made for this speed just now.

    Raises
    ------
    ConfigError
        A speed below the slowest one that the state was made for.
    """
    length = _length(constants, speed)
    capacity = len(state.history)
    if length > capacity:
        raise ConfigError(
            f"the on-line filter keeps {capacity} block means, {speed:g} m/s needs {length}:"
            " make its state for the slowest speed"
        )
    size = len(state.block) // len(state.length)
    own = slice(group * size, (group + 1) * size)
    state.filters[own] = 0.0
    state.block[own] = 0.0
    state.place[group] = 0
    state.length[group] = length
    state.choice[group] = constants.counts[2]
    state.window[:, group] = 0.0
    state.window[:length, group] = _window(length)


def _length(constants: Band, speed: float) -> int:
    """Whole blocks within one segment of the assessment: any run of its length has them all."""
    if not (math.isfinite(speed) and speed >= SLOWEST):
        raise ConfigError(f"on-line filter: found a speed of {speed:g} m/s; expected {SLOWEST:g} m/s or more")
    distance, rate = constants.segment
    blocks = float(distance) / speed * float(rate) / int(constants.counts[0])
    return max(2, math.floor(blocks + 1e-9))


@lru_cache(maxsize=512)
def _window(length: int) -> Array:
    window: Array = get_window("hann", length)
    window *= math.sqrt(2) / window.sum()
    window.flags.writeable = False  # one for all states
    return window


@kernel(inline=True, allocates=False)
def _filtered(sections: Array, filters: Array, value: float) -> float:
    """One sample through a channel's biquads, transposed direct form II."""
    for s in range(sections.shape[0]):
        result = sections[s, 0] * value + filters[s, 0]
        filters[s, 0] = sections[s, 1] * value - sections[s, 3] * result + filters[s, 1]
        filters[s, 1] = sections[s, 2] * value - sections[s, 4] * result
        value = result
    return value


@kernel(allocates=False)
def push(band: Band, state: BandState, sample: Array, out: Array) -> None:
    """Take one sample of every channel: filter it, and keep it for the next `retune`.

    Parameters
    ----------
    band : Band
        The filters.
    state : BandState
        Changed in place.
    sample : ndarray, shape (c,)
        Signals, in any unit.
    out : ndarray, shape (c,)
        Receives the filtered signals.
    """
    size = sample.shape[0] // state.choice.shape[0]
    for group in range(state.choice.shape[0]):
        first = group * size
        sections = band.sections[state.choice[group]]
        place = state.place[group]
        row = place[RECENT]
        for j in range(first, first + size):
            out[j] = _filtered(sections, state.filters[j], sample[j])
            state.recent[row, j] = sample[j]
            state.block[j] += sample[j]
        place[RECENT] = row + 1 if row + 1 < state.recent.shape[0] else 0
        place[KEPT] = min(place[KEPT] + 1, state.recent.shape[0])
        place[STARTED] += 1
        if place[STARTED] < band.counts[0]:
            continue
        row = place[HISTORY]
        for j in range(first, first + size):
            state.history[row, j] = state.block[j] / place[STARTED]
            state.block[j] = 0.0
        place[HISTORY] = row + 1 if row + 1 < state.history.shape[0] else 0
        place[MEANS] = min(place[MEANS] + 1, state.history.shape[0])
        place[STARTED] = 0


@kernel(allocates=False)
def follow_speed(band: Band, state: BandState, group: int, speed: float) -> None:
    """Let a group's spectrum reach over the segment's distance at the present speed.

    It moves where it is more than one block off, so that a sensor's noise does not move it to and fro.

    Parameters
    ----------
    band : Band
        The filters.
    state : BandState
        Changed in place. Below the slowest speed that it was made for the spectrum stays as long as it is.
    group : int
    speed : float
        m/s.
    """
    blocks = band.segment[0] / speed * band.segment[1] / band.counts[0]
    if not blocks < state.history.shape[0] + 1.0:  # a dead sensor reads 0, or nothing
        return
    length = min(max(2, math.floor(blocks + 1e-9)), state.history.shape[0])
    if abs(length - state.length[group]) > 1:
        state.length[group] = length
        _write_window(state.window, group, length)


@kernel(allocates=False)
def _write_window(window: Matrix, group: int, length: int) -> None:
    """`_window` into a column."""
    total = 0.0
    for k in range(length):
        window[k, group] = 0.5 - 0.5 * math.cos(2.0 * math.pi * k / length)
        total += window[k, group]
    for k in range(length):
        window[k, group] *= math.sqrt(2.0) / total
    for k in range(length, window.shape[0]):
        window[k, group] = 0.0


@kernel(allocates=False)
def retune(band: Band, state: BandState) -> None:
    """Find f_0 of every group that has 500 m behind it; call it at whole seconds.

    Parameters
    ----------
    band : Band
        The filters.
    state : BandState
        Changed in place.
    """
    for group in range(state.choice.shape[0]):
        retune_group(band, state, group)


@kernel(allocates=False)
def retune_group(band: Band, state: BandState, group: int) -> None:
    """Find f_0 of one group, and move its filters there: `retune` for groups whose seconds begin apart.

    f_0 is the highest peak of the summed spectra of the group's channels; without any peak, the end of the
    grid to which they rise. Constant or non-finite signals leave it where it is. Filters that a non-finite
    sample has spoilt run anew over the kept samples, so that they recover when it is no longer among them.
    """
    size = state.block.shape[0] // state.choice.shape[0]
    chosen = state.choice[group]
    if state.place[group, MEANS] >= state.length[group]:
        chosen = _dominant(band, state, group, size)
    if chosen != state.choice[group] or not math.isfinite(
        state.filters[group * size : (group + 1) * size].sum()
    ):
        state.choice[group] = chosen
        _settle(band, state, group, size)


@kernel(allocates=False)
def _dominant(band: Band, state: BandState, group: int, size: int) -> int:
    """Index of a group's f_0 by the last 500 m."""
    power, real, imaginary = state.spectrum[0], state.spectrum[1], state.spectrum[2]
    power[:] = 0.0
    mean_square = 0.0
    for j in range(group * size, (group + 1) * size):
        mean = _weigh(state, group, j)
        mean_square += mean * mean
        _transform(state.weighted, state.length[group], band.phase, real, imaginary)
        for k in range(power.shape[0]):
            power[k] += real[k] * real[k] + imaginary[k] * imaginary[k]
    chosen: int = _highest_peak(power, ROUNDING * mean_square, state.choice[group])
    return chosen


@kernel(allocates=False)
def _weigh(state: BandState, group: int, channel: int) -> float:
    """Write a channel's last 500 m, less their windowed mean, times the window; return that mean."""
    length, capacity = state.length[group], state.history.shape[0]
    oldest = state.place[group, HISTORY] - length
    row = oldest + capacity if oldest < 0 else oldest
    total, weights = 0.0, 0.0
    for k in range(length):
        value = state.history[row, channel]
        state.weighted[k] = value
        total += state.window[k, group] * value
        weights += state.window[k, group]
        row = row + 1 if row + 1 < capacity else 0
    # The windowed mean leaks far less of a quasi-static part into the lowest lines than the plain one.
    mean = total / weights
    for k in range(length):
        state.weighted[k] = (state.weighted[k] - mean) * state.window[k, group]
    for k in range(length, state.weighted.shape[0]):
        state.weighted[k] = 0.0
    return mean


@kernel(distinct=True, allocates=False)
def _transform(weighted: Array, length: int, phase: Array, real: Array, imaginary: Array) -> None:
    """Fourier sum of the weighted means at every grid frequency.

    Phases within a chunk come from a table; the chunks' sums follow one another by Horner's rule, which needs
    the phase of a whole chunk alone. So rounding errors do not grow along the signal.
    """
    real[:] = 0.0
    imaginary[:] = 0.0
    for chunk in range((length - 1) // CHUNK, -1, -1):
        for k in range(real.shape[0]):
            turned = real[k] * phase[CHUNK, 0, k] - imaginary[k] * phase[CHUNK, 1, k]
            imaginary[k] = real[k] * phase[CHUNK, 1, k] + imaginary[k] * phase[CHUNK, 0, k]
            real[k] = turned
        for i in range(0, CHUNK, 4):
            at = chunk * CHUNK + i
            a, b, c, d = weighted[at], weighted[at + 1], weighted[at + 2], weighted[at + 3]
            for k in range(real.shape[0]):
                real[k] += (
                    a * phase[i, 0, k]
                    + b * phase[i + 1, 0, k]
                    + c * phase[i + 2, 0, k]
                    + d * phase[i + 3, 0, k]
                )
                imaginary[k] += (
                    a * phase[i, 1, k]
                    + b * phase[i + 1, 1, k]
                    + c * phase[i + 2, 1, k]
                    + d * phase[i + 3, 1, k]
                )


@kernel(allocates=False)
def _highest_peak(power: Array, least: float, present: int) -> int:
    """Index of the highest local maximum in the grid, which `power` exceeds by one step at both ends."""
    count = power.shape[0] - 2
    highest, peak, total = -1.0, -1, 0.0
    for k in range(1, count + 1):
        total += power[k]
        if power[k] > power[k - 1] and power[k] >= power[k + 1] and power[k] > highest:
            highest, peak = power[k], k - 1
    if not (total > least and math.isfinite(total)):
        return present
    if peak < 0:
        return 0 if power[1] >= power[count] else count - 1
    return peak


@kernel(allocates=False)
def _settle(band: Band, state: BandState, group: int, size: int) -> None:
    """Run a group's filters from rest over its kept samples."""
    sections = band.sections[state.choice[group]]
    kept, capacity = state.place[group, KEPT], state.recent.shape[0]
    oldest = state.place[group, RECENT] - kept
    for j in range(group * size, (group + 1) * size):
        filters = state.filters[j]
        filters[:] = 0.0
        row = oldest + capacity if oldest < 0 else oldest
        for _ in range(kept):
            _filtered(sections, filters, state.recent[row, j])
            row = row + 1 if row + 1 < capacity else 0


@kernel(allocates=False)
def replay(band: Band, state: BandState, samples: int, last: int, squares: Array) -> None:
    """Run all filters from rest over their kept samples, and add up the squares of what leaves them.

    Parameters
    ----------
    band : Band
        The filters.
    state : BandState
        Its filters are changed in place.
    samples : int
        Samples in a period, the last of which ends now.
    last : int
        Row of this period in `squares`.
    squares : ndarray, shape (periods, c or more)
        Ring: receives each period's sums in the channels' columns, 0 before the first kept sample.
    """
    size = state.block.shape[0] // state.choice.shape[0]
    capacity, periods = state.recent.shape[0], squares.shape[0]
    for j in range(state.block.shape[0]):
        sections, place = band.sections[state.choice[j // size]], state.place[j // size]
        filters, kept = state.filters[j], place[KEPT]
        filters[:] = 0.0
        squares[:, j] = 0.0
        oldest = place[RECENT] - kept
        row = oldest + capacity if oldest < 0 else oldest
        for n in range(kept):
            value = _filtered(sections, filters, state.recent[row, j])
            row = row + 1 if row + 1 < capacity else 0
            age = (kept - 1 - n) // samples
            if age < periods:
                squares[(last - age) % periods, j] += value * value
