"""Training end to end, a few hundred steps: learn, judge, save, resume, load, export, be killed."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml

SB3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
torch = pytest.importorskip("torch", reason="needs the extra 'train'")

from stable_baselines3 import PPO  # noqa: E402
from stable_baselines3.common.buffers import NStepReplayBuffer  # noqa: E402
from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.monitor import Monitor  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv  # noqa: E402

from sayd_env.agents import learner  # noqa: E402
from sayd_env.agents.config import TrainConfig, load_train  # noqa: E402
from sayd_env.agents.learner import load_model, make_model  # noqa: E402
from sayd_env.agents.learning_env import environment_keywords, make_learning_env  # noqa: E402
from sayd_env.agents.policy_file import load_policy, read_policy  # noqa: E402
from sayd_env.agents.table import Table  # noqa: E402
from sayd_env.agents.training import Trained, _Run  # noqa: E402
from sayd_env.agents.training import train as learn  # noqa: E402
from sayd_env.cli import main  # noqa: E402
from sayd_env.config import ConfigError, DataError  # noqa: E402
from sayd_env.config.errors import Interrupted, StudyError  # noqa: E402
from sayd_env.config.storage import reserved  # noqa: E402
from sayd_env.envs.loop import COST_ACCELERATION, COST_FORCE  # noqa: E402
from sayd_env.envs.registration import VERSION  # noqa: E402
from sayd_env.envs.single import SaydEnv  # noqa: E402
from sayd_env.runs.executors import ExecutorChoice  # noqa: E402
from sayd_env.studies.learning import policy_evaluator  # noqa: E402
from sayd_env.studies.learning import train as study  # noqa: E402

pytestmark = pytest.mark.slow
SMALL = [
    "environment.vehicles=4",
    "environment.episode_s=0.5",
    "evaluation.episode_s=1.0",
    "evaluation.speeds_kmh=[350.0]",
    "evaluation.wear=[1.0]",
    "evaluation.seeds=[500, 501]",
    "evaluation.every=100",
    "evaluation.references=[mppt2, constant-tuned]",
    "checkpoint.every=80",
    "total_steps=200",
    "network.hidden=[16]",
    "environment.beside=[]",
    "evaluation.beside_seeds=[]",
]
PLAIN = ["memory=null", "estimate=null", "critic=[]", "privileged={}"]
HELD = "output={kind: command, middle: 0.45, half: 0.45}"
OF = {
    "ppo": ["learning.n_steps=16", "learning.batch_size=32", "learning.n_epochs=2", HELD],
    "sac": [
        *("learning.learning_starts=20", "learning.batch_size=32", "learning.buffer_size=160"),
        *(*PLAIN, HELD, "learning.n_steps=1"),
    ],
}
"""PPO with all that adapts, SAC without."""
# Too many runs of 500 m before step 0 otherwise.
RUN_IN = "base: randomized\nrun_in: 20.0\n"


def train(config: TrainConfig, folder: Path, **options: Any) -> Trained:
    return learn(config, folder, policy_evaluator(config), **options)


def settings(algorithm: str, folder: Path) -> list[str]:
    environment = folder / "randomized_quick.yaml"
    environment.write_text(RUN_IN)
    return [*SMALL, *OF[algorithm], f"environment.name={environment}"]


@pytest.fixture(scope="module", params=["ppo", "sac"])
def trained(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Trained:
    folder = tmp_path_factory.mktemp(request.param)
    return train(load_train(request.param, settings(request.param, folder)), folder / "run")


def steps_on_disk(folder: Path) -> list[int]:
    return sorted(int(path.name) for path in (folder / "checkpoints").iterdir())


def test_a_run_holds_what_it_needs_to_be_understood(trained: Trained) -> None:
    folder = trained.folder
    names = {path.name for path in folder.iterdir()}
    files = {"config.yaml", "run.yaml", "progress.csv", "evaluations.csv", "references.csv"}
    assert names >= files | {"best.npz", "last.npz", "checkpoints"}
    assert not [name for name in names if name.endswith(".tmp")]
    assert load_train(str(folder / "config.yaml")) == trained.config
    assert read_policy(folder / "best.npz").environment_version == VERSION
    (start,) = yaml.safe_load((folder / "run.yaml").read_text())["starts"]
    # A build's label, as +cpu, is not in the metadata of every one.
    assert start["libraries"]["torch"].partition("+")[0] == torch.__version__.partition("+")[0]
    assert len(steps_on_disk(folder)) == trained.config.checkpoint.keep
    assert trained.steps >= 200
    rows = Table(folder / "evaluations.csv").rows
    assert [row["steps"] for row in rows] == [row["steps"] for row in trained.evaluations]
    assert rows[0]["steps"] == 0
    assert trained.best == min(row["J_geometric"] for row in rows)
    log = Table(folder / "progress.csv").rows
    assert any("train/learning_rate" in row for row in log)
    assert any((folder / "tensorboard").iterdir())


def test_the_learning_rate_is_that_at_the_start_of_an_update(trained: Trained) -> None:
    """It falls in a straight line, as if asked before the steps of the update were made."""
    config = trained.config
    made = {"ppo": 16 * 8, "sac": 1 * 8}[config.learning.algorithm]
    rows = [row for row in Table(trained.folder / "progress.csv").rows if row.get("train/learning_rate")]
    for row in rows:
        begun = (row["steps"] - made) / config.total_steps
        assert row["train/learning_rate"] == pytest.approx(config.learning.learning_rate * (1.0 - begun))
    assert rows[-1]["train/learning_rate"] > 0.0
    assert rows


def test_the_stored_policy_acts_as_the_model(trained: Trained) -> None:
    env, encoding = make_learning_env(trained.config)
    model = make_model(trained.config, env)
    newest = max((trained.folder / "checkpoints").iterdir())
    assert load_model(newest, model).steps == trained.steps
    policy = load_policy(trained.folder / "last.npz", encoding.interface)
    env.seed(7)
    observed = env.reset()
    (part,) = env.unwrapped.parts
    state = policy.state_after(part.vector.batch.observed_run_in) if trained.config.memory else None
    for _ in range(20):
        outputs, _ = model.predict(observed, deterministic=True)
        expected = encoding.decode(outputs, env._seen)
        found, state = policy.predict(env._seen, state)
        np.testing.assert_allclose(found, expected, atol=2e-6, rtol=0)
        observed = env.step(outputs)[0]


def test_the_best_evaluation_is_that_of_the_stored_policy(trained: Trained) -> None:
    costs = policy_evaluator(trained.config)(read_policy(trained.folder / "best.npz"))
    best = np.exp(np.mean(np.log(costs)))  # the geometric mean judges
    assert best == pytest.approx(trained.best, abs=1e-12)


@pytest.mark.parametrize("trained", ["sac"], indirect=True)
def test_the_evaluator_gives_what_evaluate_policy_gives(trained: Trained) -> None:
    """Of a policy without a memory: it would take the run-in, which evaluate_policy does not give."""
    config = trained.config
    assert config.memory is None
    costs = policy_evaluator(config)(read_policy(trained.folder / "best.npz"))
    env = SaydEnv(**environment_keywords(config) | {"episode_s": 1.0})
    policy = load_policy(trained.folder / "best.npz", env.interface)
    vector = DummyVecEnv([lambda: Monitor(env)])
    for seed, cost in zip((500, 501), costs, strict=True):
        vector.seed(seed)
        vector.set_options({"speed_kmh": 350.0, "wear": 1.0, "initial_current": 0.0})
        mean, _ = evaluate_policy(policy, vector, n_eval_episodes=1)
        assert -mean == pytest.approx(cost, abs=1e-5)


@pytest.mark.parametrize("trained", ["ppo"], indirect=True)
def test_other_processes_evaluate_to_the_same_bits(trained: Trained, tmp_path: Path) -> None:
    config = trained.config.model_copy(update={"total_steps": 1})
    result = study(config, tmp_path / "run", executor=ExecutorChoice("processes", workers=2))
    assert result.trained.references == trained.references
    first, expected = result.trained.evaluations[0], trained.evaluations[0]
    assert first | {"seconds": 0.0} == expected | {"seconds": 0.0}


def test_a_run_is_exported(
    trained: Trained, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(trained.folder), "--out", "here", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    (file,) = reported["files"]
    assert read_policy(file).description == read_policy(trained.folder / "best.npz").description
    assert reported["made"]["judged"] == trained.best
    assert main(["export", str(trained.folder), "--out", "here"]) == 2
    assert "exists already" in capsys.readouterr().err
    (tmp_path / "bad.npz").write_bytes(Path(file).read_bytes()[:500])
    assert main(["export", "bad.npz", "--out", "there"]) == 2
    assert "bad.npz: is damaged" in capsys.readouterr().err
    assert not Path("there").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "what is to learn"),
        (["ppo", "--set", "learning.tau=1"], "unknown key 'learning.tau'"),
        (["ppo", "--config", "sac"], "is one of sac"),
        (["--resume", "nowhere"], "holds no run"),
        (["ppo", "--resume", "nowhere"], "leave out the algorithm"),
        (["ppo", "--seed", "1000000"], "--seed 1000000: expected a whole number from 0 to 999999"),
        (["ppo", "--seeds", "0"], "--seeds"),
        (["ppo", "--seeds", "2", "--workers", "3"], "--seeds: leave out --workers"),
        (["ppo", "--parallel", "2"], "--parallel: belongs to --seeds"),
        (["ppo", "--set", "critic=[frction]"], "critic: 'frction' is not among privileged"),
        (["sac", "--set", "learning.sde_sample_freq=4"], "sde_sample_freq: has no effect without use_sde"),
        (["ppo", "--set", "evaluation.seeds=[500, 500]"], "names something twice; it would count twice"),
        (["ppo", "--set", "environment.beside=[]"], "evaluation.beside_seeds: has no effect without"),
        (["ppo", "--set", "output.hold=0"], "output.hold"),
        (["ppo", "--set", "environment.name=nomnal"], "did you mean 'nominal'?"),
        (["ppo", "--set", "total_steps=1000"], "makes no update: the first one comes after 6400 steps"),
        (["sac", "--set", "total_steps=10000"], "makes no update: the first one comes after 10001 steps"),
        (["ppo", "--set", "inputs.stroke={middle: 0.0, half: 1.0}"], "has no quantity 'stroke'"),
    ],
)
def test_bad_input_is_one_message(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["train", *arguments]) == 2
    found = capsys.readouterr().err
    assert message in found
    assert found.startswith("sayd: error: ")
    assert not list(tmp_path.rglob("*.yaml"))


@pytest.mark.parametrize(("given", "workers"), [([], None), (["--workers", "3"], 3)])
def test_workers_make_the_evaluations(
    given: list[str], workers: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in every command; the simulator's threads are the configuration's."""
    seen: dict[str, Any] = {}

    def study(config: TrainConfig, folder: Path, **options: Any) -> None:
        seen.update(options, threads=config.environment.threads)
        raise Interrupted("seen")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sayd_env.studies.learning.train", study)
    main(["train", "ppo", *given])
    assert (seen["executor"], seen["threads"]) == (ExecutorChoice("threads", workers=workers), 1)


def test_rewards_and_last_observations_are_encoded(tmp_path: Path) -> None:
    config = load_train("ppo", [*settings("ppo", tmp_path), *PLAIN])
    env, encoding = make_learning_env(config)
    raw = SaydEnv(**environment_keywords(config), info="full")
    env.seed(3)
    np.testing.assert_allclose(env.reset()[2:4], encoding.encode(raw.reset(seed=4)[0][None]), atol=1e-6)
    period = config.environment.control_period
    for step in range(25):
        outputs = np.full((8, 1), -0.5 + 0.03 * step, np.float32)
        outputs[3] += 0.1  # the rear bogie of the second vehicle
        episode = raw.unwrapped.batch.episodes[0]
        found, rewards, dones, infos = env.step(outputs)
        commands = encoding.decode(outputs, env._seen)[1]
        middle, half = config.output.middle, config.output.half
        np.testing.assert_allclose(commands, middle + half * outputs[2:4, 0], atol=1e-6)
        seen, reward, _, truncated, _ = raw.step(commands)
        assert list(dones[2:4]) == [truncated] * 2 == [step == 24] * 2
        last = [infos[i]["terminal_observation"] for i in (2, 3)] if truncated else found[2:4]
        np.testing.assert_allclose(last, encoding.encode(seen[None]), atol=1e-6)
        # in multiples of what the reference gives at this speed and level of the track
        cost = 0.0135 * (episode.speed / 80.0) ** 2.5 * (episode.track_scale / 0.57) ** 2
        assert np.mean(rewards[2:4]) == pytest.approx(
            config.reward_scale * float(reward) / period / cost, rel=1e-5
        )


@pytest.mark.parametrize(
    ("damper", "message"),
    [("damper: passive", "needs semi-active dampers"), ("study: own.yaml", "have different dampers")],
)
def test_vehicles_that_no_command_moves_are_refused(damper: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text("base: nominal\ndamper: other.yaml\n")
    (tmp_path / "other.yaml").write_text("base: sayd\nset:\n  throttle.ratio: 50.0\n")
    beside = tmp_path / "beside.yaml"
    beside.write_text(f"{RUN_IN}{damper}\n")
    along = f"environment.beside=[{{name: {beside}, vehicles: 1, episode_s: 0.6}}]"
    with pytest.raises(ConfigError, match=message):
        make_learning_env(load_train("ppo", [*settings("ppo", tmp_path), *PLAIN, along]))


def test_paths_in_a_training_are_relative_to_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where it changes nothing but the environment; a run finds them from every directory."""
    (tmp_path / "own.yaml").write_text(RUN_IN)
    (tmp_path / "mine.yaml").write_text("base: ppo\nenvironment:\n  name: own.yaml\n")
    monkeypatch.chdir(tmp_path.parent)
    found, packaged = load_train(f"{tmp_path.name}/mine.yaml"), load_train("ppo")
    assert found.environment.name == str(tmp_path / "own.yaml")
    assert found.environment.model_copy(update={"name": packaged.environment.name}) == packaged.environment


def test_no_period_costs_more_than_the_worst(tmp_path: Path) -> None:
    config = load_train("ppo", [*settings("ppo", tmp_path), "worst_s=1e-6", "output.hold=5"])
    env, _ = make_learning_env(config)
    env.seed(3)
    env.reset()
    _, rewards, _, _ = env.step(np.zeros((8, 1), np.float32))
    per_second = config.reward_scale / config.environment.control_period
    assert rewards.min() == pytest.approx(-5 * 1e-6 * per_second, rel=1e-5)  # five periods, each at the worst


def test_a_vehicle_has_no_attributes_of_its_own(tmp_path: Path) -> None:
    env, _ = make_learning_env(load_train("ppo", settings("ppo", tmp_path)))
    env.unwrapped.set_attr("note", 1)
    assert set(env.unwrapped.get_attr("note")) == {1}
    with pytest.raises(ConfigError, match="one object"):
        env.unwrapped.set_attr("note", 2, [0])


def test_each_bogie_is_paid_for_itself(tmp_path: Path) -> None:
    config = load_train("ppo", settings("ppo", tmp_path))
    env, _ = make_learning_env(config)
    env.seed(3)
    env.reset()
    batch = env.unwrapped.parts[0].vector.batch
    _, rewards, _, _ = env.step(np.zeros((8, 1), np.float32))
    terms, cost = batch.vehicles.terms, batch.scenario.cost
    own = cost.acceleration_weight * terms[:, COST_ACCELERATION:][:, :2]
    own = own + cost.force_weight * terms[:, COST_FORCE:][:, :2]
    paid = -rewards.reshape(4, 2).astype(np.float64)
    factor = paid.sum(axis=1) / own.sum(axis=1)  # of a vehicle's episode
    assert np.all(np.abs(own[:, 0] / own[:, 1] - 1.0) > 0.1)
    # Both are made of their mean, which the environment gives as float32: a calm bogie beside a restless one
    # is paid right to a rounding of that mean.
    rounding = np.finfo(np.float32).eps * paid.mean(axis=1) / factor
    assert np.max(np.abs(paid / factor[:, None] - own) / rounding[:, None]) < 2.0


def test_vehicles_on_lines_learn_and_are_judged_along(tmp_path: Path) -> None:
    line = tmp_path / "line_quick.yaml"
    line.write_text("base: training-line\nrun_in: 20.0\n")
    along = [f"environment.beside=[{{name: {line}, vehicles: 2, episode_s: 0.6}}]", "output.hold=5"]
    more = [*along, "evaluation.beside_seeds=[510]", "learning.n_steps=8", "learning.batch_size=16"]
    config = load_train("ppo", [*settings("ppo", tmp_path), *more, "total_steps=400"])
    assert (config.networks, config.decision_period) == (12, 0.1)
    judged: list[tuple[int, float]] = []

    def stop_rule(steps: int, cost: float) -> bool:
        judged.append((steps, cost))
        return len(judged) == 2

    found = train(config, tmp_path / "run", stop_rule=stop_rule)
    assert found.steps == 2 * 96 + 12  # stopped by the first step after the second evaluation
    assert len(found.evaluations) == 2
    costs = [value for name, value in found.evaluations[0].items() if "seed" in name]
    assert "J_line_quick_seed_510" in found.evaluations[0]
    assert len(costs) == 3
    assert found.evaluations[0]["J_geometric"] == pytest.approx(np.prod(costs) ** (1.0 / 3.0))
    assert [cost for _, cost in judged] == [row["J_geometric"] for row in found.evaluations[:2]]
    log = Table(tmp_path / "run" / "progress.csv").rows
    assert any("estimate/conicity" in row for row in log)


def test_a_finished_run_can_be_prolonged(trained: Trained, tmp_path: Path) -> None:
    config = trained.config.model_copy(update={"total_steps": trained.steps + 64})
    folder = tmp_path / "run"
    shutil.copytree(trained.folder, folder)
    before = Table(folder / "evaluations.csv").rows
    longer = train(config, folder, resume=True)
    assert longer.steps >= trained.steps + 64
    assert longer.evaluations[: len(before)] == before
    assert longer.references == trained.references
    assert longer.best <= trained.best
    assert len(yaml.safe_load((folder / "run.yaml").read_text())["starts"]) == 2


@pytest.mark.parametrize("trained", ["ppo"], indirect=True)
def test_what_a_resumed_run_may_not_change(trained: Trained, tmp_path: Path) -> None:
    changed = trained.config.model_copy(update={"seed": 4, "discount_s": 1.5})
    with pytest.raises(ConfigError, match=r"discount_s: the run has \d.\d, found 1.5; seed: the run has 0"):
        train(changed, trained.folder, resume=True)
    with pytest.raises(ConfigError, match="holds no run"):
        train(trained.config, tmp_path, resume=True)
    with pytest.raises(ConfigError, match="is not empty"):
        train(trained.config, trained.folder)
    Path(trained.config.environment.name).write_text(RUN_IN + "termination_cost: 3.0\n")
    try:
        with pytest.raises(ConfigError, match="another one than when the run began"):
            train(trained.config, trained.folder, resume=True)
    finally:
        Path(trained.config.environment.name).write_text(RUN_IN)


@pytest.mark.parametrize("trained", ["ppo"], indirect=True)
def test_a_damaged_record_of_the_run_is_refused(trained: Trained, tmp_path: Path) -> None:
    for name in ("config.yaml", "run.yaml"):
        shutil.copy(trained.folder / name, tmp_path / name)
    for content in (b"", b"starts: [", b"- 1", b"\xff\xfe"):
        (tmp_path / "run.yaml").write_bytes(content)
        with pytest.raises((ConfigError, DataError), match=r"run.yaml"):
            train(trained.config, tmp_path, resume=True)


def test_a_damaged_checkpoint_is_refused(trained: Trained, tmp_path: Path) -> None:
    env, _ = make_learning_env(trained.config)
    newest = max((trained.folder / "checkpoints").iterdir())
    for file in newest.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes()[:-40])
    with pytest.raises(DataError, match="damaged"):
        load_model(tmp_path, make_model(trained.config, env))


@pytest.mark.parametrize("trained", ["ppo"], indirect=True)
def test_two_trainings_in_one_folder_and_damaged_files_are_refused(trained: Trained, tmp_path: Path) -> None:
    config, folder = trained.config, tmp_path / "run"
    with reserved(folder, "trains"), pytest.raises(ConfigError, match="another process trains here"):
        train(config, folder)
    assert list(folder.iterdir()) == []
    shutil.copytree(trained.folder, folder, dirs_exist_ok=True)
    before = (folder / "run.yaml").read_bytes()
    for name, content, message in (
        ("run.yaml", b"starts: [1]", "run.yaml: is damaged; expected the starts of the run"),
        ("evaluations.csv", b"steps,J\n0,x\n", "evaluations.csv: line 2: is damaged"),
        ("progress.csv", b"\0", "progress.csv: line 1: is damaged"),
        ("references.csv", b"policy\nmppt2\n", "references.csv: line 1: is damaged"),
        ("best.npz", b"PK", "best.npz: is damaged or no policy"),
        ("best.npz", (folder / "last.npz").read_bytes(), "best.npz: made.judged: found None; expected J"),
    ):
        good = (folder / name).read_bytes()
        (folder / name).write_bytes(content)
        with pytest.raises(DataError, match=message):
            train(config, folder, resume=True)
        (folder / name).write_bytes(good)
    assert (folder / "run.yaml").read_bytes() == before


def test_ctrl_c_saves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_train("sac", [*settings("sac", tmp_path), "checkpoint.every=100000"])

    def interrupt(done: float, total: float, what: str) -> None:
        if done > 60:
            raise KeyboardInterrupt

    monkeypatch.setattr("sayd_env.agents.training.REPORT_SECONDS", 0.0)
    with pytest.raises(Interrupted, match="saved at step 56 of 200; go on with --resume"):
        train(config, tmp_path / "run", progress=interrupt)
    assert steps_on_disk(tmp_path / "run")[-1] == 56
    assert train(config, tmp_path / "run", resume=True).steps == 200


def test_an_update_is_not_interrupted_halfway(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept at a step would be half of its update; whoever goes on would update again on top."""
    config = load_train("ppo", [*settings("ppo", tmp_path), *PLAIN])
    update, ends = PPO.train, list[int]()

    def interrupted(model: PPO) -> None:
        signal.raise_signal(signal.SIGINT)
        update(model)
        ends.append(model.num_timesteps)

    monkeypatch.setattr(PPO, "train", interrupted)
    with pytest.raises(Interrupted, match="saved at step"):
        train(config, tmp_path / "run")
    assert len(ends) == 1


def test_a_run_that_was_killed_goes_on_from_its_best_policy(tmp_path: Path) -> None:
    """The rows behind the last checkpoint go, so the best policy must not lie behind it."""
    config = load_train("sac", [*settings("sac", tmp_path), "checkpoint.every=1000", "evaluation.every=40"])
    costs = iter([9.0] * len(config.evaluation.references) + [0.03, 0.02, 0.025])

    class Kill(BaseException):
        """As a signal that nobody can catch."""

    def evaluated(_: Any) -> Any:
        cost = next(costs, None)
        if cost is None:
            raise Kill
        return np.full(_scenarios(config), cost)

    with pytest.raises(Kill):
        learn(config, tmp_path / "run", evaluated)
    trained = learn(config, tmp_path / "run", lambda _: np.full(_scenarios(config), 0.04), resume=True)
    made = read_policy(tmp_path / "run" / "best.npz").description.made
    assert made["judged"] == trained.best == pytest.approx(0.02)
    (best,) = [row for row in trained.evaluations if row["J"] == pytest.approx(0.02)]
    assert best["steps"] == made["steps"]


def _scenarios(config: TrainConfig) -> int:
    return len(config.evaluation.cases)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """A training that nothing interrupts."""
    folder = tmp_path_factory.mktemp("whole")
    return train(load_train("sac", settings("sac", folder)), folder / "run")


@pytest.mark.parametrize("which", [1, 2], ids=["in the middle", "the last"])
def test_an_evaluation_that_was_interrupted_is_made_again(
    which: int, whole: Trained, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = [row["steps"] for row in whole.evaluations]
    evaluate = _Run.evaluate

    def interrupt(run: _Run) -> None:
        if run.steps == steps[which]:
            raise KeyboardInterrupt
        evaluate(run)

    with monkeypatch.context() as patch:
        patch.setattr(_Run, "evaluate", interrupt)
        with pytest.raises(Interrupted, match=f"saved at step {steps[which]:g} of 200"):
            train(whole.config, tmp_path / "run")
    again = train(whole.config, tmp_path / "run", resume=True).evaluations
    assert [row["steps"] for row in again] == steps


def test_a_full_disk_leaves_the_last_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_train("sac", settings("sac", tmp_path))
    train(config.model_copy(update={"total_steps": 100}), tmp_path / "run")
    kept = steps_on_disk(tmp_path / "run")

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("sayd_env.agents.learner.np.savez", full)
        with pytest.raises(StudyError, match="No space left"):
            train(config, tmp_path / "run", resume=True)
    assert steps_on_disk(tmp_path / "run") == kept
    assert train(config, tmp_path / "run", resume=True).steps == 200


def test_no_return_reaches_from_before_a_resume_into_the_episodes_after_it(tmp_path: Path) -> None:
    """Of three steps: rewards of 1 before and of 100 after give 3, 2, 1 at the last rows and no 102."""

    def buffer() -> Any:
        box = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
        return NStepReplayBuffer(20, box, box, n_envs=1, n_steps=3, gamma=1.0)

    def fill(found: Any, reward: float) -> None:
        one = np.zeros((1, 1), np.float32)
        for _ in range(5):
            found.add(one, one, one, np.array([reward]), np.array([False]), [{}])

    before, after = buffer(), buffer()
    fill(before, 1.0)
    learner._save_replay(tmp_path / "replay.npz", before)
    learner._load_replay(tmp_path / "replay.npz", after)
    fill(after, 100.0)
    returns = after._get_samples(np.arange(8)).rewards.ravel()
    assert returns.tolist() == [3.0, 3.0, 3.0, 2.0, 1.0, 300.0, 300.0, 300.0]


def test_a_killed_run_goes_on_from_its_last_checkpoint(tmp_path: Path) -> None:
    given = settings("sac", tmp_path)
    command = [sys.executable, "-m", "sayd_env", "train", "sac", "--out", "run"]
    long = [*given, "total_steps=20000", "checkpoint.every=40", "evaluation.every=100000"]
    command += [part for item in long for part in ("--set", item)]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=dict(os.environ)
    )
    folder = tmp_path / "run"
    while not list(folder.glob("checkpoints/0*")) or steps_on_disk_quietly(folder)[-1] < 200:
        assert process.poll() is None, "the run ended by itself"
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    # Whatever it was about to write when it was killed: what counts is whole.
    machine = re.sub(r"\W", "_", platform.node())
    half = folder / "checkpoints" / f".000000000999.{machine}.{2**22 + 1}.tmp"  # of no process
    half.mkdir()
    (half / "state.pt").write_bytes(b"half")
    newest = max(path for path in (folder / "checkpoints").iterdir() if path.name.startswith("0"))
    config = load_train(str(folder / "config.yaml"))
    model = make_model(config, make_learning_env(config)[0])
    stand = load_model(newest, model)
    assert stand.steps == int(newest.name) >= 200
    assert stand.updates > 0
    # The buffer of 20 steps of 8 bogies has been filled.
    assert model.replay_buffer.size() == 20
    assert np.abs(model.replay_buffer.rewards).min() > 0.0
    longer = config.model_copy(update={"total_steps": stand.steps + 40})
    result = train(longer, folder, resume=True)
    assert result.steps == stand.steps + 40
    assert result.evaluations[0]["steps"] == 0
    assert not list(folder.glob("checkpoints/.*"))
    starts = yaml.safe_load((folder / "run.yaml").read_text())["starts"]
    assert [start["step"] for start in starts] == [0, stand.steps]


def steps_on_disk_quietly(folder: Path) -> list[int]:
    """Finished checkpoints while a run is writing others."""
    return sorted(int(path.name) for path in (folder / "checkpoints").glob("0*")) or [0]
