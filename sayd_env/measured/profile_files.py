"""Points of profile files as they stand there: SIMPACK, MiniProf, and tables of two columns.

SIMPACK (.prw wheels, .prr rails) numbers the steps that its keys ask for, in the order in which they are
taken: 1 ``point.dist.min``, 2 ``shift``, 3 ``rotate``, 4 ``bound``, 5 ``mirror``, 6 ``inversion``, 7
``units``. MiniProf (.whl wheels, .ban and .rail rails; Greenwood Engineering) has lines ``key=value`` up to
a blank line, then points in mm whose columns ``ColumnDef`` names, to which ``XOffset`` and ``YOffset`` are to
be added. Sources: the comments in SIMPACK's own files, and the reader of both formats in CONTACT
(m_profile.f90 of the open-source version, Vtech CMCC).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from sayd_env.config.errors import DataError
from sayd_env.config.files import MIB, read_bytes
from sayd_env.config.loader import nearest
from sayd_env.config.units import Array, Flags
from sayd_env.measured.dialect import decode, is_number, lines_of
from sayd_env.measured.table import TextTable, refuse_hollow, table_of
from sayd_env.measured.units import name_and_unit, unit_of

Kind = Literal["wheel", "rail"]

KINDS: Mapping[str, Kind] = {
    ".prw": "wheel",
    ".whl": "wheel",
    ".prr": "rail",
    ".ban": "rail",
    ".rail": "rail",
}
"""What a file is by the end of its name."""

UNITS: Mapping[str, float] = {
    unit.name: unit.factor for unit in map(unit_of, ("mm", "cm", "m", "in", "um")) if unit is not None
}
"""Units of length in which profiles come (m)."""

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?", re.ASCII)
_FARTHEST = 1e6  # units of length of the file; a metre in micrometres
_STEEPEST_TURN = 0.5  # rad; a rail is inclined by 1:20, a scan turned by more is not a profile


@dataclass(frozen=True)
class RawProfile:
    """What a file holds.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        Lateral position and height in the file's unit.
    lines : list of int
        Line of each point.
    units : tuple of float, optional
        Metres in the unit of each column, if the file says it.
    said : str
        What says it, for messages.
    kind : {"wheel", "rail"}, optional
        What the file says it is.
    notes : tuple of str
        What was done to the points, for the user.
    """

    points: Array
    lines: list[int]
    units: tuple[float, float] | None = None
    said: str = ""
    kind: Kind | None = None
    notes: tuple[str, ...] = ()


def number(text: str, where: str, what: str = "a number") -> float:
    """Read a number as these programs write it; Fortran's exponent D counts.

    Raises
    ------
    DataError
        Anything else, also what is not finite.
    """
    if not _NUMBER.fullmatch(text):
        raise DataError(f"{where}: found {_short(text)}; expected {what}")
    value = float(text.replace("d", "e").replace("D", "e"))
    if not math.isfinite(value):
        raise DataError(f"{where}: found {_short(text)}; expected {what} that is finite")
    return value


def _short(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


def is_simpack(lines: Iterable[str]) -> bool:
    """Whether lines are a SIMPACK profile: one begins a section."""
    return any(re.match(r"\s*(header|spline|point)\.begin\b", line) for line in lines)


def is_miniprof(lines: Iterable[str]) -> bool:
    """Whether lines are a MiniProf profile: one names the program or the columns."""
    return any(re.match(r"\s*(ProgramName\s*=\s*MiniProf|ColumnDef\s*=)", line, re.I) for line in lines)


# --- SIMPACK


def _flag(text: str, where: str) -> float:
    if (value := number(text, where, "0 or 1")) not in (0.0, 1.0):
        raise DataError(f"{where}: found {text}; expected 0 or 1")
    return value


def _factor(text: str, where: str) -> float:
    if (value := number(text, where, "a factor above 0")) <= 0.0:
        raise DataError(f"{where}: found {text}; expected a factor above 0")
    return value


def _only(expected: float, why: str, text: str, where: str) -> float:
    if (value := number(text, where)) != expected:
        raise DataError(f"{where}: found {text}; {why}")
    return value


def _shift(text: str, where: str) -> float:
    if abs(value := number(text, where)) > _FARTHEST:
        raise DataError(f"{where}: found {text}; expected {_FARTHEST:g} at most")
    return value


def _distance(text: str, where: str) -> float:
    if (value := number(text, where)) < 0.0:
        raise DataError(f"{where}: found {text}; expected 0 or more")
    return value


def _plain(text: str, where: str) -> str:
    del where
    return text.strip("'\"")


_Reader = Callable[[str, str], float | str]
_SIMPACK: Mapping[str, Mapping[str, _Reader]] = {
    "header": {
        "version": partial(_only, 1.0, "only version 1 of the format is known"),
        "type": _flag,
        # Where SIMPACK takes a wheel's wear numbers: no part of the curve.
        "meas.pos.e": number,
        "meas.pos.qr": number,
    },
    "spline": {
        "approx.smooth": partial(
            _only, 0.0, "SIMPACK's smoothing is not published; export smoothed points, or use shape.smoothing"
        ),
        # From where the points once came: they stand in this file.
        "file": _plain,
        "file.mtime": number,
        "comment": _plain,
        "type": number,
        "point.dist.min": _distance,
        "shift.y": _shift,
        "shift.z": _shift,
        "rotate": number,
        "bound.y.min": number,
        "bound.y.max": number,
        "bound.z.min": number,
        "bound.z.max": number,
        "mirror.y": _flag,
        "mirror.z": _flag,
        "inversion": _flag,
        "units.len": _plain,
        "units.ang": _plain,
        "units.len.f": _factor,
        "units.ang.f": _factor,
    },
}
"""Keys of each section and what reads their values."""


def read_simpack(lines: list[str], source: str) -> RawProfile:
    """Read a SIMPACK profile: every key is applied or refused.

    Raises
    ------
    DataError
        Sections that do not nest, a key that is unknown or cannot be applied, points that are none.
    """
    sections, points, numbers = _simpack_parts(lines, source)
    key = partial(_value, sections["spline"])
    notes = []
    y, z = points.T
    keep = _apart(y, z, key("point.dist.min", 0.0))
    if not keep.all():
        notes.append(f"{np.sum(~keep)} points left out that are nearer than point.dist.min to one before")
    y, z = y[keep] + key("shift.y", 0.0), z[keep] + key("shift.z", 0.0)
    turn = key("rotate", 0.0) / (_per_unit(sections["spline"], "ang", _ANGLES, source) or 1.0)
    if abs(turn) > _STEEPEST_TURN:
        raise DataError(f"{source}: rotate: found {turn:g} rad; expected {_STEEPEST_TURN:g} rad at most")
    # About x from y to z, as the axes of the file have it.
    y, z = y * math.cos(turn) - z * math.sin(turn), y * math.sin(turn) + z * math.cos(turn)
    numbers = list(np.array(numbers)[keep])
    low, high = key("bound.y.min", 1.0), key("bound.y.max", 0.0)
    if low < high:
        inside = (y >= low) & (y <= high)
        notes.append(f"{np.sum(~inside)} points left out beyond bound.y, {low:g} to {high:g}")
        y, z, numbers = y[inside], z[inside], list(np.array(numbers)[inside])
    low, high = key("bound.z.min", 1.0), key("bound.z.max", 0.0)
    if low < high:
        notes.append(f"{np.sum((z < low) | (z > high))} heights set to bound.z, {low:g} to {high:g}")
        z = np.clip(z, low, high)
    y = -y if key("mirror.y", 0.0) else y
    z = -z if key("mirror.z", 0.0) else z
    # The order of the points, which `inversion` turns round, makes no difference to the curve.
    kind = sections["header"].get("type")
    per_metre = _per_unit(sections["spline"], "len", _LENGTHS, source)
    return RawProfile(
        np.column_stack([y, z]),
        [int(line) for line in numbers],
        units=None if per_metre is None else (1.0 / per_metre, 1.0 / per_metre),
        said="units.len.f" if "units.len.f" in sections["spline"] else "units.len",
        kind=None if kind is None else ("rail", "wheel")[int(kind)],
        notes=tuple(notes),
    )


def _value(section: Mapping[str, float | str], name: str, default: float) -> float:
    return float(section.get(name, default))


def _simpack_parts(
    lines: list[str], source: str
) -> tuple[dict[str, dict[str, float | str]], Array, list[int]]:
    """Values by section and key, points and their lines."""
    sections: dict[str, dict[str, float | str]] = {"header": {}, "spline": {}}
    rows: list[tuple[float, float]] = []
    numbers: list[int] = []
    inside: list[str] = []
    for count, line in enumerate(lines, start=1):
        where = f"{source}: line {count}"
        text = _without_comment(line).strip()
        if not text:
            continue
        if mark := re.fullmatch(r"([A-Za-z]+)\.(begin|end)", text):
            _nest(inside, mark[1], mark[2], where)
        elif inside and inside[-1] == "point":
            rows.append(_simpack_point(text, where))
            numbers.append(count)
        elif match := re.fullmatch(r"([A-Za-z][\w.]*)\s*=\s*(.*)", text):
            name = match[1]
            section = inside[-1] if inside else ""
            known = _SIMPACK.get(section, {})
            if name not in known:
                raise DataError(
                    f"{where}: unknown key {_short(name)}{nearest(name, known)} of "
                    f"{f'section {section!r}' if section else 'no section'}; it might change the curve"
                )
            if name in sections[section]:
                raise DataError(f"{where}: key '{name}' appears twice")
            sections[section][name] = known[name](match[2].strip(), f"{where}: {name}")
        else:
            raise DataError(f"{where}: found {_short(text)}; expected key = value")
    if inside:
        raise DataError(f"{source}: ends within section '{inside[-1]}': {inside[-1]}.end is missing")
    return sections, np.array(rows, dtype=float).reshape(-1, 2), numbers


def _without_comment(line: str) -> str:
    """A line without what follows a ``!`` outside quotes."""
    return re.sub(r"^((?:[^!'\"]|'[^']*'|\"[^\"]*\")*)!.*$", r"\1", line)


_WITHIN = {"header": [], "spline": [], "point": ["spline"]}


def _nest(inside: list[str], name: str, what: str, where: str) -> None:
    """Enter or leave a section."""
    if name not in _WITHIN:
        raise DataError(f"{where}: unknown section {_short(name)}; expected {', '.join(_WITHIN)}")
    if inside != (_WITHIN[name] if what == "begin" else [*_WITHIN[name], name]):
        raise DataError(f"{where}: {name}.{what} is out of place")
    if what == "begin":
        inside.append(name)
    else:
        inside.pop()


def _simpack_point(text: str, where: str) -> tuple[float, float]:
    values = [number(field, where, "y and z") for field in text.split()]
    if len(values) not in (2, 3):
        raise DataError(f"{where}: found {_short(text)}; expected y, z and, perhaps, a weight")
    if len(values) == 3 and values[2] != 1.0:
        raise DataError(
            f"{where}: found weight {values[2]:g}; weighted approximation is not supported, only 1"
        )
    return values[0], values[1]


def _apart(y: Array, z: Array, distance: float) -> Flags:
    """Points that are so far from the last one that is kept."""
    keep = np.ones(len(y), dtype=bool)
    last = 0
    for i in range(1, len(y) if distance > 0.0 else 0):
        if math.hypot(y[i] - y[last], z[i] - z[last]) < distance:
            keep[i] = False
        else:
            last = i
    return keep


_ANGLES = {"rad": 1.0, "deg": math.degrees(1.0)}
_LENGTHS = {name: 1.0 / metres for name, metres in UNITS.items()}
"""Units by name, and how many of them are one of SI: SIMPACK's factors."""


def _per_unit(
    section: Mapping[str, float | str], which: str, known: Mapping[str, float], source: str
) -> float | None:
    """How many of the file's units are one of SI, by name and factor, which must agree; None: not said."""
    name, factor = section.get(f"units.{which}"), section.get(f"units.{which}.f")
    if name is None:
        return None if factor is None else float(factor)
    if name not in known:
        raise DataError(f"{source}: units.{which}: found {_short(str(name))}; expected {', '.join(known)}")
    if factor is not None and not math.isclose(float(factor), known[str(name)], rel_tol=1e-3):
        raise DataError(
            f"{source}: units.{which} = {name} has the factor {known[str(name)]:g}, but units.{which}.f = "
            f"{factor:g}"
        )
    return known[str(name)]


# --- MiniProf

_RECORDS = frozenset(
    re.findall(
        r"\w+",
        """
    alarmfailurecount alarmwarningcount areagain arealoss arearef axleno baseoffset basetilt bogie carno
    chainage chars comment crownr crownradius curve date diameterflange diametertaperline direction
    emplnum elevation fieldid filename flag flangeanglemax flangeanglemaxpos flangewidth flat gauge
    gaugerodlength gaugesensordistance gaugesensorsamples gaugesensorstddev grade graderatio hollowing
    hollowingpos id kp line mileage mpcaldate mpcaltime mpserno mptypeno originalheader position
    profilealignment profileshaping programdate programname programver qr rail railaligntype railangle
    railgaugepoint railrodlength rcf referenceprofile rodlength sd sectionno sh side stock
    superelevation superelevationheight temperature tilt time track tracksection transformstate
    transformation username wheeladjustpoint wheeldiametertaperline wheelid xypointvalues
    """,
    )
)
"""Keys, in small letters, that say where, when and with what was measured, or what the program made of it."""
_RECORD_FAMILIES = re.compile(
    r"(align|battery\.|instrument\.|location\.|windows\.|mpd|refpoint|uof|w\d).*|.*_alarm(status|level)"
)
_COMMENTS = ("!", '"', "%", "#")


def read_miniprof(lines: list[str], source: str) -> RawProfile:
    """Read a MiniProf profile.

    Raises
    ------
    DataError
        A header without an end, columns that are not named or do not fit, points that are none.
    """
    header, body = _miniprof_parts(lines, source)
    columns, any_more = _column_def(header.get("columndef", ("X,Y,*", "")))
    points, numbers, comma = [], [], _decimal_comma(text for _, text in body)
    usual = len(body[0][1].split()) if body else 0
    for count, text in body:
        where = f"{source}: line {count}"
        fields = (text.replace(",", ".") if comma else text).split()
        if len(fields) != usual:
            raise DataError(f"{where}: found {len(fields)} values; the first point has {usual}")
        if len(fields) < len(columns) or (len(fields) > len(columns) and not any_more):
            raise DataError(f"{where}: found {len(fields)} values; ColumnDef has {','.join(columns)}")
        row = [number(field, where) for field in fields[: len(columns)]]
        points.append((row[columns.index("X")], row[columns.index("Y")]))
        numbers.append(count)
    offsets = [
        number(text.replace(",", ".") if comma else text, where) if text else 0.0
        for text, where in (header.get(name, ("", "")) for name in ("xoffset", "yoffset"))
    ]
    if "xypoints" in header:
        text, where = header["xypoints"]
        if number(text, where) != len(points):
            raise DataError(f"{where}: found {text}, but the file has {len(points)} points")
    unused = [
        name for name in header if name not in _RECORDS | _USED and not _RECORD_FAMILIES.fullmatch(name)
    ]
    notes = [f"keys of the header that are not used: {', '.join(unused[:8])}"] if unused else []
    if comma:
        notes.append("decimal commas")
    return RawProfile(
        np.array(points, dtype=float).reshape(-1, 2) + offsets,
        numbers,
        units=(UNITS["mm"], UNITS["mm"]),
        said="MiniProf",
        notes=tuple(notes),
    )


_USED = frozenset(("columndef", "xoffset", "yoffset", "xypoints"))
Header = dict[str, tuple[str, str]]


def _miniprof_parts(lines: list[str], source: str) -> tuple[Header, list[tuple[int, str]]]:
    """Texts of the header by key in small letters with their places, and numbered lines of points."""
    header: Header = {}
    body: list[tuple[int, str]] = []
    over = False
    for count, line in enumerate(lines, start=1):
        text, where = line.strip(), f"{source}: line {count}"
        if not text:
            over = over or bool(header)
        elif text.startswith(_COMMENTS):
            continue
        elif not over and (match := re.fullmatch(r"([A-Za-z][\w .]*?)\s*=\s*(.*)", text)):
            name = re.sub(r"\s", "", match[1].lower())
            if name in header:
                raise DataError(f"{where}: key {_short(match[1])} appears twice")
            header[name] = match[2], f"{where}: {match[1]}"
        else:
            # Programs exist that leave out the blank line.
            over = True
            body.append((count, text))
    return header, body


def _column_def(given: tuple[str, str]) -> tuple[list[str], bool]:
    """Letters of the columns, and whether further ones may follow."""
    text, where = given
    columns = [name.strip().upper() for name in text.split(",")]
    any_more = columns[-1] == "*"
    columns = columns[:-1] if any_more else columns
    unknown = [name for name in columns if name not in ("X", "Y", "A", "C", "N", "K")]
    if unknown or columns.count("X") != 1 or columns.count("Y") != 1:
        raise DataError(f"{where}: found {_short(text)}; expected letters X, Y, A, C, N, K, X and Y once")
    return columns, any_more


def _decimal_comma(texts: Iterable[str]) -> bool:
    """Whether columns that blanks separate have decimal commas."""
    texts = list(texts)
    number_with_comma = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
    fields = [field for text in texts for field in text.split()]
    return (
        bool(fields)
        and not any("." in field for field in fields)
        and any(number_with_comma.fullmatch(field) for field in fields)
    )


# --- Columns

LARGEST = 16 * MIB
"""Most that is read of a profile; scans have some thousand points."""

_LATERAL = frozenset({"y", "lateral", "lateral position", "x"})
_VERTICAL = frozenset({"z", "height", "vertical"})
_STATED = re.compile(
    r"(?:\bin\s+|\b(?:units?|einheit)\s*[:=]?\s*|[\[(]\s*)(mm|cm|m|inch(?:es)?|[uµμ]m|microns?)(?=$|[\s\]),.;])",
    re.IGNORECASE,
)
_WORDS = {"inches": "in", "microns": "um"}


def read_lines(path: Path) -> tuple[str, str]:
    """Text of a profile file and its encoding."""
    return decode(read_bytes(path, "profile file", LARGEST), str(path))


def read_points(text: str, source: str) -> RawProfile:
    """Read a table of two columns, lateral position and height, or more with names that tell these.

    Raises
    ------
    DataError
        See `sayd_env.measured.table.read_text_table`; columns of which it is not known which these are.
    """
    lines, comments, separator = lines_of(text)
    if not lines:
        return RawProfile(np.empty((0, 2)), [])
    table = table_of(lines, source, comments=comments, separator=separator)
    if not len(table):
        return RawProfile(np.empty((0, 2)), [])
    refuse_hollow(text, table)
    if found := [name for name in table.names if is_number(name)]:
        where = f"{source}: line {table.head.line}"
        raise DataError(
            f"{where}: found {_short(found[0])} beside what is no number; expected numbers, or names"
        )
    columns = _lateral_and_vertical(table)
    units, said = _units_of(table, columns)
    others = [table.titled(k) for k in range(table.head.width) if k not in columns]
    notes = (f"not used: {', '.join(others[:8])}",) if others else ()
    return RawProfile(table.numbers(columns), table.lines.tolist(), units, said, notes=notes)


def _lateral_and_vertical(table: TextTable) -> list[int]:
    """Places of the two columns."""
    plain = [name_and_unit(name)[0].lower() for name in table.names]
    # Beside a z, y is lateral and x along the rail; without one, as MiniProf has it, x is lateral.
    for lateral, vertical in ((_LATERAL - {"x"}, _VERTICAL), ({"x"}, {"y", *_VERTICAL})):
        found = [[k for k, name in enumerate(plain) if name in known] for known in (lateral, vertical)]
        if all(len(each) == 1 for each in found):
            return [found[0][0], found[1][0]]
    if table.head.width == 2:
        return [0, 1]
    hint = "; decimal commas need another separator" if table.head.separator == "," else ""
    raise DataError(
        f"{table.source}: line {table.head.line}: found {table.head.width} columns; expected two, y and z, "
        f"or a header with these names (y_mm, z_mm){hint}"
    )


def _units_of(table: TextTable, columns: list[int]) -> tuple[tuple[float, float] | None, str]:
    """Metres in the unit of each column, by the header or what stands above it, and which of them says it."""
    head = table.head
    written = [
        head.units[k] if head.units else name_and_unit(head.names[k])[1] for k in columns if head.names
    ]
    if any(written):
        factors = [_length(text or next(filter(None, written)), table.source, head.line) for text in written]
        return (factors[0], factors[1]), "its header: " + ", ".join(filter(None, written))
    stated = {_WORDS.get(found.lower(), found) for line in head.preamble for found in _STATED.findall(line)}
    if len(stated) != 1:
        return None, ""
    (text,) = stated
    factor = _length(text, table.source, 1)
    return (factor, factor), f"its beginning: {text}"


def _length(text: str, source: str, line: int) -> float:
    unit = unit_of(_WORDS.get(text.lower(), text))
    if unit is None or unit.quantity != "length":
        raise DataError(f"{source}: line {line}: found the unit {_short(text)}; expected {', '.join(UNITS)}")
    return unit.factor
