"""Limit values of the sliding RMS."""

from __future__ import annotations

import math
from typing import NamedTuple

from sayd_env.config import ConfigError


class Limits(NamedTuple):
    """Largest allowed sliding RMS."""

    track_shift_force: float
    """Sum of the guiding forces of one wheelset (N)."""
    acceleration: float
    """Lateral acceleration of the bogie frame above a wheelset (m/s2)."""

    @property
    def mean_track_shift(self) -> float:
        """Prud'homme's limit of the track shift force's mean over 2 m (N); its RMS has half of it."""
        return 2.0 * self.track_shift_force


def limits(axle_load: float, bogie_mass: float) -> Limits:
    """Limits of track shift force and bogie-frame acceleration.

    Parameters
    ----------
    axle_load : float
        Static load P of one wheelset on the rails (N).
    bogie_mass : float
        Mass m_b of the whole bogie, wheelsets included (kg).

    Returns
    -------
    Limits
        Half of Prud'homme's limit, ``(10 + P / 3) / 2`` with P in kN, and ``(12 - m_b / 5) / 2`` m/s2 with
        m_b in t (EN 14363; Wang et al. 2022, eq. 25 and 26), in SI units.

    Raises
    ------
    ConfigError
        A load or mass that is not positive, or a mass for which eq. 26 leaves no limit (60 t and above).
    """
    return Limits(track_shift_limit(axle_load), acceleration_limit(bogie_mass))


def track_shift_limit(axle_load: float) -> float:
    """Limit of the track shift force's sliding RMS, see `limits`.

    Parameters
    ----------
    axle_load : float
        Static load of a wheelset (N).

    Returns
    -------
    float
        Half of the limit of the single force, 10 kN + P/3 (eq. 25), N.

    Raises
    ------
    ConfigError
        A load that is not positive.
    """
    if not (math.isfinite(axle_load) and axle_load > 0):
        raise ConfigError(f"axle load: found {axle_load:g} N; it must be positive")
    return 0.5 * (10e3 + axle_load / 3)


def acceleration_limit(bogie_mass: float) -> float:
    """Limit of the sliding RMS of the bogie frame's lateral acceleration, see `limits`.

    Parameters
    ----------
    bogie_mass : float
        Mass of a bogie with its wheelsets (kg).

    Returns
    -------
    float
        Half of 12 - m_b/5 with the mass in tonnes (eq. 26), m/s2.

    Raises
    ------
    ConfigError
        A mass that is not positive, or for which eq. 26 leaves no limit (60 t and above).
    """
    if not 0 < bogie_mass < 60e3:
        raise ConfigError(f"bogie mass: found {bogie_mass:g} kg; it must lie between 0 and 60,000 kg")
    return 0.5 * (12 - bogie_mass / 1e3 / 5)
