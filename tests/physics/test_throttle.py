"""The throttle's characteristic field: closed forms, files put in from outside, and files refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.config.damper import (
    EqualPercentageThrottle,
    OrificeThrottle,
    SaydDamperConfig,
    SpringValve,
    TableThrottle,
    Throttle,
    load_sayd,
)
from sayd_env.config.scenario import load_scenario
from sayd_env.measured.valves import ThrottleField, read_valve_map
from sayd_env.physics.sayd import rectified_flow, steady_force
from sayd_env.physics.throttle import (
    DROP_ROOT,
    DROP_SCALE,
    ROOT_STEP,
    ROOTS,
    _series_table,
    overlap,
    series_table,
    spring_valve_drop,
    spring_valve_flow,
    throttle_field,
)

CHECK = SpringValve(opening=0.2e5, full=0.5e5, nominal_flow=6.667e-4, nominal_drop=5e5)


ORIFICE = OrificeThrottle(
    type="orifice",
    discharge=0.65,
    density=860.0,
    closed_area=1e-7,
    open_area=7.5e-6,
    overlap=0.37,
    exponent=0.9,
)


def with_throttle(kind: str) -> SaydDamperConfig:
    """The packaged damper, its throttle equal-percentage, or the same damper with an orifice throttle."""
    damper = load_sayd("sayd")
    return damper.model_copy(update={"throttle": ORIFICE}) if kind == "orifice" else damper


def conductance(throttle: Throttle, current: float) -> float:
    """Q / sqrt(dp) by formula, C_d a sqrt(2 / rho)."""
    if isinstance(throttle, EqualPercentageThrottle):
        area = throttle.closed_area * throttle.ratio**current
    else:
        assert isinstance(throttle, OrificeThrottle)
        travel = max(0.0, (current - throttle.overlap) / (1.0 - throttle.overlap))
        area = throttle.closed_area + (throttle.open_area - throttle.closed_area) * travel**throttle.exponent
    return throttle.discharge * area * math.sqrt(2.0 / throttle.density)


KINDS = ["orifice", "equal_percentage"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("current", [0.0, 0.25, 0.5, 1.0])
def test_field_is_the_orifice_equation(current: float, kind: str) -> None:
    throttle = with_throttle(kind).throttle
    assert throttle.type == kind
    drop = np.array([1e3, 1e5, 3e6, 2e7])
    flow = throttle_field(throttle).at(current, drop)
    np.testing.assert_allclose(flow, conductance(throttle, current) * np.sqrt(drop), rtol=1e-9)


def test_spring_valve_has_the_three_branches_of_equation_24() -> None:
    q_s = 6.667e-4 * math.sqrt(0.1)
    expected = [0.0, 0.0, 0.5 * q_s, q_s, 6.667e-4]
    np.testing.assert_allclose(spring_valve_flow(CHECK, [-1e5, 0.2e5, 0.35e5, 0.5e5, 5e5]), expected)
    flow = np.linspace(1e-6, 1e-3, 50)
    np.testing.assert_allclose(spring_valve_flow(CHECK, spring_valve_drop(CHECK, flow)), flow)


def test_the_overlap_ends_where_the_flow_begins_to_rise(tmp_path: Path) -> None:
    assert overlap(ORIFICE) == 0.37
    for rows, end in (
        ("0,0.2,0.6,1\n0,0,0,0,0\n1,1,1,2,3\n2,2,2,3,4\n", 0.2),
        ("0,1\n0,0,0\n1,1,2\n", 0.0),
    ):
        (tmp_path / "table.csv").write_text(f"dp [bar] i [-] Q [l/min],{rows}")
        assert overlap(TableThrottle(type="table", file=str(tmp_path / "table.csv"))) == end


def test_an_equal_percentage_throttle_opens_by_equal_shares() -> None:
    """Equal steps of the current multiply the flow by the same factor, to 50 times the first."""
    throttle = EqualPercentageThrottle(
        type="equal_percentage", discharge=0.65, density=860.0, closed_area=1e-7, ratio=50.0
    )
    flow = throttle_field(throttle).at(np.linspace(0.0, 1.0, 5), 1e6)
    np.testing.assert_allclose(flow[1:] / flow[:-1], 50.0**0.25, rtol=1e-3)
    assert flow[0] == pytest.approx(0.65 * 1e-7 * math.sqrt(2e6 / 860.0), rel=1e-12)
    assert flow[-1] / flow[0] == pytest.approx(50.0, rel=1e-12)
    assert overlap(throttle) == 0.0


def test_the_series_table_solves_the_series() -> None:
    """At each node the drops over throttle and check valves add up, for two formulas and a table."""
    check = load_sayd("sayd").rectifier
    bent = ThrottleField(
        np.array([0.0, 0.4, 1.0]),
        np.array([0.0, 1e4, 3e5, 4e6]),
        np.array([[0.0, 1e-6, 5e-6, 4e-5], [0.0, 1e-6, 5e-5, 2e-4], [0.0, 3e-5, 4e-4, 2e-3]]),
    )
    over = (DROP_ROOT + ROOT_STEP * np.arange(ROOTS)) ** 2 - DROP_SCALE
    for field in (*(throttle_field(with_throttle(kind).throttle) for kind in KINDS), bent):
        for current in field.current:
            flow = _series_table(field, np.array([current] * 2), check)[0]
            rest = over - 2.0 * (spring_valve_drop(check, flow) - check.opening)
            np.testing.assert_allclose(field.at(current, np.maximum(rest, 0.0)), flow, rtol=1e-6, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("current", [0.0, 0.1, 0.5, 1.0])
def test_rectifier_adds_two_check_valves_in_series(current: float, kind: str) -> None:
    """At a given flow the drops of throttle and check valves add up; the flow is odd in the whole drop."""
    config = with_throttle(kind)
    throttle_drop = np.array([2e4, 1e5, 1e6, 5e6])
    flow = conductance(config.throttle, current) * np.sqrt(throttle_drop)
    drop = throttle_drop + 2.0 * spring_valve_drop(config.rectifier, flow)
    table = series_table(config.throttle, config.rectifier).ravel()
    np.testing.assert_allclose(rectified_flow(config, table, drop, current), flow, rtol=2e-3)
    np.testing.assert_allclose(
        rectified_flow(config, table, -drop, current), -rectified_flow(config, table, drop, current)
    )
    assert rectified_flow(config, table, 2.0 * config.rectifier.opening, current) == 0.0


def write_table(path: Path, currents: np.ndarray, drops: np.ndarray, flows: np.ndarray) -> Path:
    rows = [["drop [Pa] \\ current [-] -> flow [m3/s]", *map(repr, currents.tolist())]]
    rows += [[repr(float(dp)), *map(repr, q.tolist())] for dp, q in zip(drops, flows, strict=True)]
    path.write_text("# measured\n" + "\n".join(",".join(row) for row in rows) + "\n")
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_a_measured_table_takes_the_formulas_place(kind: str, tmp_path: Path) -> None:
    """The formula written out as a table gives the formula's forces."""
    config = with_throttle(kind)
    currents, drops = np.linspace(0.0, 1.0, 129), np.linspace(0.0, 1.2e7, 40)
    flows = np.sqrt(drops)[:, None] * np.array([conductance(config.throttle, i) for i in currents])
    path = write_table(tmp_path / "throttle.csv", currents, drops, flows)
    throttle = TableThrottle(type="table", file=str(path))
    measured = config.model_copy(update={"throttle": throttle})
    velocity, current = np.array([0.005, 0.05, 0.2]), np.array([[0.0], [0.3], [1.0]])
    np.testing.assert_allclose(
        steady_force(measured, velocity, current), steady_force(config, velocity, current), rtol=2e-3
    )


def test_a_table_is_looked_for_beside_the_file_that_names_it(tmp_path: Path) -> None:
    flows = np.array([[0.0, 0.0], [1e-5, 2e-4]])
    write_table(tmp_path / "throttle.csv", np.array([0.0, 1.0]), np.array([0.0, 1e7]), flows)
    packaged = Path("configs/damper/sayd-estimate.yaml")
    text = (Path(__file__).parents[2] / packaged).read_text()
    head, tail = text[: text.index("\nthrottle:") + 1], text[text.index("\nrectifier:") + 1 :]
    (tmp_path / "mine.yaml").write_text(head + "throttle: {type: table, file: throttle.csv}\n" + tail)
    damper = load_scenario(overrides=[f"damper={tmp_path / 'mine.yaml'}"]).damper
    assert isinstance(damper, SaydDamperConfig)
    np.testing.assert_allclose(throttle_field(damper.throttle).at([0.0, 1.0], 1e7), [1e-5, 2e-4])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,1\n0,0,0\n1e5,2e-5,1e-4\n2e5,1e-5,2e-4\n", "line 4: the flow must rise with the pressure drop"),
        ("0,1\n0,0,0\n1e5,2e-5,1e-5\n", "line 3: the flow must not fall from the closed to the open valve"),
        ("0,1\n0,0,0\n2e5,1e-5,1e-4\n1e5,2e-5,2e-4\n", "line 4: pressure drops must rise"),
        ("0,0.9\n0,0,0\n1e5,1e-5,1e-4\n", r"line 1: found currents from 0 to 0\.9 -; they must reach from 0"),
        ("0,2,1\n0,0,0,0\n1e5,1e-5,1e-4,2e-4\n", "line 1: currents must rise, found 0, 2, 1"),
        ("0,1\n0,0,1e-6\n1e5,1e-5,1e-4\n", "line 2: found a flow at pressure drop 0"),
        ("0,1\n-1e5,1e-6,1e-5\n1e5,1e-5,1e-4\n", "line 2: found a pressure drop of -100000 Pa"),
        ("0,1\n0,0,0\n1e5,nan,1e-4\n", "line 3: column '0': found 'nan'; expected a finite number"),
        ("0,1\n0,0,0\n1e5,1e-4\n", "line 3: found 2 cells, '1e5,1e-4'; expected 3"),
        ("0,1\n1e5,1e-5,1e-4\n", "found 1 pressure drops and 2 currents; at least 2 of each"),
        ("0,1\n", "line 1: found no header"),
        # Cells over several lines, which once ended in an internal error.
        ('"0\n",1\n0,0,0\n1e5,"1e-5\n",1e-4\n2e5,2e-5,2e-4\n', "line 1: "),
    ],
)
def test_bad_tables_are_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("dp [Pa] i [-] q [m3/s]," + text)
    throttle = TableThrottle(type="table", file=str(path))
    with pytest.raises(DataError, match=message):
        read_valve_map(throttle)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("damper.cylinder.area=-1e-4", "damper.cylinder.area: found -0.0001"),
        (
            "damper.throttle={type: orifice, discharge: 0.65, density: 860, closed_area: 1e-7, "
            "open_area: 1e-9, overlap: 0.37, exponent: 0.9}",
            "open_area 1e-09 m2 must not be below closed_area 1e-07 m2",
        ),
        ("damper.throttle.ratio=0.5", "damper.throttle.ratio: found 0.5"),
        ("damper.throttle.closed_area=0", "damper.throttle.closed_area: found 0"),
        ("damper.current=1.5", "damper.current: found 1.5"),
        ("damper.current=.nan", "damper.current: found nan"),
        ("damper.relief.full=1e6", r"full 1e\+06 Pa must be above opening 6e\+06 Pa"),
        ("damper.friction.stiction=10", "stiction 10 N must not be below the sliding friction 100 N"),
        ("damper.oil.vapour_pressure=2e5", "vapour_pressure 200000 Pa must be below"),
        ("damper.friction.width=2e-4", "unknown key 'damper.friction.width'"),
        ("damper.valve.lag=0.01", "unknown key 'damper.valve.lag'"),
        ("damper.bleed=-1e-13", "damper.bleed: found -1e-13"),
        ("damper.piston=1", "unknown key 'damper.piston'"),
    ],
)
def test_bad_dampers_are_refused(assignment: str, message: str) -> None:
    """In the estimated damper: its numbers are set by hand, so that messages may quote them."""
    with pytest.raises(ConfigError, match=message) as caught:
        load_scenario(overrides=["damper=sayd-estimate", assignment])
    assert "\n" not in str(caught.value)
