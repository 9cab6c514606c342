"""A vehicle from above, drawn on a canvas: bodies, rails, dampers with their forces and valves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sayd_env.config import palette
from sayd_env.config.palette import rgb
from sayd_env.envs.canvas import Canvas, Colour
from sayd_env.envs.loop import BOGIES
from sayd_env.envs.plan_view import CYLINDER, PAIR_OFFSET, RAIL_HEAD, ROD, Placement
from sayd_env.envs.recorder import Frame
from sayd_env.envs.trace import DAMPERS

LARGEST_FORCE = 15e3
"""Damper force of the strongest colour, N."""

# Colours.
PAPER: Colour = (238, 241, 245)
PANEL: Colour = (255, 255, 255)
INK, SOFT, FAINT = rgb(palette.INK), rgb(palette.SOFT), rgb(palette.FAINT)
FRONT, REAR = rgb(palette.FRONT), rgb(palette.REAR)
GOOD, BAD = rgb(palette.GOOD), rgb(palette.BAD)
CAR: Colour = (233, 238, 245)
CAR_EDGE: Colour = (128, 144, 166)
RAIL: Colour = (142, 148, 158)
STEEL: Colour = (70, 80, 94)
PUSH, PULL = rgb(palette.PUSH), rgb(palette.PULL)
NONE: Colour = (198, 204, 212)
BOGIE_COLOURS = (FRONT, REAR)
BOGIE_FILLS: tuple[Colour, Colour] = ((176, 204, 244), (250, 208, 166))

Box = tuple[float, float, float, float]
"""Left, top, width, height."""
BARS = (58.0, 92.0, 74.0)
"""Opening bars: distance from a bogie's centre, length, and from there to the end of the forces, pixels."""


class VehiclePicture:
    """Draws a vehicle, or one of its bogies.

    Parameters
    ----------
    canvas : Canvas
    placement : Placement
        Where its parts are.
    road : tuple of float
        Left, top, width and height of what is seen of the track.
    bogies : sequence of int
        Those that are drawn.
    bars : tuple of float
        As `BARS`.
    """

    def __init__(
        self,
        canvas: Canvas,
        placement: Placement,
        road: Box,
        bogies: Sequence[int] = range(BOGIES),
        bars: tuple[float, float, float] = BARS,
    ) -> None:
        self.canvas, self.placement, self.road = canvas, placement, road
        self.bogies, self.bars = bogies, bars

    def draw(self, frame: Frame) -> None:
        """Draw it as it is in a frame."""
        canvas, placement = self.canvas, self.placement
        canvas.clip(self.road)
        edges = []
        for bogie in self.bogies:
            outline, jagged = placement.carbody(frame, bogie)
            canvas.polygon(outline, CAR)
            edges.append((outline, jagged))
        for bogie in self.bogies:
            for rail in placement.rails(frame, bogie):
                half = np.array([0.0, 0.5 * RAIL_HEAD * placement.views[bogie].scale])
                canvas.polygon(np.vstack([rail - half, (rail + half)[::-1]]), RAIL)
            for axle, wheels in placement.wheelsets(frame, bogie):
                canvas.polygon(axle, (150, 158, 170), STEEL)
                for wheel in wheels:
                    canvas.polygon(wheel, STEEL, INK)
            parts = placement.frame(frame, bogie)
            for part in parts:
                canvas.polygon(part, BOGIE_FILLS[bogie], BOGIE_COLOURS[bogie], 1.5)
            self._centre(frame, bogie)
        for outline, jagged in edges:
            canvas.line(np.vstack([outline, outline[:1]]), CAR_EDGE, 2.0)
            canvas.line(jagged, PANEL, 3.5)
            canvas.line(jagged, CAR_EDGE, 1.0)
        dampers = [k for k in range(DAMPERS) if k * BOGIES // DAMPERS in self.bogies]
        for k in dampers:
            self._damper(frame, k)
        for k in dampers[::2]:
            self._plate(k)
        for k in dampers:
            self._values(frame, k)
        canvas.clip(None)
        if frame.faults:
            words = ", ".join(frame.faults[:3]) + (", …" if len(frame.faults) > 3 else "")
            left, top, width, height = self.road
            middle = (left + 0.5 * width, top + height - 12)
            canvas.text(words, middle, 12, BAD, align="middle")

    def _centre(self, frame: Frame, bogie: int) -> None:
        """Mark the frame's centre, where it is at rest and where it is."""
        rest, now = self.placement.centres(frame, bogie)
        canvas = self.canvas
        for arm in ((9.0, 0.0), (0.0, 9.0)):
            canvas.line(np.array([rest - arm, rest + arm]), SOFT, 1.0)
        canvas.disc((float(now[0]), float(now[1])), 4.0, BOGIE_COLOURS[bogie])

    def _damper(self, frame: Frame, k: int) -> None:
        """Draw a damper in the colour of its force, crossed out if it has a fault."""
        canvas = self.canvas
        bogie_end, car_end = self.placement.damper(frame, k)
        colour = force_colour(float(frame.damper_force[k]))
        along = bogie_end - car_end
        side = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
        half_way = car_end + 0.62 * along
        view = self.placement.views[k * BOGIES // DAMPERS]
        rod, body = ROD * view.scale * side, CYLINDER * view.scale * side
        canvas.polygon(np.array([car_end + rod, bogie_end + rod, bogie_end - rod, car_end - rod]), STEEL)
        canvas.polygon(
            np.array([car_end + body, half_way + body, half_way - body, car_end - body]), colour, STEEL
        )
        for end in (bogie_end, car_end):
            canvas.disc((float(end[0]), float(end[1])), 3.5, INK)
        if k in frame.damper_faults:
            for turn in ((1.0, 1.0), (1.0, -1.0)):
                arm = 9.0 * np.array(turn)
                middle = 0.5 * (bogie_end + car_end)
                canvas.line(np.array([middle - arm, middle + arm]), BAD, 3.0)

    def _height(self, k: int) -> float:
        """Pixel of a damper's height in the picture, at rest."""
        view = self.placement.views[k * BOGIES // DAMPERS]
        return view.centre[1] - view.scale * float(self.placement.plan.dampers[k, 0, 1])

    def _plate(self, k: int) -> None:
        """Draw what valves and forces of a pair of dampers stand on: the frame swings as far as there."""
        view = self.placement.views[k * BOGIES // DAMPERS]
        low, high = sorted(map(self._height, (k, k + 1)))
        half, width = PAIR_OFFSET * view.scale, sum(self.bars[1:]) + 12
        plate = (view.centre[0] + self.bars[0] - 6, low - half, width, high - low + 2.0 * half)
        self.canvas.box(plate, CAR, radius=4)
        self.canvas.box(plate, NONE, radius=4, border=1)

    def _values(self, frame: Frame, k: int) -> None:
        """Draw a damper's valve and force."""
        canvas, view = self.canvas, self.placement.views[k * BOGIES // DAMPERS]
        force, fault = float(frame.damper_force[k]), frame.damper_faults.get(k)
        before, length, after = self.bars
        middle_x, y = view.centre[0], self._height(k)
        left, right = middle_x + before, middle_x + before + length + after
        self._bar(frame, k, (left, y, length, 1.15 * PAIR_OFFSET * view.scale), force_colour(force))
        words = f"{round(force * 1e-3, 1) + 0.0:+.1f} kN".replace("-", "\u2212")
        canvas.text(words, (right, y), 13, INK, align="right")
        if fault is not None:
            canvas.text(fault, (middle_x - before - 46, y), 12, BAD, align="right", bold=True)

    def _bar(self, frame: Frame, k: int, box: Box, colour: Colour) -> None:
        """Draw a valve: how far it is open, and what was asked; the box has its middle height at its top."""
        canvas, (x, y, length, height) = self.canvas, box
        if frame.opening is None or frame.command is None:
            canvas.text("passive", (x, y), 11, SOFT)
            return
        canvas.box((x, y - 0.5 * height, length, height), (208, 214, 222), radius=3)
        share = min(max(float(frame.opening[k]), 0.0), 1.0)
        if share > 0.02:
            canvas.box((x, y - 0.5 * height, share * length, height), colour, radius=3)
        asked = x + min(max(float(frame.command[k]), 0.0), 1.0) * length
        canvas.box((asked - 1, y - 0.5 * height - 2, 2, height + 4), INK)


def force_colour(force: float) -> Colour:
    """Colour of a damper force (N): blue pushes, red pulls, grey is nothing."""
    share = min(abs(force) / LARGEST_FORCE, 1.0)
    target = PULL if force > 0.0 else PUSH
    # The root makes small forces visible.
    weight = math.sqrt(share)
    red, green, blue = (round(a + weight * (b - a)) for a, b in zip(NONE, target, strict=True))
    return red, green, blue
