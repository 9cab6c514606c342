"""What the compiled kernels compute is what Python computes from the same source.

Compiled code has its own rules for integers, divisions and memory, and some operations are written in LLVM's
instructions: a second way to the numbers. Whether Numba compiles is settled when it is imported, so this file
is a program as well, which writes its numbers; `make coverage` sees which lines of the kernels it reaches.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sayd_env
from sayd_env.config.scenario import load_scenario
from sayd_env.envs.single import SaydEnv
from sayd_env.physics.simulator import Simulator, VehicleModel

Numbers = dict[str, np.ndarray]

ENVIRONMENT = """
base: {base}
run_in: {run_in}
episode_s: 0.05
"""
LINE = {
    "rails": [None, "60e1"],
    "sections": [
        {"length": 36.0, "speed_kmh": 250.0, "gauge": 1.435, "friction": 0.4},
        {
            "length": 700.0,
            "speed_kmh": 265.0,
            "radius": 6000.0,
            "turn": "left",
            "cant": 0.08,
            "transition": 150.0,
        }
        | {"gauge": 1.437, "rail": 1.0, "friction": 0.3, "track": "china"},
    ],
}
"""On which everything changes within a second."""
VEHICLES = {
    "passive": (),
    "semi-active": ("damper=sayd-estimate", "damper.current=0.4", "wear=1"),
    "by Polach's law": ("contact.creep_law=polach", "track=german_low"),
    "by FASTSIM": ("contact.creep_law=fastsim",),
}
SCALES = {"acceleration": 9.81, "track_shift": 1e5, "damper_force": 1e3}
"""Gravity, an axle's load and a damper's force: rounding errors are shares of these, not of small signals."""
SHORT = ("assessment.run_in=200", "assessment.length=600")
COMMANDS = np.array([[0.3, 0.1], [0.9, 0.0], [0.2, 1.0]], dtype=np.float32)


def simulated() -> Numbers:
    """Samples of single vehicles."""
    found = {}
    for name, overrides in VEHICLES.items():
        simulator = Simulator(VehicleModel(load_scenario("estimates", [*SHORT, *overrides])), 80.0, seed=0)
        telemetry = simulator.advance(5)
        for quantity, scale in SCALES.items():
            found[f"{name} {quantity}"] = getattr(telemetry, quantity) / scale
    return found


def environments(folder: Path) -> Numbers:
    """Steps of environments: with faults, and along a line."""

    def quick(base: str, run_in: float) -> str:
        path = folder / f"{base}.yaml"
        path.write_text(ENVIRONMENT.format(base=base, run_in=run_in))
        return str(path)

    found: Numbers = {}
    for base, options in (("faults", {}), ("nominal", {"line": LINE})):
        env = SaydEnv(quick(base, 5.0))
        observations = [env.reset(seed=3, options=options)[0]]
        steps = [env.step(command) for command in COMMANDS]
        found[f"{base} observations"] = np.array([*observations, *(step[0] for step in steps)])
        found[f"{base} rewards"] = np.array([step[1] for step in steps])
    return found


def controlled(folder: Path) -> Numbers:
    """Commands of the controllers that have kernels of their own."""
    found = {}
    environment = str(folder / "nominal.yaml")
    for name in ("mppt1", "skyhook-continuous"):
        policy = sayd_env.load_policy(name, SaydEnv(environment))
        env = SaydEnv(environment, **policy.interface.keywords)
        observation, _ = env.reset(seed=5)
        state: Any = None
        commands = []
        for _ in range(3):
            action, state = policy.predict(observation, state)
            commands.append(action)
            observation, *_ = env.step(action)
        found[f"{name} commands"] = np.array(commands)
    return found


def numbers() -> Numbers:
    """All of them by name."""
    # Kernels divide as NumPy does, and say nothing.
    with tempfile.TemporaryDirectory() as name, np.errstate(all="ignore"):
        folder = Path(name)
        return simulated() | environments(folder) | controlled(folder)


@pytest.mark.compiled
@pytest.mark.slow
def test_python_and_compiled_code_agree(tmp_path: Path) -> None:
    """Functions of the mathematical library differ in their last bits, which contact amplifies a little."""
    file = tmp_path / "python.npz"
    uncompiled = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    # First what is compiled: Python alone would take hours for the tables that it leaves in the cache.
    compiled = numbers()
    subprocess.run([sys.executable, __file__, file], env=uncompiled, check=True)
    with np.load(file) as python:
        assert set(python) == set(compiled)
        for name, values in compiled.items():
            share = 1e-12 if name.split()[-1] in SCALES else 1e-9 * np.max(np.abs(values))
            np.testing.assert_allclose(python[name], values, rtol=0, atol=share, err_msg=name)


if __name__ == "__main__":
    np.savez(sys.argv[1], **numbers())  # type: ignore[arg-type] # names are not its options
