"""Measured track irregularities from a text table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from sayd_env.config.conditions import smooth_step
from sayd_env.config.errors import DataError
from sayd_env.config.track import CHANNELS, DOMAINS, FileConfig, GeometryConfig
from sayd_env.config.units import Array
from sayd_env.measured.distance import IRREGULARITIES, DistanceColumn, DistanceTable, Variant, read_table

_MIN_ROWS = 4
# A hole this many times wider than the usual spacing is missing data, over which a spline would swing freely.
_MAX_GAP = 10.0
# Rows further apart show no wave that a vehicle's yaw dampers meet: kilometres in a column of metres.
_FURTHEST = 10.0  # m
# No railway in service departs further from its nominal geometry, and none is as even as the least: such a
# number has another unit.
_MOST, _LEAST = 0.2, 2e-5  # m
# Departures have no such mean over so long a way; the line's own layout has (a cant, a curve).
_MOST_MEAN, _MEAN_LENGTH = 0.05, 100.0  # m
# Laying and wear leave half of a track's rows within few millimetres of its nominal gauge. What departs
# further is another nominal, the gauge at another depth, or widened curves, which a column follows.
_SAME_GAUGE = 0.006  # m
_USUAL_GAUGE = 1.435  # m
# A hundredth of what tracks are measured to.
_EQUAL_GAUGE = 1e-5  # m
# What a chord shows of a wave at least for the wave to be restored: errors of measurement grow 17 times.
_LEAST_SHOWN = 0.06
# Beyond a band its waves die away up to lengths this many times as long, or as short.
_FLANK = 1.25
# Longest wave of the longitudinal level in D3 (EN 13848-1).
_LONGEST_LEVEL = 150.0  # m
# Length over which a file fades in and out, over its longest wave: sharper, waves of the band leak out of it.
_FADE = 2.0
# A file is low-passed whose rows are closer than this share of the samples' distance: its shorter waves would
# be folded into long ones. What is kept begins with a wave of so many times that distance; the filter, which
# runs forward and backward, has this order and settles over so many such waves.
_DENSE, _SHORTEST_WAVE, _FOLD_ORDER, _SETTLED_WAVES = 0.9, 2.5, 8, 10.0
_NOMINAL = re.compile(r"nominal\s+(?:track\s+)?gauge\D{0,20}?(\d{3,4}(?:[.,]\d+)?)(?!\d)", re.IGNORECASE)


@dataclass(frozen=True)
class MeasuredTrack:
    """Measured irregularities in SI units.

    Attributes
    ----------
    source : str
        The file.
    x : ndarray, shape (n,)
        Ascending positions (m).
    values : ndarray, shape (n, 4)
        Alignment, vertical (m), cross-level (rad), gauge (m); zero for channels that the file lacks.
    notes : tuple of str
        What was done to the numbers of the file beside a change of units.
    nominal_gauge : ndarray, shape (n,), or None
        What the file's gauge departs from (m), where it has a gauge and this is stated.
    """

    source: str
    x: Array
    values: Array
    notes: tuple[str, ...] = ()
    nominal_gauge: Array | None = None

    def at(self, x: Array) -> Array:
        """Values at even positions by a cubic spline, shape (m, 4); outside the file those at its ends.

        Waves shorter than 2.5 times the distance of the positions asked for are taken out of a denser file
        first: they would be folded into longer ones.
        """
        found, step = CubicSpline(self.x, self.values, axis=0), float(x[1] - x[0])
        usual, length = float(np.median(np.diff(self.x))), float(self.x[-1] - self.x[0])
        if usual < _DENSE * step:
            even, spacing = np.linspace(self.x[0], self.x[-1], round(length / usual) + 1, retstep=True)
            shortest = _SHORTEST_WAVE * step
            low_pass = butter(_FOLD_ORDER, 2.0 * spacing / shortest, output="sos")
            settled = min(round(_SETTLED_WAVES * shortest / spacing), len(even) - 1)
            found = CubicSpline(even, sosfiltfilt(low_pass, found(even), axis=0, padlen=settled), axis=0)
        return np.asarray(found(np.clip(x, self.x[0], self.x[-1])), dtype=np.float64)


def read_measured(config: FileConfig) -> MeasuredTrack:
    """Read the irregularities of a file: alignment, vertical, cross_level and gauge over distance.

    Parameters
    ----------
    config : FileConfig
        Names the file, see `read_table`; what it says beside irregularities belongs to a line and is left
        alone. A gauge as a whole is made a departure by the nominal gauge, which the configuration gives, the
        file in a column ``nominal_gauge``, or a line above the header. What a column holds of the track in
        part only (a wavelength domain, offsets from a chord) is refused unless `domains` or `recover` ask for
        what there is.

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        It is none that `read_table` takes, or has fewer than four rows; a gap; rows too far apart; numbers
        that are no irregularities in the unit stated; a gauge without its nominal; a domain, a chord or a
        space curve that is not asked for, or cannot give what is.
    """
    table = read_table(config.path, IRREGULARITIES, _MIN_ROWS, config.ignore)
    refuse_unused(table, config)
    _check_gaps(table)
    columns: dict[str, list[tuple[Variant, DistanceColumn]]] = {channel: [] for channel in CHANNELS}
    for name, variant in table.variants.items():
        columns[variant.channel].append((variant, table.columns[name]))
    notes: list[str] = []
    values = np.zeros((len(table.x), len(CHANNELS)))
    for j, channel in enumerate(CHANNELS):
        if columns[channel]:
            values[:, j] = _channel(table, columns[channel], config, notes)
    values[:, CHANNELS.index("cross_level")] /= config.cross_level_base
    return MeasuredTrack(table.source, table.x, values, tuple(notes), stated_gauge(table, config))


def check_gauge(measured: MeasuredTrack, gauge: float) -> None:
    """Check that a track's own gauge (m) is what the gauge of its file departs from.

    Raises
    ------
    DataError
        It is another: both together would not be the gauge that was measured.
    """
    nominal = measured.nominal_gauge
    if nominal is None or float(np.max(np.abs(nominal - gauge))) <= _EQUAL_GAUGE:
        return
    if np.ptp(nominal) > _EQUAL_GAUGE:
        raise DataError(
            f"{measured.source}: column nominal_gauge: found {1e3 * np.min(nominal):.6g} to "
            f"{1e3 * np.max(nominal):.6g} mm; a track has one gauge, give the file as a line (--line)"
        )
    stated = f"{1e3 * nominal[0]:.6g}"
    raise DataError(
        f"{measured.source}: states a nominal gauge of {stated} mm, the track's is {1e3 * gauge:.6g} mm: "
        f"--gauge {stated}, or the track's key gauge"
    )


def stated_gauge(table: DistanceTable, config: GeometryConfig) -> Array | None:
    """Nominal gauge (m), shape (n,), of a file that has a gauge, or a nominal one over distance.

    Raises
    ------
    DataError
        The file and the configuration state several.
    """
    has_gauge = any(variant.channel == "gauge" for variant in table.variants.values())
    return _nominal(table, config) if has_gauge or "nominal_gauge" in table.columns else None


def refuse_unused(table: DistanceTable, config: GeometryConfig, *, remarks: bool = False) -> None:
    """Refuse what is stated of columns that a file lacks.

    With `remarks`, in a line's file, also another gauge than the usual one above the header: where there is
    no column of it the line would not run at it.

    Raises
    ------
    DataError
        A nominal gauge, a domain, or a chord or space curve to recover, without the columns that it is of.
    """
    variants = table.variants.values()
    channels, ways = {each.channel for each in variants}, {each.way for each in variants}
    if config.nominal_gauge is not None and "nominal_gauge" in table.columns:
        raise DataError(
            f"{table.head}: nominal_gauge: has no effect beside a column of it; leave one of them out"
        )
    lacking = "gauge" not in channels and "nominal_gauge" not in table.columns
    remarked = _nominal(table, config) if lacking and remarks else None
    other = remarked is not None and abs(remarked[0] - _USUAL_GAUGE) > _EQUAL_GAUGE
    if lacking and (config.nominal_gauge is not None or other):
        raise DataError(
            f"{table.source}: nominal gauge: has no effect without a column gauge; a line's own gauge is a "
            "column nominal_gauge_mm"
        )
    if config.domains and "domain" not in ways:
        raise DataError(f"{table.head}: domains: have no effect: no column holds one of EN 13848-1")
    if config.recover is not None and not {"chord", "space curve"} & ways:
        raise DataError(f"{table.head}: recover: has no effect: no column holds a chord or a space curve")
    base = GeometryConfig.model_fields["cross_level_base"].default
    if config.cross_level_base != base and "cross_level" not in channels:
        raise DataError(f"{table.head}: cross_level_base: has no effect without a column of the cross-level")


def _channel(
    table: DistanceTable, columns: list[tuple[Variant, DistanceColumn]], config: FileConfig, notes: list[str]
) -> Array:
    """Values of a channel (m) from the columns that hold it."""
    ways = {variant.way for variant, _ in columns}
    names = " and ".join(f"'{column.header}'" for _, column in columns)
    if ways == {"domain"}:
        return _added(table, columns, config, notes)
    if len(columns) > 1:
        raise DataError(f"{table.head}: found columns {names}; name all but one under ignore")
    ((variant, column),) = columns
    if ways == {"true"}:
        values = _departures(table, column, config, notes) if variant.channel == "gauge" else column.values
        _check_size(table, column, values)
        return values
    return _restored(table, variant, column, config, notes)


def _added(
    table: DistanceTable, columns: list[tuple[Variant, DistanceColumn]], config: FileConfig, notes: list[str]
) -> Array:
    """Sum of wavelength domains."""
    found = {variant.domain: column for variant, column in columns}
    first = columns[0][1].header
    if not config.domains:
        spans: dict[str, str] = {name: f"{low:g} to {high:g} m" for name, (low, high) in DOMAINS.items()}
        domain = columns[0][0].domain
        raise DataError(
            f"{table.head}: column '{first}' holds the waves of one domain of EN 13848-1 alone "
            f"({domain}: {spans.get(domain, 'below 5 m')}); give domains, some of "
            f"{', '.join(f'{name} ({span})' for name, span in spans.items())}, to run on the sum of their "
            "columns, without all other waves"
        )
    for domain in config.domains:
        if domain not in found:
            raise DataError(
                f"{table.head}: domains: column '{first}' has none of {domain} beside it; found "
                f"{', '.join(column.header for column in found.values())}"
            )
    used = [found[domain] for domain in config.domains]
    for column in used:
        _check_size(table, column, column.values)
    low, high = DOMAINS[config.domains[0]][0], DOMAINS[config.domains[-1]][1]
    if columns[0][0].channel == "vertical":
        high = min(high, _LONGEST_LEVEL)
    notes.append(
        f"{' + '.join(column.header for column in used)}: waves of {low:g} to {high:g} m, without all others"
    )
    return np.asarray(np.sum([column.values for column in used], axis=0))


def _departures(table: DistanceTable, column: DistanceColumn, config: FileConfig, notes: list[str]) -> Array:
    """Gauge less its nominal."""
    typical = float(np.median(column.values))
    if abs(typical) <= _MOST:
        if config.nominal_gauge is not None:
            raise DataError(
                f"{table.head}: nominal_gauge: column '{column.header}' holds departures already (about "
                f"{typical / column.factor:g} {column.unit}); leave it out"
            )
        return column.values
    nominal = _nominal(table, config)
    if nominal is None:
        raise DataError(
            f"{table.head}: column '{column.header}' holds the gauge itself, about {1e3 * typical:.0f} mm; "
            "say what it departs from: nominal_gauge (m, for example 1.435), or a line "
            "'# nominal gauge 1435 mm' above the header, or a column nominal_gauge_mm"
        )
    if abs(float(np.median(column.values - nominal))) > _SAME_GAUGE:
        raise DataError(
            f"{table.head}: column '{column.header}': about {1e3 * typical:.0f} mm, but the nominal gauge is "
            f"stated as {1e3 * float(np.median(nominal)):g} mm; at most {1e3 * _SAME_GAUGE:g} mm lie between"
        )
    text = f"{1e3 * nominal[0]:g} mm" if np.ptp(nominal) == 0.0 else "that of the column nominal_gauge"
    notes.append(f"{column.header}: the nominal gauge, {text}, is taken off")
    return np.asarray(column.values - nominal)


def _nominal(table: DistanceTable, config: GeometryConfig) -> Array | None:
    """Nominal gauge (m), shape (n,)."""
    own = table.values("nominal_gauge")
    stated = [
        1e-3 * float(found[1].replace(",", "."))
        for line in table.text.head.preamble
        if (found := _NOMINAL.search(line))
    ]
    if config.nominal_gauge is not None:
        stated.append(config.nominal_gauge)
    if len({round(each, 6) for each in stated}) > 1:
        raise DataError(
            f"{table.source}: nominal gauge: found {' and '.join(f'{1e3 * each:g} mm' for each in stated)}"
        )
    if own is not None:
        return own
    return np.full(len(table.x), stated[0]) if stated else None


def _restored(
    table: DistanceTable, variant: Variant, column: DistanceColumn, config: FileConfig, notes: list[str]
) -> Array:
    """What a chord or a space curve shows of the waves of a band; its transfer function is undone there.

    Of a symmetrical chord of length L the offset at its middle is z(x) - (z(x - L/2) + z(x + L/2)) / 2: a
    wave of length l appears 1 - cos(pi L / l) times as high.
    """
    chord = variant.chord
    shown = _chord_function(chord) if chord else np.ones_like
    longest = math.pi * chord / math.acos(1.0 - _LEAST_SHOWN) / _FLANK if chord else 1000.0
    if config.recover is None:
        raise DataError(f"{table.head}: column '{column.header}' {_why_refused(chord, longest)}")
    low, high = config.recover
    step = (table.x[-1] - table.x[0]) / (len(table.x) - 1)
    where = f"{table.head}: column '{column.header}': recover: found [{low:g}, {high:g}] m"
    if high > longest:
        raise DataError(f"{where}; a chord of {chord:g} m hardly shows waves above {longest:.3g} m")
    if low < 4.0 * step:
        raise DataError(f"{where}; rows every {step:.3g} m show waves from {4.0 * step:.3g} m on")
    if table.x[-1] - table.x[0] < 3.0 * _FADE * high:
        raise DataError(
            f"{where}; the file has {table.x[-1] - table.x[0]:g} m, {3.0 * _FADE:g} times the longest wave "
            "is needed"
        )
    if chord:
        _check_size(table, column, column.values)
    notes.append(_what_is_lost(column.header, chord, low, high))
    return _band(table.x, column.values, (low, high), shown)


def _chord_function(chord: float) -> Callable[[Array], Array]:
    """Share that the middle of a chord shows, over the spatial frequency (1/m)."""
    return lambda frequency: 1.0 - np.cos(np.pi * chord * frequency)


def _why_refused(chord: float, longest: float) -> str:
    if not chord:
        return (
            "holds a space curve, in which the line's own layout is; give recover: [shortest, longest] (m, "
            "for example [3, 70]) to run on its waves of these lengths"
        )
    blind = ", ".join(f"{chord / (2 * n):.3g}" for n in (1, 2, 3))
    return (
        f"holds offsets from a chord of {chord:g} m: a wave of length l appears 1 - cos(pi {chord:g} m / l) "
        f"times as high, not at all at {blind} m ..., and hardly above {longest:.3g} m; give recover: "
        f"[shortest, longest] (m, for example [3, {math.floor(longest):g}]) to have the waves between "
        "restored, as far as the chord shows them"
    )


def _what_is_lost(header: str, chord: float, low: float, high: float) -> str:
    text = f"{header}: waves of {low:g} to {high:g} m, without all others"
    if chord:
        text += f", restored from a chord of {chord:g} m"
        half = math.acos(1.0 - _LEAST_SHOWN) / math.pi
        blind = [
            (chord / (2 * n + half), chord / (2 * n - half)) for n in range(1, 1 + int(chord / (2 * low) + 1))
        ]
        lost = [f"{max(low, a):.3g} to {min(high, b):.3g}" for a, b in blind if a < high and b > low]
        if lost:
            text += f", which does not show those of {', '.join(reversed(lost))} m"
    return f"{text}; the first and last {_FADE * high:g} m fade in and out"


def _band(x: Array, values: Array, band: tuple[float, float], shown: Callable[[Array], Array]) -> Array:
    """Waves of a band of lengths, each divided by the share of it that was shown."""
    low, high = band
    even: Array = np.linspace(x[0], x[-1], len(x))
    step = float(even[1] - even[0])
    # A wave cut off at an end has others of all lengths in it; a chord's inverse lifts the long ones of them.
    fade = smooth_step((even - x[0]) / (_FADE * high)) * smooth_step((x[-1] - even) / (_FADE * high))
    level = values - np.polynomial.Polynomial.fit(x, values, 3)(x)
    padding = math.ceil(4.0 * high / step)
    total = len(x) + 2 * padding
    spectrum = np.fft.rfft(np.pad(CubicSpline(x, level)(even) * fade, padding))
    frequency: Array = np.asarray(np.fft.rfftfreq(total, step), dtype=np.float64)
    share = shown(frequency)
    seen = np.abs(share) >= _LEAST_SHOWN
    flanks = smooth_step((_FLANK * high * frequency - 1.0) / (_FLANK - 1.0)) * smooth_step(
        (_FLANK - low * frequency) / (_FLANK - 1.0)
    )
    found = np.fft.irfft(np.where(seen, flanks / np.where(seen, share, 1.0), 0.0) * spectrum, total)
    return np.asarray(np.interp(x, even, found[padding : padding + len(x)]))


def _check_gaps(table: DistanceTable) -> None:
    spacing = np.diff(table.x)
    usual = float(np.median(spacing))
    if usual > _FURTHEST:
        raise DataError(
            f"{table.head}: column '{table.position.header}': rows are {usual:g} m apart, at most "
            f"{_FURTHEST:g} m makes sense for irregularities (is the unit m?)"
        )
    gaps = np.flatnonzero(spacing > _MAX_GAP * usual)
    if gaps.size:
        i = int(gaps[0]) + 1
        raise DataError(
            f"{table.where(i)}: a gap of {spacing[i - 1]:g} m before {table.place(i)}; "
            f"the usual spacing is {usual:g} m, at most {_MAX_GAP:g} times that is allowed"
        )


def _check_size(table: DistanceTable, column: DistanceColumn, values: Array) -> None:
    """Refuse numbers that are no departures from a nominal geometry."""
    large = np.flatnonzero(np.abs(values) > _MOST)
    if large.size:
        i = int(large[0])
        off = "" if values is column.values else f", {1e3 * values[i]:.4g} mm off its nominal"
        raise DataError(
            f"{table.where(i)}: column '{column.header}': found {column.shown(i)}{off}; at most "
            f"{_MOST / column.factor:g} {column.unit} is allowed (is the unit {column.unit} right?)"
        )
    largest = float(np.max(np.abs(values)))
    if 0.0 < largest < _LEAST:
        raise DataError(
            f"{table.head}: column '{column.header}': no number is above {1e3 * largest:.2g} mm; no track "
            f"is as even (is the unit {column.unit} right?)"
        )
    rows = math.ceil(_MEAN_LENGTH / float(np.median(np.diff(table.x))))
    total = np.concatenate(([0.0], np.cumsum(values)))
    mean = (total[rows:] - total[:-rows]) / rows
    if mean.size and (most := float(np.max(np.abs(mean)))) > _MOST_MEAN:
        raise DataError(
            f"{table.where(int(np.argmax(np.abs(mean))))}: column '{column.header}': its mean over "
            f"{_MEAN_LENGTH:g} m is {1e3 * most:.0f} mm, at most {1e3 * _MOST_MEAN:g} mm are irregularities: "
            "take the line's own layout out (cant, curves)"
        )
