"""A batch is its vehicles: the same bits as one simulator each, whatever the threads and the company."""

from __future__ import annotations

import copy
import gc
import pickle
from typing import NamedTuple

import numba
import numpy as np
import pytest

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.scenario import load_scenario
from sayd_env.config.units import Array, Flags, Integers
from sayd_env.physics import kernel as kernel_module
from sayd_env.physics.batch import BatchSimulator, advance_units_in_parallel
from sayd_env.physics.formation import FEWEST, WIDTH, Formation, calls
from sayd_env.physics.kernel import announced_compilation, kernel
from sayd_env.physics.plant import Plant, State
from sayd_env.physics.ragged import Matrix, RaggedBatch, vehicle_from
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.physics.step import advance as advance_one

SAMPLES = 250
KMH = 3.6

MODELS = {
    "new": ["wear=0"],
    "worn": ["wear=1", "assessment.length=1000"],
    "half worn": ["wear=0.5", "friction=0.2", "contact.table_half_width=0.010"],
    "light": ["wear=1", "vehicle.bodies.carbody.mass=40000"],
    "smooth": ["track=smooth", "friction=0.2"],
    "other curve": ["wear=1", "damper.curve=[[0, 0], [0.1, 8000], [0.2, 9000], [0.4, 10000]]"],
    "closed": ["damper=sayd-estimate", "damper.current=0.05"],
    "slow valve": ["damper=sayd-estimate", "damper.current=0.4", "damper.valve.delay=0.012", "wear=1"],
    "leaking": ["damper=sayd-estimate", "damper.throttle.closed_area=4e-7", "damper.valve.delay=0.0021"],
}
"""Wheels, tracks of other lengths, masses, curves, valves, throttle tables: what `load_scenario` changes."""
FLEET = [
    ("new", 350, 0),
    ("closed", 320, 1),
    ("worn", 400, 1),
    ("new", 60, 2),
    ("half worn", 310, 3),
    ("slow valve", 350, 2),
    ("light", 380, 4),
    ("leaking", 300, 5),
    ("worn", 290, 6),
    ("smooth", 400, 0),
    ("closed", 400, 3),
    ("other curve", 300, 7),
    ("new", 310, 8),
    ("slow valve", 280, 4),
    ("half worn", 330, 5),
    ("leaking", 350, 6),
    ("worn", 60, 3),
    ("worn", 350, 9),
    ("new", 400, 4),
    ("slow valve", 400, 0),
]
"""Model, speed (km/h), seed: ten passive vehicles of one structure and step are a group and two more, seven
with semi-active dampers a group with an idle lane; the other three are of kinds of their own."""


@pytest.fixture(scope="module")
def models() -> dict[str, VehicleModel]:
    return {name: VehicleModel(load_scenario("estimates", overrides)) for name, overrides in MODELS.items()}


class Fleet:
    """The vehicles of `FLEET`, made anew as often as wanted, and what each of them does alone."""

    def __init__(self, models: dict[str, VehicleModel]) -> None:
        self.models = models
        self.tracks = [models[name].realisation(seed) for name, _, seed in FLEET]
        self.alone = [alone(simulator) for simulator in self.vehicles()]

    def vehicles(self, which: range | list[int] = range(len(FLEET))) -> list[Simulator]:  # noqa: B008
        return [self.vehicle(i) for i in which]

    def vehicle(self, i: int) -> Simulator:
        name, speed, _ = FLEET[i]
        simulator = Simulator(self.models[name], speed / KMH, track=self.tracks[i])
        simulator.state.v[simulator.model.multibody.wheelset_dofs[:, 1]] = 0.01 * (i + 1)
        return simulator


@pytest.fixture(scope="module")
def fleet(models: dict[str, VehicleModel]) -> Fleet:
    return Fleet(models)


def alone(simulator: Simulator, samples: int = SAMPLES) -> tuple[Array, State]:
    """Signals of a simulator of its own, and its state at the end."""
    run = simulator.advance(samples)
    return np.hstack([run.acceleration, run.track_shift, run.damper_force]), simulator.state


def formation(simulators: list[Simulator]) -> Formation:
    plants, states, works = zip(*((s.plant, s.state, s.work) for s in simulators), strict=True)
    return Formation(plants, states, works)


def advance(formation: Formation, substeps: list[int], active: Flags | None = None) -> Array:
    """Signals (vehicles, samples, 16) of the vehicles that are active; the others' stay zero."""
    return advance_to_the_end(formation, substeps, active)[0]


def advance_to_the_end(
    formation: Formation, substeps: list[int], active: Flags | None = None
) -> tuple[Array, Integers]:
    """The same, and how many samples each vehicle took."""
    signals, done = np.zeros((len(formation), SAMPLES, 16)), np.zeros(len(formation), dtype=np.int64)
    units = formation.units(active)
    samples = np.full(len(formation), SAMPLES)
    advance_units_in_parallel(*units, *formation.arguments(), np.array(substeps), samples, signals, done)
    return signals, done


def substeps(simulators: list[Simulator]) -> list[int]:
    return [s.model.step(s.speed)[1] for s in simulators]


def assert_same_state(found: State, expected: State) -> None:
    for name in State._fields:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)


def test_the_fleet_is_diverse(fleet: Fleet) -> None:
    simulators = fleet.vehicles()
    assert len(set(substeps(simulators))) > 2
    for name in ("table", "irregularity", "damper_velocity", "sayd_constant"):
        assert len({len(getattr(s.plant, name)) for s in simulators}) > 1, name
    assert len({len(s.state.sayd_line) for s in simulators}) > 2
    units = formation(simulators).units()
    assert sorted(np.count_nonzero(units.members >= 0, axis=1)) == [WIDTH - 1, WIDTH]
    assert sorted([*units.members[units.members >= 0], *units.alone]) == list(range(len(FLEET)))


@pytest.mark.parametrize("size", range(1, len(FLEET) + 1))
def test_a_batch_of_any_size_equals_single_runs(fleet: Fleet, size: int) -> None:
    simulators = fleet.vehicles(range(size))
    together = BatchSimulator(simulators).advance(SAMPLES)
    for i, (signals, state) in enumerate(fleet.alone[:size]):
        np.testing.assert_array_equal(together[i], signals)
        assert_same_state(simulators[i].state, state)


@pytest.mark.parametrize("size", range(1, 2 * WIDTH + 5))
def test_equal_vehicles_in_a_batch_of_any_size(fleet: Fleet, size: int) -> None:
    """One structure: alone, a group with idle lanes, a full one, several, and what is left over."""
    which = [
        i for i, (name, speed, _) in enumerate(FLEET) if name in ("new", "worn", "light") and speed > 200
    ]
    order = [which[i % len(which)] for i in range(size)]
    together = BatchSimulator(fleet.vehicles(order)).advance(SAMPLES)
    for k, i in enumerate(order):
        np.testing.assert_array_equal(together[k], fleet.alone[i][0])


@pytest.mark.parametrize("threads", range(1, numba.config.NUMBA_NUM_THREADS + 1))
def test_threads_change_nothing(fleet: Fleet, threads: int) -> None:
    together = BatchSimulator(fleet.vehicles(), threads).advance(SAMPLES)
    np.testing.assert_array_equal(together, [signals for signals, _ in fleet.alone])


def test_company_changes_nothing(fleet: Fleet) -> None:
    order = [int(i) for i in np.random.default_rng(3).permutation(len(FLEET))]
    together = BatchSimulator(fleet.vehicles(order)).advance(SAMPLES)
    for k, i in enumerate(order):
        np.testing.assert_array_equal(together[k], fleet.alone[i][0])


def test_each_vehicle_ends_with_its_own_number_of_samples(fleet: Fleet) -> None:
    """Its neighbours in the group run on, and its state is that of its last sample."""
    simulators = fleet.vehicles()
    samples = [1 + (37 * i) % SAMPLES for i in range(len(simulators))]
    together = BatchSimulator(simulators).advance(samples)
    assert together.shape[1] == max(samples)
    for i, (single, count) in enumerate(zip(fleet.vehicles(), samples, strict=True)):
        signals, state = alone(single, count)
        np.testing.assert_array_equal(together[i, :count], signals)
        assert np.isnan(together[i, count:]).all()
        assert_same_state(simulators[i].state, state)


@pytest.mark.parametrize("samples", [0, [5, 0], [5], [5, 5, 5]])
def test_a_number_of_samples_that_cannot_be_is_refused(fleet: Fleet, samples: int | list[int]) -> None:
    with pytest.raises(ConfigError, match=r"batch of 2 vehicles .*1 sample or more"):
        BatchSimulator(fleet.vehicles(range(2))).advance(samples)


def test_two_halves_are_a_whole(fleet: Fleet) -> None:
    """A batch goes on where it was, and a vehicle may run on alone: both see one state."""
    simulators = fleet.vehicles()
    first = BatchSimulator(simulators).advance(SAMPLES // 2)
    for i, simulator in enumerate(simulators):
        np.testing.assert_array_equal(first[i], fleet.alone[i][0][: SAMPLES // 2])
        signals, state = alone(simulator, SAMPLES - SAMPLES // 2)
        np.testing.assert_array_equal(signals, fleet.alone[i][0][SAMPLES // 2 :])
        assert_same_state(state, fleet.alone[i][1])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_some_run_while_others_wait(fleet: Fleet, share: float, seed: int) -> None:
    """Whoever is active does what it does alone; the others' states stay as they are."""
    active = np.random.default_rng(seed).random(len(FLEET)) < share
    simulators, waiting = fleet.vehicles(), fleet.vehicles()
    batch = formation(simulators)
    signals = advance(batch, substeps(simulators), active)
    for i, runs in enumerate(active):
        np.testing.assert_array_equal(signals[i], fleet.alone[i][0] if runs else 0.0)
        assert_same_state(simulators[i].state, fleet.alone[i][1] if runs else waiting[i].state)


def test_few_of_a_group_run_alone(fleet: Fleet) -> None:
    simulators = fleet.vehicles()
    batch = formation(simulators)
    team = batch.units().members[0]
    for count in range(WIDTH + 1):
        active = np.zeros(len(FLEET), dtype=bool)
        active[team[:count]] = True
        units = batch.units(active)
        run = sorted([*units.members[units.members >= 0], *units.alone])
        assert run == sorted(team[:count])
        assert len(units.groups) == (1 if count >= FEWEST else 0)


def test_groups_and_vehicles_alone_have_a_call_each_on_one_thread(fleet: Fleet) -> None:
    units = formation(fleet.vehicles()).units()
    assert len(units.groups) > 0
    assert len(units.alone) > 0
    nobody = np.zeros(0, dtype=np.int64)
    groups, alone = (units.groups, units.members, None), (None, None, units.alone)
    assert calls(units, 1) == [groups, alone]
    assert calls(units._replace(alone=nobody), 1) == [groups]
    assert calls(units._replace(groups=nobody), 1) == [alone]
    assert calls(units, 2) == [units]


def test_a_vehicle_can_be_replaced(fleet: Fleet) -> None:
    """Another one takes its place in the batch, of another kind even, and the groups form anew."""
    order = list(range(len(FLEET) - 1))
    simulators = fleet.vehicles(order)
    batch = formation(simulators)
    advance(batch, substeps(simulators))
    assert len(batch.units().alone) == 5
    new = [*order]
    new[1], new[3], new[5] = 19, 2, 0
    replaced = fleet.vehicles(new)
    for i, simulator in enumerate(replaced):
        batch.put(i, simulator.plant, simulator.state, simulator.work)
    signals = advance(batch, substeps(replaced))
    for k, i in enumerate(new):
        np.testing.assert_array_equal(signals[k], fleet.alone[i][0])


def test_constants_can_change(fleet: Fleet) -> None:
    """New constants act from the next call on: here those of another friction, on the same state."""
    which = [0, 2, 4, 6, 8, 9, 12, 14]
    simulators, expected = fleet.vehicles(which), fleet.vehicles(which)
    batch = formation(simulators)
    assert len(batch.units().groups) == 1
    other = VehicleModel(load_scenario("estimates", ["wear=0", "friction=0.1"]))
    plant = other.plant(simulators[0].speed, simulators[0].track)
    batch.change(0, plant)
    expected[0].plant = plant
    signals = advance(batch, substeps(simulators))
    assert len(batch.units().groups) == 1
    for k, simulator in enumerate(expected):
        np.testing.assert_array_equal(signals[k], alone(simulator)[0])
    assert np.any(signals[0] != fleet.alone[0][0])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_a_copy_runs_on_its_own(fleet: Fleet, copied: object) -> None:
    """A copy of a batch that has run goes on to the same bits, and the original stays where it is."""
    assert callable(copied)
    simulators = fleet.vehicles()
    batch = formation(simulators)
    advance(batch, substeps(simulators))
    before = copy.deepcopy([s.state for s in simulators])
    other = copied(batch)
    for mine, its in zip(batch.state, other.state, strict=True):
        for a, b in zip(mine, its, strict=True):
            assert a.size == 0 or not np.shares_memory(a, b)
    ran = advance(other, substeps(simulators))
    for simulator, state in zip(simulators, before, strict=True):
        assert_same_state(simulator.state, state)
    np.testing.assert_array_equal(advance(batch, substeps(simulators)), ran)
    for simulator, state in zip(simulators, other.state, strict=True):
        assert_same_state(simulator.state, state)


def test_the_number_of_threads_is_given_back(fleet: Fleet) -> None:
    simulators = fleet.vehicles(range(5))
    before = numba.get_num_threads()
    BatchSimulator(simulators, 1).advance(1)
    assert numba.get_num_threads() == before
    simulators[0].state.q[:] = np.nan
    with pytest.raises(StudyError, match="350 km/h diverged"):
        BatchSimulator(simulators, 1).advance(1)
    assert numba.get_num_threads() == before


def test_one_diverging_vehicle_leaves_the_others_alone(fleet: Fleet) -> None:
    """Also those in its group, whose lanes stand beside its own."""
    simulators = fleet.vehicles()
    broken = next(int(i) for i in formation(simulators).units().members[0])
    simulators[broken].state.q[:] = np.nan
    with pytest.raises(StudyError):
        BatchSimulator(simulators).advance(SAMPLES)
    for i, simulator in enumerate(simulators):
        if i != broken:
            assert_same_state(simulator.state, fleet.alone[i][1])


def alone_to_the_end(simulator: Simulator) -> tuple[Array, int]:
    """Signals of a simulator of its own, zeros behind its end, and how many samples it took."""
    signals, nothing = np.zeros((SAMPLES, simulator.channels)), np.zeros((0, 0))
    own = simulator.plant, simulator.state, simulator.work
    return signals, advance_one(*own, *substeps([simulator]), signals, nothing, nothing, nothing)


DERAILING = {"passive": [2, 0, 4, 6, 8, 9, 12, 14], "semi-active": [5, 1, 7, 10, 13, 15, 19, 1]}
"""Groups of vehicles of `FLEET`; those in front have worn wheels."""


@pytest.mark.parametrize("lateral", [5.0, 8.0, 20.0, 200.0])
@pytest.mark.parametrize("which", DERAILING.values(), ids=DERAILING.keys())
def test_a_vehicle_of_a_group_derails_as_it_does_alone(
    fleet: Fleet, which: list[int], lateral: float
) -> None:
    """Thrown against the rails (m/s) it ends soon and stays there, while the seven others run on.

    From 20 m/s on it is as good as numerically diverged, with velocities that no part of a train has.
    """
    simulators, single = fleet.vehicles(which), fleet.vehicle(which[0])
    for thrown in (simulators[0], single):
        thrown.state.v[thrown.model.multibody.wheelset_dofs[:, 1]] = lateral
    batch = formation(simulators)
    assert len(batch.units().groups) == 1
    assert len(batch.units().alone) == 0
    together, done = advance_to_the_end(batch, substeps(simulators))
    signals, taken = alone_to_the_end(single)
    assert taken < SAMPLES // 2
    assert done.tolist() == [taken] + [SAMPLES] * 7
    np.testing.assert_array_equal(together[0], signals)
    assert_same_state(simulators[0].state, single.state)
    message = simulators[0].divergence()
    assert message == single.divergence()
    assert ("a wheel has left the contact table" if lateral < 20.0 else "diverged") in message
    for k, i in enumerate(which[1:], start=1):
        np.testing.assert_array_equal(together[k], fleet.alone[i][0])
        assert_same_state(simulators[k].state, fleet.alone[i][1])


def group_of(model: VehicleModel) -> list[Simulator]:
    """Eight vehicles of a model at different speeds on different tracks."""
    simulators = [Simulator(model, (290 + 15 * k) / KMH, k) for k in range(WIDTH)]
    for k, simulator in enumerate(simulators):
        simulator.state.v[simulator.model.multibody.wheelset_dofs[:, 1]] = 0.01 * (k + 1)
    return simulators


def assert_group_equals_singles(model: VehicleModel, samples: int) -> None:
    together, expected = group_of(model), group_of(model)
    units = formation(together).units()
    assert (len(units.groups), len(units.alone)) == (1, 0)
    signals = BatchSimulator(together).advance(samples)
    assert np.any(signals != signals[0])
    for k, simulator in enumerate(expected):
        own, state = alone(simulator, samples)
        np.testing.assert_array_equal(signals[k], own)
        assert_same_state(together[k].state, state)


@pytest.mark.parametrize(("law", "samples"), [("polach", 100), ("fastsim", 10)])
def test_every_creep_law_gives_a_group_the_bits_of_single_runs(law: str, samples: int) -> None:
    assert_group_equals_singles(
        VehicleModel(load_scenario("estimates", [f"contact.creep_law={law}"])), samples
    )


@pytest.mark.parametrize("damper", ["passive-estimate", "sayd-estimate"])
def test_vehicles_with_one_bogie_in_a_group_equal_single_runs(damper: str) -> None:
    overrides = ["vehicle.sets.bogie={front: {origin: [0, 0, 0]}}", "vehicle.bodies.carbody.mass=25000"]
    model = VehicleModel(load_scenario("estimates", [*overrides, f"damper={damper}"]))
    assert (len(model.multibody.wheelset_x), len(model.multibody.yaw_dampers)) == (2, 4)
    assert_group_equals_singles(model, 100)


def test_a_simulator_is_in_a_batch_once(fleet: Fleet) -> None:
    simulators = fleet.vehicles(range(3))
    with pytest.raises(ConfigError, match="different simulators: found one twice"):
        BatchSimulator([*simulators, simulators[1]])


def test_a_changed_vehicle_s_group_alone_is_formed_anew(fleet: Fleet) -> None:
    """Before it is, there are no arguments for a compiled call, which would read what may be gone."""
    which = 2 * [0, 2, 4, 6, 8, 9, 12, 14]
    simulators, expected = fleet.vehicles(which), fleet.vehicles(which)
    batch = formation(simulators)
    before = [table.copy() for table in batch.arguments()[3:]]
    assert [len(table) for table in before] == [2, 2, 2]
    other = VehicleModel(load_scenario("estimates", ["wear=0", "friction=0.1"]))
    plant = other.plant(simulators[WIDTH].speed, simulators[WIDTH].track)
    batch.change(WIDTH, plant)
    expected[WIDTH].plant = plant
    with pytest.raises(RuntimeError, match="call units first"):
        batch.arguments()
    members = batch.units().members
    assert (members[0] < WIDTH).all()
    for old, new in zip(before, batch.arguments()[3:], strict=True):
        np.testing.assert_array_equal(new[0], old[0])
        assert np.any(new[1, :, 0] != old[1, :, 0])
    signals = advance(batch, substeps(simulators))
    for k, simulator in enumerate(expected):
        own, state = alone(simulator)
        np.testing.assert_array_equal(signals[k], own)
        assert_same_state(simulators[k].state, state)
    assert np.any(signals[WIDTH] != signals[0])


def test_some_vehicles_in_groups_of_their_own(fleet: Fleet) -> None:
    """In the order asked for, across the groups of all; the others stand still."""
    simulators = fleet.vehicles(2 * [0, 2, 4, 6, 8, 9, 12, 14])
    batch = formation(simulators)
    chosen = [15, 3, 9, 1, 11, 6, 13, 4, 0]
    some = batch.only(chosen)
    active = np.isin(np.arange(len(simulators)), chosen)
    units = some.units(active)
    assert units.members.tolist() == [chosen[:WIDTH]]
    assert units.alone.tolist() == chosen[WIDTH:]
    signals = advance(some, substeps(simulators), active)
    for k, simulator in enumerate(fleet.vehicles(2 * [0, 2, 4, 6, 8, 9, 12, 14])):
        assert np.any(signals[k]) == active[k]
        if active[k]:
            own, state = alone(simulator)
            np.testing.assert_array_equal(signals[k], own)
            assert_same_state(simulators[k].state, state)


def test_a_vehicle_of_another_kind_needs_new_groups(fleet: Fleet) -> None:
    simulators = fleet.vehicles([0, 2, 4, 6, 8, 9, 12, 14])
    batch = formation(simulators)
    closed = fleet.vehicle(1)
    batch.put(0, closed.plant, closed.state, closed.work)
    with pytest.raises(RuntimeError, match="call units first"):
        batch.arguments()
    units = batch.units()
    assert units.alone.tolist() == [0]
    assert units.members.tolist() == [[1, 2, 3, 4, 5, 6, 7, -1]]
    batch.arguments()


@pytest.mark.parametrize("threads", [0, -1, 10_000])
def test_impossible_threads(fleet: Fleet, threads: int) -> None:
    with pytest.raises(ConfigError, match=r"num_threads: found .*; expected a whole number from 1 to"):
        BatchSimulator(fleet.vehicles(range(2)), threads)


def test_vehicles_that_do_not_fit(fleet: Fleet) -> None:
    with pytest.raises(ConfigError, match="at least one"):
        BatchSimulator([])
    other = Simulator(VehicleModel(load_scenario("estimates", ["vehicle=manchester"])), 150 / KMH)
    with pytest.raises(ConfigError, match="a batch needs"):
        BatchSimulator([fleet.vehicle(0), other])
    slow = Simulator(VehicleModel(load_scenario("estimates", ["assessment.sample_rate=500"])), 300 / KMH)
    with pytest.raises(ConfigError, match="sample rate"):
        BatchSimulator([fleet.vehicle(0), slow])


class Parts(NamedTuple):
    """A named tuple of all that a batch takes: a number, arrays of one and two dimensions."""

    number: float
    row: Array
    matrix: Matrix


parts_of = vehicle_from(Parts)


@kernel(allocates=False)
def _double(table: Integers, i: int) -> float:
    """Change one vehicle's arrays by their addresses; return its number and the sum of its lengths."""
    one = parts_of(table, i)
    for k in range(one.row.shape[0]):
        one.row[k] *= 2.0
    for k in range(1, one.matrix.shape[0]):
        one.matrix[k, 0] *= 2.0
    return float(one.number + one.row.shape[0] + 10 * one.matrix.shape[0] + 100 * one.matrix.shape[1])


def parts(number: float, length: int, shape: tuple[int, int]) -> Parts:
    return Parts(number, np.arange(float(length)), np.ones(shape))


def test_compiled_code_works_on_the_vehicles_own_arrays() -> None:
    """By their addresses: no copies, any lengths, an array shared by two vehicles too."""
    vehicles = [parts(0.5, 3, (2, 4)), parts(0.25, 7, (3, 2))]
    vehicles.append(vehicles[0]._replace(number=0.125))
    batch = RaggedBatch(Parts, vehicles)
    assert [batch.view(i) is vehicle for i, vehicle in enumerate(vehicles)] == [True, True, True]
    assert list(batch) == vehicles
    np.testing.assert_array_equal(batch.table[:, 1, 0], [v.row.ctypes.data for v in vehicles])
    assert [_double(batch.table, i) for i in range(3)] == [423.5, 237.25, 423.125]
    np.testing.assert_array_equal(vehicles[0].row, 4.0 * np.arange(3.0))
    np.testing.assert_array_equal(vehicles[1].row, 2.0 * np.arange(7.0))
    np.testing.assert_array_equal(vehicles[1].matrix, [[1, 1], [2, 1], [2, 1]])
    batch.put(1, parts(1.0, 1, (2, 2)))
    assert _double(batch.table, 1) == 222.0
    np.testing.assert_array_equal(vehicles[1].row, 2.0 * np.arange(7.0))


def test_a_copied_batch_has_its_own_addresses() -> None:
    batch = RaggedBatch(Parts, [parts(0.5, 3, (2, 4)), parts(0.25, 7, (3, 2))])
    for other in (copy.deepcopy(batch), pickle.loads(pickle.dumps(batch))):
        assert _double(other.table, 1) == 237.25
        np.testing.assert_array_equal(other.view(1).row, 2.0 * np.arange(7.0))
        np.testing.assert_array_equal(batch.view(1).row, np.arange(7.0))


def test_a_shallow_copy_has_numbers_of_its_own() -> None:
    """It shares the vehicles' arrays; the numbers, which a tuple holds by value, each keeps for itself."""
    batch = RaggedBatch(Parts, [parts(0.5, 3, (2, 4)), parts(0.25, 7, (3, 2))])
    other = copy.copy(batch)
    np.testing.assert_array_equal(other.table[:, 1:], batch.table[:, 1:])
    assert not np.intersect1d(other.table[:, 0, 0], batch.table[:, 0, 0]).size
    other.put(0, parts(8.0, 1, (2, 2)))
    assert [_double(batch.table, i) for i in range(2)] == [423.5, 237.25]
    assert [_double(other.table, i) for i in range(2)] == [8.0 + 1 + 20 + 200, 237.25]
    np.testing.assert_array_equal(batch.view(1).row, 4.0 * np.arange(7.0))  # doubled by both
    del batch
    gc.collect()
    rubbish = [np.full(1, np.nan) for _ in range(1000)]  # takes the place of what has been freed
    assert [_double(other.table, i) for i in range(2)] == [229.0, 237.25]
    copies = [other, copy.copy(other)]
    copies.pop(0)
    del other
    gc.collect()
    rubbish += [np.full(1, np.nan) for _ in range(1000)]
    assert [_double(copies[0].table, i) for i in range(2)] == [229.0, 237.25]


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        (
            "row",
            np.zeros(3, dtype=np.float32),
            "found float32 of 1 dimensions, expected contiguous, aligned float64 of 1",
        ),
        ("row", np.zeros(3, dtype=np.int64), "found int64 of 1 dimensions"),
        ("row", np.zeros((3, 1)), "found float64 of 2 dimensions"),
        ("row", np.zeros(6)[::2], "expected contiguous"),
        ("matrix", np.zeros(4), "found float64 of 1 dimensions, expected contiguous, aligned float64 of 2"),
        ("matrix", np.zeros((2, 3)).T, "expected contiguous"),
    ],
)
def test_arrays_that_compiled_code_would_misread_are_refused(field: str, value: Array, message: str) -> None:
    wrong = parts(0.5, 3, (2, 4))._replace(**{field: value})
    batch = RaggedBatch(Parts, [parts(0.5, 3, (2, 4))])
    for act in (lambda: RaggedBatch(Parts, [wrong]), lambda: batch.put(0, wrong)):
        with pytest.raises(ConfigError, match=rf"Parts\.{field}: .*{message}"):
            act()


def test_a_plant_s_arrays_are_checked(fleet: Fleet) -> None:
    plant = fleet.vehicle(0).plant
    with pytest.raises(ConfigError, match=r"Plant\.motion_column: found int64"):
        RaggedBatch(Plant, [plant._replace(motion_column=plant.motion_column.astype(np.int64))])


@pytest.fixture
def fresh_kernel(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> str:
    """Cold cache for kernels that are made in a test."""
    monkeypatch.setattr(kernel_module, "CACHE_DIRECTORY", tmp_path_factory.mktemp("kernels"))
    return "the test's kernel (no time at all)"


def test_a_long_compilation_says_that_it_goes_on(fresh_kernel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_module, "REMINDED_EVERY", 1e-3)

    @kernel(announce=fresh_kernel)
    def half(x: float) -> float:
        return 0.5 * x

    said: list[str] = []
    with announced_compilation(said.append):
        half(1.0)
    assert said[1].startswith("still compiling after ")
    assert sum(line.startswith("compiled in ") for line in said) == 1


@pytest.mark.compiled
def test_what_is_merged_into_other_kernels_cannot_be_called_from_python() -> None:
    @kernel(inline=True)
    def half(x: float) -> float:
        return 0.5 * x

    @kernel
    def quarter(x: float) -> float:
        return half(half(x))

    assert quarter(1.0) == 0.25
    with pytest.raises(TypeError, match="half is merged into the kernels that call it"):
        half(1.0)


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
