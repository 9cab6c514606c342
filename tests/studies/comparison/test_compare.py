"""Comparisons: who takes part, how runs become J, and a small one from end to end."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.agents.config import InputConfig, NetworkConfig, OutputConfig
from sayd_env.agents.policy_file import StoredPolicy, describe, save_policy
from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.config.comparison import ComparedTrack, ComparedWheels, ComparisonConfig, load_comparison
from sayd_env.config.control import load_controller
from sayd_env.config.profile import load_wheel
from sayd_env.envs.single import SaydEnv
from sayd_env.runs.cache import RunCache, fingerprint
from sayd_env.runs.context import RunContext
from sayd_env.runs.policies import PolicySpec, constant_spec
from sayd_env.studies.comparison import compare as module
from sayd_env.studies.comparison.compare import CompareResult, compare, fewer
from sayd_env.studies.comparison.entrants import Entrant, read_entrants
from sayd_env.studies.comparison.grid import OWN, ScenarioGrid, Variant
from sayd_env.studies.comparison.scores import Stability

ENVIRONMENT = "base: randomized\nepisode_s: 4.0\n"
LINES = "base: line\nepisode_s: 12.0\n"
STUDY = "base: nominal\nassessment: {run_in: 200.0, length: 600.0}\n"
COMPARISON = """
environment: env.yaml
length: 600.0
tracks: [{name: german_low, scale: 0.6}]
speeds_kmh: [250.0, 350.0]
wheels: [{name: worn, wear: 1.0}]
friction: [0.35]
seeds: [5]
lines:
  environment: lines.yaml
  seeds: [11]
  tracks: [{name: german_low, scale: {distribution: fixed, value: 0.5}}]
initial_current: 0.0
critical_speed: {study: study.yaml, speeds_kmh: [320.0, 400.0], wear: 1.0, seeds: [3]}
constants: [0.3]
force_weights: [0.5, 1.0, 2.0]
bootstrap: {samples: 200, seed: 0}
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A comparison of two conditions on a short track, and of a line."""
    folder = tmp_path_factory.mktemp("comparison")
    (folder / "env.yaml").write_text(ENVIRONMENT)
    (folder / "lines.yaml").write_text(LINES)
    (folder / "study.yaml").write_text(STUDY)
    (folder / "small.yaml").write_text(COMPARISON)
    return folder / "small.yaml"


@pytest.fixture(scope="module")
def config(file: Path) -> ComparisonConfig:
    return load_comparison(str(file))


@pytest.fixture(scope="module")
def policy() -> Callable[..., StoredPolicy]:
    """Maker of a policy without sight, of one constant command."""
    interface = SaydEnv(observation="features", control_period=0.05).interface

    def make(command: float, **made: Any) -> StoredPolicy:
        description = describe(
            interface,
            name="blind",
            inputs={"speed": InputConfig(middle=80.0, half=20.0)},
            clip=3.0,
            output=OutputConfig(kind="command"),
            network=NetworkConfig(hidden=(), activation="tanh"),
            squash="clip",
            made=made,
        )
        layer = np.zeros((2, 1), np.float32), np.full(2, 2 * command - 1, np.float32)
        return StoredPolicy(description, (layer,))

    return make


def trained(seed: int, algorithm: str = "ppo") -> dict[str, Any]:
    learning = {"algorithm": algorithm}
    return {"steps": 7, "git_commit": "abc", "config": {"seed": seed, "learning": learning}}


@pytest.fixture
def folder(policy: Callable[..., StoredPolicy], tmp_path: Path) -> Path:
    """Three policies of PPO with the training seeds 2, 0 and 1, and one of SAC."""
    for name, seed in (("a", 2), ("b", 0), ("c", 1)):
        save_policy(tmp_path / f"{name}.npz", policy(0.1 * seed, **trained(seed)))
    save_policy(tmp_path / "d.npz", policy(0.4, **trained(0, "sac")))
    return tmp_path


def test_a_folder_is_a_group_for_each_algorithm(folder: Path):
    found = read_entrants([str(folder)])
    assert [each.name for each in found] == ["passive", "mppt2", "ppo", "sac"]
    assert found[2].titles == ("ppo-s0", "ppo-s1", "ppo-s2")
    assert [each.learned for each in found] == [False, False, True, True]


def test_a_path_may_hold_an_equals_sign(folder: Path, policy: Callable[..., StoredPolicy]):
    path = folder / "rate=3e-4"
    path.mkdir()
    save_policy(path / "best.npz", policy(0.25, **trained(0)))
    for text in (path, path / "best.npz"):
        assert [each.learned for each in read_entrants([str(text)])] == [False, False, True]


def test_files_are_grouped_under_a_name(folder: Path, policy: Callable[..., StoredPolicy]):
    (found,) = read_entrants([f"mine={folder}/c.npz+{folder}/a.npz", "mppt2", "passive"])[:1]
    assert found.titles == ("mine-s1", "mine-s2")
    (folder / "run").mkdir()
    save_policy(folder / "run" / "best.npz", policy(0.25))
    save_policy(folder / "run" / "last.npz", policy(0.26))
    (found,) = read_entrants(["passive", "mppt2", f"mine={folder}/run"])[2:]
    assert [Path(member.stored.where).name for member in found.members if member.stored] == ["best.npz"]
    assert found.titles == ("mine-0",)  # its training seed is not known


def test_who_takes_part_by_default():
    names = [each.name for each in read_entrants()]
    assert names[:5] == ["passive", "mppt1", "mppt2", "skyhook-onoff", "skyhook-continuous"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mppt3", r"'mppt3': unknown, did you mean 'mppt"),
        ("nowhere.npz", r"nowhere.npz: no such policy file"),
        ("x={0}/empty", r"empty: holds no files of learned policies"),
        ("a b={0}/a.npz", r"'a b=...': expected a name of letters"),
        ("x={0}/a.npz+{0}/a.npz", r"a.npz: is the same policy as .*a.npz"),
        ("x={0}/a.npz+", r"'NAME=FILE\+FILE...': found an empty place"),
        ("mppt1={0}/a.npz", r"'mppt1=...': is the name of a controller"),
        ("mppt1,mppt1", r"policy 'mppt1': duplicate"),
        ("x={0}/a.npz,y={0}/a.npz", r"a.npz: is the same policy as .*a.npz; a training seed counts once"),
    ],
)
def test_who_cannot_take_part_is_refused(text: str, message: str, folder: Path):
    (folder / "empty").mkdir()
    with pytest.raises(ConfigError, match=message):
        read_entrants(["passive", *text.format(folder).split(",")])


def test_a_comparison_needs_the_length_of_an_episode(config: ComparisonConfig):
    with pytest.raises(ConfigError, match=r"300 m are over before the 4 s .* at 350 km/h; expected 389"):
        ScenarioGrid.of(config.model_copy(update={"length": 300.0}))


def test_a_line_needs_the_length_of_a_spectrum(config: ComparisonConfig, tmp_path: Path):
    (tmp_path / "short.yaml").write_text("base: line\nepisode_s: 5.0\n")
    assert config.lines is not None
    lines = config.lines.model_copy(update={"environment": str(tmp_path / "short.yaml")})
    with pytest.raises(ConfigError, match=r"the line of seed 11 is .* m long after 5 s; expected 500 m"):
        ScenarioGrid.of(config.model_copy(update={"lines": lines}))
    straight = lines.model_copy(update={"environment": "randomized"})
    with pytest.raises(ConfigError, match=r"lines.environment: 'randomized' draws no lines"):
        ScenarioGrid.of(config.model_copy(update={"lines": straight}))


def test_what_cannot_be_is_refused_before_any_work(
    config: ComparisonConfig, entrants: list[Entrant], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delattr(module, "run_all")
    nowhere = config.critical_speed.model_copy(update={"study": "nowhere"})
    with pytest.raises(ConfigError, match=r"unknown study 'nowhere'"):
        compare(config.model_copy(update={"critical_speed": nowhere}), entrants)


def test_conditions_are_all_combinations_and_reach_the_vehicle(config: ComparisonConfig):
    many = config.model_copy(
        update={
            "tracks": (ComparedTrack(name="china"), ComparedTrack(name="german_low", scale=0.4)),
            "wheels": (
                ComparedWheels(name="LMA", profile="lma", wear=0.0, gauge=1.438),
                ComparedWheels(name="worn", wear=1.0),
            ),
        }
    )
    grid = ScenarioGrid.of(many)
    runs, lines = grid.runs(PolicySpec("mppt2"))
    assert len(runs) == len(grid.conditions) - 1 == 2 * 2 * 2
    first, last = runs[0], runs[-1]
    assert (first.scenario.wheel.name, first.scenario.wear, first.scenario.track.gauge) == (
        load_wheel("lma").name,
        0.0,
        1.438,
    )
    assert (last.speed * 3.6, last.scenario.wear, last.scenario.friction) == (350.0, 1.0, 0.35)
    assert getattr(last.scenario.track.irregularity, "scale") == 0.4  # noqa: B009 - of one kind of track
    assert last.scenario.damper.type == "sayd"
    assert not last.environment.randomisation.tracks
    assert last.environment.randomisation.tolerances  # still drawn from the seed
    assert grid.runs(PolicySpec("passive"))[0][0].scenario.damper.type == "passive"
    (line,) = lines
    assert line.line is not None
    assert line.speed == pytest.approx(float(line.line.speed_at(0.0)))
    assert line.scenario.wheel.name == load_wheel("lma").name  # the first line has the first wheels
    assert line.environment.episode_s == 12.0
    assert {piece.scale for piece in line.line.tracks} == {0.5}


def test_the_constant_s_run_is_that_of_its_command(config: ComparisonConfig):
    """By name, with the command of its file, it is the run of those with a command of their own."""
    grid = ScenarioGrid.of(config)
    own = load_controller("constant").model_dump()["current"]
    named, same, other = (
        fingerprint(*grid.runs(policy)[0][0].inputs())
        for policy in (PolicySpec("constant"), constant_spec(own), constant_spec(1.0))
    )
    assert named == same != other


def test_j_has_the_weights_and_the_charge_of_its_variant(config: ComparisonConfig):
    """k_y = 1 and k_F = 0.5; J_term = 12 a second, doubled with k_F because 2 k_F then exceeds k_y."""
    grid = ScenarioGrid.of(config)
    columns = {
        "J_acceleration": 0.3,
        "J_force": 0.2,
        "J_offline_acceleration": 0.5,
        "J_offline_force": 0.1,
        "lost": 0.25,
        "offline_lost": 0.25,
    }
    runs = {name: np.array([[value, value]]) for name, value in columns.items()}
    runs["lost"][0, 0] = 0.0
    runs["J_offline_acceleration"][0, 1] = np.inf
    assert grid.costs(runs, OWN)[0] == pytest.approx([0.3 + 0.1, 0.4 + 0.25 * 12])
    assert grid.costs(runs, Variant("online", 2.0))[0] == pytest.approx([0.5, 0.5 + 0.25 * 24])
    assert grid.costs(runs, Variant("online", 0.5))[0] == pytest.approx([0.35, 0.35 + 0.25 * 12])
    # Off line, what derailed counts as on line, also if it was behind the episode.
    assert grid.costs(runs, Variant("offline", 1.0))[0] == pytest.approx([0.55, 0.4 + 0.25 * 12])
    runs["lost"][0, 1] = 0.0
    assert grid.costs(runs, OWN)[0, 1] == pytest.approx(0.4)
    assert grid.costs(runs, Variant("offline", 1.0))[0, 1] == pytest.approx(0.4 + 0.25 * 12)


def test_quick_takes_a_few(config: ComparisonConfig):
    wheels = tuple(ComparedWheels(name=f"{wear:g}", wear=wear) for wear in (0.2, 0.9))
    few = fewer(config.model_copy(update={"wheels": wheels, "seeds": (1, 2, 3)}))
    assert ([each.wear for each in few.wheels], few.seeds, few.speeds_kmh) == ([0.9], (1,), (350.0,))
    assert few.critical_speed.speeds_kmh == (320.0, 400.0)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def entrants(policy: Callable[..., StoredPolicy], tmp_path_factory: pytest.TempPathFactory) -> list[Entrant]:
    """The passive vehicle, MPPT2 and a blind policy that always commands 0.3."""
    path = tmp_path_factory.mktemp("policies") / "blind.npz"
    save_policy(path, policy(0.3, **trained(4)))
    return read_entrants(["passive", "mppt2", f"blind={path}"])


@pytest.fixture(scope="module")
def result(config: ComparisonConfig, entrants: list[Entrant], kept: Path) -> CompareResult:
    return compare(config, entrants, context=RunContext(cache=RunCache(kept)))


def test_a_blind_policy_scores_as_the_constant_that_it_commands(result: CompareResult):
    """Its clock is another, but over the episode J on line is the same.

    On the line it is not quite: of another clock the run-in begins elsewhere, unless it is a whole number of
    periods of both.
    """
    assert result.bounds[OWN].costs[:, :2] == pytest.approx(result.costs[OWN]["blind"][:, :2], rel=1e-6)
    assert result.parts["stationary"][OWN]["blind"].geometric.value == pytest.approx(1.0, rel=1e-6)
    assert result.field(result.entrants[2], "valve_mean") == pytest.approx(0.3)


def test_the_result_has_what_scripts_read(result: CompareResult):
    found = result.as_dict()
    assert list(found["scores"]) == ["passive", "mppt2", "blind"]
    assert {"iqm", "ci95", "worst_vs_passive", "online", "offline"} <= found["scores"]["blind"].keys()
    assert (found["scores"]["mppt2"]["iqm"], found["scores"]["mppt2"]["ci95"]) == (1.0, [1.0, 1.0])
    assert [each["speed_kmh"] for each in found["scenarios"]] == [250.0, 350.0, None]
    assert [each["line"] for each in found["scenarios"]] == [None, None, 11]
    assert set(found["scores"]["mppt2"]["geometric_mean"]) == {"stationary", "lines", "together"}
    assert {"online", "offline"} == set(found["scores"]["mppt2"]["lines"])
    assert found["critical_speed_kmh"]["mppt2"] is None
    assert found["matrix"]["blind"]["training_seeds"] == ("blind-s4",)
    assert found["matrix"]["blind"]["J"].shape == (1, 3)
    (learned,) = found["learned"]
    assert (learned["seed"], learned["steps"], learned["git_commit"]) == (4, 7, "abc")
    assert len(learned["sha256"]) == 64
    runs = result.runs["mppt2"]  # J by the weights low-force, whose k_F is four times the study's
    low = float(np.mean(runs["J_acceleration"] + 2.0 * runs["J_force"]))
    assert found["scores"]["mppt2"]["J_low_force"] == pytest.approx(low, rel=1e-12)
    assert set(found["scores"]["mppt2"]["online"]) == {"0.5", "1", "2", "4"}
    assert found["targets"] == []  # three of the paper's controllers are missing
    assert result.missing[:3] == ("mppt1", "skyhook-onoff", "skyhook-continuous")


def test_each_part_is_scored_by_itself(result: CompareResult):
    """Two conditions and one line: means over both parts, weighted by their conditions, are those of all."""
    assert list(result.parts) == ["stationary", "lines"]
    straight, lines = (result.parts[part][OWN]["mppt2"] for part in result.parts)
    assert pytest.approx((2 * straight.J + lines.J) / 3) == result.scores[OWN]["mppt2"].J
    whole = result.scores[OWN]["mppt2"].geometric.value
    assert whole == pytest.approx((straight.geometric.value**2 * lines.geometric.value) ** (1 / 3))
    runs = result.runs["mppt2"]
    assert np.isfinite(runs["J_offline_acceleration"]).all()
    # On one line both filters see the same hunting: J of them is of one order.
    assert 0.5 < runs["J_offline_acceleration"][2, 0] / runs["J_acceleration"][2, 0] < 2.0


def test_passive_wheels_are_critical_where_the_map_has_them(result: CompareResult):
    """Worn wheels hunt at 400 km/h with passive dampers and do not with a closed valve (Wang et al.)."""
    assert not result.stability["passive"].stable
    assert result.stability["mppt2"].stable


def crosses(stability: Stability) -> bool:
    """Whether one of the two limits is crossed within the grid, which takes a run halfway."""
    return any(speed is not None for speed in stability.by_criterion.values())


def test_nothing_is_run_twice(
    config: ComparisonConfig, entrants: list[Entrant], kept: Path, result: CompareResult
):
    cache = RunCache(kept)
    again = compare(config, entrants, context=RunContext(cache=cache))
    # Three policies and the constant in three conditions; three at two speeds, and halfway to a crossing.
    assert cache.reused == 4 * 3 + 3 * 2 + sum(crosses(each) for each in result.stability.values())
    assert np.array_equal(again.costs[OWN]["blind"], result.costs[OWN]["blind"])
    assert again.scores[OWN]["blind"].relative_to_passive == result.scores[OWN]["blind"].relative_to_passive


def test_other_weights_under_the_same_name_are_another_policy(
    config: ComparisonConfig,
    kept: Path,
    result: CompareResult,
    policy: Callable[..., StoredPolicy],
    tmp_path: Path,
):
    save_policy(tmp_path / "blind.npz", policy(0.1, **trained(4)))
    copy = shutil.copytree(kept, tmp_path / "runs")
    others = read_entrants(["passive", "mppt2", f"blind={tmp_path}/blind.npz"])
    cache = RunCache(copy)
    found = compare(fewer(config), others, context=RunContext(cache=cache))
    assert found.field(found.entrants[2], "valve_mean") == pytest.approx(0.1)
    # The others and the constant come from the disk: at one speed, along a line, to the critical speed.
    assert cache.reused == 3 * 2 + 2 * 2 + sum(
        crosses(result.stability[name]) for name in ("passive", "mppt2")
    )


def test_an_interrupted_comparison_keeps_what_was_run(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "stability_map", interrupted)
    arguments = ["compare", "--config", str(file), "--policies", "mppt2", "--quick", "--out", str(tmp_path)]
    assert main(arguments) == 130
    assert f"finished runs are in {tmp_path}/runs; the same command goes on" in capsys.readouterr().err
    assert len(list(tmp_path.glob("runs/*/*.npz"))) == 6
    assert not (tmp_path / "result.json").exists()
    monkeypatch.undo()
    assert main([*arguments, "--json"]) == 0
    printed = capsys.readouterr()
    assert "6 runs had been finished by an earlier start" in printed.err
    assert json.loads(printed.out)["scores"]["mppt2"]["iqm"] == 1.0
    tables = (
        "scores.csv",
        "against.csv",
        "matrix.csv",
        "stability.csv",
        "best_constant.csv",
        "compare.png",
        "report.html",
        "result.json",
    )
    assert {path.name for path in tmp_path.iterdir()} == {*tables, "runs"}
