"""EN 14363's sliding RMS while a vehicle runs: over the last 100 m, behind the on-line filter."""

from __future__ import annotations

import numpy as np
from scipy.signal import sosfilt

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.units import Array, Integers
from sayd_env.envs.loop import BOGIES, LOG_ACCELERATION, LOG_FILTERED, LOG_TRACK_SHIFT
from sayd_env.envs.trace import POINTS
from sayd_env.stability.online import Band


class SlidingRms:
    """Sliding RMS of one vehicle's accelerations and track shift forces.

    The accelerations are those behind the on-line filter of the cost. The track shift forces go through a
    filter of the same band; like that one, it runs from rest over the last seconds where f_0 has moved.

    Parameters
    ----------
    band : Band
        Constants of the on-line filter.
    assessment : AssessmentConfig
        Length of the window.
    slowest : float
        Lowest speed of the run, m/s: it needs the most samples.
    rate : float
        Samples per second, Hz.
    """

    def __init__(self, band: Band, assessment: AssessmentConfig, slowest: float, rate: float) -> None:
        self._sections = np.insert(band.sections, 3, 1.0, axis=2)  # with a0, as SciPy expects
        self._kept = int(band.counts[1])
        self._length = assessment.window_length * rate
        self._most = self._samples(slowest)
        self._window = 1
        self._choice = np.full(BOGIES, band.counts[2])
        self._filters = np.zeros((BOGIES, self._sections.shape[1], 2, POINTS // BOGIES))
        self._raw = np.zeros((0, POINTS))
        self._filtered = np.zeros((0, 2 * POINTS))

    def _samples(self, speed: float) -> int:
        return max(1, round(self._length / speed))

    def advance(self, rows: Array, choice: Integers, speed: float) -> None:
        """Take the samples of a control period, or of a run-in in which f_0 did not move.

        Parameters
        ----------
        rows : ndarray, shape (t, LOG)
            True signals by the columns of `sayd_env.envs.loop`.
        choice : ndarray, shape (BOGIES,)
            Index of each bogie's f_0 during them.
        speed : float
            At their end, m/s.
        """
        self._window = self._samples(speed)
        shift = rows[:, LOG_TRACK_SHIFT : LOG_TRACK_SHIFT + POINTS]
        new = np.empty((len(rows), 2 * POINTS))
        new[:, :POINTS] = rows[:, LOG_FILTERED : LOG_FILTERED + POINTS]
        size = POINTS // BOGIES
        for k in range(BOGIES):
            own, sections = slice(k * size, (k + 1) * size), self._sections[choice[k]]
            if choice[k] != self._choice[k]:
                rest = np.zeros_like(self._filters[k])
                _, self._filters[k] = sosfilt(sections, self._raw[:, own], axis=0, zi=rest)
            target = slice(POINTS + own.start, POINTS + own.stop)
            new[:, target], self._filters[k] = sosfilt(sections, shift[:, own], axis=0, zi=self._filters[k])
        self._choice = choice.copy()
        self._raw = np.concatenate([self._raw, shift])[-self._kept :]
        self._filtered = np.concatenate([self._filtered, new])[-self._most :]

    def run_in(self, rows: Array, choice: Integers, speed: float) -> None:
        """Take the samples of a run-in, at whose end f_0 was found.

        The values are those of a train that has been running: the last seconds in the bands of this f_0.

        Parameters
        ----------
        rows : ndarray, shape (t, LOG)
            True signals.
        choice : ndarray, shape (BOGIES,)
            Index of each bogie's f_0 at the end.
        speed : float
            m/s.
        """
        start, size = self._choice.copy(), POINTS // BOGIES
        self.advance(rows, start, speed)
        acceleration = rows[-self._kept :, LOG_ACCELERATION : LOG_ACCELERATION + POINTS]
        for k in np.flatnonzero(choice != start):
            sections, rest = self._sections[choice[k]], np.zeros_like(self._filters[k])
            for first, raw in ((0, acceleration), (POINTS, self._raw)):
                passed, state = sosfilt(sections, raw[:, k * size : (k + 1) * size], axis=0, zi=rest)
                own = slice(first + k * size, first + (k + 1) * size)
                self._filtered[-len(passed) :, own] = passed[-len(self._filtered) :]
            self._filters[k] = state
        self._choice = choice.copy()

    def rms(self) -> tuple[Array, Array]:
        """Sliding RMS of acceleration (m/s2) and track shift force (N) at the points; 0 without samples."""
        if not len(self._filtered):
            return np.zeros(POINTS), np.zeros(POINTS)
        values = np.sqrt(np.mean(self._filtered[-self._window :] ** 2, axis=0))
        return values[:POINTS], values[POINTS:]
