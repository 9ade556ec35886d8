"""Settings with their bounds: declared once, in the dataclass that has them, and refused alike wherever they come from.

@dataclass(frozen=True)
class Options:
    starts: int = whole(4, least=1)
    error_bound_sigma: float = positive(1.0)

    def __post_init__(self) -> None:
        check(self)
"""

from __future__ import annotations

import math
from dataclasses import field, fields
from numbers import Integral, Real
from typing import Any

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS

_LEAST = "least"


def whole(default: int, least: int = 0) -> Any:
    """A setting that is a whole number, ``least`` or more; at most what `phnn.intake.limits` accepts."""
    return field(default=default, metadata={_LEAST: least})


def positive(default: float) -> Any:
    """A setting that is a positive number."""
    return field(default=default, metadata={_LEAST: 0.0})


def check(settings: Any) -> None:
    """Hold the values of a dataclass of settings against their bounds.

    Raises:
        InputRefused: names a setting of the wrong kind or out of range.
    """
    for name, least in bounds_of(type(settings)).items():
        checked(name, getattr(settings, name), least)


def bounds_of(kind: type) -> dict[str, float]:
    """The least value of every number among the settings of a dataclass, by name; a float for a positive number."""
    return {f.name: f.metadata[_LEAST] for f in fields(kind) if _LEAST in f.metadata}


def checked(name: str, value: Any, least: float) -> float:
    """The value of a setting, as a float where ``least`` is one.

    Raises:
        InputRefused: wrong kind or out of range.
    """
    if isinstance(least, float):
        if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < math.inf:
            raise InputRefused(f"setting {name}={value} must be a positive number")
        return float(value)
    most = LIMITS.most(name.rpartition(".")[2])
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise InputRefused(f"setting {name}={value} must be a whole number, {least} or more")
    if value > most:
        raise InputRefused(f"setting {name} must be a whole number, {most} or less")
    return int(value)
