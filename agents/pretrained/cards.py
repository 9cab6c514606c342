"""Where the ready policies come from, as their files tell it; run as a program it writes their page."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sayd_env.agents.policy_file import read_policy
from sayd_env.agents.pretrained import FOLDER, groups
from sayd_env.agents.pretrained.curves import PICTURE, draw
from sayd_env.agents.table import Table
from sayd_env.config import DataError
from sayd_env.config.palette import plain_matplotlib
from sayd_env.config.storage import write_file
from sayd_env.envs.registration import VERSION

README = "README.md"
SCORES = "scores.csv"
"""The table of that name that `sayd compare` has written."""
COLUMNS = ("name", "algorithm", "seed", "commit", "environment", "plant", "steps", "training", "J", "SHA-256")
"""Of a table of origins: what `Origin.cells` gives."""
_HEAD = """# Ready policies

Trained by `sayd train`, as the files themselves tell: each holds its whole configuration, the versions and
the command. `sayd evaluate --policies ppo-s3` runs one, without torch; `ppo` alone is the first training,
whichever is the best. J is the arithmetic mean over the scenarios of its evaluations while it learned: no
result of a comparison. `plant` has the first digits of the hash of environments, vehicle, track, dampers and
sensors, with all numbers.

`python -m sayd_env.agents.pretrained.cards` makes this page from the files, and the picture from the tables
beside them.
"""
_LIMITS = """
## Limits

- They were trained on one vehicle with tolerances, at 200 to 400 km/h, straight and on lines with curves, on
  wheels S1002CN, new to worn, the same shifted by 1 mm, and LMA, gauge 1,432 to 1,440 mm, friction 0.2 to
  0.5, one class of track at 0.35 to 0.9 of its level, and for MPPT2's weights of J (k_F = 0.5). Outside of
  that they are a guess; `sayd robustness` measures some of it.
- On new wheels below the speed of hunting the passive vehicle can be better (`worst / passive`).
- They have met no fault of a sensor, valve or damper in training. `safe:ppo` is the policy inside a monitor.
- They are solutions of a simulation whose semi-active damper is calibrated, and whose numbers nobody has
  measured; nothing here says how they would do on a train.
"""


@dataclass(frozen=True)
class Origin:
    """Where a policy comes from; None is what its file does not tell."""

    name: str
    algorithm: str
    seed: int
    """Of the training."""
    commit: str | None
    """Of the sources, with a plus if they had been changed."""
    steps: int | None
    """When it was written."""
    seconds: float | None
    """Of training until then."""
    J: float | None
    """Mean over the scenarios of its evaluations while it learned."""
    environment: str | None
    """In which it has learned."""
    plant: str | None
    """Hash of environment and scenario, with all numbers."""
    sha256: str
    """Of the file."""
    size: int
    """Of the file, bytes."""

    @property
    def short_commit(self) -> str:
        """Enough of the commit to find it."""
        return (self.commit or "-")[:12]

    def cells(self) -> tuple[str, ...]:
        """Return what a table shows, by `COLUMNS`."""
        return (
            self.name,
            self.algorithm,
            str(self.seed),
            self.short_commit,
            self.environment or "-",
            (self.plant or "-")[:12],
            "-" if self.steps is None else f"{self.steps:,}",
            "-" if self.seconds is None else f"{self.seconds / 60:.0f} min",
            "-" if self.J is None else f"{self.J:.4f}",
            self.sha256,
        )


def origin(path: Path) -> Origin:
    """Where a ready policy comes from.

    Parameters
    ----------
    path : Path
        One of `agents.pretrained.groups`.

    Raises
    ------
    ConfigError, DataError
        A file that cannot be read or is damaged, or that is another training than its name says.
    """
    policy, content = read_policy(path), path.read_bytes()
    algorithm, seed, made = policy.algorithm, policy.seed, policy.made
    if algorithm is None or seed is None or f"{algorithm}-s{seed}" != path.stem:
        raise DataError(f"{path}: holds the training '{algorithm}-s{seed}', another one than its name says")
    commit = made("git_commit")
    return Origin(
        name=path.stem,
        algorithm=algorithm,
        seed=seed,
        commit=f"{commit}+" if commit and made("git_modified") else commit,
        steps=made("steps"),
        seconds=made("seconds"),
        J=made("J"),
        environment=made("config", "environment", "name"),
        plant=made("environment_sha256"),
        sha256=hashlib.sha256(content).hexdigest(),
        size=len(content),
    )


def origins(folder: Path | None = None) -> list[Origin]:
    """Where all ready policies come from, in the order of `agents.pretrained.groups`.

    Raises
    ------
    ConfigError, DataError
        As `origin`.
    """
    return [origin(path) for files in groups(folder).values() for path in files]


def readme(folder: Path | None = None) -> str:
    """Text of the page about the ready policies.

    Raises
    ------
    ConfigError, DataError
        As `origin`.
    """
    rows = [each.cells() for each in origins(folder)]
    if not rows:
        return f"{_HEAD}\nThere are none for version {VERSION} of the environments yet.\n"
    return f"{_HEAD}\n![learning curves]({PICTURE})\n\n{_table(COLUMNS, rows)}{_scores(folder)}{_LIMITS}"


def _scores(folder: Path | None) -> str:
    """The scores of a comparison, if its table is beside the files: the environment's J on all conditions."""
    ends = ("geometric", "geometric_low", "geometric_high")
    numbers = ("force_weight", "training_seeds", "J", *ends, "worst_vs_passive")
    found = Table((folder or FOLDER) / SCORES, numbers=numbers, texts=("part", "policy", "filter")).rows
    if not found:
        return ""
    shown = [r for r in found if (r["part"], r["filter"], r["force_weight"]) == ("together", "online", 1.0)]
    rows = [
        (
            f"`{row['policy']}`",
            f"{row['training_seeds']}",
            "{:.3f} ({:.3f} to {:.3f})".format(*(row[end] for end in ends)),
            f"{row['J']:.4f}",
            f"{row['worst_vs_passive']:.2f}",
        )
        for row in sorted(shown, key=lambda row: row["geometric"])
    ]
    heads = ("policy", "trainings", "J / best constant of each condition", "mean J", "worst / passive")
    head = "## Scores\n\nOn held-out conditions, by `sayd compare`: 95 % intervals."
    return f"\n{head}\n\n{_table(heads, rows)}"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "".join(f"| {' | '.join(line)} |\n" for line in (heads, ["---"] * len(heads), *rows))


def picture() -> bytes:
    """Learning curves of the ready policies as a PNG file.

    Raises
    ------
    DataError
        A curve that is damaged.
    """
    stream = io.BytesIO()
    with plain_matplotlib():
        from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import, and only this program needs it

        figure = Figure(layout="constrained")
        draw(figure)
        figure.savefig(stream, format="png", dpi=110)
    return stream.getvalue()


if __name__ == "__main__":
    write_file(FOLDER / README, readme().encode())
    if groups():
        write_file(FOLDER / PICTURE, picture())
