"""MPPT: equations (27) to (31) worked out by hand, and the measurement by SciPy's filters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from sayd_env import baselines
from sayd_env.config.control import load_controller
from sayd_env.envs.interface import RunIn

LIMIT = 5.44
REFERENCE = 12e3
FREE = {"threshold_max": 1e3, "threshold_min": 0.0, "v_min": 0.0}


def run(policy, observe, interface, seconds, start=None):
    """Commands after each whole second; `seconds` hold the features of each."""
    steps = round(1.0 / interface.control_period)
    action, state = policy.predict(observe(interface, start or seconds[0]))
    commands = [action.copy()]
    for features in seconds:
        for _ in range(steps):
            action, state = policy.predict(observe(interface, features), state)
        commands.append(action.copy())
    return np.array(commands)


def accelerations(costs):
    return [{"acceleration_rms": LIMIT * math.sqrt(cost)} for cost in costs]


@pytest.mark.parametrize("name", ["mppt1", "mppt2"])
def test_eq_29_moves_by_the_relative_change_of_the_cost(interface, observe, name):
    features = interface(observation="features")
    policy = baselines.make(name, features, initial=0.5, k_J=0.1, k_y=1.0, k_F=0.0, **FREE)
    commands = run(policy, observe, features, accelerations([0.5, 1.0, 0.25, 0.25]))
    # 0.5; no J^n yet; -0.1 (1 - 0.5) / 1; +0.1 (1 - 0.25) / 1; unchanged
    expected = [0.5, 0.5, 0.45, 0.525, 0.525]
    assert commands == pytest.approx(np.array([expected, expected]).T, abs=1e-6)


def test_eq_27_weighs_acceleration_and_force(interface, observe):
    features = interface(observation="features")
    policy = baselines.make("mppt2", features, initial=0.5, k_J=0.2, k_y=2.0, k_F=3.0, **FREE)
    seconds = [
        {"acceleration_rms": 0.5 * LIMIT, "force_rms": 0.5 * REFERENCE},  # J = 2/4 + 3/4
        {"acceleration_rms": 0.5 * LIMIT, "force_rms": 1.0 * REFERENCE},  # J = 2/4 + 3
    ]
    commands = run(policy, observe, features, seconds)
    assert commands[2] == pytest.approx(0.5 - 0.2 * (3.5 - 1.25) / 3.5, abs=1e-6)


def test_thresholds_replace_eq_29(interface, observe):
    features = interface(observation="features")
    settings = {"threshold_max": 1.0, "threshold_min": 0.5, "delta_v_down": 0.2, "delta_v_up": 0.03}
    policy = baselines.make("mppt1", features, initial=0.6, k_J=0.1, v_min=0.05, **settings)
    seconds = [{"acceleration_rms": rms} for rms in (1.1, 2.2, 0.4, 0.8, 1.0, 0.5)]
    commands = run(policy, observe, features, seconds)[:, 0]
    # (30) twice, from the first second on; (31); (29) with J / J' = (0.4 / 0.8)^2; at a threshold (29) holds
    expected = [0.6, 0.4, 0.2, 0.23, 0.23 - 0.1 * 0.75]
    expected.append(expected[-1] - 0.1 * (1.0 - 0.64))
    expected.append(expected[-1] + 0.1 * 0.75)
    assert commands == pytest.approx(expected, abs=1e-6)


def test_a_lower_threshold_of_zero_never_opens(interface, observe):
    features = interface(observation="features")
    policy = baselines.make("mppt1", features, initial=0.6, delta_v_up=0.5, threshold_min=0.0)
    commands = run(policy, observe, features, accelerations([0.0, 0.0]))
    assert commands == pytest.approx(0.6)


def test_the_command_stays_in_its_range(interface, observe):
    features = interface(observation="features")
    settings = {"threshold_max": 1.0, "threshold_min": 0.5, "delta_v_down": 0.4, "delta_v_up": 0.4}
    policy = baselines.make("mppt2", features, initial=0.0, v_min=0.07, k_F=0.0, **settings)
    up = [{"acceleration_rms": 0.1}] * 4
    down = [{"acceleration_rms": 3.0}] * 4
    commands = run(policy, observe, features, up + down)[:, 1]
    assert commands == pytest.approx([0.07, 0.47, 0.87, 1.0, 1.0, 0.6, 0.2, 0.07, 0.07], abs=1e-6)


def test_each_bogie_has_its_own_controller(interface, observe):
    features = interface(observation="features")
    policy = baselines.make("mppt1", features, initial=0.5, threshold_max=1.0, delta_v_down=0.1)
    seconds = [{"acceleration_rms.front": 0.5, "acceleration_rms.rear": 2.0}]
    assert run(policy, observe, features, seconds)[1] == pytest.approx([0.5, 0.4])


def test_the_command_starts_at_the_current_that_is_fed_back(interface, observe):
    signals = interface()
    policy = baselines.make("mppt1", signals, v_min=0.05)
    currents = {"current.front": 0.3, "current.rear.left": 0.6, "current.rear.right": 0.8, "speed": 80.0}
    assert policy.predict(observe(signals, currents))[0] == pytest.approx([0.3, 0.7])
    assert policy.predict(observe(signals, {"speed": 80.0}))[0] == pytest.approx(0.05)


def test_only_the_chosen_sensors_count(interface, observe):
    features = interface(observation="features")
    chosen = {"accelerometer": "trailing", "damper": "right.lower"}
    policy = baselines.make("mppt2", features, **chosen)
    assert policy.sensors[:4] == (
        "acceleration_rms.front.trailing",
        "acceleration_rms.rear.trailing",
        "force_rms.front.right.lower",
        "force_rms.rear.right.lower",
    )
    signals = interface()
    policy = baselines.make("mppt2", signals, initial=0.1, **chosen)
    assert policy.sensors == (
        "speed",
        *(f"lateral_acceleration.{bogie}.trailing" for bogie in ("front", "rear")),
        *(f"pressure_{chamber}.{bogie}.right.lower" for chamber in "ab" for bogie in ("front", "rear")),
    )


def test_mppt1_needs_one_accelerometer_of_each_bogie(interface):
    assert baselines.make("mppt1", interface(), initial=0.1).sensors == (
        "speed",
        "lateral_acceleration.front.leading",
        "lateral_acceleration.rear.leading",
    )


@pytest.mark.parametrize("period", [0.01, 0.02, 0.002])
def test_acceleration_and_force_are_the_rms_of_the_second_just_ended(interface, period):
    """Against SciPy: Butterworth of order 4, 3 to 7 Hz, as f_0 = 5 Hz for 500 m (at 40 m/s 12.5 s)."""
    signals = interface(control_period=period)
    steps = round(1.0 / period)
    generator = np.random.default_rng(5)
    rows = np.zeros((10 * steps + 1, len(signals.signals)), dtype=np.float32)
    lateral = [signals.index(f"lateral_acceleration.{bogie}.leading") for bogie in ("front", "rear")]
    rows[:, lateral] = generator.normal(size=(len(rows), 2))
    high, low = (signals.index(f"pressure_{chamber}.rear.left.upper") for chamber in "ab")
    rows[:, high] = 20e5 + 5e5 * generator.normal(size=len(rows))
    rows[:, low] = 10e5
    rows[:, signals.index("speed")] = 40.0
    policy = baselines.make("mppt2", signals, initial=0.5, k_y=1.0, k_F=0.7, k_J=0.3, **FREE)
    commands, state = [], None
    for row in rows:
        action, state = policy.predict(row, state)
        commands.append(action)
    filtered = sosfilt(
        butter(4, (3.0, 7.0), "bandpass", fs=1.0 / period, output="sos"), rows[:, lateral], axis=0
    )
    force = signals.damper.cylinder.area * (rows[:, high].astype(float) - rows[:, low])
    # The first observation belongs to the time before the episode.
    mean_y = (filtered[1:] ** 2).reshape(10, steps, 2).mean(axis=1)
    mean_f = (force[1:] ** 2).reshape(10, steps).mean(axis=1)
    costs = mean_y / LIMIT**2
    costs[:, 1] += 0.7 * mean_f / REFERENCE**2
    expected = np.full((11, 2), 0.5)
    for n in range(1, 10):
        larger = np.maximum(costs[n - 1], costs[n])
        expected[n + 1] = expected[n] - 0.3 * (costs[n] - costs[n - 1]) / larger
    assert np.array(commands)[::steps] == pytest.approx(expected, abs=1e-6)
    # In between the command does not move.
    held = np.array(commands)[:-1].reshape(10, steps, 2)
    assert np.ptp(held, axis=1).max() == 0.0


def test_the_band_follows_hunting_after_500_m(interface):
    """A sine of 9 Hz lies outside of 3 to 7 Hz, and inside once f_0 has been found."""
    signals = interface()
    policy = baselines.make("mppt1", signals, initial=1.0, threshold_max=1.0, delta_v_down=0.1, k_J=0.0)
    row, state, commands = np.zeros(len(signals.signals), dtype=np.float32), None, []
    row[signals.index("speed")] = 100.0
    for step in range(1001):
        row[:4] = 2.0 * math.sin(2 * math.pi * 9.0 * 0.01 * step)
        action, state = policy.predict(row, state)
        commands.append(action[0])
    assert commands[500] == 1.0  # 5 s: RMS of the filtered sine well below 1 m/s2
    # f_0 is found at 500 m, 5 s; the second that ends at 6 s is the first in its band: 2 / sqrt(2) m/s2
    assert commands[599:1001:100] == pytest.approx([1.0, 0.9, 0.8, 0.7, 0.6], abs=1e-6)
    assert commands[600] == pytest.approx(0.9)


def test_the_band_is_that_of_hunting_from_step_0_after_a_run_in(interface):
    """Two vehicles at different speeds, each with a hunting frequency of its own; filters by SciPy."""
    signals = interface()
    settings = {"initial": 1.0, "threshold_max": 1e3, "threshold_min": 0.0, "k_F": 0.0, "k_J": 0.0}
    policy = baselines.make("mppt1", signals, **settings)
    t = 0.01 * np.arange(1001)
    speeds, tones = np.array([100.0, 80.0]), np.array([9.0, 2.5])
    rows = np.zeros((len(t), 2, len(signals.signals)), dtype=np.float32)
    rows[:, :, :4] = np.sin(2 * np.pi * t[:, None] * tones)[:, :, None] + 0.2
    rows[:, :, signals.index("speed")] = speeds
    begins = np.array([125, 0])
    rows[:125, 0] = 7.0  # of another train, before this one's run-in
    run_in = RunIn(rows[:626], begins)  # 500 m and a step
    state = policy.state_after(run_in)
    for row in rows[625 : 625 + 101]:
        _, state = policy.predict(row, state, np.zeros(2, dtype=bool))
    for vehicle, f0 in enumerate(tones):
        sections = butter(4, (max(f0 - 2.0, 0.5), f0 + 2.0), "bandpass", fs=100.0, output="sos")
        # The filter of the new band begins 2 s before f_0 was found, with the reading of step 0.
        passed = sosfilt(sections, rows[426:726, vehicle, 0])[200:]
        expected = math.sqrt(np.mean(passed.astype(float) ** 2))
        assert state.readings.rms[vehicle, :, 0] == pytest.approx(expected, rel=1e-9)


def test_without_eq_31_the_command_drifts_closed(interface, observe):
    """Where J of a second is drawn anew: by p (Delta V - k_J rho) each second, docs/model.md.

    p is the chance of a second above the threshold, rho the mean relative rise of J into such a second from
    one below it. k_J rho < Delta V: what (29) gives back is less than what (30) has taken.
    """
    features, generator = interface(observation="features", control_period=1.0), np.random.default_rng(3)
    cost = generator.chisquare(8, 4000) / 8.0  # mean square of a second of noise, 4 Hz wide: 2 B T = 8
    bound = float(np.quantile(cost, 0.8))
    gains = {"k_J": 5e-5, "delta_v_down": 1e-4, "threshold_min": 0.0, "v_min": 0.0, "k_y": 1.0, "k_F": 0.0}
    threshold = LIMIT * math.sqrt(bound)
    policy = baselines.make("mppt1", features, initial=0.5, threshold_max=threshold, **gains)
    commands = run(policy, observe, features, accelerations(cost))
    before, after = cost[:-1], cost[1:]
    rises = np.where((before <= bound) & (after > bound), (after - before) / after, 0.0)
    expected = -0.2 * (1e-4 - 5e-5 * rises.sum() / np.count_nonzero(after > bound)) * len(cost)
    assert commands[-1, 0] - 0.5 == pytest.approx(expected, rel=0.1)
    assert expected < -0.05


@pytest.mark.parametrize("name", ["mppt1", "mppt2", "mppt2-tuned", "perturb-and-observe"])
def test_where_the_command_rests_is_not_its_limit(name):
    """The paper's commands rest at 5 % and above (figures 12 and 14): far from V_min."""
    assert load_controller(name).model_dump()["v_min"] <= 0.02


def test_without_a_run_in_there_is_no_state(interface):
    signals = interface()
    nothing = RunIn(np.zeros((0, 1, len(signals.signals)), dtype=np.float32), np.zeros(1, dtype=np.int64))
    assert baselines.make("mppt1", signals).state_after(nothing) is None
