"""Compile what most tests need, once: parallel test processes then find it instead of racing for it."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import gymnasium as gym
import numba

import sayd_env  # noqa: F401 - registers the environments
from sayd_env.config.scenario import load_scenario
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.formation import FEWEST
from sayd_env.physics.simulator import Simulator, VehicleModel

COUNTS = (1, FEWEST)
"""Vehicles alone, and a group of them."""
THREADS = sorted({1, min(2, numba.config.NUMBA_NUM_THREADS)})


def simulators() -> None:
    """One vehicle, and several on one thread and on two."""
    model = VehicleModel(load_scenario())
    for threads in THREADS:
        for count in COUNTS:
            BatchSimulator([Simulator(model, 80.0, seed) for seed in range(count)], threads).advance(1)
    Simulator(model, 80.0, seed=0).advance(1)


def environments() -> None:
    """The control loop of vehicles on one thread and on two."""
    for threads in THREADS:
        for count in COUNTS:
            env = gym.make_vec(
                "SAYD/Nominal-v1",
                num_envs=count,
                vectorization_mode="vector_entry_point",
                num_threads=threads,
            )
            env.reset(seed=0)
            env.step(env.action_space.sample())


if __name__ == "__main__":
    with ProcessPoolExecutor(2) as pool:
        for done in [pool.submit(simulators), pool.submit(environments)]:
            done.result()
