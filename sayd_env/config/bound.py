"""Schema of the conditions in which a search looks for what the best possible controller could reach."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from sayd_env.config.base import Model, Number, quantity
from sayd_env.config.loader import read_study
from sayd_env.config.reward import RewardName

_FILES = ("track", "profile", "line", "environment")
"""Keys of a condition that may name a file."""


class BoundCondition(Model):
    """An episode: what is given is fixed, the rest is drawn from the seed as the environment has it."""

    seed: int = Field(description="Of the track, and of what is drawn", strict=True, ge=0, lt=2**32)
    environment: str | None = Field(None, min_length=1, description="In place of the study's; null: that")
    episode_s: float | None = quantity("s", "In place of the study's; null: that", default=None, gt=0.0)
    speed_kmh: float | None = quantity("km/h", "Speed", default=None, gt=0.0)
    wear: float | None = quantity("-", "Wear of the treads, 0 new, 1 worn", default=None, ge=0.0, le=1.0)
    friction: float | None = quantity("-", "Coefficient of friction", default=None, gt=0.0)
    gauge: float | None = quantity("m", "Track gauge", default=None, gt=0.0)
    payload: float | None = quantity("-", "Change of the carbody's mass, as a share", default=None)
    profile: str | None = Field(None, min_length=1, description="Wheel profile: a name or a path")
    track: str | None = Field(None, min_length=1, description="Track of the irregularities: a name or a path")
    track_scale: float | None = quantity("-", "Factor on their amplitudes", default=None, ge=0.0)
    line: str | None = Field(None, min_length=1, description="What changes along the way: a name or a path")

    @property
    def options(self) -> dict[str, Any]:
        """Options of the episode."""
        return self.model_dump(exclude_none=True, exclude={"seed", "environment", "episode_s"})

    @property
    def text(self) -> str:
        """In words."""
        words = [] if self.environment is None else [Path(self.environment).stem]
        for key, unit in (("speed_kmh", " km/h"), ("wear", ""), ("friction", ""), ("gauge", " m")):
            if (value := getattr(self, key)) is not None:
                words.append(f"{'' if key == 'speed_kmh' else key + ' '}{value:g}{unit}")
        if self.profile is not None:
            words.append(Path(self.profile).stem)
        if self.track is not None:
            scale = "" if self.track_scale is None else f" x {self.track_scale:g}"
            words.append(f"{Path(self.track).stem}{scale}")
        if self.line is not None:
            words.append(f"line {Path(self.line).stem}")
        return ", ".join([*words, f"seed {self.seed}"])


class BoundConditions(Model):
    """Conditions in a file of their own."""

    description: str = ""
    conditions: tuple[BoundCondition, ...] = Field(min_length=1)

    @field_validator("conditions")
    @classmethod
    def _once(cls, conditions: tuple[BoundCondition, ...]) -> tuple[BoundCondition, ...]:
        for each in conditions:
            if conditions.count(each) > 1:
                raise ValueError(f"'{each.text}' is a duplicate")
        return conditions


class ConstantSearch(Model):
    """The search for the best constant command of a condition, and of each section of its line."""

    abreast: int = quantity("-", "Commands of a round, run side by side", ge=3, le=64)
    rounds: int = quantity("-", "Rounds; each looks between the neighbours of the best so far", ge=1, le=12)
    refinements: int = quantity("-", "How often the steps around each section's best are halved", ge=0, le=8)


class SequenceSearch(Model):
    """The search over command sequences: cross-entropy method with a receding horizon."""

    samples: int = quantity("-", "Sequences of an iteration, run side by side", ge=4, le=4096)
    iterations: int = quantity("-", "Iterations at each decision", ge=1, le=100)
    passes: int = quantity("-", "Passes over the episode, each from what the last one found", ge=1, le=20)
    replan_s: float = quantity("s", "Time between decisions", gt=0.0, le=10.0)
    window_s: float = quantity("s", "Over which a decision may change the plan", gt=0.0, le=60.0)
    horizon_s: float = quantity("s", "How far each decision looks ahead", gt=0.0, le=60.0)
    knots_s: tuple[Annotated[Number, Field(gt=0.0)], ...] = Field(
        min_length=1,
        description="Distances of the knots of a change (s), in turn from iteration to iteration",
    )
    spread: float = quantity("-", "Standard deviation of a change at a knot, at first", ge=0.0, le=1.0)
    elite: float = quantity("-", "Share of the sequences of which the spread is learned", gt=0.0, le=1.0)
    seed: int = Field(description="Of the search", strict=True, ge=0, lt=2**32)

    @model_validator(mode="after")
    def _looks_ahead(self) -> SequenceSearch:
        if not self.replan_s <= self.window_s <= self.horizon_s:
            raise ValueError(
                f"replan_s ({self.replan_s:g} s), window_s ({self.window_s:g} s) and horizon_s "
                f"({self.horizon_s:g} s) must not fall in this order"
            )
        return self


class Convergence(Model):
    """Settings beside the study's own, to show what the search depends on."""

    conditions: int = quantity("-", "Number of the first conditions", ge=1)
    samples: tuple[Annotated[int, Field(strict=True, ge=4, le=4096)], ...] = Field(min_length=1)
    horizons_s: tuple[Annotated[Number, Field(gt=0.0, le=60.0)], ...] = Field(min_length=1)


class QuickBound(Model):
    """What a look takes of it."""

    conditions: int = quantity("-", "Number of the first conditions", ge=1)
    episode_s: float = quantity("s", "Length of their episodes", gt=0.0)
    samples: int = quantity("-", "Sequences of an iteration", ge=4)
    iterations: int = quantity("-", "Iterations at each decision", ge=1)


class BoundConfig(BoundConditions):
    """Conditions, policies and the searches."""

    environment: str = Field(min_length=1, description="Name of an environment, or a path to its YAML file")
    episode_s: float = quantity("s", "Time over which J is taken", gt=0.0)
    reward: RewardName = Field(description="Weights of J")
    initial_current: float = quantity("-", "Valve command of the run-in", ge=0.0, le=1.0)
    policies: tuple[str, ...] = Field(
        description="Controllers, as on a command line; mppt2 takes part always"
    )
    constant: ConstantSearch
    search: SequenceSearch
    convergence: Convergence
    quick: QuickBound

    @model_validator(mode="after")
    def _policies_once(self) -> BoundConfig:
        if len(set(self.policies)) < len(self.policies):
            raise ValueError(f"found a duplicate in {', '.join(self.policies)}")
        return self

    @model_validator(mode="after")
    def _horizons_reach(self) -> BoundConfig:
        least = self.search.window_s
        for horizon in self.convergence.horizons_s:
            if horizon < least:
                raise ValueError(f"convergence.horizons_s: found {horizon:g} s; expected {least:g} s or more")
        return self

    def with_search(self, **changes: Any) -> SequenceSearch:
        """The search with other settings, checked as a whole."""
        return SequenceSearch.model_validate(self.search.model_dump() | changes)

    def of(self, conditions: BoundConditions) -> BoundConfig:
        """The same study of other conditions."""
        return self.model_copy(update={"conditions": conditions.conditions})

    def shortened(self) -> BoundConfig:
        """A condition or two, short episodes and a small search: for a look at what comes out."""
        few = self.conditions[: self.quick.conditions]
        search = {"samples": self.quick.samples, "iterations": self.quick.iterations}
        return self.model_copy(
            update={
                "conditions": tuple(each.model_copy(update={"episode_s": None}) for each in few),
                "episode_s": self.quick.episode_s,
                "search": self.with_search(**search),
            }
        )


def load_bound(name: str = "bound", overrides: Iterable[str] = ()) -> BoundConfig:
    """Read the study by packaged name or path; paths in it are relative to it.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_study(BoundConfig, name, overrides, "environment", *_PLACES)


def load_conditions(name_or_path: str) -> BoundConditions:
    """Read conditions alone: a file with the key ``conditions``, as in the study; paths are relative to it.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_study(BoundConditions, name_or_path, (), *_PLACES)


_PLACES = tuple(f"conditions.*.{key}" for key in _FILES)
