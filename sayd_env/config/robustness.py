"""Schema of what a policy is tried with beyond its training: disturbances and single faults."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from sayd_env.config.base import Model, Number, Seed, Share, quantity
from sayd_env.config.fault import (
    DamperFaultClass,
    Fault,
    FaultClass,
    SensorErrorClass,
    SensorFaultClass,
    ValveStuckClass,
    parse_faults,
)
from sayd_env.config.limits import LIMITS
from sayd_env.config.loader import read_study
from sayd_env.config.sensors import DAMPERS, KINDS, SIGNALS, SensorKind, SensorsConfig
from sayd_env.config.track import check_track

DisturbedQuantity = Literal["sensor_noise", "delay", "lag", "wear", "friction", "payload"]

MOST_DELAY = 0.15
"""s: with a driver's own delay of some milliseconds within the 0.2 s that a valve may have."""
_ALLOWED: Mapping[str, tuple[float, float]] = {
    **{name: LIMITS[name][:2] for name in ("sensor_noise", "wear", "friction", "payload")},
    "delay": (0.0, MOST_DELAY),
    "lag": LIMITS["factor"][:2],
}


class Axis(Model):
    """One quantity that leaves what a policy has been trained or tuned for."""

    name: str = Field(min_length=1, description="How tables call it")
    quantity: DisturbedQuantity = Field(
        description="sensor_noise: factor on the noise of all sensors; delay: added to the driver's of the "
        "valves (s); lag: factor on the valves' time constant; wear, friction; payload: change of the "
        "carbody's mass and inertia, as a share"
    )
    values: tuple[Number, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _within(self) -> Axis:
        low, high = _ALLOWED[self.quantity]
        for value in self.values:
            if not low <= value <= high:
                raise ValueError(f"{self.quantity}: found {value:g}; allowed are {low:g} to {high:g}")
            if self.values.count(value) > 1:
                raise ValueError(f"{self.quantity}: {value:g} is a duplicate")
        return self


class OperatingCondition(Model):
    """In which a policy is tried."""

    speed_kmh: float = quantity("km/h", "Speed", ge=LIMITS["speed_kmh"].low, le=LIMITS["speed_kmh"].high)
    wear: float = quantity("-", "Wear of the treads", ge=0.0, le=LIMITS["wear"].high)
    friction: float = quantity(
        "-", "Coefficient of friction", ge=LIMITS["friction"].low, le=LIMITS["friction"].high
    )

    @property
    def text(self) -> str:
        """In words."""
        return f"{self.speed_kmh:g} km/h, wear {self.wear:g}, friction {self.friction:g}"


class FaultPlaces(Model):
    """Where single faults happen: each in all of its places, one after the other."""

    dampers: tuple[str, ...] = Field(min_length=1, description="Of valves and dampers")
    signals: dict[SensorKind, tuple[str, ...]] = Field(description="Of sensors, of each kind at least one")

    @model_validator(mode="after")
    def _known(self) -> FaultPlaces:
        for damper in self.dampers:
            if damper not in DAMPERS:
                raise ValueError(f"dampers: found '{damper}'; expected one of {', '.join(DAMPERS)}")
        for kind in KINDS:
            if not self.signals.get(kind):
                raise ValueError(f"signals: found none of the kind {kind}")
            for signal in self.signals[kind]:
                if SIGNALS.get(signal) != kind:
                    raise ValueError(f"signals: {kind}: found '{signal}', which is no signal of this kind")
        return self


class Asked(Model):
    """What a policy is asked for."""

    to_passive: float = quantity("-", "With a fault: largest J over the passive vehicle's", gt=0.0)
    to_best_constant: float = quantity(
        "-", "or over that of the best constant command with the same fault", gt=0.0
    )
    worse_than_passive: float = quantity(
        "-", "Without a fault: how much J may exceed the passive vehicle's, as a share", ge=0.0
    )


class QuickRobustness(Model):
    """What a look takes of it: the first conditions, seed, places and constant commands."""

    conditions: int = quantity("-", "Number of conditions", ge=1)
    episode_s: float = quantity("s", "Time over which J is taken", gt=0.0)
    values: int = quantity("-", "Number of the last values of each axis", ge=1)
    constants: tuple[Share, ...] = Field(min_length=1)


class RobustnessConfig(Model):
    """Conditions, disturbances and faults."""

    description: str = ""
    environment: str = Field(min_length=1, description="Sensors and clock, tolerances and loads by seed")
    track: str | None = Field(description="Irregularities: name of a track, or a path; null: the study's")
    conditions: tuple[OperatingCondition, ...] = Field(min_length=1)
    seeds: tuple[Seed, ...] = Field(min_length=1, description="Of tracks, tolerances and sensor errors")
    episode_s: float = quantity("s", "Time over which J is taken", gt=0.0, le=600.0)
    policies: tuple[str, ...] = Field(min_length=1, description="As on a command line, beside passive")
    constants: tuple[Share, ...] = Field(
        min_length=1, description="Valve commands (-), of which the best in each condition is a bound"
    )
    axes: tuple[Axis, ...]
    faults: str = Field(min_length=1, description="Environment whose classes of faults are run through")
    onset: float = quantity("s", "Time after step 0 at which a fault happens", ge=0.0)
    places: FaultPlaces
    asked: Asked
    quick: QuickRobustness

    @field_validator("track")
    @classmethod
    def _readable(cls, track: str | None) -> str | None:
        if track is not None:
            check_track(track, scaled=False)
        return track

    @model_validator(mode="after")
    def _once(self) -> RobustnessConfig:
        names = tuple(axis.name for axis in self.axes)
        lists: tuple[tuple[Any, ...], ...] = self.conditions, self.seeds, self.policies, self.constants, names
        for given in lists:
            if any(given.count(each) > 1 for each in given):
                raise ValueError(f"found a duplicate in {', '.join(map(str, given))}")
        if self.onset >= self.episode_s:
            raise ValueError(f"onset {self.onset:g} s must be below episode_s {self.episode_s:g} s")
        return self

    def shortened(self) -> RobustnessConfig:
        """A condition or two, a seed and a few values: for a look at what comes out."""
        quick = self.quick
        first = {kind: signals[:1] for kind, signals in self.places.signals.items()}
        places = self.places.model_copy(update={"dampers": self.places.dampers[:1], "signals": first})
        axes = [axis.model_copy(update={"values": axis.values[-quick.values :]}) for axis in self.axes]
        return self.model_copy(
            update={
                "conditions": self.conditions[: quick.conditions],
                "seeds": self.seeds[:1],
                "episode_s": min(self.episode_s, quick.episode_s),
                "constants": quick.constants,
                "axes": tuple(axes),
                "onset": min(self.onset, 0.1 * quick.episode_s),
                "places": places,
            }
        )


def load_robustness(name: str = "robustness", overrides: Iterable[str] = ()) -> RobustnessConfig:
    """Read the study by packaged name or path; paths in it are relative to it.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_study(RobustnessConfig, name, overrides, "environment", "faults", "track")


def single_faults(
    classes: Iterable[FaultClass], places: FaultPlaces, sensors: SensorsConfig, onset: float
) -> dict[str, Fault]:
    """Each single fault of some classes by its name, in each of its places.

    Of a size that is drawn the middle is taken for a valve's position and the largest for a sensor's error.

    Parameters
    ----------
    classes : iterable of FaultClass
        Those of an environment.
    places : FaultPlaces
    sensors : SensorsConfig
        Whose ranges sizes of errors are shares of.
    onset : float
        Time after step 0 (s).
    """
    found: dict[str, Fault] = {}
    for kind in classes:
        for name, raw in _faults_of(kind, places, sensors):
            (fault,) = parse_faults([{"kind": kind.kind, "start_s": onset} | raw], "robustness")
            found[name] = fault
    return found


def _faults_of(
    kind: FaultClass, places: FaultPlaces, sensors: SensorsConfig
) -> Iterator[tuple[str, dict[str, Any]]]:
    what = kind.kind.replace("_", " ")
    match kind:
        case ValveStuckClass():
            current = 0.5 * sum(kind.current.bounds)
            how = {0.0: "closed", 1.0: "open"}.get(current, f"at {current:g}")
            for damper in places.dampers:
                yield f"{what} {how}, {damper}", {"damper": damper, "current": current}
        case DamperFaultClass():
            for damper in places.dampers:
                yield f"{what}, {damper}", {"damper": damper}
        case SensorFaultClass() | SensorErrorClass():
            for sensor in kind.sensors:
                for signal in places.signals[sensor]:
                    yield f"{what}, {signal}", {"signal": signal} | _size(kind, sensors, signal)


def _size(kind: SensorFaultClass | SensorErrorClass, sensors: SensorsConfig, signal: str) -> dict[str, float]:
    """The largest error that is drawn, in the unit of the signal."""
    if isinstance(kind, SensorFaultClass):
        return {}
    sensor = sensors.of(signal)
    amount = kind.share.bounds[1] * 0.5 * (sensor.high - sensor.low)
    return {"bias" if kind.kind == "sensor_biased" else "noise": amount}
