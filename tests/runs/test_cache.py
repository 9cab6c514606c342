"""Finished runs on the disk: found again, and only where every input and every source is the same."""

from __future__ import annotations

import os
import shutil
import signal
import time
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.config import Model, StudyError, software
from sayd_env.config import control as control_config
from sayd_env.config.environment import load_environment
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.software import SOURCES, fingerprint_of, floor_fingerprint, source_fingerprint
from sayd_env.runs import cache as module
from sayd_env.runs import context, rollouts
from sayd_env.runs.cache import RunCache, fingerprint
from sayd_env.runs.context import RunContext
from sayd_env.runs.controlled import ControlledRun
from sayd_env.runs.passive import PassiveRun
from sayd_env.runs.policies import PolicySpec, policy_spec
from sayd_env.runs.rollouts import Run
from sayd_env.studies.critical_speed import recorded


class Inputs(Model):
    friction: float = 0.4


@dataclass(frozen=True)
class Toy:
    speed: float
    seed: int
    policy: str
    values: np.ndarray
    command: np.ndarray
    ending: str | None = None


TOY = Toy(1 / 3, 7, "mppt1 µ", np.linspace(0, 1, 5), np.eye(2, dtype=np.float32))
KEY = fingerprint("toys", Inputs())


@pytest.fixture
def cache(tmp_path: Path) -> RunCache:
    """A cache that has to read from the disk what another one has kept there."""
    RunCache(tmp_path).put(KEY, TOY)
    return RunCache(tmp_path)


def only_file(folder: Path) -> Path:
    (path,) = folder.glob("*/*.npz")
    return path


def same(one: Any, other: Any) -> bool:
    return all(np.array_equal(value, getattr(other, name)) for name, value in vars(one).items())


def test_a_run_comes_back_bit_for_bit(cache: RunCache):
    found = cache.get(KEY, Toy)
    assert found is not None
    assert (found.speed, found.seed, found.policy) == (TOY.speed, TOY.seed, TOY.policy)
    assert [type(x) for x in (found.speed, found.seed, found.policy)] == [float, int, str]
    assert (found.values == TOY.values).all()
    assert (found.command == TOY.command).all()
    assert found.command.dtype == np.float32
    assert found.ending is None


def test_a_controlled_run_comes_back(controlled_run: Callable[..., ControlledRun], tmp_path: Path):
    run = controlled_run("skyhook-onoff", 350, 3)
    RunCache(tmp_path).put(KEY, run)
    found = RunCache(tmp_path).get(KEY, ControlledRun)
    assert found is not None
    assert same(found, run)
    assert found.command.dtype == np.float32


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs POSIX signals")
def test_an_interrupt_in_the_middle_of_an_archive_is_one_and_the_run_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """An archive that is left open would end in a ValueError of its own."""
    begin = zipfile.ZipFile.open

    def interrupted(*arguments: Any, **named: Any) -> Any:
        opened = begin(*arguments, **named)
        os.kill(os.getpid(), signal.SIGINT)
        return opened

    monkeypatch.setattr(zipfile.ZipFile, "open", interrupted)
    with pytest.raises(KeyboardInterrupt):
        RunCache(tmp_path).put(KEY, TOY)
    monkeypatch.undo()
    found = RunCache(tmp_path).get(KEY, Toy)
    assert found is not None
    assert same(found, TOY)


def test_without_a_folder_runs_are_kept_in_memory():
    cache = RunCache()
    cache.put(KEY, TOY)
    assert cache.get(KEY, Toy) is TOY
    assert cache.reused == 0


@dataclass(frozen=True)
class Spec:
    """A run that `doubled` makes."""

    number: int

    def inputs(self) -> list[Any]:
        return [Inputs(), self.number]

    def companions(self) -> int:
        return 0

    def duration(self) -> float:
        return 0.0


@dataclass(frozen=True)
class Doubled:
    value: int


made: list[int] = []


def doubled(specs: list[Spec]) -> list[Doubled]:
    for spec in specs:
        if spec.number < 0:
            raise KeyboardInterrupt
    made.extend(spec.number for spec in specs)
    return [Doubled(2 * spec.number) for spec in specs]


def values(cache: RunCache, numbers: Iterable[int]) -> list[int]:
    found = RunContext(cache=cache).records(doubled, [Spec(n) for n in numbers], Doubled)
    return [record.value for record in found]


def test_the_second_call_does_no_work(tmp_path: Path):
    made.clear()
    first = RunCache(tmp_path)
    assert values(first, [1, 2]) == values(first, [1, 2]) == [2, 4]
    assert (sorted(made), first.reused) == ([1, 2], 0)  # a cache's own runs do not come from the disk
    second = RunCache(tmp_path)
    assert values(second, [2, 3, 1]) == [4, 6, 2]
    assert (sorted(made), second.reused) == ([1, 2, 3], 2)


def test_a_work_that_fails_leaves_nothing(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt):
        values(RunCache(tmp_path), [-1])
    assert list(tmp_path.iterdir()) == []


def test_other_work_finds_nothing(tmp_path: Path):
    """The maker of a run belongs to its inputs: an assessed run is no judged one."""
    values(RunCache(tmp_path), [1])

    def other(specs: list[Spec]) -> list[Doubled]:
        return [Doubled(0) for _ in specs]

    (found,) = RunContext(cache=RunCache(tmp_path)).records(other, [Spec(1)], Doubled)
    assert found.value == 0


def test_other_inputs_find_nothing(cache: RunCache):
    for inputs in (("toys", Inputs(friction=0.3)), ("toys", Inputs(), {"k_y": 1.0}), ("others", Inputs())):
        assert cache.get(fingerprint(*inputs), Toy) is None
    assert cache.get(fingerprint("toys", Inputs()), Toy) is not None


def test_another_record_finds_nothing(cache: RunCache):
    assert cache.get(KEY, Doubled) is None


def test_other_software_finds_nothing(cache: RunCache, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "source_fingerprint", lambda: 16 * "0")
    assert RunCache(tmp_path).get(KEY, Toy) is None


def test_other_versions_of_libraries_are_other_software(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    before = fingerprint_of([tmp_path])
    monkeypatch.setattr(software, "versions", lambda: {"numpy": "another"})
    assert fingerprint_of([tmp_path]) != before


LEAVES = {
    "agents": "policy_file.py",
    "baselines": "mppt.py",
    "config": "track.py",
    "configs": "profile/lma.yaml",
    "envs": "loop.py",
    "measured": "recordings.py",
    "physics": "contact/hertz.py",
    "runs": "metrics.py",
    "stability": "signals.py",
}
"""A file of each floor that can change a run."""


@pytest.fixture(scope="module")
def copies(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every floor's sources in a folder of their own."""
    parent = tmp_path_factory.mktemp("floors")
    for floor in SOURCES:
        shutil.copytree(
            str(resources.files(f"sayd_env.{floor}")),
            parent / floor,
            ignore=shutil.ignore_patterns("__pycache__", "*.npz"),
        )
    return {floor: parent / floor for floor in SOURCES}


def test_what_makes_runs_on_another_floor_counts_with_it(monkeypatch: pytest.MonkeyPatch):
    """Some works stand in the studies, whose sources change no other run."""
    for name in ("sayd_env.runs.metrics", "sayd_env.physics.step", "somebody.else"):
        assert floor_fingerprint(name) == ""
    folder = resources.files("sayd_env.studies")
    assert floor_fingerprint(recorded.__module__) == fingerprint_of([folder])
    specs = [PassiveRun(load_scenario(), 90.0, 1)]
    before = context._keys(recorded, specs)
    monkeypatch.setattr(context, "floor_fingerprint", lambda module: "edited")
    assert context._keys(recorded, specs) != before


def test_what_a_regulator_was_designed_on_counts(tmp_path: Path):
    """Also a file that its study names."""
    (tmp_path / "own.yaml").write_text("base: nominal\nvehicle: heavy.yaml\n")
    (tmp_path / "lqg.yaml").write_text("base: lqg\nstudy: own.yaml\n")
    identities = []
    for mass in (40e3, 50e3):
        (tmp_path / "heavy.yaml").write_text(f"base: emu\nset:\n  bodies.carbody.mass: {mass}\n")
        identities.append(policy_spec(str(tmp_path / "lqg.yaml")).identity())
    assert identities[0] != identities[1]


def test_the_same_sources_elsewhere_have_the_same_fingerprint(copies: dict[str, Path]):
    assert fingerprint_of(list(copies.values())) == source_fingerprint()


@pytest.mark.parametrize("floor", SOURCES)
def test_an_edit_in_any_floor_finds_nothing(
    floor: str, copies: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A comment is enough."""
    leaf = copies[floor] / LEAVES[floor]
    original = leaf.read_text()
    RunCache(tmp_path).put(KEY, TOY)
    try:
        leaf.write_text(original + "# edited\n")
        edited = fingerprint_of(list(copies.values()))
    finally:
        leaf.write_text(original)
    assert edited != source_fingerprint()
    assert fingerprint_of(list(copies.values())) == source_fingerprint()
    monkeypatch.setattr(module, "source_fingerprint", lambda: edited)
    assert RunCache(tmp_path).get(KEY, Toy) is None
    monkeypatch.undo()
    assert RunCache(tmp_path).get(KEY, Toy) is not None


def test_a_new_or_renamed_source_is_another_software(copies: dict[str, Path]):
    folders = list(copies.values())
    new = copies["physics"] / "contact" / "new.py"
    new.write_text("")
    one = fingerprint_of(folders)
    new = new.rename(new.with_name("other.py"))
    other = fingerprint_of(folders)
    new.unlink()
    assert len({source_fingerprint(), one, other}) == 3


def test_the_content_of_a_file_counts_that_an_input_names(tmp_path: Path):
    table = tmp_path / "table.csv"
    table.write_text("1,2\n")
    inputs = {"damper": {"throttle": [{"file": str(table)}]}}
    before = fingerprint(inputs)
    assert fingerprint(inputs) == before
    table.write_text("1,3\n")
    assert fingerprint(inputs) != before
    assert fingerprint({"text": "no\0file"}, {"text": "x" * 10_000})


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("estimates")


@pytest.fixture(scope="module")
def run(scenario: Scenario) -> Run:
    """A run of a controller whose parameters, vehicle, track and clock can be varied."""
    policy = policy_spec("constant:0.3")
    (run,) = rollouts.policy_runs([policy], [scenario], [80.0], [5], load_environment())
    return run


def key(run: Run | PassiveRun) -> str:
    return fingerprint(*run.inputs())


def test_a_run_is_that_of_its_vehicle_policy_seed_and_speed(run: Run):
    vehicle, clock = run.scenario, run.environment
    others = [
        replace(run, seed=6),
        replace(run, speed=80.1),
        replace(run, initial_current=0.1),
        replace(run, policy=PolicySpec("constant", {"current": 0.31})),
        replace(run, policy=PolicySpec("mppt2")),
        replace(run, policy=PolicySpec("mppt2", {"k_J": 0.123})),
        replace(run, scenario=vehicle.model_copy(update={"wear": 0.75})),
        replace(
            run,
            scenario=vehicle.model_copy(
                update={"vehicle": vehicle.vehicle.model_copy(update={"name": "other"})}
            ),
        ),
        replace(run, environment=clock.model_copy(update={"control_period": 0.005})),
    ]
    assert len({key(run), *map(key, others)}) == 1 + len(others)


def test_the_same_run_is_found_whatever_its_label(run: Run):
    """Read again, and under another title: the same vehicle, parameters and track are the same run."""
    again = replace(run, policy=PolicySpec("constant", {"current": 0.3}, "mine"))
    assert key(replace(again, scenario=run.scenario.model_copy(deep=True))) == key(run)


def test_the_on_line_filter_belongs_to_a_run(run: Run, monkeypatch: pytest.MonkeyPatch):
    """Policies see its output and J is taken by it."""
    before = key(run)
    online = control_config.load_online()
    other = online.model_copy(update={"settling": 1.25 * online.settling})
    monkeypatch.setattr(rollouts, "load_online", lambda: other)
    assert key(run) != before


def test_a_passive_run_is_that_of_its_vehicle_seed_and_speed(scenario: Scenario):
    run = PassiveRun(scenario, 80.0, 5)
    others = [
        replace(run, seed=6),
        replace(run, speed=80.1),
        replace(run, scenario=scenario.model_copy(update={"friction": 0.3})),
        replace(run, scenario=load_scenario("estimates", ["assessment.length=600"])),
        replace(run, scenario=load_scenario("estimates", ["contact.creep_law=polach"])),
    ]
    assert len({key(run), *map(key, others)}) == 1 + len(others)
    assert key(PassiveRun(load_scenario("estimates"), 80.0, 5)) == key(run)


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
def test_a_file_that_is_no_such_run_counts_as_not_found(damage: Any, cache: RunCache, tmp_path: Path):
    damage(only_file(tmp_path))
    assert cache.get(KEY, Toy) is None
    assert cache.reused == 0
    cache.put(KEY, TOY)
    assert RunCache(tmp_path).get(KEY, Toy) is not None


def test_a_renamed_run_is_not_taken_for_another(cache: RunCache, tmp_path: Path):
    path = only_file(tmp_path)
    path.rename(path.with_name("b.npz"))
    assert cache.get("b", Toy) is None


def test_a_damaged_byte_changes_no_value(cache: RunCache, tmp_path: Path):
    path = only_file(tmp_path)
    good = path.read_bytes()
    lost = 0
    for place in range(0, len(good), 5):
        path.write_bytes(good[:place] + bytes([good[place] ^ 0xFF]) + good[place + 1 :])
        found = RunCache(tmp_path).get(KEY, Toy)
        assert found is None or same(found, TOY), place
        lost += found is None
    assert lost > 0.3 * len(good) / 5


def test_former_runs_are_removed_on_request_and_nothing_else(cache: RunCache, tmp_path: Path):
    for name in ("0123456789abcdef", "not-ours", "old", "0123456789ABCDEF", "fedcba9876543210"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.npz").write_bytes(b"x")
        yesterday = time.time() - 90_000.0
        os.utime(tmp_path / name, (yesterday, yesterday))
    (tmp_path / "fedcba9876543210" / "b.npz").write_bytes(b"x")  # another machine is at work there
    cache.forget_former()
    assert {path.name for path in tmp_path.iterdir()} == {
        source_fingerprint(),
        "not-ours",
        "old",
        "0123456789ABCDEF",
        "fedcba9876543210",
    }
    assert cache.get(KEY, Toy) is not None


def test_a_cache_in_memory_has_nothing_to_forget():
    cache = RunCache()
    cache.put(KEY, TOY)
    cache.forget_former()
    assert cache.get(KEY, Toy) is not None


def test_a_folder_that_cannot_be_written_is_one_message():
    with pytest.raises(StudyError, match="cannot be written"):
        RunCache(Path("/proc/sayd")).put(KEY, TOY)
