"""From the keywords of `gymnasium.make` to an environment's configuration and scenario."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypedDict, Unpack

import numpy as np

from sayd_env.config import ConfigError, nearest, validate
from sayd_env.config.environment import EnvironmentConfig, RandomisationConfig, fixed_by, load_environment
from sayd_env.config.explain import shown
from sayd_env.config.loader import assigned_keys
from sayd_env.config.reward import RewardConfig, named_rewards
from sayd_env.config.scenario import Scenario
from sayd_env.config.sensors import SensorsConfig, load_sensors
from sayd_env.envs.episode_batch import environment_scenario
from sayd_env.envs.options import checked_number, number
from sayd_env.measured.lines import options_of, refuse_said


class UnexpectedKeyword(ConfigError, TypeError):
    """A keyword that there is not. Clients probe for theirs and know Python's own error by type and words."""


INFOS = ("none", "basic", "full")
"""Levels of `info`."""
RENDER_MODES = ("rgb_array", "human")


class Keywords(TypedDict, total=False):
    """Keywords of `configured`, which documents them."""

    damper: str | None
    valves: str | None
    observation: str | None
    history: int | None
    reward: str | Sequence[float] | Mapping[str, float] | None
    control_period: float | None
    episode_s: float | None
    sensors: str | SensorsConfig | None
    speed_kmh: float | None
    settings: Sequence[str] | None


def configured(
    environment: str = "nominal", **keywords: Unpack[Keywords]
) -> tuple[EnvironmentConfig, Scenario]:
    """Configuration and scenario of an environment.

    Parameters
    ----------
    environment : str
        A packaged environment (``nominal``, ``randomized``, ``faults``) or a path to a YAML file.
    damper, valves, observation, history, control_period, episode_s
        In place of the environment's own; see `EnvironmentConfig`.
    reward : str, pair or mapping, optional
        ``"mppt1"``, ``"mppt2"``, ``"low-force"``, ``(k_y, k_F)`` or ``{"k_y": ..., "k_F": ...}``; by default
        the study's weights, which are those of ``"mppt2"``.
    sensors : str or SensorsConfig, optional
        Name of a set of sensors, or a path to a YAML file.
    speed_kmh : float, optional
        Speed of all episodes, km/h.
    settings : sequence of str
        ``key=value`` assignments for the scenario, for example ``friction=0.3``. What they set is not drawn.

    Raises
    ------
    ConfigError
        A keyword that cannot be used; the message names it, what was found and what is allowed. One that the
        environment's line says itself has no effect and is refused, too.
    DataError
        A measured line that cannot be used.
    """
    if not isinstance(environment, str) or not environment:
        raise ConfigError(
            f"environment: found {shown(environment)}; expected the name of an environment or a path"
        )
    refuse_unknown("configured", keywords, Keywords.__annotations__)
    given: dict[str, Any] = {key: value for key, value in keywords.items() if value is not None}
    assignments = _assignments(given.pop("settings", None))
    weights = _weights(given.pop("reward", None))
    config = load_environment(environment)
    rows = config.history
    if "sensors" in given:
        given["sensors"] = _sensors(given["sensors"])
    left = config.randomisation.without_keys(
        assigned_keys(assignments), str(given.get("damper", config.damper))
    )
    given["randomisation"] = _at_speed(left, given.pop("speed_kmh", None))
    if config.line is not None:
        named = {"speed_kmh": "speed_kmh"} if keywords.get("speed_kmh") is not None else {}
        settings = options_of(assigned_keys(assignments))
        refuse_said(config.line, named | {f"settings: {key}": name for key, name in settings.items()})
    if config.lines is not None:
        if keywords.get("speed_kmh") is not None:
            config.lines.refuse_speed("speed_kmh")
        given["lines"] = config.lines.without(fixed_by(assigned_keys(assignments)))
    config = validate(EnvironmentConfig, dict(config) | given, "keywords")
    if config.history != rows and config.observation != "history":
        raise ConfigError(
            f"history: has no effect on observation='{config.observation}'; give observation='history', too"
        )
    scenario = environment_scenario(config, assignments, "settings")
    if scenario.damper.type != config.damper:
        raise ConfigError(
            f"settings: found a damper of type '{scenario.damper.type}', the environment has "
            f"'{config.damper}'; give damper='{scenario.damper.type}' too"
        )
    if weights is not None:
        scenario = scenario.model_copy(update={"cost": weights.of(scenario.cost)})
    return config, scenario


def refuse_unknown(function: str, keywords: Mapping[str, Any], known: Iterable[str]) -> None:
    """Refuse keywords that a function of this name does not have.

    Raises
    ------
    UnexpectedKeyword
        There is one.
    """
    allowed = sorted(known)
    for key in keywords:
        if key not in allowed:
            raise UnexpectedKeyword(
                f"{function}() got an unexpected keyword argument {shown(key)}{nearest(key, allowed)}; "
                f"allowed: {', '.join(allowed)}"
            )


def checked_flag(name: str, value: Any) -> bool:
    """A keyword that is true or false.

    Raises
    ------
    ConfigError
        Something else.
    """
    if not isinstance(value, bool | np.bool_):
        raise ConfigError(f"{name}: found {shown(value)}; expected True or False")
    return bool(value)


def checked_choice(name: str, value: Any, allowed: Iterable[str | None]) -> Any:
    """One of the values that a keyword may have.

    Raises
    ------
    ConfigError
        Another one.
    """
    values = tuple(allowed)
    if not (value is None or isinstance(value, str)) or value not in values:
        words = " or ".join(str(each) if each is None else f"'{each}'" for each in values)
        raise ConfigError(f"{name}: found {shown(value)}; expected {words}")
    return value


def _assignments(settings: Any) -> tuple[str, ...]:
    listed = () if settings is None else settings
    texts = isinstance(listed, Sequence) and all(isinstance(item, str) for item in listed)
    if isinstance(listed, str) or not texts:
        raise ConfigError(
            f"settings: found {shown(settings)}; expected a list of key=value, such as ['friction=0.3']"
        )
    return tuple(listed)


def _sensors(sensors: Any) -> SensorsConfig:
    if isinstance(sensors, SensorsConfig):
        return sensors
    if not isinstance(sensors, str) or not sensors:
        raise ConfigError(f"sensors: found {shown(sensors)}; expected the name of a set of sensors or a path")
    return load_sensors(sensors)


def _at_speed(drawn: RandomisationConfig, speed_kmh: float | None) -> RandomisationConfig:
    """Distributions of an environment whose speed a keyword may fix."""
    if speed_kmh is None:
        return drawn
    speed = {"distribution": "fixed", "value": checked_number("speed_kmh", speed_kmh)}
    return validate(RandomisationConfig, dict(drawn) | {"speed_kmh": speed}, "keywords")


def _weights(reward: Any) -> RewardConfig | None:
    """Weights of the cost; None for those of the study."""
    if reward is None:
        return None
    known = named_rewards()
    if isinstance(reward, str) and reward in known:
        return known[reward]
    pair = reward.tolist() if isinstance(reward, np.ndarray) else reward
    if isinstance(reward, Mapping) and set(reward) == {"k_y", "k_F"}:
        pair = (reward["k_y"], reward["k_F"])
    if isinstance(pair, Sequence) and not isinstance(pair, str) and len(pair) == 2:
        k_y, k_f = number(pair[0]), number(pair[1])
        if k_y is not None and k_f is not None and min(k_y, k_f) >= 0.0 and max(k_y, k_f) > 0.0:
            return RewardConfig(k_y=k_y, k_F=k_f)
    close = nearest(reward, known) if isinstance(reward, str) else ""
    raise ConfigError(
        f"reward: found {shown(reward)}{close}; expected {', '.join(map(repr, known))}, (k_y, k_F) or "
        "{'k_y': ..., 'k_F': ...}, weights of 0 or more of which one is positive"
    )
