"""An amplifier that adds a constant voltage."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Plausible, Scales
from phnn.parameters import signed
from phnn.setup import Block, Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``V = u + V₀`` before the port, from long before the recording on: rest is at ``V₀`` too."""
    parameter = signed("V_0", values["V_0"], "V", 1e3, 0.1, "offset of the amplifier")
    return setup.with_block("amplifier", Block("offset", ("V_0",)), (parameter,))


def grid(scales: Scales) -> list[dict[str, float]]:
    """Small against the largest command: one point."""
    return [{"V_0": 1e-3 * scales.voltage}]


EFFECT = Effect(
    name="amplifier_offset",
    location="amplifier",
    kind="offset",
    equation=r"V = u + V_0",
    statement="The amplifier adds {V_0} to its command. Where the actuator is linear in the voltage and a spring "
    "holds it, only the zero of the displacement shows that.",
    fingerprint="None on an actuator that is linear in its voltage, where the zero of the displacement takes all of "
    "it; elsewhere, even harmonics of a voltage that is not centred.",
    separation="The amplifier switched on during a recording, or the terminal voltage recorded as well.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    passive=False,
    strength="V_0",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("V_0",),
    plausible={"V_0": Plausible(-5.0, 5.0, "high-voltage amplifiers are off by a few volts at most")},
    needs_command=True,
    neighbours=("constant_load", "electrostriction"),
)
