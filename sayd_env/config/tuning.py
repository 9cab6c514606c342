"""Schema of a tuning: scenarios, ranges of a controller's gains, and the budget of the search."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import Field, field_validator, model_validator

from sayd_env.config.base import Model, Number, Seed, quantity
from sayd_env.config.control import CONTROLLERS, gains_of, load_controller
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import nearest
from sayd_env.config.loader import read_study
from sayd_env.config.reward import MeanName, RewardName

Gains = Mapping[str, float]
"""Values of a controller's gains by name."""


class TuningScenario(Model):
    """Conditions of one run; everything else is drawn from its seed as the environment has it."""

    profile: str | None = Field(
        None, min_length=1, description="Wheel profile, as an episode's option; null: drawn"
    )
    speed_kmh: float = quantity("km/h", "Speed", gt=0.0)
    wear: float = quantity("-", "Wear of the treads, 0 new, 1 worn", ge=0.0, le=1.0)
    friction: float = quantity("-", "Coefficient of friction", gt=0.0, le=1.0)
    seed: int = Field(description="Seed of everything else", ge=0, strict=True)

    @property
    def case(self) -> dict[str, Any]:
        """The seed, and the options of its episode."""
        return {name: value for name, value in self.model_dump().items() if value is not None}


class TunedLines(Model):
    """Lines, on which everything is drawn from the seeds."""

    environment: str = Field(min_length=1, description="Environment with `lines`: a packaged name or a path")
    seeds: tuple[Seed, ...] = Field(min_length=1, description="Of their episodes 0")
    episode_s: float = quantity("s", "Time over which J is taken", gt=0.0)


class GainRange(Model):
    """Range in which a gain is searched, in the gain's own unit."""

    low: Number = Field(description="Lower end", allow_inf_nan=False)
    high: Number = Field(description="Upper end", allow_inf_nan=False)
    share_of: str | None = Field(
        None, description="Another gain, of which the range is that of a share: keeps two thresholds in order"
    )

    @model_validator(mode="after")
    def _rises(self) -> GainRange:
        if not self.low < self.high:
            raise ValueError("needs low < high")
        return self

    @property
    def text(self) -> str:
        """In words."""
        return f"{self.low:g} to {self.high:g}{f' of {self.share_of}' if self.share_of else ''}"


class ControllerTuning(Model):
    """A search for the gains of one controller."""

    gains: dict[str, GainRange] = Field(min_length=1)
    guesses: tuple[dict[str, Number], ...] = Field(
        (), description="Points of the ranges (shares as such) that the global search starts with"
    )
    search: int = quantity("-", "Evaluations of the global search; 0: none", default=0, ge=0)
    population: int = quantity("-", "Points of a generation", default=5, ge=5)
    polish: int = quantity("-", "Evaluations of the local search", ge=0)
    radius: float = quantity(
        "-", "First step of the local search, as a share of half the ranges", default=0.2, gt=0.01, le=1.0
    )

    @model_validator(mode="after")
    def _fits(self) -> ControllerTuning:
        for name, gain in self.gains.items():
            whole = None if gain.share_of is None else self.gains.get(gain.share_of)
            if gain.share_of is not None and (whole is None or whole.share_of is not None):
                raise ValueError(f"{name}: '{gain.share_of}' is not an independent gain of this list")
        for guess in self.guesses:
            if set(guess) != set(self.gains):
                raise ValueError(f"a guess needs a value of each of {', '.join(self.gains)}")
            for name, value in guess.items():
                if not self.gains[name].low <= value <= self.gains[name].high:
                    raise ValueError(f"a guess of {name}, {value:g}, lies outside its range")
        self._check_budget()
        return self

    def _check_budget(self) -> None:
        if len(self.gains) > 1 and self.search < self.population:
            raise ValueError(
                f"several gains need a global search of at least one generation: search {self.search}, "
                f"population {self.population}"
            )
        if len(self.gains) > 1 and 0 < self.polish < len(self.gains) + 2:
            raise ValueError(
                f"the local search of {len(self.gains)} gains needs {len(self.gains) + 2} evaluations or none"
            )
        if len(self.gains) == 1 and self.search in (1, 2):
            raise ValueError("the global search of one gain needs three evaluations or none")
        if len(self.gains) == 1 and (self.polish == 1 or self.search == self.polish == 0):
            raise ValueError(
                "the local search of one gain needs two evaluations, or none behind a global one"
            )
        if self.population < 1 + len(self.guesses):
            raise ValueError(f"the population of {self.population} is too small for all guesses")

    def values(self, place: Iterable[float], digits: int) -> dict[str, float]:
        """Gains at a place of the ranges, rounded; shares become values."""
        raw = dict(zip(self.gains, map(float, place), strict=True))
        values = {
            name: value if self.gains[name].share_of is None else value * raw[str(self.gains[name].share_of)]
            for name, value in raw.items()
        }
        return {name: round(value, digits) + 0.0 for name, value in values.items()}

    def place(self, values: Gains) -> list[float]:
        """Place of gains in the ranges; values outside are clipped to its ends."""
        places = []
        for name, gain in self.gains.items():
            whole = 1.0 if gain.share_of is None else values[gain.share_of]
            share = values[name] / whole if whole else 0.0
            places.append(min(max(share, gain.low), gain.high))
        return places


class QuickTuning(Model):
    """Budget of a quick run."""

    scenarios: int = quantity("-", "Scenarios, spread over the list", ge=1)
    lines: int = quantity("-", "Number of the first lines", ge=0)
    search: int = quantity("-", "Evaluations of the global search", ge=5)
    population: int = quantity("-", "Points of a generation", ge=5)
    polish: int = quantity("-", "Evaluations of the local search", ge=0)

    def budget(self, tuning: ControllerTuning) -> dict[str, int]:
        """Evaluations of a search: a global one, and behind that of one gain a local one."""
        polish = min(tuning.polish, self.polish) if len(tuning.gains) == 1 else 0
        return {
            "population": self.population,
            "search": self.search,
            "polish": polish if polish >= 2 else 0,
        }


class TuningConfig(Model):
    """Scenarios, references and searches."""

    description: str = ""
    environment: str = Field(min_length=1, description="Environment: a packaged name or a path")
    episode_s: float = quantity("s", "Time over which J is taken", gt=0.0)
    reward: RewardName = Field(None, description="Weights of J, by name; null: the study's")
    initial_current: float = quantity("-", "Valve command of the run-in", ge=0.0, le=1.0)
    mean: MeanName = Field("geometric", description="Mean of J over scenarios and lines that is to be small")
    digits: int = quantity("-", "Decimal places of a gain", ge=1, le=12)
    references: tuple[str, ...] = Field((), description="Policies that are also run on the list")
    scenarios: tuple[TuningScenario, ...] = Field(min_length=1)
    lines: TunedLines | None = Field(None, description="Lines beside them; null: none")
    controllers: dict[str, ControllerTuning] = Field(min_length=1)
    quick: QuickTuning

    @field_validator("controllers")
    @classmethod
    def _known(cls, controllers: dict[str, ControllerTuning]) -> dict[str, ControllerTuning]:
        for name, tuning in controllers.items():
            if name not in CONTROLLERS:
                raise ValueError(f"unknown controller '{name}'{nearest(name, CONTROLLERS)}")
            known = gains_of(load_controller(name))
            for gain in tuning.gains:
                if gain not in known:
                    raise ValueError(f"{name}: unknown gain '{gain}'{nearest(gain, known)}")
            ends = ([r.low for r in tuning.gains.values()], [r.high for r in tuning.gains.values()])
            for end in ends:
                try:
                    load_controller(name, tuning.values(end, 12))
                except ConfigError as error:
                    raise ValueError(f"an end of the ranges is not allowed: {error}") from None
        return controllers

    @model_validator(mode="after")
    def _other_seeds(self) -> TuningConfig:
        seeds = [*(each.seed for each in self.scenarios), *(self.lines.seeds if self.lines else ())]
        for seed in seeds:
            if seeds.count(seed) > 1:
                raise ValueError(f"the seed {seed} is a duplicate")
        return self

    def of(self, controller: str) -> ControllerTuning:
        """Search for a controller's gains.

        Raises
        ------
        ConfigError
            There is none.
        """
        if controller not in self.controllers:
            raise ConfigError(
                f"tune {controller}: no such search{nearest(controller, self.controllers)}; "
                f"available: {', '.join(self.controllers)}"
            )
        return self.controllers[controller]

    def shortened(self) -> TuningConfig:
        """The same with the budget of a quick run."""
        every = max(1, len(self.scenarios) // self.quick.scenarios)
        searches = {
            name: tuning.model_copy(update=self.quick.budget(tuning))
            for name, tuning in self.controllers.items()
        }
        kept = self.scenarios[every - 1 :: every][: self.quick.scenarios]
        lines = self.lines
        if lines is not None:
            seeds = lines.seeds[: self.quick.lines]
            lines = lines.model_copy(update={"seeds": seeds}) if seeds else None
        return self.model_copy(update={"scenarios": kept, "lines": lines, "controllers": searches})

    @property
    def seconds(self) -> float:
        """Simulated time of one evaluation (s), without run-ins, which are made once."""
        lines = 0.0 if self.lines is None else len(self.lines.seeds) * self.lines.episode_s
        return len(self.scenarios) * self.episode_s + lines


def load_tuning(name: str = "tuning", overrides: Iterable[str] = ()) -> TuningConfig:
    """Read a tuning by packaged name or path; paths in it are relative to it.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_study(TuningConfig, name, overrides, "environment", "lines.environment")
