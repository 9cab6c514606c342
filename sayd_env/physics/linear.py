"""Linear analysis of the vehicle that the simulator runs: eigenvalues, mode shapes, linear critical speed.

The compiled right-hand side of the time integration is differentiated about steady running on smooth track,
so there is no second model. Wheel-rail contact is harmonically linearised at an amplitude of lateral motion,
yaw dampers at a stroke speed (`sayd_env.physics.equivalent_damper`); without one they count with the first
segment of their curve, or as mounts of a piston that friction holds. Other dampers count with their first
segment, stops with what they do at small displacements.

Differences are taken along the unknowns, one at a time. The tabulated creep law has continuous slopes; at the
spin of steady running they are near Kalker's coefficients. Polach's law has no derivative at pure spin: its
stiffness depends on the direction of the slip, C11 along the rail to C22 across. So with it the matrix holds
Kalker's linear coefficients, as linear theory does; in the simulation a mode whose slip turns sees a mean.

Creep forces that saturate are smaller than these slopes say. `equivalent` finds by how much at a stated shift
of the wheelsets: over a cycle of the least damped hunting mode a gain fits the forces of small creepages,
taken on in proportion, to what they are (least squares), and multiplies the stiffnesses, until both agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from scipy.linalg import eig, eigvals, lstsq
from scipy.optimize import brentq, linear_sum_assignment

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.track import NoIrregularityConfig
from sayd_env.config.units import KMH, Array, ComplexArray
from sayd_env.measured.dampers import force_velocity
from sayd_env.physics import plant as at
from sayd_env.physics.contact import creep, geometry
from sayd_env.physics.contact.geometry import ContactTable, linearised
from sayd_env.physics.equivalent_damper import (
    SHIFTS,
    EquivalentSayd,
    Stroke,
    equivalent_sayd,
    equivalent_slope,
)
from sayd_env.physics.mode_names import describe, numbered
from sayd_env.physics.multibody import Multibody
from sayd_env.physics.plant import LANES, Plant, Work
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.step import contact_at, rates
from sayd_env.physics.track.realisation import TrackRealisation, realise

Tables: TypeAlias = tuple[ContactTable, ContactTable | None]
"""Contact tables of the left wheels and of the right ones; None: the same."""

HUNTING_BAND = (0.5, 15.0)
"""Frequencies of the modes that decide running stability (Hz)."""

# Differences: small against a contact's approach (0.1 mm) and the creepage at which it saturates (1e-3),
# large against rounding; the derivatives are good to about 1e-8.
_DISPLACEMENT = 1e-8  # m, rad
_VELOCITY = 1e-6  # m/s, rad/s
_FORCE = 1e-2  # N

_ITERATIONS = 20
_RESIDUAL = 1e-8  # m/s2, rad/s2
_ROUNDING = 1e-6  # 1/s: what an imaginary part may be for an eigenvalue to be called real
_SMALLEST_LIKENESS = 0.3  # of two modes at neighbouring speeds that belong to one branch
_SPEED_TOLERANCE = 1e-6  # m/s

_FIRST_FREQUENCY = 5.0  # Hz, from which the hunting mode's is found
_FREQUENCY_TOLERANCE = 0.01
_CREEP_TOLERANCE = 1e-3
_WHOLE_STEPS = 6
_PHASES = 32  # of a cycle
_SMALL = 1e-4  # of an amplitude: creepages without saturation
_SIDEWAYS = 0.1  # lateral motion of wheelsets over the largest one of a mode that is theirs


@dataclass(frozen=True)
class Linearisation:
    """A vehicle about steady running: d/dt (x - x_0) = matrix (x - x_0), x = (q, v, F, z)."""

    matrix: Array
    """State matrix of displacements (n), velocities (n), Maxwell dampers' forces (m) and the states of one
    semi-active damper after another, SI."""
    q: Array
    """(n,) displacements of steady running, m and rad."""
    v: Array
    """(n,) velocities of steady running, rad/s: what pure rolling adds to the wheelsets' nominal spin."""
    tables: Tables
    """Contact tables in use."""
    track: TrackRealisation
    """Smooth track."""
    sayd: EquivalentSayd | None
    """Each of the semi-active dampers; None with passive ones."""
    speed: float
    """V, m/s."""
    stroke: Stroke | None
    """How the yaw dampers move."""
    creep: float
    """Creep stiffnesses over those of small creepages."""


@dataclass(frozen=True)
class OperatingPoint:
    """Where a vehicle is linearised."""

    speed: float
    """V, m/s."""
    shift: float
    """RMS of the wheelsets' lateral shift, m; 0: contact in the centred position, small creepages."""
    stroke_speed: float
    """RMS of the yaw dampers' stroke rate, m/s; 0: at rest, where friction holds semi-active ones."""
    current: float | None = None
    """Acting current of semi-active dampers; None: their own before any command."""
    frequency: float | None = None
    """Of both, Hz; None: that of the least damped hunting mode."""

    def __post_init__(self) -> None:
        for name in ("shift", "stroke_speed"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigError(f"{name}: found {getattr(self, name)}; expected a number from 0 on")
        if self.frequency is not None and not 0.0 < self.frequency < math.inf:
            raise ConfigError(f"frequency: found {self.frequency} Hz; expected a number above 0")


@dataclass(frozen=True)
class Mode:
    """An oscillatory mode of a vehicle of n unknowns."""

    frequency_hz: float
    """Damped frequency Im(lambda) / 2 pi, Hz."""
    damping_ratio: float
    """-Re(lambda) / |lambda|; negative: the mode grows."""
    eigenvalue: complex
    """lambda, with positive imaginary part, 1/s."""
    shape: ComplexArray
    """(n,) displacements, the largest of them 1."""
    vector: ComplexArray
    """The whole eigenvector: displacements, velocities, damper forces, semi-active dampers' states."""
    name: str
    """What moves, in the field's terms; of several such modes the least damped has no number."""


@dataclass(frozen=True)
class RootLocus:
    """Modes over speed; a branch is NaN where it does not oscillate."""

    speeds: Array
    """(s,) m/s."""
    eigenvalues: ComplexArray
    """(s, b) 1/s."""
    names: tuple[str, ...]
    """(b,) name of each branch: that of its mode at the highest speed at which it exists."""

    @property
    def frequency_hz(self) -> Array:
        """Damped frequencies (s, b), Hz."""
        return np.asarray(self.eigenvalues.imag / (2.0 * np.pi))

    @property
    def damping_ratio(self) -> Array:
        """Damping ratios (s, b)."""
        return _damping_ratio(self.eigenvalues)


def linearise(
    model: VehicleModel,
    speed: float,
    amplitude: float | None,
    stroke: Stroke | None = None,
    creep: float = 1.0,
) -> Linearisation:
    """Find steady running on smooth track and linearise the vehicle about it.

    Parameters
    ----------
    model : VehicleModel
        The vehicle.
    speed : float
        Speed, m/s.
    amplitude : float or None
        Amplitude of the wheelsets' lateral motion at which wheel-rail contact is harmonically linearised, m;
        None: the contact as it is in the centred position.
    stroke : Stroke, optional
        Motion at which the yaw dampers are; None: at rest.
    creep : float
        Factor of the creep stiffnesses, see `equivalent`.

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range, a stroke speed that the dampers do not allow.
    DataError
        An amplitude outside the contact table.
    StudyError
        No steady running was found, or no steady cycle of a damper.

    Notes
    -----
    Spin creep lets the wheelsets roll a little off the nominal rate. So steady running has no velocities but
    these, and the unknowns are all displacements but the wheelsets' angles of rotation, on which nothing
    depends, and these rates. Newton's method with the state matrix itself, from pure rolling; directions
    without stiffness stay where they are. Semi-active dampers let the vehicle settle and pull at nothing.
    """
    tables = _tables(model, amplitude, creep)
    track = realise(NoIrregularityConfig(type="none"), 1.0, 0)
    plant, work = equivalent_plant(model, speed, track, tables, stroke), model.work()
    law = model.scenario.damper
    sayd = None if isinstance(law, PassiveDamperConfig) else equivalent_sayd(law, stroke)
    n, m = model.multibody.n, len(model.dampers)
    spin = model.multibody.wheelset_dofs[:, 4]
    unknown = np.r_[:n]
    unknown[spin] += n
    x = np.zeros(2 * n + m)
    x[n + spin] = _pure_rolling(plant)
    for _ in range(_ITERATIONS):
        matrix = _jacobian(plant, work, x)
        residual = rates_of(plant, work, x)[n : 2 * n]
        if np.max(np.abs(residual)) < _RESIDUAL:
            whole = matrix if sayd is None else _with_sayds(model.multibody, matrix, sayd)
            q, v = x[:n].copy(), x[n : 2 * n].copy()
            return Linearisation(whole, q, v, tables, track, sayd, speed, stroke, creep)
        step = matrix[n : 2 * n, unknown]
        scale = np.linalg.norm(step, axis=0)
        scale[scale == 0.0] = 1.0
        x[unknown] -= lstsq(step / scale, residual, cond=1e-12)[0] / scale
    raise StudyError(
        f"no steady running found at {speed * KMH:g} km/h: accelerations of {np.max(np.abs(residual)):.2g} "
        f"remain after {_ITERATIONS} iterations"
    )


def equivalent(model: VehicleModel, point: OperatingPoint) -> Linearisation:
    """Linearise the vehicle at a stated amplitude of wheelsets and yaw dampers.

    Parameters
    ----------
    model : VehicleModel
        The vehicle.
    point : OperatingPoint
        Speed, RMS of shift and of stroke speed, current.

    Raises
    ------
    ConfigError, DataError, StudyError
        As `linearise`; also where the creep forces' saturation does not settle.

    Notes
    -----
    RMS stands for a sine of root 2 times it. The creepages are those of
    `hunting_mode` with the stated shift of its wheelsets (the RMS over all of them).
    """
    amplitude = math.sqrt(2.0) * point.shift if point.shift > 0.0 else None
    frequency, factor = point.frequency or _FIRST_FREQUENCY, 1.0
    settled = point.frequency is not None or point.stroke_speed == 0.0
    for iteration in range(_ITERATIONS):
        stroke = Stroke(point.stroke_speed, frequency, point.current) if point.stroke_speed > 0.0 else None
        steady = linearise(model, point.speed, amplitude, stroke, factor)
        if amplitude is None and settled:
            return steady
        mode = hunting_mode(model, steady)
        wanted = frequency if settled else round(mode.frequency_hz, 2)  # few cycles on the rig will do
        new = 1.0 if amplitude is None else _saturation(model, steady, mode, amplitude)
        near = abs(wanted - frequency) <= _FREQUENCY_TOLERANCE * frequency
        if near and abs(new - factor) < _CREEP_TOLERANCE:
            return steady
        # Two modes may take turns to be the least damped one: then go half the way.
        part = 1.0 if iteration < _WHOLE_STEPS else 0.5
        factor += part * (new - factor)
        frequency += 0.0 if near else part * (wanted - frequency)
    raise StudyError(
        f"no equivalent linear creep forces found at {point.speed * KMH:g} km/h and a shift of "
        f"{point.shift * 1e3:g} mm (RMS): a factor of {factor:.3f} does not settle"
    )


def hunting_mode(model: VehicleModel, steady: Linearisation) -> Mode:
    """Least damped bogie hunting in `HUNTING_BAND`; of a vehicle without it any mode of its wheelsets there.

    Raises
    ------
    StudyError
        There is none.
    """
    lateral = model.multibody.wheelset_dofs[:, 1]
    low, high = HUNTING_BAND
    found = [mode for mode in modes_of(model, steady) if low <= mode.frequency_hz <= high]
    found = [mode for mode in found if np.max(np.abs(mode.shape[lateral])) > _SIDEWAYS]
    found = [mode for mode in found if "hunting" in mode.name] or found
    if not found:
        raise StudyError(f"no mode of the wheelsets between {low:g} and {high:g} Hz")
    return min(found, key=lambda mode: mode.damping_ratio)


def _tables(model: VehicleModel, amplitude: float | None, creep: float = 1.0) -> Tables:
    """Contact tables linearised at an amplitude, with a factor on their creep stiffnesses."""

    def changed(table: ContactTable) -> ContactTable:
        table = table if amplitude is None else linearised(table, amplitude)
        if creep == 1.0:
            return table
        return replace(table, c11=creep * table.c11, c22=creep * table.c22, c23=creep * table.c23)

    return changed(model.table), None if model.right_table is None else changed(model.right_table)


def equivalent_plant(
    model: VehicleModel, speed: float, track: TrackRealisation, tables: Tables, stroke: Stroke | None
) -> Plant:
    """Constants of the compiled step with passive yaw dampers as straight lines; parameters as above."""
    plant, law = model.plant(speed, track, tables[0], right_table=tables[1]), model.scenario.damper
    if stroke is None or not isinstance(law, PassiveDamperConfig):
        return plant
    yaw = len(model.multibody.yaw_dampers)  # the first of all dampers
    force = plant.damper_force.copy()
    force[:, :yaw] = equivalent_slope(force_velocity(law), stroke.speed) * plant.damper_velocity[:, :yaw]
    return plant._replace(damper_force=force)


def state_matrix(model: VehicleModel, speed: float, amplitude: float | None) -> Array:
    """Return the state matrix of (q, v, F, z) as `linearise` finds it with yaw dampers at rest."""
    return linearise(model, speed, amplitude).matrix


def modes(model: VehicleModel, speed: float, amplitude: float | None) -> list[Mode]:
    """Oscillatory modes in the order of their frequencies; parameters and errors as for `linearise`."""
    return modes_of(model, linearise(model, speed, amplitude))


def modes_of(model: VehicleModel, steady: Linearisation) -> list[Mode]:
    """Oscillatory modes of a linearised vehicle in the order of their frequencies."""
    values, vectors = _spectrum(model, steady.matrix)
    n, damping = model.multibody.n, _damping_ratio(values)
    names = numbered([describe(model.multibody, shape) for shape in vectors[:, :n]], np.argsort(damping))
    return [
        Mode(
            frequency_hz=float(value.imag / (2.0 * np.pi)),
            damping_ratio=float(ratio),
            eigenvalue=complex(value),
            shape=vector[:n],
            vector=vector,
            name=name,
        )
        for value, ratio, vector, name in zip(values, damping, vectors, names, strict=True)
    ]


def root_locus(model: VehicleModel, speeds: Sequence[float], amplitude: float | None) -> RootLocus:
    """Follow the modes over speed.

    Parameters
    ----------
    model : VehicleModel
        The vehicle.
    speeds : sequence of float
        Rising speeds (m/s), near enough to each other for a mode to keep its shape.
    amplitude : float or None
        As for `linearise`.

    Notes
    -----
    Modes of neighbouring speeds are assigned to each other so that the sum of their likeness is greatest:
    the modal assurance criterion of the shapes, weighted by the roots of the masses, times one minus the
    relative distance of the eigenvalues.
    """
    weight, n = np.sqrt(model.multibody.mass), model.multibody.n
    found = [_spectrum(model, state_matrix(model, speed, amplitude)) for speed in speeds]
    owner = np.arange(len(found[0][0]))  # the branch to which each mode belongs
    owners, branches = [owner], len(owner)
    for (p, a), (q, b) in pairwise(found):
        like = _likeness(p, weight * a[:, :n], q, weight * b[:, :n])
        old, new = linear_sum_assignment(like, maximize=True)
        alike = like[old, new] > _SMALLEST_LIKENESS
        following = np.full(len(q), -1)
        following[new[alike]] = owner[old[alike]]
        fresh = np.flatnonzero(following < 0)
        following[fresh] = branches + np.arange(len(fresh))
        branches += len(fresh)
        owner = following
        owners.append(owner)
    eigenvalues = np.full((len(found), branches), complex(np.nan, np.nan))
    last: list[ComplexArray] = [np.empty(0, dtype=np.complex128)] * branches
    for s, (owner, (values, vectors)) in enumerate(zip(owners, found, strict=True)):
        eigenvalues[s, owner] = values
        for branch, vector in zip(owner, vectors, strict=True):
            last[branch] = vector[:n]
    least = np.nanmin(_damping_ratio(eigenvalues), axis=0)
    names = numbered([describe(model.multibody, shape) for shape in last], np.argsort(least))
    return RootLocus(np.array(speeds, dtype=float), eigenvalues, tuple(names))


def linear_critical_speed(
    model: VehicleModel,
    amplitude: float | None,
    speeds: Sequence[float],
    band: tuple[float, float] = HUNTING_BAND,
) -> float | None:
    """Return the lowest speed at which an oscillatory mode of the band loses its damping (m/s).

    Parameters
    ----------
    model : VehicleModel
        The vehicle.
    amplitude : float or None
        As for `linearise`.
    speeds : sequence of float
        Rising speeds (m/s) at which the sign of the damping is looked at; the result lies between two of
        them. It is the first of them if the vehicle is unstable there already.
    band : tuple of float
        Lowest and highest frequency, Hz.

    Returns
    -------
    float or None
        None: all modes of the band are damped at all the speeds.
    """
    spin = model.multibody.wheelset_dofs[:, 4]

    def matrix(speed: float) -> Array:
        full = state_matrix(model, speed, amplitude)
        return np.delete(np.delete(full, spin, axis=0), spin, axis=1)

    return critical_speed(matrix, speeds, band)


def critical_speed(
    matrix: Callable[[float], Array], speeds: Sequence[float], band: tuple[float, float] = HUNTING_BAND
) -> float | None:
    """Return the lowest speed (m/s) at which a system x' = matrix(speed) x has an undamped mode in a band.

    Parameters
    ----------
    matrix : callable
        State matrix at a speed (m/s).
    speeds, band
        As for `linear_critical_speed`.
    """

    def growth(speed: float) -> float:
        values = eigvals(matrix(speed))
        frequency = values.imag / (2.0 * np.pi)
        return float(np.max(values.real[(band[0] <= frequency) & (frequency <= band[1])], initial=-np.inf))

    if growth(speeds[0]) >= 0.0:
        return float(speeds[0])
    for low, high in pairwise(speeds):
        if growth(high) >= 0.0:
            # No mode at all in the band is no sign that brentq could use.
            return float(brentq(lambda v: max(growth(v), -1e3), low, high, xtol=_SPEED_TOLERANCE))
    return None


def _pure_rolling(plant: Plant) -> float:
    """What a centred wheelset's spin (rad/s) departs by from V / r_0, its contacts having other radii."""
    nodes = int(plant.wheel[at.TABLE_LAST * LANES]) + 2
    delta_r = float(plant.table[(nodes // 2) * geometry.WIDTH + geometry.DELTA_R])
    return -plant.speed / plant.radius * delta_r / (plant.radius + delta_r)


def rates_of(plant: Plant, work: Work, x: Array) -> Array:
    """Time derivative of (q, v, F) at position 0 of the plant's track, without semi-active dampers."""
    out, n = np.empty(len(x)), len(plant.mass)
    rates(plant, 0.0, x[:n], x[n : 2 * n], x[2 * n :], work, out)
    return out


def _jacobian(plant: Plant, work: Work, x: Array) -> Array:
    """Derivative of the rates by central differences."""
    n, m = len(plant.mass), len(plant.damper_stiffness)
    steps = np.repeat([_DISPLACEMENT, _VELOCITY, _FORCE], [n, n, m])
    columns = np.empty((len(x), len(x)))
    for j, h in enumerate(steps):
        up, down = x.copy(), x.copy()
        up[j] += h
        down[j] -= h
        columns[j] = (rates_of(plant, work, up) - rates_of(plant, work, down)) / (up[j] - down[j])
    return columns.T.copy()


def ends_of(body: Multibody) -> Array:
    """Rows that give the ends' motion of each yaw damper from (q, v), shape (d, 4, 2 n); `SHIFTS`."""
    ends = np.zeros((len(body.yaw_dampers), len(SHIFTS), 2 * body.n))
    for k, (_, bogie, car) in enumerate(body.yaw_dampers):
        ends[k, 0, : body.n] = ends[k, 1, body.n :] = bogie
        ends[k, 2, : body.n] = ends[k, 3, body.n :] = car
    return ends


def _with_sayds(body: Multibody, matrix: Array, sayd: EquivalentSayd) -> Array:
    """The state matrix of the vehicle without semi-active dampers, and these."""
    n, first, count = body.n, len(matrix), len(sayd.states)
    ends = ends_of(body)
    whole = np.zeros((first + count * len(ends),) * 2)
    whole[:first, :first] = matrix
    for k, motion in enumerate(ends):
        z = slice(first + count * k, first + count * (k + 1))
        pull = -motion[[0, 2], :n].T / body.mass[:, None]  # accelerations by F_1 and F_2
        whole[n : 2 * n, z] = pull @ sayd.c
        whole[n : 2 * n, : 2 * n] += pull @ sayd.d @ motion
        whole[z, z] = sayd.a
        whole[z, : 2 * n] = sayd.b @ motion
    return whole


def _saturation(model: VehicleModel, steady: Linearisation, mode: Mode, amplitude: float) -> float:
    """Gain that fits small creepages' forces, taken on in proportion, to those of a mode (least squares).

    Its wheelsets have a lateral amplitude (m), the RMS over them all. Wheels carry their static load.
    """
    body, n, work = model.multibody, model.multibody.n, model.work()
    lateral = mode.shape[body.wheelset_dofs[:, 1]]
    vector = mode.vector[: 2 * n] / math.sqrt(float(np.mean(np.abs(lateral) ** 2)))
    left, right = _tables(model, amplitude)
    plant = model.plant(steady.speed, steady.track, left, right_table=right)
    creepages = np.array([creep.XI_X, creep.XI_Y, creep.SPIN])

    def read(motion: Array) -> Array:
        contact_at(plant, steady.q + motion[:n], steady.v + motion[n:], 0.0, work)
        return work.creep_in.reshape(-1, LANES).copy()

    rest, small = read(np.zeros(2 * n)), _SMALL * amplitude
    there = rest[creep.BOUND] > 0.0  # wheels that the vehicle has
    parts = [(read(small * x) - rest)[creepages][:, there] / small for x in (vector.real, -vector.imag)]
    rest = rest[:, there]
    angle = 2.0 * np.pi * np.arange(_PHASES)[:, None] / _PHASES
    contact, bound = model.scenario.contact, rest[creep.BOUND]

    def changes(size: float) -> Array:
        """How the wheels' creep forces come and go in a cycle, over the amplitude."""
        swing = size * (parts[0][:, None] * np.cos(angle) + parts[1][:, None] * np.sin(angle))
        xi_x, xi_y, spin = rest[creepages][:, None] + swing
        forces = creep.creep_forces(
            contact.creep_law,
            xi_x,
            xi_y,
            spin,
            normal=bound,
            a=rest[creep.SEMI_A],
            b=rest[creep.SEMI_B],
            friction=1.0,
            shear_modulus=contact.shear_modulus,
            poisson_ratio=contact.poisson_ratio,
        )[:2]
        return np.asarray((forces - forces.mean(axis=1, keepdims=True)) / size)

    little, much = changes(small), changes(amplitude)
    return float(np.sum(much * little) / np.sum(little * little))


def _spectrum(model: VehicleModel, matrix: Array) -> tuple[ComplexArray, ComplexArray]:
    """Eigenvalues with positive imaginary part, rising in it, and their eigenvectors as rows."""
    n = model.multibody.n
    free = np.delete(np.arange(len(matrix)), model.multibody.wheelset_dofs[:, 4])
    values, vectors = eig(matrix[np.ix_(free, free)])
    chosen = np.flatnonzero(values.imag > _ROUNDING)
    chosen = chosen[np.argsort(values[chosen].imag)]
    values = values[chosen]
    full = np.zeros((len(chosen), len(matrix)), dtype=np.complex128)
    full[:, free] = vectors[:, chosen].T
    full[:, :n] = full[:, n : 2 * n] / values[:, None]  # also gives the wheelsets' angles of rotation
    full /= full[np.arange(len(chosen)), np.argmax(np.abs(full[:, :n]), axis=1)][:, None]
    return values, full


def _damping_ratio(values: ComplexArray) -> Array:
    return np.asarray(-values.real / np.abs(values))


def _likeness(p: ComplexArray, a: ComplexArray, q: ComplexArray, b: ComplexArray) -> Array:
    """Likeness of modes (eigenvalues p, shapes a as rows) to modes (q, b), from 0 to 1."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = b / np.linalg.norm(b, axis=1, keepdims=True)
    apart = np.abs(p[:, None] - q) / (np.abs(p)[:, None] + np.abs(q))
    return np.asarray(np.abs(a.conj() @ b.T) ** 2 * (1.0 - apart))
