"""The regression in small: triangular factors of the rows of each block of time.

For least squares, the rows ``[J Θ r]`` of a block are worth no more than the factor ``R`` of their QR decomposition.
Blocks that are drawn or left out are stacked again; what remains after the columns of the base are eliminated is the
trailing part of the factor of the stack (Frisch & Waugh 1933, Econometrica 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.benchmark.residual_force.evidence import Evidence

Array = NDArray[np.float64]

# Directions weaker than this share of the strongest are rounding.
_RANK = 1e-9


@dataclass(frozen=True)
class Compressed:
    """Attributes:
    factors: triangular factor of ``[J Θ r]`` of each block; counts: rows of each block.
    base: number of columns of ``J``; folds: numbers of the blocks of each fold of a cross-validation.
    """

    factors: tuple[Array, ...]
    counts: tuple[int, ...]
    base: int
    folds: tuple[tuple[int, ...], ...]

    def problem(self, blocks: Sequence[int]) -> tuple[Array, Array]:
        """``X`` (K, K) and ``y`` (K,) of a least-squares problem that is that of some blocks, the base eliminated."""
        factor = np.asarray(np.linalg.qr(np.concatenate([self.factors[k] for k in blocks]), mode="r"))
        inner = factor[self.base :, self.base :]
        return inner[:, :-1], inner[:, -1]

    def left_out(self, support: Array, taken: Sequence[int], tested: Sequence[int]) -> float:
        """Sum of squares in some blocks of base and some candidates that others have estimated.

        Args:
            support: (S,) numbers of the candidates.
        """
        chosen = np.concatenate([np.arange(self.base), self.base + np.asarray(support, dtype=int)])
        stacked = np.concatenate([self.factors[k] for k in taken])
        found = np.linalg.lstsq(stacked[:, chosen], stacked[:, -1], rcond=_RANK)[0]
        return float(
            sum(np.sum((self.factors[k][:, -1] - self.factors[k][:, chosen] @ found) ** 2) for k in tested)
        )  # fmt: skip

    def validated(self, support: Array) -> Array:
        """(F,) sums of squares of the folds, each left out in turn."""
        every = range(len(self.factors))
        return np.array(
            [self.left_out(support, [k for k in every if k not in fold], fold) for fold in self.folds]
        )  # fmt: skip


def compressed(evidence: Evidence, columns: Array | None = None, folds: int = 5) -> Compressed:
    """Factor the blocks. Folds are whole recordings where there are enough, blocks in turn otherwise.

    Args:
        columns: (n, K) whitened responses; those to the terms where not given.
    """
    rows = np.column_stack([evidence.base, evidence.columns if columns is None else columns, evidence.target])
    factors = tuple(np.asarray(np.linalg.qr(rows[b], mode="r")) for b in evidence.blocks)
    owners = np.array(evidence.recording_of)
    groups = owners if len(set(evidence.recording_of)) >= folds else np.arange(owners.size)
    found = tuple(tuple(np.flatnonzero(groups % folds == f).tolist()) for f in range(folds))
    return Compressed(
        factors, tuple(b.stop - b.start for b in evidence.blocks), evidence.base.shape[1],
        tuple(f for f in found if f),
    )  # fmt: skip
