"""Verdicts on rows M1 to M9, S1 to S6 and C1, on made-up runs whose commands are known in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sayd_env.runs.controlled import ControlledRun, ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.paper.claims import Claim, Verdict
from sayd_env.studies.paper.controlled_claims import (
    MOTION,
    command_at,
    controlled_claims,
    dwell_times,
    end_shares,
    fixed_verdicts,
    largest_distance,
    required_runs,
    settled_command,
    swings_per_second,
)

MakeRun = Callable[..., ControlledRun]
MakeRuns = Callable[..., ControlledRuns]
ROWS = [*(f"M{i}" for i in range(1, 10)), *(f"S{i}" for i in range(1, 7)), "C1"]


def judged(runs: ControlledRuns, limits: Limits) -> dict[str, Claim]:
    return {claim.id: claim for claim in controlled_claims(runs, limits)}


def failed(claims: dict[str, Claim]) -> set[str]:
    return {claim.id for claim in claims.values() if not claim.holds}


def only(policy: str, kmh: float | None = None, initial: float = 0.0, **values: Any) -> Callable[..., Any]:
    """Change one controller's runs, at one speed or at all."""

    def change(run: ControlledRun) -> dict[str, Any]:
        same = run.policy == policy and run.initial_current == initial
        return values if same and (kmh is None or abs(run.speed * 3.6 - kmh) < 1) else {}

    return change


def acceleration(limits: Limits, ratio: float) -> dict[str, Any]:
    return {"acceleration": np.array([0.1, 0.1, 0.1, ratio]) * limits.acceleration}


def track_shift(limits: Limits, ratio: float) -> dict[str, Any]:
    return {"track_shift": np.array([0.1, ratio, 0.1, 0.1]) * limits.track_shift_force}


def test_the_runs_that_the_rows_need():
    needed = required_runs()
    assert len(needed) == len(set(needed)) == 4 * 5 + 2
    assert {(p, round(v * 3.6)) for p, v, current in needed if current == 1.0} == {
        ("mppt1", 400),
        ("mppt2", 300),
    }


def test_a_vehicle_like_the_papers_passes_every_row(paper_runs: MakeRuns, limits: Limits):
    claims = judged(paper_runs(), limits)
    assert list(claims) == ROWS
    assert failed(claims) == set()
    assert {claim.fraction for claim in claims.values()} == {1.0}
    assert {c.id for c in claims.values() if c.by == "median"} == {"M2", "S4"}
    assert claims["M2"].measured == (
        "6.500 Hz (bootstraps 6.500 to 6.500); within 100 % (100 to 100); at the edge 0 % (0 to 0)"
    )
    assert claims["M3"].measured == "8.0 % (8.0 to 8.0)"
    assert claims["S2"].measured.startswith("10th percentile 0.04 s (0.04 to 0.04), median 0.04 s")
    assert "12.0 swings/s" in claims["S5"].measured


def test_each_row_fails_by_itself(paper_runs: MakeRuns, courses: SimpleNamespace, limits: Limits):
    line = courses.line
    third = courses.square(0.08)
    third[100] = 0.5
    teeth, steps = 15.0 + np.arange(31), np.tile([0.17, 0.53], 16)[:31]
    cases: list[tuple[Callable[..., Any], set[str]]] = [
        (only("mppt1", 375, **acceleration(limits, 0.51)), {"M1"}),
        (only("mppt1", frequency=np.array([4.0, 5.0, 4.2, 5.9])), {"M2"}),
        (only("mppt1", 400, frequency=np.array([1.5, 5.0, 4.2, 5.9])), {"M2"}),  # no peak: the search's end
        (only("mppt1", 400, frequency=np.array([12.0, 5.0, 4.2, 5.9])), {"M2"}),
        (only("mppt1", frequency=np.array([4.0, 5.0, 4.2, 10.1])), {"M2"}),  # a quarter lies above 10 Hz
        # A command that stays at 13.5 % is more than 5 points away from the open start's 7 %, too.
        (only("mppt1", 400, command=line([0], [0.135])), {"M3", "M4"}),
        (only("mppt1", 400, command=line([0], [0.02])), {"M3"}),
        (only("mppt1", 400, 1.0, command=line([0, 5, 6], [1.0, 0.2001, 0.07])), {"M4"}),
        (only("mppt1", 400, 1.0, command=line([0, 4, 5, 6], [1.0, 0.08, 0.07, 0.14])), {"M4"}),
        (only("mppt2", 300, **acceleration(limits, 0.51)), {"M5"}),
        (only("mppt2", 300, command=line([0, 5, 10], [0.0, 0.19, 0.35])), {"M6"}),
        (only("mppt2", 300, command=line([0, 5, 10, 14], [0.0, 0.31, 0.35, 0.35])), {"M6"}),
        # A saw-tooth from 17 to 53 % about 35 % deviates by 36 / sqrt(12) = 10.4 points.
        (only("mppt2", 300, command=line([0, 5, 10, *teeth], [0.0, 0.25, 0.35, *steps])), {"M6"}),
        # Settles at 41 %, six points above the open start's 35 %.
        (only("mppt2", 300, command=line([0, 5, 10], [0.0, 0.25, 0.41])), {"M6", "M7"}),
        (only("mppt2", 300, 1.0, command=line([0, 5, 10], [1.0, 0.36, 0.35])), {"M7"}),
        (only("mppt2", 300, 1.0, command=line([0, 5, 10], [1.0, 0.25, 0.29])), {"M7"}),
        (only("mppt2", 300, force_power_high=1.1e5), {"M8"}),
        (only("mppt2", 300, force_rms=2.6e3), {"M9"}),
        (only("mppt2", 300, force_rms=3.1e3), {"M8", "M9"}),
        (only("skyhook-onoff", 350, **track_shift(limits, 0.51)), {"S1"}),
        (only("skyhook-onoff", 400, command=courses.square(0.2)), {"S2"}),  # stays 0.1 s: not less
        (only("skyhook-onoff", 400, command=third), {"S2"}),
        (only("skyhook-onoff", 400, command=line([0], [1.0])), {"S2"}),  # never switches
        (only("skyhook-onoff", 400, force_peak=8.9e3), {"S3"}),
        (only("mppt2", 400, force_peak=12e3), {"S3"}),  # on-off must exceed both MPPTs
        (only("skyhook-continuous", 320, **track_shift(limits, 0.61)), {"S4"}),
        (only("skyhook-continuous", 320, **acceleration(limits, 0.141)), {"S4"}),  # 41 % above 0.1
        (only("skyhook-continuous", 320, acceleration=np.full(4, 0.099 * limits.acceleration)), {"S4"}),
        (only("skyhook-continuous", 400, command=courses.sine(2.4)), {"S5"}),  # 4.8 swings/s
        (only("skyhook-continuous", 400, command=courses.sine(6.0, 0.305)), {"S5"}),  # hardly at the ends
        (only("skyhook-continuous", 400, force_power_high=3.9e5), {"S6"}),
        (only("skyhook-continuous", 400, **track_shift(limits, 1.01)), {"S4", "C1"}),
    ]
    for number, (change, rows) in enumerate(cases):
        assert failed(judged(paper_runs(2, change), limits)) == rows, f"case {number}"


def test_a_fixed_command_takes_the_place_of_a_row_s_controller(
    paper_runs: MakeRuns, controlled_run: MakeRun, limits: Limits
):
    """Its force is 2.4 kN at 300 and 2.8 kN at 400 km/h; MPPT1's are 2.5 and 3 kN, on-off's peak is 11 kN."""
    runs = paper_runs(2)
    fixed = [
        controlled_run(
            "constant:0.05",
            kmh,
            seed,
            force_rms=2.4e3 if kmh == 300 else 2.8e3,
            force_power_high=9e4,
            **acceleration(limits, 0.45),
        )
        for kmh in (300, 320, 350, 375, 400)
        for seed in range(2)
    ]
    verdicts = fixed_verdicts(ControlledRuns([*runs.runs, *fixed]), limits, "constant:0.05")
    assert list(verdicts) == ROWS
    assert {row for row, verdict in verdicts.items() if verdict.holds} == {"M1", "M5", "M8", "M9", "S1", "C1"}
    assert {row for row, verdict in verdicts.items() if verdict.holds is None} == set(MOTION)
    assert verdicts["M9"].measured == "RMS force 0.96 (0.96 to 0.96) times"
    assert verdicts["M8"].measured.startswith("RMS force 0.80 (0.80 to 0.80) times")
    assert verdicts["M3"] == Verdict("stays at 5 %")
    assert verdicts["C1"].measured == "largest ratio 0.45 (0.45 to 0.45)"


@pytest.mark.parametrize(("passing", "holds"), [(10, True), (8, True), (7, False)])
def test_four_in_five_seeds_must_pass(passing: int, holds: bool, paper_runs: MakeRuns, limits: Limits):
    def change(run: ControlledRun) -> dict[str, Any]:
        bad = run.policy == "mppt1" and run.seed >= passing
        return acceleration(limits, 0.6) if bad else {}

    claim = judged(paper_runs(10, change), limits)["M1"]
    assert claim.fraction == passing / 10
    assert claim.holds is holds


def test_the_front_bogie_is_not_judged(paper_runs: MakeRuns, courses: SimpleNamespace, limits: Limits):
    both = courses.line([0, 10], [0.0, 0.08])
    both[:, 0] = 0.9
    assert failed(judged(paper_runs(2, only("mppt1", 400, command=both)), limits)) == set()


def test_a_missing_run_is_named(paper_runs: MakeRuns, limits: Limits):
    runs = paper_runs(2)
    without = ControlledRuns(r for r in runs.runs if not (r.policy == "mppt2" and r.initial_current == 1.0))
    with pytest.raises(ValueError, match=r"no run of 'mppt2' at 300 km/h, V\(0\) = 1"):
        controlled_claims(without, limits)


def test_commands_at_a_time(controlled_run: MakeRun, courses: SimpleNamespace):
    run = controlled_run(command=courses.line([0, 45], [0.0, 0.9]))
    assert command_at(run, 5.0) == pytest.approx(0.1, abs=1e-6)
    assert command_at(run, 1e3) == pytest.approx(0.8998, abs=1e-6)
    assert settled_command(run) == pytest.approx((0.45 + 0.8998) / 2, abs=1e-6)
    other = controlled_run(command=courses.line([0, 10, 45], [1.0, 0.2, 0.9]))
    assert largest_distance(run, other, 10.0) == pytest.approx(0.0, abs=1e-6)
    assert largest_distance(run, other, 5.0) == pytest.approx(0.5, abs=1e-6)
    assert math.isnan(largest_distance(run, other, 60.0))


@pytest.mark.parametrize("period", [0.04, 0.08, 1.0])
def test_a_square_wave_stays_half_its_period(
    period: float, controlled_run: MakeRun, courses: SimpleNamespace
):
    run = controlled_run(command=courses.square(period))
    assert dwell_times(run) == pytest.approx(np.full(round(45 / (period / 2)) - 2, period / 2))
    assert end_shares(run) == pytest.approx((0.5, 0.5), abs=0.02)
    assert swings_per_second(run) == pytest.approx(2 / period, abs=2 / 45)


def test_a_command_that_never_changes_has_no_stay(controlled_run: MakeRun):
    assert dwell_times(controlled_run()).size == 0
    assert swings_per_second(controlled_run()) == 0.0


@pytest.mark.parametrize("frequency", [1.03, 3.07, 6.11])
def test_a_sine_swings_twice_a_period_and_stays_at_its_ends(
    frequency: float, controlled_run: MakeRun, courses: SimpleNamespace
):
    """0.5 + 0.5 sin is <= 0.2 for the share 1/2 - asin(0.6) / pi of a period, and as long >= 0.8."""
    run = controlled_run(command=courses.sine(frequency))
    share = 0.5 - math.asin(0.6) / math.pi
    assert end_shares(run) == pytest.approx((share, share), abs=0.01)
    assert swings_per_second(run) == pytest.approx(2 * frequency, abs=2 / 45)


def test_only_passages_from_end_to_end_are_swings(controlled_run: MakeRun, courses: SimpleNamespace):
    """Down to the middle and back is none: each of the ten seconds goes 1, 0.5, 1, 0, 1."""
    points = [1.0, 0.5, 1.0, 0.0]
    times = np.arange(41) / 4
    command = courses.line(times, [points[i % 4] for i in range(41)], duration=10.0)
    assert swings_per_second(controlled_run(command=command)) == pytest.approx(2.0, abs=0.1)
