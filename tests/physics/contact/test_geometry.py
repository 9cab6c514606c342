"""Contact tables: consistency of the potential, symmetry, limits and closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env.config import DataError
from sayd_env.config.contact import ContactConfig
from sayd_env.config.profile import load_rail, load_wheel
from sayd_env.physics.contact import geometry
from sayd_env.physics.contact.conicity import harmonic_conicity, radius_difference
from sayd_env.physics.contact.geometry import cached_contact_table, contact_table, linearised, rigid_contact
from sayd_env.physics.contact.hertz import hertz_coefficients
from sayd_env.physics.profiles import Profile, flange_face, rail_profile, wheel_profile

RADIUS, GAUGE, LOAD = 0.46, 1.435, 75e3
CONFIG = ContactConfig(
    youngs_modulus=2.1e11, poisson_ratio=0.28, regularisation=0.27, table_step=5e-5, table_half_width=12e-3
)


def with_share(share: float) -> ContactConfig:
    return CONFIG.model_copy(update={"regularisation": share})


@pytest.fixture(scope="module")
def rail() -> Profile:
    return rail_profile(load_rail("cn60"))


@pytest.fixture(scope="module", params=[0.0, 0.5, 1.0])
def wheel(request: pytest.FixtureRequest) -> Profile:
    return wheel_profile(load_wheel("s1002cn"), request.param)


def arc_wheel(radius: float, slope: float) -> Profile:
    """Conical tread, hollow with the profile radius (infinite: straight), 0.75 m from the centre."""
    s = np.arange(-1000, 1001) * 5e-5
    hollow = 0.0 if np.isinf(radius) else 0.5 / radius
    return Profile("arc wheel", "wheel", s, hollow * s**2 - slope * s, half_distance=0.75)


def arc_rail(radius: float) -> tuple[Profile, float]:
    """Rail of one arc, and the gauge that puts its crown below a tape circle at 0.75 m."""
    t = np.arange(-2100, 2101) * 5e-5
    depth = 0.014
    rail = Profile("arc rail", "rail", t, np.sqrt(radius**2 - t**2) - radius, gauge_depth=depth)
    return rail, 2.0 * (0.75 - np.sqrt(2.0 * radius * depth - depth**2))


def test_slope_is_the_gradient_of_the_gap(wheel: Profile, rail: Profile) -> None:
    """Under the static load, -d(gap)/d(dy) less the patch's share is the slope; differences of second order.

    The potential (2/5) N d has the lateral force d(gap)/d(dy) + (3/5) d' over the vertical one.
    """
    worst, typical = [], []
    for step in (2e-5, 1e-5):
        config = CONFIG.model_copy(update={"table_step": step})
        table = contact_table(wheel, rail, GAUGE, config, RADIUS, LOAD)
        gradient = np.gradient(table.g0, step) + table.phi_k * np.gradient(table.y_c, step)
        patch = 0.6 * np.gradient(table.static_penetration, step)
        error = np.abs(gradient + patch + table.tan_gamma)[np.abs(table.dy) < 8e-3]
        worst.append(np.max(error))
        typical.append(np.median(error))
    assert typical[1] < 1e-6
    # The worst place is the jump onto the flange, where the slope goes from 0.1 to 2.5 within 0.2 mm.
    assert worst[1] < 1e-2
    assert worst[0] / worst[1] == pytest.approx(4.0, rel=0.2)


def test_both_wheels_carry_the_load_at_the_kinematic_roll(wheel: Profile, rail: Profile) -> None:
    table = contact_table(wheel, rail, GAUGE, CONFIG, RADIUS, LOAD)
    height = table.g0 + table.phi_k * table.y_c + table.static_penetration
    # The right wheel is the left one at the opposite shift, seen in a mirror.
    np.testing.assert_allclose(height, height[::-1], atol=1e-10)
    np.testing.assert_allclose(table.phi_k, -table.phi_k[::-1], atol=1e-15)


def test_flange_pushes_the_wheel_back(wheel: Profile, rail: Profile) -> None:
    table = contact_table(wheel, rail, GAUGE, CONFIG, RADIUS, LOAD)
    flange = table.dy > 8.5e-3
    assert np.all(table.tan_gamma[flange] > 1.0)
    # S1002's flank has 70 degrees (EN 13715); the steepest contact comes close to it.
    assert np.degrees(np.arctan(table.tan_gamma.max())) == pytest.approx(70.0, abs=1.0)
    assert np.all(table.delta_r[flange] > 5e-3)


def test_vanishing_regularisation_is_rigid_contact(wheel: Profile, rail: Profile) -> None:
    step = 2e-5  # resolves the jumps of the smallest depth, 0.3 um
    rigid = rigid_contact(wheel, rail, GAUGE, 12e-3, step=step)
    errors = []
    for share in (0.04, 0.01, 0.0025):
        config = with_share(share).model_copy(update={"table_step": step})
        table = contact_table(wheel, rail, GAUGE, config, RADIUS, LOAD)
        tread = np.abs(table.dy) < 6e-3
        errors.append(np.mean(np.abs(table.delta_r - rigid.delta_r)[tread]))
        penetration = table.static_penetration
        # Without the patch's share of the potential, at the rigid roll: wheels that sink in roll otherwise.
        height = table.g0 + 0.6 * penetration + rigid.roll * table.y_c + rigid.height
        height -= height[len(height) // 2]
        assert np.max(np.abs(height)[tread]) < 5.0 * share * np.max(penetration[tread])
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 5e-6


@pytest.mark.parametrize("hollow", [np.inf, 0.5])
def test_curvature_of_one_arc_on_another(hollow: float) -> None:
    """Relative curvatures of a cone or hollow arc on an arc are known: Hertz's coefficients follow."""
    rail, gauge = arc_rail(0.3)
    table = contact_table(arc_wheel(hollow, 0.02), rail, gauge, with_share(0.1), RADIUS, LOAD, 0.75)
    centre = np.abs(table.dy) < 5e-3
    cosine = 1.0 / np.hypot(1.0, table.tan_gamma[centre])
    # The parabola of the hollow tread has the curvature 1/R * cos^3 at a slope; the rail is a true circle.
    relative = 1.0 / 0.3 - (0.0 if np.isinf(hollow) else cosine**3 / hollow)
    rolling = 0.5 * cosine / (RADIUS + table.delta_r[centre])
    expected = hertz_coefficients(rolling, 0.5 * relative, CONFIG.youngs_modulus, CONFIG.poisson_ratio)
    vertical = per_vertical(expected, cosine)
    for measured, exact in zip((table.compliance, table.a_s, table.b_s), vertical, strict=True):
        np.testing.assert_allclose(measured[centre], exact, rtol=1e-3)


def per_vertical(coefficients: tuple[np.ndarray, ...], cosine: np.ndarray) -> tuple[np.ndarray, ...]:
    """Hertz's coefficients in the table's form: powers of the vertical force."""
    c_hertz, a_s, b_s = coefficients
    per_force = np.cbrt(1.0 / (c_hertz * cosine))
    return per_force**2 / cosine, a_s * per_force, b_s * per_force


def test_cone_on_an_arc() -> None:
    """Conical wheels on circular rails: the rail's slope below the contact is the cone's plus the roll."""
    slope, radius = 0.02, 0.3
    rail, gauge = arc_rail(radius)
    table = contact_table(arc_wheel(np.inf, slope), rail, gauge, with_share(0.02), RADIUS, LOAD, 0.75)
    near = np.abs(table.dy) < 3e-3
    conicity = harmonic_conicity(*radius_difference(table), [2e-3])[0]
    # Wickens, Fundamentals of Rail Vehicle Dynamics, eq. (2.5): circular rail under a cone.
    assert conicity == pytest.approx(slope * 0.75 / (0.75 - radius * slope), rel=5e-3)
    np.testing.assert_allclose(table.tan_gamma[near], slope + table.phi_k[near], atol=1e-5)


def test_smoothing_has_the_variance_of_hertz_pressure() -> None:
    """A share of (2/5) B b^2 / d gives b^2 / 5, the variance of the pressure summed over rolling."""
    rail, gauge = arc_rail(0.3)
    wheel = arc_wheel(0.36, 0.0)
    narrow = contact_table(wheel, rail, gauge, CONFIG, RADIUS, LOAD, 0.75)
    centre = len(narrow.dy) // 2
    across = 0.5 * (1.0 / 0.3 - 1.0 / 0.36)
    share = 0.4 * across * narrow.b_s[centre] ** 2 / narrow.compliance[centre]
    # 2.46 times as wide as long: between the circle's fifth and a quarter.
    assert narrow.b_s[centre] / narrow.a_s[centre] == pytest.approx(2.46, abs=0.02)
    assert 0.2 < share < 0.25
    table = contact_table(wheel, rail, gauge, with_share(share), RADIUS, LOAD, 0.75)
    variance = share * table.static_penetration[centre] / (2.0 * across)
    assert variance == pytest.approx(table.b_s[centre] ** 2 * LOAD ** (2.0 / 3.0) / 5.0, rel=1e-3)


def test_linearised_table(wheel: Profile, rail: Profile) -> None:
    table = contact_table(wheel, rail, GAUGE, CONFIG, RADIUS, LOAD)
    amplitude = 3e-3
    linear = linearised(table, amplitude)
    y, delta_r = radius_difference(linear)
    expected = harmonic_conicity(*radius_difference(table), [amplitude])[0]
    np.testing.assert_allclose(delta_r, 2.0 * expected * y, atol=1e-15)
    np.testing.assert_allclose(np.diff(linear.tan_gamma, 2), 0.0, atol=1e-15)
    np.testing.assert_allclose(-np.gradient(linear.g0, linear.step)[1:-1], linear.tan_gamma[1:-1], atol=1e-12)
    assert np.ptp(linear.y_c) == 0.0
    with pytest.raises(DataError, match="allowed is up to 12 mm"):
        linearised(table, 20e-3)


def test_linearising_a_linear_table_changes_nothing() -> None:
    rail, gauge = arc_rail(0.3)
    table = contact_table(arc_wheel(np.inf, 0.02), rail, gauge, with_share(0.1), RADIUS, LOAD, 0.75)
    near = np.abs(table.dy) < 4e-3
    linear = linearised(table, 2e-3)
    np.testing.assert_allclose(linear.delta_r[near], table.delta_r[near], atol=1e-6)
    np.testing.assert_allclose(linear.tan_gamma[near], table.tan_gamma[near], atol=1e-5)


def test_packed_columns(rail: Profile) -> None:
    table = contact_table(wheel_profile(load_wheel("lmb10")), rail, GAUGE, CONFIG, RADIUS, LOAD)
    packed = table.packed()
    assert packed.shape == (481, geometry.WIDTH)
    assert packed.flags.c_contiguous
    for name in geometry.COLUMNS:
        np.testing.assert_array_equal(packed[:, getattr(geometry, name.upper())], getattr(table, name))
    assert table.g0[240] == 0.0
    assert table.dy[240] == pytest.approx(0.0, abs=1e-15)
    assert np.all(np.isfinite(packed))


def test_wheel_beside_its_rail(rail: Profile) -> None:
    wheel = wheel_profile(load_wheel("s1002cn"))
    for gauge in (1.6, 2.0):
        with pytest.raises(DataError, match="runs off rail 'cn60'"):
            contact_table(wheel, rail, gauge, CONFIG, RADIUS, LOAD)
        with pytest.raises(DataError, match="runs off rail 'cn60'"):
            rigid_contact(wheel, rail, gauge, 12e-3, step=5e-5)


def test_flanges_that_do_not_fit_between_the_rails(rail: Profile) -> None:
    """EN 13715: the flange of S1002 is 32.5 mm thick, 10 mm below the tape circle, and 70 degrees steep."""
    wheel = wheel_profile(load_wheel("s1002"))
    across = 2.0 * (wheel.half_distance + flange_face(wheel, 10e-3))
    assert across == pytest.approx(1.360 + 2.0 * 0.0325, abs=5e-4)
    deeper = across - 2.0 * (rail.gauge_depth - 10e-3) / np.tan(np.radians(70.0))
    for gauge in (1.0, 1.3, deeper - 1e-3):
        with pytest.raises(DataError, match=f"gauge {gauge * 1e3:g} mm: the flanges .* do not fit"):
            contact_table(wheel, rail, gauge, CONFIG, RADIUS, LOAD)
        with pytest.raises(DataError, match="do not fit between the rails"):
            rigid_contact(wheel, rail, gauge, 12e-3, step=5e-5)
    assert np.all(np.isfinite(rigid_contact(wheel, rail, deeper + 1e-3, 12e-3, step=5e-5).delta_r))


def test_a_kept_table_is_the_one_that_was_made(
    rail: Profile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the disk the same bits as made anew; another wheel, load or gauge is another file."""
    monkeypatch.setenv("SAYD_CACHE_DIR", str(tmp_path))
    wheel = wheel_profile(load_wheel("s1002cn"))
    made = contact_table(wheel, rail, GAUGE, CONFIG, RADIUS, LOAD)
    for _ in range(2):
        found = cached_contact_table(wheel, rail, GAUGE, CONFIG, RADIUS, LOAD)
        np.testing.assert_array_equal(found.packed(), made.packed())
        assert (found.dy_min, found.step, found.load) == (made.dy_min, made.step, made.load)
    assert len(list(tmp_path.glob("contact-*.npy"))) == len(list(tmp_path.iterdir())) == 1
    cached_contact_table(wheel, rail, GAUGE + 1e-3, CONFIG, RADIUS, LOAD)
    cached_contact_table(wheel, rail, GAUGE, CONFIG, RADIUS, 0.9 * LOAD)
    assert len(list(tmp_path.iterdir())) == 3
