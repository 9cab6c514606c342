"""Arrays on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env.physics import array_cache


def test_what_python_makes_without_compilation_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last bits differ from those of compiled code: no other process may find it."""
    monkeypatch.setattr(array_cache, "cache_folder", lambda: tmp_path)
    for compiles, files in ((False, 0), (True, 1)):
        monkeypatch.setattr(array_cache, "COMPILES", compiles)
        found = array_cache.cached_array("ones", [b"ones"], 3, lambda: np.ones(3))
        assert found.tolist() == [1.0, 1.0, 1.0]
        assert len(list(tmp_path.glob("ones-*.npy"))) == files
