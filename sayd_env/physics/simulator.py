"""The Python face of the simulator: build a vehicle once, then run it at any speed on any track."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.scenario import Scenario
from sayd_env.physics.contact.geometry import ContactTable, contact_table
from sayd_env.physics.multibody import ForceElement, Multibody, assemble
from sayd_env.physics.plant import LANES, Plant, State, Work
from sayd_env.physics.profiles import rail_profile, wheel_profile
from sayd_env.physics.step import LIFT, ROWS_IN, ROWS_OUT, advance
from sayd_env.physics.track.realisation import TrackRealisation, realise

Array = npt.NDArray[np.float64]

RUN_OUT = 150.0
"""Track behind the assessed length (m): room for half a second of signal that settles the filter."""


@dataclass(frozen=True)
class Telemetry:
    """Signals of one run, one row for each sample."""

    time: Array
    """(t,) s."""
    acceleration: Array
    """(t, w) lateral acceleration of the bogie frame above each wheelset, m/s2."""
    track_shift: Array
    """(t, w) track shift force of each wheelset: sum of its wheels' lateral forces on the rails, N."""
    damper_force: Array
    """(t, d) force of each yaw damper, positive in tension, N."""
    wheel_lateral: Array
    """(t, 2 w) or (0, 2 w) lateral force of each wheel on its rail, left and right in turn, N."""
    wheel_vertical: Array
    """The same of the vertical force, N."""
    motion: Array
    """(t, n) or (0, n) displacements of all degrees of freedom, m and rad."""


class VehicleModel:
    """A scenario's vehicle, assembled, with its contact table; independent of speed and track realisation.

    Parameters
    ----------
    scenario : Scenario
        The configuration.

    Raises
    ------
    ConfigError, DataError
        A vehicle or a profile that cannot be used.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.multibody: Multibody = assemble(scenario.vehicle, scenario.track.section)
        if len(self.multibody.wheelset_x) > LANES // 2:
            raise ConfigError(
                f"{scenario.vehicle.name}: {len(self.multibody.wheelset_x)} wheelsets; at most {LANES // 2}"
            )
        if np.any(self.multibody.wheelset_dofs < 0):
            raise ConfigError(
                f"{scenario.vehicle.name}: wheel-rail contact needs all six degrees of freedom of a wheelset"
            )

    @cached_property
    def table(self) -> ContactTable:
        """Contact table of all wheels."""
        s = self.scenario
        wheel, rail = wheel_profile(s.wheel, s.wear), rail_profile(s.rail)
        return contact_table(wheel, rail, s.track.gauge, s.contact, s.vehicle.wheel_radius)

    @cached_property
    def dampers(self) -> tuple[ForceElement, ...]:
        """All Maxwell elements: the yaw dampers first, then the others of the vehicle."""
        law = self.scenario.damper
        yaw = [
            ForceElement(name, bogie - car, np.array(law.curve), law.series_stiffness)
            for name, bogie, car in self.multibody.yaw_dampers
        ]
        return (*yaw, *self.multibody.dampers)

    def check_speed(self, speed: float) -> None:
        """Refuse a speed (m/s) for which the vehicle's model does not stand.

        Raises
        ------
        ConfigError
            A speed outside the vehicle's range.
        """
        low, high = self.scenario.vehicle.speed_range
        if not low <= speed <= high:
            raise ConfigError(
                f"speed {speed * 3.6:g} km/h is outside the range of vehicle '{self.scenario.vehicle.name}': "
                f"{low * 3.6:g} to {high * 3.6:g} km/h"
            )

    def step(self, speed: float) -> tuple[float, int]:
        """Time step (s) and number of steps in a sample at a speed (m/s).

        The configured step, shortened at low speed, where the creep forces damp a wheelset at a rate of
        about 2 f_22 (1/m + r^2/I + 1/m_track) / V that an explicit scheme must resolve.

        Raises
        ------
        ConfigError
            A speed outside the vehicle's range.
        """
        self.check_speed(speed)
        numerics, sample = self.scenario.numerics, 1.0 / self.scenario.assessment.sample_rate
        longest = min(numerics.step, numerics.creep_step * speed / self._creep_rate)
        count = math.ceil(sample / longest - 1e-9)
        return sample / count, count

    @cached_property
    def _creep_rate(self) -> float:
        """Damping rate of the fastest creep mode times speed (m/s2)."""
        body, table, contact = self.multibody, self.table, self.scenario.contact
        node = int(np.argmin(np.abs(table.dy)))
        load = float(np.max(body.wheel_load))
        approach = (load / table.c_hertz[node]) ** (2.0 / 3.0)
        area = table.a_s[node] * table.b_s[node] * approach
        stiffness = 2.0 * contact.shear_modulus * area * max(table.c11[node], table.c22[node])
        radius, section = self.scenario.vehicle.wheel_radius, self.scenario.track.section
        dofs = body.wheelset_dofs[0]
        mass, roll, spin = body.mass[dofs[0]], body.mass[dofs[3]], body.mass[dofs[4]]
        lateral = 1.0 / mass + radius**2 / roll + 1.0 / section.mass
        return float(stiffness * max(lateral, 1.0 / mass + radius**2 / spin))

    def realisation(self, seed: int) -> TrackRealisation:
        """Track irregularities of a seed, long enough for an assessed run."""
        assessment = self.scenario.assessment
        if assessment.length is None:
            raise ConfigError("assessment.length: a simulation needs a distance, found null")
        length = assessment.run_in + assessment.length + RUN_OUT
        return realise(self.scenario.track.irregularity, length, seed)

    def plant(self, speed: float, track: TrackRealisation, table: ContactTable | None = None) -> Plant:
        """Constants of the compiled step at a speed (m/s) on a track, with another contact table if given."""
        h, _ = self.step(speed)
        s, b, table = self.scenario, self.multibody, table or self.table
        radius = s.vehicle.wheel_radius
        damping = b.damping + (speed / radius) * b.gyroscopic
        diagonal = np.diag(damping).copy()
        np.fill_diagonal(damping, 0.0)
        linear = _sparse_rows(b.stiffness, damping)
        connection = _sparse_rows(np.array([e.connection for e in self.dampers]).reshape(-1, b.n))
        maxwell = damper_curves(self.dampers, h)
        shift, stop = _curves(b.stops)
        approach, hunt_crossley = self._static_contact(table)
        return Plant(
            mass=b.mass,
            linear_start=linear.start,
            linear_column=linear.column,
            linear_value=np.stack(linear.values, axis=1),
            damping_diagonal=diagonal,
            mobility=1.0 / (b.mass + 0.5 * h * diagonal),
            wheelset_dofs=b.wheelset_dofs,
            section_dofs=b.section_dofs,
            wheelset_x=b.wheelset_x,
            wheel_load=b.wheel_load,
            table=np.ascontiguousarray(table.packed().ravel()),
            table_start=float(table.dy[0]),
            table_step=float(table.step),
            approach=approach,
            contact_damping=hunt_crossley,
            shear_modulus=s.contact.shear_modulus,
            friction=s.friction,
            radius=radius,
            speed=speed,
            step=h,
            damper_start=connection.start,
            damper_column=connection.column,
            damper_value=connection.values[0],
            damper_velocity=maxwell.velocity,
            damper_force=maxwell.force,
            damper_knot=maxwell.knot,
            damper_slope=maxwell.slope,
            damper_stiffness=maxwell.stiffness,
            stop_g=np.array([e.connection for e in b.stops]).reshape(-1, b.n),
            stop_shift=shift,
            stop_force=stop,
            measure=np.array([g for _, g in b.measuring_points]).reshape(-1, b.n),
            irregularity=track.coefficients,
            irregularity_start=track.x0,
            irregularity_step=track.step,
        )

    def _static_contact(self, table: ContactTable) -> tuple[Array, Array]:
        """Vertical approach under the static load and the Hunt-Crossley factor, for each wheelset."""
        load = self.multibody.wheel_load
        node = int(np.argmin(np.abs(table.dy)))
        cosine = 1.0 / math.hypot(1.0, table.tan_gamma[node])
        normal = load / cosine
        approach = (normal / table.c_hertz[node]) ** (2.0 / 3.0) / cosine
        return approach, self.scenario.contact_damping / normal

    def state(self) -> State:
        """The state at rest under the static load, the first wheelset at the start of the irregularities."""
        n, m = self.multibody.n, len(self.dampers)
        clock = np.array([0.0, -float(np.max(self.multibody.wheelset_x))])
        return State(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(m), np.zeros(m), np.zeros(m), clock)

    def work(self) -> Work:
        """Scratch memory for one vehicle."""
        n, m, w = self.multibody.n, len(self.dampers), len(self.multibody.wheelset_x)
        lanes = np.zeros(ROWS_IN * LANES)
        lanes[LIFT * LANES : (LIFT + 1) * LANES] = (
            1.0  # wheels that the vehicle does not have stay in the air
        )
        return Work(
            np.zeros(n),
            np.zeros(n),
            np.zeros((n, 2)),
            np.zeros(m),
            np.zeros((w, 8)),
            lanes,
            np.zeros(ROWS_OUT * LANES),
        )


class Simulator:
    """One vehicle that runs at constant speed on one track.

    Parameters
    ----------
    model : VehicleModel
        The vehicle; it may serve many simulators, also at the same time in several threads.
    speed : float
        Speed, m/s.
    seed : int
        Seed of the track's irregularities.
    track : TrackRealisation, optional
        A track in place of the seed's.
    table : ContactTable, optional
        A contact table in place of the model's, such as its harmonic linearisation.

    Examples
    --------
    >>> from sayd_env.config.scenario import load_scenario
    >>> model = VehicleModel(load_scenario())
    >>> telemetry = Simulator(model, speed=280 / 3.6, seed=0).advance(100)
    >>> telemetry.acceleration.shape
    (100, 4)
    """

    def __init__(
        self,
        model: VehicleModel,
        speed: float,
        seed: int = 0,
        *,
        track: TrackRealisation | None = None,
        table: ContactTable | None = None,
    ) -> None:
        self.model = model
        self.speed = speed
        self.track = model.realisation(seed) if track is None else track
        self.plant = model.plant(speed, self.track, table)
        self.state = model.state()
        self.work = model.work()

    @property
    def channels(self) -> int:
        """Number of signals that every sample has: those of `sayd_env.physics.step.record`."""
        body = self.model.multibody
        return 2 * len(body.wheelset_x) + len(body.yaw_dampers)

    def divergence(self) -> str:
        """What to tell of a run that ended early."""
        when = f"after {self.state.clock[0]:.2f} s"
        if np.all(np.isfinite(self.state.q)):
            return f"derailment at {self.speed * 3.6:g} km/h {when}: a wheel has climbed beyond the contact table"
        return (
            f"the simulation at {self.speed * 3.6:g} km/h diverged {when}; a smaller numerics.step may help"
        )

    def advance(self, samples: int, *, wheels: bool = False, motion: bool = False) -> Telemetry:
        """Run on for a number of samples and return their signals.

        Parameters
        ----------
        samples : int
            Number of samples at the scenario's sample rate.
        wheels, motion : bool
            Also record the wheel-rail forces and the displacements of all degrees of freedom.

        Raises
        ------
        StudyError
            The state did not stay finite.
        """
        h, substeps = self.model.step(self.speed)
        w = len(self.model.multibody.wheelset_x)
        start = self.state.clock[0]
        signals = np.empty((samples, self.channels))
        forces = np.empty((samples if wheels else 0, 2 * LANES))
        motions = np.empty((samples if motion else 0, self.model.multibody.n))
        done = advance(self.plant, self.state, self.work, substeps, signals, forces, motions)
        if done < samples:
            raise StudyError(self.divergence())
        return Telemetry(
            time=start + h * substeps * np.arange(1, samples + 1),
            acceleration=signals[:, :w],
            track_shift=signals[:, w : 2 * w],
            damper_force=signals[:, 2 * w :],
            wheel_lateral=forces[:, : 2 * w],
            wheel_vertical=forces[:, LANES : LANES + 2 * w],
            motion=motions,
        )

    def run(self, distance: float, *, wheels: bool = False, motion: bool = False) -> Telemetry:
        """Run over a distance (m) and return the signals."""
        samples = math.ceil(distance / self.speed * self.model.scenario.assessment.sample_rate)
        return self.advance(samples, wheels=wheels, motion=motion)


def threads(workers: int | None) -> ThreadPoolExecutor:
    """Pool for many simulators at once: compiled code and SciPy's filters run outside Python's lock."""
    return ThreadPoolExecutor(max_workers=workers, thread_name_prefix="sayd")


class _Rows(NamedTuple):
    """Several matrices of one pattern as compressed sparse rows."""

    start: npt.NDArray[np.uint32]
    column: npt.NDArray[np.uint32]
    values: tuple[Array, ...]


def _sparse_rows(*matrices: Array) -> _Rows:
    pattern = csr_matrix(np.any([m != 0.0 for m in matrices], axis=0))
    start, column = pattern.indptr.astype(np.uint32), pattern.indices.astype(np.uint32)
    row = np.repeat(np.arange(pattern.shape[0]), np.diff(start))
    return _Rows(start, column, tuple(m[row, column] for m in matrices))


class DamperCurves(NamedTuple):
    """Laws of m Maxwell dampers as the compiled step reads them, p points each."""

    velocity: Array
    """(p, m) abscissae of the force-velocity curves, m/s."""
    force: Array
    """(p, m) ordinates F, N."""
    knot: Array
    """(p, m) F + k h / 2 v at these points, N."""
    slope: Array
    """(p, m) dv / d(F + k h / 2 v) behind each point, m/(N s)."""
    stiffness: Array
    """(m,) series stiffness k, N/m."""


def damper_curves(elements: tuple[ForceElement, ...], h: float) -> DamperCurves:
    """Prepare Maxwell dampers for `sayd_env.physics.step.step_dampers` at a time step h (s)."""
    stiffness = np.array([e.series_stiffness for e in elements])
    velocity, force = _curves(elements)
    knot = force + 0.5 * h * stiffness * velocity
    return DamperCurves(velocity, force, knot, _slopes(velocity, knot), stiffness)


def _slopes(x: Array, y: Array) -> Array:
    """Slope dx/dy behind each point of a curve; the last goes on."""
    slope = np.diff(x, axis=0) / np.diff(y, axis=0)
    return np.vstack([slope, slope[-1:]])


def _curves(elements: tuple[ForceElement, ...]) -> tuple[Array, Array]:
    """Piecewise-linear curves on a common number of points: the last segment goes on."""
    count = max((len(e.curve) for e in elements), default=2)
    x, y = np.zeros((count, len(elements))), np.zeros((count, len(elements)))
    for k, element in enumerate(elements):
        points = element.curve
        more = np.arange(1, count - len(points) + 1)[:, None] * (points[-1] - points[-2])
        x[:, k], y[:, k] = np.vstack([points, points[-1] + more]).T
    return x, y
