"""Contact geometry of one wheel on its rail, tabulated over the relative lateral shift.

The unknowns are those of the left wheel (at +y): a shift `dy` of the wheel against its rail at rail level,
positive when the flange approaches the rail. A right wheel is the same table read at minus its shift.

The vertical gap between a wheel point at s from the tape circle and the rail below it is

    gap(s) = z + phi (e + s) - p(s) - h(s + dy + t0)

with the wheelset's height z and roll phi, the wheel curve p, the rail curve h and the rail's position t0.
Rigid bodies touch where the gap is least, and that point jumps. Elastic bodies press a patch, whose mean
moves continuously: contact quantities are means with the weights of the soft minimum (Arnold and Netter's
quasi-elastic contact), w(s) = exp(-gap / eps) / integral. Of a load N they are the arm Y_c = <e + s> of its
vertical part and the slope tan(gamma) = <h'> that gives its lateral part.

For a gap B u^2 the weights have the variance eps / (2 B); Hertz's pressure, summed over the rolling
direction, has b^2 / 5. The two agree if eps = (2/5) B b^2. As A a^2 + B b^2 is the penetration d, that is
0.20 d for a circular patch and 0.27 d for one five times as wide as long; the wide ones are those at a jump,
where eps matters. So eps follows the load: at every node it is one share of that node's penetration
under the static wheel load (`ContactConfig.regularisation`), found together with the patch by iteration.

Hertz's vertical force is N = (d / m)^1.5 with the patch's compliance m(dy) and the vertical penetration
d = -(z + phi Y_c + g0). Its potential (2/5) N d changes along the shift also with m, so that the lateral
force over the vertical one is

    tan = -dg0/d(dy) - phi dY_c/d(dy) - (3/5) m' N^(2/3)

and g0 is what makes this <h'> under the static load N_0, where the penetration is d_0 = m N_0^(2/3), and at
the kinematic roll phi_k, at which both wheels carry that load at one height:

    g0 = -integral <h'> d(dy) - integral phi_k dY_c - (3/5) d_0

So tan = <h'> + (phi_k - phi) dY_c/d(dy) - (3/5) m' (N^(2/3) - N_0^(2/3)): the angle of a contact that moves
with its load, and forces that are the gradient of one potential and do no net work around a loop. What roll
and yaw add to gap and slope, from the same columns, stands in `sayd_env.physics.step`.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, fields
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from sayd_env.config import DataError
from sayd_env.config.contact import ContactConfig
from sayd_env.config.units import Array, Integers
from sayd_env.physics.array_cache import cached_array
from sayd_env.physics.contact import hertz, kalker
from sayd_env.physics.contact.hertz import hertz_coefficients
from sayd_env.physics.contact.kalker import kalker_coefficients
from sayd_env.physics.kernel import kernel
from sayd_env.physics.profiles import Profile, flange_face, gauge_point

DELTA_R, G0, Y_C, TAN_GAMMA, COMPLIANCE, A_S, B_S, C11, C22, C23, PHI_K, COMPLIANCE_SLOPE = range(12)
"""Columns of `ContactTable.packed`."""

COLUMNS = (
    "delta_r",
    "g0",
    "y_c",
    "tan_gamma",
    "compliance",
    "a_s",
    "b_s",
    "c11",
    "c22",
    "c23",
    "phi_k",
    "compliance_slope",
)
"""What they hold: attributes of `ContactTable`."""

WIDTH = len(COLUMNS)
"""Number of these columns."""

_FAR = 1.0  # m; the gap where there is no rail below the wheel
_MARGIN = 1e-3  # m; contact nearer to the end of a wheel's curve is contact on its end
_ROLL_TOLERANCE = 1e-12  # m; difference of the two wheels' gaps
_ROLL_ITERATIONS = 60
_FIRST_PENETRATION = 1e-4  # m; where the search for the static penetration starts
_DEEPEST = 25.0  # smoothing depths over the least gap beyond which a weight is nothing: 1e-11
_NEAR = 4e-3  # m; what may come to weigh something at another roll, or in a flange's deep contact
_COARSE = 4  # every so many samples are enough while changes are above
_COARSE_TOLERANCE = 1e-2  # this
_STATIC_TOLERANCE = 1e-5  # rad; change of the roll and, relative, of the smoothing depth
_DEPTH_SLOPES = (
    -3.0,
    -0.5,
)  # of the depth that a depth calls for less itself, logarithms: what the secant may be
_STATIC_ITERATIONS = 60
_FLATTEST = 1e-3  # 1/m; keeps the ellipse of a perfectly conformal pair finite


@dataclass(frozen=True)
class ContactTable:
    """Contact quantities of a left wheel on a uniform grid of lateral shifts, shape (n,) each.

    Attributes
    ----------
    dy_min, step : float
        First shift and distance of the nodes (m).
    load : float
        Static wheel load of the table (N).
    delta_r : ndarray
        Rolling radius over that of the tape circle (m).
    g0 : ndarray
        Vertical gap at z = 0 and phi = 0 (m); at run time gap = z + phi * y_c + g0. g0 is 0 at dy = 0.
    y_c : ndarray
        Lateral distance of the contact from the wheelset's centre (m).
    tan_gamma : ndarray
        Contact angle; the tangent is lateral over vertical force under the static load, positive where the
        rail pushes the wheel back towards the track centre.
    compliance : ndarray
        Vertical penetration over vertical force^(2/3) (m/N^(2/3)).
    a_s, b_s : ndarray
        Semi-axes in rolling and lateral direction over the cube root of the vertical force (m/N^(1/3)).
    c11, c22, c23 : ndarray
        Kalker's coefficients at the patch's axis ratio.
    phi_k : ndarray
        Kinematic roll of the wheelset against the track at which the node was evaluated (rad), over that in
        the centre: both wheels carry the static load.
    """

    dy_min: float
    step: float
    load: float
    delta_r: Array
    g0: Array
    y_c: Array
    tan_gamma: Array
    compliance: Array
    a_s: Array
    b_s: Array
    c11: Array
    c22: Array
    c23: Array
    phi_k: Array

    @property
    def dy(self) -> Array:
        """Lateral shifts of the nodes (m)."""
        return np.asarray(self.dy_min + self.step * np.arange(len(self.delta_r)), dtype=np.float64)

    @cached_property
    def flat(self) -> Array:
        """The columns for compiled code, node by node: made once, so that vehicles can share it."""
        return self.packed().ravel()

    @property
    def compliance_slope(self) -> Array:
        """Slope of `compliance` over the shift (1/N^(2/3)): of a contact that moves with its load."""
        return np.asarray(np.gradient(self.compliance, self.step))

    @property
    def static_penetration(self) -> Array:
        """Vertical penetration under the static load (m)."""
        return np.asarray(self.load ** (2.0 / 3.0) * self.compliance)

    def packed(self) -> Array:
        """Return the columns for compiled code: (n, `WIDTH`), C-contiguous, `DELTA_R` first."""
        return np.ascontiguousarray(np.column_stack([getattr(self, name) for name in COLUMNS]))


@dataclass(frozen=True)
class RigidContact:
    """Touching points of rigid profiles over the wheelset's lateral position, shape (n,) each.

    Attributes
    ----------
    y : ndarray
        Lateral position of the wheelset at rail level (m), positive to the left.
    roll, height : ndarray
        Kinematic roll (rad) and height (m) of the wheelset, 0 in the centre.
    s : ndarray
        Contact position of the left wheel from its tape circle (m).
    t : ndarray
        Contact position on the left rail from its crown (m).
    delta_r : ndarray
        Rolling radius of the left wheel over that of the tape circle (m).
    """

    y: Array
    roll: Array
    height: Array
    s: Array
    t: Array
    delta_r: Array


def contact_table(
    wheel: Profile,
    rail: Profile,
    gauge: float,
    config: ContactConfig,
    r0: float,
    load: float,
    e: float | None = None,
    other: tuple[Profile, Profile] | None = None,
) -> ContactTable:
    """Tabulate the regularised contact of a wheel on its rail.

    Parameters
    ----------
    wheel, rail : Profile
        Sampled profiles.
    gauge : float
        Track gauge (m), measured at the rail profile's gauge depth.
    config : ContactConfig
        Elastic constants, regularisation, grid.
    r0 : float
        Rolling radius at the tape circle (m).
    load : float
        Static wheel load (N): the regularisation is a share of the penetration under it.
    e : float, optional
        Lateral distance of the tape circle from the wheelset's centre (m); by default the wheel profile's.
    other : tuple of Profile, optional
        Wheel and rail of the wheelset's other side, where they differ; its table is this function's with
        both sides exchanged.

    Raises
    ------
    DataError
        Wheel and rail do not face each other over the whole table.
    """
    sides = _sides((wheel, rail), other, gauge, e, config.table_step, config.half_nodes)
    patch = _static_patch(sides, config, r0, load)
    _check_faces(sides[0], patch.least, patch.y_c - sides[0].e)
    c11, c22, c23 = kalker_coefficients(patch.a_s / patch.b_s, config.poisson_ratio)
    fall = 0.5 * (patch.tan_gamma[1:] + patch.tan_gamma[:-1]) * config.table_step
    fall += 0.5 * (patch.roll[1:] + patch.roll[:-1]) * np.diff(patch.y_c)
    g0 = -np.concatenate([[0.0], np.cumsum(fall)]) - 0.6 * patch.penetration
    return ContactTable(
        dy_min=-config.half_nodes * config.table_step,
        step=config.table_step,
        load=load,
        delta_r=patch.delta_r,
        g0=g0 - g0[config.half_nodes],
        y_c=patch.y_c,
        tan_gamma=patch.tan_gamma,
        compliance=patch.penetration / load ** (2.0 / 3.0),
        a_s=patch.a_s,
        b_s=patch.b_s,
        c11=c11,
        c22=c22,
        c23=c23,
        phi_k=patch.roll,
    )


def cached_contact_table(
    wheel: Profile,
    rail: Profile,
    gauge: float,
    config: ContactConfig,
    r0: float,
    load: float,
    other: tuple[Profile, Profile] | None = None,
) -> ContactTable:
    """`contact_table`, from the disk if it has been made before."""
    own = [field.name for field in fields(ContactTable) if field.name not in ("dy_min", "step", "load")]
    nodes = 2 * config.half_nodes + 1

    def make() -> Array:
        table = contact_table(wheel, rail, gauge, config, r0, load, other=other)
        return np.concatenate([getattr(table, name) for name in own])

    profiles = (wheel, rail, *(other or ()))
    sizes = [(profile.name, profile.half_distance, profile.gauge_depth) for profile in profiles]
    numbers = (gauge, r0, load, sizes, config.model_dump())
    shapes = (values.tobytes() for profile in profiles for values in (profile.y, profile.z))
    flat = cached_array("contact", (repr(numbers).encode(), *shapes, _sources()), len(own) * nodes, make)
    columns = dict(zip(own, flat.reshape(len(own), nodes), strict=True))
    first = -config.half_nodes * config.table_step
    return ContactTable(dy_min=first, step=config.table_step, load=load, **columns)


@cache
def _sources() -> bytes:
    """Digest of the sources that make a table."""
    sources = (Path(source).read_bytes() for source in (__file__, hertz.__file__, kalker.__file__))
    return hashlib.sha256(b"".join(sources)).digest()


def rigid_contact(
    wheel: Profile,
    rail: Profile,
    gauge: float,
    half_width: float,
    step: float = 1e-5,
    e: float | None = None,
    other: tuple[Profile, Profile] | None = None,
) -> RigidContact:
    """Return the touching points of rigid profiles, both wheels in contact.

    Parameters
    ----------
    wheel, rail : Profile
        Sampled profiles.
    gauge : float
        Track gauge (m).
    half_width, step : float
        Largest lateral position and distance of the positions (m).
    e : float, optional
        Lateral distance of the tape circle from the wheelset's centre (m); by default the wheel profile's.
    other : tuple of Profile, optional
        Wheel and rail of the wheelset's other side, as in `contact_table`.

    Raises
    ------
    DataError
        Wheel and rail do not face each other over the whole range.
    """
    sides = _sides((wheel, rail), other, gauge, e, step, round(half_width / step))
    pair, roll, centre = sides[0], _kinematic_roll(sides), round(half_width / step)
    least, position = _lowest(pair.p, pair.h, pair.arm, pair.shifts, roll)
    s = pair.arm[0] - pair.e + position * step
    _check_faces(pair, least, s)
    delta_r = np.interp(s, pair.arm - pair.e, pair.p)
    y = pair.shifts * step - pair.shifts[centre] * step
    height = -least
    return RigidContact(y, roll - roll[centre], height - height[centre], s, s + y + pair.offset, delta_r)


def linearised(table: ContactTable, amplitude: float) -> ContactTable:
    """Harmonic linearisation of a table at an amplitude of lateral motion.

    Parameters
    ----------
    table : ContactTable
        The table.
    amplitude : float
        Amplitude of dy = amplitude sin(theta) (m).

    Returns
    -------
    ContactTable
        Same grid. Rolling radius, contact angle and roll are straight lines: the mean over the cycle and the
        first harmonic's slope. The gap is the angle's integral; contact position and patch are means.

    Raises
    ------
    DataError
        The amplitude is not positive or leaves the table.
    """
    if not 0.0 < amplitude <= -table.dy_min:
        raise DataError(
            f"linearisation amplitude: found {amplitude * 1e3:g} mm (an RMS of "
            f"{amplitude * 1e3 / math.sqrt(2.0):g} mm), allowed is up to {-table.dy_min * 1e3:g} mm "
            f"({-table.dy_min * 1e3 / math.sqrt(2.0):.3g} mm)"
        )
    sine = np.sin(2.0 * np.pi * (np.arange(720) + 0.5) / 720)
    dy = table.dy

    def mean(values: Array) -> float:
        return float(np.mean(np.interp(amplitude * sine, dy, values)))

    def slope(values: Array) -> float:
        return 2.0 * float(np.mean(np.interp(amplitude * sine, dy, values) * sine)) / amplitude

    tan_mean, tan_slope = mean(table.tan_gamma), slope(table.tan_gamma)
    tan_gamma = tan_mean + tan_slope * dy
    constant = {
        name: np.full_like(dy, mean(getattr(table, name)))
        for name in ("y_c", "compliance", "a_s", "b_s", "c11", "c22", "c23")
    }
    return ContactTable(
        dy_min=table.dy_min,
        step=table.step,
        load=table.load,
        delta_r=mean(table.delta_r) + slope(table.delta_r) * dy,
        g0=-(tan_mean * dy + 0.5 * tan_slope * dy**2),
        tan_gamma=tan_gamma,
        phi_k=slope(table.phi_k) * dy,
        **constant,
    )


@dataclass(frozen=True)
class _Pair:
    """Wheel and rail on one common grid, so that a shift of the wheel is a shift of indices."""

    wheel: Profile
    rail: Profile
    e: float  # of the wheel's tape circle (m)
    p: Array  # wheel curve (m)
    h: Array  # rail curve (m), -_FAR beyond the rail
    slope: Array  # rail slope dh/dt
    arm: Array  # e + s of the wheel samples (m)
    shifts: Integers  # index into h below the wheel's first sample, per node
    offset: float  # t - s in the centred position (m)


def _sides(
    own: tuple[Profile, Profile],
    other: tuple[Profile, Profile] | None,
    gauge: float,
    e: float | None,
    step: float,
    half_nodes: int,
) -> tuple[_Pair, ...]:
    """A wheelset's sides, each as a left one: one that stands for both, or the own one and the other.

    Raises
    ------
    DataError
        The flanges do not fit between the rails.
    """
    pairs = (own,) if other is None else (own, other)
    distances = [wheel.half_distance if e is None else e for wheel, _ in pairs]
    faces = [
        distance + flange_face(wheel, rail.gauge_depth)
        for distance, (wheel, rail) in zip(distances, pairs, strict=True)
    ]
    if (across := faces[0] + faces[-1]) >= gauge:
        raise DataError(
            f"gauge {gauge * 1e3:g} mm: the flanges of wheel '{own[0].name}', whose faces are "
            f"{across * 1e3:.1f} mm apart, do not fit between the rails; expected a wider gauge"
        )
    return tuple(
        _pair(*pair, gauge, distance, step, half_nodes)
        for distance, pair in zip(distances, pairs, strict=True)
    )


def _pair(wheel: Profile, rail: Profile, gauge: float, e: float, step: float, half_nodes: int) -> _Pair:
    first, last = np.ceil(wheel.y[0] / step - 1e-6), np.floor(wheel.y[-1] / step + 1e-6)
    s = np.arange(first, last + 1) * step
    offset = e - (0.5 * gauge - gauge_point(rail))
    # Rail samples below every wheel sample at every shift; beyond the rail's ends there is nothing to touch.
    t = s[0] + offset + (np.arange(len(s) + 2 * half_nodes) - half_nodes) * step
    inside = (t >= rail.y[0]) & (t <= rail.y[-1])
    curve, on_rail = CubicSpline(rail.y, rail.z), np.clip(t, rail.y[0], rail.y[-1])
    return _Pair(
        wheel,
        rail,
        e,
        p=np.asarray(CubicSpline(wheel.y, wheel.z)(s)),
        h=np.where(inside, curve(on_rail), -_FAR),
        slope=np.asarray(curve(on_rail, 1)),
        arm=e + s,
        shifts=np.arange(2 * half_nodes + 1),
        offset=offset,
    )


class _Patch(NamedTuple):
    """Patches under the static load, shape (n,) each; as in `ContactTable` where the names are the same."""

    roll: Array
    least: Array  # least gap at z = 0 (m)
    y_c: Array
    tan_gamma: Array
    delta_r: Array
    a_s: Array
    b_s: Array
    penetration: Array  # vertical (m)


def _static_patch(sides: tuple[_Pair, ...], config: ContactConfig, r0: float, load: float) -> _Patch:
    """Smoothing depth, patch and roll at each shift, together: each follows from the others.

    A deeper smoothing widens the patch, which lowers the penetration and so the depth: one solution at each
    node, found by the secant method on the depth's logarithm. Over the roll nodes hardly know each other: it
    changes by about a hundredth of what it changes in its own slopes, so that it settles on the way.

    The roll is taken from where the wheelset stands level with its rigid profiles in the centre.
    """
    level = _kinematic_roll(sides)
    at_rest = level[config.half_nodes]
    roll = level - at_rest
    searches = [_Search(side, config, r0, load, turn) for side, turn in _of_sides(sides, level)]
    for _ in range(_STATIC_ITERATIONS):
        for search, (_, turn) in zip(searches, _of_sides(sides, at_rest + roll), strict=True):
            search.look(turn)
        own, other = searches[0], searches[-1]
        # Moved sideways under their loads, both wheels climb by their slopes, less what they sink in: the
        # roll levels them.
        climb = own.climb + other.climb[::-1]
        old, roll = roll, np.concatenate([[0.0], np.cumsum(climb / (own.arms + other.arms[::-1]))])
        roll = 0.5 * (roll - roll[::-1]) if len(sides) == 1 else roll - roll[config.half_nodes]
        change = max(np.max(np.abs(roll - old)), *(search.change for search in searches))
        if own.stride == 1 and change < _STATIC_TOLERANCE:
            break
        for search in searches:
            search.step(finer=own.stride > 1 and change < _COARSE_TOLERANCE)
    return own.patch(roll)


def _of_sides(sides: tuple[_Pair, ...], roll: Array) -> list[tuple[_Pair, Array]]:
    """Each side with its roll: at y with roll phi the right wheel is a left one at -y with roll -phi."""
    return list(zip(sides, (roll, -roll[::-1]), strict=False))


class _Search:
    """Smoothing depth and patch of one side at each shift, for a roll that is given."""

    def __init__(self, pair: _Pair, config: ContactConfig, r0: float, load: float, roll: Array) -> None:
        self._pair, self._config, self._r0, self._load = pair, config, r0, load
        self._windows = _windows(pair.p, pair.h, pair.arm, pair.shifts, roll)
        self._log_eps = np.full(len(roll), np.log(config.regularisation * _FIRST_PENETRATION))
        self._excess, self._move, self._slope = (
            np.zeros_like(roll),
            np.zeros_like(roll),
            np.full_like(roll, -1.0),
        )
        self.stride = _COARSE

    def look(self, roll: Array) -> None:
        """Find the patch at this depth and roll, and what depth it calls for."""
        pair, config = self._pair, self._config
        eps = np.exp(self._log_eps)
        self._least, moments = _moments(
            pair.p, pair.h, pair.slope, pair.arm, pair.shifts, *self._windows, roll, eps, self.stride
        )
        self._y_c, variance, self._tangent, self._delta_r = moments.T
        variance = np.maximum(variance, config.table_step**2 / 12.0)  # a patch is no narrower than a sample
        self._cosine = 1.0 / np.hypot(1.0, self._tangent)
        # The gap is vertical and its argument horizontal; along the inclined patch both shrink by the cosine.
        lateral = np.maximum(0.5 * eps / variance * self._cosine**3, _FLATTEST)
        rolling = 0.5 * self._cosine / (self._r0 + self._delta_r)
        c, self._a, self._b = hertz_coefficients(
            rolling, lateral, config.youngs_modulus, config.poisson_ratio
        )
        normal = self._load / self._cosine
        self._penetration = (normal / c) ** (2.0 / 3.0) / self._cosine
        self._before = self._excess
        self._excess = np.log(config.regularisation * self._penetration) - self._log_eps

    @property
    def climb(self) -> Array:
        """How much the wheel rises from each node to the next (m)."""
        slope, sunk = self._tangent[1:] + self._tangent[:-1], np.diff(self._penetration)
        return np.asarray(0.5 * self._config.table_step * slope - 0.4 * sunk)

    @property
    def arms(self) -> Array:
        """Arm of the contact between each node and the next (m)."""
        return np.asarray(0.5 * (self._y_c[1:] + self._y_c[:-1]))

    @property
    def change(self) -> float:
        """By how much the depth is off, as a share."""
        return float(np.max(np.abs(self._excess)))

    def step(self, *, finer: bool) -> None:
        """Go on to the next depth."""
        moved = np.abs(self._move) > _STATIC_TOLERANCE
        steepness = (self._excess - self._before)[moved] / self._move[moved]
        self._slope[moved] = np.clip(steepness, *_DEPTH_SLOPES)
        self._move = -self._excess / self._slope
        self._log_eps = self._log_eps + self._move
        if finer:
            self.stride, self._move = 1, np.zeros_like(self._move)  # no secant across the change of samples

    def patch(self, roll: Array) -> _Patch:
        """The patches that were found."""
        per_force = np.sqrt(self._penetration * self._cosine) / np.cbrt(self._load)
        axes = self._a * per_force, self._b * per_force
        return _Patch(roll, self._least, self._y_c, self._tangent, self._delta_r, *axes, self._penetration)


def _kinematic_roll(sides: tuple[_Pair, ...]) -> Array:
    """Roll at each shift at which both rigid wheels have the same gap."""
    own, other = sides[0], sides[-1]
    roll = np.zeros(len(own.shifts))
    for _ in range(_ROLL_ITERATIONS):
        found = [_gap_and_arm(side, turn) for side, turn in _of_sides(sides, roll)]
        (gap, arm), (gap_other, arm_other) = found[0], found[-1]
        difference = gap - gap_other[::-1]
        if np.max(np.abs(difference)) > 0.5 * _FAR:
            raise DataError(_off_profile(own if np.max(gap) > 0.5 * _FAR else other))
        if np.max(np.abs(difference)) < _ROLL_TOLERANCE:
            break
        roll -= difference / (arm + arm_other[::-1])
    return 0.5 * (roll - roll[::-1]) if len(sides) == 1 else roll


def _gap_and_arm(pair: _Pair, roll: Array) -> tuple[Array, Array]:
    """Least gap at each shift and the arm at which it is."""
    gap, position = _lowest(pair.p, pair.h, pair.arm, pair.shifts, roll)
    return gap, pair.arm[0] + position * (pair.arm[1] - pair.arm[0])


def _check_faces(pair: _Pair, least: Array, s: Array) -> None:
    """Refuse contact on the ends of a curve: it would be the end of the data, not of the body."""
    wheel, rail = pair.wheel, pair.rail
    t = s + pair.offset + (pair.shifts - pair.shifts[len(pair.shifts) // 2]) * (pair.arm[1] - pair.arm[0])
    on_wheel = (s > wheel.y[0] + _MARGIN) & (s < wheel.y[-1] - _MARGIN)
    on_rail = (t > rail.y[0] + 0.1 * _MARGIN) & (t < rail.y[-1] - 0.1 * _MARGIN)
    if not np.all(on_wheel & on_rail & (least < 0.5 * _FAR)):
        raise DataError(_off_profile(pair))


def _off_profile(pair: _Pair) -> str:
    return (
        f"wheel '{pair.wheel.name}' runs off rail '{pair.rail.name}' within the contact table: check gauge "
        "and back-to-back distance, or reduce table_half_width"
    )


@kernel
def _lowest(
    p: Array, h: Array, arm: Array, shifts: Integers, roll: Array
) -> tuple[Array, Array]:  # pragma: no cover
    """Least gap of each node (z = 0) and its position in samples, refined by a parabola."""
    nodes, count = len(shifts), len(p)
    least, position = np.empty(nodes), np.empty(nodes)
    for node in range(nodes):
        shift, phi = shifts[node], roll[node]
        best, at = 1e9, 0
        for j in range(count):
            gap = phi * arm[j] - p[j] - h[shift + j]
            if gap < best:
                best, at = gap, j
        least[node], position[node] = best, at
        if 0 < at < count - 1:
            left = phi * arm[at - 1] - p[at - 1] - h[shift + at - 1] - best
            right = phi * arm[at + 1] - p[at + 1] - h[shift + at + 1] - best
            # At the rail's edge the neighbour is the void, not a parabola.
            if left + right > 0.0 and left < 1e-3 and right < 1e-3:
                position[node] = at + 0.5 * (left - right) / (left + right)
                least[node] = best - 0.125 * (left - right) ** 2 / (left + right)
    return least, position


@kernel
def _windows(
    p: Array, h: Array, arm: Array, shifts: Integers, roll: Array
) -> tuple[Integers, Integers]:  # pragma: no cover
    """First and last sample of each node that comes near its least gap: within `_NEAR` at a roll."""
    nodes, count = len(shifts), len(p)
    first, last = np.empty(nodes, dtype=np.int64), np.empty(nodes, dtype=np.int64)
    for node in range(nodes):
        shift, phi = shifts[node], roll[node]
        best = 1e9
        for j in range(count):
            best = min(best, phi * arm[j] - p[j] - h[shift + j])
        low, high = count, 0
        for j in range(count):
            if phi * arm[j] - p[j] - h[shift + j] < best + _NEAR:
                low = min(low, j)
                high = j
        first[node], last[node] = low, high
    return first, last


@kernel
def _moments(
    p: Array,
    h: Array,
    slope: Array,
    arm: Array,
    shifts: Integers,
    first_sample: Integers,
    last_sample: Integers,
    roll: Array,
    eps: Array,
    stride: int,
) -> tuple[Array, Array]:  # pragma: no cover
    """Least gap (z = 0) and weighted means of each node, over every so many samples of its window.

    The columns of the second array: mean arm, variance of the arm, mean rail slope, mean wheel curve.
    """
    nodes = len(shifts)
    least, out = np.empty(nodes), np.empty((nodes, 4))
    for node in range(nodes):
        shift, phi, depth = shifts[node], roll[node], eps[node]
        low, high = first_sample[node], last_sample[node] + 1
        best = 1e9
        for j in range(low, high, stride):
            best = min(best, phi * arm[j] - p[j] - h[shift + j])
        total, first, second, rise, radius = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(low, high, stride):
            height = (phi * arm[j] - p[j] - h[shift + j] - best) / depth
            if height < _DEEPEST:
                weight = np.exp(-height)
                x = arm[j] - arm[low]
                total += weight
                first += weight * x
                second += weight * x * x
                rise += weight * slope[shift + j]
                radius += weight * p[j]
        mean = first / total
        least[node] = best
        out[node, 0] = arm[low] + mean
        out[node, 1] = second / total - mean * mean
        out[node, 2] = rise / total
        out[node, 3] = radius / total
    return least, out
