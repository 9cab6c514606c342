"""Calibration: what a place in the ranges sets, what a row's penalty is, and runs that are not lost."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config import ConfigError, StudyError
from sayd_env.config.calibration import CalibrationConfig, load_calibration
from sayd_env.config.scenario import load_scenario
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import RunContext
from sayd_env.runs.passive import Sweep, sweep
from sayd_env.stability import Limits
from sayd_env.studies.tuning import calibrate as module
from sayd_env.studies.tuning.calibrate import Trial, assignments, calibrate, penalties_of, residuals_of

STUDY = """
base: {base}
first_seed: 1000
screening_samples: 2
screening_seeds: 1
searches: []
new_speeds: [77.7778, 94.4444, 102.7778, 111.1111]
worn_speeds: [88.8889, 97.2222, 102.7778, 116.6667]
parameters:
  - name: series stiffness
    unit: N/m
    low: 3.0e+6
    high: 12.0e+6
    guess: 5.0e+6
    scale: log
    keys: {{damper.series_stiffness: 1.0}}
    source: made up
  - name: friction
    unit: "-"
    low: 0.3
    high: 0.5
    guess: 0.35
    keys: {{friction: 1.0, contact_damping: 2.0e+5}}
    source: made up
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """A calibration of two numbers over a short distance."""
    base = tmp_path / "short.yaml"
    base.write_text("base: estimates\nassessment: {run_in: 200.0, length: 600.0}\n")
    path = tmp_path / "small.yaml"
    path.write_text(STUDY.format(base="./short.yaml"))
    return path


@pytest.fixture
def config(study: Path) -> CalibrationConfig:
    return load_calibration(str(study))


def test_a_place_sets_values_times_factors(config: CalibrationConfig):
    """Half of a log range is the geometric mean, a quarter of a linear one a quarter of the way."""
    assert assignments(config, (0.5, 0.25)) == pytest.approx(
        {"damper.series_stiffness": 6e6, "friction": 0.35, "contact_damping": 0.35 * 2e5}
    )
    assert assignments(config, (0.0, 1.0))["damper.series_stiffness"] == 3e6
    stiffness = config.parameters[0]
    assert stiffness.place(stiffness.value(0.3)) == pytest.approx(0.3)


def test_the_packaged_calibration_sets_numbers_that_a_scenario_takes():
    config = load_calibration()
    for place in (0.0, 0.5, 1.0):
        values = assignments(config, [place] * len(config.parameters))
        load_scenario(config.base, [f"{key}={value!r}" for key, value in values.items()])
    assert config.first_seed > 9  # tracks of the reproduction take no part


@pytest.fixture
def rows(synthetic: Callable[..., Sweep], limits: Limits) -> Callable[..., tuple[dict[str, float], ...]]:
    """Penalties and measures of made-up sweeps with known crossings (km/h)."""

    def rows(
        new: float = 375.0, worn: float = 331.0, force: float = 361.0, trailing: float = 1.25
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
        return penalties_of(first, second, limits)

    return rows


Rows = Callable[..., tuple[dict[str, float], ...]]


def test_a_vehicle_like_the_papers_has_no_penalty(rows: Rows):
    penalties, measures = rows()
    assert list(penalties) == [f"P{i}" for i in range(1, 11)]
    assert set(penalties.values()) == {0.0}
    assert measures["critical_new_kmh"] == pytest.approx(375.0)
    assert measures["critical_worn_kmh"] == pytest.approx(331.0)
    assert measures["critical_force_kmh"] == pytest.approx(361.0)
    assert measures["trailing_ratio"] == pytest.approx(1.25)
    assert measures["spread_350_hz"] == pytest.approx(0.1)


@pytest.mark.parametrize("new", [365.0, 390.0, 450.0])
def test_the_critical_speed_goes_on_beyond_the_grid(new: float, rows: Rows):
    """A line that would cross at 450 km/h says so, although the grid ends at 400 km/h."""
    penalties, measures = rows(new=new)
    assert measures["critical_new_kmh"] == pytest.approx(new)
    assert penalties["P2"] == pytest.approx(min((abs(new - 372) - 4) / 6, 8.0))


def test_a_crossing_below_the_grid_goes_on_as_well(rows: Rows):
    penalties, measures = rows(worn=300.0)
    assert measures["critical_worn_kmh"] == pytest.approx(300.0)
    assert penalties["P5"] == pytest.approx((31 - 4) / 5)


def test_other_rows_measure_their_distance(rows: Rows):
    assert rows(trailing=1.05)[0]["P9"] == pytest.approx((1.15 - 1.05) / 0.05)
    ratio_320 = 1 + (320 - 312) / 200
    assert rows(worn=312.0)[0]["P4"] == pytest.approx((ratio_320 - 0.96) / 0.04)


class Stop(Exception):
    pass


def test_an_interrupted_calibration_goes_on_where_it_stopped(config: CalibrationConfig, tmp_path: Path):
    """Four speeds on new and four on worn wheels for each evaluation."""
    told: list[float] = []

    def stop(done: float, total: float, what: str = "") -> None:
        told.append(done)
        if len(told) == 2:
            raise Stop

    more = config.model_copy(update={"screening_samples": 3})
    with pytest.raises(Stop):
        calibrate(more, context=RunContext(cache=RunCache(tmp_path), progress=stop))
    assert len(list(tmp_path.glob("*/*.npz"))) == 2 * 8
    told = [0.0, 0.0]
    cache = RunCache(tmp_path)
    result = calibrate(more, context=RunContext(cache=cache, progress=stop))
    assert told[2:] == [1, 2, 3]
    assert cache.reused == 2 * 8
    assert result.evaluations == calibrate(more).evaluations
    assert result.best.cost == min(e.cost for e in result.evaluations)


def test_no_finite_run_at_all_is_a_failed_study(config: CalibrationConfig, monkeypatch: pytest.MonkeyPatch):
    def diverged(*_: object) -> Trial:
        return Trial("screening", (0.0, 0.0), module.DIVERGED, {}, {})

    monkeypatch.setattr(module, "_evaluate", diverged)
    with pytest.raises(StudyError, match="no parameters within the ranges gave a finite run"):
        calibrate(config)


def test_two_evaluations_are_what_their_assignments_give(
    study: Path, config: CalibrationConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "out"
    assert main(["calibrate", "--config", str(study), "--json", "--out", str(out)]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["evaluations"] == 2
    assert {path.name for path in out.iterdir()} == {
        "result.json",
        "evaluations.csv",
        "runs",
        "cost.png",
        "nominal.yaml",
    }
    keys = [f"{key}={value!r}" for key, value in content["set"].items()]
    wheels = [load_scenario(config.base, [*keys, f"wear={wear}"]) for wear in (0.0, 1.0)]
    grids = (config.new_speeds, config.worn_speeds)
    new, worn = (sweep(each, speeds, [1000]) for each, speeds in zip(wheels, grids, strict=True))
    penalties, measures = penalties_of(new, worn, model_limits(VehicleModel(wheels[0])))
    assert content["penalties"] == pytest.approx(penalties, rel=1e-12)
    residuals = residuals_of(penalties, measures)
    assert content["cost"] == pytest.approx(np.sum(np.square(residuals)), rel=1e-12)
    rows = (out / "evaluations.csv").read_text().splitlines()
    assert rows[1].startswith("screening,")
    assert [float(x) for x in rows[1].split(",")[2:4]] == pytest.approx([5e6, 0.35])  # the guess comes first
    for parameter in config.parameters:
        assert parameter.low <= content["parameters"][parameter.name] <= parameter.high


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("new_speeds=[100.0, 90.0]", "new_speeds: .*speeds must be positive and rise: 90 follows 100"),
        ("new_speeds=[90.0]", "at least 2 entries"),
        ("parameters.friction.low=0.6", "parameters.friction: needs low < high"),
        ("parameters.friction.sorce=x", "unknown key 'parameters.friction.sorce', did you mean 'source'"),
        ("parameters.friction.guess=0.6", "parameters.friction: the guess must lie within the range"),
        ("screening_samples=0", "screening_samples: found 0; .*greater than or equal to 1"),
    ],
)
def test_bad_calibrations_are_refused(change: str, message: str, study: Path):
    with pytest.raises(ConfigError, match=message):
        load_calibration(str(study), (change,))


def test_an_unknown_key_of_a_parameter_is_named(study: Path, capsys: pytest.CaptureFixture[str]):
    study.write_text(study.read_text().replace("damper.series_stiffness", "damper.stiffness"))
    assert main(["calibrate", "--config", str(study), "--json"]) == 2
    assert "unknown key 'damper.stiffness'" in capsys.readouterr().err
