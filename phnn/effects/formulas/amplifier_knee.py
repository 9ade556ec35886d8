"""An amplifier that loses gain beyond a level on one side."""

from __future__ import annotations

from phnn.effects import Effect, Scales, at_amplifier, bounded, kinds, signed
from phnn.effects.learned.strengths import Within

_SHARE = bounded("a_K", "1", "gain lost beyond a level", 0.0, 1.0, 0.1, strength=True)


def grid(scales: Scales) -> list[dict[str, float]]:
    """A tenth of the gain lost, beyond levels on either side."""
    return [{"a_K": 0.1, "U_K": share * scales.voltage} for share in (0.8, -0.8, 0.4)]


EFFECT = Effect(
    name="amplifier_knee",
    kind=kinds.AMPLIFIER_STATIC,
    equation=r"V = u - a_K \max(u - U_K, 0)",
    statement="The amplifier loses the share {a_K} of its gain beyond {U_K}.",
    fingerprint="Flat tops on one side of the motion, at one voltage whatever the frequency.",
    separation="A small sine about two offsets of the voltage, one on either side of the level.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    declares=(_SHARE, signed("U_K", "V", "level of the lost gain", 1e4, 1.0)),
    adds=at_amplifier("knee"),
    grid=grid,
    neighbours=("amplifier_saturation",),
    rescale=Within((_SHARE,), may_vanish=True),
)
