"""Amplifier blocks backwards: the command that makes a block give a voltage.

Signals stand at the nodes of the sub-steps, equally far apart. Derivatives are central differences, an error of second
order in the step, which the iteration on the complete model removes.

=======================  ===========================================================================================
static blocks            the block's own characteristic, solved for its argument (`phnn.inverse.elementwise`)
``lowpass``              ``u = V + τ V̇``
``second_order_lowpass`` ``u = V + 2ζ τ V̇ + τ² V̈``
``delay``                ``u(t) = V(t + τ)``, held at the end
``slew_limit``           ``u = V`` where ``|V̇| ≤ S``; elsewhere out of reach
``bouc_wen``             ``u = V``; the iteration finds the rest
=======================  ===========================================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.chain import AMPLIFIERS
from phnn.errors import InputRefused
from phnn.inverse.elementwise import solve_rising
from phnn.inverse.signal import Signal
from phnn.setup import Block, Setup
from phnn.signals.long_spline import spline

Array = NDArray[np.float64]

# Blocks whose output at an instant is a function of the input at that instant.
STATIC = ("saturation", "soft_saturation", "gain", "offset", "knee", "dead_band")
# Share of a limit by which a signal may exceed it in rounding; share of a signal's range that counts as reached.
_ROUNDING, _REACHED = 1e-9, 1e-6


def command(setup: Setup, voltage: Signal, h: float) -> Signal:
    """The command at the nodes that makes the amplifier give a voltage at its end.

    Args:
        voltage: at the nodes; h: their interval [s].

    Raises:
        InputRefused: a block that has no inverse; names it.
    """
    for block in reversed(setup.amplifier):
        values = [setup.parameters[name].value for name in block.parameters]
        if block.kind in STATIC:
            voltage = _static(block, voltage, values)
        elif block.kind in _INVERSES:
            voltage = _INVERSES[block.kind](voltage, h, *values)
        else:
            raise InputRefused(
                f"the amplifier block {block.kind} has no inverse: give a model whose input is a voltage or a force"
            )
    return voltage


def command_at_rest(setup: Setup, voltage: float) -> float:
    """The constant command under which the amplifier gives a constant voltage."""
    at_rest = Signal(np.full(2, voltage), np.zeros(2, dtype=bool))
    return float(command(setup, at_rest, 1.0).values[0])


def _static(block: Block, voltage: Signal, values: list[float]) -> Signal:
    def characteristic(u: Array) -> Array:
        return np.asarray(AMPLIFIERS[block.kind](u[:, None], np.ones(1), 0.0, *values))[:, 0]

    found = solve_rising(characteristic, voltage.values)
    lost = np.abs(found.missed) > _REACHED * np.abs(voltage.values).max(initial=0.0)
    return voltage.then(found.x, lost, f"the amplifier's {block.kind.replace('_', ' ')}")


def _lowpass(voltage: Signal, h: float, tau: float) -> Signal:
    return voltage.then(voltage.values + tau * _rate(voltage.values, h))


def _second_order(voltage: Signal, h: float, tau: float, zeta: float) -> Signal:
    rate = _rate(voltage.values, h)
    return voltage.then(voltage.values + 2.0 * zeta * tau * rate + tau * tau * _rate(rate, h))


def _delay(voltage: Signal, h: float, tau: float) -> Signal:
    last = voltage.values.size - 1.0
    places = np.minimum(np.arange(voltage.values.size) + tau / h, last)
    return voltage.then(np.asarray(spline(voltage.values)(places)))


def _slew_limit(voltage: Signal, h: float, limit: float) -> Signal:
    fast = np.abs(np.diff(voltage.values)) > limit * h * (1.0 + _ROUNDING)
    lost = np.append(fast, False) | np.insert(fast, 0, False)
    return voltage.then(voltage.values, lost, "the amplifier's slew limit")


def _bouc_wen(voltage: Signal, h: float, *values: float) -> Signal:
    return voltage


def _rate(values: Array, h: float) -> Array:
    return np.asarray(np.gradient(values, h, edge_order=2 if values.size > 2 else 1))


_INVERSES: dict[str, Callable[..., Any]] = {
    "lowpass": _lowpass,
    "second_order_lowpass": _second_order,
    "delay": _delay,
    "slew_limit": _slew_limit,
    "bouc_wen": _bouc_wen,
}
