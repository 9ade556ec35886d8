"""Laws of ratios, modulator states and ports: how a transformer's ratio follows a state, how slow states follow their
drives and which of them hold heat, and how an input enters the network.
"""

from __future__ import annotations

from typing import Any

from phnn.laws.law import FactorLaw, MemoryLaw, PortLaw, register
from phnn.laws.leaf import relaxation
from phnn.laws.namespace import absolute, maximum, reciprocal, shared
from phnn.parameters import ANY, POSITIVE


def affine(q: Any, kappa: Any, q0: Any) -> Any:
    """Return ``1 + κ q/q₀``."""
    return 1.0 + kappa * q / q0


def declining(z: Any, delta: Any) -> Any:
    """Return ``1 − δ z``."""
    return 1.0 - delta * z


def cubic(q: Any, kappa_1: Any, kappa_2: Any, kappa_3: Any, q0: Any) -> Any:
    """Return ``1 + κ₁ s + κ₂ s² + κ₃ s³``, ``s = q/q₀``."""
    s = q / q0
    return 1.0 + s * (kappa_1 + s * (kappa_2 + s * kappa_3))


register(FactorLaw("affine", affine, (0.3, 0.9), (ANY, POSITIVE)))
register(FactorLaw("declining", declining, (0.3,), (ANY,)))
register(FactorLaw("cubic", cubic, (0.3, -0.2, 0.1, 0.9), (ANY, ANY, ANY, POSITIVE)))


@shared
def advanced(z: Any, h: Any, rate: Any, decay: Any) -> Any:
    """Return ``z + h φ₁(−h d) f``: the exact flow of ``ż = f`` under a constant drive, for ``f`` affine in ``z``."""
    return z + h * relaxation(h * decay)[0] * rate


def thermal_rate(z: Any, power: Any, capacity: Any, resistance: Any, ambient: Any, reference: Any) -> Any:
    """Return ``C_T ż = P − (T − T_a)/R_T`` for the temperature ``T = T_ref + z``."""
    # The two large temperatures first, so that nothing of a small rise is lost.
    return (power - (z - (ambient - reference)) * reciprocal(resistance)) * reciprocal(capacity)


def thermal_decay(capacity: Any, resistance: Any, ambient: Any, reference: Any) -> Any:
    """Return ``1/(R_T C_T)``."""
    return reciprocal(capacity * resistance)


def relaxing_rate(z: Any, drive: Any, tau: Any) -> Any:
    """Return ``τ ż = s − z``."""
    return (drive - z) * reciprocal(tau)


def relaxing_decay(tau: Any) -> Any:
    """Return ``1/τ``."""
    return reciprocal(tau)


def exceeding_rate(z: Any, drive: Any, tau: Any, threshold: Any) -> Any:
    """Return ``τ ż = max(|s|/s₀ − 1, 0) − z``: follows how far a drive of either sign goes beyond a threshold."""
    beyond = absolute(drive) * reciprocal(threshold) - 1.0
    return (maximum(beyond, 0.0 * beyond) - z) * reciprocal(tau)


def exceeding_decay(tau: Any, threshold: Any) -> Any:
    """Return ``1/τ``."""
    return reciprocal(tau)


def ageing_rate(z: Any, drive: Any, tau: Any) -> Any:
    """Return ``τ ż = 1 − z``: how far what takes the time ``τ`` has come since the start of a recording."""
    return (1.0 + 0.0 * drive - z) * reciprocal(tau)


register(MemoryLaw("thermal", thermal_rate, thermal_decay, (0.6, 1.7, 295.0, 293.0), heats=True))
register(MemoryLaw("relaxing", relaxing_rate, relaxing_decay, (0.8,)))
register(MemoryLaw("exceeding", exceeding_rate, exceeding_decay, (0.8, 0.5)))
register(MemoryLaw("ageing", ageing_rate, relaxing_decay, (0.8,), anew=True))


def linear_action(u: Any) -> Any:
    """Return ``ψ(u) = u``."""
    return u


def linear_slope(u: Any) -> Any:
    """Return ``ψ'(u) = 1``."""
    return 1.0 + 0.0 * u


def electrostrictive_action(u: Any, epsilon: Any) -> Any:
    """Return ``ψ(u) = u + ε u²/2``, from the co-energy ``α q (V + ε V²/2)``."""
    return u + 0.5 * epsilon * u * u


def electrostrictive_slope(u: Any, epsilon: Any) -> Any:
    """Return ``ψ'(u) = 1 + ε u``."""
    return 1.0 + epsilon * u


def polynomial_action(u: Any, a_1: Any, a_2: Any, u0: Any) -> Any:
    """Return ``ψ(u) = u (1 + a₁ s/2 + a₂ s²/3)``, ``s = u/u₀``: the ratio is ``ψ' = 1 + a₁ s + a₂ s²``."""
    s = u / u0
    return u * (1.0 + s * (0.5 * a_1 + s * a_2 / 3.0))


def polynomial_slope(u: Any, a_1: Any, a_2: Any, u0: Any) -> Any:
    """Return ``ψ'(u) = 1 + a₁ s + a₂ s²``."""
    s = u / u0
    return 1.0 + s * (a_1 + s * a_2)


def electrostrictive_polynomial_action(u: Any, epsilon: Any, a_1: Any, a_2: Any, u0: Any) -> Any:
    """Return both what electrostriction and what a polynomial add to ``u``."""
    return electrostrictive_action(u, epsilon) + (polynomial_action(u, a_1, a_2, u0) - u)


def electrostrictive_polynomial_slope(u: Any, epsilon: Any, a_1: Any, a_2: Any, u0: Any) -> Any:
    """Return ``ψ'(u) = 1 + ε u + a₁ s + a₂ s²``."""
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


def through_resistance(u: Any, resistance: Any) -> Any:
    """Return ``ψ(u) = u/R``: what a source drives through a linear resistor before anything moves."""
    return u / resistance


def through_resistance_slope(u: Any, resistance: Any) -> Any:
    """Return ``ψ'(u) = 1/R``."""
    return 1.0 / resistance + 0.0 * u


def through_conductance(u: Any, conductance: Any) -> Any:
    """Return ``ψ(u) = G u``, as `through_resistance` with a conductance."""
    return conductance * u


def through_conductance_slope(u: Any, conductance: Any) -> Any:
    """Return ``ψ'(u) = G``."""
    return conductance + 0.0 * u


def through_maxwell(u: Any, stiffness: Any, tau: Any) -> Any:
    """Return ``ψ(u) = u/(k τ)``, as the resistor law of the same name."""
    return u / (stiffness * tau)


def through_maxwell_slope(u: Any, stiffness: Any, tau: Any) -> Any:
    """Return ``ψ'(u) = 1/(k τ)``."""
    return 1.0 / (stiffness * tau) + 0.0 * u


# Port laws of sources that act through a linear resistor.
THROUGH_A_RESISTOR = ("resistance", "conductance", "maxwell")
register(PortLaw("resistance", through_resistance, through_resistance_slope, (0.7,)))
register(PortLaw("conductance", through_conductance, through_conductance_slope, (0.7,)))
register(PortLaw("maxwell", through_maxwell, through_maxwell_slope, (0.7, 0.4)))
