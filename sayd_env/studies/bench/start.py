"""Measure starts of the program: time and memory with nothing compiled yet and with everything."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from sayd_env.config import StudyError
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.studies.bench.spread import Effort, Measurement, quantities

# What `sayd` does, in a process of its own, which tells its peak memory (kB) at the end where it can. The
# usage that is reported to a parent counts the parent's own memory, too, since a process begins as its copy.
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
    scenario: Scenario, speed: float, effort: Effort, did: Callable[[str], None]
) -> tuple[dict[str, Measurement], dict[str, float] | None]:
    """Time and memory (MB; None if unknown) of ``first`` and ``later`` starts of a short evaluation."""
    results: dict[str, list[tuple[float, float]]] = {"first": [], "later": []}
    with tempfile.TemporaryDirectory(prefix="sayd-bench-") as folder:
        config = Path(folder) / "scenario.yaml"
        config.write_text(json.dumps(scenario.content()))
        arguments = ["evaluate", "--config", str(config), *_SHORT, "--speeds", f"{speed * KMH:.6g}"]
        starts = [("first", k) for k in range(effort.first_starts)] + [("later", 0)] * effort.later_starts
        for name, k in starts:
            results[name].append(timed_start(arguments, Path(folder) / f"cache-{k}"))
            did(f"{name} start")
    seconds = {name: [s for s, _ in pairs] for name, pairs in results.items()}
    memory = {name: float(np.median([peak for _, peak in pairs])) for name, pairs in results.items()}
    known = all(np.isfinite(list(memory.values())))
    return quantities(seconds, {name: f"{name} start" for name in results}, "s"), memory if known else None


def timed_start(arguments: Sequence[str], cache: Path | None) -> tuple[float, float]:
    """Wall time (s) and peak memory (MB, NaN if unknown) of ``sayd`` in a process of its own.

    Parameters
    ----------
    arguments : sequence of str
        Of ``sayd``.
    cache : Path or None
        Holds what is compiled; None for this process's own.

    Raises
    ------
    StudyError
        It fails.
    """
    environment = os.environ | ({} if cache is None else {"SAYD_CACHE_DIR": str(cache)})
    command = [sys.executable, "-c", _PROGRAM + _PEAK, *arguments]
    begin = time.perf_counter()
    process = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    elapsed = time.perf_counter() - begin
    last = (process.stderr.strip().splitlines() or ["no message"])[-1]
    if process.returncode != 0:
        raise StudyError(f"a start of sayd failed: {last}")
    return elapsed, 1.024e-3 * float(last) if last.isdecimal() else float("nan")
