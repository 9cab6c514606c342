"""Worker processes: Gymnasium's `AsyncVectorEnv`, by each way of starting them.

``fork`` copies a process in which numba's threads may run already, and with GNU OpenMP that ends the worker:
it works as long as the parent has not stepped several vehicles with several threads. ``forkserver`` and
``spawn`` always work.
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
single = SaydEnv(sys.argv[1])
single.reset(seed=1)  # the serial kernel is loaded and has run before the fork
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
