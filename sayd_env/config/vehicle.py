"""Schema of a vehicle: bodies and force elements, repeated over index sets (bogies, axles, sides)."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, field_validator, model_validator

from sayd_env.config.base import Model, Number, Part, quantity
from sayd_env.config.layers import Kind
from sayd_env.config.loader import nearest

VEHICLE = Kind("vehicle", data=("elements.*.curve.file",))

NotNegative = Annotated[float, Field(ge=0, strict=True)]

# What no vehicle has, by a wide margin, is a number in another unit: t for kg, MN/m for N/m, mm for m.
_LIGHTEST = {"carbody": 1000.0, "frame": 100.0, "wheelset": 100.0}  # kg
_GYRATION = (0.1, 50.0)  # m, of these
_SOFTEST, _LEAST_DAMPING, _LEAST_TORSION = 1e3, 50.0, 100.0  # N/m, N s/m, N m/rad; 0 is none
_FARTHEST, _HIGHEST, _WIDEST_STOP, _FASTEST_TRAIN = 100.0, 10.0, 1.0, 200.0  # m, m, m, m/s


def _plain(value: float, least: float, unit: str) -> float:
    """A number that is 0 or not too small for its unit."""
    if 0.0 < value < least:
        raise ValueError(f"expected 0, or {least:g} {unit} and more (is the unit {unit}?)")
    return value


Stiffness = Annotated[NotNegative, AfterValidator(lambda value: _plain(value, _SOFTEST, "N/m"))]
Damping = Annotated[NotNegative, AfterValidator(lambda value: _plain(value, _LEAST_DAMPING, "N s/m"))]
Place = Annotated[Number, Field(ge=-_FARTHEST, le=_FARTHEST)]
Position = tuple[Place, Place, Place]
Dof = Literal["x", "y", "z", "roll", "pitch", "yaw"]
Axis = Literal["x", "y", "z"]
DOFS: tuple[Dof, ...] = ("x", "y", "z", "roll", "pitch", "yaw")
GROUND = "ground"


class Member(Model):
    """One member of an index set: where its local frame stands and how it is mirrored."""

    origin: Position = Field(
        (0.0, 0.0, 0.0), description="Origin, added to the origins of the outer sets (m)"
    )
    sign: tuple[Literal[-1, 1], Literal[-1, 1], Literal[-1, 1]] = Field(
        (1, 1, 1), description="Mirroring of the local x, y, z (-)"
    )


class Body(Model):
    """A rigid body at its centre of gravity, or a part hinged to a carrier about the lateral axis."""

    name: str
    role: Literal["carbody", "frame", "wheelset", "hinged", "body"] = "body"
    per: tuple[str, ...] = Field((), description="Index sets over which the body is repeated")
    mass: float = quantity(
        "kg", "Mass; 0 for a hinged part, whose mass the carrier holds", default=0.0, ge=0.0
    )
    inertia: tuple[NotNegative, NotNegative, NotNegative] = Field(
        description="Principal moments of inertia about x, y, z (kg m2)"
    )
    position: Position = Field(description="Centre of gravity in the local frame, z above the rail (m)")
    dofs: tuple[Dof, ...] = Field(DOFS, description="Degrees of freedom")
    carrier: str | None = Field(None, description="Body that a hinged part is mounted on")

    @model_validator(mode="after")
    def _hinge(self) -> Body:
        if len(set(self.dofs)) < len(self.dofs):
            raise ValueError(f"dofs: found {', '.join(self.dofs)}; expected each once")
        if (self.role == "hinged") != (self.carrier is not None):
            raise ValueError("a hinged body, and no other, names its carrier")
        if self.role == "hinged":
            if self.dofs != ("pitch",):
                raise ValueError("a hinged body has the one degree of freedom 'pitch'")
            if self.mass != 0.0 or self.inertia[1] <= 0.0:
                raise ValueError("a hinged body has no mass of its own and a positive pitch inertia")
        elif self.mass <= 0.0 or min(self.inertia) <= 0.0:
            raise ValueError("mass and moments of inertia must be positive")
        elif self.mass < _LIGHTEST.get(self.role, 0.0):
            raise ValueError(
                f"mass: found {self.mass:g} kg; a {self.role} has {_LIGHTEST[self.role]:g} kg and more (is "
                "the unit kg?)"
            )
        elif self.role in _LIGHTEST:
            self._check_inertia()
        return self

    def _check_inertia(self) -> None:
        low, high = (radius**2 * self.mass for radius in _GYRATION)
        for axis, value in zip(("roll", "pitch", "yaw"), self.inertia, strict=True):
            if axis in self.dofs and not low <= value <= high:
                raise ValueError(
                    f"inertia: found {value:g} kg m2; of {self.mass:g} kg it is {low:.3g} to {high:.3g}, with"
                    f" radii of gyration of {_GYRATION[0]:g} to {_GYRATION[1]:g} m (is the unit kg m2?)"
                )


class Attachment(Model):
    """A point of a body, in the local frame of the element that uses it."""

    body: str = Field(description="Name of a body, or 'ground'")
    at: Position = Field(description="Position in the element's local frame, z above the rail (m)")


class _Element(Model):
    name: str
    per: tuple[str, ...] = ()
    a: Attachment
    b: Attachment


class Bush(_Element):
    """Linear springs and dampers along x, y, z between two points: springs, bushes, links."""

    type: Literal["bush"]
    stiffness: tuple[Stiffness, Stiffness, Stiffness] = Field(description="Stiffness along x, y, z (N/m)")
    damping: tuple[Damping, Damping, Damping] = Field(
        (0.0, 0.0, 0.0), description="Damping along x, y, z (N s/m)"
    )
    carries_weight: bool = Field(False, description="Carries static weight (gives its gravity stiffness)")


class Torsion(_Element):
    """A torsion spring and damper between two bodies, such as an anti-roll bar."""

    type: Literal["torsion"]
    axis: Literal["roll", "pitch", "yaw"]
    stiffness: float = quantity("N m/rad", "Torsional stiffness", ge=0.0)
    damping: float = quantity("N m s/rad", "Torsional damping", default=0.0, ge=0.0)

    @field_validator("stiffness")
    @classmethod
    def _stiff(cls, value: float) -> float:
        return _plain(value, _LEAST_TORSION, "N m/rad")


# Shock absorbers of cars are tested to 3 m/s, dampers of any vehicle give 100 N to 100 kN or so there.
_FASTEST = 10.0  # m/s
_WEAKEST, _STRONGEST = 50.0, 1e6  # N
Curve = tuple[tuple[Number, Number], ...]
_POINTS = TypeAdapter(Curve, config=ConfigDict(allow_inf_nan=False))


def checked_curve(points: Curve, abscissa: str) -> Curve:
    """Return an odd piecewise-linear characteristic's right half, which starts at (0, 0) and never falls.

    Raises
    ------
    ValueError
        Fewer than two points, a first point other than (0, 0), unsorted abscissae or falling forces.
    """
    if len(points) < 2 or points[0] != (0.0, 0.0):
        raise ValueError("needs at least two points, the first of which is [0, 0]")
    for (x0, f0), (x1, f1) in pairwise(points):
        if x1 <= x0:
            raise ValueError(f"{abscissa} must increase: {x1:g} follows {x0:g}")
        if f1 < f0:
            raise ValueError(f"the force must not fall: {f1:g} N follows {f0:g} N")
    return points


def checked_law(points: Curve) -> Curve:
    """Return a damper's `checked_curve` of force (N) over velocity (m/s), which rises all along.

    Raises
    ------
    ValueError
        As `checked_curve`, equal forces, or numbers that no damper has in these units.
    """
    for (_, f0), (v1, f1) in pairwise(points):
        if f1 == f0:
            # The force is the state of the element: a flat part would have no one velocity.
            raise ValueError(f"the force must rise up to {v1:g} m/s; give a saturated damper a small slope")
    checked_curve(points, "velocity (m/s)")
    velocity, force = points[-1]
    if velocity > _FASTEST:
        raise ValueError(
            f"velocity (m/s): found {velocity:g}; at most {_FASTEST:g} is allowed, is it in mm/s?"
        )
    if not _WEAKEST <= force <= _STRONGEST:
        raise ValueError(
            f"force (N): found {force:g} at the end; allowed are {_WEAKEST:g} to {_STRONGEST:g}, is it in kN?"
        )
    return points


class MeasuredCurve(Model):
    """Force over velocity as a test rig prints it, read by `sayd_env.measured.dampers`."""

    file: str = Field(
        min_length=1,
        description="CSV file with a column of velocities and one of forces, relative to this file",
    )
    velocity_unit: str | None = Field(None, description="Of velocities, where the header has none: mm/s")
    force_unit: str | None = Field(None, description="Of forces, where the header has none: kN")
    direction: Literal["positive", "negative", "mean"] | None = Field(
        None, description="Which velocities count where the damper has other forces in the other direction"
    )
    scale: float = quantity("-", "Factor on all forces", default=1.0, gt=0.0, le=100.0)


class MaxwellLaw(Model):
    """A damper with an odd piecewise-linear force-velocity curve in series with a spring (paper, 2.1)."""

    curve: Curve | MeasuredCurve = Field(
        description="Points (velocity (m/s), force (N)) for v >= 0; the last slope goes on"
    )
    series_stiffness: float = quantity("N/m", "Series stiffness", ge=1e5, le=1e9)

    @field_validator("curve", mode="wrap")
    @classmethod
    def _curve(cls, value: Any, _: object) -> Curve | MeasuredCurve:
        # By what is given, so that a message tells of the one way that was meant.
        if isinstance(value, Mapping | MeasuredCurve):
            return MeasuredCurve.model_validate(value)
        return checked_law(_POINTS.validate_python(value))


class Damper(_Element, MaxwellLaw):
    """A damper of the vehicle other than the yaw dampers."""

    type: Literal["damper"]
    axis: Axis


class Stop(_Element):
    """An elastic stop with clearance: force over relative displacement, odd."""

    type: Literal["stop"]
    axis: Axis
    curve: Curve = Field(description="Points (displacement (m), force (N)); the last slope goes on")

    @field_validator("curve")
    @classmethod
    def _curve(cls, points: Curve) -> Curve:
        if points and points[-1][0] > _WIDEST_STOP:
            raise ValueError(
                f"displacement (m): found {points[-1][0]:g}; at most {_WIDEST_STOP:g} is allowed, in mm?"
            )
        return checked_curve(points, "displacement (m)")


class YawDamper(_Element):
    """A place for a longitudinal yaw damper: a is its end on the bogie, b its end on the carbody."""

    type: Literal["yaw_damper"]


Element = Annotated[Bush | Torsion | Damper | Stop | YawDamper, Field(discriminator="type")]


class VehicleConfig(Part):
    """A vehicle as data; `sayd_env.physics.multibody.assemble` turns it into matrices."""

    name: str
    description: str = ""
    sets: dict[str, dict[str, Member]] = Field({}, description="Index sets: name -> member -> local frame")
    bodies: tuple[Body, ...]
    elements: tuple[Element, ...]
    wheel_radius: float = quantity("m", "Nominal rolling radius at the tape circle", gt=0.1, lt=1.0)
    measuring_height: float = quantity(
        "m", "Height above the rail of the bogie-frame accelerometers over the wheelsets", gt=0.0, le=_HIGHEST
    )
    floor_height: float | None = quantity(
        "m",
        "Height above the rail of the floor, where ride comfort is measured",
        gt=0.0,
        le=_HIGHEST,
        default=None,
    )
    speed_range: tuple[Number, Number] = Field(
        description="Lowest and highest speed for which the model stands (m/s)"
    )

    @field_validator("speed_range")
    @classmethod
    def _speeds(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if not 0.0 < limits[0] < limits[1]:
            raise ValueError("needs 0 < lowest < highest")
        if limits[1] > _FASTEST_TRAIN:
            raise ValueError(f"at most {_FASTEST_TRAIN:g} m/s is allowed (is the unit m/s?)")
        return limits

    @model_validator(mode="after")
    def _references(self) -> VehicleConfig:
        bodies = {body.name: body for body in self.bodies}
        if len(bodies) != len(self.bodies):
            raise ValueError("two bodies have the same name")
        for kind, items in (("bodies", self.bodies), ("elements", self.elements)):
            for item in items:
                for name in item.per:
                    if name not in self.sets:
                        known = f"{nearest(name, self.sets)}; sets: {', '.join(self.sets) or 'none'}"
                        raise ValueError(f"{kind}: {item.name}: unknown set '{name}'{known}")
        for body in self.bodies:
            if body.carrier is not None:
                _check_body(f"bodies: {body.name}", body.carrier, body.per, bodies)
                if body.carrier == GROUND or bodies[body.carrier].role != "wheelset":
                    raise ValueError(
                        f"bodies: {body.name}: carrier: found '{body.carrier}'; expected a wheelset, on "
                        "whose axle the hinge is"
                    )
        for element in self.elements:
            for end in (element.a, element.b):
                _check_body(f"elements: {element.name}", end.body, element.per, bodies)
        if not any(body.role == "wheelset" for body in self.bodies):
            raise ValueError("a vehicle needs at least one body with the role 'wheelset'")
        return self

    @property
    def yaw_damped(self) -> bool:
        """Whether it has yaw dampers."""
        return any(isinstance(element, YawDamper) for element in self.elements)

    @property
    def structure(self) -> Hashable:
        """What vehicles have in common that differ in numbers alone: sets, bodies, roles and elements."""
        return (
            tuple((name, *members) for name, members in self.sets.items()),
            tuple((body.name, body.role, body.per) for body in self.bodies),
            tuple((element.name, element.type, element.per) for element in self.elements),
        )


def _check_body(user: str, name: str, per: tuple[str, ...], bodies: dict[str, Body]) -> None:
    if name == GROUND:
        return
    if name not in bodies:
        raise ValueError(f"{user}: unknown body '{name}'{nearest(name, [*bodies, GROUND])}")
    outer = bodies[name].per
    if per[: len(outer)] != outer:
        raise ValueError(
            f"{user}: is repeated per {list(per)}, so it cannot reach '{name}', one per {list(outer)}"
        )
