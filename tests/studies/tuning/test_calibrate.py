"""Calibration: what a place in the ranges sets, what a row's residual is, and runs that are not lost."""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config import ConfigError, StudyError
from sayd_env.config.calibration import CalibrationConfig, Search, load_calibration
from sayd_env.config.control import MpptConfig, load_controller
from sayd_env.config.damper import PassiveDamperConfig, load_sayd
from sayd_env.config.scenario import load_scenario
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import RunContext
from sayd_env.runs.passive import Sweep
from sayd_env.stability import Limits
from sayd_env.studies.tuning import calibrate as module
from sayd_env.studies.tuning.calibrate import CalibrationResult, calibrate, damped
from sayd_env.studies.tuning.parts import part_files, semi_active_parts
from sayd_env.studies.tuning.targets import above, below, passive_residuals

STUDY = """
base: {base}
semi_active_damper: sayd-estimate
first_seed: 1000
passive:
  searches: [{{name: all, seeds: 1, length: 1500.0, radius: 1.0, samples: 4, evaluations: 4}}]
  parameters:
    - name: series stiffness
      unit: N/m
      low: 4.0e+6
      high: 9.0e+6
      scale: log
      keys: {{damper.series_stiffness: 1.0}}
      source: made up
    - name: friction
      unit: "-"
      low: 0.3
      high: 0.5
      keys: {{friction: 1.0, contact_damping: 2.0e+5}}
      source: made up
semi_active:
  searches: [{{name: all, seeds: 1, length: 1500.0, radius: 1.0, samples: 5, evaluations: 5}}]
  parameters:
    - name: corner
      unit: Hz
      low: 0.05
      high: 0.2
      keys: {{control.skyhook.corner: 1.0}}
      source: made up
    - name: lower threshold
      unit: m/s2
      low: 0.4
      high: 0.8
      keys: {{control.mppt2.threshold_min: 1.0, control.mppt2.threshold_max: 1.0}}
      source: made up
    - name: distance of the thresholds
      unit: m/s2
      low: 0.1
      high: 0.3
      keys: {{control.mppt2.threshold_max: 1.0}}
      source: made up
sensitivity: {{seeds: 1, length: 1500.0, share: 0.1}}
"""
ABOUT = {"command": "sayd calibrate"}
HELD = 2
"""Runs of fixed commands of the semi-active dampers."""
SWEEPS = 7 + 6
"""Speeds on new and on worn wheels."""
CONTROLLED = 4 * 5 + 2
"""Runs of four controllers at five speeds, and two from an open valve."""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration of a few numbers over a short distance."""
    folder = tmp_path_factory.mktemp("study")
    base = folder / "short.yaml"
    base.write_text("base: estimates\nassessment: {run_in: 200.0}\nset: {track.irregularity.scale: 0.5}\n")
    path = folder / "small.yaml"
    path.write_text(STUDY.format(base="./short.yaml"))
    return path


@pytest.fixture(scope="module")
def config(study: Path) -> CalibrationConfig:
    return load_calibration(str(study))


ROWS_OF_MPPT2 = [("mppt2", 300 / 3.6, 0.0)]


class Stop(Exception):
    pass


@dataclass
class Calibrated:
    """A calibration that was interrupted behind the first trials, those of the passive vehicle."""

    runs: Path
    """Folder of the cache."""
    kept: int
    """Runs that were there when it went on."""
    cache: RunCache
    counts: list[tuple[float, float]]
    """Its progress."""
    result: CalibrationResult


@pytest.fixture(scope="module")
def calibrated(config: CalibrationConfig, tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    def stop(done: float, total: float, what: str = "") -> None:
        if done >= 4:
            raise Stop

    runs = tmp_path_factory.mktemp("runs")
    with pytest.raises(Stop):
        calibrate(config, context=RunContext(cache=RunCache(runs), progress=stop))
    kept, cache, counts = len(list(runs.glob("*/*.npz"))), RunCache(runs), list[tuple[float, float]]()
    context = RunContext(cache=cache, progress=lambda done, total, what="": counts.append((done, total)))
    return Calibrated(runs, kept, cache, counts, calibrate(config, context=context))


def test_a_place_sets_values_times_factors(config: CalibrationConfig):
    """Half of a log range is the geometric mean, a quarter of a linear one a quarter of the way."""
    stage = config.passive
    assert stage.assignments(stage.values((0.5, 0.25))) == pytest.approx(
        {"damper.series_stiffness": 6e6, "friction": 0.35, "contact_damping": 0.35 * 2e5}
    )
    assert stage.values((0.0, 1.0)) == {"series stiffness": 4e6, "friction": 0.5}


def test_what_two_parameters_give_to_one_key_is_added_up(config: CalibrationConfig):
    numbers = config.semi_active.assignments(config.semi_active.values((0.0, 0.5, 0.5)))
    assert numbers["control.mppt2.threshold_min"] == pytest.approx(0.6)
    assert numbers["control.mppt2.threshold_max"] == pytest.approx(0.6 + 0.2)


@pytest.mark.parametrize("place", [0.0, 0.5, 1.0])
def test_the_packaged_calibration_sets_numbers_that_its_parts_take(place: float, tmp_path: Path):
    """What is written for `configs/` gives the plant that the assignments give."""
    config = load_calibration()
    passive, own = config.passive, config.semi_active
    values, mine = (
        passive.values([place] * len(passive.parameters)),
        own.values([place] * len(own.parameters)),
    )
    texts = part_files(config, "passive", values, ABOUT)
    texts |= part_files(config, "semi_active", mine, ABOUT)
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    numbers = passive.assignments(values)
    wanted = load_scenario(config.base, [f"{key}={number!r}" for key, number in numbers.items()])
    track = f"track={tmp_path}/track/german_low.yaml"
    section = f"track.section={tmp_path}/section/slab.yaml"
    parts = {"vehicle": "vehicle/emu", "damper": "damper/passive", "wheel": "profile/s1002cn"}
    named = [f"{key}={tmp_path}/{path}.yaml" for key, path in parts.items()]
    found = load_scenario(config.base, [*named, track, section, f"friction={numbers['friction']!r}"])
    for part in parts:
        same = {"name", "provenance", "description"}
        assert getattr(found, part).model_dump(exclude=same) == getattr(wanted, part).model_dump(exclude=same)
    assert found.track.section.lateral_stiffness == wanted.track.section.lateral_stiffness
    assert found.track.irregularity == wanted.track.irregularity
    assert (
        load_sayd(f"{tmp_path}/damper/sayd.yaml").throttle.closed_area == mine["area of the closed throttle"]
    )
    controller = load_controller(f"{tmp_path}/control/mppt2.yaml")
    assert isinstance(controller, MpptConfig)
    assert controller.k_J == mine["k_J of MPPT2"]


def test_the_ranges_keep_to_the_published_dampers():
    """Published: knee at 3 to 10 mm/s with 1.5 to 10 kN, slopes of 200 kN s/m or more and of 5 to 60.

    In series 4 to 10 MN/m; friction of dry stability studies 0.30 to 0.40.
    """
    config = load_calibration()
    parameters = {p.keys.__iter__().__next__(): p for p in config.passive.parameters}
    knee, force = parameters["damper.curve.1.0"], parameters["damper.curve.1.1"]
    rise = next(p for p in config.passive.parameters if list(p.keys) == ["damper.curve.2.1"])
    series = parameters["damper.series_stiffness"]
    assert 3e-3 <= knee.low < knee.high <= 10e-3
    assert 4e6 <= series.low < series.high <= 10e6
    for v, f, more in itertools.product(
        (knee.low, knee.high), (force.low, force.high), (rise.low, rise.high)
    ):
        assert f / v >= 200e3
        assert 1.5e3 <= f <= 10e3
        assert 5e3 <= more / (0.25 - v) <= 60.1e3
    friction = parameters["friction"]
    assert 0.30 <= friction.low < friction.high <= 0.40


def test_no_track_of_the_calibration_is_one_of_the_reproduction():
    config = load_calibration()
    most = max(search.seeds for stage in (config.passive, config.semi_active) for search in stage.searches)
    assert not set(range(config.first_seed, config.first_seed + most)) & {*range(100), *range(9100, 9120)}


@pytest.fixture
def rows(synthetic: Callable[..., Sweep], limits: Limits) -> Callable[..., tuple[dict[str, float], ...]]:
    """Residuals and measures of made-up sweeps with known crossings (km/h)."""

    def rows(
        new: float = 375.0,
        worn: float = 331.0,
        force: float = 361.0,
        trailing: float = 1.25,
        scattered: Sequence[Sequence[float]] = ((4.0, 5.0),),
    ) -> tuple[dict[str, float], ...]:
        first = synthetic(
            [280, 340, 370, 400],
            [new] * 3,
            [new] * 3,
            slope=1 / 100,
            frequency=lambda v: 4 + (v - 375) * 0.01,
        )
        second = synthetic(
            [320, 350, 370, 420],
            [worn] * 3,
            [force] * 3,
            trailing=trailing,
            frequency=lambda v: 4 + 0.01 * v,
            scatter=lambda v: 1.0 if v < 350 else 0.1,
        )
        return passive_residuals(first, second, limits, np.array([0.35, 0.4]), np.array(scattered))

    return rows


Rows = Callable[..., tuple[dict[str, float], ...]]


def test_a_vehicle_like_the_papers_has_small_residuals(rows: Rows):
    residuals, measures = rows(new=374.0, worn=334.0)
    assert list(residuals) == [*(f"P{i}" for i in range(1, 11)), "M1, M5, S1", "M2"]
    ratio_320 = 1 + (320 - 334) / 200
    assert residuals["P4"] == pytest.approx((ratio_320 - 0.85) / 0.05)
    ratio_350 = 1 + (350 - 334) / 200
    assert residuals["P6"] == pytest.approx((1.1 - ratio_350) / 0.05)
    others = [value for row, value in residuals.items() if row not in ("P4", "P6")]
    assert others == pytest.approx([0.0] * 10, abs=1e-9)
    assert measures["critical_worn_kmh"] == pytest.approx(334.0)
    assert measures["critical_worn_force_kmh"] == pytest.approx(361.0)
    assert measures["trailing_ratio"] == pytest.approx(1.25)
    assert measures["spread_350_hz"] == pytest.approx(0.1)


@pytest.mark.parametrize("new", [300.0, 365.0, 390.0, 450.0])
def test_the_critical_speed_goes_on_beyond_the_grid(new: float, rows: Rows):
    """A line that would cross at 450 km/h says so, although the grid ends at 400 km/h."""
    residuals, measures = rows(new=new)
    assert measures["critical_new_kmh"] == pytest.approx(new)
    assert residuals["P2"] == pytest.approx((new - 374) / 6)


def test_other_rows_measure_their_distance(rows: Rows):
    assert rows(trailing=1.05)[0]["P9"] == pytest.approx((1.2 - 1.05) / 0.05)
    # Of one seed half of the frequencies lie within 2 to 10 Hz, of the other all do.
    residuals, measures = rows(scattered=((1.0, 4.0, 6.0, 12.0), (3.0, 5.0, 7.0, 9.0)))
    assert residuals["M2"] == pytest.approx(((0.9 - 0.5) / 0.1 + 0.0) / 2)
    assert measures["held_within_scatter"] == pytest.approx(0.75)


def test_a_row_of_seeds_counts_those_that_fail():
    assert above(np.array([0.3, 0.6, 0.8]), 0.5, 0.1) == pytest.approx((0 + 1 + 3) / 3)
    assert below(np.array([0.3, 0.6]), 0.5, 0.1) == pytest.approx((2 + 0) / 2)


def test_an_interrupted_calibration_goes_on_where_it_stopped(calibrated: Calibrated):
    assert calibrated.kept == calibrated.cache.reused == 4 * (SWEEPS + HELD)
    # Trials of both stages; then two parameters of the passive one and all five, up and down.
    whole, counts = 4 + 5 + (1 + 2 * 2) + (1 + 2 * 5), calibrated.counts
    assert counts == sorted(counts)
    assert {(4, whole), (4 + 5, whole), (whole, whole)} <= set(counts)
    result = calibrated.result
    best = min(trial.cost for trial in result.trials["passive"])
    assert result.best("passive").cost == best
    assert result.trials["passive"][0].place == (0.5, 0.5)
    assert [len(trials) for trials in result.trials.values()] == [4, 5]
    assert len(result.sensitivity) == 1 + 2 * (2 + 3)


def test_all_starts_but_the_first_of_seed_0_are_at_random_places():
    assert module._start(0, 0, 3).tolist() == [0.5] * 3
    places = [tuple(module._start(seed, start, 3)) for seed, start in ((0, 1), (1, 0), (1, 1), (2, 0))]
    assert len(set(places)) == 4
    assert all(0.0 <= u < 1.0 for place in places for u in place)


@pytest.mark.parametrize(("good_cost", "starts"), [(1e6, 1), (0.0, 3)])
def test_a_search_starts_again_until_an_end_is_good(config: CalibrationConfig, good_cost: float, starts: int):
    """Each start looks over the whole ranges; the last search goes on from the best of their ends."""
    wide, last = (
        config.passive.searches[0].model_copy(update={"name": name, "radius": radius, "evaluations": count})
        for name, radius, count in (("wide", 1.0, 8), ("last", 0.1, 4))
    )
    changes = {"searches": (wide, last), "starts": 3, "good_cost": good_cost}
    stage = config.passive.model_copy(update=changes)

    def rugged(places: Sequence[module.Place], seeds: int, length: float) -> list[module.Outcome]:
        return [({"P1": 1.0 + np.cos(40.0 * a) * np.cos(31.0 * b)}, {}) for a, b in places]

    counts: list[tuple[float, float]] = []
    context = RunContext(progress=lambda done, total, what="": counts.append((done, total)))
    trials = module._searched("passive", stage, rugged, 0, module._Evaluations(context.progress, 12))
    begun = [next(trials) for _, trials in itertools.groupby(trials, lambda trial: trial.stage)]
    assert [trial.stage for trial in begun] == [
        *("passive, wide", "passive, wide 2", "passive, wide 3")[:starts],
        "passive, last",
    ]
    assert begun[0].place == (0.5, 0.5)
    assert len({trial.place for trial in begun[:-1]}) == starts
    assert begun[-1].place == min(trials[: 8 * starts], key=lambda trial: trial.cost).place
    assert counts[-1] == (8 * starts + 4, 8 * starts + 4)


def test_no_finite_run_at_all_is_a_failed_study(config: CalibrationConfig, monkeypatch: pytest.MonkeyPatch):
    def lost(*_: object, **__: object) -> None:
        raise StudyError("diverged")

    monkeypatch.setattr(RunContext, "records", lost)
    with pytest.raises(StudyError, match="passive: no numbers within the ranges gave a finite run"):
        calibrate(config)


def test_runs_that_are_made_again_are_not_counted_twice():
    """A batch of three of eight evaluations fails behind two of them, and is made again one by one."""
    counts: list[float] = []
    progress = module._Evaluations(lambda done, total, what="": counts.append(done), 8)

    def measured(values: list[int]) -> list[module.Outcome]:
        progress.within(2.0, 3.0)
        if len(values) > 1:
            raise StudyError("diverged")
        return [({}, {})]

    progress.begin("passive", 3)
    module._each([1, 2, 3], measured, ({}, {}))
    progress.end()
    assert counts == [0, 2, 2, 2, 2, 3]


def test_one_lost_set_of_numbers_does_not_take_the_others_with_it():
    def measured(values: list[float]) -> list[module.Outcome]:
        if any(value > 1.0 for value in values):
            raise StudyError("diverged")
        return [({"P1": value}, {}) for value in values]

    lost = ({"P1": module.LOST}, {})
    found = module._each([0.1, 2.0, 0.3], measured, lost)
    assert [residuals["P1"] for residuals, _ in found] == [0.1, module.LOST, 0.3]


def test_the_command_says_what_it_found(
    study: Path, calibrated: Calibrated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """It takes the runs that are there, and makes no other ones."""
    out = tmp_path / "out"
    shutil.copytree(calibrated.runs, out / "runs")
    made = sorted(path.name for path in (out / "runs").glob("*/*.npz"))
    assert main(["calibrate", "--config", str(study), "--json", "--out", str(out)]) == 0
    assert sorted(path.name for path in (out / "runs").glob("*/*.npz")) == made
    content = json.loads(capsys.readouterr().out)
    assert [content[name]["evaluations"] for name in ("passive", "semi_active")] == [4, 5]
    names = {"result.json", "evaluations_passive.csv", "evaluations_semi_active.csv", "sensitivity.csv"}
    assert {path.name for path in out.iterdir()} == {*names, "runs", "cost.png", "configs"}
    parts = {str(path.relative_to(out / "configs")) for path in (out / "configs").rglob("*.yaml")}
    assert parts == {"study/calibrated.yaml", "control/skyhook.yaml", "control/mppt2.yaml"}
    for name in ("passive", "semi_active"):
        residuals = np.array(list(content[name]["residuals"].values()))
        assert content[name]["cost"] == pytest.approx(np.sum((3 * np.arcsinh(residuals / 3)) ** 2))
    values = content["passive"]["parameters"]
    made_by = (out / "configs" / "study" / "calibrated.yaml").read_text()
    assert f"command: sayd calibrate --config {study} --json --out {out}" in made_by
    stored = load_scenario(f"{out}/configs/study/calibrated.yaml")
    assert isinstance(stored.damper, PassiveDamperConfig)
    assert stored.damper.series_stiffness == values["series stiffness"]
    assert stored.friction == values["friction"]
    assert (stored.track.irregularity.scale, stored.assessment.run_in) == (0.5, 200.0)  # of its base
    calibrated, *moved = content["sensitivity"]
    assert calibrated["name"] == "as calibrated"
    friction = values["friction"]
    steps = [min(friction + 0.02, 0.5), max(friction - 0.02, 0.3)]  # a tenth of 0.3 to 0.5
    assert [line["value"] for line in moved[2:4]] == pytest.approx(steps, abs=1e-5)
    assert {line["critical_new_kmh"] for line in moved[4:]} == {None}  # the damper is another


def test_files_of_controllers_and_dampers_are_what_is_calibrated(
    study: Path, monkeypatch: pytest.MonkeyPatch
):
    """What a file sets beside the free numbers is in the runs, and in the parts that are written."""
    own = study.parent / "own"
    own.mkdir()
    (own / "mppt2.yaml").write_text("base: mppt2\nset: {v_min: 0.01, delta_v_up: 0.06}\n")
    (own / "damper.yaml").write_text("base: sayd\nset: {valve.delay: 3.0e-3}\n")
    monkeypatch.chdir(own)
    settings = ("controllers=[mppt2.yaml]", "semi_active_damper=damper.yaml")
    config = load_calibration(str(study), settings)
    values = config.semi_active.values((0.0, 0.5, 0.5))

    class Caught(RunContext):
        def records(self, assess, runs, kind):
            raise Stop(runs)

    vehicle = config.passive.values((0.5, 0.5))
    with pytest.raises(Stop) as stop:
        module._SemiActive(config, vehicle, Caught()).measured([(vehicle, values)], ROWS_OF_MPPT2, 1, 1500.0)
    (run,) = stop.value.args[0]
    assert run.policy.parameters["v_min"] == 0.01
    assert run.policy.parameters["threshold_min"] == pytest.approx(values["lower threshold"])
    assert run.scenario.damper.valve.delay == 3e-3
    texts = part_files(config, "semi_active", values, ABOUT)
    (own / "new").mkdir()
    (own / "new" / "mppt2.yaml").write_text(texts["control/mppt2.yaml"])
    written = load_controller("new/mppt2.yaml").model_dump() | {"provenance": None}
    assert written == run.policy.parameters | {"provenance": None}


def test_what_the_skyhooks_share_goes_into_each_file_of_ones_own(study: Path):
    own = study.parent / "skyhooks"
    own.mkdir()
    (own / "skyhook-onoff.yaml").write_text("base: skyhook-onoff\nset: {open: 0.9}\n")
    config = load_calibration(str(study), (f"controllers=['{own}/skyhook-onoff.yaml']",))
    values = config.semi_active.values((0.5, 0.5, 0.5))
    texts = part_files(config, "semi_active", values, ABOUT)
    assert {path for path in texts if "skyhook" in path} == {
        "control/skyhook.yaml",
        "control/skyhook-onoff.yaml",
    }
    (own / "new").mkdir()
    (own / "new" / "skyhook-onoff.yaml").write_text(texts["control/skyhook-onoff.yaml"])
    written = load_controller(f"{own}/new/skyhook-onoff.yaml").model_dump()
    assert (written["open"], written["corner"]) == (0.9, values["corner"])


def test_no_part_stands_on_itself(study: Path):
    """Packaged ones that are calibrated anew stand on their estimates; a path may hold any sign."""
    config = load_calibration(str(study), ("semi_active_damper=sayd", "controllers=[mppt2]"))
    damper, controllers = semi_active_parts(config)[0], semi_active_parts(config)[1:]
    assert (damper.base, {part.base for part in controllers}) == (
        "sayd-estimate",
        {"mppt1-estimate", "mppt2-estimate", "skyhook-estimate"},
    )
    odd = study.parent / "q #1"
    odd.mkdir()
    (odd / "mppt2.yaml").write_text("base: mppt2\nset: {v_min: 0.01}\n")
    config = load_calibration(str(study), (f"controllers=['{odd}/mppt2.yaml']",))
    text = part_files(config, "semi_active", config.semi_active.values((0.5, 0.5, 0.5)), ABOUT)
    (odd / "new").mkdir()
    (odd / "new" / "mppt2.yaml").write_text(text["control/mppt2.yaml"])
    assert load_controller(f"{odd}/new/mppt2.yaml").model_dump()["v_min"] == 0.01


def test_no_search_makes_more_evaluations_than_it_says():
    """Places are tried four at a time; the last round is shorter."""
    search = Search(name="all", seeds=1, length=1500.0, radius=1.0, samples=4, evaluations=6)

    def tried(places):
        return [module.Trial("all", tuple(place), {"P1": float(np.sum(place))}, {}) for place in places]

    rounds = []
    module._search(
        search,
        np.array([0.5, 0.5]),
        lambda row: (0, 1),
        lambda places: rounds.append(tried(places)) or [*rounds[-1]],
        0,
    )
    assert [len(each) for each in rounds] == [4, 2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("semi_active_damper=passive", "is a passive damper"),
        ("semi_active.parameters.0.keys={control.mppt2.nope: 1.0}", "unknown key 'nope'"),
        ("semi_active.parameters.0.keys={damper.nope: 1.0}", "unknown key 'damper.nope'"),
        ("semi_active.parameters.2.low=-5", "threshold_max: found"),
        ("passive.parameters.0.keys={damper.nope: 1.0}", "unknown key 'damper.nope'"),
    ],
)
def test_what_cannot_run_is_refused_before_any_run(change: str, message: str, study: Path):
    class Caught(RunContext):
        def records(self, assess, runs, kind):
            raise Stop(runs)

    with pytest.raises(ConfigError, match=message):
        calibrate(load_calibration(str(study), (change,)), context=Caught())


def test_a_damper_s_path_may_hold_any_sign(study: Path):
    odd = study.parent / "Zug: neu, #1 [x]"
    odd.mkdir()
    (odd / "own.yaml").write_text("base: sayd\nset: {valve.delay: 3.0e-3}\n")
    config = load_calibration(str(study), (f"semi_active_damper='{odd}/own.yaml'",))
    runs = []

    class Caught(RunContext):
        def records(self, assess, made, kind):
            runs.extend(made)
            raise Stop

    vehicle = config.passive.values((0.5, 0.5))
    for asked in (
        lambda: module._Passive(config, Caught())._held([vehicle], [1], 1500.0, Caught()),
        lambda: module._SemiActive(config, vehicle, Caught()).measured(
            [(vehicle, config.semi_active.values((0.5, 0.5, 0.5)))], ROWS_OF_MPPT2, 1, 1500.0
        ),
    ):
        with pytest.raises(Stop):
            asked()
    assert [run.scenario.damper.valve.delay for run in runs] == [3e-3] * len(runs)
    assert len(runs) == HELD + 1


@pytest.mark.parametrize(
    ("files", "message"),
    [("[lqg]", "controller 'lqg': no row is about it"), ("[mine.yaml]", "unknown controller")],
)
def test_files_of_other_controllers_are_refused(
    files: str, message: str, study: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["calibrate", "--config", str(study), "--set", f"controllers={files}", "--json"]) == 2
    assert message in capsys.readouterr().err


def test_large_residuals_count_by_their_logarithm():
    trial = module.Trial("any", (0.5,), {"P1": 0.01, "P2": -50.0}, {})
    assert damped(trial) == pytest.approx([0.01, -3.0 * np.log(100.0 / 3.0)], abs=0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("passive.parameters.friction.low=0.6", "parameters.friction: needs low < high"),
        ("passive.parameters.friction.sorce=x", "unknown key 'passive.parameters.friction.sorce', did you"),
        ("passive.searches.all.samples=3", "search 'all': 3 samples; surfaces over 2 parameters need 4"),
        ("semi_active.searches.all.length=1000", "length: found 1000"),
        ("passive.starts=2", "starts: found 2 with one search"),
        (
            "semi_active.parameters.corner.keys={control.skyhook-onoff.open: 1.0}",
            "found key 'control.skyhook-onoff.open'; expected one that begins with damper., control.mppt1.",
        ),
    ],
)
def test_bad_calibrations_are_refused(change: str, message: str, study: Path):
    with pytest.raises(ConfigError, match=message):
        load_calibration(str(study), (change,))


def test_an_unknown_key_of_a_parameter_is_named(study: Path, capsys: pytest.CaptureFixture[str]):
    study.write_text(study.read_text().replace("damper.series_stiffness", "damper.stiffness"))
    assert main(["calibrate", "--config", str(study), "--json"]) == 2
    assert "unknown key 'damper.stiffness'" in capsys.readouterr().err
