"""The environment on a line: what changes along the way, and that nothing else does."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.config.environment import load_environment
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.keywords import configured
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv

SHORT = {
    "rails": [None, "60e1"],
    "sections": [
        {"length": 200.0, "speed_kmh": 250.0, "gauge": 1.435, "friction": 0.4},
        {
            "length": 700.0,
            "speed_kmh": 265.0,
            "radius": 6000.0,
            "turn": "left",
            "cant": 0.08,
            "transition": 150.0,
        }
        | {"gauge": 1.437, "rail": 1.0, "friction": 0.3, "track": "china"},
    ],
}
"""A line on which everything changes within seconds."""
COMMAND = np.array([0.3, 0.1], dtype=np.float32)


def made(environment: str = "nominal", **keywords: Any) -> SaydEnv:
    return SaydEnv(environment, **keywords)


def run(env: SaydEnv, steps: int) -> np.ndarray:
    return np.array([env.step(COMMAND)[0] for _ in range(steps)])


@pytest.mark.parametrize("environment", ["nominal", "randomized"])
@pytest.mark.parametrize(
    "line",
    ["straight", {"sections": [{"length": 100.0}, {"length": 500.0}]}],
    ids=["packaged", "sections that say nothing"],
)
def test_a_line_that_leaves_all_out_changes_no_bit(environment: str, line: Any) -> None:
    plain, on_line = made(environment), made(environment)
    first, _ = plain.reset(seed=7)
    second, _ = on_line.reset(seed=7, options={"line": line})
    assert np.array_equal(first, second)
    assert np.array_equal(run(plain, 150), run(on_line, 150))


def test_a_line_with_the_episodes_own_numbers_changes_no_bit() -> None:
    plain, on_line = made(), made()
    scenario = plain.batch.scenario
    section = {
        "length": 900.0,
        "speed_kmh": 350.0,
        "friction": scenario.friction,
        "gauge": scenario.track.gauge,
    }
    plain.reset(seed=2)
    on_line.reset(seed=2, options={"line": {"sections": [section]}})
    assert np.array_equal(run(plain, 150), run(on_line, 150))


def test_the_train_follows_speed_and_place_of_its_line() -> None:
    """Distance and speed against the closed form of a uniform acceleration."""
    env = made(episode_s=10.0)
    env.reset(seed=0, options={"line": SHORT})
    line, vehicles = env.batch.lines[0], env.batch.vehicles
    assert line is not None
    observed = run(env, 1000)[:, -1]
    at = line.distance_at(10.0)
    assert at is not None
    place = vehicles.state.view(0).clock[1] - vehicles.vehicle(0).origin
    # The speed of a sample is that of its beginning: 0.5 m/s2 over 1 ms is late by 0.25 mm/s.
    assert place == pytest.approx(float(at), abs=0.5 * 0.5e-3 * 10.0 + 1e-3)
    expected = line.speed_at(at)
    assert expected is not None
    assert observed[-1] == pytest.approx(float(expected), abs=0.01)
    assert observed[0] == pytest.approx(250.0 / 3.6, abs=0.01)


def test_a_batch_runs_the_same_lines_bit_for_bit() -> None:
    lines = [SHORT, "straight", SHORT, "conditions", SHORT, SHORT, SHORT, SHORT]
    single = []
    for k, line in enumerate(lines):
        env = made(episode_s=4.0)
        env.reset(seed=k, options={"line": line})
        single.append(run(env, 100))
    batch = SaydVectorEnv("nominal", num_envs=len(lines), episode_s=4.0)
    batch.reset(seed=0, options={"line": "straight"})
    episodes = [draw_episode(batch.config, k, 0, {"line": line}) for k, line in enumerate(lines)]
    batch.batch.reset(range(len(lines)), episodes, whole_track=False)
    actions = np.tile(COMMAND, (len(lines), 1))
    together = np.array([batch.batch.step(actions)[0] for _ in range(100)])
    for k, rows in enumerate(single):
        assert np.array_equal(rows, together[:, k])


def test_a_saved_state_goes_on_along_the_line() -> None:
    env = made(episode_s=8.0)
    env.reset(seed=4, options={"line": SHORT})
    run(env, 250)  # in the transition, the speed changing
    state = pickle.loads(pickle.dumps(env.get_state()))
    expected = run(env, 200)
    other = made(episode_s=8.0)
    other.reset(seed=9)
    other.set_state(state)
    assert np.array_equal(run(other, 200), expected)


def test_lines_are_drawn_from_the_seed_alone() -> None:
    env, again = made("line"), made("line")
    env.reset(seed=5)
    again.reset(seed=1)
    again.reset(seed=5)
    assert env.batch.lines[0] == again.batch.lines[0]
    env.reset()
    assert env.batch.lines[0] != again.batch.lines[0]


SMOOTH = {
    "length": 600.0,
    "speed_kmh": 300.0,
    "radius": 7000.0,
    "turn": "right",
    "cant": 0.09,
    "transition": 200.0,
}


def test_a_smooth_curve_is_no_hunting() -> None:
    """On even track the accelerations that count come from the curve's own slow forces alone.

    On the straight an even track gives J = 0. In the curve the share of the acceleration stays below that of
    1 % of its limit; what is left is the force of dampers that turn with their bogies.
    """
    env = made(episode_s=6.0, settings=("track.irregularity={type: none}", "wear=0.0"))
    line = {"sections": [{"length": 50.0, "speed_kmh": 300.0}, SMOOTH]}
    env.reset(seed=0, options={"line": line})
    infos = [env.step(COMMAND)[4] for _ in range(600)]
    assert sum(info["cost_acceleration"] for info in infos) < 6.0 * 0.01**2
    assert max(info["cost_force"] for info in infos) > 0.0


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("strait", "straight"),
        ({"sections": [{"length": 100.0, "radius": 50.0, "turn": "left"}]}, "radius"),
        ({"sections": [{"length": 100.0, "raduis": 900.0}]}, "raduis"),
        (3, "line"),
    ],
)
def test_a_line_that_cannot_be_is_refused_by_name(line: Any, word: str) -> None:
    env = made()
    with pytest.raises(ConfigError, match=word):
        env.reset(seed=0, options={"line": line})


@pytest.mark.parametrize("gauge", [1.4225, 1.448, 1.668])
def test_a_gauge_beyond_the_contact_tables_is_refused(gauge: float) -> None:
    """They reach 12 mm from the track's 1435 mm; rails 116 mm away carried a vehicle without a word."""
    wide = {"sections": [{"length": 300.0, "gauge": 1.436}, {"length": 300.0, "gauge": gauge}]}
    with pytest.raises(ConfigError, match=rf"line: gauge: found {gauge} m at .* tabulated for 1\.435 m"):
        made().reset(seed=0, options={"line": wide})


def test_info_says_what_lies_where_the_train_is() -> None:
    env = made(info="full", episode_s=8.0)
    _, first = env.reset(seed=0, options={"line": SHORT})
    assert first["distance"] == pytest.approx(0.0, abs=0.01)
    assert first["line_curvature"] == 0.0
    for _ in range(799):
        info = env.step(COMMAND)[4]
    assert set(info) == set(first)
    assert info["line_section"] == "2"
    assert info["line_curvature"] == pytest.approx(1.0 / 6000.0)
    assert info["line_cant"] == pytest.approx(0.08)
    assert info["line_gauge"] == pytest.approx(1.437)
    assert info["line_friction"] == pytest.approx(0.3)
    line = env.batch.lines[0]
    assert line is not None
    assert info["speed"] == pytest.approx(float(line.speed_at(info["distance"]) or 0.0), abs=0.003)


def test_the_running_values_of_a_slower_train_reach_as_far() -> None:
    """100 m of samples at the present speed, after the speed has fallen."""
    env = made(info="full", episode_s=8.0)
    section = {"length": 700.0, "speed_kmh": 230.0, "acceleration": 0.7}
    env.reset(seed=0, options={"line": {"sections": [{"length": 50.0, "speed_kmh": 250.0}, section]}})
    for _ in range(700):
        info = env.step(COMMAND)[4]
    sliding = env._sliding[0]
    assert sliding is not None
    assert sliding._window == round(100.0 / info["speed"] * 1000.0)
    assert len(sliding._filtered) > sliding._window


def test_a_constant_condition_of_a_line_is_that_of_the_episode() -> None:
    """Friction that never changes acts as the option of the same name does."""
    plain, on_line = made(), made()
    plain.reset(seed=2, options={"friction": 0.2})
    on_line.reset(seed=2, options={"line": {"sections": [{"length": 900.0, "friction": 0.2}]}})
    assert np.array_equal(run(plain, 150), run(on_line, 150))


def test_a_line_on_other_rails_is_a_run_on_these_rails() -> None:
    """A constant blend of 1 against a scenario with the second rail.

    Heights are counted from the static approach on the scenario's rail, which the springs feel: where nothing
    hunts readings agree to 1 % of their RMS.
    """
    calm: dict[str, Any] = {"speed_kmh": 250.0}
    plain = made(settings=("rail=60e1_30", "wear=0.0"), **calm)
    on_line, other = (made(settings=("wear=0.0",), **calm) for _ in range(2))
    section = {"length": 900.0, "rail": 1.0}
    plain.reset(seed=2)
    on_line.reset(seed=2, options={"line": {"rails": [None, "60e1_30"], "sections": [section]}})
    other.reset(seed=2)
    expected, found, apart = run(plain, 300)[:, :4], run(on_line, 300)[:, :4], run(other, 300)[:, :4]
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.01 * np.sqrt(np.mean(expected**2))
    assert np.sqrt(np.mean((apart - expected) ** 2)) > 0.1 * np.sqrt(np.mean(expected**2))


def test_one_vehicle_between_two_rails_leaves_the_others_of_its_group_as_they_are() -> None:
    """Seven on a whole shape read its table; beside an eighth their rows are blended: the same bits."""
    whole = {"rails": [None, "60e1"], "sections": [{"length": 900.0, "rail": 1.0}]}
    mixed = {"rails": [None, "60e1"], "sections": [{"length": 900.0, "rail": 0.3}]}
    batch = SaydVectorEnv("nominal", num_envs=8)
    batch.reset(seed=0, options={"line": "straight"})
    together = []
    for lines in ([whole] * 8, [whole] * 7 + [mixed]):
        episodes = [draw_episode(batch.config, k, 0, {"line": line}) for k, line in enumerate(lines)]
        batch.batch.reset(range(8), episodes, whole_track=False)
        together.append(np.array([batch.batch.step(np.tile(COMMAND, (8, 1)))[0] for _ in range(100)]))
    assert np.array_equal(together[0][:, :7], together[1][:, :7])
    assert not np.array_equal(together[0][:, 7], together[1][:, 7])


def test_without_a_run_in_info_is_that_of_the_start(tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text("base: nominal\nrun_in: 0.0\n")
    env = made(str(tmp_path / "short.yaml"))
    for seed in (0, 1):
        info = env.reset(seed=seed)[1]
        assert info["distance"] == pytest.approx(0.0, abs=1e-9)
        assert info["speed"] == pytest.approx(350.0 / 3.6)
        run(env, 50)


def test_a_learners_ordinary_cost_is_that_of_the_lines_own_track() -> None:
    """Level and speed of the line count, not those that the episode draws beside it."""
    section = {"length": 4000.0, "speed_kmh": 300.0, "track": "german_low", "track_scale": 0.5}
    env = made("randomized", scaled=True)
    ordinary = []
    for seed in (0, 1):
        env.reset(seed=seed, options={"line": {"sections": [section]}})
        ordinary.append(float(env._ordinary[0]))
    assert ordinary[0] == pytest.approx(ordinary[1], rel=1e-12)


def test_what_a_user_fixes_holds_beside_a_drawn_line() -> None:
    """Friction, gauge and tracks are then not drawn; a speed, which curves were fitted to, is refused."""
    options = {"friction": 0.4, "gauge": 1.434, "track": "german_low"}
    env = made("line", info="full", settings=("damper.current=0.1",))
    for seed in (0, 1):
        info = env.reset(seed=seed, options=options)[1]
        line = env.batch.lines[0]
        assert line is not None
        assert (line.friction, line.gauge, line.tracks) == (None, None, ())
        assert (info["line_friction"], info["line_gauge"], info["track"]) == (0.4, 1.434, "german_low")
        assert info["line"] == "drawn"
    fixed = made("line", settings=("friction=0.3",))
    assert fixed.reset(seed=0)[1]["friction"] == 0.3
    with pytest.raises(ConfigError, match="speeds of their own"):
        env.reset(seed=0, options={"speed_kmh": 300.0})
    with pytest.raises(ConfigError, match="speeds of their own"):
        made("line", speed_kmh=300.0)


def test_an_environment_takes_a_line_in_place_of_drawn_ones(tmp_path: Path) -> None:
    """A measured file is looked for beside the file that names it."""
    (tmp_path / "mine.csv").write_text("x_m,speed_kmh\n0,200\n500,220\n1000,220\n")
    (tmp_path / "mine.yaml").write_text("base: line\nlines: null\nline: mine.csv\n")
    env = made(str(tmp_path / "mine.yaml"))
    info = env.reset(seed=0)[1]
    assert info["speed_kmh"] == pytest.approx(200.0)
    assert info["line"] == str(tmp_path / "mine.csv")


SAYS_ALL = {"length": 900.0, "speed_kmh": 300.0, "friction": 0.4, "gauge": 1.435, "track": "china"}


@pytest.mark.parametrize(
    ("name", "value", "key"),
    [
        ("speed_kmh", 200.0, "speed_kmh"),
        ("friction", 0.2, "friction"),
        ("gauge", 1.44, "gauge"),
        ("track", "german_high", "track"),
        ("track_scale", 0.5, "track"),
    ],
)
def test_what_a_line_says_itself_is_refused_beside_it(
    name: str, value: Any, key: str, tmp_path: Path
) -> None:
    """Whether an option or the environment names the line; what a section leaves out stays allowed."""
    nominal = load_environment("nominal")
    with pytest.raises(ConfigError, match=f"options: {name}: has no effect: the line says {name} itself"):
        draw_episode(nominal, 0, 0, {"line": {"sections": [SAYS_ALL]}, name: value})
    (tmp_path / "line.yaml").write_text(json.dumps({"sections": [SAYS_ALL]}))
    (tmp_path / "mine.yaml").write_text("base: nominal\nline: line.yaml\n")
    with pytest.raises(ConfigError, match=f"options: {name}: has no effect: line '.*' says {name} itself"):
        draw_episode(load_environment(str(tmp_path / "mine.yaml")), 0, 0, {name: value})
    partly = [SAYS_ALL, {each: SAYS_ALL[each] for each in SAYS_ALL if each != key}]
    draw_episode(nominal, 0, 0, {"line": {"sections": partly}, name: value})


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"speed_kmh": 200.0}, "speed_kmh: has no effect: line '.*/line.csv' says speed_kmh itself"),
        ({"settings": ("friction=0.2",)}, "settings: friction: has no effect"),
        ({"settings": ("track.gauge=1.44",)}, "settings: track.gauge: has no effect"),
    ],
)
def test_keywords_beside_an_environments_line(keywords: dict[str, Any], message: str, tmp_path: Path) -> None:
    rows = "x_m,speed_kmh,friction,nominal_gauge_mm\n0,200,0.3,1435\n900,200,0.3,1435\n"
    (tmp_path / "line.csv").write_text(rows)
    (tmp_path / "mine.yaml").write_text("base: nominal\nline: line.csv\n")
    with pytest.raises(ConfigError, match=message):
        configured(str(tmp_path / "mine.yaml"), **keywords)
    configured(str(tmp_path / "mine.yaml"), settings=("track=china", "track.irregularity.scale=0.5"))


def test_a_path_names_a_line(tmp_path: Path) -> None:
    path = tmp_path / "line.csv"
    path.write_text("x_m,speed_kmh\n0,200\n900,200\n")
    assert made().reset(seed=0, options={"line": path})[1]["line"] == str(path)
    path.write_text("x_m,speed_kmh\n0,200\n900,-200\n")
    with pytest.raises(DataError, match="line 3"):
        made().reset(seed=0, options={"line": path})


def test_a_line_that_leaves_all_out_is_named_but_has_no_section() -> None:
    info = made(info="full").reset(seed=0, options={"line": "straight"})[1]
    assert (info["line"], info["line_section"]) == ("straight", "")
