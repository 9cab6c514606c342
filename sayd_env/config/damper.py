"""Schema of a vehicle's yaw dampers."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from sayd_env.config.base import Model, Number, Part, quantity
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.vehicle import MaxwellLaw

DAMPER = Kind("damper", data=("throttle.file", "curve.file"))
SAYD = replace(DAMPER, only=("type", "sayd"))


# Limits of the quantities here are no bounds of good design: far beyond what railway dampers have on both
# sides, they refuse a number in another unit, MN/m for N/m, mm2 for m2, bar for Pa.


class PassiveDamperConfig(MaxwellLaw, Part):
    """The passive yaw damper: piecewise-linear damper in series with a spring (paper, section 2.1)."""

    type: Literal["passive"]
    name: str
    description: str = ""


class MountConfig(Model):
    """Elastic bearing at an end of the damper, eq. (2) and (5)."""

    stiffness: float = quantity("N/m", "c_b, stiffness", ge=1e5, le=1e9)
    damping: float = quantity("N s/m", "d_b, damping", ge=0.0, le=1e7)


class FrictionConfig(Model):
    """Coulomb friction between piston and housing, eq. (11)."""

    stiction: float = quantity("N", "F_C, friction at standstill", ge=0.0, le=1e4)
    sliding: float = quantity("N", "F_S, friction while sliding", ge=0.0, le=1e4)

    @model_validator(mode="after")
    def _stiction_is_larger(self) -> Self:
        if self.stiction < self.sliding:
            raise ValueError(
                f"stiction {self.stiction:g} N must not be below the sliding friction {self.sliding:g} N"
            )
        return self


class CylinderConfig(Model):
    """Through-rod cylinder: chamber volumes of eq. (18) to (21)."""

    area: float = quantity("m2", "A, piston area less the rod's, both sides", ge=1e-5, le=0.1)
    bore: float = quantity("m", "d_p, diameter of the dead volumes", ge=0.005, le=0.5)
    stroke: float = quantity("m", "st, whole stroke between the ends", ge=0.01, le=2.0)
    dead_length_a: float = quantity("m", "L_pA, length of the dead volume of chamber A", gt=0.0, le=1.0)
    dead_length_b: float = quantity("m", "L_pB, length of the dead volume of chamber B", gt=0.0, le=1.0)


class OilConfig(Model):
    """The oil, its pressures absolute."""

    bulk_modulus: float = quantity(
        "Pa", "E, effective bulk modulus, entrained air included; no liquid's is above 4 GPa", gt=1e7, le=4e9
    )
    tank_pressure: float = quantity("Pa", "Pressure in the tank", ge=1e3, le=1e7)
    vapour_pressure: float = quantity("Pa", "Pressure below which no chamber falls", ge=0.0)

    @model_validator(mode="after")
    def _tank_is_liquid(self) -> Self:
        if self.vapour_pressure >= self.tank_pressure:
            raise ValueError(
                f"vapour_pressure {self.vapour_pressure:g} Pa must be below "
                f"tank_pressure {self.tank_pressure:g} Pa"
            )
        return self


class OrificeThrottle(Model):
    """Throttle as a turbulent orifice: Q = C_d a(i) sqrt(2 dp / rho).

    a(i) = a_0 up to the current i_0 at which the spool leaves its overlap, from there on
    a_0 + (a_1 - a_0) ((i - i_0) / (1 - i_0))^n.
    """

    type: Literal["orifice"]
    discharge: float = quantity("-", "C_d, discharge coefficient", gt=0.0, le=1.0)
    density: float = quantity("kg/m3", "rho, density of the oil", ge=500.0, le=2000.0)
    closed_area: float = quantity("m2", "a_0, area at current 0: leakage", gt=0.0, le=1e-4)
    open_area: float = quantity("m2", "a_1, area at current 1", ge=1e-9, le=1e-3)
    overlap: float = quantity(
        "-", "i_0, current up to which the spool's overlap keeps the throttle closed", ge=0.0, le=0.9
    )
    exponent: float = quantity("-", "n, shape of the area over the current beyond it", gt=0.0, le=10.0)

    @model_validator(mode="after")
    def _opens(self) -> Self:
        if self.open_area < self.closed_area:
            raise ValueError(
                f"open_area {self.open_area:g} m2 must not be below closed_area {self.closed_area:g} m2"
            )
        return self


class TableThrottle(Model):
    """Adjustable throttle as a measured characteristic field: flow over pressure drop and current."""

    type: Literal["table"]
    file: str = Field(
        min_length=1,
        description="CSV file: currents in the first row, pressure drops in the first column, flows in the "
        "rest, or a column of each; relative to this file",
    )
    current_unit: str | None = Field(None, description="Of currents, where the file has none: A, mA, %, -")
    drop_unit: str | None = Field(None, description="Of pressure drops, where the file has none: bar, Pa")
    flow_unit: str | None = Field(None, description="Of flows, where the file has none: l/min, m3/s")
    current_range: tuple[Number, Number] | None = Field(
        None,
        description="Currents of the valve closed and wide open, in the file's unit; "
        "only a share (-, %) of the command goes without",
    )


class EqualPercentageThrottle(Model):
    """Throttle as a turbulent orifice whose area rises by equal shares: Q = C_d a(i) sqrt(2 dp / rho).

    a(i) = a_0 R^i: the equal-percentage characteristic of IEC 60534-2-4, R the ratio of open to closed area.
    """

    type: Literal["equal_percentage"]
    discharge: float = quantity("-", "C_d, discharge coefficient", gt=0.0, le=1.0)
    density: float = quantity("kg/m3", "rho, density of the oil", ge=500.0, le=2000.0)
    closed_area: float = quantity("m2", "a_0, area at current 0", gt=0.0, le=1e-4)
    ratio: float = quantity("-", "R, area at current 1 over that at current 0", ge=1.0, le=1e4)


Throttle = Annotated[OrificeThrottle | EqualPercentageThrottle | TableThrottle, Field(discriminator="type")]


class SpringValve(Model):
    """A relief or check valve by eq. (22) to (24)."""

    opening: float = quantity("Pa", "p_o, pressure drop at which it begins to open", ge=100.0, le=1e8)
    full: float = quantity("Pa", "p_s, pressure drop at which it is fully open", ge=100.0, le=1e8)
    nominal_flow: float = quantity("m3/s", "Q_N, flow of the open valve at its nominal drop", ge=1e-7, le=0.1)
    nominal_drop: float = quantity("Pa", "dp_N, nominal pressure drop", ge=100.0, le=1e8)

    @model_validator(mode="after")
    def _opens_gradually(self) -> Self:
        if self.full <= self.opening:
            raise ValueError(f"full {self.full:g} Pa must be above opening {self.opening:g} Pa")
        return self


class ValveDynamics(Model):
    """From the commanded to the acting current of the throttle: driver delay, then the spool.

    The spool follows y'' = omega^2 (u - y) - 2 zeta omega y' with |y'| at most `rate`, between its stops.
    """

    delay: float = quantity("s", "Delay of the driver", ge=0.0, le=0.2)
    natural_frequency: float = quantity("Hz", "omega / 2 pi, undamped", ge=1.0, le=1e4)
    damping_ratio: float = quantity("-", "zeta", ge=0.1, le=10.0)
    rate: float = quantity("1/s", "Largest rate of the acting current", ge=0.1)


class SaydDamperConfig(Part):
    """The semi-active yaw damper: the six-state hydraulic model of the paper's section 2.2."""

    type: Literal["sayd"]
    name: str
    description: str = ""
    current: float = quantity("-", "Valve current before any command: 0 closed, 1 open", ge=0.0, le=1.0)
    failsafe_current: float = quantity(
        "-", "Current that the unpowered valve's opening corresponds to", ge=0.0, le=1.0
    )
    rod_mass: float = quantity("kg", "m_1, piston rod, on the bogie's side", ge=0.1, le=1e3)
    housing_mass: float = quantity("kg", "m_2, housing, on the carbody's side", ge=0.1, le=1e3)
    bogie_mount: MountConfig
    carbody_mount: MountConfig
    friction: FrictionConfig
    cylinder: CylinderConfig
    oil: OilConfig
    throttle: Throttle
    rectifier: SpringValve = Field(description="Each of the rectifier's four check valves")
    relief: SpringValve = Field(description="Relief valves from chamber A and B to the tank")
    suction: SpringValve = Field(description="Check valves from the tank to chamber A and B")
    bleed: float = quantity(
        "m3/(s Pa)", "Conductance of the bleed from each chamber to the tank, laminar", ge=0.0, le=1e-9
    )
    valve: ValveDynamics
    step: float = quantity("s", "Longest step of the hydraulics' integration", ge=1e-7, le=1e-3)


DamperConfig = Annotated[PassiveDamperConfig | SaydDamperConfig, Field(discriminator="type")]


def load_sayd(name_or_path: str) -> SaydDamperConfig:
    """Read a semi-active damper: a packaged name or a path to a YAML file.

    Raises
    ------
    ConfigError
        Unknown name, unreadable file, or a key that cannot be used.
    """
    return read_layered(SaydDamperConfig, SAYD, name_or_path)
