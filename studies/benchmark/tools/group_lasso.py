"""Group lasso on groups that are orthonormal within themselves (Yuan & Lin 2006; Simon & Tibshirani 2012).

    min ½‖r − Σ_g U_g β_g‖² + λ Σ_g √p_g ‖β_g‖,     U_gᵀU_g = I

With such groups a block of coordinate descent has a closed form: ``β_g = (1 − λ√p_g/‖z_g‖)₊ z_g`` with
``z_g = U_gᵀ(r − Σ_{h≠g} U_h β_h)``. A group that is not needed is zero exactly.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused

Array = NDArray[np.float64]

_ROUNDS, _TOLERANCE = 500, 1e-6
# Directions of a group weaker than this share of its strongest one are left out.
_RANK = 1e-3


@dataclass(frozen=True)
class Step:
    """A point of the path: the penalty λ and (G,) the norms of the groups' coefficients."""

    penalty: float
    norms: Array

    @property
    def active(self) -> tuple[int, ...]:
        """Places of the groups that are not zero, the largest first."""
        return tuple(int(i) for i in np.argsort(-self.norms, kind="stable") if self.norms[i] > 0.0)


def orthonormal(columns: Array) -> Array:
    """(N, p) basis of a group of columns, each of them counted at unit length."""
    sizes = np.linalg.norm(columns, axis=0)
    used = sizes > 0.0
    if not used.any():
        return np.zeros((columns.shape[0], 0))
    left, singular, _ = np.linalg.svd(columns[:, used] / sizes[used], full_matrices=False)
    return np.asarray(left[:, singular > _RANK * singular[0]])


def path(r: Array, groups: Sequence[Array], steps: int = 30, least: float = 1e-3) -> list[Step]:
    """Solutions for penalties that fall from the one at which all groups are zero.

    Args:
        r: (N,) vector to explain; groups: (N, p_g) orthonormal bases.
        steps: how many penalties; least: the last one over the first.

    Raises:
        InputRefused: a group is not orthonormal.
    """
    for i, group in enumerate(groups):
        if not np.allclose(group.T @ group, np.eye(group.shape[1]), atol=1e-8):
            raise InputRefused(f"group_lasso: group {i} is not orthonormal: pass it through orthonormal()")
    edges = np.cumsum([0, *(g.shape[1] for g in groups)])
    own = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    joined = np.hstack(groups)
    gram, right = joined.T @ joined, joined.T @ r
    weights = np.sqrt(np.diff(edges))
    first = max(
        (float(np.linalg.norm(right[o])) / w for o, w in zip(own, weights, strict=True) if w > 0.0), default=0.0
    )
    beta, found = np.zeros(right.size), []
    for penalty in first * np.geomspace(1.0, least, steps):
        _descend(beta, gram, right, own, penalty * weights)
        found.append(Step(float(penalty), np.array([float(np.linalg.norm(beta[o])) for o in own])))
    return found


def _descend(beta: Array, gram: Array, right: Array, own: Sequence[slice], limits: Array) -> None:
    """Block coordinate descent from ``beta``, which is changed in place."""
    size = max(float(np.linalg.norm(right)), 1e-300)
    for _ in range(_ROUNDS):
        change = 0.0
        for rows, limit in zip(own, limits, strict=True):
            z = right[rows] - gram[rows] @ beta + beta[rows]
            length = float(np.linalg.norm(z))
            new = z * (1.0 - limit / length) if length > limit else np.zeros_like(z)
            change = max(change, float(np.linalg.norm(new - beta[rows])))
            beta[rows] = new
        if change < _TOLERANCE * size:
            return
