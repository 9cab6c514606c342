"""Is the working tree as fast as it has to be beside an earlier commit? Both measured in turn, same machine.

    make bench-check [BASE=commit] [BENCH_OPTIONS="--only sayd-batch,ppo --rounds 5 --json"]

Each measurement is a process of its own (`measure.py`), with the checkout first on its path, the same
interpreter and packages, and a cache of its own for what is compiled. Base and tree take turns, so that what
else happens on the machine meets both. Reported are medians over the rounds; the exit status is 1 if one of
them misses what is wanted, 2 if something cannot be measured.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tarfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from io import BytesIO
from math import nan
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SCRATCH = ROOT / "build" / "bench-check"
"""Holds the base's checkout and both caches of compiled code."""
MEASURE = Path(__file__).with_name("measure.py")
BASE, TREE = "base", "tree"
SMALL_SHARE = 0.25
"""Share of the environment in a training's time below which the learner alone decides its speed."""


class Failure(Exception):
    """Something cannot be measured; the message says what."""


@dataclass(frozen=True)
class Wanted:
    """A quantity and what is asked of it."""

    name: str
    """In `measure.MEASUREMENTS`."""
    what: str
    unit: str
    ratio: float | None = None
    """How many times as fast as the base the tree has to be at least."""
    limit: float | None = None
    """Least rate, or longest time, of the tree itself."""
    is_time: bool = False
    """Less is better."""
    or_small_share: bool = False
    """Enough, too, if the environment takes less than `SMALL_SHARE` of the time."""
    rounds: int | None = None
    """At most so many rounds."""
    threads: int = 1
    alone: bool = False
    """Of the tree alone, which compares two things of its own: an earlier commit may have neither."""

    @property
    def in_words(self) -> str:
        """What is wanted, in words."""
        words = [] if self.ratio is None else [f"x {self.ratio:.3g}"]
        if self.or_small_share:
            words.append(f"or share < {SMALL_SHARE:.0%}")
        if self.limit is not None:
            words.append(f"{'<' if self.is_time else '>'} {self.limit:g}")
        return ", ".join(words)


WANTED = (
    Wanted("passive-single", "one vehicle, passive", "x real time, one core", 1.3, 150.0),
    Wanted("sayd-single", "one vehicle, 8 SAYDs", "x real time, one core", 1.7, 100.0),
    Wanted("passive-batch", "batch of 64, passive", "x real time, one core", 2.0),
    Wanted("sayd-batch", "batch of 64, 8 SAYDs", "x real time, one core", 2.5, 400.0),
    Wanted("control-steps", "64 environments, whole episodes", "steps/s, two threads", 2.0, 15e3, threads=2),
    Wanted("single-control-steps", "one environment, without resets", "steps/s, one core", None, 4e3),
    Wanted("line-straight", "straight line", "x a step without one", None, 1.05, is_time=True, alone=True),
    Wanted("line-curve", "line, steady curve", "x a step without one", None, 1.15, is_time=True, alone=True),
    Wanted(
        "line-transition", "line, transition", "x a step without one", None, 1.15, is_time=True, alone=True
    ),
    Wanted(
        "line-highspeed", "line 'highspeed'", "x a step without one", None, 1.15, is_time=True, alone=True
    ),
    Wanted("overhead", "Python around a control step", "us", None, 30.0, is_time=True),
    Wanted("reset", "randomised reset", "s", 3.0, is_time=True),
    Wanted("draw", "draw of an episode", "s", None, 5e-3, is_time=True),
    Wanted("ppo", "PPO end to end, one iteration", "steps/s", 2.0),
    Wanted("sac", "SAC end to end", "steps/s", 2.0, or_small_share=True),
    Wanted("first-start", "first start of critical-speed", "s", 1.0 / 1.7, 60.0, is_time=True, rounds=2),
    Wanted("later-start", "later start of critical-speed", "s", 1.0, 3.0, is_time=True),
    Wanted("help", "sayd --help", "s of the processor", None, 0.5, is_time=True),
    Wanted("import", "import behind Gymnasium", "s", None, 0.05, is_time=True),
)


@dataclass
class Row:
    """What was measured of a quantity."""

    wanted: Wanted
    values: dict[str, list[float]] = field(default_factory=lambda: {BASE: [], TREE: []})
    shares: list[float] = field(default_factory=list)
    """The environment's share in the tree's training time."""

    def add(self, side: str, found: dict[str, float]) -> None:
        """Take a measurement."""
        self.values[side].append(found["value"])
        if side == TREE and "share" in found:
            self.shares.append(found["share"])

    @property
    def ratio(self) -> float:
        """How many times as fast as the base the tree is, by the medians; NaN without a base."""
        if self.wanted.alone:
            return nan
        base, tree = median(self.values[BASE]), median(self.values[TREE])
        return base / tree if self.wanted.is_time else tree / base

    @property
    def ok(self) -> bool:
        """Whether all is as wanted."""
        wanted, tree = self.wanted, median(self.values[TREE])
        fast = wanted.ratio is None or self.ratio >= wanted.ratio
        if wanted.or_small_share and self.shares:
            fast = fast or median(self.shares) < SMALL_SHARE
        if wanted.limit is None:
            return fast
        return fast and (tree < wanted.limit if wanted.is_time else tree > wanted.limit)

    def as_dict(self) -> dict[str, Any]:
        """All of it."""
        spreads = {
            side: {"median": median(v), "minimum": min(v), "maximum": max(v), "values": v}
            for side, v in self.values.items()
            if v
        }
        share = {"environment_share": median(self.shares)} if self.shares else {}
        return asdict(self.wanted) | spreads | share | self._compared() | {"ok": self.ok}

    def _compared(self) -> dict[str, float | None]:
        return {"ratio": None if self.wanted.alone else self.ratio}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and say whether all is as wanted."""
    options = _options(arguments)
    try:
        base = checkout(options.base)
        rows = measure_all(base, _chosen(options.only), options.rounds)
    except Failure as failure:
        print(f"bench-check: {failure}", file=sys.stderr)
        return 2
    if options.json:
        print(json.dumps({"base": base.name, "rows": [row.as_dict() for row in rows]}, indent=1))
    else:
        print_table(base.name, rows)
    return 0 if all(row.ok for row in rows) else 1


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make bench-check", description=__doc__)
    parser.add_argument("--base", default="7a16f1b", help="commit to compare with")
    parser.add_argument("--only", default="", help="names, separated by commas: " + ", ".join(names()))
    parser.add_argument("--rounds", type=_count, default=3, help="measurements of each side")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    return parser.parse_args(arguments)


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"found '{text}'; expected a whole number from 1 on")
    return int(text)


def names() -> list[str]:
    """Names of all quantities."""
    return [wanted.name for wanted in WANTED]


def _chosen(only: str) -> list[Wanted]:
    asked = [name for name in only.split(",") if name]
    for name in asked:
        if name not in names():
            raise Failure(f"--only: unknown '{name}'; expected some of {', '.join(names())}")
    return [wanted for wanted in WANTED if not asked or wanted.name in asked]


def checkout(commit: str) -> Path:
    """Files of a commit in a folder of its own, named by its hash."""
    sha = _git("rev-parse", "--verify", "--quiet", f"{commit}^{{commit}}").decode().strip()[:12]
    folder = SCRATCH / sha
    if not folder.exists():
        part = folder.with_suffix(".part")
        with tarfile.open(fileobj=BytesIO(_git("archive", sha))) as archive:
            archive.extractall(part, filter="data")
        part.rename(folder)
    return folder


def _git(*arguments: str) -> bytes:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, check=False)
    if done.returncode:
        message = done.stderr.decode().strip() or "not a commit of this checkout"
        raise Failure(f"git {' '.join(arguments)}: {message}")
    return done.stdout


def measure_all(base: Path, wanted: Sequence[Wanted], rounds: int) -> list[Row]:
    """Measure base and tree in turn, round after round; the side that begins changes."""
    rows, begin = [Row(each) for each in wanted], time.monotonic()
    for k in range(rounds):
        for row in rows:
            if row.wanted.rounds is not None and k >= row.wanted.rounds:
                continue
            for side in (BASE, TREE) if k % 2 == 0 else (TREE, BASE):
                if row.wanted.alone and side == BASE:
                    continue
                found = measure(row.wanted, base if side == BASE else ROOT)
                row.add(side, found)
                _report(time.monotonic() - begin, f"round {k + 1} of {rounds}", row.wanted, side, found)
    return rows


def _report(seconds: float, place: str, wanted: Wanted, side: str, found: dict[str, float]) -> None:
    words = f"{wanted.what}, {side}: {found['value']:.4g} {wanted.unit}"
    print(f"[{seconds:4.0f} s] {place}, {words}", file=sys.stderr, flush=True)


def measure(wanted: Wanted, root: Path) -> dict[str, float]:
    """One measurement of a checkout."""
    environment = os.environ | {
        "PYTHONPATH": str(root),
        "SAYD_CACHE_DIR": str(SCRATCH / f"cache-{'tree' if root == ROOT else root.name}"),
        "NUMBA_NUM_THREADS": str(wanted.threads),
    }
    command = [sys.executable, str(MEASURE), wanted.name]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=SCRATCH)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise Failure(f"{wanted.name} of {root}: {last}")
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def print_table(base: str, rows: Sequence[Row]) -> None:
    """Print what was measured and what is wanted."""
    from rich.console import Console  # noqa: PLC0415 - JSON needs none of it
    from rich.table import Table  # noqa: PLC0415

    table = Table(
        title=f"working tree beside {base}: medians of {max(len(r.values[TREE]) for r in rows)} rounds"
    )
    for name in ("what", "unit", "base", "tree", "ratio", "wanted", "ok"):
        table.add_column(name, justify="right" if name in {"base", "tree", "ratio"} else "left")
    for row in rows:
        share = f" (share {median(row.shares):.0%})" if row.shares else ""
        table.add_row(
            row.wanted.what + share,
            row.wanted.unit,
            "-" if row.wanted.alone else f"{median(row.values[BASE]):.4g}",
            f"{median(row.values[TREE]):.4g}",
            "-" if row.wanted.alone else f"{row.ratio:.2f}",
            row.wanted.in_words,
            "yes" if row.ok else "NO",
        )
    Console(width=None if sys.stdout.isatty() else 140).print(table)


if __name__ == "__main__":
    sys.exit(main())
