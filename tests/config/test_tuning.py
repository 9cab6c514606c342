"""Tunings: places of the ranges, budgets, what is refused, and the packaged list of scenarios."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import pytest

from sayd_env.config import ConfigError
from sayd_env.config.control import load_controller
from sayd_env.config.distribution import UniformDistribution
from sayd_env.config.environment import load_environment
from sayd_env.config.tuning import load_tuning

STUDIES = Path(__file__).parents[2] / "configs" / "study"


def test_a_share_becomes_a_value_and_back():
    """A threshold of three quarters of 0.8 m/s2 is 0.6 m/s2."""
    tuning = load_tuning().of("mppt2")
    place = [0.1, 0.2, 0.05, 0.8, 0.75, 0.01, 0.4]
    values = tuning.values(place, 4)
    assert values["threshold_min"] == pytest.approx(0.6)
    assert tuning.place(values) == pytest.approx(place)
    assert tuning.values([x + 4e-5 for x in place], 4)["k_J"] == 0.1  # rounded to four digits


def test_gains_outside_come_to_the_end_of_their_range():
    tuning = load_tuning().of("constant")
    gain = tuning.gains["current"].model_copy(update={"low": 0.3, "high": 0.6})
    tuning = tuning.model_copy(update={"gains": {"current": gain}})
    assert tuning.place({"current": 0.05}) == [0.3]
    assert tuning.place({"current": 1.0}) == [0.6]


def test_all_corners_of_the_ranges_are_parameters_of_the_controller():
    for name, tuning in load_tuning().controllers.items():
        ends = [(gain.low, gain.high) for gain in tuning.gains.values()]
        for corner in product(*ends):
            load_controller(name, tuning.values(corner, 4))


def test_the_scenarios_are_of_the_training_and_of_no_comparison():
    """Values are on the steps of the training's laws; none is one of the comparison's file."""
    tuning = load_tuning()
    laws = load_environment(tuning.environment).randomisation
    for name in ("speed_kmh", "wear", "friction"):
        law = getattr(laws, name)
        assert isinstance(law, UniformDistribution)
        assert law.step
        for scenario in tuning.scenarios:
            steps = (getattr(scenario, name) - law.low) / law.step
            assert steps == pytest.approx(round(steps), abs=1e-6)
            assert law.low <= getattr(scenario, name) <= law.high
    seeds = {scenario.seed for scenario in tuning.scenarios}
    assert len(seeds) == len(tuning.scenarios) == 24
    assert min(seeds) == 8000


def test_nothing_about_the_tuning_reads_the_comparison_s_file():
    root = Path(__file__).parents[2]
    for path in ("config/tuning.py", *(f"studies/tuning/{name}.py" for name in ("tune", "search"))):
        assert "heldout" not in (root / "sayd_env" / path).read_text()


def test_a_look_has_fewer_scenarios_and_evaluations():
    tuning = load_tuning()
    short = tuning.shortened()
    assert [s.seed for s in short.scenarios] == [8005, 8011, 8017, 8023]  # every sixth
    assert (short.of("mppt2").search, short.of("mppt2").population) == (10, 5)
    assert (short.of("constant").search, short.of("constant").polish) == (0, 5)


def test_packaged_results_are_those_of_the_packaged_tuning():
    """Gains lie in their ranges, all else is the controller's own; the provenance names list and budget."""
    tuning = load_tuning()
    seeds = [scenario.seed for scenario in tuning.scenarios]
    for name, search in tuning.controllers.items():
        own, tuned = load_controller(name).model_dump(), load_controller(f"{name}-tuned").model_dump()
        about = tuned.pop("provenance")
        own.pop("provenance")
        assert set(tuned) == set(own)
        assert {key: value for key, value in tuned.items() if key not in search.gains} == {
            key: value for key, value in own.items() if key not in search.gains
        }
        gains = {key: tuned[key] for key in search.gains}
        assert search.values(search.place(gains), tuning.digits) == pytest.approx(gains, abs=2e-4)
        assert about["J_after"] < about["J_before"]
        assert 1 <= about["evaluations"] <= search.search + search.polish
        assert about["command"].startswith(f"sayd tune {name}")
        assert about["scenarios"] == (
            f"{len(seeds)} of configs/study/tuning.yaml, {tuning.episode_s:g} s, "
            f"seeds {min(seeds)} to {max(seeds)}"
        )
        assert re.fullmatch("[0-9a-f]{40}", about["commit"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("scenarios.0.seed=8001", "scenarios: .*the seed 8001 is a duplicate"),
        ("reward=mppt3", "reward: .*found 'mppt3', did you mean 'mppt2'"),
        ("scenarios.0.wear=1.5", "scenarios.*wear: found 1.5"),
        ("controllers.mppt2.gains.k_J.low=0.4", "k_J: .*needs low < high"),
        ("controllers.mppt2.gains.k_J.high=1.5", "an end of the ranges is not allowed: .*k_J: found 1.5"),
        ("controllers.mppt2.gains.k_I={low: 0.0, high: 1.0}", "a guess needs a value of each of"),
        ("controllers.constant.gains={curent: {low: 0.0, high: 1.0}}", "unknown gain 'curent', did you mean"),
        ("controllers.constant.search=10", "one gain is found by the local search alone"),
        ("controllers.mppt2.search=10", "at least one generation: search 10, population 12"),
        ("controllers.mppt2.polish=5", "the local search of 7 gains needs 9 evaluations or none"),
        ("controllers.mppt2.guesses.0.v_min=0.5", "a guess of v_min, 0.5, lies outside its range"),
        (
            "controllers.mppt2.gains.threshold_min.share_of=v_mn",
            "'v_mn' is not an independent gain of this list",
        ),
        ("controllers.mpt2={gains: {k_J: {low: 0.0, high: 1.0}}, polish: 3}", "unknown controller 'mpt2'"),
    ],
)
def test_bad_tunings_are_refused(change: str, message: str):
    with pytest.raises(ConfigError, match=message):
        load_tuning(overrides=[change])


def test_a_search_that_is_not_there_is_named():
    with pytest.raises(ConfigError, match="tune mppt1: no such search, did you mean 'mppt2'"):
        load_tuning().of("mppt1")
