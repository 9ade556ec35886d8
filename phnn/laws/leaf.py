"""A reducible storage: capacitor, piecewise linear resistor and leak, advanced exactly under a constant current.

    ẋ = i − φ(x/C),   φ(e) = g e + ρ (max(e − hi, 0) + min(e − lo, 0))

Under constant ``i`` the scalar autonomous equation is monotone in time, so it visits the regions below,
inside and above the dead zone in order, each with a closed form. The rule has no step-size limit, damps
stiff storages without ringing, and returns the *average* effort ``ē = (1/h)∫e dt``, so that the exchanged power
``i ē`` is exact: ``H(x⁺) − H(x) = h i ē − (loss ≥ 0)``.
"""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable

from phnn.laws.namespace import certain, exp, log1p, maximum, minimum, real, reciprocal, shared, where

# Here nine terms of the series and the difference of the exponential round alike.
_SERIES = 0.25
_NO_CURRENT = 1e-100
_SATURATED = 40.0
_NEVER = 1e300
# An end this close to a threshold, relative to the effort it came from, may lie on either side of it.
_ROUNDING = 1e-12


@shared
def relaxation(z: Any) -> Any:
    """Return ``φ₁(−z) = (1 − e^{−z})/z`` and ``φ₂(−z) = (1 − φ₁(−z))/z``, ``z ≥ 0``; by series near zero."""
    small = real(z) < _SERIES
    tail = where(small, z, 0.0 * z)
    last = 1.0 / 40320 - tail * (1.0 / 362880 - tail * (1.0 / 3628800 - tail * (1.0 / 39916800)))
    later = 1.0 / 120 - tail * (1.0 / 720 - tail * (1.0 / 5040 - tail * last))
    two = 0.5 - tail * (1.0 / 6 - tail * (1.0 / 24 - tail * later))
    if certain(small):
        return 1.0 - z * two, two
    safe = where(small, 1.0 + 0.0 * z, z)
    inverse = reciprocal(safe)
    if certain(real(z) > _SATURATED):
        return inverse, (1.0 - inverse) * inverse
    one_large = (1.0 - exp(-safe)) * inverse
    two_large = (1.0 - one_large) * inverse
    return where(small, 1.0 - z * two, one_large), where(small, two, two_large)


@shared
def _relax(e: Any, duration: Any, current: Any, rho: Any, threshold: Any) -> Any:
    """End value and time integral of ``ė = i − ρ(e − threshold)`` over a duration."""
    if certain(real(duration) <= 0.0):
        return e, 0.0 * e
    climb = (current - rho * (e - threshold)) * duration
    one, two = relaxation(duration * rho)
    return e + climb * one, duration * (e + climb * two)


@shared
def _time_to_threshold(depth: Any, current: Any, rho: Any) -> Any:
    """When ``ė = i − ρ(e − lo)`` has risen by ``depth`` to ``lo``; never for ``i ≤ 0``."""
    if certain(real(depth) <= 0.0):
        return 0.0 * depth
    rising = real(current) > _NO_CURRENT
    inverse_i = reciprocal(where(rising, current, 1.0 + 0.0 * current))
    slope = depth * rho * inverse_i
    flat = real(slope) < 1e-8
    straight = depth * (1.0 - 0.5 * slope) * inverse_i
    if certain(flat):
        return where(rising, straight, _NEVER + 0.0 * straight)
    relaxing = log1p(slope) * reciprocal(where(flat, 1.0 + 0.0 * rho, rho))
    time = where(flat, straight, relaxing)
    return where(rising, time, _NEVER + 0.0 * time)


@register_jitable(error_model="numpy", forceinline=False)
def _across(e: Any, current: Any, span: Any, rho: Any, low: Any, high: Any, leak: Any) -> Any:
    """Effort at the end, and its mean, of a step that meets a threshold: ``ė = i − g e − ρ (…)`` over ``span = h/C``.

    It goes upwards through the regions below, inside and above the dead zone.
    """
    slope = rho + leak
    # Below the dead zone, until the lower threshold is met.
    depth = low - e
    below = real(depth) > 0.0
    depth = where(below, depth, 0.0 * depth)
    whole = span + 0.0 * depth
    meet = minimum(_time_to_threshold(depth, current - leak * low, slope), whole)
    time_below = where(below, meet, 0.0 * meet)
    e1, area1 = _relax(e, time_below, current - leak * low, slope, low)
    # Inside the dead zone: without a leak a straight line, until the upper threshold is met.
    room = high - e1
    inside = real(room) > 0.0
    room = where(inside, room, 0.0 * room)
    cross = minimum(_time_to_threshold(room, current - leak * high, leak), whole - time_below)
    time_inside = where(inside, cross, 0.0 * cross)
    e2, area2 = _relax(e1, time_inside, current, leak, 0.0 * leak)
    # Above it: relaxation for what is left of the step.
    rest = whole - time_below - time_inside
    e3, area3 = _relax(e2, where(real(rest) > 0.0, rest, 0.0 * rest), current - leak * high, slope, high)
    return e3, (area1 + area2 + area3) * reciprocal(whole)


@shared
def relaxed(x: Any, gain: Any, stiffness: Any, one: Any, two: Any) -> Any:
    """End state and average effort of a step within one region.

    Args:
        gain: the first rate times the duration, ``h (i − g e₀ − ρ (e₀ − threshold))``; no ``ρ`` inside the dead zone.
        one, two: `relaxation` of ``h (ρ + g)/C``, inside the dead zone of ``h g/C``.
    """
    return x + gain * one, stiffness * (x + gain * two)


@shared
def slides_on(effort: Any, end: Any, above: Any, threshold: Any, current: Any, leak: Any) -> Any:
    """Return whether a state that starts beyond a threshold stays there for a whole step.

    Under an outward current it relaxes towards an effort beyond the threshold. Under an inward one its end tells,
    unless rounding decides on which side that lies: a steep one falls to the threshold at once, and moves on inside.
    """
    outward = real(current) - real(leak) * real(threshold)
    margin = _ROUNDING * real(effort)
    return where(
        above,
        (outward >= 0.0) | (real(end) >= real(threshold) + margin),
        (outward <= 0.0) | (real(end) <= real(threshold) + margin),
    )


@shared
def rc_flow(
    x: Any, current: Any, h: Any, stiffness: Any, rho: Any, low: Any, high: Any, leak: Any, one: Any, two: Any,
    leak_one: Any, leak_two: Any,
) -> Any:  # fmt: skip
    """Advance one storage by ``h`` under a constant current.

    Args:
        x: charge [C] (or the energy variable of any linear storage).
        current: constant inflow [A].
        h: duration [s], positive.
        stiffness: ``1/C`` with ``e = x/C``.
        rho, low, high: slope and thresholds of the resistor, ``ρ ≥ 0``, ``lo ≤ 0 ≤ hi``.
        leak: conductance ``g ≥ 0`` beside the resistor.
        one, two: `relaxation` of ``h (ρ + g)/C``; given, because they stay the same from step to step.
        leak_one, leak_two: the same of ``h g/C``.

    Returns:
        ``(x⁺, ē)``: the charge at the end and the average effort.
    """
    e0 = x * stiffness
    excess = e0 - high
    deficit = e0 - low
    # Most steps meet no threshold: one closed form, recognised by its end. Without a dead zone nothing rests in it.
    if certain((real(excess) <= 0.0) & (real(deficit) >= 0.0) & (real(high) > real(low))):
        end, mean = relaxed(x, (current - leak * e0) * h, stiffness, leak_one, leak_two)
        last = real(end) * real(stiffness)
        if certain((last <= real(high)) & (last >= real(low))):
            return end, mean
    elif certain(real(rho) > 0.0):
        above = real(excess) > 0.0
        threshold = where(above, high, low)
        end, mean = relaxed(x, (current - leak * e0 - rho * (e0 - threshold)) * h, stiffness, one, two)
        if certain(slides_on(e0, real(end) * real(stiffness), above, threshold, current, leak)):
            return end, mean
    drive = current - leak * e0 - rho * (maximum(excess, 0.0 * excess) + minimum(deficit, 0.0 * deficit))
    # A falling state is mirrored.
    falling = real(drive) < 0.0
    bottom, top = where(falling, -high, low), where(falling, -low, high)
    end, mean = _across(
        where(falling, -e0, e0), where(falling, -current, current), h * stiffness, rho, bottom, top, leak
    )
    return where(falling, -end, end) * reciprocal(stiffness), where(falling, -mean, mean)
