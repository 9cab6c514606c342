"""The fixed time step against SciPy's LSODA and DOP853 on the same right-hand side and track.

What is compared is what is assessed: the RMS of bogie-frame acceleration and track shift force, over a common
10 s and in a fixed band. `data/time_step_reference.json` holds DOP853's RMS for the scenario in
`data/time_step_scenario.yaml`, which is frozen, so that a calibration of the packaged configurations does not
touch it; the step itself is the packaged one. After a change of the model's equations, regenerate with

    python tests/validation/test_time_step.py

which takes about ten minutes and prints the errors of several steps.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfiltfilt

from sayd_env.config import StudyError, validate
from sayd_env.config.scenario import NumericsConfig, Scenario, load_scenario
from sayd_env.config.units import Array
from sayd_env.physics import step as kernels
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.plant import FORCE_Y, WHEELSETS, Plant, Work
from sayd_env.physics.simulator import Simulator, VehicleModel

DATA = Path(__file__).parent / "data"
FROZEN = DATA / "time_step_scenario.yaml"
GOLDEN = DATA / "time_step_reference.json"
BAND = (2.0, 10.0)
"""Hz"""
START, LENGTH = 1.5, 10.0
"""The common part of each run (s); the filter settles in the second behind it."""
DURATION = START + LENGTH + 1.0
SINGLE = [(wear, speed, 1) for wear in (0.0, 1.0) for speed in (280, 320)]
HUNTING = [(1.0, speed, seed) for speed in (350, 400) for seed in range(10)]
"""Wear, speed (km/h), seed of the track."""
Case = tuple[float, int, int]


@cache
def model(wear: float, step: float | None = None) -> VehicleModel:
    """The frozen vehicle, by default with the packaged time step."""
    scenario = validate(Scenario, yaml.safe_load(FROZEN.read_text()), str(FROZEN))
    numerics = load_scenario().numerics if step is None else NumericsConfig(step=step, creep_step=1.0)
    return VehicleModel(scenario.model_copy(update={"wear": wear, "numerics": numerics}))


def simulated(cases: Sequence[Case], duration: float = DURATION, step: float | None = None) -> Array:
    """Signals (cases, t, 8) of the fixed-step simulation: accelerations and track shift forces."""
    vehicles = [Simulator(model(wear, step), speed / 3.6, seed) for wear, speed, seed in cases]
    signals = BatchSimulator(vehicles).advance(round(duration * 1e3))
    return signals[:, :, : 2 * WHEELSETS]


def reference(
    case: Case, duration: float = DURATION, method: str = "DOP853", tolerance: float = 1e-6
) -> Array:
    """Accelerations and track shift forces (t, 8) at 1 kHz by `scipy.integrate.solve_ivp`."""
    wear, speed, seed = case
    m = model(wear, 5e-4)
    run = Simulator(m, speed / 3.6, seed)
    n, dampers = m.multibody.n, len(m.dampers)
    rates = Rates(run.plant, run.work, run.state.clock[1], n)
    grid = np.arange(1, round(duration * 1e3) + 1) * 1e-3
    solution = solve_ivp(
        rates,
        (0.0, grid[-1]),
        np.zeros(2 * n + dampers),
        method=method,
        t_eval=grid,
        rtol=tolerance,
        atol=tolerance * np.repeat([1e-3, 1e-1, 1e4], [n, n, dampers]),
    )
    signals = np.array([rates.signals(t, s) for t, s in zip(grid, solution.y.T, strict=True)])
    measure = np.array([g for _, g in m.multibody.measuring_points])
    return np.hstack([signals[:, :n] @ measure.T, signals[:, n:]])


class Rates:
    """The compiled right-hand side as a function of time and state."""

    def __init__(self, plant: Plant, work: Work, start: float, n: int) -> None:
        self.plant, self.work, self.start, self.n = plant, work, start, n

    def __call__(self, t: float, s: Array) -> Array:
        n, out = self.n, np.empty(len(s))
        s = np.ascontiguousarray(s)
        position = self.start + self.plant.speed * t
        kernels.rates(self.plant, position, s[:n], s[n : 2 * n], s[2 * n :], self.work, out)
        return out

    def signals(self, t: float, s: Array) -> Array:
        """Accelerations of all unknowns, then the track shift force of each wheelset."""
        acceleration = self(t, s)[self.n : 2 * self.n]
        lateral = self.work.lane_out.reshape(-1, 2, WHEELSETS)[FORCE_Y]
        return np.concatenate([acceleration, -lateral.sum(axis=0)])


def rms(signals: Array) -> Array:
    """RMS of each column in the band over the common part."""
    filtered = sosfiltfilt(butter(4, BAND, "bandpass", fs=1e3, output="sos"), signals, axis=0)
    first = round(START * 1e3)
    return np.asarray(np.sqrt(np.mean(filtered[first : first + round(LENGTH * 1e3)] ** 2, axis=0)))


def simulated_rms(cases: Sequence[Case], step: float | None = None) -> Array:
    """RMS (cases, 8) of the fixed-step simulation."""
    return np.array([rms(signals) for signals in simulated(cases, step=step)])


def key(case: Case) -> str:
    return f"wear {case[0]:g}, {case[1]} km/h, seed {case[2]}"


def golden() -> dict[str, Array]:
    stored = json.loads(GOLDEN.read_text())["rms"]
    return {name: np.array(values) for name, values in stored.items()}


@pytest.mark.parametrize("case", SINGLE, ids=key)
def test_rms_below_hunting(case: Case) -> None:
    """Every wheelset's RMS at 280 and 320 km/h is within 0.1 % of the reference."""
    np.testing.assert_allclose(simulated_rms([case])[0], golden()[key(case)], rtol=1e-3)


@pytest.mark.parametrize("speed", [350, 400])
def test_rms_of_limit_cycles(speed: int) -> None:
    """At hunting speeds the median over ten tracks of every wheelset's RMS is within 0.2 %."""
    cases = [c for c in HUNTING if c[1] == speed]
    ours = np.median(simulated_rms(cases), axis=0)
    theirs = np.median([golden()[key(c)] for c in cases], axis=0)
    np.testing.assert_allclose(ours, theirs, rtol=2e-3)


LIVE: Case = (1.0, 350, 1)
LIVE_DURATION = 1.0


def late(signals: Array) -> Array:
    """The second half of a live run, where the hunting grows."""
    return signals[round(LIVE_DURATION * 500) :]


@pytest.fixture(scope="module")
def lsoda() -> Array:
    """LSODA at 1e-7, where it stays with Adams' method; at 1e-6 it changes to BDF and takes minutes."""
    return late(reference(LIVE, LIVE_DURATION, "LSODA", 1e-7))


def error(signals: Array, true: Array) -> Array:
    """RMS of the difference over the RMS, for each signal."""
    return np.asarray(np.sqrt(np.mean((signals - true) ** 2, axis=0) / np.mean(true**2, axis=0)))


def test_two_references_agree(lsoda: Array) -> None:
    """DOP853 and LSODA, two methods with nothing in common, give the same signals to 0.1 %."""
    assert np.max(error(late(reference(LIVE, LIVE_DURATION)), lsoda)) < 1e-3


def test_second_order(lsoda: Array) -> None:
    """Signal by signal the error against LSODA falls to a 64th with an eighth of the step.

    The order is that over three halvings. A single one scatters from 1.74 to 2.21 between signals, with the
    kinks of contact table and damper curves that fall between two steps; the reference is good to 1e-5.
    """
    steps = (5e-4, 2.5e-4, 1.25e-4, 6.25e-5)
    runs = [simulated([LIVE], LIVE_DURATION, h)[0] for h in steps]
    errors = np.array([error(late(run), lsoda) for run in runs])
    assert np.all(errors[0] < 0.03)
    assert np.all(np.diff(errors, axis=0) < 0.0)
    np.testing.assert_allclose(np.log2(errors[0] / errors[-1]) / (len(steps) - 1), 2.0, atol=0.25)


def generate() -> Iterator[tuple[Case, Array]]:
    for case in SINGLE + HUNTING:
        begin = time.perf_counter()
        yield case, rms(reference(case))
        print(f"{key(case)}: {time.perf_counter() - begin:.1f} s", flush=True)


def main() -> None:
    """Write the reference and print the errors of several steps."""
    results = {key(case): [float(f"{x:.8g}") for x in values] for case, values in generate()}
    about = "RMS of 4 accelerations (m/s2) and 4 track shift forces (N), scipy DOP853, rtol 1e-6"
    GOLDEN.write_text(json.dumps({"about": about, "rms": results}, indent=1) + "\n")
    table()


def table() -> None:
    """Print the table of docs/model.md: errors of several steps in % of the reference's RMS.

    Of the eight signals, and of a group's median over the seeds, the largest; then the group's worst seed.
    """
    cases, true = SINGLE + HUNTING, golden()
    groups = {key(case): [case] for case in SINGLE}
    groups |= {f"{n} km/h, {len(HUNTING) // 2} seeds": [c for c in HUNTING if c[1] == n] for n in (350, 400)}
    print("| step |", " | ".join(groups), "|")
    for divisor in (6, 4, 3, 2, 1):
        try:
            found = dict(zip(cases, simulated_rms(cases, 1e-3 / divisor), strict=True))
        except StudyError as failure:
            print(f"| 1/{divisor} ms | {failure} |")
            continue
        row = []
        for group in groups.values():
            ours, theirs = np.array([found[c] for c in group]), np.array([true[key(c)] for c in group])
            median = np.max(np.abs(np.median(ours, axis=0) / np.median(theirs, axis=0) - 1.0))
            worst = np.max(np.abs(ours / theirs - 1.0))
            row.append(f"{100.0 * median:.3f}" + (f", worst {100.0 * worst:.2f}" if len(group) > 1 else ""))
        print(f"| 1/{divisor} ms |", " | ".join(row), "|", flush=True)


if __name__ == "__main__":
    main()
