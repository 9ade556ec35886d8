"""Sweeps of the linearised march: forward sensitivities with many right-hand sides, and the adjoint.

By the implicit function theorem the derivatives of a march obey the linearised recursion

    0 = R_x δx + R_v δv̄ + R_θ δθ − δf,     δx⁺ = X_x δx + X_v δv̄ + X_θ δθ,     δp⁺ = 2m δv̄ + 2v̄ δm − δp

whose local derivatives are complex-step derivatives of the very step that marched.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from phnn.integrate.dispatch import kernel_cache
from phnn.integrate.step import TINY, flow_force, leaf_step, port_force


@numba.njit(error_model="numpy")
def _users(rows: Any, first: Any, active: Any) -> Any:
    """(rows, K) whether an element refers to an active parameter in its columns from ``first`` on."""
    found = np.zeros((rows.shape[0], active.shape[0]), np.bool_)
    for i in range(rows.shape[0]):
        for c in range(first, rows.shape[1]):
            for k in range(active.shape[0]):
                if rows[i, c] == active[k]:
                    found[i, k] = True
    return found


@numba.njit(error_model="numpy")
def _resistor_users(leaves: Any, resistors: Any, active: Any) -> Any:
    """(R, K) the same for resistors, which also depend on the ratio of the leaf whose mid-step state they read."""
    found = _users(resistors, 2, active)
    for r in range(resistors.shape[0]):
        if resistors[r, 1] >= 0:
            for k in range(active.shape[0]):
                if leaves[resistors[r, 1], 3] == active[k]:
                    found[r, k] = True
    return found


@numba.njit(error_model="numpy")
def _linearise(
    leaves: Any, modulators: Any, resistors: Any, ports: Any, inertia: Any, theta: Any, active: Any, users: Any,
    x: Any, v: Any, u: Any, h: Any, by_state: Any, by_velocity: Any, by_theta: Any,
) -> None:  # fmt: skip
    """Derivatives of ``(x⁺_1 … x⁺_L, R)`` by states, velocity and the active parameters, element by element.

    ``by_state`` is (L+1, L+1), ``by_velocity`` (L+1,), ``by_theta`` (L+1, K); ``theta`` and ``x`` are complex.
    """
    count = leaves.shape[0]
    base = complex(v, 0.0)
    by_state[:, :] = 0.0
    by_theta[:, :] = 0.0
    by_state[count, count] = -2.0 / h
    by_velocity[count] = 2.0 * theta[inertia].real / h
    for l in range(count):  # noqa: E741
        ratio = leaves[l, 3]
        for turn in range(2):
            j = l if turn == 0 else modulators[l]
            if j < 0 or (turn == 1 and j == l):
                continue
            x[j] += TINY * 1j
            end, mean = leaf_step(leaves, modulators, l, theta, x, base, h)
            x[j] = complex(x[j].real, 0.0)
            by_state[l, j] = end.imag / TINY
            by_state[count, j] += (theta[ratio] * mean).imag / TINY
        end, mean = leaf_step(leaves, modulators, l, theta, x, complex(v, TINY), h)
        by_velocity[l] = end.imag / TINY
        by_velocity[count] += (theta[ratio] * mean).imag / TINY
        for k in range(active.shape[0]):
            if users[0][l, k] or (modulators[l] >= 0 and leaves[modulators[l], 3] == active[k]):
                theta[active[k]] += TINY * 1j
                end, mean = leaf_step(leaves, modulators, l, theta, x, base, h)
                by_theta[l, k] = end.imag / TINY
                by_theta[count, k] += (theta[ratio] * mean).imag / TINY
                theta[active[k]] = complex(theta[active[k]].real, 0.0)
    for r in range(resistors.shape[0]):
        force = flow_force(leaves, resistors, r, theta, x, complex(v, TINY), h)
        by_velocity[count] += force.imag / TINY
        if resistors[r, 1] >= 0:
            j = resistors[r, 1]
            x[j] += TINY * 1j
            by_state[count, j] += flow_force(leaves, resistors, r, theta, x, base, h).imag / TINY
            x[j] = complex(x[j].real, 0.0)
    for k in range(active.shape[0]):
        m = active[k]
        theta[m] += TINY * 1j
        for r in range(resistors.shape[0]):
            if users[1][r, k]:
                by_theta[count, k] += flow_force(leaves, resistors, r, theta, x, base, h).imag / TINY
        for j in range(ports.shape[0]):
            if users[2][j, k]:
                by_theta[count, k] -= port_force(ports, j, theta, u[j]).imag / TINY
        if m == inertia:
            by_theta[count, k] += 2.0 * v / h
        theta[m] = complex(theta[m].real, 0.0)


@numba.njit(error_model="numpy")
def _propagate(
    by_state: Any, by_velocity: Any, by_theta: Any, force: Any, first_force: Any, varied: Any, weight_of: Any,
    mass: Any, d_state: Any, d_v: Any, d_next: Any,
) -> None:  # fmt: skip
    """One step of the linearised recursion for all columns."""
    size, columns = d_state.shape
    first_varied = first_force + force.shape[0]
    count = size - 1
    inverse = 1.0 / by_velocity[count]
    d_v[:] = 0.0
    for j in range(size):
        weight = -by_state[count, j] * inverse
        for c in range(columns):
            d_v[c] += weight * d_state[j, c]
    for k in range(by_theta.shape[1]):
        d_v[k] -= by_theta[count, k] * inverse
    for f in range(force.shape[0]):
        d_v[first_force + f] += force[f] * inverse
    for m in range(varied.shape[0]):
        d_v[first_varied + m] -= by_theta[count, varied[m]] * weight_of[m] * inverse
    for l in range(count):  # noqa: E741
        rate = by_velocity[l]
        for c in range(columns):
            d_next[l, c] = rate * d_v[c]
        for j in range(count):
            weight = by_state[l, j]
            if weight != 0.0:
                for c in range(columns):
                    d_next[l, c] += weight * d_state[j, c]
        for k in range(by_theta.shape[1]):
            d_next[l, k] += by_theta[l, k]
        for m in range(varied.shape[0]):
            d_next[l, first_varied + m] += by_theta[l, varied[m]] * weight_of[m]
    for c in range(columns):
        d_next[count, c] = 2.0 * mass * d_v[c] - d_state[count, c]


@numba.njit(error_model="numpy", _nrt=False)
def _sensitivity_steps(
    leaves: Any, modulators: Any, resistors: Any, ports: Any, inertia: Any, theta: Any, theta_c: Any, active: Any,
    users: Any, states: Any, velocity: Any, u: Any, h: Any, n_initial: Any, forces: Any, varied: Any, weights: Any,
    nodes: Any, output: Any, x: Any, by_state: Any, by_velocity: Any, by_theta: Any, d_state: Any, d_next: Any,
    d_v: Any, out: Any,
) -> None:  # fmt: skip
    """The steps of `_sensitivities`."""
    count = leaves.shape[0]
    k_active = active.shape[0]
    columns = d_state.shape[1]
    for c in range(columns):
        out[0, c] = d_state[output, c]
    following = 1
    mass = theta[inertia]
    for n in range(u.shape[0]):
        for l in range(count):  # noqa: E741
            x[l] = complex(states[n, l], 0.0)
        _linearise(
            leaves, modulators, resistors, ports, inertia, theta_c, active, users, x, velocity[n], u[n], h[n], by_state,
            by_velocity, by_theta,
        )  # fmt: skip
        _propagate(
            by_state, by_velocity, by_theta, forces[n], k_active + n_initial, varied, weights[n], mass, d_state,
            d_v, d_next,
        )  # fmt: skip
        for k in range(k_active):
            if active[k] == inertia:
                d_next[count, k] += 2.0 * velocity[n]
        for m in range(varied.shape[0]):
            if active[varied[m]] == inertia:
                d_next[count, columns - varied.shape[0] + m] += 2.0 * velocity[n] * weights[n, m]
        d_state, d_next = d_next, d_state
        if following < nodes.shape[0] and nodes[following] == n + 1:
            for c in range(columns):
                out[following, c] = d_state[output, c]
            following += 1


def _sensitivities(
    leaves: Any, modulators: Any, resistors: Any, ports: Any, inertia: Any, theta: Any, active: Any, states: Any,
    velocity: Any, u: Any, h: Any, start: Any, initial: Any, forces: Any, varied: Any, weights: Any, nodes: Any,
    output: Any, out: Any,
) -> None:  # fmt: skip
    """Forward sweep of the linearised recursion with many right-hand sides.

    Columns are, in order: the active parameters, perturbed initial states, perturbed junction forces, and
    parameters perturbed by a signal instead of a constant.

    Args:
        active: (K,) indices into theta.
        start: (L+1, K) derivative of the initial state by the active parameters.
        initial: (S,) state whose initial value column ``K + s`` perturbs.
        forces: (n, F) perturbations of the junction force, one column each.
        varied: (W,) which active parameter is perturbed; weights: (n, W) by which signal.
        nodes: (N,) increasing step indices at which the output is wanted, the first 0.
        output: measured leaf.
        out: (N, K + S + F + W) filled with the output's derivatives.
    """
    count = leaves.shape[0]
    k_active = active.shape[0]
    columns = k_active + initial.shape[0] + forces.shape[1] + varied.shape[0]
    theta_c = theta.astype(np.complex128)
    x = np.zeros(count, np.complex128)
    by_state = np.zeros((count + 1, count + 1))
    by_velocity = np.zeros(count + 1)
    by_theta = np.zeros((count + 1, k_active))
    users = (_users(leaves, 3, active), _resistor_users(leaves, resistors, active), _users(ports, 1, active))
    d_state = np.zeros((count + 1, columns))
    d_next = np.zeros((count + 1, columns))
    d_v = np.zeros(columns)
    d_state[:, :k_active] = start
    for s in range(initial.shape[0]):
        d_state[initial[s], k_active + s] = 1.0
    _sensitivity_steps(
        leaves, modulators, resistors, ports, inertia, theta, theta_c, active, users, states, velocity, u, h,
        initial.shape[0], forces, varied, weights, nodes, output, x, by_state, by_velocity, by_theta, d_state, d_next,
        d_v, out,
    )  # fmt: skip


@numba.njit(error_model="numpy", _nrt=False)
def _adjoint_steps(
    leaves: Any, modulators: Any, resistors: Any, ports: Any, inertia: Any, theta: Any, theta_c: Any, none: Any,
    users: Any, states: Any, velocity: Any, u: Any, h: Any, cotangent: Any, multipliers: Any, x: Any, by_state: Any,
    by_velocity: Any, by_theta: Any, w: Any, earlier: Any,
) -> None:  # fmt: skip
    """The steps of `_adjoint`."""
    count = leaves.shape[0]
    mass = theta[inertia]
    for n in range(u.shape[0] - 1, -1, -1):
        for l in range(count + 1):  # noqa: E741
            w[l] += cotangent[n + 1, l]
        for l in range(count):  # noqa: E741
            x[l] = complex(states[n, l], 0.0)
        _linearise(
            leaves, modulators, resistors, ports, inertia, theta_c, none, users, x, velocity[n], u[n], h[n], by_state,
            by_velocity, by_theta,
        )  # fmt: skip
        into_v = 2.0 * mass * w[count]
        for l in range(count):  # noqa: E741
            into_v += by_velocity[l] * w[l]
        residual = -into_v / by_velocity[count]
        for j in range(count + 1):
            earlier[j] = residual * by_state[count, j]
            for l in range(count):  # noqa: E741
                earlier[j] += w[l] * by_state[l, j]
        earlier[count] -= w[count]
        for j in range(count + 1):
            multipliers[n + 1, j] = w[j]
            w[j] = earlier[j]
        multipliers[n + 1, count + 1] = residual
    for l in range(count + 1):  # noqa: E741
        multipliers[0, l] = w[l] + cotangent[0, l]


def _adjoint(
    leaves: Any, modulators: Any, resistors: Any, ports: Any, inertia: Any, theta: Any, states: Any, velocity: Any,
    u: Any, h: Any, cotangent: Any, multipliers: Any,
) -> None:  # fmt: skip
    """Backward sweep: multipliers of the step equations for a cotangent of the states.

    Args:
        cotangent: (n+1, L+1) ``dL/d(x, p)`` at the nodes.
        multipliers: (n+1, L+2) filled. Row ``n+1`` holds ``λ`` for ``x⁺ = X(x, v̄)``, for the momentum update and
            for ``R = 0`` of step ``n``; row 0 holds ``dL/d(x₀, p₀)``.
    """
    count = leaves.shape[0]
    theta_c = theta.astype(np.complex128)
    x = np.zeros(count, np.complex128)
    none = np.zeros(0, np.int64)
    users = (_users(leaves, 3, none), _users(resistors, 2, none), _users(ports, 1, none))
    by_state = np.zeros((count + 1, count + 1))
    by_velocity = np.zeros(count + 1)
    by_theta = np.zeros((count + 1, 0))
    w = np.zeros(count + 1)
    earlier = np.zeros(count + 1)
    _adjoint_steps(
        leaves, modulators, resistors, ports, inertia, theta, theta_c, none, users, states, velocity, u, h, cotangent,
        multipliers, x, by_state, by_velocity, by_theta, w, earlier,
    )  # fmt: skip


with kernel_cache():
    sensitivities = numba.njit(cache=True, nogil=True, error_model="numpy")(_sensitivities)
    adjoint = numba.njit(cache=True, nogil=True, error_model="numpy")(_adjoint)
