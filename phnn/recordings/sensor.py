"""Known properties of the sensor: saturation, rectification, lag, or a reading of the output's velocity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused
from phnn.parameters import quantity
from phnn.recordings.units import find_unit
from phnn.recordings.values import flag, keys_of, mapping, shown

# A sample sits at a limit of the sensor within this share of the range: numbers in files are rounded.
_AT_LIMIT = 1e-4


@dataclass(frozen=True)
class Sensor:
    """What the manifest says about the sensor, SI.

    Attributes:
        saturates: least and largest output that the sensor can show; infinite where there is no limit. Samples there
            say only that the true output lies at or beyond the limit.
        rectified: it shows the size of the output without its sign.
        lag: its time constant [s].
        derivative: how many times what it measures is derived from the network's output by time: 0, 1 or 2.
        unit: SI unit of the limits.
    """

    saturates: tuple[float, float] = (-math.inf, math.inf)
    rectified: bool = False
    lag: float = 0.0
    derivative: int = False
    unit: str = ""

    @property
    def is_limited(self) -> bool:
        """Whether it saturates at all."""
        return math.isfinite(self.saturates[0]) or math.isfinite(self.saturates[1])

    def at_limit(self, y: NDArray[np.float64]) -> NDArray[np.int8]:
        """(N,) 1 where a recorded output sits at the upper limit, -1 where at the lower one, 0 between them."""
        if not self.is_limited:
            return np.zeros(y.size, dtype=np.int8)
        room = _AT_LIMIT * float(np.ptp(y))
        return (y >= self.saturates[1] - room).astype(np.int8) - (y <= self.saturates[0] + room).astype(np.int8)

    def limited(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) an output as the sensor shows it."""
        return np.clip(y, *self.saturates) if self.is_limited else y

    def words(self, y: NDArray[np.float64]) -> str:
        """What is known, and how many samples (N,) sit at a limit; empty where nothing is."""
        found = []
        if self.is_limited:
            ends = [quantity(limit, self.unit) for limit in self.saturates if math.isfinite(limit)]
            count = int(np.sum(self.at_limit(y) != 0))
            found.append(f"saturates at {' and '.join(ends)}, where {count} samples sit: they say no more than that")
        found += ["shows the size without its sign"] if self.rectified else []
        found += [f"lags by {quantity(self.lag, 's')}"] if self.lag else []
        found += [
            ("measures the rate of the output", "measures the second derivative of the output")[self.derivative - 1]
        ] * bool(self.derivative)
        return "; ".join(found)


PLAIN = Sensor()
_DERIVATIVES = ("derivative", "second_derivative")


def sensor_of(value: Any, where: str) -> Sensor:
    """What a manifest says under ``sensor``."""
    content = mapping(value, where)
    keys_of(content, ("saturates", "rectified", "lag", *_DERIVATIVES), where)
    said = {key: key in content and flag(content[key], f"{where}: {key}") for key in _DERIVATIVES}
    saturates, unit = _limits(content, f"{where}: saturates")
    return Sensor(
        saturates,
        "rectified" in content and flag(content["rectified"], f"{where}: rectified"),
        _lag(content, f"{where}: lag"),
        2 if said["second_derivative"] else said["derivative"],
        unit,
    )


def check_unit_of_limits(sensor: Sensor, si: str, label: str, where: object) -> None:
    """Refuse limits in a unit that is not one of the output. Raises InputRefused."""
    if sensor.is_limited and sensor.unit != si:
        raise InputRefused(
            f"{where}: {label} is in units of {si}, but recordings.yaml gives limits of the sensor in {sensor.unit}: "
            f"give them in the unit of the output, sensor: {{saturates: [LEAST {si}, LARGEST {si}]}}"
        )


def _limits(content: Mapping[str, Any], where: str) -> tuple[tuple[float, float], str]:
    if "saturates" not in content:
        return PLAIN.saturates, ""
    said = content["saturates"]
    if not isinstance(said, list) or len(said) != 2 or said == [None, None]:
        raise InputRefused(
            f"{where}: {shown(said)} is no pair of limits: write [0 V, 10 V], null for a side without a limit"
        )
    found = [None if limit is None else _physical(limit, where, "10 V") for limit in said]
    units = {unit for pair in found if pair is not None for unit in pair[1:]}
    lower, upper = (free if pair is None else pair[0] for pair, free in zip(found, PLAIN.saturates, strict=True))
    if len(units) > 1 or not lower < upper:
        raise InputRefused(f"{where}: {shown(said)}: write the lower limit first, both in one unit, as [0 V, 10 V]")
    return (lower, upper), units.pop()


def _lag(content: Mapping[str, Any], where: str) -> float:
    if "lag" not in content:
        return 0.0
    lag, unit = _physical(content["lag"], where, "2 ms")
    if unit != "s" or not lag > 0.0:
        raise InputRefused(f"{where}: {shown(content['lag'])} is no time constant: write it as 2 ms")
    return lag


def _physical(value: Any, where: str, example: str) -> tuple[float, str]:
    """SI value and SI unit of a text such as ``10 V``."""
    size, _, unit = str(value).strip().partition(" ")
    known = find_unit(unit) if unit else None
    try:
        number = float(size)
    except ValueError:
        number = math.nan
    if known is None or not math.isfinite(number):
        cause = "has no unit" if not unit and math.isfinite(number) else "is no number with a unit"
        raise InputRefused(f"{where}: {shown(value)} {cause}: write it as {example}")
    return known.factor * number + known.offset, known.si
