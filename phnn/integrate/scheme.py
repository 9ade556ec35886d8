"""The discretisation of a step: one value that every solve takes, with the same equations in every path.

Every scheme advances energy variables ``x``, under the mean inputs ``ū`` of a step of size ``h``, by

    (x⁺ − x)/h = J ē − Σ_r b_r φ_r(b_rᵀ ē, q̄_r) + g ψ(ū),

with modulating variables ``q̄`` at mid-step, and modulator states by their exact flow under the mean drives of the
step. Schemes differ only in the mean effort ``ē`` of dissipative *reducible* storages: linear storages ``e = s x`` with
resistors of their own, such as hysterons, that are coupled to no other reducible one. In a step, a constant current ``i
= Σ_j J_j ē_j + Σ_p g_p ψ_p(ū)`` flows into each of them (`phnn.integrate.partition`).

======================  ============================================================================================
every other storage     discrete gradient, ``ē = (H(x⁺) − H(x))/(x⁺ − x)`` (Itoh & Abe 1988; Gonzalez 1996)
reducible storage:
``DISCRETE_GRADIENT``   exact flow of ``ẋ = i − φ(s x)``, ``ē = (1/h) ∫ s x dt``, if one resistor is piecewise linear
                        and all others are linear; otherwise as under ``RADAU``
``RADAU``               two-stage Radau IIA of ``ẋ = i − φ(s x)``, ``ē = s (3/4 X₁ + 1/4 X₂)`` (`phnn.integrate.stages`)
``MIDPOINT``            discrete gradient too, which is the implicit midpoint rule: ``ē = s (x + x⁺)/2``
======================  ============================================================================================

All of them are passive at every step size, ``H(x⁺) − H(x) ≤ h Σ_p ψ_p(ū) gᵀē``. The first two are L-stable in reducible
storages: they damp a storage that relaxes much faster than a step, where ``MIDPOINT`` lets it ring.
"""

from __future__ import annotations

from enum import Enum

from phnn.errors import InputRefused


class Scheme(Enum):
    """A discretisation; see the table above. Its value is the name that settings use."""

    DISCRETE_GRADIENT = "discrete_gradient"
    RADAU = "radau"
    MIDPOINT = "midpoint"

    @classmethod
    def named(cls, name: str) -> Scheme:
        """The scheme with a given name.

        Raises:
            InputRefused: no scheme has this name; lists the names.
        """
        for scheme in cls:
            if scheme.value == name:
                return scheme
        raise InputRefused(f"scheme = {name!r}: choose one of {', '.join(s.value for s in cls)}")
