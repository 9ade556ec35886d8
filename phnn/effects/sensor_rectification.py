"""A sensor that shows the size of the displacement without its sign."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales
from phnn.setup import Block, Setup

_BLOCK = Block("rectification")


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y = |q|`` behind the network."""
    return setup.with_block("sensor", _BLOCK, ())


def grid(scales: Scales) -> list[dict[str, float]]:
    """There is nothing to choose."""
    return [{}]


def applies(setup: Setup) -> bool:
    """No block of the sensor rectifies already."""
    return _BLOCK not in setup.sensor


EFFECT = Effect(
    name="sensor_rectification",
    location="sensor",
    kind="nonlinear",
    equation=r"y = |q|",
    statement="The sensor shows how far the output is from its zero, not on which side: it rectifies.",
    fingerprint="An output that never crosses its zero but turns back at it with a sharp corner, at twice the "
    "frequency of the drive.",
    separation="The same sine about an offset larger than its amplitude: a rectifier leaves that alone.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    passive=False,
    strength=None,
    one_sided=True,
    grid=grid,
    build=build,
    parameters=(),
    applies=applies,
    neighbours=("sensor_nonlinearity",),
)
