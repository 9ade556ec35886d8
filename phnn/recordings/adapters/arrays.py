"""Mappings from names to arrays, as numpy.savez takes them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from phnn.recordings.adapters.given import Given, where_of
from phnn.recordings.array_files import stored_arrays, table_of


def is_arrays(data: object) -> bool:
    """Whether an object maps names to numbers, arrays or lists."""
    return isinstance(data, Mapping) and bool(data) and all(map(is_numbers, data.values()))


def given_arrays(data: Mapping[str, Any], name: str = "") -> Given:
    """The arrays by name, the columns of a matrix as ``name[0]``, ….

    Raises:
        InputRefused: there are no arrays of numbers.
    """
    where = where_of(data, name)
    return Given(name, table_of(where, stored_arrays({str(k): v for k, v in data.items()})))


def is_numbers(value: Any) -> bool:
    """Whether an object is an array of real numbers, or a list of some."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        # Lists of unequal lengths, tensors on another device or with gradients.
        return False
    return array.dtype.kind in "iufb" and array.ndim > 0
