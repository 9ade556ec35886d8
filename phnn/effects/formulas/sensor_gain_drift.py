"""A sensor whose gain drifts."""

from __future__ import annotations

from phnn.effects import Effect, Scales, at_sensor, bounded, constant, kinds
from phnn.effects.learned.strengths import Within

# The gain keeps its sign.
_MOST = 0.9
_SLOPE = bounded("kappa_G", "1", "change of the sensor's gain", -_MOST, _MOST, 0.01, strength=True)


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is linear in its strength."""
    return [{"kappa_G": 1e-3, "bend_G": 0.0, "T_G": scales.duration}]


EFFECT = Effect(
    name="sensor_gain_drift",
    kind=kinds.SENSOR_OVER_TIME,
    equation=r"y = q\,(1 + \kappa_G\,t/T_G)",
    statement="The gain of the sensor drifts: it changes by the share {kappa_G} within {T_G} of every recording.",
    fingerprint="An amplitude that grows or falls steadily from the start of every recording.",
    separation="The same sine twice in one long recording, at its start and at its end: the amplitude differs.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    declares=(
        _SLOPE,
        constant("bend_G", "1", "curvature of the gain over time"),
        constant("T_G", "s", "time over which the gain changes"),
    ),
    adds=at_sensor("drifting_gain"),
    grid=grid,
    neighbours=("sensor_drift", "self_heating"),
    rescale=Within((_SLOPE,)),
)
