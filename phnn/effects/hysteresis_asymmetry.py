"""Hysteresis whose thresholds follow the displacement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phnn.effects.effect import Effect, Scales, has_plain_dead_zones, no_range, with_network
from phnn.network.elements import Resistor
from phnn.parameters import Parameter, as_table, constant
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """Every dead zone becomes ``d_i max(0, 1 + κ q/q₀)``."""
    network = setup.network

    def follow(resistor: Resistor) -> Resistor:
        if resistor.law != "dead_zone":
            return resistor
        names = (*resistor.parameters, "kappa_d", "q_d")
        return replace(resistor, law="following_dead_zone", parameters=names, modulated_by="q")

    extra = (
        Parameter("kappa_d", values["kappa_d"], "1", -3.0, 3.0, typical=0.05, description="asymmetry of hysteresis"),
        constant("q_d", values["q_d"], "m", "reference displacement of the asymmetry"),
    )
    parameters = as_table((*network.parameters.values(), *extra))
    resistors = tuple(follow(r) for r in network.resistors)
    return with_network(setup, replace(network, resistors=resistors, parameters=parameters))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"kappa_d": 1e-3, "q_d": scales.displacement}]


EFFECT = Effect(
    name="hysteresis_asymmetry",
    location="hysteron",
    kind="threshold that follows the displacement",
    equation=r"d_i(q) = d_i \max(0, 1 + \kappa_d\, q/q_d)",
    statement="The hysteresis loop is wider on one side: the dead zones grow by the share {kappa_d} per {q_d} of "
    "displacement.",
    fingerprint="The loop is wider on one side of the displacement than on the other: even harmonics that carry "
    "dissipation.",
    separation="Small slow loops about a high and a low offset: thresholds that follow the displacement change their "
    "width, electrostriction only their slope.",
    references=("Díaz, Ramírez, Le Gorrec & Wu, sec. 2.4.3 (asymmetric actuators)",),
    passive=True,
    strength="kappa_d",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("kappa_d", "q_d"),
    plausible=no_range("kappa_d", "q_d"),
    applies=has_plain_dead_zones,
    neighbours=("electrostriction",),
)
