"""Schema of the lines on which it is looked for what adaptation is worth."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import Field, model_validator

from sayd_env.config.base import Model, Seed, Share, quantity
from sayd_env.config.limits import LIMITS
from sayd_env.config.loader import read_study


class DrawnLinesConfig(Model):
    """Lines that an environment draws."""

    environment: str = Field(min_length=1, description="Environment with `lines`: a name or a path")
    seeds: tuple[Seed, ...] = Field(description="Their episodes 0 are run")


class QuickHindsight(Model):
    """What a look takes of it."""

    lines: tuple[str, ...] = Field(min_length=1)
    drawn: int = quantity("-", "Number of the first drawn lines", ge=0)
    openings: tuple[Share, ...] = Field(min_length=1)


class HindsightConfig(Model):
    """Lines, commands and policies."""

    description: str = ""
    study: str = Field(min_length=1, description="Scenario: name of a packaged study, or a path")
    environment: str = Field(min_length=1, description="Sensors and clock: a name or a path")
    lines: tuple[str, ...] = Field(description="Names of lines, or paths to YAML or CSV files")
    speed_kmh: float = quantity(
        "km/h",
        "Speed on lines that leave it out",
        ge=LIMITS["speed_kmh"].low,
        le=LIMITS["speed_kmh"].high,
    )
    drawn: DrawnLinesConfig
    seeds: tuple[Seed, ...] = Field(min_length=1, description="Of tracks")
    openings: tuple[Share, ...] = Field(
        min_length=1, description="Commands beside 0, as shares of the valve's travel beyond its overlap (-)"
    )
    refinements: int = quantity("-", "How often the steps around the best commands are halved", ge=0, le=8)
    policies: tuple[str, ...] = Field(description="Controllers beside the commands, as on a command line")
    quick: QuickHindsight

    @model_validator(mode="after")
    def _some(self) -> HindsightConfig:
        if not self.lines and not self.drawn.seeds:
            raise ValueError("found no line, neither in lines nor in drawn.seeds")
        for given in (self.lines, self.drawn.seeds, self.seeds, self.policies):
            if len(set(given)) < len(given):
                raise ValueError(f"found a duplicate in {', '.join(map(str, given))}")
        return self

    def shortened(self) -> HindsightConfig:
        """A line or two and a few commands: for a look at what comes out."""
        seeds = self.drawn.seeds[: self.quick.drawn]
        return self.model_copy(
            update={
                "lines": self.quick.lines,
                "drawn": self.drawn.model_copy(update={"seeds": seeds}),
                "openings": self.quick.openings,
                "refinements": 0,
            }
        )


def load_hindsight(name: str = "hindsight", overrides: Iterable[str] = ()) -> HindsightConfig:
    """Read the lines by packaged name or path; paths in it are relative to it.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_study(
        HindsightConfig, name, overrides, "study", "environment", "lines.*", "drawn.environment"
    )
