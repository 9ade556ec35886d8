"""The compiled integration of a program: the steps of `phnn.integrate.step`, solved one after the other.

The unknowns of a step are a bracketed scalar root for one junction, a small dense Newton iteration for several.
`phnn.integrate.sweep` differentiates the steps.

An imposed motion is no unknown. Its contact is rigid but for rounding (`phnn.network.bondgraph.description`), so that
the source gives the velocity of the moved junction and the balance there gives the force in the contact, both in closed
form. As rows of the iteration they would be sixty decades away from the others, and at rest nothing but rounding.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import inline, loop_entry, plain, stay_outside
from phnn.integrate.program import Program, actions
from phnn.integrate.roots import NOTHING, RELAXED, TOLERANCE, eliminate, extrapolated, make_root
from phnn.integrate.step import (
    FORCE,
    SIZE,
    Step,
    advance,
    balance,
    count,
    fill_constants,
    fill_gains,
    inertia,
    inlined_balance,
    is_linear,
    junction_storage,
    mean_effort,
    shape_of_constants,
)
from phnn.integrate.table import FROM_PORT, INTO_JUNCTION, JUNCTION_INLETS, JUNCTIONS, LEAVES, MODULATOR_STATES, rows_of
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]

# The functions below take a step in floats, and the same in complex numbers, without perturbations, for derivatives.


@inline
def _load(step: Step, perturbed: Step) -> None:
    """Load the state and the actions of a step in complex numbers."""
    for k in range(step.x.shape[0]):
        perturbed.x[k] = step.x[k]
    for p in range(step.a.shape[0]):
        perturbed.a[p] = step.a[p]


@inline
def _value_at(y: Any, context: Any) -> Any:
    t, step, _ = context
    step.y[0] = y
    inlined_balance(t, step)
    return step.wj[FORCE, 0], step.wj[SIZE, 0]


@plain
def _slope_at(y: Any, context: Any) -> Any:
    stay_outside()
    t, step, perturbed = context
    _load(step, perturbed)
    perturbed.y[0] = complex(y, TINY)
    balance(t, perturbed)
    return perturbed.wj[FORCE, 0].imag / TINY


_root = inline(make_root(_value_at, _slope_at))


@plain
def _prepare(t: Any, h: Any, step: Step, perturbed: Step) -> None:
    """The constants for steps of size ``h``, as floats and as complex numbers."""
    stay_outside()
    fill_constants(t, step.theta, step.g, h, step.c)
    for i in range(step.c.shape[0]):
        for k in range(step.c.shape[1]):
            perturbed.c[i, k] = step.c[i, k]


@inline
def _of_size(step: Step, h: Any) -> Step:
    """The same step with another size."""
    return Step(step.theta, step.c, step.g, step.a, step.x, step.y, h, step.wj, step.ends, step.means)


_ITERATIONS = 200
_STRICT = 20
_HALVINGS = 40
_SUFFICIENT = 1e-4
_SEPARATION = 0.1

_WHOLE = 30
_FIRST_PART = 0.25
_LEAST_PART = 2.0**-30

# Rows of the work array (7+m, m): the Newton step; its starting point; the separating point and the normal there;
# scales; the rounding level; the solution of the previous part; and from the last row on the latest Jacobian.
_STEP, _BEGIN, _POINT, _NORMAL, _SCALE, _ROUNDING, _KEPT, _LATEST = range(8)


class Room(NamedTuple):
    """Work arrays of the Newton iteration, zero before the first step.

    Attributes:
        jacobian: (m, m); moved: (m, 1) the Newton step.
        own: (7+m, m), rows as above.
        held: (4,) junctions of the contact and of the imposed motion, and the rows of the table that couple the motion
            to the contact and the contact to the motion; all -1 where no motion is imposed.
    """

    jacobian: Any
    moved: Any
    own: Any
    held: Any


@inline
def _forces(t: Any, step: Step, held: Any) -> None:
    """`balance` without the equations of an imposed motion."""
    balance(t, step)
    if held[0] >= 0:
        step.wj[FORCE, held[0]] = 0.0
        step.wj[FORCE, held[1]] = 0.0


@inline
def _speed_at(z: Any, context: Any) -> Any:
    t, k, p, v, theta, _ = context
    return mean_effort(t, k, p, z, theta) - v, abs(mean_effort(t, k, p, p, theta)) + abs(v)


@inline
def _speed_slope(z: Any, context: Any) -> Any:
    t, k, p, _, _, theta = context
    return mean_effort(t, k, complex(p, 0.0), complex(z, TINY), theta).imag / TINY


_end_of_speed = plain(make_root(_speed_at, _speed_slope))


@inline
def _impose(t: Any, step: Step, perturbed: Step, held: Any) -> bool:
    """Set the unknown of an imposed motion to what the velocity of its source makes of it; returns success."""
    if held[0] < 0:
        return True
    g, x, y = step.g, step.x, step.y
    given = 0.0
    for r in range(t[0, JUNCTION_INLETS], t[0, JUNCTION_INLETS + 1]):
        if t[r, INTO_JUNCTION] == held[0]:
            given -= g[r] * step.a[t[r, FROM_PORT]]
    velocity, moved = given / g[held[2]], held[1]
    y[held[0]], y[moved] = 0.0, velocity
    if not is_linear(t, moved):
        k = junction_storage(t, moved)
        around = (t, k, x[k], velocity, step.theta, perturbed.theta)
        y[moved], _ = _end_of_speed(x[k], inertia(t, moved, step.c) / step.h, 0.0, around)
    return np.isfinite(y[moved])


@plain
def _bear(t: Any, step: Step, held: Any) -> None:
    """Set the force in the contact to what the balance of the imposed motion needs."""
    stay_outside()
    step.y[held[0]] = 0.0
    balance(t, step)
    step.y[held[0]] = step.wj[FORCE, held[1]] / step.g[held[3]]
    balance(t, step)


@plain
def _fill_jacobian(t: Any, y: Any, perturbed: Step, jacobian: Any, held: Any) -> None:
    """(m, m) ``∂F/∂y``, a column for every perturbed unknown; unit columns for what is no unknown."""
    stay_outside()
    ys, m = perturbed.y, y.shape[0]
    for j in range(m):
        ys[j] = complex(y[j], 0.0)
    for i in range(m):
        if i == held[0] or i == held[1]:
            for j in range(m):
                jacobian[j, i] = 1.0 if j == i else 0.0
            continue
        ys[i] = complex(y[i], TINY)
        _forces(t, perturbed, held)
        ys[i] = complex(y[i], 0.0)
        for j in range(m):
            jacobian[j, i] = perturbed.wj[FORCE, j].imag / TINY


@plain
def _converged(wj: Any, own: Any, relaxed: bool) -> bool:
    stay_outside()
    tolerance, rounding = (RELAXED, 1e-13) if relaxed else (TOLERANCE, 4e-16)
    good = True
    for j in range(own.shape[1]):
        # The comparison also fails for NaN.
        good = good and abs(wj[FORCE, j]) <= tolerance * wj[SIZE, j] + rounding * own[_ROUNDING, j] + NOTHING
    return good


@plain
def _merit(wj: Any, own: Any) -> Any:
    """``Σ (F_j/c_j)²`` with ``c_j² = d(z_j − p_j)/dy_j / h``."""
    stay_outside()
    total = 0.0
    for j in range(own.shape[1]):
        total += (wj[FORCE, j] / own[_SCALE, j]) ** 2
    return total


@plain
def _advance(t: Any, step: Step, own: Any, held: Any) -> bool:
    """Take the first halving of a Newton step that reduces the merit.

    In the variables ``c_j v̄_j`` the equations of monotone laws are strongly monotone. If no halving helps, the iterate
    is projected on a plane that separates it from the solution, and so comes nearer to it (Solodov & Svaiter 1998).
    """
    stay_outside()
    y, wj, m = step.y, step.wj, step.y.shape[0]
    before = _merit(wj, own)
    length = 0.0
    for j in range(m):
        length += (own[_SCALE, j] * own[_STEP, j]) ** 2
        own[_BEGIN, j] = y[j]
    separated = False
    part = 1.0
    for _ in range(_HALVINGS):
        for j in range(m):
            y[j] = own[_BEGIN, j] + part * own[_STEP, j]
        _forces(t, step, held)
        if _merit(wj, own) <= (1.0 - _SUFFICIENT * part) * before:
            return True
        gain = 0.0
        for j in range(m):
            gain -= wj[FORCE, j] * own[_STEP, j]
        if not separated and gain >= _SEPARATION * part * length:
            separated = True
            for j in range(m):
                own[_POINT, j] = y[j]
                own[_NORMAL, j] = wj[FORCE, j]
        part *= 0.5
    along, norm = 0.0, 0.0
    for j in range(m):
        along += own[_NORMAL, j] * (own[_BEGIN, j] - own[_POINT, j])
        norm += (own[_NORMAL, j] / own[_SCALE, j]) ** 2
    for j in range(m):
        shift = along / norm * own[_NORMAL, j] / own[_SCALE, j] ** 2 if separated else 0.0
        y[j] = own[_BEGIN, j] - shift
    _forces(t, step, held)
    return separated


@inline
def _magnitude(t: Any, j: Any, x: Any, y: Any) -> Any:
    """Scale of an unknown's rounding error: a mean effort between two states is rounded by the larger of them."""
    return abs(y[j]) if is_linear(t, j) else max(abs(y[j]), abs(x[junction_storage(t, j)]))


@inline
def _ask(t: Any, step: Step, jacobian: Any, moved: Any, own: Any) -> None:
    """The residual that a Newton step is to remove, and its rounding level."""
    x, y = step.x, step.y
    for j in range(y.shape[0]):
        moved[j, 0] = -step.wj[FORCE, j]
        own[_ROUNDING, j] = 0.0
        for i in range(y.shape[0]):
            own[_ROUNDING, j] += abs(jacobian[j, i]) * _magnitude(t, i, x, y)


@plain
def _once(t: Any, step: Step, room: Room) -> bool:
    """One step with the latest Jacobian, which mostly suffices where the equations are piecewise linear.

    If it does not suffice, the unknowns are restored.
    """
    stay_outside()
    y, wj, m = step.y, step.wj, step.y.shape[0]
    jacobian, moved, own, held = room
    _forces(t, step, held)
    for j in range(m):
        for i in range(m):
            jacobian[j, i] = own[_LATEST + j, i]
    _ask(t, step, jacobian, moved, own)
    eliminate(jacobian, moved)
    for j in range(m):
        own[_BEGIN, j] = y[j]
        y[j] += moved[j, 0]
    _forces(t, step, held)
    found = _converged(wj, own, False)
    for j in range(0 if found else m):
        y[j] = own[_BEGIN, j]
    return found


@plain
def _newton(t: Any, step: Step, perturbed: Step, room: Room, damped: bool) -> bool:
    """Newton's method from ``y``, damped by `_advance` or with whole steps."""
    stay_outside()
    y, wj, m = step.y, step.wj, step.y.shape[0]
    jacobian, moved, own, held = room
    _load(step, perturbed)
    for j in range(m):
        own[_SCALE, j] = np.sqrt(inertia(t, j, step.c) / step.h)
    _forces(t, step, held)
    for iteration in range(_ITERATIONS if damped else _WHOLE):
        _fill_jacobian(t, y, perturbed, jacobian, held)
        for j in range(m):
            for i in range(m):
                own[_LATEST + j, i] = jacobian[j, i]
        _ask(t, step, jacobian, moved, own)
        if _converged(wj, own, iteration >= _STRICT):
            return True
        eliminate(jacobian, moved)
        for j in range(m):
            own[_STEP, j] = moved[j, 0]
        if damped:
            if not _advance(t, step, own, held):
                break
        else:
            for j in range(m):
                y[j] += moved[j, 0]
            _forces(t, step, held)
    return _converged(wj, own, True)


@plain
def _rest_guess(t: Any, step: Step) -> None:
    """The unknowns of a step in which nothing changes."""
    theta, x, y = step.theta, step.x, step.y
    for j in range(y.shape[0]):
        k = junction_storage(t, j)
        y[j] = mean_effort(t, k, x[k], x[k], theta) if is_linear(t, j) else x[k]


@plain
def _followed(t: Any, step: Step, perturbed: Step, room: Room) -> bool:
    """Solve for ever longer parts of the step, each from the solution of the part before.

    The equations of monotone laws have one solution for every length, which depends on it continuously. Close to the
    solution, full Newton steps pass kinks at which a line search may stop.
    """
    stay_outside()
    own, y, m = room.own, step.y, step.y.shape[0]
    _rest_guess(t, step)
    _impose(t, step, perturbed, room.held)
    done, part = 0.0, _FIRST_PART
    while done < 1.0:
        part = min(part, 1.0 - done)
        for j in range(m):
            own[_KEPT, j] = y[j]
        shorter, moved = _of_size(step, (done + part) * step.h), _of_size(perturbed, (done + part) * step.h)
        _prepare(t, shorter.h, step, perturbed)
        found = _newton(t, shorter, moved, room, False)
        if not found:
            for j in range(m):
                y[j] = own[_KEPT, j]
            found = _newton(t, shorter, moved, room, True)
        if found:
            done, part = done + part, 2.0 * part
        else:
            for j in range(m):
                y[j] = own[_KEPT, j]
            part *= 0.5
            if part < _LEAST_PART:
                _prepare(t, step.h, step, perturbed)
                return False
    return True


@plain
def _solve(t: Any, step: Step, perturbed: Step, room: Room) -> bool:
    """Solve from the guess in ``y``."""
    stay_outside()
    if room.own[_LATEST, 0] != 0.0 and _once(t, step, room):
        return True
    if _newton(t, step, perturbed, room, True):
        return True
    return _followed(t, step, perturbed, room)


@plain
def _solve_many(t: Any, step: Step, perturbed: Step, room: Room) -> bool:
    """Solve for several junctions from the guess in ``y``; the step is left at the solution."""
    stay_outside()
    held = room.held
    if held[0] < 0:
        return _solve(t, step, perturbed, room)
    # Where nothing else moves, no equation is left.
    solved = _impose(t, step, perturbed, held) and (step.y.shape[0] == 2 or _solve(t, step, perturbed, room))
    _bear(t, step, held)
    return solved


@inline
def _guess(t: Any, n: Any, states: Any, efforts: Any, step: Step) -> None:
    """Extrapolate the unknowns of step ``n`` from the two steps before it; the first step keeps its initial values."""
    if n == 0:
        _rest_guess(t, step)
        return
    for j in range(step.y.shape[0]):
        k = junction_storage(t, j)
        step.y[j] = extrapolated(efforts, n, k) if is_linear(t, j) else extrapolated(states, n + 1, k)


def _steps(t: Any, actions: Any, h: Any, states: Any, efforts: Any, own: Any, perturbed: Any, room: Room) -> Any:
    """Integrate; ``own`` and ``perturbed`` are parameters and work arrays in floats and in complex numbers."""
    theta, c, g, y, wj = own
    theta_c, c_c, g_c, y_c, wj_c, a_c, x_c, ends_c, means_c = perturbed
    fill_gains(t, theta, g)
    for r in range(g.shape[0]):
        g_c[r] = g[r]
    slope, remembers = 0.0, count(t, MODULATOR_STATES) > 0
    for n in range(actions.shape[0]):
        step = Step(theta, c, g, actions[n], states[n], y, h[n], wj, states[n + 1], efforts[n])
        moved = Step(theta_c, c_c, g_c, a_c, x_c, y_c, h[n], wj_c, ends_c, means_c)
        _guess(t, n, states, efforts, step)
        if n == 0 or h[n] != h[n - 1]:
            slope = 0.0
            _prepare(t, h[n], step, moved)
        solved = True
        if y.shape[0] == 1:
            y[0], slope = _root(y[0], inertia(t, 0, c) / h[n], slope, (t, step, moved))
            solved = np.isfinite(y[0])
        elif y.shape[0] == 0:
            balance(t, step)
        else:
            solved = _solve_many(t, step, moved, room)
        if remembers:
            advance(t, step)
        for k in range(states.shape[1]):
            solved = solved and np.isfinite(step.ends[k]) and np.isfinite(step.means[k])
        if not solved:
            return n
    return actions.shape[0]


_compiled = loop_entry(_steps)


def march(program: Program, theta: Array, x0: Array, u: Array, h: Array, states: Array, efforts: Array) -> int:
    """Integrate ``n`` steps of a program; returns the number of solved steps.

    Args:
        theta: (M,) parameters, see `Program.theta`.
        x0: (N,) initial state, in the order of the network: storages, then modulator states.
        u: (n, P) mean inputs of the steps; h: (n,) their sizes [s].
        states: (n+1, N) filled; efforts: (n, N) filled with the mean efforts of the storages and the mean drives of the
            modulator states.
    """
    states[0], t, kind = x0, program.table, np.complex128
    n, m = states.shape[1], len(rows_of(t, JUNCTIONS))
    shapes = (shape_of_constants(len(rows_of(t, LEAVES)), m), len(t), m, (4, m))
    own = (theta, *(np.zeros(shape) for shape in shapes))
    perturbed = (theta.astype(kind), *(np.zeros(shape, kind) for shape in (*shapes, u.shape[1], n, n, n)))
    room = Room(np.zeros((m, m)), np.zeros((m, 1)), np.zeros((7 + m, m)), program.held)
    return int(_compiled(t, actions(program, theta, u), h, states, efforts, own, perturbed, room))
