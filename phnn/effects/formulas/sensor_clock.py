"""A sensor whose clock is not that of the input."""

from __future__ import annotations

import math
from collections.abc import Mapping

from phnn.effects.effect import Effect, Scales, no_range
from phnn.effects.learned.strengths import within
from phnn.parameters import Parameter, constant
from phnn.setup import Block, Setup

_MOST = 0.1
_RATE, _ONE = "kappa_Z", "one_Z"


def build(setup: Setup, values: Mapping[str, float]) -> Setup:
    """``y(t) = q((1 − κ) t)``."""
    rate = Parameter(_RATE, values[_RATE], "1", -_MOST, _MOST, typical=1e-5, description="how much the clock runs fast")
    return setup.with_block(
        "sensor", Block("clock", (_RATE, _ONE)), (rate, constant(_ONE, 1.0, "1", "unit of the clock's change"))
    )


def grid(scales: Scales) -> list[dict[str, float]]:
    """Nearly linear in its strength: one point."""
    return [{_RATE: 1e-3 / (2.0 * math.pi * scales.fastest * scales.duration), _ONE: 1.0}]


EFFECT = Effect(
    name="sensor_clock",
    location="sensor",
    kind="over time",
    equation=r"y(t) = q((1 - \kappa_Z)\,t)",
    statement="The clock of the sensor runs fast by the share {kappa_Z} against that of the input (slow where it is "
    "negative), so that the measured displacement lags more and more behind.",
    fingerprint="A phase that runs away in proportion to frequency and to the time since the start.",
    separation="The same sine twice in one long recording, at its start and at its end: the phase differs.",
    references=("Mills 2006, Computer Network Time Synchronization, ch. 1",),
    passive=False,
    strength=_RATE,
    one_sided=False,
    grid=grid,
    build=build,
    parameters=(_RATE, _ONE),
    plausible=no_range(_RATE, _ONE),
    rescale=within({_RATE: (-_MOST, _MOST)}),
    neighbours=("sensor_lag",),
)
