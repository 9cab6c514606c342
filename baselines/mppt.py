"""The paper's MPPT: gradient-like steps of the valve command, with two thresholds (section 4.1)."""

from __future__ import annotations

import numpy as np

from sayd_env.baselines.extremum_seeking import ExtremumSeeking
from sayd_env.config.control import MpptConfig
from sayd_env.config.units import Array


class Mppt(ExtremumSeeking[MpptConfig]):
    """MPPT1 and MPPT2, one controller for each bogie, exactly as the paper prints them.

    Once a second, with J^(n+1) of the second just ended and J^n of the one before,

        J = k_y (psi_y / y_lim)^2 + k_F (psi_F / F_max)^2                                  (27)
        F = A (p_A - p_B)                                                                  (28)
        V^(n+1) = V^n - k_J (J^(n+1) - J^n) / max(J^n, J^(n+1))                            (29)
        V^(n+1) = V^n - delta_v_down    if psi_y > threshold_max                           (30)
        V^(n+1) = V^n + delta_v_up      if psi_y < threshold_min                           (31)

    psi_y is the RMS over the second of the lateral acceleration of the bogie frame, band-passed to f_0 +- 2
    Hz, psi_F that of the hydraulic force. A step by (30) or (31) replaces (29). In the first second there is
    no J^n: (29) then leaves V unchanged. (29) lacks the sign of the last move of V and so does not
    search; `PerturbAndObserve` does.

    =================  =====  ==========================================================================
    parameter          unit   meaning
    =================  =====  ==========================================================================
    ``k_y``            -      weight of the acceleration in (27)
    ``k_F``            -      weight of the force in (27); 0: no pressure is read
    ``k_J``            -      gain of (29)
    ``delta_v_down``   -      closing step of (30)
    ``delta_v_up``     -      opening step of (31)
    ``threshold_max``  m/s2   RMS above which (30) holds
    ``threshold_min``  m/s2   RMS below which (31) holds; 0: never
    ``v_min``          -      smallest command; V stays in [V_min, 1]
    ``initial``        -      command of the first second; null: mean of the currents fed back at the start
    ``accelerometer``  -      ``leading`` or ``trailing``: wheelset above which the bogie's sensor is mounted
    ``damper``         -      the bogie's damper whose pressures are read, for example ``left.upper``
    ``slowest``        m/s    speed below which the spectrum behind f_0 covers less than 500 m
    =================  =====  ==========================================================================

    MPPT1 has k_F = 0 and needs one accelerometer, MPPT2 also weighs the force.

    Sensors: one accelerometer of each bogie (``lateral_acceleration``), the train's ``speed`` (at the start,
    for the length of the spectrum), with k_F > 0 both pressures of one damper of each bogie, and with
    ``initial=None`` the fed-back currents (at the start). From ``features``: ``acceleration_rms``,
    ``force_rms``. Valves: ``bogie`` or ``damper``.

    References
    ----------
    Wang, Liu, Di Gialleonardo, Kovacic and Bruni, Vehicle System Dynamics 60(8), 2608-2633 (2022),
    section 4.1.
    """

    def _move(self, command: Array, previous: Array, cost: Array, rms: Array, direction: Array) -> Array:
        parameters = self.parameters
        larger = np.maximum(previous, cost)  # NaN in the first second
        rise = np.divide(cost - previous, larger, out=np.zeros_like(cost), where=larger > 0.0)
        moved = command - parameters.k_J * rise
        moved = np.where(rms > parameters.threshold_max, command - parameters.delta_v_down, moved)
        return np.where(rms < parameters.threshold_min, command + parameters.delta_v_up, moved)
