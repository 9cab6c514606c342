"""Pictures of vehicles side by side: one bogie of each from above, sliding RMS values on common axes."""

from __future__ import annotations

from collections.abc import Sequence

from sayd_env.config.palette import policy_style, rgb
from sayd_env.config.units import KMH
from sayd_env.envs.canvas import Canvas, Picture
from sayd_env.envs.charts import ACCELERATION, FORCE, Charts, Extent
from sayd_env.envs.plan_view import Placement, View, make_plan
from sayd_env.envs.recorder import Frame, Recorder
from sayd_env.envs.vehicle_picture import (
    BAD,
    FAINT,
    FRONT,
    GOOD,
    INK,
    PANEL,
    PAPER,
    REAR,
    SOFT,
    Box,
    VehiclePicture,
)

# Whole pictures are multiples of 16 pixels wide and high, as encoders of videos want them.
COLUMN, GAP, EDGE = 484, 12, 14
"""Width of a vehicle's column, and the spaces between and around them, pixels."""
HEAD, TITLE, ROAD, CHART, FOOT = 60, 42, 262, 158, 24
"""Heights from above to below, pixels; there are two charts."""
HEIGHT = HEAD + TITLE + ROAD + 2 * CHART + FOOT
SCALE = 70.0
"""Pixels in a metre of the vehicle."""
FRONT_BOGIE = 0
BARS = (48.0, 64.0, 66.0)
"""As those of `VehiclePicture`, for a narrower view."""
SHOWN = (ACCELERATION, FORCE)


class SideBySide:
    """Draws several vehicles, each in a column of its own.

    Parameters
    ----------
    recorders : sequence of Recorder
        Of the vehicles, which have the same conditions.
    names : sequence of str
        Of their policies.
    extent : Extent
        Of the charts: acceleration, force.
    exaggeration : float
        How many times as large displacements are drawn.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        Without pygame.
    """

    def __init__(
        self, recorders: Sequence[Recorder], names: Sequence[str], extent: Extent, exaggeration: float
    ) -> None:
        count = len(recorders)
        self.width = 2 * EDGE + count * (COLUMN + GAP) - GAP
        self.canvas = Canvas(self.width, HEIGHT)
        self.names, self.exaggeration = names, exaggeration
        self.lefts = [EDGE + place * (COLUMN + GAP) for place in range(count)]
        self.vehicles = [
            self._vehicle(recorder, left) for recorder, left in zip(recorders, self.lefts, strict=True)
        ]
        self.charts = [
            [
                Charts((chart,), COLUMN, CHART, GAP, Extent(extent.seconds, (largest,)))
                for chart, largest in zip(SHOWN, extent.largest, strict=True)
            ]
            for _ in recorders
        ]
        self._ground()

    def draw(self, frames: Sequence[Frame]) -> Picture:
        """Draw the vehicles as they are: a new array of shape (height, width, 3).

        Parameters
        ----------
        frames : sequence of Frame
            One of each; their histories begin with the video.
        """
        self.canvas.begin()
        self._head(frames)
        for place, frame in enumerate(frames):
            self._title(place, frame)
            self.vehicles[place].draw(frame)
            for row, charts in enumerate(self.charts[place]):
                top = HEAD + TITLE + ROAD + row * CHART
                self.canvas.image(charts.draw(frame), (self.lefts[place], top))
        return self.canvas.pixels()

    def _vehicle(self, recorder: Recorder, left: float) -> VehiclePicture:
        scenario = recorder.batch.scenario
        plan = make_plan(scenario.vehicle, recorder.model, scenario.track.gauge)
        road: Box = (left + 1, HEAD + TITLE, COLUMN - 2, ROAD)
        centre = (left + 0.5 * COLUMN, HEAD + TITLE + 0.5 * ROAD)
        # Of the other bogie nothing is drawn.
        views = tuple(View(bogie.x, centre, SCALE, 0.5 * COLUMN / SCALE) for bogie in plan.bogies)
        placement = Placement(plan, views, self.exaggeration)
        return VehiclePicture(self.canvas, placement, road, (FRONT_BOGIE,), BARS)

    def _ground(self) -> None:
        """Draw what never changes."""
        canvas = self.canvas
        canvas.fill(PAPER)
        for left, name in zip(self.lefts, self.names, strict=True):
            canvas.box((left, HEAD, COLUMN, HEIGHT - HEAD - FOOT), FAINT, radius=8)
            canvas.box((left + 1, HEAD + 1, COLUMN - 2, HEIGHT - HEAD - FOOT - 2), PANEL, radius=7)
            canvas.box((left + 14, HEAD + 12, 6, 20), rgb(policy_style(name).colour), radius=2)
            canvas.text(name, (left + 28, HEAD + 22), 18, INK, bold=True)
        y = HEIGHT - 0.5 * FOOT
        view = f"Front bogie from above, displacements \u00d7 {self.exaggeration:g}, travel to the right"
        note = f"{view}; J of the last second"
        canvas.text(note, (EDGE + 2, y), 12, SOFT)
        right: float = self.width - EDGE - 2
        right -= canvas.text("rear bogie", (right, y), 12, REAR, align="right", bold=True) + 12
        canvas.text("front bogie", (right, y), 12, FRONT, align="right", bold=True)
        canvas.keep_as_base()

    def _head(self, frames: Sequence[Frame]) -> None:
        canvas, frame = self.canvas, max(frames, key=lambda frame: frame.time)
        width = canvas.text(f"{frame.speed * KMH:.0f}", (EDGE + 2, 32), 32, INK, bold=True)
        x = EDGE + 10 + width
        x += canvas.text("km/h", (x, 38), 15, SOFT) + 28
        track = frame.track if frame.place is None else frame.place.section
        for label, value, space in (
            ("TIME", f"{frame.time:.2f} s", 96),
            ("WEAR", f"{frame.wear:.2f}", 76),
            ("FRICTION", f"{frame.friction:.2f}", 92),
            ("TRACK, THE SAME FOR ALL", track, 0),
        ):
            canvas.text(label, (x, 22), 10, SOFT)
            canvas.text(value, (x, 41), 16, INK)
            x += space

    def _title(self, place: int, frame: Frame) -> None:
        """Tell J, and whether a limit is exceeded."""
        left, canvas = self.lefts[place], self.canvas
        words = "above the limit" if frame.above_limit else "running"
        if frame.ending:
            words = frame.ending.partition(":")[0]
        y, right = HEAD + 22, left + COLUMN - 24
        width = canvas.text(words, (right, y), 12, PANEL, align="right", bold=True)
        box = (right - width - 12, y - 12, width + 24, 24)
        canvas.box(box, BAD if frame.above_limit or frame.ending else GOOD, radius=12)
        if len(frame.cost):
            cost = f"J {frame.cost[-1]:.3f}"
            canvas.text(cost, (right - width - 30, y), 15, INK, align="right", bold=True)
