"""Colours, markers and lines of all pictures: a policy or a wheelset looks the same in each of them.

The colours are those of M. Okabe and K. Ito, "Color Universal Design" (2008), which colour-blind readers can
tell apart. Where there are more things than colours, markers and lines tell them apart.
"""

from __future__ import annotations

import logging
import os
import re
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import Any

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
GREY = "#606060"
"""Beside the eight: what the others are compared with."""
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, GREY)
"""Of things without a colour of their own; yellow is too light for a line."""
LINES = ("-", "--", "-.", ":")
MARKERS = "osD^vP*X<>"
FRONT, REAR = BLUE, VERMILION
"""Colours of the bogies."""
PUSH, PULL = "#2654BE", "#C82830"
"""Colours of a damper's force by its direction, deeper than the bogies'; words beside them say which."""
LIMIT = BLACK
"""Colour of a limit, which is a dashed line."""
INK, SOFT, FAINT = "#18202C", "#687484", "#DEE3E9"
"""Words, words beside them, and what lies behind, in a picture of the vehicle."""
GOOD, BAD = GREEN, "#C4242C"
"""A vehicle within its limits, and one that is not; words say it, too."""
SHADE = "#EDEDED"
"""Behind every second section of a line."""


@dataclass(frozen=True)
class Style:
    """Colour, marker and line of one thing."""

    colour: str
    marker: str = "o"
    line: str | tuple[float, tuple[float, ...]] = "-"

    @property
    def drawn(self) -> dict[str, Any]:
        """Keywords of `matplotlib.axes.Axes.plot`."""
        return {"color": self.colour, "marker": self.marker, "linestyle": self.line}

    @property
    def plain(self) -> dict[str, Any]:
        """The same without markers, for lines of many points."""
        return {"color": self.colour, "linestyle": self.line}


# Those that the studies draw together by themselves have markers of their own, and lines of their own where a
# colour-blind reader takes two colours for one; the others share a marker with a colour that is far off.
_POLICIES = MappingProxyType(
    {
        "passive": Style(BLACK, "o", "-"),
        "mppt1": Style(SKY, "v", "--"),
        "mppt2": Style(BLUE, "^", "-"),
        "skyhook-onoff": Style(ORANGE, "s", "--"),
        "skyhook-continuous": Style(ORANGE, "p", "-."),
        "mppt2-tuned": Style(BLUE, "<", "-."),
        "constant-tuned": Style(GREY, "P", "--"),
        "speed-schedule-tuned": Style(GREY, ">", "-."),
        "hunting-schedule-tuned": Style(SKY, "X", "-."),
        "lqg-tuned": Style(GREEN, "h", ":"),
        "ppo": Style(VERMILION, "D", "-"),
        "sac": Style(PURPLE, "*", "-"),
        "constant": Style(GREY, "s", "-"),
        "speed-schedule": Style(GREY, "p", ":"),
        "hunting-schedule": Style(SKY, "o", ":"),
        "lqg": Style(GREEN, "o", "--"),
        "perturb-and-observe": Style(GREEN, "D", "-."),
        "mppt1-estimate": Style(SKY, "s", ":"),
        "mppt2-estimate": Style(BLUE, "D", ":"),
    }
)
_LEARNED = ("ppo", "sac")
_OTHERS = tuple(
    Style(colour, marker, line)
    for colour, marker, line in product((GREEN, PURPLE, SKY, BLUE), "X<>h8p", ("-", "-."))
    if (colour, marker) not in {(style.colour, style.marker) for style in _POLICIES.values()}
)
_TRAINING = re.compile(r"(?P<algorithm>[a-z]+[0-9]?)-s(?P<seed>\d+)")
_AGAIN_MARKERS = "^v<Xo>Ph8s"
_AGAIN_LINES = (*LINES, (0, (7.0, 1.5, 1.5, 1.5, 1.5, 1.5)))
"""Of an algorithm's trainings beside that of seed 0; the last line is a dash and two dots."""


def policy_style(name: str) -> Style:
    """Colour, marker and line of a policy, the same wherever it is drawn.

    Parameters
    ----------
    name : str
        A controller, an algorithm, one of its trainings (``ppo-s3``), ``constant:0.3``, ``safe:`` and any
        of these, or any other name.
    """
    if name in _POLICIES:
        return _POLICIES[name]
    kind, colon, value = name.partition(":")
    if colon and kind == "safe":  # a policy inside the fallback: a cross, seen even on top of its own marker
        inside, learned = policy_style(value), _algorithm(value) in _LEARNED
        line = ":" if inside.line == "-" else inside.line
        return replace(inside, marker="x" if learned else "+", line=line)
    if colon and kind in _POLICIES:  # a variant: the same colour
        return Style(_POLICIES[kind].colour, *_nth(zlib.crc32(value.encode())))
    if (algorithm := _algorithm(name)) in _POLICIES:
        return _training_style(_POLICIES[algorithm], int(name.rpartition("-s")[2]))
    return _OTHERS[zlib.crc32(name.encode()) % len(_OTHERS)]


def _algorithm(name: str) -> str:
    """That of a training; of anything else its name."""
    training = _TRAINING.fullmatch(name)
    return name if training is None else training["algorithm"]


def _training_style(own: Style, seed: int) -> Style:
    """Seed 0 looks as its algorithm, whose only training it is in most pictures."""
    if seed == 0:
        return own
    again, first = divmod(seed - 1, len(_AGAIN_MARKERS))
    return Style(own.colour, _AGAIN_MARKERS[first], _AGAIN_LINES[(seed + again) % len(_AGAIN_LINES)])


def wheelset_style(place: int) -> Style:
    """Colour, marker and line of a wheelset, counted from the front: a colour for each bogie."""
    return Style((FRONT, REAR)[place // 2 % 2], "os"[place % 2], ("-", "--")[place % 2])


def cycled(place: int) -> Style:
    """Style of one of several things that have no name in all pictures."""
    return Style(CYCLE[place % len(CYCLE)], *_nth(place))


def _nth(place: int) -> tuple[str, str]:
    again, first = divmod(place, len(MARKERS))
    return MARKERS[first], LINES[(place + again) % len(LINES)]  # forty different pairs


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of a colour, 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


@contextmanager
def plain_matplotlib() -> Iterator[None]:
    """Matplotlib as it comes: no window, none of the reader's settings, and a ``$`` that starts no formula.

    Import it inside. It cannot be imported where MPLBACKEND names what is not installed, as in a process that
    a notebook has started, and no picture of ours needs a backend. Its log says where it keeps its own files
    if the user's folder cannot be written: that concerns nobody.
    """
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.ERROR)
    asked = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib as mpl  # noqa: PLC0415 - slow to import, and --json needs none
    finally:
        if asked is not None:
            os.environ["MPLBACKEND"] = asked
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpl.MatplotlibDeprecationWarning)  # of settings that we do not use
        settings = {key: mpl.rcParamsDefault[key] for key in mpl.rcParamsDefault if "backend" not in key}
    try:
        with mpl.rc_context({**settings, "text.parse_math": False}):
            yield
    finally:
        log.setLevel(level)
