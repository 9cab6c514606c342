"""Perturb and observe: the textbook search for a maximum power point, here for the smallest cost."""

from __future__ import annotations

from sayd_env.baselines.extremum_seeking import ExtremumSeeking
from sayd_env.config.control import PerturbObserveConfig
from sayd_env.config.units import Array


class PerturbAndObserve(ExtremumSeeking[PerturbObserveConfig]):
    """Perturb and observe, one controller for each bogie.

    Once a second the command moves by one step, in the direction of the last move where J of eq. (27) has
    fallen or stayed, and back where it has risen:

        d^(n+1) = -d^n if J^(n+1) > J^n, else d^n            V^(n+1) = V^n + step d^(n+1)

    At an end of its range the command moves inwards.

    =================  =====  ==========================================================================
    parameter          unit   meaning
    =================  =====  ==========================================================================
    ``k_y``            -      weight of the acceleration in (27)
    ``k_F``            -      weight of the force in (27); 0: no pressure is read
    ``step``           -      change of the command in a second
    ``first_move``     -      ``close`` or ``open``: direction of the first move
    ``v_min``          -      smallest command; V stays in [V_min, 1]
    ``initial``        -      command of the first second; null: mean of the currents fed back at the start
    ``accelerometer``  -      ``leading`` or ``trailing``: wheelset above which the bogie's sensor is mounted
    ``damper``         -      the bogie's damper whose pressures are read, for example ``left.upper``
    ``slowest``        m/s    speed below which the spectrum behind f_0 covers less than 500 m
    =================  =====  ==========================================================================

    Sensors: one accelerometer of each bogie (``lateral_acceleration``), the train's ``speed`` (at the start,
    for the length of the spectrum), with k_F > 0 both pressures of one damper of each bogie, and with
    ``initial=None`` the fed-back currents (at the start). From ``features``: ``acceleration_rms``,
    ``force_rms``. Valves: ``bogie`` or ``damper``.

    References
    ----------
    Femia, Petrone, Spagnuolo and Vitelli, IEEE Transactions on Power Electronics 20(4), 963-973 (2005).
    """

    def _first_direction(self) -> float:
        return 1.0 if self.parameters.first_move == "open" else -1.0

    def _move(self, command: Array, previous: Array, cost: Array, rms: Array, direction: Array) -> Array:
        direction[cost > previous] *= -1.0  # false in the first second, whose J^n is NaN
        direction[command <= self.parameters.v_min] = 1.0
        direction[command >= 1.0] = -1.0
        return command + self.parameters.step * direction
