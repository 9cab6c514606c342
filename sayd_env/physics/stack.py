"""The arrays of many vehicles, one behind another, in one named tuple: what a compiled loop of theirs reads.

A field of all vehicles is one array; vehicles may differ in the length of a table, a curve or a track.
Compiled code cuts one vehicle's tuple out with `vehicle_of`; Python looks at it with `Stack.view`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, TypeVar, get_type_hints

import numpy as np
import numpy.typing as npt
from numba.core import types
from numba.extending import intrinsic

from sayd_env.config import ConfigError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Fields = TypeVar("Fields", bound=NamedTuple)


class Stack(Generic[Fields]):
    """Named tuples of several vehicles, stacked field by field along the first axis.

    Parameters
    ----------
    vehicles : sequence of named tuples
        All of one type, whose fields are arrays or numbers (float). The first lengths of their arrays may
        differ from vehicle to vehicle, the others not.

    Raises
    ------
    ConfigError
        Arrays that do not fit: vehicles of different structure.

    Attributes
    ----------
    values : named tuple
        Each array's rows of all vehicles, or the (v,) values of a number.
    spans : ndarray, shape (fields, v, 2)
        The first row of each vehicle in each field, and the row behind its last.
    """

    values: Any
    spans: Index

    def __init__(self, vehicles: Sequence[Fields]) -> None:
        self._kind: Any = type(vehicles[0])
        self._numbers = _numbers(self._kind)
        self._fill(list(vehicles))

    def view(self, vehicle: int) -> Fields:
        """One vehicle's tuple: views of the stack's arrays, and numbers."""
        parts = [
            float(values[span[vehicle, 0]]) if number else values[span[vehicle, 0] : span[vehicle, 1]]
            for values, span, number in zip(self.values, self.spans, self._numbers, strict=True)
        ]
        result: Fields = self._kind(*parts)
        return result

    def put(self, vehicle: int, fields: Fields) -> None:
        """Replace one vehicle's values; those of the others stay.

        Arrays that are longer than the place they have move the whole stack: views taken before then no
        longer show it.
        """
        _check(self._kind, [self.view(vehicle), fields])
        lengths = [len(np.atleast_1d(value)) for value in fields]
        if np.any(lengths > np.diff(self._starts, axis=1)[:, vehicle]):
            vehicles = [self.view(i) for i in range(self.spans.shape[1])]
            vehicles[vehicle] = fields
            self._fill(vehicles)
            return
        first = self._starts[:, vehicle]
        self.spans[:, vehicle, 1] = first + lengths
        for target, start, length, value in zip(self.values, first, lengths, fields, strict=True):
            target[start : start + length] = value

    def _fill(self, vehicles: list[Fields]) -> None:
        _check(self._kind, vehicles)
        columns = [[np.atleast_1d(value) for value in column] for column in zip(*vehicles, strict=True)]
        self.values = self._kind(*(np.concatenate(column) for column in columns))
        lengths = [[len(value) for value in column] for column in columns]
        self._starts = np.zeros((len(lengths), len(vehicles) + 1), dtype=np.int64)
        np.cumsum(lengths, axis=1, out=self._starts[:, 1:])
        self.spans = np.stack([self._starts[:, :-1], self._starts[:, 1:]], axis=2)


def _numbers(kind: Any) -> list[bool]:
    hints = get_type_hints(kind)
    return [hints[name] is float for name in kind._fields]


def _check(kind: Any, vehicles: Sequence[Any]) -> None:
    for name, column in zip(kind._fields, zip(*vehicles, strict=True), strict=True):
        if len({np.shape(value)[1:] for value in column}) > 1:
            raise ConfigError(
                f"a batch needs vehicles with equal numbers of unknowns, dampers and stops; '{name}' differs"
            )


def _rows(values: Array, spans: Index, field: int, vehicle: int) -> Array:
    return values[spans[field, vehicle, 0] : spans[field, vehicle, 1]]


def _number(values: Array, spans: Index, field: int, vehicle: int) -> float:
    return float(values[spans[field, vehicle, 0]])


def _vehicle_of(typing_context: Any, values: Any, spans: Any, vehicle: Any) -> Any:
    """Cut one vehicle's named tuple out of a stack, in compiled code (`Stack.view` is its Python twin).

    A Numba intrinsic, so that a field that somebody adds to `Plant` needs no second list of fields here.
    """
    numbers = _numbers(values.instance_class)
    parts = [types.float64 if number else array for number, array in zip(numbers, values, strict=True)]
    result: Any = types.BaseTuple.from_types(parts, values.instance_class)  # type: ignore[no-untyped-call]

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        stacked, bounds, index = arguments
        pieces = []
        for k, part in enumerate(parts):
            cut = _number if numbers[k] else _rows
            field = context.get_constant(types.int64, k)
            inputs = [builder.extract_value(stacked, k), bounds, field, index]
            pieces.append(
                context.compile_internal(builder, cut, part(values[k], spans, types.int64, vehicle), inputs)
            )
        return context.make_tuple(builder, result, pieces)

    return result(values, spans, vehicle), generate


vehicle_of: Any = intrinsic(_vehicle_of)
