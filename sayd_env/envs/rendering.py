"""Pictures of a vehicle: from above with exaggerated displacements, its dampers, and its last seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sayd_env.config.units import KMH, Array
from sayd_env.envs.canvas import Canvas, Picture, Window
from sayd_env.envs.charts import ACCELERATION, COST, FORCE, VALVE, Charts
from sayd_env.envs.plan_view import Placement, View, make_plan
from sayd_env.envs.recorder import AHEAD, BEHIND, Frame, Place, Recorder
from sayd_env.envs.vehicle_picture import (
    BAD,
    BOGIE_COLOURS,
    BOGIE_FILLS,
    FAINT,
    FRONT,
    GOOD,
    INK,
    LARGEST_FORCE,
    PANEL,
    PAPER,
    PULL,
    PUSH,
    REAR,
    SOFT,
    STEEL,
    Box,
    VehiclePicture,
    force_colour,
)

WIDTH, HEIGHT = 1280, 720
EXAGGERATION = 20.0
"""How many times as large displacements are drawn."""

# Layout.
VEHICLE: Box = (16, 70, 1248, 388)
STRIP: Box = (16, 466, 1248, 62)
LINE: Box = (644, 466, 620, 62)
"""Right half of the strip, where there is a line."""
CHARTS: tuple[Box, Box, Box] = ((16, 536, 408, 172), (436, 536, 408, 172), (856, 536, 408, 172))
CHART_SIZE = (408, 172, 12)
"""Width, height and gap of the charts."""
KEYS: Box = (16, 720, 1248, 40)
"""Below the picture of a window with keys."""
ROAD: Box = (17, 96, 1246, 361)
SCALE = 95.0
"""Pixels in a metre of the vehicle."""
VIEW_HALF_LENGTH = 3.15
SPANS = (2e-3, 5e-3, 1e-2, 2e-2, 5e-2)
"""Scales of the track's alignment, m."""


class Renderer:
    """Draws a vehicle that a recorder watches.

    Parameters
    ----------
    recorder : Recorder
    mode : str
        ``rgb_array`` or ``human``.
    caption : str
        Name of the policy, for the picture's head.
    exaggeration : float
        How many times as large displacements are drawn.
    keys : bool
        Leave room below for `keys`.

    Attributes
    ----------
    keys : sequence of (str, str)
        Keys of a keyboard and what each of them does, for the reader.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        Without pygame, or with ``human`` and no screen.
    """

    def __init__(
        self,
        recorder: Recorder,
        mode: str = "rgb_array",
        *,
        caption: str = "",
        exaggeration: float = EXAGGERATION,
        keys: bool = False,
    ) -> None:
        scenario = recorder.batch.scenario
        plan = make_plan(scenario.vehicle, recorder.model, scenario.track.gauge)
        left, top, width, height = ROAD
        middle = top + 0.5 * height
        # Forward is right, so the front bogie has the right half.
        views = tuple(
            View(bogie.x, (left + share * width, middle), SCALE, VIEW_HALF_LENGTH)
            for bogie, share in zip(plan.bogies, (0.75, 0.25), strict=True)
        )
        self.recorder = recorder
        self.caption = caption
        self.placement = Placement(plan, views, exaggeration)
        size = (WIDTH, HEIGHT + (int(KEYS[3]) if keys else 0))
        self.canvas = Canvas(*size)
        self.keys: Sequence[tuple[str, str]] = ()
        self.vehicle = VehiclePicture(self.canvas, self.placement, ROAD)
        last = COST if scenario.damper.type == "passive" else VALVE
        self.charts = Charts((ACCELERATION, FORCE, last), *CHART_SIZE)
        self.window = Window(size, "Semi-active yaw dampers") if mode == "human" else None
        self._ground()

    def draw(self, recorder: Recorder | None = None) -> Picture | None:
        """Draw the vehicle as it is now: a new array of shape (height, width, 3), or None in a window.

        Parameters
        ----------
        recorder : Recorder, optional
            Of another vehicle of the same batch, to be drawn from now on.
        """
        self.recorder = recorder or self.recorder
        if self.window is None:
            self._paint(self.recorder.frame())
            return self.canvas.pixels()
        if self.window.due(self.recorder.time):
            self.show()
        return None

    def show(self) -> None:
        """Draw the vehicle into the window, whatever the time."""
        self._paint(self.recorder.frame())
        if self.window is not None and self.window.open:
            self.window.show(self.canvas.surface())

    def close(self) -> None:
        """Close the window, if there is one."""
        if self.window is not None:
            self.window.close()

    def _ground(self) -> None:
        """Draw what never changes."""
        canvas = self.canvas
        canvas.fill(PAPER)
        for box in (VEHICLE, STRIP, *CHARTS):
            canvas.box(box, FAINT, radius=8)
            canvas.box(_inner(box, 1), PANEL, radius=7)
        left, top, width, _ = VEHICLE
        factor = self.placement.exaggeration
        title = canvas.text("Vehicle from above", (left + 12, top + 14), 13, INK, bold=True)
        note = f"displacements and track \u00d7 {factor:g}, middle of the carbody left out"
        canvas.text(note, (left + 24 + title, top + 14), 12, SOFT)
        self._scale_bar(left + 612, top + 14)
        self._legend(left + width - 12, top + 14)
        canvas.text(
            "direction of travel  →", (left + width - 14, ROAD[1] + ROAD[3] - 12), 12, SOFT, align="right"
        )
        canvas.text("left", (left + 12, ROAD[1] + 10), 11, SOFT)
        canvas.text("right", (left + 12, ROAD[1] + ROAD[3] - 12), 11, SOFT)
        canvas.keep_as_base()

    def _scale_bar(self, x: float, y: float) -> None:
        """Show how long 10 mm of displacement are."""
        length = 0.01 * self.placement.exaggeration * SCALE
        self.canvas.box((x, y - 1, length, 2), INK)
        for end in (x, x + length):
            self.canvas.box((end - 1, y - 5, 2, 10), INK)
        self.canvas.text("10 mm", (x + length + 8, y), 12, SOFT)

    def _legend(self, right: float, y: float) -> None:
        canvas, start = self.canvas, right - 408
        canvas.text("damper force", (start, y), 12, SOFT)
        canvas.text("push", (start + 92, y), 12, PUSH)
        for step in range(60):
            share = 2.0 * step / 59 - 1.0
            canvas.box((start + 128 + step, y - 5, 1.5, 10), force_colour(share * LARGEST_FORCE))
        canvas.text("pull", (start + 196, y), 12, PULL)
        canvas.box((start + 244, y - 5, 40, 10), FAINT, radius=3)
        canvas.box((start + 244, y - 5, 24, 10), STEEL, radius=3)
        canvas.box((start + 276, y - 7, 2, 14), INK)
        canvas.text("valve: open, asked", (right, y), 12, SOFT, align="right")

    def _paint(self, frame: Frame) -> None:
        self.canvas.begin()
        self._head(frame)
        self.vehicle.draw(frame)
        self._track(frame)
        self.canvas.image(self.charts.draw(frame), CHARTS[0][:2])
        self._keys()

    def _head(self, frame: Frame) -> None:
        canvas = self.canvas
        width = canvas.text(f"{frame.speed * KMH:.0f}", (20, 36), 34, INK, bold=True)
        canvas.text("km/h", (26 + width, 42), 15, SOFT)
        first, second = frame.dominant_frequency
        cost = f"{frame.cost[-1]:.3f}" if len(frame.cost) else "\u2013"
        entries = [
            ("POLICY", self.caption, 176),
            ("TIME", f"{frame.time:.2f} s", 92),
            ("J, LAST SECOND", cost, 122),
            ("f\u2080 FRONT, REAR", f"{first:.1f}, {second:.1f} Hz", 122),
            ("WEAR", f"{frame.wear:.2f}", 68),
            ("FRICTION", f"{frame.friction:.2f}", 80),
            ("TRACK", frame.track, 150) if frame.place is None else ("SECTION", frame.place.section, 150),
        ]
        x = 164.0
        for label, value, space in entries:
            if value:
                canvas.text(label, (x, 24), 10, SOFT)
                canvas.text(value, (x, 44), 16, INK, bold=label.startswith("J"))
                x += space
        self._status(frame)

    def _keys(self) -> None:
        """Show which key does what."""
        x, top, _, height = KEYS
        y = top + 0.5 * height - 6.0
        for key, meaning in self.keys:
            width = self.canvas.text(key, (x + 8, y), 12, PANEL, bold=True)
            self.canvas.box((x, y - 11, width + 16, 22), STEEL, radius=5)
            x += 24 + width
            x += 22 + self.canvas.text(meaning, (x, y), 12, INK)

    def _status(self, frame: Frame) -> None:
        """Show at the upper right whether the vehicle runs, has faults, exceeds its limit, or has ended."""
        colour, words = GOOD, "running"
        if frame.faults:
            colour, words = REAR, "1 fault" if len(frame.faults) == 1 else f"{len(frame.faults)} faults"
        if frame.above_limit:
            colour, words = BAD, "above the limit"
        if frame.ending is not None:
            colour, words = BAD, frame.ending.partition(":")[0]
        width = self.canvas.text(words, (WIDTH - 30, 36), 13, PANEL, align="right", bold=True)
        self.canvas.box((WIDTH - 44 - width, 22, width + 28, 28), colour, radius=14)

    def _track(self, frame: Frame) -> None:
        """Draw the track's alignment behind and ahead, and where the wheelsets are."""
        canvas = self.canvas
        left, top, width, height = STRIP
        if frame.place is not None:
            width -= LINE[2]
            self._line(frame.place)
        inner = (left + 118, top + 4, width - 134, height - 8)
        canvas.text("Track alignment", (left + 12, top + 15), 13, INK, bold=True)
        # Of the whole ride, so that the scale of a video does not change.
        span = next((value for value in SPANS if frame.largest_alignment <= value), frame.largest_alignment)
        canvas.text(f"± {span * 1e3:g} mm", (left + 12, top + 33), 11, SOFT)
        canvas.text(f"km {frame.position * 1e-3:.3f}", (left + 12, top + 49), 11, SOFT)

        def place(x: Array, y: Array) -> Array:
            across = inner[0] + (x + BEHIND) / (BEHIND + AHEAD) * inner[2]
            return np.column_stack([across, inner[1] + 0.5 * inner[3] * (1.0 - 0.9 * y / span)])

        canvas.clip(inner)
        ends = place(np.array([-BEHIND, AHEAD]), np.zeros(2))
        canvas.line(ends, FAINT, 1.0)
        first = 10.0 * math.ceil((frame.position - BEHIND) / 10.0)
        marks = np.arange(first, frame.position + AHEAD, 10.0) - frame.position
        for x in place(marks, np.zeros(len(marks)))[:, 0]:
            canvas.box((float(x) - 0.5, inner[1], 1, inner[3]), FAINT)
        canvas.line(place(frame.rail_x, frame.alignment), STEEL, 1.75)
        for bogie, plan in enumerate(self.placement.plan.bogies):
            for name in plan.wheelsets:
                x = np.array([self.placement.plan.rest[name][0]])
                spot = place(x, np.interp(x, frame.rail_x, frame.alignment))[0]
                canvas.disc((float(spot[0]), float(spot[1])), 4.5, BOGIE_COLOURS[bogie])
        canvas.clip(None)

    def _line(self, place: Place) -> None:
        """Draw speed, curvature and cant along the line, and where the vehicle is."""
        canvas, line = self.canvas, place.line
        left, top, width, height = LINE
        canvas.box((left - 2, top + 1, width + 1, height - 2), PANEL, radius=7)
        canvas.box((left - 2, top + 8, 1, height - 16), FAINT)
        canvas.text(place.section, (left + 12, top + 15), 13, INK, bold=True)
        canvas.text(place.curve, (left + 12, top + 33), 11, SOFT)
        canvas.text(f"cant {1e3 * abs(place.cant):.0f} mm", (left + 12, top + 49), 11, SOFT)
        inner = (left + 140, top + 4, width - 216, height - 8)
        end = max(line.length, place.distance)
        for name, colour, y in (("speed", INK, 15), ("curvature", FRONT, 31), ("cant", REAR, 47)):
            canvas.text(name, (inner[0] + inner[2] + 10, top + y), 11, colour)
        canvas.clip(inner)
        for section in line.sections[1::2]:
            first, last = (inner[0] + s / end * inner[2] for s in (section.start, section.end))
            canvas.box((first, inner[1], last - first, inner[3]), PAPER)
        s = np.linspace(0.0, end, int(inner[2]))
        speed, fastest = line.speed_at(s), line.fastest
        for values, most, colour, low in (
            (line.cant.at(s), 1.6 * _largest(line.cant.value), REAR, -1.0),  # not on the curvature's line
            (line.curvature.at(s), _largest(line.curvature.value), FRONT, -1.0),
            (speed, fastest, INK, 0.0),
        ):
            if values is not None and most:
                share = (values / most - low) / (1.0 - low)
                across = inner[0] + s / end * inner[2]
                up = inner[1] + inner[3] * (1.0 - 0.05 - 0.9 * share)
                canvas.line(np.column_stack([across, up]), colour, 1.5)
        here = inner[0] + max(place.distance, 0.0) / end * inner[2]
        canvas.box((here - 1, inner[1], 2, inner[3]), BAD)
        canvas.clip(None)


def _largest(values: tuple[float, ...]) -> float:
    return max(map(abs, values))


def colours() -> Picture:
    """Colours of a video that its first picture may lack, shape (k, 3)."""
    signals = (FRONT, REAR, BAD, GOOD, INK, SOFT, PUSH, PULL, *BOGIE_FILLS)
    forces = [force_colour(share * LARGEST_FORCE) for share in np.linspace(-1.0, 1.0, 41)]
    # Beside each signal colour its way to white, which is what smooth edges are made of.
    edges = [
        tuple(round(part + share * (255 - part)) for part in colour)
        for colour in signals
        for share in (0.0, 0.25, 0.5, 0.75)
    ]
    return np.array([*forces, *edges], dtype=np.uint8)


def _inner(box: Box, margin: float) -> Box:
    left, top, width, height = box
    return left + margin, top + margin, width - 2 * margin, height - 2 * margin
