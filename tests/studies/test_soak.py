"""The soak: its commands, its sums against the single environment, and that it sees every kind of defect."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.single import SaydEnv
from sayd_env.studies import soak as module
from sayd_env.studies.soak import DEFECTS, KINDS, LONGEST, RandomCommands, SoakResult, soak

SHORT = "base: {base}\nrun_in: 20.0\nepisode_s: {episode_s}\n"
LATE = """
base: faults
episode_s: 4.0
faults:
  onset: {distribution: uniform, low: 0.0, high: 3.0}
"""
"""Episodes so short that a hundred thousand steps make some hundred of them, with faults in most."""


def environment(folder: Path, base: str = "nominal", episode_s: float = 2.0, more: str = "") -> str:
    path = folder / f"{base}.yaml"
    path.write_text(SHORT.format(base=base, episode_s=episode_s) + more)
    return str(path)


def commands(steps: int, environments: int = 50, seed: int = 0) -> tuple[np.ndarray, list[list[str]]]:
    source = RandomCommands(environments, 2, np.random.default_rng(seed))
    rows = [(source.next(), source.names()) for _ in range(steps)]
    return np.array([row[0] for row in rows]), [row[1] for row in rows]


def test_commands_are_what_their_kinds_say() -> None:
    values, names = commands(600)
    kinds = np.array(names)
    assert set(np.unique(kinds)) == set(KINDS)
    assert values.dtype == np.float32
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    assert np.all(values[kinds == "open"] == 1.0)
    assert np.all(values[kinds == "closed"] == 0.0)
    bang = values[kinds == "bang-bang"]
    assert set(np.unique(bang)) == {0.0, 1.0}
    assert 0.4 < bang.mean() < 0.6
    fresh = kinds == "fresh"
    goes_on = fresh[1:] & fresh[:-1]
    assert np.all(np.any(values[1:][goes_on] != values[:-1][goes_on], axis=1))
    held = (kinds[1:] == "held") & (kinds[:-1] == "held")
    changes = np.any(values[1:][held] != values[:-1][held], axis=1)
    assert 0.0 < changes.mean() < 0.1  # where one stretch follows another


def test_commands_change_from_end_to_end_at_once() -> None:
    values, names = commands(600)
    banging = np.array(names) == "bang-bang"
    both = banging[1:] & banging[:-1]
    steps = np.abs(np.diff(values.astype(float), axis=0))[both]
    assert {0.0, 1.0} == set(np.unique(steps))


def test_stretches_come_as_often_as_their_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LONGEST", 1)
    _, names = commands(400)
    kinds = np.array(names).ravel()
    for kind, share in KINDS.items():  # 20,000 draws: a standard deviation is at most 0.0035
        assert np.mean(kinds == kind) == pytest.approx(share, abs=0.015)


def test_lengths_reach_from_one_step_to_a_whole_episode() -> None:
    lengths = module._lengths(np.random.default_rng(0), LONGEST, 20_000)
    assert (lengths.min(), lengths.max()) == (1, LONGEST)
    # Uniform in the logarithm: half of them are shorter than the geometric mean of the ends.
    assert np.mean(lengths < np.sqrt(LONGEST)) == pytest.approx(0.5, abs=0.02)


def test_the_same_seed_gives_the_same_commands() -> None:
    one, other = commands(50)[0], commands(50)[0]
    np.testing.assert_array_equal(one, other)
    assert np.any(commands(50, seed=1)[0] != one)


def test_seconds_are_those_of_the_single_environment(tmp_path: Path) -> None:
    """One vehicle: J of each second is minus the sum of the rewards of `SaydEnv` under the same commands."""
    name = environment(tmp_path, episode_s=1.5)
    result = soak(name, 450, environments=1, seed=7)
    env, source = SaydEnv(name), RandomCommands(1, 2, np.random.default_rng([7, 1]))
    expected = []
    for episode in range(3):
        env.reset(seed=7 if episode == 0 else None)
        if episode > 0:
            source.next()  # the batch ignores the command at which an episode begins
        rewards = [float(env.step(source.next()[0])[1]) for _ in range(150)]
        expected.append(-sum(rewards[:100]))
    np.testing.assert_allclose(result.costs, expected, rtol=1e-12)
    assert (result.steps, result.episodes, result.truncated) == (450, 3, 3)
    assert result.largest == max(result.costs)
    assert result.recommended == 2.0 * result.largest


def test_some_thousand_steps_with_everything_drawn(tmp_path: Path) -> None:
    name = environment(
        tmp_path, "faults", more="faults: {onset: {distribution: uniform, low: 0.0, high: 1.0}}\n"
    )
    result = soak(name, 4000, environments=8, seed=3)
    assert result.failures == ""
    assert result.steps == 4000
    assert result.episodes == 8 * 3  # 200 steps each: the third begins at step 402 of a vehicle
    assert len(result.costs) == 8 * 5
    assert result.endings == {}
    again = soak(name, 4000, environments=8, seed=3, workers=1)
    np.testing.assert_array_equal(again.costs, result.costs)
    conditions = {(second["seed"], second["episode"]): second for second in result.worst}
    for (seed, episode), second in conditions.items():
        env = SaydEnv(name)
        info = env.reset(seed=seed)[1]
        for _ in range(episode):
            info = env.reset()[1]
        for key in ("speed_kmh", "wear", "track"):
            assert second[key] == info[key]


def test_a_termination_is_counted_and_its_charge_left_out(tmp_path: Path) -> None:
    limits = "derailment: {quotient: 0.02, averaging: 0.5}\ntermination_cost: 1.0e+6\n"
    result = soak(environment(tmp_path, more=limits), 200, environments=4)
    assert list(result.endings) == ["derailment risk: mean Y/Q beyond its limit"]
    assert 4 <= result.episodes - 4 <= sum(result.endings.values()) <= result.episodes
    assert result.failures == ""
    assert all(second["cut"] for second in result.worst)
    assert result.largest < 10.0
    assert result.termination_cost == 1e6


def broken(monkeypatch: pytest.MonkeyPatch, at: int, how: Any) -> None:
    """Let a batch do something wrong in one of its steps."""
    step, calls = EpisodeBatch.step, [0]

    def wrong(self: EpisodeBatch, *arguments: Any, **keywords: Any) -> Any:
        calls[0] += 1
        if calls[0] == at:
            how(self, None)
        result = step(self, *arguments, **keywords)
        if calls[0] == at:
            how(self, result)
        return result

    monkeypatch.setattr(EpisodeBatch, "step", wrong)


def nan_observation(_: EpisodeBatch, result: Any) -> None:
    if result is not None:
        result[0][1, 3:5] = np.nan


def far_observation(_: EpisodeBatch, result: Any) -> None:
    if result is not None:
        result[0][:, 40] = 1e4


def infinite_reward(_: EpisodeBatch, result: Any) -> None:
    if result is not None:
        result[1][0] = -np.inf


def nan_state(batch: EpisodeBatch, result: Any) -> None:
    if result is not None:
        batch.vehicles.state.view(0).elongation[0] = np.nan


def divergence(batch: EpisodeBatch, result: Any) -> None:
    if result is None:
        batch.vehicles.state.view(1).v[:] = np.nan


@pytest.mark.parametrize(
    ("how", "defects"),
    [
        (nan_observation, {"observations": 1}),
        (far_observation, {"observations_out_of_range": 2}),
        (infinite_reward, {"rewards": 1}),
        (nan_state, {"states": 1}),
        (divergence, {"states": 1, "diverged": 1}),
    ],
)
def test_defects_are_seen(
    how: Any, defects: dict[str, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken(monkeypatch, 20, how)
    result = soak(environment(tmp_path), 40, environments=2)
    found = {name: count for name, count in result.defects.items() if count}
    assert found.keys() == defects.keys()
    assert all(found[name] >= count for name, count in defects.items())
    assert found == defects or how is nan_state  # a damper that is not finite stays so
    assert all(DEFECTS[name] in result.failures for name in defects)


def test_the_command_writes_and_prints_what_it_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    name = environment(tmp_path, episode_s=1.0)
    arguments = ["soak", "--environment", name, "--steps", "210", "--environments", "2", "--seed", "1"]
    assert main([*arguments, "--out", "here", "--json"]) == 0
    out, err = capsys.readouterr()
    content = json.loads(out)
    assert content == json.loads(Path("here/result.json").read_text())
    assert content["steps"] == 210
    assert content["seconds"] == 2
    assert content["recommended_termination_cost"] == 2.0 * content["largest_j"]
    assert set(content["defects"].values()) == {0}
    assert "recommended termination_cost" in err
    files = {path.name for path in Path("here").iterdir()}
    assert files == {"result.json", "soak.png", "worst_seconds.csv", "histogram.csv"}
    lines = Path("here/histogram.csv").read_text().splitlines()[1:]
    assert sum(int(line.split(",")[2]) for line in lines) == 2


def test_a_defect_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken(monkeypatch, 20, divergence)
    name = environment(tmp_path)
    out = str(tmp_path / "here")
    status = main(["soak", "--environment", name, "--steps", "80", "--environments", "2", "--out", out])
    assert status == 1
    message = (
        "sayd: error: the environment has defects: states that are not finite: 1, episodes that diverged: 1"
    )
    assert message in capsys.readouterr().err
    assert (tmp_path / "here/result.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--steps", "0"], "--steps 0: expected a whole number from 1"),
        (["--steps", "many"], "--steps many"),
        (["--environments", "0"], "--environments 0"),
        (["--environment", "fautls"], "did you mean 'faults'"),
        (["--set", "frictoin=0.3"], "frictoin"),
    ],
)
def test_bad_input_is_one_message(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["soak", "--steps", "10", "--out", str(tmp_path), *arguments]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert message in err


def test_no_vehicle_is_refused() -> None:
    with pytest.raises(ConfigError, match="0 vehicles"):
        soak(steps=10, environments=0)


def test_no_whole_second_is_reported_as_nothing(tmp_path: Path) -> None:
    result = soak(environment(tmp_path), 20, environments=2)
    assert len(result.costs) == 0
    assert np.isnan(result.recommended)
    assert result.tables()["histogram"][1] == []


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> SoakResult:
    path = tmp_path_factory.mktemp("soak") / "late.yaml"
    path.write_text(LATE)
    return soak(str(path), 40_000, seed=100)


@pytest.mark.slow
def test_many_steps_give_nothing_but_numbers(long: SoakResult) -> None:
    assert long.failures == ""
    assert long.steps >= 40_000
    assert long.episodes >= 100
    # The charge must exceed what a second can cost, or a policy gains by derailing.
    assert long.termination_cost > long.largest
