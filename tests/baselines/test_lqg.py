"""Clipped-optimal LQG on made-up plants: dynamic programming, a noiseless observer, what a damper can do."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from sayd_env import baselines
from sayd_env.baselines.inverse_damper import InverseDamper
from sayd_env.baselines.lqg import Lqg, designed, noise_over, observed, regulated, sampled, spread
from sayd_env.baselines.lqg_design import ReducedPlant, balanced, reduced_plants
from sayd_env.config import ConfigError
from sayd_env.config.control import LqgConfig, load_controller
from sayd_env.config.damper import TableThrottle, load_sayd
from sayd_env.envs.vector import SaydVectorEnv
from sayd_env.physics.sayd import steady_force

PERIOD = 0.01
LIMITS = (5.44, 12e3)


@pytest.fixture(scope="module")
def parameters() -> LqgConfig:
    found = load_controller("lqg")
    assert isinstance(found, LqgConfig)
    return found


@pytest.fixture(scope="module")
def plant() -> ReducedPlant:
    """Four damped oscillators of 1 to 7 Hz; a force of 1 kN moves them as the track does."""
    random = np.random.default_rng(3)
    blocks = [2 * np.pi * f * np.array([[0.0, 1.0], [-1.0, -0.3]]) for f in (1.0, 2.0, 4.0, 7.0)]
    a = np.zeros((8, 8))
    for k, block in enumerate(blocks):
        a[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
    scale = np.array([0.5] * 4 + [1e-3] * 2 + [1e3] * 2)
    return ReducedPlant(
        a=a,
        force=random.normal(size=(8, 2)) * 1e-3,
        noise=random.normal(size=(8, 2)),
        c=random.normal(size=(8, 8)) * scale[:, None],
        d=np.vstack([random.normal(size=(4, 2)) * 1e-5, np.zeros((4, 2))]),
    )


def test_the_regulator_is_that_of_dynamic_programming(plant: ReducedPlant, parameters: LqgConfig) -> None:
    """The backward recursion over many periods ends at the same gain (Bellman)."""
    found = designed(plant, PERIOD, parameters, LIMITS)
    step, entry = sampled(plant.a, plant.force, PERIOD)
    late = np.block([[step, entry], [np.zeros((2, 10))]])
    into = np.vstack([np.zeros((8, 2)), np.eye(2)])
    weights = np.diag([0.25 / LIMITS[0] ** 2] * 4 + [0.5 * parameters.force_weight / LIMITS[1] ** 2] * 2)
    seen = np.block([[plant.c[:4], plant.d[:4]], [plant.c[6:], np.eye(2)]])
    cost, penalty = seen.T @ weights @ seen, parameters.force_penalty / LIMITS[1] ** 2 * np.eye(2)
    value = np.zeros((10, 10))
    gain = np.zeros((2, 10))
    for _ in range(3000):
        gain = np.linalg.solve(penalty + into.T @ value @ into, into.T @ value @ late)
        value = cost + late.T @ value @ (late - into @ gain)
    np.testing.assert_allclose(found.regulate, gain, rtol=1e-5, atol=1e-6 * np.abs(gain).max())


def test_a_regulated_plant_costs_less_than_a_plain_one(plant: ReducedPlant, parameters: LqgConfig) -> None:
    """Mean of the regulator's own cost over the same noise, with no force added and with the wanted one."""
    found = designed(plant, PERIOD, parameters, LIMITS)
    spread_of = np.linalg.cholesky(noise_over(plant.a, plant.noise, PERIOD) + 1e-12 * np.eye(8))
    random = np.random.default_rng(0)
    kicks = random.normal(size=(4000, 8)) @ spread_of.T

    def cost(regulate: bool) -> float:
        x, added, total = np.zeros((1, 8)), np.zeros((1, 2)), 0.0
        for kick in kicks:
            force = x @ found.damper.T + added
            seen = x @ plant.c[:4].T + added @ plant.d[:4].T
            total += float(np.sum((seen / LIMITS[0]) ** 2) / 4.0)
            total += parameters.force_weight * float(np.sum((force / LIMITS[1]) ** 2) / 2.0)
            ahead = x @ found.ahead.T + added @ found.added.T
            if regulate:
                wanted, _ = regulated(found, x, force)
                added = wanted - ahead @ found.damper.T
            x = ahead + kick
        return total

    assert cost(True) < 0.95 * cost(False)


def test_the_observer_finds_the_state_of_a_noiseless_plant(
    plant: ReducedPlant, parameters: LqgConfig
) -> None:
    """It starts from rest, the plant does not; both feel the same forces."""
    found = designed(plant, PERIOD, parameters, LIMITS)
    random = np.random.default_rng(1)
    x, estimate = random.normal(size=(3, 8)), np.zeros((3, 8))
    start = np.abs(x).max()
    for _ in range(3000):
        force = random.normal(size=(3, 2)) * 1e3
        x = x @ found.bare.T + force @ found.measured.T
        readings = x @ found.read.T + force @ found.direct.T
        estimate = observed(found, estimate, force, readings)
    assert np.abs(estimate - x).max() < 1e-6 * start


def test_the_observer_s_gain_solves_its_riccati_equation(plant: ReducedPlant, parameters: LqgConfig) -> None:
    """Covariances of the filter's own recursion come to rest at the same gain."""
    found = designed(plant, PERIOD, parameters, LIMITS)
    bare = plant.a - plant.force @ plant.c[6:]
    drift = noise_over(bare, plant.noise, PERIOD)
    errors = np.diag((parameters.noise * spread(plant.a, plant.noise, plant.c[:6])) ** 2)
    p, gain = np.eye(8), np.zeros((8, 6))
    for _ in range(4000):
        gain = p @ found.read.T @ np.linalg.inv(found.read @ p @ found.read.T + errors)
        p = found.bare @ (p - gain @ found.read @ p) @ found.bare.T + drift
    np.testing.assert_allclose(found.observe, gain, rtol=1e-5, atol=1e-6 * np.abs(gain).max())


def test_noise_over_a_period_is_its_integral(plant: ReducedPlant) -> None:
    """Trapezoids of exp(A t) N N' exp(A' t)."""
    steps, covariance = 400, np.zeros((8, 8))
    for k in range(steps + 1):
        step, _ = sampled(plant.a, np.zeros((8, 1)), PERIOD * k / steps)
        weight = 0.5 if k in (0, steps) else 1.0
        covariance += weight * PERIOD / steps * step @ plant.noise @ plant.noise.T @ step.T
    np.testing.assert_allclose(noise_over(plant.a, plant.noise, PERIOD), covariance, rtol=1e-5, atol=1e-9)


def test_balanced_truncation_keeps_what_matters(plant: ReducedPlant) -> None:
    """With all states the response stays; without two its error is at most twice their Hankel values.

    Glover, International Journal of Control 39(6), 1115-1193 (1984).
    """
    b, c = np.hstack([1e3 * plant.force, plant.noise]), plant.c / np.abs(plant.c).max(axis=1, keepdims=True)

    def response(a: np.ndarray, b: np.ndarray, c: np.ndarray, f: float) -> np.ndarray:
        return np.asarray(c @ np.linalg.solve(2j * np.pi * f * np.eye(len(a)) - a, b))

    gramians = [
        solve_continuous_lyapunov(left, -right @ right.T) for left, right in ((plant.a, b), (plant.a.T, c.T))
    ]
    hankel = np.sqrt(np.sort(np.linalg.eigvals(gramians[0] @ gramians[1]).real)[::-1])
    whole, fewer = balanced(plant.a, b, c, 8), balanced(plant.a, b, c, 6)
    for f in (0.3, 1.0, 3.0, 7.0, 20.0):
        exact = response(plant.a, b, c, f)
        np.testing.assert_allclose(response(*whole, f), exact, rtol=1e-6, atol=1e-9)
        assert np.linalg.norm(response(*fewer, f) - exact, 2) <= 2.0 * hankel[6:].sum()


WIDEST = 0.8


@pytest.fixture(scope="module")
def inverse() -> InverseDamper:
    return InverseDamper(load_sayd("sayd-estimate"), 0.0, WIDEST)


def test_a_damper_gives_the_wanted_force_or_the_nearest_that_resists(inverse: InverseDamper) -> None:
    """By its characteristic: between the forces of the open and the closed valve the wanted one."""
    damper = load_sayd("sayd-estimate")
    random = np.random.default_rng(5)
    rate = random.uniform(2e-3, 0.1, 300) * random.choice([-1.0, 1.0], 300)
    wanted = random.uniform(-15e3, 15e3, 300)
    current = inverse.for_forces(rate, wanted)
    assert np.all((current >= 0.0) & (current <= WIDEST))
    least, most, force = (steady_force(damper, np.abs(rate), i) for i in (WIDEST, 0.0, current))
    along = wanted * np.sign(rate)
    inside = (along > least) & (along < most)
    assert inside.sum() > 50
    assert force[inside] == pytest.approx(along[inside], rel=0.02)
    assert force[along >= most] == pytest.approx(most[along >= most], rel=0.01)
    assert force[along <= least] == pytest.approx(least[along <= least], rel=0.01)
    # Power taken from the motion: nowhere negative, whatever is wanted.
    assert np.all(force * np.abs(rate) >= 0.0)


def test_the_order_of_arrays_in_memory_does_not_matter(inverse: InverseDamper) -> None:
    rate = np.array([[0.02, -0.01, 0.03], [0.005, 0.04, -0.02]])
    force = np.array([[3e3, -2e3, 9e3], [1e3, 5e3, -4e3]])
    turned = inverse.for_forces(np.asfortranarray(rate), np.asfortranarray(force))
    assert np.array_equal(turned, inverse.for_forces(rate, force))


def test_what_would_drive_the_motion_opens_the_valve(inverse: InverseDamper) -> None:
    rate = np.array([0.02, -0.02, 0.02, -0.02])
    currents = inverse.for_forces(rate, np.array([-5e3, 5e3, 2e4, -2e4]))
    assert currents.tolist() == [WIDEST, WIDEST, 0.0, 0.0]


def test_designs_are_blended_between_their_speeds(parameters: LqgConfig) -> None:
    policy = object.__new__(Lqg)
    policy.parameters, policy.designs = parameters, [None] * 5  # type: ignore[list-item]
    shares = policy._shares(np.array([220.0, 250.0, 100.0, 450.0]) / 3.6)
    expected = np.array([[0, 1, 0, 0, 0], [0, 0.5, 0.5, 0, 0], [1, 0, 0, 0, 0], [0, 0, 0, 0, 1]], dtype=float)
    np.testing.assert_allclose(shares, expected, atol=1e-12)


def test_a_period_for_which_there_is_no_regulator_is_refused() -> None:
    """Ten decisions a second are too few for a vehicle that hunts at 4 Hz."""
    env = SaydVectorEnv(num_envs=1, environment="nominal", control_period=0.1)
    with pytest.raises(ConfigError, match=r"lqg: no regulator is found .* control period of 0.1 s"):
        baselines.make("lqg", env)


def test_plants_are_made_anew_where_a_measured_file_has_changed(
    tmp_path: Path, parameters: LqgConfig, plant: ReducedPlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, asked = tmp_path / "map.csv", []

    def cached(_: str, content: Iterable[bytes], length: int, make: object) -> np.ndarray:
        asked.append(b"".join(content))
        return np.zeros(length)

    monkeypatch.setattr("sayd_env.baselines.lqg_design.array_cache.cached_array", cached)
    throttle = TableThrottle(type="table", file=str(file))
    damper = load_sayd("sayd").model_copy(update={"throttle": throttle})
    for flow in (15, 15, 5):
        file.write_text(f"current [-],pressure_drop [bar],flow [l/min]\n0,10,0.5\n1,10,{flow}\n")
        reduced_plants(parameters, damper)
    assert asked[0] == asked[1] != asked[2]


def test_the_observer_knows_the_vehicle() -> None:
    """Without that it would lose it: its strokes would not be those of the dampers."""
    env = SaydVectorEnv(num_envs=2, environment="nominal")
    policy = baselines.make("lqg", env)
    seen, _ = env.reset(seed=11)
    memory, commands, estimates, strokes = None, [], [], []
    columns = [policy.interface.index(f"stroke.front.{side}.upper") for side in ("left", "right")]
    near = int(np.argmin(np.abs(np.array(policy.parameters.speeds_kmh) - 350.0)))
    for _ in range(300):
        action, memory = policy.predict(seen, memory)
        commands.append(action)
        estimates.append(memory.states[near] @ policy.designs[near].read[4])
        left, right = seen[:, columns].T
        strokes.append(0.5 * (left - right) - memory.rest[:, 0])
        seen = env.step(action)[0]
    env.close()
    assert 0.0 <= np.min(commands) <= np.max(commands) <= policy.parameters.widest + 1e-6
    assert np.std(commands) > 0.0
    late = [np.array(values)[100:].ravel() for values in (estimates, strokes)]
    assert np.corrcoef(*late)[0, 1] > 0.8
