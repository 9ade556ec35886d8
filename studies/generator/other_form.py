"""Listed effects in other forms than the catalogue gives them; the diagnosis should still give the listed name."""

from __future__ import annotations

import math

import numpy as np

from studies.generator.concealed import Concealed, Values, either_sign, log_uniform, quasi_static_peak
from studies.generator.excitation import PEAK, Excitation
from studies.generator.inner import Base, Plan, Rng
from studies.generator.parameters import Array


def log_creep(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Eight Maxwell cells of one stiffness, their time constants evenly spaced over four decades."""
    shortest = log_uniform(rng, 1e-3, 1e-2)
    return Concealed("creep", 2e-3 * base["k"], 0.3 * base["k"], lambda z: {"k_l": z, "tau_l": shortest})


def three_creep_times(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Three Maxwell cells of one stiffness, their time constants two decades apart."""
    shortest = log_uniform(rng, 1e-3, 1e-2)
    shape = {"tau_l": shortest, "cells_l": 3.0}
    return Concealed("creep", 5e-3 * base["k"], 0.6 * base["k"], lambda z: {"k_l": z, **shape})


def lugre_friction(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Bristles: ``F z/z_l``, ``ż = v − |v| z/(z_l g)``, ``g = 1 + (r − 1) exp(−(v/v_st)²)``."""
    shape = {
        "z_l": log_uniform(rng, 1e-7, 1e-6),
        "r_s": float(rng.uniform(1.0, 1.6)),
        "v_st": log_uniform(rng, 1e-3, 1e-2),
    }
    return Concealed("coulomb_friction", 0.01, 2.0, lambda z: {"F_l": z, **shape})


def stribeck_friction(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``F_c (1 + (r − 1) exp(−(v/v_st)²)) tanh(v/v_s)``, rounded more widely than the catalogue's."""
    shape = {
        "v_s": log_uniform(rng, 3e-4, 2e-3),
        "r_s": float(rng.uniform(1.2, 2.0)),
        "v_st": log_uniform(rng, 3e-3, 3e-2),
    }
    return Concealed("coulomb_friction", 0.01, 2.0, lambda z: {"F_c": z, **shape})


def hertz_contact(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``k_c max(±q − q_c, 0)^{3/2}``."""
    peak, side = quasi_static_peak(base), either_sign(rng)
    q_c = float(rng.uniform(0.3, 0.8)) * peak
    stiff = base["k"] / math.sqrt(peak - q_c)
    return Concealed(
        "contact_stop",
        0.02 * stiff,
        100.0 * stiff,
        lambda z: {"k_c": z, "q_c": q_c, "side": side, "n_c": 1.5},
        stated=lambda z: {"k_c": z, "q_c": side * q_c},
    )


def tanh_saturation(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``V = V_max tanh(u/V_max)``; strength one is the largest voltage of all recordings."""
    return Concealed("amplifier_saturation", 0.1, 2.0, lambda z: {"V_max": PEAK / z, "s_V": 1.0})


def rounded_saturation(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Straight, flat, and between ``(1 ± s) V_max`` a parabola; strength one is the largest of all voltages."""
    softness = float(rng.uniform(0.05, 0.4))
    return Concealed("amplifier_saturation", 1.05, 2.0, lambda z: {"V_max": PEAK / z, "s_V": softness})


def second_order_lowpass(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``τ² V̈ + 2ζ τ V̇ + V = u``."""
    zeta = float(rng.uniform(0.5, 1.2))
    return Concealed("amplifier_lowpass", 1e-5, 2e-3, lambda z: {"tau_V": z, "zeta_V": zeta})


def quintic_stiffness(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``k q (1 + κ₅ (q/q₀)⁴)``."""
    return Concealed("cubic_stiffness", 0.01, 1.0, lambda z: {"kappa_5": z})


def power_drag(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``c |v|ⁿ v`` with n = 1.5 or 2."""
    exponent = float(rng.choice([1.5, 2.0]))
    scale = 0.05 ** (1.0 - exponent)  # such that the strength is that of a quadratic drag at 0.05 m/s
    return Concealed("quadratic_drag", 5.0, 1e4, lambda z: {"c_2": scale * z, "n_c2": exponent})


def two_slope_hysteron(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """A third hysteron that yields slowly beyond one threshold and fast beyond a second one."""
    slips_at = float(rng.uniform(0.15, 0.5)) * quasi_static_peak(base)
    further = float(rng.uniform(1.2, 1.8)) * slips_at
    slow, fast = log_uniform(rng, 1e-3, 1e-2), log_uniform(rng, 1e-5, 1e-3)

    def law(z: float) -> Values:
        widths = {"d_3": 2.0 * z * base["alpha"] * slips_at, "d_4": 2.0 * z * base["alpha"] * further}
        return {"inv_C_3": z, "rho_3": 1.0 / (z * slow), "rho_4": 1.0 / (z * fast), **widths}

    def stated(z: float) -> Values:
        return {"C_3": 1.0 / z, **{n: value for n, value in law(z).items() if n != "inv_C_3"}}

    return Concealed("extra_hysteron", 0.05 / base["C_1"], 3.0 / base["C_1"], law, stated=stated)


def bouc_wen_hysteron(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``k_w z`` with ``ż = v (1 − [v z > 0] |z/z_w|ⁿ)``."""
    shape = {"z_w": float(rng.uniform(0.15, 0.6)) * quasi_static_peak(base), "n_w": float(rng.uniform(1.0, 3.0))}
    return Concealed("extra_hysteron", 0.01 * base["k"], base["k"], lambda z: {"k_w": z, **shape})


def random_walk_drift(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """A Wiener process of its own in every recording; the strength is its deviation after one second."""
    paths = {e.name: np.cumsum(rng.standard_normal(e.samples)) * math.sqrt(e.dt) for e in plan}

    def added(z: float, excitation: Excitation) -> Array:
        walk: Array = z * paths[excitation.name]
        return walk

    return Concealed("sensor_drift", 1e-7, 1e-4, lambda z: {}, added=added, stated=lambda z: {"deviation": z})


def exponential_drift(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``A (1 − exp(−t/τ))``, ``t`` from the start of each recording."""
    sign, tau = either_sign(rng), log_uniform(rng, 0.3, 3.0)
    return Concealed(
        "sensor_drift",
        1e-7,
        1e-3,
        lambda z: {},
        added=lambda z, excitation: -sign * z * np.expm1(-excitation.t / tau),
        stated=lambda z: {"A": sign * z, "tau": tau},
    )


def exponential_coupling(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``α exp(κ q/q₀)``."""
    sign = either_sign(rng)
    return Concealed("displacement_coupling", 5e-3, 0.4, lambda z: {"kappa_e": sign * z})


FORMS = {
    "log_creep": ("creep", log_creep),
    "lugre_friction": ("coulomb_friction", lugre_friction),
    "stribeck_friction": ("coulomb_friction", stribeck_friction),
    "hertz_contact": ("contact_stop", hertz_contact),
    "tanh_saturation": ("amplifier_saturation", tanh_saturation),
    "rounded_saturation": ("amplifier_saturation", rounded_saturation),
    "second_order_lowpass": ("amplifier_lowpass", second_order_lowpass),
    "quintic_stiffness": ("cubic_stiffness", quintic_stiffness),
    "power_drag": ("quadratic_drag", power_drag),
    "two_slope_hysteron": ("extra_hysteron", two_slope_hysteron),
    "bouc_wen_hysteron": ("extra_hysteron", bouc_wen_hysteron),
    "random_walk_drift": ("sensor_drift", random_walk_drift),
    "exponential_drift": ("sensor_drift", exponential_drift),
    "exponential_coupling": ("displacement_coupling", exponential_coupling),
    "three_creep_times": ("creep", three_creep_times),
}
