"""The table of the paper's statements: one command, a row for each, the same on any number of threads."""

from __future__ import annotations

import dataclasses
import json
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.config.damper import load_sayd
from sayd_env.config.reproduction import load_reproduction
from sayd_env.config.scenario import Scenario
from sayd_env.config.track import read_track
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.figures import Drawing
from sayd_env.report.html import page_html
from sayd_env.runs import passive
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import RunContext
from sayd_env.runs.executors import ExecutorChoice
from sayd_env.studies.components.hysteresis import hysteresis
from sayd_env.studies.critical_speed import find_critical_speed
from sayd_env.studies.paper.claims import Verdict
from sayd_env.studies.paper.judged import damper_claim, model_claim
from sayd_env.studies.paper.passive_claims import passive_claims
from sayd_env.studies.paper.reproduce import ROWS, ReproduceResult, reproduce, row_policies

pytestmark = pytest.mark.slow
PASSIVE = 7 + 6
RUNS = PASSIVE + 22 + 3 * 5
"""Of one seed: passive ones on two speed grids, those with controllers and with fixed commands."""
SHORT = ["--config", "estimates", "--set", "assessment.run_in=200", "--set", "assessment.length=600"]
ONE = ["--seeds", "1", "--executor", "threads"]


@pytest.fixture(scope="module")
def progress() -> list[tuple[float, float]]:
    return []


@pytest.fixture(scope="module")
def result(short_scenario: Scenario, progress: list[tuple[float, float]]) -> ReproduceResult:
    context = RunContext(
        ExecutorChoice(workers=2), progress=lambda done, total, what="": progress.append((done, total))
    )
    return reproduce(short_scenario, [3], context=context)


def test_every_row_is_judged(result: ReproduceResult):
    assert [claim.id for claim in result.claims] == list(ROWS)
    assert result.claims[:10] == passive_claims(result.new, result.worn, result.limits)
    keys = result.as_dict()
    assert keys["seeds"] == [3]
    for row in keys["claims"]:
        assert {"id", "expected", "measured", "fraction", "holds"} <= set(row)
        assert 0.0 <= row["fraction"] <= 1.0


def test_progress_goes_on_over_all_runs(result: ReproduceResult, progress: list[tuple[float, float]]):
    """In pieces of up to eight runs side by side, and never backwards."""
    done, totals = zip(*progress, strict=True)
    assert set(totals) == {RUNS}
    assert all(0 < b - a <= 8 for a, b in pairwise((0, *done)))
    assert done[-1] == RUNS
    assert PASSIVE in done


class Stop(Exception):
    pass


def interrupted(scenario: Scenario, folder: Path, runs: int) -> int:
    """Stop a study after some runs; the number of the finished ones."""

    def stop(done: float, total: float, what: str = "") -> None:
        if done >= runs:
            raise Stop

    with pytest.raises(Stop):
        reproduce(scenario, [3], context=RunContext(ExecutorChoice(workers=1), RunCache(folder), stop))
    return len(list(folder.glob("*/*.npz")))


def test_an_interrupted_study_goes_on_without_repeating_runs(
    result: ReproduceResult, short_scenario: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Among the passive runs, and again among those with controllers."""
    made: list[passive.PassiveRun] = []

    def counted(runs: list[passive.PassiveRun]) -> Any:
        made.extend(runs)
        return simulated(runs)

    simulated = passive.simulated
    monkeypatch.setattr(passive, "simulated", counted)
    assert 4 <= interrupted(short_scenario, tmp_path, 4) < PASSIVE
    finished = interrupted(short_scenario, tmp_path, PASSIVE + 3)
    assert PASSIVE + 3 <= finished < RUNS
    assert len(made) == PASSIVE

    def again() -> tuple[ReproduceResult, int]:
        cache = RunCache(tmp_path)
        return reproduce(short_scenario, [3], context=RunContext(cache=cache)), cache.reused

    second, reused = again()
    assert (len(made), reused) == (PASSIVE, finished)
    assert second.claims == result.claims
    _, reused = again()
    assert (len(made), reused) == (PASSIVE, RUNS + len(second.histories))


def test_runs_of_another_vehicle_are_not_taken_for_finished(short_scenario: Scenario, tmp_path: Path):
    for friction, reused in ((0.4, 0), (0.3, 0), (0.4, 1)):
        cache = RunCache(tmp_path)
        other = short_scenario.model_copy(update={"friction": friction})
        passive.sweep(other, [80.0], [3], RunContext(cache=cache))
        assert cache.reused == reused


def test_wear_is_0_and_1_in_turn(result: ReproduceResult, short_scenario: Scenario):
    for grid, wear in ((result.new, 0.0), (result.worn, 1.0)):
        scenario = short_scenario.model_copy(update={"wear": wear})
        (run,) = passive.assessed([passive.PassiveRun(scenario, float(grid.speeds[0]), 3)])
        assert (grid.acceleration[0, 0] == run.acceleration).all()
    assert result.worn.speeds == pytest.approx(load_reproduction().speeds("worn"))


def test_the_model_is_counted(short_model: VehicleModel):
    """62 degrees of freedom, 8 yaw dampers of 6 states: Wang et al. (2022), section 2."""
    claim = model_claim(short_model)
    assert (claim.measured, claim.holds) == ("62, 8 and 6", True)


def test_a_loop_that_dissipates_nothing_fails_row_11(short_scenario: Scenario):
    loops = hysteresis(short_scenario, [2e-3], [2.0])
    assert damper_claim(loops).holds
    loop = loops.loops[0]
    backwards = loop.cycle._replace(force=-loop.cycle.force)
    broken = dataclasses.replace(loops, loops=(dataclasses.replace(loop, cycle=backwards),))
    assert not damper_claim(broken).holds


def test_the_command_writes_claims_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["reproduce", *SHORT, *ONE, "--json", "--out", str(tmp_path)]) == 0
    content = json.loads(capsys.readouterr().out)
    assert [claim["id"] for claim in content["claims"]] == list(ROWS)
    assert content["seeds"] == [9100]
    files = {path.name for path in tmp_path.iterdir()}
    assert {"result.json", "claims.csv", "runs_new.csv", "runs_worn.csv", "runs_controlled.csv"} <= files
    assert {"figure_01_conicity.png", "figure_08_new_wheels.png", "figure_10_worn_wheels.png"} <= files
    drawn = {name[:9] for name in files if name.startswith("figure")}
    assert drawn == {f"figure_{i:02d}" for i in (1, 2, 3, 8, *range(10, 19))}
    page = (tmp_path / "report.html").read_text()
    assert page.count('src="data:image/png;base64,') == len([f for f in files if f.endswith(".png")])
    assert "<td>damper</td>" not in page  # the estimates are not calibrated


def test_strict_fails_with_the_rows_that_do_not_hold_and_are_not_allowed_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    # A second, smaller damper curve: no vehicle is stable at every speed of the paper with a hundredth of it.
    weak = ["--set", "damper.curve=[[0, 0], [0.2, 120.0], [1.0, 150.0]]"]
    command = ["reproduce", *SHORT, *weak, *ONE, "--json", "--out", str(tmp_path), "--strict"]
    assert main(command) == 1
    out, err = capsys.readouterr()
    failed = [claim["id"] for claim in json.loads(out)["claims"] if not claim["holds"]]
    assert failed
    assert f"sayd: error: rows that do not hold: {', '.join(failed)}" in err
    assert main([*command, "--allow", ",".join(failed)]) == 0
    capsys.readouterr()
    assert main([*command, "--allow", ",".join(failed[1:])]) == 1
    assert f"sayd: error: rows that do not hold: {failed[0]}" in capsys.readouterr().err
    assert main([*command, "--allow", "P12"]) == 2
    assert "--allow P12: unknown row; expected P1, P2" in capsys.readouterr().err


def test_fixed_commands_go_through_the_same_rows(result: ReproduceResult):
    """Rows about passive dampers have no controller; those about the command's motion do not apply."""
    beside = {claim.id: claim.fixed for claim in result.claims}
    assert all((beside[row] == {}) is row.startswith(("P", "C2")) for row in ROWS)
    assert list(beside["M1"]) == ["constant:0", "constant:1", "constant-tuned"]
    for row in ("M3", "M4", "M6", "M7", "S2", "S5"):
        assert beside[row]["constant:1"] == Verdict("stays at 100 %")
    for claim in result.as_dict()["claims"]:
        assert set(claim) == {"id", "by", "expected", "measured", "fraction", "holds", "fixed"}
    runs = result.controlled
    (closed,), (mppt1,) = (runs.at(policy, 300) for policy in ("constant:0", "mppt1"))
    assert beside["M9"]["constant:0"].holds is (closed.force_rms < mppt1.force_rms)
    header, rows = result.tables()["claims"]
    (m1,) = (dict(zip(header, row, strict=True)) for row in rows if row[0] == "M1")
    assert m1["constant:0 holds"] is beside["M1"]["constant:0"].holds


def test_dampers_and_controllers_from_files(short_scenario: Scenario, tmp_path: Path):
    """A copy under another roof changes nothing, another number does; all else is the packaged one's."""
    study = load_reproduction(overrides=["fixed=[]"])
    packaged = resources.files("sayd_env.configs")
    copied, other = tmp_path / "own" / "mppt1.yaml", tmp_path / "other" / "mppt1.yaml"
    text = packaged.joinpath("control", "mppt1.yaml").read_text()
    for path in (copied, other):
        path.parent.mkdir()
        path.write_text(text if path == copied else f"{text}v_min: 0.5\n")

    def command(file: Path | None, opening: float | None = None) -> tuple[float, float]:
        damper = load_sayd("sayd")
        if opening is not None:
            damper = damper.model_copy(
                update={"relief": damper.relief.model_copy(update={"opening": opening})}
            )
        policies = row_policies([] if file is None else [str(file)])
        found = reproduce(short_scenario, [3], study=study, sayd=damper, policies=policies, context=context)
        (run,) = found.controlled.at("mppt1", 400)
        return float(run.command.min()), run.force_rms

    context = RunContext()
    own = command(None)
    assert command(copied) == own
    assert command(other)[0] >= 0.5 > own[0]
    assert command(None, 2e6)[1] != own[1]


def test_the_command_takes_dampers_and_controllers_from_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Copies of the packaged files change no row; result.json holds what was used."""
    nominal = SHORT[2:]
    packaged, files = resources.files("sayd_env.configs"), {}
    for kind, name in (("damper", "passive"), ("damper", "sayd"), ("control", "skyhook-onoff")):
        files[name] = tmp_path / f"{name}.yaml"
        files[name].write_text(packaged.joinpath(kind, f"{name}.yaml").read_text())
    own = ["--damper", files["passive"], "--sayd", files["sayd"], "--controllers", files["skyhook-onoff"]]
    contents = []
    for more in ([], map(str, own)):
        assert main(["reproduce", *nominal, *ONE, "--json", *more]) == 0
        contents.append(json.loads(capsys.readouterr().out))
    first, second = contents
    assert second["claims"] == first["claims"]
    assert second["config"]["sayd"] == first["config"]["sayd"]
    assert second["config"]["controllers"] == first["config"]["controllers"]
    assert main(["reproduce", "--damper", "sayd"]) == 2


def test_files_of_other_controllers_are_refused(tmp_path: Path):
    path = tmp_path / "constant.yaml"
    path.write_text("current: 0.3\n")
    with pytest.raises(ConfigError, match="controller 'constant': no row is about it; expected mppt1, mppt2"):
        row_policies([str(path)])


def test_rows_under_other_assumptions(short_scenario: Scenario):
    """As judged by themselves; the law is Polach's, the irregularities are another track's."""
    study = load_reproduction(
        overrides=[
            "fixed=[]",
            "assumptions=[{name: p, creep_law: polach, seeds: 1}, {name: c, track: china, seeds: 2}]",
        ]
    )
    progress: list[tuple[float, float]] = []
    context = RunContext(progress=lambda done, total, what="": progress.append((done, total)))
    found = reproduce(short_scenario, [3, 4], study=study, assumptions=True, context=context)
    assert progress[-1] == (35 * 5, 35 * 5)
    assert {name: judged.new.seeds for name, judged in found.assumptions.items()} == {"p": (3,), "c": (3, 4)}
    china = short_scenario.track.model_copy(update={"irregularity": read_track("china").irregularity})
    contact = short_scenario.contact.model_copy(update={"creep_law": "polach"})
    for name, changed in (("p", {"contact": contact}), ("c", {"track": china})):
        scenario, judged = short_scenario.model_copy(update=changed), found.assumptions[name]
        alone = find_critical_speed(scenario.model_copy(update={"wear": 0.0}), seeds=judged.new.seeds)
        assert (alone.sweep.acceleration == judged.new.acceleration).all()
        assert judged.controlled.runs[0].force_rms != found.controlled.runs[0].force_rms
    keys = found.as_dict()
    assert {row["assumption"] for row in keys["assumptions"]} == {"study", "p", "c"}
    assert len(keys["assumptions"]) == 3 * len(ROWS)
    assert len(keys["critical_speeds"]) == 3 * 4
    drawings = dict.fromkeys(found.plots(), Drawing(b"", {}))
    page = page_html(found.page(), drawings, {})
    assert "What each assumption carries" in page
    assert "p, 1 seeds" in page


def test_rows_on_skyhook_at_another_control_period(short_scenario: Scenario):
    """At the period that the environment has anyway, the rows are the same ones."""
    study = load_reproduction(overrides=["fixed=[]"])
    found = reproduce(short_scenario, [3], study=study, control_periods=[0.01])
    rows = [claim for claim in found.claims if claim.id.startswith("S")]
    assert found.by_period[0.01] == rows
    assert {entry["control_period_s"] for entry in found.as_dict()["control_periods"]} == {0.01}


def test_critical_speeds_by_creep_law(short_scenario: Scenario):
    """On new and on worn wheels as `find_critical_speed` finds them; progress ends at all."""
    speeds = (300 / 3.6, 400 / 3.6)
    study = load_reproduction(overrides=["speeds_kmh.creep_laws=[300.0, 400.0]", "fixed=[]"])
    progress: list[tuple[float, float]] = []
    context = RunContext(progress=lambda done, total, what="": progress.append((done, total)))
    found = reproduce(short_scenario, [3], study=study, creep_laws=["polach"], context=context)
    assert progress[-1][0] == progress[-1][1]
    keys = found.as_dict()["by_creep_law"]
    for wheels, wear in (("new", 0.0), ("worn", 1.0)):
        contact = short_scenario.contact.model_copy(update={"creep_law": "polach"})
        scenario = short_scenario.model_copy(update={"wear": wear, "contact": contact})
        alone = find_critical_speed(scenario, speeds, [3]).as_dict()
        assert keys[wheels]["polach"]["by_criterion"] == alone["by_criterion"]
    assert {"creep_laws_new", "creep_laws_worn"} <= set(found.tables())
