"""One measurement of the checkout that stands first on the path, in a process of its own; prints JSON.

`check.py` runs this file with an earlier commit and with the working tree in turn. How something is measured
is that of ``sayd bench`` in the tree that holds this file, whatever is measured: `_prepare` puts it in place,
with the names that an earlier commit has otherwise. Whatever compiles or fills caches comes before the clock
starts.

    python tests/bench/measure.py NAME      prints {"value": ...}, and what else belongs to it
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

TREE = Path(__file__).resolve().parents[2]
SPEED = 350.0 / 3.6
"""m/s, on worn wheels."""
BATCH = 64
"""Vehicles of a batch."""
CRITICAL = ["critical-speed", "--speeds", "300", "--seeds", "1", "--set", "assessment.length=600", "--json"]


def _prepare() -> None:
    """Take the measurements from the tree, the rest from the path, by today's names."""
    import sayd_env  # noqa: PLC0415 - each process loads what it needs
    import sayd_env.studies  # noqa: PLC0415

    for name in ("sayd_env.config.units", "sayd_env.studies.bench"):
        path = TREE / name.replace(".", "/")
        folder = [str(path)] if path.is_dir() else None
        file = path / "__init__.py" if folder else path.with_suffix(".py")
        spec = importlib.util.spec_from_file_location(name, file, submodule_search_locations=folder)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    agents = Path(sayd_env.__file__).parents[1] / "agents"
    if "from agents." in (agents / "learner.py").read_text():  # of its own at the top, before
        for name in ("agents", "agents.config", "agents.learner", "agents.learning_env"):
            sys.modules[f"sayd_env.{name}"] = importlib.import_module(name)
        settings = sys.modules["agents.config"].LearningEnvironmentConfig
        settings.vehicles = property(lambda self: self.lanes)


def one_vehicle(damper: int) -> dict[str, float]:
    """Simulated seconds of one vehicle over seconds of processor time."""
    return _factor(damper, lambda make: make(0), settling=5000, span=2.0, rounds=5)


def batch(damper: int) -> dict[str, float]:
    """Simulated seconds of all vehicles of a batch on one thread over seconds of processor time."""
    from sayd_env.physics.batch import BatchSimulator  # noqa: PLC0415

    def vehicles(make: Callable[[int], Any]) -> Any:
        return BatchSimulator([make(seed) for seed in range(BATCH)], 1)

    return _factor(damper, vehicles, settling=1000, span=0.5, rounds=3, count=BATCH)


def _factor(
    damper: int,
    vehicles: Callable[[Callable[[int], Any]], Any],
    *,
    settling: int,
    span: float,
    rounds: int,
    count: int = 1,
) -> dict[str, float]:
    """Median factor over real time of hunting vehicles with passive dampers (0) or eight SAYDs (1)."""
    from sayd_env.config.scenario import load_scenario  # noqa: PLC0415
    from sayd_env.physics.simulator import Simulator, VehicleModel  # noqa: PLC0415
    from sayd_env.studies.bench.vehicle import realtime_factor, with_dampers  # noqa: PLC0415

    model = VehicleModel(with_dampers(load_scenario("nominal"))[damper])
    running = vehicles(lambda seed: Simulator(model, SPEED, seed=seed))
    running.advance(settling)
    factors = [realtime_factor(running, span, count, time.process_time) for _ in range(rounds)]
    return {"value": float(np.median(factors))}


def line(kind: str) -> dict[str, float]:
    """Processor time of a step of eight vehicles on a line over that without one, of the same tree, in turn.

    Parameters
    ----------
    kind : str
        ``straight``, ``curve``, ``transition``: the train is on it all the time; or the name of a line, of
        which it runs the first minute, beside a train at its lowest speed, which decides a step's length.
    """
    from sayd_env.config.scenario import load_scenario  # noqa: PLC0415
    from sayd_env.physics.batch import BatchSimulator  # noqa: PLC0415
    from sayd_env.physics.simulator import Simulator, VehicleModel  # noqa: PLC0415
    from sayd_env.studies.bench.vehicle import realtime_factor, with_dampers  # noqa: PLC0415

    model = VehicleModel(with_dampers(load_scenario("nominal"))[1])
    table, rails, span = _line_table(kind, model.scenario.friction)
    speed = SPEED if rails is None else table.slowest
    pair = [
        BatchSimulator([Simulator(model, speed, seed, **way) for seed in range(8)], 1)
        for way in ({}, {"line": table, "rails": rails})
    ]
    for vehicles in pair:
        vehicles.advance(1000)
    factors = [[realtime_factor(each, span, 8, time.process_time) for each in pair] for _ in range(9)]
    return {"value": float(np.median([without / along for without, along in factors]))}


def _line_table(kind: str, friction: float) -> tuple[Any, Any, float]:
    """Table and rails of a line, and the time (s) of each of nine measurements on it."""
    from sayd_env.measured.lines import load_line  # noqa: PLC0415
    from sayd_env.physics.line import GRID_STEP, line_table, tabulated  # noqa: PLC0415

    if kind not in ("straight", "curve", "transition"):
        way = load_line(kind, speed=SPEED, friction=friction)
        return line_table(way, 200.0, 9e3, SPEED, friction), way.rails, 7.0
    s = GRID_STEP * np.arange(-20.0, 500.0)
    # A transition of 5 km, so that all of the measurement lies on it; a curve that has begun before.
    share = {"straight": 0.0 * s, "curve": 0.0 * s + 1.0, "transition": np.clip(s / 5e3, 0.0, 1.0)}[kind]
    square, even = np.full(len(s), SPEED**2), np.ones(len(s))
    found = tabulated(float(s[0]), share / 7e3, -0.08 * share, square, friction * even, 0.0 * even)
    return found, None, 0.5


def control_steps() -> dict[str, float]:
    """Control steps a second of a batch environment on two threads over whole episodes."""
    from gymnasium.utils.performance import benchmark_vector_step  # noqa: PLC0415

    from sayd_env.studies.bench.environment import make_batch, reset_time, whole_episodes  # noqa: PLC0415

    env = make_batch(2)
    env.reset(seed=0)
    window: Any = 0.5
    benchmark_vector_step(env, window)
    window = 2.0
    rate, resets = benchmark_vector_step(env, window), [reset_time(env) for _ in range(3)]
    _name_batch(env)
    return {"value": whole_episodes(rate, BATCH * env.batch.steps, float(np.median(resets)))}


def single_control_steps() -> dict[str, float]:
    """Control steps a second of one environment, without resets."""
    import gymnasium as gym  # noqa: PLC0415
    from gymnasium.utils.performance import benchmark_step  # noqa: PLC0415

    from sayd_env.studies.bench.environment import ID  # noqa: PLC0415

    env, window = gym.make(ID), 1.0
    return {"value": max(benchmark_step(env, window, seed=1) for _ in range(4))}  # type: ignore[arg-type]


def overhead() -> dict[str, float]:
    """What Python adds to the compiled call of a control step, us."""
    import gymnasium as gym  # noqa: PLC0415

    from sayd_env.studies.bench.environment import ID, step_times  # noqa: PLC0415

    env = gym.make(ID)
    _name_batch(env.unwrapped)
    return {"value": min(step_times(env, 1000)["overhead_us"] for _ in range(3))}


def _name_batch(env: Any) -> None:
    """Give the vehicles of a bare environment their name, which an earlier commit has otherwise."""
    if hasattr(type(env), "fleet"):
        type(env).batch = property(
            lambda self: SimpleNamespace(steps=self.fleet.steps, vehicles=self.fleet.lanes)
        )


def reset() -> dict[str, float]:
    """Time of a reset of one environment in which everything is drawn, s."""
    import gymnasium as gym  # noqa: PLC0415

    from sayd_env.studies.bench.environment import ID, reset_time  # noqa: PLC0415

    env = gym.make(ID.replace("Nominal", "Randomized"))
    env.reset(seed=0)
    return {"value": float(np.median([reset_time(env, time.process_time) for _ in range(23)][3:]))}


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


def _compile_loops() -> None:
    """Groups and vehicles alone have a loop each on one thread: a training may meet the second one late."""
    import gymnasium as gym  # noqa: PLC0415

    from sayd_env.studies.bench.environment import ID  # noqa: PLC0415

    for count in (1, 8):
        env = gym.make_vec(ID, count, vectorization_mode="vector_entry_point", num_threads=1)
        env.reset(seed=0)
        env.step(env.action_space.sample())


def training(algorithm: str, strides: int) -> dict[str, float]:
    """Control steps of vehicles a second of a packaged training, and the environment's share of the time.

    Of PPO so many whole iterations, steps and updates as configured; of SAC so many steps of all vehicles,
    learning from the first.
    """
    from sayd_env.agents.config import load_train  # noqa: PLC0415
    from sayd_env.studies.bench.training import make_learner  # noqa: PLC0415

    config: Any = load_train(algorithm, ["learning.learning_starts=0"] if algorithm == "sac" else [])
    learner = make_learner(config)
    _compile_loops()
    learner.env.reset()
    learner.env.step(np.zeros((learner.env.num_envs, *learner.env.action_space.shape), np.float32))
    calls = strides * (config.learning.n_steps if algorithm == "ppo" else 1) * getattr(learner, "hold", 1)
    found = learner.rate(calls * learner.vehicles, config.torch_threads, "value")
    return {"value": found["value"], "share": found["value_share"]}


def first_start() -> dict[str, float]:
    """Wall time of `sayd critical-speed` with nothing compiled, s."""
    from sayd_env.studies.bench.start import timed_start  # noqa: PLC0415

    with tempfile.TemporaryDirectory(prefix="sayd-bench-") as folder:
        return {"value": timed_start(CRITICAL, Path(folder))[0]}


def later_start() -> dict[str, float]:
    """Wall time of `sayd critical-speed` with everything compiled, s."""
    from sayd_env.studies.bench.start import timed_start  # noqa: PLC0415

    return {"value": [timed_start(CRITICAL, None)[0] for _ in range(2)][1]}


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
    "passive-single": lambda: one_vehicle(0),
    "sayd-single": lambda: one_vehicle(1),
    "passive-batch": lambda: batch(0),
    "sayd-batch": lambda: batch(1),
    "line-straight": lambda: line("straight"),
    "line-curve": lambda: line("curve"),
    "line-transition": lambda: line("transition"),
    "line-highspeed": lambda: line("highspeed"),
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
    if sys.argv[1] != "import":
        _prepare()
    print(json.dumps(MEASUREMENTS[sys.argv[1]]()))
