"""Measure the simulator: speed, cost of a step by part, and SciPy's integrators at equal accuracy."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from sayd_env.config import StudyError
from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig, load_sayd
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.units import Array
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.parts import repeat, repeat_sayds
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.physics.step import rates

METHODS = ("RK45", "DOP853")
"""SciPy's integrators that compete; the fastest that is accurate enough is reported. LSODA and the implicit
ones take more than ten times as long: they build a dense Jacobian of nearly 300 columns by differences."""
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
"""Relative tolerances that are tried, the loosest first."""
TIGHT = ("DOP853", 1e-6)
"""Method and tolerance of the solution that all are compared with."""
SCALES = (1e-3, 1e-1, 1e4)
"""Absolute tolerances over relative ones: displacements (m, rad), velocities (1/s), damper forces (N)."""
CALLS = 1000
"""Evaluations over which the time of one is taken."""
SETTLING = 1.0
"""Time that a vehicle runs before the parts of its step are measured (s)."""


@dataclass(frozen=True)
class Reference:
    """SciPy's integrator of equal accuracy."""

    method: str
    tolerance: float
    """Relative tolerance."""
    error: float
    """Relative RMS difference of the bogie frames' lateral displacement from a tight solution."""
    step_error: float
    """The same of our own time step."""
    evaluations: int
    """Evaluations of the right-hand side over the span."""
    call_us: float
    """Time of one evaluation, called from Python (us)."""
    span: float
    """Simulated time (s)."""


def with_dampers(scenario: Scenario) -> tuple[Scenario, Scenario]:
    """The scenario with passive and with semi-active yaw dampers; what it lacks is the packaged kind."""
    passive = scenario.damper if isinstance(scenario.damper, PassiveDamperConfig) else load_scenario().damper
    semi = scenario.damper if isinstance(scenario.damper, SaydDamperConfig) else load_sayd("sayd")
    return (
        scenario.model_copy(update={"damper": passive}),
        scenario.model_copy(update={"damper": semi}),
    )


def realtime_factor(
    vehicles: Simulator | BatchSimulator,
    span: float,
    count: int = 1,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Simulated seconds of so many vehicles together over the seconds of a clock: by default wall time."""
    model = vehicles.model if isinstance(vehicles, Simulator) else vehicles.simulators[0].model
    samples = samples_of(model, span)
    begin = clock()
    vehicles.advance(samples)
    return count * span / (clock() - begin)


def samples_of(model: VehicleModel, span: float) -> int:
    """Samples in a time (s)."""
    return round(span * model.scenario.assessment.sample_rate)


class PartTimer:
    """Times the parts of the step of a vehicle that has run for a while.

    Parameters
    ----------
    simulator : Simulator
        The vehicle; it runs on for a while here.
    evaluations : int
        Evaluations in one measurement.
    sayds : bool
        Time its semi-active dampers, the parts `SAYD_PARTS`, instead of `PARTS`.
    """

    def __init__(self, simulator: Simulator, evaluations: int, *, sayds: bool = False) -> None:
        self.simulator, self.evaluations, self.sayds = simulator, evaluations, sayds
        # The semi-active dampers' mounts are stiff: their two instants are a sample apart.
        sample = 1.0 / simulator.model.scenario.assessment.sample_rate
        states = [self._moved(SETTLING), self._moved(sample if sayds else 0.05)]
        self.q, self.v = (np.array([s[k] for s in states]) for k in range(2))

    def _moved(self, span: float) -> tuple[Array, Array]:
        self.simulator.advance(samples_of(self.simulator.model, span))
        return self.simulator.state.q.copy(), self.simulator.state.v.copy()

    def microseconds(self, part: int) -> float:
        """Processor time of one evaluation of a part, by its place in `PARTS` or `SAYD_PARTS` (us)."""
        s, count = self.simulator, self.evaluations
        s.work.f[:] = 0.0  # it sums up whatever a part adds
        begin = time.thread_time()
        if self.sayds:
            repeat_sayds(part, count, s.plant, s.state, s.work, self.q)
        else:
            repeat(part, count, s.plant, s.state, s.work, self.q, self.v)
        return 1e6 * (time.thread_time() - begin) / count


def measuring_rows(model: VehicleModel) -> Array:
    """Rows (w, n) that give the bogie frames' lateral displacement above the wheelsets."""
    return np.array([row for _, row in model.multibody.measuring_points])


class FirstOrder:
    """The vehicle as a system of first order for SciPy, from rest, over a span (s)."""

    def __init__(self, model: VehicleModel, speed: float, span: float) -> None:
        self.simulator = Simulator(model, speed, seed=0)
        self.n, self.m = model.multibody.n, len(model.dampers)
        self.start = float(self.simulator.state.clock[1])
        rate = model.scenario.assessment.sample_rate
        self.times = np.arange(1, samples_of(model, span) + 1) / rate
        self.evaluations = 0

    def __call__(self, t: float, s: Array) -> Array:
        """Time derivative of displacements, velocities and damper forces."""
        n, run = self.n, self.simulator
        self.evaluations += 1
        out = np.empty(len(s))
        rates(run.plant, self.start + run.speed * t, s[:n], s[n : 2 * n], s[2 * n :], run.work, out)
        return out

    def solve(self, method: str, tolerance: float) -> tuple[Array, float]:
        """Lateral displacements of the bogie frames above the wheelsets, (t, w), and the wall time (s).

        Raises
        ------
        StudyError
            The integrator gave up.
        """
        scales = np.repeat(SCALES, [self.n, self.n, self.m])
        initial, span = np.zeros(len(scales)), (0.0, self.times[-1])
        begin = time.perf_counter()
        solution = solve_ivp(
            self, span, initial, method, t_eval=self.times, rtol=tolerance, atol=tolerance * scales
        )
        elapsed = time.perf_counter() - begin
        if not solution.success:
            raise StudyError(f"scipy's {method} at rtol {tolerance:g}: {solution.message}")
        return solution.y[: self.n].T @ measuring_rows(self.simulator.model).T, elapsed


def match_accuracy(model: VehicleModel, speed: float, span: float) -> Reference:
    """Find SciPy's fastest integration that is at least as accurate as our time step.

    Accuracy is the RMS difference of the bogie frames' lateral displacement above the wheelsets from a tight
    solution, over its RMS. Of each method the loosest tolerance that is as good as our step competes.

    Raises
    ------
    StudyError
        No method is as accurate at any tolerance that is tried.
    """
    exact, _ = FirstOrder(model, speed, span).solve(*TIGHT)
    own = Simulator(model, speed, seed=0).advance(samples_of(model, span), motion=True).motion
    step_error = _difference(own @ measuring_rows(model).T, exact)
    candidates: list[tuple[float, Reference]] = []
    for method in METHODS:
        for tolerance in TOLERANCES:
            system = FirstOrder(model, speed, span)
            motion, elapsed = system.solve(method, tolerance)
            error = _difference(motion, exact)
            if error <= step_error:
                count = system.evaluations
                call = 1e6 * _call_time(system)
                candidates.append(
                    (elapsed, Reference(method, tolerance, error, step_error, count, call, span))
                )
                break
    if not candidates:
        raise StudyError(f"no scipy integrator came as near as {step_error:.1e} to the tight solution")
    return min(candidates, key=lambda c: c[0])[1]


def _difference(motion: Array, exact: Array) -> float:
    return float(np.sqrt(np.mean((motion - exact) ** 2) / np.mean(exact**2)))


def _call_time(system: FirstOrder) -> float:
    state = np.repeat(1e-2 * np.array(SCALES), [system.n, system.n, system.m])
    begin = time.perf_counter()
    for _ in range(CALLS):
        system(0.0, state)
    return (time.perf_counter() - begin) / CALLS
