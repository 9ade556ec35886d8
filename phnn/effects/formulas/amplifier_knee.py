"""An amplifier that loses gain beyond a level on one side."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, no_range
from phnn.parameters import Parameter, signed
from phnn.setup import Block, Setup

_SHARE, _LEVEL = "a_K", "U_K"


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``V = u − a max(u − U, 0)`` for ``U > 0`` and mirrored for ``U < 0``."""
    share = Parameter(_SHARE, values[_SHARE], "1", 0.0, 1.0, typical=0.1, description="gain lost beyond a level")
    level = signed(_LEVEL, values[_LEVEL], "V", 1e4, 1.0, "level of the lost gain")
    return setup.with_block("amplifier", Block("knee", (_SHARE, _LEVEL)), (share, level))


def grid(scales: Scales) -> list[dict[str, float]]:
    """A tenth of the gain lost beyond levels on either side."""
    return [{_SHARE: 0.1, _LEVEL: share * scales.voltage} for share in (0.8, -0.8, 0.4)]


EFFECT = Effect(
    name="amplifier_knee",
    location="amplifier",
    kind="static",
    equation=r"V = u - a_K \max(u - U_K, 0)",
    statement="The amplifier loses the share {a_K} of its gain beyond {U_K}.",
    fingerprint="Flat tops on one side of the motion, at one voltage whatever the frequency.",
    separation="A small sine about two offsets of the voltage, one on either side of the level.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    passive=False,
    strength=_SHARE,
    one_sided=True,
    grid=grid,
    build=build,
    parameters=(_SHARE, _LEVEL),
    plausible=no_range(_SHARE, _LEVEL),
    rescale=lambda values, factor: {**values, _SHARE: min(max(factor * values[_SHARE], 0.0), 1.0)},
    needs_command=True,
    neighbours=("amplifier_saturation",),
)
