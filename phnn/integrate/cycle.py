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
# Changes within a period, over the range of each state: what is aimed at, what rounding may leave of it, and what is
# good enough where a hysteron that only just slides lets every step gain little.
_STEADY, _NEARLY, _TOLERABLE = 1e-12, 1e-9, 1e-5
# A singular value of the scaled ``I − M`` below this is none; a range below this share of a state is rounding.
_NEUTRAL = 1e-9
# Of a change, that a Newton step may leave, and shares of the step that are tried; then a period is marched instead.
_PROGRESS, _DAMPED = 0.5, (1.0, 0.25)


def steady_cycle(program: Program, theta: Array, x: Array, u: Array, h: Array) -> Array:
    """(N,) the state in which a period begins and ends.

    Args:
        x: (N,) where to begin; u: (n, P) mean inputs and h: (n,) steps [s] of one period.

    Raises:
        SolverFailed: no root of a step was found, or there is no steady cycle; names what moves on.
    """
    states, efforts = np.empty((h.size + 1, x.size)), np.empty((h.size, x.size))

    def period(start: Array) -> tuple[Array, Array]:
        """What a period changes, and the range of each state in it."""
        done = kernel.march(program, theta, start, u, h, states, efforts)
        if done < h.size:
            raise SolverFailed(f"no solution of the step at t = {h[:done].sum():.6g} s of a period")
        change = states[-1] - start
        if program.travel >= 0:
            # The impulse of a mean force grows for ever, and nothing follows it.
            change[program.output] = 0.0
        return change, _reach(states)

    for _ in range(_RUN_IN):
        x = x + period(x)[0]
    change, reach = period(x)
    before = np.inf
    for _ in range(_ITERATIONS):
        size = float(np.abs(change / reach).max())
        if size <= _STEADY or _NEARLY >= size >= _PROGRESS * before:
            return x
        step = _settled(_swept(program, theta, states, efforts, u, h), change[:, None], reach)[:, 0]
        marched, before = x + change, size
        for target in (*(x + share * step for share in _DAMPED), marched):
            change, reach = period(target)
            # Newton's step may leave the region in which the map is what its derivative says.
            if np.abs(change / reach).max() <= _PROGRESS * size:
                break
        x = target
    left = np.abs(change / reach)
    if left.max() <= _TOLERABLE:
        return x
    raise SolverFailed(
        f"no steady cycle: {program.states[int(left.argmax())]} still changes by {left.max():.2g} of its range in a "
        f"period; say `start: unknown`, or correct what makes it drift"
    )


def _reach(states: Array) -> Array:
    """(N,) range of each state within a period; what has none has one."""
    reach = np.maximum(np.ptp(states, axis=0), _NEUTRAL * np.abs(states).max(axis=0))
    return np.where(reach > 0.0, reach, 1.0)


def cycle_derivative(end: Array, first: int, states: Array) -> Array:
    """(N, C) derivatives of the state in which a steady cycle begins, by what changes in every period alike.

    Args:
        end: (N, C + N) derivatives of the state in which one period ends that begins unchanged, and by the states in
            which it begins: those are the N columns from ``first`` on.
        states: (n+1, N) of the period.
    """
    inside = np.arange(first, first + states.shape[1])
    return _settled(end[:, inside], np.delete(end, inside, axis=1), _reach(states))


def _settled(monodromy: Array, change: Array, reach: Array) -> Array:
    """(N, C) ``(I − M)⁻¹ δ`` of changes (N, C) within a period, and nothing along what is neutral."""
    matrix = np.eye(reach.size) - monodromy * reach / reach[:, None]
    return np.asarray(reach[:, None] * np.linalg.lstsq(matrix, change / reach[:, None], rcond=_NEUTRAL)[0])


def _swept(program: Program, theta: Array, states: Array, efforts: Array, u: Array, h: Array) -> Array:
    """(N, N) ``∂P/∂x``."""
    n, march = states.shape[1], sweep.Marched(program, theta, states, efforts, u, h)
    end, by = np.empty((n, n)), sweep.by_parameters(np.zeros(0, dtype=np.int64), h.size)
    sweep.sensitivities(march, by, np.zeros((n, 0)), np.arange(n), np.zeros(1, dtype=np.int64), end)
    return without_impulse(program, end, 0)


def without_impulse(program: Program, end: Array, first: int) -> Array:
    """Derivatives (N, C) of the state in which a period ends, the impulse of an imposed motion kept as it was.

    Args:
        first: of the columns by the states in which the period begins.
    """
    if program.travel >= 0:
        end[program.output] = 0.0
        end[program.output, first + program.output] = 1.0
    return end
