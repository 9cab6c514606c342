"""Driving by hand: what keys do, posted to a window that nobody sees; the pace of the clock."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.envs import canvas
from sayd_env.studies.play import Cab

pygame = pytest.importorskip("pygame")


class Clock:
    """Time that passes only where somebody sleeps."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    made = Clock()
    monkeypatch.setattr(canvas, "time", made)
    return made


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("env") / "quick.yaml"
    path.write_text("base: nominal\nstudy: estimates\nrun_in: 20.0\n")
    return path


@pytest.fixture(scope="module")
def environment(quick: Path) -> EnvironmentConfig:
    return load_environment(str(quick))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("estimates", ["damper=sayd-estimate"])


Make = Callable[..., Cab]


@pytest.fixture
def make(scenario: Scenario, environment: EnvironmentConfig) -> Iterator[Make]:
    made: list[Cab] = []

    def cab(**options: object) -> Cab:
        made.append(Cab(scenario, environment, options=options))
        return made[-1]

    yield cab
    for each in made:
        each.window.close()


def press(*keys: int) -> None:
    for key in keys:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))


def test_up_and_down_move_the_valves_at_once(make: Make) -> None:
    cab = make(speed_kmh=300.0)
    cab.turn()
    np.testing.assert_array_equal(cab.frame.command, np.zeros(8))
    press(pygame.K_UP, pygame.K_UP, pygame.K_UP, pygame.K_DOWN)
    cab.turn()
    np.testing.assert_allclose(cab.frame.command, 0.1, rtol=1e-6)
    assert cab.ride.steps == 2  # the train went on
    for _ in range(40):  # the driver is late and the spool has its rate
        cab.turn()
    np.testing.assert_allclose(cab.frame.opening, 0.1, atol=2e-3)
    press(*[pygame.K_UP] * 30)
    cab.turn()
    np.testing.assert_array_equal(cab.frame.command, np.ones(8))


def test_speed_wear_and_track_begin_the_train_anew(make: Make) -> None:
    cab = make(speed_kmh=300.0)
    press(pygame.K_UP, pygame.K_UP)
    cab.turn()
    own = cab.frame.track
    press(pygame.K_RIGHT, pygame.K_RIGHT, pygame.K_w)
    cab.turn()
    assert cab.frame.speed * 3.6 == pytest.approx(320.0)
    assert cab.frame.wear == 0.0  # behind 1 comes 0
    assert cab.frame.track == own
    assert cab.ride.steps == 1
    np.testing.assert_allclose(cab.frame.command, 0.1, rtol=1e-6)  # as the valves stood
    np.testing.assert_allclose(cab.frame.opening, 0.1, atol=1e-3)  # during the run-in, too
    press(pygame.K_LEFT, pygame.K_t, pygame.K_w)
    cab.turn()
    assert cab.frame.speed * 3.6 == pytest.approx(310.0)
    assert cab.frame.wear == 0.25
    assert cab.frame.track != own
    result = cab.result.runs
    assert [round(run["speed_kmh"]) for run in result] == [300, 320]
    assert [run["seconds"] for run in result] == pytest.approx([0.01, 0.01])


def test_all_tracks_come_in_turn(make: Make) -> None:
    cab = make()
    own, seen = cab.frame.track, []
    for _ in cab._tracks:
        press(pygame.K_t)
        cab.turn()
        seen.append(cab.frame.track)
    assert seen[-1] == own
    assert len(set(seen)) == len(seen)


def test_reset_runs_the_same_again(make: Make) -> None:
    cab = make(speed_kmh=300.0)
    places = []
    for _ in range(2):
        press(pygame.K_r)
        for _ in range(5):
            cab.turn()
        places.append(cab.frame.poses)
        assert cab.ride.steps == 5
    assert places[0] == places[1]


def test_a_pause_stops_the_train_and_not_the_clock(make: Make, clock: Clock) -> None:
    cab = make(speed_kmh=300.0)
    cab.turn()
    press(pygame.K_SPACE)
    before = clock.now
    for _ in range(10):
        cab.turn()
    assert cab.ride.steps == 1
    assert clock.now > before
    assert ("Space", "go on") in cab.renderer.keys
    press(pygame.K_SPACE)
    cab.turn()
    assert cab.ride.steps == 2


def test_the_train_keeps_the_time_of_the_clock(make: Make, clock: Clock) -> None:
    cab = make(speed_kmh=300.0)
    cab.turn()
    start = clock.now
    for _ in range(100):
        cab.turn()
    assert clock.now - start == pytest.approx(1.0, abs=1e-9)


def test_the_keys_are_shown(make: Make) -> None:
    cab = make(speed_kmh=300.0, wear=0.5)
    press(pygame.K_UP)
    cab.turn()
    shown = dict(cab.renderer.keys)
    assert shown["\u2191 \u2193"] == "command 0.05"
    assert shown["\u2190 \u2192"] == "300 km/h"
    assert shown["W"] == "wear 0.50"
    assert {"T", "Space", "R", "Q"} <= set(shown)
    # They stand below the picture of the environment, in the window.
    screen = pygame.surfarray.array3d(pygame.display.get_surface()).transpose(1, 0, 2)
    assert screen.shape == (760, 1280, 3)
    assert len(np.unique(screen[724:756].reshape(-1, 3), axis=0)) > 20


def test_what_cannot_be_is_said_and_changes_nothing(
    scenario: Scenario, environment: EnvironmentConfig
) -> None:
    unworn = load_scenario("estimates", ["damper=sayd-estimate", "wheel=s1002", "wear=0"])
    left = environment.model_copy(update={"randomisation": environment.randomisation.without({"wear"})})
    cab = Cab(unworn, left)
    cab.turn()
    press(pygame.K_w)
    cab.turn()
    assert cab.frame.wear == 0.0
    assert "wear" in dict(cab.renderer.keys)["!"]
    press(pygame.K_UP)
    cab.turn()
    assert cab.ride.steps == 3  # the same run
    cab.window.close()


@pytest.mark.parametrize("key", [pygame.K_q, pygame.K_ESCAPE])
def test_a_key_quits(make: Make, key: int) -> None:
    cab = make(speed_kmh=300.0)
    cab.turn()
    press(key)
    result = cab.drive()
    assert not cab.window.open
    assert [run["seconds"] for run in result.runs] == pytest.approx([0.01])


def test_the_command_ends_with_the_runs(quick: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pygame.display.init()  # there are events before there is a window
    press(pygame.K_RIGHT, pygame.K_q)
    options = ["--environment", str(quick), "--speed", "300", "--config", "estimates"]
    assert main(["play", *options, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["runs"] == []
    assert printed["command"].startswith("sayd play")


def test_without_pygame_or_a_screen_the_message_says_so(
    scenario: Scenario, environment: EnvironmentConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    pygame.display.quit()
    needed = r"a window needs a screen .*'sayd render' do without"
    with monkeypatch.context() as patch:
        patch.setenv("SDL_VIDEODRIVER", "none-such")
        with pytest.raises(ConfigError, match=needed):
            Cab(scenario, environment)
    with monkeypatch.context() as patch:  # SDL finds no screen, and would draw where nobody sees it
        for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
            patch.delenv(name, raising=False)
        patch.setattr(pygame.display, "get_driver", lambda: "offscreen")
        with pytest.raises(ConfigError, match=needed):
            Cab(scenario, environment)
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ConfigError, match=r"pip install 'sayd-env\[render\]'"):
        Cab(scenario, environment)
