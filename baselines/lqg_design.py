"""The vehicle as an LQG controller sees it: linearised with closed dampers, on one track, reduced.

Inputs are a force for each bogie that its dampers should add, left against right, and white noise that,
through first-order low-passes, makes alignment and cross-level: their density falls with the square of the
frequency, as that of measured track does. One track passes under all wheelsets. Balanced truncation (Moore,
IEEE Trans. Autom. Control 26 (1981) 17) leaves some tens of its states.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import matrix_balance, solve_continuous_lyapunov, svd

from sayd_env.config.control import LqgConfig
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.files import named_files
from sayd_env.config.scenario import load_scenario
from sayd_env.config.units import KMH, Array
from sayd_env.config.user_cache import report_once
from sayd_env.envs.interface import BOGIES
from sayd_env.physics import array_cache, kernel_cache
from sayd_env.physics.simulator import VehicleModel

if TYPE_CHECKING:
    from sayd_env.physics.state_space import StateSpace

READ = 6
"""Of the outputs the first ones are read by sensors: four accelerations and both bogies' strokes."""
OUTPUTS = 8
"""Beside them the tensions of both bogies' dampers."""
ORDER = 6
"""Of the approximation of the delay from one wheelset to the next."""
MARGIN = 0.1
"""Least damping rate (1/s) of the linear vehicle; one that is not stable is shifted to it."""


@dataclass(frozen=True)
class ReducedPlant:
    """x' = a x + force u + noise w, y = c x + d u at one speed, n states.

    y: four lateral accelerations (m/s2), strokes (m) and tensions (N) of both bogies' dampers, left against
    right. u: forces added to the tensions (N). w: white noise of density 1.
    """

    a: Array
    """(n, n)."""
    force: Array
    """(n, 2)."""
    noise: Array
    """(n, 2)."""
    c: Array
    """(8, n)."""
    d: Array
    """(8, 2)."""

    @classmethod
    def shapes(cls, n: int) -> dict[str, tuple[int, int]]:
        """Shapes of the matrices by name."""
        return dict(
            zip(
                (each.name for each in fields(cls)),
                ((n, n), (n, 2), (n, 2), (OUTPUTS, n), (OUTPUTS, 2)),
                strict=True,
            )
        )


def reduced_plants(parameters: LqgConfig, damper: SaydDamperConfig) -> list[ReducedPlant]:
    """Reduced plants at the speeds of some parameters, from the disk if they have been made before.

    Raises
    ------
    ConfigError, DataError, StudyError
        A study that cannot be read or linearised.
    """
    scenario = load_scenario(parameters.study).model_copy(update={"damper": damper})
    shapes = ReducedPlant.shapes(parameters.states)
    length = sum(rows * columns for rows, columns in shapes.values())
    chosen = ("speeds_kmh", "stroke_speed", "shifts", "corner", "states")
    content = (
        scenario.model_dump_json(exclude={"provenance", "description"}).encode(),
        repr([getattr(parameters, name) for name in chosen]).encode(),
        Path(__file__).read_bytes(),
        kernel_cache.source_hash().encode(),
        *(path.read_bytes() for path in named_files(scenario.model_dump(mode="json"))),
    )

    def make() -> Array:
        report_once("linearising the vehicle for LQG; this takes some seconds, once for a vehicle")
        model = VehicleModel(scenario)
        plants = [plant_at(model, kmh / KMH, parameters) for kmh in parameters.speeds_kmh]
        return np.concatenate([getattr(each, name).ravel() for each in plants for name in shapes])

    count = len(parameters.speeds_kmh)
    flat = array_cache.cached_array("lqg", content, count * length, make).reshape(count, length)
    found = []
    for row in flat:
        ends = np.cumsum([rows * columns for rows, columns in shapes.values()])
        parts = np.split(row, ends[:-1])
        found.append(
            ReducedPlant(*(part.reshape(shape) for part, shape in zip(parts, shapes.values(), strict=True)))
        )
    return found


def plant_at(model: VehicleModel, speed: float, parameters: LqgConfig) -> ReducedPlant:
    """Reduced plant of a vehicle with closed dampers at a speed (m/s).

    Raises
    ------
    numpy.linalg.LinAlgError
        The reduction fails.
    """
    from sayd_env.physics.state_space import wheelset_delays  # noqa: PLC0415 - keeps the start fast

    whole = stable_system(model, speed, parameters).delayed(*wheelset_delays(model, speed), order=ORDER)
    groups = {f"force.{bogie}": _turning("force", bogie, 1.0) for bogie in BOGIES}
    system = whole.combined({**groups, "alignment": {"alignment": 1.0}, "cross_level": {"cross_level": 1.0}})
    damper = model.scenario.damper
    assert isinstance(damper, SaydDamperConfig)  # `reduced_plants` sees to it
    share = 0.25 * damper.cylinder.area
    rows = [{name: 1.0} for name in system.outputs if name.startswith("lateral_acceleration")]
    rows += [_turning("stroke", bogie, 0.25) for bogie in BOGIES]
    for bogie in BOGIES:  # a damper's tension is minus A (p_A - p_B)
        tension = _turning("pressure_a", bogie, -share)
        rows.append({**tension, **_turning("pressure_b", bogie, share)})
    shares = np.array([[row.get(name, 0.0) for name in system.outputs] for row in rows])
    return _reduced(system, shares @ system.c, shares @ system.d, parameters)


def stable_system(model: VehicleModel, speed: float, parameters: LqgConfig) -> StateSpace:
    """The linear vehicle at the first shift at which it is stable; else all rates of the last one shifted."""
    from sayd_env.physics.linear import OperatingPoint  # noqa: PLC0415 - keeps the start fast
    from sayd_env.physics.state_space import StateSpace, state_space  # noqa: PLC0415

    for shift in parameters.shifts:
        point = OperatingPoint(speed, shift, parameters.stroke_speed, current=0.0)
        system = state_space(model, point)
        fastest = float(np.max(np.linalg.eigvals(system.a).real))
        if fastest <= -MARGIN:
            return system
    return StateSpace(**{**vars(system), "a": system.a - (fastest + MARGIN) * np.eye(len(system.a))})


def balanced(a: Array, b: Array, c: Array, states: int) -> tuple[Array, Array, Array]:
    """Balanced truncation of a stable system by the square roots of its Gramians.

    Parameters
    ----------
    a, b, c : ndarray, shapes (n, n), (n, m), (p, n)
        Of dx/dt = a x + b u, y = c x.
    states : int
        That are kept.

    Returns
    -------
    tuple of ndarray, shapes (states, states), (states, m), (p, states)

    References
    ----------
    Laub, Heath, Paige and Ward, IEEE Transactions on Automatic Control 32(2), 115-122 (1987).
    """
    a, scaled = matrix_balance(a, permute=False)
    b, c = np.linalg.solve(scaled, b), c @ scaled
    roots = []
    for left, right in ((a, b), (a.T, c.T)):
        values, vectors = np.linalg.eigh(solve_continuous_lyapunov(left, -right @ right.T))
        roots.append(vectors * np.sqrt(np.maximum(values, 0.0)))
    u, hankel, v = svd(roots[1].T @ roots[0])
    size = np.sqrt(hankel[:states])
    into, out = roots[0] @ v[:states].T / size, (roots[1] @ u[:, :states] / size).T
    return out @ a @ into, out @ b, c @ into


def _turning(kind: str, bogie: str, share: float) -> dict[str, float]:
    """Shares of a bogie's four dampers that turn it."""
    sides = (("left", share), ("right", -share))
    return {f"{kind}.{bogie}.{side}.{place}": x for side, x in sides for place in ("upper", "lower")}


def _reduced(system: StateSpace, c: Array, d: Array, parameters: LqgConfig) -> ReducedPlant:
    """Put the track's low-passes before the system, scale what comes out to RMS 1 and reduce it."""
    n, corner = len(system.a), 2.0 * np.pi * parameters.corner
    a = np.block([[system.a, system.b[:, 2:]], [np.zeros((2, n)), -corner * np.eye(2)]])
    force = np.vstack([system.b[:, :2], np.zeros((2, 2))])
    noise = np.vstack([np.zeros((n, 2)), corner * np.eye(2)])
    c = np.hstack([c, d[:, 2:]])
    # Alignment and cross-level, each such that it alone gives the first sensor an RMS of 0.5 m/s2; forces of
    # 1 kN. Units of this order make the truncation fair.
    for k in range(2):
        covariance = solve_continuous_lyapunov(a, -np.outer(noise[:, k], noise[:, k]))
        noise[:, k] *= 0.5 / np.sqrt(c[0] @ covariance @ c[0])
    rms = np.sqrt(np.diag(c @ solve_continuous_lyapunov(a, -noise @ noise.T) @ c.T))
    small_a, small_b, small_c = balanced(
        a, np.hstack([1e3 * force, noise]), c / rms[:, None], parameters.states
    )
    return ReducedPlant(small_a, small_b[:, :2] * 1e-3, small_b[:, 2:], small_c * rms[:, None], d[:, :2])
