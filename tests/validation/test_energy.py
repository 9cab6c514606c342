"""Energy balance of a running vehicle: every force must be the transpose of the velocity it works on.

First law in the frame that moves with the train: the change of kinetic energy, of the energy in linear
springs, stops, Maxwell springs and contacts equals minus the heat in linear dampers, damper pistons, slipping
contacts and contact damping, plus the work of whatever holds the speed V. The powers are computed here from
the recorded motion and the wheels' force resultants, by the formulas written out below.

In a curve each body has a frame of its own. Kinetic energy and contact go with the motion against these
frames, springs and dampers with the motion against a common one, which is this and the frames' offsets. Work
is then also done by the forces of inertia, on the motion against the own frames; by what moves the offsets,
against the forces of the connections; and by what turns the frames, against the wheels' yaw moments.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.linalg import eigh

from sayd_env.config import validate
from sayd_env.config.scenario import NumericsConfig, Scenario, load_scenario
from sayd_env.config.units import GRAVITY, Array
from sayd_env.config.vehicle import VehicleConfig
from sayd_env.physics import step as kernels
from sayd_env.physics.line import CENTRE_KAPPA, CENTRE_ROWS, LineTable, tabulated
from sayd_env.physics.plant import (
    APPROACH,
    FORCE_X,
    FORCE_Y,
    LANES,
    MOMENT_YAW,
    NORMAL,
    POWER_DAMPING,
    POWER_SLIP,
    ROWS_OUT,
    STORED,
    WHEEL_ROWS,
    WHEELSETS,
)
from sayd_env.physics.simulator import Simulator, VehicleModel


def row(lanes: Array, index: int) -> Array:
    """One row of the contact's outputs over time, shape (t, LANES): four left wheels, then four right."""
    return lanes.reshape(-1, ROWS_OUT, LANES)[:, index]


def march(simulator: Simulator, steps: int) -> dict[str, Array]:
    """States after every step, and the contact evaluated at them."""
    state, plant, work = simulator.state, simulator.plant, simulator.work
    q, v, force, position, lanes, rail, line = [], [], [], [], [], [], []
    n, on_line = len(state.q), work.line.size > 0
    for k in range(steps + 1):
        if k > 0 or on_line:
            kernels.step(plant, state, work)
        offset, rate = (work.line[i * n : (i + 1) * n] if on_line else np.zeros(n) for i in (1, 2))
        kernels.contact_at(plant, state.q + offset, state.v + rate, state.clock[1], work)
        q.append(state.q.copy())
        v.append(state.v.copy())
        force.append(state.force.copy())
        position.append(state.clock[1])
        lanes.append(work.lane_out.copy())
        rail.append(work.rail.reshape(-1, WHEELSETS).copy())
        line.append(work.line.copy() if on_line else np.zeros(4 * n + CENTRE_ROWS))
    names = ("q", "v", "force", "position", "lanes", "rail", "line")
    return {n: np.array(x) for n, x in zip(names, (q, v, force, position, lanes, rail, line), strict=True)}


def curve_energy(x: Array, curve: Array) -> Array:
    """Integral of an odd piecewise-linear force from 0 to x (the last slope goes on)."""
    nodes, forces = curve.T
    size = np.abs(x)
    total = np.zeros_like(size)
    for i in range(len(nodes) - 1):
        slope = (forces[i + 1] - forces[i]) / (nodes[i + 1] - nodes[i])
        end = np.inf if i == len(nodes) - 2 else nodes[i + 1]
        part = np.clip(size, nodes[i], end) - nodes[i]
        total += forces[i] * part + 0.5 * slope * part**2
    return total


def inverse_curve(force: Array, curve: Array) -> Array:
    """Velocity of an odd piecewise-linear damper at a force."""
    nodes, forces = curve.T
    size = np.abs(force)
    inside = np.interp(size, forces, nodes)
    slope = (nodes[-1] - nodes[-2]) / (forces[-1] - forces[-2])
    beyond = np.maximum(size - forces[-1], 0.0) * slope
    return np.asarray(np.sign(force) * (inside + beyond))


def frame_power(model: VehicleModel, run: dict[str, Array], speed: float) -> Array:
    """Power of the forces of inertia and of what moves the ends of the connections, shape (t,), W."""
    body, n = model.multibody, model.multibody.n
    loads, offset, moved = (run["line"][:, i * n : (i + 1) * n] for i in range(3))
    if not np.any(loads):
        return np.zeros(len(loads))
    static = np.zeros(n)
    static[body.wheelset_dofs[:, 2]], static[body.section_dofs[:, 1]] = (
        -2 * body.wheel_load,
        2 * body.wheel_load,
    )
    inertia = loads - static + np.diag(body.damping) * moved
    joined, rate, little = run["q"] + offset, run["v"] + moved, 1e-8
    spin = speed / model.scenario.vehicle.wheel_radius
    joints = joined @ body.stiffness.T + rate @ (body.damping + spin * body.gyroscopic).T
    joints += sum(run["force"][:, [k]] * e.connection for k, e in enumerate(model.dampers))
    for e in body.stops:
        stretch = joined @ e.connection
        more, less = (curve_energy(stretch + side * little, e.curve) for side in (1.0, -1.0))
        joints += (0.5 * (more - less) / little)[:, None] * e.connection
    return np.asarray(np.sum(run["v"] * inertia + moved * joints, axis=1))


def holding_power(model: VehicleModel, run: dict[str, Array], speed: float) -> Array:
    """Power of what holds the speed against the rails' irregularities and bends, shape (t,), W."""
    body, table, q, lanes = model.multibody, model.table, run["q"], run["lanes"]
    radius, n, dofs, section = (
        model.scenario.vehicle.wheel_radius,
        body.n,
        body.wheelset_dofs,
        body.section_dofs,
    )
    moved = run["line"][:, 2 * n : 3 * n]
    side = np.repeat([1.0, -1.0], WHEELSETS)
    of = np.tile(np.arange(WHEELSETS), 2)
    values, slopes = run["rail"][:, :4, of], run["rail"][:, 4:, of]
    align, vertical, cross, gauge = (speed * slopes[:, i] for i in range(4))
    y, roll, yaw = (q[:, dofs[of, i]] for i in (1, 3, 5))
    plane = values[:, 2] + q[:, section[of, 2]]
    offset = y + radius * roll - values[:, 0] - q[:, section[of, 0]]
    shift = side * offset - 0.5 * values[:, 3]
    node = np.clip(np.floor((shift - table.dy[0]) / table.step).astype(int), 0, len(table.dy) - 2)

    def at_shift(values: Array) -> Array:
        return np.interp(shift, table.dy, values)

    def slope(values: Array) -> Array:
        return (values[node + 1] - values[node]) / table.step

    delta_r, arm, tilt_0 = at_shift(table.delta_r), at_shift(table.y_c), at_shift(table.phi_k)
    # Stored is (2/5) N d, with the elastic force N and the penetration d = m N^(2/3).
    compliance, rest = at_shift(table.compliance), table.load ** (2.0 / 3.0)
    power = (2.5 * row(lanes, STORED) / compliance) ** 0.4
    tilt, across = side * (roll - plane), yaw - slopes[:, 0]
    steep, steeper = at_shift(table.tan_gamma), slope(table.tan_gamma)
    # Roll moves a wheel sideways that is larger by dr; a yawed wheel touches ahead of or behind its axle.
    rolling, deeper = radius + delta_r, delta_r - tilt * arm
    raised = steep * (arm - rolling * steep)
    slope_dr, slope_arm = slope(table.delta_r), slope(table.y_c)
    tangent = steep + (tilt_0 - tilt) * slope_arm + tilt * (steeper * delta_r + steep * slope_dr)
    tangent -= 0.5 * (across**2 + tilt**2) * (steeper * arm + steep * slope_arm)
    tangent += 0.5 * across**2 * steep * (2.0 * rolling * steeper + steep * slope_dr)
    tangent -= 0.6 * at_shift(table.compliance_slope) * (power - rest)
    cosine = 1.0 / np.hypot(1.0, tangent)
    up = row(lanes, NORMAL) * cosine
    creep_y = row(lanes, FORCE_Y) + up * (side * tangent + plane)
    rise = vertical + cross * (side * arm + offset)  # of the rail's surface below the wheel
    # A wheel of radius r0 + dr that spins with V / r0, and rolls along its yawed plane over the rail's line.
    more = delta_r / radius
    hold = speed * row(lanes, FORCE_X) * more
    hold += speed * creep_y * (yaw + across * (tangent**2 + more / cosine**2))
    # A bent rail yaws below the wheel, which raises it.
    bend = np.gradient(slopes[:, 0], np.asarray(run["position"]) / speed, axis=0)
    # A curve turns it likewise, and the wheelset with it.
    turning = moved[:, dofs[of, 5]] + speed * run["line"][:, 4 * n + CENTRE_KAPPA, None]
    bend += turning
    hold -= turning * row(lanes, MOMENT_YAW)
    hold += up * across * raised * bend
    # The rail's surface lifts the wheel and shifts it sideways as it runs by.
    hold += creep_y * side * tangent * rise
    hold += up * (rise - (side * tangent + plane) * align - 0.5 * tangent * gauge)
    hold += cross * deeper * (creep_y - side * up * steep)
    return np.asarray(hold.sum(axis=1))


def balance(model: VehicleModel, run: dict[str, Array], speed: float) -> dict[str, Array]:
    """Energy (J) and powers (W) over time, shape (t,) each."""
    body, n = model.multibody, model.multibody.n
    q, v, force, lanes = run["q"], run["v"], run["force"], run["lanes"]
    joined, rate = q + run["line"][:, n : 2 * n], v + run["line"][:, 2 * n : 3 * n]

    # Stored energy. The static load of each wheelset is a constant force between wheelset and track.
    kinetic = 0.5 * np.einsum("ti,i,ti->t", v, body.mass, v)
    springs = 0.5 * np.einsum("ti,ij,tj->t", joined, body.stiffness, joined)
    stops = sum((curve_energy(joined @ e.connection, e.curve) for e in body.stops), np.zeros(len(q)))
    maxwell = sum(0.5 * force[:, k] ** 2 / e.series_stiffness for k, e in enumerate(model.dampers))
    dofs, section = body.wheelset_dofs, body.section_dofs
    static = 2.0 * (q[:, dofs[:, 2]] - q[:, section[:, 1]]) @ body.wheel_load
    stored = row(lanes, STORED).sum(axis=1)

    # Heat.
    linear = np.einsum("ti,ij,tj->t", rate, body.damping, rate)
    pistons = sum(force[:, k] * inverse_curve(force[:, k], e.curve) for k, e in enumerate(model.dampers))
    slip = row(lanes, POWER_SLIP).sum(axis=1)
    contact = row(lanes, POWER_DAMPING).sum(axis=1)

    frames = frame_power(model, run, speed)
    return {
        "energy": kinetic + springs + stops + maxwell + static + stored,
        "heat": linear + pistons + slip + contact,
        "hold": holding_power(model, run, speed) + frames,
        "frames": frames,
    }


def residual(
    scenario: Scenario, kmh: float, duration: float, step: float, line: LineTable | None = None
) -> dict[str, float]:
    """Residual of the first law over a run and the heat (J)."""
    numerics = NumericsConfig(step=step, creep_step=1.0)
    model = VehicleModel(scenario.model_copy(update={"numerics": numerics}))
    run = march(Simulator(model, kmh / 3.6, 1, line=line), round(duration / step))
    result = balance(model, run, kmh / 3.6)
    work = {name: float(trapezoid(result[name], dx=step)) for name in ("heat", "hold", "frames")}
    change = float(result["energy"][-1] - result["energy"][0])
    return work | {"residual": change + work["heat"] - work["hold"]}


@pytest.mark.parametrize(("wear", "kmh"), [(0.0, 280.0), (1.0, 350.0)])
def test_energy_balance_on_irregular_track(wear: float, kmh: float) -> None:
    """First law over 1.5 s of running: closed to 0.2 % of the heat at 0.5 ms, to nothing as steps vanish.

    The residual falls with the square of the step; extrapolated to none, less than 5e-5 of the heat is left.
    """
    scenario = load_scenario("estimates", [f"wear={wear}"])
    coarse, middle, fine = (residual(scenario, kmh, 1.5, h) for h in (5e-4, 2.5e-4, 1.25e-4))
    assert coarse["heat"] > 1e3
    assert abs(coarse["residual"]) < 2e-3 * coarse["heat"]
    assert abs(fine["residual"]) < 1.25e-4 * fine["heat"]
    assert abs(middle["residual"]) < abs(coarse["residual"]) / 3.0
    assert abs(fine["residual"]) < abs(middle["residual"]) / 3.0
    assert abs(4.0 * fine["residual"] - middle["residual"]) / 3.0 < 5e-5 * fine["heat"]


def test_energy_balance_in_a_curve() -> None:
    """The same through a transition into a canted curve, where the frames do a good part of the work."""
    scenario, kmh, curvature = load_scenario("estimates"), 300.0, 1 / 4000
    x = np.arange(-100.0, 400.0, 10.0)
    share, even = np.clip((x - 20.0) / 60.0, 0.0, 1.0), np.ones(len(x))
    cant = -0.155
    line = tabulated(
        -100.0, share * curvature, share * cant, even * (kmh / 3.6) ** 2, even * scenario.friction, 0.0 * even
    )
    coarse, middle, fine = (residual(scenario, kmh, 1.5, h, line) for h in (5e-4, 2.5e-4, 1.25e-4))
    assert abs(coarse["frames"]) > 0.5 * coarse["heat"] > 5e3
    assert abs(coarse["residual"]) < 5e-4 * coarse["heat"]
    assert abs(middle["residual"]) < abs(coarse["residual"]) / 3.0
    assert abs(fine["residual"]) < abs(middle["residual"]) / 3.0
    assert abs(4.0 * fine["residual"] - middle["residual"]) / 3.0 < 5e-5 * fine["heat"]


def test_energy_balance_through_loss_of_contact() -> None:
    """The same over a hump that wheels jump off and land behind, at steps that resolve the impact."""
    scenario = load_scenario(
        overrides=[
            "track=defect",
            "track.irregularity.channel=vertical",
            "track.irregularity.amplitude=0.01",
            "track.irregularity.length=3.0",
            "track.irregularity.position=20.0",
        ]
    )
    coarse, fine = (residual(scenario, 300.0, 0.8, h) for h in (6.25e-5, 3.125e-5))
    assert fine["heat"] > 1e3
    assert abs(fine["residual"]) < 1e-3 * fine["heat"]
    assert abs(fine["residual"]) < abs(coarse["residual"]) / 3.0


def wheelset_alone() -> VehicleModel:
    """A wheelset of 150 kN on an undamped track, without friction to speak of."""
    data = {
        "name": "wheelset",
        "wheel_radius": 0.46,
        "measuring_height": 0.5,
        "speed_range": [5.0, 100.0],
        "bodies": [
            {
                "name": "axle",
                "role": "wheelset",
                "mass": MASS,
                "inertia": [7e3, 1e3, 7e3],
                "position": [0.0, 0.0, 0.46],
            }
        ],
        "elements": [],
    }
    scenario = load_scenario(
        overrides=[
            "track=smooth",
            "track.section.vertical_damping=0",
            "contact_damping=0",
            "friction=1e-4",
            "numerics.step=3.125e-5",
        ]
    )
    return VehicleModel(scenario.model_copy(update={"vehicle": validate(VehicleConfig, data, "test")}))


MASS = 15000.0


def test_bounce_on_hertz_springs() -> None:
    """Small bounce on wheel-rail contact and track against the closed form of two masses on linear springs.

    Hertz's force c d^1.5 has the stiffness 1.5 N / d at its static load N.
    """
    model = wheelset_alone()
    section = model.scenario.track.section
    simulator = Simulator(model, 50.0)
    state, plant = simulator.state, simulator.plant
    axle_z, track_z = model.multibody.wheelset_dofs[0, 2], model.multibody.section_dofs[0, 1]
    approach = plant.wheel.reshape(WHEEL_ROWS, LANES)[APPROACH, 0]
    contact = 2.0 * 1.5 * 0.5 * MASS * GRAVITY / approach
    k = np.array([[contact, -contact], [-contact, contact + 2.0 * section.vertical_stiffness]])
    squared, shapes = eigh(k, np.diag([MASS, section.mass]))
    amplitude = 1e-3 * approach
    state.q[axle_z] = amplitude
    state.a[[axle_z, track_z]] = -amplitude * k[:, 0] / [MASS, section.mass]
    start = shapes.T @ np.diag([MASS, section.mass]) @ [amplitude, 0.0]
    for _ in range(1600):  # 50 ms
        kernels.step(plant, state, simulator.work)
        expected = shapes @ (start * np.cos(np.sqrt(squared) * state.clock[0]))
        np.testing.assert_allclose(state.q[[axle_z, track_z]], expected, atol=0.01 * amplitude)


def test_free_flight() -> None:
    """A wheelset thrown upwards leaves the rail, feels no force, and falls with g."""
    simulator = Simulator(wheelset_alone(), 50.0)
    state, plant, work = simulator.state, simulator.plant, simulator.work
    axle_z = simulator.model.multibody.wheelset_dofs[0, 2]
    state.v[axle_z] = 0.5
    flight = []
    for _ in range(1600):
        kernels.step(plant, state, work)
        if state.q[axle_z] > 1e-3:
            assert np.all(work.lane_out.reshape(ROWS_OUT, LANES)[[FORCE_X, NORMAL]] == 0.0)
            flight.append((state.clock[0], state.q[axle_z]))
    t, z = np.array(flight).T
    assert len(t) > 1000
    assert 2.0 * np.polynomial.Polynomial.fit(t, z, 2).convert().coef[2] == pytest.approx(-GRAVITY, rel=1e-9)
