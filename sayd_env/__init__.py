"""High-speed rail vehicle with semi-active yaw dampers: simulator, assessment and environments."""

from pathlib import Path

from sayd_env.envs.registration import register_environments

__version__ = "0.1.0"

_CHECKOUT = Path(__file__).resolve().parent.parent
if __name__ == "sayd_env" and (_CHECKOUT / "pyproject.toml").is_file():
    # In a checkout agents, baselines and configs stand beside this package; a wheel holds them inside it.
    __path__.append(str(_CHECKOUT))

register_environments()
