"""Measured profiles: from the points of a file to a curve in metres, and what had to be done for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sayd_env.config import DataError
from sayd_env.config.units import Array
from sayd_env.measured.profile_files import (
    KINDS,
    UNITS,
    Kind,
    RawProfile,
    is_miniprof,
    is_simpack,
    read_lines,
    read_miniprof,
    read_points,
    read_simpack,
)

FEWEST_POINTS = 20
"""A profile with fewer points cannot carry slopes and curvatures."""

EXTENT: dict[Kind, tuple[tuple[float, float], tuple[float, float]]] = {
    "wheel": ((0.055, 0.160), (0.020, 0.060)),
    "rail": ((0.045, 0.120), (0.005, 0.060)),
}
"""Widths and heights (m) that points may span: a wheel from throat to field side up to a whole rim of 140 mm,
with a flange of 26 to 36 mm (EN 13715); a rail's head, 65 to 75 mm wide and up to 51 mm high (EN 13674-1),
with or without its sides. No profile fits in two units."""

SAME = 0.015e-3
"""Points nearer to each other than this (m) are one: scans are rounded to 0.01 mm."""

WIDEST_GAP, RUNNING = 6e-3, (-0.025, 0.020)
"""Points may be so far apart (m) where wheels run, about the tape circle and the middle of the head."""

COARSE = 1e-3
"""Points of a tread that are farther apart (m) are noted: conicity at small amplitudes depends on what lies
between them."""

STANDS_OFF, KINK, NOISE = 3e-5, 0.06, 8.0
"""A point may stand off the curve through its neighbours by this (m), by what a kink of this slope makes, by
what rounding makes, or by so many times as much as half of the points do: scans are rough all along."""

CHECKED: dict[Kind, float] = {"wheel": 0.030, "rail": 0.025}
"""How far (m) from the tape circle and from the middle of the head single points are checked."""

BACK_OFF = 1e-3
"""By how much (m) the back in a wheel's file may stand elsewhere than its numbers say: rounded, or worn."""

BACK = (0.5e-3, 3e-3)
"""A back stands where points within the first width (m) span at least the second height."""

_KEPT = 0.6
"""Share of the points that must be left when overhangs are cut."""

FREE = {"wheel": (0.0, 0.025), "rail": (-0.025, 0.020)}
"""Where a curve must not turn back (m): from the flange's top to beyond the tread; about the crown."""


@dataclass(frozen=True)
class MeasuredProfile:
    """A curve from a file.

    Attributes
    ----------
    y, z : ndarray, shape (n,)
        Coordinates (m), y strictly increasing.
    notes : tuple of str
        What was recognised and changed, for the user.
    """

    y: Array
    z: Array
    notes: tuple[str, ...] = ()


def read_profile_file(
    path: Path,
    kind: Kind,
    *,
    unit: str | None = None,
    mirror: bool | None = None,
    invert: bool | None = None,
    smoothing: float = 0.0,
    tape_to_back: float | None = None,
) -> MeasuredProfile:
    """Read a measured profile.

    Parameters
    ----------
    path : Path
        SIMPACK, MiniProf, or text with columns y and z; see docs/profiles.md.
    kind : {"wheel", "rail"}
        What it is to be.
    unit : {"mm", "cm", "m", "in", "um"}, optional
        Of its numbers; by default what the file says, else the one in which they make a profile.
    mirror, invert : bool, optional
        Whether y and z are turned round; by default so that z is upwards and a wheel's flange at negative y.
    smoothing : float
        Length (m) over which the curve will be smoothed; with one, a point may stand off its neighbours.
    tape_to_back : float, optional
        Distance (m) of a wheel's tape circle from its back, against which the file's back is checked.

    Returns
    -------
    MeasuredProfile
        y to the field side, z upwards.

    Raises
    ------
    DataError
        Empty, too short, not numeric or unsorted points (the line is named), a point that stands off its
        neighbours; no unit that fits; a wheel whose y = 0 is not its tape circle; the other kind.
    """
    text, encoding = read_lines(path)
    lines = text.split("\n")
    if is_simpack(lines):
        raw = read_simpack(lines, str(path))
    elif is_miniprof(lines):
        raw = read_miniprof(lines, str(path))
    else:
        raw = read_points(text, str(path))
    _check_kind(path, raw, kind)
    if len(raw.points) < FEWEST_POINTS:
        found = f"{len(raw.points)} points" if len(raw.points) else "no points"
        raise DataError(f"{path}: found {found}, at least {FEWEST_POINTS} are needed")
    y, z, notes = _in_metres(path, raw, kind, unit)
    y, z, turned = _upright(path, y, z, kind, mirror, invert, tape_to_back)
    if tape_to_back is not None:
        _check_back(path, y, z, tape_to_back)
    placed = _gauge_face(mirror) if kind == "rail" else []
    y, z, cleaned = _single_valued(path, y, z, raw.lines, kind, smoothing)
    coded = () if encoding == "UTF-8" else (f"encoding: {encoding}",)
    return MeasuredProfile(y, z, (*coded, *raw.notes, *notes, *turned, *placed, *cleaned))


def _check_kind(path: Path, raw: RawProfile, kind: Kind) -> None:
    """Refuse a rail as a wheel and the other way round, and a file that contradicts itself."""
    named = KINDS.get(path.suffix.lower())
    if raw.kind is not None and named is not None and raw.kind != named:
        raise DataError(
            f"{path}: its header says that it is a {raw.kind} (type = {int(raw.kind == 'wheel')}), "
            f"its name that it is a {named} ({path.suffix})"
        )
    if (found := raw.kind or named) not in (None, kind):
        raise DataError(f"{path}: is a {found} profile; expected a {kind}")


def _in_metres(path: Path, raw: RawProfile, kind: Kind, unit: str | None) -> tuple[Array, Array, list[str]]:
    """Coordinates in metres by the unit that is asked for, else stated, else the only one that fits."""
    spans = np.ptp(raw.points, axis=0)
    extent = f"{spans[0]:.4g} wide and {spans[1]:.4g} high"
    if unit is not None:
        factors, said = (UNITS[unit], UNITS[unit]), f"shape.unit: {unit}"
    elif raw.units is not None:
        factors, said = raw.units, raw.said
    else:
        fitting = [name for name, metres in UNITS.items() if _fits(kind, *(spans * metres))]
        if len(fitting) != 1:
            what = (
                f"is it in {' or '.join(fitting)}?" if fitting else f"a {kind} in none of {', '.join(UNITS)}"
            )
            raise DataError(
                f"{path}: its unit is not known: points are {extent}, {what}; state it by {kind}.shape.unit "
                f"(--set {kind}.shape.unit=mm) or in a header (y_mm, z_mm)"
            )
        factors = UNITS[fitting[0]], UNITS[fitting[0]]
        note = f"unit: {fitting[0]}, in which points {extent} make a {kind}; the file does not say it"
        return *(raw.points * factors).T, [note]
    if not _fits(kind, *(spans * factors)):
        wide, high = spans * factors * 1e3
        limits = " and ".join(
            f"{low * 1e3:g} to {top * 1e3:g} mm {name}"
            for (low, top), name in zip(EXTENT[kind], ("wide", "high"), strict=True)
        )
        raise DataError(
            f"{path}: by its unit ({said}) it is {wide:.4g} mm wide and {high:.4g} mm high; a {kind} profile "
            f"is {limits}"
        )
    return *(raw.points * factors).T, []


def _fits(kind: Kind, width: float, height: float) -> bool:
    """Whether a width and a height (m) are those of a profile."""
    return all(low <= span <= top for (low, top), span in zip(EXTENT[kind], (width, height), strict=True))


def _upright(
    path: Path,
    y: Array,
    z: Array,
    kind: Kind,
    mirror: bool | None,
    invert: bool | None,
    tape_to_back: float | None,
) -> tuple[Array, Array, list[str]]:
    """Curve with z upwards and a wheel's flange at negative y, unless stated otherwise.

    Most of a wheel's width is its tread, from which the flange stands out; most of a rail's is the top of its
    head, below which the sides hang.
    """
    notes = []
    order = np.argsort(y)
    even = np.linspace(np.min(y), np.max(y), 500)
    middle, low, top = np.median(np.interp(even, y[order], z[order])), np.min(z), np.max(z)
    if invert is None:
        outwards, other = (top - middle, middle - low) if kind == "wheel" else (middle - low, top - middle)
        invert = bool(other > _CLEARLY * outwards)
        if invert:
            notes.append(f"z turned round, so that it is upwards: the {_TELLTALE[kind]} in the file")
    z = -z if invert else z
    if kind == "wheel":
        _check_origin(path, y, z, tape_to_back)
    if mirror is None:
        mirror = kind == "wheel" and bool(y[np.argmax(z)] > 0.0)
        if mirror:
            notes.append("y turned round, so that the flange is at negative y")
    return (-y if mirror else y), z, notes


def _check_origin(path: Path, y: Array, z: Array, tape_to_back: float | None) -> None:
    """Refuse a wheel whose points lie all on one side of what should be its tape circle."""
    low, high = np.min(y), np.max(y)
    if low < -_ORIGIN and high > _ORIGIN:
        return
    found = (
        f"{path}: y runs from {low * 1e3 + 0.0:g} to {high * 1e3 + 0.0:g} mm in the file; y = 0 must be the "
        "tape circle"
    )
    if tape_to_back is None:
        raise DataError(found)
    tape = low + tape_to_back if y[np.argmax(z)] < 0.5 * (low + high) else high - tape_to_back
    remedy = f"{'subtract' if tape > 0.0 else 'add'} {abs(tape) * 1e3:g} mm"
    raise DataError(
        f"{found}, {tape_to_back * 1e3:g} mm from the wheel's back: {remedy}, if the points begin at the back"
    )


_ORIGIN = 0.010
"""How far a wheel reaches at least (m) to both sides of its tape circle, whatever is missing or shifted."""


def _check_back(path: Path, y: Array, z: Array, tape_to_back: float) -> None:
    """Refuse a wheel whose points reach its back at another place than its numbers say."""
    end, (width, height) = np.min(y), BACK
    inside, outside = (np.max(z[side]) - z[np.argmin(np.abs(y))] for side in (y < 0.0, y > 0.0))
    if inside < height or outside > height:
        return  # no flange, or one on either side: a rail, which is refused as such
    if np.ptp(z[y <= end + width]) < height or abs(end + tape_to_back) <= BACK_OFF:
        return
    raise DataError(
        f"{path}: the wheel's back stands at y = {end * 1e3:.1f} mm, wheel.tape_to_back says "
        f"{-tape_to_back * 1e3:g}: y = 0 must be the tape circle; shift the file, or set "
        f"wheel.tape_to_back={-end:.4g} if it is"
    )


def _gauge_face(mirror: bool | None) -> list[str]:
    """Which side of a rail is taken for its inner one, if nobody has said it."""
    if mirror is not None:
        return []
    return ["gauge face: taken to be at negative y; if it is at positive y, set rail.shape.mirror=true"]


_CLEARLY = 1.5
"""How many times as far a curve that is turned round reaches to the wrong side; of profiles about 10."""
_TELLTALE: dict[Kind, str] = {"wheel": "flange points to negative z", "rail": "sides hang to positive z"}


def _single_valued(
    path: Path, y: Array, z: Array, lines: list[int], kind: Kind, smoothing: float
) -> tuple[Array, Array, list[str]]:
    """Points in the order of y, those that coincide merged, what overhangs cut off."""
    if y[-1] < y[0]:
        y, z, lines = y[::-1], z[::-1], lines[::-1]
    y, z, lines, merged = _merged(y, z, lines)
    notes = (
        [f"{_points(merged)} merged, which lay within {SAME * 1e3:g} mm of or above another"]
        if merged
        else []
    )
    top = int(np.argmax(z))
    low, high = (y[top] + reach if kind == "rail" else reach for reach in FREE[kind])
    back = np.flatnonzero(np.diff(y) <= 0.0)
    before, after = back[back < top], back[back >= top]
    first = int(before[-1]) + 1 if before.size else 0
    last = int(after[0]) if after.size else len(y) - 1
    # A wheel is cut behind its flange's top and beyond its tread, a rail below its head.
    if (kind == "rail" and first and y[first] > low) or (after.size and y[last] < high):
        at = first if kind == "rail" and first and y[first] > low else last + 1
        raise DataError(
            f"{path}: line {lines[at]}: y goes from {y[at - 1] * 1e3:g} to {y[at] * 1e3:g} mm, against the "
            "direction of the other points"
        )
    _check_rest(path, y[first : last + 1], len(y), kind)
    if not smoothing:
        _check_single(path, y[first : last + 1], z[first : last + 1], lines[first : last + 1], kind)
    names = ("behind the flange's top", "beyond the tread") if kind == "wheel" else ("inside", "outside")
    for count, at, where in ((first, first, names[0]), (len(y) - 1 - last, last, names[1])):
        if count:
            notes.append(
                f"{_points(count)} cut {where}, where the curve overhangs at y = {y[at] * 1e3:.2f} mm"
            )
    return y[first : last + 1], z[first : last + 1], notes + _coarse(y[first : last + 1], kind)


def _coarse(y: Array, kind: Kind) -> list[str]:
    """That the points of a tread are far apart."""
    tread = y[(y > RUNNING[0]) & (y < RUNNING[1])]
    if kind != "wheel" or len(tread) < 2 or (apart := np.max(np.diff(tread))) <= COARSE * 1.001:
        return []
    return [
        f"points up to {apart * 1e3:.2g} mm apart on the tread: conicity at small amplitudes is uncertain by "
        "some 5 %"
    ]


def _check_single(path: Path, y: Array, z: Array, lines: list[int], kind: Kind) -> None:
    """Refuse a point that stands off the parabola through two neighbours on each side."""
    centre = 0.0 if kind == "wheel" else 0.5 * (y[0] + y[-1])
    places = np.arange(2, len(y) - 2)
    places = places[np.abs(y[places] - centre) < CHECKED[kind]]
    if not len(places):
        return
    around = places[:, None] + np.array([-2, -1, 1, 2])
    apart = (y[places + 2] - y[places - 2])[:, None] / 4.0
    away = (y[around] - y[places][:, None]) / apart
    weights = np.linalg.pinv(np.stack([np.ones_like(away), away, away**2], axis=-1))[:, 0]
    off = z[places] - np.sum(weights * z[around], axis=1)
    heights = np.diff(np.unique(np.round(z, 10)))
    rounding = 0.5 * np.min(heights, initial=1e-4) * (1.0 + np.sum(np.abs(weights), axis=1))
    kink = KINK / 3.0 * apart[:, 0]
    allowed = np.maximum(STANDS_OFF + kink + rounding, NOISE * np.median(np.abs(off)))
    worst = int(np.argmax(np.abs(off) - allowed))
    if abs(off[worst]) > allowed[worst]:
        at, found, most = places[worst], abs(off[worst]) * 1e3, allowed[worst] * 1e3
        raise DataError(
            f"{path}: line {lines[at]}: the point at y = {y[at] * 1e3:g} mm stands {found:.2g} mm off "
            f"the curve through its neighbours; the rounding and the roughness of the file explain at most "
            f"{most:.2g} mm: remove the point, or smooth by {kind}.shape.smoothing=0.003 (m)"
        )


def _points(count: int) -> str:
    return f"{count} point{'s' * (count != 1)}"


def _check_rest(path: Path, y: Array, before: int, kind: Kind) -> None:
    """Refuse points in no order, several curves in one file, and gaps where wheels run."""
    if len(y) < max(FEWEST_POINTS, _KEPT * before):
        raise DataError(
            f"{path}: only {len(y)} of {before} points follow one another in y; expected one "
            "curve, point by point"
        )
    centre = 0.0 if kind == "wheel" else 0.5 * (y[0] + y[-1])
    low, high = (centre + reach for reach in RUNNING)
    for i in np.flatnonzero((np.diff(y) > WIDEST_GAP) & (y[1:] > low) & (y[:-1] < high))[:1]:
        raise DataError(
            f"{path}: no points between y = {y[i] * 1e3:g} and {y[i + 1] * 1e3:g} mm; at most "
            f"{WIDEST_GAP * 1e3:g} mm may lie between two where wheels run"
        )


def _merged(y: Array, z: Array, lines: list[int]) -> tuple[Array, Array, list[int], int]:
    """Points of which neighbours that coincide, or stand above one another, are one, their mean."""
    groups = [[0]]
    for i in range(1, len(y)):
        first = groups[-1][0]
        if -SAME < y[i] - y[i - 1] <= 1e-9 or np.hypot(y[i] - y[first], z[i] - z[first]) < SAME:
            groups[-1].append(i)
        else:
            groups.append([i])
    starts = np.array([group[0] for group in groups])
    counts = np.array([len(group) for group in groups])
    means = [np.add.reduceat(values, starts) / counts for values in (y, z)]
    return means[0], means[1], [lines[start] for start in starts], len(y) - len(groups)
