"""Charge that leaks from the hysterons' capacitors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.effects.effect import Effect, Plausible, Scales, has_dead_zones, with_network
from phnn.network.elements import Resistor
from phnn.network.roles import charges
from phnn.parameters import positive
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``Q̇_i = α v − h_i⁻¹(e_i) − G e_i``: a linear resistor beside every dead zone."""
    leaks = tuple(Resistor(f"leakage_{n}", "linear", {n: 1.0}, ("G",)) for n in charges(setup.network))
    conductance = positive("G", values["G"], "S", "leakage of the hysterons' capacitors", 1e8)
    return with_network(setup, setup.network.extend(resistors=leaks, parameters=(conductance,)))


def grid(scales: Scales) -> list[dict[str, float]]:
    """Weak over the whole recording, and faster relaxations, where the charge no longer falls along a straight line."""
    c = scales.transducer * scales.displacement / scales.voltage
    slow = 2.0 * np.pi * scales.slowest
    rates = (0.01 / scales.duration, 0.3 / scales.duration, 0.1 * slow, slow)
    return [{"G": float(rate) * c} for rate in rates]


EFFECT = Effect(
    name="charge_leakage",
    location="electrical",
    kind="leakage",
    equation=r"\dot{Q}_i = \alpha v - h_i^{-1}(e_i) - G e_i, \quad e_i = Q_i/C_i",
    statement="The capacitors of the hysterons leak with a conductance of {G} each: what hysteresis holds back is "
    "slowly let go.",
    fingerprint="On a hold the displacement drifts by at most what the dead zones hold, and slow loops are narrower "
    "than fast ones.",
    separation="Holds of equal length after loops of small and of large amplitude: leakage lets go no more than the "
    "dead zones hold and stops, creep goes on in proportion to the displacement.",
    references=("Goldfarb & Celanovic 1997, IEEE Control Systems 17 (electrical side of a stack)",),
    passive=True,
    strength="G",
    one_sided=True,
    grid=grid,
    build=build,
    parameters=("G",),
    plausible={
        "G": Plausible(
            0.0,
            0.05,
            "ceramics of 10⁹ Ω m and 2·10⁻⁸ F/m discharge in 20 s, better ones more slowly",
            over="C_1",
        )
    },
    applies=has_dead_zones,
    neighbours=("creep", "extra_hysteron"),
)
