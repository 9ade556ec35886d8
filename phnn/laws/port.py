"""Port laws: how an input enters the network."""

from __future__ import annotations

from typing import Any

from phnn.domain import ANY
from phnn.laws.law import PortLaw, register


def linear_action(u: Any) -> Any:
    """``ψ(u) = u``."""
    return u


def linear_slope(u: Any) -> Any:
    """``ψ'(u) = 1``."""
    return 1.0 + 0.0 * u


def electrostrictive_action(u: Any, epsilon: Any) -> Any:
    """``ψ(u) = u + ε u²/2``, from the co-energy ``α q (V + ε V²/2)``."""
    return u + 0.5 * epsilon * u * u


def electrostrictive_slope(u: Any, epsilon: Any) -> Any:
    """``ψ'(u) = 1 + ε u``."""
    return 1.0 + epsilon * u


register(PortLaw("linear", linear_action, linear_slope, ()))
register(PortLaw("electrostriction", electrostrictive_action, electrostrictive_slope, (0.2,), (ANY,)))
