"""A learned change of the sensor over the time of a recording: its gain drifts, its clock runs fast or slow."""

from __future__ import annotations

import math

from phnn.effects import Chain, Effect, Scales, constant, kinds
from phnn.effects.learned.strengths import Within, each, either
from phnn.setup import Block

# Bounds: the gain stays above a tenth, and the clock error is at most one radian of the fastest line.
_LIMITS = {"g_Z1": 0.45, "g_Z2": 0.45, "c_Z": 1.0}
_TYPICAL, _SMALL = 0.01, 1e-3

_CHANGES = either(_LIMITS, "1", "change of the sensor with time", _TYPICAL)
_SIZES = (
    constant("T_Z", "s", "time over which the sensor changes"),
    constant("s_Z", "1", "change of the clock for a strength of one"),
)
_BLOCKS = (Block("clock", ("c_Z", "s_Z")), Block("drifting_gain", ("g_Z1", "g_Z2", "T_Z")))


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point for each strength."""
    sizes = {"T_Z": scales.duration, "s_Z": 1.0 / (2.0 * math.pi * scales.fastest * scales.duration)}
    return each(_CHANGES, _SMALL, sizes)


EFFECT = Effect(
    name="learned_sensor_over_time",
    kind=kinds.SENSOR_OVER_TIME,
    equation=r"y = g(t)\,q((1 - \kappa)\,t)",
    statement="The sensor changes with the time of the recording: its gain by the shares {g_Z1} (straight) and {g_Z2} "
    "(square) in {T_Z}, and its clock by {c_Z} times {s_Z}.",
    fingerprint="An amplitude that grows or falls, or a growing phase error, with the time since the start.",
    separation="The same sine twice in one long recording, at its start and at its end.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    declares=(*_CHANGES, *_SIZES),
    adds=Chain("sensor", _BLOCKS),
    grid=grid,
    neighbours=("sensor_drift", "self_heating"),
    rescale=Within(_CHANGES),
    related_kinds=(kinds.GAIN_DRIFT, kinds.CLOCK),
)
