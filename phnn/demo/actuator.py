"""The concealed actuator: eqs. (2)–(6) of the paper plus every effect of the demonstration, solved by LSODA.

With ``e_i = Q_i/C_i`` and ``h`` the dead zone of eq. (2),

    Q̇_i = α v − h_i(e_i, q),    q̇ = v = p/m,    ṡ = v − s/τ_s,    τ_V V̇ = u − V
    ṗ = α (V + ½ ε V²) − α Σ e_i − k q (1 + κ₃ (q/q₀)²) − k_s s − b v − c₂ |v| v − F_c tanh(v/v_s) − k_c max(q − q_c, 0)

with ``i = 1, 2, 3``. At its neutral value an effect's parameter leaves exactly the equations of the paper.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import ODEintWarning, odeint

from phnn.demo.excitation import Excitation
from phnn.errors import SolverFailed

Array = NDArray[np.float64]

# Table 1 of the paper, SI; rho is the conductance ϱ⁻¹.
TABLE = {
    "m": 1.0148e-3,
    "k": 24579.0,
    "b": 3.7356,
    "alpha": 0.046311,
    "C_1": 5.6425e-7,
    "C_2": 5.2125e-7,
    "rho_1": 0.6002,
    "rho_2": 1.1528e-4,
    "d_1": 14.7571,
    "d_2": 8.6838,
}

# Values at which an effect is absent. inv_C_3 is 1/C_3, so that absence is a number; a τ_V of zero means none.
NEUTRAL = {
    "k_s": 0.0,
    "tau_s": 1.0,
    "kappa_3": 0.0,
    "F_c": 0.0,
    "v_s": 1e-4,
    "c_2": 0.0,
    "inv_C_3": 0.0,
    "rho_3": 0.0,
    "d_3": 1.0,
    "kappa_d": 0.0,
    "epsilon": 0.0,
    "tau_V": 0.0,
    "V_max": math.inf,
    "k_c": 0.0,
    "q_c": 1.0,
}
Q_0 = 100e-6  # m, displacement that the dimensionless strengths refer to

_ORDER = (*TABLE, *NEUTRAL)
_STATES = 7  # Q_1, Q_2, q, p, s, Q_3, V
# Typical sizes of the states [C, C, m, kg m/s, m, C, V]: absolute tolerances are a small part of them.
_SIZES = np.array([4e-6, 4e-6, 1e-4, 1e-5, 1e-4, 4e-6, 75.0])
_RELATIVE = 1e-8


@njit(cache=True)
def _dead_zone(e: float, rho: float, half: float) -> float:
    """Eq. (2): current through the nonlinear resistor at the voltage ``e``."""
    if e > half:
        return rho * (e - half)
    if e < -half:
        return rho * (e + half)
    return 0.0


@njit(cache=True)
def _rates(t: float, x: Array, w: Array, drive: Array) -> Array:
    """``ẋ``; ``w`` holds the parameters in the order of ``_ORDER``, ``drive`` one piece of voltage."""
    m, k, b, alpha, c_1, c_2, rho_1, rho_2, d_1, d_2 = w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8], w[9]
    k_s, tau_s, kappa_3, f_c, v_s, drag, inv_c_3, rho_3, d_3 = (
        w[10],
        w[11],
        w[12],
        w[13],
        w[14],
        w[15],
        w[16],
        w[17],
        w[18],
    )
    kappa_d, epsilon, tau_v, v_max, k_c, q_c = w[19], w[20], w[21], w[22], w[23], w[24]
    q, v, s = x[2], x[3] / m, x[4]
    out = np.zeros(7)

    voltage = drive[0] + drive[1] * math.sin(2.0 * math.pi * (drive[2] * t + 0.5 * drive[3] * t * t))
    if tau_v > 0.0:
        out[6] = (voltage - x[6]) / tau_v
        voltage = x[6]
    voltage = min(max(voltage, -v_max), v_max)

    width = max(0.0, 1.0 + kappa_d * q / Q_0)
    e_1, e_2, e_3 = x[0] / c_1, x[1] / c_2, x[5] * inv_c_3
    out[0] = alpha * v - _dead_zone(e_1, rho_1, 0.5 * d_1 * width)
    out[1] = alpha * v - _dead_zone(e_2, rho_2, 0.5 * d_2 * width)
    out[2] = v
    force = alpha * (voltage * (1.0 + 0.5 * epsilon * voltage) - e_1 - e_2 - e_3)
    force -= k * q * (1.0 + kappa_3 * (q / Q_0) ** 2) + (b + drag * abs(v)) * v
    if f_c != 0.0:
        force -= f_c * math.tanh(v / v_s)
    if k_s != 0.0:
        out[4] = v - s / tau_s
        force -= k_s * s
    if inv_c_3 != 0.0:
        out[5] = alpha * v - _dead_zone(e_3, rho_3, 0.5 * d_3 * width)
    if q > q_c:
        force -= k_c * (q - q_c)
    out[3] = force
    return out


def simulate(parameters: Mapping[str, float], excitation: Excitation) -> Array:
    """Displacement from rest at the sampling times.

    Args:
        parameters: those of ``TABLE``, and those of ``NEUTRAL`` that are not neutral; SI.
        excitation: continuous voltage; the solver stops and starts again where it jumps.

    Returns:
        q, (samples,), m.

    Raises:
        SolverFailed: LSODA gave up.
    """
    values = {**NEUTRAL, **parameters}
    w = np.array([values[name] for name in _ORDER])
    t, which = excitation.t, excitation.piece_of(excitation.t)
    q = np.empty(t.size)
    x = np.zeros(_STATES)
    for i, piece in enumerate(excitation.pieces):
        inside = which == i
        times = np.unique(np.concatenate([[piece.start], t[inside], [piece.end]]))
        path = _solve(x, times, w, piece.as_array(), excitation.name)
        q[inside] = path[np.searchsorted(times, t[inside]), 2]
        x = path[-1]
    return q


def _solve(x: Array, times: Array, w: Array, drive: Array, name: str) -> Array:
    """States at ``times``, (len(times), 7); the voltage is smooth on the whole stretch."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ODEintWarning)
        try:
            path: Array = odeint(
                _rates,
                x,
                times,
                args=(w, drive),
                rtol=_RELATIVE,
                atol=_RELATIVE * 1e-2 * _SIZES,
                mxstep=200_000,
                tfirst=True,
            )
        except ODEintWarning as warning:
            span = f"between {times[0]:g} s and {times[-1]:g} s"
            raise SolverFailed(f"{name}: LSODA stopped {span} ({warning}): draw another seed") from warning
    if not np.isfinite(path).all():
        first = times[int(np.argmin(np.isfinite(path).all(axis=1)))]
        raise SolverFailed(f"{name}: the simulation left the finite numbers at {first:g} s: draw another seed")
    return path


def simulate_all(parameters: Mapping[str, float], plan: Sequence[Excitation]) -> tuple[Array, ...]:
    """``simulate`` for every recording of a plan."""
    return tuple(simulate(parameters, excitation) for excitation in plan)
