"""The compiled power-preserving step.

One step of size ``h`` from ``(x, p)`` under the mean inputs ``ū`` solves one monotone scalar equation in the
mid-step velocity ``v̄ = (p⁺ + p)/(2m)``,

    R(v̄) = 2(m v̄ − p)/h + Σ_l a_l ē_l(v̄) + Σ_r φ_r(v̄) − Σ_j g_j ψ_j(ū_j) = 0,

where ``ē_l`` is the discrete gradient of a lossless leaf or the average effort of a dissipative leaf under
the constant current ``a_l v̄`` (`phnn.laws.leaf`). Multiplied by ``h v̄`` it is the energy balance of the step.

Every function here runs on floats and on complex numbers with a tiny imaginary part; the latter yields
exact derivatives of the very step that marches, so that none is written by hand.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from phnn.integrate.dispatch import flow_table, port_table, storage_table, threshold_table
from phnn.integrate.program import LOSSLESS
from phnn.laws.leaf import rc_flow
from phnn.laws.namespace import reciprocal

# Far below any flow that matters, so that the perturbation stays small even where a flow has died away.
TINY = 1e-140
_TOLERANCE = 1e-14
_ITERATIONS = 120
# A motion that has died away reaches the smallest numbers, where relative accuracy is lost.
_NOTHING = 1e-200

_mean_effort = storage_table()
_thresholds = threshold_table()
_flow = flow_table()
_action = port_table()


@numba.njit(error_model="numpy", forceinline=True)
def _mid_state(leaves: Any, m: Any, theta: Any, x: Any, v: Any, h: Any) -> Any:
    """Mid-step energy variable of a lossless leaf, the read-only argument of a modulated law; 0 for none."""
    if m < 0:
        return 0.0 * v
    return x[m] + 0.5 * h * theta[leaves[m, 3]] * v


@numba.njit(error_model="numpy", forceinline=True)
def leaf_step(leaves: Any, modulators: Any, l: Any, theta: Any, x: Any, v: Any, h: Any) -> Any:  # noqa: E741
    """Next state and mean effort of leaf ``l`` under the mid-step velocity ``v``."""
    row = leaves[l]
    current = theta[row[3]] * v
    if row[0] == LOSSLESS:
        end = x[l] + h * current
        return end, _mean_effort(row[1], x[l], end, theta[row[4]], theta[row[5]], theta[row[6]], theta[row[7]])
    q = _mid_state(leaves, modulators[l], theta, x, v, h)
    rho, low, high = _thresholds(row[2], q, theta[row[8]], theta[row[9]], theta[row[10]], theta[row[11]])
    # A linear storage: its capacitance is one over the effort at one.
    one = 1.0 + 0.0 * v
    capacitance = reciprocal(_mean_effort(row[1], one, one, theta[row[4]], theta[row[5]], theta[row[6]], theta[row[7]]))
    return rc_flow(x[l], current, h, capacitance, rho, low, high)


@numba.njit(error_model="numpy", forceinline=True)
def flow_force(leaves: Any, resistors: Any, r: Any, theta: Any, x: Any, v: Any, h: Any) -> Any:
    """Force of resistor ``r`` on the junction."""
    row = resistors[r]
    q = _mid_state(leaves, row[1], theta, x, v, h)
    return _flow(row[0], v, q, theta[row[2]], theta[row[3]], theta[row[4]], theta[row[5]])


@numba.njit(error_model="numpy", forceinline=True)
def port_force(ports: Any, j: Any, theta: Any, u: Any) -> Any:
    """``g_j ψ_j(u_j)``."""
    row = ports[j]
    return theta[row[1]] * _action(
        row[0], u + 0.0 * theta[0], theta[row[2]], theta[row[3]], theta[row[4]], theta[row[5]]
    )


@numba.njit(error_model="numpy", forceinline=True)
def balance(
    leaves: Any, modulators: Any, resistors: Any, inertia: Any, theta: Any, x: Any, p: Any, v: Any, drive: Any, h: Any,
    x_next: Any, efforts: Any,
) -> Any:  # fmt: skip
    """``R(v̄)`` and the size of its terms; fills the leaves' next states and mean efforts."""
    total = 2.0 * (theta[inertia] * v - p) / h - drive
    size = abs(total.real) + abs(drive) + abs(p) / h
    for l in range(leaves.shape[0]):  # noqa: E741
        end, mean = leaf_step(leaves, modulators, l, theta, x, v, h)
        x_next[l] = end
        efforts[l] = mean
        force = theta[leaves[l, 3]] * mean
        total += force
        size += abs(force.real)
    for r in range(resistors.shape[0]):
        force = flow_force(leaves, resistors, r, theta, x, v, h)
        total += force
        size += abs(force.real)
    return total, size


@numba.njit(error_model="numpy", forceinline=True)
def solve_step(
    leaves: Any, modulators: Any, resistors: Any, inertia: Any, theta: Any, theta_c: Any, x: Any, x_c: Any, p: Any,
    drive: Any, h: Any, guess: Any, x_next: Any, efforts: Any, x_scratch: Any, e_scratch: Any,
) -> Any:  # fmt: skip
    """The root ``v̄`` by Newton inside a bracket; NaN where none was found. ``*_c`` are complex copies.

    Every network is passive, so that ``v̄ R(v̄) > 0`` far out and a root exists. Where no law is modulated ``R``
    increases at least as fast as ``2 m v̄/h``: one root, and one step of that slope leads beyond it. A modulated
    threshold may let ``R`` fall for a while; hence only signs that were seen bound the root.
    """
    floor = 2.0 * theta[inertia] / h
    low = -np.inf
    high = np.inf
    v = guess
    last = np.inf
    reach = 1.0
    for iteration in range(_ITERATIONS):
        value, _ = balance(
            leaves, modulators, resistors, inertia, theta_c, x_c, p, complex(v, TINY), drive, h, x_scratch, e_scratch
        )  # fmt: skip
        if not np.isfinite(value.real):
            return np.nan
        if value.real > 0.0:
            high = v
        else:
            low = v
        slope = value.imag / TINY
        step = v - value.real / slope
        # Not finite fails the comparison as well. Newton may also hop between two kinks: a step that did not halve
        # the residual is followed by a bisection. On a falling branch it would go to a root that is not connected.
        newton = low <= step <= high and slope > 0.0 and abs(value.real) <= 0.5 * last
        last = abs(value.real)
        exhausted = False
        if newton:
            v = step
        elif np.isfinite(high - low):
            v = 0.5 * (low + high)
            exhausted = v in (low, high)
        else:
            v -= reach * value.real / floor
            reach *= 2.0
        residual, size = balance(
            leaves, modulators, resistors, inertia, theta, x, p, v, drive, h, x_next, efforts
        )  # fmt: skip
        slack = _TOLERANCE if iteration < 12 else 1e-12
        if exhausted or abs(residual) <= slack * size + _NOTHING:
            return v
    return np.nan
