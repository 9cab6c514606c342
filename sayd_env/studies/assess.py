"""Is a recorded ride stable? EN 14363 on the signals of a real train."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sayd_env.config import ConfigError, DataError
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.palette import SKY, VERMILION
from sayd_env.config.units import KMH, Array
from sayd_env.report.columns import Column, Table, csv_table, json_rows, print_table
from sayd_env.report.figures import Plot, legend_below, limit_line, panels
from sayd_env.stability import (
    Assessment,
    Channel,
    Limits,
    Quantity,
    Recording,
    assess,
    assessed_span,
    band_pass,
    distance_run,
    limits,
    read_recording,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

_PLOTS_PER_FIGURE = 4
# Fourteen points in a period of 14 Hz, the highest edge of the pass band: enough for a smooth line.
_PLOT_RATE = 200.0


class _Unit(NamedTuple):
    """Unit of what is shown of a quantity."""

    name: str
    scale: float
    """From SI to it."""
    key: str
    """In a column's name."""


_UNITS = {
    Quantity.ACCELERATION: _Unit("m/s²", 1.0, "m_s2"),
    Quantity.TRACK_SHIFT_FORCE: _Unit("kN", 1e-3, "kn"),
}


@dataclass(frozen=True)
class ChannelResult:
    """Verdict on one channel; SI units."""

    channel: Channel
    dominant_frequency: float
    """f_0 (Hz); NaN for a constant signal."""
    rms_max: float
    """Maximum of the sliding RMS (m/s2 or N)."""
    position: float
    """Centre of the window with the maximum, from the first sample (m)."""
    limit: float
    """Limit of the sliding RMS (m/s2 or N)."""

    @property
    def stable(self) -> bool:
        """Whether the maximum does not exceed the limit."""
        return self.rms_max <= self.limit

    def row(self) -> dict[str, Any]:
        """Values by `COLUMNS`, and the unit as it is printed."""
        unit = _UNITS[self.channel.quantity]
        return {
            "name": self.channel.name,
            "quantity": self.channel.quantity.value,
            "unit": unit.key,
            "shown_unit": unit.name,
            "dominant_frequency_hz": self.dominant_frequency,
            "rms_max": self.rms_max * unit.scale,
            "limit": self.limit * unit.scale,
            "ratio": self.rms_max / self.limit,
            "position_m": self.position,
            "stable": self.stable,
        }


COLUMNS = (
    Column("name", "channel"),
    Column("quantity", "quantity", wide=True),
    Column("unit"),
    Column("dominant_frequency_hz", "f_0", "Hz", digits=2),
    Column("rms_max", "max. RMS", digits=2),
    Column("limit", "limit", digits=2),
    Column("ratio", "ratio", digits=2, limit=1.0),
    Column("position_m", "at", "m", digits=0),
    Column("stable", "stable", bad=lambda stable: not stable),
)


@dataclass(frozen=True)
class RecordingResult:
    """Verdict on a recording."""

    file: str
    settings: AssessmentConfig
    """Settings in force, options included."""
    recording: Recording
    assessment: Assessment
    limits: Limits

    @property
    def channels(self) -> list[ChannelResult]:
        """Verdict on each channel, in the order of the file."""
        found = self.assessment
        position = found.position[found.rms.argmax(axis=0)]
        numbers = np.column_stack([found.dominant_frequency, found.maximum, position]).tolist()
        return [
            ChannelResult(channel, frequency, largest, place, self.limit(channel))
            for channel, (frequency, largest, place) in zip(self.recording.channels, numbers, strict=True)
        ]

    @property
    def stable(self) -> bool:
        """Whether every channel stays within its limit."""
        return all(channel.stable for channel in self.channels)

    @property
    def distance(self) -> Array:
        """Distance of every sample from the first (m)."""
        recording = self.recording
        return distance_run(recording.speed, recording.sample_rate, len(recording.signals))

    def limit(self, channel: Channel) -> float:
        """Limit that applies to a channel (m/s2 or N)."""
        if channel.quantity is Quantity.ACCELERATION:
            return self.limits.acceleration
        return self.limits.track_shift_force

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``."""
        distance = self.distance
        start, end = assessed_span(distance, self.settings)
        speed = np.broadcast_to(self.recording.speed, distance.shape)[distance >= start] * KMH
        return {
            "file": self.file,
            "stable": self.stable,
            "sample_rate_hz": self.recording.sample_rate,
            "assessed_distance_m": end - start,
            "speed_kmh": {"min": speed.min(), "mean": speed.mean(), "max": speed.max()},
            "limits": {
                "acceleration_rms": self.limits.acceleration,
                "track_shift_rms_kn": self.limits.track_shift_force / 1e3,
            },
            "channels": json_rows(COLUMNS, [channel.row() for channel in self.channels]),
        }

    def tables(self) -> dict[str, Table]:
        """Return the verdicts, and the sliding RMS over the distance."""
        units = [_UNITS[channel.quantity] for channel in self.recording.channels]
        named = zip(self.recording.channels, units, strict=True)
        values = self.assessment.rms * [unit.scale for unit in units]
        return {
            "channels": csv_table(COLUMNS, [channel.row() for channel in self.channels]),
            "sliding_rms": (
                ["position_m", *(f"{channel.name}_{unit.key}" for channel, unit in named)],
                np.column_stack([self.assessment.position, values]).tolist(),
            ),
        }

    def plots(self) -> dict[str, Plot]:
        """Return filtered signals with their sliding RMS and limits (figure 8a of Wang et al. 2022)."""
        count = len(self.recording.channels)
        groups = [range(i, min(i + _PLOTS_PER_FIGURE, count)) for i in range(0, count, _PLOTS_PER_FIGURE)]
        if len(groups) == 1:
            return {"signals": partial(self._draw, groups[0])}
        return {f"signals_{k}": partial(self._draw, group) for k, group in enumerate(groups, start=1)}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print one line for each channel and the verdict."""
        rows = [channel.row() for channel in self.channels]
        columns = (COLUMNS[0], Column("shown_unit", "unit"), *COLUMNS[1:])
        print_table(console, "largest sliding RMS by EN 14363", columns, rows, wide=wide)
        distance = self.as_dict()["assessed_distance_m"]
        verdict = "stable" if self.stable else "unstable"
        console.print(f"{self.file}: {verdict} by EN 14363 over {distance:.0f} m", markup=False)

    def _draw(self, group: range, figure: Figure) -> None:
        recording, distance = self.recording, self.distance
        start, _ = assessed_span(distance, self.settings)
        stride = max(1, int(recording.sample_rate / _PLOT_RATE))
        part = slice(int(np.searchsorted(distance, start)), None, stride)
        chosen = list(group)
        filtered = band_pass(
            recording.signals[:, chosen],
            recording.sample_rate,
            self.assessment.dominant_frequency[chosen],
            self.settings,
        )[part]
        axes = panels(figure, len(chosen), size=(8.0, 1.9), sharex=True)
        for axis, k, signal in zip(axes, chosen, filtered.T, strict=True):
            self._draw_channel(axis, k, distance[part], signal)
        axes[-1].set_xlabel("distance (m)")
        legend_below(figure, axes[0])

    def _draw_channel(self, axis: Axes, k: int, distance: Array, signal: Array) -> None:
        channel = self.recording.channels[k]
        unit = _UNITS[channel.quantity]
        rms = self.assessment.rms[:, k] * unit.scale
        limit = self.limit(channel) * unit.scale
        draw_assessed(axis, distance, signal * unit.scale, self.assessment.position, rms, limit)
        axis.set_ylabel(unit.name)
        axis.set_title(
            f"{channel.name}, f0 = {self.assessment.dominant_frequency[k]:.2f} Hz", fontsize="small"
        )


def draw_assessed(axis: Axes, x: Array, filtered: Array, position: Array, rms: Array, limit: float) -> None:
    """Draw a band-passed signal, its sliding RMS at other places and the limit of this."""
    axis.plot(x, filtered, color=SKY, linewidth=0.5, label="band-passed signal")
    axis.plot(position, rms, "x-", color=VERMILION, markersize=3, linewidth=0.8, label="sliding RMS")
    limit_line(axis, limit, "limit")


def assess_file(
    path: Path,
    settings: AssessmentConfig,
    *,
    speed: float | None = None,
    sample_rate: float | None = None,
    columns: Sequence[str] | None = None,
    run_in: float = 0.0,
    axle_load: float | None = None,
    bogie_mass: float | None = None,
) -> RecordingResult:
    """Assess a recording by EN 14363: all of it behind the run-in.

    Parameters
    ----------
    path : Path
        CSV file, see `sayd_env.stability.read_recording`.
    settings : AssessmentConfig
        The procedure; its run-in and length are those of simulated runs and do not apply.
    speed, sample_rate : float, optional
        Constant speed (m/s) and sampling rate (Hz) of a file without such a column, or one of time.
    columns : sequence of str, optional
        Channels to assess; all by default.
    run_in : float
        Distance at the start that is not assessed (m).
    axle_load, bogie_mass : float, optional
        Vehicle of the recording (N, kg), if it is not that of the settings.

    Raises
    ------
    ConfigError
        An option or the file cannot be used.
    DataError
        The content of the file cannot be used.
    """
    if not (math.isfinite(run_in) and run_in >= 0):
        raise ConfigError(f"run-in: found {run_in:g} m; it must be 0 or more")
    given = {"axle_load": axle_load, "bogie_mass": bogie_mass}
    settings = settings.model_copy(
        update={"run_in": run_in, "length": None} | {k: v for k, v in given.items() if v is not None}
    )
    limit_values = limits(settings.axle_load, settings.bogie_mass)
    recording = read_recording(path, settings, speed=speed, sample_rate=sample_rate, columns=columns)
    try:
        assessment = assess(recording.signals, recording.sample_rate, recording.speed, settings)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    return RecordingResult(str(path), settings, recording, assessment, limit_values)
