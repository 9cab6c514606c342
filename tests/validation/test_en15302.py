"""Rolling radii and equivalent conicity against EN 15302:2021.

Source: EN 15302:2021, annexes I to K, as published in code form (github.com/rohrbecka/EN15302): wheels A, B
and I on rail A, gauge 1435.16 mm, back-to-back distance 1360 mm, tape circle radius 460 mm; conicity with
tolerance bands.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from sayd_env.config.profile import load_rail, load_wheel
from sayd_env.physics.contact.conicity import equivalent_conicity, radius_difference
from sayd_env.physics.contact.geometry import rigid_contact
from sayd_env.physics.profiles import rail_profile, wheel_profile

DATA = Path(__file__).parent / "data"
WHEELS = ["A", "B", "I"]


def reference(file: str, wheel: str) -> np.ndarray:
    with (DATA / file).open() as stream:
        rows = [list(map(float, row[1:])) for row in csv.reader(stream) if row[0] == f"Wheel{wheel}RailA"]
    return np.array(rows)


@pytest.fixture(scope="module")
def differences() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    rail = rail_profile(load_rail("en15302_rail_a"))
    return {
        wheel: radius_difference(
            rigid_contact(wheel_profile(load_wheel(f"en15302_{wheel.lower()}")), rail, 1.43516, 9e-3)
        )
        for wheel in WHEELS
    }


@pytest.mark.parametrize("wheel", WHEELS)
def test_rolling_radius_difference(wheel: str, differences: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    y, expected = reference("en15302_delta_r.csv", wheel).T
    if wheel == "A":
        # The table prints the value of 1.8 mm at 1.7 mm, too.
        twice = np.isclose(np.abs(y), 1.7)
        assert np.all(np.isclose(np.abs(expected[twice]), 0.572))
        y, expected = y[~twice], expected[~twice]
    measured = np.interp(y * 1e-3, *differences[wheel]) * 1e3
    error = np.abs(measured - expected)
    assert np.median(error) < 0.02
    assert np.all(error <= 0.02 + 0.02 * np.abs(expected))


@pytest.mark.parametrize("wheel", WHEELS)
def test_equivalent_conicity_within_the_tolerance_bands(
    wheel: str, differences: dict[str, tuple[np.ndarray, np.ndarray]]
) -> None:
    amplitude, expected, low, high, _, _ = reference("en15302_conicity.csv", wheel).T
    measured = equivalent_conicity(*differences[wheel], amplitude * 1e-3)
    rounding = 0.0005
    assert np.all((measured >= low - rounding) & (measured <= high + rounding))
    assert np.mean(np.abs(measured - expected)) < 0.005
