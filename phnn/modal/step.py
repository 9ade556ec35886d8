"""One step of modes with elements at their ports, compiled: Newton's method for the extensions, then the modes.

    Δx = Δx⁰ + C (u − ē(Δx)),     C_jl = Σ_i b_ij (1 − a_i) b_il

The mean forces of the parts are discrete gradients of `phnn.laws`. Their slopes in Newton's method are written out,
because they shape the iterations and not the solution, and a complex step through the laws takes longer.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import inline
from phnn.integrate.elimination import eliminate
from phnn.laws.resistor import quadratic_drag
from phnn.laws.storage import hardening_spring_mean_effort, softening_spring_mean_effort, spring_mean_effort
from phnn.modal.elements import HARDENING, SLOW, SOFTENING, STOP

Array = NDArray[np.float64]

# Iterations of a step, those with whole Newton steps, and the change of Δx, over the largest so far, that ends them.
_MOST, _WHOLE, _SETTLED = 60, 20, 1e-11


class Parts(NamedTuple):
    """Parts of the elements: kinds (count,) of `phnn.modal.elements`; k, r (P, count) weights and thresholds."""

    kinds: NDArray[np.int64]
    k: Array
    r: Array


class ModeState(NamedTuple):
    """The modes: propagator (4, M) of one step, rows of ``exp(A h)``; b (M, P) ratios; q, v = q̇ (M,)."""

    propagator: Array
    b: Array
    q: Array
    v: Array


class PortState(NamedTuple):
    """The ports: (P,) extensions x, Σ x² of this period, ⟨x²⟩ of the one before; s (P, count) of the stops."""

    x: Array
    square: Array
    before: Array
    s: Array


class Step(NamedTuple):
    """The unknowns of a step and the memory of its solution.

    Attributes:
        h: length [s].
        c (P, P), free (P,): Δx of the ports by constant forces, and Δx⁰ without forces.
        dx, ebar (P,): Δx and ē; parts (P, count): s̄.
        stiff (P,), off (P, 1), jacobian (P, P): slopes of ē, residual and matrix of Newton's method.
    """

    h: float
    c: Array
    free: Array
    dx: Array
    ebar: Array
    parts: Array
    stiff: Array
    off: Array
    jacobian: Array


def step_of(h: float, shape: tuple[int, ...]) -> Step:
    """The memory of a step of length h, zero, for (P, count) parts."""
    one, square = (shape[0],), (shape[0], shape[0])
    return Step(h, *(np.zeros(size) for size in (square, one, one, one, shape, one, (shape[0], 1), square)))


_spring, _softening = inline(spring_mean_effort), inline(softening_spring_mean_effort)
_hardening, _drag = inline(hardening_spring_mean_effort), inline(quadratic_drag)


@inline
def _held(s: Any, dx: Any, r: Any) -> Any:
    """Deflection of a stop after Δx: what goes beyond its threshold slides."""
    return min(max(s + dx, -r), r)


@inline
def _mean_part(kind: Any, x: Any, dx: Any, h: Any, r: Any, s: Any, before: Any) -> Any:
    """Mean of one part over a step from x to x + dx: the law's discrete gradient for the weight one."""
    y = x + dx
    if kind == STOP:
        return _spring(s, _held(s, dx, r), 1.0)
    if kind == SOFTENING:
        return _softening(x, y, 1.0, r)
    if kind == HARDENING:
        return _hardening(x, y, 1.0)
    if kind == SLOW:
        return _spring(x, y, 1.0) / (1.0 + before / (r * r))
    return _drag(dx, 0.0, 1.0) / (h * h)


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
def _newton(u: Any, step: Any, largest: Any, share: Any) -> Any:
    """Move Δx by a share of a Newton step; returns the largest residual and the largest Δx so far."""
    change = 0.0
    for j in range(step.dx.size):
        step.off[j, 0] = step.free[j] - step.dx[j]
        for m in range(step.dx.size):
            step.off[j, 0] += step.c[j, m] * (u[m] - step.ebar[m])
            step.jacobian[j, m] = step.c[j, m] * step.stiff[m]
        step.jacobian[j, j] += 1.0
    eliminate(step.jacobian, step.off)
    for j in range(step.dx.size):
        change = max(change, abs(step.off[j, 0]))
        step.dx[j] += share * step.off[j, 0]
        largest = max(largest, abs(step.dx[j]))
    return change, largest


@inline
def _respond(parts: Any, ports: Any, step: Any) -> None:
    """Fill what the elements respond to Δx: ē, its parts and its slopes."""
    for j in range(step.dx.size):
        step.ebar[j] = 0.0
        step.stiff[j] = 0.0
        for a in range(parts.kinds.size):
            kind, k, r, s = parts.kinds[a], parts.k[j, a], parts.r[j, a], ports.s[j, a]
            step.stiff[j] += k * _slope(kind, ports.x[j], step.dx[j], step.h, r, s, ports.before[j])
            step.parts[j, a] = _mean_part(kind, ports.x[j], step.dx[j], step.h, r, s, ports.before[j])
            step.ebar[j] += k * step.parts[j, a]


@inline
def extend(u: Any, parts: Any, ports: Any, step: Any, largest: Any) -> Any:
    """Solve a step for Δx, ē and its parts; returns the largest Δx so far, or -1 where no solution was found."""
    for iteration in range(_MOST):
        # Stops have kinks, between which whole steps may go back and forth.
        change, largest = _newton(u, step, largest, 1.0 if iteration < _WHOLE else 0.5)
        _respond(parts, ports, step)
        if change <= _SETTLED * largest:
            return largest
    return -1.0


@inline
def prepare(modes: Any, ports: Any, step: Any) -> None:
    """Fill the extensions at the start, and C."""
    for i in range(modes.q.size):
        for j in range(step.dx.size):
            ports.x[j] += modes.b[i, j] * modes.q[i]
            for m in range(step.dx.size):
                step.c[j, m] += modes.b[i, j] * (1.0 - modes.propagator[0, i]) * modes.b[i, m]


@inline
def release(modes: Any, step: Any) -> None:
    """Fill Δx⁰: how the extensions move without forces."""
    for j in range(step.dx.size):
        step.free[j] = 0.0
    for i in range(modes.q.size):
        moved = (modes.propagator[0, i] - 1.0) * modes.q[i] + modes.propagator[1, i] * modes.v[i]
        for j in range(step.dx.size):
            step.free[j] += modes.b[i, j] * moved


@inline
def move_modes(u: Any, modes: Any, step: Any) -> None:
    """Advance the modes under the forces u − ē."""
    a = modes.propagator
    for i in range(modes.q.size):
        g = 0.0
        for j in range(step.dx.size):
            g += modes.b[i, j] * (u[j] - step.ebar[j])
        y = modes.q[i] - g
        modes.q[i], modes.v[i] = (
            g + a[0, i] * y + a[1, i] * modes.v[i],
            a[2, i] * y + a[3, i] * modes.v[i],
        )


@inline
def move_ports(parts: Any, ports: Any, step: Any) -> None:
    """Advance the extensions and the stops by Δx."""
    for j in range(step.dx.size):
        for a in range(parts.kinds.size):
            if parts.kinds[a] == STOP:
                ports.s[j, a] = _held(ports.s[j, a], step.dx[j], parts.r[j, a])
        ports.x[j] += step.dx[j]
        ports.square[j] += ports.x[j] * ports.x[j]


@inline
def close_period(ports: Any, n: Any) -> None:
    """Keep the mean square of the period that ends for the slow springs of the next one."""
    for j in range(ports.x.size):
        ports.before[j] = ports.square[j] / n
        ports.square[j] = 0.0
