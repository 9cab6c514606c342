"""Where the parts of a vehicle are drawn: its plan from above, displaced, in the pixels of a picture.

Lengths along and across the track have one scale; the carbody's middle is left out, so that the bogies are
large enough to be seen. Displacements, and those of the rails, are drawn many times as large as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from sayd_env.config.units import Array
from sayd_env.config.vehicle import Attachment, VehicleConfig, YawDamper
from sayd_env.envs.loop import BOGIES
from sayd_env.envs.recorder import Frame, Pose
from sayd_env.envs.trace import DAMPERS
from sayd_env.physics.multibody import Multibody

# Outlines for drawing only, m.
CAR_HALF_WIDTH = 1.66
CAR_END, CAR_BREAK = 2.95, 2.85
CAR_CORNER = 0.45
TOOTH = 0.10
BEAM_HALF_LENGTH, BEAM_HALF_WIDTH, BEAM_Y = 1.62, 0.09, 0.93
TRANSOM_HALF_WIDTH = 0.22
AXLE_HALF_LENGTH, AXLE_HALF_WIDTH = 1.06, 0.075
WHEEL_HALF_WIDTH = 0.07
RAIL_HEAD = 0.072
PAIR_OFFSET = 0.115
CYLINDER, ROD = 0.078, 0.026


@dataclass(frozen=True)
class Bogie:
    """A bogie in the plan."""

    name: str
    x: float
    """Of its centre along the vehicle, m."""
    wheelsets: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Plan:
    """Where the bodies stand at rest, seen from above."""

    carbody: str
    bogies: tuple[Bogie, ...]
    """Front to rear; named as their frames."""
    rest: Mapping[str, tuple[float, float]]
    """x and y of the bodies' centres, m."""
    dampers: Array
    """(d, 2, 2) x and y of the yaw dampers' ends on bogie and carbody, drawn side by side, m."""
    wheel_radius: float
    rail_y: float
    """Half the distance of the rails' centres, m."""


def make_plan(vehicle: VehicleConfig, model: Multibody, gauge: float) -> Plan:
    """Plan of a vehicle with a carbody and bogies."""
    by_role: dict[str, list[str]] = {"carbody": [], "frame": [], "wheelset": []}
    for name, instance in model.instances.items():
        if instance.body.role in by_role:
            by_role[instance.body.role].append(name)
    rest = {
        name: (float(model.instances[name].position[0]), float(model.instances[name].position[1]))
        for names in by_role.values()
        for name in names
    }
    frames = sorted(by_role["frame"], key=lambda name: -rest[name][0])
    owned: dict[str, list[str]] = {name: [] for name in frames}
    for name in by_role["wheelset"]:
        owned[min(frames, key=lambda frame: abs(rest[frame][0] - rest[name][0]))].append(name)
    return Plan(
        carbody=by_role["carbody"][0],
        bogies=tuple(Bogie(name, rest[name][0], tuple(owned[name])) for name in frames),
        rest=rest,
        dampers=_damper_ends(vehicle),
        wheel_radius=vehicle.wheel_radius,
        rail_y=0.5 * (gauge + RAIL_HEAD),
    )


def _damper_ends(vehicle: VehicleConfig) -> Array:
    """Ends of the yaw dampers; those of a pair, one above the other, are drawn beside each other."""
    ends = []
    for element in vehicle.elements:
        if isinstance(element, YawDamper):
            for members in product(*(vehicle.sets[name].values() for name in element.per)):
                origin = np.sum([member.origin for member in members], axis=0)
                sign = np.prod([member.sign for member in members], axis=0)
                ends.append([_seen_from_above(end, origin, sign) for end in (element.a, element.b)])
    if not ends:
        return np.empty((0, 2, 2))
    places = np.array(ends)
    height = places[:, :, 2] - places[:, :, 2].mean()
    outwards = np.sign(places[:, :, 1]) * np.sign(height) * PAIR_OFFSET
    places[:, :, 1] += outwards
    return np.asarray(places[:, :, :2])


def _seen_from_above(end: Attachment, origin: Array, sign: Array) -> Array:
    return np.asarray(origin + sign * np.array(end.at), dtype=np.float64)


def displaced(points: Array, rest: tuple[float, float], pose: Pose, exaggeration: float) -> Array:
    """Points of a body that has moved: x and y, shape (k, 2), m.

    Rotations are small: a point moves by (x - yaw dy, y + yaw dx), and this is drawn `exaggeration` times as
    large.
    """
    arm = points - np.array(rest)
    move = np.column_stack([pose.x - pose.yaw * arm[:, 1], pose.y + pose.yaw * arm[:, 0]])
    return np.asarray(points + exaggeration * move)


def rectangle(x: float, y: float, half_length: float, half_width: float) -> Array:
    """Corners of a rectangle along the track."""
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return np.asarray(np.array([x, y]) + signs * np.array([half_length, half_width]))


@dataclass(frozen=True)
class View:
    """A part of the track on the screen."""

    x: float
    """Place along the vehicle in the middle of the view, m."""
    centre: tuple[float, float]
    """Its pixel."""
    scale: float
    """Pixels in a metre."""
    half_length: float
    """m."""

    def pixels(self, points: Array) -> Array:
        """Pixels of points (x forward, y to the left) of shape (k, 2): forward is right, left is up."""
        seen = points - np.array([self.x, 0.0])
        return np.asarray(np.array(self.centre) + self.scale * seen * np.array([1.0, -1.0]))


class Placement:
    """Puts a frame's bodies on the screen.

    Parameters
    ----------
    plan : Plan
    views : sequence of View
        One of each bogie.
    exaggeration : float
        How many times as large displacements are drawn.
    """

    def __init__(self, plan: Plan, views: tuple[View, ...], exaggeration: float) -> None:
        self.plan = plan
        self.views = views
        self.exaggeration = exaggeration

    def _of(self, frame: Frame, name: str, view: View, points: Array) -> Array:
        # The train's lag behind its nominal position is not exaggerated.
        own, lag = frame.poses[name], frame.poses[self.plan.carbody].x
        moved = displaced(points, self.plan.rest[name], Pose(own.x - lag, own.y, own.yaw), self.exaggeration)
        return view.pixels(moved)

    def frame(self, frame: Frame, bogie: int) -> list[Array]:
        """Polygons of a bogie frame: two side beams and the transom between them."""
        plan, view = self.plan.bogies[bogie], self.views[bogie]
        parts = [
            rectangle(plan.x, 0.0, TRANSOM_HALF_WIDTH, BEAM_Y),
            rectangle(plan.x, BEAM_Y, BEAM_HALF_LENGTH, BEAM_HALF_WIDTH),
            rectangle(plan.x, -BEAM_Y, BEAM_HALF_LENGTH, BEAM_HALF_WIDTH),
        ]
        return [self._of(frame, plan.name, view, part) for part in parts]

    def wheelsets(self, frame: Frame, bogie: int) -> list[tuple[Array, list[Array]]]:
        """Polygons of a bogie's axles, each with those of its wheels."""
        plan, view, found = self.plan, self.views[bogie], []
        for name in plan.bogies[bogie].wheelsets:
            x, y = plan.rest[name]
            axle = rectangle(x, y, AXLE_HALF_WIDTH, AXLE_HALF_LENGTH)
            wheels = [
                rectangle(x, y + side * plan.rail_y, plan.wheel_radius, WHEEL_HALF_WIDTH) for side in (1, -1)
            ]
            found.append(
                (
                    self._of(frame, name, view, axle),
                    [self._of(frame, name, view, wheel) for wheel in wheels],
                )
            )
        return found

    def centres(self, frame: Frame, bogie: int) -> tuple[Array, Array]:
        """Pixels of a bogie frame's centre at rest and as it is, each of shape (2,)."""
        plan, view = self.plan.bogies[bogie], self.views[bogie]
        rest = np.array([self.plan.rest[plan.name]])
        return view.pixels(rest)[0], self._of(frame, plan.name, view, rest)[0]

    def carbody(self, frame: Frame, bogie: int) -> tuple[Array, Array]:
        """Outline of the carbody's part above a bogie, and the jagged edge towards its middle."""
        plan, view = self.plan, self.views[bogie]
        x, out = plan.bogies[bogie].x, 1.0 if plan.bogies[bogie].x > 0.0 else -1.0
        turn = np.linspace(0.0, 0.5 * np.pi, 9)
        corner = CAR_CORNER * np.column_stack([np.sin(turn), np.cos(turn)])
        round_left = np.array([CAR_END - CAR_CORNER, CAR_HALF_WIDTH - CAR_CORNER]) + corner
        teeth = np.linspace(CAR_HALF_WIDTH, -CAR_HALF_WIDTH, 9)
        jagged = np.column_stack([-CAR_BREAK + TOOTH * (np.arange(9) % 2), teeth])
        outline = np.vstack([jagged[:1], round_left, (round_left * [1.0, -1.0])[::-1], jagged[:0:-1]])
        place = np.array([out, 1.0])

        def put(points: Array) -> Array:
            return self._of(frame, plan.carbody, view, points * place + np.array([x, 0.0]))

        return put(outline), put(jagged)

    def damper(self, frame: Frame, k: int) -> Array:
        """Pixels of a damper's ends on bogie and carbody, shape (2, 2)."""
        bogie = k * BOGIES // DAMPERS
        view, ends = self.views[bogie], self.plan.dampers[k]
        names = (self.plan.bogies[bogie].name, self.plan.carbody)
        return np.vstack(
            [self._of(frame, name, view, end[None]) for name, end in zip(names, ends, strict=True)]
        )

    def rails(self, frame: Frame, bogie: int) -> tuple[Array, Array]:
        """Pixels along the left and the right rail under a bogie."""
        view = self.views[bogie]
        seen = np.abs(frame.rail_x - view.x) <= view.half_length + 1e-9
        x, middle, widened = frame.rail_x[seen], frame.alignment[seen], 0.5 * frame.gauge[seen]
        left = np.column_stack([x, self.plan.rail_y + self.exaggeration * (middle + widened)])
        right = np.column_stack([x, -self.plan.rail_y + self.exaggeration * (middle - widened)])
        return view.pixels(left), view.pixels(right)
