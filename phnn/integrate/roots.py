"""Scalar equations of a step: the root within a bracket, and reducible storages without an exact flow.

The function of a root need not increase everywhere: observed signs bound the root, so that a bracket always holds one.

Reducible storages take, under the constant current of a step, two-stage Radau IIA (Butcher 1964; Hairer & Wanner 1996,
Sec. IV.5) where they are linear, ``E = s x``:

    X_1 = x + h (5/12 f_1 − 1/12 f_2),   X_2 = x⁺ = x + h (3/4 f_1 + 1/4 f_2),
    f_i = i − φ(s X_i),                  ē = 3/4 E_1 + 1/4 E_2.

It is L-stable, of third order, and algebraically stable, ``H(x⁺) − H(x) ≤ h i ē − h Σ b_i E_i φ(E_i)``, hence passive.
A nonlinear storage takes the discrete gradient, ``x⁺ = x + h (i − φ(ē(x, x⁺)))``. Both rules are written as defects of
their equations, which the torch module evaluates as well.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.laws.namespace import TINY

TOLERANCE = 1e-14
# Multiple of the rounding error that terms may leave whose cancellation the equation's size does not show.
RELAXED = 1e-12
_STRICT = 12
# After a step that has left this share of the residual no kink is near, and the chord is as good as the derivative.
_SMOOTH = 0.1
# Halvings down to neighbouring floats; every other one follows a Newton step that did not help.
_ITERATIONS = 300
# A motion that dies away reaches subnormal numbers, where relative accuracy is lost.
NOTHING = 1e-200


@inline
def extrapolated(history: Any, n: Any, k: Any) -> Any:
    """Guess entry ``(n, k)``, ``n ≥ 1``, from the two rows before it."""
    return history[n - 1, k] if n == 1 else 2.0 * history[n - 1, k] - history[n - 2, k]


def make_root(value_at: Callable[..., Any], slope_at: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``root(guess, floor, slope, context) -> (y, slope)``, to be compiled with its two functions.

    ``floor > 0`` is a lower bound on the slope of an increasing equation: one step with this slope leads beyond the
    root. A positive ``slope`` replaces the derivative in the first step: where the equation is piecewise linear, the
    slope of the step before is often exact. The root is NaN if none was found.

    Args:
        value_at: ``(y, context) -> (value, size of the terms that cancel in it)``.
        slope_at: ``(y, context) -> derivative``.
    """

    def root(guess: Any, floor: Any, slope: Any, context: Any) -> Any:
        low, high, last, reach = -np.inf, np.inf, np.inf, 1.0
        y, at, before = guess, guess, 0.0
        exhausted, borrowed = False, False
        for iteration in range(_ITERATIONS):
            value, size = value_at(y, context)
            if borrowed and not abs(value) <= abs(before):
                # Far beyond the root of a steep law Newton's method needs hundreds of steps back, or terms overflow.
                y, value, size = at, before, 0.0
            if not np.isfinite(value):
                break
            if exhausted or abs(value) <= (TOLERANCE if iteration < _STRICT else RELAXED) * size + NOTHING:
                return y, slope
            if value > 0.0:
                high = y
            else:
                low = y
            borrowed = iteration == 0 and slope > 0.0
            if abs(value) <= _SMOOTH * abs(before):
                slope = (value - before) / (y - at)
            elif not borrowed:
                slope = slope_at(y, context)
            step, at, before = y - value / slope, y, value
            # The comparison also fails for values that are not finite. Newton's method may hop between two kinks: a
            # step that did not halve the residual is followed by a bisection. A falling branch would lead to a root
            # that is not connected.
            newton = low <= step <= high and slope > 0.0 and abs(value) <= 0.5 * last
            last = np.inf if borrowed else abs(value)
            if newton:
                y = step
            elif np.isfinite(high - low):
                y = 0.5 * (low + high)
                exhausted = y in (low, high)
            else:
                y -= reach * value / floor
                reach *= 2.0
        return np.nan, 0.0

    return root


# Newton steps before the search within brackets.
_QUICK = 15


def radau_defects(d1: Any, d2: Any, current: Any, h: Any, lost1: Any, lost2: Any) -> Any:
    """Return ``A⁻¹ d − h f`` for the stage displacements ``d_i = X_i − x`` and the flows ``φ_i`` lost there."""
    return (1.5 * d1 + 0.5 * d2 - h * (current - lost1), 2.5 * d2 - 4.5 * d1 - h * (current - lost2))


def gradient_defect(d: Any, current: Any, h: Any, lost: Any) -> Any:
    """Return ``x⁺ − x − h (i − φ(ē))``."""
    return d - h * (current - lost)


_radau_defects, _gradient_defect = plain(radau_defects), plain(gradient_defect)


def make_radau(flow: Callable[..., Any], plain_flow: Callable[..., Any]) -> Any:
    """``search(x, i, h, context) -> (X_1, X_2, a, b)``, ``moved(x, i, h, s, solution, context) -> (x⁺, ē)``, compiled.

    The search runs in real numbers; its result is NaN if it fails. If no slope is negative, Newton's method from the
    previous state converges in a few steps. Otherwise two nested scalar searches follow, each in a bracket: the first
    defect increases with the first stage; with the first stage as its root, the second defect increases with the second
    stage. ``moved`` takes one Newton step from the result with ``J = [[a, 1/2], [−9/2, b]]`` in the perturbed numbers
    (implicit function theorem), so that one search serves all derivatives of a step.

    Args:
        flow: ``(x, x⁺, context) -> φ``, the flow into the resistors of the storage at its mean effort.
        plain_flow: the same without the perturbations of the context.
    """

    @plain
    def at(state: Any, context: Any) -> Any:
        return plain_flow(state, state, context)

    lost = _make_lost(at)

    @plain
    def first_value(one: Any, given: Any) -> Any:
        x, two, i, h, context = given
        taken, slope = lost(one, context)
        g, _ = _radau_defects(one - x, two - x, i, h, taken, 0.0)
        return g, abs(one) + abs(two) + abs(x) + h * (abs(i) + abs(taken) + abs(slope * one))

    @plain
    def first_slope(one: Any, given: Any) -> Any:
        _, _, _, h, context = given
        return 1.5 + h * lost(one, context)[1]

    first = plain(make_root(first_value, first_slope))

    @plain
    def second_value(two: Any, given: Any) -> Any:
        x, i, h, context = given
        one, _ = first(two, 1.5, 0.0, (x, two, i, h, context))
        taken, slope = lost(two, context)
        _, g = _radau_defects(one - x, two - x, i, h, 0.0, taken)
        return g, abs(one) + abs(two) + abs(x) + h * (abs(i) + abs(taken) + abs(slope * two))

    @plain
    def second_slope(two: Any, given: Any) -> Any:
        x, i, h, context = given
        one, _ = first(two, 1.5, 0.0, (x, two, i, h, context))
        return 2.5 + h * lost(two, context)[1] + 2.25 / (1.5 + h * lost(one, context)[1])

    second = plain(make_root(second_value, second_slope))

    @plain
    def search(x: Any, i: Any, h: Any, context: Any) -> Any:
        stay_outside()
        one, two = x, x
        for _ in range(_QUICK):
            taken1, slope1 = lost(one, context)
            taken2, slope2 = lost(two, context)
            a, b = 1.5 + h * slope1, 2.5 + h * slope2
            if a <= 0.0 or b <= 0.0:
                break
            g1, g2 = _radau_defects(one - x, two - x, i, h, taken1, taken2)
            size = abs(one) + abs(two) + abs(x) + h * abs(i)
            size1 = size + h * (abs(taken1) + abs(slope1 * one))
            size2 = size + h * (abs(taken2) + abs(slope2 * two))
            if abs(g1) <= TOLERANCE * size1 + NOTHING and abs(g2) <= TOLERANCE * size2 + NOTHING:
                return one, two, a, b
            inverse = 1.0 / (a * b + 2.25)
            one -= (b * g1 - 0.5 * g2) * inverse
            two -= (4.5 * g1 + a * g2) * inverse
        two, _ = second(x, 2.5, 0.0, (x, i, h, context))
        one, _ = first(two, 1.5, 0.0, (x, two, i, h, context))
        return one, two, 1.5 + h * lost(one, context)[1], 2.5 + h * lost(two, context)[1]

    @plain
    def moved(x: Any, current: Any, h: Any, s: Any, solution: Any, context: Any) -> Any:
        stay_outside()
        one, two, a, b = solution
        before, after = one + 0.0 * current, two + 0.0 * current
        lost1, lost2 = flow(before, before, context), flow(after, after, context)
        g1, g2 = _radau_defects(before - x, after - x, current, h, lost1, lost2)
        inverse = 1.0 / (a * b + 2.25)
        before = before - (b * g1 - 0.5 * g2) * inverse
        after = after - (4.5 * g1 + a * g2) * inverse
        return after, s * (0.75 * before + 0.25 * after)

    return search, moved


def make_gradient(flow: Callable[..., Any], plain_flow: Callable[..., Any]) -> Any:
    """``search(x, i, h, context) -> (x⁺, slope)``, ``moved(x, i, h, solution, context) -> x⁺``, as of `make_radau`."""

    @plain
    def between(end: Any, context: Any) -> Any:
        return plain_flow(context[0] + 0.0 * end, end, context[1])

    lost = _make_lost(between)

    @plain
    def value_at(end: Any, given: Any) -> Any:
        x, i, h, context = given
        taken, _ = lost(end, (x, context))
        return _gradient_defect(end - x, i, h, taken), abs(end) + abs(x) + h * (abs(i) + abs(taken))

    @plain
    def slope_at(end: Any, given: Any) -> Any:
        x, _, h, context = given
        return 1.0 + h * lost(end, (x, context))[1]

    root = plain(make_root(value_at, slope_at))

    @plain
    def search(x: Any, i: Any, h: Any, context: Any) -> Any:
        stay_outside()
        given = (x, i, h, context)
        end, _ = root(x, 1.0, 0.0, given)
        return end, slope_at(end, given)

    @plain
    def moved(x: Any, current: Any, h: Any, solution: Any, context: Any) -> Any:
        stay_outside()
        end, slope = solution[0] + 0.0 * current, solution[1]
        return end - _gradient_defect(end - x, current, h, flow(x + 0.0 * current, end, context)) / slope

    return search, moved


def _make_lost(plain_flow: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``lost(state, context)``: the lost flow and its slope at a real state."""

    @plain
    def lost(state: Any, context: Any) -> Any:
        stay_outside()
        flow = plain_flow(complex(state, TINY), context)
        return flow.real, flow.imag / TINY

    return lost
