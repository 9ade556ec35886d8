"""The kinds of blocks of the measuring chain and of sources, and amplifiers: from the command within the sub-steps to
the voltage there. A function here or in `phnn.chain.sensors` becomes a kind by its decorator.

A block takes ``fine`` (n, 3), its input at the start, middle and end of every step, the steps ``h`` (n,) [s], its input
before the first of them [V] and its parameters, and gives its output at the same points. The end of one row and the
start of the next differ where the input jumps. The low-passes are exact for an input that is linear between the points.
Static maps have another slope beyond a level, or below one: compositions of them are monotone characteristics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import entry
from phnn.laws.namespace import absolute, exp, log1p, maximum, minimum, real, shared, where
from phnn.laws.resistor import bouc_wen_path
from phnn.parameters import ANY, NONNEGATIVE, POSITIVE, Domain

Array = NDArray[Any]
Law = Callable[..., Any]


@dataclass(frozen=True)
class BlockKind:
    """A kind of block or of source.

    Attributes:
        law: from its input, or from the time, to its output; takes its parameters last.
        domains: admissible values of the parameters, in their order.
        remembers: its output at an instant does not follow from its input at that instant alone.
        linear: its output is linear in its input, so that changes of it pass like the signal itself.
    """

    law: Law
    domains: tuple[Domain, ...]
    remembers: bool = False
    linear: bool = False


AMPLIFIERS: dict[str, BlockKind] = {}
SENSORS: dict[str, BlockKind] = {}
SOURCES: dict[str, BlockKind] = {}


def registers(kinds: dict[str, BlockKind], *domains: Domain, name: str = "", **known: bool) -> Callable[[Law], Law]:
    """Return a decorator that makes a function a kind, by its own name if no other is given; see `BlockKind`."""

    def register(law: Law) -> Law:
        kinds[name or law.__name__] = BlockKind(law, domains, **known)
        return law

    return register


def rate(y: Array, t: Array) -> Array:
    """Return ``dy/dt`` at the samples, the slope of the parabola through each and its neighbours; second order.

    A time that is there twice parts what comes before it from what comes after it: the parabola takes one side.
    """
    shape = (-1,) + (1,) * (y.ndim - 1)
    h = np.diff(t.ravel()).reshape(shape)
    apart = h == 0.0
    # Products, not quotients: those of complex numbers keep the real part to the last digit.
    slopes = np.diff(y, axis=0) * (1.0 / np.where(apart, 1.0, h))
    inner = (h[1:] * slopes[:-1] + h[:-1] * slopes[1:]) * (1.0 / np.maximum(h[1:] + h[:-1], np.finfo(float).tiny))
    if not apart.any():
        first, last = 2.0 * slopes[:1] - inner[:1], 2.0 * slopes[-1:] - inner[-1:]
        return np.concatenate([first, inner, last])
    derivative, ends = np.concatenate([slopes[:1], inner, slopes[-1:]]), np.concatenate([[True], apart.ravel(), [True]])
    whole = ~(ends[1:] | ends[:-1])
    for side, (at, step) in enumerate(((1, 0), (-1, -1))):
        edges = np.flatnonzero(ends[side : ends.size - 1 + side] & ~ends[1 - side : ends.size - side])
        # The straight line through two samples where there is no third on this side.
        neighbour = np.where(whole[edges + at].reshape(-1, *shape[1:]), derivative[edges + at], slopes[edges + step])
        derivative[edges] = 2.0 * slopes[edges + step] - neighbour
    return derivative


@registers(AMPLIFIERS, name="rate", remembers=True)
def imposed_rate(fine: Array, h: Array, before: Any) -> Array:
    """Return ``u̇`` within the steps: a motion that is imposed by its displacement, as the velocity that it is.

    Of the parabola through start, middle and end of every step, so that the mean over a step is the difference of the
    displacement over the step, ``Δu/h``, exactly: no noise of the samples is amplified beyond that.

    Args:
        fine: (n, 3) displacement at the start, middle and end of the steps; h: (n,) steps [s].
        before: displacement before them, at which it stood still.
    """
    start, middle = fine[:, 0], fine[:, 1]
    end = np.append(start[1:], fine[-1:, 2])
    fall, rise = (4.0 * (middle - start), 4.0 * (end - middle))
    mean = end - start
    return np.asarray(np.column_stack([fall - mean, mean, rise - mean]) * (1.0 / h)[:, None])


def kneed(u: Array, share: Any, level: Any) -> Array:
    """Return ``u − a max(u − U, 0)`` for ``U ≥ 0`` and mirrored for ``U < 0``: the slope is ``1 − a`` beyond the level.

    Monotone for ``a ≤ 1``.
    """
    side = where(real(level) < 0.0, -1.0 + 0.0 * level, 1.0 + 0.0 * level)
    beyond = side * (u - level)
    return np.asarray(u - share * side * maximum(beyond, 0.0 * beyond))


# Share of a step by which a point counts as inside it: the node of a jump is hit to rounding only, of a million steps.
_INSIDE = 1e-9
_JUMP = 1e-9


@registers(AMPLIFIERS, NONNEGATIVE, remembers=True)
def delay(fine: Array, h: Array, before: Any, tau: Any) -> Array:
    """Return ``V(t) = u(t − τ)``, ``u`` the parabola through the three points of every step.

    Jumps of ``u`` keep their one-sided values where they fall between two steps. Where one falls into a step, the
    middle value is chosen such that the mean over the step by Simpson's rule is that of the delayed signal: what the
    network feels, and its derivative by ``τ``, are exact then.
    """
    zero = 0.0 * (tau + before + fine[0, 0])
    fine, before = fine + zero, before + zero
    nodes = np.concatenate([[0.0], np.cumsum(h)])
    gaps = np.real(fine[:, 0] - np.concatenate([[before], fine[:-1, 2]]))
    jumps = np.cumsum(np.abs(gaps) > _JUMP * np.abs(np.real(fine)).max())
    area = np.concatenate([[zero], np.cumsum(h * (fine[:, 0] + 4.0 * fine[:, 1] + fine[:, 2]) / 6.0)])
    return np.asarray(_delayed(fine, h, before, tau + zero, nodes, jumps, area))


@entry
def _delayed(fine: Any, h: Any, before: Any, tau: Any, nodes: Any, jumps: Any, area: Any) -> Any:
    out = np.empty_like(fine)
    # Of the start, middle and end of a step: where it comes from, and the signal's integral up to there.
    rows, areas = np.full(3, -1), np.empty(3, fine.dtype)
    for n in range(fine.shape[0]):
        for i in range(3):
            t = nodes[n] + 0.5 * i * h[n] - tau
            row = rows[i]
            while row + 1 < h.shape[0] and nodes[row + 1] <= real(t) + (1 - i) * _INSIDE * h[n]:
                row += 1
            rows[i] = row
            if row < 0:
                out[n, i], areas[i] = before, before * t
            else:
                s = (t - nodes[row]) / h[row]
                out[n, i], part = parabola(fine[row, 0], fine[row, 1], fine[row, 2], s)
                areas[i] = area[row] + h[row] * part
        first, last = rows[0], rows[2]
        if last >= 0 and jumps[last] > (jumps[first] if first >= 0 else 0):
            mean = (areas[2] - areas[0]) / h[n]
            out[n, 1] = 1.5 * mean - 0.25 * (out[n, 0] + out[n, 2])
    return out


@shared
def parabola(first: Any, middle: Any, last: Any, s: Any) -> Any:
    """Return the parabola through values at 0, ½ and 1, at ``s``, and its integral from 0 to there."""
    linear, square = 4.0 * middle - 3.0 * first - last, 2.0 * (first + last) - 4.0 * middle
    return first + s * (linear + s * square), s * (first + s * (0.5 * linear + s * square / 3.0))


# Below this size of x the series of sin(√x)/√x has converged after its third term.
_SERIES = 1e-4


@registers(AMPLIFIERS, POSITIVE, remembers=True)
def lowpass(fine: Array, h: Array, before: float, tau: Any) -> Array:
    """Return ``τ V̇ = u − V``."""
    return np.asarray(_first_order(fine + 0.0 * tau, *first_order_weights(h, tau), before + 0.0 * tau))


@registers(AMPLIFIERS, ANY, POSITIVE, remembers=True)
def fading(fine: Array, h: Array, before: float, share: Any, tau: Any) -> Array:
    """Return ``V = u − a z``, ``τ ż = u − z``: what lasts longer than ``τ`` fades by a share."""
    return np.asarray(fine - share * lowpass(fine, h, before, tau))


def first_order_weights(h: Array, tau: Any) -> tuple[Any, Any, Any]:
    """Return ``a, b₀, b₁`` of `first_order_step` in steps ``h`` [s]."""
    z = 0.5 * h / tau
    a = exp(-z)
    mean = (1.0 - a) / z
    return a, mean - a, 1.0 - mean


@registers(AMPLIFIERS, POSITIVE, POSITIVE, remembers=True)
def second_order_lowpass(fine: Array, h: Array, before: float, tau: Any, zeta: Any) -> Array:
    """Return ``τ² V̈ + 2ζ τ V̇ + V = u``.

    With ``s`` the time in units of τ and the state ``(V, dV/ds)``, ``V = u − 2ζ u'``, ``dV/ds = u'`` solve the equation
    for an input of slope ``u'``; what differs from them decays as ``exp(A s)``, ``A = [[0, 1], [−1, −2ζ]]``.
    """
    s, *weights = second_order_weights(h, tau, zeta)
    decay = np.stack(weights, axis=1)
    zero = 0.0 * (tau + zeta)
    return np.asarray(_second_order(fine + zero, s + zero, decay + zero, zeta + zero, before + zero))


def second_order_weights(h: Array, tau: Any, zeta: Any) -> tuple[Any, Any, Any]:
    """Return half a step in units of τ and the first row of ``exp(A s)`` for steps ``h`` [s]."""
    s = 0.5 * h / tau
    even, odd = _decay(s, zeta)
    return s, even + zeta * odd, odd


def _decay(s: Array, zeta: Any) -> tuple[Array, Array]:
    """Return ``e^{−ζs} cos √x`` and ``s e^{−ζs} sin √x / √x`` with ``x = (1 − ζ²) s²``, of either sign.

    Beyond critical damping they are sums of two falling exponentials, for the hyperbolic functions would overflow.
    """
    x = (1.0 - zeta * zeta) * s * s
    swings = real(x) > _SERIES
    falls = real(x) < -_SERIES
    root = np.sqrt(where(swings, x, 1.0))
    spread = np.sqrt(where(falls, -x, 1.0))
    slow, fast = exp(spread - zeta * s), exp(-spread - zeta * s)
    damped = exp(-zeta * s)
    even = where(swings, damped * np.cos(root), damped * (1.0 - x / 2.0 + x * x / 24.0))
    odd = where(swings, damped * np.sin(root) / root, damped * (1.0 - x / 6.0 + x * x / 120.0))
    return where(falls, 0.5 * (slow + fast), even), s * where(falls, 0.5 * (slow - fast) / spread, odd)


@shared
def first_order_step(state: Any, start: Any, end: Any, a: Any, b0: Any, b1: Any) -> Any:
    """Return the output after half a step: ``a V + b₀ u₀ + b₁ u₁``."""
    return a * state + b0 * start + b1 * end


@shared
def second_order_step(off: Any, rate: Any, slope: Any, even: Any, odd: Any, zeta: Any) -> Any:
    """Return output minus input, and the rate of the output, after half a step with an input of a slope.

    Args:
        even, odd: first row of ``exp(A s)``; the second is ``(−odd, even − 2ζ odd)``.
    """
    lag = 2.0 * zeta * slope
    start, start_rate = off + lag, rate - slope
    end, end_rate = even * start + odd * start_rate, (even - 2.0 * zeta * odd) * start_rate - odd * start
    return end - lag, slope + end_rate


@entry
def _first_order(fine: Any, a: Any, b0: Any, b1: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    for n in range(fine.shape[0]):
        out[n, 0] = state
        for i in range(1, 3):
            state = first_order_step(state, fine[n, i - 1], fine[n, i], a[n], b0[n], b1[n])
            out[n, i] = state
    return out


@entry
def _second_order(fine: Any, s: Any, decay: Any, zeta: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    rate = 0.0 * state
    for n in range(fine.shape[0]):
        out[n, 0] = state
        for i in range(1, 3):
            slope = (fine[n, i] - fine[n, i - 1]) / s[n]
            off, rate = second_order_step(state - fine[n, i - 1], rate, slope, decay[n, 0], decay[n, 1], zeta)
            state = fine[n, i] + off
            out[n, i] = state
    return out


@registers(AMPLIFIERS, POSITIVE, ANY, ANY, ANY, remembers=True)
def bouc_wen(fine: Array, h: Array, before: float, a: Any, beta: Any, gamma: Any, weight: Any) -> Array:
    """Return ``V − w h`` with ``ḣ = A V̇ − β|V̇|h − γ|h|V̇`` (eq. (19)), exact for an input monotone between points."""
    # All of them complex where one is, so that the loop is compiled for two types only.
    zero = 0.0 * (a + beta + gamma)
    state = _bouc_wen_state(fine + zero, before + zero, a + zero, beta + zero, gamma + zero)
    return np.asarray(fine - weight * state)


@shared
def bouc_wen_step(state: Any, rise: Any, a: Any, beta: Any, gamma: Any) -> Any:
    """Return the state ``h`` after the input has risen by ``rise``."""
    # With s = h·sign(V̇) both directions obey ds/d|V| = A − β s − γ|s|: one exponential a sign of s.
    side = where(real(rise) >= 0.0, 1.0, -1.0)
    length = absolute(rise)
    s = side * state
    if real(s) < 0.0:
        rate = beta - gamma
        # Length until s = 0; further than the step where it is not met at all.
        inside = real(1.0 - rate * s / a)
        straight = abs(real(rate * s / a)) < 1e-9
        meet = 2.0 * length + 1.0
        if straight:
            meet = -s / a
        elif inside > 0.0:
            meet = log1p(-rate * s / a) / rate
        if real(meet) < real(length):
            s = 0.0 * s
            length = length - meet
        else:
            s = _approach(s, a, rate, length)
            length = 0.0 * length
    s = _approach(s, a, beta + gamma, length)
    return side * s


@entry
def _bouc_wen_state(fine: Any, last: Any, a: Any, beta: Any, gamma: Any) -> Any:
    out = np.empty_like(fine)
    state = 0.0 * last
    for n in range(fine.shape[0]):
        for i in range(3):
            state = bouc_wen_step(state, fine[n, i] - last, a, beta, gamma)
            last = fine[n, i]
            out[n, i] = state
    return out


@shared
def _approach(s: Any, a: Any, rate: Any, length: Any) -> Any:
    """Return ``ds/dL = A − rate·s`` over a length."""
    z = rate * length
    factor = 1.0 - 0.5 * z
    if abs(real(z)) > 1e-6:
        factor = (1.0 - exp(-z)) / z
    return s + (a - rate * s) * length * factor


@registers(AMPLIFIERS, ANY, POSITIVE, POSITIVE, NONNEGATIVE, ANY, remembers=True)
def slipping(
    fine: Array, h: Array, before: float, weight: Any, travel: Any, exponent: Any, back: Any, lean: Any
) -> Array:
    """Return ``V − w s`` by Bouc and Wen: ``ṡ = (V̇ − β|V̇| e sgn s − γ V̇ e)/U``, ``e = |s|ⁿ``, ``β, γ = (1 ± c)/2``.

    Eq. (19) in its normal form, with an exponent and a lean ``a``: on the way up s slips towards ``1 + a``, and on the
    way down towards ``a − 1``. The steps along the path are those of the law `bouc_wen`.
    """
    zero = 0.0 * (travel + exponent + back + lean)
    shape = (travel + zero, exponent + zero, back + zero, lean + zero)
    return np.asarray(fine - weight * _slipped(fine + zero, before + zero, *shape))


@shared
def slip_step(state: Any, rise: Any, travel: Any, exponent: Any, back: Any, lean: Any) -> Any:
    """Return the state ``s`` after the input has risen by ``rise``."""
    one = 1.0 + 0.0 * state
    end, _ = bouc_wen_path(state, rise / travel, 1.0, one, one, exponent, back, lean, one)
    return end


@entry
def _slipped(fine: Any, last: Any, travel: Any, exponent: Any, back: Any, lean: Any) -> Any:
    out = np.empty_like(fine)
    state = 0.0 * last
    for n in range(fine.shape[0]):
        for i in range(3):
            state = slip_step(state, fine[n, i] - last, travel, exponent, back, lean)
            last = fine[n, i]
            out[n, i] = state
    return out


# A ratio whose powers vanish, while its logarithm exists.
_LEAST = 1e-100


@registers(AMPLIFIERS, POSITIVE)
def saturation(fine: Array, h: Array, before: float, limit: Any) -> Array:
    """Return ``V = clip(u, ±V_max)``."""
    return np.asarray(where(absolute(real(fine)) > real(limit), np.sign(real(fine)) * limit, fine + 0.0 * limit))


@registers(AMPLIFIERS, POSITIVE, POSITIVE)
def soft_saturation(fine: Array, h: Array, before: float, limit: Any, sharpness: Any) -> Array:
    """Return ``V = u/(1 + |u/V_max|ⁿ)^{1/n}`` (Rapp 1991), the larger of ``1`` and ``|u/V_max|`` out of the root."""
    size = absolute(fine + 0.0 * limit) / limit
    large = maximum(size, 1.0 + 0.0 * size)
    ratio = maximum(minimum(size, 1.0 + 0.0 * size) / large, _LEAST + 0.0 * size)
    return np.asarray(fine / large * exp(-log1p(exp(sharpness * np.log(ratio))) / sharpness))


@registers(AMPLIFIERS, POSITIVE, remembers=True)
def slew_limit(fine: Array, h: Array, before: Any, limit: Any) -> Array:
    """Return ``|V̇| ≤ S``: ``V`` follows ``u`` where it can and approaches it at the rate ``S`` where it cannot.

    Exact at the points of the sub-steps for an input that is linear between them.
    """
    reach = 0.5 * h * limit
    zero = 0.0 * (limit + fine[0, 0])
    return np.asarray(_limited(fine + zero, reach + zero, before + zero))


@shared
def slew_step(state: Any, u: Any, reach: Any) -> Any:
    """Return the output after half a step, in which it moves by ``reach`` at most."""
    return state + maximum(minimum(u - state, reach), -reach)


@entry
def _limited(fine: Any, reach: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    for n in range(fine.shape[0]):
        out[n, 0] = state
        for i in range(1, 3):
            state = slew_step(state, fine[n, i], reach[n])
            out[n, i] = state
    return out


@registers(AMPLIFIERS, NONNEGATIVE, remembers=True)
def play(fine: Array, h: Array, before: Any, width: Any) -> Array:
    """Return the play operator of half-width ``δ``: ``w`` rests while ``|u − w| < δ``; centred at first."""
    zero = 0.0 * (width + before + fine[0, 0])
    return np.asarray(_carried(fine + zero, width + zero, before + zero))


@entry
def _carried(fine: Any, width: Any, state: Any) -> Any:
    out = np.empty_like(fine)
    for n in range(fine.shape[0]):
        for i in range(3):
            state = maximum(minimum(state, fine[n, i] + width), fine[n, i] - width)
            out[n, i] = state
    return out


@registers(AMPLIFIERS, ANY)
def offset(fine: Array, h: Array, before: Any, voltage: Any) -> Array:
    """Return ``V = u + V₀``."""
    return np.asarray(fine + voltage)


@registers(AMPLIFIERS, POSITIVE)
def gain(fine: Array, h: Array, before: Any, factor: Any) -> Array:
    """Return ``V = γ u``: a drive of unknown gain."""
    return np.asarray(factor * fine)


@registers(AMPLIFIERS, ANY, ANY)
def knee(fine: Array, h: Array, before: Any, share: Any, level: Any) -> Array:
    """Apply `phnn.chain.amplifiers.kneed`: less gain beyond a level on one side."""
    return kneed(fine, share, level)


@registers(AMPLIFIERS, ANY, NONNEGATIVE)
def dead_band(fine: Array, h: Array, before: Any, share: Any, level: Any) -> Array:
    """Return ``u − a clip(u, ±U)``: the slope is ``1 − a`` below the level, a dead band for ``a = 1``, monotone."""
    inside = 0.0 * fine + level
    return np.asarray(fine - share * maximum(minimum(fine + 0.0 * inside, inside), -inside))
