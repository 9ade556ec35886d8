"""Storage laws: energies with their discrete gradients in closed form.

The coordinate-wise discrete gradient ``ē = (H(b) − H(a))/(b − a)`` (Itoh & Abe 1988) is written as a
polynomial in ``a`` and ``b`` or as a difference of like terms, so that nothing cancels when ``b → a``.
"""

from __future__ import annotations

import math
from typing import Any

from phnn.laws.law import StorageLaw, register
from phnn.laws.leaf import relaxation
from phnn.laws.namespace import absolute, cos, exp, maximum, minimum, real, reciprocal, shared, sin, sqrt, where
from phnn.parameters import ANY, NONNEGATIVE, POSITIVE


def capacitor_mean_effort(a: Any, b: Any, capacitance: Any) -> Any:
    """Return ``H = x²/(2C)``: charge on a capacitor, momentum of a mass."""
    return 0.5 * (a + b) * reciprocal(capacitance)


def spring_mean_effort(a: Any, b: Any, stiffness: Any) -> Any:
    """Return ``H = k x²/2``."""
    return 0.5 * stiffness * (a + b)


@shared
def _completion(kappa: Any) -> Any:
    """Smallest coefficient of ``s⁵`` that keeps ``H″ = k(1 + 3κs² + 5cs⁴) ≥ 0`` for softening ``κ < 0``."""
    return where(real(kappa) < 0.0, 0.45 * kappa * kappa, 0.0 * kappa)


@shared
def _cubic_share(u: Any, w: Any, kappa: Any, completion: Any) -> Any:
    """Return what the cubic bend adds to the mean effort between ``u q₀`` and ``w q₀``, as a share of ``k (a + b)``."""
    quadratic = u * u + w * w
    sextic = (quadratic + u * w) * (quadratic - u * w)
    return kappa * quadratic / 4.0 + completion * sextic / 6.0


def cubic_spring_mean_effort(a: Any, b: Any, stiffness: Any, kappa: Any, q0: Any) -> Any:
    """Duffing spring, effort ``k x (1 + κ s² + c s⁴)``, ``s = x/q₀``; ``c = 9κ²/20`` where ``κ < 0``, else 0."""
    return stiffness * (a + b) * (0.5 + _cubic_share(a / q0, b / q0, kappa, _completion(kappa)))


@shared
def _quadratic_mean(a: Any, b: Any, u: Any, w: Any) -> Any:
    """Mean effort of a quadratic spring over its stiffness."""
    return 0.5 * (a + b) + (a * u + a * w + b * w) / 3.0 + (a + b) * (u * u + w * w) / 12.0


def quadratic_spring_mean_effort(a: Any, b: Any, stiffness: Any, kappa: Any, q0: Any) -> Any:
    """Return ``H = k x² (1/2 + κ s/3 + κ² s²/12)``, ``s = x/q₀``, of curvature ``H″ = k (1 + κ s)² ≥ 0``."""
    return stiffness * _quadratic_mean(a, b, kappa * a / q0, kappa * b / q0)


@shared
def _bent_completion(kappa_2: Any, q2: Any, kappa_3: Any, q3: Any) -> Any:
    """Return ``c = (9/20) |κ₃| (|κ₃| + (κ₂ q₃/q₂)²)`` where ``κ₃ < 0``, else 0: without κ₂ that of the cubic bend."""
    slant = kappa_2 * q3 / q2
    return where(real(kappa_3) < 0.0, 0.45 * kappa_3 * (kappa_3 - slant * slant), 0.0 * kappa_3)


def bent_spring_mean_effort(a: Any, b: Any, stiffness: Any, kappa_2: Any, q2: Any, kappa_3: Any, q3: Any) -> Any:
    """Return a spring with both bends, effort ``k x (1 + κ₂ s₂ + κ₂² s₂²/3 + κ₃ s₃² + c s₃⁴)``.

    ``H ≥ k x²/7`` for all bends, so that rest is the minimum. Convex where ``κ₃ ≥ 0``; elsewhere the effort may fall.
    """
    cubic = (a + b) * _cubic_share(a / q3, b / q3, kappa_3, _bent_completion(kappa_2, q2, kappa_3, q3))
    return stiffness * (_quadratic_mean(a, b, kappa_2 * a / q2, kappa_2 * b / q2) + cubic)


def weight_mean_effort(a: Any, b: Any, force: Any) -> Any:
    """Return ``H = −F x``: the potential of a constant force, not bounded below."""
    return -force + 0.0 * (a + b)


@shared
def _stop_side(gap: Any) -> Any:
    """Return the sign of a stop's side."""
    return where(real(gap) < 0.0, -1.0 + 0.0 * gap, 1.0 + 0.0 * gap)


def stop_mean_effort(a: Any, b: Any, stiffness: Any, gap: Any) -> Any:
    """One-sided elastic stop, ``H = k max(x − gap, 0)²/2`` for ``gap ≥ 0`` and mirrored for ``gap < 0``."""
    side = _stop_side(gap)
    return stiffness * side * _mean_depth(side * (a - gap), side * (b - gap))


@shared
def _depths(raw_a: Any, raw_b: Any) -> tuple[Any, Any, Any]:
    """Depths ``P = max(r, 0)`` at two values of ``r``, and ``(P_b − P_a)/(r_b − r_a)``."""
    depth_a = maximum(raw_a, 0.0 * raw_a)
    depth_b = maximum(raw_b, 0.0 * raw_b)
    crossing = real(raw_a) * real(raw_b) < 0.0
    span = where(crossing, absolute(raw_b - raw_a), 1.0 + 0.0 * raw_a)
    inside = where(real(raw_a) + real(raw_b) > 0.0, 1.0 + 0.0 * raw_a, 0.0 * raw_a)
    # On a crossing one depth is zero and the other lies on the segment, hence the share depth/span.
    return depth_a, depth_b, where(crossing, (depth_a + depth_b) / span, inside)


@shared
def _mean_depth(raw_a: Any, raw_b: Any) -> Any:
    """Return ``(P_b² − P_a²)/2/(r_b − r_a)``, ``P = max(r, 0)``: the mean of ``P`` between two values of ``r``."""
    depth_a, depth_b, share = _depths(raw_a, raw_b)
    return 0.5 * (depth_a + depth_b) * share


@shared
def _root(x: Any) -> Any:
    """Return ``√x`` of ``x ≥ 0``, with the slope zero at 0."""
    inside = real(x) > 0.0
    return where(inside, sqrt(where(inside, x, 1.0 + 0.0 * x)), 0.0 * x)


def round_stop_mean_effort(a: Any, b: Any, stiffness: Any, gap: Any, depth: Any) -> Any:
    """Return the contact of round surfaces (Hertz), ``± k p √(p/p₀)``, ``p = max(±(x − gap), 0)``, on the gap's side.

    The fifth powers of the roots are factored: ``(w⁵ − u⁵)/(w² − u²)``.
    """
    side = _stop_side(gap)
    depth_a, depth_b, share = _depths(side * (a - gap), side * (b - gap))
    u, w = _root(depth_a / depth), _root(depth_b / depth)
    total = u + w
    touched = real(total) > 0.0
    squares, product = u * u + w * w, u * w
    powers = squares * squares - product * product + product * squares
    return 0.4 * stiffness * depth * side * share * powers / where(touched, total, 1.0 + 0.0 * total)


def stops_mean_effort(a: Any, b: Any, upper: Any, lower: Any, gap: Any) -> Any:
    """Elastic stops on both sides, ``H = k₊ max(x − gap, 0)²/2 + k₋ max(−x − gap, 0)²/2``, ``gap ≥ 0``."""
    return upper * _mean_depth(a - gap, b - gap) - lower * _mean_depth(-a - gap, -b - gap)


def saturating_spring_mean_effort(a: Any, b: Any, stiffness: Any, reach: Any) -> Any:
    """Return a spring whose force ``k clip(x, ±reach)`` grows no further beyond a displacement; convex, ``H ≥ 0``.

    The mean of ``clip`` is that of the clipped ends, moved towards the end farther outside.
    """
    limit = reach + 0.0 * (a + b)
    inner_a = maximum(minimum(a + 0.0 * limit, limit), -limit)
    inner_b = maximum(minimum(b + 0.0 * limit, limit), -limit)
    apart = real(a) != real(b)
    span = where(apart, b - a, 1.0 + 0.0 * limit)
    outside = (b - inner_b) + (a - inner_a)
    return 0.5 * stiffness * (inner_a + inner_b + (inner_b - inner_a) * (outside / span))


@shared
def _bend(x: Any, reach: Any) -> Any:
    """Return ``√(1 + (x/r)²)``."""
    s = x / reach
    return sqrt(1.0 + s * s)


def softening_spring_mean_effort(a: Any, b: Any, stiffness: Any, reach: Any) -> Any:
    """Return ``H = k r² (√(1 + (x/r)²) − 1)``, effort ``k x/√(1 + (x/r)²)``: at most ``k r``; convex, ``H ≥ 0``.

    The difference of the roots is taken by that of their squares.
    """
    return stiffness * (a + b) / (_bend(a, reach) + _bend(b, reach))


def hardening_spring_mean_effort(a: Any, b: Any, coefficient: Any) -> Any:
    """Return ``H = k₃ x⁴/4``, effort ``k₃ x³``: the spring has no stiffness at rest; convex, ``H ≥ 0``."""
    return 0.25 * coefficient * (a + b) * (a * a + b * b)


def quintic_spring_mean_effort(a: Any, b: Any, stiffness: Any, q0: Any) -> Any:
    """Return ``H = k x² s⁴/6``, ``s = x/q₀``, effort ``k x s⁴``: convex, ``H ≥ 0``."""
    u2, w2 = (a / q0) * (a / q0), (b / q0) * (b / q0)
    return stiffness * (a + b) * (u2 * u2 + u2 * w2 + w2 * w2) / 6.0


_HALF_TURN = math.pi


@shared
def _slope_of_sine(x: Any) -> Any:
    """Return ``sin x/x``."""
    apart = real(x) * real(x) > 1e-8
    safe = where(apart, x, 1.0 + 0.0 * x)
    return where(apart, sin(safe) / safe, 1.0 - x * x / 6.0)


def wave_spring_mean_effort(a: Any, b: Any, sine: Any, cosine: Any, length: Any) -> Any:
    """Return a force that repeats along the way, ``F_s sin κx + F_c cos κx``, ``κ = 2π/λ``.

    ``H`` is bounded, and negative in places: where nothing moves yet, the force may already act.
    """
    middle, half = _HALF_TURN * (a + b) / length, _HALF_TURN * (b - a) / length
    return (sine * sin(middle) + cosine * cos(middle)) * _slope_of_sine(half)


# The stiffness of an exponential spring changes by at most this factor; beyond, it is constant.
MOST_BENT = 100.0
_FARTHEST = math.log(MOST_BENT)
_NEVER, _STRAIGHT = 1e150, 1e-100


@shared
def _last(rate: Any, stiffness: Any, bend: Any) -> tuple[Any, Any, Any]:
    """Return where an exponential spring becomes straight, and its force and stiffness there."""
    bends = real(rate) > _STRAIGHT
    bent = where(bends, rate, 1.0 + 0.0 * rate)
    factor = where(real(bend) > 0.0, MOST_BENT + 0.0 * rate, 1.0 / MOST_BENT + 0.0 * rate)
    reach = where(bends, _FARTHEST / bent, _NEVER + 0.0 * rate)
    return reach, stiffness * absolute(factor - 1.0) / bent, stiffness * where(bends, factor, 1.0 + 0.0 * rate)


@shared
def _grown(size: Any, bend: Any) -> Any:
    """Return ``e^w`` where the spring stiffens, else 1: so the `relaxation` of ``w`` becomes that of ``−w``."""
    return where(real(bend) > 0.0, exp(size), 1.0 + 0.0 * size)


@shared
def exponential_spring_mean_effort(a: Any, b: Any, stiffness: Any, force: Any, bend: Any) -> Any:
    """Give a spring the stiffness ``E' = k (1 + b |E|/F)``: ``E = ± (e^{bk|x|/F} − 1) F/b``, convex.

    The stiffness stays within a factor 100 of ``k``, so that no number overflows. The mean effort is
    ``(a + b)/(|a| + |b|)`` times the mean force between the sizes ``|a|`` and ``|b|``.
    """
    size_a, size_b = absolute(a + 0.0 * b), absolute(b + 0.0 * a)
    rate = absolute(bend) * stiffness / force
    reach, pull, steepest = _last(rate, stiffness, bend)
    inner_a, inner_b = minimum(size_a, reach + 0.0 * size_a), minimum(size_b, reach + 0.0 * size_b)
    # From the end where the spring is stiffer, so that exponentials only fall.
    first = where(real(bend) > 0.0, maximum(inner_a, inner_b), minimum(inner_a, inner_b))
    change = inner_a + inner_b - first - first
    one, two = relaxation(rate * absolute(change))
    there = relaxation(rate * first)[0] * _grown(rate * first, bend)
    inside = stiffness * (first * there * one + change * two)
    outer_a, outer_b = size_a - inner_a, size_b - inner_b
    outside = pull + 0.5 * steepest * (outer_a + outer_b)
    # Where both ends lie on one side, no difference of theirs is divided by itself: its derivative would be rounding.
    mixed = (real(minimum(outer_a, outer_b)) <= 0.0) & (real(maximum(outer_a, outer_b)) > 0.0)
    span = where(mixed, size_b - size_a, 1.0 + 0.0 * size_a)
    one_side = where(real(outer_a) > 0.0, 0.0 * span, 1.0 + 0.0 * span)
    share = where(mixed, (inner_b - inner_a) / span, one_side)
    total = size_a + size_b
    moved = real(total) > 0.0
    mean = (share * inside + (1.0 - share) * outside) / where(moved, total, 1.0 + 0.0 * total)
    return (a + b) * where(moved, mean, 0.5 * stiffness + 0.0 * mean)


_BENT = (NONNEGATIVE, ANY, POSITIVE)

register(StorageLaw("capacitor", capacitor_mean_effort, (0.7,)))
register(StorageLaw("spring", spring_mean_effort, (1.3,), domains=(NONNEGATIVE,)))
register(StorageLaw("cubic_spring", cubic_spring_mean_effort, (1.3, 0.4, 0.8), domains=_BENT))
register(StorageLaw("quadratic_spring", quadratic_spring_mean_effort, (1.3, 0.4, 0.8), domains=_BENT))
_TWICE_BENT = (*_BENT, ANY, POSITIVE)
register(StorageLaw("bent_spring", bent_spring_mean_effort, (1.3, 0.4, 0.8, 0.3, 0.7), domains=_TWICE_BENT))
register(StorageLaw("weight", weight_mean_effort, (0.6,), bounded=False, domains=(ANY,)))
register(StorageLaw("stop", stop_mean_effort, (2.0, 0.3), domains=(NONNEGATIVE, ANY)))
register(StorageLaw("round_stop", round_stop_mean_effort, (2.0, 0.3, 0.6), domains=(NONNEGATIVE, ANY, POSITIVE)))
register(StorageLaw("stops", stops_mean_effort, (2.0, 1.4, 0.3), domains=(NONNEGATIVE,) * 3))
register(StorageLaw("saturating_spring", saturating_spring_mean_effort, (1.3, 0.4), domains=(NONNEGATIVE,) * 2))
register(StorageLaw("softening_spring", softening_spring_mean_effort, (1.3, 0.4), domains=(NONNEGATIVE, POSITIVE)))
register(StorageLaw("hardening_spring", hardening_spring_mean_effort, (0.9,), domains=(NONNEGATIVE,)))
register(StorageLaw("quintic_spring", quintic_spring_mean_effort, (0.9, 0.8), domains=(NONNEGATIVE, POSITIVE)))
_WAVE = (ANY, ANY, POSITIVE)
register(
    StorageLaw("wave_spring", wave_spring_mean_effort, (0.3, 0.2, 0.7), convex=False, bounded=False, domains=_WAVE)
)
_EXPONENTIAL = (NONNEGATIVE, POSITIVE, ANY)
register(StorageLaw("exponential_spring", exponential_spring_mean_effort, (1.3, 0.7, 0.4), domains=_EXPONENTIAL))
