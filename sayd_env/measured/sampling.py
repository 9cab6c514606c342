"""From the times of a file to signals on one uniform grid: rates are recognised, gaps refused by place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from sayd_env.config.errors import DataError
from sayd_env.config.units import Array, Integers

# What is judged lies below 14 Hz, whose period is 71 ms: a spline follows the signal over a quarter of it.
LONGEST_GAP = 0.02
"""Longest time without a value of a signal that is bridged (s)."""
LONGEST_SPEED_GAP = 10.0
"""Longest time for which a speed is carried on (s); a train changes it by 7 m/s at most meanwhile."""

# Uniform times scatter by rounding only; a hundredth of a step is no more than noise of a clock.
_SCATTER = 0.02
# A rate that rounding leaves open by more than this moves frequencies and distances too far.
_UNCERTAIN = 1e-3
# Samples nearer than this part of the usual step, as rounded times are, count as one.
_SAME = 0.25


@dataclass(frozen=True)
class Series:
    """Values of one column where it has them.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times (s), not falling.
    values : ndarray, shape (n,)
        In SI units.
    rows : ndarray of int, shape (n,)
        Where they stand among the values of the file.
    where : callable
        Place of a row in the file, as a message begins.
    """

    time: Array
    values: Array
    rows: Integers
    where: Callable[[int], str]

    def place(self, sample: int) -> str:
        """Place of a value in the file."""
        return self.where(int(self.rows[sample]) if len(self.rows) else 0)


@dataclass(frozen=True)
class Sampled:
    """Signals and speed on a uniform grid."""

    rate: float
    """Samples per second (Hz)."""
    signals: Array
    """Shape (n, channels)."""
    speed: Array | None
    """Shape (n,), m/s."""
    notes: tuple[str, ...]
    """What was done to the data."""


@dataclass(frozen=True)
class _Clock:
    """What times say about the sampling."""

    rate: float
    """Samples per second (Hz); of irregular times the usual one."""
    time: Array
    uniform: bool
    rounding: float = 0.0
    """By which the times of the file differ from uniform ones (s)."""


def put_right(time: Array, where: Callable[[int], str]) -> tuple[Array, str]:
    """Uniform times behind those of a file, which may be rounded; irregular ones stay as they are.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times (s).
    where : callable
        Place of a time in the file, as a message begins.

    Returns
    -------
    time : ndarray, shape (n,)
    note : str
        What was done, "" for nothing.

    Raises
    ------
    DataError
        Times that fall or do not advance, or are rounded so coarsely that the rate stays open.
    """
    clock = _clock(time, where)
    if not clock.rounding:
        return clock.time, ""
    note = f"Times are rounded to {clock.rounding:g} s; recognised behind them: {clock.rate:.6g} Hz."
    return clock.time, note


def sampled(channels: Sequence[Series], speed: Series | None, minimum_rate: float, source: str) -> Sampled:
    """Put signals and speed on the grid of the channel with the highest rate.

    Uniform times stay as they are. Where they are irregular, or channels have several rates, signals are
    resampled by cubic splines. Short gaps are bridged, longer ones refused. The speed is linear between its
    values.

    Parameters
    ----------
    channels : sequence of Series
        One at least.
    speed : Series, optional
        Speed (m/s).
    minimum_rate : float
        Lowest sampling rate of a channel (Hz).
    source : str
        The file.

    Raises
    ------
    DataError
        Gaps, or too low a rate, with their place; channels without a common time.
    """
    timed = []
    for each in channels:
        clock = _clock(each.time, each.place)
        if clock.rate < minimum_rate * (1 - 1e-6):
            raise DataError(
                f"{each.place(0)}: sampling rate {clock.rate:.6g} Hz; expected {minimum_rate:g} Hz or more"
            )
        timed.append((replace(each, time=clock.time), clock))
    fastest = max((clock for _, clock in timed), key=lambda clock: (clock.rate, clock.uniform))
    grid = _grid(timed, fastest, source)
    notes: dict[str, None] = {}
    columns = []
    for series, clock in timed:
        if clock.uniform and _same(series.time, grid):
            columns.append(series.values)
            continue
        if clock.uniform and (part := _part(series, grid)) is not None:
            notes[f"Read is what all channels have, {grid[0]:.6g} to {grid[-1]:.6g} s."] = None
            columns.append(part)
            continue
        notes[_resampled(series, clock, fastest.rate)] = None
        columns.append(_spline(series, clock)(grid))
    along = None if speed is None else _speed(speed, grid, notes)
    return Sampled(fastest.rate, np.column_stack(columns), along, tuple(notes))


def _clock(time: Array, where: Callable[[int], str]) -> _Clock:
    if len(time) < 3:
        raise DataError(f"{where(0)}: found {len(time)} samples; expected a recording of at least 500 m")
    steps = np.diff(time)
    if (back := np.flatnonzero(steps < 0)).size:
        i = int(back[0]) + 1
        raise DataError(f"{where(i)}: the time falls from {time[i - 1]:.9g} to {time[i]:.9g} s")
    span = float(time[-1] - time[0])
    if span <= 0:
        raise DataError(f"{where(1)}: the time steps by 0 s; it must advance")
    centred = np.arange(len(time)) - 0.5 * (len(time) - 1)
    since = time - time[0]
    step = float(centred @ since / (centred @ centred))
    scatter = float(np.ptp(since - step * centred))
    if scatter <= _SCATTER * step:
        return _uniform(time, (len(time) - 1) / span)
    rounding = _rounding(time)
    if scatter <= 1.2 * rounding:
        return _uniform(time, _behind(1.0 / step, rounding, span, where(0)), rounding)
    usual = 1.0 / float(np.median(steps[steps > 0]))
    return _Clock(float(round(usual)) if abs(usual - round(usual)) < 0.01 * usual else usual, time, False)


def _uniform(time: Array, rate: float, rounding: float = 0.0) -> _Clock:
    rate = float(round(rate)) if abs(rate - round(rate)) < 1e-6 * rate else rate
    return _Clock(rate, time[0] + np.arange(len(time)) / rate, True, rounding)


def _behind(rate: float, rounding: float, span: float, place: str) -> float:
    """Rate behind rounded times: the only whole one that they allow, or as they say if they are exact."""
    share = rounding / span
    whole = np.arange(np.ceil(rate * (1 - share)), np.floor(rate * (1 + share)) + 1)
    if len(whole) == 1:
        return float(whole[0])
    if share > _UNCERTAIN:
        raise DataError(
            f"{place}: times rounded to {rounding:g} s leave the sampling rate open ({rate:.4g} Hz within"
            f" {100 * share:.2g} %); give it: --sample-rate"
        )
    return rate


def _rounding(time: Array) -> float:
    """Coarsest power of ten of which all times are multiples (s); 0 for none down to 1 us."""
    for power in range(7):
        ticks = time * 10.0**power
        if np.abs(ticks - np.round(ticks)).max() < 1e-4 + 1e-9 * np.abs(ticks).max():
            return 10.0**-power
    return 0.0


def _grid(timed: Sequence[tuple[Series, _Clock]], fastest: _Clock, source: str) -> Array:
    """Uniform times that all channels have."""
    if fastest.uniform and all(_same(series.time, fastest.time) for series, _ in timed):
        return fastest.time
    start = max(float(series.time[0]) for series, _ in timed)
    end = min(float(series.time[-1]) for series, _ in timed)
    count = int((end - start) * fastest.rate * (1 + 1e-12) + 1e-6) + 1
    if end <= start:
        raise DataError(
            f"{source}: the channels have no common time: one starts at {start:.6g} s, where another ends"
        )
    return start + np.arange(count) / fastest.rate


def _same(time: Array, grid: Array) -> bool:
    step = grid[1] - grid[0]
    return len(time) == len(grid) and bool(np.abs(time - grid).max() < _SCATTER * step)


def _part(series: Series, grid: Array) -> Array | None:
    """Values at the times of a grid that are times of the series, None where they are others."""
    step = grid[1] - grid[0]
    first = max(0, round(float(grid[0] - series.time[0]) / step))
    part = slice(first, first + len(grid))
    return series.values[part] if _same(series.time[part], grid) else None


def _resampled(series: Series, clock: _Clock, rate: float) -> str:
    """Refuse long gaps; say what happens to short ones and to other times."""
    steps = np.diff(series.time)
    holes = np.flatnonzero(steps > LONGEST_GAP * (1 + 1e-6))
    if holes.size:
        i = int(holes[0])
        others = f" ({len(holes)} gaps in all)" if len(holes) > 1 else ""
        first = min(int(series.rows[i]) + 1, int(series.rows[i + 1]))
        raise DataError(
            f"{series.where(first)}: a gap of {1e3 * steps[i]:.4g} ms, from {series.time[i]:.6g} to"
            f" {series.time[i + 1]:.6g} s{others}; at most {1e3 * LONGEST_GAP:g} ms are bridged:"
            " cut the recording"
        )
    if clock.uniform and abs(clock.rate - rate) < 1e-6 * rate:
        return f"Signals of {rate:.6g} Hz have times of their own: put on common ones by cubic splines."
    if clock.uniform:
        return f"Signals of {clock.rate:.6g} Hz were resampled to {rate:.6g} Hz by cubic splines."
    short = steps > 1.5 / clock.rate
    gaps = f"{int(short.sum())} gaps of up to {1e3 * steps.max():.3g} ms were bridged by cubic splines."
    if np.ptp(steps[~short]) < 0.1 / clock.rate:
        return gaps
    return (
        f"Times are irregular, in steps of {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms: resampled"
        f" to {rate:.6g} Hz by cubic splines."
    ) + (f" {gaps}" if short.any() else "")


def _spline(series: Series, clock: _Clock) -> CubicSpline:
    """A spline through the samples; those at the same time, as rounding puts them, count by their mean."""
    first = np.concatenate(([True], np.diff(series.time) > _SAME / clock.rate))
    if first.all():
        return CubicSpline(series.time, series.values)
    group = np.cumsum(first) - 1
    count = np.bincount(group)
    return CubicSpline(
        np.bincount(group, series.time) / count, np.bincount(group, series.values) / count, extrapolate=True
    )


def _speed(series: Series, grid: Array, notes: dict[str, None]) -> Array:
    time = series.time
    if not len(time):
        raise DataError(f"{series.place(0)}: holds no speed")
    steps = np.diff(np.concatenate(([min(grid[0], time[0])], time, [max(grid[-1], time[-1])])))
    longest = int(steps.argmax())
    if steps[longest] > LONGEST_SPEED_GAP:
        raise DataError(
            f"{series.place(max(0, longest - 1))}: no further speed for {steps[longest]:.4g} s; it is carried"
            f" on for {LONGEST_SPEED_GAP:g} s at most: give a constant one (--speed), or cut the recording"
        )
    if steps[longest] > 10 * (grid[1] - grid[0]):
        notes[
            f"The speed has {len(time)} values, up to {steps[longest]:.3g} s apart: linear in between, and"
            " carried on at the ends."
        ] = None
    return np.interp(grid, time, series.values)
