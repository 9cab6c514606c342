"""Comparisons: what a file may say, and that nothing was trained or tuned on the packaged one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

import sayd_env
from sayd_env.config import ConfigError
from sayd_env.config.comparison import HELD_OUT, ComparisonConfig, load_comparison
from sayd_env.config.distribution import UniformDistribution
from sayd_env.config.environment import load_environment
from sayd_env.config.frozen import frozen
from sayd_env.config.scenario import load_scenario
from sayd_env.config.tuning import load_tuning

ROOT = Path(sayd_env.__file__).parents[1]
SOURCES = [path for name in ("sayd_env", "agents", "baselines") for path in (ROOT / name).rglob("*.py")]


@pytest.fixture(scope="module")
def held_out() -> ComparisonConfig:
    return load_comparison()


def test_held_out_conditions_lie_between_the_steps_of_the_training(held_out: ComparisonConfig):
    laws = load_environment("training").randomisation
    for law, values in (
        (laws.speed_kmh, held_out.speeds_kmh),
        (laws.wear, held_out.wear),
        (laws.friction, held_out.friction),
    ):
        assert isinstance(law, UniformDistribution)
        assert law.step
        for value in values:
            steps = (value - law.low) / law.step
            assert abs(steps - round(steps)) > 0.1
            assert law.low < value < law.high
    assert not {track.name for track in laws.tracks} & {track.name for track in held_out.tracks}


def test_held_out_seeds_are_no_others(held_out: ComparisonConfig):
    mine = {*held_out.seeds, *held_out.critical_speed.seeds}
    for file in (ROOT / "configs" / "train").glob("*.yaml"):
        evaluation = yaml.safe_load(file.read_text())["evaluation"]
        assert not mine & set(evaluation["seeds"])
    assert not mine & {case.seed for case in load_tuning().scenarios}
    assert not mine & {*range(100), *range(1000, 1100)}  # of the studies, of the calibrations


def test_trainings_draw_from_seeds_beyond_the_held_out_ones(held_out: ComparisonConfig):
    learning = pytest.importorskip("sayd_env.agents.learning_env", exc_type=ImportError)
    assert max(*held_out.seeds, *held_out.critical_speed.seeds) < learning.SEEDS_APART


def test_nothing_but_the_comparison_reads_them():
    naming = {path for path in SOURCES if HELD_OUT in path.read_text(encoding="utf-8")}
    assert naming == {ROOT / "sayd_env" / "config" / "comparison.py"}
    importing = {path for path in SOURCES if "config.comparison import" in path.read_text(encoding="utf-8")}
    allowed = re.compile(r"(cli/policies|studies/comparison/\w+)\.py")
    assert importing
    for path in importing:
        assert allowed.fullmatch(path.relative_to(ROOT / "sayd_env").as_posix())


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("speedz_kmh=[300]", r"speedz_kmh.*speeds_kmh"),
        ("speeds_kmh=[300,250]", r"speeds must rise: 250 follows 300"),
        ("speeds_kmh=[300,900]", r"found 900; allowed are 30 to 500 km/h"),
        ("wear=[0.5,0.5]", r"0.5 is a duplicate"),
        ("wear=[1.5]", r"wear.*1.5"),
        ("friction=[0.0]", r"found 0; allowed are 0.05 to 1"),
        ("seeds=[]", r"seeds"),
        ("seeds=[1.5]", r"seeds.*1.5"),
        ("tracks=[{name: nowhere}]", r"nowhere"),
        ("tracks=[{name: smooth, scale: 1.0}]", r"even: it has nothing to scale"),
        ("tracks=[{name: china}, {name: china}]", r"'china' is a duplicate"),
        ("force_weights=[0.5,2]", r"must include 1"),
        ("constants=[1.2]", r"constants.*1.2"),
        ("bootstrap.samples=10", r"bootstrap.samples.*10"),
        ("critical_speed.speeds_kmh=[300]", r"critical_speed.speeds_kmh"),
        ("critical_speed.seeds=[1,1]", r"1 is a duplicate"),
        ("length=-5", r"length.*-5"),
    ],
)
def test_what_cannot_be_is_refused(assignment: str, message: str):
    with pytest.raises(ConfigError, match=message):
        load_comparison(overrides=[assignment])


def test_paths_are_relative_to_the_file(tmp_path: Path):
    source = yaml.safe_load((ROOT / "configs" / "study" / f"{HELD_OUT}.yaml").read_text())
    source["environment"] = "own.yaml"
    source["critical_speed"]["study"] = "own.yaml"
    source["tracks"] = [{"name": "own.yaml"}]
    track = (ROOT / "configs" / "track" / "china.yaml").read_text()
    (tmp_path / "own.yaml").write_text(track)
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(source))
    found = load_comparison(str(tmp_path / "mine.yaml"))
    own = str(tmp_path / "own.yaml")
    assert (found.environment, found.critical_speed.study, found.tracks[0].name) == (own, own, own)


def test_each_digest_is_that_of_its_part():
    scenario, environment = load_scenario(), load_environment("randomized")
    before = frozen(scenario, environment)
    heavier = scenario.cost.model_copy(update={"force_weight": 0.6})
    assert _changed(before, frozen(scenario.model_copy(update={"cost": heavier}), environment)) == {"weights"}
    assert _changed(before, frozen(scenario.model_copy(update={"friction": 0.3}), environment)) == {"plant"}
    longer = environment.model_copy(update={"episode_s": 30.0})
    assert _changed(before, frozen(scenario, longer)) == {"environment"}
    assert {"mppt1", "mppt2", "online"} <= before["controllers"].keys()
    assert frozen(load_scenario(), load_environment("randomized")) == before


def _changed(before: dict[str, object], after: dict[str, object]) -> set[str]:
    assert before["sha256"] != after["sha256"]
    return {name for name in before if before[name] != after[name]} - {"sha256"}
