"""Values as JSON knows them: what is stored, printed, or hashed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python


def jsonable(value: Any) -> Any:
    """Turn NumPy values, models, dataclasses, enums and paths into plain JSON values; NaN and inf into None.

    Raises
    ------
    TypeError
        A value of another type.
    """
    return to_jsonable_python(value, fallback=_plainer, inf_nan_mode="null")


def _plainer(value: Any) -> Any:
    """What pydantic does not know, as something that it knows."""
    if isinstance(value, np.generic | np.ndarray):
        if np.iscomplexobj(value):
            raise TypeError("a result holds complex numbers, which JSON does not know")
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a result holds a {type(value).__name__}, which JSON does not know")
