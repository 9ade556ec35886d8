"""A learned course of the sensor over the time of a recording: its gain drifts, its clock runs fast or slow."""

from __future__ import annotations

import math
from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, no_range
from phnn.effects.learned.strengths import each, within
from phnn.parameters import Parameter, constant
from phnn.setup import Block, Setup

# The gain stays above a tenth, and the clock is out by no more than a radian of the fastest line.
_LIMITS = {"g_Z1": 0.45, "g_Z2": 0.45, "c_Z": 1.0}
_TYPICAL, _SMALL = 0.01, 1e-3

_STRENGTHS = tuple(_LIMITS)
_SIZES = {"T_Z": ("s", "time over which the sensor changes"), "s_Z": ("1", "change of the clock for a strength of one")}


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y = (1 + g₁ t/T + g₂ (t/T)²) q((1 − c s) t)``."""
    given = {
        n: Parameter(n, values[n], "1", -most, most, typical=_TYPICAL, description="change of the sensor with time")
        for n, most in _LIMITS.items()
    }
    sizes = {n: constant(n, values[n], unit, text) for n, (unit, text) in _SIZES.items()}
    clock, gain = (given["c_Z"], sizes["s_Z"]), (given["g_Z1"], given["g_Z2"], sizes["T_Z"])
    setup = setup.with_block("sensor", Block("clock", tuple(p.name for p in clock)), clock)
    return setup.with_block("sensor", Block("drifting_gain", tuple(p.name for p in gain)), gain)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Every strength alone."""
    sizes = {"T_Z": scales.duration, "s_Z": 1.0 / (2.0 * math.pi * scales.fastest * scales.duration)}
    return each(_STRENGTHS, tuple((n,) for n in _STRENGTHS), _SMALL, sizes)


EFFECT = Effect(
    name="learned_sensor_over_time",
    location="sensor",
    kind="over time",
    equation=r"y = g(t)\,q((1 - \kappa)\,t)",
    statement="The sensor changes with the time of the recording: its gain by the shares {g_Z1} (straight) and {g_Z2} "
    "(square) in {T_Z}, and its clock by {c_Z} times {s_Z}.",
    fingerprint="An amplitude that grows or falls, or a phase that runs away, with the time since the start.",
    separation="The same sine twice in one long recording, at its start and at its end.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    passive=False,
    strength=_STRENGTHS[0],
    strengths=_STRENGTHS,
    one_sided=False,
    grid=grid,
    build=build,
    rescale=within({n: (-most, most) for n, most in _LIMITS.items()}),
    parameters=(*_STRENGTHS, *_SIZES),
    plausible=no_range(*_STRENGTHS, *_SIZES),
    akin=("gain that drifts", "clock"),
    neighbours=("sensor_drift", "self_heating"),
)
