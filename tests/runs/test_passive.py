"""Passive runs in pieces of work: who runs beside whom, and that company changes nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.physics.formation import WIDTH
from sayd_env.runs.context import RunContext, pieces
from sayd_env.runs.passive import Assessed, PassiveRun, assessed, assessed_or_derailed

FIELDS = ("frequency", "frequency_force", "acceleration", "track_shift")


@pytest.fixture(scope="module")
def scenarios(short_scenario: Scenario) -> tuple[Scenario, ...]:
    """Vehicles that differ in wear, dampers and track, and one whose assessed way is longer."""
    length = f"assessment.length={short_scenario.assessment.length!r}"
    worn, soft = ["wear=1.0"], ["damper.series_stiffness=5e6", "track.irregularity.scale=0.6"]
    closed = ["damper=sayd", "damper.current=0.1"]
    return (
        short_scenario,
        *(load_scenario("estimates", (length, *each)) for each in (worn, soft, closed)),
        load_scenario("estimates", ("assessment.length=700.0",)),
    )


def test_vehicles_of_one_structure_run_side_by_side(scenarios: tuple[Scenario, ...]):
    runs = [PassiveRun(each, speed, 3) for each in scenarios for speed in (70.0, 90.0)]
    assert len({run.companions() for run in runs}) == 1
    other = load_scenario("estimates", ("vehicle=manchester",))
    assert PassiveRun(other, 70.0, 3).companions() != runs[0].companions()


def test_company_changes_nothing(scenarios: tuple[Scenario, ...]):
    """Of any numbers, speeds and tracks; each ends where its own way does."""
    runs = [PassiveRun(each, 75.0 + 5.0 * i, i) for i, each in enumerate(scenarios)]
    for run, found in zip(runs, assessed(runs), strict=True):
        (alone,) = assessed([run])
        assert found.speed == run.speed
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))


def test_a_run_that_ends_early_is_beyond_every_limit_and_leaves_the_others(scenarios: tuple[Scenario, ...]):
    wild = load_scenario("estimates", ("assessment.length=600.0", "track.irregularity.scale=60.0"))
    calm = PassiveRun(scenarios[0], 80.0, 1)
    first, second = assessed_or_derailed([PassiveRun(wild, 80.0, 1), calm])
    assert np.isinf(first.acceleration).all()
    assert np.isinf(first.track_shift).all()
    assert np.isnan(first.frequency).all()
    np.testing.assert_array_equal(second.acceleration, assessed([calm])[0].acceleration)


@dataclass(frozen=True)
class Timed:
    """A run of which only its length is known."""

    length: float
    group: int = 0

    def inputs(self) -> list[float]:
        return [self.length, self.group]

    def companions(self) -> int:
        return self.group

    def duration(self) -> float:
        return self.length


def test_runs_of_a_piece_are_about_as_long_and_the_longest_come_first():
    lengths = np.random.default_rng(4).permutation(4 * WIDTH)
    found = pieces([Timed(float(each)) for each in lengths], range(4 * WIDTH), 2)
    assert [len(piece) for piece in found] == [WIDTH] * 4
    in_order = np.arange(4 * WIDTH)[::-1].reshape(4, WIDTH)
    np.testing.assert_array_equal([lengths[piece] for piece in found], in_order)


def test_no_piece_mixes_those_that_cannot_run_together():
    specs = [Timed(float(i % 5), group=i % 3) for i in range(30)]
    found = pieces(specs, range(30), 2)
    assert sorted(i for piece in found for i in piece) == list(range(30))
    assert all(len({specs[i].group for i in piece}) == 1 for piece in found)


def test_records_come_in_the_order_of_their_runs(short_scenario: Scenario):
    speeds = (90.0, 70.0, 80.0)
    records = RunContext().records(assessed, [PassiveRun(short_scenario, v, 2) for v in speeds], Assessed)
    assert tuple(record.speed for record in records) == speeds
