"""A sensor whose clock runs at another rate than that of the input."""

from __future__ import annotations

import math

from phnn.effects import Effect, Scales, at_sensor, bounded, constant, kinds
from phnn.effects.learned.strengths import Within

_MOST = 0.1
_RATE = bounded("kappa_Z", "1", "how much the clock runs fast", -_MOST, _MOST, 1e-5, strength=True)


def grid(scales: Scales) -> list[dict[str, float]]:
    """One point: the law is nearly linear in its strength."""
    return [{"kappa_Z": 1e-3 / (2.0 * math.pi * scales.fastest * scales.duration), "one_Z": 1.0}]


EFFECT = Effect(
    name="sensor_clock",
    kind=kinds.SENSOR_OVER_TIME,
    equation=r"y(t) = q((1 - \kappa_Z)\,t)",
    statement="The clock of the sensor runs fast by the share {kappa_Z} against that of the input (slow where it is "
    "negative), so that the measured displacement lags more and more behind.",
    fingerprint="A phase error that grows in proportion to frequency and to the time since the start.",
    separation="The same sine twice in one long recording, at its start and at its end: the phase differs.",
    references=("Mills 2006, Computer Network Time Synchronization, ch. 1",),
    declares=(_RATE, constant("one_Z", "1", "unit of the clock's change")),
    adds=at_sensor("clock"),
    grid=grid,
    neighbours=("sensor_lag",),
    rescale=Within((_RATE,)),
)
