"""Measure starts of the program: time and memory with nothing compiled yet and with everything."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from sayd_env.config import StudyError
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.studies.bench.spread import Spread

# What `sayd` does, in a process of its own, which tells its peak memory (kB) at the end where it can. The
# usage that a parent is told counts the parent's own memory, too, since a process begins as its copy.
_PROGRAM = "from sayd_env.cli import main; status = main()"
_PEAK = """
import sys
from pathlib import Path
about = Path("/proc/self/status")
if status == 0 and about.exists():
    print(about.read_text().partition("VmHWM:")[2].split()[0], file=sys.stderr)
sys.exit(status)
"""
_SHORT = ("--seeds", "1", "--json", "--set", "assessment.run_in=0", "--set", "assessment.length=1000")


def measure_starts(
    scenario: Scenario, speed: float, first: int, later: int, did: Callable[[str], None]
) -> tuple[dict[str, Spread], dict[str, float] | None]:
    """Time and memory of a short ``sayd evaluate``, with nothing compiled yet and with everything."""
    results: dict[str, list[tuple[float, float]]] = {"first": [], "later": []}
    with tempfile.TemporaryDirectory(prefix="sayd-bench-") as folder:
        config = Path(folder) / "scenario.yaml"
        config.write_text(json.dumps(scenario.model_dump(mode="json")))
        command = [sys.executable, "-c", _PROGRAM + _PEAK, "evaluate", "--config", str(config), *_SHORT]
        command += ["--speeds", f"{speed * KMH:.6g}"]
        for k in range(first):
            results["first"].append(_timed(command, Path(folder) / f"cache-{k}"))
            did("first start")
        for _ in range(later):
            results["later"].append(_timed(command, Path(folder) / "cache-0"))
            did("later start")
    startup = {name: Spread.of([seconds for seconds, _ in pairs]) for name, pairs in results.items()}
    memory = {name: float(np.median([peak for _, peak in pairs])) for name, pairs in results.items()}
    return startup, memory if all(np.isfinite(list(memory.values()))) else None


def _timed(command: list[str], cache: Path) -> tuple[float, float]:
    """Wall time (s) and peak memory (MB, NaN if unknown) of a process."""
    environment = os.environ | {"SAYD_CACHE_DIR": str(cache)}
    begin = time.perf_counter()
    process = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    elapsed = time.perf_counter() - begin
    last = (process.stderr.strip().splitlines() or ["no message"])[-1]
    if process.returncode != 0:
        raise StudyError(f"a start of sayd failed: {last}")
    return elapsed, 1.024e-3 * float(last) if last.isdecimal() else float("nan")
