"""The steady cycle of a network under a periodic input, by Newton's method on the period map.

    x = P(x, θ),     (I − M) δx = ∂P/∂θ δθ,     M = ∂P/∂x

A passive network forgets its initial state. Where a resonance is sharp or a modulator state is slow, this takes so many
periods that integrating them all would be too expensive.

Neutral directions (monodromy eigenvalue 1), such as a charge within its dead zone, have no steady value of their own.
They keep the value after the run-in (least squares, least change); their sensitivity is zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.integrate import kernel, sweep
from phnn.integrate.program import Program

Array = NDArray[np.float64]

# Periods integrated before the first Newton step, so that every hysteron has gone round its loop.
_RUN_IN = 2
_ITERATIONS = 40
# Largest change within a period relative to the range of each state: the target; the limit for rounding errors; the
# limit where a hysteron that just begins to slide makes every Newton step small.
_STEADY, _NEARLY, _TOLERABLE = 1e-12, 1e-9, 1e-5
# A search within the last limit ends after so many iterations that leave more than this share of the smallest change.
_PATIENCE, _SLOW = 2, 0.9
# Singular values of the scaled ``I − M`` below this count as zero. A range below this share of a state is rounding.
_NEUTRAL = 1e-9
# The share of a change that a Newton step may leave, and the shares of the step that are tried. If none of them
# suffices, one more period is integrated.
_PROGRESS, _DAMPED = 0.5, (1.0, 0.25)


def steady_cycle(program: Program, theta: Array, x: Array, u: Array, h: Array) -> Array:
    """(N,) the state in which a period begins and ends.

    Args:
        x: (N,) initial guess; u: (n, P) mean inputs and h: (n,) steps [s] of one period.

    Raises:
        SolverFailed: no root of a step was found, or there is no steady cycle; names the states that drift.
    """
    states, efforts = np.empty((h.size + 1, x.size)), np.empty((h.size, x.size))

    def period(start: Array) -> tuple[Array, Array]:
        """The change of the state over a period, and the range of each state within it."""
        done = kernel.march(program, theta, start, u, h, states, efforts)
        if done < h.size:
            raise SolverFailed(f"no solution of the step at t = {h[:done].sum():.6g} s of a period")
        change = states[-1] - start
        if program.travel >= 0:
            # The impulse of a mean force grows without bound, but nothing depends on it.
            change[program.output] = 0.0
        return change, reach_of(states)

    for _ in range(_RUN_IN):
        x = x + period(x)[0]
    change, reach = period(x)
    before, best, waited = np.inf, (np.inf, x), 0
    for _ in range(_ITERATIONS):
        size = float(np.abs(change / reach).max())
        if size <= _STEADY or _NEARLY >= size >= _PROGRESS * before:
            return x
        waited = 0 if size < _SLOW * best[0] else waited + 1
        best = min(best, (size, x), key=lambda b: b[0])
        if waited >= _PATIENCE and best[0] <= _TOLERABLE:
            return best[1]
        step = steady_change(_swept(program, theta, states, efforts, u, h), change[:, None], reach)[:, 0]
        integrated, before = x + change, size
        for target in (*(x + share * step for share in _DAMPED), integrated):
            change, reach = period(target)
            # The Newton step may leave the region where the linearised period map is accurate.
            if np.abs(change / reach).max() <= _PROGRESS * size:
                break
        x = target
    left = np.abs(change / reach)
    best = min(best, (float(left.max()), x), key=lambda b: b[0])
    if best[0] <= _TOLERABLE:
        return best[1]
    raise SolverFailed(
        f"no steady cycle: {program.states[int(left.argmax())]} still changes by {left.max():.2g} of its range in a "
        f"period; set `start: unknown`, or correct the cause of the drift"
    )


def reach_of(states: Array) -> Array:
    """(N,) range of each state within a period; one for a state that does not move."""
    # State by state in memory: across rows of a few numbers the reduction takes sixteen times as long.
    by_state = np.ascontiguousarray(states.T)
    least, most = by_state.min(axis=1), by_state.max(axis=1)
    reach = np.maximum(most - least, _NEUTRAL * np.maximum(most, -least))
    return np.where(reach > 0.0, reach, 1.0)


def cycle_derivative(end: Array, first: int, states: Array) -> Array:
    """(N, C) derivatives of the state in which a steady cycle begins, by quantities that change alike in every period.

    Args:
        end: (N, C + N) derivatives of the state at the end of one period whose initial state is fixed, followed from
            column ``first`` by N columns of derivatives by the initial state.
        states: (n+1, N) of the period.
    """
    inside = np.arange(first, first + states.shape[1])
    return steady_change(end[:, inside], np.delete(end, inside, axis=1), reach_of(states))


def steady_change(monodromy: Array, change: Array, reach: Array) -> Array:
    """(N, C) ``(I − M)⁻¹ δ`` of changes (N, C) within a period; zero along neutral directions."""
    matrix = np.eye(reach.size) - monodromy * reach / reach[:, None]
    return np.asarray(reach[:, None] * np.linalg.lstsq(matrix, change / reach[:, None], rcond=_NEUTRAL)[0])


def _swept(program: Program, theta: Array, states: Array, efforts: Array, u: Array, h: Array) -> Array:
    """(N, N) ``∂P/∂x``."""
    n, march = states.shape[1], sweep.Integrated(program, theta, states, efforts, u, h)
    end, by = np.empty((n, n)), sweep.by_parameters(np.zeros(0, dtype=np.int64), h.size)
    sweep.sensitivities(march, by, np.zeros((n, 0)), np.arange(n), np.zeros(1, dtype=np.int64), end)
    return without_impulse(program, end, 0)


def without_impulse(program: Program, end: Array, first: int) -> Array:
    """Derivatives (N, C) of the state at the end of a period, with zero derivatives of the impulse of an imposed
    motion.

    Args:
        first: first of the columns by the initial states of the period.
    """
    if program.travel >= 0:
        end[program.output] = 0.0
        end[program.output, first + program.output] = 1.0
    return end
