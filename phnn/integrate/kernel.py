"""The compiled kernels that integrate a program.

All of them take the same steps (`phnn.integrate.step`), which `phnn.integrate.sweep` differentiates. The quick kernel
(`phnn.integrate.quick`) serves networks with one linear junction. The general one, here, serves all: it finds the
unknowns of a step as a bracketed scalar root for one junction, by a small dense Newton iteration for several.

An imposed motion is no unknown. Its contact is rigid but for rounding (`phnn.network.bondgraph.description`), so that
the source gives the velocity of the moved junction and the balance there gives the force in the contact, both in closed
form. As rows of the iteration they would be sixty decades away from the others, and at rest nothing but rounding.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phnn.integrate import program as at
from phnn.integrate import quick
from phnn.integrate.cache import inline, loop_entry, plain, stay_outside
from phnn.integrate.program import Program, actions, rows_of
from phnn.integrate.roots import NOTHING, RELAXED, TOLERANCE, extrapolated, make_root
from phnn.integrate.step import (
    CAPACITY,
    CONSTANTS,
    EFFORT,
    FORCE,
    NEXT,
    SIZE,
    Step,
    advance,
    balance,
    count,
    fill_constants,
    fill_gains,
    inlined_balance,
    is_linear,
    junction_storage,
    mean_effort,
    rows,
)
from phnn.laws.namespace import TINY


@inline
def _value_at(y: Any, context: Any) -> Any:
    t, step, _ = context
    step.y[0] = y
    inlined_balance(t, step)
    return step.wj[FORCE, 0], step.wj[SIZE, 0]


@plain
def _slope_at(y: Any, context: Any) -> Any:
    stay_outside()
    t, _, perturbed = context
    perturbed.y[0] = complex(y, TINY)
    balance(t, perturbed)
    return perturbed.wj[FORCE, 0].imag / TINY


_root = inline(make_root(_value_at, _slope_at))


@plain
def _prepare(t: Any, step: Step, perturbed: Step) -> None:
    """Fill the constants for a size of steps, as floats and as complex numbers."""
    stay_outside()
    c = step.c
    fill_constants(t, step.theta, step.h, c)
    for i in range(c.shape[0]):
        for k in range(c.shape[1]):
            perturbed.c[i, k] = c[i, k]


@inline
def _sized(step: Step, h: Any) -> Step:
    """Return a step of another size; its constants are those of the former one."""
    return Step(step.theta, step.c, step.g, step.a, step.x, step.y, h, step.wj, step.wx)


@inline
def inertia(t: Any, j: Any, c: Any) -> Any:
    """Return ``d(z_j − p_j)/dy_j``: twice the mass of a linear junction, else one."""
    return 2.0 * c[count(t, at.LEAVES) + j, CAPACITY] if is_linear(t, j) else 1.0


@plain
def eliminate(matrix: Any, right: Any) -> None:
    """Solve a small linear system in place by elimination with row pivoting; ``right`` (m, k) becomes the solution."""
    stay_outside()
    m, columns = right.shape
    for k in range(m):
        pivot = k
        for i in range(k + 1, m):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(m):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for c in range(columns):
                right[k, c], right[pivot, c] = right[pivot, c], right[k, c]
        for i in range(k + 1, m):
            share = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, m):
                matrix[i, j] -= share * matrix[k, j]
            for c in range(columns):
                right[i, c] -= share * right[k, c]
    for k in range(m - 1, -1, -1):
        inverse = 1.0 / matrix[k, k]
        for j in range(k + 1, m):
            for c in range(columns):
                right[k, c] -= matrix[k, j] * right[j, c]
        for c in range(columns):
            right[k, c] *= inverse


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
        jacobian: (m, m); right: (m, 1) right-hand side, then the Newton step.
        own: (7+m, m), rows as above.
        held: (4,) junctions of the contact and of the imposed motion, and the rows of the table that couple the motion
            to the contact and the contact to the motion; all -1 where no motion is imposed.
    """

    jacobian: Any
    right: Any
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
    for r in rows(t, at.JUNCTION_INLETS):
        if t[r, at.INTO_JUNCTION] == held[0]:
            given -= g[r] * step.a[t[r, at.FROM_PORT]]
    velocity, moved = given / g[held[2]], held[1]
    y[held[0]], y[moved] = 0.0, velocity
    if not is_linear(t, moved):
        k = junction_storage(t, moved)
        context = (t, k, x[k], velocity, step.theta, perturbed.theta)
        y[moved], _ = _end_of_speed(x[k], inertia(t, moved, step.c) / step.h, 0.0, context)
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
def _converged(wj: Any, work: Any, relaxed: bool) -> bool:
    stay_outside()
    tolerance, rounding = (RELAXED, 1e-13) if relaxed else (TOLERANCE, 4e-16)
    good = True
    for j in range(work.shape[1]):
        level = tolerance * wj[SIZE, j] + rounding * work[_ROUNDING, j] + NOTHING
        # The comparison also fails for NaN, and where the terms overflow.
        good = good and abs(wj[FORCE, j]) <= level < np.inf
    return good


@plain
def _merit(wj: Any, work: Any) -> Any:
    """Return ``Σ (F_j/c_j)²`` with ``c_j² = d(z_j − p_j)/dy_j / h``."""
    stay_outside()
    total = 0.0
    for j in range(work.shape[1]):
        total += (wj[FORCE, j] / work[_SCALE, j]) ** 2
    return total


@plain
def _advance(t: Any, step: Step, work: Any, held: Any) -> bool:
    """Take the first halving of a Newton step that reduces the merit.

    In the variables ``c_j v̄_j`` the equations of monotone laws are strongly monotone. If no halving helps, the iterate
    is projected on a plane that separates it from the solution, and so comes nearer to it (Solodov & Svaiter 1998).
    """
    stay_outside()
    y, wj = step.y, step.wj
    m = y.shape[0]
    before = _merit(wj, work)
    length = 0.0
    for j in range(m):
        length += (work[_SCALE, j] * work[_STEP, j]) ** 2
        work[_BEGIN, j] = y[j]
    separated = False
    part = 1.0
    for _ in range(_HALVINGS):
        for j in range(m):
            y[j] = work[_BEGIN, j] + part * work[_STEP, j]
        _forces(t, step, held)
        if _merit(wj, work) <= (1.0 - _SUFFICIENT * part) * before:
            return True
        gain = 0.0
        for j in range(m):
            gain -= wj[FORCE, j] * work[_STEP, j]
        if not separated and gain >= _SEPARATION * part * length:
            separated = True
            for j in range(m):
                work[_POINT, j] = y[j]
                work[_NORMAL, j] = wj[FORCE, j]
        part *= 0.5
    along, norm = 0.0, 0.0
    for j in range(m):
        along += work[_NORMAL, j] * (work[_BEGIN, j] - work[_POINT, j])
        norm += (work[_NORMAL, j] / work[_SCALE, j]) ** 2
    for j in range(m):
        shift = along / norm * work[_NORMAL, j] / work[_SCALE, j] ** 2 if separated else 0.0
        y[j] = work[_BEGIN, j] - shift
    _forces(t, step, held)
    return separated


@inline
def _magnitude(t: Any, j: Any, x: Any, y: Any) -> Any:
    """Scale of an unknown's rounding error: a mean effort between two states is rounded by the larger of them."""
    return abs(y[j]) if is_linear(t, j) else max(abs(y[j]), abs(x[junction_storage(t, j)]))


@inline
def _ask(t: Any, step: Step, room: Room) -> None:
    """Fill the residual that a Newton step is to remove, and its rounding level."""
    work, m = room.own, step.y.shape[0]
    for j in range(m):
        room.right[j, 0] = -step.wj[FORCE, j]
        work[_ROUNDING, j] = 0.0
        for i in range(m):
            work[_ROUNDING, j] += abs(room.jacobian[j, i]) * _magnitude(t, i, step.x, step.y)


@plain
def _once(t: Any, step: Step, room: Room) -> bool:
    """Take one step with the latest Jacobian, which mostly suffices where the equations are piecewise linear.

    If it does not suffice, the unknowns are restored.
    """
    stay_outside()
    jacobian, right, work, held = room
    y, m = step.y, step.y.shape[0]
    _forces(t, step, held)
    for j in range(m):
        for i in range(m):
            jacobian[j, i] = work[_LATEST + j, i]
    _ask(t, step, room)
    eliminate(jacobian, right)
    for j in range(m):
        work[_BEGIN, j] = y[j]
        y[j] += right[j, 0]
    _forces(t, step, held)
    solved = _converged(step.wj, work, False)
    for j in range(0 if solved else m):
        y[j] = work[_BEGIN, j]
    return solved


@plain
def _newton(t: Any, step: Step, perturbed: Step, room: Room, damped: bool) -> bool:
    """Newton's method from ``y``, damped by `_advance` or with whole steps."""
    stay_outside()
    jacobian, right, work, held = room
    y, m = step.y, step.y.shape[0]
    for j in range(m):
        work[_SCALE, j] = np.sqrt(inertia(t, j, step.c) / step.h)
    _forces(t, step, held)
    for iteration in range(_ITERATIONS if damped else _WHOLE):
        _fill_jacobian(t, y, perturbed, jacobian, held)
        for j in range(m):
            for i in range(m):
                work[_LATEST + j, i] = jacobian[j, i]
        _ask(t, step, room)
        if _converged(step.wj, work, iteration >= _STRICT):
            return True
        eliminate(jacobian, right)
        for j in range(m):
            work[_STEP, j] = right[j, 0]
        if damped:
            if not _advance(t, step, work, held):
                break
        else:
            for j in range(m):
                y[j] += right[j, 0]
            _forces(t, step, held)
    return _converged(step.wj, work, True)


@plain
def _rest_guess(t: Any, theta: Any, x: Any, y: Any) -> None:
    """Set the unknowns to those of a step in which nothing changes."""
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
    y, work = step.y, room.own
    _rest_guess(t, step.theta, step.x, y)
    _impose(t, step, perturbed, room.held)
    done, part = 0.0, _FIRST_PART
    while done < 1.0:
        part = min(part, 1.0 - done)
        for j in range(y.shape[0]):
            work[_KEPT, j] = y[j]
        shorter, moved = _sized(step, (done + part) * step.h), _sized(perturbed, (done + part) * step.h)
        _prepare(t, shorter, moved)
        solved = False
        for damped in (False, True):
            if not solved:
                for j in range(y.shape[0]):
                    y[j] = work[_KEPT, j]
                solved = _newton(t, shorter, moved, room, damped)
        if solved:
            done, part = done + part, 2.0 * part
        else:
            for j in range(y.shape[0]):
                y[j] = work[_KEPT, j]
            part *= 0.5
            if part < _LEAST_PART:
                _prepare(t, step, perturbed)
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
def solve_many(t: Any, step: Step, perturbed: Step, room: Room) -> bool:
    """Solve for several junctions from the guess in ``y``; the values are left at the solution.

    Args:
        perturbed: the step in complex numbers, without perturbations.
    """
    stay_outside()
    held = room.held
    if held[0] < 0:
        return _solve(t, step, perturbed, room)
    # Where nothing else moves, no equation is left.
    solved = _impose(t, step, perturbed, held) and (step.y.shape[0] == 2 or _solve(t, step, perturbed, room))
    _bear(t, step, held)
    return solved


Array = NDArray[np.float64]


@inline
def _guess(t: Any, theta: Any, n: Any, states: Any, efforts: Any, y: Any) -> None:
    """Extrapolate the unknowns of step ``n`` from the two steps before it; the first step keeps its initial values."""
    if n == 0:
        _rest_guess(t, theta, states[0], y)
        return
    for j in range(y.shape[0]):
        k = junction_storage(t, j)
        y[j] = extrapolated(efforts, n, k) if is_linear(t, j) else extrapolated(states, n + 1, k)


@loop_entry
def _steps(t: Any, actions: Any, h: Any, states: Any, efforts: Any, both: Any, room: Room) -> Any:
    """Integrate; ``both`` are a step in floats and in complex numbers, whose arrays are filled."""
    step, perturbed = both
    theta, g, x, y = step.theta, step.g, step.x, step.y
    fill_gains(t, theta, g)
    for r in range(g.shape[0]):
        perturbed.g[r] = g[r]
    slope = 0.0
    for n in range(actions.shape[0]):
        step, perturbed = _sized(step, h[n]), _sized(perturbed, h[n])
        for k in range(x.shape[0]):
            x[k] = states[n, k]
            perturbed.x[k] = states[n, k]
        for p in range(actions.shape[1]):
            step.a[p] = actions[n, p]
            perturbed.a[p] = actions[n, p]
        _guess(t, theta, n, states, efforts, y)
        if n == 0 or h[n] != h[n - 1]:
            slope = 0.0
            _prepare(t, step, perturbed)
        solved = True
        if y.shape[0] == 1:
            # The slope of the step before is the first guess.
            y[0], slope = _root(y[0], inertia(t, 0, step.c) / h[n], slope, (t, step, perturbed))
            solved = np.isfinite(y[0])
        elif y.shape[0] == 0:
            balance(t, step)
        else:
            solved = solve_many(t, step, perturbed, room)
        if count(t, at.MODULATOR_STATES) > 0:
            advance(t, step)
        for k in range(x.shape[0]):
            states[n + 1, k] = step.wx[NEXT, k]
            efforts[n, k] = step.wx[EFFORT, k]
            solved = solved and np.isfinite(step.wx[NEXT, k]) and np.isfinite(step.wx[EFFORT, k])
        if not solved:
            return n
    return actions.shape[0]


def march_any(program: Program, theta: Array, actions: Array, h: Array, states: Array, efforts: Array) -> int:
    """Integrate any program from ``states[0]`` under the actions (n, P) of its ports; return the steps solved."""
    t = program.table
    n, m, leaves = states.shape[1], len(rows_of(t, at.JUNCTIONS)), len(rows_of(t, at.LEAVES))
    shapes = ((leaves + m, CONSTANTS), len(t), actions.shape[1], n, m, (4, m), (2, n))

    def empty(kind: type) -> Step:
        arrays: list[Any] = [np.zeros(shape, kind) for shape in shapes]
        return Step._make([theta.astype(kind), *arrays[:5], 0.0, *arrays[5:]])

    room = Room(np.zeros((m, m)), np.zeros((m, 1)), np.zeros((7 + m, m)), program.held)
    return int(_steps(t, actions, h, states, efforts, (empty(np.float64), empty(np.complex128)), room))


def work_of(program: Program) -> float:
    """Return the work of a step and of its derivatives, in quick steps in which nothing is modulated."""
    following = sum(map(bool, program.sparsity.thresholds))
    return (1.0 if quick.serves(program) else 4.0) + 0.25 * following + len(program.sparsity.modulators)


def march(
    program: Program, theta: Array, x0: Array, u: Array, h: Array, states: Array, efforts: Array, general: bool = False
) -> int:
    """Integrate ``n`` steps of a program; return the number of solved steps.

    Args:
        theta: (M,) parameters, see `Program.theta`.
        x0: (N,) initial state, in the order of the network: storages, then modulator states.
        u: (n, P) mean inputs of the steps; h: (n,) their sizes [s].
        states: (n+1, N) filled; efforts: (n, N) filled with the mean efforts of the storages and the mean drives of the
            modulator states.
        general: take the general kernel where the quick one would serve too.
    """
    states[0] = x0
    kernel = march_any if general or not quick.serves(program) else quick.march
    return kernel(program, theta, actions(program, theta, u), h, states, efforts)
