"""Schema of a wheel or rail profile: zones of formulas, a table of points, or a measured file."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field, model_validator

from sayd_env.config.base import Model, Number, Part, quantity
from sayd_env.config.layers import Kind, read_layered


def _kind(kind: str) -> Kind:
    one = Kind("profile", data=("shape.file", "wear.shape.file"), only=("kind", kind), measured=kind)
    return replace(one, parts={"left": one, "right": one}, optional=("right",), sided=True)


WHEEL, RAIL = _kind("wheel"), _kind("rail")

JOINT_TOLERANCE_MM = 0.02
"""Zones may miss each other by this much (mm): published formulas are rounded."""


_WIDEST = 500.0  # mm; no profile reaches further from its origin
_FLATTEST = 1e6  # mm; an arc of a larger radius is a line

_LEAST_SMOOTHING = 1.5e-4
"""Of the five samples that a cubic smooths (m)."""


class Line(Model):
    """Straight zone: z = offset + slope * y."""

    type: Literal["line"]
    start: float = quantity("mm", "lateral start of the zone", ge=-_WIDEST, le=_WIDEST)
    end: float = quantity("mm", "lateral end of the zone", ge=-_WIDEST, le=_WIDEST)
    offset: float = quantity("mm", "height of the line at y = 0")
    slope: float = quantity("-", "slope dz/dy")


class Arc(Model):
    """Circular zone: z = centre_z +- sqrt(radius^2 - (y - centre_y)^2)."""

    type: Literal["arc"]
    start: float = quantity("mm", "lateral start of the zone", ge=-_WIDEST, le=_WIDEST)
    end: float = quantity("mm", "lateral end of the zone", ge=-_WIDEST, le=_WIDEST)
    centre_y: float = quantity("mm", "lateral position of the centre", ge=-_FLATTEST, le=_FLATTEST)
    centre_z: float = quantity("mm", "height of the centre", ge=-_FLATTEST, le=_FLATTEST)
    radius: float = quantity("mm", "radius", gt=0, le=_FLATTEST)
    side: Literal["upper", "lower"] = Field(description="which half of the circle: upper (+) or lower (-)")

    @model_validator(mode="after")
    def _inside(self) -> Arc:
        reach = max(abs(self.start - self.centre_y), abs(self.end - self.centre_y))
        if reach > self.radius:
            raise ValueError(f"the zone reaches {reach:g} mm from the centre, beyond the radius")
        return self


class Polynomial(Model):
    """Polynomial zone: z = sum_k coefficients[k] * y^k."""

    type: Literal["polynomial"]
    start: float = quantity("mm", "lateral start of the zone", ge=-_WIDEST, le=_WIDEST)
    end: float = quantity("mm", "lateral end of the zone", ge=-_WIDEST, le=_WIDEST)
    coefficients: tuple[Number, ...] = Field(
        min_length=1, description="coefficients from the constant upwards (mm, -, 1/mm, ...)"
    )


Zone = Annotated[Line | Arc | Polynomial, Field(discriminator="type")]


class Shape(Model):
    """The curve itself, given in exactly one way; y towards the field side, z upwards.

    Wheel: flange at negative y, z is the growth of the rolling radius. Rail: gauge face at negative y.
    """

    zones: tuple[Zone, ...] | None = Field(None, min_length=1, description="formulas, in order of y (mm)")
    points: tuple[tuple[Number, Number], ...] | None = Field(
        None, min_length=8, description="table of [y, z] in order of y (mm)"
    )
    file: str | None = Field(None, description="measured file (path): SIMPACK, MiniProf or columns y and z")
    unit: Literal["mm", "cm", "m", "in", "um"] | None = Field(
        None, description="unit of the file; null: what it says, or else the one in which it makes a profile"
    )
    mirror: bool | None = Field(
        None, description="turn y round; null: only a file's, so that a wheel's flange is at negative y"
    )
    invert: bool | None = Field(None, description="turn z round; null: only a file's, so that it is upwards")
    smoothing: float = quantity(
        "m",
        "length over which tabulated points are smoothed (cubic Savitzky-Golay)",
        default=0.0,
        ge=0.0,
        le=0.02,
    )

    @model_validator(mode="after")
    def _one_way(self) -> Shape:
        given = [name for name in ("zones", "points", "file") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of zones, points, file; found {', '.join(given) or 'none'}")
        if self.unit is not None and self.file is None:
            raise ValueError(f"unit is that of a file; {given[0]} are in mm")
        if 0.0 < self.smoothing < _LEAST_SMOOTHING:
            raise ValueError(f"smoothing: nothing is smoothed over less than {1e3 * _LEAST_SMOOTHING:g} mm")
        for before, after in zip(self.zones or (), (self.zones or ())[1:], strict=False):
            if abs(before.end - after.start) > 1e-9:
                raise ValueError(
                    f"zones must join: one ends at {before.end:g} mm, the next starts at {after.start:g} mm"
                )
        for zone in self.zones or ():
            if zone.end <= zone.start:
                raise ValueError(f"a zone must end beyond its start, found {zone.start:g} to {zone.end:g} mm")
        return self


class HollowWear(Model):
    """Hollow tread wear w(s) = depth * cos^2(pi (s - centre) / (2 half_width)) within the half width."""

    type: Literal["hollow"]
    depth: float = quantity("m", "largest depth of the fully worn tread", ge=0.0, lt=0.01)
    centre: float = quantity(
        "m", "lateral position of the deepest point, field side positive", ge=-0.06, le=0.06
    )
    half_width: float = quantity("m", "half width of the worn band", gt=0.0, lt=0.06)


class MeasuredWear(Model):
    """The fully worn profile itself; the blend runs between the new shape and this one."""

    type: Literal["measured"]
    shape: Shape


class WheelProfileConfig(Part):
    """A wheel profile and where it sits on its wheelset."""

    kind: Literal["wheel"]
    name: str
    shape: Shape
    shift: float = quantity(
        "m",
        "the whole curve is moved outwards (towards the field side) by this",
        default=0.0,
        ge=-0.01,
        le=0.01,
    )
    back_to_back: float = quantity("m", "distance between the backs of the wheels", gt=0.5, lt=2.0)
    tape_to_back: float = quantity("m", "distance from the tape circle to the wheel's back", gt=0.0, lt=0.2)
    wear: Annotated[HollowWear | MeasuredWear, Field(discriminator="type")] | None = Field(
        None, description="what wear = 1 means; without it the profile does not wear"
    )
    right: WheelProfileConfig | None = Field(
        None, description="right wheels, where they have another profile than the left ones"
    )

    @model_validator(mode="after")
    def _one_wheelset(self) -> WheelProfileConfig:
        _check_right(self, "back_to_back")
        return self


class RailProfileConfig(Part):
    """A rail profile, its cant and the depth at which its gauge is measured."""

    kind: Literal["rail"]
    name: str
    shape: Shape
    cant: float = quantity(
        "-",
        "inclination towards the track centre that is not yet in the curve (1:40 is 0.025)",
        ge=0.0,
        le=0.1,
    )
    gauge_depth: float = quantity(
        "m", "depth below the crown at which the gauge is measured", gt=0.0, lt=0.04
    )
    right: RailProfileConfig | None = Field(
        None, description="right rail, where it has another profile than the left one"
    )

    @model_validator(mode="after")
    def _one_track(self) -> RailProfileConfig:
        _check_right(self, "gauge_depth")
        return self


def _check_right(left: WheelProfileConfig | RailProfileConfig, common: str) -> None:
    """Refuse a right side that has a right side, or another number that is one for both."""
    if left.right is None:
        return
    if left.right.right is not None:
        raise ValueError("right: is the right one already, it has no right one of its own")
    if getattr(left, common) != getattr(left.right, common):
        raise ValueError(
            f"right.{common}: found {getattr(left.right, common):g}; expected that of the left one, "
            f"{getattr(left, common):g} m: set {left.kind}.{common} or {left.kind}.right.{common} "
            "to the common one"
        )


def sides(
    wheel: WheelProfileConfig, rail: RailProfileConfig
) -> tuple[tuple[WheelProfileConfig, RailProfileConfig], tuple[WheelProfileConfig, RailProfileConfig]]:
    """Wheel and rail of the left and of the right side, equal where they are alike."""
    left = (
        wheel if wheel.right is None else wheel.model_copy(update={"right": None}),
        rail if rail.right is None else rail.model_copy(update={"right": None}),
    )
    return left, (wheel.right or left[0], rail.right or left[1])


def shifted(wheel: WheelProfileConfig, shift: float) -> WheelProfileConfig:
    """The same with another outward shift (m), on both sides."""
    right = None if wheel.right is None else shifted(wheel.right, shift)
    return wheel.model_copy(update={"shift": shift, "right": right})


def load_wheel(name_or_path: str) -> WheelProfileConfig:
    """Read a wheel profile: a packaged name, or a path to a YAML or profile file.

    Raises
    ------
    ConfigError
        Unknown name, unreadable file, or a key that cannot be used.
    """
    return read_layered(WheelProfileConfig, WHEEL, name_or_path)


def load_rail(name_or_path: str) -> RailProfileConfig:
    """Read a rail profile: a packaged name, or a path to a YAML or profile file.

    Raises
    ------
    ConfigError
        Unknown name, unreadable file, or a key that cannot be used.
    """
    return read_layered(RailProfileConfig, RAIL, name_or_path)
