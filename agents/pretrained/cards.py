"""Where the ready policies come from, as their files tell it; run as a program it writes their page."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path

from sayd_env.agents.policy_file import read_policy
from sayd_env.agents.pretrained import FOLDER, groups
from sayd_env.agents.pretrained.curves import PICTURE, draw
from sayd_env.config import DataError
from sayd_env.config.palette import plain_matplotlib
from sayd_env.config.storage import write_file
from sayd_env.envs.registration import VERSION

README = "README.md"
COLUMNS = ("name", "algorithm", "seed", "commit", "environment", "steps", "training", "J", "SHA-256")
"""Of a table of origins: what `Origin.cells` gives."""
_HEAD = """# Ready policies

Trained by `sayd train`, as the files themselves tell: each holds its whole configuration, the versions and
the command. `sayd evaluate --policies ppo-s3` runs one, without torch; `ppo` alone is the first training,
whichever is the best. J is the mean over the scenarios of its evaluations while it learned: no result of
a comparison.

`python -m sayd_env.agents.pretrained.cards` makes this page from the files, and the picture from the tables
beside them.
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
    lines = [COLUMNS, ("---",) * len(COLUMNS), *rows]
    table = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    return f"{_HEAD}\n![learning curves]({PICTURE})\n\n{table}"


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
