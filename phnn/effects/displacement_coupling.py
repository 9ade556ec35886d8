"""A transducer ratio that follows the displacement."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, has_transducer, no_range, with_network
from phnn.network.elements import Modulation
from phnn.parameters import Parameter, constant
from phnn.setup import Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``α`` becomes ``α (1 + κ q/q_a)`` in the port and in the hysterons' couplings alike."""
    return with_network(
        setup,
        setup.network.extend(
            modulations=(Modulation("alpha", "q", "affine", ("kappa_a", "q_a")),),
            parameters=(
                Parameter("kappa_a", values["kappa_a"], "1", -3.0, 3.0, typical=0.05, description="change of coupling"),
                constant("q_a", values["q_a"], "m", "reference displacement of the coupling"),
            ),
        ),
    )


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"kappa_a": 1e-3, "q_a": scales.displacement}]


EFFECT = Effect(
    name="displacement_coupling",
    location="coupling",
    kind="ratio that follows the displacement",
    equation=r"\alpha(q) = \alpha (1 + \kappa_a\, q/q_a)",
    statement="The transducer ratio follows the displacement: it changes by the share {kappa_a} per {q_a}.",
    fingerprint="Even harmonics and a mean shift with the product of voltage and displacement, weaker and turned in "
    "phase above the resonance.",
    separation="A small sine on several offsets of the voltage, below and above the resonance: a coupling that follows "
    "the displacement changes its gain with the offset and leaves the resonance where it is.",
    references=("van der Schaft & Jeltsema 2014, Port-Hamiltonian Systems Theory, ch. 2 (modulated transformer)",),
    passive=True,
    strength="kappa_a",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("kappa_a", "q_a"),
    plausible=no_range("kappa_a", "q_a"),
    applies=has_transducer,
    neighbours=("electrostriction", "quadratic_stiffness", "sensor_nonlinearity"),
)
