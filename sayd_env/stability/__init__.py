"""Running stability by EN 14363; usable alone on measured signals of a real train."""

from sayd_env.measured.recordings import Channel, Quantity, Recording, read_recording
from sayd_env.stability.assessment import Assessment, assess, assessed_span
from sayd_env.stability.critical import (
    CriticalSpeed,
    Crossing,
    GridSensitivity,
    critical_speed,
    grid_sensitivity,
    thinned_grids,
)
from sayd_env.stability.limits import Limits, acceleration_limit, limits, track_shift_limit
from sayd_env.stability.signals import (
    averaged_spectra,
    band_pass,
    distance_run,
    dominant_frequency,
    sliding_rms,
)

__all__ = [
    "Assessment",
    "Channel",
    "CriticalSpeed",
    "Crossing",
    "GridSensitivity",
    "Limits",
    "Quantity",
    "Recording",
    "acceleration_limit",
    "assess",
    "assessed_span",
    "averaged_spectra",
    "band_pass",
    "critical_speed",
    "distance_run",
    "dominant_frequency",
    "grid_sensitivity",
    "limits",
    "read_recording",
    "sliding_rms",
    "thinned_grids",
    "track_shift_limit",
]
