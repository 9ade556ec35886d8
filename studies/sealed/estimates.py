"""Errors of estimated parameters against what was sealed.

An error of an estimate is a normal deviate of the stated 95 % interval: 1.96 where the truth lies at one of its ends,
in proportion inside.

Voltage and displacement leave one common factor of all impedances free, which the stated mass fixes. Where the stated
mass is exact, errors of what scales with it say nothing of its stated deviation: those parameters are left out there.
Where it is drawn, its error moves them all together, so that the base parameters of one case are hardly more than one
draw. Errors by noise alone therefore compare with the truth at the stated mass, in intervals that take the mass as
exact. The mass itself is left out always, for its interval is the anchor's own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from scipy.stats import norm

from studies.generator import Sealed
from studies.generator.cases import CANONICAL

_DEVIATE = float(norm.ppf(0.975))  # of the ends of the intervals that are stated
_REFERENCE = 100e-6  # m, displacement that strengths of a seal refer to

# The parameters of the catalogue that are compared, by effect. What the recordings know in products only, as of
# self-heating, is not.
_COMPARED = {
    "creep": ("k_s", "tau_s"), "extra_hysteron": ("C_x", "rho_x", "d_x"), "cubic_stiffness": ("kappa_3",),
    "coulomb_friction": ("F_c",), "quadratic_drag": ("c_2",), "hysteresis_asymmetry": ("kappa_d",),
    "electrostriction": ("epsilon",), "amplifier_lowpass": ("tau_a",), "amplifier_saturation": ("V_max",),
    "sensor_drift": ("drift_rate",), "contact_stop": ("k_c", "g_c"), "quadratic_stiffness": ("kappa_2",),
    "charge_leakage": ("G",), "rate_dependent_threshold": ("kappa_v",), "displacement_coupling": ("kappa_a",),
    "depolarisation": ("delta_z", "tau_z", "V_c"), "second_mode": ("m_2", "k_2", "b_2"), "delay": ("tau_d",),
    "slew_limit": ("S",), "sensor_lag": ("tau_y",), "sensor_nonlinearity": ("a_2", "a_3"),
    "output_backlash": ("delta_b",), "mains_pickup": ("f_m",), "base_motion": ("f_b",),
}  # fmt: skip
# Their names in a seal, where these are others.
_IN_SEAL = {"C_x": "C_3", "rho_x": "rho_3", "d_x": "d_3", "tau_a": "tau_V", "drift_rate": "rate", "g_c": "q_c"}
# The parameter that holds the reference displacement, and its power.
_REFERRED = {"kappa_3": ("q_0", 2), "kappa_d": ("q_d", 1), "kappa_2": ("q_2", 1), "kappa_a": ("q_a", 1)}
# Impedances, admittances and forces per volt: they scale with the common factor.
_SCALED = {"k", "b", "alpha", "k_s", "F_c", "c_2", "k_c", "m_2", "k_2", "b_2", "G", "C_x", "rho_x"}

# By name: value, and as far as known the 95 % interval, and exact: the interval that takes anchors as exact.
Estimates = Mapping[str, Mapping[str, Any]]


def all_errors(estimates: Estimates, named: Iterable[str], sealed: Sealed) -> dict[str, dict[str, float]]:
    """Return the errors of base and effect parameters as normal deviates, by name; of both also by the noise alone.

    Args:
        estimates: of the final model; named: the effects whose names are given.
    """
    pairs = {"base": _base_pairs(estimates, sealed), "effect": _effect_pairs(estimates, named, sealed)}
    factor = sealed.stated_mass / sealed.base["m"] if sealed.stated_mass > 0.0 else 1.0
    errors: dict[str, dict[str, float]] = {}
    for kind, own in pairs.items():
        stated = {n: t for n, t in own.items() if sealed.stated_mass > 0.0 or not _scaled(n)}
        errors[kind] = _deviates(estimates, "interval", stated)
        exact = {n: t * factor if _scaled(n) else t for n, t in own.items()}
        errors[f"{kind}_by_noise"] = _deviates(estimates, "exact", exact)
    return errors


def _deviates(estimates: Estimates, kind: str, truth: Mapping[str, float]) -> dict[str, float]:
    """Return errors over the part of an interval on the side of the truth, times 1.96, where there is one."""
    errors = {}
    for name, true in truth.items():
        if (ends := estimates[name].get(kind)) is not None:
            value = float(estimates[name]["value"])
            errors[name] = _DEVIATE * (value - true) / abs(value - float(ends[0 if true < value else 1]))
    return errors


def _base_pairs(estimates: Estimates, sealed: Sealed) -> dict[str, float]:
    """Return the truth by the name of the estimate; hysterons have no order, they are compared in that of their dead
    zones, and nothing is compared where their numbers differ."""
    own = _in_order({n: float(e["value"]) for n, e in estimates.items()})
    true = _in_order(sealed.base)
    if len(own) != len(true):
        return {}
    names = {n: n for n in ("k", "b", "alpha")}
    names |= {f"{n}_{i}": f"{n}_{j}" for i, j in zip(own, true, strict=True) for n in ("C", "rho", "d")}
    return {n: sealed.base[of] for n, of in names.items() if n in estimates}


def _in_order(table: Mapping[str, float]) -> list[str]:
    """Return the numbers of the hysterons among the names of parameters, in the order of their dead zones."""
    return sorted(sorted(n[2:] for n in table if n.startswith("d_") and n[2:].isdigit()), key=lambda i: table[f"d_{i}"])


def _effect_pairs(estimates: Estimates, named: Iterable[str], sealed: Sealed) -> dict[str, float]:
    """Return the same of each rightly named effect whose law has the form of the catalogue.

    Nothing where the actuator has another hysteresis: no model is right then, no interval has to hold.
    """
    canonical = sealed.form == CANONICAL
    truth = {**sealed.background, **(sealed.parameters if canonical else {})}
    concealed = (*(sealed.effects if canonical else ()), *sealed.background_effects)
    pairs = {}
    for effect in named if not sealed.base_family else ():
        for name in _COMPARED.get(effect, ()) if effect in concealed else ():
            of, (reference, power) = _IN_SEAL.get(name, name), _REFERRED.get(name, ("", 0))
            if of in truth and name in estimates:
                scale = (float(estimates[reference]["value"]) / _REFERENCE) ** power if power else 1.0
                pairs[name] = truth[of] * scale
    return pairs


def _scaled(name: str) -> bool:
    """Tell whether the common factor moves a parameter; hysterons are numbered."""
    kind, _, number = name.partition("_")
    return name in _SCALED or (kind in ("C", "rho") and number.isdigit())
