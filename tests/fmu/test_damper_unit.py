"""The damper as a unit: valid, without Python, and the same damper as the vehicle's."""

from __future__ import annotations

import math
import re
import subprocess
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from sayd_env.config.damper import EqualPercentageThrottle, SaydDamperConfig, load_sayd
from sayd_env.config.units import Array
from sayd_env.physics import sayd
from sayd_env.physics.plant import LANES

STEP = 5e-4
CONTINUED, REACHED = 1, 2


def motion(t: Array) -> dict[str, Array]:
    """Both ends, from rest, 4 mm and 1 mm; the valve opens by and by."""
    r = np.minimum(t / 0.1, 1.0)
    fade, rate = r * r * (3.0 - 2.0 * r), 60.0 * r * (1.0 - r)
    columns = {}
    for end, amplitude, omega in (("1", 4e-3, 2 * np.pi * 3.0), ("2", 1e-3, 2 * np.pi * 7.0)):
        columns[f"x_{end}"] = amplitude * fade * np.sin(omega * t)
        columns[f"v_{end}"] = amplitude * (rate * np.sin(omega * t) + fade * omega * np.cos(omega * t))
    return {**columns, "current": 0.05 + 0.25 * np.floor(t / 0.1)}


def simulated(unit: Path, t: Array, start: dict[str, Any]) -> Any:
    """Outputs at times t by FMPy: a step's inputs are those at its start, and the ends go on from there."""
    inputs = np.rec.fromarrays([t, *motion(t).values()], names=["time", *motion(t)])
    return fmpy.simulate_fmu(
        str(unit),
        start_time=0.0,
        stop_time=t[-1],
        step_size=t[1],
        output_interval=t[1],
        input=inputs,
        start_values=start,
    )


def integrated(config: SaydDamperConfig, t: Array) -> Array:
    """F_1, F_2, p_A, p_B and stroke (t, 5) by the vehicle's own damper, the ends going on likewise."""
    step = t[1]
    arrays, ends = sayd.sayd_arrays(config, step), motion(t)
    state, inputs = sayd.rest(config), np.zeros(sayd.INPUTS * LANES)
    rows, given = state.reshape(-1, LANES), inputs.reshape(-1, LANES)
    line = np.full(sayd.line_length(config, step) * LANES, config.current)
    states = [rows[:, 0].copy()]
    for n in range(len(t) - 1):
        for x, v, old, end in (
            (sayd.END_1, sayd.RATE_1, sayd.OLD_RATE_1, "1"),
            (sayd.END_2, sayd.RATE_2, sayd.OLD_RATE_2, "2"),
        ):
            now = ends[f"v_{end}"][n]
            rise = now - ends[f"v_{end}"][max(n - 1, 0)]
            given[old], given[v] = now, now + rise
            given[x] = ends[f"x_{end}"][n] + step * (now + 0.5 * rise)
        rows[sayd.COMMAND] = ends["current"][n]
        sayd.move_valves((0,), arrays.constant, line, inputs, state)
        sayd.integrate((0,), step, arrays.substeps, arrays.constant, arrays.table, inputs, state)
        states.append(rows[:, 0].copy())
    return np.array(states)[:, [sayd.FORCE_1, sayd.FORCE_2, sayd.PRESSURE_A, sayd.PRESSURE_B, sayd.STROKE]]


def columns(found: Any) -> Array:
    return np.stack([found[name] for name in ("F_1", "F_2", "p_A", "p_B", "stroke")], axis=1)


def changed(**sections: Any) -> SaydDamperConfig:
    config = load_sayd("sayd-estimate")
    updates = {
        key: getattr(config, key).model_copy(update=value) if isinstance(value, dict) else value
        for key, value in sections.items()
    }
    return config.model_copy(update=updates)


def test_units_are_valid(damper_units: list[Path]) -> None:
    assert [validate_fmu(str(unit)) for unit in damper_units] == [[], []]


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize("step", [STEP, 3e-4])
def test_forces_are_those_of_our_own_integration(damper_units: list[Path], version: int, step: float) -> None:
    t = step * np.arange(round(0.3 / step) + 1)
    own = integrated(load_sayd("sayd-estimate"), t)
    found = columns(simulated(damper_units[version], t, {}))
    assert np.max(np.abs(found - own) / np.max(np.abs(own), axis=0)) < 1e-6
    assert np.max(np.abs(own[:, 0])) > 5e3


def test_parameters_are_those_of_the_configuration(damper_units: list[Path]) -> None:
    t = STEP * np.arange(601)
    other = changed(
        rod_mass=6.0,
        bogie_mount={"stiffness": 2e7},
        friction={"stiction": 50.0, "sliding": 40.0},
        oil={"bulk_modulus": 7e8},
        bleed=0.0,
        valve={"delay": 0.0117, "damping_ratio": 0.7, "rate": 5.0},
    )
    start = {
        "rod_mass": 6.0,
        "bogie_mount.stiffness": 2e7,
        "friction.stiction": 50.0,
        "friction.sliding": 40.0,
        "oil.bulk_modulus": 7e8,
        "bleed": 0.0,
        "valve.delay": 0.0117,
        "valve.damping_ratio": 0.7,
        "valve.rate": 5.0,
    }
    own = integrated(other, t)
    found = columns(simulated(damper_units[0], t, start))
    assert np.max(np.abs(found - own) / np.max(np.abs(own), axis=0)) < 1e-6


def lsoda(config: SaydDamperConfig, t: Array, current: float) -> Array:
    """F_1 and F_2 (t, 2) of eq. (1) to (24), written out anew, by SciPy's LSODA.

    Friction is eq. (11) but for 10 um/s about standstill, where it rises steadily.
    """
    c, oil, throttle, check = config.cylinder, config.oil, config.throttle, config.rectifier
    assert isinstance(throttle, EqualPercentageThrottle)
    area = throttle.closed_area * throttle.ratio**current
    square = 0.5 * throttle.density / (throttle.discharge * area) ** 2
    dead = 0.25 * math.pi * c.bore**2
    v_a, v_b = (0.5 * c.stroke * c.area + dead * length for length in (c.dead_length_a, c.dead_length_b))
    one, two = config.bogie_mount, config.carbody_mount

    def valve(v: Any, drop: float) -> float:
        if drop < v.opening:
            return 0.0
        partial = math.sqrt(v.full / v.nominal_drop) * (drop - v.opening) / (v.full - v.opening)
        return float(v.nominal_flow * (partial if drop <= v.full else math.sqrt(drop / v.nominal_drop)))

    def series(drop: float) -> float:
        wide = check.nominal_flow * math.sqrt(check.full / check.nominal_drop)
        linear, over = 2.0 * (check.full - check.opening) / wide, drop - 2.0 * check.opening
        if over <= 0.0:
            return 0.0
        q = 2.0 * over / (linear + math.sqrt(linear**2 + 4.0 * square * over))
        return (
            q if q <= wide else math.sqrt(drop / (square + 2.0 * check.nominal_drop / check.nominal_flow**2))
        )

    def forces(time: float, y: Array) -> tuple[float, float]:
        ends = {name: float(x[0]) for name, x in motion(np.array([time])).items()}
        return (
            one.stiffness * (ends["x_1"] - y[0]) + one.damping * (ends["v_1"] - y[1]),
            two.stiffness * (ends["x_2"] - y[2]) + two.damping * (ends["v_2"] - y[3]),
        )

    def rates(time: float, y: Array) -> list[float]:
        f_1, f_2 = forces(time, y)
        slip, (p_a, p_b) = y[1] - y[3], y[4:]
        inner = c.area * (p_a - p_b) - config.friction.sliding * math.tanh(slip / 1e-5)
        through = math.copysign(series(abs(p_a - p_b)), p_a - p_b)
        tank = [
            valve(config.suction, -over) - valve(config.relief, over) - config.bleed * over
            for over in (p_a - oil.tank_pressure, p_b - oil.tank_pressure)
        ]
        q_a, q_b = tank[0] - through - c.area * slip, tank[1] + through + c.area * slip
        stroke = y[0] - y[2]
        return [
            y[1],
            (inner + f_1) / config.rod_mass,
            y[3],
            (f_2 - inner) / config.housing_mass,
            oil.bulk_modulus
            / (v_a + c.area * stroke)
            * (q_a if p_a > oil.vapour_pressure else max(q_a, 0.0)),
            oil.bulk_modulus
            / (v_b - c.area * stroke)
            * (q_b if p_b > oil.vapour_pressure else max(q_b, 0.0)),
        ]

    y = np.array([0.0, 0.0, 0.0, 0.0, oil.tank_pressure, oil.tank_pressure])
    done = solve_ivp(rates, (0.0, t[-1]), y, "LSODA", t, rtol=1e-7, atol=[1e-10] * 4 + [1.0] * 2)
    assert done.success
    return np.array([forces(time, state) for time, state in zip(t, done.y.T, strict=True)])


@pytest.mark.parametrize("current", [0.0, 0.4])
def test_forces_are_those_of_lsoda(
    damper_units: list[Path], current: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.5 % of the RMS, as a tool uses it: the inputs of a step are those at its start."""
    whole = motion
    monkeypatch.setitem(globals(), "motion", lambda t: {**whole(t), "current": np.full_like(t, current)})
    t = STEP * np.arange(1001)
    config = changed(current=current)
    found = columns(simulated(damper_units[0], t, {"motion": CONTINUED, "current": current}))[:, :2]
    expected = lsoda(config, t, current)
    error = np.sqrt(np.mean((found - expected) ** 2, axis=0) / np.mean(expected**2, axis=0))
    assert np.all(error < 5e-3), error


def test_steps_of_any_length_give_the_same(damper_units: list[Path]) -> None:
    """Random steps of 0.05 to 2 ms beside even ones of 0.1 ms: 1 % of the RMS, delay line included."""
    rng = np.random.default_rng(0)
    times = np.r_[0.0, np.cumsum(rng.choice([5e-5, 1e-4, 5e-4, 1e-3, 2e-3], 700))]
    times = times[times <= 0.4]
    t = 1e-4 * np.arange(4001)
    with Stepped(damper_units[0], {"motion": REACHED}) as unit:
        even = [0.0, *(unit.step(a, b) for a, b in pairwise(t))]
    with Stepped(damper_units[0], {"motion": REACHED}) as unit:
        force = [0.0, *(unit.step(a, b) for a, b in pairwise(times))]
    error = np.array(force) - np.interp(times, t, even)
    assert np.sqrt(np.mean(error**2) / np.mean(np.square(even))) < 1e-2


class Stepped:
    """A unit in one's own loop."""

    def __init__(self, unit: Path, start: dict[str, Any]) -> None:
        self.folder = fmpy.extract(str(unit))
        about = fmpy.read_model_description(self.folder)
        self.place = {v.name: v.valueReference for v in about.modelVariables}
        self.unit = fmpy.instantiate_fmu(self.folder, about)
        self.unit.setupExperiment(startTime=0.0)
        for name, value in start.items():
            if name == "motion":
                self.unit.setInteger([self.place[name]], [value])
            else:
                self.unit.setReal([self.place[name]], [value])
        self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()

    def step(self, a: float, b: float, shift: Mapping[str, float] = MappingProxyType({})) -> float:
        """F_1 after a step at whose end the ends arrive, each number shifted."""
        for name, (value,) in motion(np.array([b])).items():
            self.unit.setReal([self.place[name]], [value + shift.get(name, 0.0)])
        self.unit.doStep(currentCommunicationPoint=a, communicationStepSize=b - a)
        return float(self.unit.getReal([self.place["F_1"]])[0])

    def __enter__(self) -> Stepped:
        return self

    def __exit__(self, *_: object) -> None:
        self.unit.terminate()
        self.unit.freeInstance()


def test_a_moving_train_and_an_offset_change_nothing(damper_units: list[Path]) -> None:
    """Galilei: ends given in a frame at rest, 800 m along the line at 80 m/s, with a length between them."""
    t = STEP * np.arange(401)
    moving = {"motion": REACHED, "x_1": 800.7, "x_2": 800.0, "v_1": 80.0, "v_2": 80.0}
    with Stepped(damper_units[0], {"motion": REACHED}) as still, Stepped(damper_units[0], moving) as unit:
        pairs = []
        for a, b in pairwise(t):
            along = 800.0 + 80.0 * b
            shift = {"x_1": along + 0.7, "x_2": along, "v_1": 80.0, "v_2": 80.0}
            pairs.append((still.step(a, b), unit.step(a, b, shift)))
    first, second = np.array(pairs).T
    assert np.max(np.abs(first - second)) < 1e-4 * np.max(np.abs(first))


def test_saved_states_go_on_alike_also_from_bytes(damper_units: list[Path]) -> None:
    t = STEP * np.arange(201)
    with Stepped(damper_units[0], {"motion": REACHED}) as unit, Stepped(damper_units[0], {}) as other:
        for a, b in pairwise(t):
            unit.step(a, b)
        state = unit.unit.getFMUstate()
        copy = unit.unit.serializeFMUstate(state)
        further = [unit.step(a, b) for a, b in pairwise(t + t[-1])]
        unit.unit.setFMUstate(state)
        assert [unit.step(a, b) for a, b in pairwise(t + t[-1])] == further
        unit.unit.freeFMUstate(state)
        restored = other.unit.deSerializeFMUstate(copy)
        other.unit.setFMUstate(restored)
        assert [other.step(a, b) for a, b in pairwise(t + t[-1])] == further
        other.unit.freeFMUstate(restored)


def library(unit: Path, folder: Path) -> Path:
    fmpy.extract(str(unit), str(folder))
    (found,) = folder.glob("binaries/*linux*/*.so")
    return found


def test_it_needs_no_python_and_no_special_processor(damper_units: list[Path], tmp_path: Path) -> None:
    for n, unit in enumerate(damper_units):
        path = library(unit, tmp_path / str(n))
        symbols = subprocess.run(["nm", "-D", path], capture_output=True, text=True, check=True).stdout
        assert not re.search(r"\b_?(Py|numba|NRT)", symbols, re.IGNORECASE)
        needed = subprocess.run(["readelf", "-d", path], capture_output=True, text=True, check=True).stdout
        assert set(re.findall(r"\(NEEDED\).*\[(.+)\]", needed)) <= {"libc.so.6", "libm.so.6"}
        code = subprocess.run(["objdump", "-d", path], capture_output=True, text=True, check=True).stdout
        assert "xmm" in code
        assert not re.search(r"[yz]mm\d", code)


def test_a_tool_in_plain_c_runs_it_with_an_empty_environment(
    damper_units: list[Path], tmp_path: Path
) -> None:
    """Calls in and out of turn, two instances, restoring a state; the forces are those of our own damper."""
    headers = Path(fmpy.__file__).parent / "c-code"
    program = tmp_path / "host"
    source = Path(__file__).with_name("host.c")
    command = ["cc", "-std=gnu11", "-Wall", "-Werror", f"-I{headers}", source, "-o", program, "-ldl", "-lm"]
    subprocess.run(command, check=True)
    token = fmpy.read_model_description(str(damper_units[1])).guid
    done = subprocess.run(
        [program, library(damper_units[1], tmp_path), token],
        capture_output=True,
        text=True,
        env={},
        check=False,
    )
    assert done.returncode == 0, done.stdout
    t = STEP * np.arange(401)
    omega = 2.0 * np.pi * 3.0
    config = load_sayd("sayd-estimate")
    arrays = sayd.sayd_arrays(config, STEP)
    state, inputs = sayd.rest(config), np.zeros(sayd.INPUTS * LANES)
    rows, given = state.reshape(-1, LANES), inputs.reshape(-1, LANES)
    rows[[sayd.STROKE_RATE, sayd.ROD_RATE]] = given[sayd.RATE_1] = 4e-3 * omega
    line = np.full(sayd.line_length(config, STEP) * LANES, config.current)
    for time in t[1:]:
        given[sayd.OLD_RATE_1] = given[sayd.RATE_1]
        given[sayd.END_1], given[sayd.RATE_1] = (
            4e-3 * math.sin(omega * time),
            4e-3 * omega * math.cos(omega * time),
        )
        sayd.move_valves((0,), arrays.constant, line, inputs, state)
        sayd.integrate((0,), STEP, arrays.substeps, arrays.constant, arrays.table, inputs, state)
    expected = rows[[sayd.FORCE_1, sayd.FORCE_2], 0]
    assert [float(x) for x in done.stdout.split()] == pytest.approx(list(expected), rel=1e-6)
