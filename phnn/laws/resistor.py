"""Resistor laws: sector functions ``ε φ(ε) ≥ 0``, so that every network built from them is passive.

Dampers are ``φ = σ(v, q) v`` with ``σ ≥ 0``: powers of the speed, by direction, and growing with the position.
"""

from __future__ import annotations

import math
from typing import Any

from phnn.laws.law import ResistorLaw, register
from phnn.laws.leaf import relaxation
from phnn.laws.namespace import (
    absolute,
    certain,
    exp,
    log1p,
    maximum,
    minimum,
    real,
    reciprocal,
    shared,
    sqrt,
    tanh,
    where,
)
from phnn.laws.storage import MOST_BENT, exponential_spring_mean_effort
from phnn.parameters import ANY, NONNEGATIVE, POSITIVE


@shared
def piecewise_linear(effort: Any, rho: Any, low: Any, high: Any) -> Any:
    """Return ``φ = ρ (max(ε − hi, 0) + min(ε − lo, 0))``, with ``lo ≤ 0 ≤ hi`` a sector law."""
    above = effort - high
    below = effort - low
    return rho * (maximum(above, 0.0 * above) + minimum(below, 0.0 * below))


def linear_thresholds(q: Any, rho: Any) -> Any:
    """No dead zone."""
    return rho, 0.0 * rho, 0.0 * rho


def linear(effort: Any, q: Any, rho: Any) -> Any:
    """Return ``φ = ρ ε``."""
    return rho * effort


def maxwell_thresholds(q: Any, stiffness: Any, tau: Any) -> Any:
    """No dead zone; slope ``1/(k_s τ)``."""
    rho = reciprocal(stiffness * tau)
    return rho, 0.0 * rho, 0.0 * rho


def maxwell(effort: Any, q: Any, stiffness: Any, tau: Any) -> Any:
    """Dashpot of a Maxwell cell by its relaxation time: ``φ = ε/(k_s τ)`` beside a spring ``k_s``."""
    return effort * reciprocal(stiffness * tau)


def dead_zone_thresholds(q: Any, rho: Any, width: Any) -> Any:
    """Symmetric thresholds ``±d/2``."""
    return rho, -0.5 * width, 0.5 * width


def dead_zone(effort: Any, q: Any, rho: Any, width: Any) -> Any:
    """Eq. (2): zero for ``|ε| ≤ d/2``, slope ``ϱ⁻¹`` outside."""
    return piecewise_linear(effort, rho, -0.5 * width, 0.5 * width)


def bristles_thresholds(q: Any, rho: Any, force: Any) -> Any:
    """Symmetric thresholds ``±F``."""
    return rho, -force, force


def bristles(effort: Any, q: Any, rho: Any, force: Any) -> Any:
    """Bristles under the force ``ε``: zero for ``|ε| ≤ F``, slope ``ρ`` outside."""
    return piecewise_linear(effort, rho, -force, force)


@shared
def following_width(q: Any, width: Any, kappa: Any, q0: Any) -> Any:
    """Return ``d max(0, 1 + κ q/q₀)``: never negative, hence a sector law at every displacement."""
    factor = 1.0 + kappa * q / q0
    return width * maximum(factor, 0.0 * factor)


def following_dead_zone_thresholds(q: Any, rho: Any, width: Any, kappa: Any, q0: Any) -> Any:
    """Symmetric thresholds that follow the displacement."""
    half = 0.5 * following_width(q, width, kappa, q0)
    return rho + 0.0 * half, -half, half


def following_dead_zone(effort: Any, q: Any, rho: Any, width: Any, kappa: Any, q0: Any) -> Any:
    """Eq. (2) with the width ``d max(0, 1 + κ q/q₀)``."""
    half = 0.5 * following_width(q, width, kappa, q0)
    return piecewise_linear(effort, rho, -half, half)


@shared
def _hastened_half(momentum: Any, width: Any, kappa: Any, mass: Any) -> Any:
    """Return ``(d/2) (1 + κ |p|/m)``."""
    return 0.5 * width * (1.0 + kappa * absolute(momentum) * reciprocal(mass))


def rate_dependent_dead_zone_thresholds(q: Any, rho: Any, width: Any, kappa: Any, mass: Any) -> Any:
    """Symmetric thresholds that grow with the speed ``|p|/m`` of the momentum ``p = q`` that is read."""
    half = _hastened_half(q, width, kappa, mass)
    return rho + 0.0 * half, -half, half


def rate_dependent_dead_zone(effort: Any, q: Any, rho: Any, width: Any, kappa: Any, mass: Any) -> Any:
    """Eq. (2) with the width ``d (1 + κ |p|/m)``, ``κ ≥ 0`` in s/m, hence a sector law at every speed."""
    half = _hastened_half(q, width, kappa, mass)
    return piecewise_linear(effort, rho, -half, half)


@shared
def _tempered(value: Any, kappa: Any, rise: Any) -> Any:
    """Return ``v max(0, 1 + κ ϑ)``: never negative, hence a sector law at every temperature."""
    factor = 1.0 + kappa * rise
    return value * maximum(factor, 0.0 * factor)


def thermal_dead_zone_thresholds(q: Any, rho: Any, width: Any, kappa_rho: Any, kappa_d: Any) -> Any:
    """Symmetric thresholds and a slope that follow the temperature rise ``ϑ = q``."""
    half = 0.5 * _tempered(width, kappa_d, q)
    return _tempered(rho, kappa_rho, q), -half, half


def thermal_dead_zone(effort: Any, q: Any, rho: Any, width: Any, kappa_rho: Any, kappa_d: Any) -> Any:
    """Eq. (2) with ``ϱ⁻¹ max(0, 1 + κ_ϱ ϑ)`` and ``d max(0, 1 + κ_d ϑ)``, temperature coefficients in 1/K."""
    half = 0.5 * _tempered(width, kappa_d, q)
    return piecewise_linear(effort, _tempered(rho, kappa_rho, q), -half, half)


def yielding_thresholds(q: Any, stiffness: Any, travel: Any, tau: Any) -> Any:
    """Symmetric thresholds ``±k x_s``; slope ``1/(k τ)`` outside."""
    half = stiffness * travel
    return reciprocal(stiffness * tau), -half, half


def yielding(effort: Any, q: Any, stiffness: Any, travel: Any, tau: Any) -> Any:
    """Slip of a cell with the spring ``k``: none while it is bent by less than ``x_s``, else the excess over ``τ``.

    All its parameters but ``k`` are independent of its strength: the force of the cell is proportional to ``k``.
    """
    half = stiffness * travel
    return piecewise_linear(effort, reciprocal(stiffness * tau), -half, half)


def coulomb(effort: Any, q: Any, force: Any, velocity: Any) -> Any:
    """Dry friction, regularised: ``F_c tanh(v/v_s)``."""
    return force * tanh(effort / velocity)


def stribeck(effort: Any, q: Any, force: Any, velocity: Any, rise: Any, decay: Any) -> Any:
    """Dry friction that is larger at low speed: ``F_c (1 + r exp(−(v/v_d)²)) tanh(v/v_s)``, ``r ≥ 0``."""
    return force * _falling(effort, rise, decay) * tanh(effort / velocity)


@shared
def _falling(velocity: Any, rise: Any, decay: Any) -> Any:
    """Stribeck's curve ``1 + r exp(−(v/v_d)²)``: friction over that at high speed."""
    over = velocity / decay
    return 1.0 + rise * exp(-over * over)


def quadratic_drag(effort: Any, q: Any, drag: Any) -> Any:
    """Return ``c₂ |v| v``."""
    return drag * absolute(effort) * effort


def turbulent(effort: Any, q: Any, conductance: Any, kappa: Any, flow: Any) -> Any:
    """Flow ``Q`` through pipe and orifice, ``g ε = Q (1 + κ |Q|/Q₀)``: linear for small, a root for large ``ε``."""
    return 2.0 * conductance * effort / (1.0 + sqrt(1.0 + 4.0 * kappa * conductance * absolute(effort) / flow))


def overflow(effort: Any, q: Any, rate: Any, level: Any, capacitance: Any) -> Any:
    """Return ``r max(V − V_o, 0)`` out of a tank of volume ``V = C ε`` whose rim is at ``V_o ≥ 0``."""
    above = capacitance * effort - level
    return rate * maximum(above, 0.0 * above)


# Slopes, widths and forces may be zero; what divides or scales may not.
_SLOPE_WIDTH = (NONNEGATIVE, NONNEGATIVE)

register(ResistorLaw("linear", linear, (0.7,), linear_thresholds, domains=(NONNEGATIVE,)))
register(ResistorLaw("maxwell", maxwell, (0.7, 0.4), maxwell_thresholds, domains=(POSITIVE, POSITIVE)))
register(ResistorLaw("dead_zone", dead_zone, (0.7, 0.6), dead_zone_thresholds, domains=_SLOPE_WIDTH))
register(
    ResistorLaw(
        "following_dead_zone", following_dead_zone, (0.7, 0.6, 0.5, 0.9), following_dead_zone_thresholds,
        domains=(*_SLOPE_WIDTH, ANY, POSITIVE),
    )
)  # fmt: skip
register(ResistorLaw("bristles", bristles, (0.7, 0.3), bristles_thresholds, domains=_SLOPE_WIDTH))
register(
    ResistorLaw("yielding", yielding, (0.7, 0.5, 0.4), yielding_thresholds, domains=(POSITIVE, NONNEGATIVE, POSITIVE))
)
register(ResistorLaw("coulomb", coulomb, (0.4, 0.3), domains=(NONNEGATIVE, POSITIVE)))
register(
    ResistorLaw(
        "stribeck", stribeck, (0.4, 0.3, 0.5, 0.8), domains=(NONNEGATIVE, POSITIVE, NONNEGATIVE, POSITIVE),
        monotone=False,
    )
)  # fmt: skip
register(ResistorLaw("quadratic_drag", quadratic_drag, (0.8,), domains=(NONNEGATIVE,)))
register(
    ResistorLaw(
        "thermal_dead_zone", thermal_dead_zone, (0.7, 0.6, 0.2, -0.1), thermal_dead_zone_thresholds,
        domains=(*_SLOPE_WIDTH, ANY, ANY),
    )
)  # fmt: skip
register(
    ResistorLaw(
        "rate_dependent_dead_zone", rate_dependent_dead_zone, (0.7, 0.6, 0.5, 0.9), rate_dependent_dead_zone_thresholds,
        domains=(*_SLOPE_WIDTH, NONNEGATIVE, POSITIVE),
    )
)  # fmt: skip
register(ResistorLaw("turbulent", turbulent, (0.7, 0.4, 0.9), domains=(NONNEGATIVE, NONNEGATIVE, POSITIVE)))
register(ResistorLaw("overflow", overflow, (0.8, 0.3, 0.6), domains=(NONNEGATIVE, NONNEGATIVE, POSITIVE)))


# Below this share of the reference speed every power is linear, so that friction (the power zero) has a slope at rest.
SMOOTHED = 1e-2
# Largest exponent: more would leave the range of 32 bits at the ends of the parameters' ranges.
_STEEPEST = 3.0
_LOG_SMOOTHED = math.log(SMOOTHED)
# Largest force over the force of slip: beyond it the share that slips grows no more.
_FAR = 30.0
# Strain below which a slip counts as linear in it.
_AT_REST = 1e-9
# Largest lean of a slipping spring towards one direction.
_LEANS = 0.95
# Rate [1/s] at which a cell yields that follows the path alone.
_AT_ONCE = 1e9


@shared
def _power(speed: Any, exponent: Any, reference: Any) -> Any:
    """Return ``z (z² + ε²)^{(n − 1)/2}``, ``z = v/v₀``, ``0 ≤ n ≤ 3``: odd, rising, ``±|z|ⁿ`` for ``|z| ≫ ε``."""
    z = speed / reference
    finer = z / SMOOTHED
    n = minimum(exponent, _STEEPEST + 0.0 * exponent)
    return z * exp((n - 1.0) * (_LOG_SMOOTHED + 0.5 * log1p(finer * finer)))


def power_damper(effort: Any, q: Any, forward: Any, backward: Any, exponent: Any, reference: Any) -> Any:
    """Return ``F₊ |v/v₀|ⁿ`` for ``v ≥ 0`` and ``−F₋ |v/v₀|ⁿ`` for ``v < 0``, linear below a hundredth of ``v₀``.

    ``n = 0`` is friction, 1 a viscous damper, 2 drag.
    """
    return where(real(effort) >= 0.0, forward + 0.0 * effort, backward + 0.0 * effort) * _power(
        effort, exponent, reference
    )


def square_damper(effort: Any, q: Any, force: Any, exponent: Any, reference: Any, q0: Any) -> Any:
    """Return ``±F (q/q₀)² |v/v₀|ⁿ``: a damper that grows with the square of the displacement."""
    s = q / q0
    return force * s * s * _power(effort, exponent, reference)


def ramp_damper(effort: Any, q: Any, force: Any, exponent: Any, reference: Any, slope: Any) -> Any:
    """Return ``±F max(c q, 0) |v/v₀|ⁿ``: a damper on the side of the sign of ``c`` that grows with the distance."""
    s = slope * q
    return force * maximum(s, 0.0 * s) * _power(effort, exponent, reference)


def cushion(effort: Any, q: Any, force: Any, exponent: Any, reference: Any, slope: Any, onset: Any) -> Any:
    """Return ``±F max(c q − s, 0) |v/v₀|ⁿ``: a ramp that sets in at a distance."""
    s = slope * q - onset
    return force * maximum(s, 0.0 * s) * _power(effort, exponent, reference)


@shared
def bouc_wen(effort: Any, q: Any, force: Any, exponent: Any, back: Any, lean: Any, mass: Any) -> Any:
    """Bouc–Wen beside a spring of the force ``E``: ``v e`` while ``v = p/m`` loads it, else ``−c v e``; ``e = |E/F|ⁿ``.

    With ``c ≥ 0`` both take energy: ``Ė = k (v − β |v| e sgn E − γ v e)``, ``β = (1 + c)/2`` and ``γ = (1 − c)/2``.
    What slips depends on the path alone, not on the time. ``p = q`` is the momentum that is read, ``n ≥ 1``. Forwards
    ``F (1 + a)`` stands for ``F``, and backwards ``F (1 − a)``.
    """
    speed = q * reciprocal(mass)
    forwards = where(real(q) < 0.0, -1.0 + 0.0 * q, 1.0 + 0.0 * q)
    slip = where(real(q) * real(effort) > 0.0, speed, -back * speed)
    return slip * _strained(effort / (force * _leant(lean, forwards)), exponent)


@shared
def _leant(lean: Any, side: Any) -> Any:
    """Return ``1 ± a``, which stays positive."""
    return 1.0 + side * maximum(minimum(lean, _LEANS + 0.0 * lean), -_LEANS + 0.0 * lean)


@shared
def _strained(strain: Any, exponent: Any) -> Any:
    """Return ``|s|ⁿ``, ``n ≥ 1``, and no more than for a strain far beyond one."""
    size = minimum(absolute(strain), _FAR + 0.0 * strain)
    return _power(size, maximum(exponent, 1.0 + 0.0 * exponent), 1.0 + 0.0 * size)


@shared
def _of_length(way: Any, length: Any) -> Any:
    """Return the share of a way in a length; none of no length."""
    moves = real(length) > 0.0
    return where(moves, way / where(moves, length, 1.0 + 0.0 * length), 0.0 * way)


@shared
def bouc_wen_path(
    x: Any, current: Any, h: Any, stiffness: Any, force: Any, exponent: Any, back: Any, lean: Any, mass: Any
) -> tuple[Any, Any]:
    """End state and mean effort of a step along the path ``h i``, of second order and passive for every length.

    In strains ``a = ±E/F``, positive on the way forth, ``da/dl = 1 + c |a|ⁿ`` up to rest and ``1 − aⁿ`` beyond, with
    the length ``l = s h |i|/F``. The way back follows the midpoint rule, the way forth its linearisation at the start.
    With the mean rate ``g``, the mean strain ``m`` of a part and ``m̃ = g (a + a⁺)/2 + (1 − g) m``, it takes the energy
    ``l (m̃ − g (a + a⁺)/2) = l m (1 − g) ≥ 0``.
    """
    side = where(real(current) < 0.0, -1.0 + 0.0 * current, 1.0 + 0.0 * current)
    force = force * _leant(lean, side)
    scale = side * stiffness / force
    strain, length = x * scale, h * current * scale
    behind = minimum(strain, 0.0 * strain)
    way, middle, rate = length, behind, 1.0 + 0.0 * strain
    if not certain(real(strain) >= 0.0):
        first = 1.0 + back * _strained(behind, exponent)
        half = minimum(behind + 0.5 * minimum(length, -behind) * first, 0.0 * behind)
        rate = 1.0 + back * _strained(half, exponent)
        way = minimum(length, -behind / rate)
        middle = behind + 0.5 * way * rate
        if certain(real(way) == real(length)):
            return (behind + way * rate) / scale, middle * force * side
    way = where(real(strain) < 0.0, way, 0.0 * way)
    rest, begin = length - way, maximum(strain, 0.0 * strain)
    size = maximum(begin, _AT_REST + 0.0 * begin)
    rise = _strained(size, exponent) / size
    taken = rise * begin
    one, two = relaxation(maximum(exponent, 1.0 + 0.0 * exponent) * rest * rise)
    slow = one * (1.0 - taken)
    end = begin + rest * slow
    forth = 0.5 * slow * (begin + end) + (1.0 - slow) * (begin + rest * two * (1.0 - taken))
    share = _of_length(way, length)
    short = (real(strain) < 0.0) & (real(way) >= real(length))
    mean = share * middle + (1.0 - share) * forth
    return (where(short, behind + way * rate, end) / scale, where(short, middle, mean) * force * side)


def lugre(effort: Any, q: Any, force: Any, rise: Any, decay: Any, mass: Any) -> Any:
    """Bristles that slip the more the larger their force ``E`` is: ``|v| E/F``, ``F = F_c (1 + r exp(−(v/v_d)²))``.

    That is `bouc_wen` with ``n = c = 1``; ``v = p/m`` is read. With ``r = 0`` it is Dahl's friction.
    """
    one = 1.0 + 0.0 * force
    return bouc_wen(effort, q, force * _falling(q * reciprocal(mass), rise, decay), one, one, 0.0 * force, mass)


def lugre_path(
    x: Any, current: Any, h: Any, stiffness: Any, force: Any, rise: Any, decay: Any, mass: Any
) -> tuple[Any, Any]:
    """As `bouc_wen_path`, with the friction at the speed of the step."""
    one = 1.0 + 0.0 * force
    return bouc_wen_path(
        x, current, h, stiffness, force * _falling(current, rise, decay), one, one, 0.0 * force, mass
    )  # fmt: skip


def duhem(effort: Any, q: Any, force: Any, exponent: Any, bend: Any, mass: Any) -> Any:
    """Slip beside the spring ``E' = k (1 + b |E|/F)``: ``v |E/F|ⁿ/(1 + b |E|/F)`` while ``v`` loads it, else none.

    ``v = p/m`` as of `bouc_wen`; the force may grow without end.
    """
    size = minimum(absolute(effort) / force, _FAR + 0.0 * effort)
    moved = where(real(q) * real(effort) > 0.0, q * reciprocal(mass), 0.0 * q)
    return moved * _strained(size, exponent) / _stiffer(size, bend)


@shared
def _stiffer(strain: Any, bend: Any) -> Any:
    """Return ``1 + b |E|/F`` within the bounds of the exponential spring."""
    return maximum(minimum(1.0 + bend * strain, MOST_BENT + 0.0 * strain), 1.0 / MOST_BENT + 0.0 * strain)


def duhem_path(
    x: Any, current: Any, h: Any, stiffness: Any, force: Any, exponent: Any, bend: Any, mass: Any
) -> tuple[Any, Any]:
    """As `bouc_wen_path`, on the spring that `duhem` stands beside: its way back is elastic, hence exact."""
    side = where(real(current) < 0.0, -1.0 + 0.0 * current, 1.0 + 0.0 * current)
    start, length = side * x, side * h * current
    way = minimum(length, maximum(-start, 0.0 * start))
    begin, rest = start + way, length - way
    if certain(real(rest) <= 0.0):
        return side * begin, side * exponential_spring_mean_effort(start, begin, stiffness, force, bend)
    effort = exponential_spring_mean_effort(begin, begin, stiffness, force, bend)
    size = maximum(effort / force, _AT_REST + 0.0 * effort)
    rise = _strained(size, exponent) / size
    taken = rise * (effort / force) / _stiffer(minimum(size, _FAR + 0.0 * size), bend)
    steep = maximum(exponent, 1.0 + 0.0 * exponent) - bend * size / (1.0 + bend * size)
    one, two = relaxation(rest * stiffness / force * maximum(rise * steep, 0.0 * rise))
    slow = one * (1.0 - taken)
    end = begin + rest * slow
    within = maximum(begin + rest * two * (1.0 - taken), 0.0 * begin)
    slipping = exponential_spring_mean_effort(within, within, stiffness, force, bend)
    forth = slow * exponential_spring_mean_effort(begin, end, stiffness, force, bend) + (1.0 - slow) * slipping
    share = where(real(rest) <= 0.0, 1.0 + 0.0 * length, _of_length(way, length))
    back = exponential_spring_mean_effort(start, begin, stiffness, force, bend)
    return side * end, side * (share * back + (1.0 - share) * forth)


@shared
def plastic_thresholds(q: Any, stiffness: Any, travel: Any, gape: Any, lean: Any) -> Any:
    """Thresholds that follow the displacement, and a slope so steep that nothing but the path matters."""
    gape, lean = gape * q * q, lean * q * q
    high, low = travel + gape + lean, travel + gape - lean
    return (
        _AT_ONCE * reciprocal(stiffness) + 0.0 * high,
        -stiffness * maximum(low, 0.0 * low),
        stiffness * maximum(high, 0.0 * high),
    )


def plastic(effort: Any, q: Any, stiffness: Any, travel: Any, gape: Any, lean: Any) -> Any:
    """Return a spring that yields at once beyond ``x_s + (g ± a) q²``."""
    slope, low, high = plastic_thresholds(q, stiffness, travel, gape, lean)
    return piecewise_linear(effort, slope, low, high)


_POWER = (NONNEGATIVE, POSITIVE)

register(ResistorLaw("power_damper", power_damper, (0.7, 0.5, 1.6, 0.8), domains=(NONNEGATIVE, NONNEGATIVE, *_POWER)))
register(ResistorLaw("square_damper", square_damper, (0.7, 0.6, 0.8, 0.9), domains=(NONNEGATIVE, *_POWER, POSITIVE)))
register(ResistorLaw("ramp_damper", ramp_damper, (0.7, 1.3, 0.8, 1.1), domains=(NONNEGATIVE, *_POWER, ANY)))
register(ResistorLaw("cushion", cushion, (0.7, 1.3, 0.8, 1.1, 0.3), domains=(NONNEGATIVE, *_POWER, ANY, ANY)))
_PATH = (POSITIVE, NONNEGATIVE)
register(
    ResistorLaw(
        "bouc_wen",
        bouc_wen,
        (0.7, 1.4, 0.3, 0.2, 0.9),
        domains=(*_PATH, NONNEGATIVE, ANY, POSITIVE),
        path=bouc_wen_path,
    )
)
register(
    ResistorLaw(
        "lugre", lugre, (1.4, 0.5, 0.8, 0.9), domains=(POSITIVE, NONNEGATIVE, POSITIVE, POSITIVE), path=lugre_path
    )
)
register(
    ResistorLaw(
        "duhem", duhem, (0.7, 1.4, 0.3, 0.9), domains=(*_PATH, ANY, POSITIVE), path=duhem_path,
        spring="exponential_spring",
    )
)  # fmt: skip
register(
    ResistorLaw("plastic", plastic, (0.7, 0.5, 0.2, 0.1), plastic_thresholds, domains=(POSITIVE, NONNEGATIVE, ANY, ANY))
)
