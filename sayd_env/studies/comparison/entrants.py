"""Who takes part in a comparison: controllers, and learned policies in groups of training seeds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sayd_env import baselines
from sayd_env.agents import pretrained
from sayd_env.agents.policy_archive import file_digest
from sayd_env.agents.policy_file import NAME, StoredPolicy
from sayd_env.config import ConfigError
from sayd_env.runs.policies import LEARNED, PAPER, TUNED, ForeignReader, PolicySpec, policy_spec, read_learned

REFERENCES = ("passive", "mppt2")
"""What all others are compared with."""
DEFAULT = ("passive", *PAPER, *TUNED)
"""Who takes part beside the ready policies if nobody is named."""
_BEST = "best.npz"  # in the folder of a training


@dataclass(frozen=True)
class Entrant:
    """A controller, or the policies that one way of learning came to with several training seeds."""

    name: str
    members: tuple[PolicySpec, ...]
    """One for each training seed; a controller is its only member."""

    @property
    def learned(self) -> bool:
        """Whether it was trained."""
        return self.members[0].learned is not None

    @property
    def titles(self) -> tuple[str, ...]:
        """How its members are called."""
        return tuple(member.title for member in self.members)


def read_entrants(names: Sequence[str] | None = None, foreign: ForeignReader | None = None) -> list[Entrant]:
    """Read who takes part; the passive vehicle and MPPT2 always do.

    Parameters
    ----------
    names : sequence of str, optional
        Each is a policy as `policy_spec` reads it, a ready algorithm (``ppo``) for all of its training seeds,
        ``NAME=FILE+FILE...`` for the training seeds of one way of learning, or a folder of files, which
        become one group for each algorithm. A folder that a training has left stands for its best policy. By
        default the paper's and the tuned controllers and all ready policies.
    foreign : callable, optional
        What reads a file of Stable-Baselines3; without, it is refused.

    Raises
    ------
    ConfigError
        An unknown name, a missing file, a folder without policies, a duplicate name or file.
    DataError
        A damaged file.
    """
    chosen = list(names if names is not None else (*DEFAULT, *pretrained.groups()))
    chosen = [*(name for name in REFERENCES if name not in chosen), *chosen]
    found = [entrant for text in chosen for entrant in _read(text.strip(), foreign)]
    _refuse_duplicates(found)
    return found


def provenance(policy: PolicySpec) -> dict[str, Any]:
    """Where a learned policy comes from: its file, and what that says of its training.

    Raises
    ------
    ConfigError
        The file no longer exists.
    """
    stored = policy.learned
    assert stored is not None  # only learned policies come from somewhere
    made = stored.description.made
    return {
        "name": policy.title,
        "file": Path(stored.where).name,
        "sha256": file_digest(stored.where),
        "algorithm": stored.algorithm,
        "seed": stored.seed,
        **{name: made.get(name) for name in ("steps", "seconds")},
        "training_J": made.get("J"),
        **{name: made.get(name) for name in ("environment_sha256", "git_commit", "git_modified")},
    }


def _read(text: str, foreign: ForeignReader | None) -> list[Entrant]:
    name, equals, files = text.partition("=")
    if equals and not Path(text).exists():
        return [_group(name.strip(), [read_learned(file, foreign) for file in _files(files.split("+"))])]
    ready = pretrained.groups()
    if text in ready:
        return [_group(text, [read_learned(file) for file in ready[text]])]
    if Path(text).is_dir():
        return _by_algorithm([read_learned(file) for file in _files([text])])
    spec = policy_spec(text, foreign)
    return [Entrant(spec.title, (spec,))]


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


def _by_algorithm(policies: Iterable[StoredPolicy]) -> list[Entrant]:
    groups: dict[str, list[StoredPolicy]] = {}
    for policy in policies:
        if policy.algorithm is None:
            raise ConfigError(
                f"{policy.where}: does not say with which algorithm it was trained; give it a name: "
                f"NAME={policy.where}"
            )
        groups.setdefault(policy.algorithm, []).append(policy)
    return [_group(name, groups[name]) for name in sorted(groups)]


def _group(name: str, policies: Sequence[StoredPolicy]) -> Entrant:
    """Policies under one name, called by their training seeds where these are known and differ."""
    if not NAME.fullmatch(name):
        raise ConfigError(
            f"policies '{name}=...': expected a name of letters, digits and _ . - before the equals sign"
        )
    if name in baselines.NAMES:  # it would be taken for that controller, the paper's perhaps
        raise ConfigError(f"policies '{name}=...': is the name of a controller; choose another one")
    by_seed = {policy.seed: policy for policy in policies if policy.seed is not None}
    if len(by_seed) == len(policies):
        numbered = {f"s{seed}": by_seed[seed] for seed in sorted(by_seed)}
    else:
        numbered = {str(i): policy for i, policy in enumerate(policies)}
    return Entrant(name, tuple(PolicySpec(f"{name}-{k}", stored=policy) for k, policy in numbered.items()))


def _refuse_duplicates(found: Sequence[Entrant]) -> None:
    names, titles, files = set[str](), set[str](), dict[str, str]()
    for entrant in found:
        if entrant.name in names or titles & set(entrant.titles):
            raise ConfigError(f"policy '{entrant.name}': duplicate")
        names.add(entrant.name)
        titles.update(entrant.titles)
        for where in (member.learned.where for member in entrant.members if member.learned is not None):
            digest = file_digest(where)
            if digest in files:
                first = files[digest]
                raise ConfigError(f"{where}: is the same policy as {first}; a training seed counts once")
            files[digest] = where
