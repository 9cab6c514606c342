"""The machine that is measured."""

from __future__ import annotations

import platform
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numba


def machine() -> dict[str, Any]:
    """Processor, cores that this process may use, system and date."""
    return {
        "processor": _processor(),
        "cores": numba.config.NUMBA_NUM_THREADS,  # type: ignore[attr-defined] # made at run time
        "system": f"{platform.system()} {platform.machine()}",
        "date": datetime.now(UTC).date().isoformat(),
    }


def _processor() -> str:
    """Name of the processor: Linux tells it in a file alone."""
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
