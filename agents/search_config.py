"""Schema of a search for the settings of a training."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import Field, model_validator

from sayd_env.agents.config import Count
from sayd_env.config import Model
from sayd_env.config.base import Number
from sayd_env.config.layers import Kind, read_layered

TrainingSeed = Annotated[int, Field(strict=True, ge=0, lt=1_000_000)]


class RangeConfig(Model):
    """Where a setting is looked for: an interval, or some values."""

    low: Number | None = Field(None, description="Lowest value")
    high: Number | None = Field(None, description="Highest value")
    log: bool = Field(False, description="Equally likely are equal ratios, not equal differences")
    whole: bool = Field(False, description="Whole numbers only")
    choices: tuple[Any, ...] = Field((), max_length=32, description="In place of an interval")

    @model_validator(mode="after")
    def _one_of_both(self) -> RangeConfig:
        if self.choices:
            if self.low is not None or self.high is not None:
                raise ValueError("found both an interval and choices; expected one of them")
            return self
        if self.low is None or self.high is None or not self.low < self.high:
            raise ValueError("expected low below high, or choices")
        if self.log and self.low <= 0.0:
            raise ValueError(f"low ({self.low:g}) must be positive with log")
        if self.whole and not (self.low.is_integer() and self.high.is_integer()):
            raise ValueError("low and high must be whole numbers with whole")
        return self

    def holds(self, value: Any) -> bool:
        """Whether a value can be drawn."""
        if self.choices:
            return value in self.choices
        if not isinstance(value, int | float):
            return False
        assert self.low is not None  # the validator has made sure
        assert self.high is not None
        return bool(self.low <= value <= self.high) and (not self.whole or float(value).is_integer())


class QuickSearchConfig(Model):
    """Numbers of a look at a search."""

    trials: Count = Field(description="Trainings in all")
    total_steps: Count = Field(description="Steps of each")


class SearchConfig(Model):
    """A search: trials are short trainings, judged as each training judges its policies."""

    description: str = ""
    training: str = Field(min_length=1, description="Packaged training, or a path to its YAML file")
    trials: Count = Field(description="Trainings before the finalists'")
    total_steps: Count = Field(description="Steps of each, unless it is given up")
    training_seed: TrainingSeed = Field(description="Of each")
    finalists: Count = Field(description="Best trials that are repeated, beside the training's own settings")
    finalist_seeds: tuple[TrainingSeed, ...] = Field(
        description="Further training seeds of these; the lowest mean of all seeds wins. None: the best trial"
    )
    random_trials: Count = Field(description="Trials before the search learns from former ones")
    give_up_after: float = Field(
        strict=True,
        ge=0.0,
        le=1.0,
        description="Share of the steps (-) after which a trial worse than the median is given up",
    )
    ranges: dict[str, RangeConfig] = Field(min_length=1, description="Settings of the training, dotted keys")
    quick: QuickSearchConfig = Field(description="What makes it a look, not a result")

    def shortened(self) -> SearchConfig:
        """The same with the numbers of `quick`."""
        quick = self.quick
        fewer = min(self.random_trials, quick.trials)
        return self.model_copy(
            update={
                "trials": quick.trials,
                "total_steps": quick.total_steps,
                "random_trials": fewer,
                "finalist_seeds": (),
            }
        )


def load_search(name: str, overrides: Iterable[str] = ()) -> SearchConfig:
    """Read a search: a packaged name (``ppo``, ``sac``) or a path to a YAML file.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used; the message names it and what is allowed.
    """
    return read_layered(SearchConfig, Kind("search", names=("training",)), name, overrides)
