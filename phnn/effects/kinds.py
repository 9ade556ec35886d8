"""Kinds of effects: the local variables through which they act, and their location.

A kind is one object for the dictionary of generic functions, for the effects and for the words of a report.
"""

from __future__ import annotations

from dataclasses import dataclass, field

LOCATIONS = (
    "amplifier", "electrical", "hysteron", "coupling", "mechanical", "thermal", "sensor", "environment",
)  # fmt: skip
# Variables of kinds whose dictionary has no axis of its own.
ELAPSED, AFTER_A_STEP = "time", "time after a step"


@dataclass(frozen=True)
class Kind:
    """The kind of an effect.

    Attributes:
        location: one of `LOCATIONS`.
        name: in words, unique at its location.
        history: the past variables on which it depends, if a static plot does not show that; ``{output}``, ``{rate}``
            and ``{source}`` stand for the words of the system's domain.
        learned: name of the learned one-port of this kind; empty if there is none.
        axis: variable on which it acts, if its generic functions have none.
    """

    location: str
    name: str
    history: str = field(default="", compare=False)
    learned: str = field(default="", compare=False)
    axis: str = field(default="", compare=False)

    @property
    def key(self) -> str:
        """Location and name as one text, ``location/name``."""
        return f"{self.location}/{self.name}"


# Changes of the command by the amplifier.
LAG = Kind("amplifier", "lag")
LIMIT = Kind("amplifier", "limit")
SLEW = Kind("amplifier", "slew", "on the rate of the {source}")
OFFSET = Kind("amplifier", "offset")
AMPLIFIER_STATIC = Kind("amplifier", "static")

LEAKAGE = Kind("electrical", "leakage", "on the past of the voltages that the hysterons hold", axis=AFTER_A_STEP)

SHAPE = Kind("hysteron", "shape", "on the history of the {output}, as a hysteron does", axis="displacement")
THRESHOLD_BY_DISPLACEMENT = Kind("hysteron", "threshold that follows the displacement")
THRESHOLD_BY_RATE = Kind("hysteron", "threshold that follows the rate")
THRESHOLD_OVER_TIME = Kind("hysteron", "threshold over time", axis=ELAPSED)
CAPACITANCE_BY_CHARGE = Kind(
    "hysteron", "capacitance that follows the charge", "on the voltages that the hysterons hold"
)

FORCE_BY_VOLTAGE = Kind("coupling", "force against voltage")
RATIO_BY_DISPLACEMENT = Kind("coupling", "ratio that follows the displacement")
RATIO_BY_PAST_VOLTAGE = Kind(
    "coupling", "ratio that follows past voltage", "on how high the {source} was before", axis=ELAPSED
)
RATIO_OVER_TIME = Kind("coupling", "ratio over time", axis=ELAPSED)
RATIO_BY_WARMTH = Kind(
    "thermal", "ratio that follows the warmth", "on how much energy was dissipated before", axis=ELAPSED
)

# Forces on the moving part.
ELASTIC = Kind("mechanical", "elastic", learned="learned_spring")
DISSIPATIVE = Kind("mechanical", "dissipative", learned="learned_damper")
MEMORY = Kind("mechanical", "memory", learned="learned_relaxation")
DAMPING_BY_DISPLACEMENT = Kind("mechanical", "damping that follows the displacement")
PLAY = Kind("mechanical", "play", "on the turning points of the {source}")
MODE = Kind("mechanical", "mode", "on the rate at which the {rate} changes, and on its past")
RINGING_MODE = Kind(
    "mechanical",
    "ringing mode",
    "on the rate at which the {rate} changed long before, at the frequency where the error is largest",
)
CONSTANT_FORCE = Kind("mechanical", "constant")

# Changes of the measured quantity by the sensor.
SENSOR_NONLINEAR = Kind("sensor", "nonlinear")
SENSOR_STATIC = Kind("sensor", "static")
LAG_OR_PLAY = Kind("sensor", "lag or play", "on the rate of the {output} and on its turning points")
GAIN_DRIFT = Kind("sensor", "gain that drifts", "on the {output}, the more or the less of it the later it is")
CLOCK = Kind("sensor", "clock")
DRIFT = Kind("sensor", "drift")
SENSOR_OVER_TIME = Kind("sensor", "over time")
OVER_TIME = (THRESHOLD_OVER_TIME, RATIO_OVER_TIME, SENSOR_OVER_TIME)

LINES = Kind("environment", "lines", "on time alone, in lines")
