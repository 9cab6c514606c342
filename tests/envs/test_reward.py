"""The rewards of whole seconds against J of eq. (27), recomputed from the logged signals with SciPy.

Independent of the compiled loop: f_0 by an own Fourier sum, the filter by `scipy.signal.sosfilt`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, get_window, sosfilt

from sayd_env.config.units import Array
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.loop import LOG_ACCELERATION, LOG_HYDRAULIC
from sayd_env.envs.single import SaydEnv

RATE = 1000
GRID = np.arange(14, 122) / 10  # 1.5 to 12 Hz, and a step beyond both ends


def dominant(points: Array, speed: float) -> float:
    """Highest peak of the summed Hann spectra of the last 500 m, on means of 10 ms; points: (t, 2)."""
    length = int(500.0 / speed * 100)
    means = points[-length * 10 :].reshape(length, 10, -1).mean(axis=1)
    window = get_window("hann", length)[:, None]
    means = (means - (window * means).sum(axis=0) / window.sum()) * window
    phases = np.exp(-2j * np.pi * GRID[:, None] * 0.01 * np.arange(length))
    power = (np.abs(phases @ means) ** 2).sum(axis=1)
    peaks = [k for k in range(1, len(GRID) - 1) if power[k] > power[k - 1] and power[k] >= power[k + 1]]
    return float(GRID[max(peaks, key=lambda k: power[k])])


def filtered_seconds(points: Array, start: int, seconds: int, speed: float) -> list[Array]:
    """A bogie's accelerations of each second from step 0 on, behind the band around f_0.

    Where f_0 moves at t, the new filter runs from rest over [t - 2 s, t + 1 s], and goes on from there.
    """
    f0, state, found = 5.0, None, []
    _, state = sosfilt(sections(f0), points[:start], axis=0, zi=rest())
    for t in range(start, start + seconds * RATE, RATE):
        new = dominant(points[:t], speed)
        if new != f0:
            f0 = new
            _, state = sosfilt(sections(f0), points[t - 2 * RATE : t], axis=0, zi=rest())
        passed, state = sosfilt(sections(f0), points[t : t + RATE], axis=0, zi=state)
        found.append(passed)
    return found


def sections(f0: float) -> Array:
    band: Array = butter(4, (max(f0 - 2.0, 0.5), f0 + 2.0), "bandpass", fs=RATE, output="sos")
    return band


def rest() -> Array:
    return np.zeros((4, 2, 2))


def cost_of(rows: Array, start: int, seconds: int, speed: float, weights: tuple[float, float]) -> Array:
    """Mean J of the two bogies in each second, eq. (27); limits of Wang et al. (2022), eq. 26, and F_max."""
    total = np.zeros(seconds)
    for bogie in range(2):
        columns = slice(LOG_ACCELERATION + 2 * bogie, LOG_ACCELERATION + 2 * bogie + 2)
        passed = filtered_seconds(rows[:, columns], start, seconds, speed)
        for k in range(seconds):
            span = slice(start + k * RATE, start + (k + 1) * RATE)
            forces = rows[span, LOG_HYDRAULIC + 4 * bogie : LOG_HYDRAULIC + 4 * bogie + 4]
            total[k] += weights[0] * np.mean((passed[k] / 5.44) ** 2) + weights[1] * np.mean(
                (forces / 12e3) ** 2
            )
    return total / 2


def logged(env: SaydEnv, actions: Any, seed: int) -> tuple[Array, int]:
    """True signals of the same episode at 1 kHz, and the number of samples before step 0."""
    batch = EpisodeBatch(env.config, 1, scenario=env.batch.scenario)
    rows = batch.reset([0], [draw_episode(env.config, seed, 0)], log=True)
    before = len(rows[0])
    for action in actions:
        log = np.empty((1, batch.settings.samples, rows[0].shape[1]))
        batch.step(action[None], log=log)
        rows.append(log[0])
    return np.concatenate(rows), before


@pytest.mark.parametrize("period", [0.01, 0.02, 0.05])
@pytest.mark.parametrize(("name", "weights"), [("mppt1", (1.0, 0.0)), ("mppt2", (1.0, 0.5))])
def test_rewards_of_a_second_are_minus_j(period: float, name: str, weights: tuple[float, float]) -> None:
    env = SaydEnv(control_period=period, reward=name, episode_s=3.0)
    steps = round(3.0 / period)
    actions = np.random.default_rng(4).random((steps, 2), dtype=np.float32)
    _, info = env.reset(seed=11)
    results = [env.step(action) for action in actions]
    rewards = np.array([result[1] for result in results])
    rows, before = logged(env, actions, seed=11)
    expected = cost_of(rows, before, 3, info["speed_kmh"] / 3.6, weights)
    np.testing.assert_allclose(-rewards.reshape(3, -1).sum(axis=1), expected, rtol=1e-9)
    # The test means something: f_0 has moved from where it starts. (At the end of a period it is the next's.)
    assert not np.any(results[-2][4]["dominant_frequency"] == 5.0)


def test_the_control_period_does_not_change_the_cost() -> None:
    # At 100 m/s the run-in of 500 m is a whole number of each of these periods.
    totals = []
    for period in (0.01, 0.02, 0.05, 0.1):
        env = SaydEnv(control_period=period, episode_s=2.0, speed_kmh=360.0)
        env.reset(seed=2)
        steps = [env.step(np.zeros(2, np.float32)) for _ in range(round(2.0 / period))]
        totals.append(sum(step[1] for step in steps))
    np.testing.assert_allclose(totals, totals[0], rtol=1e-12)


def test_step_0_is_that_of_a_train_which_has_been_running() -> None:
    # Ideal sensors: their readings are the true signals.
    env = SaydEnv(observation="features", episode_s=1.0, info="full")
    observed, _ = env.reset(seed=11)
    found = env.batch.dominant_frequency()[0]
    action = np.zeros(2, np.float32)
    info = env.step(action)[4]
    rows, before = logged(env, [action], seed=11)
    window = round(100.0 / (350 / 3.6) * RATE)
    names = [signal.name for signal in env.signals]
    for k, bogie in enumerate(("front", "rear")):
        points = rows[:, LOG_ACCELERATION + 2 * k : LOG_ACCELERATION + 2 * k + 2]
        f0 = dominant(points[:before], 350 / 3.6)
        assert f0 != 5.0
        assert found[k] == pytest.approx(f0, rel=1e-12)
        assert observed[names.index(f"dominant_frequency.{bogie}")] == pytest.approx(f0, rel=1e-6)
        passed = sosfilt(sections(f0), points[before - 2 * RATE :], axis=0)
        expected = np.sqrt(np.mean(passed[RATE : 2 * RATE] ** 2, axis=0))
        first = names.index(f"acceleration_rms.{bogie}.leading")
        np.testing.assert_allclose(observed[first : first + 2], expected, rtol=1e-6)  # float32
        # The sliding RMS values begin in the same band, those of the track shift force, too.
        shift = sosfilt(sections(f0), rows[before - 2 * RATE :, 4 + 2 * k : 6 + 2 * k], axis=0)
        for name, values in (("sliding_rms_acceleration", passed), ("sliding_rms_track_shift", shift)):
            expected = np.sqrt(np.mean(values[-window:] ** 2, axis=0))
            np.testing.assert_allclose(info[name][2 * k : 2 * k + 2], expected, rtol=1e-9)


def test_running_values_are_those_of_the_last_100_m() -> None:
    env = SaydEnv(info="full", episode_s=3.0)
    env.reset(seed=11)
    actions = np.random.default_rng(4).random((300, 2), dtype=np.float32)
    info = [env.step(action) for action in actions][-1][4]
    rows, before = logged(env, actions, seed=11)
    speed = 350 / 3.6
    window = round(100.0 / speed * RATE)
    for bogie in range(2):
        acceleration = rows[:, LOG_ACCELERATION + 2 * bogie : LOG_ACCELERATION + 2 * bogie + 2]
        passed = np.concatenate(filtered_seconds(acceleration, before, 3, speed))
        found = info["sliding_rms_acceleration"][2 * bogie : 2 * bogie + 2]
        np.testing.assert_allclose(found, np.sqrt(np.mean(passed[-window:] ** 2, axis=0)), rtol=1e-9)
        # The track shift forces go through the same bands.
        shift, filtered = rows[:, 4 + 2 * bogie : 6 + 2 * bogie], []
        f0, state = (
            5.0,
            sosfilt(sections(5.0), rows[:before, 4 + 2 * bogie : 6 + 2 * bogie], axis=0, zi=rest())[1],
        )
        for t in range(before, len(rows), RATE):
            new = dominant(acceleration[:t], speed)
            if new != f0:
                f0, state = new, sosfilt(sections(new), shift[t - 2 * RATE : t], axis=0, zi=rest())[1]
            passed, state = sosfilt(sections(f0), shift[t : t + RATE], axis=0, zi=state)
            filtered.append(passed)
        expected = np.sqrt(np.mean(np.concatenate(filtered)[-window:] ** 2, axis=0))
        np.testing.assert_allclose(
            info["sliding_rms_track_shift"][2 * bogie : 2 * bogie + 2], expected, rtol=1e-9
        )
