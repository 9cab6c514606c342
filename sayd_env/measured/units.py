"""Units as files of people spell them: in brackets, at the end of a name, in a row of their own."""

from __future__ import annotations

import re
from typing import NamedTuple

from sayd_env.config.units import KMH


class Unit(NamedTuple):
    """A unit that was recognised."""

    quantity: str
    """What is measured in it."""
    factor: float
    """From it to SI."""
    name: str
    """How it is written here."""


_G = 9.80665  # m/s2, standard gravity
_UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    "speed": {"m/s": 1.0, "km/h": 1 / KMH, "mm/s": 1e-3, "mph": 0.44704},
    "acceleration": {"m/s2": 1.0, "mm/s2": 1e-3, "cm/s2": 1e-2, "g": _G},
    "force": {"N": 1.0, "daN": 10.0, "kN": 1e3, "MN": 1e6},
    "length": {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048},
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "mbar": 100.0, "bar": 1e5, "psi": 6894.757},
    "flow": {"m3/s": 1.0, "l/s": 1e-3, "l/min": 1e-3 / 60, "cm3/s": 1e-6, "m3/h": 1 / 3600},
    "current": {"A": 1.0, "mA": 1e-3},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295},
    "angular rate": {"rad/s": 1.0, "deg/s": 0.017453292519943295, "rpm": 0.10471975511965978},
    "curvature": {"1/m": 1.0, "1/km": 1e-3},
    "frequency": {"Hz": 1.0, "kHz": 1e3},
    "stiffness": {"N/m": 1.0, "N/mm": 1e3, "kN/m": 1e3, "kN/mm": 1e6, "MN/m": 1e6},
    "damping": {"Ns/m": 1.0, "kNs/m": 1e3},
    "torque": {"Nm": 1.0, "kNm": 1e3},
    "temperature": {"degC": 1.0, "K": 1.0},
    "ratio": {"-": 1.0, "%": 0.01, "1": 1.0},
}
_KNOWN = {
    name: Unit(quantity, factor, name) for quantity, each in _UNITS.items() for name, factor in each.items()
}
_OTHER_SPELLING = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "kmh": "km/h",
    "kph": "km/h",
    "kmph": "km/h",
    "km/hr": "km/h",
    "mps": "m/s",
    "m/sec": "m/s",
    "m/s/s": "m/s2",
    "m/ss": "m/s2",
    "m/sec2": "m/s2",
    "ms-2": "m/s2",
    "ms-1": "m/s",
    "g0": "g",
    "gn": "g",
    "micron": "um",
    "inch": "in",
    "lpm": "l/min",
    "°": "deg",
    "°c": "degC",
    "°/s": "deg/s",
    "1/min": "rpm",
    "none": "-",
}
# Milli and mega differ by case alone: what would be the other one is no spelling of a unit that is known.
_MILLI_OR_MEGA = frozenset({"mN", "mPa", "MV", "MA", "Mbar", "Ms", "Mm"})
# Elsewhere case does not matter.
_IN_LOWER_CASE = {name.lower(): unit for name, unit in _KNOWN.items()} | {
    other: _KNOWN[name] for other, name in _OTHER_SPELLING.items()
}
_SIGNS = str.maketrans({"²": "2", "³": "3", "µ": "u", "μ": "u", "_": "/"} | dict.fromkeys("^*·⋅ .()", ""))
_BRACKETS = re.compile(r"\s*[\[({<](.*)[\])}>]\s*", re.DOTALL)
_AT_END = (
    re.compile(r"(?P<name>.*?)[\s_]*[\[({<](?P<unit>[^\[({<]*(?:\([^()]*\))?)[\])}>]\s*", re.DOTALL),
    re.compile(r"(?P<name>.+?)(?:\s*,\s*|\s+in\s+|\s*/\s*(?=\())(?P<unit>\S+)"),
    re.compile(r"(?P<name>.+?)\s+(?P<unit>\S+/\S+|kN|ms)"),
)


def unit_of(text: str) -> Unit | None:
    """The unit that a text means, with or without brackets, None for none that is known.

    Examples
    --------
    >>> unit_of("[m/s²]").quantity, unit_of("km_h").name, unit_of("furlong")
    ('acceleration', 'km/h', None)
    """
    plain = without_brackets(text).replace("/(", "/").translate(_SIGNS)
    if plain in _MILLI_OR_MEGA:
        return None
    return _KNOWN.get(plain) or _IN_LOWER_CASE.get(plain.lower())


def without_brackets(text: str) -> str:
    """A text without brackets around it and outer blanks."""
    inner = _BRACKETS.fullmatch(text)
    return (inner[1] if inner else text).strip()


def name_and_unit(header: str) -> tuple[str, str]:
    """A column's name, and the unit in brackets or at its end as in the file; "" where there is none.

    Examples
    --------
    >>> name_and_unit("acc, bogie 1 [m/s^2]"), name_and_unit("speed_km_h"), name_and_unit("v in km/h")
    (('acc, bogie 1', 'm/s^2'), ('speed', 'km_h'), ('v', 'km/h'))
    """
    bracket = _AT_END[0].fullmatch(header)
    if bracket:
        return bracket["name"].rstrip(" /,").lstrip(), bracket["unit"].strip()
    parts = header.split("_")
    for count in (3, 2, 1):
        unit = "_".join(parts[-count:])
        if len(parts) > count and unit and unit_of(unit):
            return "_".join(parts[:-count]), unit
    for pattern in _AT_END[1:]:
        found = pattern.fullmatch(header)
        if found and unit_of(found["unit"]):
            return found["name"].strip(), found["unit"]
    return header.strip(), ""
