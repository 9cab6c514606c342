"""A vehicle driven by hand: a window, a keyboard, and sliding RMS values against their limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from rich.console import Console

from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.limits import LIMITS
from sayd_env.config.loader import packaged_names
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array32
from sayd_env.envs.recorder import Frame
from sayd_env.report.columns import Column, Listing, Table, csv_table, json_rows
from sayd_env.report.files import Result
from sayd_env.runs.policies import constant_spec, for_policy
from sayd_env.studies.ride import Ride

COMMAND_STEP = 0.05
"""By which a key changes the valves' command."""
SPEED_STEP = 10.0
"""By which a key changes the speed, km/h."""
WEAR_STEP = 0.25
LONGEST = 120.0
"""After this time a run goes on from the start of the next track, s: the track is made before it begins."""
ESTIMATE = "-estimate"
"""How a packaged track ends that differs from that of the shorter name by its calibration only."""

COLUMNS = (
    # At its start.
    Column("speed_kmh", "speed", "km/h"),
    Column("wear", "wear"),
    Column("friction", "friction"),
    Column("track", "track"),
    Column("seconds", "time", "s", digits=1),
    # Mean over the run, eq. (27), on-line filter.
    Column("J", "J", digits=4),
    Column("J_acceleration", "of acceleration", digits=4),
    Column("J_force", "of force", digits=4),
    Column("ending", "ended early"),
)
"""Of the table of the runs that were driven by hand."""


@dataclass(eq=False)
class PlayResult(Result):
    """All runs until the window was closed."""

    runs: list[dict[str, Any]] = field(default_factory=list)
    """By `COLUMNS`."""

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``--json``."""
        return {"runs": json_rows(COLUMNS, self.runs)}

    def tables(self) -> Mapping[str, Table]:
        """One row for each run."""
        return {"runs": csv_table(COLUMNS, self.runs)}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the runs."""
        if self.runs:
            Listing("Driven by hand", COLUMNS, self.runs).print(console, wide)


class Hand:
    """A policy that does what a hand says: one command for all valves."""

    command = 0.0

    def make(self, env: Any) -> Hand:
        """Itself, for whatever environment."""
        del env
        return self

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Array32, Any]:
        """The command of now."""
        del episode_start, deterministic
        return np.full((len(observation), 1), self.command, dtype=np.float32), state


class Cab:
    """A vehicle, its window and its keyboard.

    The command acts at once. Speed, wear and track cannot change under a running train: the train begins
    anew on the same stretch, with the valves as they stand. Several keys pressed in a row begin it once.

    Parameters
    ----------
    scenario : Scenario
        The vehicle; passive yaw dampers give way to semi-active ones.
    environment : EnvironmentConfig
        Sensors, control period, and distributions by which the first run is drawn.
    seed : int
        Of the runs.
    options : mapping, optional
        What is fixed from the start, as for `draw_episode`.

    Raises
    ------
    ConfigError
        Options that are not allowed; pygame or a screen is missing.
    """

    def __init__(
        self,
        scenario: Scenario,
        environment: EnvironmentConfig,
        seed: int = 0,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        config = environment.model_copy(update={"valves": "vehicle", "episode_s": LONGEST})
        self.hand, self.seed, self.number = Hand(), seed, 0
        self.options = dict(options or {})
        self.ride = Ride(self.hand, for_policy(scenario, constant_spec(0.0)), config)
        self.result = PlayResult()
        self.paused = False
        self._note = ""
        packaged = [name for name in packaged_names("track") if not name.endswith(ESTIMATE)]
        self._tracks = [self.options.get("track"), *packaged]
        self._keys: Mapping[str, Callable[[], None]] = {
            "up": lambda: self._open(COMMAND_STEP),
            "down": lambda: self._open(-COMMAND_STEP),
            "right": lambda: self._accelerate(SPEED_STEP),
            "left": lambda: self._accelerate(-SPEED_STEP),
            "w": self._wear_on,
            "t": self._change_track,
            "space": self._pause,
            "r": lambda: None,
            "q": self._quit,
            "escape": self._quit,
        }
        try:
            from sayd_env.envs.rendering import Renderer  # noqa: PLC0415 - loads Matplotlib

            self.renderer = Renderer(self.ride.recorder, "human", caption="by hand", keys=True)
        except DependencyNotInstalled as error:
            raise ConfigError(str(error)) from None
        assert self.renderer.window is not None  # that is what "human" means
        self.window = self.renderer.window
        try:
            self._begin(self.options)
        except ConfigError:
            self.window.close()
            raise

    @property
    def frame(self) -> Frame:
        """The train as it is now."""
        return self.ride.recorder.frame()

    def drive(self) -> PlayResult:
        """Drive until the window is closed."""
        try:
            while self.window.open:
                self.turn()
        finally:
            self.window.close()
        if self.ride.steps:
            self.result.runs.append(self._driven())
        return self.result

    def turn(self) -> None:
        """Do what keys ask for, then run a control period, or wait where the train stands."""
        pressed = [key for key in self.window.pressed() if key in self._keys]
        former = dict(self.options)
        for key in pressed:
            self._keys[key]()
        if not self.window.open:
            return
        if "r" in pressed or self.options != former:
            self._begin_anew(former)
        elif self.ride.seconds >= LONGEST:
            self.number += 1
            self._begin_anew(former)
        if pressed:
            self._show_keys()
        if self.paused or not self.ride.running:
            self.window.pause()
        else:
            self.ride.step()
        self.renderer.draw()

    def _open(self, step: float) -> None:
        self.hand.command = min(max(round(self.hand.command + step, 2), 0.0), 1.0)

    def _accelerate(self, step: float) -> None:
        at_start = self.ride.batch.mean_speed(0) * KMH
        allowed = LIMITS["speed_kmh"]
        wanted = float(self.options.get("speed_kmh", at_start)) + step
        self.options["speed_kmh"] = min(max(wanted, allowed.low), allowed.high)

    def _wear_on(self) -> None:
        wear = float(self.options.get("wear", self.frame.wear))
        self.options["wear"] = (
            0.0 if wear >= 1.0 else min(WEAR_STEP * math.floor(wear / WEAR_STEP + 1.0), 1.0)
        )

    def _change_track(self) -> None:
        place = self._tracks.index(self.options.pop("track", None))
        following = self._tracks[(place + 1) % len(self._tracks)]
        if following is not None:
            self.options["track"] = following

    def _quit(self) -> None:
        self.window.close()

    def _pause(self) -> None:
        self.paused = not self.paused

    def _begin_anew(self, former: Mapping[str, Any]) -> None:
        """Begin under the conditions of now; where they cannot be, say why and keep the former ones."""
        driven = self._driven() if self.ride.steps else None
        self._note = "run-in ..."
        self._show_keys()
        self.renderer.show()
        try:
            self._begin(self.options)
        except ConfigError as error:
            self.options, self._note = dict(former), str(error)
            return
        if driven is not None:
            self.result.runs.append(driven)

    def _begin(self, options: Mapping[str, Any]) -> None:
        start = {"initial_current": self.hand.command}
        self.ride.begin(self.seed, self.number, {**options, **start})
        self.paused, self._note = False, ""
        self._show_keys()

    def _driven(self) -> dict[str, Any]:
        """The run of now by `COLUMNS`."""
        frame, ride = self.frame, self.ride
        return {
            "speed_kmh": ride.batch.mean_speed(0) * KMH,
            "wear": frame.wear,
            "friction": frame.friction,
            "track": frame.track,
            "seconds": ride.seconds,
            "ending": frame.ending,
            **ride.costs(),
        }

    def _show_keys(self) -> None:
        frame = self.frame
        self.renderer.keys = (
            ("\u2191 \u2193", f"command {self.hand.command:.2f}"),
            ("\u2190 \u2192", f"{self.ride.batch.mean_speed(0) * KMH:.0f} km/h"),
            ("W", f"wear {frame.wear:.2f}"),
            ("T", f"track {frame.track}"),
            ("Space", "go on" if self.paused else "pause"),
            ("R", "begin again"),
            ("Q", "quit"),
            *([("!", self._note)] if self._note else []),
        )
