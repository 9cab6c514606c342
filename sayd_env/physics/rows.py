"""Products of a sparse matrix with the states of several vehicles side by side.

A vector of W vehicles is a flat array: element ``row * W + vehicle``. The product takes each entry of the
matrix once for all vehicles, with W numbers in a vector register: written out in LLVM's own vectors, because
its vectorisers either unroll so short a loop or spoil the long ones. Each vehicle's sum has the same terms in
the same order whatever W is, so its result is the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba.core import cgutils, errors, types

from sayd_env.config.units import Array
from sayd_env.physics.kernel import instructions, kernel

Column = npt.NDArray[np.uint32]
Lanes = tuple[int, ...]
"""A tuple whose length is the number of vehicles side by side: compiled code knows it as a constant."""

SINGLE: Lanes = (0,)
"""One vehicle."""
ABREAST: Lanes = (0,) * 8
"""As many vehicles as a 512-bit register has numbers; two 256-bit registers serve as well."""

RowProduct: TypeAlias = Callable[[Lanes, Column, Array, np.int64, np.int64, Array, Array, int], None]
_alloca: Any = cgutils.alloca_once  # without annotations


class Rows(NamedTuple):
    """A sparse matrix by rows."""

    start: Column
    """(rows + 1,) where the entries of each row begin."""
    column: Column
    """(entries,) their columns."""
    value: Array
    """(entries,) what they are, the same for all vehicles, or (entries * W,) for each vehicle."""


def sparse_rows(matrix: Array) -> Rows:
    """Rows of a matrix (r, c)."""
    row, column = np.nonzero(matrix)
    start = np.zeros(len(matrix) + 1, dtype=np.uint32)
    np.cumsum(np.bincount(row, minlength=len(matrix)), out=start[1:])
    return Rows(start, column.astype(np.uint32), matrix[row, column])


def _check_flat(**arrays: tuple[Any, Any]) -> None:
    """Refuse arrays that an intrinsic would misread: they must be flat, contiguous and of the right type."""
    for name, (array, dtype) in arrays.items():
        fits = isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"
        if not (fits and array.dtype == dtype):
            raise errors.TypingError(f"{name}: found {array}, expected a flat contiguous array of {dtype}")


def _row_product(each: bool, accumulate: bool) -> RowProduct:
    """Intrinsic: one row of a product, with values of `each` vehicle or of all, added or written.

    Called as ``f(lanes, column, value, first, last, x, out, row)``.
    """

    def plain(
        lanes: Lanes,
        column: Column,
        value: Array,
        first: np.int64,
        last: np.int64,
        x: Array,
        out: Array,
        row: int,
    ) -> None:
        def part(array: Array, i: int) -> Array:
            return array[i * len(lanes) : (i + 1) * len(lanes)]

        total = part(out, row) if accumulate else np.zeros(len(lanes))
        for entry in range(first, last):
            factor = part(value, entry) if each else value[entry]
            total = total + factor * part(x, int(column[entry]))
        part(out, row)[:] = total

    @instructions(plain)
    def product(
        _context: Any,
        lanes: Any,
        column: Any,
        value: Any,
        first: Any,
        last: Any,
        x: Any,
        out: Any,
        row: Any,
    ) -> Any:
        _check_flat(column=(column, types.uint32), value=(value, types.float64))
        _check_flat(x=(x, types.float64), out=(out, types.float64))
        width = len(lanes)
        number = ir.DoubleType()
        vector = number if width == 1 else ir.VectorType(number, width)

        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            arrays = [
                context.make_array(signature.args[k])(context, builder, arguments[k]).data
                for k in (1, 2, 5, 6)
            ]
            columns, values, source, target = arrays
            index = context.get_value_type(types.intp)

            def place(base: Any, i: Any) -> Any:
                flat = builder.mul(i, ir.Constant(index, width))
                return builder.bitcast(builder.gep(base, [flat]), vector.as_pointer())

            def repeated(scalar: Any) -> Any:
                if width == 1:
                    return scalar
                empty = ir.Constant(vector, ir.Undefined)
                one = builder.insert_element(empty, scalar, ir.Constant(ir.IntType(32), 0))
                mask = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
                return builder.shuffle_vector(one, empty, mask)

            where = place(target, arguments[7])
            total = _alloca(builder, vector)
            initial = builder.load(where, align=8) if accumulate else ir.Constant(vector, None)
            builder.store(initial, total)
            one = ir.Constant(index, 1)
            with cgutils.for_range_slice(builder, arguments[3], arguments[4], one, index) as (entry, _):
                j = builder.zext(builder.load(builder.gep(columns, [entry])), index)
                if each:
                    factor = builder.load(place(values, entry), align=8)
                else:
                    factor = repeated(builder.load(builder.gep(values, [entry])))
                product = builder.fmul(factor, builder.load(place(source, j), align=8))
                builder.store(builder.fadd(builder.load(total), product), total)
            builder.store(builder.load(total), where, align=8)
            return context.get_dummy_value()

        return types.void(lanes, column, value, first, last, x, out, row), codegen

    return product


_row_of_all = _row_product(each=False, accumulate=False)
_row_of_each = _row_product(each=True, accumulate=False)
_add_row_of_all = _row_product(each=False, accumulate=True)
_add_row_of_each = _row_product(each=True, accumulate=True)


@kernel(inline=True, allocates=False)
def multiply(lanes: Lanes, start: Column, column: Column, value: Array, x: Array, out: Array) -> None:
    """Write the product of a matrix (`Rows`) with x (columns * W,) into out (rows * W,)."""
    rows = start.shape[0] - 1
    if value.shape[0] == column.shape[0]:
        for i in range(rows):
            _row_of_all(lanes, column, value, np.int64(start[i]), np.int64(start[i + 1]), x, out, i)
    else:
        for i in range(rows):
            _row_of_each(lanes, column, value, np.int64(start[i]), np.int64(start[i + 1]), x, out, i)


@kernel(inline=True, allocates=False)
def add_product(lanes: Lanes, start: Column, column: Column, value: Array, x: Array, out: Array) -> None:
    """Add the product of a matrix (`Rows`) with x (columns * W,) to out (rows * W,)."""
    rows = start.shape[0] - 1
    if value.shape[0] == column.shape[0]:
        for i in range(rows):
            _add_row_of_all(lanes, column, value, np.int64(start[i]), np.int64(start[i + 1]), x, out, i)
    else:
        for i in range(rows):
            _add_row_of_each(lanes, column, value, np.int64(start[i]), np.int64(start[i + 1]), x, out, i)
