"""One more RC hysteron than the model has."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.effects import Effect, Parts, Scales, SpecialCase, has_transducer, kinds, positive
from phnn.models.actuator import hysteron

_STORAGE, _RESISTOR, _COUPLING = hysteron("x")


def grid(scales: Scales) -> list[dict[str, float]]:
    """Slip after shares of the displacement; relaxation from slower than the slowest to faster than the fastest
    line."""
    small = 1e-3 * scales.voltage
    c = scales.transducer * scales.displacement / small
    rates = (
        2.0 * np.pi * np.array([0.3 * scales.slowest, 3.0 * scales.slowest, scales.fastest / 3.0, 30 * scales.fastest])
    )
    # A weak hysteron has a large C and a low voltage. Its dead zone must be as small, or it would never slip.
    return [
        {"C_x": c, "rho_x": float(rate) * c, "d_x": 2.0 * share * small}
        for share in (0.02, 0.06, 0.15, 0.3, 0.6, 0.9)
        for rate in rates
    ]


def rescale(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """Scale ``1/C``, the strength; the relaxation rate ``ϱ⁻¹/C`` and the displacement ``d C/(2α)`` to slip do not
    change."""
    weight = min(max(factor, 1e-2), 1e3)
    return {"C_x": values["C_x"] / weight, "rho_x": values["rho_x"] / weight, "d_x": values["d_x"] * weight}


def weakened(values: Mapping[str, float]) -> dict[str, float]:
    """The hysterons of a model at a hundredth of their strength, so that another form of hysteresis can take their
    place."""
    of_x = {n: rescale({f"{kind}_x": values[f"{kind}_{n}"] for kind in ("C", "rho", "d")}, 0.0) for n in _names(values)}
    return {f"{key[:-2]}_{n}": v for n, each in of_x.items() for key, v in each.items()}


def as_creep(values: Mapping[str, float]) -> dict[str, float]:
    """The parameters of a relaxing spring ``α²/C`` with time ``C/ϱ⁻¹``: a hysteron without its dead zone.

    Hysterons of one model can be exchanged: the extra one takes the place of the hysteron that slips first.
    """
    first = min(_names(values), key=lambda name: values[f"d_{name}"] * values[f"C_{name}"])
    relaxing = {
        "k_s": values["alpha"] ** 2 / values[f"C_{first}"],
        "tau_s": values[f"C_{first}"] / values[f"rho_{first}"],
    }
    return _in_the_place_of(first, values) | relaxing


def equivalents(values: Mapping[str, float]) -> list[dict[str, float]]:
    """The extra hysteron exchanged with each of the others, any of which may be the superfluous one."""
    return [_in_the_place_of(name, values) for name in _names(values) if name != "x"]


def _names(values: Mapping[str, float]) -> list[str]:
    """Names of the hysterons with a dead zone."""
    return [n[2:] for n in values if n.startswith("d_") and {f"C_{n[2:]}", f"rho_{n[2:]}"} <= set(values)]


def _in_the_place_of(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Parameter values that exchange one hysteron with the extra one."""
    return {f"{kind}_{name}": values[f"{kind}_x"] for kind in ("C", "rho", "d") if name != "x"}


EFFECT = Effect(
    name="extra_hysteron",
    kind=kinds.SHAPE,
    equation=r"\dot{Q}_x = \alpha v - h_x^{-1}(Q_x/C_x)",
    statement="The hysteresis needs one more hysteron: capacitance {C_x}, dead zone {d_x}, conductance {rho_x} outside "
    "it.",
    fingerprint="Loops whose width grows with the amplitude in another way than the hysterons of the model allow: "
    "rounder corners.",
    separation="Slow triangles of many amplitudes, each with a hold at its end: a hysteron needs a displacement to "
    "slip, creep and friction do not.",
    references=("Díaz, Ramírez, Le Gorrec & Wu, eqs. (1)–(4)",),
    declares=(
        positive("C_x", "F", "capacitance of hysteron x", strength=True),
        positive("rho_x", "S", "conductance of hysteron x outside its dead zone"),
        positive("d_x", "V", "width of the dead zone of hysteron x"),
    ),
    adds=Parts((_STORAGE,), (_RESISTOR,), (_COUPLING,)),
    grid=grid,
    applies=has_transducer,
    neighbours=("creep", "coulomb_friction"),
    related_kinds=(kinds.CAPACITANCE_BY_CHARGE, kinds.THRESHOLD_BY_DISPLACEMENT, kinds.THRESHOLD_BY_RATE),
    rescale=rescale,
    special_cases=(SpecialCase("creep", as_creep),),
    equivalents=equivalents,
)
