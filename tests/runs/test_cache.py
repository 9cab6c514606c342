"""Finished runs on the disk: found again, and only where every input is the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.config import ConfigError, Model
from sayd_env.runs import cache as checkpoint
from sayd_env.runs.cache import RunStore, fingerprint
from sayd_env.runs.controlled import ControlledRun


class Inputs(Model):
    friction: float = 0.4


@dataclass(frozen=True)
class Toy:
    speed: float
    seed: int
    policy: str
    values: np.ndarray
    command: np.ndarray


TOY = Toy(1 / 3, 7, "mppt1 µ", np.linspace(0, 1, 5), np.eye(2, dtype=np.float32))


@pytest.fixture
def store(tmp_path: Path) -> RunStore[Toy]:
    return RunStore(tmp_path, "toys", Toy, Inputs())


def only_file(folder: Path) -> Path:
    (path,) = folder.glob("*/*.npz")
    return path


def test_a_run_comes_back_bit_for_bit(store: RunStore[Toy], tmp_path: Path):
    store.put("a", TOY)
    found = RunStore(tmp_path, "toys", Toy, Inputs()).get("a")
    assert found is not None
    assert (found.speed, found.seed, found.policy) == (TOY.speed, TOY.seed, TOY.policy)
    assert [type(x) for x in (found.speed, found.seed, found.policy)] == [float, int, str]
    assert (found.values == TOY.values).all()
    assert (found.command == TOY.command).all()
    assert found.command.dtype == np.float32


def test_a_controlled_run_comes_back(controlled_run: Callable[..., ControlledRun], tmp_path: Path):
    run = controlled_run("skyhook-onoff", 350, 3)
    RunStore(tmp_path, "skyhook", ControlledRun, Inputs(), {"closed": 0.0}).put("350_kmh_seed_3", run)
    found = RunStore(tmp_path, "skyhook", ControlledRun, Inputs(), {"closed": 0.0}).get("350_kmh_seed_3")
    assert found is not None
    assert same(found, run)
    assert found.command.dtype == np.float32


def test_the_second_call_does_no_work(store: RunStore[Toy]):
    calls = []

    def compute() -> Toy:
        calls.append(1)
        return TOY

    first = store.remembered("a", compute)
    assert store.reused == 0
    second = store.remembered("a", compute)
    assert (len(calls), store.reused) == (1, 1)
    assert (first.values == second.values).all()
    store.remembered("b", compute)
    assert len(calls) == 2


def test_a_work_that_fails_leaves_nothing(store: RunStore[Toy], tmp_path: Path):
    def interrupted() -> Toy:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.remembered("a", interrupted)
    assert list(tmp_path.glob("*/*")) == []


def test_other_inputs_find_nothing(store: RunStore[Toy], tmp_path: Path):
    store.put("a", TOY)
    assert RunStore(tmp_path, "toys", Toy, Inputs(friction=0.3)).get("a") is None
    assert RunStore(tmp_path, "toys", Toy, Inputs(), {"k_y": 1.0}).get("a") is None
    assert RunStore(tmp_path, "others", Toy, Inputs()).get("a") is None


def test_other_software_finds_nothing(store: RunStore[Toy], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    store.put("a", TOY)
    monkeypatch.setattr(checkpoint, "versions", lambda: {"numpy": "another"})
    assert RunStore(tmp_path, "toys", Toy, Inputs()).get("a") is None


def test_another_source_has_another_fingerprint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    package = tmp_path / "sayd_env"
    (package / "physics").mkdir(parents=True)
    source = package / "physics" / "step.py"
    source.write_text("x = 1\n")
    monkeypatch.setattr(checkpoint, "_PACKAGE", package)
    before = fingerprint("a")
    assert fingerprint("a") == before
    source.write_text("x = 2\n")
    assert fingerprint("a") != before


def test_the_content_of_a_file_counts_that_an_input_names(tmp_path: Path):
    table = tmp_path / "table.csv"
    table.write_text("1,2\n")
    inputs = {"damper": {"throttle": [{"file": str(table)}]}}
    before = fingerprint(inputs)
    assert fingerprint(inputs) == before
    table.write_text("1,3\n")
    assert fingerprint(inputs) != before
    assert fingerprint({"text": "no\0file"}, {"text": "x" * 10_000})


def test_the_runs_class_counts(tmp_path: Path):
    here = fingerprint("a", modules=[Path(__file__)])
    other = tmp_path / "module.py"
    other.write_text("y = 1\n")
    assert len({here, fingerprint("a"), fingerprint("a", modules=[other])}) == 3


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def foreign(path: Path) -> None:
    np.savez(path, other=np.zeros(3))


def pickled(path: Path) -> None:
    np.savez(path, speed=np.array([{}], dtype=object))


@pytest.mark.parametrize(
    "damage",
    [cut, foreign, pickled, lambda path: path.write_bytes(b""), lambda path: path.write_text("hello")],
)
def test_a_file_that_is_no_such_run_is_computed_again(damage: Any, store: RunStore[Toy], tmp_path: Path):
    store.put("a", TOY)
    damage(only_file(tmp_path))
    assert store.get("a") is None
    assert store.remembered("a", lambda: TOY) is TOY
    assert store.get("a") is not None


def test_a_renamed_run_is_not_taken_for_another(store: RunStore[Toy], tmp_path: Path):
    store.put("a", TOY)
    path = only_file(tmp_path)
    path.rename(path.with_name("b.npz"))
    assert store.get("b") is None


def same(one: Any, other: Any) -> bool:
    return all(np.array_equal(value, getattr(other, name)) for name, value in vars(one).items())


def test_a_damaged_byte_changes_no_value(store: RunStore[Toy], tmp_path: Path):
    store.put("a", TOY)
    path = only_file(tmp_path)
    good = path.read_bytes()
    lost = 0
    for place in range(0, len(good), 5):
        path.write_bytes(good[:place] + bytes([good[place] ^ 0xFF]) + good[place + 1 :])
        found = store.get("a")
        assert found is None or same(found, TOY), place
        lost += found is None
    assert lost > 0.3 * len(good) / 5


def test_former_runs_are_removed_on_request_and_nothing_else(store: RunStore[Toy], tmp_path: Path):
    store.put("a", TOY)
    for name in ("toys-0123456789abcdef", "toys-not-ours", "toys-old", "others-0123456789abcdef"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.npz").write_bytes(b"x")
    store.forget_former()
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {
        f"toys-{store.fingerprint}",
        "toys-not-ours",
        "toys-old",
        "others-0123456789abcdef",
    }


def test_a_name_stays_in_its_folder(tmp_path: Path):
    RunStore(tmp_path / "runs", "../of *any* [kind]", Toy, Inputs())
    assert [path.parent for path in tmp_path.rglob("*of__any*")] == [tmp_path / "runs"]


def test_a_folder_that_cannot_be_written_is_found_at_once():
    with pytest.raises(ConfigError, match="cannot be written"):
        RunStore(Path("/proc/sayd"), "toys", Toy)
