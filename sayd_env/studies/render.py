"""Policies at work, in pictures: a video, or its last picture; several policies side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gymnasium.error import DependencyNotInstalled

from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.envs.canvas import Picture
from sayd_env.report.columns import Table
from sayd_env.report.files import Result
from sayd_env.report.video import checked_video, write_video
from sayd_env.runs.context import Progress, silent
from sayd_env.runs.policies import PolicySpec, for_policy
from sayd_env.studies.ride import COLUMNS, Ride

if TYPE_CHECKING:
    from rich.console import Console

    from sayd_env.envs.charts import Extent

HOLD = 1.0
"""How long the last picture of a run that ended early stays, s."""
MOST = 4
"""Policies side by side: a column of each is 484 pixels wide."""


@dataclass(frozen=True, eq=False)
class Video:
    """What is to be drawn, and where it goes."""

    policies: Sequence[PolicySpec]
    """One, or several side by side."""
    file: Path
    seconds: float = 10.0
    fps: float = 25.0
    exaggeration: float | None = None
    """How many times as large displacements are drawn; by default as the environment's pictures."""

    @property
    def pictures(self) -> int:
        """Number of pictures; in a PNG there is one, of the end."""
        return 1 if self.file.suffix.lower() == ".png" else max(1, round(self.seconds * self.fps))

    def time(self, picture: int) -> float:
        """Time of a picture, the first of which has number 0, s."""
        return self.seconds if self.file.suffix.lower() == ".png" else (picture + 1) / self.fps


@dataclass(eq=False)
class RecordedRun:
    """The run of one policy."""

    policy: str
    rows: list[tuple[float | None, ...]] = field(default_factory=list)
    """One for each picture, by `COLUMNS`."""
    seconds: float = 0.0
    """How long the vehicle ran, s."""
    costs: Mapping[str, float] = field(default_factory=dict)
    """Mean J over this time and its parts, as `Ride.costs`."""
    faults: tuple[str, ...] = ()
    ending: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``--json``."""
        own = {"policy": self.policy, "seconds": self.seconds}
        return {**own, **self.costs, "faults": list(self.faults), "ending": self.ending}


@dataclass(eq=False)
class RenderResult(Result):
    """A video and the runs that it shows."""

    video: Video
    speed: float
    """At step 0, m/s."""
    seed: int
    wear: float
    friction: float
    runs: list[RecordedRun] = field(default_factory=list)
    """One for each policy."""

    @property
    def pictures(self) -> int:
        """Number of pictures."""
        return max((len(run.rows) for run in self.runs), default=0)

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``--json``; what belongs to a run is under `runs` where there are several."""
        common = {
            "file": str(self.video.file),
            "speed_kmh": self.speed * KMH,
            "wear": self.wear,
            "friction": self.friction,
            "fps": self.video.fps,
            "pictures": self.pictures,
        }
        runs = [run.as_dict() for run in self.runs]
        return {**common, **runs[0]} if len(runs) == 1 else {**common, "runs": runs}

    def tables(self) -> Mapping[str, Table]:
        """The charts' values at each picture."""
        if len(self.runs) == 1:
            return {"pictures": (COLUMNS, self.runs[0].rows)}
        rows = [(run.policy, *row) for run in self.runs for row in run.rows]
        return {"pictures": (("policy", *COLUMNS), rows)}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print what has been drawn."""
        for run in self.runs:
            costs = {name: f"{value:.4g}" for name, value in run.costs.items()}
            console.print(
                f"{run.policy} at {self.speed * KMH:g} km/h, wear {self.wear:g}, friction "
                f"{self.friction:.3g}, seed {self.seed}: {run.seconds:g} s, J {costs['J']} (acceleration "
                f"{costs['J_acceleration']}, force {costs['J_force']})",
                highlight=False,
            )
            for fault in run.faults:
                console.print(f"fault: {fault}", highlight=False, markup=False)
            if run.ending is not None:
                console.print(f"ended early: {run.ending}", style="red", highlight=False, markup=False)
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
    """Run policies and write their video.

    Several policies run the same episode and are drawn side by side. They run twice: the axes of the video,
    the same for all, end where the largest values of the first time do.

    Parameters
    ----------
    scenario : Scenario
        The vehicle; it gets the yaw dampers that a policy needs.
    environment : EnvironmentConfig
        Sensors, control period, and distributions by which the episode is drawn.
    seed : int
        Episode 0 of this seed is shown.
    speed : float, optional
        m/s; by default drawn.
    fixed : mapping, optional
        Further options of the episode, as for `draw_episode`.
    progress : Progress
        Gets the number of finished pictures.

    Raises
    ------
    ConfigError
        A file, policy, speed, length or rate that cannot be, too many policies; pygame is missing.
    """
    environments = [policy.environment(environment) for policy in video.policies]
    for each in environments:
        _check(video, each.control_period)
    options = dict(fixed or {}) | ({} if speed is None else {"speed_kmh": speed * KMH})
    rides = [
        Ride(policy, for_policy(scenario, policy), _long_enough(config, video.seconds), video.seconds)
        for policy, config in zip(video.policies, environments, strict=True)
    ]
    try:
        return _recorded(video, rides, seed, options, progress)
    except DependencyNotInstalled as error:
        raise ConfigError(str(error)) from None


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
    if len(video.policies) > MOST:
        raise ConfigError(f"--policies: found {len(video.policies)}; a video has room for {MOST}")
    checked_video(video.file, video.fps, video.pictures)


def _long_enough(environment: EnvironmentConfig, seconds: float) -> EnvironmentConfig:
    """The environment with episodes that last as long as the video."""
    period = environment.control_period
    needed = period * math.ceil(seconds / period)
    return environment.model_copy(update={"episode_s": max(environment.episode_s, needed)})


def _recorded(
    video: Video, rides: Sequence[Ride], seed: int, options: Mapping[str, Any], progress: Progress
) -> RenderResult:
    # These load Matplotlib and need an extra.
    from sayd_env.envs.rendering import EXAGGERATION, Renderer, colours  # noqa: PLC0415
    from sayd_env.envs.side_by_side import SideBySide  # noqa: PLC0415

    factor = EXAGGERATION if video.exaggeration is None else video.exaggeration
    names = [policy.title for policy in video.policies]
    recorders = [ride.recorder for ride in rides]
    before = 0
    if len(rides) == 1:
        renderer = Renderer(recorders[0], caption=names[0], exaggeration=factor)
        draw: Callable[[], Picture | None] = renderer.draw
    else:
        extent = _extent(rides, video, seed, options, progress)
        before = video.pictures
        together = SideBySide(recorders, names, extent, factor)

        def draw() -> Picture:
            return together.draw([recorder.frame() for recorder in recorders])

    for ride in rides:
        ride.begin(seed, options=options)
    first = recorders[0].frame()
    result = RenderResult(video, first.speed, seed, first.wear, first.friction)

    def report(done: float, total: float, what: str = "") -> None:
        progress(before + done, before + total, what)

    write_video(video.file, _pictures(result, rides, draw, report), video.fps, colours())
    return result


def _extent(
    rides: Sequence[Ride], video: Video, seed: int, options: Mapping[str, Any], progress: Progress
) -> Extent:
    """Axes on which all of the policies' values can be seen, from a first run of each."""
    from sayd_env.envs.charts import Extent  # noqa: PLC0415 - loads Matplotlib

    for ride in rides:
        ride.begin(seed, options=options)
    for n in range(video.pictures):
        for ride in rides:
            ride.advance(video.time(n))
        progress(n + 1, 2 * video.pictures, f"axes, {video.time(n):.1f} s")
    frames = [ride.recorder.frame() for ride in rides]
    largest = [
        max(float(values.max(initial=0.0)) for values in each)
        for each in ([frame.acceleration for frame in frames], [frame.force for frame in frames])
    ]
    return Extent(video.seconds, largest)


def _pictures(
    result: RenderResult, rides: Sequence[Ride], draw: Callable[[], Picture | None], progress: Progress
) -> Iterator[Picture]:
    """Run the vehicles from picture to picture, and fill in the result on the way."""
    video, held = result.video, 0
    result.runs = [RecordedRun(policy.title) for policy in video.policies]
    for n in range(video.pictures):
        for run, ride in zip(result.runs, rides, strict=True):
            ride.advance(video.time(n))
            run.rows.append(ride.row())
        picture = draw()
        assert picture is not None  # there is no window
        progress(n + 1, video.pictures, f"{video.time(n):.1f} s")
        yield picture
        if not any(ride.running for ride in rides):
            held += 1
            if held >= HOLD * video.fps:
                break
    for run, ride in zip(result.runs, rides, strict=True):
        frame = ride.recorder.frame()
        run.seconds, run.costs, run.faults, run.ending = (
            ride.seconds,
            ride.costs(),
            frame.faults,
            frame.ending,
        )
