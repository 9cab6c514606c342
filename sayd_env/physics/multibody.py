"""Assembly: bodies and linear force elements -> M, C, K and the connection vectors of 1-D force elements.

Rotations are small and the frame moves with the train, so every displacement of a point is linear in the
degrees of freedom: u(p) = u_body + theta x (p - p_body). A force element between two points along a
direction d then has the elongation g.q with the connection vector g = d.(u(b) - u(a)), and acts on the
degrees of freedom with the generalised force -g F.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from sayd_env.config import ConfigError
from sayd_env.config.track import SectionConfig
from sayd_env.config.units import GRAVITY, Array, Integers
from sayd_env.config.vehicle import Bush, Damper, Stop, Torsion, VehicleConfig
from sayd_env.measured.dampers import force_velocity
from sayd_env.physics.layout import (
    Arrangement,
    Instance,
    Layout,
    Place,
    arrange,
    displacement,
    frame_of,
    layout,
)

_ROUNDING = 1e-14  # of a matrix's largest entry


@dataclass(frozen=True)
class ForceElement:
    """A non-linear 1-D force element: name, connection vector (n,) and odd piecewise-linear law."""

    name: str
    connection: Array
    curve: Array
    """Points (velocity or displacement, force), shape (k, 2)."""
    series_stiffness: float = 0.0
    """Series stiffness of a Maxwell element (N/m); 0 for a stop."""


@dataclass(frozen=True)
class Multibody:
    """Assembled model of n degrees of freedom, in an order that keeps the matrices' columns compact."""

    dof_names: tuple[str, ...]
    mass: Array
    """Diagonal of the mass matrix, shape (n,), kg and kg m2."""
    damping: Array
    """C, shape (n, n), without the gyroscopic terms."""
    stiffness: Array
    """K, shape (n, n), with the gravity stiffness of the static loads."""
    gyroscopic: Array
    """G, shape (n, n): the gyroscopic force is -(V / r0) G v (spinning wheelsets)."""
    dampers: tuple[ForceElement, ...]
    """Maxwell elements other than yaw dampers."""
    stops: tuple[ForceElement, ...]
    yaw_dampers: tuple[tuple[str, Array, Array], ...]
    """Name, connection vector of the bogie end and of the carbody end (elongation = bogie - carbody)."""
    wheelset_dofs: Integers
    """Columns of x, y, z, roll, pitch, yaw of each wheelset, shape (w, 6); -1: not free."""
    section_dofs: Integers
    """Columns of y, z, roll of the track section under each wheelset, shape (w or 0, 3)."""
    wheelset_x: Array
    """Longitudinal position of each wheelset, shape (w,), m."""
    wheel_load: Array
    """Static vertical load of one wheel of each wheelset, shape (w,), N; 0 if it cannot move vertically."""
    measuring_points: tuple[tuple[str, Array], ...]
    """Lateral displacement of the bogie frame (of the wheelset, if no frame is there) above each wheelset:
    name and connection vector."""
    bogie_mass: float
    """Frame and its wheelsets (kg), the m_b of EN 14363; of the heaviest bogie, whose limit is the lowest."""
    total_mass: float
    instances: dict[str, Instance] = field(repr=False)
    arrangement: Arrangement = field(repr=False)
    """What it shares with all vehicles of its design: the same object."""

    @property
    def n(self) -> int:
        """Number of degrees of freedom."""
        return len(self.dof_names)

    @property
    def axle_load(self) -> float:
        """Static load of the lightest wheelset (N), the P of EN 14363: that with the lowest limit."""
        return 2.0 * float(np.min(self.wheel_load))

    def point(self, name: str, position: Array, direction: Array) -> Array:
        """Row that gives the displacement of a body's point along a direction, shape (n,)."""
        return displacement(self.instances[name], position, self.n).T @ direction


def assemble(vehicle: VehicleConfig, section: SectionConfig | None) -> Multibody:
    """Assemble a vehicle on co-moving track sections.

    Parameters
    ----------
    vehicle : VehicleConfig
        Bodies and force elements.
    section : SectionConfig or None
        The track section under each wheelset: lateral, vertical and roll (paper reference 13); None for a
        rigid track.

    Raises
    ------
    ConfigError
        The vehicle's elements do not fit together (a weight that nothing carries, for example).
    """
    plan = layout(vehicle, section is not None)
    mass = _masses(vehicle, section)[plan.mass]
    springs, dashpots = _linear_numbers(vehicle, section)
    weight = _weight(plan, mass)
    force, loads = _statics(vehicle.name, plan, springs, weight)
    stiffness = _without_rounding(plan.linear.added_up(springs, plan.n, (plan.gravity, force)))
    damping = _without_rounding(plan.linear.added_up(dashpots, plan.n))

    own = arrange(plan, _compact_order(stiffness, damping))
    shuffle = np.ix_(own.order, own.order)
    instances = own.instances_of(vehicle)
    return Multibody(
        dof_names=own.dof_names,
        mass=mass[own.order],
        damping=damping[shuffle],
        stiffness=stiffness[shuffle],
        gyroscopic=_gyroscopic(instances, plan.n),
        dampers=_force_elements(vehicle, own.dampers),
        stops=_force_elements(vehicle, own.stops),
        yaw_dampers=own.yaw_dampers,
        wheelset_dofs=own.wheelset_dofs,
        section_dofs=own.section_dofs,
        wheelset_x=own.wheelset_x,
        wheel_load=loads,
        measuring_points=own.measuring_points,
        bogie_mass=_bogie_mass(instances),
        total_mass=sum(i.body.mass for i in instances.values()),
        instances=instances,
        arrangement=own,
    )


def _masses(vehicle: VehicleConfig, section: SectionConfig | None) -> Array:
    """Masses and moments of inertia of all bodies, six each, and two of a track section (`Layout.mass`)."""
    numbers = [n for body in vehicle.bodies for n in (body.mass, body.mass, body.mass, *body.inertia)]
    if section is not None:
        numbers += [section.mass, section.roll_inertia]
    return np.array(numbers)


def _linear_numbers(vehicle: VehicleConfig, section: SectionConfig | None) -> tuple[Array, Array]:
    """Stiffness and damping of what is linear, in the order of the elements, then of a track section."""
    stiffness: list[float] = []
    damping: list[float] = []
    for element in vehicle.elements:
        if isinstance(element, Bush):
            stiffness += element.stiffness
            damping += element.damping
        elif isinstance(element, Torsion):
            stiffness.append(element.stiffness)
            damping.append(element.damping)
    if section is not None:
        arm = section.seat_half_spacing
        k, c = 2 * section.vertical_stiffness, 2 * section.vertical_damping
        stiffness += (section.lateral_stiffness, k, k * arm**2)
        damping += (section.lateral_damping, c, c * arm**2)
    return np.array(stiffness), np.array(damping)


def _weight(plan: Layout, mass: Array) -> Array:
    """Weight on each unknown, N."""
    weight = np.zeros(plan.n)
    heavy = [i.columns["z"] for i in plan.instances.values() if "z" in i.columns]
    weight[heavy] = -GRAVITY * mass[heavy]
    return weight


def _statics(name: str, plan: Layout, springs: Array, weight: Array) -> tuple[Array, Array]:
    """Static force of each carrier on its end b, upwards, and load of a wheel of each wheelset, N.

    Raises
    ------
    ConfigError
        A weight that no spring carries.
    """
    vertical = plan.vertical.added_up(springs, plan.n)
    wheelsets = [plan.instances[name].columns.get("z") for name in plan.wheelsets]
    support = [z for z in wheelsets if z is not None]
    stiff = 1e3 * max(float(np.max(np.diag(vertical))), 1.0)
    vertical[support, support] += stiff
    rows = np.flatnonzero(np.any(vertical != 0.0, axis=1) | (weight != 0.0))
    settled = np.zeros(plan.n)
    if len(rows):
        settled[rows] = np.linalg.lstsq(vertical[np.ix_(rows, rows)], weight[rows], rcond=1e-12)[0]
    if not np.allclose(vertical @ settled, weight, atol=1e-6 * np.max(np.abs(weight))):
        raise ConfigError(
            f"{name}: the static weight is not carried; mark the springs that carry it with "
            "carries_weight: true"
        )
    force = [-springs[carrier.number] * float(carrier.connection @ settled) for carrier in plan.carriers]
    sinking = [0.0 if z is None else settled[z] for z in wheelsets]
    return np.array(force), -0.5 * stiff * np.array(sinking)


def _force_elements(vehicle: VehicleConfig, places: tuple[Place, ...]) -> tuple[ForceElement, ...]:
    """Elements of a law of their own, each with its curve."""
    laws = {place.element: _law(vehicle, place.element) for place in places}
    return tuple(ForceElement(place.name, place.connection, *laws[place.element]) for place in places)


def _law(vehicle: VehicleConfig, place: int) -> tuple[Array, float]:
    """Curve and series stiffness of a damper or a stop."""
    element = vehicle.elements[place]
    assert isinstance(element, Damper | Stop)  # the layout has chosen it as one
    if isinstance(element, Damper):
        return force_velocity(element), element.series_stiffness
    return np.array(element.curve), 0.0


def _gyroscopic(instances: dict[str, Instance], n: int) -> Array:
    """Matrix G of the spinning wheelsets: I_y omega couples roll and yaw (force -(V / r0) G v)."""
    matrix = np.zeros((n, n))
    for i in instances.values():
        if i.body.role == "wheelset" and {"roll", "yaw"} <= i.columns.keys():
            roll, yaw, spin = i.columns["roll"], i.columns["yaw"], i.body.inertia[1]
            matrix[roll, yaw] = -spin
            matrix[yaw, roll] = spin
    return matrix


def _without_rounding(matrix: Array) -> Array:
    """The matrix with zeros for what rounding leaves of sums that cancel.

    Else its pattern, and with it the order of the unknowns, would change with any number of the vehicle, and
    vehicles that differ in numbers alone could not stand side by side.
    """
    return np.where(np.abs(matrix) > _ROUNDING * np.max(np.abs(matrix), initial=0.0), matrix, 0.0)


def _compact_order(*matrices: Array) -> Integers:
    """Order of the unknowns that keeps the non-zero rows of each column close together."""
    pattern = sum(np.abs(m) for m in matrices) != 0.0
    return _order_of(np.asarray(pattern).tobytes(), len(matrices[0]))


@lru_cache(maxsize=64)
def _order_of(pattern: bytes, n: int) -> Integers:
    matrix = csr_matrix(np.frombuffer(pattern, dtype=np.bool_).reshape(n, n))
    return np.asarray(reverse_cuthill_mckee(matrix, symmetric_mode=True), dtype=np.int64)


def _bogie_mass(instances: dict[str, Instance]) -> float:
    wheelsets = [i for i in instances.values() if i.body.role == "wheelset"]
    frames = [i for i in instances.values() if i.body.role == "frame"]
    if not frames:
        return max(w.body.mass for w in wheelsets)
    return max(
        frame.body.mass + sum(w.body.mass for w in wheelsets if frame_of(w, frames) is frame)
        for frame in frames
    )
