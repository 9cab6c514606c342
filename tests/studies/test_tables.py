"""Tables of the studies: names in CSV and JSON that scripts rely on, and print that fits 80 columns.

The names are those of the files that the studies wrote before their tables had columns; that part guards
against change only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from sayd_env.report.columns import Column, Listing
from sayd_env.studies import (
    adaptation,
    assess,
    critical_speed,
    evaluate,
    modes,
    policies,
    robustness,
    soak,
)
from sayd_env.studies.bench import bench
from sayd_env.studies.comparison import page
from sayd_env.studies.components import conicity, hysteresis
from sayd_env.studies.paper import claims
from sayd_env.studies.tuning import calibrate, tune

AVERAGED = (
    "J J_acceleration J_force J_run J_offline J_offline_acceleration J_offline_force acceleration_ratio "
    "track_shift_ratio force_rms_n force_peak_n force_power_above_10_hz_n2 comfort valve_mean "
    "valve_travel_per_km switching_per_s fallback_share"
)


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        (
            hysteresis.COLUMNS,
            "amplitude_mm frequency_hz current force_peak_n energy_j dynamic_stiffness_n_per_m "
            "storage_stiffness_n_per_m loss_stiffness_n_per_m zero_force_slope_n_per_m force_limit_n",
        ),
        (conicity.CURVE, "amplitude_mm tan_gamma_e tan_gamma_e_table tan_gamma_harmonic"),
        (
            assess.COLUMNS,
            "name quantity unit dominant_frequency_hz rms_max limit ratio position_m stable",
        ),
        (soak.WORST, "J cut second seed episode speed_kmh wear friction track faults commands"),
        (evaluate._MEDIANS, f"policy wear friction speed_kmh {AVERAGED} derailed"),
        (
            adaptation.BEST,
            "force_weight speed_kmh wheel wear gauge friction level current J J_single J_closed J_open",
        ),
        (
            page._COSTS,
            "part policy filter force_weight training_seeds J geometric geometric_low geometric_high "
            "iqm_to_passive iqm_to_passive_low "
            "iqm_to_passive_high iqm_to_mppt2 iqm_to_mppt2_low iqm_to_mppt2_high improvement_over_mppt2 "
            "improvement_over_mppt2_low improvement_over_mppt2_high best_of_paper improvement_over_best "
            "improvement_over_best_low improvement_over_best_high reduction reduction_low reduction_high "
            "worst_vs_passive conditions_worse_than_passive relative_to_best_constant J_best_training_seed "
            "J_worst_training_seed",
        ),
        (
            page._GAINS,
            "part policy filter force_weight controller geometric_reduction geometric_reduction_low "
            "geometric_reduction_high reduction reduction_low reduction_high improvement "
            "improvement_low improvement_high",
        ),
        (
            page._STABILITY,
            "policy critical_speed_kmh status acceleration_ratio track_shift_ratio largest_run",
        ),
        (page._TARGETS, "policy asked measured holds"),
        (claims.CLAIMS, "id by expected measured fraction holds"),
        (critical_speed._LAW_COLUMNS, "creep_law criterion critical_speed_kmh status"),
        (bench.COLUMNS, "quantity unit median minimum maximum count"),
    ],
)
def test_stored_names_stay(columns: Sequence[Column], names: str):
    assert [column.name for column in columns] == names.split()


def test_modes_keep_their_keys():
    assert modes._KEYS == ("speed_kmh", "frequency_hz", "damping_ratio", "name")


WORDS = {
    **{"policy": "skyhook-continuous", "creep_law": "fastsim", "criterion": "track_shift_force"},
    **{
        "name": "bogie.front.leading",
        "quantity": "track_shift_force",
        "unit": "m/s²",
        "track": "german_high",
    },
    **{
        "faults": "damper_lost sensor_frozen",
        "commands": "bang-bang",
        "source": "estimated from other trains",
    },
    **{"controller": "skyhook-continuous", "asked": "J at least 10 % below the best", "range": "0.3 to 0.6"},
    **{"measured": "12.3 % (10.1 to 14.5)", "expected": "worn: critical speed 322 to 340 km/h", "id": "P10"},
    **{"by": "median", "gain": "current_minimum", "critical": "> 430", "short_commit": "0123456789ab+"},
    **{"disturbance": "sensor biased, longitudinal_acceleration.front.left"},
    **{"part": "stationary"},
    **{"environment": "training", "algorithm": "ppo", "sha256": "0" * 64, "verdict": "344 km/h " * 6},
}
FLAGS = {"holds": True, "stable": False, "cut": True}
HUGE = {"force_rms_n": 12345.6, "force_peak_n": 45678.9, "force_power_above_10_hz_n2": 12345678.0}
HUGE |= {"track_shift_rms_n": 56789.0, "fraction": 1.0, "seconds": 36000.0, "steps": 2_000_000}


@pytest.mark.parametrize(
    "columns",
    [
        hysteresis.COLUMNS,
        conicity.CURVE,
        assess.COLUMNS,
        soak.WORST,
        (*evaluate._WHO, *evaluate._COST_COLUMNS),
        (*evaluate._WHO, *evaluate._DAMPER_COLUMNS),
        evaluate._POLICY_COLUMNS,
        adaptation.ADAPTATION,
        (*page._COSTS, *page._BESIDE),
        page._GAINS,
        page._RELATIVE,
        page._TARGETS,
        claims.CLAIMS,
        critical_speed.TRENDS,
        policies.READY,
        bench.COLUMNS,
        tune.GAINS,
        tune.COSTS,
        calibrate.PARAMETERS,
        robustness.OUTCOMES,
        robustness._VERDICTS,
    ],
)
def test_a_table_fits_eighty_columns(columns: Sequence[Column], printed: Callable[[Any], str]):
    """With long names, and numbers as large as they come; J is MPPT2's, which then has no other column."""
    columns = [column for column in columns if column.name != "J_mppt2"]
    row: dict[str, Any] = {column.name: 400.123 for column in columns}
    row |= {name: value for name, value in (WORDS | FLAGS | HUGE).items() if name in row}
    row |= {name: 12.3456 for name in row if name.startswith(("J", "iqm", "worst", "largest", "improvement"))}
    row |= {name: 0.123 for name in row if name in ("wear", "friction", "current", "reduction")}
    row |= {name: 0.123 for name in row if name.startswith(("reduction_", "geometric"))}
    listing = Listing("title", columns, [row, row])
    printed(SimpleNamespace(summary=listing.print))
