"""The layout of observations and actions that a policy needs, from an environment, several, or an id."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sayd_env.config import ConfigError
from sayd_env.config.explain import shown
from sayd_env.envs.interface import Interface


def interface_of(source: Any, keywords: Mapping[str, Any] | None = None) -> Interface:
    """What a policy may know of an environment.

    Parameters
    ----------
    source
        An `Interface`, a Gymnasium environment or vector environment (wrapped or not), a vector environment
        of Stable-Baselines3, or an id or `EnvSpec`, of which an environment is made and closed again.
    keywords : mapping, optional
        With which an environment of an id is made.

    Raises
    ------
    ConfigError
        Something else, or an environment whose observations a wrapper has changed.
    """
    if isinstance(source, Interface):
        return source
    if _is_specification(source):
        return _of_specification(source, keywords or {})
    inner = getattr(source, "unwrapped", source)
    found = getattr(inner, "interface", None)
    if found is None and hasattr(inner, "get_attr"):
        found = _first_attribute(inner)
    if not isinstance(found, Interface):
        raise ConfigError(
            f"found {shown(source)}; expected an environment of sayd_env, several, or an environment's id"
        )
    _check_observations(source, inner)
    return found


def _is_specification(source: Any) -> bool:
    return isinstance(source, str) or hasattr(source, "entry_point")


def _of_specification(source: Any, keywords: Mapping[str, Any]) -> Interface:
    import gymnasium  # noqa: PLC0415 - policies of an interface need no Gymnasium

    import sayd_env  # noqa: F401, PLC0415 - registers the ids

    try:
        env = gymnasium.make(source, **keywords)
    except (gymnasium.error.Error, ImportError) as error:
        raise ConfigError(f"environment {shown(source)}: {error}") from None
    try:
        return interface_of(env)
    finally:
        env.close()


def _first_attribute(vector: Any) -> Any:
    """Interface of the first of a vector's environments, all of which are alike."""
    try:
        return vector.get_attr("interface")[0]
    except (AttributeError, LookupError):
        return None


def _check_observations(source: Any, inner: Any) -> None:
    """Refuse wrappers that change observations: controllers read the sensors' own, in SI units."""
    for name in ("single_observation_space", "observation_space"):
        own = getattr(inner, name, None)
        if own is not None:
            if getattr(source, name, own) != own:
                raise ConfigError(
                    "a wrapper changes the environment's observations; controllers need them as the sensors "
                    "give them: make the policy with the environment inside the wrapper"
                )
            return
