"""Formulas that can replace learned elements: they describe the physics of an element and never name it.

Each is an ordinary `Effect` with few parameters, at the location and of the kind of the learned element that it may
replace. They are not in the catalogue and take no part in a search.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

from phnn.effects import kinds
from phnn.effects.additions import at_amplifier, at_sensor
from phnn.effects.declaration import bounded, constant, nonnegative, signed
from phnn.effects.effect import Effect, Points, gathered, in_all_forms
from phnn.effects.learned import Within

_WIDTH = nonnegative("delta_U", "V", "half width of the dead band", 1e3, 0.1)
_ONLY_WIDTH = replace(_WIDTH, strength=True)
_LOST_IN_BAND = bounded("a_U", "1", "gain lost in the dead band", 0.0, 1.0, 0.1, strength=True)


AMPLIFIER_DEAD_BAND = Effect(
    name="amplifier_dead_band",
    kind=kinds.AMPLIFIER_STATIC,
    equation=r"V = u - \mathrm{clip}(u, \pm\delta_U)",
    statement="The amplifier has a dead band: its output is zero while the command is within {delta_U} of zero, and "
    "beyond that the voltage is smaller by the same amount.",
    fingerprint="Plateaus about zero volts, at one voltage whatever the frequency.",
    separation="A small sine about an offset well above the dead band: there the amplifier is linear.",
    references=("Horowitz & Hill 2015, The Art of Electronics, sec. 2.4 (crossover distortion)",),
    declares=(_ONLY_WIDTH, constant("a_U", "1", _LOST_IN_BAND.description)),
    adds=at_amplifier("dead_band", "a_U", "delta_U"),
    grid=Points(*({"delta_U": (share, "voltage"), "a_U": 1.0} for share in (1e-3, 0.01, 0.05))),
    neighbours=("amplifier_saturation",),
    rescale=Within((_ONLY_WIDTH,), may_vanish=True),
).or_as(
    equation=r"V = u - a_U\,\mathrm{clip}(u, \pm\delta_U)",
    statement="The amplifier loses the share {a_U} of its gain while its command is within {delta_U} of zero.",
    declares=(_LOST_IN_BAND, _WIDTH),
    grid=Points(*({"a_U": 0.1, "delta_U": (share, "voltage")} for share in (0.02, 0.1, 0.3))),
    rescale=Within((_LOST_IN_BAND,), may_vanish=True),
)


_LOST_BEYOND = bounded("a_K", "1", "gain lost beyond a level", 0.0, 1.0, 0.1, strength=True)


AMPLIFIER_KNEE = Effect(
    name="amplifier_knee",
    kind=kinds.AMPLIFIER_STATIC,
    equation=r"V = u - a_K \max(u - U_K, 0)",
    statement="The amplifier loses the share {a_K} of its gain beyond {U_K}.",
    fingerprint="Flat tops on one side of the motion, at one voltage whatever the frequency.",
    separation="A small sine about two offsets of the voltage, one on either side of the level.",
    references=("Fleming & Leang 2014, Design, Modeling and Control of Nanopositioning Systems, ch. 14",),
    declares=(_LOST_BEYOND, signed("U_K", "V", "level of the lost gain", 1e4, 1.0)),
    adds=at_amplifier("knee"),
    grid=Points(*({"a_K": 0.1, "U_K": (share, "voltage")} for share in (0.8, -0.8, 0.4))),
    neighbours=("amplifier_saturation",),
    rescale=Within((_LOST_BEYOND,), may_vanish=True),
)


_CLOCK_MOST = 0.1
_CLOCK_RATE = bounded("kappa_Z", "1", "how much the clock runs fast", -_CLOCK_MOST, _CLOCK_MOST, 1e-5, strength=True)


SENSOR_CLOCK = Effect(
    name="sensor_clock",
    kind=kinds.SENSOR_OVER_TIME,
    equation=r"y(t) = q((1 - \kappa_Z)\,t)",
    statement="The clock of the sensor runs fast by the share {kappa_Z} against that of the input (slow where it is "
    "negative), so that the measured displacement lags more and more behind.",
    fingerprint="A phase error that grows in proportion to frequency and to the time since the start.",
    separation="The same sine twice in one long recording, at its start and at its end: the phase differs.",
    references=("Mills 2006, Computer Network Time Synchronization, ch. 1",),
    declares=(_CLOCK_RATE, constant("one_Z", "1", "unit of the clock's change")),
    adds=at_sensor("clock"),
    grid=Points({"kappa_Z": (5e-4 / math.pi, "1/fastest", "1/duration"), "one_Z": 1.0}),
    neighbours=("sensor_lag",),
    rescale=Within((_CLOCK_RATE,)),
)


# The gain keeps its sign.
_GAIN_MOST = 0.9
_GAIN_SLOPE = bounded("kappa_G", "1", "change of the sensor's gain", -_GAIN_MOST, _GAIN_MOST, 0.01, strength=True)


SENSOR_GAIN_DRIFT = Effect(
    name="sensor_gain_drift",
    kind=kinds.SENSOR_OVER_TIME,
    equation=r"y = q\,(1 + \kappa_G\,t/T_G)",
    statement="The gain of the sensor drifts: it changes by the share {kappa_G} within {T_G} of every recording.",
    fingerprint="An amplitude that grows or falls steadily from the start of every recording.",
    separation="The same sine twice in one long recording, at its start and at its end: the amplitude differs.",
    references=("Fraden 2016, Handbook of Modern Sensors, ch. 3",),
    declares=(
        _GAIN_SLOPE,
        constant("bend_G", "1", "curvature of the gain over time"),
        constant("early_G", "1", "part of the gain that follows the logarithm of time"),
        constant("T_G", "s", "time over which the gain changes"),
    ),
    adds=at_sensor("drifting_gain"),
    grid=Points({"kappa_G": 1e-3, "bend_G": 0.0, "early_G": 0.0, "T_G": "duration"}),
    neighbours=("sensor_drift", "self_heating"),
    rescale=Within((_GAIN_SLOPE,)),
)


@cache
def formulas() -> dict[str, Effect]:
    """Return all formulas by name."""
    return gathered(__name__)


def formulas_for(element: Effect) -> list[Effect]:
    """Return the formulas that may replace a learned element, in all forms."""
    return [f for f in in_all_forms(formulas().values()) if f.kind == element.kind]
