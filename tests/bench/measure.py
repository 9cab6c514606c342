"""One measurement of the checkout that stands first on the path, in a process of its own; prints JSON.

`check.py` runs this file with an earlier commit and with the working tree in turn. So it uses nothing but
what both have. Whatever compiles or fills caches comes before the clock starts.

    python tests/bench/measure.py NAME      prints {"value": ...}, and what else belongs to it
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

SPEED = 350.0 / 3.6
"""m/s, on worn wheels."""
BATCH = 64
"""Vehicles of a batch."""
CRITICAL = ["critical-speed", "--speeds", "300", "--seeds", "1", "--set", "assessment.length=600", "--json"]


def scenario(damper: str) -> Any:
    """The paper's vehicle on worn wheels with passive yaw dampers or eight SAYDs."""
    from sayd_env.config.scenario import load_scenario  # noqa: PLC0415 - each process loads what it needs

    return load_scenario("nominal", () if damper == "passive" else ("damper=sayd",))


def one_vehicle(damper: str) -> dict[str, float]:
    """Simulated seconds of one vehicle over seconds of processor time."""
    from sayd_env.physics.simulator import Simulator, VehicleModel  # noqa: PLC0415

    model = VehicleModel(scenario(damper))
    simulator, spans = Simulator(model, SPEED, seed=0), []
    simulator.advance(5000)  # it hunts
    for _ in range(5):
        begin = time.process_time()
        simulator.advance(2000)
        spans.append(time.process_time() - begin)
    return {"value": 2.0 / float(np.median(spans))}


def batch(damper: str) -> dict[str, float]:
    """Simulated seconds of all vehicles of a batch on one thread over seconds of processor time."""
    from sayd_env.physics.batch import BatchSimulator  # noqa: PLC0415
    from sayd_env.physics.simulator import Simulator, VehicleModel  # noqa: PLC0415

    model = VehicleModel(scenario(damper))
    vehicles, spans = BatchSimulator([Simulator(model, SPEED, seed=k) for k in range(BATCH)], 1), []
    vehicles.advance(1000)
    for _ in range(3):
        begin = time.process_time()
        vehicles.advance(500)
        spans.append(time.process_time() - begin)
    return {"value": 0.5 * BATCH / float(np.median(spans))}


def control_steps() -> dict[str, float]:
    """Control steps a second of a batch environment on two threads over one episode and one reset."""
    import gymnasium as gym  # noqa: PLC0415

    import sayd_env  # noqa: F401, PLC0415 - registers the environments

    env: Any = gym.make_vec(
        "SAYD/Nominal-v0", num_envs=BATCH, vectorization_mode="vector_entry_point", num_threads=2
    )
    env.reset(seed=0)
    actions = np.random.default_rng(0).random((2100, BATCH, 2), dtype=np.float32)
    for action in actions[:20]:
        env.step(action)
    ends, steps, begin = 0, 0, time.perf_counter()
    # From within one episode to the same place in the next: all steps of an episode, and its reset.
    for action in actions[20:]:
        _, _, terminated, truncated, _ = env.step(action)
        ends += int(np.count_nonzero(terminated | truncated))
        steps += 1
        if ends >= BATCH and steps >= 2000:
            break
    return {"value": BATCH * steps / (time.perf_counter() - begin), "ends": ends}


def single_control_steps() -> dict[str, float]:
    """Control steps a second of processor time of one environment, without resets."""
    import gymnasium as gym  # noqa: PLC0415

    import sayd_env  # noqa: F401, PLC0415

    env = gym.make("SAYD/Nominal-v0")
    actions, spans = np.random.default_rng(0).random((500, 2), dtype=np.float32), []
    for _ in range(4):
        env.reset(seed=1)
        begin = time.process_time()
        for action in actions:
            env.step(action)
        spans.append(time.process_time() - begin)
    return {"value": len(actions) / min(spans)}


def overhead() -> dict[str, float]:
    """What Python adds to the compiled call of a control step, us."""
    import gymnasium as gym  # noqa: PLC0415

    import sayd_env  # noqa: F401, PLC0415
    from sayd_env.studies.bench.environment import StepTimer  # noqa: PLC0415

    timer = StepTimer(gym.make("SAYD/Nominal-v0"), 1000)
    return {"value": min(timer.overhead() for _ in range(3))}


def reset() -> dict[str, float]:
    """Time of a reset of one environment in which everything is drawn, s."""
    import gymnasium as gym  # noqa: PLC0415

    import sayd_env  # noqa: F401, PLC0415

    env, spans = gym.make("SAYD/Randomized-v0"), []
    for seed in range(23):
        begin = time.process_time()
        env.reset(seed=seed)
        spans.append(time.process_time() - begin)
    return {"value": float(np.median(spans[3:]))}


def draw() -> dict[str, float]:
    """Time of drawing an episode with faults and of its scenario, s."""
    from sayd_env.config.environment import load_environment  # noqa: PLC0415
    from sayd_env.config.scenario import load_scenario  # noqa: PLC0415
    from sayd_env.envs.draw import draw_episode, episode_scenario  # noqa: PLC0415

    config, base, spans = load_environment("faults"), load_scenario("nominal", ("damper=sayd",)), []
    for k in range(50):
        begin = time.process_time()
        episode_scenario(base, draw_episode(config, 0, k))
        spans.append(time.process_time() - begin)
    return {"value": float(np.median(spans))}


def training(algorithm: str, strides: int) -> dict[str, float]:
    """Control steps of vehicles a second of a packaged training, and the environment's share of the time.

    Of PPO so many whole iterations, steps and updates as configured; of SAC so many steps of all vehicles,
    learning from the first. Resets count as often as over whole episodes.
    """
    import torch  # noqa: PLC0415

    from sayd_env.agents.config import load_train  # noqa: PLC0415
    from sayd_env.agents.learner import make_model  # noqa: PLC0415
    from sayd_env.agents.learning_env import make_learning_env  # noqa: PLC0415

    config: Any = load_train(algorithm, ["learning.learning_starts=0"] if algorithm == "sac" else [])
    torch.set_num_threads(config.torch_threads)
    env: Any = make_learning_env(config)[0]
    model, settings = make_model(config, env), config.environment
    spent, episode = {"step": 0.0, "reset": 0.0}, round(settings.episode_s / settings.control_period)

    def timed(name: str) -> Callable[..., Any]:
        function = getattr(env, name)

        def call(*arguments: Any) -> Any:
            begin = time.perf_counter()
            result = function(*arguments)
            spent[name] += time.perf_counter() - begin
            return result

        return call

    env.reset()  # compiles
    env.step(np.zeros((env.num_envs, *env.action_space.shape), np.float32))
    env.step, env.reset = timed("step"), timed("reset")
    calls = strides * (config.learning.n_steps if algorithm == "ppo" else 1)
    begin = time.perf_counter()
    model.learn(calls * env.num_envs, log_interval=None)
    elapsed = time.perf_counter() - begin
    # `learn` begins with a reset, which counts by what the steps hold beyond whole episodes.
    resets = spent["reset"] * (calls / episode - calls // episode)
    elapsed += resets - spent["reset"]
    return {"value": calls * settings.vehicles / elapsed, "share": (spent["step"] + resets) / elapsed}


def start(cache: str) -> dict[str, float]:
    """Wall time of `sayd critical-speed` with what is in a cache, s."""
    environment = os.environ | ({"SAYD_CACHE_DIR": cache} if cache else {})
    if not cache:  # nothing is compiled any more
        subprocess.run([sys.executable, "-m", "sayd_env", *CRITICAL], capture_output=True, check=True)
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "sayd_env", *CRITICAL], capture_output=True, check=True, env=environment
    )
    return {"value": time.perf_counter() - begin}


def first_start() -> dict[str, float]:
    """Wall time of `sayd critical-speed` with nothing compiled, s."""
    import tempfile  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="sayd-bench-") as folder:
        return start(str(Path(folder)))


def later_start() -> dict[str, float]:
    """Wall time of `sayd critical-speed` with everything compiled, s."""
    return start("")


def help_text() -> dict[str, float]:
    """Processor time of `sayd --help`, s."""
    spans = []
    for _ in range(3):
        before = os.times()
        subprocess.run([sys.executable, "-m", "sayd_env", "--help"], capture_output=True, check=True)
        after = os.times()
        spans.append(after.children_user + after.children_system)
        spans[-1] -= before.children_user + before.children_system
    return {"value": min(spans)}


def importing() -> dict[str, float]:
    """Time of `import sayd_env` behind Gymnasium, s."""
    import gymnasium  # noqa: F401, PLC0415

    begin = time.perf_counter()
    import sayd_env  # noqa: F401, PLC0415

    return {"value": time.perf_counter() - begin}


MEASUREMENTS: dict[str, Callable[[], dict[str, float]]] = {
    "passive-single": lambda: one_vehicle("passive"),
    "sayd-single": lambda: one_vehicle("sayd"),
    "passive-batch": lambda: batch("passive"),
    "sayd-batch": lambda: batch("sayd"),
    "control-steps": control_steps,
    "single-control-steps": single_control_steps,
    "overhead": overhead,
    "reset": reset,
    "draw": draw,
    "ppo": lambda: training("ppo", 1),
    "sac": lambda: training("sac", 60),
    "first-start": first_start,
    "later-start": later_start,
    "help": help_text,
    "import": importing,
}


if __name__ == "__main__":
    print(json.dumps(MEASUREMENTS[sys.argv[1]]()))
