"""The reference: scipy's Radau at a tolerance of 1e-10 under the continuous sine, kept in a file because it is slow."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numba
import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.case import AMPLITUDE, FREQUENCIES, NAMES, PERIODS, SAMPLES, TRUTH, Array, times

CACHE = Path(__file__).parent / "results" / ".cache"
TIGHT = 1e-10

# States (Q_1, Q_2, q, p) are solved for as multiples of their peaks in the campaign, so that one absolute
# tolerance means the same for all of them; the peers are given the same states.
SCALE = np.array([4.2e-6, 5.4e-6, 1.2e-4, 1.3e-4])


@numba.njit
def rates(t: float, z: Array, omega: float, theta: Array, scale: Array) -> Array:
    """Eqs. (3)–(6) in scaled states; ``theta`` in the order of `benchmarks.case.NAMES`."""
    m, k, b, alpha = theta[0], theta[1], theta[2], theta[3]
    v = z[3] * scale[3] / m
    out = np.empty(4)
    force = -k * z[2] * scale[2] - b * v + alpha * AMPLITUDE * math.sin(omega * t)
    for i in range(2):
        effort = z[i] * scale[i] / theta[4 + i]
        half = 0.5 * theta[8 + i]
        out[i] = (alpha * v - theta[6 + i] * (max(effort - half, 0.0) + min(effort + half, 0.0))) / scale[i]
        force -= alpha * effort
    out[2] = v / scale[2]
    out[3] = force / scale[3]
    return out


@numba.njit
def jacobian(t: float, z: Array, omega: float, theta: Array, scale: Array) -> Array:
    """Derivative of `rates` by the states."""
    m, k, b, alpha = theta[0], theta[1], theta[2], theta[3]
    out = np.zeros((4, 4))
    for i in range(2):
        effort = z[i] * scale[i] / theta[4 + i]
        if abs(effort) > 0.5 * theta[8 + i]:
            out[i, i] = -theta[6 + i] / theta[4 + i]
        out[i, 3] = alpha / m * scale[3] / scale[i]
        out[3, i] = -alpha / theta[4 + i] * scale[i] / scale[3]
    out[2, 3] = scale[3] / (m * scale[2])
    out[3, 2] = -k * scale[2] / scale[3]
    out[3, 3] = -b / m
    return out


def radau(frequency: float, theta: Array, tolerance: float, scale: Array = SCALE) -> Array:
    """(SAMPLES,) displacement by scipy's Radau with the exact Jacobian [m].

    Raises:
        RuntimeError: the solver gave up.
    """
    arguments: tuple[Any, ...] = (2.0 * np.pi * frequency, theta, scale)
    t = times(frequency)
    solution = solve_ivp(
        rates, (0.0, PERIODS / frequency), np.zeros(4), "Radau", t, args=arguments, jac=jacobian, rtol=tolerance,
        atol=tolerance,
    )  # fmt: skip
    if not solution.success:
        raise RuntimeError(f"Radau at {frequency:g} Hz: {solution.message}")
    return np.asarray(solution.y[2] * scale[2])


def reference(frequency: float, theta: Array = TRUTH) -> Array:
    """(SAMPLES,) displacement at the tight tolerance, from the file where it has been computed before [m]."""
    key = hashlib.sha256(np.array([frequency, AMPLITUDE, PERIODS, SAMPLES, TIGHT, *theta, *SCALE]).tobytes())
    path = CACHE / f"{frequency:g}Hz-{key.hexdigest()[:12]}.npy"
    if path.exists():
        return np.asarray(np.load(path))
    q = radau(frequency, theta, TIGHT)
    CACHE.mkdir(parents=True, exist_ok=True)
    np.save(path, q)
    return q


def reference_campaign(theta: Array = TRUTH) -> Array:
    """(7, SAMPLES) the whole campaign [m]."""
    return np.stack([reference(f, theta) for f in FREQUENCIES])


def difference_step(name: str) -> float:
    """Step in the logarithm of a parameter for central differences of the reference.

    The stiff hysteron switches within microseconds, so that sensitivities all but jump: a step that moves the
    switching by a good part of a sample would smear them. Only ``rho_1`` does not move it; its sensitivity is
    so small that it needs a large step to stand out from the reference's own error.
    """
    return 1e-2 if name == "rho_1" else 5e-5


def reference_sensitivities() -> Array:
    """(7, SAMPLES, 10) derivatives of the displacement by the logarithms of the parameters, central differences [m]."""
    columns = []
    for k, name in enumerate(NAMES):
        step = difference_step(name)
        up, down = TRUTH.copy(), TRUTH.copy()
        up[k] *= np.exp(step)
        down[k] *= np.exp(-step)
        columns.append((reference_campaign(up) - reference_campaign(down)) / (2.0 * step))
    return np.stack(columns, axis=-1)
