"""A safe fallback around any policy: a monitor of the sensors that closes the valves of a bogie."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.baselines.constant import Passive
from sayd_env.baselines.hunting_indicator import Hunting, hunting_indicator
from sayd_env.baselines.observation_layout import interface_of
from sayd_env.baselines.sensor_twins import Agreement, SensorTwins
from sayd_env.config import ConfigError
from sayd_env.config.explain import shown
from sayd_env.config.safe import load_safe
from sayd_env.config.units import Array, Array32, Flags, Integers
from sayd_env.envs.interface import BOGIES, RunIn

SAFE = "safe:"
"""Before the name of any policy: this one inside the fallback."""


@dataclass
class Watch:
    """State of n vehicles: that of the policy inside, and of the monitor."""

    policy: Any
    began: bool
    """Whether the policy inside has acted, or has taken the run-in."""
    hunting: Hunting
    agreement: Agreement
    slow: Integers
    """(n,) control periods for which the speed has read less than a running train's."""
    closed: Flags
    """(n, 2) whether the monitor holds the valves of a bogie closed."""
    trips: Integers
    """(n, 2) how often hunting has closed them; forgotten after a long calm."""
    calm: Integers
    """(n, 2) control periods since the last cause."""
    share: Array
    """(n, 2) how much of the policy's command acts: 0 none, 1 all."""
    periods: Integers
    """(n,) control periods since the start of the episode."""
    intervened: Integers
    """(n, 2) those in which it was less than all."""
    content: bool
    """Whether the monitor holds nothing of any vehicle, and remembers nothing against it."""


class SafeFallback:
    """Any policy, and a monitor that closes the valves of a bogie which hunts or whose sensors lie.

    For each bogie, from the observation alone:

        hunting      the band-passed acceleration of the frame, RMS over the limit of EN 14363, exceeds `trip`
        sensors      two sensors that measure the same motion differ in RMS or mean (`SensorTwins`)
        speed        its reading is below that of a running train: a dead sensor, or a standing train

    Any of them closes the valves of the bogie (`command`), in the same control period. They stay closed until
    no cause has been there and the indicator has been below `release` for the whole time `hold`, which
    doubles with each trip by hunting. Then the policy's command comes back over the time `reopening`. The
    policy inside observes and decides all the time; while the monitor is content, its actions pass through
    bit by bit.

    Parameters
    ----------
    policy : object
        With the `predict` of all policies.
    interface : Interface, optional
        Or whatever `baselines.make` takes for an environment; by default the policy's own.
    **thresholds
        Values that replace those of ``configs/control/safe.yaml``.

    Attributes
    ----------
    name : str
        ``safe:`` and the name of the policy.
    policy
        The one inside.
    interface : Interface
    parameters : SafeConfig
    sensors : tuple of str
        Signals that the monitor reads.

    Raises
    ------
    ConfigError
        A fallback already, or passive dampers, which nothing closes; a policy of which nobody knows the
        environment; observations without accelerations; thresholds that cannot be used.

    Examples
    --------
    >>> from sayd_env import baselines
    >>> policy = baselines.SafeFallback(baselines.make("mppt2", "SAYD/Nominal-v1"))
    >>> policy.name
    'safe:mppt2'
    """

    def __init__(self, policy: Any, interface: Any = None, **thresholds: Any) -> None:
        inside = str(getattr(policy, "name", type(policy).__name__))
        self.name = SAFE + inside
        own = getattr(policy, "interface", None) if interface is None else interface
        if own is None:
            raise ConfigError(
                f"{self.name}: the policy has no attribute 'interface'; give the environment as well"
            )
        if isinstance(policy, SafeFallback):
            raise ConfigError(f"{self.name}: is a fallback already")
        if isinstance(policy, Passive):
            raise ConfigError(f"{self.name}: no command reaches passive dampers; name '{inside}' alone")
        self.policy, self.interface, self.parameters = policy, interface_of(own), load_safe(thresholds)
        self.interface.check(self.name, {})
        self._indicator = hunting_indicator(self.name, self.interface, self.parameters)
        self._twins = SensorTwins(self.interface, self.parameters, _sensors_of(policy))
        self._hunting, self._pairs = (
            np.array([self.interface.index(name) for name in part.sensors], dtype=np.intp)
            for part in (self._indicator, self._twins)
        )
        self._speed = self.interface.index("speed")
        signals = {**dict.fromkeys(self._indicator.sensors), **dict.fromkeys(self._twins.sensors)}
        self.sensors = (*dict.fromkeys((*signals, "speed")),)

        def periods(seconds: float) -> int:
            return max(1, round(seconds / self.interface.control_period))

        times = self.parameters
        self._hold, self._longest = periods(times.hold), periods(times.longest_hold)
        self._confirmation, self._reopening = periods(times.confirmation), periods(times.reopening)

    def state_after(self, run_in: RunIn) -> Watch | None:
        """State at step 0 of a monitor that was running during the run-in, as the policy inside perhaps was.

        Parameters
        ----------
        run_in : RunIn
            What the vehicles observed before step 0.

        Returns
        -------
        Watch or None
            For the first call of `predict`; None if there was no run-in.
        """
        if not len(run_in.observations):
            return None
        rows = _numbers(run_in.observations.astype(np.float64))
        state = self._begin(rows[-1])
        # The last observation is that of the reset: `predict` gets it.
        for t, row in enumerate(rows[:-1]):
            for vehicle in np.flatnonzero(run_in.begins == t):
                # The speed's sensor rises slowly to its reading: the last one says how long the spectrum is.
                ahead = row.copy()
                ahead[:, self._speed] = rows[-1, :, self._speed]
                self._restart_monitor(state, ahead, int(vehicle))
            self._take(state, row)
        if hasattr(self.policy, "state_after"):
            state.policy = self.policy.state_after(run_in)
            state.began = state.policy is not None
        return state

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Watch | None = None,
        episode_start: npt.ArrayLike | None = None,
        deterministic: bool = True,
    ) -> tuple[Array32, Watch]:
        """Valve commands for the next control period, see `Policy.predict`.

        Raises
        ------
        ConfigError
            Shapes that do not fit each other or the environment; as the policy inside.
        """
        values, single = self.interface.rows(observation, self.name)
        if not np.isfinite(values).all():
            values = _numbers(values)
            observation = values[0] if single else values
        newest = values[:, -1] if self.interface.observation == "history" else values
        starts = None if episode_start is None else np.atleast_1d(np.asarray(episode_start, dtype=np.bool_))
        if state is None:
            state = self._begin(newest)
        elif not isinstance(state, Watch):
            raise ConfigError(
                f"{self.name}: state: found {shown(state)}; expected what the last call returned"
            )
        elif len(state.share) != len(newest):
            raise ConfigError(
                f"{self.name}: the state is that of {len(state.share)} vehicles, the observation that of "
                f"{len(newest)}; start with state=None"
            )
        elif starts is not None and starts.shape != (len(newest),):
            raise ConfigError(
                f"{self.name}: found episode_start of shape {starts.shape}; expected ({len(newest)},)"
            )
        elif starts is not None:
            for vehicle in np.flatnonzero(starts):
                self._restart(state, newest, int(vehicle))
        if not state.began and starts is not None:
            episode_start = np.ones_like(starts)  # the monitor has seen the run-in, the policy has not
        action, state.policy = self.policy.predict(
            observation, state.policy, episode_start, deterministic=deterministic
        )
        state.began = True
        self._watch(state, newest)
        return self._guarded(action, state.share[0] if single else state.share), state

    def intervening(self, state: Watch) -> Flags:
        """Bogies in which the last action was not quite the policy's own, shape (n, 2)."""
        return np.less(state.share, 1.0)

    def interventions(self, state: Watch) -> Array:
        """Share of the control periods of the episode in which this was so, shape (n, 2)."""
        return np.asarray(state.intervened / np.maximum(state.periods, 1)[:, None])

    def _begin(self, rows: Array) -> Watch:
        count = len(rows)
        shape = (count, len(BOGIES))
        return Watch(
            policy=None,
            began=False,
            hunting=self._indicator.begin(rows[:, self._hunting]),
            agreement=self._twins.begin(rows[:, self._pairs]),
            slow=np.zeros(count, dtype=np.int64),
            closed=np.zeros(shape, dtype=np.bool_),
            trips=np.zeros(shape, dtype=np.int64),
            calm=np.zeros(shape, dtype=np.int64),
            share=np.ones(shape),
            periods=np.zeros(count, dtype=np.int64),
            intervened=np.zeros(shape, dtype=np.int64),
            content=True,
        )

    def _restart(self, state: Watch, rows: Array, vehicle: int) -> None:
        """Put one vehicle back to the start of an episode."""
        self._restart_monitor(state, rows, vehicle)
        for values in (state.slow, state.closed, state.trips, state.calm, state.periods, state.intervened):
            values[vehicle] = 0
        state.share[vehicle] = 1.0

    def _restart_monitor(self, state: Watch, rows: Array, vehicle: int) -> None:
        self._indicator.restart(state.hunting, rows[:, self._hunting], vehicle)
        self._twins.restart(state.agreement, rows[:, self._pairs], vehicle)

    def _take(self, state: Watch, rows: Array) -> None:
        self._indicator.take(state.hunting, rows[:, self._hunting])
        self._twins.take(state.agreement, rows[:, self._pairs])

    def _watch(self, state: Watch, rows: Array) -> None:
        """Advance the monitor by one control period."""
        self._take(state, rows)
        limits = self.parameters
        indicator = self._indicator.values(state.hunting)
        hunts = indicator > limits.trip
        state.slow = np.where(rows[:, self._speed] >= limits.slowest, 0, state.slow + 1)
        cause = hunts | self._twins.untrusted(state.agreement)
        cause |= (state.slow >= self._confirmation)[:, None]
        state.periods += 1
        if state.content and not cause.any():
            state.calm += 1
            return
        state.trips += hunts & ~state.closed
        state.calm = np.where(cause | (state.closed & (indicator > limits.release)), 0, state.calm + 1)
        # Sixty doublings are beyond any hold.
        doubled = self._hold * 2.0 ** np.clip(state.trips - 1, 0, 60)
        state.closed = cause | (state.closed & (state.calm < np.minimum(doubled, self._longest)))
        state.share = np.where(state.closed, 0.0, np.minimum(1.0, state.share + 1.0 / self._reopening))
        state.trips[~state.closed & (state.calm > 2 * self._longest)] = 0
        state.intervened += self.intervening(state)
        state.content = not state.trips.any() and bool(np.all(state.share == 1.0))

    def _guarded(self, action: Array32, share: Array) -> Array32:
        """The policy's commands, shape (..., A), with shares (..., 2) of the bogies."""
        if np.all(share == 1.0):
            return action
        if self.interface.actions == 1:  # one command for both bogies
            of_each = share.min(axis=-1, keepdims=True)
        else:
            of_each = np.repeat(share, self.interface.actions // len(BOGIES), axis=-1)
        closed = self.parameters.command
        mixed = closed + of_each * (np.asarray(action, dtype=np.float64) - closed)
        return np.where(of_each == 1.0, action, mixed.astype(np.float32))


def _numbers(rows: Array) -> Array:
    """Readings of which one that is no number is a dead sensor's."""
    return rows if np.isfinite(rows).all() else np.where(np.isfinite(rows), rows, 0.0)


def _sensors_of(policy: Any) -> Collection[str] | None:
    """Signals that a policy says it reads; None if it does not say."""
    found = getattr(policy, "sensors", None)
    return found if isinstance(found, tuple) else None
