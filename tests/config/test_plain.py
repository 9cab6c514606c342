"""Plain values: NumPy, models and dataclasses as JSON knows them."""

from __future__ import annotations

import enum
import json
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from sayd_env.config import Model
from sayd_env.config.plain import jsonable


class Colour(enum.Enum):
    RED = "red"


class Section(Model):
    speed: float = 80.0


@dataclass(frozen=True)
class Values:
    values: np.ndarray


def test_numpy_values_become_plain_json_and_non_finite_numbers_become_null():
    value = {
        "array": np.array([[1.5, np.nan], [np.inf, -2.0]]),
        "single": np.float32(0.5),
        "double": np.float64("nan"),
        "integer": np.int32(3),
        "flag": np.bool_(True),
        "enum": Colour.RED,
        "path": Path("a/b"),
        "model": Section(),
        "dataclass": Values(np.zeros(1)),
        "none": None,
        "view": MappingProxyType({"x": np.float64(0.1)}),
        2: (1, "x"),
    }
    expected = {
        "array": [[1.5, None], [None, -2.0]],
        "single": 0.5,
        "double": None,
        "integer": 3,
        "flag": True,
        "enum": "red",
        "path": "a/b",
        "model": {"speed": 80.0},
        "dataclass": {"values": [0.0]},
        "none": None,
        "view": {"x": 0.1},
        "2": [1, "x"],
    }
    assert jsonable(value) == expected
    assert json.loads(json.dumps(jsonable(value), allow_nan=False)) == expected


@pytest.mark.parametrize(
    ("value", "kind"), [(object(), "object"), (np.array([1j]), "complex"), (len, "function")]
)
def test_a_value_json_does_not_know_is_refused_by_its_kind(value: Any, kind: str):
    with pytest.raises(TypeError, match=kind):
        jsonable({"a": [value]})
