"""Integration of modes with elements at their ports: exact for the modes, with an exact power balance.

While the forces at the ports are constant over a step, modes move as in closed form, and the work done on them is
``Σ_j f_j Δx_j``: what they store more and what their dampers lose. An element gives the step's mean force ``ē_j`` as a
discrete gradient (Gonzalez 1996), so that ``ē_j Δx_j`` is what it stores more plus what it loses. Both balances are
exact, and therefore every step is passive, whatever its length, within a period of slow springs. ``Δx`` follows from

    Δx = Δx⁰ + C (u − ē(Δx)),     C_jl = Σ_i b_ij (1 − a_i) b_il,

with ``Δx⁰`` without forces and ``a_i`` what is left of a displacement after a step; C shrinks with the square of the
step, and the equation is solved by Newton's method.

References: Gonzalez 1996, J. Nonlinear Sci. 6; Visintin 1994, Differential Models of Hysteresis, ch. III (stops).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.compiled import entry, inline
from phnn.integrate.elimination import eliminate
from phnn.modal.elements import HARDENING, SLOW, SOFTENING, STOP

Array = NDArray[np.float64]

# Iterations of a step, those with whole Newton steps, and the change of Δx, over the largest so far, that ends them.
_MOST, _WHOLE, _SETTLED = 60, 20, 1e-11
# Harmonic oscillators have decayed to this before the period that counts; periods at most.
_DECAYED, _PERIODS = 1e-4, 11


class Marched(NamedTuple):
    """A period: q (n, M) at the steps' beginnings; s̄ (n, P, count) with ``ē = Σ k s̄``; whether steps were solved."""

    q: Array
    s: Array
    solved: bool


@inline
def _mean_part(kind: Any, x: Any, dx: Any, h: Any, r: Any, s: Any, before: Any) -> Any:
    """Mean of one part over a step in which the extension goes from x to x + dx: a discrete gradient."""
    y = x + dx
    if kind == STOP:
        return 0.5 * (s + min(max(s + dx, -r), r))
    if kind == SOFTENING:
        return (x + y) / (np.sqrt(1.0 + (x / r) ** 2) + np.sqrt(1.0 + (y / r) ** 2))
    if kind == HARDENING:
        return 0.25 * (x + y) * (x * x + y * y)
    if kind == SLOW:
        return 0.5 * (x + y) / (1.0 + before / (r * r))
    return abs(dx) * dx / (h * h)


@inline
def _slope(kind: Any, x: Any, dx: Any, h: Any, r: Any, s: Any, before: Any) -> Any:
    """About how fast that mean grows with dx."""
    y = x + dx
    if kind == STOP:
        return 0.5 if abs(s + dx) < r else 0.0
    if kind == SOFTENING:
        return 0.5 / (1.0 + (y / r) ** 2) ** 1.5
    if kind == HARDENING:
        return 0.25 * (x * x + 2.0 * x * y + 3.0 * y * y)
    if kind == SLOW:
        return 0.5 / (1.0 + before / (r * r))
    return 2.0 * abs(dx) / (h * h)


@inline
def _extend(
    u: Any, free: Any, c: Any, kinds: Any, k: Any, r: Any, h: Any, x: Any, s: Any, before: Any, largest: Any, dx: Any,
    ebar: Any, parts: Any, room: Any,
) -> Any:  # fmt: skip
    """Solve a step for dx, with ē and its parts; the largest Δx so far, or -1 where no solution was found."""
    stiff, off, jacobian = room
    for iteration in range(_MOST):
        change = 0.0
        for j in range(dx.size):
            off[j, 0] = free[j] - dx[j]
            for m in range(dx.size):
                off[j, 0] += c[j, m] * (u[m] - ebar[m])
                jacobian[j, m] = c[j, m] * stiff[m]
            jacobian[j, j] += 1.0
        eliminate(jacobian, off)
        # Stops have kinks, between which whole steps may go back and forth.
        share = 1.0 if iteration < _WHOLE else 0.5
        for j in range(dx.size):
            change = max(change, abs(off[j, 0]))
            dx[j] += share * off[j, 0]
            largest = max(largest, abs(dx[j]))
        for j in range(dx.size):
            ebar[j] = 0.0
            stiff[j] = 0.0
            for a in range(kinds.size):
                stiff[j] += k[j, a] * _slope(kinds[a], x[j], dx[j], h, r[j, a], s[j, a], before[j])
                parts[j, a] = _mean_part(kinds[a], x[j], dx[j], h, r[j, a], s[j, a], before[j])
                ebar[j] += k[j, a] * parts[j, a]
        if change <= _SETTLED * largest:
            return largest
    return -1.0


@entry
def _march(
    u: Array, propagator: Array, b: Array, kinds: NDArray[np.int64], k: Array, r: Array, h: float, periods: int,
    begin: Array, before: Array, q_out: Array, s_out: Array,
) -> bool:  # fmt: skip
    """Fills q_out and s_out with the last period; False where a step found no solution."""
    n, ports = u.shape
    modes, parts = b.shape[0], kinds.size
    q, v, x = begin[0].copy(), begin[1].copy(), np.zeros(ports)
    s, ebar, free, dx = np.zeros((ports, parts)), np.zeros(ports), np.zeros(ports), np.zeros(ports)
    room = (np.zeros(ports), np.zeros((ports, 1)), np.zeros((ports, ports)))
    c, square, largest = np.zeros((ports, ports)), np.zeros(ports), 1e-300
    for i in range(modes):
        for j in range(ports):
            x[j] += b[i, j] * q[i]
            for m in range(ports):
                c[j, m] += b[i, j] * (1.0 - propagator[0, i]) * b[i, m]
    for step in range(periods * n):
        now = step % n
        if now == 0 and step > 0:
            for j in range(ports):
                before[j] = square[j] / n
                square[j] = 0.0
        for j in range(ports):
            free[j] = 0.0
        for i in range(modes):
            moved = (propagator[0, i] - 1.0) * q[i] + propagator[1, i] * v[i]
            q_out[now, i] = q[i]
            for j in range(ports):
                free[j] += b[i, j] * moved
        largest = _extend(u[now], free, c, kinds, k, r, h, x, s, before, largest, dx, ebar, s_out[now], room)
        if not 0.0 < largest < 1e200:
            return False
        for j in range(ports):
            for a in range(parts):
                if kinds[a] == STOP:
                    s[j, a] = min(max(s[j, a] + dx[j], -r[j, a]), r[j, a])
            x[j] += dx[j]
            square[j] += x[j] * x[j]
        for i in range(modes):
            g = 0.0
            for j in range(ports):
                g += b[i, j] * (u[now, j] - ebar[j])
            y = q[i] - g
            q[i], v[i] = (
                g + propagator[0, i] * y + propagator[1, i] * v[i],
                propagator[2, i] * y + propagator[3, i] * v[i],
            )
    return True


def propagator_of(omega: Array, zeta: Array, h: float) -> Array:
    """(4, M) entries of ``exp(A h)``, ``A = [[0, 1], [−ω², −2ζω]]``, row by row; ζ < 1."""
    damped = omega * np.sqrt(1.0 - zeta**2)
    decay, cosine = np.exp(-zeta * omega * h), np.cos(damped * h)
    sine = np.sin(damped * h) / damped
    return np.stack(
        [
            decay * (cosine + zeta * omega * sine),
            decay * sine,
            -decay * omega**2 * sine,
            decay * (cosine - zeta * omega * sine),
        ]
    )


def march(
    u: Array, omega: Array, zeta: Array, b: Array, kinds: NDArray[np.int64], k: Array, r: Array, h: float,
    begin: Array | None = None, before: Array | None = None, periods: int | None = None,
) -> Marched:  # fmt: skip
    """Integrate a periodic input until the transient of the modes is over, or for a dozen periods; return the last one.

    Args:
        u: (n, P) force of each step, constant over it; omega, zeta: (M,); b: (M, P).
        kinds: (count,) of the elements' parts; k, r: (P, count) their weights and thresholds; h: step [s].
        begin: (2, M) q and q̇ to begin with, zero if left out; stops begin without stress.
        before: (P,) mean square of the extensions before the first period, zero if left out.
        periods: how many are integrated; as many as the transient takes if left out.
    """
    n, modes = len(u), omega.size
    if periods is None:
        slowest = float((zeta * omega).min()) * n * h
        periods = 1 + min(_PERIODS, int(np.ceil(-np.log(_DECAYED) / max(slowest, 1e-12))))
    q, s = np.empty((n, modes)), np.empty((n, *k.shape))
    start = np.zeros((2, modes)) if begin is None else begin
    calm = np.zeros(b.shape[1]) if before is None else before.copy()
    solved = _march(u, propagator_of(omega, zeta, h), b, kinds, k, r, h, periods, start, calm, q, s)
    return Marched(q, s, bool(solved))
