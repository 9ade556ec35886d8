"""Exhaustive hold-out over the catalogue: which element, fitted on some samples, predicts others best, to first order.

With the columns ``Z = [J X]``, sensitivities of the base model and responses to every effect at every point of its
grid, a subset ``S`` of the responses is fitted on the samples T and scored on the samples H:

    β_S = argmin ‖r_T − Z_T β‖²,     ΔH_S = ‖r_H − J_H β_∅‖² − ‖r_H − Z_H β_S‖²

Both need the products ``ZᵀZ`` and ``Zᵀr`` over T and over H alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnosis.linearised_fit import LinearisedFit, direction
from phnn.effects import Effect

Array = NDArray[np.float64]

# Added to the diagonal of normal matrices of columns of unit length.
_RIDGE = 1e-8


@dataclass(frozen=True)
class Candidate:
    """An effect at a point of its grid, where its coefficient is one; ``place``: of its column."""

    effect: Effect
    point: Mapping[str, float]
    place: int


@dataclass(frozen=True)
class Winner:
    """A candidate with its coefficient; ``gain``: ΔH in units of the noise."""

    candidate: Candidate
    coefficient: float
    gain: float

    @property
    def name(self) -> str:
        """Name in the catalogue."""
        return self.candidate.effect.canonical


@dataclass(frozen=True)
class Products:
    """Normal matrices over the samples of a fit and over those that are held out.

    Attributes:
        fit, held: (K + M, K + M) of base columns and candidates, scaled; right, other: (K + M,) with the residual.
        square: of the held-out residual; base: K; sizes: (K + M,) lengths by which columns were divided.
    """

    fit: Array
    right: Array
    held: Array
    other: Array
    square: float
    base: int
    sizes: Array

    def left(self, chosen: Sequence[int]) -> tuple[float, Array]:
        """Sum of squares on what is held out, and the coefficients of the chosen candidates."""
        use = np.concatenate([np.arange(self.base), self.base + np.asarray(chosen, dtype=int)])
        normal = self.fit[np.ix_(use, use)] + _RIDGE * np.eye(use.size)
        beta = np.linalg.solve(normal, self.right[use])
        rest = self.square - float(2.0 * beta @ self.other[use] - beta @ self.held[np.ix_(use, use)] @ beta)
        return rest, (beta / self.sizes[use])[self.base :]


def library(linearised: LinearisedFit, effects: Sequence[Effect]) -> tuple[list[Candidate], Array]:
    """Every effect at every point of its grid, and (N, M) its responses; none that change nothing."""
    candidates: list[Candidate] = []
    columns: list[Array] = []
    for effect in effects:
        for point in effect.grid(linearised.scales):
            column = direction(linearised, effect, point)
            if np.isfinite(column).all() and column.any():
                candidates.append(Candidate(effect, point, len(candidates)))
                columns.append(column)
    return candidates, np.column_stack(columns) if columns else np.zeros((linearised.fit.residual.size, 0))


def products(
    r: Array, base: Array, columns: Array, fitted: NDArray[np.bool_], held: NDArray[np.bool_]
) -> Products:  # fmt: skip
    """Products over the samples that are fitted and those that are held out.

    Args:
        r: (N,) residual; base: (N, K) what moves freely; columns: (N, M) responses of the candidates.
    """
    joined = np.hstack([base, columns])
    sizes = np.maximum(np.linalg.norm(joined[fitted], axis=0), 1e-12 * np.linalg.norm(joined, axis=0).max())
    first, second = joined[fitted] / sizes, joined[held] / sizes
    return Products(
        first.T @ first, first.T @ r[fitted], second.T @ second, second.T @ r[held], float(r[held] @ r[held]),
        base.shape[1], sizes,
    )  # fmt: skip


def winners(found: Products, candidates: Sequence[Candidate]) -> list[Winner]:
    """The best point of every name, the largest gain first; a strength of the wrong sign is none."""
    alone, _ = found.left([])
    best: dict[str, Winner] = {}
    for candidate in candidates:
        rest, coefficients = found.left([candidate.place])
        winner = Winner(candidate, float(coefficients[0]), alone - rest)
        wrong = candidate.effect.one_sided and winner.coefficient <= 0.0
        if not wrong and (winner.name not in best or winner.gain > best[winner.name].gain):
            best[winner.name] = winner
    return sorted(best.values(), key=lambda w: -w.gain)
