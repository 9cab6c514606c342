"""Tables over distance, as track geometry and lines are: each column a quantity with its unit."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sayd_env.config.errors import DataError
from sayd_env.config.loader import nearest
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import Array
from sayd_env.measured.table import TextTable, labelled, physical_numbers, read_text_table
from sayd_env.measured.units import unit_of


class _Kind(NamedTuple):
    """What a column may be given in."""

    quantity: str
    units: tuple[str, ...]
    """Of its example in messages; the first is that of the paper trail: ``gauge_mm``."""


_SMALL = _Kind("length", ("mm",))
_SHARE = _Kind("ratio", ("",))
CONDITIONS: Mapping[str, _Kind] = {
    "speed": _Kind("speed", ("km/h",)),
    "radius": _Kind("length", ("m",)),
    "curvature": _Kind("curvature", ("1/km",)),
    "cant": _SMALL,
    "nominal_gauge": _SMALL,
    "friction": _SHARE,
    "rail": _SHARE,
}
"""What lies along a line beside irregularities."""
IRREGULARITIES: Mapping[str, _Kind] = dict.fromkeys(CHANNELS, _SMALL)
"""A track's departures from its nominal geometry."""
_POSITION = "x"
_KINDS = {_POSITION: _Kind("length", ("m", "km")), **IRREGULARITIES, **CONDITIONS}
_OTHER_NAMES = {
    **dict.fromkeys(("position", "distance", "chainage", "station", "kilometre", "kilometer"), _POSITION),
    "longitudinal_level": "vertical",  # EN 13848-1
    "crosslevel": "cross_level",
    "track_gauge": "gauge",
    "superelevation": "cant",
    "richtung": "alignment",
    **dict.fromkeys(("längshöhe", "laengshoehe"), "vertical"),
    "spurweite": "gauge",
    **dict.fromkeys(("überhöhung", "ueberhoehung"), "cant"),
}
_CHORD = re.compile(
    r"(?:(?P<length>\d+(?:_\d+)?)_?(?P<unit>m|ft)_)?(?:mid_?)?(?:chord|versine|mco)s?"
    r"(?:_(?P<behind>\d+(?:_\d+)?)_?(?P<behind_unit>m|ft))?"
)
# In a name that says no more, or says it in another order.
_SOME_CHORD = re.compile(r"versine|chord|(?<![a-z])mco|mid_?ordinate|pfeilh")
_SOME_SPACE_CURVE = re.compile(r"space_?curve")
_STRAIGHT = re.compile(r"[-+]?(?:inf(?:inity)?|∞)", re.IGNORECASE)
_DOMAIN = re.compile(r"d(?P<domain>[0-3])")
_SPACE_CURVE = ("space_curve", "spacecurve", "absolute", "position")
_RAILS = ("left", "right", "left_rail", "right_rail", "l", "r")

# Measuring cars print 4 rows a metre, trolleys 1 a centimetre: closer rows have kilometres in a column of
# metres. A line is not longer than the irregularities of one run can be, which are a table in memory.
_CLOSEST, _LONGEST = 0.01, 1e6  # m


@dataclass(frozen=True)
class DistanceColumn:
    """One quantity over distance."""

    header: str
    """As it stands in the file."""
    values: Array
    """(n,), SI."""
    unit: str
    factor: float
    """From its unit to SI."""

    def shown(self, row: int) -> str:
        """A number as the file has it, with its unit."""
        return f"{self.values[row] / self.factor:g} {self.unit}".rstrip(" -")


class Variant(NamedTuple):
    """How a column holds a channel of the track."""

    channel: str
    way: str
    """``true``, ``chord``, ``domain`` or ``space curve``."""
    chord: float = 0.0
    """m."""
    domain: str = ""
    """``D1`` to ``D3`` of EN 13848-1."""


@dataclass(frozen=True)
class DistanceTable:
    """Columns of a file in SI units, and the lines where its rows stand.

    Attributes
    ----------
    text : TextTable
        The file.
    x : ndarray, shape (n,)
        Ascending distances (m).
    position : DistanceColumn
        The same as it stands in the file.
    columns : mapping
        The other columns by name.
    variants : mapping
        What the columns of irregularities hold, by their names.
    """

    text: TextTable
    position: DistanceColumn
    columns: Mapping[str, DistanceColumn]
    variants: Mapping[str, Variant]

    @property
    def source(self) -> str:
        """The file."""
        return self.text.source

    @property
    def x(self) -> Array:
        """Ascending distances (m), shape (n,)."""
        return self.position.values

    @property
    def head(self) -> str:
        """Line of the header, as messages name it."""
        return f"{self.source}: line {self.text.head.line}"

    def where(self, row: int) -> str:
        """Line of a row in the file, as messages name it."""
        return self.text.where(row)

    def place(self, row: int) -> str:
        """Distance of a row, as it stands in the file."""
        return f"{self.position.header} {self.x[row] / self.position.factor:g}"

    def values(self, name: str) -> Array | None:
        """Values of a column, shape (n,), None where the file lacks it."""
        column = self.columns.get(name)
        return None if column is None else column.values


def read_table(
    path: str | Path, needed: Collection[str], rows: int, ignore: Collection[str] = ()
) -> DistanceTable:
    """Read a file over distance.

    Parameters
    ----------
    path : str or Path
        The file, see `read_text_table`. Units stand in the header (``gauge_mm``, ``gauge [mm]``) or below it.
    needed : collection of str
        Quantities of which it has one at least, in whatever way.
    rows : int
        Fewest rows of numbers.
    ignore : collection of str
        Columns, as the header names them, that are not read.

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        No, unknown, missing or repeated columns; units that are missing or none of a column's; cells that are
        not finite numbers; too few rows; distances that do not ascend, or are in another unit than stated.
    """
    text = read_text_table(path, "table over distance")
    where = f"{text.source}: line {text.head.line}"
    if not text.names:
        raise DataError(f"{text.no_header()}; expected x_m or x_km and any of {_examples(needed)}")
    for name in ignore:
        if name not in text.names:
            raise DataError(f"{where}: ignore: no column '{name}'{nearest(name, text.names)}")
    places = [k for k, name in enumerate(text.names) if name not in ignore]
    found = {k: _identified(text, k, where) for k in places}
    _check_found(text, found, needed, where)
    if len(text) < rows:
        raise DataError(f"{text.source}: found {len(text)} rows of numbers; at least {rows} are needed")
    factors = {k: _factor(text, k, name, where) for k, (name, _) in found.items()}
    _check_radius(text, {name: k for k, (name, _) in found.items()})
    numbers = physical_numbers(text, places)
    columns = {
        found[k][0]: DistanceColumn(text.names[k], factors[k][1] * numbers[:, j], *factors[k])
        for j, k in enumerate(places)
    }
    variants = {name: variant for name, variant in found.values() if variant is not None}
    table = DistanceTable(text, columns.pop(_POSITION), columns, variants)
    _check_positions(table)
    return table


def _examples(names: Collection[str]) -> str:
    return ", ".join(
        f"{name}_{unit}".rstrip("_").replace("/", "_").replace("km_h", "kmh")
        for name in names
        for unit in _KINDS[name].units
    )


def _identified(text: TextTable, column: int, where: str) -> tuple[str, Variant | None]:
    """What a column is."""
    label, unit = labelled(text, column)
    if label in ("km", "m") and (not unit or _is_length(unit)):
        label = _POSITION
    name = _OTHER_NAMES.get(label, label)
    if name in IRREGULARITIES:
        return name, Variant(name, "true")
    if name in _KINDS:
        return name, None
    for known in sorted((*CHANNELS, *_OTHER_NAMES), key=len, reverse=True):
        if label.startswith(f"{known}_") and (channel := _OTHER_NAMES.get(known, known)) in CHANNELS:
            variant = _variant(channel, label.removeprefix(f"{known}_"), f"{where}: {text.titled(column)}")
            if variant is not None:
                return label, variant
    _refuse_part(label, f"{where}: {text.titled(column)}")
    allowed = _examples(_KINDS)
    raise DataError(
        f"{where}: unknown {text.titled(column)}{nearest(text.names[column], allowed.split(', '))}; "
        f"allowed: {allowed}; or name it under ignore"
    )


def _is_length(unit: str) -> bool:
    known = unit_of(unit)
    return known is not None and known.quantity == "length"


def _refuse_part(label: str, where: str) -> None:
    """Refuse what holds a part of the track under a name that does not say of which channel."""
    if _SOME_CHORD.search(label):
        raise DataError(
            f"{where} holds offsets from a chord; name it 'alignment_10m_chord' or 'vertical_10m_chord', "
            "with the length of the whole chord, or name it under ignore"
        )
    if _SOME_SPACE_CURVE.search(label):
        raise DataError(
            f"{where} holds a space curve; name it 'alignment_space_curve' or 'vertical_space_curve', or "
            "name it under ignore"
        )


def _check_radius(text: TextTable, places: Mapping[str, int]) -> None:
    """Say what a straight has in place of an infinite radius."""
    if "radius" not in places:
        return
    column = places["radius"]
    for row, cell in enumerate(text.cells([column])[:, 0]):
        if _STRAIGHT.fullmatch(cell):
            raise DataError(
                f"{text.where(row, column)}: found '{cell}'; where it is straight the radius is 0, or give "
                "curvature_1_km"
            )


def _variant(channel: str, way: str, where: str) -> Variant | None:
    if found := _CHORD.fullmatch(way):
        length, unit = found["length"] or found["behind"], found["unit"] or found["behind_unit"]
        if length is None:
            raise DataError(
                f"{where} holds offsets from a chord of unknown length; name it '{channel}_10m_chord', with "
                "the length of the whole chord, in whose middle they are measured"
            )
        known = unit_of(unit)
        assert known is not None
        chord = known.factor * float(length.replace("_", "."))
        if chord <= 0.0:
            raise DataError(f"{where}: found a chord of {length} {unit}; expected a length above 0")
        return Variant(channel, "chord", chord)
    if found := _DOMAIN.fullmatch(way):
        return Variant(channel, "domain", domain=f"D{found['domain']}")
    if way in _SPACE_CURVE:
        return Variant(channel, "space curve")
    if way in _RAILS:
        raise DataError(
            f"{where} is of one rail; give the mean of both as '{channel}', which is that of the centre line"
        )
    return None


def _check_found(
    text: TextTable, found: Mapping[int, tuple[str, Variant | None]], needed: Collection[str], where: str
) -> None:
    first: dict[str, int] = {}
    for k, (name, _) in found.items():
        if name in first:
            one, other = text.names[first[name]], text.names[k]
            problem = f"column '{one}' appears twice" if one == other else f"found {one} and {other}"
            raise DataError(f"{where}: {problem}; expected one of them")
        first[name] = k
    if _POSITION not in first:
        raise DataError(f"{where}: column 'x_m' or 'x_km' is missing; found {', '.join(text.names)}")
    if not any(name in needed or (variant and variant.channel in needed) for name, variant in found.values()):
        raise DataError(
            f"{where}: nothing to read beside '{text.names[first[_POSITION]]}'; expected any of "
            f"{_examples(needed)}"
        )


def _factor(text: TextTable, column: int, name: str, where: str) -> tuple[str, float]:
    """Unit of a column and its factor to SI."""
    label, unit = labelled(text, column)
    kind = _KINDS.get(name, _SMALL)
    if not unit and kind.quantity == "ratio":
        return "", 1.0
    if not unit and label in ("km", "m"):
        unit = label
    known = unit_of(unit) if unit else None
    if known is None or known.quantity != kind.quantity:
        found = f"unknown unit '{unit}'" if unit else "its unit is missing"
        example = " or ".join(f"'{name} [{each}]'" for each in kind.units if each)
        raise DataError(f"{where}: {text.titled(column)}: {found}; expected {example or 'a share, - or %'}")
    return known.name, known.factor


def _check_positions(table: DistanceTable) -> None:
    spacing = np.diff(table.x)
    wrong = np.flatnonzero(spacing <= 0.0)
    if wrong.size:
        i = int(wrong[0]) + 1
        problem = "appears twice" if spacing[i - 1] == 0.0 else f"comes after {table.place(i - 1)}"
        turned = np.all(spacing < 0.0)
        hint = " (turn the rows round, and with them the signs of what goes left or right)" if turned else ""
        raise DataError(f"{table.where(i)}: {table.place(i)} {problem}; positions must ascend{hint}")
    usual, length = float(np.median(spacing)), float(table.x[-1] - table.x[0])
    column = f"{table.head}: column '{table.position.header}'"
    if usual < _CLOSEST * (1.0 - 1e-6):  # centimetres as they are written
        raise DataError(
            f"{column}: rows are {usual:g} m apart, at least {_CLOSEST:g} m makes sense (is the unit km?)"
        )
    if length > _LONGEST:
        raise DataError(
            f"{column}: the file is {length / 1e3:g} km long, at most {_LONGEST / 1e3:g} km are read (is the "
            "unit m?)"
        )
