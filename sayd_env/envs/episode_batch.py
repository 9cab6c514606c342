"""Vehicles that run episodes side by side, as an environment's configuration says.

What single environment, batch environment and rollout evaluator share: from an episode that was drawn to
vehicles under control, from policies' actions to valve commands, from signals to observations, rewards and
ends. It knows no Gymnasium.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError
from sayd_env.config.conditions import Line, amplitude
from sayd_env.config.control import OnlineConfig, load_online
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.fault import SensorNoisy
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.sensors import SIGNALS as SENSED
from sayd_env.config.sensors import UNITS
from sayd_env.config.units import Array, Array32, Flags
from sayd_env.envs.cost import termination_charge
from sayd_env.envs.draw import Episode, episode_scenario
from sayd_env.envs.faults import FaultSchedule
from sayd_env.envs.interface import ACTIONS, BOGIES, Interface, RunIn, Signal
from sayd_env.envs.interface import DAMPERS as OF_A_BOGIE
from sayd_env.envs.interface import POINTS as OF_A_FRAME
from sayd_env.envs.loop import CLIMBED, NOT_FINITE, OVERLOADED, RUNNING
from sayd_env.envs.options import number_array
from sayd_env.envs.trace import DAMPERS, POSITION
from sayd_env.envs.vehicle import (
    LoopSettings,
    SensorErrors,
    Vehicle,
    make_vehicle,
    model_limits,
    on_line_band,
    run_in_distance,
)
from sayd_env.envs.vehicle_batch import VehicleBatch, VehicleState
from sayd_env.measured.lines import load_line
from sayd_env.physics.batch import checked_threads
from sayd_env.physics.simulator import RUN_OUT, VehicleModel
from sayd_env.physics.track.realisation import TrackRealisation, realise, realise_line
from sayd_env.stability import Limits

ROUNDING = 1e-6
"""So far may a valve command be beyond its bound: a map to 0 to 1 in float32 rounds."""
ENDINGS = {
    CLIMBED: "derailment: a wheel has climbed over its rail",
    OVERLOADED: "derailment risk: mean Y/Q beyond its limit",
    NOT_FINITE: "non-finite: the simulation diverged",
}
"""What a vehicle's status means."""


@dataclass(frozen=True, eq=False)
class EpisodeState:
    """All of one vehicle of a batch at an instant."""

    config: EnvironmentConfig
    scenario: Scenario
    vehicle: VehicleState
    episode: Episode | None
    line: Line | None
    elapsed: int
    limits: Limits
    faults: FaultSchedule | None
    """What is still to happen."""
    history: Array32


class EpisodeBatch:
    """Vehicles that run episodes.

    Parameters
    ----------
    config : EnvironmentConfig
        What the episodes are.
    count : int
        Number of vehicles.
    scenario : Scenario, optional
        The scenario in place of the one that the configuration names.
    num_threads : int, optional
        Threads, as in `VehicleBatch`.
    motion : bool
        Trace the motion of all unknowns, too.

    Raises
    ------
    ConfigError
        A configuration that does not fit together.

    Attributes
    ----------
    interface : Interface
        What a policy may know.
    steps : int
        Control periods after which an episode is truncated.
    elapsed : ndarray, shape (count,)
        Control periods of each vehicle's episode so far.
    episodes : list of Episode
        What each vehicle runs; None before the first reset.
    lines : list of Line
        What changes along each vehicle's way; None where nothing does.
    limits : list of Limits
        Each vehicle's limits of EN 14363.
    observed_run_in : RunIn or None
        What all vehicles observed in their run-in, if the last reset was asked to keep it.
    """

    def __init__(
        self,
        config: EnvironmentConfig,
        count: int,
        *,
        scenario: Scenario | None = None,
        num_threads: int | None = None,
        motion: bool = False,
    ) -> None:
        if count < 1:
            raise ConfigError(f"found {count} vehicles; expected at least 1")
        self.config = config
        self.count = count
        self.scenario = environment_scenario(config) if scenario is None else scenario
        self.settings = loop_settings(config, self.scenario)
        self.interface = make_interface(config, self.scenario, self.settings.online)
        self.steps = round(config.episode_s / config.control_period)
        self.elapsed = np.zeros(count, dtype=np.int64)
        self.episodes: list[Episode | None] = [None] * count
        self.lines: list[Line | None] = [None] * count
        self._model = VehicleModel(self.scenario)
        self._band = on_line_band(self._model, self.settings)
        self._num_threads = None if num_threads is None else checked_threads(num_threads)
        self._motion = motion
        self._vehicles: VehicleBatch | None = None
        self._models: list[VehicleModel | None] = [None] * count
        self._faults: list[FaultSchedule | None] = [None] * count
        self.limits = [model_limits(self._model)] * count
        self._low = np.array([signal.low for signal in self.interface.signals])
        self._high = np.array([signal.high for signal in self.interface.signals])
        nothing = np.clip(0.0, self._low, self._high).astype(np.float32)
        self._history = np.broadcast_to(nothing, (count, *self.interface.shape)).copy()
        self._bounded = np.zeros((count, len(self.interface.signals)))
        self._valve = np.repeat(np.arange(ACTIONS[config.valves]), DAMPERS // ACTIONS[config.valves])
        self._commanded = np.zeros((count, DAMPERS))
        self._faulty = False
        self.observed_run_in: RunIn | None = None

    def __getstate__(self) -> dict[str, Any]:
        """A copy assembles its vehicles anew when it is asked for them."""
        return self.__dict__ | {"_models": [None] * self.count}

    def _batch(self, vehicles: Sequence[Vehicle]) -> VehicleBatch:
        return VehicleBatch(self.settings, self._band, vehicles, self._num_threads, motion=self._motion)

    @property
    def vehicles(self) -> VehicleBatch:
        """The vehicles under control.

        Raises
        ------
        ConfigError
            Before the first reset.
        """
        if self._vehicles is None:
            raise ConfigError("step before reset: call reset first")
        return self._vehicles

    def reset(
        self,
        which: Sequence[int],
        episodes: Sequence[Episode],
        *,
        log: bool = False,
        keep_run_in: bool = False,
        watch: Callable[[int], None] | None = None,
        whole_track: bool = True,
        steps: Sequence[int] | None = None,
    ) -> list[Array]:
        """Begin episodes: build the vehicles and run them in.

        Parameters
        ----------
        which : sequence of int
            Vehicles that begin; at the first call all of them.
        episodes : sequence of Episode
            One for each of these.
        log : bool
            Return the true signals of the run-in, as `VehicleBatch.run_in` does.
        keep_run_in : bool
            Keep the observations of the run-in in `observed_run_in`.
        watch : callable, optional
            Called after each control period of the run-in with its number, see `VehicleBatch.run_in`.
        whole_track : bool
            Make the track for an assessed run. False: so far as the episode goes by its configuration.
        steps : sequence of int, optional
            Control periods that count of each, for what a measured track has to cover; by default those of
            the configuration.

        Raises
        ------
        ConfigError
            An episode that cannot be, such as a speed beyond the vehicle's.
        DataError
            A measured track that does not cover the episode.
        """
        models = [self._model_of(episode) for episode in episodes]
        lines = [self._line(model, episode) for model, episode in zip(models, episodes, strict=True)]
        episodes = [_on_line(episode, line) for episode, line in zip(episodes, lines, strict=True)]
        built = [
            self._vehicle(model, episode, line, whole_track, n)
            for model, episode, line, n in zip(
                models, episodes, lines, steps or [self.steps] * len(models), strict=True
            )
        ]
        if self._vehicles is None:
            if sorted(which) != list(range(self.count)):
                raise ConfigError("the first reset must be one of all vehicles")
            ordered = [built[list(which).index(i)] for i in range(self.count)]
            self._vehicles = self._batch(ordered)
        else:
            for i, vehicle in zip(which, built, strict=True):
                self._vehicles.put(i, vehicle)
        self.observed_run_in = self._prepared(self._vehicles, which) if keep_run_in else None
        watchers = [
            each for each in (self._keep_observed if keep_run_in else None, watch) if each is not None
        ]
        logs = self._vehicles.run_in(which, log=log, each_period=_in_turn(watchers) if watchers else None)
        for i, model, episode, line in zip(which, models, episodes, lines, strict=True):
            self.episodes[i], self.lines[i], self._models[i] = episode, line, model
            self.limits[i] = model_limits(model)
            self.elapsed[i] = 0
            self._faults[i] = FaultSchedule(episode.faults) if episode.faults else None
            self._strike(i)
        self._faulty = any(schedule is not None for schedule in self._faults)
        self._observe(which, fresh=True)
        return logs

    def model(self, i: int) -> VehicleModel:
        """The vehicle of an episode that has begun, as its conditions make it."""
        found, episode = self._models[i], self.episodes[i]
        if found is None:
            assert episode is not None  # the reset has set it
            found = self._models[i] = self._model_of(episode)
        return found

    def _prepared(self, vehicles: VehicleBatch, which: Sequence[int]) -> RunIn:
        """Room for the observations of a run-in."""
        periods = np.zeros(self.count, dtype=np.int64)
        periods[list(which)] = [vehicles.vehicle(i).run_in for i in which]
        longest = int(periods.max())
        shape = (longest, self.count, len(self.interface.signals))
        return RunIn(np.zeros(shape, dtype=np.float32), longest - periods)

    def _keep_observed(self, period: int) -> None:
        """Keep what is observed at the end of a control period of the run-in."""
        assert self.observed_run_in is not None  # the reset has made it
        self.observed_run_in.observations[period] = np.nan_to_num(self._newest())

    def _vehicle(
        self, model: VehicleModel, episode: Episode, line: Line | None, whole_track: bool, steps: int
    ) -> Vehicle:
        period = self.config.control_period
        distance = _way(episode, line, self.config.episode_s + period)
        judged = _way(episode, line, steps * period)
        return make_vehicle(
            model,
            episode.speed,
            self._track(model, episode, line, distance, judged, whole_track),
            self.config.sensors,
            self.settings,
            band_constants=self._band,
            current=episode.initial_current,
            errors=SensorErrors(episode.sensor_bias, episode.sensor_noise),
            noise=self._noise(episode),
            line=line,
            distance=distance,
        )

    def _line(self, model: VehicleModel, episode: Episode) -> Line | None:
        """What changes along an episode's way, where it leaves something out as the episode has it."""
        if episode.line is None or isinstance(episode.line, Line):
            return episode.line
        scenario = model.scenario
        line = load_line(
            episode.line, speed=episode.speed, gauge=scenario.track.gauge, friction=scenario.friction
        )
        return None if line.plain else line

    def _model_of(self, episode: Episode) -> VehicleModel:
        scenario = episode_scenario(self.scenario, episode)
        return self._model if scenario is self.scenario else VehicleModel(scenario)

    def _track(
        self,
        model: VehicleModel,
        episode: Episode,
        line: Line | None,
        distance: float,
        judged: float,
        whole: bool,
    ) -> TrackRealisation:
        """The episode's track: of an assessed run, so that the episode's length does not change it."""
        track, assessment = model.scenario.track, model.scenario.assessment
        assessed = assessment.run_in + (assessment.length or 0.0)
        needed = self.config.run_in + distance
        length = assessed * max(1, math.ceil(needed / assessed)) + RUN_OUT
        covered = length if whole else needed + RUN_OUT
        origin = run_in_distance(model, episode.speed, self.settings)
        # What an assessed run goes beyond the assessed length is not judged.
        to_assess = assessment.length or 0.0
        end = origin + (to_assess if to_assess <= judged <= to_assess + RUN_OUT else judged)
        if line is None:
            part = [(origin, end)]
            return realise(track.irregularity, length, episode.track_seed, covered=covered, judged=part)
        return realise_line(
            line, track, length, episode.track_seed, origin, covered=covered, judged=(origin, end)
        )

    def _noise(self, episode: Episode) -> np.random.Generator | None:
        """Source of the noise of an episode's sensors, if any of them has or gets some."""
        noisy = any(self.config.sensors.of(signal).noise > 0.0 for signal in SENSED)
        noisy = noisy or any(isinstance(fault, SensorNoisy) for fault in episode.faults)
        return np.random.default_rng(episode.stream("noise")) if noisy else None

    def step(
        self, actions: npt.ArrayLike, *, log: Array | None = None, active: Flags | None = None
    ) -> tuple[Array32, Array, Flags, Flags]:
        """Run all vehicles over one control period.

        Parameters
        ----------
        actions : array_like, shape (count, A)
            Valve commands, checked by `checked_actions`.
        log : ndarray, shape (count, samples, LOG), optional
            Receives the true signals.
        active : ndarray of bool, shape (count,), optional
            Vehicles that run; all by default.

        Returns
        -------
        observations : ndarray of float32, shape (count, *interface.shape)
            A new array.
        rewards : ndarray, shape (count,)
            Minus the mean of the bogies' J over the period, and minus the charge for a termination.
        terminated, truncated : ndarray of bool, shape (count,)
        """
        vehicles = self.vehicles
        running = self._running(active)
        np.asarray(actions, dtype=np.float64).take(self._valve, axis=1, out=self._commanded)
        if active is not None:  # the others keep their commands, which telemetry shows
            self._commanded[~active] = vehicles.command[~active]
        vehicles.step(self._commanded, log=log, active=active)
        self.elapsed += running
        truncated = self.elapsed >= self.steps
        terminated = vehicles.status != RUNNING
        ended = np.count_nonzero(terminated)
        rewards = vehicles.rewards.copy()
        if ended or active is not None:
            rewards[~running] = 0.0
            truncated &= ~terminated
        for i in self._to_charge(terminated, running, active) if ended else ():
            rewards[i] = self._last_reward(i)
        if self._faulty:
            for i in map(int, np.flatnonzero(running)):
                self._strike(i)
        self._observe(range(self.count), fresh=False)
        return self.observations(), rewards, terminated, truncated

    def _running(self, active: Flags | None) -> Flags:
        """Vehicles that run in a step."""
        running: Flags = self.vehicles.status == RUNNING
        return running if active is None else running & active

    def _to_charge(self, terminated: Flags, running: Flags, active: Flags | None) -> list[int]:
        """Vehicles whose run ended in this step, or before step 0, for which this is the first step."""
        before = ~running & (self.elapsed == 0)
        ended = terminated & (running | (before if active is None else before & active))
        return [int(i) for i in np.flatnonzero(ended)]

    def _last_reward(self, i: int) -> float:
        """Reward of the period in which a run ended, with the charge for the rest of the episode."""
        last = float(self.vehicles.rewards[i]) if self.elapsed[i] else 0.0
        elapsed = float(self.elapsed[i] * self.config.control_period)
        charge = termination_charge(self.config, self.scenario.cost, elapsed)
        return (last if math.isfinite(last) else 0.0) - charge

    def observations(self) -> Array32:
        """What the vehicles observe, a new array of shape (count, *interface.shape)."""
        return self._history.copy()

    def dominant_frequency(self) -> Array:
        """f_0 of the on-line filter of each bogie, a new array of shape (count, BOGIES), Hz."""
        vehicles = self.vehicles
        found: Array = vehicles.band.frequency[vehicles.choice()]
        return found

    def mean_speed(self, i: int) -> float:
        """Mean speed of a vehicle's episode by its configuration (m/s)."""
        episode, line = self.episodes[i], self.lines[i]
        assert episode is not None  # the reset has set it
        along = None if line is None else line.distance_at(self.config.episode_s)
        return episode.speed if along is None else float(along) / self.config.episode_s

    def track_level(self, i: int) -> float | None:
        """Factor on the amplitudes of the track, on a line the RMS over an episode; None: the track's own."""
        episode, line = self.episodes[i], self.lines[i]
        assert episode is not None  # the reset has set it
        if line is None or not line.tracks:
            return episode.track_scale
        bounds = np.array([(piece.start, piece.end) for piece in line.tracks])
        bounds[-1, 1] = math.inf  # beyond its end a line goes on
        inside = np.clip(bounds, 0.0, self.mean_speed(i) * self.config.episode_s)
        own = episode.track_scale
        if own is None:
            own = amplitude(episode.irregularity or self.scenario.track.irregularity)
        levels = [piece.level(own) for piece in line.tracks]
        return float(np.sqrt(np.average(np.square(levels), weights=inside[:, 1] - inside[:, 0])))

    def distance(self) -> Array:
        """How far each vehicle's centre has gone since step 0, a new array of shape (count,), m."""
        vehicles = self.vehicles
        return np.asarray(vehicles.trace[:, -1, POSITION] - vehicles.origin)

    def get_state(self, i: int) -> EpisodeState:
        """All of a vehicle and its episode, as copies; it can be pickled."""
        return EpisodeState(
            config=self.config,
            scenario=self.scenario,
            vehicle=self.vehicles.get_state(i),
            episode=self.episodes[i],
            line=self.lines[i],
            elapsed=int(self.elapsed[i]),
            limits=self.limits[i],
            faults=copy.deepcopy(self._faults[i]),
            history=self._history[i].copy(),
        )

    def set_state(self, states: Sequence[EpisodeState]) -> None:
        """Put all vehicles back to states of these or of others of the same environment.

        Raises
        ------
        ConfigError
            States of another environment or of another number of vehicles.
        """
        if len(states) != self.count:
            raise ConfigError(f"state: found one of {len(states)} vehicles; expected {self.count}")
        if any(not self._is_own(state) for state in states):
            raise ConfigError(
                "state: found one of another environment; expected one of equal configuration, settings and "
                "reward"
            )
        if self._vehicles is None:
            vehicles = [state.vehicle.built for state in states]
            self._vehicles = self._batch(vehicles)
        for i, state in enumerate(states):
            self._vehicles.set_state(i, state.vehicle)
            self.episodes[i], self.lines[i], self._models[i] = state.episode, state.line, None
            self.elapsed[i] = state.elapsed
            self.limits[i] = state.limits
            self._faults[i] = copy.deepcopy(state.faults)
            self._history[i] = state.history
        self._faulty = any(schedule is not None for schedule in self._faults)

    def _is_own(self, state: EpisodeState) -> bool:
        """Whether a state is one of this environment; a batch's own share their configuration with it."""
        pairs = (state.config, self.config), (state.scenario, self.scenario)
        return all(theirs is own or theirs == own for theirs, own in pairs)

    def ending(self, i: int) -> str:
        """Why a vehicle's episode was terminated."""
        return ENDINGS[int(self.vehicles.status[i])]

    def _strike(self, i: int) -> None:
        """Let the faults happen whose time has come."""
        schedule = self._faults[i]
        if schedule is not None:
            schedule.apply(self.elapsed[i] * self.config.control_period, self.vehicles, i)

    def _newest(self) -> Array:
        """The signals or features of the last period within their ranges: scratch, shape (count, numbers)."""
        newest = self.vehicles.features if self.settings.features else self.vehicles.signals
        np.maximum(newest, self._low, out=self._bounded)
        bounded: Array = np.minimum(self._bounded, self._high, out=self._bounded)
        return bounded

    def _observe(self, which: Sequence[int], *, fresh: bool) -> None:
        """Take over the last signals of some vehicles; those of a fresh one fill its whole history.

        Where a run diverged, the observation of the period before stays: nothing but numbers gets out.
        """
        vehicles = self.vehicles
        values = self._newest()
        rows: Any = slice(None) if len(which) == self.count else np.asarray(which, dtype=np.intp)
        if np.count_nonzero(vehicles.status):
            rows = np.array([i for i in which if vehicles.status[i] != NOT_FINITE], dtype=np.intp)
        if self.config.observation != "history":
            self._history[rows] = values[rows]
        elif fresh:
            self._history[rows] = values[rows, None]
        else:
            self._history[rows, :-1] = self._history[rows, 1:]
            self._history[rows, -1] = values[rows]


def _in_turn(calls: Sequence[Callable[[int], None]]) -> Callable[[int], None]:
    """All of these as one."""

    def every(period: int) -> None:
        for call in calls:
            call(period)

    return every


def _way(episode: Episode, line: Line | None, time: float) -> float:
    """How far an episode gets within a time from step 0 on (m)."""
    along = None if line is None else line.distance_at(time)
    return episode.speed * time if along is None else float(along)


def _on_line(episode: Episode, line: Line | None) -> Episode:
    """The episode, at the speed that its line begins with."""
    speed = None if line is None else line.speed_at(0.0)
    return episode if speed is None else replace(episode, speed=float(speed))


def environment_scenario(
    config: EnvironmentConfig, overrides: Sequence[str] = (), option: str = "--set"
) -> Scenario:
    """Scenario of an environment: its study with its kind of yaw dampers.

    Parameters
    ----------
    config : EnvironmentConfig
        The environment.
    overrides : sequence of str
        ``key=value`` assignments for the scenario, applied last.
    option : str
        What a message calls the place of the assignments.

    Raises
    ------
    ConfigError
        See `load_scenario`.
    """
    scenario = load_scenario(config.study)
    if scenario.damper.type != config.damper or overrides:
        kind = () if scenario.damper.type == config.damper else (f"damper={config.damper}",)
        scenario = load_scenario(config.study, (*kind, *overrides), option)
    return scenario


def loop_settings(config: EnvironmentConfig, scenario: Scenario) -> LoopSettings:
    """What the vehicles of an environment have in common."""
    return LoopSettings(
        online=load_online(),
        control_period=config.control_period,
        sample_rate=scenario.assessment.sample_rate,
        run_in=config.run_in,
        features=config.observation == "features",
        quotient_limit=config.derailment.quotient,
        averaging=config.derailment.averaging,
    )


def make_interface(config: EnvironmentConfig, scenario: Scenario, online: OnlineConfig) -> Interface:
    """What a policy may know of an environment."""
    features = config.observation == "features"
    return Interface(
        observation=config.observation,
        signals=feature_list(config, scenario) if features else signal_list(config),
        history=config.history if config.observation == "history" else 1,
        valves=config.valves,
        control_period=config.control_period,
        damper=scenario.damper,
        acceleration_limit=model_limits(VehicleModel(scenario)).acceleration,
        force_reference=scenario.cost.force_reference,
        online=online,
        assessment=scenario.assessment,
    )


def signal_list(config: EnvironmentConfig) -> tuple[Signal, ...]:
    """The signals of an observation, with the sensors' ranges."""
    return tuple(_sensed(config, name, name) for name in SENSED)


def feature_list(config: EnvironmentConfig, scenario: Scenario) -> tuple[Signal, ...]:
    """The features of an observation, with the ranges that follow from those of the sensors."""
    sensors, assessment = config.sensors, scenario.assessment
    damper = scenario.damper
    if not isinstance(damper, SaydDamperConfig):  # the passive vehicle has the spaces of the other one
        damper = environment_scenario(config.model_copy(update={"damper": "sayd"})).damper
    area = damper.cylinder.area if isinstance(damper, SaydDamperConfig) else 0.0
    acceleration = max(abs(sensors.lateral_acceleration.low), abs(sensors.lateral_acceleration.high))
    force = area * (sensors.pressure.high - sensors.pressure.low)
    dampers = [f"{bogie}.{place}" for bogie in BOGIES for place in OF_A_BOGIE]
    points = [f"{bogie}.{place}" for bogie in BOGIES for place in OF_A_FRAME]
    low, high = assessment.frequency_min, assessment.frequency_max
    return (
        # A band-pass filter may overshoot the range of what it is given.
        *(Signal(f"acceleration_rms.{place}", "m/s2", 0.0, 2.0 * acceleration) for place in points),
        *(Signal(f"force_rms.{place}", "N", 0.0, max(force, 1.0)) for place in dampers),
        *(Signal(f"dominant_frequency.{bogie}", "Hz", low, high) for bogie in BOGIES),
        *(_sensed(config, f"current.{place}", f"current.{place}") for place in dampers),
        *(Signal(f"command.{place}", "-", 0.0, 1.0) for place in dampers),
        _sensed(config, "speed", "speed"),
    )


def _sensed(config: EnvironmentConfig, name: str, signal: str) -> Signal:
    sensor = config.sensors.of(signal)
    return Signal(name, UNITS[SENSED[signal]], sensor.low, sensor.high)


class OutOfRange(ConfigError):
    """Valve commands beyond 0 to 1, which may be cut off."""


def checked_actions(actions: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
    """Valve commands of the right shape, each a number from 0 to 1; rounding beyond is cut off.

    Raises
    ------
    ConfigError
        Anything else, `OutOfRange` for numbers; the message names the value and what is allowed.
    """
    values = number_array("action", actions, shape)
    if values.shape != shape:
        raise ConfigError(f"action: found shape {values.shape}; expected {shape}")
    inside = (values >= 0.0) & (values <= 1.0)
    if np.count_nonzero(inside) == inside.size:
        return values
    inside = (values >= -ROUNDING) & (values <= 1.0 + ROUNDING)
    if np.count_nonzero(inside) < inside.size:
        place = tuple(int(i) for i in np.argwhere(~inside)[0])
        kind = ConfigError if np.isnan(values[place]) else OutOfRange
        raise kind(
            f"action: found {float(values[place])!r} at {list(place)}; expected finite numbers from 0 to 1"
        )
    clipped: Array = np.clip(values, 0.0, 1.0)
    return clipped
