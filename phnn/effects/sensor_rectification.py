"""A sensor that shows the magnitude of the displacement without its sign."""

from __future__ import annotations

from phnn.effects import Effect, Scales, at_sensor, kinds
from phnn.setup import Setup


def grid(scales: Scales) -> list[dict[str, float]]:
    """No parameters."""
    return [{}]


def applies(setup: Setup) -> bool:
    """No block of the sensor rectifies already."""
    return all(block.kind != "rectification" for block in setup.sensor)


EFFECT = Effect(
    name="sensor_rectification",
    kind=kinds.SENSOR_NONLINEAR,
    equation=r"y = |q|",
    statement="The sensor shows how far the output is from its zero, not on which side: it rectifies.",
    fingerprint="An output that never crosses its zero but turns back at it with a sharp corner, at twice the "
    "frequency of the drive.",
    separation="The same sine about an offset larger than its amplitude: a rectifier does not change it.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    adds=at_sensor("rectification"),
    grid=grid,
    applies=applies,
    neighbours=("sensor_nonlinearity",),
)
