"""Electrostriction: a force that grows with the square of the voltage."""

from __future__ import annotations

from phnn.effects import Effect, Placed, Scales, has_transducer, kinds, signed
from phnn.effects.additions import bent_port
from phnn.setup import Setup


def bend(setup: Setup, parameters: Placed) -> Setup:
    """The voltage port acts through ``ψ(V) = V + ε V²/2``; its conjugate current gains the factor ``1 + ε V``."""
    return bent_port(setup, "electrostriction", parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    return [{"epsilon": 1e-3 / scales.voltage}]


EFFECT = Effect(
    name="electrostriction",
    kind=kinds.FORCE_BY_VOLTAGE,
    equation=r"F = \alpha (V + \frac{1}{2} \varepsilon V^2)",
    statement="The force is not proportional to the voltage: electrostriction adds the share {epsilon} times half "
    "the voltage, the same at every frequency.",
    fingerprint="Even harmonics and a mean shift with the square of the voltage, the same at every frequency and "
    "without a loop.",
    separation="Small sines about several offsets of the voltage, far below and near the resonance: electrostriction "
    "follows the voltage, the others follow the displacement.",
    references=("Uchino 1997, Piezoelectric Actuators and Ultrasonic Motors",),
    declares=(
        signed("epsilon", "1/V", "electrostriction", 1.0, 1e-3, strength=True).plausibly(
            -0.02, 0.02, "the charge constant of soft ceramics at most doubles up to the coercive voltage, 50 V or more"
        ),
    ),
    adds=bend,
    grid=grid,
    applies=has_transducer,
    neighbours=("displacement_coupling", "quadratic_stiffness", "sensor_nonlinearity"),
)
