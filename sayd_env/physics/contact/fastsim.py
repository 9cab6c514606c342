"""Kalker's FASTSIM: creep forces by the simplified theory of rolling contact, the reference for the tests.

The elastic displacement of a point of the contact is proportional to its traction (an elastic foundation).
Tractions build up along strips from the leading to the trailing edge and are cut back to the traction bound.
Three flexibilities L1, L2, L3 make the linear creep forces equal to those of the half-space; large creepage
needs a single one, or the force of a sliding contact would not oppose its creepage. The flexibilities
therefore blend into one as creepage grows, by the rule of the program CONTACT.

References
----------
J. J. Kalker, A fast algorithm for the simplified theory of rolling contact, Vehicle System Dynamics 11 (1982)
1-13. E. A. H. Vollebregt, P. Wilders, FASTSIM2: a second-order accurate frictional rolling contact algorithm,
Computational Mechanics 47 (2011) 105-116: the elliptic bound. E. A. H. Vollebregt, CONTACT (open source,
Vtech CMCC), simplified theory with three flexibilities: the blending.
"""

from __future__ import annotations

import math

from sayd_env.physics.kernel import kernel

# CONTACT measures the size of a creepage with spin in 1/mm, whatever the size of the contact.
_SPIN_LENGTH = 1e-3
# Creepage, in units of the one that saturates in the linear theory, at which one flexibility is left.
_BLEND_END = 3.0


@kernel
def flexibilities(
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
) -> tuple[float, float, float]:
    """Flexibilities (L1, L2, L3) of the simplified theory (m^3/N), blended into one for large creepage.

    Parameters as for `fastsim`. For vanishing creepage L1 = 8 a / (3 G C11), L2 = 8 a / (3 G C22) and
    L3 = pi a sqrt(a/b) / (4 G C23). Their weighted mean L = (xi_x^2 + xi_y^2 + s^2) / (xi_x^2/L1 + xi_y^2/L2
    + s^2/L3) with s = 3 pi a spin / 32 replaces them linearly until creepage is three times the one at which
    the linear forces reach the friction bound.
    """
    flex_x = 8.0 * a / (3.0 * shear_modulus * c11)
    flex_y = 8.0 * a / (3.0 * shear_modulus * c22)
    flex_spin = math.pi * a * math.sqrt(a / b) / (4.0 * shear_modulus * c23)
    turn = 3.0 * math.pi / 32.0 * a * spin
    squares = xi_x * xi_x + xi_y * xi_y + turn * turn
    if squares == 0.0:
        return flex_x, flex_y, flex_spin
    single = squares / (xi_x * xi_x / flex_x + xi_y * xi_y / flex_y + turn * turn / flex_spin)

    unit = friction * normal / (shear_modulus * a * b)
    saturation = math.hypot(
        math.hypot(unit / c11, unit / c22), unit / (c23 * math.sqrt(a * b)) * _SPIN_LENGTH
    )
    size = math.hypot(math.hypot(xi_x, xi_y), spin * _SPIN_LENGTH)
    share = min(1.0, size / (_BLEND_END * saturation))
    return (
        flex_x + share * (single - flex_x),
        flex_y + share * (single - flex_y),
        flex_spin + share * (single - flex_spin),
    )


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
    flex_x, flex_y, flex_spin = flexibilities(
        xi_x, xi_y, spin, normal, a, b, c11, c22, c23, friction, shear_modulus
    )
    rate_spin = spin / flex_spin
    peak = (2.0 if parabolic else 1.5) * friction * normal / (math.pi * a * b)
    dx = 2.0 * a / mx
    dy = 2.0 * b / my
    centre = 1.0 / 6.0 if whole_elements else 0.5
    fx = fy = mz = 0.0
    for j in range(my):
        y = -b + (j + 0.5) * dy
        chord = 1.0 - (y / b) ** 2
        rate_x = xi_x / flex_x - rate_spin * y
        first = math.ceil(0.5 * mx * (1.0 - math.sqrt(chord)) - 0.5)
        px = py = 0.0
        for i in range(first, mx - first):
            x = a - (i + 0.5) * dx
            step = dx
            if i == first and not whole_elements:
                step = a * math.sqrt(chord) - x
            rate_y = xi_y / flex_y + rate_spin * (x + centre * step)
            px -= rate_x * step
            py -= rate_y * step
            height = max(chord - (x / a) ** 2, 0.0)
            bound = peak * (height if parabolic else math.sqrt(height))
            traction = math.hypot(px, py)
            if traction > bound:
                px *= bound / traction
                py *= bound / traction
            fx += px
            fy += py
            mz += x * py - y * px
    return fx * dx * dy, fy * dx * dy, mz * dx * dy
