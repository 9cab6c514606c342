"""LQG on the linearised vehicle, clipped to what the dampers can do, in the loop of the environment.

    python examples/lqg.py                    # its J beside constant commands and MPPT
    sayd evaluate --speeds 350 --policies examples/lqg.py:make,constant:0,mppt2

1. `sayd_env.physics.state_space` linearises the vehicle with its dampers closed, at 350 km/h and at
   the amplitudes below. Inputs are a force for each bogie that its dampers should add, left against right.
2. One track passes under all wheelsets. Its irregularities are white noise through a first-order low-pass:
   their density falls with the square of the frequency, as that of the German spectra does.
3. Balanced truncation leaves some fifty of 254 states (Moore, IEEE Trans. Autom. Control
   26 (1981) 17), which are sampled at the control period.
4. The regulator minimises J of eq. (27), with one period between command and force. The observer (a Kalman
   filter) reads accelerometers and strokes, and is told the forces that the pressures show.
5. A damper cannot push ("clipped optimal control"): the flow that would bring the oil to the wanted pressure
   must pass the throttle, whose characteristic is solved for the current, cut to what there is.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from judge import controller, mean_cost
from scipy.linalg import expm, matrix_balance, solve_continuous_lyapunov, solve_discrete_are, svd

from sayd_env.config.scenario import load_scenario
from sayd_env.envs.interface import BOGIES, Interface
from sayd_env.physics.linear import OperatingPoint
from sayd_env.physics.sayd import rectified_flow
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.state_space import StateSpace, state_space, wheelset_delays
from sayd_env.physics.throttle import series_table

ID = "sayd_env:SAYD/Nominal-v1"
KEYWORDS: dict[str, Any] = {"observation": "signals"}
SPEED = 350.0 / 3.6
STROKE_SPEED = 6e-3
"""m/s (RMS), at which the dampers move there with closed valves."""
SHIFTS = (1e-3, 2e-3, 3e-3, 4e-3)
"""m (RMS); the smallest one at which the vehicle is stable counts: on worn wheels it hunts at less."""
FORCE_PENALTY = 0.02
"""Weight of the added force over F_max, squared, beside J's own of the whole force."""
NOISE = 0.2
"""Error of the sensors that the observer reckons with, over the RMS of what it expects."""
WIDEST = 0.3
"""Widest command: a valve on its way from further open is late when the damper has to resist again."""
CORNER = 0.5
"""Hz, from which the irregularities' density falls with the square of the frequency."""
KEPT = 1e-3
"""Hankel singular values that stay, over the largest."""


def balanced(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Balanced truncation of a stable system by the square roots of its Gramians."""
    a, scaled = matrix_balance(a, permute=False)
    b, c = np.linalg.solve(scaled, b), c @ scaled
    roots = []
    for left, right in ((a, b), (a.T, c.T)):
        values, vectors = np.linalg.eigh(solve_continuous_lyapunov(left, -right @ right.T))
        roots.append(vectors * np.sqrt(np.maximum(values, 0.0)))
    u, hankel, v = svd(roots[1].T @ roots[0])
    n = int(np.sum(hankel > KEPT * hankel[0]))
    into, out = roots[0] @ v[:n].T / np.sqrt(hankel[:n]), (roots[1] @ u[:, :n] / np.sqrt(hankel[:n])).T
    return out @ a @ into, out @ b, c @ into


def plant(damper_area: float) -> tuple[np.ndarray, ...]:
    """Reduced A, B of added forces (N), B of the track's noise, C and the forces' D.

    Outputs are four accelerations, then of both bogies the dampers' strokes and tensions, left against right.
    """
    model = VehicleModel(load_scenario("nominal", ["damper=sayd"]))
    points = (OperatingPoint(SPEED, shift, STROKE_SPEED, current=0.0) for shift in SHIFTS)
    systems = (state_space(model, point) for point in points)
    stable = next(s for s in systems if np.max(np.linalg.eigvals(s.a).real) < 0.0)
    whole = stable.delayed(*wheelset_delays(model, SPEED), order=6)
    groups = {f"force.{bogie}": _turning("force", bogie, 1.0) for bogie in BOGIES}
    system = whole.combined({**groups, "alignment": {"alignment": 1.0}, "cross_level": {"cross_level": 1.0}})
    rows = [{name: 1.0} for name in system.outputs if name.startswith("lateral_acceleration")]
    rows += [_turning("stroke", bogie, 0.25) for bogie in BOGIES]
    for bogie in BOGIES:  # a damper's tension is minus A (p_A - p_B)
        tension = _turning("pressure_a", bogie, -0.25 * damper_area)
        rows.append({**tension, **_turning("pressure_b", bogie, 0.25 * damper_area)})
    shares = np.array([[row.get(name, 0.0) for name in system.outputs] for row in rows])
    return _shaped(system, shares @ system.c, shares @ system.d)


def _turning(kind: str, bogie: str, share: float) -> dict[str, float]:
    """Shares of a bogie's four dampers that turn it."""
    sides = (("left", share), ("right", -share))
    return {f"{kind}.{bogie}.{side}.{place}": x for side, x in sides for place in ("upper", "lower")}


def _shaped(system: StateSpace, c: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, ...]:
    """Put the track's low-passes before the system, scale what comes out to RMS 1 and reduce it."""
    n, corner = len(system.a), 2.0 * np.pi * CORNER
    a = np.block([[system.a, system.b[:, 2:]], [np.zeros((2, n)), -corner * np.eye(2)]])
    force = np.vstack([system.b[:, :2], np.zeros((2, 2))])
    noise = np.vstack([np.zeros((n, 2)), corner * np.eye(2)])
    c = np.hstack([c, d[:, 2:]])
    # Alignment and cross-level, each such that it alone gives the first sensor an RMS of 0.5 m/s2; forces of
    # 1 kN. Units of this order make the truncation fair.
    for k in range(2):
        spread = solve_continuous_lyapunov(a, -np.outer(noise[:, k], noise[:, k]))
        noise[:, k] *= 0.5 / np.sqrt(c[0] @ spread @ c[0])
    rms = np.sqrt(np.diag(c @ solve_continuous_lyapunov(a, -noise @ noise.T) @ c.T))
    small_a, small_b, small_c = balanced(a, np.hstack([1e3 * force, noise]), c / rms[:, None])
    return small_a, small_b[:, :2] * 1e-3, small_b[:, 2:], small_c * rms[:, None], d[:, :2]


class Lqg:
    """The policy: what `sayd evaluate` and `mean_cost` call."""

    def __init__(self, interface: Interface) -> None:
        self.interface, period, damper = interface, interface.control_period, interface.damper
        self.area = damper.cylinder.area
        a, force, noise, c, d = plant(self.area)
        n = len(a)
        self.a, self.force = _sampled(a, force, period)
        self.c, self.d = c, d
        # x, and the forces that are on their way: the command of now acts from the next period on.
        late = np.block([[self.a, self.force], [np.zeros((2, n + 2))]])
        entry = np.vstack([np.zeros((n, 2)), np.eye(2)])
        weights = np.diag(
            [0.25 / interface.acceleration_limit**2] * 4 + [0.25 / interface.force_reference**2] * 2
        )
        seen = np.vstack([np.hstack([c[:4], d[:4]]), np.hstack([c[6:], np.eye(2)])])
        cost = seen.T @ weights @ seen + 1e-12 * np.eye(n + 2)
        penalty = FORCE_PENALTY / interface.force_reference**2 * np.eye(2)
        s = solve_discrete_are(late, entry, 0.5 * (cost + cost.T), penalty)
        self.gain = np.linalg.solve(penalty + entry.T @ s @ entry, entry.T @ s @ late)
        # The observer sees what the dampers do: for it the vehicle has none, and their forces act on it.
        bare, self.read = a - force @ c[6:], c[:6] - d[:6] @ c[6:]
        self.bare, self.measured = _sampled(bare, force, period)
        spread = expm(
            np.block([[-bare, noise @ noise.T], [np.zeros((n, n)), bare.T]]) * period
        )  # Van Loan 1978
        drift = self.bare @ spread[:n, n:]
        rms = np.sqrt(np.diag(c[:6] @ solve_continuous_lyapunov(a, -noise @ noise.T) @ c[:6].T))
        errors = np.diag((NOISE * rms) ** 2)
        p = solve_discrete_are(self.bare.T, self.read.T, 0.5 * (drift + drift.T), errors)
        self.observe = p @ self.read.T @ np.linalg.inv(self.read @ p @ self.read.T + errors)
        self.rate = c[4:6] @ a
        self.damper, self.period = damper, period
        cylinder, oil = damper.cylinder, damper.oil
        dead = np.pi / 4.0 * cylinder.bore**2 * 0.5 * (cylinder.dead_length_a + cylinder.dead_length_b)
        # Oil that a chamber takes for each Pa of pressure drop, both chambers sharing it.
        self.capacity = 0.5 * (0.5 * cylinder.stroke * cylinder.area + dead) / oil.bulk_modulus
        self.currents = np.linspace(0.0, WIDEST, 61)
        self.throttle = series_table(damper.throttle, damper.rectifier).ravel()
        places = [f"{b}.{s}.{p}" for b in BOGIES for s in ("left", "right") for p in ("upper", "lower")]
        self.columns = {
            kind: [interface.index(f"{kind}.{place}") for place in places]
            for kind in ("stroke", "pressure_a", "pressure_b")
        }
        accelerations = [s.name for s in interface.signals if s.name.startswith("lateral_acceleration")]
        self.accelerations = [interface.index(name) for name in accelerations]

    def predict(
        self,
        observation: np.ndarray,
        state: tuple[np.ndarray, np.ndarray] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, Any]:
        """Valve commands of front and rear bogie."""
        seen, single = self.interface.rows(observation, "lqg")
        if state is None:
            state = np.zeros((len(seen), len(self.a))), _yaw(seen[:, self.columns["stroke"]])
        x, rest = state
        if episode_start is not None and np.any(episode_start):
            x[episode_start], rest[episode_start] = 0.0, _yaw(seen[:, self.columns["stroke"]])[episode_start]
        strokes = _yaw(seen[:, self.columns["stroke"]])
        rest += 0.005 * (strokes - rest)  # where the pistons stand is no motion
        drop = seen[:, self.columns["pressure_a"]] - seen[:, self.columns["pressure_b"]]
        force = -self.area * _yaw(drop)
        readings = np.hstack([seen[:, self.accelerations], strokes - rest])
        x = x @ self.bare.T + force @ self.measured.T
        x += (readings - x @ self.read.T - force @ self.d[:6].T) @ self.observe.T
        # What the dampers do beyond the model's, and where the next period begins.
        added = force - x @ self.c[6:].T
        ahead = x @ self.a.T + added @ self.force.T
        wanted = ahead @ self.c[6:].T - np.hstack([x, added]) @ self.gain.T
        rate = ahead @ self.rate.T
        action = self._commands(force, wanted, rate).astype(np.float32)
        return (action[0] if single else action), (x, rest)

    def _commands(self, force: np.ndarray, wanted: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Commands, (N, 2), with which the dampers come nearest to a tension (N) at the end of the period.

        The flow that the piston drives, less what the oil takes on the way to the wanted pressure drop, has
        to pass the throttle; by its characteristic this needs a current, as far as there is one.
        """
        drop, goal = -force / self.area, -wanted / self.area
        flow = -self.area * rate - self.capacity * (goal - drop) / self.period
        middle = 0.5 * (drop + goal)
        through = rectified_flow(self.damper, self.throttle, np.abs(middle)[..., None], self.currents)
        below = np.sum(through <= (flow * np.sign(middle))[..., None], axis=-1)
        return np.asarray(self.currents[np.maximum(below - 1, 0)])


def _sampled(a: np.ndarray, b: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """A and B for inputs that hold over a period."""
    n, m = b.shape
    step = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * period)
    return step[:n, :n], step[:n, n:]


def _yaw(values: np.ndarray) -> np.ndarray:
    """Half the difference of the sides' means of eight dampers' values, shape (N, 2)."""
    sides = values.reshape(-1, 2, 2, 2).mean(axis=3)
    return 0.5 * (sides[:, :, 0] - sides[:, :, 1])


def make(interface: Interface) -> Lqg:
    """The policy for `sayd evaluate`."""
    return Lqg(interface)


make.environment = {**KEYWORDS, "valves": "bogie", "control_period": 0.01}


def main(episodes: int = 4) -> dict[str, float]:
    """J of LQG and of what does not know the model, in episodes of 20 s at 350 km/h on worn wheels."""
    policy = make(gym.make(ID, **KEYWORDS).unwrapped.interface)
    memory: Any = None

    def act(observation: np.ndarray) -> np.ndarray:
        nonlocal memory
        action, memory = policy.predict(observation, memory)
        return action

    found = {"lqg": mean_cost(act, episodes, ID, **KEYWORDS)}
    for name in ("constant:0", "constant:0.3", "constant:0.5", "mppt1", "mppt2"):
        found[name] = mean_cost(controller(name, ID, **KEYWORDS), episodes, ID, **KEYWORDS)
    return found


if __name__ == "__main__":
    for name, cost in main().items():
        print(f"{name}: J = {cost:.4f}")
