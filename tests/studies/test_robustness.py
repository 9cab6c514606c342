"""Policies with disturbances and faults: none is left out, and what is asked is judged."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from matplotlib.figure import Figure

from sayd_env.cli import main
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import load_environment
from sayd_env.config.fault import Fault
from sayd_env.config.robustness import Axis, RobustnessConfig, load_robustness, single_faults
from sayd_env.config.scenario import load_scenario
from sayd_env.config.sensors import KINDS, SIGNALS
from sayd_env.report.figures import drawing
from sayd_env.report.html import page_html
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import Row, rows
from sayd_env.runs.policies import policy_spec
from sayd_env.studies.robustness import (
    FAULT,
    UNDISTURBED,
    Disturbance,
    RobustnessResult,
    _Study,
    _undisturbed,
    disturbance_of,
    robustness,
)

ENVIRONMENT = """
base: nominal
study: estimates
sensors: realistic
run_in: 500.0
faults:
  count: {distribution: fixed, value: 1}
  onset: {distribution: fixed, value: 0.0}
  kinds:
    - {kind: damper_lost}
    - {kind: sensor_dead, sensors: [lateral_acceleration]}
"""


def test_no_fault_is_left_out() -> None:
    """Every kind of the schema; of sensors' faults every kind of sensor; of valves both ends and the middle.

    The schema is the list of what can fail: a fault that is added to it is missed here until it is run.
    """
    config = load_robustness()
    environment = load_environment(config.faults)
    assert environment.faults is not None
    found = list(single_faults(environment.faults.kinds, config.places, environment.sensors, 1.0).values())
    kinds = {get_args(each.model_fields["kind"].annotation)[0] for each in get_args(get_args(Fault)[0])}
    assert {each.kind for each in found} == kinds
    for kind in (each for each in kinds if each.startswith("sensor")):
        sensors = {SIGNALS[each.signal] for each in found if each.kind == kind}  # type: ignore[union-attr]
        assert sensors == set(KINDS), kind
    stuck = sorted(each.current for each in found if each.kind == "valve_stuck")
    assert stuck == pytest.approx([0.0, 0.5, 1.0])
    assert all(each.start_s == 1.0 for each in found)


def test_the_largest_error_of_a_sensor_is_taken() -> None:
    """Half the range of the accelerometers is 100 m/s2, of the pressures 80 bar; shares as in faults.yaml."""
    config, environment = load_robustness(), load_environment("faults")
    assert environment.faults is not None
    shares = {each.kind: each.share.bounds[1] for each in environment.faults.kinds if hasattr(each, "share")}
    found = single_faults(environment.faults.kinds, config.places, environment.sensors, 0.0)
    biased = found["sensor biased, lateral_acceleration.front.leading"]
    noisy = found["sensor noisy, pressure_a.front.left.upper"]
    assert biased.bias == pytest.approx(100.0 * shares["sensor_biased"])  # type: ignore[union-attr]
    assert noisy.noise == pytest.approx(80e5 * shares["sensor_noisy"])  # type: ignore[union-attr]


def test_a_disturbance_changes_its_own_quantity() -> None:
    scenario, environment = load_scenario("estimates", ["damper=sayd-estimate"]), load_environment("training")
    assert isinstance(scenario.damper, SaydDamperConfig)
    before = scenario.damper.valve
    later = disturbance_of(Axis(name="a", quantity="delay", values=(0.02,)), 0.02).scenario(scenario).damper
    slower = disturbance_of(Axis(name="b", quantity="lag", values=(4.0,)), 4.0).scenario(scenario).damper
    assert isinstance(later, SaydDamperConfig)
    assert isinstance(slower, SaydDamperConfig)
    assert later.valve.delay == pytest.approx(before.delay + 0.02)
    assert slower.valve.natural_frequency == pytest.approx(before.natural_frequency / 4.0)
    assert Disturbance("c", "wear", 1.1).scenario(scenario).wear == 1.1
    loud = Disturbance("d", "sensor_noise", 8.0).environment(environment).randomisation
    assert (loud.sensor_noise.bounds, loud.payload) == ((8.0, 8.0), environment.randomisation.payload)
    none = Disturbance(UNDISTURBED)
    assert none.scenario(scenario) is scenario
    assert none.environment(environment) is environment


def made_up(costs: dict[tuple[str, str], list[float]], **changes: Any) -> RobustnessResult:
    """Two conditions with one seed; J by policy and disturbance."""
    names = [each.name for each in dataclasses.fields(Row)]

    def row(policy: str, cost: float) -> Row:
        values: dict[str, Any] = dict.fromkeys(names, 0.5) | {"policy": policy, "seed": 1, "J": cost}
        ending = "derailed" if math.isnan(cost) else None
        return Row(**values | {"ending": ending, "J": 9.0 if ending else cost, "fallback_share": None})

    (fault,) = (
        fault
        for name, fault in single_faults(
            load_environment("faults").faults.kinds,  # type: ignore[union-attr]
            load_robustness().places,
            load_environment("faults").sensors,
            0.0,
        ).items()
        if name.startswith("power lost")
    )
    worn = Axis(name="wear", quantity="wear", values=(1.1,))
    lost = Disturbance(FAULT, fault=fault, title="power lost")
    disturbances = (Disturbance(UNDISTURBED), disturbance_of(worn, 1.1), lost)
    config = load_robustness(overrides=["seeds=[1]", "axes=[{name: wear, quantity: wear, values: [1.1]}]"])
    costs = costs | {
        (policy, "wear 1.1"): values for (policy, title), values in costs.items() if title == "none"
    }
    config = config.model_copy(update={"conditions": config.conditions[:2]})
    runs = {key: [row(key[0], cost) for cost in values] for key, values in costs.items()}
    judged = tuple(dict.fromkeys(policy for policy, _ in costs if policy not in ("passive", "constant:0.3")))
    return RobustnessResult(config, disturbances, judged, ("constant:0.3",), runs, **changes)


RESULT = {
    ("passive", "none"): [0.10, 0.20],
    ("passive", "power lost"): [0.10, 0.20],
    ("constant:0.3", "none"): [0.08, 0.10],
    ("constant:0.3", "power lost"): [0.30, 0.50],
    ("good", "none"): [0.10, 0.204],  # 2 % above the passive one's
    ("good", "power lost"): [0.19, 0.55],  # below twice; 10 % above the best constant
    ("bad", "none"): [0.09, 0.21],  # 5 % above
    ("bad", "power lost"): [0.34, 0.20],  # 3.4 times, and 13 % above the best constant
    ("off", "none"): [0.05, 0.05],
    ("off", "power lost"): [0.05, math.nan],  # derails
}


def test_what_is_asked_is_judged_condition_by_condition() -> None:
    """By hand: twice the passive vehicle's, or 10 % above the best constant command; 2 % without a fault."""
    found = {(each.policy, each.disturbance): each for each in made_up(RESULT).outcomes}
    assert {key: each.holds for key, each in found.items()} == {
        ("good", "none"): True,
        ("good", "power lost"): True,
        ("bad", "none"): False,
        ("bad", "power lost"): False,
        ("off", "none"): True,
        ("good", "wear 1.1"): True,
        ("bad", "wear 1.1"): False,
        ("off", "wear 1.1"): True,
        ("off", "power lost"): False,
    }
    bad = found["bad", "power lost"]
    assert pytest.approx(0.27) == bad.J
    assert bad.to_passive == pytest.approx(3.4)
    assert bad.to_best_constant == pytest.approx(0.34 / 0.30)
    assert found["off", "power lost"].derailed == 1


def test_a_result_is_shown(read_page: Callable[[str], Any], printed: Callable[[Any], str]) -> None:
    result = made_up(RESULT)
    printed(result)
    assert result.as_dict()["verdicts"][0]["faults_met"] == 1
    drawings = {name: drawing(draw) for name, draw in result.plots().items()}
    page = read_page(page_html(result.page(), drawings, {"config": {}}))
    assert page.pictures == [drawings["robustness_axes"].png, drawings["robustness_faults"].png]
    assert "power lost" in page.text
    assert len(result.tables()["runs"][1]) == 5 * 3 * 2  # type: ignore[arg-type]


def test_quantities_have_their_true_places_and_what_was_trained_is_a_span() -> None:
    """Conditions of wear 1.0 and 0.7: level over this span as without a disturbance, then to 1.1."""
    figure = Figure()
    made_up(RESULT).plots()["robustness_axes"](figure)
    (panel,) = figure.axes
    assert panel.get_xlabel() == "wear (-)"
    assert list(panel.get_xticks()) == [0.7, 1.0, 1.1]
    line = next(line for line in panel.lines if line.get_label() == "bad")
    np.testing.assert_array_equal(line.get_xdata(), [0.7, 1.0, 1.1])
    np.testing.assert_allclose(line.get_ydata(), 1.05)
    assert line.get_markevery() == [2]  # a marker where there is a value
    assert line.get_markerfacecolor() == "none"
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"undisturbed", "passive", "good", "bad", "off"} == {*names}


def test_what_is_asked_with_a_fault_is_in_the_legend() -> None:
    figure = Figure()
    made_up(RESULT).plots()["robustness_faults"](figure)
    assert "asked: at most 2" in [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize(
    ("quantity", "low", "high"),
    [
        *(("delay", 0.0, 0.0), ("lag", 1.0, 1.0), ("wear", 0.5, 1.0), ("friction", 0.25, 0.45)),
        *(("sensor_noise", 0.5, 2.0), ("payload", -0.17, 0.0)),
    ],
)
def test_spans_are_those_of_conditions_and_environment(quantity: Any, low: float, high: float) -> None:
    """As the comments of robustness.yaml say."""
    config = load_robustness()
    environment = load_environment(config.environment)
    assert _undisturbed(quantity, config.conditions, environment) == pytest.approx((low, high))


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> RobustnessConfig:
    """One short run on an even track, two faults."""
    path = tmp_path_factory.mktemp("robust") / "env.yaml"
    path.write_text(ENVIRONMENT)
    changes = [f"environment={path}", f"faults={path}", "track=smooth", "seeds=[3]", "episode_s=7.0"]
    changes += ["axes=[]", "constants=[0.3]", "onset=0.5"]
    changes += ["conditions=[{speed_kmh: 300.0, wear: 0.0, friction: 0.3}]"]
    return load_robustness(overrides=changes)


@pytest.fixture(scope="module")
def result(config: RobustnessConfig) -> RobustnessResult:
    """Of a constant command, in the fallback and out of it."""
    return robustness(config, [policy_spec(name) for name in ("constant:0.3", "safe:constant:0.3")])


def test_a_dead_sensor_moves_no_open_loop(config: RobustnessConfig, result: RobustnessResult) -> None:
    """The study does not run it: what it takes instead, the run without a fault, has the same numbers."""
    study, policy = _Study(config), policy_spec("constant:0.3")
    dead = next(each for each in study.disturbances if "dead" in each.title)
    assert not dead.felt_by(policy)
    assert rows(study.runs(policy, dead), RunContext()) == result.runs["constant:0.3", UNDISTURBED]
    lost = next(each for each in study.disturbances if "damper" in each.title)
    assert result.runs["passive", lost.title] != result.runs["passive", UNDISTURBED]


def test_a_fallback_that_never_trips_costs_nothing(result: RobustnessResult) -> None:
    """On an even track no bogie hunts at 300 km/h on new wheels: all numbers are the same."""
    (inside,), (guarded,) = result.runs["constant:0.3", "none"], result.runs["safe:constant:0.3", "none"]
    assert guarded.fallback_share == 0.0
    assert inside.fallback_share is None
    assert dataclasses.replace(guarded, policy="constant:0.3", fallback_share=None) == inside


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("axes=[{name: a, quantity: wear, values: [1.5]}]", "wear: found 1.5; allowed are 0 to 1.2"),
        ("axes=[{name: a, quantity: mass, values: [1.0]}]", "expected 'sensor_noise', 'delay'"),
        ("places.dampers=[front]", "dampers: found 'front'"),
        ("places.signals.speed=[]", "found none of the kind speed"),
        ("places.signals.speed=[stroke.front.left.upper]", "no signal of this kind"),
        ("onset=50", "onset 50 s must be below"),
        ("faults=randomized", "'randomized' has none"),
        ("conditions.0.speed_kmh=900", "speed_kmh"),
        ("seeds=[1, 1]", "duplicate"),
    ],
)
def test_what_cannot_be_is_refused(change: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robustness", "--set", change, "--json"]) == 2
    assert said in capsys.readouterr().err


def test_a_policy_that_nothing_can_close_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("safe:passive", "safe:safe:mppt2", "safe:nobody"):
        assert main(["robustness", "--policies", name, "--json", "--out", str(tmp_path)]) == 2
        assert name.removeprefix("safe:") in capsys.readouterr().err
