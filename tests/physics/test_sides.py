"""Left and right wheels and rails apart: what is true of wheelsets of two sides and of their vehicles."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.config import ConfigError
from sayd_env.config.scenario import load_scenario
from sayd_env.config.units import Array
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.contact.conicity import equivalent_conicity, harmonic_conicity, radius_difference
from sayd_env.physics.contact.geometry import ContactTable, rigid_contact
from sayd_env.physics.profiles import Profile
from sayd_env.physics.simulator import Simulator, VehicleModel

SAMPLES, SPEED = 150, 60.0
AMPLITUDES = np.arange(1, 6) * 1e-3


def model(*overrides: str) -> VehicleModel:
    return VehicleModel(load_scenario("manchester", ["track=smooth", *overrides]))


@pytest.fixture(scope="module")
def two_sided() -> VehicleModel:
    return model("wheel={left: s1002, right: en15302_a}", "rail={left: '60e1', right: en15302_rail_a}")


@pytest.fixture(scope="module")
def exchanged() -> VehicleModel:
    return model("wheel={left: en15302_a, right: s1002}", "rail={left: en15302_rail_a, right: '60e1'}")


def vehicle(of: VehicleModel, offset: float) -> Simulator:
    """A vehicle on smooth track with its wheelsets off the centre (m)."""
    simulator = Simulator(of, SPEED)
    simulator.state.q[of.multibody.wheelset_dofs[:, 1]] = offset
    return simulator


def signals(simulator: Simulator) -> Array:
    run = simulator.advance(SAMPLES)
    return np.hstack([run.acceleration, run.track_shift])


def test_the_mirrored_vehicle_moves_as_in_a_mirror(two_sided: VehicleModel, exchanged: VehicleModel) -> None:
    there, back = signals(vehicle(two_sided, 2e-3)), signals(vehicle(exchanged, -2e-3))
    assert np.max(np.abs(there)) > 1.0
    np.testing.assert_allclose(back, -there, atol=1e-6 * np.max(np.abs(there)))
    # Its wheelsets do not stand in the middle, which those of a vehicle with two like sides do.
    assert np.max(np.abs(signals(vehicle(two_sided, 0.0)))) > 1e-3
    assert np.max(np.abs(signals(vehicle(model(), 0.0)))) < 1e-6


def test_two_sides_that_are_alike_are_one() -> None:
    plain, named = (
        model(),
        model("wheel={left: s1002, right: s1002}", "rail={left: '60e1', right: '60e1'}"),
    )
    assert named.right_table is None
    for ours, theirs in zip(vehicle(plain, 0.0).plant, vehicle(named, 0.0).plant, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_batch_has_the_bits_of_single_runs(two_sided: VehicleModel, exchanged: VehicleModel) -> None:
    models, offsets = [two_sided, model(), exchanged, two_sided], [1e-3, 2e-3, -1e-3, 3e-3]
    together = BatchSimulator([vehicle(*each) for each in zip(models, offsets, strict=True)]).advance(SAMPLES)
    for found, *each in zip(together, models, offsets, strict=True):
        np.testing.assert_array_equal(found[:, : signals(vehicle(*each)).shape[1]], signals(vehicle(*each)))


def test_tables_level_the_wheelset(two_sided: VehicleModel) -> None:
    """Of the static loads each wheel carries its own, so that both gaps close by the same amounts over y."""
    left, right = two_sided.table, two_sided.right_table
    assert right is not None

    def height(table: ContactTable) -> Array:
        return -(table.phi_k * table.y_c + table.g0 + table.static_penetration)

    np.testing.assert_allclose(left.phi_k, -right.phi_k[::-1], atol=1e-6)
    middle = len(left.dy) // 2
    ours, theirs = height(left), height(right)[::-1]
    near = np.abs(left.dy) < 6e-3
    difference = ours - theirs - (ours[middle] - theirs[middle])
    np.testing.assert_allclose(difference[near], 0.0, atol=2e-6)


def cone(slope: float) -> Profile:
    s = np.arange(-1000, 1001) * 5e-5
    return Profile("cone", "wheel", s, -slope * s, half_distance=0.75)


def test_conicity_of_two_cones_is_their_mean() -> None:
    t = np.arange(-700, 701) * 5e-5
    rail = Profile("arc", "rail", t, np.sqrt(0.05**2 - t**2) - 0.05, gauge_depth=0.014)
    gauge = 2.0 * (0.75 - np.sqrt(2.0 * 0.05 * 0.014 - 0.014**2))
    pairs = [(cone(0.02), rail), (cone(0.06), rail)]
    contacts = [
        rigid_contact(*pair, gauge, 9e-3, other=other) for pair, other in zip(pairs, pairs[::-1], strict=True)
    ]
    y, delta_r = radius_difference(*contacts)
    assert np.interp(0.0, y, delta_r) != pytest.approx(0.0, abs=1e-6)
    for conicity in (equivalent_conicity, harmonic_conicity):
        np.testing.assert_allclose(conicity(y, delta_r, AMPLITUDES), 0.04, rtol=2e-2)


def test_motion_about_an_offset_has_the_conicity_of_that_about_the_centre() -> None:
    """A difference of radii of one sign to the side moves the motion, not its wavelength."""
    y = np.linspace(-9e-3, 9e-3, 3601)

    def odd(x: Array) -> Array:
        return 0.2 * x + 1e3 * x**3

    for conicity in (equivalent_conicity, harmonic_conicity):
        centred, aside = conicity(y, odd(y), AMPLITUDES), conicity(y, odd(y - 1.5e-3), AMPLITUDES)
        np.testing.assert_allclose(aside, centred, rtol=1e-4)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("wheel={left: s1002, right: lma}", "right.back_to_back: found 1.353; expected that of the left one"),
        (
            "wheel={left: s1002, right: lma}",
            "set wheel.back_to_back or wheel.right.back_to_back to the common",
        ),
        ("wheel={left: s1002, rigth: s1002}", "wheel: found rigth beside left; expected left and right"),
        ("wheel={left: s1002, right: cn60}", "is a rail profile; as wheel are available"),
        ("wheel.right={left: s1002, right: s1002}", "right"),
    ],
)
def test_sides_that_do_not_fit(override: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        model(override)
    assert message in str(caught.value)
