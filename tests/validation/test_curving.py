"""Curves, cant and changing speed against closed forms and against equations in an inertial frame.

Axes: y to the left, z up; a left curve has kappa > 0 and, banked, a cant angle phi < 0. A wheelset that lies
outwards in a left curve has y < 0.

Sources: Newland, Steering a flexible railway truck on curved track, J. Eng. Ind. 91 (1969) 908-918; Boocock,
Steady-state motion of railway vehicles on curved track, J. Mech. Eng. Sci. 11 (1969) 556-566; Wickens,
Fundamentals of Rail Vehicle Dynamics (2003), chapters 2 (conicity, gyroscopic moments) and 5 (steering, shear
and bending stiffness of a bogie).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from sayd_env.config import validate
from sayd_env.config.loader import parse_yaml
from sayd_env.config.profile import RailProfileConfig, WheelProfileConfig
from sayd_env.config.scenario import load_scenario
from sayd_env.config.track import NoIrregularityConfig
from sayd_env.config.units import GRAVITY, Array
from sayd_env.config.vehicle import VehicleConfig
from sayd_env.physics import plant as at
from sayd_env.physics import step as kernels
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.line import GRID_STEP, LineTable, tabulated
from sayd_env.physics.simulator import Simulator, Telemetry, VehicleModel
from sayd_env.physics.track.realisation import realise

RADIUS, HALF_BASE = 0.46, 1.25  # of the wheels and of the bogie's wheelbase, m
RAIL_RADIUS = 0.08
EVEN = realise(NoIrregularityConfig(type="none"), 3000.0, 0)

WHEELSET = """
name: wheelset
wheel_radius: 0.46
measuring_height: 0.46
speed_range: [1.0, 80.0]
bodies:
  - {name: wheelset, role: wheelset, mass: 1500.0, inertia: [750.0, 110.0, 750.0], position: [0.0, 0.0, 0.46]}
elements:
  - name: speed_hold
    type: bush
    a: {body: ground, at: [0.0, 0.0, 0.46]}
    b: {body: wheelset, at: [0.0, 0.0, 0.46]}
    stiffness: [1.0e3, 0.0, 0.0]
    damping: [1.0e3, 0.0, 0.0]
"""
BOGIE = """
name: bogie
wheel_radius: 0.46
measuring_height: 0.46
speed_range: [1.0, 80.0]
sets:
  axle: {{leading: {{origin: [1.25, 0.0, 0.0]}}, trailing: {{origin: [-1.25, 0.0, 0.0]}}}}
  side: {{left: {{}}, right: {{sign: [1, -1, 1]}}}}
bodies:
  - name: frame
    role: frame
    mass: 2500.0
    inertia: [2000.0, 1400.0, 2500.0]
    position: [0.0, 0.0, 0.46]
  - name: wheelset
    role: wheelset
    per: [axle]
    mass: 1500.0
    inertia: [750.0, 110.0, 750.0]
    position: [0.0, 0.0, 0.46]
elements:
  - name: primary
    type: bush
    per: [axle, side]
    a: {{body: frame, at: [0.0, 1.0, 0.46]}}
    b: {{body: wheelset, at: [0.0, 1.0, 0.46]}}
    stiffness: [{along}, {across}, 1.0e6]
    damping: [{damping}, {damping}, 1.0e4]
    carries_weight: true
"""
SPEED_HOLD = """
  - name: speed_hold
    type: bush
    a: {body: ground, at: [0.0, 0.0, 0.46]}
    b: {body: frame, at: [0.0, 0.0, 0.46]}
    stiffness: [1.0e3, 0.0, 0.0]
    damping: [1.0e3, 0.0, 0.0]
"""
WHEEL = """
kind: wheel
name: cone
back_to_back: 1.360
tape_to_back: 0.070
shape:
  zones:
    - {{type: line, start: -60.0, end: -30.0, offset: {flange}, slope: -0.4}}
    - {{type: line, start: -30.0, end: 45.0, offset: 0.0, slope: -{conicity}}}
"""
RAIL = """
kind: rail
name: arc
cant: 0.0
gauge_depth: 0.005
shape:
  zones: [{type: arc, start: -40.0, end: 40.0, centre_y: 0.0, centre_z: -80.0, radius: 80.0, side: upper}]
"""
RIGID = ("track.section.lateral_stiffness=1e9", "track.section.vertical_stiffness=1e9")


def conical(vehicle: str, conicity: float = 0.05) -> VehicleModel:
    """A vehicle with conical wheels on a rigid track."""
    wheel = WHEEL.format(conicity=conicity, flange=30.0 * conicity - 12.0)
    overrides = ["wear=0.0", "track=smooth", *RIGID, "track.section.lateral_damping=3.5e5"]
    return VehicleModel(
        load_scenario("estimates", overrides).model_copy(
            update={
                "vehicle": validate(VehicleConfig, parse_yaml(vehicle, "vehicle"), "vehicle"),
                "wheel": validate(WheelProfileConfig, parse_yaml(wheel, "wheel"), "wheel"),
                "rail": validate(RailProfileConfig, parse_yaml(RAIL, "rail"), "rail"),
            }
        )
    )


def line(
    curvature: float,
    cant: float,
    speed: float | Callable[[Array], Array],
    *,
    begin: float = 0.0,
    transition: float = 0.0,
    friction: float = 0.3,
    step: float = GRID_STEP,
) -> LineTable:
    """A transition into a curve (1/m) at a cant angle (rad); without a transition only the curve."""
    x = np.arange(-100.0, 3000.0, step)
    share = np.clip((x - begin) / transition, 0.0, 1.0) if transition else np.ones_like(x)
    square = (speed(x) if callable(speed) else speed * np.ones_like(x)) ** 2
    even = np.ones_like(x)
    return tabulated(-100.0, share * curvature, share * cant, square, friction * even, 0.0 * even, step)


def balancing(curvature: float, speed: float) -> float:
    """Cant angle (rad) at which no lateral force remains."""
    return -float(np.arctan(speed**2 * curvature / GRAVITY))


def settled(model: VehicleModel, where: LineTable, distance: float) -> tuple[dict[str, float], Telemetry]:
    """Mean displacements over the last second of a run by their names, and the signals of that second."""
    simulator = Simulator(model, where.slowest, track=EVEN, line=where)
    simulator.advance(int(distance / where.slowest * 1000.0))
    end = simulator.advance(1000, motion=True, wheels=True)
    return dict(zip(model.multibody.dof_names, end.motion.mean(axis=0), strict=True)), end


def half_distance(model: VehicleModel) -> float:
    """Half the distance of a wheelset's contacts in its middle position (m)."""
    return float(np.interp(0.0, model.table.dy, model.table.y_c))


def effective_conicity(model: VehicleModel, cone: float) -> float:
    """Of conical wheels on round rails, for the lateral displacement of the axle (Wickens, section 2.4).

    The wheelset rolls as it shifts, which moves its contacts on the rails and its lowest points to the side.
    """
    s = half_distance(model)
    return cone * (s + RAIL_RADIUS * cone) / (s - RADIUS * cone)


@pytest.mark.parametrize("cone", [0.05, 0.1])
@pytest.mark.parametrize("curvature", [1 / 2000, -1 / 2000])
def test_free_wheelset_follows_the_rolling_line(cone: float, curvature: float) -> None:
    """A free wheelset rolls about y_0 = -r_0 s kappa / gamma, where its wheels' radii fit the rails' lengths.

    Set on a curve in the track's middle it does not settle there: it runs in Klingel's wave about it,
    y = y_0 (1 - cos(2 pi x / L)), with the amplitude y_0.
    """
    speed, model = 2.0, conical(WHEELSET, cone)
    s, conicity = half_distance(model), effective_conicity(model, cone)
    rolling_line = -RADIUS * s * curvature / conicity
    wave = 2.0 * np.pi * np.sqrt(s * RADIUS / cone)
    where = line(curvature, balancing(curvature, speed), speed, friction=1.0)
    simulator = Simulator(model, speed, track=EVEN, line=where)
    telemetry = simulator.advance(int(3.0 * wave / speed * 1000.0), motion=True)
    y, x = telemetry.motion[:, model.multibody.wheelset_dofs[0, 1]], telemetry.time * speed
    assert np.mean(y) == pytest.approx(rolling_line, rel=0.005)
    expected = rolling_line * (1.0 - np.cos(2.0 * np.pi * x / wave))
    assert np.max(np.abs(y - expected)) < 0.1 * abs(rolling_line)


@pytest.mark.parametrize(("along", "across", "damping"), [(2e7, 2e7, 1e5), (5e6, 5e6, 2e4), (5e5, 2e6, 2e4)])
@pytest.mark.parametrize("cone", [0.05, 0.1])
def test_bogie_in_a_curve(along: float, across: float, damping: float, cone: float) -> None:
    """Steady curving of a two-axle bogie between rigid and flexible, at its balancing cant.

    Linear creep, half wheelbase h, springs that hold each wheelset to the frame with k_psi in yaw and k_y
    laterally. Wheelset i has the lateral creep force 2 f_22 psi_i and the yaw moment
    -2 f_11 s (s kappa + gamma y_i / r_0), with y_i and psi_i against the track at its own place; the frame
    sees it turned by +- h kappa more. Equilibrium of all three bodies gives psi_1 = -psi_2 = theta:

        theta = -h kappa / (1 + 4 f_11 f_22 s gamma / (r_0 k_s k_psi)),    1 / k_s = 1 / k_y + h^2 / k_psi
        y_1 - y_2 = 4 f_22 theta / k_s
        (y_1 + y_2) / 2 = -(r_0 / gamma) (s kappa - h theta f_22 / (f_11 s))

    k_s is Wickens' shear stiffness and k_psi his bending stiffness. Without bending stiffness both wheelsets
    are radial on the rolling line; the rigid bogie has theta = -h kappa and Newland's
    y = -r_0 (s^2 + h^2 f_22 / f_11) kappa / (gamma s). Friction is high, so that creep stays linear; spin
    creep and the stiffness of gravity, which the formulas leave out, are of the order of a per cent.
    """
    speed, curvature = 10.0, 1 / 20000
    model = conical(BOGIE.format(along=along, across=across, damping=damping) + SPEED_HOLD, cone)
    table, node = model.table, int(np.argmin(np.abs(model.table.dy)))
    patch = table.a_s[node] * table.b_s[node] * float(model.multibody.wheel_load[0]) ** (2.0 / 3.0)
    f_11, f_22 = (model.scenario.contact.shear_modulus * patch * c[node] for c in (table.c11, table.c22))
    s, conicity, h = half_distance(model), effective_conicity(model, cone), HALF_BASE
    bending, lateral = 2.0 * along * 1.0**2, 2.0 * across
    shear = 1.0 / (1.0 / lateral + h**2 / bending)
    theta = -h * curvature / (1.0 + 4.0 * f_11 * f_22 * s * conicity / (RADIUS * shear * bending))
    mean = -RADIUS / conicity * (s * curvature - h * theta * f_22 / (f_11 * s))

    where = line(curvature, balancing(curvature, speed), speed, begin=50.0, transition=300.0, friction=20.0)
    q, _ = settled(model, where, 900.0)
    y = [q[f"wheelset.{name}.y"] for name in ("leading", "trailing")]
    yaw = [q[f"wheelset.{name}.yaw"] for name in ("leading", "trailing")]
    assert 0.5 * (yaw[0] - yaw[1]) == pytest.approx(theta, rel=0.01, abs=0.003 * h * curvature)
    assert 0.5 * (yaw[0] + yaw[1]) == pytest.approx(0.0, abs=0.02 * abs(theta))
    assert 0.5 * (y[0] + y[1]) == pytest.approx(mean, rel=0.015)
    assert y[0] - y[1] == pytest.approx(4.0 * f_22 * theta / shear, rel=0.02, abs=2e-3 * abs(mean))


MANCHESTER = VehicleModel(load_scenario("manchester", ["track=smooth", *RIGID]))
"""On a rigid track: with the numbers of its file, its equilibrium is a calculation by hand."""
CAR, FRAMES, WHEELSETS = 32000.0, 2 * 2615.0, 4 * 1813.0  # masses, kg
CAR_HEIGHT, FRAME_HEIGHT, SECONDARY, PRIMARY = 1.8, 0.6, 0.8275, 0.46  # of centres and springs' middles, m


def hand_calculation(excess: float, tilted: float = 0.0) -> dict[str, float]:
    """Equilibrium of the Manchester vehicle under a lateral acceleration (m/s2), all outwards.

    Car on frames on wheelsets, which are `tilted` (rad); unknown are the rolls and the shears of both stages.
    A spring's vertical force leans with the mean roll of its ends, and half of its moment over the shear goes
    to each of them.
    """
    roll_2 = 4 * 4.3e5 * 1.0**2 + 4 * 1.05e4 + 2 * 0.94e6  # springs, their bending, anti-roll bars, N m/rad
    roll_1, shear_2, shear_1 = 8 * 1.22e6 * 1.0**2, 4 * 1.6e5, 8 * 3.884e6
    upper, lower = CAR_HEIGHT - SECONDARY, SECONDARY - PRIMARY
    weight_2, weight_1 = CAR * GRAVITY, (CAR + FRAMES) * GRAVITY
    frame_arm = FRAME_HEIGHT - PRIMARY
    matrix = [  # car roll, frame roll, secondary shear, primary shear
        [-0.5 * weight_2, -0.5 * weight_2, shear_2, 0.0],
        [roll_2 - weight_2 * upper, -roll_2, -0.5 * weight_2, 0.0],
        [0.0, -0.5 * weight_1, 0.0, shear_1],
        [
            -weight_2 * upper,
            roll_1 - FRAMES * GRAVITY * frame_arm - weight_2 * lower,
            -weight_2,
            -0.5 * weight_1,
        ],
    ]
    load = [
        CAR * excess,
        CAR * excess * upper,
        (CAR + FRAMES) * excess + 0.5 * weight_1 * tilted,
        FRAMES * excess * frame_arm + CAR * excess * (CAR_HEIGHT - PRIMARY) + roll_1 * tilted,
    ]
    car, frame, secondary, primary = np.linalg.solve(matrix, load)
    frame_shift = primary + frame_arm * frame
    car_shift = primary + lower * frame + secondary + upper * car
    moment = excess * (CAR * CAR_HEIGHT + FRAMES * FRAME_HEIGHT + WHEELSETS * RADIUS)
    moment += GRAVITY * (CAR * car_shift + FRAMES * frame_shift)
    return {"car": float(car), "frame": float(frame), "shift": float(car_shift), "moment": float(moment)}


def test_roll_and_wheel_loads_on_a_cant() -> None:
    """Roll of car and frames and wheel load shift on a straight canted track against the hand calculation."""
    cant = -0.04
    q, end = settled(MANCHESTER, line(0.0, cant, 30.0, begin=100.0, transition=200.0), 1200.0)
    inwards = GRAVITY * cant  # the vehicle leans to the right, where the track is lower for a positive angle
    by_hand = hand_calculation(inwards)
    assert q["carbody.roll"] == pytest.approx(by_hand["car"], rel=5e-3)
    assert q["frame.front.roll"] == pytest.approx(by_hand["frame"], rel=5e-3)
    below = np.mean(
        [value for name, value in q.items() if name.startswith("wheelset") and name.endswith(".y")]
    )
    assert q["carbody.y"] - below == pytest.approx(-by_hand["shift"], rel=5e-3)
    load = end.wheel_vertical.mean(axis=0)
    moved = np.sum(load[1::2] - load[::2]) * half_distance(MANCHESTER)
    assert moved == pytest.approx(by_hand["moment"], rel=0.01)
    weight = MANCHESTER.multibody.total_mass * GRAVITY
    assert np.sum(load) == pytest.approx(weight * np.cos(cant), rel=1e-5)
    assert np.sum(end.track_shift[-1]) == pytest.approx(-weight * np.sin(cant), rel=1e-4)


@pytest.mark.parametrize("excess", [0.0, 0.35, -0.35])
def test_roll_and_forces_in_a_curve(excess: float) -> None:
    """The same in curves at a cant deficiency, a cant excess and at balance: there only steering is left.

    Track shift forces add up to the mass times what cant leaves of the centrifugal acceleration, the wheel
    loads to the mass times the rest of the resultant. On their way outwards the wheelsets climb, and the
    vehicle tilts with them.
    """
    speed, curvature = 30.0, 1 / 2000
    cant = -np.arctan2(speed**2 * curvature, GRAVITY) + excess / GRAVITY
    q, end = settled(MANCHESTER, line(curvature, cant, speed, begin=100.0, transition=200.0), 1500.0)
    felt = speed**2 * curvature * np.cos(cant) + GRAVITY * np.sin(cant)
    places = [f"wheelset.{bogie}.{axle}" for bogie in ("front", "rear") for axle in ("leading", "trailing")]
    tilted = float(np.mean([q[f"{place}.roll"] for place in places]))
    by_hand = hand_calculation(felt, tilted)
    assert q["carbody.roll"] == pytest.approx(by_hand["car"], rel=5e-3, abs=5e-6)
    assert q["frame.front.roll"] == pytest.approx(by_hand["frame"], rel=5e-3, abs=5e-6)
    mass = MANCHESTER.multibody.total_mass
    assert np.sum(end.track_shift[-1]) == pytest.approx(-mass * felt, rel=1e-4, abs=1.0)
    down = GRAVITY * np.cos(cant) - speed**2 * curvature * np.sin(cant)
    assert np.sum(end.wheel_vertical[-1]) == pytest.approx(mass * down, rel=1e-5)
    # Accelerometers in the frames feel it too, and nothing at balance.
    assert end.acceleration[-1] == pytest.approx(felt, rel=1e-3, abs=1e-6)


SPRINGY = BOGIE.format(along=1.0e6, across=1.0e6, damping=1.0e4)
WAVE, BEND, BANK, FAST = 40.0, 1 / 1000, -0.05, 40.0


def bend(s: Array) -> Array:
    return BEND * np.sin(np.pi * np.maximum(s, 0.0) / WAVE) ** 2


def bank(s: Array) -> Array:
    return BANK * np.sin(np.pi * np.maximum(s, 0.0) / WAVE) ** 3


class Inertial:
    """The bogie of `SPRINGY` as three rigid bodies in an inertial frame, turning freely and by any angle.

    Wheels carry no lateral load and no moment: each wheelset is held up by its static load, which acts at its
    centre upwards from the canted track below it. Springs and dampers are the same in all directions.
    """

    x, masses = (0.0, HALF_BASE, -HALF_BASE), (2500.0, 1500.0, 1500.0)
    inertia = ((2000.0, 1400.0, 2500.0), (750.0, 110.0, 750.0), (750.0, 110.0, 750.0))
    stiffness, damping = 1.0e6, 1.0e4
    start = -3.0

    def __init__(self) -> None:
        s = np.linspace(-50.0, 100.0, 30001)
        self.heading = CubicSpline(s, bend(s)).antiderivative()
        self.east = CubicSpline(s, np.cos(self.heading(s))).antiderivative()
        self.north = CubicSpline(s, np.sin(self.heading(s))).antiderivative()

    def frame(self, s: float) -> tuple[Array, Array]:
        """Place of an axle's centre at s, and the axes of the track there as columns."""
        psi, phi = self.heading(s), bank(s)
        turned = np.array([[np.cos(psi), -np.sin(psi), 0.0], [np.sin(psi), np.cos(psi), 0.0], [0, 0, 1.0]])
        rolled = np.array([[1.0, 0, 0], [0, np.cos(phi), -np.sin(phi)], [0, np.sin(phi), np.cos(phi)]])
        axes = turned @ rolled
        return np.array([self.east(s), self.north(s), 0.0]) + RADIUS * axes[:, 2], axes

    def rates(self, t: float, state: Array) -> Array:
        """Newton and Euler."""
        z = state.reshape(3, 18)
        place, velocity, spin = z[:, :3], z[:, 3:6], z[:, 15:]
        axes = z[:, 6:15].reshape(3, 3, 3)
        force, moment = np.zeros((3, 3)), np.zeros((3, 3))
        carried = 0.5 * self.masses[0]
        for body in range(3):
            force[body, 2] = -self.masses[body] * GRAVITY
        for body in (1, 2):
            up = self.frame(self.start + FAST * t + self.x[body])[1][:, 2]
            force[body] += (carried + self.masses[body]) * GRAVITY * up
            axle = axes[body][:, 1]
            ahead = np.cross(axle, axes[0][:, 2])
            mean = axes[0][:, 2] + np.cross(ahead / np.linalg.norm(ahead), axle)
            preload = 0.5 * carried * GRAVITY * mean / np.linalg.norm(mean)
            for side in (1.0, -1.0):
                arm, other = axes[0] @ [self.x[body], side, 0.0], side * axle
                stretch = place[body] + other - place[0] - arm
                rate = velocity[body] + np.cross(spin[body], other) - velocity[0] - np.cross(spin[0], arm)
                pull = -self.stiffness * stretch - self.damping * rate - preload
                force[body] += pull
                force[0] -= pull
                couple = 0.5 * np.cross(stretch, pull)
                moment[body] += np.cross(other, pull) - couple
                moment[0] -= np.cross(arm, pull) + couple
        out = np.zeros((3, 18))
        out[:, :3] = velocity
        for body in range(3):
            tensor = axes[body] @ np.diag(self.inertia[body]) @ axes[body].T
            torque = moment[body] - np.cross(spin[body], tensor @ spin[body])
            out[body, 3:6], out[body, 15:] = force[body] / self.masses[body], np.linalg.solve(tensor, torque)
            out[body, 6:15] = np.cross(spin[body], axes[body].T).T.ravel()
        return out.ravel()

    def run(self, times: Array) -> tuple[Array, Array]:
        """Lateral displacement, roll and yaw, shape (3, 3, t).

        Of each body against the track at its own place; then of each against the bogie frame.
        """
        first = np.zeros((3, 18))
        for body in range(3):
            first[body, :3] = self.frame(self.start + self.x[body])[0]
            first[body, 3], first[body, 6:15] = FAST, np.eye(3).ravel()
        first[1:, 16] = FAST / RADIUS
        found = solve_ivp(
            self.rates, (0.0, times[-1]), first.ravel(), "DOP853", t_eval=times, rtol=1e-9, atol=1e-10
        ).y.reshape(3, 18, -1)
        own, joined = np.zeros((3, 3, len(times))), np.zeros((3, 3, len(times)))
        for i, t in enumerate(times):
            axes = found[:, 6:15, i].reshape(3, 3, 3)
            for body in range(3):
                centre, track = self.frame(self.start + FAST * t + self.x[body])
                apart, axle = track.T @ (found[body, :3, i] - centre), track.T @ axes[body][:, 1]
                own[body, :, i] = apart[1], axle[2], -axle[0]
                apart = axes[0].T @ (found[body, :3, i] - found[0, :3, i])
                axle = axes[0].T @ axes[body][:, 1]
                joined[body, :, i] = apart[1], axle[2], -axle[0]
        return own, joined


@pytest.fixture(scope="module")
def free_bogie() -> tuple[Array, Array, Array]:
    """Times, and what `Inertial.run` gives at them."""
    times = np.arange(0.02, 0.6, 0.02)
    return times, *Inertial().run(times)


@pytest.mark.parametrize("slowest", [FAST, 25.0])
def test_moving_frames_against_an_inertial_frame(
    free_bogie: tuple[Array, Array, Array], slowest: float
) -> None:
    """Inertia, leaning gravity, offsets of the bodies' frames and spinning wheelsets, all at once.

    The bogie flies on as it will while the track bends and banks below it: its motion against the track shows
    the frames' accelerations, and that of its wheelsets against its frame, a hundred times smaller, their
    offsets, the lean of the springs' static forces and the gyroscopic moments. Linearised equations are right
    to some 0.5 % of the largest value. On a line with a lower speed elsewhere, the matrices are those of it.
    """
    times, own, joined = free_bogie
    model = conical(SPRINGY)
    x = np.arange(-100.0, 200.0, 1.0)
    square = np.where(x < -50.0, slowest, FAST) ** 2
    where = tabulated(-100.0, bend(x), bank(x), square, np.ones_like(x), 0.0 * x, 1.0)
    simulator = Simulator(model, FAST, track=EVEN, line=where)
    simulator.plant.load[:] = 0.0  # the wheels' static load stays
    simulator.plant.wheel.reshape(at.WHEEL_ROWS, at.LANES)[at.APPROACH] = -1.0  # all wheels in the air
    simulator.state.clock[1] = Inertial.start
    step, n = simulator.plant.number[at.STEP], model.multibody.n
    bodies = [model.multibody.instances[name] for name in ("frame", "wheelset.leading", "wheelset.trailing")]
    columns = np.array([[each.columns[name] for name in ("y", "roll", "yaw")] for each in bodies])
    found, between = np.zeros_like(own), np.zeros_like(joined)
    for i in range(len(times)):
        for _ in range(round((times[i] - (times[i - 1] if i else 0.0)) / step)):
            kernels.step(simulator.plant, simulator.state, simulator.work)
        found[:, :, i] = simulator.state.q[columns]
        common = (simulator.state.q + simulator.work.line[n : 2 * n])[columns]
        between[:, :, i] = common - common[0]
        between[:, 0, i] -= np.array(Inertial.x) * common[0, 2]
    for k in range(3):
        assert np.max(np.abs(found[:, k] - own[:, k])) < 0.005 * np.max(np.abs(own[:, k]))
        assert np.max(np.abs(between[:, k] - joined[:, k])) < 0.01 * np.max(np.abs(joined[:, k]))


def test_transition_without_a_kick() -> None:
    """Where curvature and cant are continuous, forces are.

    The track shift forces of a bogie with centres of mass at height z add up to
    m (V^2 kappa + g phi - z V^2 phi''). No millisecond has a larger step than these have, but for the bogie's
    own swing; what is left of the ramps' kinks, rounded over a node's distance d, is m z V^3 phi' / d^2.
    """
    speed, curvature, transition = 20.0, 1 / 4000, 80.0
    cant = 0.5 * balancing(curvature, speed)
    model = conical(BOGIE.format(along=5e6, across=5e6, damping=2e4) + SPEED_HOLD, 0.1)
    mass = model.multibody.total_mass
    force = mass * (speed**2 * curvature + GRAVITY * cant)
    for step in (GRID_STEP, 0.5 * GRID_STEP, 0.25 * GRID_STEP):
        where = line(curvature, cant, speed, begin=50.0, transition=transition, friction=5.0, step=step)
        simulator = Simulator(model, speed, track=EVEN, line=where)
        total = simulator.advance(int(700.0 / speed * 1000.0)).track_shift.sum(axis=1)
        slope = speed * abs(force) / transition + mass * RADIUS * speed**3 * abs(cant) / transition / step**2
        assert np.max(np.abs(np.diff(total))) < 1.6e-3 * slope
        assert np.max(np.abs(np.diff(total, 2))) < 0.05 * np.max(np.abs(np.diff(total)))
        assert total[-1] == pytest.approx(-force, rel=1e-4)


def test_conditions_of_a_sample() -> None:
    """Conditions that hold for a millisecond give the motion of those taken at each time step."""
    speed, curvature = 20.0, 1 / 4000
    model = conical(BOGIE.format(along=5e6, across=5e6, damping=2e4) + SPEED_HOLD, 0.1)
    where = line(curvature, balancing(curvature, speed), speed, begin=20.0, transition=60.0, friction=5.0)
    sampled, fine = (Simulator(model, speed, track=EVEN, line=where) for _ in range(2))
    telemetry = sampled.advance(5000)
    each = round(1e-3 / fine.plant.number[at.STEP])
    expected = np.zeros_like(telemetry.acceleration)
    measure = np.array([g for _, g in model.multibody.measuring_points])
    n = model.multibody.n
    for t in range(len(expected)):
        for _ in range(each):
            kernels.step(fine.plant, fine.state, fine.work)
        expected[t] = measure @ (fine.state.a + fine.work.line[3 * n : 4 * n])
    assert np.max(np.abs(telemetry.acceleration - expected)) < 0.003 * np.max(np.abs(expected))


def test_ramp_of_speed() -> None:
    """A constant acceleration: place and speed from the closed form, forces those of the present speed."""
    slow, gain, curvature = 20.0, 0.5, 1 / 4000
    model = conical(BOGIE.format(along=5e6, across=5e6, damping=2e4) + SPEED_HOLD, 0.1)

    def speed(x: Array) -> Array:
        return np.sqrt(slow**2 + 2.0 * gain * np.maximum(x, 0.0))

    simulator = Simulator(
        model, slow, track=EVEN, line=line(curvature, balancing(curvature, 25.0), speed, friction=5.0)
    )
    simulator.state.clock[1] = 0.0
    cant, mass = balancing(curvature, 25.0), model.multibody.total_mass
    for seconds in (10, 20, 30):
        telemetry = simulator.advance(10000)
        place = slow * seconds + 0.5 * gain * seconds**2
        # Within half a time step at each moment, which a higher speed makes a little more of.
        within = gain * seconds * simulator.plant.number[at.STEP]
        assert simulator.state.clock[1] == pytest.approx(place, abs=within)
        felt = (slow + gain * seconds) ** 2 * curvature * np.cos(cant) + GRAVITY * np.sin(cant)
        assert np.sum(telemetry.track_shift[-1]) == pytest.approx(-mass * felt, rel=1e-4, abs=0.1)


def signals(telemetry: Telemetry) -> Array:
    return np.hstack([telemetry.acceleration, telemetry.track_shift, telemetry.damper_force])


@pytest.fixture(scope="module")
def emu() -> VehicleModel:
    return VehicleModel(load_scenario("estimates"))


def lines(speed: float, friction: float) -> dict[str, LineTable | None]:
    """No line, a straight one, and curves that begin at different places."""
    return {
        "-": None,
        "s": line(0.0, 0.0, speed, friction=friction),
        "b": line(1 / 1500, -0.05, speed, begin=20.0, transition=40.0),
        "l": line(1 / 2000, -0.05, speed, begin=90.0, transition=40.0),
    }


def test_straight_line_leaves_every_bit(emu: VehicleModel) -> None:
    where = lines(50.0, emu.scenario.friction)
    none, straight = (signals(Simulator(emu, 50.0, 0, line=where[k]).advance(2000)) for k in "-s")
    assert np.array_equal(none, straight)


@pytest.mark.parametrize("which", ["b", "bl-sb", "blbl-sbl", "bllll", "--s--"])
def test_batch_on_lines_has_the_bits_of_single_vehicles(emu: VehicleModel, which: str) -> None:
    """Vehicles with and without a line, on curves that they enter at different times."""
    where = lines(50.0, emu.scenario.friction)
    batch, alone = (
        [Simulator(emu, 50.0, seed, line=where[k]) for seed, k in enumerate(which)] for _ in range(2)
    )
    together = BatchSimulator(batch, 1).advance(4000)
    for row, simulator in zip(together, alone, strict=True):
        # In pieces: where a call begins is of no account either.
        parts = [signals(simulator.advance(count)) for count in (1000, 1, 2499, 500)]
        assert np.array_equal(row, np.vstack(parts))


def test_left_and_right_curves_mirror_each_other() -> None:
    left, right = (
        Simulator(
            MANCHESTER,
            30.0,
            track=EVEN,
            line=line(side / 1000, side * -0.05, 30.0, begin=20.0, transition=40.0),
        )
        for side in (1.0, -1.0)
    )
    forces = [simulator.advance(6000).track_shift for simulator in (left, right)]
    np.testing.assert_allclose(forces[0], -forces[1], atol=1e-6 * np.max(np.abs(forces[0])))
