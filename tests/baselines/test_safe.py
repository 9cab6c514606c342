"""The safe fallback: when it closes the valves, when it lets go, and that it else changes nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from sayd_env import baselines, load_policy
from sayd_env.baselines.safe import SafeFallback
from sayd_env.config import ConfigError
from sayd_env.config.safe import load_safe
from sayd_env.config.units import Array32
from sayd_env.envs.interface import RunIn

PERIOD = 0.01
"""s, of the made-up interface."""
FREQUENCY = 5.0
"""Hz: the start frequency of the on-line filter."""
CAREFREE = {"trip": 1e9, "release": 1e8, "slowest": 1.0}
"""Thresholds that nothing passes; of the pairs see `careless`."""


@dataclass
class Open:
    """A policy that opens all valves and remembers how often."""

    interface: Any
    name: str = "open"
    sensors: tuple[str, ...] = ()

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        rows = np.ndim(observation) > len(self.interface.shape)
        shape = (len(observation), self.interface.actions) if rows else (self.interface.actions,)
        return np.full(shape, 1.0, dtype=np.float32), (state or 0) + 1


def careless() -> dict[str, Any]:
    """Thresholds of a monitor that never intervenes."""
    blind = {"floor": 1e9, "ratio": 1e9, "offset": 1e9}
    return CAREFREE | dict.fromkeys(
        ("lateral_acceleration", "longitudinal_acceleration", "pressure", "stroke"), blind
    )


def waves(interface, amplitude, seconds, *, frequency=FREQUENCY, speed=80.0, **sensors):
    """Observations (steps, obs): a sine on all accelerometers, other courses on some signals."""
    steps = round(seconds / PERIOD)
    time = PERIOD * np.arange(steps)
    values = np.zeros((steps, len(interface.signals)))
    for column, signal in enumerate(interface.signals):
        kind = signal.name.partition(".")[0]
        if kind in ("lateral_acceleration", "longitudinal_acceleration"):
            values[:, column] = amplitude * np.sin(2 * np.pi * frequency * time)
        if kind in ("pressure_a", "pressure_b"):
            side = 1.0 if kind.endswith("a") else -1.0
            values[:, column] = 12e5 + side * 4e5 * np.sin(2 * np.pi * frequency * time)
        if kind == "stroke":
            values[:, column] = 2e-3 * np.sin(2 * np.pi * frequency * time)
        if kind == "speed":
            values[:, column] = speed
        for name, course in sensors.items():
            if signal.name == name.replace("__", "."):
                values[:, column] = course(values[:, column])
    return values.astype(np.float32)


def shares(policy: SafeFallback, observations: Array32) -> Array32:
    """Commands of a policy that opens all valves: the share that the fallback leaves of them."""
    state, found = None, []
    for observation in observations:
        action, state = policy.predict(observation, state)
        found.append(action)
    return np.array(found)


def first_closed(commands: Array32, bogie: int = 0) -> float:
    """Time (s) of the first command 0; infinite if there is none."""
    closed = np.flatnonzero(commands[:, bogie] == 0.0)
    return math.inf if not len(closed) else PERIOD * closed[0]


def test_a_sine_trips_at_its_threshold(interface):
    """The filter passes f_0, and the RMS of a sine is its amplitude over the square root of 2."""
    limits, made = load_safe(), interface()
    edge = math.sqrt(2.0) * limits.trip * made.acceleration_limit
    for factor, trips in ((0.97, False), (1.03, True)):
        commands = shares(SafeFallback(Open(made)), waves(made, factor * edge, 10.0))
        assert math.isfinite(first_closed(commands)) == trips, factor


def test_a_sine_trips_in_the_time_of_its_closed_form(interface):
    """e(t) = a^2 / 2 (1 - exp(-t / tau)) reaches the square of the threshold at tau ln(1 / (1 - 1 / f^2)).

    The band-pass adds its group delay: of a Butterworth band of half width 2 Hz and order n per flank about
    n / (2 pi 2 Hz), less than half a second.
    """
    limits, made = load_safe(), interface()
    edge = math.sqrt(2.0) * limits.trip * made.acceleration_limit
    for factor in (1.5, 2.0, 4.0):
        expected = limits.smoothing * math.log(1.0 / (1.0 - factor**-2))
        found = first_closed(shares(SafeFallback(Open(made)), waves(made, factor * edge, 4.0)))
        assert expected - 0.05 <= found <= expected + 0.5, factor


def test_features_bring_the_rms(interface, observe):
    made = interface(observation="features")
    limit = load_safe().trip * made.acceleration_limit
    policy = SafeFallback(Open(made))
    for factor, command in ((0.99, 1.0), (1.01, 0.0)):
        readings = {"acceleration_rms.rear": factor * limit, "acceleration_rms.front": 0.2, "speed": 80.0}
        assert policy.predict(observe(made, readings))[0].tolist() == [1.0, command]


def test_it_lets_go_after_the_hold_and_not_before(interface):
    """Calm below the release threshold for the whole hold; then the command comes back as a ramp."""
    limits, made = load_safe(), interface(observation="features")
    loud = 1.1 * limits.trip * made.acceleration_limit
    between = 0.5 * (limits.trip + limits.release) * made.acceleration_limit
    hold, reopening = (round(t / PERIOD) for t in (limits.hold, limits.reopening))
    levels = [loud, *[between] * 1000, *[0.2] * (hold + reopening)]
    column = [made.index(f"acceleration_rms.front.{point}") for point in ("leading", "trailing")]
    rows = np.zeros((len(levels), len(made.signals)), dtype=np.float32)
    rows[:, made.index("speed")] = 80.0
    rows[:, column] = np.array(levels, dtype=np.float32)[:, None]
    commands = shares(SafeFallback(Open(made)), rows)
    calm = 1001
    assert np.all(commands[: calm + hold - 1, 0] == 0.0)
    ramp = np.minimum(1.0, np.arange(1, reopening + 2) / reopening)
    np.testing.assert_allclose(
        commands[calm + hold - 1 :, 0], ramp[: len(levels) - calm - hold + 1], rtol=1e-6
    )
    assert np.all(commands[:, 1] == 1.0)


def test_hunting_again_doubles_the_hold(interface):
    """What hunts as soon as it is open is closed for 1, 2, 4, ... holds, up to the longest one."""
    made = interface(observation="features")
    policy = SafeFallback(Open(made), hold=0.1, longest_hold=0.5, reopening=0.02)
    column = [made.index(f"acceleration_rms.front.{point}") for point in ("leading", "trailing")]
    row = np.zeros(len(made.signals), dtype=np.float32)
    row[made.index("speed")] = 80.0
    command, state, closed = 1.0, None, []
    for _ in range(300):
        row[column] = 5.0 if command == 1.0 else 0.0
        action, state = policy.predict(row.copy(), state)
        command = float(action[0])
        closed.append(command == 0.0)
    edges = np.flatnonzero(np.diff(np.array([0, *closed, 0])))
    lengths = edges[1::2] - edges[::2]
    assert [round(PERIOD * n, 2) for n in lengths[:4]] == [0.1, 0.2, 0.4, 0.5]


MOTION = {
    "lateral_acceleration": (0.0, 1.0, 3.0),
    "longitudinal_acceleration": (0.0, 1.0, 3.0),
    "pressure": (12e5, 4e5, 60e5),
    "stroke": (0.0, 2e-3, 6e-3),
}
"""Mean and amplitude of what `waves` makes of a quantity, and a bias: twice what is allowed."""


@pytest.mark.parametrize(
    ("signal", "kind"),
    [
        ("lateral_acceleration.front.trailing", "lateral_acceleration"),
        ("longitudinal_acceleration.front.left", "longitudinal_acceleration"),
        ("pressure_a.front.left.upper", "pressure"),
        ("stroke.front.right.lower", "stroke"),
    ],
)
@pytest.mark.parametrize("fault", ["dead", "frozen", "biased"])
def test_a_sensor_that_fails_closes_its_bogie(interface, signal, kind, fault):
    """In the time of the closed form, by the sliding mean square of what no longer moves.

    It falls as (s + D^2) exp(-t / tau), D the step of the mean, until the twin's RMS is `ratio` times as
    large; a bias shows when (1 - exp(-t / tau)) of it exceeds `offset`. Both must last.
    """
    limits, made, begin = load_safe(), interface(), 300
    bounds, (mean, amplitude, bias) = getattr(limits, kind), MOTION[kind]

    def course(values):
        failed = values.copy()
        after = {"dead": 0.0, "frozen": values[begin], "biased": values[begin:] + bias}
        failed[begin:] = after[fault]
        return failed

    def watched(name):
        return SafeFallback(Open(made, sensors=(name,)))

    rows = waves(made, 1.0, 9.0, **{signal.replace(".", "__"): course})
    spread = 0.5 * amplitude**2
    if fault == "biased":
        # The step itself passes for noise, s + D^2 x (1 - x) with x = exp(-t / tau), if it is large enough.
        noisy = (bounds.ratio**2 - 1.0) * spread / bias**2
        share = 0.5 - math.sqrt(0.25 - noisy) if noisy < 0.25 else bounds.offset / bias
    else:
        step = mean if fault == "dead" else 0.0
        share = 1.0 - spread / (spread + step**2) / bounds.ratio**2
    expected = limits.confirmation - limits.smoothing * math.log(1.0 - share)
    commands = shares(watched(signal), rows)
    assert first_closed(commands) - PERIOD * begin == pytest.approx(expected, abs=0.15)
    assert np.all(commands[-1] == [0.0, 1.0])  # it stays, and the other bogie is left alone
    if kind != "lateral_acceleration":  # nobody reads it: nobody minds
        assert np.all(shares(watched("speed"), rows) == 1.0)


def test_a_dead_speed_closes_all(interface):
    made = interface()
    rows = waves(made, 1.0, 6.0)
    rows[200:, made.index("speed")] = 0.3
    commands = shares(SafeFallback(Open(made)), rows)
    expected = 2.0 + load_safe().confirmation
    assert [first_closed(commands, b) for b in (0, 1)] == pytest.approx([expected] * 2, abs=0.02)


def ride(interface, steps, vehicles, seed=0):
    generator = np.random.default_rng(seed)
    values = generator.normal(size=(steps, vehicles, len(interface.signals)))
    for column, signal in enumerate(interface.signals):
        kind = signal.name.partition(".")[0]
        values[:, :, column] *= {"pressure_a": 1e6, "pressure_b": 1e6, "stroke": 1e-3}.get(kind, 8.0)
        if kind == "speed":
            values[:, :, column] = np.linspace(40.0, 110.0, vehicles)
        if kind == "acceleration_rms":
            values[:, :, column] = np.abs(values[:, :, column])
        if kind == "current":
            values[:, :, column] = 0.4
    return values.astype(np.float32)


@pytest.mark.parametrize("name", ["mppt2", "skyhook-onoff", "constant:0.3"])
def test_where_nothing_trips_nothing_changes(interface, name):
    """The same bits, whatever the vehicles do, also of the state inside."""
    made = interface()
    rows = ride(made, 350, 3)
    alone, wrapped = baselines.make(name, made), SafeFallback(baselines.make(name, made), **careless())
    state, inside = None, None
    starts = np.zeros(3, dtype=bool)
    for step, row in enumerate(rows):
        starts[:] = step in (0, 200)
        expected, state = alone.predict(row, state, starts)
        found, inside = wrapped.predict(row, inside, starts)
        assert found.tobytes() == expected.tobytes()
    assert np.all(wrapped.interventions(inside) == 0.0)


@pytest.mark.parametrize("kind", ["signals", "history", "features"])
def test_many_vehicles_equal_single_ones(interface, kind):
    made = interface(observation=kind)
    rows = ride(made, 420, 3)
    if kind == "history":
        rows = np.repeat(rows[:, :, None], made.history, axis=2)
    policy = SafeFallback(Open(made), hold=0.5)
    together = shares(policy, rows)
    assert 0.0 < np.mean(together == 0.0) < 1.0
    for vehicle in range(3):
        assert np.array_equal(shares(policy, rows[:, vehicle]), together[:, vehicle])


def test_an_episode_starts_a_vehicle_afresh(interface):
    made = interface()
    rows, policy = ride(made, 500, 2), SafeFallback(baselines.make("mppt2", made), hold=0.5)
    state, found = None, []
    for step, row in enumerate(rows):
        action, state = policy.predict(row, state, np.array([step == 0, step in (0, 230)]))
        found.append(action)
    later, state = [], None
    for row in rows[230:, 1]:
        action, state = policy.predict(row, state)
        later.append(action)
    assert np.array_equal(np.array(found)[230:, 1], later)


def test_the_run_in_is_heard(interface):
    """A bogie that hunts before step 0 is closed at step 0; a policy that takes no run-in begins there."""
    made = interface()
    loud = 2.0 * math.sqrt(2.0) * load_safe().trip * made.acceleration_limit
    rows = waves(made, loud, 4.0)
    policy = SafeFallback(Open(made))
    state = policy.state_after(RunIn(rows[:, None], np.zeros(1, dtype=np.int64)))
    assert state is not None
    action, state = policy.predict(rows[-1:], state, np.zeros(1, dtype=bool))
    assert np.all(action == 0.0)
    assert state.policy == 1
    assert policy.state_after(RunIn(rows[:0, None], np.zeros(1, dtype=np.int64))) is None


@pytest.mark.parametrize(
    ("valves", "closed"), [("bogie", [1, 0]), ("damper", [1] * 4 + [0] * 4), ("vehicle", [0])]
)
def test_every_layout_of_valves(interface, observe, valves, closed):
    made = interface(observation="features", valves=valves)
    readings = {
        "acceleration_rms.rear": made.acceleration_limit,
        "acceleration_rms.front": 0.2,
        "speed": 80.0,
    }
    assert SafeFallback(Open(made)).predict(observe(made, readings))[0].tolist() == closed


def test_it_reports_how_much_it_intervenes(interface, observe):
    made = interface(observation="features")
    policy, state = SafeFallback(Open(made)), None
    for step in range(10):
        level = made.acceleration_limit if step >= 6 else 0.2
        _, state = policy.predict(observe(made, {"acceleration_rms.front": level, "speed": 80.0}), state)
    assert policy.interventions(state).tolist() == [[0.4, 0.0]]


@pytest.mark.parametrize("begin", [0, 200])
def test_readings_that_are_no_numbers_are_a_dead_sensor(interface, begin):
    """Of a client's own, where the policy inside does not mind."""
    made = interface()
    rows = waves(made, 1.0, 6.0)
    rows[begin:, made.index("lateral_acceleration.rear.leading")] = np.nan
    commands = shares(SafeFallback(Open(made)), rows)
    assert np.all(commands[-1] == [1.0, 0.0])


@pytest.mark.parametrize("inside", ["mppt2", "constant:0.3", "skyhook-onoff", "ppo"])
@pytest.mark.parametrize("missing", [np.nan, np.inf])
def test_the_policy_inside_gets_a_dead_sensor_s_zero(interface, inside, missing):
    """One behaviour for all: alone controllers refuse such a reading, and learned ones take it."""
    made = load_policy("ppo").interface if inside == "ppo" else interface()
    outcomes = []
    for value in (missing, 0.0):
        guarded, state = baselines.make(f"safe:{inside}", made), None
        generator = np.random.default_rng(5)
        for step in range(200):
            seen = generator.normal(size=made.shape).astype(np.float32)
            seen[..., made.index("speed")] = 80.0
            if step >= 50:
                seen[...] = value
            action, state = guarded.predict(seen, state)
            outcomes.append(action)
        assert np.all(action == 0.0)  # the speed is dead: the valves are closed
        assert np.all(guarded.interventions(state) > 0.0)
    assert np.array_equal(outcomes[:200], outcomes[200:])


def test_a_speed_that_is_no_number_is_a_dead_one(interface):
    made = interface()
    rows = waves(made, 1.0, 6.0)
    missing = rows.copy()
    missing[:, made.index("speed")], rows[:, made.index("speed")] = np.nan, 0.0
    commands = [shares(SafeFallback(Open(made)), each) for each in (missing, rows)]
    assert np.array_equal(*commands)
    assert np.all(commands[0][-1] == 0.0)


def test_a_sensor_that_was_dead_at_first_is_trusted_again(interface):
    made = interface()
    rows = waves(made, 1.0, 30.0)
    rows[:200, made.index("lateral_acceleration.rear.leading")] = np.nan
    commands = shares(SafeFallback(Open(made)), rows)
    assert np.all(commands[199] == [1.0, 0.0])
    assert np.all(commands[-1] == 1.0)


def test_what_cannot_be_is_refused(interface):
    made = interface()
    for act, said in (
        (lambda: SafeFallback(Open(made), trip=0.1), "release 0.4 must be below trip 0.1"),
        (lambda: SafeFallback(Open(made), tripp=0.1), "unknown key 'tripp', did you mean 'trip'"),
        (lambda: SafeFallback(SafeFallback(Open(made))), "is a fallback already"),
        (lambda: SafeFallback(object()), "no attribute 'interface'"),
        (
            lambda: SafeFallback(Open(made)).predict(np.zeros(made.shape, np.float32), object()),
            "state: found .*; expected what the last call returned",
        ),
        (lambda: SafeFallback(Open(interface(control_period=0.05))), "50 ms is too long"),
        (lambda: baselines.make("safe:nobody", made), "policy 'nobody': unknown"),
        (lambda: SafeFallback(Open(made)).predict(np.zeros(3)), "found an observation of shape"),
    ):
        with pytest.raises(ConfigError, match=said):
            act()


def test_a_name_says_it_everywhere(interface):
    made = interface()
    policy = baselines.make("safe:mppt2", made, k_J=0.1)
    assert isinstance(policy, SafeFallback)
    assert (policy.name, policy.policy.parameters.k_J) == ("safe:mppt2", 0.1)
    assert baselines.make("safe:constant:0.3", made).policy.name == "constant"
