"""Electrostriction: a force that grows with the square of the voltage."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.bent import bent_port
from phnn.effects.effect import Effect, Plausible, Scales, has_transducer, with_network
from phnn.parameters import signed
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """The voltage port acts through ``ψ(V) = V + ε V²/2``; its conjugate current gains the factor ``1 + ε V``."""
    extra = signed("epsilon", values["epsilon"], "1/V", 1.0, 1e-3, "electrostriction")
    return with_network(setup, bent_port(setup.network, "electrostriction", (extra,)))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"epsilon": 1e-3 / scales.voltage}]


EFFECT = Effect(
    name="electrostriction",
    location="coupling",
    kind="force against voltage",
    equation=r"F = \alpha (V + \frac{1}{2} \varepsilon V^2)",
    statement="The force is not proportional to the voltage: electrostriction adds the share {epsilon} times half "
    "the voltage, the same at every frequency.",
    fingerprint="Even harmonics and a mean shift with the square of the voltage, the same at every frequency and "
    "without a loop.",
    separation="Small sines about several offsets of the voltage, far below and near the resonance: electrostriction "
    "follows the voltage, the others follow the displacement.",
    references=("Uchino 1997, Piezoelectric Actuators and Ultrasonic Motors",),
    passive=True,
    strength="epsilon",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("epsilon",),
    plausible={
        "epsilon": Plausible(
            -0.02, 0.02, "the charge constant of soft ceramics at most doubles up to the coercive voltage, 50 V or more"
        )
    },
    applies=has_transducer,
    neighbours=("displacement_coupling", "quadratic_stiffness", "sensor_nonlinearity"),
)
