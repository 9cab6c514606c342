"""Linear analysis of the vehicle that the simulator runs: eigenvalues, mode shapes, linear critical speed.

The compiled right-hand side of the time integration is differentiated about steady running on smooth track,
so there is no second model. Wheel-rail contact is harmonically linearised at an amplitude of lateral motion;
dampers count with the first segment of their curve, stops with what they do at small displacements.

Differences are taken along the unknowns, one at a time. The tabulated creep law has continuous slopes; at the
spin of steady running they are near Kalker's coefficients. Polach's law has no derivative at pure spin: its
stiffness depends on the direction of the slip, C11 along the rail to C22 across. So with it the matrix holds
Kalker's linear coefficients, as linear theory does; in the simulation a mode whose slip turns sees a mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.linalg import eig, eigvals, lstsq
from scipy.optimize import brentq, linear_sum_assignment

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.track import NoIrregularityConfig
from sayd_env.config.units import Array
from sayd_env.physics import plant as at
from sayd_env.physics.contact import geometry
from sayd_env.physics.contact.geometry import ContactTable, linearised
from sayd_env.physics.mode_names import describe, numbered
from sayd_env.physics.plant import LANES, Plant, Work
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.step import rates
from sayd_env.physics.track.realisation import TrackRealisation, realise

Complex = npt.NDArray[np.complex128]
Index = npt.NDArray[np.int64]

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


@dataclass(frozen=True)
class Linearisation:
    """A vehicle about steady running: d/dt (x - x_0) = matrix (x - x_0), x = (q, v, F)."""

    matrix: Array
    """(2 n + m, 2 n + m) state matrix of displacements, velocities and Maxwell dampers' forces, SI."""
    q: Array
    """(n,) displacements of steady running, m and rad."""
    v: Array
    """(n,) velocities of steady running, rad/s: what pure rolling adds to the wheelsets' nominal spin."""
    table: ContactTable
    """Contact table in use."""
    track: TrackRealisation
    """Smooth track."""


@dataclass(frozen=True)
class Mode:
    """An oscillatory mode of a vehicle of n unknowns."""

    frequency_hz: float
    """Damped frequency Im(lambda) / 2 pi, Hz."""
    damping_ratio: float
    """-Re(lambda) / |lambda|; negative: the mode grows."""
    eigenvalue: complex
    """lambda, with positive imaginary part, 1/s."""
    shape: Complex
    """(n,) displacements, the largest of them 1."""
    vector: Complex
    """(2 n + m,) the whole eigenvector: displacements, velocities, damper forces."""
    name: str
    """What moves, in the field's terms; of several such modes the least damped has no number."""


@dataclass(frozen=True)
class RootLocus:
    """Modes over speed; a branch is NaN where it does not oscillate."""

    speeds: Array
    """(s,) m/s."""
    eigenvalues: Complex
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


def linearise(model: VehicleModel, speed: float, amplitude: float | None) -> Linearisation:
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

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range, or semi-active dampers, whose hydraulics have no linear part that
        would say anything about the whole.
    DataError
        An amplitude outside the contact table.
    StudyError
        No steady running was found.

    Notes
    -----
    Spin creep lets the wheelsets roll a little off the nominal rate. So steady running has no velocities but
    these, and the unknowns are all displacements but the wheelsets' angles of rotation, on which nothing
    depends, and these rates. Newton's method with the state matrix itself, from pure rolling; directions
    without stiffness stay where they are.
    """
    if not isinstance(model.scenario.damper, PassiveDamperConfig):
        raise ConfigError(
            f"damper '{model.scenario.damper.name}': the linear analysis needs passive yaw dampers"
        )
    table, right = (
        each if each is None or amplitude is None else linearised(each, amplitude)
        for each in (model.table, model.right_table)
    )
    assert table is not None
    track = realise(NoIrregularityConfig(type="none"), 1.0, 0)
    plant, work = model.plant(speed, track, table, right_table=right), model.work()
    n, m = model.multibody.n, len(model.dampers)
    spin = model.multibody.wheelset_dofs[:, 4]
    unknown = np.r_[:n]
    unknown[spin] += n
    x = np.zeros(2 * n + m)
    x[n + spin] = _pure_rolling(plant)
    for _ in range(_ITERATIONS):
        matrix = _jacobian(plant, work, x)
        residual = _rates(plant, work, x)[n : 2 * n]
        if np.max(np.abs(residual)) < _RESIDUAL:
            return Linearisation(matrix, x[:n].copy(), x[n : 2 * n].copy(), table, track)
        step = matrix[n : 2 * n, unknown]
        scale = np.linalg.norm(step, axis=0)
        scale[scale == 0.0] = 1.0
        x[unknown] -= lstsq(step / scale, residual, cond=1e-12)[0] / scale
    raise StudyError(
        f"no steady running found at {speed * 3.6:g} km/h: accelerations of {np.max(np.abs(residual)):.2g} "
        f"remain after {_ITERATIONS} iterations"
    )


def state_matrix(model: VehicleModel, speed: float, amplitude: float | None) -> Array:
    """Return the state matrix of (q, v, F), shape (2 n + m, 2 n + m), as `linearise` finds it."""
    return linearise(model, speed, amplitude).matrix


def modes(model: VehicleModel, speed: float, amplitude: float | None) -> list[Mode]:
    """Oscillatory modes in the order of their frequencies; parameters and errors as for `linearise`."""
    values, vectors = _spectrum(model, speed, amplitude)
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
    found = [_spectrum(model, speed, amplitude) for speed in speeds]
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
    last: list[Complex] = [np.empty(0, dtype=np.complex128)] * branches
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


def second_order(mass: npt.ArrayLike, damping: Array, stiffness: Array) -> Array:
    """State matrix, shape (2 n, 2 n), of M q'' + C q' + K q = 0 with a diagonal M of shape (n,)."""
    n, per_mass = len(stiffness), 1.0 / np.asarray(mass, dtype=float)[:, None]
    return np.block([[np.zeros((n, n)), np.eye(n)], [-per_mass * stiffness, -per_mass * damping]])


def conical_contact(
    wheelset_dofs: Index,
    n: int,
    speed: float,
    conicity: float,
    creep: tuple[float, float],
    half_distance: float,
    radius: float,
) -> tuple[Array, Array]:
    """Linear creep forces of wheelsets with conical wheels on rigid rails, as matrices.

    Parameters
    ----------
    wheelset_dofs : ndarray, shape (w, 6)
        Columns of x, y, z, roll, pitch, yaw, as in `sayd_env.physics.multibody.Multibody`; y and yaw count.
    n : int
        Number of unknowns.
    speed : float
        V, m/s.
    conicity : float
        lambda, slope of the tread (-).
    creep : tuple of float
        Creep coefficients of one wheel in longitudinal and lateral direction, N.
    half_distance : float
        a, half the distance of the contact points, m.
    radius : float
        r_0, rolling radius, m.

    Returns
    -------
    stiffness, damping : ndarray, shape (n, n)
        To be added to those of the suspension.

    Notes
    -----
    Creepages xi_y = y' / V - psi and xi_x = a psi' / V + lambda y / r_0 (of opposite sign left and right);
    lateral force -2 f_22 xi_y, yaw moment -2 a f_11 xi_x (Wickens, Fundamentals of Rail Vehicle Dynamics,
    2003, chapter 2; spin and gravity stiffness left out).
    """
    stiffness, damping = np.zeros((n, n)), np.zeros((n, n))
    longitudinal, lateral = 2.0 * creep[0], 2.0 * creep[1]
    y, yaw = wheelset_dofs[:, 1], wheelset_dofs[:, 5]
    damping[y, y] = lateral / speed
    stiffness[y, yaw] = -lateral
    damping[yaw, yaw] = longitudinal * half_distance**2 / speed
    stiffness[yaw, y] = longitudinal * half_distance * conicity / radius
    return stiffness, damping


def _pure_rolling(plant: Plant) -> float:
    """What a centred wheelset's spin (rad/s) departs by from V / r_0, its contacts having other radii."""
    nodes = int(plant.wheel[at.TABLE_LAST * LANES]) + 2
    delta_r = float(plant.table[(nodes // 2) * geometry.WIDTH + geometry.DELTA_R])
    return -plant.speed / plant.radius * delta_r / (plant.radius + delta_r)


def _rates(plant: Plant, work: Work, x: Array) -> Array:
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
        columns[j] = (_rates(plant, work, up) - _rates(plant, work, down)) / (up[j] - down[j])
    return columns.T.copy()


def _spectrum(model: VehicleModel, speed: float, amplitude: float | None) -> tuple[Complex, Complex]:
    """Eigenvalues with positive imaginary part, rising in it, and their eigenvectors as rows."""
    matrix, n = state_matrix(model, speed, amplitude), model.multibody.n
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


def _damping_ratio(values: Complex) -> Array:
    return np.asarray(-values.real / np.abs(values))


def _likeness(p: Complex, a: Complex, q: Complex, b: Complex) -> Array:
    """Likeness of modes (eigenvalues p, shapes a as rows) to modes (q, b), from 0 to 1."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = b / np.linalg.norm(b, axis=1, keepdims=True)
    apart = np.abs(p[:, None] - q) / (np.abs(p)[:, None] + np.abs(q))
    return np.asarray(np.abs(a.conj() @ b.T) ** 2 * (1.0 - apart))
