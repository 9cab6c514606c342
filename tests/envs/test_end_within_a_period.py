"""Telemetry of a run that ends within a control period: of the sample at which it ended.

The vehicle's time steps do not know of control periods: with a constant command, a run with control periods
of one sample is the same run, and it stops right there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.envs.loop import CLIMBED, OVERLOADED
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv
from sayd_env.physics.formation import WIDTH

SPEED = 360.0
"""km/h: the run-in of 20 m takes 0.2 s, a whole number of periods of either length."""
SAMPLES = 10
"""Samples in a control period of 10 ms."""
BAD = {"speed_kmh": SPEED, "track": "german_low", "track_scale": 5.0, "friction": 0.6, "wear": 1.0}
"""Irregularities five times those of a bad track."""
HALF = np.full(2, 0.5, np.float32)
REPORTED = (
    "damper_force",
    "track_shift_force",
    "wheel_lateral_force",
    "wheel_vertical_force",
    "valve_command",
    "valve_current",
    "hydraulic_flow",
    "hydraulic_power",
    "mean_quotient",
    "mean_track_shift",
)
Info = dict[str, Any]


def environment(folder: Path, quotient: float, control_period: float, damper: str) -> SaydEnv:
    """The nominal environment with a short run-in and another limit of Y/Q."""
    path = folder / f"{quotient!r}.yaml"
    path.write_text(f"base: nominal\nrun_in: 20.0\nepisode_s: 1.0\nderailment: {{quotient: {quotient!r}}}\n")
    return SaydEnv(str(path), damper=damper, info="full", control_period=control_period)


def run(env: SaydEnv, seed: int) -> list[Info]:
    """What each period tells, to the end of the episode."""
    env.reset(seed=seed, options=BAD)
    infos, over = [], False
    while not over:
        _, _, terminated, truncated, info = env.step(HALF)
        infos.append(info)
        over = terminated or truncated
    return infos


def assert_ends_alike(by_sample: list[Info], by_period: list[Info]) -> None:
    assert len(by_sample) % SAMPLES != 0
    assert len(by_period) == len(by_sample) // SAMPLES + 1
    last, end = by_sample[-1], by_period[-1]
    assert end["ending"] == last["ending"]
    for name in REPORTED:
        np.testing.assert_array_equal(end[name], last[name], name)
    # The sample makes a difference.
    for name in ("damper_force", "wheel_vertical_force"):
        assert np.any(last[name] != by_sample[-2][name]), name


@pytest.mark.parametrize("damper", ["sayd", "passive"])
def test_a_wheel_that_climbs(tmp_path: Path, damper: str) -> None:
    fine, coarse = (environment(tmp_path, 5.0, period, damper) for period in (0.001, 0.01))
    for seed in range(1, 20):
        by_sample = run(fine, seed)
        if fine.batch.vehicles.status[0] == CLIMBED and len(by_sample) % SAMPLES != 0:
            break
    else:
        pytest.fail("no wheel climbed within a period")
    assert_ends_alike(by_sample, run(coarse, seed))
    assert coarse.batch.vehicles.status[0] == CLIMBED


@pytest.mark.parametrize("damper", ["sayd", "passive"])
def test_a_quotient_beyond_its_limit(tmp_path: Path, damper: str) -> None:
    """The limit lies between two records of the mean Y/Q, of which the second falls within a period."""
    seed = 3
    free = run(environment(tmp_path, 5.0, 0.001, damper), seed)
    means = np.array([info["mean_quotient"].max() for info in free])
    records = [n for n in range(2 * SAMPLES, len(means)) if means[n] > means[:n].max()]
    last = max(n for n in records if (n + 1) % SAMPLES != 0)
    limit = float(0.5 * (means[:last].max() + means[last]))
    fine, coarse = (environment(tmp_path, limit, period, damper) for period in (0.001, 0.01))
    by_sample = run(fine, seed)
    assert len(by_sample) == last + 1
    assert_ends_alike(by_sample, run(coarse, seed))
    assert fine.batch.vehicles.status[0] == coarse.batch.vehicles.status[0] == OVERLOADED


def test_vehicles_side_by_side_report_the_same(tmp_path: Path) -> None:
    """The others of a group run on: telemetry of one that has ended stays that of its last sample."""
    single = environment(tmp_path, 1.5, 0.01, "sayd")
    ends = [run(single, seed) for seed in range(WIDTH)]
    vector = SaydVectorEnv(str(tmp_path / "1.5.yaml"), num_envs=WIDTH, num_threads=1, info="full")
    vector.reset(seed=list(range(WIDTH)), options=BAD)
    assert len(vector.batch.vehicles.formation.units().groups) == 1
    ended: set[int] = set()
    for n in range(max(map(len, ends))):
        _, _, terminated, truncated, infos = vector.step(np.tile(HALF, (WIDTH, 1)))
        for k in (int(k) for k in np.flatnonzero(terminated | truncated) if int(k) not in ended):
            ended.add(k)
            assert n + 1 == len(ends[k])
            for name in REPORTED:
                np.testing.assert_array_equal(infos[name][k], ends[k][-1][name], name)
    assert ended == set(range(WIDTH))
    assert len({len(each) for each in ends}) > 2
    assert sum(bool(each[-1]["ending"]) for each in ends) > 2
