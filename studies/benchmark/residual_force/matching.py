"""Terms of the table that resemble a force found without them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Terms at most; share of a force at which enough is explained; least share of an effect that counts.
_TERMS, ENOUGH, _COUNTS = 4, 0.9, 0.1
# Share of a force that one or two effects have to explain for it to be listed.
BY_TWO = 0.75


def shares(columns: Array, wanted: Array, effects: Sequence[str], total: float) -> Mapping[str, float]:
    """Share of a response that each effect explains, by orthogonal least squares, forward.

    Terms join as long as less than `ENOUGH` is explained and they bring a share that counts; those of one effect
    count together.

    Args:
        columns: (n, K) responses to the terms; wanted: (n,) response to the force; effects: of the terms, empty for
            what is not listed; total: sum of squares that is to be explained.
    """
    left, basis, found, explained = wanted.copy(), columns.copy(), Counter[str](), 0.0
    lengths = np.linalg.norm(columns, axis=0)
    for _ in range(_TERMS):
        size = np.linalg.norm(basis, axis=0)
        # What earlier terms have taken away leaves directions of rounding.
        usable = size > 1e-3 * lengths
        gain = np.where(usable, (basis.T @ left) ** 2 / np.where(usable, size, 1.0) ** 2, 0.0)
        best = int(np.argmax(gain))
        if not gain[best] > 0.3 * _COUNTS * total:
            break
        direction = basis[:, best] / size[best]
        left = left - direction * (direction @ left)
        basis = basis - np.outer(direction, direction @ basis)
        found[effects[best]] += gain[best] / total
        explained += gain[best] / total
        if explained >= ENOUGH:
            break
    return {name: share for name, share in found.items() if share >= _COUNTS}


def named(found: Mapping[str, float]) -> tuple[frozenset[str], float]:
    """The effects of largest shares, one where it explains enough, and the share of both over `BY_TWO`."""
    ordered = sorted(found.items(), key=lambda item: -item[1])
    for count in (1, 2):
        share = sum(s for _, s in ordered[:count])
        if share >= BY_TWO:
            break
    return frozenset(name for name, _ in ordered[:count]), share / BY_TWO
