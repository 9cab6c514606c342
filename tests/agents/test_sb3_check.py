"""The checker of Stable-Baselines3 on every id and every keyword that changes a space, warnings as errors.

Allowed are two warnings, each with its reason: see `ALLOWED`.
"""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium as gym
import pytest

SB3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

from stable_baselines3.common.env_checker import check_env  # noqa: E402

from sayd_env.envs.registration import IDS  # noqa: E402

ALLOWED = (
    # The action is the valve command itself, 0 to 1, as the paper and all controllers have it; training
    # rescales it to -1 to 1.
    "We recommend you to use a symmetric and normalized Box action space",
    # `history` is a matrix, rows of time. Stable-Baselines3 flattens it.
    "Your observation  has an unconventional shape",
)
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
    {"control_period": 0.001, "episode_s": 0.05},
    {"control_period": 0.05},
    {"sensors": "realistic"},
    {"info": "full"},
]


def check(env: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for message in ALLOWED:
            warnings.filterwarnings("ignore", message=message)
        check_env(env)


@pytest.mark.parametrize("name", IDS)
def test_ids_pass_the_checker(name: str) -> None:
    check(gym.make(name, episode_s=0.2))


@pytest.mark.parametrize("keywords", VARIANTS, ids=lambda k: ",".join(f"{a}={b}" for a, b in k.items()))
def test_keywords_pass_the_checker(keywords: dict[str, Any], quick: str) -> None:
    check(gym.make("SAYD/Nominal-v1", **{"environment": quick, "episode_s": 0.2} | keywords))


def test_everything_drawn_passes_the_checker(quick_faults: str) -> None:
    check(gym.make("SAYD/Faults-v1", environment=quick_faults, info="full", observation="history"))
