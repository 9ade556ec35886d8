"""Port laws: how an input enters the network."""

from __future__ import annotations

from typing import Any

from phnn.domain import ANY, POSITIVE
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


def polynomial_action(u: Any, a_1: Any, a_2: Any, u0: Any) -> Any:
    """``ψ(u) = u (1 + a₁ s/2 + a₂ s²/3)``, ``s = u/u₀``: the ratio follows the input, ``ψ' = 1 + a₁ s + a₂ s²``."""
    s = u / u0
    return u * (1.0 + s * (0.5 * a_1 + s * a_2 / 3.0))


def polynomial_slope(u: Any, a_1: Any, a_2: Any, u0: Any) -> Any:
    """``ψ'(u) = 1 + a₁ s + a₂ s²``."""
    s = u / u0
    return 1.0 + s * (a_1 + s * a_2)


def electrostrictive_polynomial_action(u: Any, epsilon: Any, a_1: Any, a_2: Any, u0: Any) -> Any:
    """Both what electrostriction and what a polynomial add to ``u``."""
    return electrostrictive_action(u, epsilon) + (polynomial_action(u, a_1, a_2, u0) - u)


def electrostrictive_polynomial_slope(u: Any, epsilon: Any, a_1: Any, a_2: Any, u0: Any) -> Any:
    """``ψ'(u) = 1 + ε u + a₁ s + a₂ s²``."""
    return epsilon * u + polynomial_slope(u, a_1, a_2, u0)


register(PortLaw("linear", linear_action, linear_slope, ()))
register(PortLaw("electrostriction", electrostrictive_action, electrostrictive_slope, (0.2,), (ANY,)))
register(PortLaw("polynomial", polynomial_action, polynomial_slope, (0.2, -0.1, 0.9), (ANY, ANY, POSITIVE)))
register(
    PortLaw(
        "electrostrictive_polynomial", electrostrictive_polynomial_action, electrostrictive_polynomial_slope,
        (0.3, 0.2, -0.1, 0.9), (ANY, ANY, ANY, POSITIVE),
    )
)  # fmt: skip
