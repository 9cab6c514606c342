"""Lines given by sections: closed forms, what is left out, refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sayd_env.config import ConfigError, packaged_names, validate
from sayd_env.config.conditions import Knots, Line, cant_deficiency, joined
from sayd_env.config.line import LineConfig, outline, read_line, resolve
from sayd_env.config.track import read_irregularity


def line(*sections: dict[str, Any], episode: dict[str, float] | None = None, **keys: Any) -> Line:
    config = validate(LineConfig, {"sections": list(sections)} | keys, "mine.yaml")
    return resolve(config, **(episode or {}))


CURVE = {"length": 500.0, "radius": 800.0, "turn": "left", "cant": 0.1, "transition": 120.0}


def test_packaged_lines_can_be_read() -> None:
    names = packaged_names("line")
    assert {"straight", "slow_curve", "highspeed", "conditions"} <= set(names)
    for name in names:
        assert resolve(read_line(name), speed=60.0).length >= 1000.0


def test_straight_leaves_everything_as_the_episode_has_it() -> None:
    straight = resolve(read_line("straight"), speed=90.0, gauge=1.435, friction=0.4)
    assert straight.plain
    assert straight.speed_squared is straight.gauge is straight.friction is straight.rail_blend is None
    assert straight.tracks == straight.defects == ()
    assert not straight.curved
    assert straight.constant_speed
    assert straight.slowest is straight.fastest is None
    assert straight.speed_at(3.0) is straight.time_at(3.0) is straight.distance_at(3.0) is None
    assert straight.sections[0].straight
    assert not straight.curvature.at([-500.0, 0.0, 5000.0]).any()
    assert not resolve(read_line("slow_curve")).plain


def test_a_clothoid_turns_by_the_integral_of_its_curvature() -> None:
    curve = line(CURVE | {"length": 620.0}).curvature
    # Heading of a clothoid L / (2 R), of an arc its length over R.
    assert curve.integral(120.0) == pytest.approx(120.0 / (2 * 800.0))
    assert curve.integral(620.0) == pytest.approx(120.0 / (2 * 800.0) + 500.0 / 800.0)
    # Offset of its end from the tangent: L^2 / (6 R), and the next terms of Fresnel's series.
    s = np.linspace(0.0, 120.0, 4001)
    offset = np.trapezoid(np.sin(curve.integral(s)), s)
    angle = 120.0 / (2 * 800.0)
    assert offset == pytest.approx(120.0 * (angle / 3 - angle**3 / 42 + angle**5 / 1320), rel=1e-7)
    assert curve.slope([-1.0, 60.0, 300.0]) == pytest.approx([0.0, 1 / (800.0 * 120.0), 0.0])


def test_cant_serves_the_curve_and_rolls_the_frame_inwards() -> None:
    left, right = line(CURVE), line(CURVE | {"turn": "right"})
    for bend, side in ((left, 1.0), (right, -1.0)):
        assert bend.curvature.at(300.0) == pytest.approx(side / 800.0)
        assert bend.roll.at(300.0) == pytest.approx(-side * 0.1 / 1.5)
        # Curvature and cant change together.
        s = np.linspace(0.0, 120.0, 7)
        np.testing.assert_allclose(bend.cant.at(s), 0.1 * 800.0 * bend.curvature.at(s), atol=1e-15)


def test_nothing_is_missing_at_the_speed_that_balances_cant() -> None:
    speed = np.sqrt(9.81 * 800.0 * 0.1 / 1.5)  # V^2 / R = g h / b
    _, missing = cant_deficiency(line(CURVE), Knots((0.0,), (speed**2,)))
    np.testing.assert_allclose(missing, 0.0, atol=1e-15)
    # 120 km/h on 800 m: 11.8 V^2 / R mm (EN 13803, V in km/h) are 212 mm.
    _, missing = cant_deficiency(line(CURVE), Knots((0.0,), ((120 / 3.6) ** 2,)))
    assert missing.max() == pytest.approx(11.8e-3 * 120.0**2 / 800.0 - 0.1, rel=2e-3)


def test_a_ramp_is_as_long_as_its_acceleration_says() -> None:
    fast = line({"length": 500.0, "speed_kmh": 180.0}, {"length": 3000.0, "speed_kmh": 252.0})
    ramp = (70.0**2 - 50.0**2) / (2 * 0.5)
    assert fast.speed_at([0.0, 500.0, 500.0 + ramp, 1e6]) == pytest.approx([50.0, 50.0, 70.0, 70.0])
    assert fast.time_at(500.0 + ramp) == pytest.approx(10.0 + 20.0 / 0.5)
    assert (fast.slowest, fast.fastest) == pytest.approx((50.0, 70.0))
    assert not fast.constant_speed
    t = np.array([0.0, 5.0, 20.0, 33.0, 60.0, 100.0])
    run = solve_ivp(
        lambda _, s: fast.speed_at(s), (0.0, 100.0), [0.0], t_eval=t, rtol=1e-10, atol=1e-9, max_step=0.1
    )
    np.testing.assert_allclose(fast.distance_at(t), run.y[0], rtol=1e-7)
    np.testing.assert_allclose(fast.time_at(fast.distance_at(t)), t, atol=1e-10)


def test_braking_is_the_same_ramp_downwards() -> None:
    slow = line({"length": 500.0, "speed_kmh": 252.0}, {"length": 4000.0, "speed_kmh": 180.0})
    assert slow.speed_at(500.0 + 2400.0) == pytest.approx(50.0)
    assert slow.time_at(2900.0) == pytest.approx(500.0 / 70.0 + 40.0)


def test_a_blend_is_smooth_and_about_the_boundary() -> None:
    gauges = line({"length": 100.0, "gauge": 1.432}, {"length": 100.0, "gauge": 1.44}, blend=20.0).gauge
    assert gauges is not None
    np.testing.assert_allclose(
        gauges.at([-9.0, 90.0, 100.0, 110.0, 900.0]), [1.432, 1.432, 1.436, 1.44, 1.44]
    )
    s = np.linspace(90.0, 110.0, 401)
    t = (s - 90.0) / 20.0
    np.testing.assert_allclose(gauges.at(s), 1.432 + 0.008 * (6 * t**5 - 15 * t**4 + 10 * t**3), atol=6e-5)
    assert gauges.slope(s).max() <= 1.875 * 0.008 / 20.0


def test_blends_and_ramps_may_fill_their_sections() -> None:
    steps = [{"length": 0.1 * 3.0, "gauge": each} for each in (1.433, 1.431, 1.434, 1.432)]
    gauges = line(*steps, blend=0.3).gauge
    assert gauges is not None
    np.testing.assert_allclose(gauges.at([0.0, 0.15, 0.45, 0.75, 2.0]), [1.433, 1.433, 1.431, 1.434, 1.432])
    ramp = (70.0**2 - 50.0**2) / (2 * 0.5)
    speeds = [180.0, 252.0, 180.0, 252.0]
    full = line(*({"length": ramp * (1 + 1e-15), "speed_kmh": each} for each in speeds))
    assert full.speed_at(np.arange(1, 5) * ramp) == pytest.approx([50.0, 70.0, 50.0, 70.0])


def test_what_a_section_leaves_out_is_the_episodes() -> None:
    sections = (
        {"length": 3000.0, "friction": 0.2, "gauge": 1.44, "rail": 1.0, "speed_kmh": 180.0},
        {"length": 3000.0},
    )
    rails = [None, "60e1_30"]
    mixed = line(*sections, rails=rails, episode={"speed": 60.0, "gauge": 1.434, "friction": 0.5})
    for knots, value in ((mixed.friction, 0.5), (mixed.gauge, 1.434), (mixed.rail_blend, 0.0)):
        assert knots is not None
        assert knots.at(5000.0) == value
    assert mixed.speed_at(6000.0) == pytest.approx(60.0)
    assert mixed.rails is not None
    assert mixed.rails[0] is None
    assert mixed.rails[1].cant == 0.03333
    with pytest.raises(ConfigError, match="line: speed_kmh: some sections leave it out: the episode's own"):
        line(*sections, rails=rails, episode={"gauge": 1.434, "friction": 0.5})


def test_tracks_cover_the_line_and_join_where_they_are_equal() -> None:
    tracks = line(
        {"length": 100.0, "track": "german_low", "track_scale": 0.5},
        {"length": 100.0, "track": "german_low", "track_scale": 0.5},
        {"length": 50.0},
        {"length": 50.0, "track_scale": 2.0},
    ).tracks
    assert [(each.start, each.end, each.scale) for each in tracks] == [
        (0.0, 200.0, 0.5),
        (200.0, 250.0, None),
        (250.0, 300.0, 2.0),
    ]
    assert [each.irregularity for each in tracks] == [read_irregularity("german_low"), None, None]


def test_defects_lie_at_their_place_in_their_section() -> None:
    (defect,) = line(
        {"length": 100.0},
        {
            "length": 50.0,
            "defects": [{"channel": "gauge", "amplitude": 2e-3, "length": 8.0, "position": 20.0}],
        },
    ).defects
    assert (defect.channel, defect.position, defect.length, defect.scale) == ("gauge", 120.0, 8.0, 1.0)


def test_sections_say_where_they_are_straight() -> None:
    sections = line(
        {"length": 100.0, "name": "a"}, CURVE, {"length": 200.0, "transition": 80.0}, {"length": 100.0}
    ).sections
    assert [each.name for each in sections] == ["a", "2", "3", "4"]
    assert [(each.start, each.end) for each in sections] == [(0, 100), (100, 600), (600, 800), (800, 900)]
    assert [each.straight for each in sections] == [True, False, False, True]
    assert [each.straight_from for each in sections] == [0.0, None, 680.0, 800.0]
    resolved = line({"length": 100.0, "name": "a"}, CURVE)
    assert [resolved.section_at(s).name for s in (-5.0, 0.0, 99.9, 100.0, 9e9)] == ["a", "a", "a", "2", "2"]


def test_knots_drop_what_says_nothing() -> None:
    assert joined([(0.0, 1.0), (1.0, 1.0), (2.0, 1.0), (3.0, 2.0)]) == Knots((0.0, 2.0, 3.0), (1.0, 1.0, 2.0))
    with pytest.raises(ValueError, match="jumps from 1 to 2 at 1 m"):
        joined([(1.0, 1.0), (1.0, 2.0)])


def test_rails_and_files_lie_beside_the_line(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/rail.yaml").write_text('base: "60e1"\nname: mine\ncant: 0.03\n')
    path = tmp_path / "line.yaml"
    path.write_text("rails: [null, mine/rail.yaml]\nsections: [{length: 100.0, rail: 1.0}]\n")
    rails = resolve(read_line(str(path))).rails
    assert rails is not None
    assert rails[1].cant == 0.03
    path.write_text("file: mine/measured.csv\n")
    assert read_line(str(path)).file == str(tmp_path / "mine/measured.csv")
    with pytest.raises(ConfigError, match="is measured"):
        resolve(read_line(str(path)))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "give either sections, one at least, or a file"),
        ({"file": "a.csv", "sections": [{"length": 9.0}]}, "give either sections"),
        ({"sections": [{"length": 0.0}]}, r"length: found 0\.0; expected a number greater than 0"),
        ({"sections": [{"length": 50.0, "raduis": 9.0}]}, "raduis', did you mean 'radius'"),
        ({"sections": [CURVE | {"radius": 149.0}]}, "radius: found 149.* or equal to 150"),
        ({"sections": [CURVE | {"cant": 0.19}]}, "cant: found 0.19.* or equal to 0.18"),
        ({"sections": [CURVE | {"turn": None}]}, "radius and turn .* belong together"),
        ({"sections": [{"length": 50.0, "cant": 0.1}]}, r"cant: found 0\.1 m in a section without a radius"),
        ({"sections": [CURVE | {"transition": None}]}, "section '1': transition: is missing"),
        ({"sections": [CURVE, {"length": 90.0}]}, "section '2': transition: is missing"),
        (
            {"sections": [CURVE | {"transition": 501.0}]},
            r"transition: found 501 m; the section is 500 m long",
        ),
        (
            {"sections": [CURVE | {"transition": 30.0}]},
            "slope of the cant: found 0.003333 -; at most 0.0025 -",
        ),
        ({"sections": [CURVE | {"speed_kmh": 180.0}]}, "cant deficiency: found 0.3778 m; at most 0.3 m"),
        ({"sections": [{"length": 50.0, "speed_kmh": 20.0}]}, "speed_kmh: found 20.0; .* or equal to 30"),
        ({"sections": [{"length": 50.0, "acceleration": 0.8}]}, "acceleration: .* or equal to 0.7"),
        (
            {"sections": [{"length": 90.0, "speed_kmh": 180.0}, {"length": 2399.0, "speed_kmh": 252.0}]},
            "section '2': speed_kmh: the change to 252 km/h at 0.5 m/s2 takes 2400 m; the section is 2399 m",
        ),
        (
            {"sections": [{"length": 50.0, "acceleration": 0.6}]},
            "section '1': acceleration: has no effect: no section has a speed_kmh",
        ),
        (
            {"sections": [{"length": 50.0, "transition": 30.0}]},
            "section '1': transition: has no effect: neither curvature nor cant changes",
        ),
        ({"sections": [CURVE, CURVE]}, "section '2': transition: has no effect"),
        (
            {"sections": [{"length": 50.0}], "rails": [None, "60e1_30"]},
            "rails: have no effect where no section has a rail",
        ),
        ({"sections": [{"length": 50.0, "gauge": 2.0}]}, "gauge: found 2.0"),
        ({"sections": [{"length": 50.0, "friction": 0.0}]}, "friction: found 0.0"),
        ({"sections": [{"length": 50.0, "rail": 0.5}]}, "rail: the line's two rails are missing"),
        ({"sections": [{"length": 50.0}], "rails": ["cn60", "s1002"]}, "rails: .*is a wheel profile"),
        ({"sections": [{"length": 50.0, "track": "german"}]}, "unknown track 'german', did you mean"),
        (
            {"sections": [{"length": 50.0, "track": "smooth", "track_scale": 1.0}]},
            "track 'smooth' is even: it has nothing to scale",
        ),
        (
            {"sections": [{"length": 90.0}, {"length": 34.0, "friction": 0.1}, {"length": 90.0}]},
            "section '2': friction: lasts 34 m; .* a run knows it every 10 m, it needs 35 m",
        ),
        (
            {"sections": [{"length": 50.0}, {"length": 20.0}]},
            "section '2': length: found 20 m; expected the 25 m",
        ),
        ({"sections": [{"length": 50.0, "name": "2"}, {"length": 50.0}]}, "two sections have the name '2'"),
        (
            {
                "sections": [
                    {
                        "length": 50.0,
                        "defects": [{"channel": "gauge", "amplitude": 1e-3, "length": 9.0, "position": 42.0}],
                    }
                ]
            },
            "defects: one ends at 51 m; the section is 50 m long",
        ),
    ],
)
def test_refusals_name_what_is_wrong(content: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        validate(LineConfig, content, "mine.yaml")
    assert str(caught.value).startswith("mine.yaml: ")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("section_length", 500.0),
        ("nominal_gauge", 1.432),
        ("ignore", ["twist_mm"]),
        ("domains", ["D1"]),
        ("recover", [3.0, 25.0]),
        ("cross_level_base", 1.435),
    ],
)
def test_keys_of_a_measured_file_do_not_stand_beside_sections(key: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=f"mine.yaml: .*{key}: has no effect beside sections"):
        validate(LineConfig, {"sections": [CURVE], key: value}, "mine.yaml")


def test_a_lines_content_with_all_its_keys_is_the_line() -> None:
    """As a result's record has it: what stands at its default says nothing."""
    for name in packaged_names("line"):
        config = read_line(name)
        assert validate(LineConfig, config.model_dump(mode="json"), "record") == config


def test_a_line_says_what_all_of_its_sections_say() -> None:
    whole = {"length": 50.0, "speed_kmh": 200.0, "friction": 0.3, "gauge": 1.434, "track": "china"}

    def said(*sections: dict[str, Any]) -> frozenset[str]:
        return outline(validate(LineConfig, {"sections": list(sections)}, "mine.yaml")).said

    assert said({"length": 50.0}) == frozenset()
    assert said(whole, whole) == {"speed_kmh", "friction", "gauge", "track", "track_scale"}
    assert said(whole, {"length": 50.0}) == frozenset()
    assert said(whole, {"length": 50.0, "track_scale": 0.5}) == {"track_scale"}
    assert said({"length": 50.0, "track_scale": 0.5}) == {"track_scale"}


def test_braking_in_a_curve_counts_with_the_speed_that_is_still_there() -> None:
    approach = {"length": 500.0, "speed_kmh": 180.0}
    with pytest.raises(ConfigError, match=r"section '2'.*cant deficiency"):
        line(approach, CURVE | {"speed_kmh": 160.0, "length": 1000.0})
    with pytest.raises(
        ConfigError, match=r"line: section '1'.*cant deficiency"
    ):  # the episode's speed counts
        line(CURVE, episode={"speed": 50.0})
