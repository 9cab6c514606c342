"""Kalker's FASTSIM: creep forces by the simplified theory of rolling contact.

The time loop's table is made from it (`sayd_env.physics.contact.creep`); it can also stand there itself.

The elastic displacement of a point of the contact is proportional to its traction (an elastic foundation).
Tractions build up along strips from the leading to the trailing edge and are cut back to the traction bound.
Three flexibilities L1, L2, L3 make the linear creep forces equal to those of the half-space; large creepage
needs a single one, or the force of a sliding contact would not oppose its creepage. The flexibilities
therefore blend into one as creepage grows, by the rule of the program CONTACT.

In lengths a and b and tractions mu N / (a b) all contacts have one grid and one bound: `march` takes many of
them side by side, element by element, in vector instructions.

References
----------
J. J. Kalker, A fast algorithm for the simplified theory of rolling contact, Vehicle System Dynamics 11 (1982)
1-13. E. A. H. Vollebregt, P. Wilders, FASTSIM2: a second-order accurate frictional rolling contact algorithm,
Computational Mechanics 47 (2011) 105-116: the elliptic bound. E. A. H. Vollebregt, CONTACT (open source,
Vtech CMCC), simplified theory with three flexibilities: the blending.
"""

from __future__ import annotations

import math

import numpy as np

from sayd_env.config.units import Array
from sayd_env.physics.kernel import kernel

# Rows of the rates that `march` reads. Tractions in mu N / (a b), lengths along x in a, along y in b.
RATE_X, RATE_Y, TURN_X, TURN_Y, SEMI_A, SEMI_B = range(6)
RATES = 6
TRACTIONS = 2
"""Rows of scratch that `march` needs."""

# How far from the centre spin is turned into a creepage to measure the size of both together, over sqrt(a b).
# CONTACT takes 1 mm whatever the contact; a creep law without a scale wants a share of the contact. This one
# is 1 mm in a contact with sqrt(a b) = 5.5 mm, that of a wheel load of 75 kN.
_SPIN_ARM = 1.0 / 5.5
# Creepage, in units of the one that saturates in the linear theory, at which one flexibility is left.
_BLEND_END = 3.0
# Added to squared creepages: no creepage gives no force, without a branch.
_NO_CREEP = 1e-60


@kernel(inline=True)
def flexibilities(
    xi_x: float,
    xi_y: float,
    spin: float,
    bound: float,
    a: float,
    b: float,
    c11: float,
    c22: float,
    c23: float,
    shear_modulus: float,
) -> tuple[float, float, float]:
    """Flexibilities (L1, L2, L3) of the simplified theory (m^3/N), blended into one for large creepage.

    Parameters as for `fastsim`, with the bound mu N (N, positive) in place of its factors. For vanishing
    creepage L1 = 8 a / (3 G C11), L2 = 8 a / (3 G C22) and L3 = pi a sqrt(a/b) / (4 G C23). Their weighted
    mean L = (xi_x^2 + xi_y^2 + s^2) / (xi_x^2/L1 + xi_y^2/L2 + s^2/L3) with s = 3 pi a spin / 32 replaces
    them linearly until creepage is three times the one at which the linear forces reach the friction bound.
    """
    flex_x = 8.0 * a / (3.0 * shear_modulus * c11)
    flex_y = 8.0 * a / (3.0 * shear_modulus * c22)
    flex_spin = math.pi * a * math.sqrt(a / b) / (4.0 * shear_modulus * c23)
    turn = 3.0 * math.pi / 32.0 * a * spin
    squares = xi_x * xi_x + xi_y * xi_y + turn * turn + _NO_CREEP
    single = squares / (
        xi_x * xi_x / flex_x + xi_y * xi_y / flex_y + turn * turn / flex_spin + _NO_CREEP / flex_x
    )

    # Creepages that saturate the linear theory, over mu N / (G a b).
    x, y, z = 1.0 / c11, 1.0 / c22, _SPIN_ARM / c23
    saturation = math.sqrt(x * x + y * y + z * z)
    arm = spin * _SPIN_ARM * math.sqrt(a * b)
    size = math.sqrt(xi_x * xi_x + xi_y * xi_y + arm * arm) * (shear_modulus * a * b / bound)
    share = size / (_BLEND_END * saturation)
    share = share if share < 1.0 else 1.0
    return (
        flex_x + share * (single - flex_x),
        flex_y + share * (single - flex_y),
        flex_spin + share * (single - flex_spin),
    )


@kernel(inline=True)
def rates(
    xi_x: float,
    xi_y: float,
    spin: float,
    bound: float,
    a: float,
    b: float,
    c11: float,
    c22: float,
    c23: float,
    shear_modulus: float,
) -> tuple[float, float, float, float]:
    """Growth of a sticking point's traction against the rolling direction, for `march`.

    Parameters as for `flexibilities`. The traction changes by ``-(r_x - t_x y / b, r_y + t_y x / a) mu N /
    (a b)`` over a length a; returned are r_x, r_y, t_x, t_y.
    """
    flex_x, flex_y, flex_spin = flexibilities(xi_x, xi_y, spin, bound, a, b, c11, c22, c23, shear_modulus)
    scale = a * (a * b) / bound
    turn = scale * spin / flex_spin
    return scale * xi_x / flex_x, scale * xi_y / flex_y, turn * b, turn * a


@kernel(distinct=True, allocates=False)
def march(
    rate: Array,
    fx: Array,
    fy: Array,
    mz: Array,
    px: Array,
    py: Array,
    mx: int,
    my: int,
    parabolic: bool,
    whole_elements: bool,
) -> None:
    """Sum up the tractions of many contacts, each on a grid of mx times my elements.

    Parameters
    ----------
    rate : ndarray, shape (RATES * n,)
        Rows RATE_X to TURN_Y as from `rates`, and the semi-axes (m).
    fx, fy, mz : ndarray, shape (n,)
        Receive the forces over mu N and the moment over mu N (m).
    px, py : ndarray, shape (n,)
        Scratch. (Rows of one array would have to be shown to be apart before the loop over contacts becomes
        vector instructions.)
    mx, my, parabolic, whole_elements
        As for `fastsim`.
    """
    n = px.shape[0]
    for k in range(n):
        fx[k] = fy[k] = mz[k] = 0.0
    peak = (2.0 if parabolic else 1.5) / math.pi
    dx, dy = 2.0 / mx, 2.0 / my
    centre = 1.0 / 6.0 if whole_elements else 0.5
    for j in range(my):
        y = -1.0 + (j + 0.5) * dy
        chord = 1.0 - y * y
        first = math.ceil(0.5 * mx * (1.0 - math.sqrt(chord)) - 0.5)
        for k in range(n):
            px[k] = py[k] = 0.0
        for i in range(first, mx - first):
            x = 1.0 - (i + 0.5) * dx
            step = dx
            if i == first and not whole_elements:
                step = math.sqrt(chord) - x
            height = max(chord - x * x, 0.0)
            bound = peak * (height if parabolic else math.sqrt(height))
            middle = x + centre * step
            for k in range(n):
                grown_x = px[k] - (rate[RATE_X * n + k] - rate[TURN_X * n + k] * y) * step
                grown_y = py[k] - (rate[RATE_Y * n + k] + rate[TURN_Y * n + k] * middle) * step
                cut = bound / math.sqrt(grown_x * grown_x + grown_y * grown_y)
                cut = cut if cut < 1.0 else 1.0
                grown_x *= cut
                grown_y *= cut
                px[k] = grown_x
                py[k] = grown_y
                fx[k] += grown_x
                fy[k] += grown_y
                mz[k] += rate[SEMI_A * n + k] * x * grown_y - rate[SEMI_B * n + k] * y * grown_x
    area = dx * dy
    for k in range(n):
        fx[k] *= area
        fy[k] *= area
        mz[k] *= area


@kernel
def fastsim(
    xi_x: float,
    xi_y: float,
    spin: float,
    normal: float,
    a: float,
    b: float,
    c11: float,
    c22: float,
    c23: float,
    friction: float,
    shear_modulus: float,
    mx: int = 50,
    my: int = 50,
    parabolic: bool = False,
    whole_elements: bool = False,
) -> tuple[float, float, float]:
    """Creep forces and spin moment on the wheel by FASTSIM.

    Parameters
    ----------
    xi_x, xi_y, spin, normal, a, b, c11, c22, c23, friction, shear_modulus
        As for `sayd_env.physics.contact.polach.polach`; normal, friction, a and b positive.
    mx, my : int
        Elements of the grid along 2 a and 2 b.
    parabolic : bool
        Traction bound that vanishes linearly at the edge (Kalker 1982) instead of Hertz's half-ellipsoid.
    whole_elements : bool
        March as element codes such as CONTACT do: a point has come one whole element when it reaches the
        first centre, and spin acts at 1/6 of an element ahead of the centre. This is of first order (2 % too
        stiff at 41 x 41) and serves the comparison with them. Otherwise the distance from the edge is exact.

    Returns
    -------
    fx, fy : float
        Forces on the wheel (N).
    mz : float
        Moment about the contact normal (N m).

    Notes
    -----
    Against the rolling direction the traction changes by
    ``-(xi_x / L1 - spin y / L3, xi_y / L2 + spin x / L3)`` per length as long as a point sticks.
    """
    bound = friction * normal
    rate, force, traction = np.empty(RATES), np.empty((3, 1)), np.empty((TRACTIONS, 1))
    rate[RATE_X], rate[RATE_Y], rate[TURN_X], rate[TURN_Y] = rates(
        xi_x, xi_y, spin, bound, a, b, c11, c22, c23, shear_modulus
    )
    rate[SEMI_A], rate[SEMI_B] = a, b
    march(rate, force[0], force[1], force[2], traction[0], traction[1], mx, my, parabolic, whole_elements)
    return bound * force[0, 0], bound * force[1, 0], bound * force[2, 0]
