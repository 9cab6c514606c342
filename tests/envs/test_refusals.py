"""What an environment cannot use is refused by name at its border, whatever type it has."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env import baselines
from sayd_env.config import ConfigError, DataError
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv

HUGE = 10**400
"""Too large for a float."""
HUGER = 10**5000
"""Python does not even write it."""
UNWRITTEN = "a int too long to write"


RECURSIVE: list[Any] = []
"""A list that holds itself."""
RECURSIVE.append(RECURSIVE)


class Silent:
    """An object that cannot say what it is."""

    def __repr__(self) -> str:
        raise ValueError


def kind(value: Any) -> str:
    """Name of a case: pytest cannot write the values themselves."""
    return type(value).__name__


def message_of(call: Any, *arguments: Any, **keywords: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        call(*arguments, **keywords)
    assert len(str(caught.value)) <= 1200
    assert str(caught.value).isprintable()
    return str(caught.value)


@pytest.mark.parametrize(
    ("keyword", "value", "found"),
    [
        *(
            ("settings", value, "expected a list of key=value")
            for value in (-1, 1e308, HUGE, object(), 1j, len)
        ),
        ("settings", Fraction(1, 3), "settings: found Fraction(1, 3); expected"),
        ("settings", "friction=0.3", "settings: found 'friction=0.3'; expected"),
        ("settings", {"friction": 0.3}, "settings: found {'friction': 0.3}; expected"),
        ("settings", ["friction=0.3", 5], "settings: found ['friction=0.3', 5]; expected"),
        ("settings", ["wear=0x" + "f" * 20000], f"wear: found {UNWRITTEN}"),
        ("settings", ['wear=!!int ""'], "has a value that does not fit its tag"),
        (
            "settings",
            ['track.irregularity={type: file, path: "a\\0b"}'],
            r"found 'a\x00b'; expected text without",
        ),
        ("environment", HUGER, f"environment: found {UNWRITTEN}; expected the name"),
        ("environment", "a\0b", r"unknown env 'a\x00b'; available: faults, line, nominal"),
        ("environment", "\x1b[2J", r"unknown env '\x1b[2J'; available: faults, line, nominal"),
        ("environment", "a\0b.yaml", r"a\x00b.yaml: is not a valid file name"),
        ("environment", "\ud800.yaml", r"\ud800.yaml: is not a valid file name"),
        ("environment", "a" * 100_000, "aaa...; available: faults, line, nominal"),
        ("environment", "a/" * 5000 + "b.yaml", "b.yaml: cannot be read"),
        ("sensors", HUGER, f"sensors: found {UNWRITTEN}; expected the name"),
        ("sensors", "\x1b[2J", r"unknown sensors '\x1b[2J'; available: ideal"),
        ("observation", HUGER, f"observation: found {UNWRITTEN}; expected"),
        ("reward", HUGER, f"reward: found {UNWRITTEN}; expected"),
        ("reward", {"k_y": 1, "k_F": HUGE}, "reward: found {'k_y': 1, 'k_F': 1000"),
        ("reward", np.array(5), "reward: found array(5); expected"),
        ("info", HUGER, f"info: found {UNWRITTEN}; expected"),
        ("info", Silent(), "info: found"),
        ("episode_s", 1.7e308, "episode_s: found 1.7e+308; expected a number less than or equal to 86400"),
        ("speed_kmh", HUGER, f"speed_kmh: found {UNWRITTEN}; expected a number from 30"),
        ("speed_kmh", Fraction(HUGE), "speed_kmh: found Fraction(1000"),
        ("speed_kmh", np.array([300.0]), "speed_kmh: found array([300.]); expected"),
        ("s\x1bped", 1, r"unexpected keyword argument 's\x1bped'"),
    ],
    ids=kind,
)
def test_keywords(keyword: str, value: Any, found: str) -> None:
    assert found in message_of(lambda: SaydEnv(**{keyword: value}).reset(seed=1))


@pytest.mark.parametrize(
    ("keyword", "value", "found"),
    [
        ("num_envs", HUGE, "num_envs: found 1000"),
        ("num_envs", 65537, "num_envs: found 65537; expected a whole number from 1 to 65536"),
        ("num_envs", HUGER, f"num_envs: found {UNWRITTEN}; expected"),
        ("num_threads", HUGER, f"num_threads: found {UNWRITTEN}; expected"),
        ("max_episode_steps", HUGE, "max_episode_steps: found 1000"),
        ("max_episode_steps", np.zeros(3), "max_episode_steps: found array([0., 0., 0.]); expected"),
        ("max_episode_steps", Silent(), "max_episode_steps: found a Silent too long to write; expected"),
        ("max_episode_steps", HUGER, f"max_episode_steps: found {UNWRITTEN}; expected"),
        ("autoreset_mode", HUGER, f"autoreset_mode: found {UNWRITTEN}; expected one of"),
        ("autoreset_mode", np.zeros(3), "autoreset_mode: found array([0., 0., 0.]); expected one of"),
    ],
    ids=kind,
)
def test_keywords_of_a_batch(keyword: str, value: Any, found: str) -> None:
    assert found in message_of(SaydVectorEnv, **{keyword: value})


@pytest.mark.parametrize(
    ("options", "found"),
    [
        *(
            ({name: value}, f"options: {name}: found ")
            for name in ("speed_kmh", "wear", "friction", "payload", "initial_current", "track_scale")
            for value in (HUGE, HUGER, Fraction(HUGE), np.array(0.5), 1j, b"1")
        ),
        ({"profile": HUGER}, f"options: profile: found {UNWRITTEN}; expected"),
        ({"track": HUGER}, f"options: track: found {UNWRITTEN}; expected"),
        ({"track": "\ud800.yaml"}, r"\ud800.yaml: is not a valid file name"),
        ({"track": "\x1b[2J"}, r"unknown track '\x1b[2J'; available: china"),
        ({"track": "a/" * 5000 + "b.yaml"}, "b.yaml: cannot be read"),
        ({"faults": np.array(5)}, "options: faults: found array(5); expected a list of faults"),
        ({"faults": RECURSIVE}, "options: faults.0: found [[...]]; expected keys and values"),
        ({"faults": b"stuck"}, "options: faults: found b'stuck'; expected a list of faults"),
        ({HUGER: 1}, f"options: unknown key {UNWRITTEN}; allowed"),
        (5, "options: found 5; expected keys and values"),
    ],
    ids=kind,
)
def test_options(options: Any, found: str) -> None:
    assert found in message_of(SaydEnv().reset, seed=1, options=options)
    assert found in message_of(SaydVectorEnv().reset, seed=1, options=options)


@pytest.mark.parametrize(
    "seed", [HUGE, HUGER, 2**63, -1, 1.5, b"a", "a", np.array(3), np.array([[3]]), {3}, True], ids=kind
)
def test_seeds(seed: Any) -> None:
    assert "seed: found" in message_of(SaydEnv().reset, seed=seed)
    assert "seed: found" in message_of(SaydVectorEnv().reset, seed=seed)
    assert "seed: found" in message_of(SaydVectorEnv().reset, seed=[seed])


@pytest.mark.parametrize(
    "mask", [HUGER, [1, 0], [True], [[True], [True, False]], np.array(True), "ab", b"ab"], ids=kind
)
def test_masks(mask: Any) -> None:
    vector = SaydVectorEnv(num_envs=2)
    found = message_of(vector.reset, seed=1, options={"reset_mask": mask})
    assert found.startswith("options: reset_mask: found ")
    assert found.endswith("expected a boolean for each of the 2 vehicles, one of them true")


@pytest.mark.parametrize(
    "actions",
    [
        [["1", "0"]],
        [[HUGE, 0.5]],
        [[-HUGER, 0.5]],
        [[Fraction(HUGE), 0.5]],
        [["a", "b"]],
        [[1j, 0.5]],
        None,
        [[0.5], [1]],
    ],
    ids=kind,
)
def test_actions(actions: Any, quick: str) -> None:
    vector = SaydVectorEnv(quick)
    vector.reset(seed=1)
    assert message_of(vector.step, actions).startswith("action: found ")


@pytest.mark.parametrize("name", [5, HUGER, None, b"mppt2", np.zeros(3), Silent()], ids=kind)
def test_names_of_controllers(name: Any) -> None:
    assert message_of(baselines.make, name, SaydEnv()).startswith("policy: found ")


@pytest.mark.parametrize("name", ["constant:0.3", "mppt2", "skyhook-onoff"], ids=kind)
def test_observations_of_controllers(name: str) -> None:
    env = SaydEnv()
    policy = baselines.make(name, env)
    for value, allowed in (
        (np.nan, "finite numbers"),
        (np.inf, "finite numbers"),
        (1e308, "numbers up to 3.4e+38"),
    ):
        observation = np.zeros(41)
        observation[40] = value
        expected = f"observation: found {value} for 'speed'; expected {allowed}"
        assert message_of(policy.predict, observation).endswith(expected)
    assert np.all(np.isfinite(policy.predict(np.full(41, 3.4e38))[0]))
    for other in (["a"] * 41, ["1"] * 41, [np.datetime64("now")] * 41, [1j] * 41, [HUGE] * 41, 5.0, None):
        assert "observation" in message_of(policy.predict, other)


def test_an_episode_beyond_the_measured_track_is_refused(tmp_path: Path) -> None:
    """Two seconds at 360 km/h behind a run-in of 500 m, on a file of 650 m whose ramps are even track."""
    rows = "\n".join(f"{x},{np.sin(x / 5):.6f}" for x in range(651))
    (tmp_path / "own.csv").write_text(f"x_m,alignment_mm\n{rows}\n", encoding="utf-8")
    settings = [f"track={tmp_path / 'own.csv'}", "track.irregularity.ramp=25.0"]
    SaydEnv(settings=settings, speed_kmh=360.0, episode_s=1.0).reset(seed=0)
    with pytest.raises(
        DataError, match=r"covers 0 to 650 m, .* judged from 4\d\d.* to 69\d.* m; give a long"
    ):
        SaydEnv(settings=settings, speed_kmh=360.0, episode_s=2.0).reset(seed=0)
