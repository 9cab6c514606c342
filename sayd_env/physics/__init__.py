"""The simulator: vehicle, contact, track and dampers. Knows no Gymnasium, no policy, no result file."""

from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.simulator import Simulator, Telemetry, VehicleModel

__all__ = ["BatchSimulator", "Simulator", "Telemetry", "VehicleModel"]
