"""Policies that come ready with the package: files named by algorithm and training seed, ``ppo-s0.npz``.

Only names are read here; `agents.policy_file.read_policy` reads a file. What each of them is and where it
comes from is in ``README.md`` beside them, which `agents.pretrained.cards` makes.
"""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

from sayd_env.config import ConfigError, nearest

FOLDER = Path(str(resources.files(__name__)))
"""Where the files are."""
_NAME = re.compile(r"(?P<algorithm>[a-z][a-z0-9]*)-s(?P<seed>0|[1-9][0-9]*)\.npz")


def groups(folder: Path | None = None) -> dict[str, tuple[Path, ...]]:
    """Files of the ready policies.

    Parameters
    ----------
    folder : Path, optional
        Where they are; the package's by default.

    Returns
    -------
    dict of tuple of Path
        By algorithm, in alphabetic order; its files in the order of their training seeds. Empty without
        files.
    """
    found: dict[str, dict[int, Path]] = {}
    for file in (folder or FOLDER).iterdir():
        if match := _NAME.fullmatch(file.name):
            found.setdefault(match["algorithm"], {})[int(match["seed"])] = file
    return {name: tuple(files[seed] for seed in sorted(files)) for name, files in sorted(found.items())}


def names(folder: Path | None = None) -> tuple[str, ...]:
    """Names that `path` knows: each algorithm, then each of its files.

    Parameters
    ----------
    folder : Path, optional
        Where the files are; the package's by default.
    """
    return tuple(
        name
        for algorithm, files in groups(folder).items()
        for name in (algorithm, *(file.stem for file in files))
    )


def path(name: str, folder: Path | None = None) -> Path:
    """File of a ready policy.

    Parameters
    ----------
    name : str
        ``ppo-s3`` is that training; ``ppo`` is the first one, of the lowest seed, whichever is the best.
    folder : Path, optional
        Where the files are; the package's by default.

    Raises
    ------
    ConfigError
        No such policy.
    """
    known = groups(folder)
    files = {file.stem: file for each in known.values() for file in each}
    files |= {algorithm: each[0] for algorithm, each in known.items()}
    if name not in files:
        listed = names(folder)
        expected = f"expected {', '.join(listed)}" if listed else "none come with this installation"
        raise ConfigError(f"ready policy '{name}': unknown{nearest(name, listed)}; {expected}")
    return files[name]
