"""Effects that no catalogue lists: what the diagnosis should call unknown."""

from __future__ import annotations

import math

from studies.generator.concealed import Concealed, either_sign, log_uniform
from studies.generator.inner import Base, Plan, Rng


def regime_damper(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``b (1 + κ (q/q₀)²)``."""
    return Concealed("regime_damper", 0.02, 50.0, lambda z: {"kappa_b": z})


def curved_capacitance(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``Q_i = C_i (1 + κ e_i²) e_i`` in both hysterons."""
    return Concealed("curved_capacitance", 1e-5, 0.02, lambda z: {"kappa_C": z})


def quantised_amplifier(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``V = Δ round(u/Δ)``: a coarse digital-to-analogue converter."""
    return Concealed("quantised_amplifier", 0.5, 20.0, lambda z: {"Delta_u": z})


def sensor_gain_drift(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``y = q (1 + κ t/3 s)`` in every recording."""
    sign = either_sign(rng)
    return Concealed("sensor_gain_drift", 0.01, 1.0, lambda z: {"kappa_y": sign * z})


def parametric_stiffness(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``k (1 + κ sin(2π f t + φ))``, ``t`` from the start of each recording."""
    frequency, phase = log_uniform(rng, 3.0, 300.0), float(rng.uniform(0.0, 2.0 * math.pi))
    return Concealed("parametric_stiffness", 2e-3, 0.5, lambda z: {"kappa_p": z, "f_p": frequency, "phi_p": phase})


def directional_damper(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``b (1 + κ)`` forwards, ``b`` backwards."""
    return Concealed("directional_damper", 0.02, 50.0, lambda z: {"kappa_f": z})


def amplifier_dead_band(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``V = u ∓ δ`` beyond ``±δ``, zero between: crossover distortion."""
    return Concealed("amplifier_dead_band", 0.05, 20.0, lambda z: {"delta_V": z})


def sensor_clock(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """``y(t) = q((1 − κ) t)``: the sensor's clock runs fast."""
    return Concealed("sensor_clock", 1e-5, 0.05, lambda z: {"kappa_t": z})


UNLISTED = {
    "regime_damper": regime_damper,
    "curved_capacitance": curved_capacitance,
    "quantised_amplifier": quantised_amplifier,
    "sensor_gain_drift": sensor_gain_drift,
    "parametric_stiffness": parametric_stiffness,
    "directional_damper": directional_damper,
    "amplifier_dead_band": amplifier_dead_band,
    "sensor_clock": sensor_clock,
}
UNLISTED_LOCATIONS = {
    "regime_damper": "mechanical",
    "curved_capacitance": "hysteron",
    "quantised_amplifier": "amplifier",
    "sensor_gain_drift": "sensor",
    "parametric_stiffness": "mechanical",
    "directional_damper": "mechanical",
    "amplifier_dead_band": "amplifier",
    "sensor_clock": "sensor",
}
