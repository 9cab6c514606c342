"""Many vehicles in one compiled call, each with arrays of its own: a ragged batch of named tuples.

Compiled code gets the addresses and shapes of all arrays in one table and makes one vehicle's named tuple of
them. So a loop over vehicles takes a handful of arguments, whatever a vehicle consists of; arrays may
differ in length from vehicle to vehicle, several vehicles may share one, and none is copied.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import (
    Annotated,
    Any,
    Generic,
    NamedTuple,
    SupportsIndex,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.np import arrayobj, numpy_support

from sayd_env.config import ConfigError
from sayd_env.config.units import Array, Integers
from sayd_env.physics.kernel import instructions

Matrix = Annotated[Array, 2]
"""An array of two dimensions, where a named tuple says `Array` for one."""
Cube = Annotated[Array, 3]
IndexMatrix = Annotated[Integers, 2]
Fields = TypeVar("Fields", bound=NamedTuple)

_make_array: Any = arrayobj.make_array  # without annotations
_populate_array: Any = arrayobj.populate_array

_COLUMNS = 4  # address and up to three lengths


def _field(hint: Any) -> tuple[np.dtype[Any], int]:
    """Type and number of dimensions of a field; a number has none."""
    if hint is float:
        return np.dtype(np.float64), 0
    dimensions = 1
    if get_origin(hint) is Annotated:
        hint, dimensions = get_args(hint)
    return np.dtype(get_args(get_args(hint)[1])[0]), dimensions


@cache
def _fields(kind: Any) -> tuple[tuple[np.dtype[Any], int], ...]:
    hints = get_type_hints(kind, include_extras=True)
    return tuple(_field(hints[name]) for name in kind._fields)


class RaggedBatch(Generic[Fields]):
    """Named tuples of several vehicles.

    Parameters
    ----------
    kind : type
        Of the named tuples; its annotations say which fields are numbers (float) and how many dimensions the
        arrays have.
    vehicles : sequence of named tuples
        Contiguous arrays of these types. They stay the vehicles' own: whoever changes them in place
        changes the batch.

    Raises
    ------
    ConfigError
        A field of another type or number of dimensions.

    Attributes
    ----------
    table : ndarray, shape (v, fields, 4)
        Address and up to three lengths of each array: what compiled code takes.
    """

    table: Any

    def __init__(self, kind: type[Fields], vehicles: Sequence[Fields]) -> None:
        self._types = _fields(kind)
        self._vehicles: list[Any] = list(vehicles)
        self._numbers: list[list[Array]] = [[] for _ in vehicles]
        self.table = np.zeros((len(self._vehicles), len(self._types), _COLUMNS), dtype=np.int64)
        for i, fields in enumerate(self._vehicles):
            self.put(i, fields)

    def __len__(self) -> int:
        return len(self._vehicles)

    def __iter__(self) -> Iterator[Fields]:
        return iter(self._vehicles)

    def view(self, vehicle: int) -> Fields:
        """One vehicle's tuple."""
        found: Fields = self._vehicles[vehicle]
        return found

    def put(self, vehicle: int, fields: Fields) -> None:
        """Replace one vehicle's tuple, by reference."""
        numbers = []
        for k, (value, (kind, dimensions)) in enumerate(zip(fields, self._types, strict=True)):
            if dimensions == 0:
                array = np.array([value], dtype=np.float64)
                numbers.append(array)
            else:
                array = self._checked(fields, k, value, kind, dimensions)
            self.table[vehicle, k, 0] = array.ctypes.data
            self.table[vehicle, k, 1 : 1 + array.ndim] = array.shape
        self._numbers[vehicle] = numbers  # keeps them alive
        self._vehicles[vehicle] = fields

    def _checked(self, fields: Any, k: int, value: Any, kind: np.dtype[Any], dimensions: int) -> Any:
        fits = value.dtype == kind and value.ndim == dimensions
        if not (fits and value.flags.c_contiguous and value.flags.aligned):
            raise ConfigError(
                f"{type(fields).__name__}.{fields._fields[k]}: found {value.dtype} of {value.ndim} "
                f"dimensions, expected contiguous, aligned {kind} of {dimensions}"
            )
        return value

    def __getstate__(self) -> dict[str, Any]:
        return {"types": self._types, "vehicles": list(self._vehicles)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A copy has its arrays elsewhere, and numbers of its own."""
        self._types, self._vehicles = state["types"], state["vehicles"]
        self._numbers = [[] for _ in self._vehicles]
        self.table = np.zeros((len(self._vehicles), len(self._types), _COLUMNS), dtype=np.int64)
        for i, fields in enumerate(self._vehicles):
            self.put(i, fields)


def vehicle_from(kind: type[Fields]) -> Callable[[Integers, SupportsIndex], Fields]:
    """Compiled counterpart of `RaggedBatch.view`: ``f(table, i)`` makes vehicle i's named tuple.

    A Numba intrinsic, so that a field that somebody adds needs no second list of fields here.
    """

    def plain(table: Integers, vehicle: SupportsIndex) -> Fields:
        entries = zip(table[vehicle], _fields(kind), strict=True)
        return kind(*(_in_memory(entry, *field) for entry, field in entries))

    @instructions(plain)
    def view(_context: Any, table: Any, vehicle: Any) -> Any:
        parts: list[Any] = [
            types.float64
            if dimensions == 0
            else types.Array(numpy_support.from_dtype(dtype), dimensions, "C")
            for dtype, dimensions in _fields(kind)
        ]
        result: Any = types.BaseTuple.from_types(parts, kind)  # type: ignore[no-untyped-call]

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            entries = _make_array(signature.args[0])(context, builder, arguments[0]).data
            index = context.get_value_type(types.intp)

            def constant(value: int) -> Any:
                return ir.Constant(index, value)

            first = builder.mul(
                context.cast(builder, arguments[1], signature.args[1], types.intp),
                constant(len(parts) * _COLUMNS),
            )

            def entry(k: int, column: int) -> Any:
                place = builder.add(first, constant(k * _COLUMNS + column))
                return builder.load(builder.gep(entries, [place]))

            pieces = []
            for k, part in enumerate(parts):
                data = builder.inttoptr(entry(k, 0), context.get_data_type(_item(part)).as_pointer())
                pieces.append(
                    builder.load(data)
                    if part is types.float64
                    else _array(context, builder, part, data, [entry(k, 1 + d) for d in range(part.ndim)])
                )
            return context.make_tuple(builder, result, pieces)

        return result(table, vehicle), generate

    return view


def _in_memory(entry: Integers, dtype: np.dtype[Any], dimensions: int) -> Any:
    """What lies at an address of a batch's table, which somebody else keeps alive."""
    address, *lengths = entry.tolist()
    shape = lengths[:dimensions]
    memory = (ctypes.c_char * max(1, math.prod(shape) * dtype.itemsize)).from_address(address)
    array = np.ndarray(shape, dtype, buffer=memory)
    return array if dimensions else array.item()


def _item(part: Any) -> Any:
    return part.dtype if isinstance(part, types.Array) else part


def _array(context: Any, builder: Any, kind: Any, data: Any, shape: list[Any]) -> Any:
    """A contiguous array at an address, which somebody else keeps alive."""
    array = _make_array(kind)(context, builder)
    index = context.get_value_type(types.intp)
    size = ir.Constant(index, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    strides = [size]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    _populate_array(array, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
    return array._getvalue()
