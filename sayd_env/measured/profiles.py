"""Measured profile files: two columns of coordinates in mm, or SIMPACK's .prw and .prr point lists."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sayd_env.config import DataError
from sayd_env.config.loader import read_text

FEWEST_POINTS = 20
"""A profile with fewer points cannot carry slopes and curvatures."""

_COMMENT = ("!", "#", "%", "//")


def read_profile_file(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read the points of a measured profile.

    Parameters
    ----------
    path : Path
        Text with two columns y, z in mm, separated by blanks, commas, semicolons or tabs; an optional header
        line; comments begin with ``#``, ``!``, ``%`` or ``//``. In ``.prw`` and ``.prr`` files only the lines
        between ``point.begin`` and ``point.end`` are read, ``units.len.f`` and ``mirror``, ``shift`` and
        ``inversion`` of the header are obeyed.

    Returns
    -------
    y, z : ndarray, shape (n,)
        Coordinates (m), y strictly increasing.

    Raises
    ------
    DataError
        Empty, too short, not numeric, non-finite, duplicated or unsorted points; the line is named.
    """
    lines = read_text(path, "profile file").splitlines()
    header, body = _simpack_parts(lines) if _is_simpack(lines) else ({}, list(enumerate(lines, start=1)))
    points, numbers = _parse(path, body, allow_header=not header)
    _check(path, points, numbers, int(header.get("inversion", 0)))
    return _to_metres(points, header)


def _is_simpack(lines: list[str]) -> bool:
    return any(line.strip().startswith("point.begin") for line in lines)


def _simpack_parts(lines: list[str]) -> tuple[dict[str, float], list[tuple[int, str]]]:
    """Numeric header entries and numbered point lines of a SIMPACK profile."""
    header: dict[str, float] = {"units.len.f": 1000.0}
    body: list[tuple[int, str]] = []
    inside = False
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if text.startswith("point."):
            inside = text.startswith("point.begin")
        elif inside:
            body.append((number, line))
        elif match := re.match(r"([a-z][\w.]*)\s*=\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(?:!|$)", text):
            header[match[1]] = float(match[2])
    return header, body


def _parse(
    path: Path, body: list[tuple[int, str]], allow_header: bool
) -> tuple[NDArray[np.float64], list[int]]:
    """Points (n, 2) and the line number of each."""
    rows: list[tuple[float, float]] = []
    numbers: list[int] = []
    for number, line in body:
        text = line.strip()
        if not text or text.startswith(_COMMENT):
            continue
        fields = re.split(r"[,;\s]+", text.rstrip(",;"))
        try:
            row = (float(fields[0]), float(fields[1]))
        except (ValueError, IndexError):
            if allow_header and not rows and len(fields) > 1 and re.match(r"[A-Za-z\"]", text):
                allow_header = False
                continue
            raise DataError(
                f"{path}: line {number}: found {text[:40]!r}, expected two numbers y z (mm)"
            ) from None
        rows.append(row)
        numbers.append(number)
    return np.array(rows, dtype=float).reshape(-1, 2), numbers


def _check(path: Path, points: NDArray[np.float64], numbers: list[int], inverted: int) -> None:
    if len(points) < FEWEST_POINTS:
        found = f"{len(points)} points" if len(points) else "no points"
        raise DataError(f"{path}: found {found}, at least {FEWEST_POINTS} are needed")
    for index in np.flatnonzero(~np.isfinite(points).all(axis=1))[:1]:
        raise DataError(f"{path}: line {numbers[index]}: found a value that is not finite")
    steps = np.diff(points[:, 0])
    for index in np.flatnonzero(steps == 0.0)[:1]:
        raise DataError(f"{path}: line {numbers[index + 1]}: y = {points[index, 0]:g} mm appears twice")
    descending = np.sum(steps < 0.0) > len(steps) / 2
    wrong = steps > 0.0 if descending else steps < 0.0
    for index in np.flatnonzero(wrong)[:1]:
        raise DataError(
            f"{path}: line {numbers[index + 1]}: y goes from {points[index, 0]:g} to "
            f"{points[index + 1, 0]:g} mm, against the direction of the other points"
        )
    if descending and not inverted:
        raise DataError(f"{path}: y falls from line to line; sort the points by increasing y")


def _to_metres(
    points: NDArray[np.float64], header: dict[str, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, z = points.T + np.array([[header.get("shift.y", 0.0)], [header.get("shift.z", 0.0)]])
    y = -y if header.get("mirror.y", 0.0) == 1.0 else y
    z = -z if header.get("mirror.z", 0.0) == 1.0 else z
    order = np.argsort(y)
    scale = 1.0 / header.get("units.len.f", 1000.0)
    return y[order] * scale, z[order] * scale
