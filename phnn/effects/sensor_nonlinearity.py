"""A sensor with a nonlinear characteristic."""

from __future__ import annotations

from phnn.effects import Effect, Scales, at_sensor, kinds, signed

# Typical values for coefficients that start at zero: an error of a hundredth at a tenth of a millimetre.
_SQUARE, _CUBE = 1e2, 1e6


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point for each coefficient; the law is linear in both."""
    small = 1e-3 / scales.sensed
    return [{"a_2": small, "a_3": 0.0}, {"a_2": 0.0, "a_3": small / scales.sensed}]


EFFECT = Effect(
    name="sensor_nonlinearity",
    kind=kinds.SENSOR_NONLINEAR,
    equation=r"y = q + a_2 q^2 + a_3 q^3",
    statement="The sensor is not linear: it adds {a_2} times the square and {a_3} times the cube of the displacement "
    "to its reading, at any speed.",
    fingerprint="Harmonics of the displacement that depend on its amplitude alone, the same at every frequency and "
    "across the resonance.",
    separation="The same sine once with the sensor moved along its range: the sensor's error moves with it, a "
    "nonlinearity of the actuator does not.",
    references=("Fleming 2013, Sensors and Actuators A 190 (position sensors), sec. 2.1",),
    declares=(
        signed("a_2", "1/{sensed}", "quadratic error", 1e9, _SQUARE, strength=True, own_size=True),
        signed("a_3", "1/{sensed}^2", "cubic error", 1e15, _CUBE, strength=True, own_size=True),
    ),
    adds=at_sensor("polynomial"),
    grid=grid,
    neighbours=("electrostriction", "displacement_coupling", "quadratic_stiffness"),
)
