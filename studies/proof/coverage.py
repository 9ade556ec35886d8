"""The distance of estimates from the truth in their own standard errors, and the coverage of intervals.

An error is a normal deviate of the stated 95 % interval: 1.96 where the truth lies at one of its ends, in proportion
inside. Where no interval is stated the standard error takes its place.

Voltage and displacement leave one common factor of all impedances free, which the stated mass fixes. Where the stated
mass is exact, errors of what scales with it say nothing of its stated deviation: those parameters are left out there.
Where it is drawn, its error moves them all together, so that the base parameters of one case are hardly more than one
draw. `noise_errors` therefore compares with the truth at the stated mass, in intervals that take the mass as exact.
The mass itself is left out always, for its interval is the anchor's own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from scipy.stats import norm

from studies.generator import Sealed

SHARES = (0.68, 0.95)
_SHARE = 0.95  # of the intervals that are stated
_REFERENCE = 100e-6  # m, displacement that strengths of a seal refer to

# By effect and parameter of the catalogue: the seal's name, and the power of the reference displacement, whose own
# name follows. What the recordings know in products only, as of self-heating, is not compared.
_SEALED: dict[str, dict[str, tuple[str, int, str]]] = {
    "creep": {"k_s": ("k_s", 0, ""), "tau_s": ("tau_s", 0, "")},
    "extra_hysteron": {"C_x": ("C_3", 0, ""), "rho_x": ("rho_3", 0, ""), "d_x": ("d_3", 0, "")},
    "cubic_stiffness": {"kappa_3": ("kappa_3", 2, "q_0")},
    "coulomb_friction": {"F_c": ("F_c", 0, "")},
    "quadratic_drag": {"c_2": ("c_2", 0, "")},
    "hysteresis_asymmetry": {"kappa_d": ("kappa_d", 1, "q_d")},
    "electrostriction": {"epsilon": ("epsilon", 0, "")},
    "amplifier_lowpass": {"tau_a": ("tau_V", 0, "")},
    "amplifier_saturation": {"V_max": ("V_max", 0, "")},
    "sensor_drift": {"drift_rate": ("rate", 0, "")},
    "contact_stop": {"k_c": ("k_c", 0, ""), "g_c": ("q_c", 0, "")},
    "quadratic_stiffness": {"kappa_2": ("kappa_2", 1, "q_2")},
    "charge_leakage": {"G": ("G", 0, "")},
    "rate_dependent_threshold": {"kappa_v": ("kappa_v", 0, "")},
    "displacement_coupling": {"kappa_a": ("kappa_a", 1, "q_a")},
    "depolarisation": {"delta_z": ("delta_z", 0, ""), "tau_z": ("tau_z", 0, ""), "V_c": ("V_c", 0, "")},
    "second_mode": {"m_2": ("m_2", 0, ""), "k_2": ("k_2", 0, ""), "b_2": ("b_2", 0, "")},
    "delay": {"tau_d": ("tau_d", 0, "")},
    "slew_limit": {"S": ("S", 0, "")},
    "sensor_lag": {"tau_y": ("tau_y", 0, "")},
    "sensor_nonlinearity": {"a_2": ("a_2", 0, ""), "a_3": ("a_3", 0, "")},
    "output_backlash": {"delta_b": ("delta_b", 0, "")},
    "mains_pickup": {"f_m": ("f_m", 0, "")},
    "base_motion": {"f_b": ("f_b", 0, "")},
}
# Impedances, admittances and forces per volt: they scale with the common factor.
_SCALED = {"k", "b", "alpha", "k_s", "F_c", "c_2", "k_c", "m_2", "k_2", "b_2", "G", "C_x", "rho_x"}

Estimates = Mapping[str, Mapping[str, Any]]
# The estimate and the truth, by the name of the parameter.
Pairs = dict[str, tuple[Mapping[str, Any], float]]


def base_errors(estimates: Estimates, sealed: Sealed) -> dict[str, float]:
    """Error, as a normal deviate, of each base parameter that has an interval; none where the numbers of hysterons
    differ.

    Args:
        estimates: ``{"value", "std", "interval_95"}`` by name; hysterons have no order, they are compared in that of
            their dead zones.
    """
    return _errors(_base_pairs(estimates, sealed), sealed)


def effect_errors(missing: Iterable[Mapping[str, Any]], sealed: Sealed) -> dict[str, float]:
    """The same of the parameters of each rightly named effect whose law has the form of the catalogue."""
    return _errors(_effect_pairs(missing, sealed), sealed)


def noise_errors(
    estimates: Estimates, missing: Iterable[Mapping[str, Any]], sealed: Sealed
) -> tuple[dict[str, float], dict[str, float]]:
    """The same of base and effect parameters by the noise alone: the stated mass counts as exact, and what scales with
    it is compared with the truth times the factor by which the stated mass is wrong.

    Args:
        estimates: with ``"interval_95_anchors_exact"`` in place of the interval; those without it are left out.
    """
    factor = sealed.stated_mass / sealed.base["m"] if sealed.stated_mass > 0.0 else 1.0

    def alone(pairs: Pairs) -> dict[str, float]:
        found = {}
        for name, (_, true) in pairs.items():
            estimate = estimates.get(name)
            ends = (estimate or {}).get("interval_95_anchors_exact")
            if estimate is not None and ends is not None:
                at = true * factor if _scaled(name) else true
                found[name] = _deviate(float(estimate["value"]), ends, at)
        return found

    return alone(_base_pairs(estimates, sealed)), alone(_effect_pairs(missing, sealed))


def _base_pairs(estimates: Estimates, sealed: Sealed) -> Pairs:
    orders = [hysterons_of(table) for table in (estimates, sealed.base)]
    own = sorted(orders[0], key=lambda i: float(estimates[f"d_{i}"]["value"]))
    true = sorted(orders[1], key=lambda i: sealed.base[f"d_{i}"])
    if len(own) != len(true) or not estimates:
        return {}
    names = {n: n for n in ("k", "b", "alpha")}
    names |= {f"{n}_{i}": f"{n}_{j}" for i, j in zip(own, true, strict=True) for n in ("C", "rho", "d")}
    return {n: (estimates[n], sealed.base[of]) for n, of in names.items() if n in estimates}


def hysterons_of(table: Iterable[str]) -> list[str]:
    """Numbers of the hysterons among the names of parameters."""
    return sorted(n[2:] for n in table if n.startswith("d_") and n[2:].isdigit())


def _effect_pairs(missing: Iterable[Mapping[str, Any]], sealed: Sealed) -> Pairs:
    """None where the actuator has another hysteresis, for then no model is right and no interval has to hold."""
    pairs: Pairs = {}
    if sealed.base_family:
        return pairs
    truth = {**sealed.background, **(sealed.parameters if sealed.form == "canonical" else {})}
    concealed = (*(sealed.effects if sealed.form == "canonical" else ()), *sealed.background_effects)
    for entry in missing:
        effect, estimates = str(entry["effect"]), entry.get("parameters") or {}
        for name, (of, power, reference) in _SEALED.get(effect, {}).items():
            if effect not in concealed or of not in truth or name not in estimates:
                continue
            scale = (float(estimates[reference]["value"]) / _REFERENCE) ** power if power else 1.0
            pairs[name] = (estimates[name], truth[of] * scale)
    return pairs


def _errors(pairs: Pairs, sealed: Sealed) -> dict[str, float]:
    anchored = sealed.stated_mass > 0.0
    found = {}
    for name, (estimate, true) in pairs.items():
        if not anchored and _scaled(name):
            continue
        std, value, ends = estimate.get("std"), float(estimate["value"]), estimate.get("interval_95")
        if ends is not None:
            found[name] = _deviate(value, ends, true)
        elif std is not None and 0.0 < float(std) < math.inf:
            found[name] = (value - true) / float(std)
    return found


def _deviate(value: float, ends: Sequence[float], true: float) -> float:
    """Error over the part of a 95 % interval on the side of the truth, times 1.96."""
    reach = value - float(ends[0]) if true < value else float(ends[1]) - value
    return float(norm.ppf(0.5 + 0.5 * _SHARE)) * (value - true) / reach


def _scaled(name: str) -> bool:
    """Whether the common factor moves a parameter; hysterons are numbered."""
    kind, _, number = name.partition("_")
    return name in _SCALED or (kind in ("C", "rho") and number.isdigit())


def inside(errors: Iterable[float], share: float) -> list[bool]:
    """Whether each normal interval of that probability contains the truth."""
    return [abs(error) <= norm.ppf(0.5 + 0.5 * share) for error in errors]
