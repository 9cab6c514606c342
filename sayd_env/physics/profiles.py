"""Wheel and rail profiles: from formulas, tables and measured files to one dense, uniform curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline, make_interp_spline
from scipy.optimize import brentq
from scipy.signal import savgol_filter

from sayd_env.config import ConfigError, DataError
from sayd_env.config.files import read_bytes
from sayd_env.config.limits import WORN_OUT
from sayd_env.config.profile import (
    JOINT_TOLERANCE_MM,
    Arc,
    HollowWear,
    Line,
    MeasuredWear,
    Polynomial,
    RailProfileConfig,
    Shape,
    WheelProfileConfig,
)
from sayd_env.config.units import Array
from sayd_env.measured.profile_files import LARGEST, Kind
from sayd_env.measured.profiles import read_profile_file

SAMPLING = 5e-5
"""Lateral distance of the samples (m): a flange arc of 13 mm is resolved to 0.1 um."""
_NARROWEST = 0.021
"""Width (m) beyond the longest smoothing, which every profile exceeds by far."""

TREAD_REACH = (-0.030, 0.025)
"""A wheel's points must cover at least this (m): throat to field side."""

_LOWEST_FLANGE, _HIGHEST_FIELD_SIDE = 5e-3, 8e-3
"""A flange is higher (m), the field side of a worn tread stands above its tape circle by a few mm at most."""

RAIL_REACH = (-0.025, 0.020)
"""A rail's points must cover at least this around the crown (m)."""


@dataclass(frozen=True)
class Profile:
    """A sampled profile.

    Attributes
    ----------
    name : str
        Name of the profile.
    kind : {"wheel", "rail"}
        Which body it belongs to.
    y : ndarray, shape (n,)
        Lateral positions (m), uniform, towards the field side; wheel: 0 is the tape circle, flange negative;
        rail: 0 is the crown, gauge face negative.
    z : ndarray, shape (n,)
        Heights (m); wheel: growth of the rolling radius over that of the tape circle; rail: above the crown.
    half_distance : float
        Wheel: lateral distance e of the tape circle from the wheelset's centre (m); 0 for a rail.
    gauge_depth : float
        Rail: depth below the crown at which the gauge is measured (m); 0 for a wheel.
    notes : tuple of str
        What was recognised and changed in a measured file, for the user.
    """

    name: str
    kind: Kind
    y: Array
    z: Array
    half_distance: float = 0.0
    gauge_depth: float = 0.0
    notes: tuple[str, ...] = ()


def file_contents(config: WheelProfileConfig | RailProfileConfig) -> tuple[bytes, ...]:
    """Contents of the measured files that a profile names, by which what is made of it may be kept.

    Raises
    ------
    ConfigError
        One cannot be read.
    """
    shapes = [config.shape]
    if isinstance(config, WheelProfileConfig) and isinstance(config.wear, MeasuredWear):
        shapes.append(config.wear.shape)
    files = [Path(shape.file) for shape in shapes if shape.file is not None]
    return tuple(read_bytes(file, "profile file", LARGEST) for file in files)


def wheel_profile(config: WheelProfileConfig, wear: float = 0.0) -> Profile:
    """Sample a wheel profile at a state of wear.

    Parameters
    ----------
    config : WheelProfileConfig
        The profile.
    wear : float
        0 is new, 1 fully worn as the profile's `wear` section says; between them heights are blended, and
        beyond 1 they go on by the same law.

    Raises
    ------
    ConfigError
        Wear outside 0 to `WORN_OUT`, or asked of a profile that has no `wear` section.
    DataError
        The curve cannot be used: a faulty measured file, zones that do not meet, no flange at negative y.
    """
    if not 0.0 <= wear <= WORN_OUT:
        raise ConfigError(f"wear: found {wear:g}, allowed is 0 (new) over 1 (worn) to {WORN_OUT:g}")
    if wear > 0.0 and config.wear is None:
        raise ConfigError(
            f"wheel profile '{config.name}' has no wear section, so wear must be 0 (found {wear:g})"
        )
    y, z, notes = _sampled(config.shape, config.name, "wheel", config.tape_to_back)
    if config.wear is not None and wear > 0.0:
        y, z, further = _worn(config, y, z, wear)
        notes = (*notes, *further)
    y, z = _on_grid(CubicSpline(y + config.shift, z), y[0] + config.shift, y[-1] + config.shift)
    # Behind its back a wheel has no surface; the shift alone would move the curve across it.
    ahead = y >= -config.tape_to_back - 1e-9
    y, z = y[ahead], z[ahead]
    _check_reach(config.name, y, TREAD_REACH, "the tape circle")
    z = z - np.interp(0.0, y, z)
    flange, rise = (max(0.0, float(np.max(z[side]))) for side in (y < 0.0, y > 0.0))
    if flange < _LOWEST_FLANGE or rise > _HIGHEST_FIELD_SIDE:
        raise DataError(
            f"wheel profile '{config.name}': no flange at negative y alone: it rises by {flange * 1e3:.1f} "
            f"mm there and by {rise * 1e3:.1f} mm at positive y. Is it a rail? If the axes differ, set "
            "mirror or invert"
        )
    if config.shape.file is not None:
        place = (
            f"backs {config.back_to_back * 1e3:g} mm apart, tape circle {config.tape_to_back * 1e3:g} mm from"
        )
        notes = (*notes, f"{config.name}: {place} the back (wheel.back_to_back, wheel.tape_to_back)")
    half = 0.5 * config.back_to_back + config.tape_to_back
    return Profile(config.name, "wheel", y, z, half_distance=half, notes=notes)


def rail_profile(config: RailProfileConfig) -> Profile:
    """Sample a rail profile, inclined by its cant, with the crown at the origin.

    Raises
    ------
    DataError
        The curve cannot be used: a measured file is faulty, zones do not meet, or the head is too short.
    """
    y, z, notes = _sampled(config.shape, config.name, "rail")
    tilt = np.arctan(config.cant)
    # Canted inwards the head leans towards the track centre (negative y).
    turned_y, turned_z = y * np.cos(tilt) - z * np.sin(tilt), z * np.cos(tilt) + y * np.sin(tilt)
    if np.any(np.diff(turned_y) <= 0.0):
        raise DataError(
            f"rail profile '{config.name}': overhangs at the cant of {config.cant:g}; shorten its sides"
        )
    curve = CubicSpline(turned_y, turned_z)
    crown = _crown(curve, turned_y, turned_z)
    y, z = _on_grid(curve, turned_y[0] - crown, turned_y[-1] - crown, offset=crown)
    z = z - float(curve(crown))
    _check_reach(config.name, y, RAIL_REACH, "the crown")
    if config.shape.file is not None:
        notes = (*notes, f"{config.name}: {_stands(config.cant, y, z)} (rail.cant)")
    profile = Profile(config.name, "rail", y, z, gauge_depth=config.gauge_depth, notes=notes)
    gauge_point(profile)
    return profile


def _stands(cant: float, y: Array, z: Array) -> str:
    """How a measured rail stands, for the user."""
    if cant:
        return f"turned by a cant of {cant:g} over that of the file"
    reach = np.linspace(0.0, _HEAD, 50)
    aside = np.interp(reach, y, z) - np.interp(-reach, y, z)
    even = np.max(np.abs(aside)) < _EVEN
    return "stands as in the file" + (
        ", upright: in the track it is inclined by 1:20 to 1:40" if even else ""
    )


_HEAD, _EVEN = 0.015, 5e-5
"""Where a head that is inclined by 1:40 has its sides 0.3 mm apart in height, an upright one not."""


def profile_notes(parts: Mapping[str, object]) -> tuple[str, ...]:
    """What was recognised and changed in the measured profiles among the parts of a configuration.

    Parameters
    ----------
    parts : mapping
        Wheels and rails, and others that are passed over, by any names.

    Raises
    ------
    DataError
        One cannot be used.
    """
    notes: list[str] = []
    for part in parts.values():
        sides = (part, part.right) if isinstance(part, WheelProfileConfig | RailProfileConfig) else ()
        for side in sides:
            if isinstance(side, WheelProfileConfig) and _measured(side):
                notes += wheel_profile(side, float(isinstance(side.wear, MeasuredWear))).notes
            elif isinstance(side, RailProfileConfig) and side.shape.file is not None:
                notes += rail_profile(side).notes
    return tuple(dict.fromkeys(notes))


def _measured(wheel: WheelProfileConfig) -> bool:
    worn = wheel.wear.shape.file if isinstance(wheel.wear, MeasuredWear) else None
    return wheel.shape.file is not None or worn is not None


def blended(first: Profile, second: Profile, share: float) -> Profile:
    """Rail between two: heights blended about their crowns.

    Where one of them ends before the other it goes on as steeply as it ends: by tenths of a millimetre at the
    foot of the gauge face.

    Parameters
    ----------
    first, second : Profile
        Rails.
    share : float
        Of the second one, 0 to 1.

    Raises
    ------
    DataError
        The inner side does not reach down to the gauge depth.
    """
    if share in (0.0, 1.0):
        return second if share else first
    ends = min(first.y[0], second.y[0]), max(first.y[-1], second.y[-1])
    y = SAMPLING * np.arange(round(ends[0] / SAMPLING), round(ends[1] / SAMPLING) + 1)
    heights = [make_interp_spline(rail.y, rail.z, k=1)(y) for rail in (first, second)]
    name = f"{share:g} of the way from {first.name} to {second.name}"
    depth = (1.0 - share) * first.gauge_depth + share * second.gauge_depth
    profile = Profile(name, "rail", y, (1.0 - share) * heights[0] + share * heights[1], gauge_depth=depth)
    gauge_point(profile)
    return profile


def gauge_point(rail: Profile) -> float:
    """Lateral position of the gauge face relative to the crown (m, negative).

    Raises
    ------
    DataError
        The rail's inner side does not reach down to the gauge depth.
    """
    inner = rail.y <= 0.0
    if rail.z[0] > -rail.gauge_depth:
        raise DataError(
            f"rail profile '{rail.name}': its inner side ends {-rail.z[0] * 1e3:.1f} mm below the crown, "
            f"the gauge is measured at {rail.gauge_depth * 1e3:.1f} mm"
        )
    return float(np.interp(-rail.gauge_depth, rail.z[inner], rail.y[inner]))


def flange_face(wheel: Profile, depth: float) -> float:
    """Lateral position of the flange's face at a depth below the tape circle (m); -inf if it ends above."""
    deep = wheel.y[(wheel.y < 0.0) & (wheel.z >= depth)]
    return float(deep[-1]) if deep.size else -np.inf


def mirrored(profile: Profile) -> Profile:
    """Return the profile seen in a mirror: y of the other sign."""
    return replace(profile, y=-profile.y[::-1], z=profile.z[::-1])


def _sampled(
    shape: Shape, name: str, kind: Kind, tape_to_back: float | None = None
) -> tuple[Array, Array, tuple[str, ...]]:
    """Samples of the curve (m) in the order of y, as given (before shift, cant and datum), and notes."""
    if shape.file is not None:
        measured = read_profile_file(
            Path(shape.file),
            kind,
            unit=shape.unit,
            mirror=shape.mirror,
            invert=shape.invert,
            smoothing=shape.smoothing,
            tape_to_back=tape_to_back,
        )
        y, z = _interpolated(measured.y, measured.z, shape.smoothing)
        _check_width(name, y)
        return y, z, tuple(f"{shape.file}: {note}" for note in measured.notes)
    y, z = _from_zones(shape, name) if shape.zones is not None else _from_points(shape, name)
    _check_width(name, y)
    y = -y[::-1] if shape.mirror else y
    z = z[::-1] if shape.mirror else z
    return y, -z if shape.invert else z, ()


def _from_zones(shape: Shape, name: str) -> tuple[Array, Array]:
    zones = shape.zones or ()
    for before, after in pairwise(zones):
        gap = _height(after, np.array([after.start]))[0] - _height(before, np.array([before.end]))[0]
        if abs(gap) > JOINT_TOLERANCE_MM:
            raise DataError(
                f"profile '{name}': the zones do not meet at y = {after.start:g} mm: step of {gap:.3f} mm"
            )
    count = round((zones[-1].end - zones[0].start) * 1e-3 / SAMPLING)
    y = np.linspace(zones[0].start, zones[-1].end, count + 1)
    owner = np.searchsorted([zone.end for zone in zones[:-1]], y)
    z = np.empty_like(y)
    for index, zone in enumerate(zones):
        z[owner == index] = _height(zone, y[owner == index])
    return y * 1e-3, z * 1e-3


def _height(zone: Line | Arc | Polynomial, y: Array) -> Array:
    """Height of a zone (mm) at lateral positions (mm)."""
    if isinstance(zone, Line):
        return zone.offset + zone.slope * y
    if isinstance(zone, Polynomial):
        return np.asarray(np.polynomial.polynomial.polyval(y, np.array(zone.coefficients)))
    drop = np.sqrt(zone.radius**2 - (y - zone.centre_y) ** 2)
    return zone.centre_z + (drop if zone.side == "upper" else -drop)


def _from_points(shape: Shape, name: str) -> tuple[Array, Array]:
    y, z = np.array(shape.points, dtype=float).T * 1e-3
    if np.any(np.diff(y) <= 0.0):
        where = y[np.argmax(np.diff(y) <= 0.0) + 1] * 1e3
        raise DataError(f"profile '{name}': points must be sorted by increasing y; see y = {where:g} mm")
    return _interpolated(y, z, shape.smoothing)


def _interpolated(y: Array, z: Array, smoothing: float) -> tuple[Array, Array]:
    """Curve through points on the grid of samples, smoothed over a length (m)."""
    # Akima's interpolation does not ring where a straight and a curved part meet.
    y, z = _on_grid(Akima1DInterpolator(y, z, method="makima", extrapolate=True), y[0], y[-1])
    window = 2 * round(0.5 * smoothing / SAMPLING) + 1
    if not 3 < window <= len(y):
        return y, z
    return y, savgol_filter(z, window, polyorder=3, mode="interp")


def _worn(
    config: WheelProfileConfig, y: Array, z: Array, wear: float
) -> tuple[Array, Array, tuple[str, ...]]:
    if isinstance(config.wear, HollowWear):
        # The band is given relative to the tape circle, so it is placed on the shifted curve.
        phase = (y + config.shift - config.wear.centre) / config.wear.half_width
        depth = config.wear.depth * np.cos(0.5 * np.pi * np.clip(phase, -1.0, 1.0)) ** 2
        return y, z - wear * depth, ()
    assert config.wear is not None  # the caller has checked
    worn_y, worn_z, notes = _sampled(config.wear.shape, f"{config.name} (worn)", "wheel", config.tape_to_back)
    both = (y >= worn_y[0]) & (y <= worn_y[-1])
    _check_reach(f"{config.name} (worn)", y[both], TREAD_REACH, "the tape circle")
    y, z = y[both], z[both]
    return y, (1.0 - wear) * z + wear * np.interp(y, worn_y, worn_z), notes


def _on_grid(
    curve: CubicSpline | Akima1DInterpolator, first: float, last: float, offset: float = 0.0
) -> tuple[Array, Array]:
    """Values on whole multiples of the sampling distance between two positions, curve(y + offset)."""
    y = np.arange(np.ceil(first / SAMPLING - 1e-6), np.floor(last / SAMPLING + 1e-6) + 1) * SAMPLING
    return y, np.asarray(curve(y + offset), dtype=float)


def _crown(curve: CubicSpline, y: Array, z: Array) -> float:
    """Position of the highest point: the zero of the slope beside the highest sample."""
    top = int(np.clip(np.argmax(z), 2, len(y) - 3))
    slope = curve.derivative()
    low, high = y[top - 2], y[top + 2]
    if slope(low) * slope(high) >= 0.0:
        return float(y[top])
    return float(brentq(slope, low, high, xtol=1e-12))


def _check_width(name: str, y: Array) -> None:
    width = SAMPLING * (len(y) - 1)
    if width < _NARROWEST:
        raise DataError(
            f"profile '{name}': is {max(0.0, 1e3 * width):g} mm wide, at least {1e3 * _NARROWEST:g} mm are "
            "needed; zones and points are in mm"
        )


def _check_reach(name: str, y: Array, reach: tuple[float, float], datum: str) -> None:
    if len(y) == 0 or y[0] > reach[0] or y[-1] < reach[1]:
        found = f"{y[0] * 1e3:.1f} to {y[-1] * 1e3:.1f} mm" if len(y) else "nothing"
        raise DataError(
            f"profile '{name}': covers {found} from {datum}, at least {reach[0] * 1e3:g} to "
            f"{reach[1] * 1e3:g} mm are needed"
        )
