"""What is observed in the run-in: the observations of each period, and no change of what is run."""

from __future__ import annotations

import numpy as np

from sayd_env import baselines
from sayd_env.config.environment import load_environment
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.rollout import roll_out

CONFIG = load_environment("randomized", ["run_in=60"])
SEEDS = (3, 4)
# Thresholds that are never met: every step of MPPT2 is by eq. (29), so that all bits of J are in the command.
BY_COST_ALONE = {"threshold_min": 0.0, "threshold_max": 1e3, "k_J": 0.1}


def begun(seeds: tuple[int, ...], *, keep_run_in: bool) -> tuple[EpisodeBatch, list[np.ndarray]]:
    batch = EpisodeBatch(CONFIG, len(seeds))
    episodes = [draw_episode(CONFIG, seed, 0, None) for seed in seeds]
    return batch, batch.reset(range(len(seeds)), episodes, log=True, keep_run_in=keep_run_in)


def test_listening_changes_no_bit_and_is_the_same_alone_and_beside_others() -> None:
    (silent, quiet_log), (batch, log) = begun(SEEDS, keep_run_in=False), begun(SEEDS, keep_run_in=True)
    assert silent.observed_run_in is None
    assert batch.observed_run_in is not None
    for quiet, loud in zip(quiet_log, log, strict=True):
        np.testing.assert_array_equal(quiet, loud)
    np.testing.assert_array_equal(silent.observations(), batch.observations())
    np.testing.assert_array_equal(batch.observed_run_in.observations[-1], batch.observations())
    lengths = [len(rows) // batch.settings.samples for rows in log]
    assert len(set(lengths)) == len(SEEDS)  # vehicles of different speeds
    np.testing.assert_array_equal(
        len(batch.observed_run_in.observations) - batch.observed_run_in.begins, lengths
    )
    for i, seed in enumerate(SEEDS):
        alone, _ = begun((seed,), keep_run_in=True)
        assert alone.observed_run_in is not None
        own = batch.observed_run_in.observations[batch.observed_run_in.begins[i] :, i]
        np.testing.assert_array_equal(own, alone.observed_run_in.observations[:, 0])


def test_a_controller_alone_and_beside_others_does_the_same() -> None:
    config = CONFIG.model_copy(update={"run_in": 500.0})
    episodes = [draw_episode(config, seed, 0, None) for seed in SEEDS]

    def rolled(chosen: list[int]) -> list[np.ndarray]:
        batch = EpisodeBatch(config, len(chosen))
        policy = baselines.make("mppt2", batch.interface, **BY_COST_ALONE)
        runs = roll_out(batch, policy, [episodes[i] for i in chosen], [310] * len(chosen))
        return [run.actions for run in runs]

    both = rolled([0, 1])
    np.testing.assert_array_equal(both[0], rolled([0])[0])
    np.testing.assert_array_equal(both[1], rolled([1])[0])
    # A command for each second begun, but the second's: eq. (29) needs two seconds to compare.
    for actions in both:
        for command in actions.T:
            np.testing.assert_array_equal(np.flatnonzero(np.diff(command)) + 1, [200, 300])
