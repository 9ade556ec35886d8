"""The effects that can be concealed: how their shapes are drawn, and what one strength means for each.

Every effect has one positive number, its strength, that makes it vanish as it goes to zero; everything else (time
constants, thresholds, signs) is its shape, drawn once. The search for the strength then has one dimension. Tables name
the effects: those that a catalogue lists in its own form, others of their forms, and those that no catalogue lists.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.generator.plans import PEAK, Array, Excitation
from studies.generator.world import Q_0, quasi_static_peak

Values = dict[str, float]
Rng = np.random.Generator
Base = Mapping[str, float]
Plan = Sequence[Excitation]

_FASTEST = 150.0  # Hz, highest line of the paper's recordings
_WARMTH = 1.0  # K, to which the losses of the paper's fastest sine warm the actuator
_LOSS = 0.05  # W, typical losses at that sine
_TYPICAL = 100e-6  # m, displacement at which the two terms of a curved sensor count alike


@dataclass(frozen=True)
class Concealed:
    """One effect with its shape drawn.

    Attributes:
        name: canonical name.
        guess: a strength to begin the search with.
        most: largest strength that still makes physical sense.
        law: strength -> parameters for the simulation (SI).
        added: strength and recording -> what is added to the output, (samples,), m.
        stated: strength -> its parameters as a person would state them, where these are not those of ``law``.
    """

    name: str
    guess: float
    most: float
    law: Callable[[float], Values] = lambda strength: {}
    added: Callable[[float, Excitation], Array] = lambda strength, excitation: np.zeros(excitation.samples)
    stated: Callable[[float], Values] | None = None


# Draws the shape of an effect for an actuator and its recordings.
Draw = Callable[[Rng, Base, Plan], Concealed]


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def either_sign(rng: Rng) -> float:
    """Draw plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def described(effect: Concealed, strength: float) -> Values:
    """Return the parameters of an effect as a person would state them, SI."""
    if effect.stated is not None:
        return effect.stated(strength)
    values = effect.law(strength)
    if "inv_C_3" in values:
        values = {"C_3": 1.0 / values["inv_C_3"], **{n: v for n, v in values.items() if n != "inv_C_3"}}
    if {"kappa_2", "kappa_3", "kappa_5", "kappa_a", "kappa_b", "kappa_d", "kappa_e"} & set(values):
        values["q_0"] = Q_0
    return values


def _one(name: str, guess: float, most: float, parameter: str, signed: bool = False) -> Draw:
    """Return how an effect is drawn whose strength is a parameter; a ``signed`` one has either sign."""

    def drawn(rng: Rng, base: Base, plan: Plan) -> Concealed:
        sign = either_sign(rng) if signed else 1.0
        return Concealed(name, guess, most, lambda z: {parameter: sign * z})

    return drawn


# Listed effects in the form of the catalogue


def _creep(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return a Maxwell cell ``k_s s`` with ``ṡ = v − s/τ``."""
    tau = log_uniform(rng, 0.05, 1.0)
    return Concealed("creep", 0.01 * base["k"], base["k"], lambda z: {"k_s": z, "tau_s": tau})


def _extra_hysteron(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return a third hysteron; its dead zone shrinks with 1/C_3: it slips at one displacement whatever its strength."""
    slips_at = rng.uniform(0.15, 0.6) * quasi_static_peak(base)
    tau = log_uniform(rng, 1e-5, 3e-3)

    def law(z: float) -> Values:
        return {"inv_C_3": z, "rho_3": 1.0 / (z * tau), "d_3": 2.0 * z * base["alpha"] * slips_at}

    return Concealed("extra_hysteron", 0.05 / base["C_1"], 3.0 / base["C_1"], law)


def _coulomb_friction(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``F_c tanh(v/v_s)``."""
    return Concealed("coulomb_friction", 0.01, 2.0, lambda z: {"F_c": z, "v_s": 1e-4})


def _amplifier_saturation(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return a hard limit of the voltage; the strength is the part of the largest voltage that is cut off."""
    return Concealed("amplifier_saturation", 0.02, 0.6, lambda z: {"V_max": PEAK * (1.0 - z)})


def _sensor_drift(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return a ramp, of the same rate in every recording, as of a steadily warming sensor."""
    rate = either_sign(rng)
    return Concealed("sensor_drift", 1e-7, 1e-3, added=lambda z, e: z * rate * e.t, stated=lambda z: {"rate": z * rate})


def _contact_stop(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``k_c max(±q − q_c, 0)`` on either side."""
    q_c, side = float(rng.uniform(0.5, 0.9)) * quasi_static_peak(base), either_sign(rng)
    return Concealed(
        "contact_stop",
        0.02 * base["k"],
        100.0 * base["k"],
        lambda z: {"k_c": z, "q_c": q_c, "side": side},
        stated=lambda z: {"k_c": z, "q_c": side * q_c},
    )


def _second_mode(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return a second mass by a spring and a damper on the first one, of drawn frequency and damping ratio."""
    omega = 2.0 * math.pi * log_uniform(rng, 0.5 * _FASTEST, 3.0 * _FASTEST)
    zeta = log_uniform(rng, 0.01, 0.3)

    def law(z: float) -> Values:
        return {"m_2": z, "k_2": z * omega**2, "b_2": 2.0 * zeta * z * omega}

    return Concealed("second_mode", 2e-3 * base["m"], base["m"], law)


def _depolarisation(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``α (1 − δ z)``, ``τ ż = max(|V|/V_c − 1, 0) − z``."""
    peak = max(float(np.max(np.abs(e.voltage(e.t)))) for e in plan)
    critical, tau = float(rng.uniform(0.3, 0.85)) * peak, log_uniform(rng, 0.05, 2.0)
    most = 0.8 / (peak / critical - 1.0)
    return Concealed("depolarisation", 0.01 * most, most, lambda z: {"delta_z": z, "tau_z": tau, "V_c": critical})


def _heated(name: str, guess: float, most: float, parameter: str) -> Draw:
    """Return how an effect of the temperature ``T``, ``C_T Ṫ = P − T/R_T``, is drawn; it has either sign."""

    def drawn(rng: Rng, base: Base, plan: Plan) -> Concealed:
        # Only κ_T/C_T and R_T C_T are in the recordings: R_T is set so that temperatures are of the order of a kelvin.
        sign, tau, resistance = either_sign(rng), log_uniform(rng, 0.1, 2.0), _WARMTH / _LOSS
        shape = {"C_T": tau / resistance, "R_T": resistance}
        return Concealed(name, guess, most, lambda z: {parameter: sign * z, **shape})

    return drawn


def _slew_limit(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``|V̇| ≤ S``; strength one is the steepest slope of all voltages between their jumps."""
    steepest = max(p.steepest for e in plan for p in e.pieces)
    return Concealed("slew_limit", 0.5, 20.0, lambda z: {"S": steepest / z})


def _sensor_nonlinearity(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``y = q + a₂ q² + a₃ q³``; the ratio of the two terms is the shape."""
    angle = float(rng.uniform(0.0, 2.0 * math.pi))

    def law(z: float) -> Values:
        return {"a_2": z * math.cos(angle) / _TYPICAL, "a_3": z * math.sin(angle) / _TYPICAL**2}

    return Concealed("sensor_nonlinearity", 5e-3, 0.2, law)


def _mains_pickup(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return lines at 50 or 60 Hz and up to two harmonics; every recording begins at a phase of its own."""
    mains, harmonics = float(rng.choice([50.0, 60.0])), int(rng.integers(1, 4))
    shares = {h: 1.0 if h == 1 else float(rng.uniform(0.1, 0.6)) for h in range(1, harmonics + 1)}
    phases = {e.name: rng.uniform(0.0, 2.0 * math.pi, harmonics) for e in plan}

    def added(z: float, excitation: Excitation) -> Array:
        t, own = excitation.t, phases[excitation.name]
        lines = [shares[h] * np.sin(2.0 * math.pi * h * mains * t + own[h - 1]) for h in shares]
        return z * np.sum(lines, axis=0)

    def stated(z: float) -> Values:
        return {"f_m": mains, **{f"A_{h}": z * share for h, share in shares.items()}}

    return Concealed("mains_pickup", 1e-7, 1e-4, added=added, stated=stated)


def _base_motion(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return a force ``A sin(2π f t + φ)``, ``t`` from the start of each recording: the same in every one."""
    frequency, phase = log_uniform(rng, 3.0, 300.0), float(rng.uniform(0.0, 2.0 * math.pi))
    return Concealed("base_motion", 5e-3, 5.0, lambda z: {"A_b": z, "f_b": frequency, "phi_b": phase})


# By name: the canonical location, and how the effect is drawn; the order is that of the cases of a stratum. Left out
# are what no recording of displacement can show and what needs no search.
_LISTED: dict[str, tuple[str, Draw]] = {
    "creep": ("mechanical", _creep),
    "extra_hysteron": ("hysteron", _extra_hysteron),
    # k q (1 + κ₃ s²), s = q/q₀
    "cubic_stiffness": ("mechanical", _one("cubic_stiffness", 0.01, 1.0, "kappa_3")),
    "coulomb_friction": ("mechanical", _coulomb_friction),
    # c₂ |v| v
    "quadratic_drag": ("mechanical", _one("quadratic_drag", 5.0, 1e4, "c_2")),
    # d_i (1 + κ_d s)
    "hysteresis_asymmetry": ("hysteron", _one("hysteresis_asymmetry", 0.02, 0.8, "kappa_d", signed=True)),
    # α (V + ½ ε V²)
    "electrostriction": ("coupling", _one("electrostriction", 1e-4, 0.01, "epsilon", signed=True)),
    # τ V̇ = u − V
    "amplifier_lowpass": ("amplifier", _one("amplifier_lowpass", 1e-5, 1e-2, "tau_V")),
    "amplifier_saturation": ("amplifier", _amplifier_saturation),
    "sensor_drift": ("sensor", _sensor_drift),
    "contact_stop": ("mechanical", _contact_stop),
    # k q (1 + κ₂ s + κ₂² s²/3)
    "quadratic_stiffness": ("mechanical", _one("quadratic_stiffness", 0.01, 1.5, "kappa_2", signed=True)),
    # Q̇_i −= G e_i for all hysterons
    "charge_leakage": ("electrical", _one("charge_leakage", 1e-8, 1e-3, "G")),
    # d_i (1 + κ_v |v|)
    "rate_dependent_threshold": ("hysteron", _one("rate_dependent_threshold", 0.1, 50.0, "kappa_v")),
    # α (1 + κ s)
    "displacement_coupling": ("coupling", _one("displacement_coupling", 5e-3, 0.5, "kappa_a", signed=True)),
    "depolarisation": ("coupling", _depolarisation),
    "second_mode": ("mechanical", _second_mode),
    # α (1 + κ_T T)
    "self_heating": ("thermal", _heated("self_heating", 0.05, 5.0, "kappa_T")),
    # V(t) = u(t − τ)
    "delay": ("amplifier", _one("delay", 1e-5, 1e-2, "tau_d")),
    "slew_limit": ("amplifier", _slew_limit),
    # τ ẏ = q − y
    "sensor_lag": ("sensor", _one("sensor_lag", 1e-5, 1e-2, "tau_y")),
    "sensor_nonlinearity": ("sensor", _sensor_nonlinearity),
    # a play of half-width δ
    "output_backlash": ("sensor", _one("output_backlash", 1e-7, 2e-5, "delta_b")),
    "mains_pickup": ("environment", _mains_pickup),
    "base_motion": ("environment", _base_motion),
}
LISTED = tuple(_LISTED)

# Effects of one set leave much the same trace in ordinary recordings.
ALIKE = (
    {"electrostriction", "displacement_coupling", "quadratic_stiffness", "sensor_nonlinearity", "hysteresis_asymmetry"},
    {"delay", "amplifier_lowpass", "sensor_lag"},
    {"cubic_stiffness", "contact_stop", "amplifier_saturation"},
    {"creep", "charge_leakage", "extra_hysteron"},
    {"self_heating", "depolarisation", "sensor_drift"},
)
# Two blocks of one of these act one after the other, in an order that an effect's name does not tell.
_ORDERED = ("amplifier", "sensor")


def may_be_paired(first: str, second: str) -> bool:
    """Tell whether two effects can be told apart in principle and act together in one way only."""
    if first == second or any({first, second} <= alike for alike in ALIKE):
        return False
    return not (LOCATIONS[first] == LOCATIONS[second] and LOCATIONS[first] in _ORDERED)


# Effects that no catalogue lists: what the diagnosis should call unknown


def _parametric_stiffness(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``k (1 + κ sin(2π f t + φ))``, ``t`` from the start of each recording."""
    frequency, phase = log_uniform(rng, 3.0, 300.0), float(rng.uniform(0.0, 2.0 * math.pi))
    return Concealed("parametric_stiffness", 2e-3, 0.5, lambda z: {"kappa_p": z, "f_p": frequency, "phi_p": phase})


_UNLISTED: dict[str, tuple[str, Draw]] = {
    # b (1 + κ (q/q₀)²)
    "regime_damper": ("mechanical", _one("regime_damper", 0.02, 50.0, "kappa_b")),
    # Q_i = C_i (1 + κ e_i²) e_i in both hysterons
    "curved_capacitance": ("hysteron", _one("curved_capacitance", 1e-5, 0.02, "kappa_C")),
    # V = Δ round(u/Δ): a coarse digital-to-analogue converter
    "quantised_amplifier": ("amplifier", _one("quantised_amplifier", 0.5, 20.0, "Delta_u")),
    # y = q (1 + κ t/3 s) in every recording
    "sensor_gain_drift": ("sensor", _one("sensor_gain_drift", 0.01, 1.0, "kappa_y", signed=True)),
    "parametric_stiffness": ("mechanical", _parametric_stiffness),
    # b (1 + κ) forwards, b backwards
    "directional_damper": ("mechanical", _one("directional_damper", 0.02, 50.0, "kappa_f")),
    # V = u ∓ δ beyond ±δ, zero between: crossover distortion
    "amplifier_dead_band": ("amplifier", _one("amplifier_dead_band", 0.05, 20.0, "delta_V")),
    # y(t) = q((1 − κ) t): the sensor's clock runs fast
    "sensor_clock": ("sensor", _one("sensor_clock", 1e-5, 0.05, "kappa_t")),
}
UNLISTED = tuple(_UNLISTED)


def _amplifier_ripple(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``V = u (1 + κ sin(2π f t + φ))``: the rectified mains, 100 or 120 Hz, move the gain."""
    frequency, phase = float(rng.choice([100.0, 120.0])), float(rng.uniform(0.0, 2.0 * math.pi))
    return Concealed("amplifier_ripple", 2e-3, 0.5, lambda z: {"kappa_u": z, "f_u": frequency, "phi_u": phase})


def _cogging(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``A sin(2π q/λ)``, too weak to make a second rest position."""
    length = log_uniform(rng, 2e-5, 8e-5)
    most = 0.9 * base["k"] * length / (2.0 * math.pi)
    return Concealed("cogging", 0.02 * most, most, lambda z: {"A_g": z, "lambda_g": length})


def _end_cushion(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``c max(±q − q_e, 0) v`` on either side."""
    q_e, side = float(rng.uniform(0.1, 0.6)) * quasi_static_peak(base), either_sign(rng)
    return Concealed("end_cushion", 2e4, 1e8, lambda z: {"c_e": z, "q_e": q_e, "side_e": side})


def _cyclic_error(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``y = q + A sin(2π q/λ)``: a scale of period λ, read so that y still grows with q."""
    period = log_uniform(rng, 1e-5, 4e-5)
    return Concealed("cyclic_error", 1e-7, 0.9 * period / (2.0 * math.pi), lambda z: {"A_y": z, "lambda_y": period})


def _scale_stitch(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``y = q + ½ δ tanh((q − q_y)/w)``: two parts of a scale meet at q_y, too far apart or too close."""
    seam, sign = float(rng.uniform(-0.6, 0.6)) * quasi_static_peak(base), either_sign(rng)
    width = log_uniform(rng, 3e-6, 1e-5)
    return Concealed("scale_stitch", 1e-7, 1.8 * width, lambda z: {"delta_y": sign * z, "q_y": seam, "w_y": width})


# Kinds of a stratum of their own, so that the cases of the others stay as they are.
_FURTHER_UNLISTED: dict[str, tuple[str, Draw]] = {
    "amplifier_ripple": ("amplifier", _amplifier_ripple),
    # V = u − z, ż = ω V: a capacitor in series
    "amplifier_high_pass": ("amplifier", _one("amplifier_high_pass", 0.02, 50.0, "omega_u")),
    "cogging": ("mechanical", _cogging),
    "end_cushion": ("mechanical", _end_cushion),
    # κ k |q| tanh(v/v_s): friction in proportion to the deflection
    "reid_damper": ("mechanical", _one("reid_damper", 2e-3, 0.5, "kappa_r")),
    # d_i exp(κ t/3 s) in every recording
    "threshold_drift": ("hysteron", _one("threshold_drift", 0.01, 2.0, "kappa_w", signed=True)),
    # α (1 − κ lg(1 + t/5 ms)), lg to the base of ten, in every recording
    "coupling_ageing": ("coupling", _one("coupling_ageing", 2e-3, 0.2, "kappa_l")),
    # a force k x T: losses make the actuator longer, or shorter
    "thermal_expansion": ("thermal", _heated("thermal_expansion", 5e-6, 2e-4, "x_T")),
    "cyclic_error": ("sensor", _cyclic_error),
    "scale_stitch": ("sensor", _scale_stitch),
}
FURTHER_UNLISTED = tuple(_FURTHER_UNLISTED)
_EVERY = {**_LISTED, **_UNLISTED, **_FURTHER_UNLISTED}
LOCATIONS = {name: location for name, (location, _) in _EVERY.items()}


def drawn(name: str, rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Draw the shape of a listed effect in its catalogue form, or of an unlisted one."""
    return _EVERY[name][1](rng, base, plan)


# What a seed of the demonstration may draw, in the order in which it draws; the others are there to be asked for.
EFFECTS = ("creep", "cubic_stiffness", "coulomb_friction", "quadratic_drag", "extra_hysteron", *LISTED[5:10])
ON_REQUEST = ("none", "contact_stop")


def draw(name: str, rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Draw an effect of the demonstration: one of ``EFFECTS`` or ``contact_stop``.

    A stop lies on the side of positive displacements, and the rate of a drift is stated of every recording.
    """
    if name == "contact_stop":
        q_c = float(rng.uniform(0.6, 0.9)) * quasi_static_peak(base)
        return Concealed(name, 0.02 * base["k"], 100.0 * base["k"], lambda z: {"k_c": z, "q_c": q_c})
    if name == "sensor_drift":
        rate, names = either_sign(rng), [f"rate_{e.name}" for e in plan]
        return Concealed(
            name, 1e-7, 1e-3, added=lambda z, e: z * rate * e.t, stated=lambda z: dict.fromkeys(names, z * rate)
        )
    return drawn(name, rng, base, plan)


# Listed effects in other forms than the catalogue gives them; the diagnosis should still give the listed name


def _log_creep(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return eight Maxwell cells of one stiffness, their time constants evenly spaced over four decades."""
    shortest = log_uniform(rng, 1e-3, 1e-2)
    return Concealed("creep", 2e-3 * base["k"], 0.3 * base["k"], lambda z: {"k_l": z, "tau_l": shortest})


def _three_creep_times(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return three Maxwell cells of one stiffness, their time constants two decades apart."""
    shape = {"tau_l": log_uniform(rng, 1e-3, 1e-2), "cells_l": 3.0}
    return Concealed("creep", 5e-3 * base["k"], 0.6 * base["k"], lambda z: {"k_l": z, **shape})


def _lugre_friction(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return bristles: ``F z/z_l``, ``ż = v − |v| z/(z_l g)``, ``g = 1 + (r − 1) exp(−(v/v_st)²)``."""
    z_l, r_s = log_uniform(rng, 1e-7, 1e-6), float(rng.uniform(1.0, 1.6))
    shape = {"z_l": z_l, "r_s": r_s, "v_st": log_uniform(rng, 1e-3, 1e-2)}
    return Concealed("coulomb_friction", 0.01, 2.0, lambda z: {"F_l": z, **shape})


def _stribeck_friction(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``F_c (1 + (r − 1) exp(−(v/v_st)²)) tanh(v/v_s)``, rounded more widely than the catalogue's."""
    v_s, r_s = log_uniform(rng, 3e-4, 2e-3), float(rng.uniform(1.2, 2.0))
    shape = {"v_s": v_s, "r_s": r_s, "v_st": log_uniform(rng, 3e-3, 3e-2)}
    return Concealed("coulomb_friction", 0.01, 2.0, lambda z: {"F_c": z, **shape})


def _hertz_contact(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``k_c max(±q − q_c, 0)^{3/2}``."""
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


def _tanh_saturation(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``V = V_max tanh(u/V_max)``; strength one is the largest voltage of all recordings."""
    return Concealed("amplifier_saturation", 0.1, 2.0, lambda z: {"V_max": PEAK / z, "s_V": 1.0})


def _rounded_saturation(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return straight, flat, and between ``(1 ± s) V_max`` a parabola; strength one is the largest of all voltages."""
    softness = float(rng.uniform(0.05, 0.4))
    return Concealed("amplifier_saturation", 1.05, 2.0, lambda z: {"V_max": PEAK / z, "s_V": softness})


def _second_order_lowpass(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``τ² V̈ + 2ζ τ V̇ + V = u``."""
    zeta = float(rng.uniform(0.5, 1.2))
    return Concealed("amplifier_lowpass", 1e-5, 2e-3, lambda z: {"tau_V": z, "zeta_V": zeta})


def _power_drag(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``c |v|ⁿ v`` with n = 1.5 or 2."""
    exponent = float(rng.choice([1.5, 2.0]))
    scale = 0.05 ** (1.0 - exponent)  # such that the strength is that of a quadratic drag at 0.05 m/s
    return Concealed("quadratic_drag", 5.0, 1e4, lambda z: {"c_2": scale * z, "n_c2": exponent})


def _two_slope_hysteron(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return a third hysteron that yields slowly beyond one threshold and fast beyond a second one."""
    slips_at = float(rng.uniform(0.15, 0.5)) * quasi_static_peak(base)
    further = float(rng.uniform(1.2, 1.8)) * slips_at
    slow, fast = log_uniform(rng, 1e-3, 1e-2), log_uniform(rng, 1e-5, 1e-3)

    def law(z: float) -> Values:
        widths = {"d_3": 2.0 * z * base["alpha"] * slips_at, "d_4": 2.0 * z * base["alpha"] * further}
        return {"inv_C_3": z, "rho_3": 1.0 / (z * slow), "rho_4": 1.0 / (z * fast), **widths}

    return Concealed("extra_hysteron", 0.05 / base["C_1"], 3.0 / base["C_1"], law)


def _bouc_wen_hysteron(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``k_w z`` with ``ż = v (1 − [v z > 0] |z/z_w|ⁿ)``."""
    shape = {"z_w": float(rng.uniform(0.15, 0.6)) * quasi_static_peak(base), "n_w": float(rng.uniform(1.0, 3.0))}
    return Concealed("extra_hysteron", 0.01 * base["k"], base["k"], lambda z: {"k_w": z, **shape})


def _random_walk_drift(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return a Wiener process of its own in every recording; the strength is its deviation after one second."""
    paths = {e.name: np.cumsum(rng.standard_normal(e.samples)) * math.sqrt(e.dt) for e in plan}
    return Concealed(
        "sensor_drift", 1e-7, 1e-4, added=lambda z, e: np.asarray(z * paths[e.name]), stated=lambda z: {"deviation": z}
    )


def _exponential_drift(rng: Rng, base: Base, plan: Plan) -> Concealed:
    """Return ``A (1 − exp(−t/τ))``, ``t`` from the start of each recording."""
    sign, tau = either_sign(rng), log_uniform(rng, 0.3, 3.0)
    return Concealed(
        "sensor_drift",
        1e-7,
        1e-3,
        added=lambda z, e: -sign * z * np.expm1(-e.t / tau),
        stated=lambda z: {"A": sign * z, "tau": tau},
    )


# By form: the effect, and how it is drawn.
FORMS: dict[str, tuple[str, Draw]] = {
    "log_creep": ("creep", _log_creep),
    "lugre_friction": ("coulomb_friction", _lugre_friction),
    "stribeck_friction": ("coulomb_friction", _stribeck_friction),
    "hertz_contact": ("contact_stop", _hertz_contact),
    "tanh_saturation": ("amplifier_saturation", _tanh_saturation),
    "rounded_saturation": ("amplifier_saturation", _rounded_saturation),
    "second_order_lowpass": ("amplifier_lowpass", _second_order_lowpass),
    # k q (1 + κ₅ (q/q₀)⁴)
    "quintic_stiffness": ("cubic_stiffness", _one("cubic_stiffness", 0.01, 1.0, "kappa_5")),
    "power_drag": ("quadratic_drag", _power_drag),
    "two_slope_hysteron": ("extra_hysteron", _two_slope_hysteron),
    "bouc_wen_hysteron": ("extra_hysteron", _bouc_wen_hysteron),
    "random_walk_drift": ("sensor_drift", _random_walk_drift),
    "exponential_drift": ("sensor_drift", _exponential_drift),
    # α exp(κ q/q₀)
    "exponential_coupling": ("displacement_coupling", _one("displacement_coupling", 5e-3, 0.4, "kappa_e", signed=True)),
    "three_creep_times": ("creep", _three_creep_times),
}
