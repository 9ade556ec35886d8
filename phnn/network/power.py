"""The terms of a power balance."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


class PowerBalance(NamedTuple):
    """``dH/dt = Σ supplied − Σ dissipated``; the defect is a rounding error.

    Attributes:
        stored: (...) ``∇Hᵀ ẋ`` [W].
        dissipated: (..., R) ``ε_r φ_r(ε_r) ≥ 0`` of every resistor [W].
        supplied: (..., P) ``ψ(u) gᵀ∇H`` of every port [W].
        defect: (...) ``stored − Σ supplied + Σ dissipated`` [W].
    """

    stored: Tensor
    dissipated: Tensor
    supplied: Tensor
    defect: Tensor
