"""The effects that can be concealed: how their shapes are drawn, and what one strength means for each.

Every effect has one positive number, its strength, that makes it vanish as it goes to zero; everything else (time
constants, thresholds, signs) is its shape, drawn once. The search for the strength then has one dimension.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from studies.generator.actuator import Q_0, Array
from studies.generator.excitation import PEAK, Excitation
from studies.generator.parameters import FURTHER

Values = dict[str, float]


@dataclass(frozen=True)
class Concealed:
    """One effect with its shape drawn.

    Attributes:
        name: canonical name.
        guess: a strength to begin the search with.
        most: largest strength that still makes physical sense.
        law: strength -> parameters for the simulation (SI).
        drift: strength -> drift rates of the sensor, one per recording, m/s.
        added: strength and recording -> what else is added to the output, (samples,), m.
        stated: strength -> its parameters as a person would state them, where these are not those of ``law``.
    """

    name: str
    guess: float
    most: float
    law: Callable[[float], Values]
    drift: Callable[[float], Values] = lambda strength: {}
    added: Callable[[float, Excitation], Array] = lambda strength, excitation: np.zeros(excitation.samples)
    stated: Callable[[float], Values] | None = None


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def either_sign(rng: np.random.Generator) -> float:
    """Plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def quasi_static_peak(base: Mapping[str, float]) -> float:
    """Displacement [m] at the largest voltage if no hysteron slipped: a size to place thresholds by."""
    return base["alpha"] * PEAK / stuck_stiffness(base)


def stuck_stiffness(base: Mapping[str, float]) -> float:
    """Stiffness [N/m] while no hysteron slips, ``k + α² Σ 1/C``, or ``k + α Σ c`` with another hysteresis."""
    elastance = 1.0 / base["C_1"] + 1.0 / base["C_2"]
    for number in FURTHER:
        elastance += base.get(f"inv_C_{number}", 0.0)
    other = sum(base.get(n, 0.0) for n in (*(f"c_play_{i}" for i in (1, 2, 3, 4)), "c_bouc"))
    return base["k"] + base["alpha"] ** 2 * elastance + base["alpha"] * other


def _creep(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    tau = log_uniform(rng, 0.05, 1.0)
    return Concealed("creep", 0.01 * base["k"], base["k"], lambda z: {"k_s": z, "tau_s": tau})


def _cubic_stiffness(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    return Concealed("cubic_stiffness", 0.01, 1.0, lambda z: {"kappa_3": z})


def _coulomb_friction(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    return Concealed("coulomb_friction", 0.01, 2.0, lambda z: {"F_c": z, "v_s": 1e-4})


def _quadratic_drag(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    return Concealed("quadratic_drag", 5.0, 1e4, lambda z: {"c_2": z})


def _extra_hysteron(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    # The dead zone shrinks with 1/C_3, so that the hysteron slips at the same displacement whatever its strength.
    slips_at = rng.uniform(0.15, 0.6) * quasi_static_peak(base)
    tau = log_uniform(rng, 1e-5, 3e-3)

    def law(z: float) -> Values:
        return {"inv_C_3": z, "rho_3": 1.0 / (z * tau), "d_3": 2.0 * z * base["alpha"] * slips_at}

    return Concealed("extra_hysteron", 0.05 / base["C_1"], 3.0 / base["C_1"], law)


def _hysteresis_asymmetry(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    sign = either_sign(rng)
    return Concealed("hysteresis_asymmetry", 0.02, 0.8, lambda z: {"kappa_d": sign * z})


def _electrostriction(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    sign = either_sign(rng)
    return Concealed("electrostriction", 1e-4, 0.01, lambda z: {"epsilon": sign * z})


def _amplifier_lowpass(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    return Concealed("amplifier_lowpass", 1e-5, 1e-2, lambda z: {"tau_V": z})


def _amplifier_saturation(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    return Concealed("amplifier_saturation", 0.02, 0.6, lambda z: {"V_max": PEAK * (1.0 - z)})


def _sensor_drift(rng: np.random.Generator, base: Mapping[str, float], names: Sequence[str]) -> Concealed:
    # A steadily warming sensor: the same rate in every recording.
    slope = either_sign(rng)
    return Concealed("sensor_drift", 1e-7, 1e-3, lambda z: {}, lambda z: dict.fromkeys(names, z * slope))


def _contact_stop(rng: np.random.Generator, base: Mapping[str, float]) -> Concealed:
    q_c = float(rng.uniform(0.6, 0.9)) * quasi_static_peak(base)
    return Concealed("contact_stop", 0.02 * base["k"], 100.0 * base["k"], lambda z: {"k_c": z, "q_c": q_c})


_DRAWS: dict[str, Callable[[np.random.Generator, Mapping[str, float]], Concealed]] = {
    "creep": _creep,
    "cubic_stiffness": _cubic_stiffness,
    "coulomb_friction": _coulomb_friction,
    "quadratic_drag": _quadratic_drag,
    "extra_hysteron": _extra_hysteron,
    "hysteresis_asymmetry": _hysteresis_asymmetry,
    "electrostriction": _electrostriction,
    "amplifier_lowpass": _amplifier_lowpass,
    "amplifier_saturation": _amplifier_saturation,
    "contact_stop": _contact_stop,
}

# What a seed may draw; the others are there to be asked for.
EFFECTS = (*(name for name in _DRAWS if name != "contact_stop"), "sensor_drift")
ON_REQUEST = ("none", "contact_stop")


def draw(name: str, rng: np.random.Generator, base: Mapping[str, float], plan: Sequence[Excitation]) -> Concealed:
    """An effect with its shape drawn; ``name`` is one of ``EFFECTS`` or ``contact_stop``."""
    if name == "sensor_drift":
        return _sensor_drift(rng, base, [excitation.name for excitation in plan])
    return _DRAWS[name](rng, base)


def drifts(effect: Concealed, strength: float, plan: Sequence[Excitation]) -> tuple[Array, ...]:
    """What is added to the output of each recording, (samples,), m."""
    rates = effect.drift(strength)
    return tuple(rates.get(e.name, 0.0) * e.t + effect.added(strength, e) for e in plan)


def described(effect: Concealed, strength: float) -> Values:
    """The parameters of an effect as a person would state them, SI."""
    if effect.stated is not None:
        return effect.stated(strength)
    values = effect.law(strength)
    if "inv_C_3" in values:
        values = {"C_3": 1.0 / values["inv_C_3"], "rho_3": values["rho_3"], "d_3": values["d_3"]}
    if {"kappa_2", "kappa_3", "kappa_5", "kappa_a", "kappa_b", "kappa_d", "kappa_e"} & set(values):
        values["q_0"] = Q_0
    rates = {f"rate_{name}": rate for name, rate in effect.drift(strength).items()}
    return {**values, **rates}
