"""Tuning: the search finds a known optimum, evaluations are not lost, and J is the rollout evaluator's."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from sayd_env.cli import main
from sayd_env.config.control import SpeedScheduleConfig, load_controller
from sayd_env.config.tuning import ControllerTuning, load_tuning
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.keywords import configured
from sayd_env.envs.rollout import roll_out
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import RunContext
from sayd_env.runs.evaluator import PolicyCosts
from sayd_env.runs.policies import PolicySpec, policy_spec
from sayd_env.studies.tuning import tune as module
from sayd_env.studies.tuning.search import minimise
from sayd_env.studies.tuning.tune import TuneResult, tune

TINY = (
    "episode_s=2.0",
    "references=[passive]",
    "scenarios=[{speed_kmh: 300.0, wear: 0.5, friction: 0.3, seed: 9000},"
    " {speed_kmh: 200.0, wear: 0.0, friction: 0.4, seed: 9001}]",
    "controllers.constant.polish=2",
    "controllers.constant.search=0",
    "lines=null",
    "mean=arithmetic",
)
PLAIN = TINY[-2:]
"""Scenarios without lines, and their plain mean."""


def search_of(**content: object) -> ControllerTuning:
    return ControllerTuning.model_validate(content)


def test_one_gain_s_optimum_is_found():
    """(x - 0.42)^2: Brent's parabola meets it at once."""
    tried: list[float] = []

    def cost(stage: str, place: np.ndarray) -> float:
        tried.append(float(place[0]))
        return float((place[0] - 0.42) ** 2)

    minimise(search_of(gains={"current": {"low": 0.0, "high": 1.0}}, polish=12), {}, cost, 0)
    assert len(tried) <= 12
    assert min(tried, key=lambda x: abs(x - 0.42)) == pytest.approx(0.42, abs=1e-6)


@pytest.mark.parametrize(("search", "polish", "tried"), [(5, 0, 5), (5, 4, 9)])
def test_one_gain_s_search_keeps_to_its_budget(search: int, polish: int, tried: int):
    places: list[float] = []

    def cost(stage: str, place: np.ndarray) -> float:
        places.append(float(place[0]))
        return float(np.cos(3.0 * place[0]))

    minimise(
        search_of(gains={"current": {"low": 0.0, "high": 1.0}}, search=search, polish=polish), {}, cost, 0
    )
    assert len(places) == tried


@pytest.mark.parametrize(
    ("change", "budget"),
    [
        ("quick.polish=5", (10, 5)),
        ("quick.polish=1", (10, 0)),
        ("controllers.constant.polish=0", (10, 0)),
        ("controllers.constant.polish=3", (10, 3)),
    ],
)
def test_a_quick_search_of_one_gain_makes_evaluations(change: str, budget: tuple[int, int]):
    quick = load_tuning(overrides=(change,)).shortened().of("constant")
    assert (quick.search, quick.polish) == budget


@pytest.mark.parametrize(("search", "polish"), [(0, 0), (0, 1), (5, 1)])
def test_a_search_of_one_gain_with_too_few_evaluations_is_refused(search: int, polish: int):
    with pytest.raises(ValidationError, match="local search of one gain needs two evaluations, or none"):
        search_of(gains={"current": {"low": 0.0, "high": 1.0}}, search=search, polish=polish)


def test_several_gains_optimum_is_found_within_the_budget():
    """A bowl whose valley runs across two of three gains, one of them a share, the optimum inside."""
    tuning = search_of(
        gains={
            "k_J": {"low": 0.0, "high": 0.2},
            "threshold_max": {"low": 0.1, "high": 1.1},
            "threshold_min": {"low": 0.0, "high": 1.0, "share_of": "threshold_max"},
        },
        search=60,
        population=10,
        polish=60,
        radius=0.2,
    )
    seen: list[tuple[str, float, dict[str, float]]] = []

    def cost(stage: str, place: np.ndarray) -> float:
        gains = tuning.values(place, 12)
        x, y = (gains["k_J"] - 0.05) / 0.2, gains["threshold_max"] - 0.7
        value = x**2 + (y + x) ** 2 + (gains["threshold_min"] - 0.35) ** 2
        seen.append((stage, value, gains))
        return float(value)

    own = {"k_J": 0.2, "threshold_max": 1.0, "threshold_min": 0.9}
    minimise(tuning, own, cost, 3)
    assert seen[0][2] == pytest.approx(own)  # the search starts from what the controller has
    assert [stage for stage, *_ in seen].count("search") == 60
    assert len(seen) <= 120
    _, value, gains = min(seen, key=lambda each: each[1])
    assert value < 1e-4
    assert gains == pytest.approx({"k_J": 0.05, "threshold_max": 0.7, "threshold_min": 0.35}, abs=0.02)


class Bowl:
    """Stands in for the vehicles: J is a bowl around a current of 0.45; stops after some evaluations."""

    made = 0
    stop: int | None = None

    def __init__(self, environment: str, cases: Sequence[Any], **settings: Any) -> None:
        self.asked = environment, cases, settings

    def inputs(self, policy: PolicySpec) -> tuple[Any, ...]:
        environment, cases, settings = self.asked
        return environment, cases, settings["episode_s"], policy.identity()

    def costs(self, policy: PolicySpec) -> PolicyCosts:
        if Bowl.stop == Bowl.made:
            raise KeyboardInterrupt
        Bowl.made += 1
        current = policy.parameters.get("current", 0.0)
        return PolicyCosts(0.02 + (current - 0.45) ** 2 + 0.1 * np.arange(len(self.asked[1])), 0)


@pytest.fixture
def bowl(monkeypatch: pytest.MonkeyPatch) -> type[Bowl]:
    monkeypatch.setattr(module, "PolicyEvaluator", Bowl)
    monkeypatch.setattr(Bowl, "made", 0)
    monkeypatch.setattr(Bowl, "stop", None)
    return Bowl


def test_an_interrupted_tuning_goes_on_where_it_stopped(bowl: type[Bowl], tmp_path: Path):
    settings = load_tuning(overrides=PLAIN)

    def again() -> tuple[TuneResult, int]:
        cache = RunCache(tmp_path)
        return tune("constant", settings, context=RunContext(cache=cache)), cache.reused

    whole = tune("constant", settings)
    needed, bowl.made = bowl.made, 0
    bowl.stop = 9
    with pytest.raises(KeyboardInterrupt):
        again()
    assert len(list(tmp_path.glob("*/*.npz"))) == 9
    bowl.stop = None
    result, reused = again()
    assert bowl.made == needed  # none of the nine again
    assert reused == 9
    assert result.evaluations == whole.evaluations
    assert again()[0].best == result.best
    assert bowl.made == needed
    assert result.best.gains["current"] == pytest.approx(0.45, abs=1e-4)
    # Mean over 32 scenarios of 0.1 k is 1.55; the least J is 0.02.
    assert result.best.cost == pytest.approx(1.57, abs=1e-6)
    assert result.before.cost == pytest.approx(1.57 + 0.45**2, abs=1e-9)


def test_progress_counts_every_evaluation_once(bowl: type[Bowl]):
    progress: list[tuple[float, float]] = []
    context = RunContext(progress=lambda done, total, what="": progress.append((done, total)))
    result = tune("constant", load_tuning(), context=context)
    search = load_tuning().of("constant")
    total = len(result.references) + search.search + search.polish
    assert progress == [(done, total) for done in range(1, len(progress) + 1)]
    # Scenarios, and lines; a closed constant is a reference and a place of the search.
    assert 2 * len(progress) >= 2 * len(result.evaluations) >= bowl.made


def test_the_mean_is_the_geometric_one_over_scenarios_and_lines(bowl: type[Bowl]):
    """Costs of 0.02 + 0.1 k, of each list by itself."""
    result = tune("constant", load_tuning())
    costs = [0.02 + 0.1 * k for k in (*range(32), *range(8))]
    least = result.best.gains["current"]
    assert result.best.costs == pytest.approx([cost + (least - 0.45) ** 2 for cost in costs])
    assert result.best.cost == pytest.approx(float(np.exp(np.mean(np.log(result.best.costs)))))
    assert result.best.mean == pytest.approx(float(np.mean(result.best.costs)))
    header, rows = result.tables()["scenarios"]
    assert len(rows) == 40
    assert [row[0] for row in rows[-8:]] == ["line"] * 8
    assert header[:6] == ("line", "profile", "speed_kmh", "wear", "friction", "seed")
    assert result.as_dict()["simulated_s"] == len(result.tried) * 1120.0


def test_entries_of_a_list_are_tuned_one_by_one(bowl: type[Bowl], tmp_path: Path):
    """What comes out is a file of the controller with the list in its place."""
    result = tune("speed-schedule", load_tuning(overrides=PLAIN).shortened())
    file = tmp_path / "speed-schedule-tuned.yaml"
    file.write_text(result.control_file())
    found = load_controller(str(file))
    assert isinstance(found, SpeedScheduleConfig)
    assert found.commands == tuple(result.best.gains[f"commands.{k}"] for k in range(5))
    assert found.speeds_kmh == load_controller("speed-schedule").model_dump()["speeds_kmh"]


def test_evaluations_on_other_scenarios_are_made_anew(bowl: type[Bowl], tmp_path: Path):
    tune("constant", load_tuning(), context=RunContext(cache=RunCache(tmp_path)))
    needed, bowl.made = bowl.made, 0
    cache = RunCache(tmp_path)
    tune("constant", load_tuning(overrides=["episode_s=10.0"]), context=RunContext(cache=cache))
    # The lines are the same.
    assert (bowl.made, cache.reused) == (needed // 2, needed // 2)


def test_the_file_of_parameters_is_the_controller_with_other_gains(bowl: type[Bowl], tmp_path: Path):
    settings = load_tuning(overrides=PLAIN).shortened()
    result = tune("mppt2", settings, name="mine.yaml", command="sayd tune mppt2 --quick")
    file = tmp_path / "mppt2-tuned.yaml"
    file.write_text(result.control_file())
    found = load_controller(str(file)).model_dump()
    about = found.pop("provenance")
    own = load_controller("mppt2").model_dump(exclude={"provenance"})
    assert found == own | dict(result.best.gains)
    assert about["command"] == "sayd tune mppt2 --quick"
    assert about["scenarios"] == "4 of mine.yaml, 20 s, seeds 8007 to 8031"
    assert about["simulated_s"] == len(result.tried) * 4 * 20.0
    assert about["evaluations"] == len(result.tried)
    assert about["J_before"] == pytest.approx(0.17 + 0.45**2, rel=1e-5)  # mean of 0, 0.1, 0.2, 0.3: 0.15


def test_j_is_that_of_rollouts_of_the_scenarios():
    """The same episodes by `roll_out`: J of the parts, weighted."""
    settings = load_tuning(overrides=TINY)
    found = tune("constant", settings).best
    config, scenario = configured("training", episode_s=2.0)
    batch = EpisodeBatch(config, 2, scenario=scenario, num_threads=1)
    episodes = [
        draw_episode(
            config, s.seed, 0, {k: v for k, v in s.case.items() if k != "seed"} | {"initial_current": 0.0}
        )
        for s in settings.scenarios
    ]
    spec = PolicySpec("constant", found.gains)
    runs = roll_out(batch, spec.make(batch), episodes, [200, 200])
    weights = scenario.cost.acceleration_weight, scenario.cost.force_weight
    assert found.derailed == 0
    assert found.costs == pytest.approx([np.dot(weights, run.cost(2.0)) for run in runs], rel=1e-9)


def test_a_tuning_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Two evaluations, golden sections of 0 to 1 from either end: the better one wins and can be used."""
    arguments = [text for change in TINY for text in ("--set", change)]
    out = tmp_path / "out"
    assert main(["tune", "constant", *arguments, "--out", str(out), "--json", "--workers", "1"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert {path.name for path in out.iterdir()} == {
        "result.json",
        "evaluations.csv",
        "scenarios.csv",
        "tune.png",
        "constant-tuned.yaml",
        "runs",
    }
    assert content["evaluations"] == 2
    golden = (3.0 - 5.0**0.5) / 2.0
    assert content["gains"]["current"] in (
        pytest.approx(golden, abs=1e-4),
        pytest.approx(1.0 - golden, abs=1e-4),
    )
    with (out / "evaluations.csv").open() as stream:
        tried = [row for row in csv.DictReader(stream) if row["policy"] == "constant-tuned"]
    means = [(float(row["J_9000"]) + float(row["J_9001"])) / 2.0 for row in tried]
    assert len(means) == 2
    assert content["J_after"] == pytest.approx(min(means), rel=1e-12)
    assert content["gains"]["current"] == float(tried[int(np.argmin(means))]["current"])
    assert list(content["J"]) == ["passive", "constant", "constant-tuned"]
    spec = policy_spec(str(out / "constant-tuned.yaml"))
    assert spec.title == "constant-tuned@out"
    policy = spec.make(EpisodeBatch(configured("training")[0], 1, num_threads=1))
    action, _ = policy.predict(np.zeros((1, 41), dtype=np.float32))
    assert np.array_equal(action, np.full((1, 2), content["gains"]["current"], dtype=np.float32))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["mppt1"], "mppt1"),
        (["constant", "--out", "x.yaml"], "expected a directory; the file of parameters is -o x.yaml"),
        (["constant", "-o", "x.txt"], "expected a file that ends in .yaml"),
        (["constant", "--set", "references=[mppt3]"], "policy 'mppt3': unknown"),
        (["constant", "--set", "scenarios.0.speed_kmh=900.0"], "speed_kmh"),
    ],
)
def test_bad_input_is_one_message(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    assert main(["tune", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


def test_a_packaged_file_is_never_written(capsys: pytest.CaptureFixture[str]):
    packaged = Path(__file__).parents[3] / "configs" / "control" / "mppt2-tuned.yaml"
    before = packaged.read_bytes()
    assert main(["tune", "mppt2", "--quick", "-o", str(packaged), "--json"]) == 2
    assert "lies among the packaged files" in capsys.readouterr().err
    assert main(["tune", "mppt2", "--quick", "--out", str(packaged.parent)]) == 2
    assert packaged.read_bytes() == before
