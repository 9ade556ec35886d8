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


register(FactorLaw("affine", affine, (0.3, 0.9), (ANY, POSITIVE)))
register(FactorLaw("declining", declining, (0.3,), (ANY,)))
