"""Further effects that can be concealed inside the actuator, in the form that the catalogue gives them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from studies.generator.concealed import Concealed, Values, either_sign, log_uniform, quasi_static_peak
from studies.generator.excitation import Excitation

_FASTEST = 150.0  # Hz, highest line of the paper's recordings
_WARMTH = 1.0  # K, to which the losses of the paper's fastest sine warm the actuator
_LOSS = 0.05  # W, typical losses at that sine

Rng = np.random.Generator
Base = Mapping[str, float]
Plan = Sequence[Excitation]


def quadratic_stiffness(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``k q (1 + κ₂ s + κ₂² s²/3)``."""
    sign = either_sign(rng)
    return Concealed("quadratic_stiffness", 0.01, 1.5, lambda z: {"kappa_2": sign * z})


def contact_stop(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``k_c max(±q − q_c, 0)`` on either side."""
    q_c, side = float(rng.uniform(0.5, 0.9)) * quasi_static_peak(base), either_sign(rng)
    return Concealed(
        "contact_stop",
        0.02 * base["k"],
        100.0 * base["k"],
        lambda z: {"k_c": z, "q_c": q_c, "side": side},
        stated=lambda z: {"k_c": z, "q_c": side * q_c},
    )


def second_mode(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """A second mass by a spring and a damper on the first one; its frequency and damping ratio are its shape."""
    omega = 2.0 * math.pi * log_uniform(rng, 0.5 * _FASTEST, 3.0 * _FASTEST)
    zeta = log_uniform(rng, 0.01, 0.3)

    def law(z: float) -> Values:
        return {"m_2": z, "k_2": z * omega**2, "b_2": 2.0 * zeta * z * omega}

    return Concealed("second_mode", 2e-3 * base["m"], base["m"], law)


def charge_leakage(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``Q̇_i −= G e_i`` for all hysterons."""
    return Concealed("charge_leakage", 1e-8, 1e-3, lambda z: {"G": z})


def rate_dependent_threshold(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``d_i (1 + κ |v|)``."""
    return Concealed("rate_dependent_threshold", 0.1, 50.0, lambda z: {"kappa_v": z})


def displacement_coupling(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``α (1 + κ q/q₀)``."""
    sign = either_sign(rng)
    return Concealed("displacement_coupling", 5e-3, 0.5, lambda z: {"kappa_a": sign * z})


def depolarisation(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``α (1 − δ z)``, ``τ ż = max(|V|/V_c − 1, 0) − z``."""
    peak = max(float(np.max(np.abs(e.voltage(e.t)))) for e in plan)
    critical, tau = float(rng.uniform(0.3, 0.85)) * peak, log_uniform(rng, 0.05, 2.0)
    most = 0.8 / (peak / critical - 1.0)
    return Concealed("depolarisation", 0.01 * most, most, lambda z: {"delta_z": z, "tau_z": tau, "V_c": critical})


def self_heating(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``α (1 + κ_T T)``, ``C_T Ṫ = P − T/R_T``."""
    # Only κ_T/C_T and R_T C_T are in the recordings: R_T is set so that temperatures are of the order of a kelvin.
    sign, tau = either_sign(rng), log_uniform(rng, 0.1, 2.0)
    resistance = _WARMTH / _LOSS

    def law(z: float) -> Values:
        return {"kappa_T": sign * z, "C_T": tau / resistance, "R_T": resistance}

    return Concealed("self_heating", 0.05, 5.0, law)


def base_motion(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """A force ``A sin(2π f t + φ)``, ``t`` from the start of each recording: the same in every one."""
    frequency, phase = log_uniform(rng, 3.0, 300.0), float(rng.uniform(0.0, 2.0 * math.pi))
    return Concealed("base_motion", 5e-3, 5.0, lambda z: {"A_b": z, "f_b": frequency, "phi_b": phase})


INNER = {
    "quadratic_stiffness": quadratic_stiffness,
    "contact_stop": contact_stop,
    "second_mode": second_mode,
    "charge_leakage": charge_leakage,
    "rate_dependent_threshold": rate_dependent_threshold,
    "displacement_coupling": displacement_coupling,
    "depolarisation": depolarisation,
    "self_heating": self_heating,
    "base_motion": base_motion,
}
