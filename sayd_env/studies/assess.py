"""Is a recorded ride stable? EN 14363 on the signals of a real train."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sayd_env.config import ConfigError, DataError, StudyError
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.limits import AXLE_LOAD, BOGIE_MASS
from sayd_env.config.palette import GREY, SKY, cycled
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array
from sayd_env.physics.multibody import assemble
from sayd_env.report.columns import Column, Listing, Table, csv_table, json_rows
from sayd_env.report.figures import Plot, label, legend_below, limit_line, panels
from sayd_env.report.html import Grid, Page, Picture, Section, Text, Verdict
from sayd_env.report.live import extremes
from sayd_env.stability import (
    Assessment,
    Channel,
    Quantity,
    Recording,
    acceleration_limit,
    assess,
    assessed_span,
    averaged_spectra,
    band_pass,
    distance_run,
    read_recording,
    track_shift_limit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

_PLOTS_PER_FIGURE = 4
_LONGEST_NAME = 36
# EN 14363 takes these quantiles of a quantity in a section for its extremes.
_QUANTILES = (0.0015, 0.9985)


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
_TITLES = {
    Quantity.ACCELERATION: "lateral acceleration of the bogie frame",
    Quantity.TRACK_SHIFT_FORCE: "track shift force of a wheelset",
}


class Stated(NamedTuple):
    """A number of a train and who stated it."""

    value: float
    source: str


@dataclass(frozen=True)
class Train:
    """What the limits follow from."""

    bogie_mass: Stated | None = None
    """Mass of the whole bogie, wheelsets included (kg)."""
    axle_load: Stated | None = None
    """Static load of one wheelset on the rails (N)."""

    @classmethod
    def of(
        cls,
        *,
        bogie_mass: float | None = None,
        axle_load: float | None = None,
        scenario: Scenario | None = None,
    ) -> Train:
        """Take numbers as given (kg, N), the others from the vehicle of a scenario, if there is one.

        Raises
        ------
        ConfigError
            A number that no train has, such as one in t or kN.
        """
        for name, value, allowed in (
            ("bogie_mass", bogie_mass, BOGIE_MASS),
            ("axle_load", axle_load, AXLE_LOAD),
        ):
            if value is not None and not allowed.low <= value <= allowed.high:
                raise ConfigError(f"{name}: found {value:g}; expected {allowed}")
        mass = None if bogie_mass is None else Stated(bogie_mass, "--bogie-mass")
        load = None if axle_load is None else Stated(axle_load, "--axle-load")
        if scenario is None:
            return cls(mass, load)
        vehicle = assemble(scenario.vehicle, scenario.track.section)
        source = f"vehicle {scenario.vehicle.name}"
        return cls(
            mass or Stated(vehicle.bogie_mass, source),
            load or Stated(vehicle.axle_load, source),
        )

    def limit(self, quantity: Quantity) -> float:
        """Limit of a quantity's sliding RMS (m/s2 or N), see `check`."""
        self.check([quantity])
        if quantity is Quantity.ACCELERATION:
            return acceleration_limit(self.bogie_mass.value if self.bogie_mass else math.nan)
        return track_shift_limit(self.axle_load.value if self.axle_load else math.nan)

    def check(self, quantities: Iterable[Quantity]) -> None:
        """Refuse a train of which a number is missing that the limit of a quantity follows from.

        Raises
        ------
        ConfigError
            It names all that is missing, and how to give it.
        """
        found = set(quantities)
        missing = []
        if Quantity.ACCELERATION in found and self.bogie_mass is None:
            missing.append("the limit of accelerations follows from the bogie's mass: give --bogie-mass KG")
        if Quantity.TRACK_SHIFT_FORCE in found and self.axle_load is None:
            missing.append("the limit of track shift forces follows from the axle load: give --axle-load KN")
        if missing:
            raise ConfigError(
                f"the recorded train is not known: {'; '.join(missing)}; or --config with a study whose"
                " vehicle is that train"
            )


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
        """Whether the maximum does not exceed the limit.

        Raises
        ------
        StudyError
            The maximum is no number, so that there is no verdict.
        """
        if math.isnan(self.rms_max):
            raise StudyError(
                f"channel '{self.channel.name}': its largest sliding RMS is no number; no verdict"
            )
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
_SHOWN = (COLUMNS[0], Column("shown_unit", "unit"), *COLUMNS[1:])

SECTION_COLUMNS = (
    Column("start_m", "from", "m", digits=0),
    Column("end_m", "to", "m", digits=0),
    Column("speed_kmh", "speed", "km/h", digits=0),
    Column("name", "channel"),
    Column("unit", "unit"),
    Column("mean", "mean", digits=2),
    Column("low", "0.15 %", digits=2),
    Column("high", "99.85 %", digits=2),
    Column("rms", "RMS", digits=2),
    Column("band_rms", "RMS in the band", digits=2),
    Column("rms_max", "max. sliding RMS", digits=2),
    Column("ratio", "ratio to the limit", digits=2, limit=1.0),
)
"""Statistics of a section of the line: of the measured signal, and behind the band-pass filter."""


@dataclass(frozen=True)
class RecordingResult:
    """Verdict on a recording."""

    file: str
    settings: AssessmentConfig
    """Settings in force, options included."""
    recording: Recording
    assessment: Assessment
    train: Train

    @property
    def channels(self) -> list[ChannelResult]:
        """Verdict on each channel, in the order of the file."""
        found = self.assessment
        position = found.position[found.rms.argmax(axis=0)]
        numbers = np.column_stack([found.dominant_frequency, found.maximum, position]).tolist()
        return [
            ChannelResult(channel, frequency, largest, place, self.train.limit(channel.quantity))
            for channel, (frequency, largest, place) in zip(self.recording.channels, numbers, strict=True)
        ]

    @property
    def stable(self) -> bool:
        """Whether every channel stays within its limit."""
        return all(channel.stable for channel in self.channels)

    @cached_property
    def distance(self) -> Array:
        """Distance of every sample from the first (m)."""
        recording = self.recording
        return distance_run(recording.speed, recording.sample_rate, len(recording.signals))

    @cached_property
    def filtered(self) -> Array:
        """Signals behind the band-pass filter, shape (n, channels)."""
        found = self.recording
        return band_pass(found.signals, found.sample_rate, self.assessment.dominant_frequency, self.settings)

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``."""
        start, end = assessed_span(self.distance, self.settings)
        speed = np.broadcast_to(self.recording.speed, self.distance.shape)[self.distance >= start] * KMH
        limits = {quantity: self.train.limit(quantity) for quantity in self._quantities}
        force = limits.get(Quantity.TRACK_SHIFT_FORCE)
        return {
            "file": self.file,
            "stable": self.stable,
            "sample_rate_hz": self.recording.sample_rate,
            "assessed_distance_m": end - start,
            "speed_kmh": {"min": speed.min(), "mean": speed.mean(), "max": speed.max()},
            "train": {
                "bogie_mass_kg": _of(self.train.bogie_mass),
                "axle_load_kn": _of(self.train.axle_load, 1e-3),
            },
            "limits": {
                "acceleration_rms": limits.get(Quantity.ACCELERATION),
                "track_shift_rms_kn": None if force is None else force / 1e3,
            },
            "notes": list(self.recording.notes),
            "channels": json_rows(COLUMNS, [channel.row() for channel in self.channels]),
        }

    @property
    def _quantities(self) -> list[Quantity]:
        found = {channel.quantity for channel in self.recording.channels}
        return [quantity for quantity in Quantity if quantity in found]

    def tables(self) -> dict[str, Table]:
        """Return the verdicts, the statistics of sections, and the sliding RMS over the distance."""
        units = [_UNITS[channel.quantity] for channel in self.recording.channels]
        named = zip(self.recording.channels, units, strict=True)
        values = self.assessment.rms * [unit.scale for unit in units]
        return {
            "channels": csv_table(COLUMNS, [channel.row() for channel in self.channels]),
            "sections": csv_table(SECTION_COLUMNS, self.sections()),
            "sliding_rms": (
                ["position_m", *(f"{channel.name}_{unit.key}" for channel, unit in named)],
                np.column_stack([self.assessment.position, values]).tolist(),
            ),
        }

    def sections(self) -> list[dict[str, Any]]:
        """Rows of `SECTION_COLUMNS`: sections of the length of a spectrum, the last one up to half longer."""
        start, end = assessed_span(self.distance, self.settings)
        count = max(1, round((end - start) / self.settings.segment_length))
        bounds = [start + self.settings.segment_length * k for k in range(count)] + [end]
        return [row for bound in pairwise(bounds) for row in self._section(*bound)]

    def _section(self, start: float, end: float) -> Iterator[dict[str, Any]]:
        first, last = np.searchsorted(self.distance, [start, end])
        part = slice(int(first), max(int(last), int(first) + 1))
        centre = self.assessment.position
        windows = (centre >= start) & (centre <= end)
        speed = np.broadcast_to(self.recording.speed, self.distance.shape)[part].mean()
        for k, channel in enumerate(self.recording.channels):
            unit = _UNITS[channel.quantity]
            signal, band = self.recording.signals[part, k], self.filtered[part, k]
            low, high = np.quantile(signal, _QUANTILES)
            largest = float(self.assessment.rms[windows, k].max()) if windows.any() else math.nan
            numbers = {
                "mean": signal.mean(),
                "low": low,
                "high": high,
                "rms": np.sqrt(np.mean(signal**2)),
                "band_rms": np.sqrt(np.mean(band**2)),
                "rms_max": largest,
            }
            yield {
                "start_m": start,
                "end_m": end,
                "speed_kmh": speed * KMH,
                "name": channel.name,
                "unit": unit.name,
                **{key: float(value) * unit.scale for key, value in numbers.items()},
                "ratio": largest / self.train.limit(channel.quantity),
            }

    def plots(self) -> dict[str, Plot]:
        """Return signals, their sliding RMS with the limits (figure 8a of Wang et al. 2022), and spectra."""
        count = len(self.recording.channels)
        groups = [range(i, min(i + _PLOTS_PER_FIGURE, count)) for i in range(0, count, _PLOTS_PER_FIGURE)]
        names = ["signals"] if len(groups) == 1 else [f"signals_{k}" for k in range(1, len(groups) + 1)]
        signals: dict[str, Plot] = {
            name: partial(self._draw_signals, group) for name, group in zip(names, groups, strict=True)
        }
        return signals | {"sliding_rms": self._draw_rms, "spectra": self._draw_spectra}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print one line for each channel, what was done to the data, and the verdict."""
        self._listing().print(console, wide)
        for line in (*self._limit_words(), *self.recording.notes):
            console.print(_SHOWN[0].words(line), markup=False, highlight=False)
        distance = self.as_dict()["assessed_distance_m"]
        verdict = "stable" if self.stable else "unstable"
        console.print(f"{self.file}: {verdict} by EN 14363 over {distance:.0f} m", markup=False)

    def page(self) -> Page:
        """The page that goes to others: verdict, pictures, sections, what was done to the data."""
        about, settings = self.as_dict(), self.settings
        speed, metres = about["speed_kmh"], about["assessed_distance_m"]
        verdict = "stable" if self.stable else "unstable"
        facts = {
            "file": self.file,
            "assessed distance": f"{metres:.0f} m, behind {settings.run_in:g} m left out",
            "speed": f"{speed['min']:.0f} to {speed['max']:.0f} km/h, mean {speed['mean']:.0f} km/h",
            "sampling rate": f"{about['sample_rate_hz']:g} Hz",
        }
        names = [name for name in self.plots() if name.startswith("signals")]
        about_signals, about_sliding = (text.format(s=settings) for text in (_SIGNALS, _SLIDING))
        signals = [
            Picture(
                name,
                f"Measured and band-passed signals, {name}",
                [about_signals] if name == names[-1] else [],
            )
            for name in names
        ]
        shown = {
            channel.name: names[k // _PLOTS_PER_FIGURE] for k, channel in enumerate(self.recording.channels)
        }

        def figure(row: dict[str, Any]) -> str:
            return shown[row["name"]]

        sections = Listing("", SECTION_COLUMNS, self.sections(), "start_m")
        channels = self._listing()
        above = [channel.channel.name for channel in self.channels if not channel.stable]
        words = [f"The ride is {verdict} by EN 14363 over {metres:.0f} m."]
        words += [f"Above the limit: {', '.join(above)}."] if above else []
        return Page(
            f"Running stability of {Path(self.file).name}",
            Verdict(words, self.stable),
            [
                Section("Channels", [Grid.of(channels, figure), *map(Text, self._limit_words())]),
                Section("Recording", [Grid.facts(facts), *map(Text, self.recording.notes)]),
                Section(
                    "Sliding RMS and limits",
                    [Picture("sliding_rms", "Sliding RMS over the distance, with limits", [about_sliding])],
                ),
                Section("Signals", signals),
                Section("Spectra", [Picture("spectra", "Spectra of the signals", [_SPECTRA])]),
                Section(
                    f"Sections of {settings.segment_length:g} m", [Text(_SECTIONS), Grid.of(sections, figure)]
                ),
            ],
        )

    def _listing(self) -> Listing:
        rows = [channel.row() for channel in self.channels]
        return Listing("largest sliding RMS by EN 14363", _SHOWN, rows)

    def _limit_words(self) -> list[str]:
        words = []
        if Quantity.ACCELERATION in self._quantities and self.train.bogie_mass:
            mass, source = self.train.bogie_mass
            limit = self.train.limit(Quantity.ACCELERATION)
            words.append(f"Limit {limit:.2f} m/s² of accelerations: bogie of {mass:,.0f} kg ({source}).")
        if Quantity.TRACK_SHIFT_FORCE in self._quantities and self.train.axle_load:
            load, source = self.train.axle_load
            limit = self.train.limit(Quantity.TRACK_SHIFT_FORCE) / 1e3
            words.append(
                f"Limit {limit:.2f} kN of track shift forces: axle load {load / 1e3:.1f} kN ({source})."
            )
        return words

    def _draw_signals(self, group: range, figure: Figure) -> None:
        start, _ = assessed_span(self.distance, self.settings)
        part = slice(int(np.searchsorted(self.distance, start)), None)
        axes = panels(figure, len(group), size=(8.0, 1.9), sharex=True)
        for axis, k in zip(axes, group, strict=True):
            channel, f0 = self.recording.channels[k], self.assessment.dominant_frequency[k]
            unit = _UNITS[channel.quantity]
            x, measured = extremes(self.distance[part], self.recording.signals[part, k] * unit.scale)
            axis.plot(x, measured, color=GREY, alpha=0.5, linewidth=0.5, label="measured signal")
            x, filtered = extremes(self.distance[part], self.filtered[part, k] * unit.scale)
            axis.plot(x, filtered, color=SKY, linewidth=0.5, label="band-passed signal")
            axis.set_ylabel(unit.name)
            axis.set_title(f"{_short(channel.name)}, f0 = {f0:.2f} Hz", fontsize="small")
        axes[-1].set_xlabel("distance (m)")
        legend_below(figure, axes[0])

    def _draw_rms(self, figure: Figure) -> None:
        found = self.assessment
        names = [_short(channel.name) for channel in self.recording.channels]
        axes = self._draw_channels(figure, found.position, found.rms, names, "sliding RMS")
        for axis, quantity in zip(axes, self._quantities, strict=True):
            limit = self.train.limit(quantity) * _UNITS[quantity].scale
            limit_line(axis, limit, "limit")
            axis.set_ylim(0.0, 1.15 * max(limit, axis.dataLim.y1))
            _legend_beside(axis)
        axes[-1].set_xlabel("distance (m)")

    def _draw_spectra(self, figure: Figure) -> None:
        found = self.recording
        span = assessed_span(self.distance, self.settings)
        frequency, spectra = averaged_spectra(
            found.signals, found.sample_rate, self.distance, self.settings, span
        )
        names = [
            f"{_short(channel.name)}: f0 = {f0:.2f} Hz"
            for channel, f0 in zip(found.channels, self.assessment.dominant_frequency, strict=True)
        ]
        axes = self._draw_channels(figure, frequency, np.sqrt(spectra).T, names, "RMS")
        for axis in axes:
            axis.set_ylim(bottom=0.0)
            _legend_beside(axis)
        axes[-1].set_xlabel("frequency (Hz)")

    def _draw_channels(
        self, figure: Figure, x: Array, values: Array, names: Sequence[str], what: str
    ) -> list[Axes]:
        """Draw curves of all channels, shape (n, channels), a panel for each quantity."""
        axes = panels(figure, len(self._quantities), size=(8.0, 3.0), sharex=True)
        for axis, quantity in zip(axes, self._quantities, strict=True):
            unit = _UNITS[quantity]
            for number, k in enumerate(self._of(quantity)):
                style = cycled(number).plain
                axis.plot(x, values[:, k] * unit.scale, **style, linewidth=1.0, label=names[k])
            axis.set(ylabel=f"{what} ({unit.name})", title=_TITLES[quantity])
        return axes

    def _of(self, quantity: Quantity) -> list[int]:
        return [k for k, channel in enumerate(self.recording.channels) if channel.quantity is quantity]


def _of(stated: Stated | None, scale: float = 1.0) -> dict[str, Any] | None:
    return None if stated is None else {"value": stated.value * scale, "from": stated.source}


def _short(name: str) -> str:
    """A channel's name as a picture has room for it."""
    return label(name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…")


def _legend_beside(axis: Axes) -> None:
    axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


_SLIDING = (
    "RMS of the band-passed signals over {s.window_length:g} m, every {s.window_step:g} m, as section 3 of "
    "Wang et al. (2022) applies EN 14363. The limit of accelerations is (12 - m_b / 5) / 2 m/s² with the "
    "bogie's mass m_b in t, that of track shift forces (10 + P / 3) / 2 kN with the axle load P in kN. A "
    "channel above its limit makes the ride unstable."
)
_SIGNALS = (
    "Each signal as it was measured, and behind a band-pass filter of {s.band_half_width:g} Hz to both sides "
    "of its dominant frequency f0, run forward and backward. Of long recordings the extremes are drawn."
)
_SPECTRA = (
    "RMS of harmonic components, averaged over sections that overlap by half. The highest peak is the "
    "dominant frequency f0."
)
_SECTIONS = (
    "Mean, quantiles and RMS are of the signal as it was measured; RMS in the band and sliding RMS of the "
    "band-passed one. Rows above the limit stand out."
)


def assess_file(
    path: Path,
    settings: AssessmentConfig,
    train: Train,
    *,
    speed: float | None = None,
    sample_rate: float | None = None,
    columns: Sequence[str] | None = None,
    run_in: float = 0.0,
) -> RecordingResult:
    """Assess a recording by EN 14363: all of it behind the run-in.

    Parameters
    ----------
    path : Path
        The file, see `sayd_env.stability.read_recording`.
    settings : AssessmentConfig
        The procedure; its run-in and length are those of simulated runs and do not apply.
    train : Train
        The recorded train, from whose numbers the limits follow.
    speed, sample_rate : float, optional
        Constant speed (m/s) and sampling rate (Hz) of a file without such a column, or one of time.
    columns : sequence of str, optional
        Channels to assess; all by default.
    run_in : float
        Distance at the start that is not assessed (m).

    Raises
    ------
    ConfigError
        An option or the file cannot be used, or a number of the train is missing.
    DataError
        The content of the file cannot be used.
    """
    if not (math.isfinite(run_in) and run_in >= 0):
        raise ConfigError(f"run-in: found {run_in:g} m; it must be 0 or more")
    settings = settings.model_copy(update={"run_in": run_in, "length": None})
    recording = read_recording(path, settings, speed=speed, sample_rate=sample_rate, columns=columns)
    train.check(channel.quantity for channel in recording.channels)
    try:
        assessment = assess(recording.signals, recording.sample_rate, recording.speed, settings)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    return RecordingResult(str(path), settings, recording, assessment, train)
