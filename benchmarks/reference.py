"""The reference: scipy's Radau at a tight tolerance, restarted at every sample where the straight input has a kink.

Beside the states (Q_1, Q_2, q, p) it solves their variational equations, so that the reference of a gradient needs no
finite differences. It takes minutes and is kept in files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numba
import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.case import TRUTH, Array
from phnn.recordings.recording import Recording

CACHE = Path(__file__).parent / "results" / ".cache"
# At 1e-10 a tenfold tighter tolerance moves no displacement by more than 1e-13 and no sensitivity by more than 3e-7.
TIGHT = 1e-10

# States are solved for as multiples of their peaks in the campaign, so that one absolute tolerance means the
# same for all of them; the peers are given the same states.
SCALE = np.array([4.2e-6, 5.4e-6, 1.2e-4, 1.3e-4])
_STATES, _PARAMETERS = 4, 10


@numba.njit(cache=True)
def rates(z: Array, voltage: float, theta: Array, scale: Array) -> Array:
    """(4,) eqs. (3)–(6) in scaled states; ``theta`` in the order of `benchmarks.case.NAMES`."""
    m, k, b, alpha = theta[0], theta[1], theta[2], theta[3]
    v = z[3] * scale[3] / m
    out = np.empty(4)
    force = -k * z[2] * scale[2] - b * v + alpha * voltage
    for i in range(2):
        effort = z[i] * scale[i] / theta[4 + i]
        half = 0.5 * theta[8 + i]
        out[i] = (alpha * v - theta[6 + i] * (max(effort - half, 0.0) + min(effort + half, 0.0))) / scale[i]
        force -= alpha * effort
    out[2] = v / scale[2]
    out[3] = force / scale[3]
    return out


@numba.njit(cache=True)
def jacobian(z: Array, theta: Array, scale: Array) -> Array:
    """(4, 4) derivative of `rates` by the states."""
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


@numba.njit(cache=True)
def by_parameters(z: Array, voltage: float, theta: Array, scale: Array) -> Array:
    """(4, 10) derivative of `rates` by the logarithms of the parameters."""
    m, k, b, alpha = theta[0], theta[1], theta[2], theta[3]
    v = z[3] * scale[3] / m
    out = np.zeros((4, 10))
    out[2, 0], out[3, 0] = -v, b * v
    out[3, 1], out[3, 2], out[3, 3] = -k * z[2] * scale[2], -b * v, alpha * voltage
    for i in range(2):
        out[i, 0], out[i, 3] = -alpha * v, alpha * v
        effort = z[i] * scale[i] / theta[4 + i]
        half, rho = 0.5 * theta[8 + i], theta[6 + i]
        out[3, 3] -= alpha * effort
        out[3, 4 + i] = alpha * effort
        if abs(effort) > half:
            sign = 1.0 if effort > 0.0 else -1.0
            out[i, 4 + i] = rho * effort
            out[i, 6 + i] = -rho * (effort - sign * half)
            out[i, 8 + i] = rho * sign * half
    for i in range(4):
        out[i] /= scale[i]
    return out


@numba.njit(cache=True)
def _varied(t: float, w: Array, u: float, slope: float, theta: Array, scale: Array) -> Array:
    """(44,) rates of the states and, row by row, of their derivatives by the parameters."""
    z, columns = w[:4], w[4:].reshape(4, 10)
    out = np.empty(44)
    out[:4] = rates(z, u + slope * t, theta, scale)
    change = jacobian(z, theta, scale) @ columns + by_parameters(z, u + slope * t, theta, scale)
    out[4:] = change.ravel()
    return out


@numba.njit(cache=True)
def _varied_jacobian(t: float, w: Array, u: float, slope: float, theta: Array, scale: Array) -> Array:
    """(44, 44) for Newton's iteration, without the block by which states move the derivatives: it converges as well."""
    small = jacobian(w[:4], theta, scale)
    out = np.zeros((44, 44))
    out[:4, :4] = small
    for i in range(4):
        for j in range(4):
            for k in range(10):
                out[4 + 10 * i + k, 4 + 10 * j + k] = small[i, j]
    return out


def solved(recording: Recording, theta: Array, tolerance: float = TIGHT) -> tuple[Array, Array]:
    """(N,) displacement [m] and (N, 10) its derivatives by the logarithms of the parameters [m].

    Raises:
        RuntimeError: the solver gave up.
    """
    dt, u = recording.dt, recording.u
    w = np.zeros(_STATES * (1 + _PARAMETERS))
    path = [w]
    for n in range(u.size - 1):
        arguments = (u[n], (u[n + 1] - u[n]) / dt, theta, SCALE)
        piece = solve_ivp(
            _varied, (0.0, dt), w, "Radau", args=arguments, jac=_varied_jacobian, rtol=tolerance, atol=tolerance
        )
        if not piece.success:
            raise RuntimeError(f"Radau on {recording.name} after sample {n}: {piece.message}")
        w = piece.y[:, -1]
        path.append(w)
    found = np.array(path)
    first = _STATES + 2 * _PARAMETERS
    return found[:, 2] * SCALE[2], found[:, first : first + _PARAMETERS] * SCALE[2]


def reference(recordings: Sequence[Recording], theta: Array = TRUTH) -> tuple[Array, Array]:
    """(R, N) displacements and (R, N, 10) derivatives, from the files where they have been computed before."""
    pairs = [_kept(r, theta) for r in recordings]
    return np.stack([q for q, _ in pairs]), np.stack([s for _, s in pairs])


def _kept(recording: Recording, theta: Array) -> tuple[Array, Array]:
    key = hashlib.sha256(np.concatenate([recording.t, recording.u, theta, SCALE, [TIGHT]]).tobytes())
    path = CACHE / f"{recording.name}-{key.hexdigest()[:12]}.npz"
    if path.exists():
        with np.load(path) as kept:
            return kept["q"], kept["by"]
    print(f"reference of {recording.name} (kept for the next run)", flush=True)
    q, by = solved(recording, theta)
    CACHE.mkdir(parents=True, exist_ok=True)
    np.savez(path, q=q, by=by)
    return q, by
