"""An array in a file, known by name, shape and type before its numbers are read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# Kinds of numpy's types that are numbers; complex ones are refused where somebody asks for them.
NUMBERS = "iufbc"


@dataclass(frozen=True)
class Stored:
    """Attributes:
    name: of the array, groups before it.
    shape, dtype: as the file states them.
    load: reads the numbers; raises InputRefused where they are damaged or too large.
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype
    load: Callable[[], np.ndarray]


def lazily(stored: Stored) -> Callable[[], np.ndarray]:
    """The numbers of an array, read at the first call and kept for further ones."""
    kept: list[np.ndarray] = []

    def get() -> np.ndarray:
        if not kept:
            kept.append(stored.load())
        return kept[0]

    return get
