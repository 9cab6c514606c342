"""A batch is its vehicles: the same bits as one simulator each, whatever the threads and the company."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
import pytest
from sayd_env.physics.stack import Stack

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.scenario import load_scenario
from sayd_env.physics import kernel as kernel_module
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.kernel import announced_compilation, kernel
from sayd_env.physics.simulator import Simulator, VehicleModel

Array = npt.NDArray[np.float64]
SAMPLES = 400
KMH = 3.6


@pytest.fixture(scope="module")
def models() -> tuple[VehicleModel, VehicleModel, VehicleModel]:
    """New wheels; worn wheels, another damper and a shorter track; lengths of all tables differ."""
    return (
        VehicleModel(load_scenario()),
        VehicleModel(
            load_scenario(
                None,
                [
                    "wear=1",
                    "damper.curve=[[0, 0], [0.1, 8000], [0.2, 9000], [0.4, 10000]]",
                    "assessment.length=1000",
                    "contact.table_half_width=0.010",
                ],
            )
        ),
        VehicleModel(load_scenario(None, ["friction=0.2", "track=smooth"])),
    )


@pytest.fixture
def fleet(models: tuple[VehicleModel, ...]) -> list[Simulator]:
    """Vehicles of different speeds (and so different numbers of substeps), tracks, wheels and dampers."""
    return vehicles(models)


def vehicles(models: tuple[VehicleModel, ...]) -> list[Simulator]:
    cases = [(0, 350, 0), (1, 400, 1), (0, 60, 2), (2, 120, 0), (1, 300, 3)]
    fleet = [Simulator(models[m], speed / KMH, seed) for m, speed, seed in cases]
    for k, simulator in enumerate(fleet):
        simulator.state.v[simulator.plant.wheelset_dofs[:, 1]] = 0.01 * (k + 1)
    return fleet


def alone(simulator: Simulator, samples: int = SAMPLES) -> Array:
    run = simulator.advance(samples)
    return np.hstack([run.acceleration, run.track_shift, run.damper_force])


def test_the_fleet_is_diverse(fleet: list[Simulator]) -> None:
    assert len({s.model.step(s.speed)[1] for s in fleet}) > 2
    for name in ("table", "irregularity", "damper_velocity"):
        assert len({len(getattr(s.plant, name)) for s in fleet}) > 1, name


def test_batch_equals_single_runs(models: tuple[VehicleModel, ...], fleet: list[Simulator]) -> None:
    together = BatchSimulator(fleet).advance(SAMPLES)
    for i, simulator in enumerate(vehicles(models)):
        np.testing.assert_array_equal(together[i], alone(simulator))
        np.testing.assert_array_equal(fleet[i].state.q, simulator.state.q)


@pytest.mark.parametrize("threads", range(1, numba.config.NUMBA_NUM_THREADS + 1))
def test_threads_change_nothing(models: tuple[VehicleModel, ...], threads: int) -> None:
    reference = BatchSimulator(vehicles(models), 1).advance(SAMPLES)
    np.testing.assert_array_equal(BatchSimulator(vehicles(models), threads).advance(SAMPLES), reference)


def test_company_changes_nothing(models: tuple[VehicleModel, ...], fleet: list[Simulator]) -> None:
    reference = BatchSimulator(vehicles(models)).advance(SAMPLES)
    backwards = BatchSimulator(fleet[::-1]).advance(SAMPLES)
    np.testing.assert_array_equal(backwards[::-1], reference)
    few = BatchSimulator(vehicles(models)[1:3]).advance(SAMPLES)
    np.testing.assert_array_equal(few, reference[1:3])


def test_two_halves_are_a_whole(models: tuple[VehicleModel, ...], fleet: list[Simulator]) -> None:
    """A batch goes on where it was, and a vehicle may run on alone: both see one state."""
    whole = BatchSimulator(vehicles(models)).advance(SAMPLES)
    batch = BatchSimulator(fleet)
    first = batch.advance(SAMPLES // 2)
    np.testing.assert_array_equal(first, whole[:, : SAMPLES // 2])
    np.testing.assert_array_equal(alone(fleet[1], SAMPLES // 2), whole[1, SAMPLES // 2 :])
    assert fleet[1].state.clock[0] > fleet[0].state.clock[0]


def test_the_number_of_threads_is_given_back(fleet: list[Simulator]) -> None:
    before = numba.get_num_threads()
    BatchSimulator(fleet, 1).advance(1)
    assert numba.get_num_threads() == before
    fleet[0].state.q[:] = np.nan
    with pytest.raises(StudyError, match="350 km/h diverged"):
        BatchSimulator(fleet, 1).advance(1)
    assert numba.get_num_threads() == before


def test_one_diverging_vehicle_leaves_the_others_alone(
    models: tuple[VehicleModel, ...], fleet: list[Simulator]
) -> None:
    fleet[0].state.q[:] = np.nan
    with pytest.raises(StudyError):
        BatchSimulator(fleet).advance(SAMPLES)
    other = vehicles(models)[1]
    other.advance(SAMPLES)
    np.testing.assert_array_equal(fleet[1].state.q, other.state.q)


@pytest.mark.parametrize("threads", [0, -1, 10_000])
def test_impossible_threads(fleet: list[Simulator], threads: int) -> None:
    with pytest.raises(ConfigError, match=r"num_threads: found .*; expected a whole number from 1 to"):
        BatchSimulator(fleet, threads)


def test_vehicles_that_do_not_fit(fleet: list[Simulator]) -> None:
    with pytest.raises(ConfigError, match="at least one"):
        BatchSimulator([])
    other = Simulator(VehicleModel(load_scenario(None, ["vehicle=manchester"])), 150 / KMH)
    with pytest.raises(ConfigError, match="a batch needs"):
        BatchSimulator([fleet[0], other])
    slow = Simulator(VehicleModel(load_scenario(None, ["assessment.sample_rate=500"])), 300 / KMH)
    with pytest.raises(ConfigError, match="sample rate"):
        BatchSimulator([fleet[0], slow])


def test_stack_and_back(fleet: list[Simulator]) -> None:
    states = [s.state for s in fleet]
    stack = Stack(states)
    for i, state in enumerate(states):
        view = stack.view(i)
        for name in state._fields:
            np.testing.assert_array_equal(getattr(view, name), getattr(state, name))
            # Passive dampers leave the semi-active ones' arrays empty, and nothing is shared there.
            shared = np.shares_memory(getattr(view, name), getattr(stack.values, name))
            assert shared or getattr(stack.values, name).size == 0


@pytest.mark.parametrize("change", [-300, 0, 300], ids=["shorter", "as long", "longer"])
def test_putting_one_vehicle_leaves_the_others(fleet: list[Simulator], change: int) -> None:
    stack = Stack([s.plant for s in fleet])
    before = [s.plant for s in fleet]
    track = fleet[0].plant.irregularity
    rows = np.vstack([track, track[:change]]) if change > 0 else track[: len(track) + change]
    new = fleet[1].plant._replace(irregularity=rows + 1.0, speed=33.0)
    stack.put(1, new)
    stack.put(0, before[0])
    for i, expected in enumerate([before[0], new, *before[2:]]):
        for name in expected._fields:
            np.testing.assert_array_equal(getattr(stack.view(i), name), getattr(expected, name))


@pytest.fixture
def fresh_kernel(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> str:
    """Cold cache for kernels that are made in a test."""
    monkeypatch.setattr(kernel_module, "CACHE_DIRECTORY", tmp_path_factory.mktemp("kernels"))
    return "the test's kernel (no time at all)"


def test_compilation_is_announced_once(fresh_kernel: str) -> None:
    @kernel(announce=fresh_kernel)
    def twice(x: float) -> float:
        return 2.0 * x

    @kernel
    def thrice(x: float) -> float:
        return 3.0 * x

    said: list[str] = []
    with announced_compilation(said.append):
        assert twice(1.0) + twice(2.0) + thrice(1.0) == 9.0
    assert said[0] == f"compiling {fresh_kernel} ..."
    assert said[1].startswith("compiled in ")
    assert len(said) == 2
    with announced_compilation(said.append):
        twice(3.0)
    twice(1)  # another type: compiled, with nobody listening
    assert len(said) == 2
