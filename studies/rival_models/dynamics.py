"""Linear dynamics of unit static gain behind a hysteresis operator.

    L(s) = (1 + z s/ω) / (s²/ω² + 2 ζ s/ω + 1)  ·  Π_i (1 + k_i τ_i s) / (1 + τ_i s)

Discretised exactly for an input that is linear between samples, or held (matrix exponential over one
sample interval; Franklin, Powell, Workman 1998, Sec. 6.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter, lfilter_zi

Array = NDArray[np.float64]

HELD = "zero_order"
# Logarithms of ω over the highest excited frequency, of ζ, and of ω τ; and the values between which z and k may lie.
_START = (np.log(4.0), np.log(0.3), 0.0)
_LOW, _HIGH = (np.log(1e-3), np.log(1e-3), -10.0), (np.log(300.0), np.log(300.0), 10.0)
_LAG = ((0.0, 0.9), (np.log(1e-4), -5.0), (np.log(1e4), 20.0))


@dataclass(frozen=True)
class Dynamics:
    """The structure: one section of second order and ``lags`` of first order; ``rate`` is the unit of ω, rad/s.

    A parameter vector is ``(ln ω/rate, ln ζ, z, ln rate·τ_1, k_1, …)``.
    """

    lags: int
    rate: float

    @property
    def start(self) -> Array:
        """(P,) parameters from which a fit begins."""
        return np.array([*_START, *(x for k in range(self.lags) for x in (_LAG[0][0] + 2.0 * k, _LAG[0][1]))])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest values (P,), (P,)."""
        return np.array([*_LOW, *_LAG[1] * self.lags]), np.array([*_HIGH, *_LAG[2] * self.lags])

    def filter(self, theta: Array, dt: float, held: bool) -> tuple[Array, Array]:
        """Numerator and denominator in z⁻¹ at the sampling interval ``dt`` [s]."""
        omega, zeta, zero = self.rate * np.exp(theta[0]), np.exp(theta[1]), theta[2]
        a, b = np.array([1.0 / omega**2, 2.0 * zeta / omega, 1.0]), np.array([zero / omega, 1.0])
        for log_tau, lead in theta[3:].reshape(-1, 2):
            tau = np.exp(log_tau) / self.rate
            a, b = np.polymul(a, [tau, 1.0]), np.polymul(b, [lead * tau, 1.0])
        return _discretised(b, a, dt, held)


def _discretised(b: Array, a: Array, dt: float, held: bool) -> tuple[Array, Array]:
    """``b(s)/a(s)``, strictly proper, in z⁻¹: state space over one sample, then numerator from the impulse response."""
    n = a.size - 1
    # In units of dt: the companion matrix of seconds would hold numbers of very different size.
    powers = float(dt) ** -np.arange(n + 1)[::-1]
    scaled = a * powers
    low, high = scaled[1:] / scaled[0], b * powers[-b.size :] / scaled[0]
    joint = np.zeros((n + 2, n + 2))
    joint[0, :n] = -low
    joint[1:n, : n - 1] = np.eye(n - 1)
    joint[0, n], joint[n, n + 1] = 1.0, 1.0
    over = expm(joint)
    step, constant, ramp = over[:n, :n], over[:n, n], np.zeros(n) if held else over[:n, n + 1]
    driven = constant - ramp + step @ ramp
    row = np.concatenate([np.zeros(n - high.size), high])
    impulse, state = [float(row @ ramp)], driven
    for _ in range(n):
        impulse.append(float(row @ state))
        state = step @ state
    denominator: Array = np.asarray(np.poly(step).real, dtype=np.float64)
    numerator: Array = np.convolve(denominator, np.array(impulse))[: n + 1]
    # Rounding would leave a static gain that differs from one where poles lie close to one.
    return numerator * (denominator.sum() / numerator.sum()), denominator


def filtered(b: Array, a: Array, x: Array, before: Array) -> Array:
    """``(N, K)`` columns through a filter that has rested at ``before`` (K,)."""
    rest = lfilter_zi(b, a)[:, None] * before[None, :]
    found, _ = lfilter(b, a, x, axis=0, zi=rest)
    return np.asarray(found)


def free_responses(b: Array, a: Array, samples: int) -> Array:
    """``(N, order)`` outputs without input from unit states."""
    order = a.size - 1
    found, _ = lfilter(b, a, np.zeros((samples, order)), axis=0, zi=np.eye(order))
    return np.asarray(found)
