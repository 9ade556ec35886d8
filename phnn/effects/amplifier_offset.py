"""An amplifier that adds a constant voltage."""

from __future__ import annotations

from phnn.effects import Effect, Scales, at_amplifier, kinds, signed


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: an offset that is small against the largest command."""
    return [{"V_0": 1e-3 * scales.voltage}]


EFFECT = Effect(
    name="amplifier_offset",
    kind=kinds.OFFSET,
    equation=r"V = u + V_0",
    statement="The amplifier adds {V_0} to its command. If the actuator is linear in the voltage and a spring "
    "holds it, only the zero of the displacement shows the offset.",
    fingerprint="No trace if the actuator is linear in its voltage, as the zero of the displacement absorbs the "
    "offset; otherwise, even harmonics of a voltage that is not centred.",
    separation="The amplifier switched on during a recording, or the terminal voltage recorded as well.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    declares=(
        signed("V_0", "V", "offset of the amplifier", 1e3, 0.1, strength=True).plausibly(
            -5.0, 5.0, "high-voltage amplifiers are off by a few volts at most"
        ),
    ),
    adds=at_amplifier("offset"),
    grid=grid,
    neighbours=("constant_load", "electrostriction"),
)
