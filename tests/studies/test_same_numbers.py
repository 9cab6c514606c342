"""What commands print stays the same, to the bit.

This guards against change only: it does not show that any of the numbers is right.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import pytest

from sayd_env.cli import main
from sayd_env.config.software import versions

STORED = json.loads((Path(__file__).parent / "data" / "printed_before.json").read_text())
CASES = {case["command"][0]: case for case in STORED["results"]}
SAME_MACHINE = STORED["processor"] == llvm.get_host_cpu_name() and all(
    STORED["versions"][library] == versions()[library] for library in ("numpy", "scipy", "numba")
)
TOLERANCE = 0.0 if SAME_MACHINE else 1e-6
"""Relative: another processor or library rounds otherwise, and what runs on wheels makes more of it."""


def differences(stored: Any, found: Any, where: str, tolerance: float = 0.0) -> list[str]:
    """Places at which something stored is not found, or is found otherwise; additional keys are none."""
    if isinstance(stored, Mapping) and isinstance(found, Mapping):
        missing = [f"{where}.{key}: missing" for key in stored if key not in found]
        pairs = [(stored[key], found[key], f"{where}.{key}") for key in stored if key in found]
        return missing + [line for pair in pairs for line in differences(*pair, tolerance)]
    if isinstance(stored, list) and isinstance(found, list) and len(stored) == len(found):
        rows = enumerate(zip(stored, found, strict=True))
        return [line for i, pair in rows for line in differences(*pair, f"{where}[{i}]", tolerance)]
    if isinstance(stored, float) and isinstance(found, float) and tolerance:
        found = stored if found == pytest.approx(stored, rel=tolerance, abs=0.0) else found
    return [] if stored == found else [f"{where}: {stored!r} before, {found!r} now"]


@pytest.mark.parametrize("name", CASES)
def test_a_command_prints_what_it_printed_before(name: str, capsys: pytest.CaptureFixture[str]):
    assert main(CASES[name]["command"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert differences(CASES[name]["printed"], found, name, TOLERANCE) == []


def test_a_difference_is_found():
    stored = {"a": [1.0, {"b": None}], "c": "x"}
    assert differences(stored, {"a": [1.0, {"b": None, "new": 1}], "c": "x"}, "r") == []
    assert differences(stored, {"a": [1.1, {}], "c": "x"}, "r") == [
        "r.a[0]: 1.0 before, 1.1 now",
        "r.a[1].b: missing",
    ]
    assert differences(stored, {"a": [1.0], "c": "x"}, "r") != []
