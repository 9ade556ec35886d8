"""Laws of modulator states: how slow states follow their drives, and which of them hold heat."""

from __future__ import annotations

from typing import Any

from phnn.laws.law import Heat, MemoryLaw, register
from phnn.laws.leaf import relaxation
from phnn.laws.namespace import absolute, log1p, maximum, reciprocal, shared


@shared
def advanced(z: Any, h: Any, rate: Any, decay: Any) -> Any:
    """``z + h φ₁(−h d) f``: the exact flow of ``ż = f`` under a constant drive, for ``f`` affine in ``z``."""
    return z + h * relaxation(h * decay)[0] * rate


def average(z: Any, h: Any, rate: Any, decay: Any) -> Any:
    """``z + h φ₂(−h d) f``: the mean of that flow over the step."""
    return z + h * relaxation(h * decay)[1] * rate


def thermal_rate(z: Any, power: Any, capacity: Any, resistance: Any, ambient: Any, reference: Any) -> Any:
    """``C_T ż = P − (T − T_a)/R_T`` for the temperature ``T = T_ref + z``."""
    return (power - thermal_flow(z, capacity, resistance, ambient, reference)) * reciprocal(capacity)


def thermal_decay(capacity: Any, resistance: Any, ambient: Any, reference: Any) -> Any:
    """``1/(R_T C_T)``."""
    return reciprocal(capacity * resistance)


@shared
def thermal_flow(z: Any, capacity: Any, resistance: Any, ambient: Any, reference: Any) -> Any:
    """Heat that flows to the ambient, ``(T − T_a)/R_T``."""
    # The two large temperatures first, so that nothing of a small rise is lost.
    return (z - (ambient - reference)) * reciprocal(resistance)


def thermal_energy(z: Any, capacity: Any, resistance: Any, ambient: Any, reference: Any) -> Any:
    """``U = C_T (T − T_ref)``, which is ``C_T T_ref (exp(S/C_T) − 1)`` in the entropy ``S`` above that at ``T_ref``."""
    return capacity * z


def thermal_entropy(a: Any, b: Any, capacity: Any, resistance: Any, ambient: Any, reference: Any) -> Any:
    """Change of entropy ``C_T log(T_b/T_a)`` between two states."""
    return capacity * log1p((b - a) * reciprocal(reference + a))


def thermal_ambient(capacity: Any, resistance: Any, ambient: Any, reference: Any) -> Any:
    """``T_a``."""
    return ambient


def relaxing_rate(z: Any, drive: Any, tau: Any) -> Any:
    """``τ ż = s − z``."""
    return (drive - z) * reciprocal(tau)


def relaxing_decay(tau: Any) -> Any:
    """``1/τ``."""
    return reciprocal(tau)


def exceeding_rate(z: Any, drive: Any, tau: Any, threshold: Any) -> Any:
    """``τ ż = max(|s|/s₀ − 1, 0) − z``: follows how far a drive of either sign goes beyond a threshold."""
    beyond = absolute(drive) * reciprocal(threshold) - 1.0
    return (maximum(beyond, 0.0 * beyond) - z) * reciprocal(tau)


def exceeding_decay(tau: Any, threshold: Any) -> Any:
    """``1/τ``."""
    return reciprocal(tau)


_HEAT = Heat(thermal_energy, thermal_entropy, thermal_flow, thermal_ambient)

register(MemoryLaw("thermal", thermal_rate, thermal_decay, (0.6, 1.7, 295.0, 293.0), _HEAT))
register(MemoryLaw("relaxing", relaxing_rate, relaxing_decay, (0.8,)))
register(MemoryLaw("exceeding", exceeding_rate, exceeding_decay, (0.8, 0.5)))
