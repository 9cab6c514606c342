"""Means of Y/Q and of the track shift force over 2 m, against a convolution of what every sample tells."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.envs.loop import OVERLOADED, PEAK_QUOTIENT, PEAK_TRACK_SHIFT
from sayd_env.envs.single import SaydEnv

BAD = {"track": "german_high", "track_scale": 2.0, "wear": 1.0}
ACTION = np.full(2, 0.6, np.float32)


def over_2_m(values: np.ndarray, speed: float) -> np.ndarray:
    samples = 2.0 / (speed * 1e-3)
    weights = np.append(np.ones(int(samples)), samples - int(samples)) / samples
    return np.array([np.convolve(column, weights)[: len(values)] for column in values.T]).T


@pytest.mark.parametrize("speed_kmh", [120.0, 350.0])
def test_means_are_those_over_the_last_2_m(quick: str, speed_kmh: float) -> None:
    env = SaydEnv(quick, control_period=0.001, info="full")
    env.reset(seed=5, options=BAD | {"speed_kmh": speed_kmh})
    infos, terms = [], []
    for _ in range(180):
        infos.append(env.step(ACTION)[4])
        terms.append(env.batch.vehicles.terms[0].copy())
    lateral, vertical = (
        np.array([info[f"wheel_{way}_force"] for info in infos]) for way in ("lateral", "vertical")
    )
    # Towards the flange: the left wheels, which come first, push their rail to the left.
    quotient = np.where(vertical > 0.0, lateral * np.tile([1.0, -1.0], 4) / vertical, 0.0)
    shift = np.array([info["track_shift_force"] for info in infos])
    full = int(2.0 / (speed_kmh / 3.6 * 1e-3)) + 1
    for name, values, place, size in (
        ("mean_quotient", quotient, PEAK_QUOTIENT, lambda mean: max(0.0, mean.max())),
        ("mean_track_shift", shift, PEAK_TRACK_SHIFT, lambda mean: np.abs(mean).max()),
    ):
        found = np.array([info[name] for info in infos])
        expected = over_2_m(values, speed_kmh / 3.6)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found[full:], expected[full:], rtol=0, atol=1e-12 * scale)
        peaks = [size(mean) for mean in found]
        np.testing.assert_array_equal([row[place] for row in terms], peaks)
    assert infos[0]["limit_mean_track_shift"] == 2.0 * infos[0]["limit_track_shift"]


def test_the_run_ends_at_the_first_sample_whose_mean_exceeds_the_limit(quick: str) -> None:
    free = SaydEnv(quick, control_period=0.001, info="full")
    free.reset(seed=5, options=BAD)
    means = [free.step(ACTION)[4]["mean_quotient"].max() for _ in range(150)]
    limit = float(np.sort(means)[-40])
    strict = free.config.derailment.model_copy(update={"quotient": limit})
    config = free.config.model_copy(update={"derailment": strict})
    first = int(np.argmax(np.array(means) > limit))
    batch = type(free.batch)(config, 1, scenario=free.batch.scenario)
    episode = free.batch.episodes[0]
    assert episode is not None
    batch.reset([0], [episode])
    if batch.vehicles.status[0] == OVERLOADED:
        pytest.fail("the run-in ends above the limit: choose another seed")
    for n in range(first + 1):
        ended = batch.step(ACTION[None])[2][0]
        assert ended == (n == first)
    assert batch.vehicles.status[0] == OVERLOADED
