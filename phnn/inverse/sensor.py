"""Sensor blocks backwards: the displacement that makes a block report an output.

=======================  ===========================================================================================
static blocks            the block's own characteristic, solved for its argument (`phnn.inverse.elementwise`)
``lag``                  ``q = y + τ ẏ``
``clock``                ``q((1 − c s) t) = y(t)``, held at the end
``rectification``        ``q = y``, for outputs that are not negative
``play``                 ``q = y + δ s``, where ``s`` is the direction of motion. It changes sign while ``|ẏ|`` is below
                         a fiftieth of its largest value, for no mass crosses the play at once
=======================  ===========================================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain import SENSORS
from phnn.errors import InputRefused
from phnn.inverse.elementwise import solve_rising
from phnn.inverse.path import derivative
from phnn.inverse.signal import Signal
from phnn.setup import Setup
from phnn.signals.long_spline import spline

Array = NDArray[np.float64]

# Blocks whose output at an instant is a function of the input at that instant, and of time.
STATIC = ("drift", "polynomial", "zero", "knee", "cubic", "drifting_gain")
_REACHED = 1e-6
# Share of the largest speed below which a play is crossed.
_CROSSING = 0.02
# Share of the range of an output that may lie below zero and still count as none: rounding, and corrections.
_BELOW = 1e-3


def displacement(setup: Setup, output: Signal, dt: float, strict: bool = True) -> Signal:
    """The displacement at the samples that makes the sensor report an output.

    Args:
        output: at the samples; dt: their interval [s].
        strict: refuse an output that a block cannot report, where a corrected one is taken as near as it can be.

    Raises:
        InputRefused: a block that has no inverse, or an output that it cannot report; names it.
    """
    t: Array = dt * np.arange(output.values.size, dtype=np.float64)
    for block in reversed(setup.sensor):
        values = [setup.parameters[name].value for name in block.parameters]
        if block.kind in STATIC:
            output = _static(block.kind, output, t, values)
        elif block.kind in _INVERSES:
            if strict and block.kind == "rectification":
                _check_sign(output.values, t)
            output = output.then(_INVERSES[block.kind](output.values, t, *values))
        else:
            raise InputRefused(f"the sensor block {block.kind} has no inverse: give a model without it")
    return output


def _static(kind: str, output: Signal, t: Array, values: list[float]) -> Signal:
    found = solve_rising(lambda q: np.asarray(SENSORS[kind](q, t, *values)), output.values)
    lost = np.abs(found.missed) > _REACHED * np.abs(output.values).max(initial=0.0)
    return output.then(found.x, lost, f"the sensor's {kind.replace('_', ' ')}")


def _lag(y: Array, t: Array, tau: float) -> Array:
    return y + tau * derivative(y, t[1] - t[0])


def _clock(y: Array, t: Array, change: float, scale: float) -> Array:
    places = np.minimum(np.arange(y.size) / (1.0 - change * scale), y.size - 1.0)
    return np.asarray(spline(y)(places))


def _check_sign(y: Array, t: Array) -> None:
    if y.min() < -_BELOW * np.ptp(y):
        worst = int(np.argmin(y))
        raise InputRefused(
            f"the model's sensor reports |q|, and the reference is {y[worst]:.4g} m at t = {t[worst]:.6g} s: give a "
            "reference that is not negative"
        )


def _rectification(y: Array, t: Array) -> Array:
    return np.maximum(y, 0.0)


def _play(y: Array, t: Array, width: float) -> Array:
    rate = derivative(y, t[1] - t[0])
    slow = _CROSSING * np.abs(rate).max()
    return y + width * rate / np.sqrt(rate**2 + slow**2) if slow > 0.0 else y


_INVERSES: dict[str, Callable[..., Any]] = {
    "lag": _lag,
    "clock": _clock,
    "rectification": _rectification,
    "play": _play,
}
