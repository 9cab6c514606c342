"""Base of all configuration: frozen, strict models whose fields know their unit."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

Number = Annotated[float, Field(strict=True)]
"""A number in a list: neither text nor true or false will do."""
Share = Annotated[Number, Field(ge=0.0, le=1.0)]
"""A number from 0 to 1 in a list."""
Seed = Annotated[int, Field(strict=True, ge=0, lt=2**32)]
"""Of random draws."""


class Model(BaseModel):
    """A frozen configuration section; unknown keys and non-finite numbers are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True, arbitrary_types_allowed=False
    )


class Provenance(Model):
    """Where calibrated numbers come from: any keys and values."""

    model_config = ConfigDict(extra="allow")


class Part(Model):
    """What one file describes."""

    provenance: Provenance = Field(Provenance(), description="Where calibrated numbers come from")


def quantity(unit: str, doc: str, *, default: Any = ..., **bounds: Any) -> Any:
    """Field of a physical quantity: number with a unit.

    Parameters
    ----------
    unit : str
        SI unit, "-" for dimensionless. Shown in error messages.
    doc : str
        What the quantity is.
    default : Any
        Default value; required when omitted.
    **bounds
        Pydantic's numeric bounds: ``gt``, ``ge``, ``lt``, ``le``.
    """
    return Field(
        default, description=f"{doc} ({unit})", json_schema_extra={"unit": unit}, strict=True, **bounds
    )


def is_multiple(value: float, of: float) -> bool:
    """Whether a number is a whole multiple of another one, at least once it, up to rounding."""
    ratio = value / of
    count = round(ratio) if math.isfinite(ratio) else 0
    return count >= 1 and abs(value - count * of) <= 1e-9 * value
