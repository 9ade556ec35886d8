"""A sensor that drifts."""

from __future__ import annotations

from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales
from phnn.parameters import Parameter
from phnn.setup import Block, Setup


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y = q + r t`` with the time of the recording."""
    rate = values["drift_rate"]
    parameter = Parameter("drift_rate", rate, "m/s", -1.0, 1.0, typical=1e-8, description="rate of the sensor's drift")
    return setup.with_block("sensor", Block("drift", ("drift_rate",)), (parameter,))


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    return [{"drift_rate": scales.noise / scales.duration}]


EFFECT = Effect(
    name="sensor_drift",
    location="sensor",
    kind="drift",
    equation=r"y = q + r\,t",
    statement="The sensor drifts by {drift_rate}, whatever the actuator does.",
    fingerprint="A ramp below the lowest excited frequency that goes on whatever the voltage does.",
    separation="A recording at zero voltage, as long as the others, after a long rest: a sensor drifts then as well, "
    "creep does not.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    passive=False,
    strength="drift_rate",
    one_sided=False,
    grid=grid,
    build=build,
    parameters=("drift_rate",),
    neighbours=("creep",),
)
