"""Episodes: distributions, seeds, options, faults, and the scenarios that come of them."""

from __future__ import annotations

import dataclasses
import pickle
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.fault import SensorBiased, SensorNoisy, ValveStuck
from sayd_env.config.profile import load_wheel
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.sensors import SIGNALS
from sayd_env.config.track import SpectrumConfig, read_track
from sayd_env.envs.draw import STREAMS, Episode, draw_episode, episode_scenario
from sayd_env.envs.keywords import configured
from sayd_env.physics.track.realisation import realise

NOMINAL = load_environment("nominal")
RANDOMISED = load_environment("randomized")
FAULTY = load_environment("faults")
BASE = load_scenario("nominal", ["damper=sayd"])
MANY = [draw_episode(FAULTY, seed, k) for seed in range(40) for k in range(25)]
"""A thousand episodes."""


def values(episode: Episode) -> dict[str, Any]:
    fields = {f.name: getattr(episode, f.name) for f in dataclasses.fields(episode)}
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in fields.items()}


def differing(a: Episode, b: Episode) -> set[str]:
    first, second = values(a), values(b)
    return {name for name in first if first[name] != second[name]}


def refused(options: Any, config: EnvironmentConfig = NOMINAL) -> str:
    with pytest.raises(ConfigError) as caught:
        draw_episode(config, 0, 0, options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# Seeds


@pytest.mark.parametrize("seed", [0, 1, 7, 2**31, 2**32 - 1, 2**32, 2**40 + 3, 2**64 + 5])
def test_the_seed_sequence_of_the_first_episode_is_that_of_the_seed(seed: int):
    first = np.random.default_rng([seed, 0]).random(5)
    np.testing.assert_array_equal(first, np.random.default_rng(seed).random(5))
    assert draw_episode(NOMINAL, seed, 0).track_seed == seed


@pytest.mark.parametrize(("seed", "number"), [(0, 3), (5, 1), (2**32 - 1, 2**20), (2**40, 9), (2**64 + 5, 2)])
def test_the_track_seed_is_the_seed_sequence_as_one_number(seed: int, number: int):
    track_seed = draw_episode(NOMINAL, seed, number).track_seed
    for key in ((), (74, 2)):
        alone = np.random.SeedSequence(track_seed, spawn_key=key).generate_state(8)
        listed = np.random.SeedSequence([seed, number], spawn_key=key).generate_state(8)
        np.testing.assert_array_equal(alone, listed)


def test_the_track_of_the_first_episode_is_that_of_the_studies():
    irregularity = episode_scenario(BASE, draw_episode(NOMINAL, 4, 0)).track.irregularity
    tracks = [
        realise(irregularity, 600.0, draw_episode(NOMINAL, 4, k).track_seed).coefficients for k in (0, 1)
    ]
    np.testing.assert_array_equal(tracks[0], realise(BASE.track.irregularity, 600.0, 4).coefficients)
    assert not np.allclose(tracks[0], tracks[1])


def test_the_same_seed_gives_the_same_episode_and_another_one_another():
    for config in (NOMINAL, RANDOMISED, FAULTY):
        a, b = (draw_episode(config, 12, 3) for _ in range(2))
        assert differing(a, b) == set()
    assert "speed" in differing(draw_episode(RANDOMISED, 12, 3), draw_episode(RANDOMISED, 12, 4))
    assert "speed" in differing(draw_episode(RANDOMISED, 12, 3), draw_episode(RANDOMISED, 13, 3))
    assert len({episode.speed for episode in MANY}) == len(MANY)
    assert len({episode.track_seed for episode in MANY}) == len(MANY)


def test_an_episode_does_not_know_how_long_those_before_it_were():
    for override in ("episode_s=1.0", "control_period=0.05", "run_in=2000.0", "observation=history"):
        other = load_environment("faults", [override])
        assert differing(draw_episode(FAULTY, 3, 5), draw_episode(other, 3, 5)) == set()


def test_components_have_streams_of_their_own():
    episode = draw_episode(NOMINAL, 1, 2)
    firsts = [np.random.default_rng(episode.stream(component)).random() for component in STREAMS]
    firsts.append(np.random.default_rng(episode.track_seed).random())
    assert len(set(firsts)) == len(STREAMS) + 1
    children = np.random.SeedSequence([1, 2]).spawn(6)
    for component, key in STREAMS.items():
        expected = children[key].generate_state(4)
        np.testing.assert_array_equal(episode.stream(component).generate_state(4), expected)


def test_an_episode_survives_pickling():
    episode = draw_episode(FAULTY, 2, 1)
    assert differing(pickle.loads(pickle.dumps(episode)), episode) == set()


# Laws


def test_nominal_episodes_differ_in_their_track_alone():
    a, b = draw_episode(NOMINAL, 0, 0), draw_episode(NOMINAL, 9, 4)
    assert differing(a, b) == {"seed", "number"}
    assert a.speed == 350.0 / 3.6
    assert (a.wear, a.friction, a.payload, a.initial_current) == (1.0, None, 0.0, 0.0)
    assert (a.track, a.irregularity, a.track_scale, a.faults) == (None, None, None, ())
    np.testing.assert_array_equal(a.sensor_bias, np.zeros(41))
    np.testing.assert_array_equal(a.sensor_noise, np.ones(41))


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("speed", 200.0 / 3.6, 400.0 / 3.6),
        ("friction", 0.2, 0.5),
        ("payload", -0.17, 0.0),
        ("initial_current", 0.0, 0.5),
    ],
)
def test_quantities_are_uniform_between_their_limits(name: str, low: float, high: float):
    drawn = np.array([getattr(episode, name) for episode in MANY])
    assert stats.kstest(drawn, stats.uniform(low, high - low).cdf).pvalue > 0.001


def test_quantities_do_not_depend_on_each_other():
    names = ("speed", "wear", "friction", "payload", "initial_current")
    table = np.array([[getattr(episode, name) for name in names] for episode in MANY])
    correlation = np.corrcoef(table, rowvar=False) - np.eye(len(names))
    assert np.max(np.abs(correlation)) < 4.0 / np.sqrt(len(MANY))


def test_tracks_come_by_their_weights_with_scales_of_their_own():
    counts = Counter(episode.track for episode in MANY)
    expected = {"german_low": 500, "german_high": 250, "china": 250}
    assert set(counts) == set(expected)
    assert stats.chisquare([counts[k] for k in expected], list(expected.values())).pvalue > 0.001
    limits = {"german_low": (0.35, 0.9), "german_high": (0.35, 0.6), "china": (1.0, 1.52)}
    for name, (low, high) in limits.items():
        scales = [episode.track_scale for episode in MANY if episode.track == name]
        assert stats.kstest(scales, stats.uniform(low, high - low).cdf).pvalue > 0.001


def test_tolerances_follow_their_distributions_and_are_shared_by_a_group():
    drawn = [episode.tolerances["vehicle.elements.arm_joint.stiffness"] for episode in MANY]
    exact = stats.truncnorm(-3.0, 3.0, loc=1.0, scale=0.075)
    assert stats.kstest(drawn, exact.cdf).pvalue > 0.001
    for episode in MANY[:20]:
        assert episode.tolerances["sayd.relief.opening"] == episode.tolerances["sayd.relief.full"]


def test_sensor_errors_are_within_their_spread():
    bias = np.array([episode.sensor_bias for episode in MANY])
    noise = np.array([episode.sensor_noise for episode in MANY])
    spread = np.array([FAULTY.sensors.of(signal).bias_spread for signal in SIGNALS])
    share = bias / spread
    assert stats.kstest(share.ravel(), stats.uniform(-1.0, 2.0).cdf).pvalue > 0.001
    assert stats.kstest(noise.ravel(), stats.uniform(0.5, 1.5).cdf).pvalue > 0.001
    correlation = np.corrcoef(share, rowvar=False) - np.eye(len(SIGNALS))
    assert np.max(np.abs(correlation)) < 5.0 / np.sqrt(len(MANY))
    with pytest.raises(ValueError, match="read-only"):
        MANY[0].sensor_bias[0] = 1.0


def test_a_distribution_that_is_exchanged_shifts_no_other_draw():
    other = load_environment(
        "faults",
        [
            "randomisation.wear={distribution: fixed, value: 0.5}",
            "randomisation.friction=null",
            "randomisation.tolerances.arm_joints.factor={distribution: fixed, value: 1.0}",
            "sensors.pressure.bias_spread=0",
        ],
    )
    for k in range(5):
        found = differing(draw_episode(FAULTY, 1, k), draw_episode(other, 1, k))
        assert found <= {"wear", "friction", "tolerances", "sensor_bias"}
    fewer = load_environment("faults", ["randomisation.profiles=[]", "randomisation.gauge=null"])
    for k in range(20):
        found = differing(draw_episode(FAULTY, 1, k), draw_episode(fewer, 1, k))
        assert found <= {"profile", "wheel", "wheel_shift", "gauge", "wear"}


def test_profiles_come_by_their_weights_and_wear_if_they_can():
    counts = Counter((episode.profile, episode.wheel_shift) for episode in MANY)
    expected = {(None, None): 600, (None, 1e-3): 200, ("lma", None): 200}
    assert set(counts) == set(expected)
    assert stats.chisquare([counts[k] for k in expected], list(expected.values())).pvalue > 0.001
    for episode in MANY:
        assert (episode.wheel is None) == (episode.profile is None)
        assert episode.profile is None or episode.wear == 0.0
    assert len({episode.wear for episode in MANY}) == 21


def test_the_gauge_lies_on_a_grid_of_millimetres():
    counts = Counter(episode.gauge for episode in MANY)
    assert sorted(counts) == [round(1.432 + 0.001 * k, 3) for k in range(9)]
    assert stats.chisquare(list(counts.values())).pvalue > 0.001


# Options

OPTIONS: dict[str, tuple[Any, set[str]]] = {
    "speed_kmh": (250, {"speed"}),
    "wear": (0.33, {"wear"}),  # the four profiles can have it
    "profile": ("worn", {"wear", "wheel_shift"}),  # the study's own, of which two are shifted
    "gauge": (1.4375, {"gauge"}),
    "friction": (0.31, {"friction"}),
    "payload": (0.1, {"payload"}),
    "initial_current": (1.0, {"initial_current"}),
    "track_scale": (0.123, {"track_scale"}),
    "track": ("smooth", {"track", "irregularity", "track_scale"}),
    "faults": ([], {"faults"}),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_an_option_changes_its_quantity_alone(name: str):
    value, touched = OPTIONS[name]
    changed: set[str] = set()
    for k in range(4):
        changed |= differing(draw_episode(FAULTY, 8, k), draw_episode(FAULTY, 8, k, {name: value}))
    assert changed == touched


def test_options_are_taken_as_they_are():
    episode = draw_episode(
        RANDOMISED, 0, 0, {"speed_kmh": np.float32(350), "profile": "new", "friction": 0.4, "track": "china"}
    )
    assert (episode.speed, episode.wear, episode.friction) == (350.0 / 3.6, 0.0, 0.4)
    assert episode.irregularity == read_track("china").irregularity
    assert episode.track_scale is not None
    assert 1.0 <= episode.track_scale <= 1.52
    assert draw_episode(NOMINAL, 0, 0, {"track": "china"}).track_scale is None
    assert differing(draw_episode(NOMINAL, 0, 0, {}), draw_episode(NOMINAL, 0, 0)) == set()


def test_a_profile_is_a_name_a_path_or_an_end_of_wear(tmp_path: Path):
    packaged = draw_episode(RANDOMISED, 0, 0, {"profile": "lma"})
    assert (packaged.profile, packaged.wheel, packaged.wear) == ("lma", load_wheel("lma"), 0.0)
    worn = draw_episode(RANDOMISED, 0, 0, {"profile": "s1002cn", "wear": 0.5})
    assert (worn.wheel, worn.wheel_shift, worn.wear) == (load_wheel("s1002cn"), None, 0.5)
    path = tmp_path / "own.yaml"
    for shift in ("2.0e-3", "2.5e-3"):  # read again for each episode
        path.write_text(f"base: s1002cn\nshift: {shift}\n")
        wheel = draw_episode(NOMINAL, 0, 0, {"profile": str(path)}).wheel
        assert wheel is not None
        assert wheel.shift == float(shift)
    for seed in range(20):  # an end of wear is that of the study's own profile
        episode = draw_episode(RANDOMISED, seed, 0, {"profile": "new"})
        assert (episode.profile, episode.wheel, episode.wheel_shift, episode.wear) == (None, None, None, 0.0)


def test_a_wear_is_that_of_a_profile_which_wears():
    drawn = [draw_episode(RANDOMISED, seed, 0) for seed in range(40)]
    fixed = [draw_episode(RANDOMISED, seed, 0, {"wear": 0.5}) for seed in range(40)]
    assert {episode.profile for episode in drawn} == {None, "lma"}
    assert {(episode.profile, episode.wear) for episode in fixed} == {(None, 0.5)}
    for before, after in zip(drawn, fixed, strict=True):
        assert before.profile is not None or before.wheel_shift == after.wheel_shift
    assert {draw_episode(RANDOMISED, seed, 0, {"wear": 0}).profile for seed in range(40)} == {None, "lma"}


def test_a_track_file_is_read_again_for_each_episode(tmp_path: Path):
    text = (Path(__file__).parents[2] / "configs/track/sine.yaml").read_text(encoding="utf-8")
    path = tmp_path / "line.yaml"
    for scale in (0.5, 0.75):
        path.write_text(text.replace("scale: 1.0", f"scale: {scale}"))
        irregularity = draw_episode(NOMINAL, 0, 0, {"track": str(path)}).irregularity
        assert irregularity == read_track(str(path)).irregularity


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([("wear", 1)], "options: found [('wear', 1)]; expected keys and values"),
        (
            {"speed": 350},
            "options: unknown key 'speed', did you mean 'speed_kmh'?; allowed: faults, friction",
        ),
        ({1: 2}, "options: unknown key 1; allowed: "),
        ({"speed_kmh": 1000}, "options: speed_kmh: found 1000; expected a number from 30 to 500 km/h"),
        ({"speed_kmh": float("nan")}, "speed_kmh: found nan; expected a number from 30 to 500 km/h"),
        ({"speed_kmh": "350"}, "speed_kmh: found '350'; expected a number from 30 to 500 km/h"),
        ({"speed_kmh": None}, "speed_kmh: found None; expected a number"),
        ({"wear": -0.1}, "wear: found -0.1; expected a number from 0 to 1.2"),
        ({"wear": True}, "wear: found True; expected a number from 0 to 1.2"),
        ({"friction": 0.0}, "friction: found 0.0; expected a number from 0.05 to 1"),
        ({"payload": 2}, "payload: found 2; expected a number from -0.5 to 0.5"),
        ({"initial_current": 1.01}, "initial_current: found 1.01; expected a number from 0 to 1"),
        ({"track_scale": 6}, "track_scale: found 6; expected a number from 0 to 5"),
        ({"profile": "wron"}, "profile: found 'wron', did you mean 'worn'?; expected new, worn, "),
        ({"profile": 1}, "profile: found 1; expected new, worn, "),
        ({"profile": "cn60"}, "cn60.yaml: is a rail profile; as wheel are available: "),
        ({"profile": "nowhere.yaml"}, "nowhere.yaml: no such file"),
        ({"profile": "new", "wear": 0.5}, "wear and profile 'new' set the same quantity: give one of them"),
        ({"profile": "lma", "wear": 0.5}, "wear: found 0.5; wheel profile 'lma' does not say how it wears"),
        ({"gauge": 1435}, "gauge: found 1435; expected a number from 0.9 to 1.7 m"),
        ({"track": "chna"}, "unknown track 'chna', did you mean 'china'?; available: "),
        ({"track": None}, "track: found None; expected the name of a track or a path"),
        ({"track": "nowhere.yaml"}, "nowhere.yaml: no such file"),
        (
            {"track": "smooth", "track_scale": 2},
            "track_scale: track 'smooth' is even: it has nothing to scale",
        ),
        ({"faults": "all"}, "options: faults: found 'all'; expected a list of faults"),
        ({"faults": [{"kind": "valve_stuck", "damper": "x", "current": 0}]}, "faults.0.damper: found 'x'"),
    ],
)
def test_a_bad_option_is_one_clear_line(options: Any, expected: str):
    assert expected in refused(options)


@pytest.mark.parametrize(("seed", "number"), [(-1, 0), (0, -1), (1.5, 0), (True, 0), ("1", 0)])
def test_seed_and_number_are_whole(seed: Any, number: Any):
    with pytest.raises(ConfigError, match=r"expected a whole number (from 0 to|of 0 or more)"):
        draw_episode(NOMINAL, seed, number)


# Faults


def test_faults_come_by_their_weights():
    counts = Counter(len(episode.faults) for episode in MANY)
    assert stats.chisquare([counts[k] for k in range(4)], [100, 500, 300, 100]).pvalue > 0.001
    kinds = Counter(fault.kind for episode in MANY for fault in episode.faults)
    weights = {
        "valve_stuck": 3.0,
        "power_lost": 2.0,
        "damper_lost": 1.0,
        "sensor_dead": 1.5,
        "sensor_frozen": 1.0,
        "sensor_biased": 1.5,
        "sensor_noisy": 1.0,
    }
    expected = np.array(list(weights.values())) / sum(weights.values()) * sum(kinds.values())
    assert stats.chisquare([kinds[k] for k in weights], expected).pvalue > 0.001


def test_faults_are_within_their_ranges():
    faults = [fault for episode in MANY for fault in episode.faults]
    assert stats.kstest([fault.start_s for fault in faults], stats.uniform(0.0, 15.0).cdf).pvalue > 0.001
    stuck = [fault.current for fault in faults if isinstance(fault, ValveStuck)]
    assert {0.0, 1.0} < set(stuck)
    assert all(current in (0.0, 1.0) or 0.02 <= current <= 0.98 for current in stuck)
    biased = [fault for fault in faults if isinstance(fault, SensorBiased)]
    shares = np.array([f.bias / _half_range(f.signal) for f in biased])
    assert np.all((np.abs(shares) >= 0.005) & (np.abs(shares) <= 0.05))
    assert 0.3 < np.mean(shares > 0.0) < 0.7
    for fault in faults:
        if isinstance(fault, SensorNoisy):
            assert 0.002 <= fault.noise / _half_range(fault.signal) <= 0.02


def _half_range(signal: str) -> float:
    sensor = FAULTY.sensors.of(signal)
    return 0.5 * (sensor.high - sensor.low)


def test_no_part_fails_twice_and_faults_are_in_order():
    crowded = load_environment("faults", ["faults.count={distribution: fixed, value: 8}"])
    for k in range(50):
        faults = draw_episode(crowded, 0, k).faults
        places = [getattr(fault, "damper", None) or getattr(fault, "signal", None) for fault in faults]
        assert len(places) == len(set(places)) == 8
        assert [fault.start_s for fault in faults] == sorted(fault.start_s for fault in faults)


def test_sensors_that_run_out_leave_fewer_faults():
    kinds = "[{kind: sensor_dead, sensors: [speed]}]"
    config = load_environment(
        "faults", ["faults.count={distribution: fixed, value: 3}", f"faults.kinds={kinds}"]
    )
    (fault,) = draw_episode(config, 0, 0).faults
    assert fault.kind == "sensor_dead"


# Scenarios


def carbody(scenario: Scenario) -> Any:
    return next(body for body in scenario.vehicle.bodies if body.role == "carbody")


def test_a_nominal_episode_has_the_scenario_itself():
    assert episode_scenario(BASE, draw_episode(NOMINAL, 3, 7)) is BASE


def test_conditions_arrive_in_the_scenario():
    episode = draw_episode(RANDOMISED, 5, 2)
    scenario = episode_scenario(BASE, episode)
    assert (scenario.wear, scenario.friction) == (episode.wear, episode.friction)
    assert carbody(scenario).mass == pytest.approx(carbody(BASE).mass * (1.0 + episode.payload), rel=1e-15)
    ratios = np.array(carbody(scenario).inertia) / carbody(BASE).inertia
    np.testing.assert_allclose(ratios, 1.0 + episode.payload, rtol=1e-15)
    assert isinstance(scenario.track.irregularity, SpectrumConfig)
    assert isinstance(episode.irregularity, SpectrumConfig)
    assert scenario.track.irregularity.scale == episode.track_scale
    assert scenario.track.irregularity.density == episode.irregularity.density
    ratio = scenario.track.section.lateral_stiffness / BASE.track.section.lateral_stiffness
    assert ratio == pytest.approx(episode.tolerances["track.section.lateral_stiffness"], rel=1e-15)
    assert scenario.damper.type == BASE.damper.type == "sayd"
    ratio = scenario.damper.oil.bulk_modulus / BASE.damper.oil.bulk_modulus
    assert ratio == pytest.approx(episode.tolerances["sayd.oil.bulk_modulus"], rel=1e-15)
    assert scenario.wheel == BASE.wheel.model_copy(update={"shift": episode.wheel_shift or BASE.wheel.shift})
    assert scenario.track.gauge == episode.gauge


def test_a_profile_and_a_gauge_arrive_in_the_scenario():
    scenario = episode_scenario(BASE, draw_episode(NOMINAL, 0, 0, {"profile": "lma", "gauge": 1.44}))
    assert (scenario.wheel, scenario.wear, scenario.track.gauge) == (load_wheel("lma"), 0.0, 1.44)
    assert scenario.track.irregularity == BASE.track.irregularity
    flatter = load_environment("nominal", ["randomisation.profiles=[{shift: 0.001}]"])
    wheel = episode_scenario(BASE, draw_episode(flatter, 0, 0)).wheel
    assert wheel == BASE.wheel.model_copy(update={"shift": 1e-3})


def test_every_drawn_scenario_is_allowed_with_both_kinds_of_damper():
    passive = load_scenario("nominal")
    for episode in MANY[::10]:
        for base in (BASE, passive):
            scenario = episode_scenario(base, episode)
            assert Scenario.model_validate(scenario.model_dump()) == scenario


def test_a_passive_vehicle_has_the_tolerances_of_its_own_dampers():
    passive = load_scenario("nominal")
    episode = draw_episode(RANDOMISED, 5, 2)
    scenario = episode_scenario(passive, episode)
    assert scenario.damper.type == passive.damper.type == "passive"
    ratio = scenario.damper.series_stiffness / passive.damper.series_stiffness
    assert ratio == pytest.approx(episode.tolerances["passive.series_stiffness"], rel=1e-15)


def test_a_scale_alone_keeps_the_studys_track():
    scenario = episode_scenario(BASE, draw_episode(NOMINAL, 0, 0, {"track_scale": 0.25}))
    assert isinstance(scenario.track.irregularity, SpectrumConfig)
    assert isinstance(BASE.track.irregularity, SpectrumConfig)
    assert scenario.track.irregularity.scale == 0.25
    assert scenario.track.irregularity.density == BASE.track.irregularity.density
    smooth = load_scenario("nominal", ["track=smooth"])
    with pytest.raises(ConfigError, match="nothing to scale"):
        episode_scenario(smooth, draw_episode(NOMINAL, 0, 0, {"track_scale": 0.25}))


def test_a_tolerance_that_the_scenario_does_not_have_is_refused():
    group = "{keys: [vehicle.elements.arm_jont.stiffness], factor: {distribution: fixed, value: 1.1}}"
    config = load_environment("nominal", [f"randomisation.tolerances={{joints: {group}}}"])
    with pytest.raises(ConfigError, match="did you mean 'arm_joint'"):
        episode_scenario(BASE, draw_episode(config, 0, 0))


def test_a_number_that_settings_set_is_not_scaled_by_a_tolerance() -> None:
    """The other numbers of its group, and those of a part that is named as a whole, are."""

    def scenarios(*settings: str) -> list[Scenario]:
        config, base = configured("randomized", settings=list(settings))
        episodes = [draw_episode(config, seed, 0, base=base) for seed in range(6)]
        return [episode_scenario(base, episode) for episode in episodes]

    moduli = {each.damper.oil.bulk_modulus for each in scenarios("damper.oil.bulk_modulus=1.0e9")}
    assert moduli == {1.0e9}
    mounts = scenarios("damper.bogie_mount.stiffness=20e6")
    assert {each.damper.bogie_mount.stiffness for each in mounts} == {20e6}
    assert len({each.damper.carbody_mount.stiffness for each in mounts}) > 1
    assert len({each.damper.oil.bulk_modulus for each in scenarios("damper=sayd")}) > 1


def test_new_wheels_by_settings_leave_profiles_that_do_not_wear_in_the_draw() -> None:
    """LMA has 1 of 5 of the weights, whether an option or settings say that wheels are new."""
    config, base = configured("randomized", settings=["wear=0"])
    drawn = [draw_episode(config, seed, 0, base=base).profile for seed in range(400)]
    assert drawn == [draw_episode(config, seed, 0, {"wear": 0.0}).profile for seed in range(400)]
    assert 0.14 < drawn.count("lma") / 400 < 0.26
    config, base = configured("nominal", settings=["wheel=lma"])
    assert draw_episode(config, 0, 0, base=base).wear == 0.0
    with pytest.raises(ConfigError, match=r"wear: found 0.5; wheel profile 'lma' does not say"):
        draw_episode(config, 0, 0, {"wear": 0.5}, base)
