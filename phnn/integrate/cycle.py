"""The steady cycle of a network under a periodic input, by Newton's method on the period map.

    x = P(x, θ),     (I − M) δx = ∂P/∂θ δθ,     M = ∂P/∂x

A passive network forgets how it began, but slowly where a resonance is sharp or a memory long, and a march would take
as many periods. What nothing carries away again, such as a charge within its dead zone, has no steady value of its own:
it keeps the one that it has reached (least squares, least change), and no parameter moves it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.integrate import kernel, sweep
from phnn.integrate.program import Program

Array = NDArray[np.float64]

# Periods marched before the first Newton step, so that hysterons have been around their loops.
_RUN_IN = 2
_ITERATIONS = 40
# Changes within a period, over the range of each state: what is aimed at, and what rounding may leave of it.
_STEADY, _NEARLY = 1e-12, 1e-9
# A singular value of the scaled ``I − M`` below this is none.
_NEUTRAL = 1e-9
# Of a change, that a Newton step may leave: otherwise one more period is marched instead.
_PROGRESS = 0.5


def steady_cycle(program: Program, theta: Array, x: Array, u: Array, h: Array) -> Array:
    """(N,) the state in which a period begins and ends.

    Args:
        x: (N,) where to begin; u: (n, P) mean inputs and h: (n,) steps [s] of one period.

    Raises:
        SolverFailed: no root of a step was found, or there is no steady cycle; names what moves on.
    """
    states, efforts = np.empty((h.size + 1, x.size)), np.empty((h.size, x.size))

    def period(start: Array) -> tuple[Array, Array]:
        """The end of a period, and the range of each state in it."""
        done = kernel.march(program, theta, start, u, h, states, efforts)
        if done < h.size:
            raise SolverFailed(f"no solution of the step at t = {h[:done].sum():.6g} s of a period")
        spread = np.ptp(states, axis=0)
        return states[-1].copy(), np.where(spread > 0.0, spread, 1.0)

    for _ in range(_RUN_IN):
        x, _ = period(x)
    end, spread = period(x)
    before = np.inf
    for _ in range(_ITERATIONS):
        change = float(np.abs((end - x) / spread).max())
        if change <= _STEADY or _NEARLY >= change >= _PROGRESS * before:
            return x
        monodromy = _swept(program, theta, states, efforts, u, h)
        target = x + _settled(monodromy, (end - x)[:, None], spread)[:, 0]
        further, reach = period(target)
        if np.abs((further - target) / reach).max() > _PROGRESS * change:
            # Newton's step has left the region in which the map is what its derivative says.
            target = end
            further, reach = period(target)
        x, end, spread, before = target, further, reach, change
    worst = program.states[int(np.abs((end - x) / spread).argmax())]
    raise SolverFailed(
        f"no steady cycle: {worst} still changes by {change:.2g} of its range in a period; say `start: unknown`, or "
        f"correct what makes it drift"
    )


def cycle_derivative(end: Array, first: int, states: Array) -> Array:
    """(N, C) derivatives of the state in which a steady cycle begins, by what changes in every period alike.

    Args:
        end: (N, C + N) derivatives of the state in which one period ends that begins unchanged, and by the states in
            which it begins: those are the N columns from ``first`` on.
        states: (n+1, N) of the period.
    """
    inside = np.arange(first, first + states.shape[1])
    spread = np.ptp(states, axis=0)
    return _settled(end[:, inside], np.delete(end, inside, axis=1), np.where(spread > 0.0, spread, 1.0))


def _settled(monodromy: Array, change: Array, spread: Array) -> Array:
    """(N, C) ``(I − M)⁻¹ δ`` of changes (N, C) within a period, and nothing along what is neutral."""
    matrix = np.eye(spread.size) - monodromy * spread / spread[:, None]
    return np.asarray(spread[:, None] * np.linalg.lstsq(matrix, change / spread[:, None], rcond=_NEUTRAL)[0])


def _swept(program: Program, theta: Array, states: Array, efforts: Array, u: Array, h: Array) -> Array:
    """(N, N) ``∂P/∂x``."""
    n, none = states.shape[1], np.zeros(0, dtype=np.int64)
    end = np.empty((n, n))
    sweep.sensitivities(
        program, theta, none, states, efforts, u, h, np.zeros((n, 0)), np.arange(n), np.zeros((h.size, 0)), none,
        np.zeros((h.size, 0)), np.zeros(1, dtype=np.int64), end=end,
    )  # fmt: skip
    return end
