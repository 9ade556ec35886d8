"""The concealed actuator from amplifier to sensor: parameters, compiled equations, solvers.

The equations are the paper's (2)–(6) and every effect. With ``e_i = Q_i/C_i``, ``h_i`` the dead zone of eq. (2),
``s = q/q₀`` and ``A`` the factor of the coupling,

    Q̇_i = α A v − h_i(e_i) − G e_i,    q̇ = v = p/m,    ṗ = α A (V + ½ ε V²) − α A Σ e_i − F(q, v, …)

At its neutral value an effect's parameter leaves exactly the equations of the paper. LSODA solves them; Runge and
Kutta's method does under a coarse converter or a random force, which would stop LSODA at every step or sample.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import ODEintWarning, odeint

from phnn.errors import SolverFailed
from studies.generator.plans import PEAK, Array, Excitation

Q_0 = 100e-6  # m, displacement that the dimensionless strengths refer to
FORCE_STEP = 25e-6  # s, between the samples of a random force
_TRACKS = 1e-8  # s, within which a slew-limited amplifier that has caught up follows its command
_DECADES = 4.0  # that the time constants of creep with several of them span
_FOLLOWS = 2e-6  # s, within which a play that its displacement has caught follows the envelope
_RELATIVE = 1e-8
_STEP = 1.5e-6  # s, with which the fast hysteron of any draw (0.6 µs) is stable
_SAME = 1e-12  # s; LSODA refuses times as close as that
_FINE = 5e-6  # s; a play turns between the samples, where the displacement does
_GAIN_TIME = 3.0  # s, in which a slow change of the gain reaches κ_y
_AGES = 5e-3  # s, after which ageing follows the logarithm of time

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

ABSENT = 1e3  # F: a hysteron of this capacitance is no more than a wire

FURTHER = (5, 6)  # numbers of a base's third and fourth hysteron; 3 and 4 belong to effects

# Values at which an effect is absent: inv_C_3 is 1/C_3, so that absence is a number, and a τ_V of zero means none.
# Hysterons 5 and 6 are the third and the fourth of a base; plays, a Bouc–Wen or a Duhem state take their place.
_ZERO = """
    k_s k_l kappa_2 kappa_3 kappa_5 kappa_p f_p phi_p F_c F_l c_2 kappa_b kappa_f k_c m_2 k_2 b_2 A_b f_b phi_b
    inv_C_3 rho_3 rho_4 k_w kappa_d kappa_v kappa_C G inv_C_5 rho_5 inv_C_6 rho_6
    c_play_1 c_play_2 c_play_3 c_play_4 c_play_5 c_play_6
    c_play_7 c_play_8 lean_play gape_play c_bouc c_duhem epsilon kappa_a kappa_e delta_z kappa_T
    tau_d Delta_u delta_V tau_V zeta_V s_V tau_y a_2 a_3 delta_b kappa_y kappa_t
    kappa_u f_u phi_u omega_u A_g c_e kappa_r kappa_w kappa_l x_T A_y delta_y
"""
_ONE = """
    tau_s tau_l r_s v_st z_l n_c2 q_c n_c side d_3 d_4 z_w n_w d_5 d_6
    r_play_1 r_play_2 r_play_3 r_play_4 r_play_5 r_play_6
    r_play_7 r_play_8 q_play z_bouc n_bouc up_duhem down_duhem tau_z V_c C_T R_T lambda_g q_e side_e lambda_y q_y w_y
"""
NEUTRAL: dict[str, float] = {
    **dict.fromkeys(_ZERO.split(), 0.0),
    **dict.fromkeys(_ONE.split(), 1.0),
    **dict.fromkeys(("S", "V_max"), math.inf),
    "beta_bouc": 0.5,
    "cells_l": 8.0,
    "v_s": 1e-4,
}

# Typical sizes of the states Q_1, Q_2, q, p, s, Q_3, V [C, C, m, kg m/s, m, C, V]: absolute tolerances follow them.
_SIZES = (4e-6, 4e-6, 1e-4, 1e-5, 1e-4, 4e-6, 75.0)

# States that are there only while their effect is: the parameter that must differ from its neutral value, and sizes.
_EXTRA: dict[str, tuple[str, tuple[float, ...]]] = {
    "at_slew": ("S", (75.0,)),
    "at_filter": ("zeta_V", (75.0,)),
    "at_polarisation": ("delta_z", (1.0,)),
    "at_warmth": ("C_T", (1.0,)),
    "at_mode": ("m_2", (1e-4, 1e-2)),
    "at_cells": ("k_l", (1e-4,) * 8),
    "at_bristle": ("F_l", (1e-6,)),
    "at_wen": ("k_w", (1e-5,)),
    "at_sensor": ("tau_y", (1e-4,)),
    "at_hysteron_5": ("inv_C_5", (4e-6,)),
    "at_hysteron_6": ("inv_C_6", (4e-6,)),
    "at_plays": ("c_play_1", (1e-4,) * 8),
    "at_bouc": ("c_bouc", (1e-4,)),
    "at_duhem": ("c_duhem", (1e-4,)),
    "at_blocked": ("omega_u", (75.0,)),
}
_RECORD = np.dtype([(n, np.float64) for n in (*TABLE, *NEUTRAL)] + [(n, np.int64) for n in _EXTRA])


def packed(parameters: Mapping[str, float]) -> tuple[NDArray[np.void], Array]:
    """Return what the compiled equations read, and typical sizes of the states.

    Args:
        parameters: those of ``TABLE``, and those of ``NEUTRAL`` that are not neutral; SI.

    Returns:
        A record (1,) of all parameters and of the position of each extra state, 0 where it is absent (no extra state
        comes first); and the sizes (states,). Absent states take no part: the paper's equations stay what they are.
    """
    record = np.zeros(1, _RECORD)
    values = {**NEUTRAL, **parameters}
    for name, value in values.items():
        record[name] = value
    sizes = list(_SIZES)
    for name, (needed, extra) in _EXTRA.items():
        if values[needed] != NEUTRAL[needed]:
            record[name] = len(sizes)
            sizes.extend(extra)
    return record, np.array(sizes)


def quasi_static_peak(base: Mapping[str, float]) -> float:
    """Return the displacement [m] at the largest voltage if no hysteron slipped: a size to place thresholds by."""
    return base["alpha"] * PEAK / stuck_stiffness(base)


def stuck_stiffness(base: Mapping[str, float]) -> float:
    """Return the stiffness [N/m] while no hysteron slips: ``k + α² Σ 1/C``, or ``k + α Σ c`` without hysterons."""
    elastance = 1.0 / base["C_1"] + 1.0 / base["C_2"]
    for number in FURTHER:
        elastance += base.get(f"inv_C_{number}", 0.0)
    other = sum(base.get(n, 0.0) for n in (*(f"c_play_{i}" for i in range(1, 9)), "c_bouc", "c_duhem"))
    return base["k"] + base["alpha"] ** 2 * elastance + base["alpha"] * other


@njit(cache=True)
def _dead_zone(e: float, rho: float, half: float) -> float:
    """Eq. (2): current through the nonlinear resistor at the voltage ``e``."""
    if e > half:
        return rho * (e - half)
    if e < -half:
        return rho * (e + half)
    return 0.0


@njit(cache=True)
def _commanded(t: float, drive: Array) -> tuple[float, float]:
    """Commanded voltage [V] and its time derivative [V/s] on one piece."""
    since = t - drive[4]
    phase = 2.0 * math.pi * (drive[2] * since + 0.5 * drive[3] * since * since)
    rate = drive[1] * 2.0 * math.pi * (drive[2] + drive[3] * since) * math.cos(phase)
    return drive[0] + drive[5] * since + drive[1] * math.sin(phase), drive[5] + rate


@njit(cache=True)
def _clipped(voltage: float, most: float, softness: float) -> float:
    """Hard limit (softness ``s`` zero), a parabola between ``(1 ± s) V_max`` that touches both, or ``tanh`` (one)."""
    if softness == 1.0:
        return most * math.tanh(voltage / most)
    beyond = abs(voltage) - (1.0 - softness) * most
    if beyond <= 0.0:
        return voltage
    if beyond >= 2.0 * softness * most:
        return math.copysign(most, voltage)
    return math.copysign(abs(voltage) - beyond * beyond / (4.0 * softness * most), voltage)


@njit(cache=True)
def _amplifier(t: float, x: Array, w: Any, drive: Array, out: Array) -> float:
    """Terminal voltage: high-pass, ripple, converter, dead band, slew limit, low-pass, saturation, in this order.

    High-pass: ``V = u − z``, ``ż = ω V``. Ripple: ``u (1 + κ_u sin(2π f t + φ))``.
    Slew limit: ``V̇ = u̇ + (u − V)/ε`` within ``±S``, so that without a limit there is no lag. Low-pass:
    ``τ V̇ = u − V``, or of second order ``τ V̇ = W``, ``τ Ẇ = u − V − 2ζ W``.
    """
    voltage, slope = _commanded(t, drive)
    if w.at_blocked > 0:
        voltage -= x[w.at_blocked]
        out[w.at_blocked] = w.omega_u * voltage
    if w.kappa_u != 0.0:
        voltage *= 1.0 + w.kappa_u * math.sin(2.0 * math.pi * w.f_u * t + w.phi_u)
    if w.Delta_u > 0.0:
        voltage = math.floor(voltage / w.Delta_u + 0.5) * w.Delta_u
    voltage = math.copysign(max(abs(voltage) - w.delta_V, 0.0), voltage)
    if w.at_slew > 0:
        behind = voltage - x[w.at_slew]
        out[w.at_slew] = min(max(slope + behind / _TRACKS, -w.S), w.S)
        voltage = x[w.at_slew]
    if w.tau_V > 0.0:
        if w.at_filter > 0:
            rate = x[w.at_filter]
            out[6] = rate / w.tau_V
            out[w.at_filter] = (voltage - x[6] - 2.0 * w.zeta_V * rate) / w.tau_V
        else:
            out[6] = (voltage - x[6]) / w.tau_V
        voltage = x[6]
    return _clipped(voltage, w.V_max, w.s_V)


@njit(cache=True)
def _coupling(t: float, x: Array, w: Any, voltage: float, out: Array) -> float:
    """``(1 + κ s) exp(κ_e s) (1 − κ_l lg(1 + t/5 ms)) (1 − δ z) (1 + κ_T T)``, ``τ_z ż = max(|V|/V_c − 1, 0) − z``."""
    factor = 1.0 + w.kappa_a * x[2] / Q_0
    if w.kappa_e != 0.0:
        factor *= math.exp(w.kappa_e * x[2] / Q_0)
    if w.kappa_l != 0.0:
        factor *= 1.0 - w.kappa_l * math.log10(1.0 + t / _AGES)
    if w.at_polarisation > 0:
        z = x[w.at_polarisation]
        out[w.at_polarisation] = (max(abs(voltage) / w.V_c - 1.0, 0.0) - z) / w.tau_z
        factor *= 1.0 - w.delta_z * z
    if w.at_warmth > 0:
        factor *= 1.0 + w.kappa_T * x[w.at_warmth]
    return factor


@njit(cache=True)
def _effort(linear: float, kappa: float) -> float:
    """Voltage ``e`` of a capacitor with ``e + κ e³ = Q/C`` (κ ≥ 0; the one real root of the cubic)."""
    if kappa == 0.0:
        return linear
    root = math.sqrt(3.0 * kappa)
    return 2.0 / root * math.sinh(math.asinh(1.5 * root * linear) / 3.0)


@njit(cache=True)
def _slipping(state: int, e: float, rho: float, half: float, flow: float, out: Array) -> float:
    """Power [W] lost in the dead zone of a hysteron, whose charge changes by ``flow`` [A] less what slips."""
    slips = _dead_zone(e, rho, half)
    out[state] = flow - slips
    return e * slips


@njit(cache=True)
def _other_hysteresis(x: Array, v: float, w: Any, out: Array) -> tuple[float, float]:
    """Voltage [V] of a hysteresis without hysterons (0 where there is none), and the power [W] lost in it."""
    q, drop, lost = x[2], 0.0, 0.0
    if w.at_bouc > 0:
        z = x[w.at_bouc]
        slips = abs(z / w.z_bouc) ** w.n_bouc * (w.beta_bouc * abs(v) * np.sign(z) + (1.0 - w.beta_bouc) * v)
        out[w.at_bouc] = v - slips
        drop, lost = w.c_bouc * z, w.c_bouc * z * slips
    if w.at_duhem > 0:
        z = x[w.at_duhem]
        slips = abs(v) * z / (w.up_duhem if v > 0.0 else w.down_duhem)
        out[w.at_duhem] = v - slips
        drop, lost = w.c_duhem * z, w.c_duhem * z * slips
    if w.at_plays > 0:
        bend = w.q_play * (math.sqrt(1.0 + (q / w.q_play) ** 2) - 1.0)
        low, high = q + (w.lean_play - w.gape_play) * bend, q + (w.lean_play + w.gape_play) * bend
        stiff = (w.c_play_1, w.c_play_2, w.c_play_3, w.c_play_4, w.c_play_5, w.c_play_6, w.c_play_7, w.c_play_8)
        reach = (w.r_play_1, w.r_play_2, w.r_play_3, w.r_play_4, w.r_play_5, w.r_play_6, w.r_play_7, w.r_play_8)
        for i in range(8):
            at = w.at_plays + i
            out[at] = (min(max(x[at], low - reach[i]), high + reach[i]) - x[at]) / _FOLLOWS
            drop += stiff[i] * (q - x[at])
            lost += stiff[i] * (q - x[at]) * out[at]
    return drop, w.alpha * lost


@njit(cache=True)
def _hysterons(t: float, x: Array, w: Any, flow: float, v: float, out: Array) -> tuple[float, float, float, float]:
    """``e_1, e_2``, the sum of all others [V] and the power [W] lost in the dead zones, at the current ``flow`` [A].

    Thresholds: ``½ d_i max(0, 1 + κ_d q/q₀) (1 + κ_v |v|) exp(κ_w t/3 s)``. Hysteron 3 may slip more past ``½ d_4``.
    """
    width = max(0.0, 1.0 + w.kappa_d * x[2] / Q_0) * (1.0 + w.kappa_v * abs(v))
    width *= math.exp(w.kappa_w * t / _GAIN_TIME)
    e_1, e_2, e_3 = _effort(x[0] / w.C_1, w.kappa_C), _effort(x[1] / w.C_2, w.kappa_C), x[5] * w.inv_C_3
    h_1, h_2 = _dead_zone(e_1, w.rho_1, 0.5 * w.d_1 * width), _dead_zone(e_2, w.rho_2, 0.5 * w.d_2 * width)
    out[0] = flow - h_1 - w.G * e_1
    out[1] = flow - h_2 - w.G * e_2
    loss = e_1 * h_1 + e_2 * h_2
    if w.inv_C_3 != 0.0:
        h_3 = _dead_zone(e_3, w.rho_3, 0.5 * w.d_3 * width)
        if w.rho_4 > 0.0:
            h_3 += _dead_zone(e_3, w.rho_4, 0.5 * w.d_4 * width)
        out[5] = flow - h_3 - w.G * e_3
        loss += e_3 * h_3
    others = e_3
    fifth, sixth = (w.at_hysteron_5, w.inv_C_5, w.rho_5, w.d_5), (w.at_hysteron_6, w.inv_C_6, w.rho_6, w.d_6)
    for at, elastance, rho, d in (fifth, sixth):
        if at > 0:
            e = x[at] * elastance
            loss += _slipping(at, e, rho, 0.5 * d * width, flow - w.G * e, out)
            others += e
    drop, lost = _other_hysteresis(x, v, w, out)
    return e_1, e_2, others + drop, loss + lost


@njit(cache=True)
def _spring_and_damper(t: float, q: float, v: float, w: Any) -> float:
    """``k (1 + κ_p sin) q (1 + κ₃ s² + κ₂ s + κ₂² s²/3 + κ₅ s⁴) + (b (1 + κ_b s²) (1 + κ_f [v > 0]) + c₂ |v|ⁿ) v``."""
    s = q / Q_0
    shape = 1.0 + w.kappa_3 * s**2 + w.kappa_2 * s + w.kappa_2**2 * s**2 / 3.0 + w.kappa_5 * s**4
    stiffness = w.k
    if w.kappa_p != 0.0:
        stiffness *= 1.0 + w.kappa_p * math.sin(2.0 * math.pi * w.f_p * t + w.phi_p)
    drag = w.c_2 * abs(v) if w.n_c2 == 1.0 else w.c_2 * abs(v) ** w.n_c2
    return stiffness * q * shape + (w.b * (1.0 + w.kappa_b * s**2) * (1.0 + w.kappa_f * (v > 0.0)) + drag) * v


@njit(cache=True)
def _guide(q: float, v: float, w: Any) -> float:
    """Cogging ``A_g sin(2π q/λ_g)``, cushion ``c_e max(±q − q_e, 0) v``, Reid's damper ``κ_r k |q| tanh(v/v_s)``."""
    force = w.c_e * max(w.side_e * q - w.q_e, 0.0) * v
    if w.A_g != 0.0:
        force += w.A_g * math.sin(2.0 * math.pi * q / w.lambda_g)
    if w.kappa_r != 0.0:
        force += w.kappa_r * w.k * abs(q) * math.tanh(v / w.v_s)
    return force


@njit(cache=True)
def _friction(x: Array, v: float, w: Any, out: Array) -> float:
    """``F_c g tanh(v/v_s)``, ``g = 1 + (r − 1) exp(−(v/v_st)²)``; bristles ``F_l z/z_l``, ``ż = v − |v| z/(z_l g)``."""
    force = 0.0
    if w.F_c == 0.0 and w.at_bristle == 0:
        return force
    stribeck = 1.0 + (w.r_s - 1.0) * math.exp(-((v / w.v_st) ** 2))
    if w.F_c != 0.0:
        force += w.F_c * stribeck * math.tanh(v / w.v_s)
    if w.at_bristle > 0:
        z = x[w.at_bristle]
        out[w.at_bristle] = v - abs(v) * z / (w.z_l * stribeck)
        force += w.F_l * z / w.z_l
    return force


@njit(cache=True)
def _memory(x: Array, v: float, w: Any, out: Array) -> float:
    """Maxwell cells ``ṡ = v − s/τ``, one or several spaced in log τ, and Bouc–Wen ``ż = v (1 − [vz > 0] |z/z_w|ⁿ)``."""
    force = 0.0
    if w.k_s != 0.0:
        out[4] = v - x[4] / w.tau_s
        force += w.k_s * x[4]
    if w.at_cells > 0:
        for j in range(int(w.cells_l)):
            cell = w.at_cells + j
            out[cell] = v - x[cell] / (w.tau_l * 10.0 ** (_DECADES * j / (w.cells_l - 1.0)))
            force += w.k_l * x[cell]
    if w.at_wen > 0:
        z = x[w.at_wen]
        out[w.at_wen] = v * (1.0 - (abs(z / w.z_w) ** w.n_w if v * z > 0.0 else 0.0))
        force += w.k_w * z
    return force


@njit(cache=True)
def _contact(q: float, w: Any) -> float:
    """A stop at ``±q_c``: ``k_c max(±q − q_c, 0)ⁿ``, n = 1 or Hertz's 3/2."""
    depth = w.side * q - w.q_c
    return w.side * w.k_c * depth**w.n_c if depth > 0.0 else 0.0


@njit(cache=True)
def _second_mass(x: Array, v: float, w: Any, out: Array) -> float:
    """Force on the first mass by a second one on it: ``ẋ₂ = v − v₂``, ``m₂ v̇₂ = k₂ x₂ + b₂ (v − v₂)``."""
    i = w.at_mode
    apart = v - x[i + 1]
    force = w.k_2 * x[i] + w.b_2 * apart
    out[i] = apart
    out[i + 1] = force / w.m_2
    return force


@njit(cache=True)
def rates(t: float, x: Array, w: Any, drive: Array) -> Array:
    """``ẋ``, (states,): Q_1, Q_2, q, p, s, Q_3, V and the extra states.

    Args:
        t: s.
        x: the states, SI.
        w: parameters, as ``packed`` makes them.
        drive: one piece of voltage, ``Piece.as_array``.
    """
    w = w[0]
    q, v = x[2], x[3] / w.m
    out = np.zeros(x.size)
    voltage = _amplifier(t, x, w, drive, out)
    alpha = w.alpha * _coupling(t, x, w, voltage, out)
    e_1, e_2, others, loss = _hysterons(t, x, w, alpha * v, v, out)
    force = alpha * (voltage * (1.0 + 0.5 * w.epsilon * voltage) - e_1 - e_2 - others)
    force -= _spring_and_damper(t, q, v, w)
    force -= _guide(q, v, w)
    force -= _friction(x, v, w, out)
    force -= _memory(x, v, w, out)
    force -= _contact(q, w)
    if w.at_mode > 0:
        force -= _second_mass(x, v, w, out)
    if w.A_b != 0.0:
        force += w.A_b * math.sin(2.0 * math.pi * w.f_b * t + w.phi_b)
    if w.at_warmth > 0:
        # Above ambient: C_T Ṫ = losses − T/R_T; the free length grows by x_T T.
        force += w.k * w.x_T * x[w.at_warmth]
        out[w.at_warmth] = (loss + w.b * v * v - x[w.at_warmth] / w.R_T) / w.C_T
    if w.at_sensor > 0:
        out[w.at_sensor] = (q - x[w.at_sensor]) / w.tau_y
    out[2] = v
    out[3] = force
    return out


@njit(cache=True)
def _pushed(t: float, x: Array, w: Any, drive: Array, force: Array) -> Array:
    """``rates`` with a force [N] on the mass, (n,) every ``FORCE_STEP`` and straight in between; empty for none."""
    out = rates(t, x, w, drive)
    if force.size > 0:
        at = t / FORCE_STEP
        i = min(int(at), force.size - 2)
        out[3] += force[i] + (at - i) * (force[i + 1] - force[i])
    return out


@njit(cache=True)
def march(x: Array, times: Array, w: Any, drive: Array, longest: float, force: Array) -> Array:
    """States at ``times``, (len(times), states), by Runge and Kutta's method in steps of at most ``longest`` [s].

    For voltages and forces with thousands of jumps or kinks, at each of which an adaptive method would begin again.
    """
    path = np.empty((times.size, x.size))
    path[0] = x
    for i in range(1, times.size):
        count = max(1, math.ceil((times[i] - times[i - 1]) / longest))
        h = (times[i] - times[i - 1]) / count
        for j in range(count):
            t = times[i - 1] + j * h
            k_1 = _pushed(t, x, w, drive, force)
            k_2 = _pushed(t + 0.5 * h, x + 0.5 * h * k_1, w, drive, force)
            k_3 = _pushed(t + 0.5 * h, x + 0.5 * h * k_2, w, drive, force)
            k_4 = _pushed(t + h, x + h * k_3, w, drive, force)
            x = x + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        path[i] = x
    return path


@njit(cache=True)
def play(q: Array, half: float) -> Array:
    """Output of a play of half-width ``half`` that starts in the middle, shape as ``q``."""
    y = np.empty_like(q)
    last = q[0]
    for i in range(q.size):
        last = min(max(last, q[i] - half), q[i] + half)
        y[i] = last
    return y


def scaled(q: Array, t: Array, values: Mapping[str, float]) -> Array:
    """``(1 + κ_y t/3 s) (q + a₂ q² + a₃ q³ + A sin(2π q/λ) + ½ δ tanh((q − q_y)/w))``, m; ``t`` from the start, s."""
    curved = q + values["a_2"] * q**2 + values["a_3"] * q**3
    curved += values["A_y"] * np.sin(2.0 * math.pi * q / values["lambda_y"])
    curved += 0.5 * values["delta_y"] * np.tanh((q - values["q_y"]) / values["w_y"])
    return curved * (1.0 + values["kappa_y"] * t / _GAIN_TIME)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """A random force on the mass and errors of the sampling instants; both are absent where they are empty.

    Attributes:
        force: (n,), N, at multiples of ``FORCE_STEP`` from the start of the recording on, straight in between.
        late: (samples,), s: the displacement is sampled that much later than its time says, the voltage is not.
    """

    force: Array = field(default_factory=lambda: np.zeros(0))
    late: Array = field(default_factory=lambda: np.zeros(0))


CALM = Disturbance()


def simulate(parameters: Mapping[str, float], excitation: Excitation, disturbance: Disturbance = CALM) -> Array:
    """Simulate the displacement from rest as an ideal sensor reports it at the sampling times.

    Args:
        parameters: those of ``TABLE``, and those of ``NEUTRAL`` that are not neutral; SI.
        excitation: continuous voltage; the solver stops and starts again where it jumps.
        disturbance: a random force, and errors of the sampling instants; none if left out.

    Returns:
        y, (samples,), m; the displacement q itself where no effect sits in the sensor.

    Raises:
        SolverFailed: LSODA gave up.
    """
    values = {**NEUTRAL, **parameters}
    w, sizes = packed(parameters)
    drive = excitation.delayed(values["tau_d"]) if values["tau_d"] > 0.0 else excitation
    parts = math.ceil(excitation.dt / _FINE) if values["delta_b"] > 0.0 else 1
    sampled, end = excitation.t * (1.0 - values["kappa_t"]), excitation.pieces[-1].end
    if disturbance.late.size > 0:
        sampled = np.clip(sampled + disturbance.late, 0.0, end)
    t = sampled
    if values["delta_b"] > 0.0:
        last = excitation.samples - (1 if disturbance.late.size == 0 else 0)
        t = np.minimum(np.arange(last * parts + 1, dtype=np.float64) * (excitation.dt / parts), end)
    q = _path(w, sizes, drive, t, disturbance.force)
    if values["delta_b"] > 0.0:
        q = play(q, values["delta_b"])
        q = q[::parts] if disturbance.late.size == 0 else np.interp(sampled, t, q)
    return scaled(q, excitation.t, values)


def _path(w: NDArray[np.void], sizes: Array, drive: Excitation, t: Array, force: Array) -> Array:
    """Return the displacement, delayed by a lagging sensor if there is one, at the times ``t``, (len(t),), m."""
    which = drive.piece_of(t)
    seen = int(w[0]["at_sensor"]) or 2
    q = np.empty(t.size)
    x = np.zeros(sizes.size)
    for i, piece in enumerate(drive.pieces):
        inside = which == i
        asked = np.where(np.abs(t[inside] - piece.start) < _SAME, piece.start, t[inside])
        asked = np.where(np.abs(asked - piece.end) < _SAME, piece.end, asked)
        times = np.unique(np.concatenate([[piece.start], asked, [piece.end]]))
        path = _solve(x, times, w, piece.as_array(), drive.name, sizes, force)
        q[inside] = path[np.searchsorted(times, asked), seen]
        x = path[-1]
    return q


def _solve(x: Array, times: Array, w: NDArray[np.void], drive: Array, name: str, sizes: Array, force: Array) -> Array:
    """Return states at ``times``, (len(times), states); the command is smooth on the whole stretch."""
    path: Array
    if w[0]["Delta_u"] > 0.0 or force.size > 0:
        path = march(x, times, w, drive, _STEP, force)
    else:
        path = _adaptive(x, times, w, drive, name, sizes)
    if not np.isfinite(path).all():
        first = times[int(np.argmin(np.isfinite(path).all(axis=1)))]
        raise SolverFailed(f"{name}: the simulation left the finite numbers at {first:g} s: draw another seed")
    return path


def _adaptive(x: Array, times: Array, w: NDArray[np.void], drive: Array, name: str, sizes: Array) -> Array:
    with warnings.catch_warnings():
        warnings.simplefilter("error", ODEintWarning)
        tolerance = {"rtol": _RELATIVE, "atol": _RELATIVE * 1e-2 * sizes}
        try:
            path: Array = odeint(rates, x, times, args=(w, drive), **tolerance, mxstep=200_000, tfirst=True)
        except ODEintWarning as warning:
            span = f"between {times[0]:g} s and {times[-1]:g} s"
            raise SolverFailed(f"{name}: LSODA stopped {span} ({warning}): draw another seed") from warning
    return path


def simulate_all(
    parameters: Mapping[str, float], plan: Sequence[Excitation], disturbances: Sequence[Disturbance] = ()
) -> tuple[Array, ...]:
    """Return ``simulate`` for every recording of a plan; ``disturbances``, where given, are one for each."""
    each = disturbances or [CALM] * len(plan)
    return tuple(simulate(parameters, e, d) for e, d in zip(plan, each, strict=True))
