"""An amplifier that loses gain about zero: crossover distortion."""

from __future__ import annotations

from dataclasses import replace

from phnn.effects import Effect, Scales, at_amplifier, bounded, constant, kinds, nonnegative
from phnn.effects.learned.strengths import Within

_WIDTH = nonnegative("delta_U", "V", "half width of the dead band", 1e3, 0.1)
_ONLY_WIDTH = replace(_WIDTH, strength=True)
_SHARE = bounded("a_U", "1", "gain lost in the dead band", 0.0, 1.0, 0.1, strength=True)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Bands of several widths."""
    return [{"delta_U": share * scales.voltage, "a_U": 1.0} for share in (1e-3, 0.01, 0.05)]


def grid_partly(scales: Scales) -> list[dict[str, float]]:
    """A tenth of the gain lost, within bands of several widths."""
    return [{"a_U": 0.1, "delta_U": share * scales.voltage} for share in (0.02, 0.1, 0.3)]


EFFECT = Effect(
    name="amplifier_dead_band",
    kind=kinds.AMPLIFIER_STATIC,
    equation=r"V = u - \mathrm{clip}(u, \pm\delta_U)",
    statement="The amplifier has a dead band: its output is zero while the command is within {delta_U} of zero, and "
    "beyond that the voltage is smaller by the same amount.",
    fingerprint="Plateaus about zero volts, at one voltage whatever the frequency.",
    separation="A small sine about an offset well above the dead band: there the amplifier is linear.",
    references=("Horowitz & Hill 2015, The Art of Electronics, sec. 2.4 (crossover distortion)",),
    declares=(_ONLY_WIDTH, constant("a_U", "1", _SHARE.description)),
    adds=at_amplifier("dead_band", "a_U", "delta_U"),
    grid=grid,
    neighbours=("amplifier_saturation",),
    rescale=Within((_ONLY_WIDTH,), may_vanish=True),
).or_as(
    equation=r"V = u - a_U\,\mathrm{clip}(u, \pm\delta_U)",
    statement="The amplifier loses the share {a_U} of its gain while its command is within {delta_U} of zero.",
    declares=(_SHARE, _WIDTH),
    grid=grid_partly,
    rescale=Within((_SHARE,), may_vanish=True),
)
