"""The paper's controllers and simpler ones, as policies with the `predict` of Stable-Baselines3.

>>> import gymnasium
>>> from sayd_env import baselines
>>> env = gymnasium.make("SAYD/Nominal-v1")
>>> policy = baselines.make("mppt1", env)
>>> observation, info = env.reset(seed=0)
>>> action, state = policy.predict(observation)
>>> action.shape
(2,)

They use sensor signals only; one policy serves one vehicle or many. `make` also makes other policies, learned
ones and those of one's own code, where their loader is registered.
"""

from __future__ import annotations

from typing import Any

from sayd_env.baselines.constant import Constant, Passive
from sayd_env.baselines.hunting_schedule import HuntingSchedule
from sayd_env.baselines.lqg import Lqg
from sayd_env.baselines.mppt import Mppt
from sayd_env.baselines.observation_layout import interface_of
from sayd_env.baselines.perturb_observe import PerturbAndObserve
from sayd_env.baselines.policy import Policy
from sayd_env.baselines.safe import SAFE, SafeFallback
from sayd_env.baselines.skyhook import ContinuousSkyhook, OnOffSkyhook
from sayd_env.baselines.speed_schedule import SpeedSchedule
from sayd_env.config import ConfigError
from sayd_env.config.control import controller_of, load_controller
from sayd_env.config.explain import shown
from sayd_env.envs.registration import policy_loader

__all__ = ["NAMES", "SAFE", "Policy", "SafeFallback", "interface_of", "make", "parse"]

_KINDS: dict[str, Any] = {
    "passive": Passive,
    "constant": Constant,
    "mppt1": Mppt,
    "mppt2": Mppt,
    "perturb-and-observe": PerturbAndObserve,
    "skyhook-onoff": OnOffSkyhook,
    "skyhook-continuous": ContinuousSkyhook,
    "mppt2-tuned": Mppt,
    "constant-tuned": Constant,
    "speed-schedule": SpeedSchedule,
    "speed-schedule-tuned": SpeedSchedule,
    "hunting-schedule": HuntingSchedule,
    "hunting-schedule-tuned": HuntingSchedule,
    "lqg": Lqg,
    "lqg-tuned": Lqg,
    "mppt1-estimate": Mppt,
    "mppt2-estimate": Mppt,
}
NAMES = tuple(_KINDS)
"""Controllers that `make` knows."""


def make(name: str, env_or_spec: Any, **parameters: Any) -> Any:
    """Make a policy for an environment.

    Parameters
    ----------
    name : str
        One of `NAMES`, ``constant:V`` with a valve command V, or the path of a YAML file of parameters that
        is named after its controller, such as ``sayd tune`` writes: ``results/tune-mppt2/mppt2-tuned.yaml``.
        Or whatever else `sayd_env.load_policy` loads: a ready policy's name, ``.npz``, ``.onnx``,
        ``file.py:factory``. With ``safe:`` before it, any of these inside a `SafeFallback`.
    env_or_spec
        What it is to control: an `Interface`, a Gymnasium environment or vector environment (wrapped or not),
        a vector environment of Stable-Baselines3, or an environment's id or `EnvSpec`.
    **parameters
        Values that replace those of ``configs/control/NAME.yaml``; the controller's docstring lists them. For
        a policy that is no controller, options of `sayd_env.load_policy`.

    Returns
    -------
    Policy
        With ``predict(observation, state=None, episode_start=None, deterministic=True)`` and the attributes
        ``name``, ``interface``, and those of controllers ``parameters`` and ``sensors``.

    Raises
    ------
    ConfigError
        Unknown name or parameter, a value that cannot be used, or an environment without the signals, valves
        or dampers that the controller needs.
    """
    given, (name, short) = name, parse(name)
    if given.strip().startswith(SAFE):
        return SafeFallback(make(given.strip().removeprefix(SAFE), env_or_spec, **parameters))
    if name not in NAMES and not name.endswith((".yaml", ".yml")):
        return policy_loader()(given, env_or_spec, **parameters)
    duplicates = short.keys() & parameters
    if duplicates:
        raise ConfigError(
            f"policy '{name}': {', '.join(duplicates)} is given after the colon and as a parameter"
        )
    config = load_controller(name, {**short, **parameters})
    name = controller_of(name)
    keywords = {"damper": "passive"} if name == "passive" else None
    return _KINDS[name](name, interface_of(env_or_spec, keywords), config)


def parse(text: str) -> tuple[str, dict[str, float]]:
    """Split a controller's name from the value after a colon: ``constant:0.3``.

    Parameters
    ----------
    text : str
        A name, or ``constant:V`` with a valve command V from 0 to 1. Whether there is such a controller is
        for `make` to say.

    Returns
    -------
    name : str
    parameters : dict
        ``{"current": V}``, or nothing.

    Raises
    ------
    ConfigError
        A value after another name than ``constant``, or one that is not a number from 0 to 1.
    """
    if not isinstance(text, str):
        raise ConfigError(f"policy: found {shown(text)}; expected a name, or a path as text")
    name, colon, value = text.strip().partition(":")
    if not colon or name not in NAMES:
        return name, {}
    if name != "constant":
        raise ConfigError(f"policy '{text}': only 'constant' takes a value, for example constant:0.3")
    try:
        current = float(value)
    except ValueError:
        current = float("nan")
    if not 0.0 <= current <= 1.0:
        raise ConfigError(f"policy '{text}': expected a valve command from 0 to 1 after the colon")
    return name, {"current": current}
