"""The compiled march: the steps of `phnn.integrate.step` solved one after the other."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from phnn.integrate.dispatch import kernel_cache
from phnn.integrate.step import port_force, solve_step


@numba.njit(error_model="numpy", _nrt=False)
def _march_steps(
    leaves: Any, modulators: Any, resistors: Any, ports: Any, inertia: Any, theta: Any, theta_c: Any, x0: Any, u: Any,
    h: Any, states: Any, velocity: Any, efforts: Any, x: Any, x_c: Any, x_next: Any, mean: Any, x_scratch: Any,
    e_scratch: Any,
) -> Any:  # fmt: skip
    """The steps of `_march`, which owns all memory: without it, reference counts of arrays cost most of the time."""
    count = leaves.shape[0]
    for l in range(count + 1):  # noqa: E741
        states[0, l] = x0[l]
    p = x0[count]
    mass = theta[inertia]
    guess = p / mass
    for n in range(u.shape[0]):
        drive = 0.0
        for j in range(ports.shape[0]):
            drive += port_force(ports, j, theta, u[n, j])
        v = solve_step(
            leaves, modulators, resistors, inertia, theta, theta_c, x, x_c, p, drive, h[n], guess, x_next, mean,
            x_scratch, e_scratch,
        )  # fmt: skip
        if not np.isfinite(v):
            return n
        guess = v if n == 0 else 2.0 * v - velocity[n - 1]
        velocity[n] = v
        p = 2.0 * mass * v - p
        for l in range(count):  # noqa: E741
            x[l] = x_next[l]
            x_c[l] = x_next[l]
            states[n + 1, l] = x_next[l]
            efforts[n, l] = mean[l]
        states[n + 1, count] = p
    return u.shape[0]


def _march(
    leaves: Any, modulators: Any, resistors: Any, ports: Any, inertia: Any, theta: Any, x0: Any, u: Any, h: Any,
    states: Any, velocity: Any, efforts: Any,
) -> Any:  # fmt: skip
    """March ``n`` steps; returns how many succeeded.

    Args:
        theta: (M,) parameters.
        x0: (L+1,) initial leaf states and, last, the momentum.
        u: (n, P) mean inputs of the steps; h: (n,) their sizes.
        states: (n+1, L+1) filled with the states in that order.
        velocity: (n,) filled with the mid-step velocities.
        efforts: (n, L) filled with the leaves' mean efforts.
    """
    count = leaves.shape[0]
    x = x0[:count].copy()
    x_c = x.astype(np.complex128)
    theta_c = theta.astype(np.complex128)
    x_next = np.zeros(count)
    mean = np.zeros(count)
    x_scratch = np.zeros(count, np.complex128)
    e_scratch = np.zeros(count, np.complex128)
    return _march_steps(
        leaves, modulators, resistors, ports, inertia, theta, theta_c, x0, u, h, states, velocity, efforts, x, x_c,
        x_next, mean, x_scratch, e_scratch,
    )  # fmt: skip


with kernel_cache():
    march = numba.njit(cache=True, nogil=True, error_model="numpy")(_march)
