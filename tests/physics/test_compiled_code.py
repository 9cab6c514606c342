"""What the compiler makes of the hot loops: vector instructions, looked at in freshly compiled code.

A loop that loses its vector instructions still gives the same numbers, several times as slowly. Here it shows
without a clock. Compiled is for the machine that the test runs on; what is asked for holds with AVX2 and with
AVX-512, in whole registers of either.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

import pytest
from llvmlite import binding
from numba import types

from sayd_env.physics import kernel as kernel_module
from sayd_env.physics import line, rows, sayd, step
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import Plant, State, Work
from sayd_env.physics.ragged import vehicle_from
from sayd_env.physics.rows import ABREAST, SINGLE, Lanes

ARRAY = types.Array(types.float64, 1, "C")
COLUMN = types.Array(types.uint32, 1, "C")

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(
        not binding.get_host_cpu_features().get("avx2", False), reason="the instructions looked for need AVX2"
    ),
]


@kernel(distinct=True, allocates=False)
def _read_table(x: Any, table: Any, out: Any) -> None:
    """Loop with a read at a computed place."""
    for i in range(out.shape[0]):
        out[i] = 2.0 * table[int(x[i])]


def assembly(function: Any, *arguments: Any) -> str:
    """Text of a kernel's code, compiled here as its decorator does: code from a cache has no text."""
    options = {name: function.targetoptions[name] for name in ("error_model", "nogil", "forceinline", "_nrt")}
    loop = kernel_module.njit(pipeline_class=function._compiler.pipeline_class, **options)(function.py_func)
    loop.compile(arguments)
    (text,) = loop.inspect_asm().values()
    return str(text)


def bodies(text: str) -> list[Counter[str]]:
    """Counts of arithmetic instructions and gathers in the stretches between labels.

    A packed instruction is counted without the `v` of those with three operands.
    """
    found = []
    for block in re.split(r"^\.LBB\w+:", text, flags=re.MULTILINE):
        found.append(
            Counter(re.findall(r"^\s+v?((?:add|sub|mul|div|sqrt)[ps]d|gather\w+)\s", block, re.MULTILINE))
        )
    return found


def gathers(body: Counter[str]) -> int:
    return sum(count for name, count in body.items() if name.startswith("gather"))


@pytest.fixture(scope="module")
def machine_gathers() -> bool:
    """Whether the compiler reads tables by gathers: where they are slow it takes the numbers one by one."""
    return any(gathers(body) for body in bodies(assembly(_read_table, ARRAY, ARRAY, ARRAY)))


def lanes(of: Lanes) -> Any:
    return types.UniTuple(types.int64, len(of))


@pytest.mark.parametrize("abreast", [SINGLE, ABREAST], ids=["single", "abreast"])
def test_contact_is_vector_instructions(abreast: Lanes, machine_gathers: bool) -> None:
    """One body holds all of the contact: its two divisions, its two roots, nothing but its table one by one.

    Gathers: two nodes of the contact table with 13 numbers each. Where there are none, the place in the table
    is found wheel by wheel, and that alone: a difference, a product and the table's end, a sum, for each of
    the four in a register.
    """
    found = bodies(assembly(step._touch, lanes(abreast), *(6 * [ARRAY])))
    (body,) = (b for b in found if b["divpd"])
    assert body["divpd"] == 2
    assert body["sqrtpd"] == 2
    assert body["mulpd"] > 70
    assert body["divsd"] == body["sqrtsd"] == 0
    assert gathers(body) <= 26
    if machine_gathers:
        assert not any(name.endswith("sd") for name in body)
    else:
        assert max(body["subsd"], body["mulsd"], body["addsd"]) <= 4


@pytest.mark.parametrize("abreast", [SINGLE, ABREAST], ids=["single", "abreast"])
def test_resultants_are_vector_instructions(abreast: Lanes) -> None:
    found = bodies(assembly(step._resultants, lanes(abreast), *(5 * [ARRAY])))
    (body,) = (b for b in found if b["divpd"])
    assert body["mulpd"] > 15
    assert gathers(body) == 0
    assert not any(name.endswith("sd") for name in body)


@pytest.mark.parametrize("product", [rows.multiply, rows.add_product], ids=["multiply", "add_product"])
def test_sums_of_vehicles_abreast_are_vector_instructions(product: Any) -> None:
    """One multiplication and one addition for the entries of all vehicles; no number stands alone."""
    text = assembly(product, lanes(ABREAST), COLUMN, COLUMN, ARRAY, ARRAY, ARRAY)
    total = sum(bodies(text), Counter())
    assert total["mulpd"] == total["addpd"] > 0
    assert total["mulsd"] == total["addsd"] == 0


@pytest.mark.parametrize("abreast", [SINGLE, ABREAST], ids=["single", "abreast"])
def test_the_hydraulics_are_vector_instructions(abreast: Lanes) -> None:
    """Only table reads gather, four in each of three Newton steps; roots and divisions are packed."""
    arguments = (types.float64, types.int64, *(4 * [ARRAY]))
    found = bodies(assembly(sayd.integrate, lanes(abreast), *arguments))
    (body,) = (b for b in found if b["divpd"])
    assert body["divpd"] == 6
    assert body["sqrtpd"] == 11
    assert gathers(body) <= 12
    assert not any(name.endswith("sd") for name in body)


@kernel(allocates=False)
def _step_vehicles(lanes: Lanes, plants: Any, states: Any, works: Any) -> None:
    step.steps(lanes, _plant_of(plants, 0), _state_of(states, 0), _work_of(works, 0), 1, True)


_plant_of, _state_of, _work_of = vehicle_from(Plant), vehicle_from(State), vehicle_from(Work)


@pytest.mark.slow
@pytest.mark.parametrize("abreast", [SINGLE, ABREAST], ids=["single", "abreast"])
def test_the_loops_are_the_same_within_the_step(abreast: Lanes) -> None:
    """Merged into the whole step, the loops keep what they have alone."""
    tables = types.Array(types.int64, 3, "C")
    found = bodies(assembly(_step_vehicles, lanes(abreast), tables, tables, tables))
    packed = [b for b in found if b["divpd"] and b["divsd"] == b["sqrtsd"] == 0]
    contact = [b for b in packed if (b["divpd"], b["sqrtpd"]) == (2, 2) and b["mulpd"] > 70]
    assert len(contact) == 1
    assert gathers(contact[0]) <= 26
    hydraulics = [b for b in packed if (b["divpd"], b["sqrtpd"]) == (6, 11)]
    assert len(hydraulics) == 1
    assert gathers(hydraulics[0]) <= 12


def test_what_a_line_does_is_vector_instructions() -> None:
    """Two loops over vehicles side by side, for their centres and for a body; places in the table packed.

    For a curve's polynomials alone, 13 products and more; a vehicle by itself has nothing beside it.
    """
    arrays = [ARRAY, ARRAY, ARRAY, COLUMN, ARRAY, ARRAY, ARRAY, types.float64, *(3 * [ARRAY])]
    found = bodies(assembly(line._enter, lanes(ABREAST), *arrays))
    centre, body = (b for b in found if b["divpd"])
    assert centre["mulpd"] >= 13
    assert body["mulpd"] >= 60
