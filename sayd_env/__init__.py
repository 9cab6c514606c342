"""High-speed rail vehicle with semi-active yaw dampers: simulator, assessment and environments."""

from pathlib import Path
from typing import Any

from sayd_env.envs.registration import register_environments, register_policy_loader

__version__ = "0.1.0"

_CHECKOUT = Path(__file__).resolve().parent.parent
if __name__ == "sayd_env" and (_CHECKOUT / "pyproject.toml").is_file():
    # In a checkout agents, baselines and configs stand beside this package; a wheel holds them inside it.
    __path__.append(str(_CHECKOUT))

register_environments()
register_policy_loader("sayd_env.runs.policies:load_policy")


def load_policy(policy: str, env: Any = None, **options: Any) -> Any:
    """Make a policy of any kind, ready to act: see `sayd_env.runs.policies.load_policy`.

    >>> policy = load_policy("mppt2", "SAYD/Nominal-v1")
    >>> policy.interface.keywords["control_period"]
    0.01
    """
    from sayd_env.runs.policies import load_policy as load  # noqa: PLC0415 - importing sayd_env stays light

    return load(policy, env, **options)
