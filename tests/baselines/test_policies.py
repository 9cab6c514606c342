"""What all controllers share: `make`, the `predict` protocol, vehicles, and what they refuse."""

from __future__ import annotations

import pickle
import re
from importlib import resources
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
import yaml

from sayd_env import baselines
from sayd_env.config import ConfigError
from sayd_env.config.damper import PassiveDamperConfig

CONTROLLERS = [name for name in baselines.NAMES if name != "passive"]
PASSIVE = PassiveDamperConfig(
    type="passive", name="p", curve=((0.0, 0.0), (0.1, 1e4), (1.0, 2e4)), series_stiffness=5e6
)
KINDS = [name for name in CONTROLLERS if not name.endswith(("-tuned", "-estimate"))]
"""The others are of the same classes, with other numbers."""
BOGIE_CONTROLLERS = [name for name in KINDS if not name.startswith(("constant", "speed-schedule"))]
OBSERVATIONS = [
    (name, kind)
    for name in KINDS
    for kind in ("signals", "history", "features")
    if not (kind == "features" and name.startswith(("skyhook", "lqg")))
]


def ride(interface, steps, vehicles, seed=0):
    """Observations (steps, vehicles, obs) of about the right size, speeds from 30 to 110 m/s."""
    generator = np.random.default_rng(seed)
    values = generator.normal(size=(steps, vehicles, len(interface.signals)))
    for column, signal in enumerate(interface.signals):
        kind = signal.name.partition(".")[0]
        size = {"pressure_a": 1e6, "pressure_b": 1e6, "stroke": 1e-3, "force_rms": 5e3}.get(kind, 1.0)
        values[:, :, column] *= size
        if kind in ("acceleration_rms", "force_rms"):
            values[:, :, column] = np.abs(values[:, :, column])
        if kind in ("current", "command"):
            values[:, :, column] = 0.4
        if kind == "speed":
            values[:, :, column] = np.linspace(30.0, 110.0, vehicles)
    if interface.observation == "history":
        values = np.repeat(values[:, :, None], interface.history, axis=2)
        values[:, :, :-1] = 1e3  # the past, which the policy has seen
    return values.astype(np.float32)


def commands_of(policy, observations, starts=None):
    state, commands = None, []
    for step, observation in enumerate(observations):
        action, state = policy.predict(observation, state, None if starts is None else starts[step])
        commands.append(action)
    return np.array(commands)


@pytest.mark.parametrize(("name", "kind"), OBSERVATIONS)
def test_many_vehicles_equal_single_ones(interface, name, kind):
    policy = baselines.make(name, interface(observation=kind))
    observations = ride(policy.interface, 620, 3)
    together = commands_of(policy, observations)
    assert together.shape == (620, 3, 2)
    assert together.dtype == np.float32
    assert np.all((together >= 0.0) & (together <= 1.0))
    for vehicle in range(3):
        alone = commands_of(policy, observations[:, vehicle])
        assert np.array_equal(alone, together[:, vehicle])


@pytest.mark.parametrize(("name", "kind"), OBSERVATIONS)
def test_episode_start_starts_a_vehicle_afresh(interface, name, kind):
    policy = baselines.make(name, interface(observation=kind))
    first, second = ride(policy.interface, 1500, 3, seed=1), ride(policy.interface, 1300, 3, seed=2)
    second[..., -1] = np.linspace(110.0, 30.0, 3)[(None, slice(None)) + (None,) * (second.ndim - 3)]
    observations = first.copy()
    starts = np.zeros((1500, 3), dtype=bool)
    starts[0] = True
    starts[150, 1] = starts[733, 2] = True
    observations[150:1450, 1] = second[:, 1]
    observations[733:, 2] = second[:767, 2]
    commands = commands_of(policy, observations, starts)
    assert np.array_equal(commands[:, 0], commands_of(policy, first[:, 0]))
    assert np.array_equal(commands[150:1450, 1], commands_of(policy, second[:, 1]))
    assert np.array_equal(commands[733:, 2], commands_of(policy, second[:767, 2]))


@pytest.mark.parametrize("name", BOGIE_CONTROLLERS)
def test_a_history_is_read_at_its_newest_row(interface, name):
    signals = baselines.make(name, interface())
    history = baselines.make(name, interface(observation="history"))
    observations = ride(signals.interface, 250, 2)
    past = np.repeat(observations[:, :, None], 4, axis=2)
    assert np.array_equal(commands_of(signals, observations), commands_of(history, past))


@pytest.mark.parametrize("name", BOGIE_CONTROLLERS)
def test_valves_of_their_own_get_their_bogie_s_command(interface, name):
    observations = ride(interface(), 350, 2)
    bogie = commands_of(baselines.make(name, interface()), observations)
    damper = commands_of(baselines.make(name, interface(valves="damper")), observations)
    assert np.array_equal(damper, np.repeat(bogie, 4, axis=2))
    with pytest.raises(ConfigError, match="controls each bogie separately, but valves='vehicle'"):
        baselines.make(name, interface(valves="vehicle"))


@pytest.mark.parametrize(("valves", "count"), [("bogie", 2), ("damper", 8), ("vehicle", 1)])
@pytest.mark.parametrize("kind", ["signals", "history", "features"])
def test_constant_and_passive_fit_every_environment(interface, valves, count, kind):
    constant = baselines.make("constant", interface(observation=kind, valves=valves), current=0.25)
    action, state = constant.predict(np.zeros((5, *constant.interface.shape)))
    assert np.array_equal(action, np.full((5, count), 0.25, dtype=np.float32))
    assert constant.predict(np.zeros((5, *constant.interface.shape)), state)[0].shape == (5, count)
    passive = baselines.make("passive", interface(observation=kind, valves=valves, damper=PASSIVE))
    assert np.array_equal(passive.predict(np.zeros(passive.interface.shape))[0], np.zeros(count))


def test_the_tuned_constant_commands_its_number(interface):
    """The number that stands in its file, whatever the vehicle does."""
    text = (
        resources.files("sayd_env.configs")
        .joinpath("control", "constant-tuned.yaml")
        .read_text(encoding="utf-8")
    )
    number = yaml.safe_load(text)["current"]
    assert 0.0 < number < 1.0
    policy = baselines.make("constant-tuned", interface())
    commands = commands_of(policy, ride(policy.interface, 250, 3))
    assert np.array_equal(commands, np.full((250, 3, 2), number, dtype=np.float32))


def test_a_file_of_parameters_stands_for_its_controller(interface, tmp_path):
    """Named after mppt2, with its text but for k_J: as mppt2 with this k_J."""
    text = resources.files("sayd_env.configs").joinpath("control", "mppt2.yaml").read_text(encoding="utf-8")
    file = tmp_path / "mppt2.yaml"
    file.write_text(re.sub(r"k_J: [\d.]+", "k_J: 0.2", text))
    own, packaged = baselines.make(str(file), interface()), baselines.make("mppt2", interface(), k_J=0.2)
    assert (own.name, own.parameters) == ("mppt2", packaged.parameters)
    other = tmp_path / "mine.yaml"
    other.write_text(text)
    with pytest.raises(ConfigError, match=r"mine\.yaml: a file is named after its controller; unknown"):
        baselines.make(str(other), interface())
    with pytest.raises(ConfigError, match=r"mppt1\.yaml: no such file"):
        baselines.make(str(tmp_path / "mppt1.yaml"), interface())


@pytest.mark.parametrize(
    ("name", "changes", "parameters", "message"),
    [
        ("passive", {}, {}, "needs passive dampers, .* make it with damper='passive'"),
        ("passive", {"damper": PASSIVE}, {"k": 1.0}, "'passive': has no parameters, found k"),
        ("mppt2", {"damper": PASSIVE}, {}, r"mppt2: weighs the force .* damper='sayd'"),
        ("skyhook-continuous", {"damper": PASSIVE}, {}, "characteristic of semi-active dampers"),
        ("lqg", {"damper": PASSIVE}, {}, "lqg: needs the characteristic of semi-active dampers"),
        ("lqg", {"observation": "features"}, {}, "lqg: .* has no signal 'lateral_acceleration.front"),
        ("lqg", {}, {"speeds_kmh": (200.0, 100.0)}, "speeds_kmh must rise"),
        (
            "skyhook-onoff",
            {"observation": "features"},
            {},
            "skyhook-onoff: .* has no signal 'longitudinal_acceleration.front",
        ),
        ("mppt1", {"control_period": 0.05}, {}, "50 ms is too long .* use observation='features'"),
        (
            "mppt1",
            {},
            {"treshold_max": 1.0},
            "'mppt1': unknown key 'treshold_max', did you mean 'threshold_max'",
        ),
        (
            "mppt1",
            {},
            {"k_J": -0.1},
            "'mppt1': k_J: found -0.1; expected a number greater than or equal to 0",
        ),
        ("mppt1", {}, {"k_J": float("nan")}, "'mppt1': k_J: found nan; expected"),
        ("mppt1", {}, {"threshold_min": 2.0, "threshold_max": 1.0}, "threshold_min 2 m/s2 must not exceed"),
        ("mppt2", {}, {"damper": "upper"}, "'mppt2': damper: found 'upper'; expected 'left.upper'"),
        ("skyhook-onoff", {}, {"closed": 0.5, "open": 0.4}, "closed 0.5 must be below open 0.4"),
        (
            "constant",
            {},
            {"current": 1.5},
            "'constant': current: found 1.5; expected a number less than or equal",
        ),
        ("constant", {}, {"current": True}, "'constant': current: found True; expected a number"),
        (
            "mppt",
            {},
            {},
            "policy 'mppt': unknown, did you mean 'mppt[12]'.*expected passive, constant, mppt1",
        ),
        ("online", {}, {}, "policy 'online': unknown"),
        ("mppt:0.3", {}, {}, "policy 'mppt:0.3': unknown, did you mean"),
        ("mppt1:0.3", {}, {}, "policy 'mppt1:0.3': only 'constant' takes a value"),
        ("constant:1.3", {}, {}, "policy 'constant:1.3': expected a valve command from 0 to 1"),
        ("constant:", {}, {}, "policy 'constant:': expected a valve command from 0 to 1"),
        ("constant:0.3", {}, {"current": 0.4}, "current is given after the colon and as a parameter"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_message(interface, name, changes, parameters, message):
    with pytest.raises(ConfigError, match=message) as raised:
        baselines.make(name, interface(**changes), **parameters)
    assert "\n" not in str(raised.value)


def test_the_short_form_of_a_constant_command(interface):
    short, long = (
        baselines.make("constant:0.3", interface()),
        baselines.make("constant", interface(), current=0.3),
    )
    assert (short.name, short.parameters) == (long.name, long.parameters)
    assert short.predict(np.zeros(short.interface.shape))[0] == pytest.approx(0.3)


def test_features_serve_where_the_control_period_is_too_long(interface):
    policy = baselines.make("mppt1", interface(observation="features", control_period=0.05))
    assert policy.predict(np.zeros(policy.interface.shape))[0].shape == (2,)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_shapes_that_do_not_fit_are_refused(interface, name):
    policy = baselines.make(name, interface())
    good = ride(policy.interface, 1, 3)[0]
    for bad in (good[:, :-1], good[0, :-1], good[None], np.float32(1.0)):
        with pytest.raises(ConfigError, match="found an observation of shape"):
            policy.predict(bad)
    _, state = policy.predict(good)
    with pytest.raises(ConfigError, match="the state is that of 3 vehicles, the observation that of 2"):
        policy.predict(good[:2], state)
    with pytest.raises(ConfigError, match="found episode_start of shape"):
        policy.predict(good, state, episode_start=[True])
    with pytest.raises(ConfigError, match=r"state: found .*; expected what the last call returned"):
        policy.predict(good, object())


@pytest.mark.parametrize("name", CONTROLLERS)
def test_policies_can_be_sent_to_another_process(interface, name):
    policy = baselines.make(name, interface())
    observations = ride(policy.interface, 120, 2)
    copy = pickle.loads(pickle.dumps(policy))
    assert np.array_equal(commands_of(policy, observations), commands_of(copy, observations))


class Vehicle(gym.Env):
    """As much of an environment as `make` looks at."""

    interface: ClassVar = None
    closed = 0

    def __init__(self):
        self.observation_space = gym.spaces.Box(-1.0, 1.0, self.interface.shape, np.float32)
        self.action_space = gym.spaces.Box(0.0, 1.0, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        return np.zeros(self.interface.shape, dtype=np.float32), {}

    def step(self, action):
        return np.zeros(self.interface.shape, dtype=np.float32), 0.0, False, False, {}

    def close(self):
        type(self).closed += 1


class ForeignVector:
    """The part of a Stable-Baselines3 vector environment that counts here."""

    num_envs = 2

    def __init__(self, env):
        self.env = env
        self.observation_space = env.observation_space

    @property
    def unwrapped(self):
        return self

    def get_attr(self, name, indices=None):
        return [getattr(self.env, name)] * 2


@pytest.fixture
def vehicle(interface, monkeypatch):
    monkeypatch.setattr(Vehicle, "interface", interface())
    monkeypatch.setattr(Vehicle, "closed", 0)
    return Vehicle


def test_make_reads_the_interface_of_every_kind_of_environment(vehicle):
    vector = gym.vector.SyncVectorEnv([vehicle, vehicle])
    sources = [vehicle(), gym.wrappers.TimeLimit(vehicle(), 10), vector, ForeignVector(vehicle())]
    for source in sources:
        assert baselines.make("mppt1", source).interface is vehicle.interface
    vector.close()


def test_make_reads_the_interface_of_an_id(vehicle, monkeypatch):
    monkeypatch.setattr(gym.envs.registration, "registry", dict(gym.envs.registration.registry))
    gym.register("Vehicle-v0", entry_point=vehicle, disable_env_checker=True)
    assert baselines.make("mppt1", "Vehicle-v0").interface is vehicle.interface
    assert baselines.make("mppt1", gym.spec("Vehicle-v0")).interface is vehicle.interface
    assert vehicle.closed == 2


def test_other_things_are_refused(vehicle):
    for other in (None, 3, gym.make("CartPole-v1"), ForeignVector(gym.make("CartPole-v1"))):
        with pytest.raises(ConfigError, match="expected an environment of sayd_env"):
            baselines.make("constant", other)
    for missing in ("Nowhere-v0", "no_such_module:Nowhere-v0"):
        with pytest.raises(ConfigError, match=f"environment '{missing}'"):
            baselines.make("constant", missing)


def test_changed_observations_are_refused(vehicle):
    scaled = gym.wrappers.RescaleObservation(vehicle(), np.float32(-2.0), np.float32(2.0))
    with pytest.raises(ConfigError, match="a wrapper changes the environment's observations"):
        baselines.make("constant", scaled)
    vector = gym.vector.SyncVectorEnv([vehicle, vehicle])
    with pytest.raises(ConfigError, match="a wrapper changes the environment's observations"):
        baselines.make("constant", Scaled(vector))
    vector.close()


ENDS = np.float32(-1.0), np.float32(1.0)


def test_changed_actions_are_refused(vehicle):
    """0.3 of -1 to 1 would be 0.65; a wrapper that takes any number and cuts it off changes nothing."""
    with pytest.raises(ConfigError, match="a wrapper changes the environment's actions"):
        baselines.make("constant:0.3", gym.wrappers.RescaleAction(vehicle(), *ENDS))
    vector = gym.vector.SyncVectorEnv([vehicle, vehicle])
    with pytest.raises(ConfigError, match="a wrapper changes the environment's actions"):
        baselines.make("constant:0.3", gym.wrappers.vector.RescaleAction(vector, *ENDS))
    vector.close()
    with pytest.raises(ConfigError, match="a wrapper changes the environment's actions"):
        baselines.make("constant:0.3", gym.wrappers.DiscretizeAction(vehicle(), 5))
    clipped = gym.wrappers.ClipAction(vehicle())
    assert baselines.make("constant:0.3", clipped).interface is clipped.unwrapped.interface


class Scaled(gym.vector.VectorObservationWrapper):
    """Twice the observations."""

    def __init__(self, env):
        super().__init__(env)
        self.single_observation_space = gym.spaces.Box(
            -2.0, 2.0, env.single_observation_space.shape, np.float32
        )

    def observations(self, observations):
        return 2.0 * observations
