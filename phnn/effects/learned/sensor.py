"""A learned characteristic of the sensor: a cubic, and higher or lower gain towards either end."""

from __future__ import annotations

from phnn.effects import Chain, Effect, Scales, kinds
from phnn.effects.learned.strengths import Within, constants, each, either
from phnn.setup import Block

# The slope of the cubic is at least 1 − 2·0.25 − 3·0.16 = 0.02, that of a knee at least 0.1: the characteristic rises.
_LIMITS = {"a_Y2": 0.25, "a_Y3": 0.16, "h_Y1": 0.9, "h_Y2": 0.9, "h_Y3": 0.9, "h_Y4": 0.9}
# Levels of the knees as shares of the displacement.
_KNEES = {"1": 0.35, "2": 0.7, "3": -0.35, "4": -0.7}
_TYPICAL, _SMALL = 0.01, 1e-3

_ERRORS = either(_LIMITS, "1", "learned error of the sensor", _TYPICAL)
_LEVELS = constants(
    ("y_Y", *(f"y_Y{i}" for i in _KNEES)), "{sensed}", "level of the learned characteristic of the sensor"
)
# A cubic; then, at every knee, the share ``h`` of the gain is lost beyond its level.
_BLOCKS = (Block("cubic", ("a_Y2", "a_Y3", "y_Y")), *(Block("knee", (f"h_Y{i}", f"y_Y{i}")) for i in _KNEES))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The cubic's coefficients one by one, and both knees on either side."""
    levels = {"y_Y": scales.sensed} | {f"y_Y{i}": share * scales.sensed for i, share in _KNEES.items()}
    groups = (("a_Y2",), ("a_Y3",), ("h_Y1", "h_Y2"), ("h_Y3", "h_Y4"))
    return each(_ERRORS, _SMALL, levels, groups)


EFFECT = Effect(
    name="learned_sensor",
    kind=kinds.SENSOR_STATIC,
    equation=r"y = f(q), \quad f' > 0",
    statement="The sensor is not linear: at {y_Y} it errs by the shares {a_Y2} (square) and {a_Y3} (cube), and it "
    "loses {h_Y1}, {h_Y2}, {h_Y3} and {h_Y4} of its gain beyond {y_Y1}, {y_Y2}, {y_Y3} and {y_Y4}.",
    fingerprint="Harmonics of the displacement that depend on its amplitude alone, the same at every frequency and "
    "across the resonance.",
    separation="The same sine once with the sensor moved along its range: the sensor's error moves with it.",
    references=("Fleming 2013, Sensors and Actuators A 190 (position sensors), sec. 2.1",),
    declares=(*_ERRORS, *_LEVELS),
    adds=Chain("sensor", _BLOCKS),
    grid=grid,
    neighbours=("sensor_nonlinearity", "electrostriction"),
    rescale=Within(_ERRORS),
    related_kinds=(kinds.SENSOR_NONLINEAR,),
)
