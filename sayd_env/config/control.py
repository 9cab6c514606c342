"""Schemas of the controllers and of the on-line filter that they and the reward share."""

from __future__ import annotations

from collections.abc import Iterable

from sayd_env.config.base import Model, quantity
from sayd_env.config.loader import read_overridden


class OnlineConfig(Model):
    """The on-line band-pass filter: how it finds and follows the dominant frequency f_0 while running.

    Band, filter order, range of f_0 and the distance behind it are those of the assessment.
    """

    start_frequency: float = quantity("Hz", "f_0 until the distance of one spectrum is run", gt=0.0)
    frequency_step: float = quantity("Hz", "step of the grid of f_0", gt=0.0)
    block: float = quantity("s", "the spectrum is that of the means over this time, or of samples", gt=0.0)
    settling: float = quantity("s", "kept signal that a filter with a new band runs over first", gt=0.0)


def load_online(name: str = "online", overrides: Iterable[str] = ()) -> OnlineConfig:
    """Read the settings of the on-line filter.

    Parameters
    ----------
    name : str
        A packaged configuration (``online``) or a path to a YAML file.
    overrides : iterable of str
        ``key=value`` assignments.

    Raises
    ------
    ConfigError
        The file, a key or a value cannot be used.
    """
    return read_overridden(OnlineConfig, "control", name, overrides)
