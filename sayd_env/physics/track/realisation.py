"""From an irregularity's configuration to the spline table that the time step reads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sayd_env.config.conditions import Line, TrackPiece, smooth_step
from sayd_env.config.errors import ConfigError, DataError
from sayd_env.config.track import (
    CHANNELS,
    DefectConfig,
    FileConfig,
    IrregularityConfig,
    NoIrregularityConfig,
    SineConfig,
    SpectrumConfig,
    TrackConfig,
)
from sayd_env.config.units import Array
from sayd_env.measured.tracks import read_measured
from sayd_env.physics.track.spectra import random_irregularity
from sayd_env.physics.track.spline import interpolation_coefficients, spline_table

FADE_IN = 50.0
GRID_STEP = 0.25

# A cubic spline through eight points a wave departs from a sine by 0.12 % in value and 0.44 % in slope.
_POINTS_A_WAVE = 8
# Grid points beyond both ends of the run. The influence of the ends on the spline falls by 0.27 a point.
_MARGIN = 16
# More of them behind what a shortened table has to cover: the end's influence on it is then 1e-36.
_SETTLED = 64
# 128 MB of coefficients; 1000 km at the usual step.
_MAX_POINTS = 4_000_000
# A file's distances are printed to a millimetre at best.
_ENOUGH = 1e-3  # m


@dataclass(frozen=True)
class TrackRealisation:
    """Irregularities of one run, as a uniform cubic B-spline (continuous second derivative).

    Attributes
    ----------
    x0 : float
        Position of the first sample (m); it lies before the run's start at 0.
    step : float
        Distance of the samples (m).
    length : float
        Length of the run that the table covers (m).
    coefficients : ndarray, shape (n, 4)
        C-contiguous coefficients of alignment, vertical (m), cross-level (rad) and gauge (m) for
        `sayd_env.physics.track.spline.spline_value_slope`. n depends on length and step alone.
    """

    x0: float
    step: float
    length: float
    coefficients: Array

    def evaluate(self, x: ArrayLike) -> tuple[Array, Array]:
        """Values and slopes d/dx at positions x (m) of shape (m,): two arrays of shape (m, 4)."""
        positions = np.ascontiguousarray(np.atleast_1d(x), dtype=np.float64)
        value, slope = np.empty((2, len(positions), len(CHANNELS)))
        spline_table(self.coefficients, self.x0, self.step, positions, value, slope)
        return value, slope


def realise(
    config: IrregularityConfig,
    length: float,
    seed: int,
    fade_in: float = FADE_IN,
    grid_step: float = GRID_STEP,
    covered: float | None = None,
    judged: Sequence[tuple[float, float]] = (),
) -> TrackRealisation:
    """Irregularities from position 0 to `length`.

    Parameters
    ----------
    config : IrregularityConfig
        What kind of irregularity.
    length : float
        Length of the run (m).
    seed : int
        Seed of a random irregularity; the others do not depend on it. The same seed gives the same track for
        the same length, not the same beginning for another length.
    fade_in : float
        Length from position 0 over which the irregularity grows from nothing (m), with continuous curvature;
        the track before it is even. 0: none, and before the table its first values hold. A single defect is
        not faded, being smooth itself.
    grid_step : float
        Distance of the spline's samples (m).
    covered : float, optional
        Length (m) that the table needs to cover, for a run that ends before `length`: so far it is the same.
    judged : sequence of pairs of float
        Parts of the run (m) whose results count. A measured file has to cover them with its ramps left out:
        even track may lie in the run-in and behind what is judged, never in it.

    Raises
    ------
    ConfigError
        Length, seed, fade or step out of range; waves shorter than eight grid steps; a single defect behind
        all that is judged.
    DataError
        A measured file that is wrong or too short for the run, or for what is judged of it.
    """
    _check(config, length, seed, fade_in, grid_step)
    points = math.ceil(length / grid_step) + 1 + 2 * _MARGIN
    x = grid_step * np.arange(-_MARGIN, points - _MARGIN, dtype=np.float64)
    # What fades in is no less even in a file that begins with its ramp.
    parts = [(max(start, fade_in), end) for start, end in judged]
    samples = _samples(config, x, length, seed, parts)
    if covered is not None and covered < length:
        length = covered
        points = min(points, math.ceil(length / grid_step) + 1 + 2 * _MARGIN + _SETTLED)
        x, samples = x[:points], samples[:points]
    if fade_in > 0.0 and not isinstance(config, DefectConfig):
        samples *= smooth_step(x / fade_in)[:, None]
    return TrackRealisation(float(x[0]), grid_step, length, interpolation_coefficients(samples))


def realise_line(
    line: Line,
    base: TrackConfig,
    length: float,
    seed: int,
    origin: float,
    covered: float | None = None,
    judged: tuple[float, float] | None = None,
) -> TrackRealisation:
    """Irregularities and gauge of a line, from position 0 of a run to `length`.

    Parameters
    ----------
    line : Line
        Classes of track, gauge and single defects; what it leaves out is the base's.
    base : TrackConfig
        Track of the run; the contact tables are those of its gauge.
    length, seed, covered
        As of `realise`. Each class of track is the same realisation all along, so that one passes into
        another by what each has at that place. A measured file with ramps lies on the line, its offset
        counted from s = 0, and what it does not reach before and behind the line is the base's; one without,
        which has to cover the run, lies on the run.
    origin : float
        Position on the run of the line's s = 0 (m).
    judged : pair of float, optional
        Part of the run (m) whose results count. A file with ramps has to cover what of it lies in its pieces
        and on the line, but for the line's blend at their ends.

    Raises
    ------
    ConfigError, DataError
        As `realise`.
    """
    pieces = _surrounded(line.tracks) or (TrackPiece(0.0, math.inf, None, None),)
    parts: dict[IrregularityConfig, list[TrackPiece]] = {}
    for piece in pieces:
        parts.setdefault(_of_piece(piece, base.irregularity, origin), []).append(piece)
    tracks = {
        config: realise(
            config, length, seed, covered=covered, judged=_judged(pieces_of, line, origin, judged)
        )
        for config, pieces_of in parts.items()
    }
    first = next(iter(tracks.values()))
    knots: Array = first.x0 + first.step * np.arange(-1.0, len(first.coefficients) - 1.0)
    s = knots - origin
    # Weights on a spline's coefficients act on its values as long as they change slowly over its step.
    total = np.zeros_like(first.coefficients)
    for config, track in tracks.items():
        share = np.sum([_share(piece, pieces, line.blend, s) for piece in parts[config]], axis=0)
        total += share[:, None] * track.coefficients
    if line.gauge is not None:
        total[:, CHANNELS.index("gauge")] += line.gauge.at(s) - base.gauge
    for defect in line.defects:
        moved = defect.model_copy(update={"position": defect.position + origin})
        total += realise(moved, length, seed, covered=covered).coefficients
    return replace(first, coefficients=total)


def _surrounded(pieces: tuple[TrackPiece, ...]) -> tuple[TrackPiece, ...]:
    """Pieces with the run's own track before and behind them where a measured file, even there, has ended."""
    if not pieces:
        return ()
    begin = min(pieces[0].start, _reach(pieces[0])[0])
    end = max(pieces[-1].end, _reach(pieces[-1])[1])
    if begin > -math.inf:
        pieces = (TrackPiece(-math.inf, begin, None, None), replace(pieces[0], start=begin), *pieces[1:])
    if end < math.inf:
        pieces = (*pieces[:-1], replace(pieces[-1], end=end), TrackPiece(end, math.inf, None, None))
    return pieces


def _reach(piece: TrackPiece) -> tuple[float, float]:
    """Where (m) a measured file with ramps begins and ends on a line; all others are everywhere."""
    config = piece.irregularity
    if not isinstance(config, FileConfig) or config.ramp is None:
        return -math.inf, math.inf
    x = read_measured(config).x
    return float(x[0]) + config.offset, float(x[-1]) + config.offset


def _of_piece(piece: TrackPiece, base: IrregularityConfig, origin: float) -> IrregularityConfig:
    config = base if piece.irregularity is None else piece.irregularity
    if isinstance(piece.irregularity, FileConfig) and piece.irregularity.ramp is not None:
        config = config.model_copy(update={"offset": piece.irregularity.offset + origin})
    return config if piece.scale is None else config.model_copy(update={"scale": piece.scale})


def _judged(
    pieces: Sequence[TrackPiece], line: Line, origin: float, judged: tuple[float, float] | None
) -> list[tuple[float, float]]:
    """Parts of the run that are judged on pieces of a track, without the blends into others."""
    if judged is None:
        return []
    ends = [
        (max(judged[0], origin + piece.start + line.blend), origin + min(piece.end, line.length) - line.blend)
        for piece in pieces
    ]
    cut = [(start, min(end, judged[1])) for start, end in ends]
    return [(start, end) for start, end in cut if start < end]


def _share(piece: TrackPiece, pieces: Sequence[TrackPiece], blend: float, s: Array) -> Array:
    """Share of a piece of the track at distances s: 1 within it, passing into its neighbours."""
    begun = np.ones_like(s) if piece is pieces[0] else smooth_step((s - piece.start) / blend + 0.5)
    ended = np.zeros_like(s) if piece is pieces[-1] else smooth_step((s - piece.end) / blend + 0.5)
    return np.asarray(begun - ended)


def _samples(
    config: IrregularityConfig, x: Array, length: float, seed: int, judged: Sequence[tuple[float, float]]
) -> Array:
    match config:
        case SpectrumConfig():
            return random_irregularity(config, len(x), float(x[1] - x[0]), seed)
        case SineConfig():
            wave = np.sin(2.0 * np.pi * x / config.wavelength)
            return _single_channel(config, wave)
        case DefectConfig():
            _check_place(config, judged)
            t = np.clip((x - config.position) / config.length, 0.0, 1.0)
            return _single_channel(config, 0.5 * (1.0 - np.cos(2.0 * np.pi * t)))
        case FileConfig():
            return config.scale * _measured(config, x, length, judged)
        case NoIrregularityConfig():
            return np.zeros((len(x), len(CHANNELS)))


def _single_channel(config: SineConfig | DefectConfig, shape: Array) -> Array:
    samples = np.zeros((len(shape), len(CHANNELS)))
    samples[:, CHANNELS.index(config.channel)] = config.scale * config.amplitude * shape
    return samples


def _measured(config: FileConfig, x: Array, length: float, judged: Sequence[tuple[float, float]]) -> Array:
    measured = read_measured(config)
    first, last = measured.x[0] + config.offset, measured.x[-1] + config.offset
    values = measured.at(x - config.offset)
    if config.ramp is not None:
        _check_judged(config, first, last, judged)
        window = smooth_step((x - first) / config.ramp) * smooth_step((last - x) / config.ramp)
        return values * window[:, None]
    if first > 0.0 or last < length:
        raise DataError(
            f"{config.path}: covers {first:g} to {last:g} m of a run from 0 to {length:g} m; "
            f"shorten the run, change 'offset', or give 'ramp' (m) to run in and out on even track"
        )
    return values


def _check_place(config: DefectConfig, judged: Sequence[tuple[float, float]]) -> None:
    """Refuse a defect that the run does not reach: its results would be those of even track."""
    end = max((end for _, end in judged), default=math.inf)
    if config.position >= end:
        raise ConfigError(
            f"irregularity.position: the defect begins at {config.position:g} m of the run, which is judged "
            f"up to {end:g} m; move it forward, or make the run longer (assessment.length, episode_s)"
        )


def _check_judged(
    config: FileConfig, first: float, last: float, judged: Sequence[tuple[float, float]]
) -> None:
    """Refuse even track, or a file that has not grown to its full size, where results count."""
    assert config.ramp is not None
    for start, end in judged:
        if first + config.ramp > start + _ENOUGH or last - config.ramp < end - _ENOUGH:
            raise DataError(
                f"{config.path}: covers {first:g} to {last:g} m, of which the first and last {config.ramp:g} "
                f"m are its ramp, but the run is judged from {start:g} to {end:g} m; give a longer file, "
                "shorten what is judged (assessment.length, episode_s), or change 'offset' or 'ramp'"
            )


def _check(config: IrregularityConfig, length: float, seed: int, fade_in: float, grid_step: float) -> None:
    for name, value in (("length", length), ("grid step", grid_step)):
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigError(f"track {name}: found {value}; expected a length above 0 (m)")
    if length > _MAX_POINTS * grid_step:
        raise ConfigError(
            f"track length: found {length:g} m; a grid step of {grid_step:g} m allows "
            f"{_MAX_POINTS * grid_step:g} m at most"
        )
    if not (math.isfinite(fade_in) and fade_in >= 0.0):
        raise ConfigError(f"track fade-in: found {fade_in}; expected a length of 0 or more (m)")
    if seed < 0:
        raise ConfigError(f"track seed: found {seed}; expected a whole number of 0 or more")
    name, shortest = _shortest_wave(config)
    if shortest < _POINTS_A_WAVE * grid_step * (1.0 - 1e-9):
        raise ConfigError(
            f"irregularity.{name}: found {shortest:g} m; a grid step of {grid_step:g} m allows "
            f"{_POINTS_A_WAVE * grid_step:g} m and more"
        )


def _shortest_wave(config: IrregularityConfig) -> tuple[str, float]:
    match config:
        case SpectrumConfig():
            return "wavelength_min", config.wavelength_min
        case SineConfig():
            return "wavelength", config.wavelength
        case DefectConfig():
            return "length", config.length
        case FileConfig() if config.ramp is not None:
            return "ramp", config.ramp
        case _:
            return "type", math.inf
