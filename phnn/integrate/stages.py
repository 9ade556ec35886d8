"""Leaves without an exact flow, under the constant current of a step.

Two-stage Radau IIA (Butcher 1964; Hairer & Wanner 1996, Sec. IV.5) for a linear storage ``E = s x``:

    X_1 = x + h (5/12 f_1 − 1/12 f_2),   X_2 = x⁺ = x + h (3/4 f_1 + 1/4 f_2),
    f_i = i − φ(s X_i),                  ē = 3/4 E_1 + 1/4 E_2.

It is L-stable, of third order, and algebraically stable, ``H(x⁺) − H(x) ≤ h i ē − h Σ b_i E_i φ(E_i)``, hence passive.
Multiplied by the inverse of its matrix the stage equations are monotone where the resistor is, with weights
``(3/4, 1/4)``. A nonlinear storage takes the discrete gradient, ``x⁺ = x + h (i − φ(ē(x, x⁺)))``.

Both rules are written as defects of their equations, which the torch module evaluates as well.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from phnn.integrate.dispatch import stay_outside
from phnn.integrate.roots import NOTHING, RELAXED, TOLERANCE, make_root
from phnn.laws.namespace import TINY, real

WEIGHTS = (0.75, 0.25)
_ITERATIONS = 80
_STRICT = 20
_HALVINGS = 40
_SUFFICIENT = 1e-4
_SEPARATION = 0.1


def radau_defects(d1: Any, d2: Any, current: Any, h: Any, lost1: Any, lost2: Any) -> Any:
    """``A⁻¹ d − h f`` for the stage displacements ``d_i = X_i − x`` and the flows ``φ_i`` lost there."""
    return (
        1.5 * d1 + 0.5 * d2 - h * (current - lost1),
        2.5 * d2 - 4.5 * d1 - h * (current - lost2),
    )


def gradient_defect(d: Any, current: Any, h: Any, lost: Any) -> Any:
    """``x⁺ − x − h (i − φ(ē))``."""
    return d - h * (current - lost)


def make_radau(flow: Callable[..., Any], compiled: Callable[..., Any]) -> Callable[..., Any]:
    """``radau(x, current, h, s, context) -> (x⁺, ē)``, NaN where the stages were not found.

    Newton's method with a line search; where no step along it reduces the defects, the iterate is projected on a plane
    that separates it from the solution, which always brings it nearer where the equations are monotone (Solodov &
    Svaiter 1998). The last step is taken with the perturbed numbers, by the implicit function theorem.

    Args:
        flow: ``(state, context) -> φ``, what the resistors of the leaf take.
        compiled: compiler of the inner functions.
    """
    defects = compiled(radau_defects)

    @compiled
    def evaluated(one: Any, two: Any, x: Any, i: Any, h: Any, context: Any) -> Any:
        """Defects, slopes of the lost flows, and sizes of the terms that cancel, at real stages."""
        stay_outside()
        plain1, plain2 = flow(complex(one, 0.0), context), flow(complex(two, 0.0), context)
        moved1, moved2 = flow(complex(one, TINY), context), flow(complex(two, TINY), context)
        g1, g2 = defects(one - x, two - x, i, h, plain1.real, plain2.real)
        s1, s2 = (moved1.imag - plain1.imag) / TINY, (moved2.imag - plain2.imag) / TINY
        size = h * abs(i) + 4.5 * (abs(one) + abs(two) + abs(x))
        size1 = size + h * abs(plain1.real) + h * abs(s1 * one)
        size2 = size + h * abs(plain2.real) + h * abs(s2 * two)
        return g1, g2, s1, s2, size1, size2

    @compiled
    def newton(g1: Any, g2: Any, a: Any, b: Any) -> Any:
        """``−J⁻¹ g`` with ``J = [[a, ½], [−9/2, b]]``."""
        inverse = 1.0 / (a * b + 2.25)
        return -(b * g1 - 0.5 * g2) * inverse, -(4.5 * g1 + a * g2) * inverse

    @compiled
    def improved(one: Any, two: Any, x: Any, i: Any, h: Any, s1: Any, s2: Any, before: Any, context: Any) -> Any:
        """The next stages along a Newton step, or their projection."""
        stay_outside()
        separated = False
        z1, z2, p1, p2 = one, two, 0.0, 0.0
        part = 1.0
        for _ in range(_HALVINGS):
            t1, t2 = one + part * s1, two + part * s2
            lost1, lost2 = flow(complex(t1, 0.0), context), flow(complex(t2, 0.0), context)
            g1, g2 = defects(t1 - x, t2 - x, i, h, lost1.real, lost2.real)
            if abs(g1) + abs(g2) <= (1.0 - _SUFFICIENT * part) * before:
                return t1, t2
            if not separated and -(0.75 * g1 * s1 + 0.25 * g2 * s2) >= _SEPARATION * part * (s1 * s1 + s2 * s2):
                separated = True
                z1, z2, p1, p2 = t1, t2, 0.75 * g1, 0.25 * g2
            part *= 0.5
        if not separated:
            return one, two
        along = (p1 * (one - z1) + p2 * (two - z2)) / (p1 * p1 + p2 * p2)
        return one - along * p1, two - along * p2

    @compiled
    def radau(x: Any, current: Any, h: Any, s: Any, context: Any) -> Any:
        start, i = real(x), real(current)
        one, two = start, start
        a, b = np.nan, np.nan
        for iteration in range(_ITERATIONS):
            g1, g2, slope1, slope2, size1, size2 = evaluated(one, two, start, i, h, context)
            tolerance = TOLERANCE if iteration < _STRICT else RELAXED
            if abs(g1) <= tolerance * size1 + NOTHING and abs(g2) <= tolerance * size2 + NOTHING:
                a, b = 1.5 + h * slope1, 2.5 + h * slope2
                break
            s1, s2 = newton(g1, g2, 1.5 + h * slope1, 2.5 + h * slope2)
            one, two = improved(one, two, start, i, h, s1, s2, abs(g1) + abs(g2), context)
            if not (np.isfinite(one) and np.isfinite(two)):
                break
        first, last = one + 0.0 * current, two + 0.0 * current
        g1, g2 = defects(first - x, last - x, current, h, flow(first, context), flow(last, context))
        s1, s2 = newton(g1, g2, a, b)
        first, last = first + s1, last + s2
        return last, s * (0.75 * first + 0.25 * last)

    return radau


def make_gradient(flow: Callable[..., Any], compiled: Callable[..., Any]) -> Callable[..., Any]:
    """``gradient(x, current, h, context) -> x⁺``, NaN where it was not found.

    Args:
        flow: ``(x, x⁺, context) -> φ(ē)``.
        compiled: compiler of the inner functions.
    """
    defect = compiled(gradient_defect)

    @compiled
    def value_at(end: Any, context: Any) -> Any:
        x, i, h, inner = context
        lost = flow(complex(x, 0.0), complex(end, 0.0), inner).real
        return defect(end - x, i, h, lost), abs(end) + abs(x) + h * (abs(i) + abs(lost))

    @compiled
    def slope_at(end: Any, context: Any) -> Any:
        stay_outside()
        x, _, h, inner = context
        plain = flow(complex(x, 0.0), complex(end, 0.0), inner)
        moved = flow(complex(x, 0.0), complex(end, TINY), inner)
        return 1.0 + h * (moved.imag - plain.imag) / TINY

    root = compiled(make_root(value_at, slope_at))

    @compiled
    def gradient(x: Any, current: Any, h: Any, context: Any) -> Any:
        inner = (real(x), real(current), h, context)
        found, _ = root(real(x), 1.0, 0.0, inner)
        end = found + 0.0 * current
        return end - defect(end - x, current, h, flow(x + 0.0 * current, end, context)) / slope_at(found, inner)

    return gradient
