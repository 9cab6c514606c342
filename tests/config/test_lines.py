"""Drawn lines: fit by construction, independent streams."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from sayd_env.config import ConfigError, packaged_names
from sayd_env.config.conditions import Line, cant_deficiency
from sayd_env.config.lines import Uniform, draw_line, read_lines

NAMED = packaged_names("lines")


def stream(seed: int) -> Uniform:
    return lambda name: float(np.random.default_rng([seed, zlib.crc32(name.encode())]).random())


def drawn(seed: int, *overrides: str) -> Line:
    return draw_line(read_lines("highspeed", overrides), stream(seed))


@pytest.mark.parametrize("name", NAMED)
def test_drawn_lines_keep_their_limits(name: str) -> None:
    config = read_lines(name)
    assert config.curves is not None
    radii, cants, curved = [], [], 0
    for seed in range(60):
        line = draw_line(config, stream(seed))
        assert line.speed_squared is not None
        _, missing = cant_deficiency(line, line.speed_squared)
        assert np.abs(line.cant.value).max() <= config.curves.most_cant
        assert (np.sign(line.curvature.at(_)) * missing).max() <= config.curves.most_deficiency * (1 + 1e-9)
        radii += [1 / abs(kappa) for kappa in line.curvature.value if kappa]
        cants += [abs(cant) for cant in line.cant.value]
        curved += sum(section.straight_from is None for section in line.sections)
        assert 160.0 / 3.6 - 1e-9 <= (line.slowest or 0.0) <= (line.fastest or 0.0) <= 400.0 / 3.6 + 1e-9
    assert min(radii) >= 5500.0
    assert max(radii) <= 12000.0 * (1 + 1e-9)
    # Binomial of 600 sections: three deviations are 36.
    assert curved == pytest.approx(0.4 * 600, abs=36)
    assert max(cants) > 0.15


def test_the_same_numbers_make_the_same_line() -> None:
    assert drawn(3) == drawn(3)
    assert drawn(3) != drawn(4)


OTHERS = {
    "gauge": ("gauge={distribution: fixed, value: 1.435}", "gauge"),
    "friction": ("friction=null", "friction"),
    "rail": ("rail={distribution: fixed, value: 0.25}", "rail_blend"),
    "tracks": ("tracks=[{name: china}]", "tracks"),
    "defects": ("defects=null", "defects"),
    "cant_deficiency": ("curves.cant_deficiency={distribution: fixed, value: 0.05}", "cant"),
}


@pytest.mark.parametrize("quantity", OTHERS)
def test_another_distribution_leaves_all_other_draws_as_they_are(quantity: str) -> None:
    override, changed = OTHERS[quantity]
    for seed in range(5):
        one, other = drawn(seed), drawn(seed, override)
        for name in Line.__dataclass_fields__:
            if name != changed:
                assert getattr(one, name) == getattr(other, name), name
    assert any(getattr(drawn(seed), changed) != getattr(drawn(seed, override), changed) for seed in range(5))


def test_without_speeds_and_curves_the_rest_is_the_same() -> None:
    one, other = drawn(1), drawn(1, "curves=null", "speed_kmh=null")
    assert other.speed_squared is None
    assert not other.curved
    assert (one.gauge, one.tracks, one.friction) == (other.gauge, other.tracks, other.friction)


def test_radii_are_spread_above_what_the_speed_needs() -> None:
    # At 400 km/h 290 mm of cant and deficiency need V^2 b / (g 0.29) = 6,510 m; above it the law is uniform.
    least = (400 / 3.6) ** 2 * 1.5 / (9.81 * 0.29)
    radii: list[float] = []
    for seed in range(60):
        line = drawn(seed, "curves.share=1.0", "speed_kmh={distribution: fixed, value: 400.0}")
        radii += [1 / abs(kappa) for kappa in set(line.curvature.value) if kappa]
    assert min(radii) >= least * (1 - 1e-9)
    spread = np.sort((np.array(radii) - least) / (12000.0 - least))
    distance = np.abs(spread - (np.arange(len(spread)) + 0.5) / len(spread)).max()
    assert distance < 1.63 / np.sqrt(len(spread))  # Kolmogorov and Smirnov at 1 %


def test_a_distribution_that_never_reaches_the_radius_gives_the_least_one() -> None:
    line = drawn(
        0,
        "curves.share=1.0",
        "speed_kmh={distribution: fixed, value: 400.0}",
        "curves.radius={distribution: choice, values: [600.0, 900.0]}",
    )
    least = (400 / 3.6) ** 2 * 1.5 / (9.81 * 0.29)
    np.testing.assert_allclose([abs(kappa) for kappa in line.curvature.value if kappa], 1 / least)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "speed_kmh={distribution: uniform, low: 20.0, high: 400.0}",
            "speed_kmh: .*allowed are 30 to 500 km/h",
        ),
        ("speed_kmh=null", "curves need a speed_kmh"),
        (
            "curves.transition={distribution: fixed, value: 1100.0}",
            "curves.transition reaches beyond the shortest",
        ),
        (
            "curves.radius={distribution: fixed, value: 100.0}",
            "radius reaches down to 100; at least 150 is needed",
        ),
        ("curves.radius={distribution: choice, values: [9000.0, 6000.0]}", "values of a choice must ascend"),
        (
            "curves.cant_deficiency={distribution: fixed, value: 0.2}",
            "cant_deficiency reaches beyond 0 to 0.11 m",
        ),
        ("curves.most_cant=0.2", "less than or equal to 0.18"),
        ("rail={distribution: fixed, value: 1.5}", "rail reaches beyond 0 to 1"),
        ("rails=null", "rail needs the two rails"),
        ("tracks=[{name: chine}]", "did you mean 'china'"),
        ("tracks=[{name: china, weight: 0.0}]", "at least one weight must be positive"),
        ("length={distribution: fixed, value: 20.0}", "length reaches down to 20; at least 35 is needed"),
        (
            "length={distribution: fixed, value: 2.0e+6}",
            "length reaches up to 2e.06; at most 1e.06 is possible",
        ),
        (
            "curves.transition={distribution: uniform, low: 5.0, high: 600.0}",
            "transition reaches down to 5; at least 20 is needed",
        ),
        (
            "defects.amplitude={distribution: uniform, low: 1.0, high: 4.0}",
            "amplitude reaches up to 4; at most 0.1 is possible",
        ),
        (
            "defects.length={distribution: fixed, value: 1.0}",
            "length reaches down to 1; at least 2 is needed",
        ),
        ("defects.length={distribution: fixed, value: 2000.0}", "defects.length reaches beyond the shortest"),
        ("sections={distribution: fixed, value: 0.0}", "sections reaches down to 0"),
    ],
)
def test_refusals(override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_lines("highspeed", [override])


def test_sections_are_as_long_as_their_blend_where_nothing_else_is_drawn() -> None:
    plain = [f"{name}=null" for name in ("friction", "rail", "rails", "curves", "defects")]
    config = read_lines("highspeed", [*plain, "length={distribution: fixed, value: 25.0}"])
    assert draw_line(config, stream(0)).length == pytest.approx(10 * 25.0)


def test_a_drawn_line_that_is_not_allowed_is_one_message() -> None:
    """Transitions of 20 to 50 m are too steep for the cant of some of the curves."""
    short = "curves.transition={distribution: uniform, low: 20.0, high: 50.0}"
    messages = []
    for seed in range(20):
        try:
            drawn(seed, short)
        except ConfigError as error:
            messages.append(str(error))
    assert messages
    assert all("a line that was drawn is not allowed: " in each for each in messages)
    assert all("slope of the cant" in each for each in messages)
