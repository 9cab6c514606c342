"""The Python face of the simulator: build a vehicle once, then run it at any speed on any track."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.conditions import Rails
from sayd_env.config.contact import ContactConfig
from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.profile import RailProfileConfig, WheelProfileConfig, sides
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array
from sayd_env.measured.dampers import force_velocity
from sayd_env.physics import plant as at
from sayd_env.physics import sayd
from sayd_env.physics.aligned import aligned, zeros
from sayd_env.physics.contact import creep, geometry
from sayd_env.physics.contact.geometry import ContactTable, cached_contact_table
from sayd_env.physics.layout import Arrangement
from sayd_env.physics.line import CENTRE_ROWS, LineTable, body_arrays
from sayd_env.physics.multibody import ForceElement, Multibody, assemble
from sayd_env.physics.plant import LANES, WHEELSETS, Plant, State, Work
from sayd_env.physics.profiles import Profile, blended, file_contents, rail_profile, wheel_profile
from sayd_env.physics.rows import Column, Rows, sparse_rows
from sayd_env.physics.step import advance
from sayd_env.physics.track.realisation import TrackRealisation, realise

SHORTEST_STEP = 1e-6
"""s; shorter steps than numerics.step may have are not taken: a run of them would have no end."""
FASTEST = 50.0
"""No part of a vehicle moves faster against the running train (m/s, rad/s): beyond it, numbers do."""

LOAD_STEP = 5e3
"""Step (N) of the wheel loads for which contact tables are made, so that vehicles share them.

Half a step off, at 60 kN, the regularisation is that of a penetration 3 % off: contacts move by 0.03 mm
(RMS over 7 mm of shift; 0.26 mm in the middle of a worn wheel's jump).
"""

BLENDS = 5
"""Contact tables of rails between two profiles, from the first to the second."""

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
    sayds: Array
    """(t, STATES, d) or (0, STATES, d) states of the semi-active dampers by the rows of `physics.sayd`."""


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
        if len(self.multibody.yaw_dampers) > LANES:
            raise ConfigError(
                f"{scenario.vehicle.name}: {len(self.multibody.yaw_dampers)} yaw dampers; at most {LANES}"
            )
        if np.any(self.multibody.wheelset_dofs < 0):
            raise ConfigError(
                f"{scenario.vehicle.name}: wheel-rail contact needs all six degrees of freedom of a wheelset"
            )

    @cached_property
    def table(self) -> ContactTable:
        """Contact table of the left wheels; of all wheels where both sides are alike."""
        return self._table(0)

    @cached_property
    def right_table(self) -> ContactTable | None:
        """Contact table of the right wheels, read at minus their shift; None where both sides are alike."""
        return self._table(1) if self._sides[1] != self._sides[0] else None

    @property
    def _sides(self) -> tuple[Side, Side]:
        return sides(self.scenario.wheel, self.scenario.rail)

    def _table(self, side: int) -> ContactTable:
        s, load = self.scenario, table_load(self.multibody.wheel_load)
        own, other = self._sides[side], self._sides[1 - side]
        further = None if own == other else other
        files = tuple(file_contents(profile) for profile in (*own, *(further or ())))
        radius = s.vehicle.wheel_radius
        return _contact_table(own, further, s.wear, s.track.gauge, s.contact, radius, load, files)

    @property
    def creep_table(self) -> Array:
        """What the creep law reads as its table."""
        contact = self.scenario.contact
        return creep.law_table(contact.creep_law, contact.poisson_ratio)

    @cached_property
    def dampers(self) -> tuple[ForceElement, ...]:
        """All Maxwell elements: the yaw dampers first, if passive, then the others of the vehicle."""
        law = self.scenario.damper
        if not isinstance(law, PassiveDamperConfig):
            return self.multibody.dampers
        curve = force_velocity(law)
        yaw = [
            ForceElement(name, bogie - car, curve, law.series_stiffness)
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
                f"speed {speed * KMH:g} km/h is outside the range of vehicle '{self.scenario.vehicle.name}': "
                f"{low * KMH:g} to {high * KMH:g} km/h"
            )

    def step(self, speed: float) -> tuple[float, int]:
        """Time step (s) and number of steps in a sample at a speed (m/s).

        The configured step, shortened at low speed, where the creep forces damp a wheelset at a rate of
        about 2 f_22 (1/m + r^2/I + 1/m_track) / V that an explicit scheme must resolve.

        Raises
        ------
        ConfigError
            A speed outside the vehicle's range, or masses so small that the step would have no end.
        """
        self.check_speed(speed)
        numerics, sample = self.scenario.numerics, 1.0 / self.scenario.assessment.sample_rate
        longest = min(numerics.step, numerics.creep_step * speed / self._creep_rate)
        if not longest >= SHORTEST_STEP:
            raise ConfigError(
                f"vehicle '{self.scenario.vehicle.name}': creep forces on so small masses of a wheelset and "
                f"track.section need steps of {longest:.3g} s; at least {SHORTEST_STEP:g} s is allowed"
            )
        count = math.ceil(sample / longest - 1e-9)
        return sample / count, count

    @cached_property
    def _creep_rate(self) -> float:
        """Damping rate of the fastest creep mode times speed (m/s2)."""
        stiffness = max(self._creep_stiffness(table) for table in (self.table, self.right_table) if table)
        body = self.multibody
        radius, section = self.scenario.vehicle.wheel_radius, self.scenario.track.section
        dofs = body.wheelset_dofs[0]
        mass, roll, spin = body.mass[dofs[0]], body.mass[dofs[3]], body.mass[dofs[4]]
        lateral = 1.0 / mass + radius**2 / roll + 1.0 / section.mass
        return float(stiffness * max(lateral, 1.0 / mass + radius**2 / spin))

    def _creep_stiffness(self, table: ContactTable) -> float:
        """Creep force of a centred wheelset per creepage (N)."""
        contact, node = self.scenario.contact, int(np.argmin(np.abs(table.dy)))
        area = table.a_s[node] * table.b_s[node] * float(np.max(self.multibody.wheel_load)) ** (2.0 / 3.0)
        return float(2.0 * contact.shear_modulus * area * max(table.c11[node], table.c22[node]))

    def realisation(self, seed: int) -> TrackRealisation:
        """Track irregularities of a seed, long enough for an assessed run.

        Raises
        ------
        ConfigError
            No distance is assessed, or irregularities that cannot be.
        """
        assessment = self.scenario.assessment
        if assessment.length is None:
            raise ConfigError("assessment.length: a simulation needs a distance, found null")
        end = assessment.run_in + assessment.length
        judged = [(assessment.run_in, end)]
        return realise(self.scenario.track.irregularity, end + RUN_OUT, seed, judged=judged)

    def plant(
        self,
        speed: float,
        track: TrackRealisation,
        table: ContactTable | None = None,
        points: Array | None = None,
        line: LineTable | None = None,
        rails: Rails | None = None,
        right_table: ContactTable | None = None,
    ) -> Plant:
        """Constants of the compiled step.

        Parameters
        ----------
        speed : float
            m/s.
        track : TrackRealisation
            Where the vehicle runs.
        table : ContactTable, optional
            A contact table in place of the model's, of both sides without a `right_table`.
        points : ndarray, shape (p, n), optional
            Rows of further measuring points, behind those of the bogie frames.
        line : LineTable, optional
            Curves and changing conditions; `speed` is then the lowest on it.
        rails : pair of RailProfileConfig or None, optional
            Rail profiles between which the line blends; the first None is the scenario's.
        right_table : ContactTable, optional
            Contact table of the right wheels in place of the model's.
        """
        h, _ = self.step(speed)
        b = self.multibody
        right = right_table if table or right_table else self.right_table
        table = table or self.table
        flat = self._shapes(rails) if rails else [table.flat, *([] if right is None else [right.flat])]
        damping = b.damping + (speed / self.scenario.vehicle.wheel_radius) * b.gyroscopic
        diagonal = np.diag(damping).copy()
        np.fill_diagonal(damping, 0.0)
        maxwell = damper_curves(self.dampers, h)
        sayds = self._sayds(h)
        motion = _motion_rows(b.arrangement, self.scenario.vehicle.wheel_radius, self._semi_active)
        force = sparse_rows(self._force_matrix(damping))
        frames = np.array([g for _, g in b.measuring_points]).reshape(-1, b.n)
        measure = sparse_rows(frames if points is None else np.vstack([frames, points]))
        shift, stop = _curves(b.stops)
        number = self._numbers(speed, track, table, 0 if sayds is None else sayds.substeps)
        body = np.zeros(0)
        body_column: Column = np.zeros(0, dtype=np.uint32)
        if line is not None:
            body, body_column = body_arrays(b)
            number[at.LINE_START], number[at.PER_LINE_STEP] = line.start, 1.0 / line.step
            number[at.LINE_COUNT] = len(line.values)
            number[at.SHAPES] = 1.0 if rails is None else BLENDS
        return Plant(
            number=number,
            wheel=aligned(self._wheels(speed, (table, right or table), len(flat[0]) * (len(flat) - 1))),
            mass=b.mass,
            damping_diagonal=diagonal,
            mobility=1.0 / (b.mass + 0.5 * h * diagonal),
            load=self._static_load(),
            wheelset_x=b.wheelset_x,
            table=flat[0] if len(flat) == 1 else np.concatenate(flat),
            motion_start=motion.start,
            motion_column=motion.column,
            motion_value=motion.value,
            force_start=force.start,
            force_column=force.column,
            force_value=force.value,
            measure_start=measure.start,
            measure_column=measure.column,
            measure_value=measure.value,
            damper_velocity=maxwell.velocity,
            damper_force=maxwell.force,
            damper_knot=maxwell.knot,
            damper_slope=maxwell.slope,
            damper_stiffness=maxwell.stiffness,
            stop_shift=shift,
            stop_force=stop,
            sayd_constant=np.zeros(0) if sayds is None else aligned(sayds.constant),
            sayd_table=np.zeros(0) if sayds is None else sayds.table,
            irregularity=track.coefficients.ravel(),
            creep=self.creep_table,
            line=np.zeros(0) if line is None else line.values.ravel(),
            body=body,
            body_column=body_column,
        )

    def _shapes(self, rails: Rails) -> list[Array]:
        """Contact tables of rails between two profiles, behind one another, of each side that has its own."""
        s, load = self.scenario, table_load(self.multibody.wheel_load)
        ends = [sides(s.wheel, s.rail if rail is None else rail) for rail in rails]
        alike = all(left == right for left, right in ends)
        found: list[list[Array]] = [[], []]
        for share in np.linspace(0.0, 1.0, BLENDS):
            pairs = [
                (wheel_profile(first[0], s.wear), blended(_rail(first[1]), _rail(second[1]), share))
                for first, second in zip(*ends, strict=True)
            ]
            for side in range(1 if alike else 2):
                other = None if alike else pairs[1 - side]
                table = cached_contact_table(
                    *pairs[side], s.track.gauge, s.contact, s.vehicle.wheel_radius, load, other
                )
                found[side].append(table.flat)
        return [np.concatenate(tables) for tables in found if tables]

    def _numbers(self, speed: float, track: TrackRealisation, table: ContactTable, substeps: int) -> Array:
        number = np.zeros(at.NUMBERS)
        number[at.STEP], number[at.SUBSTEPS], number[at.SPEED] = self.step(speed)[0], substeps, speed
        number[at.RAIL_START], number[at.PER_RAIL_STEP] = track.x0, 1.0 / track.step
        number[at.RAIL_COUNT] = len(track.coefficients)
        number[at.WIDEST] = table.dy[-1]
        number[at.SHAPES] = 1.0
        number[at.CREEP_LAW] = creep.LAWS.index(self.scenario.contact.creep_law)
        return number

    def _wheels(self, speed: float, tables: tuple[ContactTable, ContactTable], right_base: int) -> Array:
        """Constants of the wheels, (WHEEL_ROWS * LANES,), with the tables of the left and the right ones."""
        radius, count = self.scenario.vehicle.wheel_radius, len(self.multibody.wheelset_x)
        table = tables[0]
        wheel = np.zeros((at.WHEEL_ROWS, 2, WHEELSETS))
        wheel[at.TABLE_BASE, 1] = right_base
        wheel[at.TABLE_START], wheel[at.PER_TABLE_STEP] = table.dy[0], 1.0 / table.step
        wheel[at.TABLE_LAST] = len(table.delta_r) - 2
        wheel[at.TABLE_LOAD] = table.load ** (2.0 / 3.0)
        wheel[at.RADIUS], wheel[at.PER_RADIUS] = radius, 1.0 / radius
        wheel[at.WHEEL_SPEED], wheel[at.PER_SPEED] = speed, 1.0 / speed
        wheel[at.FRICTION], wheel[at.SHEAR_MODULUS] = (
            self.scenario.friction,
            self.scenario.contact.shear_modulus,
        )
        wheel[at.APPROACH] = -1.0  # wheels that the vehicle does not have stay in the air
        for side, each in enumerate(tables):
            wheel[at.APPROACH, side, :count], wheel[at.LOAD_FACTOR, side, :count] = self._static_contact(each)
        return wheel.ravel()

    def _static_load(self) -> Array:
        """What the static loads of the wheels put on wheelsets and track sections, shape (n,)."""
        load = np.zeros(self.multibody.n)
        load[self.multibody.wheelset_dofs[:, 2]] -= 2.0 * self.multibody.wheel_load
        load[self.multibody.section_dofs[:, 1]] += 2.0 * self.multibody.wheel_load
        return load

    def _force_matrix(self, damping: Array) -> Array:
        """Generalised forces over `Work.x`, from the damping matrix without its diagonal."""
        b, n = self.multibody, self.multibody.n
        contact = np.zeros((n, at.ROWS_OUT, 2, WHEELSETS))
        for j, (wheelset, section) in enumerate(zip(b.wheelset_dofs, b.section_dofs, strict=True)):
            for dof, row in zip(wheelset, range(at.FORCE_X, at.MOMENT_YAW + 1), strict=True):
                contact[dof, row, :, j] = 1.0
            for dof, row, sign in zip(
                section, (at.FORCE_Y, at.FORCE_Z, at.MOMENT_TRACK), (-1.0, -1.0, 1.0), strict=True
            ):
                contact[dof, row, :, j] = sign
        parts = [-b.stiffness, -damping, np.zeros((n, n)), contact.reshape(n, -1)]
        parts.append(-np.reshape([e.connection for e in self.dampers], (-1, n)).T)
        if self._semi_active:
            ends = np.zeros((n, 2, LANES))
            for k, (_, bogie, car) in enumerate(b.yaw_dampers):
                ends[:, 0, k], ends[:, 1, k] = -bogie, -car
            parts.append(ends.reshape(n, -1))
        parts.append(-np.reshape([e.connection for e in b.stops], (-1, n)).T)
        return np.hstack(parts)

    @property
    def _semi_active(self) -> bool:
        return not isinstance(self.scenario.damper, PassiveDamperConfig)

    def _static_contact(self, table: ContactTable) -> tuple[Array, Array]:
        """Vertical approach under the static load and the Hunt-Crossley factor, for each wheelset."""
        load = self.multibody.wheel_load
        node = int(np.argmin(np.abs(table.dy)))
        normal = load * math.hypot(1.0, table.tan_gamma[node])
        approach = load ** (2.0 / 3.0) * table.compliance[node]
        return approach, self.scenario.contact_damping / normal

    def _sayds(self, h: float) -> sayd.SaydArrays | None:
        """Constants of the semi-active dampers at a time step (s), None with passive ones."""
        damper = self.scenario.damper
        return None if isinstance(damper, PassiveDamperConfig) else sayd.sayd_arrays(damper, h)

    def state(self, speed: float) -> State:
        """The state at rest under the static load, the first wheelset at the start of the irregularities.

        The speed (m/s) decides how many steps of commands the valve drivers hold back.
        """
        n, m = self.multibody.n, len(self.dampers)
        damper, sayds, line = self.scenario.damper, np.zeros(0), np.zeros(0)
        if not isinstance(damper, PassiveDamperConfig):
            sayds = sayd.rest(damper)
            line = np.full(sayd.line_length(damper, self.step(speed)[0]) * LANES, damper.current)
        return State(
            q=zeros(n),
            v=zeros(n),
            a=zeros(n),
            elongation=zeros(m),
            piston=zeros(m),
            force=zeros(m),
            sayd=aligned(sayds),
            sayd_line=aligned(line),
            clock=aligned(np.array([0.0, -float(np.max(self.multibody.wheelset_x))])),
        )

    def work(self, points: int = 0, line: LineTable | None = None, rails: Rails | None = None) -> Work:
        """Scratch memory for one vehicle, with room for further measuring points and for a line."""
        b = self.multibody
        n, m, s, w = b.n, len(self.dampers), len(b.stops), len(b.wheelset_x)
        semi_active = self._semi_active
        x = 3 * n + at.ROWS_OUT * LANES + m + s + (2 * LANES if semi_active else 0)
        y = at.MOTIONS * WHEELSETS + m + s + (sayd.INPUTS * LANES if semi_active else 0)
        law = (creep.ROWS_IN * LANES, creep.ROWS_OUT * LANES, len(creep.scratch(LANES)))
        sizes = (n, x, y, 8 * WHEELSETS, at.ROWS_IN * LANES, at.PATCH_ROWS * LANES, *law, w + points)
        shapes = 0 if rails is None else 2 * geometry.WIDTH * LANES
        on_line = (0, 0, 0) if line is None else (at.WHEEL_ROWS * LANES, shapes, 4 * n + CENTRE_ROWS + 3)
        return Work(*(zeros(size) for size in (*sizes, *on_line)))


@lru_cache(maxsize=64)
def _motion_rows(design: Arrangement, radius: float, semi_active: bool) -> Rows:
    """Rows of `Work.y` over the motion in `Work.x`: displacements, predicted and present velocities.

    Vehicles of one design share them.
    """
    n = design.layout.n
    motions = np.zeros((at.MOTIONS, WHEELSETS, 3 * n))
    for j, (wheelset, section) in enumerate(zip(design.wheelset_dofs, design.section_dofs, strict=True)):
        x, y, z, roll, pitch, yaw = wheelset
        section_y, section_z, section_roll = section
        for first, offset, height, turn, plane in (
            (0, at.M_OFFSET, at.M_HEIGHT, at.M_ROLL, at.M_PLANE),
            (n, at.M_BOTTOM, at.M_RISE, at.M_ROLL_RATE, at.M_PLANE_RATE),
        ):
            motions[offset, j, first + np.array([y, roll, section_y])] = 1.0, radius, -1.0
            motions[height, j, first + np.array([z, section_z])] = 1.0, -1.0
            motions[turn, j, first + roll] = motions[plane, j, first + section_roll] = 1.0
        motions[at.M_YAW, j, yaw] = motions[at.M_YAW_RATE, j, n + yaw] = 1.0
        motions[at.M_SLIP_X, j, n + x] = motions[at.M_SPIN_RATE, j, n + pitch] = 1.0
    yaw_dampers = [] if semi_active else [bogie - car for _, bogie, car in design.yaw_dampers]
    elongations = [*yaw_dampers, *(place.connection for place in (*design.dampers, *design.stops))]
    rows = [motions.reshape(-1, 3 * n), np.pad(np.reshape(elongations, (-1, n)), ((0, 0), (0, 2 * n)))]
    if semi_active:
        ends = np.zeros((sayd.INPUTS, LANES, 3 * n))
        for k, (_, *pair) in enumerate(design.yaw_dampers):
            for row, end in zip((sayd.END_1, sayd.END_2), pair, strict=True):
                for part in range(3):  # position, velocity and old velocity stand one behind another
                    ends[row + part, k, part * n : (part + 1) * n] = end
        rows.append(ends.reshape(-1, 3 * n))
    return sparse_rows(np.vstack(rows))


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
    line : LineTable, optional
        Curves and changing conditions; its speeds are those at which the vehicle runs.
    rails : pair of RailProfileConfig or None, optional
        Rail profiles between which the line blends; the first None is the scenario's.

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
        line: LineTable | None = None,
        rails: Rails | None = None,
    ) -> None:
        self.model = model
        self.speed = speed if line is None else line.slowest
        self.track = model.realisation(seed) if track is None else track
        self.plant = model.plant(self.speed, self.track, table, line=line, rails=rails)
        self.state = model.state(self.speed)
        self.work = model.work(line=line, rails=rails)

    @property
    def channels(self) -> int:
        """Number of signals that every sample has: those of `sayd_env.physics.step.record`."""
        body = self.model.multibody
        return 2 * len(body.wheelset_x) + len(body.yaw_dampers)

    def divergence(self) -> str:
        """What to tell of a run that ended early."""
        when = f"after {self.state.clock[0]:.2f} s"
        if np.max(np.abs(self.state.v)) < FASTEST:
            return f"derailment at {self.speed * KMH:g} km/h {when}: a wheel has left the contact table"
        return (
            f"the simulation at {self.speed * KMH:g} km/h diverged {when}; a smaller numerics.step may help"
        )

    def command(self, currents: npt.ArrayLike) -> None:
        """Set the commanded valve currents of the semi-active dampers; they hold until the next command.

        Parameters
        ----------
        currents : array_like, shape (d,) or ()
            Commands from 0 (closed) to 1 (open), in the order of `Multibody.yaw_dampers`.

        Raises
        ------
        ConfigError
            Passive dampers, a wrong number of currents, or a current that is not a number from 0 to 1.
        """
        rows = self._valves()
        rows[sayd.COMMAND] = checked_currents(currents, rows.shape[1])

    def power(self, on: npt.ArrayLike) -> None:
        """Switch the power of the valves on or off; without it a valve goes to its fail-safe opening.

        Parameters
        ----------
        on : array_like of bool, shape (d,) or ()

        Raises
        ------
        ConfigError
            Passive dampers or a wrong number of values.
        """
        rows = self._valves()
        values = np.asarray(on, dtype=bool)
        if values.shape not in ((), (rows.shape[1],)):
            raise ConfigError(f"power: found shape {values.shape}, expected {rows.shape[1]} values")
        rows[sayd.POWERED] = values

    def _valves(self) -> Array:
        """View of the semi-active dampers' states, (STATES, d)."""
        if self.state.sayd.size == 0:
            name = self.model.scenario.damper.name
            raise ConfigError(f"damper '{name}' has no valve: commands need a damper of type sayd")
        return self.state.sayd.reshape(sayd.STATES, LANES)[:, : len(self.model.multibody.yaw_dampers)]

    def advance(
        self, samples: int, *, wheels: bool = False, motion: bool = False, sayds: bool = False
    ) -> Telemetry:
        """Run on for a number of samples and return their signals.

        Parameters
        ----------
        samples : int
            Number of samples at the scenario's sample rate.
        wheels, motion, sayds : bool
            Also record the wheel-rail forces, the displacements of all degrees of freedom, and the states of
            the semi-active dampers.

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
        dampers = np.empty((samples if sayds else 0, self.state.sayd.size))
        done = advance(self.plant, self.state, self.work, substeps, signals, forces, motions, dampers)
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
            sayds=dampers.reshape(len(dampers), dampers.shape[1] // LANES, LANES)[
                :, :, : len(self.model.multibody.yaw_dampers)
            ],
        )

    def run(
        self, distance: float, *, wheels: bool = False, motion: bool = False, sayds: bool = False
    ) -> Telemetry:
        """Run over a distance (m) and return the signals.

        Raises
        ------
        ConfigError
            A distance below 0, or none.
        StudyError
            The state did not stay finite.
        """
        if not 0.0 <= distance < math.inf:
            raise ConfigError(f"distance: found {distance} m; expected a number from 0 on")
        samples = math.ceil(distance / self.speed * self.model.scenario.assessment.sample_rate)
        return self.advance(samples, wheels=wheels, motion=motion, sayds=sayds)


def table_load(wheel_load: Array) -> float:
    """Static wheel load (N) of the contact table of a vehicle whose wheels carry `wheel_load` (N)."""
    return LOAD_STEP * max(1, round(float(np.mean(wheel_load)) / LOAD_STEP))


Side: TypeAlias = tuple[WheelProfileConfig, RailProfileConfig]
"""Wheel and rail profile of a side."""


@lru_cache(maxsize=256)
def _contact_table(
    own: Side,
    other: Side | None,
    wear: float,
    gauge: float,
    contact: ContactConfig,
    radius: float,
    load: float,
    files: tuple[tuple[bytes, ...], ...],
) -> ContactTable:
    """Contact table of a side beside another one, or one like it; many vehicles of a study share it."""
    del files  # a measured file may have changed under its name
    pair, *further = [(wheel_profile(side[0], wear), _rail(side[1])) for side in (own, other) if side]
    return cached_contact_table(*pair, gauge, contact, radius, load, *further)


def _rail(config: RailProfileConfig) -> Profile:
    return _rail_of(config, file_contents(config))


@lru_cache(maxsize=8)
def _rail_of(config: RailProfileConfig, files: tuple[bytes, ...]) -> Profile:
    del files  # as above
    return rail_profile(config)


def checked_currents(currents: npt.ArrayLike, count: int) -> Array:
    """Commands for `count` valves, each a number from 0 to 1.

    Raises
    ------
    ConfigError
        Anything else: nothing that is not a valid current reaches the hydraulics.
    """
    values = np.asarray(currents, dtype=float)
    if values.shape not in ((), (count,)):
        raise ConfigError(f"valve currents: found shape {values.shape}, expected {count} values")
    wrong = ~((values >= 0.0) & (values <= 1.0))
    if np.any(wrong):
        found = np.atleast_1d(values)[np.atleast_1d(wrong)][0]
        raise ConfigError(f"valve currents: found {found:g}, expected finite numbers from 0 to 1")
    return values


def threads(workers: int | None) -> ThreadPoolExecutor:
    """Pool for many simulators at once: compiled code and SciPy's filters run outside Python's lock."""
    return ThreadPoolExecutor(max_workers=workers, thread_name_prefix="sayd")


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
    longer: dict[int, Array] = {}  # elements of one kind share their curve
    for element in elements:
        if id(element.curve) not in longer:
            longer[id(element.curve)] = _longer(element.curve, count)
    points = np.array([longer[id(e.curve)] for e in elements]).reshape(-1, count, 2)
    x, y = np.moveaxis(points, (0, 1, 2), (2, 1, 0))
    return np.ascontiguousarray(x), np.ascontiguousarray(y)


def _longer(points: Array, count: int) -> Array:
    """A curve on so many points, shape (count, 2)."""
    more = np.arange(1, count - len(points) + 1)[:, None] * (points[-1] - points[-2])
    return np.vstack([points, points[-1] + more])
