"""A learned characteristic of the amplifier: dead bands, and lower gain towards either end."""

from __future__ import annotations

from phnn.effects import Chain, Effect, Scales, kinds
from phnn.effects.learned.strengths import Within, constants, starts, strengths
from phnn.setup import Block

# Levels as shares of the largest command.
_BANDS = {"1": 0.02, "2": 0.08, "3": 0.25}
_KNEES = {"4": 0.5, "5": 0.75, "6": 0.92, "7": -0.5, "8": -0.75, "9": -0.92}
_TYPICAL, _SMALL = 0.1, 5e-4

_IN_BANDS, _BEYOND = (tuple(f"a_C{i}" for i in levels) for levels in (_BANDS, _KNEES))
_LEVELS = tuple(f"U_C{i}" for i in (*_BANDS, *_KNEES))
_SHARES = strengths((*_IN_BANDS, *_BEYOND), "1", "gain lost in the amplifier", 1.0, _TYPICAL)
# The blocks act in series; each takes the share ``a`` of the gain below or beyond its level.
_BLOCKS = tuple(Block("dead_band" if i in _BANDS else "knee", (f"a_C{i}", f"U_C{i}")) for i in (*_BANDS, *_KNEES))


def grid(scales: Scales) -> list[dict[str, float]]:
    """All strengths equal; then emphasis on the dead bands, and on the ends."""
    levels = {f"U_C{i}": share * scales.voltage for i, share in (_BANDS | _KNEES).items()}
    return starts(_SHARES, _SMALL, (_IN_BANDS, _BEYOND), levels)


EFFECT = Effect(
    name="learned_amplifier",
    kind=kinds.AMPLIFIER_STATIC,
    equation=r"V = f(u), \quad 0 \leq f' \leq 1",
    statement="The amplifier is not linear: it loses {a_C1}, {a_C2} and {a_C3} of its gain below {U_C1}, {U_C2} and "
    "{U_C3}, and {a_C4}, {a_C5}, {a_C6} beyond {U_C4}, {U_C5}, {U_C6}, {a_C7}, {a_C8}, {a_C9} beyond {U_C7}, {U_C8}, "
    "{U_C9}.",
    fingerprint="Plateaus about zero or flat tops, at one voltage whatever the frequency.",
    separation="Sines of rising amplitude about two offsets of the voltage: the amplifier's characteristic stays at "
    "its voltage, a nonlinearity of the actuator at its displacement.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    declares=(*_SHARES, *constants(_LEVELS, "V", "level below or beyond which the amplifier loses gain")),
    adds=Chain("amplifier", _BLOCKS),
    grid=grid,
    neighbours=("amplifier_saturation", "contact_stop", "electrostriction"),
    rescale=Within(_SHARES),
    related_kinds=(kinds.LIMIT,),
)
