"""Tunings: places of the ranges, budgets, what is refused, and the packaged list of scenarios."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import pytest

from sayd_env import baselines
from sayd_env.config import ConfigError
from sayd_env.config.control import gains_of, load_controller
from sayd_env.config.distribution import UniformDistribution
from sayd_env.config.environment import load_environment
from sayd_env.config.tuning import load_tuning
from sayd_env.studies.tuning.tune import training_seconds


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
    """Values are on the steps of the training's distributions; none is one of the comparison's file."""
    tuning = load_tuning()
    randomisation = load_environment(tuning.environment).randomisation
    for name in ("speed_kmh", "wear", "friction"):
        drawn = getattr(randomisation, name)
        assert isinstance(drawn, UniformDistribution)
        assert drawn.step
        for scenario in tuning.scenarios:
            steps = (getattr(scenario, name) - drawn.low) / drawn.step
            assert steps == pytest.approx(round(steps), abs=1e-6)
            assert drawn.low <= getattr(scenario, name) <= drawn.high
    assert [scenario.seed for scenario in tuning.scenarios] == [*range(8000, 8032)]


def test_the_scenarios_reach_from_low_conicity_to_worn_and_lines_are_among_them():
    tuning = load_tuning()
    low = [scenario for scenario in tuning.scenarios if scenario.profile == "lma"]
    assert len(low) == 8
    assert max(scenario.wear for scenario in tuning.scenarios) == 0.95
    assert low[0].case == {"profile": "lma", "speed_kmh": 210.0, "wear": 0.0, "friction": 0.3, "seed": 8024}
    assert "profile" not in tuning.scenarios[0].case
    assert tuning.lines is not None
    assert load_environment(tuning.lines.environment).lines is not None


def test_every_search_simulates_at_least_what_one_training_of_ppo_does():
    """An evaluation: 32 episodes of 20 s and 8 of 60 s.

    A training: a million decisions of 40 ms, two bogies of a vehicle deciding at the same time.
    """
    tuning = load_tuning()
    assert tuning.seconds == 32 * 20.0 + 8 * 60.0
    wanted = 1_000_000 * 0.04 / 2
    assert training_seconds() == pytest.approx(wanted)
    for search in tuning.controllers.values():
        # What rounds to the same gains is not simulated again: of one gain only the even points are sure.
        sure = search.search if len(search.gains) == 1 else search.search + search.polish
        assert sure * tuning.seconds >= wanted


def test_nothing_about_the_tuning_reads_the_comparison_s_file():
    root = Path(__file__).parents[2]
    for path in ("config/tuning.py", *(f"studies/tuning/{name}.py" for name in ("tune", "search"))):
        assert "heldout" not in (root / "sayd_env" / path).read_text()


def test_a_look_has_fewer_scenarios_and_evaluations():
    tuning = load_tuning()
    short = tuning.shortened()
    assert [s.seed for s in short.scenarios] == [8007, 8015, 8023, 8031]  # every eighth
    assert short.lines is None
    assert (short.of("mppt2").search, short.of("mppt2").population) == (10, 5)
    assert (short.of("constant").search, short.of("constant").polish) == (10, 5)


def test_packaged_results_are_those_of_the_packaged_tuning():
    """Gains lie in their ranges, all else is the controller's own; the provenance names list and budget."""
    tuning = load_tuning()
    seeds = [scenario.seed for scenario in tuning.scenarios]
    shipped = [name for name in tuning.controllers if f"{name}-tuned" in baselines.NAMES]
    assert {"constant", "mppt2"} <= set(shipped)
    for name in shipped:
        search = tuning.controllers[name]
        own, tuned = (gains_of(load_controller(each)) for each in (name, f"{name}-tuned"))
        about = tuned.pop("provenance")
        own.pop("provenance")
        assert set(tuned) == set(own)
        lists = {gain.partition(".")[0] for gain in search.gains if "." in gain}
        kept = set(own) - set(search.gains) - lists
        assert {key: tuned[key] for key in kept} == {key: own[key] for key in kept}
        gains = {key: tuned[key] for key in search.gains}
        assert search.values(search.place(gains), tuning.digits) == pytest.approx(gains, abs=2e-4)
        assert about["J_after"] < about["J_before"]
        assert 1 <= about["evaluations"] <= search.search + search.polish
        assert about["command"].startswith(f"sayd tune {name}")
        if about["simulated_s"] is None:  # found before there were lines
            continue
        assert tuning.lines is not None
        assert about["scenarios"] == (
            f"{len(seeds)} of configs/study/tuning.yaml, {tuning.episode_s:g} s, "
            f"seeds {min(seeds)} to {max(seeds)}; {len(tuning.lines.seeds)} lines, "
            f"{tuning.lines.episode_s:g} s, seeds {min(tuning.lines.seeds)} to {max(tuning.lines.seeds)}"
        )
        assert about["simulated_s"] == about["evaluations"] * tuning.seconds
        assert about["mean"] == tuning.mean
        assert re.fullmatch("[0-9a-f]{40}", about["commit"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("scenarios.0.seed=8001", "the seed 8001 is a duplicate"),
        ("reward=mppt3", "reward: .*found 'mppt3', did you mean 'mppt2'"),
        ("scenarios.0.wear=1.5", "scenarios.*wear: found 1.5"),
        ("controllers.mppt2.gains.k_J.low=0.4", "k_J: .*needs low < high"),
        ("controllers.mppt2.gains.k_J.high=1.5", "an end of the ranges is not allowed: .*k_J: found 1.5"),
        ("controllers.mppt2.gains.k_I={low: 0.0, high: 1.0}", "a guess needs a value of each of"),
        ("controllers.constant.gains={curent: {low: 0.0, high: 1.0}}", "unknown gain 'curent', did you mean"),
        ("controllers.constant.search=2", "the global search of one gain needs three evaluations or none"),
        ("lines.seeds=[8000]", "the seed 8000 is a duplicate"),
        ("mean=harmonic", "mean: .*harmonic"),
        (
            "controllers.speed-schedule={gains: {commands.7: {low: 0.0, high: 1.0}}, polish: 3}",
            "unknown gain 'commands.7'",
        ),
        ("scenarios.0.profile=''", "profile"),
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
