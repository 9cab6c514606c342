"""Environments as data: packaged ones, files on top of them, refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from sayd_env.config import ConfigError, packaged_names
from sayd_env.config.assessment import load_assessment
from sayd_env.config.distribution import FixedDistribution, UniformDistribution
from sayd_env.config.environment import OF_THE_SCENARIO, EnvironmentConfig, fixed_by, load_environment
from sayd_env.config.scaling import scaled
from sayd_env.config.scenario import load_scenario

Write = Callable[..., Path]


def refused(name: object, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_environment(str(name), overrides)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(text: str, name: str = "mine.yaml") -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write


def fixed(config: EnvironmentConfig, name: str) -> float:
    drawn = getattr(config.randomisation, name)
    assert isinstance(drawn, FixedDistribution)
    return drawn.value


def test_nominal_is_the_papers_vehicle_without_chance():
    config = load_environment()
    assert (fixed(config, "speed_kmh"), fixed(config, "wear")) == (350.0, 1.0)
    assert (fixed(config, "payload"), fixed(config, "initial_current")) == (0.0, 0.0)
    assert (fixed(config, "sensor_bias"), fixed(config, "sensor_noise")) == (0.0, 1.0)
    assert config.randomisation.friction is None
    assert config.randomisation.tracks == ()
    assert config.randomisation.tolerances == {}
    assert config.faults is None
    assert (config.control_period, config.episode_s, config.valves) == (0.01, 20.0, "bogie")
    assert load_scenario(config.study).wear == 1.0


def test_the_run_in_is_that_of_the_assessment():
    assert load_environment().run_in == load_assessment().run_in


def test_faults_stand_on_the_randomised_conditions():
    randomised, faulty = load_environment("randomized"), load_environment("faults")
    names = {"nominal", "randomized", "faults", "line", "training", "training-line"}
    assert set(packaged_names("env")) == names
    assert randomised.faults is None
    assert faulty.faults is not None
    assert faulty.randomisation == randomised.randomisation
    assert {each.kind for each in faulty.faults.kinds} == {
        "valve_stuck",
        "power_lost",
        "damper_lost",
        "sensor_dead",
        "sensor_frozen",
        "sensor_biased",
        "sensor_noisy",
    }
    # A fault that comes after the end of an episode is none.
    assert faulty.faults.onset.bounds[1] < faulty.episode_s


def test_randomised_conditions_span_speeds_wear_and_tracks():
    randomisation = load_environment("randomized").randomisation
    assert randomisation.speed_kmh.bounds == (200.0, 400.0)
    assert randomisation.wear is not None
    assert randomisation.wear.bounds == (0.0, 1.0)
    assert {track.name for track in randomisation.tracks} == {"german_low", "german_high", "china"}
    assert {(profile.name, profile.shift) for profile in randomisation.profiles} == {
        (None, None),
        (None, 1e-3),
        ("lma", None),
    }
    assert randomisation.gauge is not None
    assert randomisation.gauge.bounds == (1.432, 1.440)
    assert load_environment("training").randomisation.profiles == randomisation.profiles
    for group in randomisation.tolerances.values():
        low, high = group.factor.bounds
        assert low < 1.0 < high


def test_what_assignments_to_a_scenario_fix_is_not_drawn():
    randomisation = load_environment("randomized").randomisation
    keys = ("wear", "wheel.shift", "track.irregularity.scale", "vehicle.bodies.frame.mass")
    assert fixed_by(keys) == {"wear", "profiles", "tracks"}
    assert fixed_by(["track"]) == {"gauge", "tracks"}
    left = randomisation.without(fixed_by(keys))
    assert (left.wear, left.profiles, left.tracks) == (None, (), ())
    assert (left.friction, left.gauge, left.tolerances) == (
        randomisation.friction,
        randomisation.gauge,
        randomisation.tolerances,
    )
    every = randomisation.without()
    assert [getattr(every, name) for name in OF_THE_SCENARIO] == [None, (), None, None, ()]


def test_every_tolerance_leads_to_numbers_of_the_study():
    groups = load_environment("randomized").randomisation.tolerances
    for kind in ("sayd", "passive"):
        scenario = load_scenario("nominal", ["damper=sayd"] if kind == "sayd" else [])
        other = {"sayd": "passive", "passive": "sayd"}[kind]
        for group in groups.values():
            for end in group.factor.bounds:  # within what the schemas allow
                keys = [key.split(".") for key in group.keys if not key.startswith(other)]
                paths = {tuple(["damper", *key[1:]] if key[0] == kind else key): end for key in keys}
                assert scaled(scenario, paths) != scenario or not paths


def test_a_file_differs_from_its_base_only_where_it_says_so(write: Write):
    path = write(
        "base: randomized\ncontrol_period: 0.02\nsensors: {pressure: {noise: 0.0}}\n"
        "randomisation:\n  speed_kmh: {distribution: fixed, value: 300}\n"
        "  tolerances: {arm_joints: {factor: {distribution: fixed, value: 1.1}}}\n"
    )
    config, base = load_environment(str(path)), load_environment("randomized")
    assert config.control_period == 0.02
    assert config.sensors.pressure.noise == 0.0
    assert config.sensors.stroke == base.sensors.stroke
    assert fixed(config, "speed_kmh") == 300.0
    assert config.randomisation.wear == base.randomisation.wear
    joints = config.randomisation.tolerances["arm_joints"]
    assert joints.keys == base.randomisation.tolerances["arm_joints"].keys
    assert joints.factor == FixedDistribution(distribution="fixed", value=1.1)


def test_assignments_come_last_and_in_their_order():
    config = load_environment(
        "randomized", ["sensors=ideal", "sensors.stroke.noise=1e-6", "randomisation.speed_kmh.low=350"]
    )
    assert (config.sensors.stroke.noise, config.sensors.pressure.noise) == (1e-6, 0.0)
    assert config.randomisation.speed_kmh == UniformDistribution(
        distribution="uniform", low=350.0, high=400.0
    )
    assert load_environment("nominal", ["damper=passive"]).damper == "passive"


def test_paths_in_a_file_start_at_that_file(write: Write, monkeypatch: pytest.MonkeyPatch):
    track = Path(__file__).parents[2] / "configs/track/german_low.yaml"
    write(track.read_text(), "tracks/line.yaml")
    write("base: ../mine.yaml\n", "deep/other.yaml")
    path = write(
        "study: ./study.yaml\nrandomisation: {tracks: [{name: tracks/line.yaml}]}\n",
    )
    monkeypatch.chdir("/")
    for name in (path, path.parent / "deep/other.yaml"):
        config = load_environment(str(name))
        assert (
            Path(config.randomisation.tracks[0].name).resolve()
            == (path.parent / "tracks/line.yaml").resolve()
        )
        assert Path(config.study).resolve() == (path.parent / "study.yaml").resolve()


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        (
            "control_period=0.03",
            "control_period: found 0.03; expected a whole number of milliseconds that div",
        ),
        (
            "control_period=0.0005",
            "expected a whole number of milliseconds that divides a second: 1, 2, 4, 5",
        ),
        ("control_period=2", "control_period: found 2; expected a number less than or equal to 1"),
        ("episode_s=0.015", "episode_s (0.015 s) must be a multiple of control_period (0.01 s)"),
        ("valves=both", "valves: found 'both'; expected 'bogie', 'damper' or 'vehicle'"),
        ("observation=signal", "expected 'signals', 'history' or 'features', did you mean 'signals'?"),
        ("history=0", "history: found 0; expected a number greater than or equal to 1"),
        ("damper=active", "damper: found 'active'; expected 'sayd' or 'passive'"),
        ("sensors=realisic", "unknown sensors 'realisic', did you mean 'realistic'?; available: ideal"),
        ("sensors=", "sensors: found None; expected a name (ideal, realistic), a path or keys and values"),
        ("contrl_period=1", "unknown key 'contrl_period', did you mean 'control_period'?"),
        ("termination_cost=-1", "termination_cost: found -1; expected a number greater than or equal to 0"),
        ("derailment.quotient=.nan", "derailment.quotient: found nan; expected a finite number"),
        (
            "randomisation.speed_kmh.high=600",
            "the distribution reaches from 200 to 600; allowed are 30 to 500 km/h",
        ),
        (
            "randomisation.wear.high=1.5",
            "randomisation.wear: the distribution reaches from 0 to 1.5; allowed are 0 to 1.2:",
        ),
        (
            "randomisation.wear.high=1e308",
            "high - low (1e+308) must be a whole number of steps, found step 0.05",
        ),
        ("randomisation.wear.step=1e-320", "must be a whole number of steps, found step 9.99989e-321"),
        ("episode_s=1e308", "episode_s: found 1e+308; expected a number less than or equal to 86400"),
        (
            "randomisation.tracks=[{name: china, weight: 1e308}]",
            "expected a number less than or equal to 1e+09",
        ),
        ("randomisation.friction.low=0", "the distribution reaches from 0 to 0.5; allowed are 0.05 to 1"),
        ("randomisation.speed_kmh=null", "randomisation.speed_kmh: found None"),
        ("randomisation.tracks.0.name=chna", "unknown track 'chna', did you mean 'china'?"),
        (
            "randomisation.tracks=[{name: smooth, scale: {distribution: fixed, value: 1}}]",
            "has nothing to scale",
        ),
        ("randomisation.tracks=[{name: china, weight: 0}]", "at least one weight must be positive"),
        ("randomisation.profiles=[{name: lma, weight: 0}]", "at least one weight must be positive"),
        ("randomisation.profiles.0.name=lmaa", "unknown profile 'lmaa', did you mean 'lma'?"),
        ("randomisation.profiles.0.shift=0.1", "shift: found 0.1"),
        ("randomisation.gauge={distribution: fixed, value: 1435}", "the distribution reaches from 1435"),
        ("randomisation.tolerances.frames.keys=[vehcle.x]", "begins with 'vehcle', did you mean 'vehicle'?"),
        (
            "randomisation.tolerances.frames.factor.low=0",
            "the distribution reaches from 0 to 1.1; allowed are 0.1 to 10",
        ),
        (
            "randomisation.tolerances.frames.keys=[sayd.valve.delay]",
            "key 'sayd.valve.delay' is in two groups, 'frames' and 'valve_delay'",
        ),
        (
            "faults.count={distribution: uniform, low: 0, high: 1}",
            "faults.count.distribution: found 'uniform'; expected fixed, ch",
        ),
        (
            "faults.count={distribution: choice, values: [0.5]}",
            "faults.count: the distribution has 0.5; allowed are whole numbers",
        ),
        (
            "faults.count={distribution: fixed, value: 9}",
            "the distribution has 9; allowed are whole numbers from 0 to 8",
        ),
        (
            "faults.onset.low=-1",
            "faults.onset: the distribution reaches down to -1 s; allowed are 0 s and more",
        ),
        ("faults.kinds=[]", "faults.kinds: found []; expected at least 1 entries"),
        ("faults.kinds=[{kind: sensor_ded}]", "kind: found 'sensor_ded', did you mean 'sensor_dead'?"),
        ("faults.kinds=[{kind: power_lost, weight: 0}]", "at least one weight must be positive"),
        (
            "faults.kinds.0.current.value=2",
            "faults.kinds.0.current: the distribution reaches from 2 to 2; allowed are 0 to 1",
        ),
        (
            "faults.kinds=[{kind: sensor_dead, sensors: [gyro]}]",
            "found 'gyro'; expected 'lateral_acceleration'",
        ),
    ],
)
def test_a_bad_value_is_one_clear_line(override: str, expected: str):
    assert expected in refused("faults", override)


def test_the_file_that_sets_a_bad_value_is_blamed(write: Write):
    base = write("history: 0\n", "base.yaml")
    path = write("base: base.yaml\ncontrol_period: 0.02\n")
    assert refused(path).startswith(f"{base}: history: found 0; expected")
    sensors = write("name: mine\n", "sensors.yaml")
    found = refused(write("sensors: sensors.yaml\n"))
    assert found.startswith(f"{sensors}: keys are missing: lateral_acceleration, ")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty; expected keys and values"),
        ("base: 5\n", "base: found 5; expected a name, a path or null"),
        ("base: mine.yaml\n", "base: 'mine.yaml' refers back to this file"),
        ("base: nominl\n", "unknown env 'nominl', did you mean 'nominal'?"),
        ("base: null\nstudy: nominal\n", "keys are missing: "),
    ],
)
def test_a_bad_file_is_one_clear_line(
    text: str, expected: str, write: Write, monkeypatch: pytest.MonkeyPatch
):
    path = write(text)
    monkeypatch.chdir(path.parent)
    assert expected in refused("./mine.yaml")
