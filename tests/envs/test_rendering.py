"""Pictures: their form, what moves in them and by how much, charts against sums done by hand, both modes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import check_env

from sayd_env.config import ConfigError
from sayd_env.config.units import Array
from sayd_env.envs.canvas import Picture
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.keywords import configured
from sayd_env.envs.loop import COST_ACCELERATION, COST_FORCE
from sayd_env.envs.recorder import Frame, Pose, Recorder
from sayd_env.envs.single import SaydEnv

pytest.importorskip("pygame")

from sayd_env.envs import rendering, vehicle_picture
from sayd_env.envs.charts import ACCELERATION, FORCE, VALVE, Charts, _newest
from sayd_env.envs.plan_view import View, displaced, rectangle
from sayd_env.envs.rendering import FRONT, HEIGHT, REAR, SCALE, WIDTH, Renderer, force_colour

HALF = np.full(2, 0.5, dtype=np.float32)


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def env(quick: str) -> Iterator[SaydEnv]:
    env = SaydEnv(quick, render_mode="rgb_array")
    env.reset(seed=0)
    yield env
    env.close()


def watched(
    environment: str, steps: int, *, options: dict[str, Any] | None = None, **keywords: Any
) -> Recorder:
    """A recorder that has watched a vehicle for some steps with half-open valves."""
    config, scenario = configured(environment, **keywords)
    batch = EpisodeBatch(config, 1, scenario=scenario, num_threads=1)
    batch.reset([0], [draw_episode(config, 0, 0, options)])
    recorder = Recorder(batch)
    for _ in range(steps):
        batch.step(HALF[None])
        recorder.take()
    return recorder


def at_rest(frame: Frame, **poses: Pose) -> Frame:
    """The frame with all bodies and the track at rest, but for some bodies."""
    still = {name: Pose(0.0, 0.0, 0.0) for name in frame.poses}
    moved = {name.replace("_", "."): pose for name, pose in poses.items()}
    even = np.zeros_like(frame.alignment)
    return replace(frame, poses=still | moved, alignment=even, gauge=even, damper_force=np.zeros(8))


def picture(renderer: Renderer, frame: Frame) -> Picture:
    renderer._paint(frame)
    return renderer.canvas.pixels()


def middle_of(image: Picture, colour: tuple[int, int, int]) -> Array:
    """Mean pixel (x, y) of what has a colour in the vehicle's panel."""
    left, top, width, height = (int(value) for value in rendering.ROAD)
    part = image[top : top + height, left : left + width]
    rows, columns = np.nonzero(np.all(np.abs(part.astype(int) - colour) <= 2, axis=2))
    return np.array([columns.mean() + left, rows.mean() + top])


def test_a_picture_is_a_new_array_of_bytes(env: SaydEnv) -> None:
    one, other = env.render(), env.render()
    assert one.shape == (HEIGHT, WIDTH, 3)
    assert one.dtype == np.uint8
    assert one is not other
    assert not np.shares_memory(one, other)
    np.testing.assert_array_equal(one, other)


def test_pictures_change_with_time(env: SaydEnv) -> None:
    before = env.render()
    env.step(HALF)
    assert np.any(env.render() != before)


def test_same_seed_same_picture(quick: str) -> None:
    images = []
    for _ in range(2):
        env = SaydEnv(quick, render_mode="rgb_array")
        env.reset(seed=3)
        env.step(HALF)
        images.append(env.render())
        env.close()
    np.testing.assert_array_equal(*images)


def test_watching_changes_no_bit(quick: str) -> None:
    observations = []
    for mode in (None, "rgb_array"):
        env = SaydEnv(quick, render_mode=mode)
        env.reset(seed=5)
        for _ in range(5):
            observation = env.step(HALF)[0]
            if mode is not None:
                env.render()
        observations.append(observation)
        env.close()
    np.testing.assert_array_equal(observations[0], observations[1])


def test_displaced_points_by_hand() -> None:
    # 2 mm forward, 5 mm to the left and 1 mrad at an arm of (1, 2) m, twenty times as large.
    found = displaced(np.array([[11.0, 2.0]]), (10.0, 0.0), Pose(0.002, 0.005, 0.001), 20.0)
    np.testing.assert_allclose(found, [[11.0 + 20 * (0.002 - 0.002), 2.0 + 20 * (0.005 + 0.001)]], rtol=1e-12)


def test_a_view_has_forward_right_and_left_up() -> None:
    view = View(8.75, (950.0, 270.0), 100.0, 3.0)
    np.testing.assert_allclose(view.pixels(np.array([[9.75, 0.5]])), [[1050.0, 220.0]])


def test_rectangle_by_hand() -> None:
    corners = {tuple(point) for point in rectangle(1.0, 2.0, 0.5, 0.25).tolist()}
    assert corners == {(1.5, 2.25), (1.5, 1.75), (0.5, 2.25), (0.5, 1.75)}


def test_the_plan_is_that_of_the_vehicle(quick: str) -> None:
    # Positions of configs/vehicle/emu.yaml: pivots at 8.75 m, wheelbase 2.5 m, dampers 1.35 m off the middle.
    plan = Renderer(watched(quick, 0)).placement.plan
    assert [bogie.x for bogie in plan.bogies] == [8.75, -8.75]
    assert plan.bogies[1].wheelsets == ("wheelset.rear.leading", "wheelset.rear.trailing")
    assert plan.rest["wheelset.rear.trailing"] == (-10.0, 0.0)
    np.testing.assert_allclose(plan.dampers[:, 0, 0], [9.1] * 4 + [-8.4] * 4)
    np.testing.assert_allclose(plan.dampers[:, 1, 0], [8.4] * 4 + [-9.1] * 4)
    pairs = plan.dampers[:, 0, 1].reshape(4, 2).mean(axis=1)
    np.testing.assert_allclose(pairs, [1.35, -1.35, 1.35, -1.35])


def test_a_shifted_bogie_is_drawn_shifted(quick: str) -> None:
    recorder = watched(quick, 1)
    renderer, frame = Renderer(recorder), recorder.frame()
    still = picture(renderer, at_rest(frame))
    moved = picture(renderer, at_rest(frame, frame_front=Pose(0.0, 0.004, 0.0)))
    # 4 mm to the left, twenty times as large: 7.6 pixels up at 95 pixels in a metre; farther up it is hidden
    # in part by what the dampers' values stand on.
    shift = middle_of(moved, FRONT) - middle_of(still, FRONT)
    np.testing.assert_allclose(shift, [0.0, -0.004 * 20.0 * SCALE], atol=0.6)
    np.testing.assert_allclose(middle_of(moved, REAR), middle_of(still, REAR), atol=0.05)


def test_a_turned_bogie_is_drawn_turned(quick: str) -> None:
    recorder = watched(quick, 1)
    renderer, frame = Renderer(recorder), recorder.frame()
    turned = at_rest(frame, frame_rear=Pose(0.0, 0.0, 0.004))
    left = renderer.placement.frame(turned, 1)[1]  # the left beam
    ahead = left[left[:, 0] > left[:, 0].mean()].mean(axis=0)
    behind = left[left[:, 0] < left[:, 0].mean()].mean(axis=0)
    # To the left: the front end goes up, by 4 mrad times twenty of the beam's length.
    assert (behind - ahead)[1] / (ahead - behind)[0] == pytest.approx(0.08, rel=1e-6)


def test_the_carbody_moves_the_far_ends_of_the_dampers(quick: str) -> None:
    recorder = watched(quick, 1)
    renderer, frame = Renderer(recorder), recorder.frame()
    still, swayed = at_rest(frame), at_rest(frame, carbody=Pose(0.03, 0.01, 0.0))
    for k in range(8):
        shift = renderer.placement.damper(swayed, k) - renderer.placement.damper(still, k)
        # The train's lag of 30 mm shows in none of the bodies' places against the carbody.
        np.testing.assert_allclose(shift[1], [0.0, -0.01 * 20.0 * SCALE], atol=1e-9)
        np.testing.assert_allclose(shift[0], [-0.03 * 20.0 * SCALE, 0.0], atol=1e-9)


def test_rails_follow_alignment_and_gauge(quick: str) -> None:
    recorder = watched(quick, 1)
    renderer, frame = Renderer(recorder), recorder.frame()
    even = at_rest(frame)
    bent = replace(even, alignment=even.alignment + 0.003, gauge=even.gauge + 0.002)
    for side, shift in ((0, 0.003 + 0.001), (1, 0.003 - 0.001)):
        moved = renderer.placement.rails(bent, 0)[side] - renderer.placement.rails(even, 0)[side]
        np.testing.assert_allclose(moved[:, 0], 0.0, atol=1e-9)
        np.testing.assert_allclose(moved[:, 1], -shift * 20.0 * SCALE, rtol=1e-9)


def test_the_track_under_the_wheels_is_the_one_that_the_wheels_feel(quick: str) -> None:
    recorder = watched(quick, 20)
    frame, vehicles = recorder.frame(), recorder.batch.vehicles
    formation = vehicles.formation
    x, felt = (
        formation.plant.view(0).wheelset_x,
        formation.work.view(0).rail[: len(formation.plant.view(0).wheelset_x)],
    )
    # The last step evaluated the track half a millisecond of travel ago at most: 5 cm.
    np.testing.assert_allclose(np.interp(x, frame.rail_x, frame.alignment), felt, atol=5e-5)


def test_the_running_values_are_those_of_the_cost(quick: str) -> None:
    config, scenario = configured(quick, episode_s=2.0, control_period=0.02)
    batch = EpisodeBatch(config, 1, scenario=scenario, num_threads=1)
    batch.reset([0], [draw_episode(config, 0, 0, None)])
    recorder, terms = Recorder(batch), []
    for _ in range(90):
        batch.step(HALF[None])
        recorder.take()
        recorder.take()  # twice is once
        terms.append(batch.vehicles.terms[0].copy())
    frame, last = recorder.frame(), np.array(terms[-50:]).sum(axis=0)
    acceleration = last[COST_ACCELERATION : COST_ACCELERATION + 2]
    force = last[COST_FORCE : COST_FORCE + 2]
    assert len(frame.times) == 90
    assert frame.times[-1] == pytest.approx(1.8)
    np.testing.assert_allclose(
        frame.acceleration[-1], frame.acceleration_limit * np.sqrt(acceleration), rtol=1e-9
    )
    np.testing.assert_allclose(frame.force[-1], scenario.cost.force_reference * np.sqrt(force), rtol=1e-9)
    # By the rewards, which are minus the mean J, eq. (27).
    weights = scenario.cost.acceleration_weight, scenario.cost.force_weight
    assert frame.cost[-1] == pytest.approx(
        weights[0] * acceleration.mean() + weights[1] * force.mean(), rel=1e-9
    )


def test_a_long_run_keeps_ten_seconds(quick: str) -> None:
    recorder = watched(quick, 0, episode_s=0.05, control_period=0.05)
    batch, whole = recorder.batch, []
    for _ in range(260):  # 13 s
        batch.step(HALF[None])
        recorder.take()
        whole.append(batch.vehicles.terms[0, COST_FORCE])
    frame = recorder.frame()
    np.testing.assert_allclose(frame.times[[0, -1]], [3.05, 13.0])
    sums = np.convolve(whole, np.ones(20), "valid")[-200:]
    np.testing.assert_allclose(frame.force[:, 0], frame.force_reference * np.sqrt(sums), rtol=1e-9)


def test_faults_are_marked_when_they_happen(quick: str) -> None:
    faults = [
        {"kind": "valve_stuck", "damper": "front.left.upper", "current": 0.3, "start_s": 0.05},
        {"kind": "damper_lost", "damper": "rear.right.lower", "start_s": 0.05},
        {"kind": "sensor_dead", "signal": "speed", "start_s": 0.1},
    ]
    recorder = watched(quick, 4, options={"faults": faults})
    assert recorder.frame().faults == ()
    renderer = Renderer(recorder)
    before = middle_of(picture(renderer, recorder.frame()), rendering.INK)
    for _ in range(4):
        recorder.batch.step(HALF[None])
    frame = recorder.frame()
    assert frame.faults == ("valve stuck: front.left.upper", "damper lost: rear.right.lower")
    assert frame.damper_faults == {0: "valve stuck", 7: "damper lost"}
    assert frame.damper_force[7] == 0.0
    assert np.all(np.isfinite(before))
    with_faults, without = (
        picture(renderer, frame),
        picture(renderer, replace(frame, faults=(), damper_faults={})),
    )
    red = np.all(with_faults == rendering.BAD, axis=2).sum() - np.all(without == rendering.BAD, axis=2).sum()
    assert red > 200


def test_an_ending_is_shown(quick: str) -> None:
    recorder = watched(quick, 1)
    renderer, frame = Renderer(recorder), recorder.frame()
    assert frame.ending is None
    ended = picture(renderer, replace(frame, ending="derailment: a wheel has climbed over its rail"))
    assert tuple(ended[25, WIDTH - 50]) == rendering.BAD
    assert tuple(picture(renderer, frame)[25, WIDTH - 50]) == rendering.GOOD


def test_a_limit_is_exceeded_by_the_newest_value_of_a_bogie(quick: str) -> None:
    frame = watched(quick, 3).frame()
    values = np.full((3, 2), frame.acceleration_limit)
    assert not replace(frame, acceleration=values).above_limit
    values[-1, 1] *= 1.001
    assert replace(frame, acceleration=values).above_limit
    assert not replace(frame, acceleration=values[::-1]).above_limit
    assert not replace(frame, acceleration=values[:0]).above_limit


def test_the_badge_is_red_above_the_limit_whatever_else_is_shown(quick: str) -> None:
    recorder = watched(quick, 3)
    renderer, frame = Renderer(recorder), recorder.frame()
    for faults in ((), ("valve stuck: front.left.upper",)):
        for share, red in ((0.99, False), (1.01, True)):
            now = np.full_like(frame.acceleration, share * frame.acceleration_limit)
            now[:, 1] = 0.0  # one bogie is enough
            shown = picture(renderer, replace(frame, acceleration=now, faults=faults))
            assert (tuple(shown[25, WIDTH - 50]) == rendering.BAD) is red


def test_the_scale_of_the_track_is_that_of_the_whole_ride(quick: str) -> None:
    """It holds all that a video shows of the track, and no frame changes it."""
    recorder = watched(quick, 0, episode_s=20.0)
    frames = [recorder.frame()]
    for _ in range(40):
        recorder.batch.step(HALF[None])
        frames.append(recorder.frame())
    (scale,) = {frame.largest_alignment for frame in frames}
    assert scale >= max(np.abs(frame.alignment).max() for frame in frames) > 0.0


def test_a_diverged_run_can_be_drawn(quick: str) -> None:
    recorder = watched(quick, 2)
    recorder.batch.vehicles.state.view(0).v[:] = np.nan
    recorder.batch.step(HALF[None])
    recorder.take()
    frame = recorder.frame()
    assert frame.ending is not None
    assert len(frame.times) == 2
    assert picture(Renderer(recorder), frame).shape == (HEIGHT, WIDTH, 3)


def test_passive_dampers_have_no_valves(quick: str) -> None:
    recorder = watched(quick, 2, damper="passive")
    frame = recorder.frame()
    assert frame.opening is None
    assert frame.command is None
    assert frame.valve is None
    assert Renderer(recorder).draw() is not None


def test_valve_bars_show_what_acts_and_what_is_asked(quick: str) -> None:
    recorder = watched(quick, 1, options={"initial_current": 0.25})
    frame = recorder.frame()
    assert frame.command is not None
    assert frame.opening is not None
    np.testing.assert_array_equal(frame.command, 0.5)
    # 10 ms behind the command the valve has hardly moved.
    np.testing.assert_allclose(frame.opening, 0.25, atol=0.15)


def test_the_charts_are_matplotlib_s(quick: str) -> None:
    """A line has the frame's values in the chart's unit over the time before now, an axis ends above them."""
    recorder = watched(quick, 30)
    frame = recorder.frame()
    charts = Charts((ACCELERATION, FORCE, VALVE), 408, 172, 12)
    image = charts.draw(frame)
    assert image.shape == (172, 3 * 408 + 2 * 12, 4)
    for panel, values in zip(
        charts._panels, (frame.acceleration, 1e-3 * frame.force, frame.valve), strict=True
    ):
        assert values is not None
        for line, column in zip(panel.lines, values.T, strict=True):
            np.testing.assert_allclose(line.get_xdata(), frame.times - frame.time)
            np.testing.assert_allclose(line.get_ydata(), column)
        assert panel.axes.get_ylim()[1] >= values.max()
    limits = [panel.limit.get_ydata()[0] for panel in charts._panels]
    np.testing.assert_allclose(limits[:2], [frame.acceleration_limit, 1e-3 * frame.force_reference])


def test_newest_values_have_room_beside_each_other() -> None:
    """Below 10 two digits behind the point, above as many signs as there."""
    found = [_newest(value, 2) for value in (0.0, 9.99, 9.996, 12.64, 123.4)]
    assert found == ["0.00", "9.99", "10.0", "12.6", "123"]


def test_bars_and_words_are_not_covered_by_a_frame_that_swings(quick: str) -> None:
    """Where a valve's bar is, nothing else is drawn, however far the bogie turns."""
    recorder = watched(quick, 1)
    frame, renderer = recorder.frame(), Renderer(recorder)
    turned = replace(frame, poses=frame.poses | {"frame.front": Pose(0.0, 0.006, 0.006)})
    left, top, width, height = (int(value) for value in rendering.ROAD)
    before, length, after = vehicle_picture.BARS
    middle = left + round(0.75 * width + before)  # the front bogie has the right half
    ends = middle - 4, middle + round(length + after)
    rows = [round(top + 0.5 * height - SCALE * float(y)) for y in renderer.placement.plan.dampers[:4, 0, 1]]
    still, moved = picture(renderer, frame), picture(renderer, turned)
    assert np.any(still != moved)
    for y in rows:
        np.testing.assert_array_equal(
            still[y - 5 : y + 6, ends[0] : ends[1]], moved[y - 5 : y + 6, ends[0] : ends[1]]
        )


def test_what_moves_in_a_chart_leaves_no_trace(quick: str) -> None:
    """Lines that are drawn on top of kept axes give the same picture as charts that begin anew."""
    recorder = watched(quick, 20)
    charts = Charts((ACCELERATION, FORCE, VALVE), 408, 172, 12)
    charts.draw(recorder.frame())
    for _ in range(30):
        recorder.batch.step(HALF[None])
        recorder.take()
    frame = recorder.frame()
    anew = Charts((ACCELERATION, FORCE, VALVE), 408, 172, 12)
    np.testing.assert_array_equal(charts.draw(frame), anew.draw(frame))


def test_force_colours() -> None:
    assert force_colour(0.0) == vehicle_picture.NONE
    assert force_colour(1e6) == vehicle_picture.PULL
    assert force_colour(-1e6) == vehicle_picture.PUSH
    assert force_colour(15e3 / 4) == tuple(
        round((a + b) / 2) for a, b in zip(vehicle_picture.NONE, vehicle_picture.PULL, strict=True)
    )


def test_a_window_shows_the_run_and_closes_twice(quick: str) -> None:
    env = gym.make("SAYD/Nominal-v1", environment=quick, render_mode="human")
    env.reset(seed=0)
    assert env.render() is None
    for _ in range(3):
        env.step(HALF)
    env.close()
    env.close()


def test_a_window_that_is_closed_stays_closed(quick: str) -> None:
    recorder = watched(quick, 1)
    renderer = Renderer(recorder, "human")
    pygame = renderer.canvas.pygame
    assert renderer.window is not None
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    renderer.draw()
    assert not renderer.window.open
    renderer.draw()
    renderer.close()


def test_a_new_episode_begins_with_empty_charts(env: SaydEnv) -> None:
    env.step(HALF)
    state = env.get_state()
    (watcher,) = env._recorders
    assert len(watcher.frame().times) == 1
    env.reset()
    assert len(watcher.frame().times) == 0
    env.step(HALF)
    env.set_state(state)
    assert len(watcher.frame().times) == 0
    assert watcher.frame().time == pytest.approx(0.01)


def test_gymnasiums_checker_draws_in_both_modes(quick: str) -> None:
    check_env(
        gym.make("SAYD/Nominal-v1", environment=quick, episode_s=0.05, render_mode="rgb_array").unwrapped
    )


def test_a_picture_before_the_first_reset_is_refused(quick: str) -> None:
    with pytest.raises(ConfigError, match="call reset first"):
        SaydEnv(quick, render_mode="rgb_array").render()


def test_without_pygame_the_message_says_what_to_install(quick: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env = SaydEnv(quick, render_mode="rgb_array")
    env.reset(seed=0)
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r"pip install 'sayd-env\[render\]'"):
        env.render()


def test_without_a_screen_the_message_says_so(quick: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "none-such")
    env = SaydEnv(quick, render_mode="human")
    with pytest.raises(DependencyNotInstalled, match="needs a screen"):
        env.reset(seed=0)


def test_pygame_is_loaded_for_the_first_picture_only() -> None:
    code = (
        "import sys, sayd_env.envs.single as s; e = s.SaydEnv(render_mode='rgb_array'); "
        "assert not {'pygame', 'sayd_env.envs.rendering'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path.cwd())


def test_a_picture_knows_the_place_on_the_line() -> None:
    """Speed against the closed form of a uniform acceleration; the strip's marker moves with the train."""
    sections = [
        {"name": "first", "length": 100.0, "speed_kmh": 180.0},
        {
            "name": "curve",
            "length": 600.0,
            "speed_kmh": 198.0,
            "radius": 3000.0,
            "turn": "right",
            "cant": 0.05,
        }
        | {"transition": 100.0, "friction": 0.25},
    ]
    recorder = watched("nominal", 300, options={"line": {"sections": sections}})
    frame = recorder.frame()
    assert frame.place is not None
    distance = frame.place.distance
    assert distance == pytest.approx(100.0 + 50.0 * 1.0 + 0.25 * 1.0**2, abs=0.1)
    assert frame.position == distance
    assert frame.speed == pytest.approx(np.sqrt(50.0**2 + 2 * 0.5 * (distance - 100.0)), rel=1e-4)
    assert frame.place.section == "curve"
    assert frame.place.curve == f"R {3000.0 * 100.0 / (distance - 100.0):,.0f} m right"
    assert frame.place.cant == pytest.approx(-0.05 * (distance - 100.0) / 100.0, rel=1e-6)
    assert frame.friction == pytest.approx(0.25)
    renderer = Renderer(recorder)
    image = picture(renderer, frame)
    left, top, width, height = (int(value) for value in rendering.LINE)
    strip = image[top + 8 : top + height - 8, left : left + width]
    columns = np.flatnonzero((strip == np.array(rendering.BAD)).all(axis=(0, 2)))
    assert columns.size  # two pixels wide, of which smoothing may take one
    assert columns.mean() + 0.5 == pytest.approx(140 + distance / 700.0 * (width - 216), abs=1.5)
