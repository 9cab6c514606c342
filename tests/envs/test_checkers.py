"""Gymnasium's own checker on every id and every keyword, pictures included, warnings as errors.

Nothing is on the list of allowed warnings.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import pytest
from gymnasium.utils.env_checker import check_env

from sayd_env.envs.registration import IDS

pytest.importorskip("pygame")

VARIANTS: list[dict[str, Any]] = [
    {},
    {"damper": "passive"},
    {"valves": "damper"},
    {"valves": "vehicle"},
    {"observation": "history"},
    {"observation": "history", "history": 2},
    {"observation": "features"},
    {"observation": "features", "damper": "passive"},
    {"reward": "mppt1"},
    {"reward": (1.0, 2.0)},
    {"control_period": 0.001, "episode_s": 0.05},
    {"control_period": 0.02},
    {"control_period": 0.05},
    {"sensors": "realistic"},
    {"speed_kmh": 250.0},
    {"info": "full"},
    {"info": "full", "damper": "passive"},
    {"settings": ("friction=0.3",)},
]


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.mark.parametrize("name", IDS)
def test_ids_pass_the_checker(name: str) -> None:
    check_env(gym.make(name, episode_s=0.2).unwrapped)


@pytest.mark.parametrize("keywords", VARIANTS, ids=lambda k: ",".join(f"{a}={b}" for a, b in k.items()))
def test_keywords_pass_the_checker(keywords: dict[str, Any], quick: str) -> None:
    env = gym.make("SAYD/Nominal-v1", **{"environment": quick, "episode_s": 0.2} | keywords)
    drawn = keywords.keys() <= {"damper", "info"}  # what changes the picture
    check_env(env.unwrapped, skip_render_check=not drawn)


def test_everything_drawn_passes_the_checker(quick_faults: str) -> None:
    env = gym.make("SAYD/Faults-v1", environment=quick_faults, info="full", observation="history")
    check_env(env.unwrapped)
