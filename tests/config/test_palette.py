"""Colours: fixed for each name, told apart by colour-blind readers."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import numpy.typing as npt
import pytest

from sayd_env import baselines
from sayd_env.config import palette
from sayd_env.config.palette import CYCLE, Style, cycled, policy_style, rgb, wheelset_style
from sayd_env.config.robustness import load_robustness
from sayd_env.config.units import Array
from sayd_env.runs.policies import PAPER, TUNED

# H. Brettel, F. Vienot, J. D. Mollon, "Computerized simulation of color appearance for dichromats" (1997), in
# the form of F. Vienot, H. Brettel, J. D. Mollon (1999): linear RGB as protanopes and deuteranopes see it.
DICHROMATS = {
    "protan": [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]],
    "deutan": [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]],
}


def lab(colour: str, seen: npt.ArrayLike | None = None) -> Array:
    """CIE L*a*b* of a colour (IEC 61966-2-1, D65)."""
    share = np.array(rgb(colour)) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    linear = linear if seen is None else np.clip(np.asarray(seen) @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(np.maximum(to_xyz @ linear / [0.9505, 1.0, 1.089], 1e-9))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("kind", ["all", *DICHROMATS])
def test_colours_differ_for_whoever_looks(kind: str):
    """A difference of 2.3 is just noticeable; these are five times as large."""
    for one, other in combinations(CYCLE, 2):
        difference = np.linalg.norm(lab(one, DICHROMATS.get(kind)) - lab(other, DICHROMATS.get(kind)))
        assert difference > 5.0 * 2.3, (one, other)


LEARNED = ("ppo", "sac")
TOGETHER = ("passive", *PAPER, *TUNED, *LEARNED, "safe:mppt2", "safe:ppo")
"""What `sayd compare` and `sayd robustness` draw in one picture if nothing else is asked."""
NEAR, FAR = 20.0, 30.0
"""Differences of colour as deuteranopes see it (CIE L*a*b*): one on a thin line is taken for the other, and
none is. Green and grey are 18 apart, blue and sky 25, black and anything else more than 55."""


def deuteranopic(one: Style, other: Style) -> float:
    seen = [lab(style.colour, DICHROMATS["deutan"]) for style in (one, other)]
    return float(np.linalg.norm(seen[0] - seen[1]))


def test_policies_of_one_picture_differ_without_colours():
    """Markers always, lines where the colours are near."""
    assert {*load_robustness().policies} <= {*TOGETHER}
    for one, other in combinations(TOGETHER, 2):
        a, b = policy_style(one), policy_style(other)
        assert a.marker != b.marker, (one, other)
        assert a.line != b.line or deuteranopic(a, b) > NEAR, (one, other)


def test_policies_that_share_a_marker_have_colours_far_apart():
    for one, other in combinations({*baselines.NAMES, *TOGETHER}, 2):
        a, b = policy_style(one), policy_style(other)
        assert a.marker != b.marker or (deuteranopic(a, b) > FAR and a.line != b.line), (one, other)


def test_the_training_of_seed_0_looks_as_its_algorithm_and_its_fallback_does_not():
    for algorithm in LEARNED:
        assert policy_style(f"{algorithm}-s0") == policy_style(algorithm)
        assert policy_style(f"safe:{algorithm}-s0") == policy_style(f"safe:{algorithm}")
        assert policy_style(f"safe:{algorithm}").marker == "x"
    # Beside a controller five trainings of one algorithm share no marker with a colour that is near.
    for algorithm, name in product(LEARNED, TOGETHER):
        for seed in range(1, 5):
            a, b = policy_style(f"{algorithm}-s{seed}"), policy_style(name)
            assert a.marker != b.marker or deuteranopic(a, b) > FAR, (algorithm, seed, name)


def test_controllers_and_algorithms_have_styles_of_their_own():
    styles = [policy_style(name) for name in (*baselines.NAMES, "ppo", "sac")]
    assert len(set(styles)) == len(styles)


def test_trainings_share_their_algorithm_s_colour():
    styles = [policy_style(f"ppo-s{seed}") for seed in range(5)]
    assert {style.colour for style in styles} == {policy_style("ppo").colour}
    assert len(set(styles)) == len({s.marker for s in styles}) == len({s.line for s in styles}) == 5
    assert len({policy_style(f"ppo-s{seed}") for seed in range(50)}) == 50
    assert policy_style("constant:0.3").colour == policy_style("constant").colour


def test_any_other_name_has_a_style_that_does_not_change():
    # CRC-32 of the names by the standard's check value: "123456789" gives 0xCBF43926.
    others = palette._OTHERS
    assert policy_style("123456789") == others[0xCBF43926 % len(others)]
    assert isinstance(policy_style("$\x07_"), Style)


def test_bogies_have_colours_and_their_wheelsets_lines():
    front, behind, rear, last = map(wheelset_style, range(4))
    assert front.colour == behind.colour == palette.FRONT
    assert rear.colour == last.colour == palette.REAR
    assert len({front.line, behind.line}) == 2
    assert len({cycled(i) for i in range(8)}) == 8
