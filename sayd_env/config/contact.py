"""Schema of the wheel-rail contact: creep law, elastic constants, regularisation and the table grid."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from sayd_env.config.base import Model, quantity

CreepLaw = Literal["table", "polach", "fastsim"]


class ContactConfig(Model):
    """Law of the creep forces, and how the contact tables are made."""

    creep_law: CreepLaw = Field(
        "table",
        description="Creep forces: table of FASTSIM, Polach's law, or FASTSIM itself (slow, the reference)",
    )
    youngs_modulus: float = quantity("Pa", "Young's modulus of wheel and rail", ge=1e10, le=1e12)
    poisson_ratio: float = quantity("-", "Poisson's ratio of wheel and rail", gt=0.0, lt=0.5)
    regularisation: float = quantity(
        "-",
        "quasi-elastic smoothing depth of the gap over the penetration under the static wheel load",
        ge=0.01,
        le=1.0,
    )
    table_step: float = quantity("m", "lateral step of the table and of the profile grid", ge=1e-5, le=5e-4)
    table_half_width: float = quantity(
        "m", "largest lateral shift of a wheel against its rail in the table", ge=5e-3, le=2e-2
    )

    @model_validator(mode="after")
    def _whole_steps(self) -> ContactConfig:
        if abs(self.half_nodes * self.table_step - self.table_half_width) > 1e-9:
            raise ValueError("table_half_width must be a whole number of table_step")
        return self

    @property
    def half_nodes(self) -> int:
        """Number of table steps on each side of the centre."""
        return round(self.table_half_width / self.table_step)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus G = E / (2 (1 + nu)) (Pa)."""
        return self.youngs_modulus / (2.0 * (1.0 + self.poisson_ratio))
