"""Dampers ``φ = σ(v, q) v``, ``σ ≥ 0``: powers of the speed, by direction, and growing with the position."""

from __future__ import annotations

import math
from typing import Any

from phnn.domain import ANY, NONNEGATIVE, POSITIVE
from phnn.laws.law import ResistorLaw, register
from phnn.laws.namespace import exp, log1p, maximum, minimum, real, shared, where

# Below this share of the reference speed every power is linear, so that friction (the power zero) has a slope at rest.
SMOOTHED = 1e-2
# Largest exponent: more would leave the range of 32 bits at the ends of the parameters' ranges.
_STEEPEST = 3.0
_LOG_SMOOTHED = math.log(SMOOTHED)


@shared
def _power(speed: Any, exponent: Any, reference: Any) -> Any:
    """``z (z² + ε²)^{(n − 1)/2}`` with ``z = v/v₀`` and ``0 ≤ n ≤ 3``: odd, rising, ``±|z|ⁿ`` for ``|z| ≫ ε``."""
    z = speed / reference
    finer = z / SMOOTHED
    n = minimum(exponent, _STEEPEST + 0.0 * exponent)
    return z * exp((n - 1.0) * (_LOG_SMOOTHED + 0.5 * log1p(finer * finer)))


def power_damper(effort: Any, q: Any, forward: Any, backward: Any, exponent: Any, reference: Any) -> Any:
    """``F₊ |v/v₀|ⁿ`` for ``v ≥ 0`` and ``−F₋ |v/v₀|ⁿ`` for ``v < 0``, linear below a hundredth of ``v₀``.

    ``n = 0`` is friction, 1 a viscous damper, 2 drag.
    """
    return where(real(effort) >= 0.0, forward + 0.0 * effort, backward + 0.0 * effort) * _power(
        effort, exponent, reference
    )


def square_damper(effort: Any, q: Any, force: Any, exponent: Any, reference: Any, q0: Any) -> Any:
    """``±F (q/q₀)² |v/v₀|ⁿ``: a damper that grows with the square of the displacement."""
    s = q / q0
    return force * s * s * _power(effort, exponent, reference)


def ramp_damper(effort: Any, q: Any, force: Any, exponent: Any, reference: Any, slope: Any) -> Any:
    """``±F max(c q, 0) |v/v₀|ⁿ``: a damper that acts on the side of the sign of ``c`` and grows with the distance."""
    s = slope * q
    return force * maximum(s, 0.0 * s) * _power(effort, exponent, reference)


_POWER = (NONNEGATIVE, POSITIVE)

register(ResistorLaw("power_damper", power_damper, (0.7, 0.5, 1.6, 0.8), domains=(NONNEGATIVE, NONNEGATIVE, *_POWER)))
register(ResistorLaw("square_damper", square_damper, (0.7, 0.6, 0.8, 0.9), domains=(NONNEGATIVE, *_POWER, POSITIVE)))
register(ResistorLaw("ramp_damper", ramp_damper, (0.7, 1.3, 0.8, 1.1), domains=(NONNEGATIVE, *_POWER, ANY)))
