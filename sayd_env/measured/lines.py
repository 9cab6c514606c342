"""Lines as everything reads them: from sections, or from a measured CSV file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sayd_env.config.conditions import (
    SHORTEST_TRANSITION,
    Knots,
    Line,
    Section,
    TrackPiece,
    checked,
    joined,
)
from sayd_env.config.errors import ConfigError, DataError
from sayd_env.config.files import read_bytes
from sayd_env.config.line import LineConfig, outline, read_line, resolve, resolve_rails
from sayd_env.config.track import FileConfig, IrregularityConfig, TrackConfig
from sayd_env.config.units import Array
from sayd_env.measured.distance import CONDITIONS, IRREGULARITIES, DistanceColumn, DistanceTable, read_table
from sayd_env.measured.table import LARGEST
from sayd_env.measured.tracks import refuse_unused, stated_gauge

# A shorter line is one of kilometres in a column of metres.
_SHORTEST = 100.0  # m
# Where a line has cant it has centimetres: less is one of metres in a column of millimetres.
_LEAST_CANT = 1e-3  # m
# Below these a curve, and a cant of the other sign in it, may be noise of a straight.
_LEAST_CURVATURE, _WRONG_CANT = 5e-5, 5e-3  # 1/m, m
# Changes below these are not judged: a noise of 0.03/km, or of 1 mm, from row to row stays below them.
_LEAST_JUMP, _LEAST_GAUGE_JUMP = 1.2e-4, 5e-3  # 1/m, m
# Length of the means that are judged (m), and the most of a change that may lie within half a transition.
_MEAN, _MOST_SHARE = 5.0, 0.85
_PLACES = SHORTEST_TRANSITION * np.linspace(-0.5, 0.5, 5)
# Keys of a scenario and the option of an episode that sets the same.
_OPTIONS = {
    "friction": "friction",
    "track": "track",
    "track.gauge": "gauge",
    "track.irregularity.scale": "track_scale",
}


def load_line(
    line: str | LineConfig,
    overrides: Iterable[str] = (),
    *,
    speed: float | None = None,
    gauge: float | None = None,
    friction: float | None = None,
) -> Line:
    """Conditions over distance of a line.

    Parameters
    ----------
    line : str or LineConfig
        A packaged name (``highspeed``), a path to a YAML file or to a measured CSV file, or its content.
    overrides : iterable of str
        ``key=value`` assignments to a file's keys.
    speed, gauge, friction : float, optional
        What the episode has (m/s, m, -), for sections that leave out what others say.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used, or a line that is not allowed.
    DataError
        A measured file that cannot be used.
    """
    source = "line"
    if isinstance(line, str):
        source = line
        line = read_line(line, overrides)
    if line.file is not None:
        return read_measured_line(line, speed)
    return resolve(line, speed=speed, gauge=gauge, friction=friction, source=source)


def own_line(line: str | LineConfig) -> Line:
    """What a line says itself, whatever the episode's speed, gauge and friction are.

    Raises
    ------
    ConfigError, DataError
        As `load_line`.
    """
    config = read_line(line) if isinstance(line, str) else line
    return outline(config) if config.file is None else read_measured_line(config)


def irregularities_along(tracks: Iterable[TrackConfig], line: str | None = None) -> list[IrregularityConfig]:
    """Irregularities under runs on some tracks, or along a line, which takes a track's where it has none.

    Raises
    ------
    ConfigError, DataError
        As `load_line`.
    """
    pieces = () if line is None else own_line(line).tracks
    said = [piece.irregularity for piece in pieces] or [None]
    return [each or track.irregularity for track in tracks for each in said]


def refuse_said(line: str | LineConfig, given: Mapping[str, str]) -> None:
    """Refuse what is given beside a line that says the same all along.

    Parameters
    ----------
    line : str or LineConfig
        The line.
    given : mapping
        What messages call each thing that is given, and the name of the episode's option that it is.

    Raises
    ------
    ConfigError
        The line says one of them; or as `load_line`.
    DataError
        As `load_line`.
    """
    if not given:
        return
    said = own_line(line).said
    called = f"line '{line}'" if isinstance(line, str) else "the line"
    for source, name in given.items():
        if name in said:
            raise ConfigError(
                f"{source}: has no effect: {called} says {name} itself, all along; leave one of them out"
            )


def options_of(keys: Iterable[str]) -> dict[str, str]:
    """Keys of a scenario that are an option of an episode, with its name."""
    found = {key: _OPTIONS.get(key, "track" if key.startswith("track.irregularity") else "") for key in keys}
    return {key: name for key, name in found.items() if name}


def line_content(line: str) -> dict[str, Any]:
    """What a line says, for a result's record: its keys, and the digest of a measured file.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    config = read_line(line)
    content = config.model_dump(mode="json")
    if config.file is None:
        return content
    measured = read_bytes(Path(config.file), "measured line", LARGEST)
    return content | {"sha256": hashlib.sha256(measured).hexdigest()}


def read_measured_line(config: LineConfig, speed: float | None = None) -> Line:
    """Conditions over distance of a measured line.

    Between rows everything is linear, the speed's square too; s = 0 is the first row. Columns, beside ``x_m``
    or ``x_km``: ``speed_kmh``; ``radius_m`` (positive in left curves, 0 where it is straight) or
    ``curvature_1_km``; ``cant_mm`` (positive where the right rail is higher); ``nominal_gauge_mm`` (the
    slowly changing gauge, about 1435, elsewhere what the gauge of `read_measured` is stated to depart from);
    ``friction``; ``rail`` (share of the second of the line's rails, 0 to
    1), all in other units as well; and the irregularities of `read_measured`, which needs even spacing where
    a line does not.

    Parameters
    ----------
    config : LineConfig
        Names the file, its rails, the length of its sections and the blend of its irregularities at its ends.
    speed : float, optional
        The episode's speed (m/s), for a file without speeds.

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        It is none that `read_table` takes; it begins in a curve; numbers beyond what is allowed.
    """
    assert config.file is not None
    table = read_table(config.file, (*CONDITIONS, *IRREGULARITIES), rows=2, ignore=config.ignore)
    if table.x[-1] - table.x[0] < _SHORTEST:
        raise DataError(
            f"{table.head}: column '{table.position.header}': the line is {table.x[-1] - table.x[0]:g} m "
            f"long; at least {_SHORTEST:g} m are needed (is the unit km?)"
        )
    if "rail" in table.columns and config.rails is None:
        raise DataError(f"{table.source}: column 'rail': the line's two rails are missing, which YAML names")
    if "rail" not in table.columns and config.rails is not None and config.rails[0] is None:
        raise DataError(f"{table.head}: rails: have no effect without a column 'rail', between which it goes")
    refuse_unused(table, config, remarks=True)
    try:
        _check_signs(table)
        line = checked(_line(table, config), speed)
    except ValueError as error:
        raise DataError(f"{table.source}: {error}") from None
    if line.curvature.value[0] or line.cant.value[0]:
        raise DataError(
            f"{table.where(0)}: begins with curvature or cant, but what lies before is straight: "
            "begin where the transition does, with 0"
        )
    _check_jumps(table, line)
    return line


def _check_signs(table: DistanceTable) -> None:
    """Refuse speeds backwards, and a cant that is in another unit or of the other sign."""
    speed, cant, curvature = table.columns.get("speed"), table.columns.get("cant"), _curvature(table)
    if speed is not None and (back := np.flatnonzero(speed.values <= 0.0)).size:
        row = int(back[0])
        raise DataError(
            f"{table.where(row)}: column '{speed.header}': found {speed.shown(row)}; expected more than 0"
        )
    if cant is None:
        return
    largest = float(np.max(np.abs(cant.values)))
    if 0.0 < largest < _LEAST_CANT:
        raise DataError(
            f"{table.head}: column '{cant.header}': no number is above {1e3 * largest:.2g} mm; no line "
            f"has so little cant (is the unit {cant.unit} right?)"
        )
    if curvature is not None:
        _check_sides(table, cant, curvature)


def _check_sides(table: DistanceTable, cant: DistanceColumn, curvature: Array) -> None:
    """Refuse a curve whose cant, on the whole, raises its inner rail."""
    width = np.gradient(table.x)
    for rows in _curves(table.x - table.x[0], curvature):
        helps = cant.values[rows] * np.sign(np.sum(curvature[rows]))
        weights = np.abs(curvature[rows]) * width[rows]
        if np.sum(helps * weights) < -_WRONG_CANT * np.sum(weights):
            row = rows.start + int(np.argmin(helps))
            raise DataError(
                f"{table.where(row)}: column '{cant.header}': found {cant.shown(row)} in a curve to the "
                f"{'left' if curvature[row] > 0.0 else 'right'}, and alike in most of it: the inner rail "
                "would be the higher one; cant is positive where the right rail is higher, a radius in "
                "curves to the left"
            )


def _curves(s: Array, curvature: Array) -> Iterator[slice]:
    """Rows of each stretch whose mean curvature over the shortest transition has one sign."""
    knots = joined(zip(s.tolist(), curvature.tolist(), strict=True))
    mean = _mean(knots, s, SHORTEST_TRANSITION)
    side = np.where(np.abs(mean) < _LEAST_CURVATURE, 0.0, np.sign(mean))
    bounds = [0, *(np.flatnonzero(np.diff(side)) + 1).tolist(), len(s)]
    yield from (slice(a, b) for a, b in pairwise(bounds) if side[a] != 0.0)


def _mean(knots: Knots, s: Array, length: float) -> Array:
    """Mean of a quantity over a length (m) about each distance s (m)."""
    return (knots.integral(s + 0.5 * length) - knots.integral(s - 0.5 * length)) / length


def _check_jumps(table: DistanceTable, line: Line) -> None:
    """Refuse a curvature or gauge that changes faster than over the shortest transition of a section.

    Within 10 m a linear transition of 20 m goes half its way, a half cosine 0.7 of it, a jump all of it.
    Judged are means over 5 m, in which a noise of rows every 0.25 m falls to less than a quarter, and only
    changes that such a noise does not make. The slope of the cant has a limit of its own.
    """
    grid = np.arange(-SHORTEST_TRANSITION, line.length + SHORTEST_TRANSITION, 1.0)
    for name, knots, least in (
        ("radius" if "radius" in table.columns else "curvature", line.curvature, _LEAST_JUMP),
        ("nominal_gauge" if "nominal_gauge" in table.columns else "gauge", line.gauge, _LEAST_GAUGE_JUMP),
    ):
        if knots is None or knots.constant:
            continue
        around = np.stack([_mean(knots, grid + shift, _MEAN) for shift in _PLACES])
        change, whole = np.abs(around[3] - around[1]), np.ptp(around, axis=0)
        sudden = np.where((change > least) & (change > _MOST_SHARE * whole), change, 0.0)
        if sudden.any():
            s = float(grid[int(np.argmax(sudden))])
            row = int(np.argmin(np.abs(table.x - table.x[0] - s)))
            raise DataError(
                f"{table.where(row)}: column '{table.columns[name].header}': most of a change, about "
                f"{table.place(row)}, lies within {0.5 * SHORTEST_TRANSITION:g} m; transitions are "
                f"{SHORTEST_TRANSITION:g} m long or more"
            )


def _line(table: DistanceTable, config: LineConfig) -> Line:
    s = table.x - table.x[0]
    length, none = float(s[-1]), Knots((0.0,), (0.0,))
    curvature = _knots(s, _curvature(table)) or none
    cant = _knots(s, table.values("cant")) or none
    speeds = table.values("speed")
    return Line(
        curvature=curvature,
        cant=cant,
        sections=tuple(_sections(length, config.section_length, curvature, cant)),
        speed_squared=_knots(s, None if speeds is None else speeds**2),
        gauge=_knots(s, stated_gauge(table, config)),
        friction=_knots(s, table.values("friction")),
        rail_blend=_knots(s, table.values("rail")),
        rails=resolve_rails(config),
        tracks=_tracks(table, length, config),
        blend=config.blend,
    )


def _curvature(table: DistanceTable) -> Array | None:
    radius, curvature = table.values("radius"), table.values("curvature")
    if radius is None:
        return curvature
    if curvature is not None:
        raise DataError(f"{table.source}: found radius_m and curvature_1_km; expected one of them")
    # Curves below 1 m are refused as those of 1 m are, without numbers that overflow.
    size = np.copysign(np.maximum(np.abs(radius), 1.0), radius)
    return np.where(radius == 0.0, 0.0, 1.0 / size)


def _knots(s: Array, values: Array | None) -> Knots | None:
    return None if values is None else joined(zip(s.tolist(), values.tolist(), strict=True))


def _tracks(table: DistanceTable, length: float, config: LineConfig) -> tuple[TrackPiece, ...]:
    if not table.variants:
        return ()
    offset = -float(table.x[0])
    irregularity = FileConfig(
        type="file", path=table.source, offset=offset, ramp=config.blend, **config.geometry
    )
    return (TrackPiece(0.0, length, irregularity, None),)


def _sections(length: float, each: float, curvature: Knots, cant: Knots) -> Iterator[Section]:
    """Parts of equal length; a rest of less than half of it belongs to the last one."""
    knots = np.union1d(curvature.s, cant.s)
    bounds = [0.0, *np.arange(each, length - 0.5 * each, each).tolist(), length]
    for start, end in pairwise(bounds):
        s = np.concatenate(([start], knots[(knots > start) & (knots < end)], [end]))
        bent = np.flatnonzero((curvature.at(s) != 0.0) | (cant.at(s) != 0.0))
        straight = [start, *s[1:].tolist(), None][bent[-1] + 1 if bent.size else 0]
        yield Section(f"{start:g} to {end:g} m", start, end, straight)
