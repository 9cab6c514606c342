"""Notes for the user on the measured files that a configuration names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig, TableThrottle
from sayd_env.config.line import LineConfig
from sayd_env.config.track import FileConfig, TrackConfig
from sayd_env.config.vehicle import Damper, MeasuredCurve, VehicleConfig
from sayd_env.measured.dampers import curve_note
from sayd_env.measured.lines import read_measured_line
from sayd_env.measured.tracks import check_gauge, read_measured
from sayd_env.measured.valves import map_note


def measured_notes(parts: Mapping[str, object]) -> tuple[str, ...]:
    """What was read from files and done to their numbers, a line for each.

    Parameters
    ----------
    parts : mapping
        Vehicles, dampers and tracks, and lines as `line_content` gives them, by any names; others are passed
        over.

    Raises
    ------
    ConfigError, DataError
        A file cannot be used, or its gauge departs from another one than the track has.
    """
    return tuple(dict.fromkeys(note for part in parts.values() for note in _of(part)))


def _of(part: object) -> Iterator[str]:
    if isinstance(part, VehicleConfig):
        for element in part.elements:
            if isinstance(element, Damper) and isinstance(element.curve, MeasuredCurve):
                yield curve_note(element.curve)
    elif isinstance(part, PassiveDamperConfig) and isinstance(part.curve, MeasuredCurve):
        yield curve_note(part.curve)
    elif isinstance(part, SaydDamperConfig) and isinstance(part.throttle, TableThrottle):
        yield map_note(part.throttle)
    elif isinstance(part, TrackConfig) and isinstance(part.irregularity, FileConfig):
        yield from _of_track(part.irregularity, part.gauge)
    elif isinstance(part, Mapping) and part.get("file"):
        line = LineConfig.model_validate({key: part[key] for key in LineConfig.model_fields if key in part})
        yield from _of_line(line)


def _of_line(line: LineConfig) -> Iterator[str]:
    assert line.file is not None
    irregularities = read_measured_line(line).tracks
    yield from (note for piece in irregularities for note in _of_track(piece.irregularity))


def _of_track(config: object, gauge: float | None = None) -> Iterator[str]:
    """Notes on a file of a line, or of a track with a gauge of its own (m)."""
    assert isinstance(config, FileConfig)
    measured = read_measured(config)
    if gauge is not None:
        check_gauge(measured, gauge)
    for note in measured.notes:
        yield f"{config.path}: {note}"
