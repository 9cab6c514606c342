"""The layout of observations and actions that a policy needs, from an environment, several, or an id."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box

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
        Something else, or an environment whose observations or actions a wrapper has changed.
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
    _check_wrappers(source, inner)
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


_SPACES = {
    "observations": ("single_observation_space", "observation_space"),
    "actions": ("single_action_space", "action_space"),
}
"""Where environments have their spaces: vector environments of Gymnasium in the first of two attributes."""


def _check_wrappers(source: Any, inner: Any) -> None:
    """Refuse wrappers after which observations or actions are not the environment's own, in SI units.

    One that takes any action, as `ClipAction`, changes none that a controller gives.
    """
    for kind, names in _SPACES.items():
        name = next((name for name in names if hasattr(inner, name)), None)
        if name is None:
            continue
        own: Any = getattr(inner, name)
        seen: Any = getattr(source, name, own)
        if seen != own and (kind == "observations" or not _takes_any(seen)):
            raise ConfigError(_CHANGED.format(kind))
    while source is not inner and source is not None:
        if getattr(source, "norm_obs", False):  # SB3's VecNormalize, whose space stays as it was
            raise ConfigError(_CHANGED.format("observations"))
        source = getattr(source, "venv", None)


def _takes_any(actions: Any) -> bool:
    return isinstance(actions, Box) and not np.isfinite([actions.low, actions.high]).all()


_CHANGED = (
    "a wrapper changes the environment's {}; controllers need them in SI units and valve commands: make the "
    "policy with the environment inside the wrapper"
)
