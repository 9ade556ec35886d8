"""Factor laws: how a transformer ratio follows a state."""

from __future__ import annotations

from typing import Any

from phnn.domain import ANY, POSITIVE
from phnn.laws.law import FactorLaw, register


def affine(q: Any, kappa: Any, q0: Any) -> Any:
    """``1 + κ q/q₀``."""
    return 1.0 + kappa * q / q0


def declining(z: Any, delta: Any) -> Any:
    """``1 − δ z``."""
    return 1.0 - delta * z


def cubic(q: Any, kappa_1: Any, kappa_2: Any, kappa_3: Any, q0: Any) -> Any:
    """``1 + κ₁ s + κ₂ s² + κ₃ s³``, ``s = q/q₀``."""
    s = q / q0
    return 1.0 + s * (kappa_1 + s * (kappa_2 + s * kappa_3))


register(FactorLaw("affine", affine, (0.3, 0.9), (ANY, POSITIVE)))
register(FactorLaw("declining", declining, (0.3,), (ANY,)))
register(FactorLaw("cubic", cubic, (0.3, -0.2, 0.1, 0.9), (ANY, ANY, ANY, POSITIVE)))
