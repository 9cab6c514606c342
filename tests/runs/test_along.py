"""J off line along a line: a filter that follows the hunting from section to section, on made-up signals."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sayd_env.config.assessment import load_assessment
from sayd_env.config.line import LineConfig, LineSectionConfig, resolve
from sayd_env.envs.loop import LOG
from sayd_env.runs import along
from sayd_env.runs.along import Trip, offline_along

RATE, SPEED, RUN_IN = 500.0, 80.0, 500


def made(amplitude: float, frequencies: tuple[float, ...], lengths: tuple[float, ...]) -> tuple[Any, Trip]:
    """A run in which each section has a frequency of its own, after a second before step 0."""
    sections = tuple(LineSectionConfig(length=length) for length in lengths)
    trip = Trip(resolve(LineConfig(sections=sections)), SPEED)
    count = RUN_IN + round(sum(lengths) / SPEED * RATE)
    times = (np.arange(count) + 1 - RUN_IN) / RATE
    place = trip.sections(np.maximum(times, 0.0))
    phase = 2.0 * np.pi * np.cumsum(np.array(frequencies)[place]) / RATE
    signals = np.zeros((count, LOG))
    signals[:, :4] = (amplitude * np.sin(phase))[:, None]
    return SimpleNamespace(true=signals, run_in=RUN_IN, sample_rate=RATE, times=times), trip


def test_a_sine_has_half_its_square_whatever_its_frequency_in_a_section():
    """4 Hz, then 9 Hz: a filter of one frequency would lose one of them."""
    rollout, trip = made(1.4, (4.0, 9.0), (2000.0, 2000.0))
    assert offline_along(rollout, trip, load_assessment()) == pytest.approx(1.4**2 / 2.0, rel=0.02)


@pytest.mark.parametrize(("on_the_second", "judged"), [(300.0, False), (500.0, True), (700.0, True)])
def test_a_straight_on_which_the_time_runs_out_is_judged_if_it_is_long_enough(
    on_the_second: float, judged: bool
):
    """A segment of the spectrum takes 500 m. A sine has an RMS of its amplitude by the root of two."""
    rollout, trip = made(1.0, (5.0, 5.0), (1500.0, 2000.0))
    kept = RUN_IN + round((1500.0 + on_the_second) / SPEED * RATE)
    rollout.true, rollout.times, rollout.ending = rollout.true[:kept], rollout.times[:kept], None
    run = SimpleNamespace(scenario=SimpleNamespace(assessment=load_assessment()))
    (first, second), _ = along._sliding_rms(run, rollout, trip)
    assert first == pytest.approx(math.sqrt(0.5), rel=0.02)
    # Where the signals end, in the middle of a wave, the filter of both directions is 2.5 % too high.
    assert second == pytest.approx(math.sqrt(0.5) if judged else math.nan, rel=0.04, nan_ok=True)


def test_a_short_last_section_counts_with_the_one_before():
    rollout, trip = made(0.7, (5.0, 5.0), (1500.0, 200.0))
    assert offline_along(rollout, trip, load_assessment()) == pytest.approx(0.7**2 / 2.0, rel=0.02)
