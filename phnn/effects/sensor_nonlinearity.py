"""A sensor whose characteristic is not straight."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, no_range, sensed_unit
from phnn.parameters import signed
from phnn.setup import Block, Setup

# Typical values where a coefficient starts at zero: a hundredth over a tenth of a millimetre.
_SQUARE, _CUBE = 1e2, 1e6


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y = q + a₂ q² + a₃ q³`` behind the network."""
    square, cube, unit = values["a_2"], values["a_3"], sensed_unit(setup)
    parameters = (
        signed("a_2", square, f"1/{unit}", 1e9, abs(square) or _SQUARE, "quadratic error"),
        signed("a_3", cube, f"1/{unit}^2", 1e15, abs(cube) or _CUBE, "cubic error"),
    )
    return setup.with_block("sensor", Block("polynomial", ("a_2", "a_3")), parameters)


def grid(scales: Scales) -> list[dict[str, float]]:
    """Linear in both coefficients: one point for each."""
    small = 1e-3 / scales.sensed
    return [{"a_2": small, "a_3": 0.0}, {"a_2": 0.0, "a_3": small / scales.sensed}]


EFFECT = Effect(
    name="sensor_nonlinearity",
    location="sensor",
    kind="nonlinear",
    equation=r"y = q + a_2 q^2 + a_3 q^3",
    statement="The sensor is not straight: to what it measures it adds {a_2} times its square and {a_3} times its "
    "cube, at any speed.",
    fingerprint="Harmonics of the displacement that depend on its amplitude alone, the same at every frequency and "
    "across the resonance.",
    separation="The same sine once with the sensor moved along its range: what the sensor does moves with it, what "
    "the actuator does stays.",
    references=("Fleming 2013, Sensors and Actuators A 190 (position sensors), sec. 2.1",),
    passive=False,
    strength="a_2",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("a_2", "a_3"),
    plausible=no_range("a_2", "a_3"),
    neighbours=("electrostriction", "displacement_coupling", "quadratic_stiffness"),
    strengths=("a_2", "a_3"),
)
