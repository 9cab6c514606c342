"""A policy at work, in pictures: one run of one vehicle, drawn as a video or as its last picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.envs.cost import squares, weighted
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch, checked_actions
from sayd_env.envs.loop import RUNNING
from sayd_env.envs.recorder import Recorder
from sayd_env.envs.rollout import first_state, listens
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Table
from sayd_env.report.figures import Plot
from sayd_env.report.video import Picture, checked_video, write_video
from sayd_env.runs.context import Progress, silent
from sayd_env.runs.policies import PolicySpec, for_policy

if TYPE_CHECKING:
    from rich.console import Console

    from sayd_env.envs.rendering import Renderer

HOLD = 1.0
"""How long the last picture of a run that ended early stays, s."""
COLUMNS = (
    *("time_s", "speed_kmh", "distance_m", "J"),
    *("acceleration_rms_front_m_s2", "acceleration_rms_rear_m_s2"),
    *("force_rms_front_n", "force_rms_rear_n"),
    *("valve_front", "valve_rear"),
)


@dataclass(frozen=True, eq=False)
class Video:
    """What is to be drawn, and where it goes."""

    policy: PolicySpec
    file: Path
    seconds: float = 10.0
    fps: float = 25.0
    exaggeration: float | None = None
    """How many times as large displacements are drawn; by default as the environment's pictures."""

    @property
    def pictures(self) -> int:
        """Number of pictures; in a PNG there is one, of the end."""
        return 1 if self.file.suffix.lower() == ".png" else max(1, round(self.seconds * self.fps))

    def step(self, picture: int, control_period: float) -> int:
        """Control periods before a picture, the first of which has number 0."""
        time = self.seconds if self.file.suffix.lower() == ".png" else (picture + 1) / self.fps
        return round(time / control_period)


@dataclass(eq=False)
class RenderResult:
    """A video and the run that it shows."""

    video: Video
    speed: float
    """At step 0, m/s."""
    seed: int
    wear: float
    friction: float
    rows: list[tuple[float | None, ...]] = field(default_factory=list)
    """One for each picture, by `COLUMNS`."""
    seconds: float = 0.0
    """How long the vehicle ran, s."""
    cost: float = 0.0
    """Mean J over this time, eq. (27), on-line filter."""
    cost_acceleration: float = 0.0
    cost_force: float = 0.0
    faults: tuple[str, ...] = ()
    ending: str | None = None

    @property
    def pictures(self) -> int:
        """Number of pictures."""
        return len(self.rows)

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``--json``."""
        return {
            "file": str(self.video.file),
            "policy": self.video.policy.title,
            "speed_kmh": self.speed * KMH,
            "wear": self.wear,
            "friction": self.friction,
            "seconds": self.seconds,
            "fps": self.video.fps,
            "pictures": self.pictures,
            "J": self.cost,
            "J_acceleration": self.cost_acceleration,
            "J_force": self.cost_force,
            "faults": list(self.faults),
            "ending": self.ending,
        }

    def tables(self) -> Mapping[str, Table]:
        """The charts' values at each picture."""
        return {"pictures": (COLUMNS, self.rows)}

    def plots(self) -> Mapping[str, Plot]:
        """None: the video is the plot."""
        return {}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print what has been drawn."""
        console.print(
            f"{self.video.policy.title} at {self.speed * KMH:g} km/h, wear {self.wear:g}, friction "
            f"{self.friction:.3g}, seed {self.seed}: {self.seconds:g} s, J {self.cost:.4g} (acceleration "
            f"{self.cost_acceleration:.4g}, force {self.cost_force:.4g})",
            highlight=False,
        )
        for fault in self.faults:
            console.print(f"fault: {fault}", highlight=False, markup=False)
        if self.ending is not None:
            console.print(f"ended early: {self.ending}", style="red", highlight=False, markup=False)
        size = self.video.file.stat().st_size / 1e6 if self.video.file.exists() else 0.0
        noun = "picture" if self.pictures == 1 else "pictures"
        console.print(
            f"{self.video.file}: {self.pictures} {noun}, {size:.1f} MB",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )


def render(
    video: Video,
    scenario: Scenario,
    environment: EnvironmentConfig,
    *,
    seed: int = 0,
    speed: float | None = None,
    fixed: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> RenderResult:
    """Run a policy and write its video.

    Parameters
    ----------
    video : Video
    scenario : Scenario
        The vehicle; it gets the yaw dampers that the policy needs.
    environment : EnvironmentConfig
        Sensors, control period, and distributions by which the episode is drawn.
    seed : int
        Episode 0 of this seed is shown.
    speed : float, optional
        m/s; by default drawn.
    fixed : mapping, optional
        Further options of the episode, as for `draw_episode`.
    progress : Progress
        Told the number of finished pictures.

    Raises
    ------
    ConfigError
        A file, policy, speed, length or rate that cannot be; pygame is missing.
    """
    environment = video.policy.environment(environment)
    period = environment.control_period
    _check(video, period)
    fitted = for_policy(scenario, video.policy)
    config = environment.model_copy(
        update={
            "damper": fitted.damper.type,
            "episode_s": max(environment.episode_s, period * math.ceil(video.seconds / period)),
        }
    )
    options = dict(fixed or {}) | ({} if speed is None else {"speed_kmh": speed * KMH})
    episode = draw_episode(config, seed, 0, options)
    VehicleModel(fitted).check_speed(episode.speed)
    batch = EpisodeBatch(config, 1, scenario=fitted, num_threads=1)
    policy = video.policy.make(batch)
    recorder = Recorder(batch)
    renderer = _renderer(recorder, video)
    batch.reset([0], [episode], listen=listens(policy))
    first = recorder.frame()
    result = RenderResult(video, first.speed, seed, first.wear, first.friction)
    from sayd_env.envs.rendering import colours  # noqa: PLC0415 - the renderer has loaded it

    write_video(video.file, _pictures(result, policy, recorder, renderer, progress), video.fps, colours())
    return result


def _check(video: Video, control_period: float) -> None:
    if not (math.isfinite(video.seconds) and video.seconds >= control_period):
        raise ConfigError(
            f"--seconds {video.seconds:g}: expected at least one control period, {control_period:g} s"
        )
    if not 0.0 < video.fps <= 1.0 / control_period + 1e-9:
        raise ConfigError(
            f"--fps {video.fps:g}: expected at most one picture in a control period, {1.0 / control_period:g}"
        )
    if video.exaggeration is not None and not (
        math.isfinite(video.exaggeration) and video.exaggeration > 0.0
    ):
        raise ConfigError(f"--exaggeration {video.exaggeration:g}: expected a number above 0")
    checked_video(video.file, video.fps, video.pictures)


def _renderer(recorder: Recorder, video: Video) -> Renderer:
    try:
        from sayd_env.envs.rendering import EXAGGERATION, Renderer  # noqa: PLC0415 - needs an extra

        exaggeration = EXAGGERATION if video.exaggeration is None else video.exaggeration
        return Renderer(recorder, caption=video.policy.title, exaggeration=exaggeration)
    except DependencyNotInstalled as error:
        raise ConfigError(str(error)) from None


def _pictures(
    result: RenderResult, policy: Any, recorder: Recorder, renderer: Renderer, progress: Progress
) -> Iterator[Picture]:
    """Run the vehicle from picture to picture, and fill in the result on the way."""
    video, batch = result.video, recorder.batch
    period = batch.config.control_period
    observation, shape = batch.observations(), (1, batch.interface.actions)
    state, start = first_state(policy, batch)
    steps, sums, held = 0, np.zeros(2), 0
    for n in range(video.pictures):
        until = video.step(n, period)
        while steps < until and int(batch.vehicles.status[0]) == RUNNING:
            action, state = policy.predict(observation, state, start, deterministic=True)
            start = np.zeros(1, dtype=np.bool_)
            observation, _, _, _ = batch.step(checked_actions(action, shape))
            recorder.take()
            steps += 1
            sums += squares(np.nan_to_num(batch.vehicles.terms[0], posinf=0.0))
        picture = renderer.draw()
        assert picture is not None  # the renderer has no window
        result.rows.append(_row(recorder))
        progress(n + 1, video.pictures, f"{steps * period:.1f} s")
        yield picture
        if int(batch.vehicles.status[0]) != RUNNING:
            held += 1
            if held >= HOLD * video.fps:
                break
    frame, result.seconds = recorder.frame(), steps * period
    if steps:
        result.cost_acceleration, result.cost_force = (sums / result.seconds).tolist()
    result.cost = weighted(batch.scenario.cost, result.cost_acceleration, result.cost_force)
    result.faults, result.ending = frame.faults, frame.ending


def _row(recorder: Recorder) -> tuple[float | None, ...]:
    frame = recorder.frame()
    valves = [None, None] if frame.valve is None else np.asarray(frame.valve[-1], dtype=float).tolist()
    distance = frame.speed * frame.time if frame.place is None else frame.place.distance
    signals = (frame.speed * KMH, distance, frame.cost[-1], *frame.acceleration[-1], *frame.force[-1])
    return (frame.time, *(float(value) for value in signals), *valves)
