"""High-speed rail vehicle with semi-active yaw dampers: simulator, assessment and environments."""

from sayd_env.envs.registration import register_when_loaded

__version__ = "0.1.0"

register_when_loaded()
