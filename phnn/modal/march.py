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

from phnn.integrate.cache import inline, loop_entry
from phnn.modal.step import (
    ModeState,
    Parts,
    PortState,
    Step,
    close_period,
    extend,
    move_modes,
    move_ports,
    prepare,
    release,
    step_of,
)

Array = NDArray[np.float64]

# The integration stops at a larger Δx, before anything overflows; the largest Δx before the first step, not zero
# because changes are compared with it.
_LARGEST, _LEAST = 1e200, 1e-300
# Harmonic oscillators have decayed to this before the period that counts; periods at most.
_DECAYED, _PERIODS = 1e-4, 11


class Structure(NamedTuple):
    """Modes and ports: omega, zeta (M,) frequencies [rad/s] and damping ratios; b (M, P) ratios."""

    omega: Array
    zeta: Array
    b: Array


class Integrated(NamedTuple):
    """A period: q (n, M) at the steps' beginnings; s̄ (n, P, count) with ``ē = Σ k s̄``; whether steps were solved."""

    q: Array
    s: Array
    solved: bool


class _Period(NamedTuple):
    """Arrays for q (n, M) and s̄ (n, P, count) of the period that is returned."""

    q: Array
    s: Array


@inline
def _keep(modes: Any, step: Any, now: Any, out: Any) -> None:
    """Write a step's q and s̄ into the period; before the modes move."""
    for i in range(modes.q.size):
        out.q[now, i] = modes.q[i]
    for j in range(step.dx.size):
        for a in range(step.parts.shape[1]):
            out.s[now, j, a] = step.parts[j, a]


@loop_entry
def _march(u: Array, modes: ModeState, parts: Parts, ports: PortState, step: Step, periods: int, out: _Period) -> bool:
    """Fill ``out`` with the last of some periods; False where a step has no solution."""
    largest = _LEAST
    prepare(modes, ports, step)
    for number in range(periods * len(u)):
        now = number % len(u)
        if now == 0 and number > 0:
            close_period(ports, len(u))
        release(modes, step)
        largest = extend(u[now], parts, ports, step, largest)
        if not 0.0 < largest < _LARGEST:
            return False
        _keep(modes, step, now, out)
        move_ports(parts, ports, step)
        move_modes(u[now], modes, step)
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
    u: Array,
    structure: Structure,
    parts: Parts,
    h: float,
    begin: Array | None = None,
    before: Array | None = None,
    periods: int | None = None,
) -> Integrated:
    """Integrate a periodic input until the transient of the modes is over, or for a dozen periods; return the last one.

    Args:
        u: (n, P) force of each step, constant over it; h: step [s].
        begin: (2, M) q and q̇ to begin with, zero if left out; stops begin without stress.
        before: (P,) mean square of the extensions before the first period, zero if left out.
        periods: how many are integrated; as many as the transient takes if left out.
    """
    n, (count, number) = len(u), structure.b.shape
    if periods is None:
        slowest = float((structure.zeta * structure.omega).min()) * n * h
        periods = 1 + min(_PERIODS, int(np.ceil(-np.log(_DECAYED) / max(slowest, 1e-12))))
    q, v = np.zeros((2, count)) if begin is None else begin.copy()
    calm = np.zeros(number) if before is None else before.copy()
    modes = ModeState(propagator_of(structure.omega, structure.zeta, h), structure.b, q, v)
    ports = PortState(np.zeros(number), np.zeros(number), calm, np.zeros(parts.k.shape))
    out = _Period(np.empty((n, count)), np.empty((n, *parts.k.shape)))
    solved = _march(u, modes, parts, ports, step_of(h, parts.k.shape), periods, out)
    return Integrated(*out, bool(solved))
