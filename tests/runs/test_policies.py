"""Policies of every kind, wherever a policy is named: controllers, files, models, code of one's own."""

from __future__ import annotations

import json
import os
import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sayd_env
from sayd_env import baselines
from sayd_env.cli import main
from sayd_env.config import ConfigError, DataError
from sayd_env.config.environment import load_environment
from sayd_env.envs.interface import RunIn
from sayd_env.envs.single import SaydEnv
from sayd_env.runs.policies import PolicySpec, policy_spec, policy_specs

MINE = """
import numpy as np
import {helper}

class Steady:
    def __init__(self, command, count):
        self.command, self.count = command, count

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        shape = (*np.shape(observation)[:-1], self.count)
        return np.full(shape, self.command, np.float32), state

def make(interface):
    return Steady({helper}.COMMAND, interface.actions)

def slow(interface):
    return make(interface)

slow.environment = {{"control_period": 0.05, "valves": "vehicle"}}

def broken(interface):
    values = []
    return values[3]

def empty(interface):
    return None

def odd(interface):
    return Steady(1.5, interface.actions)

def few(interface):
    return Steady(0.5, interface.actions + 1)

class Late:
    def predict(self, *arguments, **keywords):
        raise RuntimeError("no\\nidea")

def late(interface):
    return Late()

class Forgetful(Steady):
    def __init__(self, interface):
        super().__init__(0.5, interface.actions)

    def state_after(self, run_in):
        return run_in.observation

def bare():
    return None

class Short:
    def __init__(self, interface): pass
    def predict(self, observation): return observation, None
"""


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A file of factories that imports a file beside it."""
    (tmp_path / "own_helper.py").write_text("COMMAND = 0.3\n")
    path = tmp_path / "mine.py"
    path.write_text(MINE.format(helper="own_helper"))
    return path


def test_code_of_one_s_own_acts(mine: Path) -> None:
    env = SaydEnv()
    spec = policy_spec(f"{mine}:make")
    assert spec.title == "mine:make"
    policy = spec.make(env)
    observation, _ = env.reset(seed=0)
    action, state = policy.predict(observation, None, None, deterministic=True)
    assert state is None
    np.testing.assert_array_equal(action, np.float32([0.3, 0.3]))
    np.testing.assert_array_equal(
        policy.predict(np.stack([observation] * 3))[0], np.full((3, 2), np.float32(0.3))
    )
    np.testing.assert_array_equal(baselines.make(f"{mine}:make", env).predict(observation)[0], action)


def test_factories_of_one_file_are_different_policies(mine: Path) -> None:
    names = ("make", "odd", "few")
    assert len({repr(policy_spec(f"{mine}:{name}").identity()) for name in names}) == len(names)


def test_a_factory_brings_its_environment(mine: Path) -> None:
    spec = policy_spec(f"{mine}:slow")
    config = spec.environment(load_environment())
    assert (config.control_period, config.valves) == (0.05, "vehicle")
    with pytest.raises(
        ConfigError, match=r"needs control_period=0.05, the environment has 0.01; make it with"
    ):
        spec.make(SaydEnv())
    policy = sayd_env.load_policy(f"{mine}:slow", "SAYD/Nominal-v1")
    env = gym.make("SAYD/Nominal-v1", **policy.interface.keywords)
    assert policy.predict(env.reset(seed=0)[0])[0].shape == env.action_space.shape == (1,)


@pytest.mark.parametrize(
    ("factory", "message"),
    [
        ("broken", r"mine.py:broken: .*mine.py, line 23: IndexError: list index out of range"),
        ("empty", r"mine.py:empty: returned None; expected an object with a method predict"),
        ("odd", r"mine.py:odd: action: found 1.5 at \[0, 0\]"),
        ("few", r"mine.py:few: action: found shape \(2, 3\); expected \(2, 2\)"),
        ("late", r"mine.py:late: .*mine.py, line 36: RuntimeError: no idea"),
        ("none", r"mine.py:none: has no function 'none'"),
        ("bare", r"mine.py:bare: TypeError: bare\(\) takes 0 .* given; expected a function of one argument"),
        ("Short", r"mine.py:Short: TypeError: .*; expected predict\(observation, state, episode_start"),
    ],
)
def test_code_that_fails_is_reported_in_one_message(factory: str, message: str, mine: Path) -> None:
    env = SaydEnv()
    with pytest.raises(ConfigError, match=message) as caught:
        policy_spec(f"{mine}:{factory}").make(env).predict(np.zeros((2, 41), np.float32))
    assert "\n" not in str(caught.value)


def test_a_run_in_that_the_code_cannot_take_is_reported_in_one_message(mine: Path) -> None:
    policy = policy_spec(f"{mine}:Forgetful").make(SaydEnv())
    run_in = RunIn(np.zeros((3, 1, 41), np.float32), np.zeros(1, dtype=np.int64))
    with pytest.raises(ConfigError, match=r"mine.py:Forgetful: .*mine.py, line \d+: AttributeError: .*RunIn"):
        policy.state_after(run_in)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (None, "policy: found None; expected a name"),
        ("mine.py", "'mine.py': names no factory; expected mine.py:FACTORY"),
        ("mine.py:", "'mine.py:': names no factory; expected mine.py:FACTORY"),
        ("3", "'3': a number alone; commas part policies, not decimals"),
    ],
)
def test_what_names_no_policy_is_told_apart(given: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        policy_spec(given)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def make(:\n", r"bad.py, line 1: SyntaxError"),
        ("import nothing_of_this_name\n", r"bad.py, line 1: ModuleNotFoundError"),
        ("raise SystemExit(3)\n", r"bad.py, line 1: SystemExit: 3"),
        ("def make(i): ...\nmake.environment = {'speed': 3}\n", "environment: found .*expected keywords"),
    ],
)
def test_code_that_cannot_be_loaded_is_reported(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        policy_spec(f"{path}:make")
    with pytest.raises(ConfigError, match=r"nothing.py: no such file"):
        policy_spec(f"{tmp_path}/nothing.py:make")
    with pytest.raises(ConfigError, match=r"nothing.here: no such module"):
        policy_spec("nothing.here:make")


def test_what_is_no_file_of_code_is_refused_before_it_is_read(tmp_path: Path) -> None:
    (tmp_path / "loop.py").symlink_to("loop.py")
    os.mkfifo(tmp_path / "pipe.py")
    with (tmp_path / "large.py").open("wb") as stream:
        stream.truncate(2**40)
    for name, message in (("loop", "no such file"), ("pipe", "no such file"), ("large", "larger than 2 MiB")):
        with pytest.raises(ConfigError, match=message):
            policy_spec(f"{tmp_path / name}.py:make")


def test_an_edit_counts_and_is_loaded(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the file, in what it imports or names, in a package; not in a file beside it that it ignores."""
    seen = np.zeros(41, np.float32)

    def look(text: str) -> tuple[Any, float]:
        spec = policy_spec(text)
        return spec.identity(), float(spec.make(SaydEnv()).predict(seen)[0][0])

    first = look(f"{mine}:make")
    assert look(f"{mine}:make") == first
    (mine.parent / "other.py").write_text("COMMAND = 0.9\n")
    assert look(f"{mine}:make") == first
    spec = policy_spec(f"{mine}:make")
    (mine.parent / "own_helper.py").write_text("COMMAND = 0.75\n")
    with pytest.raises(ConfigError, match="has changed since"):
        spec.make(SaydEnv())
    second = look(f"{mine}:make")
    assert second[0] != first[0]
    assert second[1] == 0.75
    mine.write_text(mine.read_text() + "\nWEIGHTS = 'weights.txt'\n")
    third = look(f"{mine}:make")
    (mine.parent / "weights.txt").write_text("1")
    fourth = look(f"{mine}:make")
    (mine.parent / "weights.txt").write_text("2")
    assert len({str(each[0]) for each in (first, second, third, fourth, look(f"{mine}:make"))}) == 5
    package = mine.parent / "own_package"
    (package / "deep").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "deep" / "__init__.py").write_text("COMMAND = 0.25\n")
    (package / "factories.py").write_text(MINE.format(helper="own_package.deep"))
    monkeypatch.chdir(mine.parent)
    before = look("own_package.factories:make")
    assert before[1] == 0.25
    (package / "deep" / "__init__.py").write_text("COMMAND = 0.125\n")
    after = look("own_package.factories:make")
    assert after[1] == 0.125
    assert after[0] != before[0]


def act(spec: PolicySpec) -> list[float]:
    """What a policy commands in another process."""
    return [float(each) for each in spec.make(SaydEnv(**spec.needs)).predict(np.zeros(41, np.float32))[0]]


def test_code_acts_in_other_processes(mine: Path) -> None:
    spec = policy_spec(f"{mine}:make")
    assert len(pickle.dumps(spec)) < 1000
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        assert executor.submit(act, spec).result() == act(spec)


@pytest.mark.usefixtures("ready")
def test_learned_policies_travel_light() -> None:
    assert len(pickle.dumps(policy_spec("ppo"))) < 100_000


@pytest.mark.usefixtures("ready")
def test_a_ready_policy_is_loaded_by_its_name() -> None:
    policy = sayd_env.load_policy("ppo")
    assert policy.name == "ppo-s0"
    env = gym.make("SAYD/Nominal-v1", **policy.interface.keywords)
    observation, _ = env.reset(seed=0)
    action, _ = policy.predict(observation)
    same, _ = baselines.make("ppo", env).predict(observation)
    np.testing.assert_array_equal(action, same)
    with pytest.raises(
        ConfigError, match=r"needs observation='history', the environment has 'signals'; make it with"
    ):
        baselines.make("ppo", gym.make("SAYD/Nominal-v1"))
    assert baselines.make("passive", "SAYD/Nominal-v1").interface.keywords["damper"] == "passive"


def test_titles_differ(tmp_path: Path, ready: Path) -> None:
    source, other = (ready / "ppo-s0.npz").read_bytes(), ready / "ppo-s1.npz"
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mppt2.yaml").write_text("")
    (tmp_path / "one" / "x.npz").write_bytes(source)
    stored = policy_spec(str(other)).learned
    assert stored is not None
    from sayd_env.agents.policy_file import StoredPolicy, save_policy  # noqa: PLC0415

    renamed = stored.description.model_copy(update={"name": "ppo-s0"})
    save_policy(tmp_path / "two" / "x.npz", StoredPolicy(renamed, stored.layers))
    found = policy_specs([str(tmp_path / "one" / "x.npz"), str(tmp_path / "two" / "x.npz"), "passive"])
    assert [spec.title for spec in found] == ["ppo-s0", "ppo-s0@two", "passive"]
    with pytest.raises(ConfigError, match="'ppo-s0': duplicate"):
        policy_specs(["ppo-s0", str(tmp_path / "one" / "x.npz")])


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory, ready: Path) -> Path:
    """A ready policy as an ONNX model."""
    pytest.importorskip("onnx", reason="needs the extra 'onnx'")
    pytest.importorskip("onnxruntime", reason="needs the extra 'onnx'")
    folder = tmp_path_factory.mktemp("onnx")
    assert main(["export", "ppo-s1", "--onnx", "--out", str(folder)]) == 0
    return folder / "ppo-s1.onnx"


def test_an_exported_model_acts_as_its_policy(exported: Path) -> None:
    spec = policy_spec(str(exported))
    assert (spec.title, dict(spec.needs)) == ("ppo-s1", dict(policy_spec("ppo-s1").needs))
    with pytest.raises(ConfigError, match="needs observation='history'"):
        spec.make(SaydEnv())
    model, policy = (sayd_env.load_policy(name, "SAYD/Nominal-v1") for name in (str(exported), "ppo-s1"))
    interface = model.interface
    low, high = (np.array([getattr(signal, end) for signal in interface.signals]) for end in ("low", "high"))
    seen = np.float32(low + np.random.default_rng(0).random((7, *interface.shape)) * (high - low))
    found, _ = model.predict(seen)
    np.testing.assert_allclose(found, policy.predict(seen)[0], atol=1e-6)
    for i in range(7):  # the same bits alone
        np.testing.assert_array_equal(model.predict(seen[i])[0], found[i])


def test_models_of_others_are_checked_by_their_shapes(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx", reason="needs the extra 'onnx'")
    pytest.importorskip("onnxruntime", reason="needs the extra 'onnx'")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    path = tmp_path / "foreign.onnx"

    def save(width: int, bias: float, count: int = 2) -> None:
        weight = onnx.numpy_helper.from_array(np.zeros((width, count), np.float32), "w")
        offset = onnx.numpy_helper.from_array(np.full(count, bias, np.float32), "b")
        nodes = [helper.make_node("Gemm", ["x", "w", "b"], ["y"])]
        graph = helper.make_graph(
            nodes,
            "foreign",
            [helper.make_tensor_value_info("x", kind, ["batch", width])],
            [helper.make_tensor_value_info("y", kind, ["batch", count])],
            [weight, offset],
        )
        opset = [helper.make_opsetid("", 17)]
        path.write_bytes(helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString())

    env = SaydEnv()
    save(41, 0.25)
    np.testing.assert_array_equal(
        policy_spec(str(path)).make(env).predict(np.zeros((3, 41)))[0], np.full((3, 2), 0.25)
    )
    save(31, 0.25)
    with pytest.raises(
        ConfigError, match=r"foreign.onnx: takes .*31.*'signals' is float32 of shape \(N, 41\)"
    ):
        policy_spec(str(path)).make(env)
    save(41, 1.25)
    with pytest.raises(ConfigError, match=r"foreign.onnx: action: found 1.25"):
        policy_spec(str(path)).make(env).predict(np.zeros(41))
    save(41, 0.5, 8)
    with pytest.raises(ConfigError, match=r"foreign.onnx: action: found shape \(1, 8\)"):
        policy_spec(str(path)).make(env).predict(np.zeros(41))
    path.write_bytes(b"no model")
    with pytest.raises(DataError, match=r"foreign.onnx: is no ONNX model"):
        policy_spec(str(path))


def test_every_kind_is_evaluated_alike(
    mine: Path, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A constant command by name and by code of one's own, a network by weights and as a model."""
    names = ["constant:0.3", f"{mine}:make", "ppo-s1", str(exported)]
    short = ["--set", "assessment.length=600", "--speeds", "300", "--seeds", "1", "--wear", "1"]
    code = main(["evaluate", "--policies", ",".join(names), *short, "--json", "--out", str(tmp_path / "out")])
    assert code == 0
    rows = {row["policy"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    *given, last = rows
    assert given == ["constant:0.3", "mine:make", "ppo-s1"]
    assert last.startswith("ppo-s1@")
    constant, own, weights, model = rows.values()
    assert own["J"] == pytest.approx(constant["J"], rel=1e-6)  # 0.3 in single precision
    assert model["J"] == pytest.approx(weights["J"], rel=1e-3)
