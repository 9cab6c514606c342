"""High-speed rail vehicle with semi-active yaw dampers: simulator, assessment and environments."""

__version__ = "0.1.0"
