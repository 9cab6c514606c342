"""The Gymnasium environment of one vehicle."""

from __future__ import annotations

from typing import Any, SupportsFloat, Unpack

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded

from sayd_env.config.units import Array32
from sayd_env.envs.environment import Environment
from sayd_env.envs.keywords import RENDER_MODES, Keywords
from sayd_env.envs.options import whole_number
from sayd_env.envs.registration import id_of


class SaydEnv(Environment, gym.Env[Array32, Array32]):
    """A high-speed rail vehicle whose eight yaw dampers have valves that a policy commands.

    Made by ``gymnasium.make`` with one of these ids:

    - ``SAYD/Nominal-v1``: the paper's vehicle at 350 km/h on worn wheels, with sensors without errors.
    - ``SAYD/Randomized-v1``: speed, wear, friction, track, payload, tolerances and sensor errors drawn for
      each episode.
    - ``SAYD/Faults-v1``: also faults of valves, dampers and sensors.
    - ``SAYD/Line-v0``: as Randomized, over 120 s of a line along which speed, curves, gauge, rail shape,
      friction and irregularities change.

    **Action.** A ``Box`` of valve commands V, float32: 0 closes a valve (strongest damping), 1 opens it. The
    driver turns it into a current after a delay, and the valve's spool follows with its own dynamics and a
    limited rate, so that the acting current lags behind the command. A command holds for one control period,
    10 ms.

    | valves    | number | command of                         | closed | open |
    | --------- | ------ | ---------------------------------- | ------ | ---- |
    | 'bogie'   | 0      | the four valves of the front bogie | 0      | 1    |
    | 'bogie'   | 1      | the four valves of the rear bogie  | 0      | 1    |
    | 'damper'  | 0      | front.left.upper                   | 0      | 1    |
    | 'damper'  | 1      | front.left.lower                   | 0      | 1    |
    | 'damper'  | 2      | front.right.upper                  | 0      | 1    |
    | 'damper'  | 3      | front.right.lower                  | 0      | 1    |
    | 'damper'  | 4      | rear.left.upper                    | 0      | 1    |
    | 'damper'  | 5      | rear.left.lower                    | 0      | 1    |
    | 'damper'  | 6      | rear.right.upper                   | 0      | 1    |
    | 'damper'  | 7      | rear.right.lower                   | 0      | 1    |
    | 'vehicle' | 0      | all eight valves                   | 0      | 1    |

    **Observation.** What a train can measure, in SI units, float32, in a ``Box`` whose bounds are the
    sensors' ranges: the mean of each sensor's readings (1 kHz) over the last control period. With
    ``observation="signals"``, and ``"history"`` for the last of these vectors, oldest first:

    | number   | quantity                  | places, the last changes first      | unit | low  | high    |
    | -------- | ------------------------- | ----------------------------------- | ---- | ---- | ------- |
    | 0 to 3   | lateral_acceleration      | front/rear, leading/trailing        | m/s2 | -100 | 100     |
    | 4 to 7   | longitudinal_acceleration | front/rear, left/right              | m/s2 | -100 | 100     |
    | 8 to 15  | pressure_a                | front/rear, left/right, upper/lower | Pa   | 0    | 1.6e+07 |
    | 16 to 23 | pressure_b                | front/rear, left/right, upper/lower | Pa   | 0    | 1.6e+07 |
    | 24 to 31 | stroke                    | front/rear, left/right, upper/lower | m    | -0.1 | 0.1     |
    | 32 to 39 | current                   | front/rear, left/right, upper/lower | -    | 0    | 1       |
    | 40       | speed                     | -                                   | m/s  | 0    | 140     |

    With ``observation="features"``, the inputs of the paper's controllers, computed from the readings:

    | number   | quantity           | places, the last changes first      | unit | low | high  |
    | -------- | ------------------ | ----------------------------------- | ---- | --- | ----- |
    | 0 to 3   | acceleration_rms   | front/rear, leading/trailing        | m/s2 | 0   | 200   |
    | 4 to 11  | force_rms          | front/rear, left/right, upper/lower | N    | 0   | 29760 |
    | 12 to 13 | dominant_frequency | front/rear                          | Hz   | 1.5 | 12    |
    | 14 to 21 | current            | front/rear, left/right, upper/lower | -    | 0   | 1     |
    | 22 to 29 | command            | front/rear, left/right, upper/lower | -    | 0   | 1     |
    | 30       | speed              | -                                   | m/s  | 0   | 140   |

    ``env.unwrapped.signals`` lists name, unit and range of every number. Networks want numbers of order 1:
    ``scaled=True`` gives them, and `sayd_env.envs.wrappers.NormalizeSignals` maps the ranges to -1 to 1.

    **Reward.** Minus the paper's cost of the period, eq. (27): the mean over the two bogies of
    ``k_y (psi_y / y_lim)^2 + k_F (psi_F / F_max)^2``, from true signals at 1 kHz, scaled such that the
    rewards of a whole second add up to minus the mean J of that second. The acceleration is filtered on line,
    around the bogie's dominant frequency of the last 500 m.

    **Start.** The vehicle runs over 500 m with the initial command, so that filters and spectra are settled.

    **End.** ``truncated`` after `episode_s` seconds. ``terminated`` where a wheel climbs over its rail, where
    Y/Q of a wheel, in the mean over 2 m, exceeds its limit, or where the numbers do not stay finite
    (``info["error"]`` then says so); the reward of that period is charged with `termination_cost` for every
    second that remains.

    **Episodes.** ``reset(seed=s)`` begins episode 0 of seed s, ``reset()`` the next episode of the same seed.
    Episode k is drawn from [s, k] alone: it does not depend on those before.
    ``reset(options={...})`` fixes some of ``speed_kmh, profile, wear, gauge, friction, payload,
    initial_current, track, track_scale, line, faults``.

    **Info.** The same keys after a reset and a step. Of the period ``cost_acceleration`` and ``cost_force``
    (the two squares of the cost, unweighted, means of the bogies; 0 after a reset), ``dominant_frequency``
    (2, Hz), ``distance`` (m since step 0), ``speed`` (m/s), and ``ending`` and ``error``, empty unless the
    run was terminated or diverged. Of the episode ``seed, episode_number, speed_kmh, profile, wheel_shift,
    wear, gauge, friction, track, line, faults``. With
    ``info="full"`` also, at the end of the period: ``damper_force`` (8, N), ``track_shift_force`` (4, N),
    ``wheel_lateral_force`` and
    ``wheel_vertical_force`` (8, N, on the rails; left and right in turn), ``valve_current`` and
    ``valve_command`` (8), ``hydraulic_flow`` (8, m3/s: what the pistons displace) and ``hydraulic_power``
    (8, W: what they put into the oil), and EN 14363's values of the last 100 m behind the on-line filter,
    ``sliding_rms_acceleration`` (4, m/s2) and ``sliding_rms_track_shift`` (4, N), with their limits
    ``limit_acceleration`` and ``limit_track_shift``; for safety the means over 2 m ``mean_quotient`` (8, Y/Q
    towards the flange) and ``mean_track_shift`` (4, N), with ``limit_quotient`` and
    ``limit_mean_track_shift`` (Prud'homme); ``line_section``, ``line_curvature`` (1/m), ``line_cant`` (m),
    ``line_gauge`` (m) and ``line_friction`` where the vehicle is.

    Parameters
    ----------
    environment : str
        A packaged environment (``nominal``, ``randomized``, ``faults``) or a path to a YAML file.
    damper : str, optional
        ``sayd``, or ``passive`` for the vehicle with passive dampers: the same spaces, commands do nothing.
    valves : str, optional
        ``bogie`` (2 commands), ``damper`` (8) or ``vehicle`` (1).
    observation : str, optional
        ``signals``, ``history`` or ``features``.
    history : int, optional
        Vectors in a ``history``.
    reward : str, pair or mapping, optional
        ``"mppt1"``, ``"mppt2"`` (as the study by default), ``"low-force"``, ``(k_y, k_F)`` or
        ``{"k_y": ..., "k_F": ...}``.
    control_period : float, optional
        s; a whole number of milliseconds that divides a second.
    episode_s : float, optional
        s; a multiple of the control period.
    sensors : str, optional
        ``ideal``, ``realistic`` or a path to a YAML file.
    speed_kmh : float, optional
        Speed of all episodes, km/h.
    settings : sequence of str
        ``key=value`` assignments for the scenario, such as ``friction=0.3``. What they set is not drawn.
    scaled : bool
        For learners: observations of order 1 by fixed maps (`configs/learner/scaled.yaml`), cut off at -5 and
        5; actions from -1 (closed) to 1 (open), what reaches beyond is cut off; rewards in multiples of the J
        that an ordinary policy has at the same speed and track level, so that a second gives about -1, and no
        step less than -40.
    info : str
        ``none``, ``basic`` or ``full``.
    render_mode : str, optional
        ``rgb_array`` or ``human``.

    Raises
    ------
    ConfigError
        A keyword, an option or an action that cannot be used; the message names it and what is allowed. An
        unknown keyword is also a ``TypeError``, an action also a ``gymnasium.error.InvalidAction``.
    gymnasium.error.ResetNeeded
        A step before the first reset or after the end of an episode.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 100}  # noqa: RUF012

    def __init__(
        self,
        environment: str = "nominal",
        *,
        scaled: bool = False,
        info: str = "basic",
        render_mode: str | None = None,
        **keywords: Unpack[Keywords],
    ) -> None:
        self._make(1, environment, keywords, scaled, info, render_mode, num_threads=1)
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.config.control_period)}
        self.observation_space, self.action_space = self._spaces()
        self._shape = (self.interface.actions,)
        own = {"environment": environment, "scaled": scaled, "info": info, "render_mode": render_mode}
        self.spec = EnvSpec(id_of(environment), "sayd_env.envs.single:SaydEnv", kwargs={**own, **keywords})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
            Begin episode 0 of this seed; by default the next episode of the last seed.
        options : dict, optional
            What to fix of the episode.

        Raises
        ------
        ConfigError
            An unknown option, a value that is not allowed, or one that the episode's line says itself.
        DataError
            A measured track or line that cannot be used.
        """
        seed = None if seed is None else whole_number("seed", seed)
        super().reset(seed=seed)
        self._begin([0], [seed], options)
        if self.render_mode == "human":
            self.render()
        return self._observed()[0], self._info(0)

    def step(self, action: Array32) -> tuple[Array32, SupportsFloat, bool, bool, dict[str, Any]]:
        """Hold valve commands for one control period.

        Parameters
        ----------
        action : ndarray, shape (A,)
            Valve commands from 0 (closed) to 1 (open).

        Raises
        ------
        InvalidAction
            An action of another shape, out of range by more than rounding (1e-6) or not finite.
        gymnasium.error.ResetNeeded
            No episode is running.
        """
        if self._over[0]:
            raise ResetNeeded("no episode is running: call reset before step")
        values = self._commands(action)
        observation, rewards, terminated, truncated = self._advance(values[None])
        ended, late = bool(terminated[0]), bool(truncated[0])
        self._over[0] = ended or late
        if self.render_mode == "human":
            self.render()
        return observation[0], float(rewards[0]), ended, late, self._info(0)

    def render(self) -> Any:
        """A picture of the vehicle: an array of shape (height, width, 3), or None with ``human``."""
        if self.render_mode is None:
            gym.logger.warn("render() needs a render_mode: give make render_mode='rgb_array' or 'human'")
            return None
        return self._pictures()[0]

    def close(self) -> None:
        """Close the window, if there is one. Closing it again has no effect."""
        self._close_window()
