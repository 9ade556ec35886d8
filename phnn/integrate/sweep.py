"""Sweeps of the linearised march: forward sensitivities with many right-hand sides, and the adjoint.

By the implicit function theorem the derivatives of a march obey the linearised recursion

    0 = F_x δx + F_y δy + F_θ δθ − δf,     δx_l⁺ = X_x δx + X_y δy + X_θ δθ,     δp⁺ = δp + Z_x δx + Z_y δy + Z_θ δθ

whose local derivatives `phnn.integrate.linearise` takes of the very step that marched.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.compiled import entry, inline, loop, plain, stay_outside
from phnn.integrate.linearise import derivatives_at, new_derivatives, pattern_of
from phnn.integrate.lookups import junction_storage
from phnn.integrate.program import Program
from phnn.integrate.solve import eliminate
from phnn.integrate.tables import LEAVES

Array = NDArray[np.float64]


@plain
def _add_scaled(out: Any, weight: Any, row: Any) -> None:
    if weight != 0.0:
        for c in range(out.shape[0]):
            out[c] += weight * row[c]


@plain
def _propagate(
    t: Any, p: Any, d: Any, force: Any, junction: Any, first_force: Any, varied: Any, weight_of: Any, state: Any,
    unknown: Any, following: Any, matrix: Any,
) -> None:  # fmt: skip
    """One step of the linearised recursion for all columns."""
    stay_outside()
    n, m, k_active = state.shape[0], unknown.shape[0], p.active.shape[0]
    first_varied = first_force + force.shape[0]
    for j in range(m):
        unknown[j, :] = 0.0
        for s in range(n):
            _add_scaled(unknown[j], -d.by_force[s, j], state[s])
        for k in range(k_active):
            unknown[j, k] -= d.by_force[n + m + k, j]
        for w in range(varied.shape[0]):
            unknown[j, first_varied + w] -= d.by_force[n + m + varied[w], j] * weight_of[w]
        for i in range(m):
            matrix[j, i] = d.by_force[n + i, j]
    for f in range(force.shape[0]):
        unknown[junction, first_force + f] += force[f]
    eliminate(matrix, unknown)
    following[:, :] = 0.0
    for j in range(m):
        end = junction_storage(t, j)
        _add_scaled(following[end], 1.0, state[end])
        for s in range(n):
            _add_scaled(following[end], d.by_change[s, j], state[s])
        for i in range(m):
            _add_scaled(following[end], d.by_change[n + i, j], unknown[i])
        for k in range(k_active):
            following[end, k] += d.by_change[n + m + k, j]
        for w in range(varied.shape[0]):
            following[end, first_varied + w] += d.by_change[n + m + varied[w], j] * weight_of[w]
    for i in range(n + m + k_active):
        for pair in range(p.first[i], p.first[i + 1]):
            end = t[t[0, LEAVES] + p.leaf[pair], 0]
            if i < n:
                _add_scaled(following[end], d.by_leaf[pair], state[i])
            elif i < n + m:
                _add_scaled(following[end], d.by_leaf[pair], unknown[i - n])
            else:
                following[end, i - n - m] += d.by_leaf[pair]
                for w in range(varied.shape[0]):
                    if varied[w] == i - n - m:
                        following[end, first_varied + w] += d.by_leaf[pair] * weight_of[w]


def _sensitivities(
    t: Any, p: Any, theta: Any, states: Any, efforts: Any, u: Any, h: Any, start: Any, initial: Any, forces: Any,
    junction: Any, varied: Any, weights: Any, nodes: Any, output: Any, out: Any,
) -> None:  # fmt: skip
    n, columns = states.shape[1], out.shape[1]
    k_active = p.active.shape[0]
    d = new_derivatives(t, p, theta, n, u.shape[1])
    m = d.y.shape[0]
    state, following = np.zeros((n, columns)), np.zeros((n, columns))
    unknown, matrix = np.zeros((m, columns)), np.zeros((m, m))
    state[:, :k_active] = start
    for s in range(initial.shape[0]):
        state[initial[s], k_active + s] = 1.0
    _sensitivity_steps(
        t, p, d, states, efforts, u, h, forces, junction, k_active + initial.shape[0], varied, weights, nodes, output,
        state, following, unknown, matrix, out,
    )  # fmt: skip


@loop
def _sensitivity_steps(
    t: Any, p: Any, d: Any, states: Any, efforts: Any, u: Any, h: Any, forces: Any, junction: Any, first_force: Any,
    varied: Any, weights: Any, nodes: Any, output: Any, state: Any, following: Any, unknown: Any, matrix: Any, out: Any,
) -> None:  # fmt: skip
    """The steps of `_sensitivities`, which owns all memory."""
    for c in range(out.shape[1]):
        out[0, c] = state[output, c]
    node = 1
    for n in range(u.shape[0]):
        derivatives_at(t, p, d, n, states, efforts, u, h, n == 0 or h[n] != h[n - 1])
        _propagate(
            t, p, d, forces[n], junction, first_force, varied, weights[n], state, unknown, following, matrix
        )  # fmt: skip
        state, following = following, state
        if node < nodes.shape[0] and nodes[node] == n + 1:
            for c in range(out.shape[1]):
                out[node, c] = state[output, c]
            node += 1


def _adjoint(
    t: Any, p: Any, theta: Any, states: Any, efforts: Any, u: Any, h: Any, cotangent: Any, w: Any, gradient: Any,
    multipliers: Any,
) -> None:  # fmt: skip
    n = states.shape[1]
    d = new_derivatives(t, p, theta, n, u.shape[1])
    m = d.y.shape[0]
    _adjoint_steps(
        t, p, d, states, efforts, u, h, cotangent, w, gradient, multipliers, np.zeros(n), np.zeros((m, 1)),
        np.zeros((m, m)),
    )  # fmt: skip


@loop
def _adjoint_steps(
    t: Any, p: Any, d: Any, states: Any, efforts: Any, u: Any, h: Any, cotangent: Any, w: Any, gradient: Any,
    multipliers: Any, earlier: Any, mu: Any, matrix: Any,
) -> None:  # fmt: skip
    """The steps of `_adjoint`."""
    n, m = w.shape[0], mu.shape[0]
    last = u.shape[0] - 1
    for step in range(last, -1, -1):
        for s in range(n):
            w[s] += cotangent[step + 1, s]
        derivatives_at(t, p, d, step, states, efforts, u, h, step == last or h[step] != h[step + 1])
        for j in range(m):
            mu[j, 0] = -_pulled(t, p, d, n + j, w)
            for i in range(m):
                matrix[j, i] = d.by_force[n + j, i]
        eliminate(matrix, mu)
        for i in range(n + m + gradient.shape[0]):
            if n <= i < n + m:
                continue
            total = _pulled(t, p, d, i, w)
            for j in range(m):
                total += d.by_force[i, j] * mu[j, 0]
            if i < n:
                earlier[i] = total
            else:
                gradient[i - n - m] += total
        for j in range(m):
            k = junction_storage(t, j)
            earlier[k] += w[k]
        if multipliers.shape[0] > 0:
            for s in range(n):
                multipliers[step, s] = w[s]
            for j in range(m):
                multipliers[step, n + j] = mu[j, 0]
        for s in range(n):
            w[s] = earlier[s]


@inline
def _pulled(t: Any, p: Any, d: Any, i: Any, w: Any) -> Any:
    """``wᵀ ∂(x⁺)/∂(input i)`` without the part that carries a junction's state over."""
    total = 0.0
    for pair in range(p.first[i], p.first[i + 1]):
        total += d.by_leaf[pair] * w[t[t[0, LEAVES] + p.leaf[pair], 0]]
    for j in range(d.by_change.shape[1]):
        total += d.by_change[i, j] * w[junction_storage(t, j)]
    return total


_compiled_sensitivities = entry(_sensitivities)
_compiled_adjoint = entry(_adjoint)


def sensitivities(
    program: Program, theta: Array, active: NDArray[np.int64], states: Array, efforts: Array, u: Array, h: Array,
    start: Array, initial: NDArray[np.int64], forces: Array, varied: NDArray[np.int64], weights: Array,
    nodes: NDArray[np.int64],
) -> Array:  # fmt: skip
    """Forward sweep of the linearised recursion with many right-hand sides.

    Columns are, in order: the active parameters, perturbed initial states, perturbed forces on the junction through
    which the output flows, and parameters perturbed by a signal instead of a constant.

    Args:
        active: (K,) places in theta.
        states, efforts, u, h: of the march.
        start: (N, K) derivative of the initial state by the active parameters.
        initial: (S,) state whose initial value column ``K + s`` perturbs.
        forces: (n, F) perturbations of the junction's force, one column each.
        varied: (W,) which active parameter is perturbed; weights: (n, W) by which signal.
        nodes: (M,) increasing step indices at which the output is wanted, the first 0.

    Returns:
        (M, K + S + F + W) the output's derivatives.
    """
    out = np.empty((nodes.size, active.size + initial.size + forces.shape[1] + varied.size))
    junction = program.junctions.index(program.states[program.flow]) if program.junctions else 0
    _compiled_sensitivities(
        program.table, pattern_of(program, active), theta, states, efforts, u, h, start, initial, forces, junction,
        varied, weights, nodes, program.output, out,
    )  # fmt: skip
    return out


def adjoint(
    program: Program, theta: Array, active: NDArray[np.int64], states: Array, efforts: Array, u: Array, h: Array,
    cotangent: Array, multipliers: Array | None = None, carry: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Backward sweep of the linearised recursion.

    Args:
        active: (K,) places in theta.
        states, efforts, u, h: of the march, or of a window of it.
        cotangent: (n+1, N) ``dL/dx`` at the nodes.
        multipliers: (n, N+m) filled with ``dL/dx⁺`` of every step and the multipliers of its ``F``.
        carry: (N,) what later windows have passed back to the last node.

    Returns:
        (K,) ``dL/dθ`` of the window, and (N,) ``dL/dx`` at its first node but for that node's own cotangent.
    """
    w = np.zeros(states.shape[1]) if carry is None else carry.copy()
    gradient = np.zeros(active.size)
    room = np.zeros((0, 0)) if multipliers is None else multipliers
    _compiled_adjoint(
        program.table, pattern_of(program, active), theta, states, efforts, u, h, cotangent, w, gradient, room
    )
    return gradient, w
