"""A learned characteristic of the sensor: a cubic, and more or less gain towards either end."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, no_range, sensed_unit
from phnn.effects.learned.strengths import each, within
from phnn.parameters import Parameter, constant
from phnn.setup import Block, Setup

# The slope of the cubic is at least 1 − 2·0.25 − 3·0.16 = 0.02, that of a knee a tenth: the characteristic rises.
_LIMITS = {"a_Y2": 0.25, "a_Y3": 0.16, "h_Y1": 0.9, "h_Y2": 0.9, "h_Y3": 0.9, "h_Y4": 0.9}
# Levels of the knees as shares of the displacement.
_KNEES = {"1": 0.35, "2": 0.7, "3": -0.35, "4": -0.7}
_TYPICAL, _SMALL = 0.01, 1e-3

_STRENGTHS = tuple(_LIMITS)
_LEVELS = ("y_Y", *(f"y_Y{i}" for i in _KNEES))


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y = f(q)``: a cubic, then at every knee the share ``h`` of the gain is taken beyond its level."""
    given = {
        n: Parameter(n, values[n], "1", -most, most, typical=_TYPICAL, description="learned error of the sensor")
        for n, most in _LIMITS.items()
    }
    unit = sensed_unit(setup)
    levels = {n: constant(n, values[n], unit, "level of the learned characteristic of the sensor") for n in _LEVELS}
    cubic = (given["a_Y2"], given["a_Y3"], levels["y_Y"])
    setup = setup.with_block("sensor", Block("cubic", tuple(p.name for p in cubic)), cubic)
    for i in _KNEES:
        knee = (given[f"h_Y{i}"], levels[f"y_Y{i}"])
        setup = setup.with_block("sensor", Block("knee", tuple(p.name for p in knee)), knee)
    return setup


def grid(scales: Scales) -> list[dict[str, float]]:
    """The cubic's coefficients alone, and both knees of either side."""
    levels = {"y_Y": scales.sensed} | {f"y_Y{i}": share * scales.sensed for i, share in _KNEES.items()}
    groups = (("a_Y2",), ("a_Y3",), ("h_Y1", "h_Y2"), ("h_Y3", "h_Y4"))
    return each(_STRENGTHS, groups, _SMALL, levels)


EFFECT = Effect(
    name="learned_sensor",
    location="sensor",
    kind="static",
    equation=r"y = f(q), \quad f' > 0",
    statement="The sensor is not straight: at {y_Y} it errs by the shares {a_Y2} (square) and {a_Y3} (cube), and it "
    "loses {h_Y1}, {h_Y2}, {h_Y3} and {h_Y4} of its gain beyond {y_Y1}, {y_Y2}, {y_Y3} and {y_Y4}.",
    fingerprint="Harmonics of the displacement that depend on its amplitude alone, the same at every frequency and "
    "across the resonance.",
    separation="The same sine once with the sensor moved along its range: what the sensor does moves with it.",
    references=("Fleming 2013, Sensors and Actuators A 190 (position sensors), sec. 2.1",),
    passive=False,
    strength=_STRENGTHS[0],
    strengths=_STRENGTHS,
    one_sided=False,
    grid=grid,
    build=build,
    rescale=within({n: (-most, most) for n, most in _LIMITS.items()}),
    parameters=(*_STRENGTHS, *_LEVELS),
    plausible=no_range(*_STRENGTHS, *_LEVELS),
    akin=("nonlinear",),
    neighbours=("sensor_nonlinearity", "electrostriction"),
)
