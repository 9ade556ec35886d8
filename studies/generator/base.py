"""The actuator in which effects are concealed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from studies.generator.actuator import TABLE
from studies.generator.concealed import log_uniform, quasi_static_peak
from studies.generator.other_base import MOVED, family_of
from studies.generator.parameters import ABSENT, FURTHER

_SPREAD = 0.2  # each parameter of Table 1 moves by up to this part of itself
_SLIPS = 1.1  # charge at the largest voltage over that at which a hysteron slips, at least


def draw_base(rng: np.random.Generator) -> dict[str, float]:
    """Table 1 with every parameter moved by up to ±20 %, such that each hysteron slips at the largest voltage.

    A hysteron that never slips is a capacitor in series: its slope and width would be in no recording.
    """
    while True:
        base = {name: value * float(rng.uniform(1.0 - _SPREAD, 1.0 + _SPREAD)) for name, value in TABLE.items()}
        charge = base["alpha"] * quasi_static_peak(base)
        if all(charge / base[f"C_{i}"] > _SLIPS * 0.5 * base[f"d_{i}"] for i in (1, 2)):
            return base


def with_hysterons(base: Mapping[str, float], count: int, rng: np.random.Generator) -> dict[str, float]:
    """The base with 1 to 4 hysterons, all of which slip at the largest voltage.

    With one, the second is left out. The third and the fourth have a capacitance of 1 to 3 times ``C_1``, slip at 5 to
    40 % of the largest displacement and relax in 10 µs to 3 ms. They make the actuator stiffer: the widths of the first
    two shrink with the largest displacement, so that these slip as early in a cycle as before.
    """
    if count == 1:
        return {**base, "C_2": ABSENT, "rho_2": 0.0}
    found, peak = dict(base), quasi_static_peak(base)
    for number in FURTHER[: count - 2]:
        stiffness = float(rng.uniform(1.0 / 3.0, 1.0)) / base["C_1"]
        slips_at = float(rng.uniform(0.05, 0.4)) * peak
        tau = log_uniform(rng, 1e-5, 3e-3)
        found |= {
            f"inv_C_{number}": stiffness,
            f"rho_{number}": 1.0 / (stiffness * tau),
            f"d_{number}": 2.0 * stiffness * base["alpha"] * slips_at,
        }
    shrunk = quasi_static_peak(found) / peak
    return found | {name: base[name] * shrunk for name in ("d_1", "d_2")}


def moving(base: Mapping[str, float]) -> list[str]:
    """Names of the parameters that a refit of the base model moves: those of the hysteresis that is there."""
    absent = [f"{n}_{i}" for i in (1, 2) for n in ("C", "rho", "d") if base[f"C_{i}"] == ABSENT]
    further = [f"{n}_{number}" for number in FURTHER for n in ("inv_C", "rho", "d") if f"inv_C_{number}" in base]
    return [n for n in TABLE if n not in absent] + further + list(MOVED.get(family_of(base), ()))


def as_stated(base: Mapping[str, float]) -> dict[str, float]:
    """The parameters as a person would state them: ``C_3``, ``rho_3``, ``d_3`` of a third hysteron, and so on."""
    other = (*MOVED.get(family_of(base), ()), "q_play")
    stated = {n: base[n] for n in moving(base) if n in TABLE} | {n: base[n] for n in other if n in base}
    for i, number in enumerate(n for n in FURTHER if f"inv_C_{n}" in base):
        stated |= {
            f"C_{3 + i}": 1.0 / base[f"inv_C_{number}"],
            f"rho_{3 + i}": base[f"rho_{number}"],
            f"d_{3 + i}": base[f"d_{number}"],
        }
    return stated
