"""What an episode is: its conditions and faults, drawn from the seed, fixed by options, put into a scenario.

Seeds
-----
Episode k of seed s has the seed sequence [s, k]. The track uses this sequence itself, so that the track of
episode 0 is that of seed s in the studies. Every other component has a child of its own, spawn key (1,) to
(5,), and every quantity of the scenario has a child of that by its name. So no draw affects another one:
neither an option, nor another distribution, nor the length of the episodes before.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from operator import itemgetter
from typing import Any, Literal

import numpy as np

from sayd_env.config import ConfigError, validate
from sayd_env.config.conditions import Line
from sayd_env.config.distribution import chosen
from sayd_env.config.environment import EnvironmentConfig, ProfileClass
from sayd_env.config.fault import (
    MOST_FAULTS,
    DamperFaultClass,
    Fault,
    FaultsConfig,
    SensorErrorClass,
    ValveStuckClass,
    parse_faults,
)
from sayd_env.config.line import LineConfig
from sayd_env.config.lines import draw_line
from sayd_env.config.loader import is_path
from sayd_env.config.profile import WheelProfileConfig, load_wheel, shifted
from sayd_env.config.scaling import scaled
from sayd_env.config.scenario import Scenario
from sayd_env.config.sensors import DAMPERS, SIGNALS, SensorConfig, SensorsConfig
from sayd_env.config.track import IrregularityConfig, TrackClass, read_irregularity, scalable
from sayd_env.config.units import KMH, Array
from sayd_env.envs.options import NUMBERS, PROFILES, EpisodeOptions, checked_options, whole_number
from sayd_env.measured.lines import refuse_said

Component = Literal["scenario", "sensors", "faults", "noise", "spare"]
STREAMS: Mapping[Component, int] = {"scenario": 1, "sensors": 2, "faults": 3, "noise": 4, "spare": 5}
"""Spawn keys of the components' random streams."""


@dataclass(frozen=True, eq=False)
class Episode:
    """The conditions of one episode."""

    seed: int
    """Seed s of the environment."""
    number: int
    """Number k of the episode."""
    speed: float
    """m/s."""
    profile: str | None
    """Wheel profile; None: the scenario's."""
    wheel: WheelProfileConfig | None = field(repr=False)
    """This profile, as its file has it; None: the scenario's."""
    wheel_shift: float | None
    """Outward shift of the profile (m), in place of its own; None: its own."""
    wear: float | None
    """0 new to 1 worn, and 0 for a profile that does not wear; None: the scenario's."""
    gauge: float | None
    """Track gauge (m); None: the scenario's."""
    friction: float | None
    """Coefficient of friction; None: the scenario's."""
    payload: float
    """Change of the carbody's mass and inertia, as a share of it."""
    initial_current: float
    """Valve command during the run-in, 0 closed to 1 open."""
    track: str | None
    """Track whose irregularities the episode has; None: the scenario's."""
    irregularity: IrregularityConfig | None = field(repr=False)
    """These irregularities, at the scale of their file; None: the scenario's."""
    track_scale: float | None
    """Factor on their amplitudes, in place of their own; None: their own."""
    line: str | LineConfig | Line | None = field(repr=False)
    """What changes along the way: a name, a path, a content or a drawn line; None: nothing."""
    tolerances: Mapping[str, float] = field(repr=False)
    """Factor on each of some numbers of the scenario; keys as in `ToleranceConfig`."""
    sensor_bias: Array = field(repr=False)
    """(41,) error of each signal's sensor beside its configured bias, in the signal's unit, as `SIGNALS`."""
    sensor_noise: Array = field(repr=False)
    """(41,) factor on the noise of each signal's sensor."""
    faults: tuple[Fault, ...]
    """Faults of valves, dampers and sensors."""

    @property
    def track_seed(self) -> int:
        """Seed of the track's irregularities: the seed sequence [s, k] written as one number."""
        words = max(1, -(-self.seed.bit_length() // 32))
        return self.seed | (self.number << (32 * words))

    def stream(self, component: Component) -> np.random.SeedSequence:
        """Seed sequence of a component, for draws beyond those of this episode."""
        return np.random.SeedSequence([self.seed, self.number], spawn_key=(STREAMS[component],))


def draw_episode(
    config: EnvironmentConfig,
    seed: int,
    episode: int,
    options: Mapping[str, Any] | None = None,
    base: Scenario | None = None,
) -> Episode:
    """Draw the conditions of an episode.

    Parameters
    ----------
    config : EnvironmentConfig
        The environment with the distributions of what is drawn.
    seed : int
        Seed of the environment, 0 or more. Seeds below 2^32 have no track in common.
    episode : int
        Number of the episode, 0 or more.
    options : mapping, optional
        Quantities to fix; the other draws stay as they are. ``speed_kmh`` (km/h), ``profile`` ("new", "worn":
        the scenario's own at wear 0 or 1; otherwise the name of a wheel profile or the path of a YAML file,
        unworn unless ``wear`` says more), ``wear`` (above 0 a profile is drawn that wears), ``gauge``
        (m), ``friction``, ``payload``, ``initial_current``, ``track`` (name, or path to a YAML file: its
        irregularities) and ``track_scale``, ``line`` (name, path to a YAML or CSV file, or content: what it
        says goes before the other quantities), ``faults`` (a list as for `parse_faults`).
    base : Scenario, optional
        The environment's, where settings may have changed its wear and its wheels; by default both are as the
        packaged studies have them: worn wheels, of a profile that says how it wears.

    Raises
    ------
    ConfigError
        An unknown option, a value that is not allowed, or one that the episode's line says itself.
    DataError
        A measured line that cannot be used.
    """
    seed, episode = whole_number("seed", seed, most=2**128), whole_number("episode", episode)
    fixed = checked_options(options)
    sequence = np.random.SeedSequence([seed, episode])
    drawn_from = config.randomisation
    uniform = _Uniform(sequence)
    drawn = {
        name: float(quantity.at(uniform(name)))
        for name in NUMBERS
        if (quantity := getattr(drawn_from, name)) is not None
    } | fixed.numbers
    bias, noise = _sensor_errors(config, sequence)
    faults = () if config.faults is None else _drawn_faults(config.faults, config.sensors, sequence)
    track = _drawn_track(drawn_from.tracks, fixed, uniform)
    # A wear that is not drawn, the option's or the study's, is to act.
    own = 1.0 if base is None else base.wear
    worn = fixed.numbers.get("wear", own if drawn_from.wear is None else 0.0) > 0.0
    profile = _drawn_profile(drawn_from.profiles, fixed, uniform, worn=worn)
    wheel = profile.wheel if profile.wheel is not None or base is None else base.wheel
    if wheel is not None and wheel.wear is None:
        if fixed.numbers.get("wear", 0.0) > 0.0:
            raise ConfigError(
                f"options: wear: found {fixed.numbers['wear']:g}; wheel profile '{wheel.name}' does not "
                "say how it wears: expected 0"
            )
        drawn["wear"] = 0.0
    return Episode(
        seed=seed,
        number=episode,
        speed=drawn["speed_kmh"] / KMH,
        profile=profile.name,
        wheel=profile.wheel,
        wheel_shift=profile.shift,
        wear=drawn.get("wear"),
        gauge=drawn.get("gauge"),
        friction=drawn.get("friction"),
        payload=drawn["payload"],
        initial_current=drawn["initial_current"],
        track=track.name,
        irregularity=track.irregularity,
        track_scale=track.scale,
        line=_line(config, fixed, uniform),
        tolerances={
            key: float(group.factor.at(uniform(f"tolerances.{name}")))
            for name, group in drawn_from.tolerances.items()
            for key in group.keys
        },
        sensor_bias=bias,
        sensor_noise=noise,
        faults=faults if fixed.faults is None else fixed.faults,
    )


def episode_scenario(base: Scenario, episode: Episode) -> Scenario:
    """Scenario of an episode.

    Parameters
    ----------
    base : Scenario
        The scenario of the environment.
    episode : Episode
        What differs from it.

    Returns
    -------
    Scenario
        The base itself if nothing differs; otherwise parts that do not differ are shared with it.

    Raises
    ------
    ConfigError
        A tolerance of a number that the scenario does not have, or a value that is not allowed.
    """
    changes: dict[str, Any] = {}
    if episode.wear not in (None, base.wear):
        changes["wear"] = episode.wear
    if episode.friction not in (None, base.friction):
        changes["friction"] = episode.friction
    irregularity = base.track.irregularity if episode.irregularity is None else episode.irregularity
    if episode.track_scale is not None:
        _check_scalable(irregularity, episode.track)
        content = dict(irregularity) | {"scale": episode.track_scale}
        irregularity = validate(type(irregularity), content, "track_scale")
    gauge = base.track.gauge if episode.gauge is None else episode.gauge
    if (irregularity, gauge) != (base.track.irregularity, base.track.gauge):
        changes["track"] = base.track.model_copy(update={"irregularity": irregularity, "gauge": gauge})
    wheel = base.wheel if episode.wheel is None else episode.wheel
    if episode.wheel_shift is not None:
        wheel = shifted(wheel, episode.wheel_shift)
    if wheel != base.wheel:
        changes["wheel"] = wheel
    if changes:
        base = validate(Scenario, dict(base) | changes, "episode")
    return scaled(base, _factors(base, episode))


def _factors(base: Scenario, episode: Episode) -> dict[tuple[str, ...], float]:
    """Factors on the scenario's numbers, by their paths: tolerances of what it has, and payload."""
    factors: dict[tuple[str, ...], float] = {}
    for key, factor in episode.tolerances.items():
        first, *rest = key.split(".")
        if first in ("sayd", "passive"):
            if first == base.damper.type:
                factors["damper", *rest] = factor
        else:
            factors[first, *rest] = factor
    if episode.payload != 0.0:
        for body in base.vehicle.bodies:
            if body.role == "carbody":
                for quantity in ("mass", "inertia"):
                    path = ("vehicle", "bodies", body.name, quantity)
                    factors[path] = factors.get(path, 1.0) * (1.0 + episode.payload)
    return {path: factor for path, factor in factors.items() if factor != 1.0}


class _Uniform:
    """Uniform numbers in [0, 1), each from a stream of its name alone."""

    def __init__(self, sequence: np.random.SeedSequence) -> None:
        self._entropy = sequence.entropy

    def __call__(self, name: str) -> float:
        key = (STREAMS["scenario"], zlib.crc32(name.encode()))
        (word,) = np.random.SeedSequence(self._entropy, spawn_key=key).generate_state(1, np.uint64)
        return float(word >> np.uint64(11)) * 2.0**-53


def _generator(sequence: np.random.SeedSequence, component: Component) -> np.random.Generator:
    child = np.random.SeedSequence(sequence.entropy, spawn_key=(STREAMS[component],))
    return np.random.default_rng(child)


def _line(
    config: EnvironmentConfig, fixed: EpisodeOptions, uniform: _Uniform
) -> str | LineConfig | Line | None:
    if fixed.line is not None or config.lines is None:
        line = config.line if fixed.line is None else fixed.line
        if line is not None:
            refuse_said(line, {f"options: {name}": name for name in fixed.sayable})
        return line
    if "speed_kmh" in fixed.numbers:
        config.lines.refuse_speed("options: speed_kmh")
    given = {*fixed.numbers, *(("tracks",) if fixed.track or fixed.track_scale is not None else ())}
    return draw_line(config.lines.without(given), uniform)


@dataclass(frozen=True)
class _Track:
    name: str | None = None
    irregularity: IrregularityConfig | None = None
    scale: float | None = None


def _drawn_track(classes: tuple[TrackClass, ...], fixed: EpisodeOptions, uniform: _Uniform) -> _Track:
    """Track and its scale; a track that an option names keeps its class's scale."""
    name, scale = fixed.track, fixed.track_scale
    drawn = None
    if name is not None:
        drawn = next((entry for entry in classes if entry.name == name), None)
    elif classes:
        place = int(chosen(tuple(entry.weight for entry in classes), uniform("tracks")))
        drawn, name = classes[place], classes[place].name
    if scale is None and drawn is not None and drawn.scale is not None:
        scale = float(drawn.scale.at(uniform("track_scale")))
    irregularity = None if name is None else read_irregularity(name)
    if irregularity is not None and scale is not None:
        _check_scalable(irregularity, name)
    return _Track(name, irregularity, scale)


@dataclass(frozen=True)
class _Profile:
    name: str | None = None
    wheel: WheelProfileConfig | None = None
    shift: float | None = None

    @property
    def wears(self) -> bool:
        """Whether its treads can be worn, so far as that is known without the scenario."""
        return self.wheel is None or self.wheel.wear is not None


def _drawn_profile(
    classes: tuple[ProfileClass, ...], fixed: EpisodeOptions, uniform: _Uniform, *, worn: bool
) -> _Profile:
    """Wheel profile, one that wears if it is to be worn; one that an option names has its own shift."""
    if fixed.profile is not None:
        own = fixed.profile in PROFILES
        return _Profile() if own else _Profile(fixed.profile, _wheel(fixed.profile))
    if not classes:
        return _Profile()
    found = [
        _Profile(each.name, None if each.name is None else _wheel(each.name), each.shift) for each in classes
    ]
    weights, u = [each.weight for each in classes], uniform("profiles")
    drawn = found[int(chosen(weights, u))]
    if worn and not drawn.wears:
        able = [weight * profile.wears for weight, profile in zip(weights, found, strict=True)]
        drawn = found[int(chosen(able, u))] if any(able) else drawn
    return drawn


def _wheel(name: str) -> WheelProfileConfig:
    # A packaged profile stays as it is, a user's file may be edited between episodes.
    return load_wheel(name) if is_path(name) else _packaged_wheel(name)


@lru_cache(maxsize=64)
def _packaged_wheel(name: str) -> WheelProfileConfig:
    return load_wheel(name)


def _check_scalable(irregularity: IrregularityConfig, name: str | None) -> None:
    try:
        scalable(irregularity, name or "of the study")
    except ValueError as error:
        raise ConfigError(f"options: track_scale: {error}") from None


def _sensor_errors(config: EnvironmentConfig, sequence: np.random.SeedSequence) -> tuple[Array, Array]:
    """Bias of every signal's sensor and factor on its noise."""
    sensors = [config.sensors.of(signal) for signal in SIGNALS]
    u = _generator(sequence, "sensors").random((2, len(sensors)))
    share, factor = config.randomisation.sensor_bias.at(u[0]), config.randomisation.sensor_noise.at(u[1])
    bias = share * np.array([s.bias_spread for s in sensors])
    bias.flags.writeable = factor.flags.writeable = False
    return bias, factor


def _drawn_faults(
    config: FaultsConfig, sensors: SensorsConfig, sequence: np.random.SeedSequence
) -> tuple[Fault, ...]:
    """Faults in the order of their onsets, no two of them of the same damper or the same signal."""
    numbers = _generator(sequence, "faults").random((1 + MOST_FAULTS, 5))
    weights = tuple(each.weight for each in config.kinds)
    dampers, signals = list(DAMPERS), list(SIGNALS)
    drawn = []
    for u in numbers[1 : 1 + round(float(config.count.at(numbers[0, 0])))]:
        kind = config.kinds[int(chosen(weights, u[0]))]
        fault: dict[str, Any] = {"kind": kind.kind, "start_s": float(config.onset.at(u[1]))}
        if isinstance(kind, ValveStuckClass | DamperFaultClass):
            fault["damper"] = dampers.pop(int(u[2] * len(dampers)))
            if isinstance(kind, ValveStuckClass):
                fault["current"] = float(kind.current.at(u[3]))
        else:
            possible = [signal for signal in signals if SIGNALS[signal] in kind.sensors]
            if not possible:  # every sensor of these kinds has its fault
                continue
            fault["signal"] = possible[int(u[2] * len(possible))]
            signals.remove(fault["signal"])
            if isinstance(kind, SensorErrorClass):
                fault |= _error(kind, sensors.of(fault["signal"]), u[3], u[4])
        drawn.append(fault)
    return parse_faults(sorted(drawn, key=itemgetter("start_s")), "drawn")


def _error(kind: SensorErrorClass, sensor: SensorConfig, size: float, side: float) -> dict[str, float]:
    """Measure of a sensor's error in the unit of its signal."""
    amount = float(kind.share.at(size)) * 0.5 * (sensor.high - sensor.low)
    if kind.kind == "sensor_noisy":
        return {"noise": amount}
    return {"bias": amount if side < 0.5 else -amount}
