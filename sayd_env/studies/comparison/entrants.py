"""Who takes part in a comparison: controllers, and learned policies in groups of training seeds."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sayd_env import baselines
from sayd_env.agents import pretrained
from sayd_env.agents.policy_file import StoredPolicy, read_policy
from sayd_env.config import ConfigError, DataError
from sayd_env.runs.policies import LEARNED, PolicySpec, policy_spec

PAPER = ("mppt1", "mppt2", "skyhook-onoff", "skyhook-continuous")
"""The paper's controllers, as printed."""
REFERENCES = ("passive", "mppt2")
"""What all others are compared with."""
DEFAULT = ("passive", *PAPER, "mppt2-tuned", "constant-tuned")
"""Who takes part beside the ready policies if nobody is named."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
_BEST = "best.npz"  # in the folder of a training


@dataclass(frozen=True)
class Contestant:
    """A controller, or the policies that one way of learning came to with several training seeds."""

    name: str
    members: tuple[PolicySpec, ...]
    """One for each training seed; a controller is its only member."""

    @property
    def learned(self) -> bool:
        """Whether it was trained."""
        return self.members[0].stored is not None

    @property
    def titles(self) -> tuple[str, ...]:
        """How its members are called."""
        return tuple(member.title for member in self.members)


def contestants(names: Sequence[str] | None = None) -> list[Contestant]:
    """Read who takes part; the passive vehicle and MPPT2 always do.

    Parameters
    ----------
    names : sequence of str, optional
        Each is one of `baselines.NAMES`, ``constant:V``, a ready policy or all of an algorithm (``ppo``), the
        file of a learned policy, ``NAME=FILE+FILE...`` for the training seeds of one way of learning, or a
        folder of files, which become one group for each algorithm. A folder that a training has left stands
        for its best policy. By default the paper's and the tuned controllers and all ready policies.

    Raises
    ------
    ConfigError
        An unknown name, a missing file, a folder without policies, a name or a file that stands there twice.
    DataError
        A damaged file.
    """
    if names is None:
        chosen = [*DEFAULT, *pretrained.groups()]
    else:
        chosen = [*(name for name in REFERENCES if name not in names), *names]
    found = [contestant for text in chosen for contestant in _read(text.strip())]
    _check_different(found)
    return found


def provenance(policy: PolicySpec) -> dict[str, Any]:
    """Where a learned policy comes from: its file, and what that says of its training.

    Raises
    ------
    DataError
        The file has gone.
    """
    assert policy.stored is not None  # only learned policies come from somewhere
    made = policy.stored.description.made
    return {
        "name": policy.title,
        "file": Path(policy.stored.source).name,
        "sha256": file_digest(policy.stored),
        "algorithm": _algorithm(policy.stored),
        "seed": _training_seed(policy.stored),
        "steps": made.get("steps"),
        "seconds": made.get("seconds"),
        "training_J": made.get("J"),
        "environment_sha256": made.get("environment_sha256"),
        "git_commit": made.get("git_commit"),
        "git_modified": made.get("git_modified"),
    }


def file_digest(stored: StoredPolicy) -> str:
    """SHA-256 of a policy's file.

    Raises
    ------
    DataError
        The file has gone.
    """
    try:
        return hashlib.sha256(Path(stored.source).read_bytes()).hexdigest()
    except OSError as error:
        raise DataError(f"{stored.source}: cannot be read again ({error.strerror or error})") from None


def _read(text: str) -> list[Contestant]:
    name, equals, files = text.partition("=")
    if equals:
        return [_group(name.strip(), _files(files.split("+")))]
    ready = pretrained.groups()
    if text in ready:
        return [_group(text, ready[text])]
    if Path(text).is_dir():
        return _by_algorithm(_files([text]))
    spec = policy_spec(text)
    return [Contestant(spec.title, (spec,))]


def _files(texts: Iterable[str]) -> list[Path]:
    """Files of learned policies that texts name, those of folders in the order of their names."""
    found: list[Path] = []
    for text in texts:
        if not text.strip():  # would be the current directory
            raise ConfigError("policies 'NAME=FILE+FILE...': found an empty place; expected files or folders")
        path = Path(text.strip())
        if not path.is_dir():
            found.append(path)
            continue
        inside = [path / _BEST] if (path / _BEST).is_file() else sorted(path.glob(f"*{LEARNED}"))
        if not inside:
            raise ConfigError(f"{path}: holds no files of learned policies (*{LEARNED})")
        found += inside
    return found


def _by_algorithm(files: Sequence[Path]) -> list[Contestant]:
    groups: dict[str, list[Path]] = {}
    for file in files:
        algorithm = _algorithm(read_policy(file))
        if algorithm is None:
            raise ConfigError(
                f"{file}: does not say with which algorithm it was trained; give it a name: NAME={file}"
            )
        groups.setdefault(algorithm, []).append(file)
    return [_group(name, groups[name]) for name in sorted(groups)]


def _group(name: str, files: Sequence[Path]) -> Contestant:
    """Policies under one name, called by their training seeds where these are known and differ."""
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"policies '{name}=...': expected a name of letters, digits and _ . - before the equals sign"
        )
    if name in baselines.NAMES:  # it would be taken for that controller, the paper's perhaps
        raise ConfigError(f"policies '{name}=...': is the name of a controller; choose another one")
    policies = [read_policy(file) for file in files]
    seeds = [_training_seed(policy) for policy in policies]
    known = None not in seeds and len(set(seeds)) == len(seeds)
    numbered = [f"s{seed}" if known else f"{i}" for i, seed in enumerate(seeds)]
    members = [
        PolicySpec(f"{name}-{number}", stored=replace(policy, source=str(file)))
        for number, policy, file in zip(numbered, policies, files, strict=True)
    ]
    order = sorted(range(len(members)), key=lambda i: seeds[i] or 0) if known else range(len(members))
    return Contestant(name, tuple(members[i] for i in order))


def _check_different(found: Sequence[Contestant]) -> None:
    names, titles, files = set[str](), set[str](), dict[str, str]()
    for contestant in found:
        if contestant.name in names:
            raise ConfigError(f"policy '{contestant.name}' stands there twice")
        names.add(contestant.name)
        for member in contestant.members:
            if member.title in titles:
                raise ConfigError(f"policy '{member.title}' stands there twice")
            titles.add(member.title)
            if member.stored is not None:
                digest = file_digest(member.stored)
                if digest in files:
                    raise ConfigError(
                        f"{member.stored.source}: is the same policy as {files[digest]}; "
                        "a training seed counts once"
                    )
                files[digest] = member.stored.source


def _made_config(policy: StoredPolicy) -> dict[str, Any]:
    config = policy.description.made.get("config")
    return config if isinstance(config, dict) else {}


def _training_seed(policy: StoredPolicy) -> int | None:
    seed = _made_config(policy).get("seed")
    return seed if isinstance(seed, int) else None


def _algorithm(policy: StoredPolicy) -> str | None:
    learning = _made_config(policy).get("learning")
    algorithm = learning.get("algorithm") if isinstance(learning, dict) else None
    return algorithm if isinstance(algorithm, str) else None
