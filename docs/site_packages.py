"""The packages as a wheel has them, made before MkDocs looks for their docstrings."""

from __future__ import annotations

import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = (("sayd_env", "."), ("agents", "agents"), ("baselines", "baselines"))
"""Where the sources of a package are, and where in `sayd_env` a wheel puts them."""


def on_startup(**_: object) -> None:
    """Copy them: a folder that is missing when the plugins begin would be left out of their search."""
    copy = ROOT / "build" / "packages" / "sayd_env"
    shutil.rmtree(copy, ignore_errors=True)
    for source, target in PACKAGES:
        for module in (ROOT / source).rglob("*.py"):
            place = copy / target / module.relative_to(ROOT / source)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(module, place)
