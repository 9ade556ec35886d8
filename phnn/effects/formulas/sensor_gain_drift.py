"""A sensor whose gain drifts."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, no_range
from phnn.effects.learned.strengths import within
from phnn.parameters import Parameter, constant
from phnn.setup import Block, Setup

# The gain keeps its sign.
_MOST = 0.9
_SLOPE, _BEND, _TIME = "kappa_G", "bend_G", "T_G"


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y = q (1 + κ t/T)``."""
    slope = Parameter(
        _SLOPE, values[_SLOPE], "1", -_MOST, _MOST, typical=0.01, description="change of the sensor's gain"
    )
    constants = (
        constant(_BEND, 0.0, "1", "curvature of the gain's course"),
        constant(_TIME, values[_TIME], "s", "time over which the gain changes"),
    )
    return setup.with_block("sensor", Block("drifting_gain", (_SLOPE, _BEND, _TIME)), (slope, *constants))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{_SLOPE: 1e-3, _BEND: 0.0, _TIME: scales.duration}]


EFFECT = Effect(
    name="sensor_gain_drift",
    location="sensor",
    kind="over time",
    equation=r"y = q\,(1 + \kappa_G\,t/T_G)",
    statement="The gain of the sensor drifts: it changes by the share {kappa_G} within {T_G} of every recording.",
    fingerprint="An amplitude that grows or falls steadily from the start of every recording.",
    separation="The same sine twice in one long recording, at its start and at its end: the amplitude differs.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    passive=False,
    strength=_SLOPE,
    one_sided=False,
    grid=grid,
    build=build,
    parameters=(_SLOPE, _BEND, _TIME),
    plausible=no_range(_SLOPE, _BEND, _TIME),
    rescale=within({_SLOPE: (-_MOST, _MOST)}),
    neighbours=("sensor_drift", "self_heating"),
)
