"""Leaves without an exact flow, under the constant current of a step.

Two-stage Radau IIA (Butcher 1964; Hairer & Wanner 1996, Sec. IV.5) for a linear storage ``E = s x``:

    X_1 = x + h (5/12 f_1 − 1/12 f_2),   X_2 = x⁺ = x + h (3/4 f_1 + 1/4 f_2),
    f_i = i − φ(s X_i),                  ē = 3/4 E_1 + 1/4 E_2.

It is L-stable, of third order, and algebraically stable, ``H(x⁺) − H(x) ≤ h i ē − h Σ b_i E_i φ(E_i)``, hence passive.
A nonlinear storage takes the discrete gradient, ``x⁺ = x + h (i − φ(ē(x, x⁺)))``.

Both rules are written as defects of their equations, which the torch module evaluates as well.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from phnn.integrate.compiled import stay_outside
from phnn.integrate.roots import make_root
from phnn.laws.namespace import TINY, real


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

    The first defect increases with the first stage, and with the first stage so found the second defect increases with
    the second: two scalar roots, one within the other, each in a bracket. The last step is taken with the perturbed
    numbers, by the implicit function theorem.

    Args:
        flow: ``(state, context) -> φ``, what the resistors of the leaf take.
        compiled: compiler of the inner functions.
    """
    defects = compiled(radau_defects)

    @compiled
    def lost(state: Any, context: Any) -> Any:
        """The lost flow and its slope at a real state."""
        stay_outside()
        plain, moved = flow(complex(state, 0.0), context), flow(complex(state, TINY), context)
        return plain.real, (moved.imag - plain.imag) / TINY

    @compiled
    def first_value(one: Any, given: Any) -> Any:
        x, two, i, h, context = given
        taken, slope = lost(one, context)
        g, _ = defects(one - x, two - x, i, h, taken, 0.0)
        return g, abs(one) + abs(two) + abs(x) + h * (abs(i) + abs(taken) + abs(slope * one))

    @compiled
    def first_slope(one: Any, given: Any) -> Any:
        _, _, _, h, context = given
        return 1.5 + h * lost(one, context)[1]

    first = compiled(make_root(first_value, first_slope))

    @compiled
    def second_value(two: Any, given: Any) -> Any:
        x, i, h, context = given
        one, _ = first(two, 1.5, 0.0, (x, two, i, h, context))
        taken, slope = lost(two, context)
        _, g = defects(one - x, two - x, i, h, 0.0, taken)
        return g, abs(one) + abs(two) + abs(x) + h * (abs(i) + abs(taken) + abs(slope * two))

    @compiled
    def second_slope(two: Any, given: Any) -> Any:
        x, i, h, context = given
        one, _ = first(two, 1.5, 0.0, (x, two, i, h, context))
        return 2.5 + h * lost(two, context)[1] + 2.25 / (1.5 + h * lost(one, context)[1])

    second = compiled(make_root(second_value, second_slope))

    @compiled
    def radau(x: Any, current: Any, h: Any, s: Any, context: Any) -> Any:
        start, i = real(x), real(current)
        two, _ = second(start, 2.5, 0.0, (start, i, h, context))
        one, _ = first(two, 1.5, 0.0, (start, two, i, h, context))
        a, b = 1.5 + h * lost(one, context)[1], 2.5 + h * lost(two, context)[1]
        before, after = one + 0.0 * current, two + 0.0 * current
        g1, g2 = defects(before - x, after - x, current, h, flow(before, context), flow(after, context))
        # Newton's step −J⁻¹ g with J = [[a, 1/2], [−9/2, b]].
        inverse = 1.0 / (a * b + 2.25)
        before = before - (b * g1 - 0.5 * g2) * inverse
        after = after - (4.5 * g1 + a * g2) * inverse
        return after, s * (0.75 * before + 0.25 * after)

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
