"""Comparisons: what a file may say, and that nothing was trained or tuned on the packaged one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

import sayd_env
from sayd_env.config import ConfigError
from sayd_env.config.comparison import HELD_OUT, ComparisonConfig, load_comparison
from sayd_env.config.digests import digests
from sayd_env.config.distribution import UniformDistribution
from sayd_env.config.environment import load_environment
from sayd_env.config.scenario import load_scenario
from sayd_env.studies.comparison.grid import ScenarioGrid

ROOT = Path(sayd_env.__file__).parents[1]
CONFIGS = ROOT / "configs"
SOURCES = [path for name in ("sayd_env", "agents", "baselines") for path in (ROOT / name).rglob("*.py")]


@pytest.fixture(scope="module")
def held_out() -> ComparisonConfig:
    return load_comparison()


def numbers_of(content: object) -> set[float]:
    """All numbers of a YAML content, wherever they stand; true and false are none."""
    if isinstance(content, dict | list):
        inner = content.values() if isinstance(content, dict) else content
        return set().union(*map(numbers_of, inner))
    known = isinstance(content, int | float) and not isinstance(content, bool)
    return {float(content)} if known else set()  # type: ignore[arg-type]


def texts_of(content: object) -> set[str]:
    """All texts among the values of a YAML content."""
    if isinstance(content, dict | list):
        inner = content.values() if isinstance(content, dict) else content
        return set().union(*map(texts_of, inner))
    return {content} if isinstance(content, str) else set()


def others() -> dict[str, object]:
    """Every other configuration by its path, the held-out spectra's own files left out."""
    own = {HELD_OUT, "fra_6", "grade_5", "grade_6"}
    files = (path for path in (ROOT / "configs").rglob("*.yaml") if path.stem not in own)
    return {f"{path.parent.name}/{path.name}": yaml.safe_load(path.read_text()) for path in files}


def test_held_out_conditions_lie_between_the_steps_of_the_training(held_out: ComparisonConfig):
    randomisation = load_environment("training").randomisation
    gauges = load_environment("randomized").randomisation.gauge
    worn = [each.wear for each in held_out.wheels if each.wear > 0.0]
    for drawn, values in (
        (randomisation.speed_kmh, held_out.speeds_kmh),
        (randomisation.wear, worn),
        (randomisation.friction, held_out.friction),
        (gauges, [each.gauge for each in held_out.wheels]),
    ):
        assert isinstance(drawn, UniformDistribution)
        assert drawn.step
        for value in values:
            assert value is not None
            steps = (value - drawn.low) / drawn.step
            assert abs(steps - round(steps)) > 0.1
            assert drawn.low < value < drawn.high


def test_held_out_wheels_reach_from_low_conicity_to_worn(held_out: ComparisonConfig):
    first, *_, last = held_out.wheels
    assert first.profile == "lma"
    assert last.wear > 0.9


def test_no_other_configuration_knows_a_held_out_spectrum(held_out: ComparisonConfig):
    assert held_out.lines is not None
    spectra = {track.name for track in (*held_out.tracks, *held_out.lines.tracks)}
    assert len(spectra) >= 2
    for name, content in others().items():
        assert not spectra & texts_of(content), name


def test_no_other_configuration_has_a_held_out_seed_or_condition(held_out: ComparisonConfig):
    assert held_out.lines is not None
    seeds = {*held_out.seeds, *held_out.critical_speed.seeds, *held_out.lines.seeds}
    assert len(seeds) == sum(map(len, (held_out.seeds, held_out.critical_speed.seeds, held_out.lines.seeds)))
    wheels = [(each.wear, each.gauge) for each in held_out.wheels]
    for name, content in others().items():
        found = numbers_of(content)
        assert not seeds & found, name
        assert not {*held_out.speeds_kmh} & found, name
        if name.startswith(("study/", "env/", "line")):
            assert not {*held_out.friction} & found, name
            assert not {gauge for _, gauge in wheels} & found, name
    assert not seeds & {*range(100), *range(1000, 1100)}  # of the studies, of the calibrations


def test_its_size_is_what_the_file_says(held_out: ComparisonConfig):
    """Every condition with every seed: the assessed length or the episode, and the run-in before it."""
    grid = ScenarioGrid.of(held_out)
    assert grid.drawn is not None
    way, along = held_out.length + grid.environment.run_in, grid.drawn.environment
    straight = sum(way * 3.6 / each.speed_kmh for each in grid.conditions if each.speed_kmh is not None)
    lines = sum(
        along.episode_s + along.run_in / float(line.speed_at(0.0)) for line in grid.drawn.lines.values()
    )
    seconds = len(held_out.seeds) * (straight + lines)
    assert f"{seconds:,.0f} s of simulation" in (CONFIGS / "study" / f"{HELD_OUT}.yaml").read_text()


def test_trainings_draw_from_seeds_beyond_the_held_out_ones(held_out: ComparisonConfig):
    learning = pytest.importorskip("sayd_env.agents.learning_env", exc_type=ImportError)
    assert held_out.lines is not None
    highest = max(*held_out.seeds, *held_out.critical_speed.seeds, *held_out.lines.seeds)
    assert highest < learning.SEEDS_APART


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
        ("wheels=[{name: a, wear: 0.5}, {name: a, wear: 0.6}]", r"'a' is a duplicate"),
        ("wheels=[{name: a, wear: 1.5}]", r"wear.*1.5"),
        ("wheels=[{name: a, wear: 0.0, gauge: 3.0}]", r"gauge.*3"),
        ("wheels=[{name: a, profile: lma, wear: 0.5}]", r"does not say how it wears: wear must be 0"),
        ("lines.seeds=[1,1]", r"1 is a duplicate"),
        ("lines.tracks=[{name: nowhere}]", r"nowhere"),
        ("lines.environmant=x", r"environmant.*environment"),
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
    source["lines"] |= {"environment": "own.yaml", "tracks": [{"name": "own.yaml"}]}
    track = (ROOT / "configs" / "track" / "china.yaml").read_text()
    (tmp_path / "own.yaml").write_text(track)
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(source))
    found = load_comparison(str(tmp_path / "mine.yaml"))
    own = str(tmp_path / "own.yaml")
    assert (found.environment, found.critical_speed.study, found.tracks[0].name) == (own, own, own)
    assert found.lines is not None
    assert (found.lines.environment, found.lines.tracks[0].name) == (own, own)


def test_each_digest_is_that_of_its_part():
    scenario, environment = load_scenario(), load_environment("randomized")
    before = digests(scenario, environment)
    heavier = scenario.cost.model_copy(update={"force_weight": 0.6})
    assert _changed(before, digests(scenario.model_copy(update={"cost": heavier}), environment)) == {
        "weights"
    }
    assert _changed(before, digests(scenario.model_copy(update={"friction": 0.3}), environment)) == {"plant"}
    longer = environment.model_copy(update={"episode_s": 30.0})
    assert _changed(before, digests(scenario, longer)) == {"environment"}
    assert {"mppt1", "mppt2", "online"} <= before["controllers"].keys()
    assert digests(load_scenario(), load_environment("randomized")) == before


def _changed(before: dict[str, object], after: dict[str, object]) -> set[str]:
    assert before["sha256"] != after["sha256"]
    return {name for name in before if before[name] != after[name]} - {"sha256"}
