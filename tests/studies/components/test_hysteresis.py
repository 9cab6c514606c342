"""The damper test rig against SciPy's integration, a linear damper's closed form, and claim P11."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from sayd_env.cli import main
from sayd_env.config.damper import EqualPercentageThrottle, PassiveDamperConfig, SaydDamperConfig
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.report.figures import DPI
from sayd_env.studies.components.hysteresis import (
    AMPLITUDES,
    FREQUENCIES,
    HysteresisResult,
    curve_force,
    hysteresis,
)

CURVE = ((0.0, 0.0), (0.05, 5.0e3), (0.12, 9.0e3), (0.3, 9.9e3))
STIFFNESS = 4.0e6


def with_damper(curve: tuple[tuple[float, float], ...], stiffness: float) -> Scenario:
    damper = PassiveDamperConfig(type="passive", name="trial", curve=curve, series_stiffness=stiffness)
    return load_scenario().model_copy(update={"damper": damper})


@pytest.fixture(scope="module")
def result() -> HysteresisResult:
    return hysteresis(with_damper(CURVE, STIFFNESS))


def integrated(amplitude: float, frequency: float) -> tuple[float, float]:
    """Energy (J) and peak force (N) of a steady cycle by LSODA: F' = k (x' - w), curve(w) = F."""
    v, f = np.array(CURVE).T
    slope = (v[-1] - v[-2]) / (f[-1] - f[-2])
    omega = 2.0 * np.pi * frequency

    def rate(t: float, y: np.ndarray) -> list[float]:
        size = abs(y[0])
        piston = np.interp(size, f, v) if size <= f[-1] else v[-1] + slope * (size - f[-1])
        velocity = amplitude * omega * np.cos(omega * t)
        return [STIFFNESS * (velocity - np.copysign(piston, y[0])), y[0] * velocity]

    period = 1.0 / frequency
    times = 8.0 * period + np.linspace(0.0, period, 2001)
    found = solve_ivp(
        rate,
        (0.0, times[-1]),
        [0.0, 0.0],
        method="LSODA",
        t_eval=times,
        rtol=1e-9,
        atol=1e-6,
        max_step=period / 50,
    )
    return float(found.y[1, -1] - found.y[1, 0]), float(np.max(np.abs(found.y[0])))


@pytest.mark.parametrize("amplitude", AMPLITUDES)
@pytest.mark.parametrize("frequency", [1.0, 4.0, 10.0])
def test_energy_and_peak_are_those_of_an_independent_integration(
    result: HysteresisResult, amplitude: float, frequency: float
) -> None:
    loop = next(x for x in result.loops if (x.amplitude, x.frequency) == (amplitude, frequency))
    energy, peak = integrated(amplitude, frequency)
    assert loop.energy == pytest.approx(energy, rel=1e-4)
    assert loop.force_peak == pytest.approx(peak, rel=1e-4)


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_linear_damper_has_maxwells_complex_stiffness(frequency: float) -> None:
    # k i omega c / (k + i omega c); the loop's area is pi Im(k*) A^2.
    viscosity, amplitude = 1.0e5, 2.0e-3
    scenario = with_damper(((0.0, 0.0), (10.0, 10.0 * viscosity)), STIFFNESS)
    (loop,) = hysteresis(scenario, [amplitude], [frequency]).loops
    dashpot = 2j * np.pi * frequency * viscosity
    stiffness = STIFFNESS * dashpot / (STIFFNESS + dashpot)
    assert loop.stiffness == pytest.approx(stiffness, rel=1e-5)
    assert loop.energy == pytest.approx(np.pi * stiffness.imag * amplitude**2, rel=1e-5)
    assert loop.force_peak == pytest.approx(abs(stiffness) * amplitude, rel=1e-5)


def test_loops_have_the_shape_of_figure_3(result: HysteresisResult) -> None:
    """Claim P11: dissipation, force limited by the curve, slope of the series stiffness."""
    assert len(result.loops) == len(AMPLITUDES) * len(FREQUENCIES)
    for loop in result.loops:
        assert loop.energy > 0.0
        assert loop.force_limit is not None
        assert loop.force_peak <= loop.force_limit
        # Without force the viscous part rests, so the spring takes the whole motion.
        assert loop.zero_force_slope == pytest.approx(STIFFNESS, rel=0.02)


def test_figure_3_goes_beyond_the_knee_of_figure_2(result: HysteresisResult) -> None:
    """A panel for each amplitude in one row, all frequencies in it, and the knee's force on both sides."""
    loops, curve = Figure(), Figure()
    for name, figure in (("loops", loops), ("curve", curve)):
        result.plots()[name](figure)
    knees = len(CURVE) - 2
    for panel in loops.axes:
        assert len(panel.lines) == len(FREQUENCIES) + 2 * knees
        assert panel.get_subplotspec().is_first_row()
    low, high = loops.axes[-1].get_ylim()
    assert low < -CURVE[1][1] / 1e3 < CURVE[1][1] / 1e3 < high
    whole, detail = curve.axes
    assert whole.lines[0].get_xdata()[-1] == pytest.approx(1e3 * CURVE[-1][0])
    points = [line for line in detail.lines if line.get_linestyle() == "None"]
    assert [len(line.get_xdata()) for line in points] == [len(FREQUENCIES)] * len(AMPLITUDES)


@pytest.mark.parametrize(("amplitudes", "currents"), [(20, 1), (11, 2), (1, 12), (3, 4), (7, 3)])
def test_many_loops_fill_a_grid(result: HysteresisResult, amplitudes: int, currents: int) -> None:
    """No picture is more than twice as high as wide, or wide as high, and none has 5,000 pixels."""
    one = result.loops[0]
    loops = [
        replace(one, amplitude=1e-3 * (i + 1), current=k / 12)
        for i in range(amplitudes)
        for k in range(currents)
    ]
    figure = Figure()
    replace(result, loops=tuple(loops)).plots()["loops"](figure)
    width, height = figure.get_size_inches()
    assert len(figure.axes) >= amplitudes * currents
    assert 0.5 <= width / height <= 2.0
    assert DPI * max(width, height) < 5000


def test_limit_is_the_curve_at_the_peak_velocity() -> None:
    damper = with_damper(CURVE, STIFFNESS).damper
    assert curve_force(damper, 0.02) == pytest.approx(2.0e3)
    assert curve_force(damper, 0.12) == pytest.approx(9.0e3)
    assert curve_force(damper, 0.5) == pytest.approx(9.9e3 + 0.2 * 5.0e3)


def test_small_and_fast_motion_sees_the_spring_alone() -> None:
    # omega c / k = 63: the storage stiffness is 1 / (1 + 1 / 63^2) of the spring's.
    (loop,) = hysteresis(with_damper(CURVE, STIFFNESS), [1e-5], [400.0]).loops
    assert loop.stiffness.real == pytest.approx(STIFFNESS, rel=5e-4)


def test_command_writes_figures_loops_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--amplitudes", "1,2", "--frequencies", "4", "--damper", "passive", "--out", str(tmp_path)]
    assert main(["hysteresis", "--json", *arguments]) == 0
    loops = json.loads(capsys.readouterr().out)["loops"]
    assert [(x["amplitude_mm"], x["frequency_hz"], x["current"]) for x in loops] == [
        (1.0, 4.0, None),
        (2.0, 4.0, None),
    ]
    assert {"force_peak_n", "energy_j", "dynamic_stiffness_n_per_m"} <= loops[0].keys()
    assert {p.name for p in tmp_path.iterdir()} == {
        "result.json",
        "figures.csv",
        "loops.csv",
        "loops.png",
        "curve.png",
    }
    with (tmp_path / "figures.csv").open() as file:
        assert len(list(csv.reader(file))) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--amplitudes", "1,x"], "--amplitudes x: expected a finite number above 0 mm"),
        (["--frequencies", "0"], "--frequencies 0: expected a finite number above 0 Hz"),
        (["--amplitudes", ""], "--amplitudes an empty place: expected a finite number above 0 mm"),
    ],
)
def test_bad_grids_are_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hysteresis", *arguments]) == 2
    assert message in capsys.readouterr().err


def series_spring(damper: SaydDamperConfig) -> float:
    """Stiffness of oil and mounts: E A^2 (1 / V_A + 1 / V_B) in series with c_b1 and c_b2."""
    c = damper.cylinder
    dead = 0.25 * np.pi * c.bore**2
    volumes = [0.5 * c.stroke * c.area + length * dead for length in (c.dead_length_a, c.dead_length_b)]
    oil = damper.oil.bulk_modulus * c.area**2 * sum(1.0 / v for v in volumes)
    return float(
        1.0 / (1.0 / oil + 1.0 / damper.bogie_mount.stiffness + 1.0 / damper.carbody_mount.stiffness)
    )


def spring_and_throttle(damper: SaydDamperConfig, amplitude: float, frequency: float) -> float:
    """In-phase stiffness (N/m) of the series spring behind the closed throttle alone, by LSODA.

    F' = k (x' - w), where the throttle passes Q = C_d a_0 sqrt(2 F / (A rho)) at the piston's w = Q / A.
    """
    throttle, area, k = damper.throttle, damper.cylinder.area, series_spring(damper)
    assert isinstance(throttle, EqualPercentageThrottle)
    gain = throttle.discharge * throttle.closed_area * np.sqrt(2.0 / (throttle.density * area)) / area
    omega, period = 2.0 * np.pi * frequency, 1.0 / frequency
    times = 8.0 * period + np.linspace(0.0, period, 2001)

    def rate(t: float, y: np.ndarray) -> list[float]:
        piston = gain * np.copysign(np.sqrt(abs(y[0])), y[0])
        return [k * (amplitude * omega * np.cos(omega * t) - piston)]

    tight = {"rtol": 1e-8, "atol": 1e-3, "max_step": period / 200}
    found = solve_ivp(rate, (0.0, times[-1]), [0.0], method="LSODA", t_eval=times, **tight)
    return float(2.0 / period * np.trapezoid(found.y[0] * np.sin(omega * times), times) / amplitude)


def test_semi_active_loops_over_current() -> None:
    """Each loop dissipates, an open valve less; no force passes the field by more than friction and inertia.

    A closed damper at 1 mm and 10 Hz works on its oil and mounts: what the loop stores is their stiffness,
    less what the closed throttle lets through.
    """
    scenario = load_scenario(overrides=["damper=sayd"])
    found = hysteresis(scenario, [1e-3, 4e-3], [1.0, 10.0], (0.0, 0.25, 1.0))
    assert [loop.current for loop in found.loops] == [0.0, 0.25, 1.0] * 4
    for loop in found.loops:
        assert loop.energy > 0.0
        assert loop.force_peak < 1.02 * loop.force_limit + 100.0
    slow = [loop.energy for loop in found.loops if (loop.amplitude, loop.frequency) == (4e-3, 1.0)]
    assert slow == sorted(slow, reverse=True)
    damper = scenario.damper
    assert isinstance(damper, SaydDamperConfig)
    closed = next(x for x in found.loops if (x.amplitude, x.frequency, x.current) == (1e-3, 10.0, 0.0))
    assert closed.stiffness.real == pytest.approx(spring_and_throttle(damper, 1e-3, 10.0), rel=0.03)
    tight = damper.model_copy(update={"throttle": damper.throttle.model_copy(update={"closed_area": 1e-9})})
    (shut,) = hysteresis(scenario.model_copy(update={"damper": tight}), [1e-3], [10.0], (0.0,)).loops
    assert shut.stiffness.real == pytest.approx(series_spring(tight), rel=0.03)


def test_semi_active_field_rises_with_velocity_and_falls_with_current() -> None:
    found = hysteresis(load_scenario(overrides=["damper=sayd"]), [1e-3], [1.0])
    assert found.field is not None
    force = found.field.force
    assert force.shape == (4, len(found.field.velocity))
    assert np.all(np.diff(force, axis=1) > 0.0)
    assert np.all(np.diff(force[:, 1:], axis=0) <= 0.0)
    assert np.all(force[0, 1:] > force[-1, 1:])
    assert found.field.as_dict()["current"] == [0.0, 0.25, 0.5, 1.0]


def test_command_draws_semi_active_loops(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    grid = ["--amplitudes", "1", "--frequencies", "4", "--current", "0,0.5"]
    assert main(["hysteresis", "--json", "--damper", "sayd", *grid, "--out", str(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [x["current"] for x in result["loops"]] == [0.0, 0.5]
    assert len(result["field"]["force_n"]) == 2
    assert (tmp_path / "field.csv").exists()
    assert (tmp_path / "loops.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--damper", "sayd", "--current", "0,1.2"], "--current 1.2: expected a number from 0 to 1"),
        (["--damper", "sayd", "--current", "nan"], "--current nan: expected a number from 0 to 1"),
        (["--damper", "passive", "--current", "0"], "damper 'passive' has no valve"),
    ],
)
def test_bad_currents_are_refused(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hysteresis", *arguments]) == 2
    assert message in capsys.readouterr().err
