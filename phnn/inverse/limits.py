"""Limits of the command: its range and its rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.chain.amplifiers import slew_limit
from phnn.inverse.options import InverseOptions
from phnn.inverse.signal import Signal

Array = NDArray[np.float64]

# Share of a limit by which a command may exceed it in rounding.
_ROUNDING = 1e-9


def limited(command: Signal, before: float, dt: float, options: InverseOptions) -> Signal:
    """The command at the samples within its limits; it follows what was asked for where it can.

    Args:
        command: at the samples; before: the command before the first one [V].
        dt: interval of the samples [s].
    """
    if options.limits is not None:
        low, high = options.limits
        room = _ROUNDING * max(abs(low), abs(high))
        lost = (command.values < low - room) | (command.values > high + room)
        cause = f"the voltage limits {low:g} V and {high:g} V"
        command = command.then(np.clip(command.values, low, high), lost, cause)
    if options.slew is not None:
        kept = _followed(command.values, before, dt, options.slew)
        lost = np.abs(kept - command.values) > _ROUNDING * options.slew * dt
        command = command.then(kept, lost, f"the slew limit {options.slew:g} V/s")
    return command


def _followed(command: Array, before: float, dt: float, slew: float) -> Array:
    """(N,) a command that approaches what was asked for at a limited rate."""
    last = np.concatenate([[before], command[:-1]])
    # The block begins every step where it ended the one before, and has its middle on the straight line.
    steps = np.column_stack([last, 0.5 * (last + command), command])
    return slew_limit(steps, np.full(command.size, dt), before, slew)[:, 2]
