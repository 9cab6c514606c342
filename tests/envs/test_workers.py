"""Worker processes: Gymnasium's `AsyncVectorEnv`, by each way of starting them.

``fork`` copies a process but not its threads: single environments, which need none, work all the same. (What
a batch does in such a copy is in `test_clients`.)
"""

from __future__ import annotations

import subprocess
import sys
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv

from sayd_env.envs.vector import SaydVectorEnv

FORK = """
import sys
from functools import partial
import gymnasium as gym, numpy as np, sayd_env
from gymnasium.vector import AsyncVectorEnv
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv
single, batch = SaydEnv(sys.argv[1]), SaydVectorEnv(sys.argv[1], num_envs=2)
batch.reset(seed=1)  # both kernels are loaded and have run before the fork, one of them on threads
single.reset(seed=1)
maker = partial(gym.make, "SAYD/Nominal-v1", environment=sys.argv[1])
workers = AsyncVectorEnv([maker] * 2, context="fork")
observation, _ = workers.reset(seed=1)
np.testing.assert_array_equal(observation[0], single.reset(seed=1)[0])
action = np.full((2, 2), 0.5, np.float32)
np.testing.assert_array_equal(workers.step(action)[0][0], single.step(action[0])[0])
workers.close()
print("done")
"""


@pytest.mark.parametrize("context", ["forkserver", "spawn"])
def test_workers_give_the_same_bits(context: str, quick: str) -> None:
    maker = partial(gym.make, "sayd_env:SAYD/Nominal-v1", environment=quick)
    batch = SaydVectorEnv(quick, num_envs=2)
    workers = AsyncVectorEnv([maker] * 2, context=context)
    try:
        np.testing.assert_array_equal(workers.reset(seed=1)[0], batch.reset(seed=1)[0])
        for actions in np.random.default_rng(0).random((22, 2, 2), dtype=np.float32):
            found, expected = workers.step(actions), batch.step(actions)
            for one, other in zip(found[:4], expected[:4], strict=True):
                np.testing.assert_array_equal(one, other)
    finally:
        workers.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="fork is the way of Linux")
def test_forked_workers_give_the_same_bits(quick: str) -> None:
    command = [sys.executable, "-c", FORK, quick]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert done.stdout.strip().endswith("done"), done.stderr
