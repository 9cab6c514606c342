"""High-speed rail vehicle with semi-active yaw dampers: simulator, assessment and environments."""

from sayd_env.envs.registration import register_environments

__version__ = "0.1.0"

register_environments()
