"""Actuators whose hysteresis is not one of hysterons: generalised Prandtl–Ishlinskii, or Bouc–Wen.

Either takes the place of the hysterons as the voltage that opposes the displacement: all of the mismatch lies there.

    prandtl_ishlinskii:  V_h = Σ c_i (q − w_i),  four plays w_i between γ₋(q) − r_i and γ₊(q) + r_i,
                         γ∓(q) = q + (a ∓ δ) g(q),  g(q) = q_p (√(1 + (q/q_p)²) − 1)
    bouc_wen:            V_h = c z,  ż = v − |z/z_b|ⁿ (β |v| sgn z + (1 − β) v)

The lean ``a`` moves both envelopes and so makes the loop asymmetric, the gape ``δ`` parts them. The dissipated powers
``Σ c_i (q − w_i) ẇ_i`` and ``c z (v − ż)`` are not negative for r_i > (|a| + δ) g and β ≥ ½; parameters are drawn so.

References: Al Janaideh, Rakheja, Su 2011 (plays with envelopes); Wen 1976.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from studies.generator.concealed import log_uniform, quasi_static_peak
from studies.generator.parameters import ABSENT

HYSTERONS, PRANDTL_ISHLINSKII, BOUC_WEN = "hysterons", "prandtl_ishlinskii", "bouc_wen"
BASES = (HYSTERONS, PRANDTL_ISHLINSKII, BOUC_WEN)
LOCATION = "hysteron"  # where a base of another hysteresis differs from the model

# What a refit of such a base moves besides mass, stiffness, damping and coupling; the displacement q_play is a scale.
MOVED = {
    PRANDTL_ISHLINSKII: (
        *(f"{n}_play_{i}" for n in ("c", "r") for i in (1, 2, 3, 4)),
        *("lean_play", "gape_play"),
    ),
    BOUC_WEN: ("c_bouc", "z_bouc", "n_bouc", "beta_bouc"),
}
# Effects that act on hysterons, and have no meaning where there are none.
ON_HYSTERONS = (
    *("extra_hysteron", "hysteresis_asymmetry", "rate_dependent_threshold", "charge_leakage"),
    "curved_capacitance",
)

_THRESHOLDS = ((0.12, 0.2), (0.25, 0.4), (0.45, 0.6), (0.65, 0.9))  # of plays, over the largest displacement
_EVEN = 4.0  # concentration of the shares of the plays in their stiffness
_LEAN, _GAPE = (0.4, 0.75), (0.05, 0.25)  # over the least threshold; their sum stays below 1: no cycle gives energy
_SATURATES = (0.25, 0.6)  # z_bouc over the largest displacement
_EXPONENT, _BETA = (1.0, 2.0), (0.55, 0.9)


def with_hysteresis(base: Mapping[str, float], family: str, rng: np.random.Generator) -> dict[str, float]:
    """The base with another hysteresis in the place of its hysterons, as stiff as they are while none slips.

    Args:
        base: parameters with two hysterons, SI.
        family: one of ``BASES``.
    """
    if family == HYSTERONS:
        return dict(base)
    peak = quasi_static_peak(base)
    stiff = base["alpha"] * (1.0 / base["C_1"] + 1.0 / base["C_2"])  # V/m
    none = {f"{n}_{i}": v for i in (1, 2) for n, v in (("C", ABSENT), ("rho", 0.0))}
    draw = _plays if family == PRANDTL_ISHLINSKII else _bouc_wen
    return {**base, **none, **draw(rng, peak, stiff)}


def _plays(rng: np.random.Generator, peak: float, stiff: float) -> dict[str, float]:
    reach = [float(rng.uniform(*span)) * peak for span in _THRESHOLDS]
    shares = rng.dirichlet([_EVEN] * len(reach))
    least = reach[0] / peak
    sign = float(rng.choice([-1.0, 1.0]))
    found = {f"c_play_{i + 1}": stiff * float(share) for i, share in enumerate(shares)}
    found |= {f"r_play_{i + 1}": r for i, r in enumerate(reach)}
    lean, gape = (least * float(rng.uniform(*span)) for span in (_LEAN, _GAPE))
    return found | {"lean_play": sign * lean, "gape_play": gape, "q_play": peak}


def _bouc_wen(rng: np.random.Generator, peak: float, stiff: float) -> dict[str, float]:
    return {
        "c_bouc": stiff * log_uniform(rng, 0.6, 1.2),
        "z_bouc": float(rng.uniform(*_SATURATES)) * peak,
        "n_bouc": float(rng.uniform(*_EXPONENT)),
        "beta_bouc": float(rng.uniform(*_BETA)),
    }


def family_of(base: Mapping[str, float]) -> str:
    """Which hysteresis a base has."""
    return next((family for family, names in MOVED.items() if names[0] in base), HYSTERONS)


def acts_on(effect: str, family: str) -> bool:
    """Whether an effect has a meaning in an actuator of this hysteresis."""
    return family == HYSTERONS or effect not in ON_HYSTERONS
