"""Made-up sweeps whose crossings are known in closed form, and a short scenario that runs in a moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.physics.simulator import VehicleModel
from sayd_env.stability import Limits
from sayd_env.studies.sweep import Sweep

SHORT = ("assessment.run_in=200", "assessment.length=600")
"""An assessed distance that holds one segment of the spectrum, for runs of a tenth of a second."""

LIMITS = Limits(track_shift_force=30e3, acceleration=5.44)
"""Wang et al. (2022), eq. 25 and 26, for P = 150 kN and m_b = 5.6 t."""

MakeSweep = Callable[..., Sweep]


def make_sweep(
    kmh: Sequence[float],
    acceleration_kmh: Sequence[float],
    force_kmh: Sequence[float],
    *,
    slope: float = 1 / 200,
    trailing: float = 1.25,
    frequency: Callable[[float], float] = lambda kmh: 4.0,
    scatter: Callable[[float], float] = lambda kmh: 0.0,
) -> Sweep:
    """Make quantities over their limits that rise linearly with speed, and pass 1 at given speeds (km/h).

    One crossing speed for each seed. The trailing wheelsets have `trailing` times the leading ones' force;
    the accelerations of the four wheelsets are 1, 0.9, 0.9 and 0.9 of the highest. Dominant frequencies (Hz)
    spread over `scatter` between the wheelsets.
    """
    v = np.array(kmh)[:, None]
    ratio_a, ratio_f = (1 + (v - np.array(c)[None, :]) * slope for c in (acceleration_kmh, force_kmh))
    share_a, share_f = np.array([1.0, 0.9, 0.9, 0.9]), np.array([1 / trailing, 1.0, 1 / trailing, 1.0])
    centre = np.array([frequency(x) for x in kmh])
    width = np.array([scatter(x) for x in kmh])
    f = centre[:, None, None] + width[:, None, None] * np.array([-0.5, 0.0, 0.2, 0.5])
    f = np.broadcast_to(f, (len(kmh), len(acceleration_kmh), 4)).copy()
    return Sweep(
        speeds=np.array(kmh) / 3.6,
        seeds=tuple(range(len(acceleration_kmh))),
        frequency=f,
        frequency_force=f.copy(),
        acceleration=LIMITS.acceleration * ratio_a[..., None] * share_a,
        track_shift=LIMITS.track_shift_force * ratio_f[..., None] * share_f,
    )


@pytest.fixture(scope="session")
def synthetic() -> MakeSweep:
    """Maker of sweeps with known crossings."""
    return make_sweep


@pytest.fixture(scope="session")
def limits() -> Limits:
    """Limits that the made-up sweeps are scaled by."""
    return LIMITS


@pytest.fixture(scope="session")
def short_scenario() -> Scenario:
    """The estimates, which no calibration changes, over a short distance."""
    return load_scenario("estimates", SHORT)


@pytest.fixture(scope="session")
def short_model(short_scenario: Scenario) -> VehicleModel:
    """Vehicle of the short scenario."""
    return VehicleModel(short_scenario)
