"""A line under a running vehicle: curvature, cant, speed, friction and rail shape over distance.

Every body stands at its own place along the line, and its unknowns are measured from the curved and canted
centre line there. So contact and track know nothing of a curve but the turning of the wheelsets; what a curve
does to the vehicle comes in twice:

- the frames of the bodies are accelerated and gravity leans in them: forces of inertia on the bodies;
- the frames of two bodies that a connection joins stand at different places: the connection sees the bodies'
  motion against one common frame, that of the vehicle's centre, which is their own motion and the offset of
  their frames.

With curvature kappa (1/m, positive in a left curve), cant angle phi (rad, the frame's roll about the
direction of travel, negative where the right rail is higher) and speed V, a body at x from the vehicle's
centre and height z has

    y'' + V^2 kappa + g phi - z V^2 phi''     laterally,
    z'' - V^2 kappa phi - g phi^2 / 2         vertically,
    phi'' V^2 in roll and V^2 kappa' in yaw

for its acceleration against free fall, and its frame lies at Theta(x) - Theta(0) - Theta'(0) x - z (phi(x) -
phi(0)) from the centre's, with Theta'' = kappa. A spinning wheelset has the moments I_y (V / r) V kappa in
roll and -I_y (V / r) V phi' in yaw (Wickens 2003, chapter 2; Garg and Dukkipati 1984, chapter 3, from which
the signs are derived for these axes).

Conditions hold over a sample (1 ms, at most 0.15 m) and are those of its middle; only the offsets go on at
their rates, else the connections would feel steps. The speed changes so slowly that its own forces are left
out: no traction, no pitch from braking, no lag of the wheels' rotation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, PPoly

from sayd_env.config.conditions import LINE_STEP, Line
from sayd_env.config.errors import ConfigError
from sayd_env.config.units import GRAVITY, Array
from sayd_env.physics import plant as at
from sayd_env.physics.contact import geometry
from sayd_env.physics.kernel import kernel
from sayd_env.physics.multibody import Multibody
from sayd_env.physics.plant import LANES, WHEELSETS, Plant, Work
from sayd_env.physics.rows import Column, Lanes

GRID_STEP = LINE_STEP
"""Distance of the table's nodes (m): kinks of curvature and cant are rounded over two of them each way."""
MARGIN = 30.0
"""Line before and behind the run (m) that its first and last bodies need."""

# Columns of a line's table: polynomials over the distance from each node, lowest power first.
THETA = 0  # twice integrated curvature, m; six coefficients
CANT = THETA + 6  # cant angle, rad; four
SQUARE = CANT + 4  # square of the speed, m2/s2; two
FRICTION = SQUARE + 2  # coefficient of friction; two
BLEND = FRICTION + 2  # place between the vehicle's rail shapes, from 0; two
CURVED = BLEND + 2  # 1 where there is a curve or a cant within `MARGIN`, else 0
STEADY = CURVED + 1  # 0 where anything changes within `MARGIN`, else 1 and the first such node's number
COLUMNS = STEADY + 1

# Rows of `Plant.body`, one number for each body.
X, HEIGHT, CARRIED, SPIN, BODY_ROWS = range(5)

# Rows behind the bodies' in `Work.line`: where each vehicle's centre is looked up, and the line there.
PLACE, HELD, INSIDE, CENTRE_THETA, CENTRE_ANGLE, CENTRE_KAPPA, CENTRE_CANT, CENTRE_TWIST = range(8)
CENTRE_ROWS = 8

# Rows of what a line does to a body: loads, offsets of its frame, their rates, its acceleration against
# free fall.
(
    LOAD_Y,
    LOAD_Z,
    LOAD_ROLL,
    LOAD_YAW,
    OFFSET_Y,
    OFFSET_ROLL,
    OFFSET_YAW,
    RATE_Y,
    RATE_ROLL,
    RATE_YAW,
    FALL_Y,
    FALL_Z,
    FALL_ROLL,
    FALL_YAW,
) = range(14)


@dataclass(frozen=True)
class LineTable:
    """A line as the compiled step reads it."""

    start: float
    """Position of the first node on the run (m)."""
    step: float
    """Distance of the nodes (m)."""
    values: Array
    """(nodes, COLUMNS), C-contiguous."""
    slowest: float
    """Lowest speed on it, m/s."""
    fastest: float
    """Highest speed on it, m/s."""


def changes(line: Line) -> bool:
    """Whether a line says more than gauge, irregularities and one speed: its vehicles then need a table."""
    return line.curved or line.reshaped or line.friction is not None or not line.constant_speed


def line_table(
    line: Line, origin: float, distance: float, speed: float, friction: float, step: float = GRID_STEP
) -> LineTable:
    """Table of a line for a run.

    Parameters
    ----------
    line : Line
    origin : float
        Position on the run of the line's s = 0 (m).
    distance : float
        How far the run goes beyond it (m).
    speed, friction : float
        What holds where the line leaves them out: m/s, -.
    step : float
        Distance of the nodes (m).
    """
    before = math.ceil((origin + 2.0 * MARGIN) / step)
    s = step * np.arange(-before, math.ceil((distance + 2.0 * MARGIN) / step) + 1)
    even = np.ones(len(s))
    return tabulated(
        origin + float(s[0]),
        line.curvature.at(s),
        line.roll.at(s),
        even * speed**2 if line.speed_squared is None else line.speed_squared.at(s),
        even * friction if line.friction is None else line.friction.at(s),
        0.0 * even if line.rail_blend is None else line.rail_blend.at(s),
        step,
    )


def tabulated(
    start: float,
    curvature: Array,
    cant: Array,
    square: Array,
    friction: Array,
    blend: Array,
    step: float = GRID_STEP,
) -> LineTable:
    """Table of a line from values at equidistant nodes.

    Parameters
    ----------
    start : float
        Position of the first node on the run (m).
    curvature, cant : ndarray, shape (n,)
        1/m and rad: control points of cubic B-splines, which round kinks and never overshoot.
    square, friction, blend : ndarray, shape (n,)
        m2/s2, -, -: linear between the nodes.
    step : float
        Distance of the nodes (m).

    Raises
    ------
    ConfigError
        A speed that is not above 0.
    """
    if not np.min(square) > 0.0:
        raise ConfigError(f"line: a speed of {math.sqrt(max(0.0, float(np.min(square)))):g} m/s")
    x = step * np.arange(len(curvature))
    values = np.zeros((len(x), COLUMNS))
    for column, points, order in ((THETA, curvature, 2), (CANT, cant, 0)):
        piecewise = _rounded(points, step)
        if order:
            piecewise = piecewise.antiderivative(order)
        powers = piecewise.c[::-1]
        values[:, column : column + len(powers)] = powers.T
    for column, points in ((SQUARE, square), (FRICTION, friction), (BLEND, blend)):
        values[:, column] = points
        values[:-1, column + 1] = np.diff(points) / step
    values[:, CURVED] = _near(values[:, [*range(THETA + 2, THETA + 6), *range(CANT, CANT + 4)]], step)
    slopes = [*range(THETA + 3, THETA + 6), *range(CANT + 1, CANT + 4), SQUARE + 1, FRICTION + 1, BLEND + 1]
    values[:, STEADY] = _steady(_near(values[:, slopes], step))
    return LineTable(start, step, values, math.sqrt(np.min(square)), math.sqrt(np.max(square)))


def _near(values: Array, step: float) -> Array:
    """1 for nodes (rows) within `MARGIN` of one where any value is not 0, else 0."""
    near = math.ceil(MARGIN / step)
    found = np.any(values != 0.0, axis=1)
    return np.asarray(np.convolve(np.pad(found, near), np.ones(2 * near + 1), mode="valid") > 0.0)


def _steady(changing: Array) -> Array:
    """The column `STEADY`, of the nodes where something changes."""
    before = np.concatenate(([True], changing[:-1] != 0.0))
    first = np.where((changing == 0.0) & before, np.arange(1, len(changing) + 1), 0)
    return np.where(changing == 0.0, np.maximum.accumulate(first), 0)


def _rounded(points: Array, step: float) -> PPoly:
    """Cubic B-spline with control points at equidistant nodes, as polynomials between these nodes."""
    padded = np.pad(points, (3, 3), mode="edge")
    knots = step * np.arange(-5.0, len(points) + 5.0)
    spline = BSpline(knots, padded, 3)
    whole = PPoly.from_spline(spline)
    first, last = np.searchsorted(whole.x, [-0.5 * step, (len(points) - 0.5) * step])
    return PPoly(whole.c[:, first:last], whole.x[first : last + 1])


def body_arrays(body: Multibody) -> tuple[Array, Column]:
    """What a line needs to know of the bodies, wheelsets first: `Plant.body` and `Plant.body_column`.

    Returns
    -------
    ndarray, shape (BODY_ROWS * bodies,), and ndarray of uint32, shape (4 * bodies,)
        Columns of y, z, roll and yaw of each body.

    Raises
    ------
    ConfigError
        A body that cannot move laterally, vertically, in roll and in yaw.
    """
    wheelsets = [i for i in body.instances.values() if i.body.role == "wheelset"]
    wheelsets.sort(key=lambda i: int(np.argmin(np.abs(body.wheelset_x - i.position[0]))))
    others = [i for i in body.instances.values() if i.body.role not in ("wheelset", "hinged")]
    found, columns = np.zeros((BODY_ROWS, len(wheelsets) + len(others))), []
    rigid = np.zeros(body.n)
    for each in (*wheelsets, *others):
        if not {"y", "z", "roll", "yaw"} <= each.columns.keys():
            raise ConfigError(
                f"body '{each.body.name}': a line needs its lateral, vertical, roll and yaw motion"
            )
        columns += [each.columns[name] for name in ("y", "z", "roll", "yaw")]
        rigid[each.columns["y"]], rigid[each.columns["roll"]] = -each.position[2], 1.0
    # Static forces of the springs lean with the body's frame: what the stiffness has for a roll of the whole.
    leaning = body.stiffness @ rigid
    for k, each in enumerate((*wheelsets, *others)):
        spin = each.body.inertia[1] if k < len(wheelsets) else 0.0
        found[:, k] = each.position[0], each.position[2], leaning[each.columns["y"]], spin
    return found.ravel(), np.array(columns, dtype=np.uint32)


@kernel(inline=True, allocates=False)
def speed_of(lanes: Lanes, k: int, plant: Plant, work: Work) -> float:
    """Present speed of vehicle k (m/s)."""
    if plant.line.shape[0] > 0:
        return float(work.wheel[at.WHEEL_SPEED * LANES * len(lanes) + k])
    return float(plant.number[at.SPEED * len(lanes) + k])


@kernel(inline=True, allocates=False)
def _node(number: Array, w: int, k: int, s: float) -> tuple[int, float]:
    """Place of the first number of a position's node in `Plant.line`, and distance from the node (m)."""
    count = number[at.LINE_COUNT * w + k]
    u = (s - number[at.LINE_START * w + k]) * number[at.PER_LINE_STEP * w + k]
    u = u if u > 0.0 else 0.0
    u = u if u < count else count
    i = min(int(u), int(count) - 1)
    return int(number[at.LINE_BASE * w + k]) + COLUMNS * i, (u - i) / number[at.PER_LINE_STEP * w + k]


@kernel(inline=True, allocates=False)
def _bend(line: Array, p: int, t: float) -> tuple[float, float, float, float]:
    """Theta, Theta', Theta'' = kappa and kappa' of a node's polynomial."""
    c0, c1, c2 = line[p + THETA], line[p + THETA + 1], line[p + THETA + 2]
    c3, c4, c5 = line[p + THETA + 3], line[p + THETA + 4], line[p + THETA + 5]
    return (
        c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
        c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
        2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5),
    )


@kernel(inline=True, allocates=False)
def _lean(line: Array, p: int, t: float) -> tuple[float, float, float]:
    """Cant angle and its two derivatives over distance."""
    c0, c1, c2, c3 = line[p + CANT], line[p + CANT + 1], line[p + CANT + 2], line[p + CANT + 3]
    return (
        c0 + t * (c1 + t * (c2 + t * c3)),
        c1 + t * (2.0 * c2 + t * 3.0 * c3),
        2.0 * c2 + t * 6.0 * c3,
    )


@kernel(inline=True, allocates=False)
def follow(lanes: Lanes, plant: Plant, clock: Array, work: Work, count: int, first: bool) -> None:
    """Take speed, friction, loads and offsets at the vehicles' places on their lines for so many steps.

    Where nothing changes they are looked up once, unless this is the first sample of a call, and always at
    one place: when that happened leaves no trace in the results.
    """
    w = len(lanes)
    look, held = first, 4 * plant.load.shape[0] + HELD * w
    for k in range(w):
        p, _ = _node(plant.number, w, k, clock[w + k])
        steady = plant.line[p + STEADY]
        look = look or steady == 0.0 or steady != work.line[held + k]
    if look:
        _look_up(lanes, plant, clock, work, 0.5 * (count + 1) * plant.number[at.STEP * w], first)


@kernel(inline=True, allocates=False)
def curved(lanes: Lanes, work: Work) -> bool:
    """Whether any of the vehicles is in a curve or on a cant."""
    return bool(work.line[work.line.shape[0] - 3 * len(lanes)] != 0.0)


@kernel(inline=True, allocates=False)
def faster(lanes: Lanes, work: Work) -> bool:
    """Whether any of the vehicles runs at another speed than its plant's."""
    return bool(work.line[work.line.shape[0] - 2 * len(lanes)] != 0.0)


@kernel(inline=True, allocates=False)
def between(lanes: Lanes, work: Work) -> bool:
    """Whether any wheel stands on a rail between two of its shapes."""
    return bool(work.line[work.line.shape[0] - len(lanes)] != 0.0)


@kernel(inline=True, allocates=False)
def _begin(lanes: Lanes, plant: Plant, work: Work, first: bool) -> None:
    """Give `Work.wheel` and `Work.line` what holds without a line, where this is not there from before.

    Off a curve nobody reads the offsets and accelerations, and in one all that are not 0 are written.
    """
    rows, n = LANES * len(lanes), plant.load.shape[0]
    for i in range(plant.wheel.shape[0] if first else 0):
        work.wheel[i] = plant.wheel[i]
    for i in range(at.TABLE_BASE * rows, (at.TABLE_BASE + 1) * rows):
        work.wheel[i] = plant.wheel[i]
    for i in range(n):
        work.line[i] = plant.load[i]
    for i in range(n if first else 4 * n, work.line.shape[0]):
        work.line[i] = 0.0


@kernel(allocates=False)
def _look_up(lanes: Lanes, plant: Plant, clock: Array, work: Work, ahead: float, first: bool) -> None:
    """Fill `Work.wheel` and `Work.line` with what holds a time (s) ahead: at the mean of the steps' ends."""
    w = len(lanes)
    n = plant.load.shape[0]
    rows = LANES * w
    centre, mixed = 4 * n, work.line.shape[0] - w
    bent, other = mixed - 2 * w, mixed - w
    _begin(lanes, plant, work, first)
    for k in range(w):
        s = clock[w + k]
        p, t = _node(plant.number, w, k, s)
        steady = plant.line[p + STEADY]
        if steady != 0.0:
            s = plant.number[at.LINE_START * w + k] + (steady - 0.5) / plant.number[at.PER_LINE_STEP * w + k]
        else:
            s += ahead * math.sqrt(plant.line[p + SQUARE] + t * plant.line[p + SQUARE + 1])
        p, t = _node(plant.number, w, k, s)
        work.line[centre + PLACE * w + k], work.line[centre + HELD * w + k] = s, steady
        work.line[centre + INSIDE * w + k] = plant.line[p + CURVED]
        speed = math.sqrt(plant.line[p + SQUARE] + t * plant.line[p + SQUARE + 1])
        work.line[other] = 1.0 if speed != plant.number[at.SPEED * w + k] else work.line[other]
        work.line[bent] = 1.0 if plant.line[p + CURVED] != 0.0 else work.line[bent]
        for i in range(LANES if speed != work.wheel[at.WHEEL_SPEED * rows + k] else 0):
            work.wheel[at.WHEEL_SPEED * rows + i * w + k] = speed
            work.wheel[at.PER_SPEED * rows + i * w + k] = 1.0 / speed
        last_shape = plant.number[at.SHAPES * w + k] - 1.0
        for j in range(plant.wheelset_x.shape[0] // w):
            q, u = _node(plant.number, w, k, s + plant.wheelset_x[j * w + k])
            friction = plant.line[q + FRICTION] + u * plant.line[q + FRICTION + 1]
            for i in (j * w + k, (WHEELSETS + j) * w + k):
                work.wheel[at.FRICTION * rows + i] = friction
            if last_shape > 0.0:
                shape = last_shape * (plant.line[q + BLEND] + u * plant.line[q + BLEND + 1])
                for i in (j * w + k, (WHEELSETS + j) * w + k):
                    work.wheel[at.SHAPE * rows + i] = shape
                    size = (plant.wheel[at.TABLE_LAST * rows + i] + 2.0) * geometry.WIDTH
                    work.wheel[at.TABLE_BASE * rows + i] += math.floor(shape) * size
                work.line[mixed] = 1.0 if shape != math.floor(shape) else work.line[mixed]
    if work.line[bent] != 0.0:
        _enter(
            lanes,
            plant.number,
            plant.line,
            plant.body,
            plant.body_column,
            plant.mass,
            plant.damping_diagonal,
            work.wheel,
            ahead,
            work.line[centre:],
            work.lane_in,  # scratch until the contact
            work.line[:centre],
        )


@kernel(inline=True, allocates=False)
def _put_down(lanes: Lanes, y: int, vertical: int, roll: int, yaw: int, effects: Array, out: Array) -> None:
    """Take what a line does to a body to the places of its unknowns in `Work.line`."""
    w, n = len(lanes), out.shape[0] // 4
    for k in range(w):
        out[y + k] += effects[LOAD_Y * w + k]
        out[vertical + k] -= effects[LOAD_Z * w + k]
        out[roll + k] += effects[LOAD_ROLL * w + k]
        out[yaw + k] -= effects[LOAD_YAW * w + k]
        out[n + y + k] = effects[OFFSET_Y * w + k]
        out[n + roll + k] = effects[OFFSET_ROLL * w + k]
        out[n + yaw + k] = effects[OFFSET_YAW * w + k]
        out[2 * n + y + k] = effects[RATE_Y * w + k]
        out[2 * n + roll + k] = effects[RATE_ROLL * w + k]
        out[2 * n + yaw + k] = effects[RATE_YAW * w + k]
        out[3 * n + y + k] = effects[FALL_Y * w + k]
        out[3 * n + vertical + k] = effects[FALL_Z * w + k]
        out[3 * n + roll + k] = effects[FALL_ROLL * w + k]
        out[3 * n + yaw + k] = effects[FALL_YAW * w + k]


@kernel(distinct=True, allocates=False)
def _enter(
    lanes: Lanes,
    number: Array,
    line: Array,
    body: Array,
    column: Column,
    mass: Array,
    diagonal: Array,
    wheel: Array,
    ahead: float,
    centre: Array,
    effects: Array,
    out: Array,
) -> None:
    """Loads of all bodies of all vehicles, and offsets a time (s) before, into their part of `Work.line`.

    `centre` is the part behind it. A loop over the vehicles becomes vector instructions only where the
    compiler sees that what it reads and writes does not overlap: so each body's numbers go through `effects`.
    """
    w, width = len(lanes), number.shape[0] // at.NUMBERS  # the same, of which the compiler knows one
    rows, bodies = LANES * w, body.shape[0] // (BODY_ROWS * w)
    for k in range(width):
        p, t = _node(number, w, k, centre[PLACE * w + k])
        theta, angle, kappa, _ = _bend(line, p, t)
        cant, twist, _ = _lean(line, p, t)
        centre[CENTRE_THETA * w + k], centre[CENTRE_ANGLE * w + k] = theta, angle
        centre[CENTRE_KAPPA * w + k] = kappa
        centre[CENTRE_CANT * w + k], centre[CENTRE_TWIST * w + k] = cant, twist
    for b in range(bodies):
        y, vertical = int(column[4 * b]) * w, int(column[4 * b + 1]) * w
        roll, yaw = int(column[4 * b + 2]) * w, int(column[4 * b + 3]) * w
        for k in range(width):
            speed = wheel[at.WHEEL_SPEED * rows + k]
            square, spin = speed * speed, speed * wheel[at.PER_RADIUS * rows + k]
            x, z = body[(X * bodies + b) * w + k], body[(HEIGHT * bodies + b) * w + k]
            theta_0, angle_0 = centre[CENTRE_THETA * w + k], centre[CENTRE_ANGLE * w + k]
            kappa_0 = centre[CENTRE_KAPPA * w + k]
            cant_0, twist_0 = centre[CENTRE_CANT * w + k], centre[CENTRE_TWIST * w + k]
            # Rounding shall leave no offsets on the straight, and no rates where they do not change.
            inside = centre[INSIDE * w + k]
            passing = speed if centre[HELD * w + k] == 0.0 else 0.0
            p, t = _node(number, w, k, centre[PLACE * w + k] + x)
            theta, angle, kappa, kappa_slope = _bend(line, p, t)
            cant, twist, twist_slope = _lean(line, p, t)
            aside, turned, rolled = theta - theta_0 - angle_0 * x, angle - angle_0, cant - cant_0
            aside, turned, rolled = inside * aside, inside * turned, inside * rolled
            roll_rate, yaw_rate = passing * (twist - twist_0), passing * (kappa - kappa_0)
            shift_rate = passing * (turned - kappa_0 * x) - z * roll_rate
            accelerated_y = (
                square * kappa * (1.0 - 0.5 * cant * cant)
                + GRAVITY * cant * (1.0 - cant * cant / 6.0)
                - z * square * twist_slope
            )
            accelerated_z = -square * kappa * cant - 0.5 * GRAVITY * cant * cant
            momentum = body[(SPIN * bodies + b) * w + k] * spin
            carried = body[(CARRIED * bodies + b) * w + k] * rolled
            effects[LOAD_Y * w + k] = carried - mass[y + k] * accelerated_y - diagonal[y + k] * shift_rate
            effects[LOAD_Z * w + k] = mass[vertical + k] * accelerated_z
            effects[LOAD_ROLL * w + k] = (
                momentum * speed * kappa_0
                - mass[roll + k] * square * twist_slope
                - diagonal[roll + k] * roll_rate
            )
            effects[LOAD_YAW * w + k] = (
                momentum * speed * twist_0
                + mass[yaw + k] * square * kappa_slope
                + diagonal[yaw + k] * yaw_rate
            )
            effects[OFFSET_Y * w + k] = aside - z * rolled - ahead * shift_rate
            effects[OFFSET_ROLL * w + k] = rolled - ahead * roll_rate
            effects[OFFSET_YAW * w + k] = turned - ahead * yaw_rate
            effects[RATE_Y * w + k], effects[RATE_ROLL * w + k] = shift_rate, roll_rate
            effects[RATE_YAW * w + k] = yaw_rate
            effects[FALL_Y * w + k], effects[FALL_Z * w + k] = accelerated_y, accelerated_z
            effects[FALL_ROLL * w + k] = square * twist_slope
            effects[FALL_YAW * w + k] = square * kappa_slope
        _put_down(lanes, y, vertical, roll, yaw, effects, out)


@kernel(inline=True, allocates=False)
def turn(lanes: Lanes, plant: Plant, work: Work) -> None:
    """Give the contacts the wheelsets' motion against their own places on the line, in `Work.y`.

    What the spin of the wheelsets does at another speed than the plant's is added to the forces: their matrix
    is that of the plant's speed.
    """
    w = len(lanes)
    n, bodies = plant.load.shape[0], plant.body.shape[0] // (BODY_ROWS * w)
    block, rows = WHEELSETS * w, LANES * w
    for j in range(plant.wheelset_x.shape[0] // w if faster(lanes, work) else 0):
        for k in range(w):
            over = work.wheel[at.WHEEL_SPEED * rows + k] - plant.number[at.SPEED * w + k]
            momentum = plant.body[(SPIN * bodies + j) * w + k] * over
            momentum *= plant.wheel[at.PER_RADIUS * rows + k]
            roll, yaw = int(plant.body_column[4 * j + 2]) * w + k, int(plant.body_column[4 * j + 3]) * w + k
            work.f[roll] += momentum * work.y[at.M_YAW_RATE * block + j * w + k]
            work.f[yaw] -= momentum * work.y[at.M_ROLL_RATE * block + j * w + k]
    for j in range(plant.wheelset_x.shape[0] // w if curved(lanes, work) else 0):
        for k in range(w):
            y, roll = int(plant.body_column[4 * j]) * w + k, int(plant.body_column[4 * j + 2]) * w + k
            yaw, place = int(plant.body_column[4 * j + 3]) * w + k, j * w + k
            radius, speed = plant.wheel[at.RADIUS * rows + k], work.wheel[at.WHEEL_SPEED * rows + k]
            rolled, roll_rate = work.line[n + roll], work.line[2 * n + roll]
            work.y[at.M_OFFSET * block + place] -= work.line[n + y] + radius * rolled
            work.y[at.M_ROLL * block + place] -= rolled
            work.y[at.M_YAW * block + place] -= work.line[n + yaw]
            work.y[at.M_BOTTOM * block + place] -= work.line[2 * n + y] + radius * roll_rate
            work.y[at.M_ROLL_RATE * block + place] -= roll_rate
            work.y[at.M_YAW_RATE * block + place] += speed * work.line[4 * n + CENTRE_KAPPA * w + k]


@kernel(inline=True, allocates=False)
def blend(lanes: Lanes, plant: Plant, work: Work) -> None:
    """Make the two nodes of the contact table between which each wheel stands, for the shape of its rail.

    `Work.wheel` then points to where a table with these nodes would begin, so that the contact reads them as
    it reads a table. On a whole shape they are its own.
    """
    w = len(lanes)
    rows, width = LANES * w, geometry.WIDTH
    for i in range(rows):
        k = i % w
        last = plant.wheel[at.TABLE_LAST * rows + i]
        start, per_step = plant.wheel[at.TABLE_START * rows + i], plant.wheel[at.PER_TABLE_STEP * rows + i]
        place = (work.lane_in[at.SHIFT * rows + i] - start) * per_step
        place = place if place > 0.0 else 0.0
        node = int(place if place < last else last)
        shape = work.wheel[at.SHAPE * rows + i]
        lower = min(int(shape), max(int(plant.number[at.SHAPES * w + k]) - 2, 0))
        share = shape - lower
        size = (int(last) + 2) * width
        p = int(plant.wheel[at.TABLE_BASE * rows + i]) + lower * size + node * width
        q, target = p + size, 2 * width * i
        for c in range(2 * width):
            work.shape[target + c] = (1.0 - share) * plant.table[p + c] + share * plant.table[q + c]
        work.wheel[at.TABLE_BASE * rows + i] = target - node * width
