"""The creep laws of the time loop behind one interface: a table of FASTSIM, Polach's law, FASTSIM itself.

FASTSIM with three flexibilities has no scale: over mu N its forces depend on the ratio of the semi-axes and
on

    u = G a b C11 xi_x / (mu N),  v = G a b C22 xi_y / (mu N),  w = G (a b)^1.5 C23 spin / (mu N)

alone, for one Poisson's ratio. The linear theory's forces are -u and -(v + w). A table over these four
numbers replaces the march through the contact. The creepages, which have no end, are drawn into a ball,

    (U, V, W) = (u, v, s w) / (c + sqrt(u^2 + v^2 + (s w)^2)),

which keeps their directions: on its surface stand the forces of a sliding contact. In U, V and W the table is
a quadratic B-spline, so that forces and their slopes are continuous; over the ellipse it is linear, as the
contact table is over the shift. The slopes at no creepage are set to those of the linear theory.

Tabulated is what remains when a part is taken away that has a peak at no creepage, where a spline has none.
In the ball the linear forces are c U / (1 - R) and so on, R the distance from the centre: they grow by R. The
slip that begins at the trailing edge takes a third of sqrt(u^2 + v^2) off the forces of u and v, and to first
order nothing off that of w. In all

    fx = -c (1 - c/3) P U + spline,  fy = -(c (1 - c/3) V + c/s W) P + spline,  P = R (1 - R)^2.

Without that part forces are 2 to 3 % too small where new wheels run, at a tenth of mu N.

The forces are odd in xi_x and in (xi_y, spin) together, so a quarter of the ball is tabulated, with nodes
beyond its faces that continue the spline by symmetry. Cells that the ball's surface cuts have nodes outside,
where the forces are continued along the radius.

Arrays are flat, element ``row * n + i`` for contact i of n.

References
----------
J. J. Kalker, A fast algorithm for the simplified theory of rolling contact, Vehicle System Dynamics 11 (1982)
1-13. E. A. H. Vollebregt, S. D. Iwnicki, G. Xie, P. Shackleton, Assessing the accuracy of different
simplified frictional rolling contact algorithms, Vehicle System Dynamics 50 (2012) 1-17: what FASTSIM and
tables are worth.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from sayd_env.config.units import Array
from sayd_env.physics.array_cache import cached_array
from sayd_env.physics.contact import fastsim, kalker
from sayd_env.physics.contact.polach import polach
from sayd_env.physics.kernel import kernel

LAWS = ("table", "polach", "fastsim")
"""Names of the laws; compiled code knows them by their place."""
TABLE, POLACH, FASTSIM = range(3)

# Rows in: a contact's creepages, friction bound mu N (N), semi-axes (m) and Kalker's coefficients.
XI_X, XI_Y, SPIN, BOUND, SEMI_A, SEMI_B, C11, C22, C23 = range(9)
ROWS_IN = 9
# Rows out: forces on the wheel (N) and moment about the contact's normal (N m), which FASTSIM alone gives.
FX, FY, MZ = range(3)
ROWS_OUT = 3

# Nodes. In creepage and spin errors fall with the square of the cells' size; spin wants the finer ones.
_CELLS_U, _CELLS_V, _CELLS_W = 8, 8, 14
_CORE, _SPIN_SCALE = 1.5, math.sqrt(3.0)  # c and s above
_PEAK = _CORE * (1.0 - _CORE / 3.0)
_SPIN_PEAK = _CORE / _SPIN_SCALE
_RATIOS = 13
# Ellipses: a/b from 1/15 to 10, clamped beyond, in steps of sqrt(a) / (sqrt(a) + _RATIO_MIDDLE sqrt(b)).
# Two steps from 10 down lies 5, where Kalker's coefficients, linear between the entries of their table E.3,
# have a strong kink. That table ends at 1/10, and the coefficients are constant beyond; forces are not. This
# table goes on to 1/15, which leaves room below 0.11, to which a worn wheel's patch is widened at a jump.
_RATIO_MIDDLE = 1.9
_FIFTH_RATIO, _LAST_RATIO = (math.sqrt(r) / (math.sqrt(r) + _RATIO_MIDDLE) for r in (5.0, 10.0))
_RATIO_STEP = 0.5 * (_LAST_RATIO - _FIFTH_RATIO)
_FIRST_RATIO = _LAST_RATIO - (_RATIOS - 1) * _RATIO_STEP
_RATIO_SCALE = 1.0 / _RATIO_STEP
_ELEMENTS = 64  # of FASTSIM's grid along both semi-axes, for the table
_MARCH_ELEMENTS = 32  # the same in the time loop
_SURFACE = 1.0 - 1e-6  # radius that stands for that of the surface, where creepages are infinite
_BLOCK = 256  # contacts that FASTSIM takes side by side: their rows stay in the cache
_ROUNDED = 5e-3  # of mu N: forces turn into Coulomb's limit between 1 - this and 1 + this
_PER_ROUNDED = 0.25 / _ROUNDED
_MARGIN = 2  # nodes beyond the ball's faces while the spline is made

# The table's strides. A row holds the nodes of U, each with both forces.
_FORCES = 2
_SIDE_U, _SIDE_V, _SIDE_W = _CELLS_U + 3, 2 * _CELLS_V + 3, _CELLS_W + 3
_V1 = _FORCES * _SIDE_U
_V2 = 2 * _V1
_W1 = _V1 * _SIDE_V
_W2 = 2 * _W1
_RATIO = _W1 * _SIDE_W
_ZERO_U, _ZERO_V, _ZERO_W = 1.0, 1.0 + _CELLS_V, 1.0  # nodes of no creepage
_FIRST = -(_W1 + _V1 + _FORCES)  # from a stencil's middle to its first node

WIDTH = 8
"""Numbers read of each row: three nodes' pairs, and one pair more that fills a vector register."""

SCRATCH_ROWS = fastsim.RATES + fastsim.TRACTIONS
"""Rows of scratch that each law may use."""

# Least friction bound to divide by (N), and sum of semi-axes (m): a wheel in the air.
_NO_FORCE = 1e-9
_NO_PATCH = 1e-30
# Added to a force over mu N that is divided by.
_NO_SIZE = 1e-300


def scratch(n: int) -> Array:
    """Return scratch memory for the laws' work on n contacts."""
    return np.zeros(SCRATCH_ROWS * n + WIDTH)


@kernel(distinct=True, allocates=False)
def table_rows(  # noqa: PLR0915 - three loops: into the ball, the spline, back to forces
    x: Array, out: Array, scratch: Array, table: Array, shear_modulus: float
) -> None:
    """Creep forces from the table of `creep_table`.

    Parameters
    ----------
    x : ndarray, shape (ROWS_IN * n,)
        Contacts. One without a friction bound gets no force.
    out : ndarray, shape (ROWS_OUT * n,)
        Receives the forces on the wheel (N).
    scratch : ndarray
        From `scratch`.
    table : ndarray
        From `creep_table`.
    shear_modulus : float
        G (Pa).
    """
    n = x.shape[0] // ROWS_IN
    # No more than four rows of one array are written in a loop: the compiler has to show that they are apart.
    for i in range(n):
        a, b, bound = x[SEMI_A * n + i], x[SEMI_B * n + i], x[BOUND * n + i]
        stiffness = shear_modulus * a * b / (bound if bound > _NO_FORCE else _NO_FORCE)
        u = stiffness * x[C11 * n + i] * x[XI_X * n + i]
        v = stiffness * x[C22 * n + i] * x[XI_Y * n + i]
        root = math.sqrt(a * b)
        w = _SPIN_SCALE * stiffness * root * x[C23 * n + i] * x[SPIN * n + i]
        inward = 1.0 / (_CORE + math.sqrt(u * u + v * v + w * w))
        u, v, w = inward * abs(u), inward * v * (1.0 if x[SPIN * n + i] >= 0.0 else -1.0), inward * abs(w)
        # Within the ball by construction; the bounds keep what is not a number inside the table.
        u = u if u < 1.0 else 1.0
        w = w if w < 1.0 else 1.0
        v = v if v < 1.0 else 1.0
        v = v if v > -1.0 else -1.0
        # The part with a peak, in place of the forces.
        remote = _CORE * inward
        peak = (1.0 - remote) * remote * remote
        out[n + i] = _PEAK * peak * u
        out[2 * n + i] = peak * (_PEAK * v + _SPIN_PEAK * w)
        ratio = (a / (a + _RATIO_MIDDLE * root + _NO_PATCH) - _FIRST_RATIO) * _RATIO_SCALE
        ratio = ratio if ratio > 0.0 else 0.0
        ratio = ratio if ratio < _RATIOS - 1.0 else _RATIOS - 1.0
        plane = np.floor(ratio)
        plane = plane if plane < _RATIOS - 2.0 else _RATIOS - 2.0
        u, v, w = u * _CELLS_U + _ZERO_U, v * _CELLS_V + _ZERO_V, w * _CELLS_W + _ZERO_W
        near_u, near_v, near_w = np.rint(u), np.rint(v), np.rint(w)
        scratch[i] = u - near_u
        scratch[n + i] = v - near_v
        scratch[2 * n + i] = w - near_w
        scratch[3 * n + i] = ratio - plane
        out[i] = plane * _RATIO + near_w * _W1 + near_v * _V1 + near_u * _FORCES + _FIRST

    row = scratch[SCRATCH_ROWS * n :]
    for i in range(n):
        node = np.uint32(out[i])
        above_node = node + np.uint32(_RATIO)
        u0, u1, u2 = _weights(scratch[i])
        v0, v1, v2 = _weights(scratch[n + i])
        w0, w1, w2 = _weights(scratch[2 * n + i])
        above = scratch[3 * n + i]
        below = 1.0 - above
        p00, p01, p02 = w0 * v0, w0 * v1, w0 * v2
        p10, p11, p12 = w1 * v0, w1 * v1, w1 * v2
        p20, p21, p22 = w2 * v0, w2 * v1, w2 * v2
        for c in range(row.shape[0]):
            k, m = node + c, above_node + c
            row[c] = below * (
                (p00 * table[k] + p01 * table[k + _V1] + p02 * table[k + _V2])
                + (p10 * table[k + _W1] + p11 * table[k + _W1 + _V1] + p12 * table[k + _W1 + _V2])
                + (p20 * table[k + _W2] + p21 * table[k + _W2 + _V1] + p22 * table[k + _W2 + _V2])
            ) + above * (
                (p00 * table[m] + p01 * table[m + _V1] + p02 * table[m + _V2])
                + (p10 * table[m + _W1] + p11 * table[m + _W1 + _V1] + p12 * table[m + _W1 + _V2])
                + (p20 * table[m + _W2] + p21 * table[m + _W2 + _V1] + p22 * table[m + _W2 + _V2])
            )
        out[i] = u0 * row[0] + u1 * row[2] + u2 * row[4] - out[n + i]
        out[n + i] = u0 * row[1] + u1 * row[3] + u2 * row[5] - out[2 * n + i]

    for i in range(n):
        bound = x[BOUND * n + i]
        bound = bound if bound > 0.0 else 0.0
        # The spline passes Coulomb's limit by half a per cent (1.6 % at a/b 0.1): taken off without a kink.
        fx, fy = out[i], out[n + i]
        size = math.sqrt(fx * fx + fy * fy)
        kept = size if size < 1.0 + _ROUNDED else 1.0 + _ROUNDED
        beyond = kept - (1.0 - _ROUNDED)
        beyond = beyond if beyond > 0.0 else 0.0
        bound *= (kept - beyond * beyond * _PER_ROUNDED) / (size + _NO_SIZE)
        out[i] = fx * bound * (1.0 if x[XI_X * n + i] >= 0.0 else -1.0)
        out[n + i] = fy * bound * (1.0 if x[SPIN * n + i] >= 0.0 else -1.0)
        out[MZ * n + i] = 0.0


@kernel(inline=True)
def _weights(f: float) -> tuple[float, float, float]:
    """Weights of the quadratic B-spline's three nodes, f from the middle one in cells (-1/2 to 1/2)."""
    return 0.5 * (0.5 - f) * (0.5 - f), 0.75 - f * f, 0.5 * (0.5 + f) * (0.5 + f)


@kernel(distinct=True, allocates=False)
def polach_rows(x: Array, out: Array, scratch: Array, table: Array, shear_modulus: float) -> None:
    """Creep forces by Polach's law, with the parameters of `table_rows`."""
    n = x.shape[0] // ROWS_IN
    for i in range(n):  # as `polach_spin_gain`
        scratch[i] = 1.0 - 6.3 * math.expm1(-x[SEMI_A * n + i] / (x[SEMI_B * n + i] + _NO_PATCH))
    for i in range(n):
        out[MZ * n + i] = 0.0
        out[i], out[n + i] = polach(
            x[XI_X * n + i],
            x[XI_Y * n + i],
            x[SPIN * n + i],
            x[BOUND * n + i],
            x[SEMI_A * n + i],
            x[SEMI_B * n + i],
            x[C11 * n + i],
            x[C22 * n + i],
            x[C23 * n + i],
            scratch[i],
            1.0,
            shear_modulus,
        )


@kernel(allocates=False)
def fastsim_rows(x: Array, out: Array, scratch: Array, table: Array, shear_modulus: float) -> None:
    """Creep forces by FASTSIM with the parabolic bound, with the parameters of `table_rows`.

    `table` holds one number: the elements of the grid along both semi-axes. Some twenty times slower than the
    table: the reference to judge it by.
    """
    n, elements = x.shape[0] // ROWS_IN, int(table[0])
    rate = scratch[: fastsim.RATES * n]
    px, py = scratch[fastsim.RATES * n : -WIDTH - n], scratch[-WIDTH - n : -WIDTH]
    for i in range(n):
        a, b, bound = x[SEMI_A * n + i], x[SEMI_B * n + i], x[BOUND * n + i]
        a, b = (a, b) if a * b > _NO_PATCH else (1.0, 1.0)
        bound = bound if bound > _NO_FORCE else _NO_FORCE
        rate_x, rate_y, turn_x, turn_y = fastsim.rates(
            x[XI_X * n + i],
            x[XI_Y * n + i],
            x[SPIN * n + i],
            bound,
            a,
            b,
            x[C11 * n + i],
            x[C22 * n + i],
            x[C23 * n + i],
            shear_modulus,
        )
        rate[fastsim.RATE_X * n + i] = rate_x
        rate[fastsim.RATE_Y * n + i] = rate_y
        rate[fastsim.TURN_X * n + i] = turn_x
        rate[fastsim.TURN_Y * n + i] = turn_y
        rate[fastsim.SEMI_A * n + i] = a
        rate[fastsim.SEMI_B * n + i] = b
    fx, fy, mz = out[:n], out[n : 2 * n], out[2 * n :]
    fastsim.march(rate, fx, fy, mz, px, py, elements, elements, True, False)
    for i in range(n):
        bound = x[BOUND * n + i]
        bound = bound if bound > 0.0 else 0.0
        for row in range(ROWS_OUT):
            out[row * n + i] *= bound


def law_table(law: str, poisson_ratio: float) -> Array:
    """Return what a law of `LAWS` reads as its table; nothing for Polach's law."""
    if law == "table":
        return creep_table(poisson_ratio)
    return np.array([float(_MARCH_ELEMENTS)] if law == "fastsim" else [])


@lru_cache(maxsize=8)
def creep_table(poisson_ratio: float) -> Array:
    """Return the table of `table_rows` for a Poisson's ratio, from the disk if it has been made before.

    It lies beside the compiled kernels in a file named by the hash of all that it is made from: sources of
    this module, of FASTSIM and of Kalker's coefficients, and Poisson's ratio. A file that is damaged is made
    anew; without a place to write the table is made in every process (a third of a second).
    """
    sources = (Path(source).read_bytes() for source in (__file__, fastsim.__file__, kalker.__file__))
    content = (repr(float(poisson_ratio)).encode(), *sources)
    return cached_array("creep", content, _LENGTH, lambda: build_table(poisson_ratio))


def build_table(poisson_ratio: float, elements: int = _ELEMENTS) -> Array:
    """Make the table of `table_rows`, flat, from FASTSIM with the parabolic bound.

    Parameters
    ----------
    poisson_ratio : float
        Poisson's ratio.
    elements : int
        Elements of FASTSIM along each semi-axis.
    """
    table = np.empty((_RATIOS, _SIDE_W, _SIDE_V, _SIDE_U, _FORCES))
    for plane, t in enumerate(np.linspace(_FIRST_RATIO, _LAST_RATIO, _RATIOS)):
        forces = _node_forces((_RATIO_MIDDLE * t / (1.0 - t)) ** 2, poisson_ratio, elements) - _peaked_part()
        for component, values in enumerate(forces):
            spline = _spline(values, component)
            table[plane, ..., component] = np.moveaxis(spline, (0, 1, 2), (2, 1, 0))
    return np.append(table.ravel(), np.zeros(WIDTH))  # the last row is read beyond its end


_LENGTH = _RATIOS * _RATIO + WIDTH


def _axis(cells: int, two_sided: bool) -> Array:
    """Places of the nodes along an axis of the ball, with the margin beyond its faces."""
    end = cells + _MARGIN
    return np.arange(-end if two_sided else 0, end + 1) / cells


def _nodes() -> Array:
    """Places of the nodes of U >= 0, all V, W >= 0, shape (3, U, V, W)."""
    axes = (_axis(_CELLS_U, False), _axis(_CELLS_V, True), _axis(_CELLS_W, False))
    return np.stack(np.meshgrid(*axes, indexing="ij"))


def _peaked_part() -> Array:
    """The part of the forces that is not tabulated, at the nodes, shape (2, U, V, W)."""
    u, v, w = _nodes()
    remote = np.maximum(1.0 - np.sqrt(u * u + v * v + w * w), 0.0)
    peak = (1.0 - remote) * remote**2
    return np.stack([-peak * _PEAK * u, -peak * (_PEAK * v + _SPIN_PEAK * w)])


def _node_forces(a_over_b: float, poisson_ratio: float, elements: int) -> Array:
    """Forces over mu N at the nodes of U >= 0, all V, W >= 0, shape (2, U, V, W)."""
    place = _nodes()
    radius = np.sqrt(np.sum(place**2, axis=0))
    outside = radius > 1.0
    direction = place / np.where(outside, radius, 1.0)
    forces = _forces_in_ball(direction, a_over_b, poisson_ratio, elements)
    # Beyond the surface: as far from the force there as the force equally deep below, on the other side.
    mirrored = _forces_in_ball(
        (2.0 - radius[outside]) * direction[:, outside], a_over_b, poisson_ratio, elements
    )
    forces[:, outside] = 2.0 * forces[:, outside] - mirrored
    return forces


def _forces_in_ball(place: Array, a_over_b: float, poisson_ratio: float, elements: int) -> Array:
    """Forces over mu N by FASTSIM at places (3, ...) of the ball."""
    points = place.reshape(3, -1)
    radius = np.minimum(np.sqrt(np.sum(points**2, axis=0)), _SURFACE)
    u, v, w = _CORE * points / (1.0 - radius)
    n = points.shape[1]
    c11, c22, c23 = kalker.kalker_coefficients(a_over_b, poisson_ratio)
    # A contact with mu N = G = a b = 1.
    a, b = math.sqrt(a_over_b), math.sqrt(1.0 / a_over_b)
    columns = (u / c11, v / c22, w / (_SPIN_SCALE * c23), 1.0, a, b, c11, c22, c23)
    rows = np.array([np.broadcast_to(column, n) for column in columns])
    forces = np.empty((_FORCES, n))
    for begin in range(0, n, _BLOCK):
        part = np.ascontiguousarray(rows[:, begin : begin + _BLOCK])
        out = np.empty((ROWS_OUT, part.shape[1]))
        fastsim_rows(part.ravel(), out.ravel(), scratch(part.shape[1]), np.array([float(elements)]), 1.0)
        forces[:, begin : begin + _BLOCK] = out[:_FORCES]
    return forces.reshape((_FORCES, *place.shape[1:]))


def _spline(values: Array, component: int) -> Array:
    """Coefficients of the quadratic B-spline through the nodes of `_node_forces`, cut to the table's nodes.

    The slopes at no creepage are then made those of the linear theory by the nodes around it: Fx = -u,
    Fy = -(v + w).
    """
    from scipy.ndimage import spline_filter  # noqa: PLC0415 - only who makes a table pays for it

    across = values[:, ::-1, :0:-1]  # W < 0 from (V, W) -> -(V, W)
    half = np.concatenate([across if component == FX else -across, values], axis=2)
    ahead = half[:0:-1]  # U < 0
    whole = np.concatenate([-ahead if component == FX else ahead, half], axis=0)
    spline = spline_filter(whole, order=2, mode="mirror")
    cells = (_CELLS_U, _CELLS_V, _CELLS_W)
    middle = tuple(m + _MARGIN for m in cells)
    weights = np.array([0.125, 0.75, 0.125])
    for axis, slope in ((0, -_CORE), (1, -_CORE), (2, -_CORE / _SPIN_SCALE)):
        if (axis == 0) != (component == FX):
            continue
        turned = np.moveaxis(spline, axis, 0)
        at = middle[axis]
        others = tuple(slice(m - 1, m + 2) for k, m in enumerate(middle) if k != axis)
        ahead, behind = turned[(at + 1, *others)], turned[(at - 1, *others)]
        lack = slope / cells[axis] - 0.5 * weights @ (ahead - behind) @ weights
        ahead += lack
        behind -= lack
    least = (-1, -_CELLS_V - 1, -1)
    u, v, w = (slice(m + n, m + k + 2) for m, n, k in zip(middle, least, cells, strict=True))
    return np.asarray(spline[u, v, w])


def creep_forces(
    law: str,
    xi_x: ArrayLike,
    xi_y: ArrayLike,
    spin: ArrayLike,
    normal: ArrayLike,
    a: ArrayLike,
    b: ArrayLike,
    friction: ArrayLike,
    shear_modulus: float,
    poisson_ratio: float,
) -> Array:
    """Creep forces and spin moment by a law of the time loop, for arrays that broadcast against each other.

    Parameters
    ----------
    law : str
        One of `LAWS`.
    xi_x, xi_y, spin, normal, a, b, friction, shear_modulus
        As for `sayd_env.physics.contact.polach.polach`; all but the last may be arrays.
    poisson_ratio : float
        Poisson's ratio, from which Kalker's coefficients follow.

    Returns
    -------
    ndarray, shape (3, ...)
        Forces on the wheel (N) and moment about the contact's normal (N m).

    Raises
    ------
    ValueError
        The law has another name.
    """
    if law not in LAWS:
        raise ValueError(f"creep law {law!r}: expected one of {', '.join(LAWS)}")
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    coefficients = kalker.kalker_coefficients(a / b, poisson_ratio)
    bound = np.asarray(friction, dtype=float) * normal
    columns = np.broadcast_arrays(xi_x, xi_y, spin, bound, a, b, *coefficients)
    shape = columns[0].shape
    x = np.concatenate([np.ravel(column) for column in columns]).astype(float)
    n = x.size // ROWS_IN
    out = np.empty(ROWS_OUT * n)
    kernels = (table_rows, polach_rows, fastsim_rows)
    kernels[LAWS.index(law)](x, out, scratch(n), law_table(law, poisson_ratio), shear_modulus)
    return out.reshape(ROWS_OUT, *shape)
