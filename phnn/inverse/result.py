"""The result of an inverse: the command, the motion it reaches, and what cannot be reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.inverse.options import InverseOptions

Array = NDArray[np.float64]

SCHEMA = "phnn.inverse/1"


@dataclass(frozen=True)
class Stretch:
    """A time in which the output misses the reference by more than the tolerance.

    Attributes:
        start, end: times of its first and last sample [s].
        error: the largest error in it, with its sign, output minus reference [m].
        at: when [s].
        causes: why, in words; empty where nothing was out of reach and the iteration alone did not get there.
    """

    start: float
    end: float
    error: float
    at: float
    causes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Inverse:
    """The input that makes a model follow a reference.

        found = model.inverse(t, reference)
        model.simulate(found.t, found.voltage, input_before=found.voltage_before, hold=found.options.hold)
                                                             # is found.reached

    Attributes:
        t: (N,) time [s]; it begins before the reference's where there is a way into it.
        given: (N,) the reference as it was given, after the way into it [m].
        reference: (N,) what the output was to follow: the same, smoothed if that was asked for [m].
        voltage: (N,) the command [V].
        voltage_before: the constant command before the first sample, in whose equilibrium everything begins [V].
        reached: (N,) output of the complete model under that command [m].
        tolerance: error that counts as none [m].
        iterations: simulations of the complete model.
        missed: where the error is larger than that.
        messages: what a user should know, in sentences.
        options: as asked for.
    """

    t: Array
    given: Array
    reference: Array
    voltage: Array
    voltage_before: float
    reached: Array
    tolerance: float
    iterations: int
    missed: tuple[Stretch, ...]
    messages: tuple[str, ...]
    options: InverseOptions

    @property
    def error(self) -> Array:
        """(N,) output minus reference [m]."""
        return self.reached - self.reference

    @property
    def error_of_given(self) -> Array:
        """(N,) output minus the reference as it was given, what smoothing has taken from it included [m]."""
        return self.reached - self.given

    @property
    def follows(self) -> bool:
        """Whether the error is nowhere larger than the tolerance."""
        return not self.missed

    def document(self) -> dict[str, Any]:
        """The content of ``invert.json``."""
        speed = np.diff(self.voltage) / (self.t[1] - self.t[0])
        return {
            "schema": SCHEMA,
            "samples": self.t.size,
            "follows": self.follows,
            "error_max_m": float(np.abs(self.error).max()),
            "error_rms_m": float(np.sqrt(np.mean(self.error**2))),
            "error_of_given_max_m": float(np.abs(self.error_of_given).max()),
            "error_of_given_rms_m": float(np.sqrt(np.mean(self.error_of_given**2))),
            "tolerance_m": self.tolerance,
            "range_of_reference_m": float(np.ptp(self.reference)),
            "iterations": self.iterations,
            "voltage_V": [float(self.voltage.min()), float(self.voltage.max())],
            "voltage_before_V": self.voltage_before,
            "slew_V_per_s": float(np.abs(speed).max()),
            "missed": [
                {"from_s": s.start, "to_s": s.end, "error_m": s.error, "at_s": s.at, "causes": list(s.causes)}
                for s in self.missed
            ],
            "messages": list(self.messages),
            "options": {
                "smooth_Hz": self.options.smooth,
                "limits_V": None if self.options.limits is None else list(self.options.limits),
                "slew_V_per_s": self.options.slew,
                "hold": self.options.hold,
                "lead_in_s": self.options.lead_in,
            },
        }


def stretches(t: Array, error: Array, tolerance: float, lost: NDArray[np.bool_], causes: tuple[str, ...],
              least: float) -> tuple[Stretch, ...]:  # fmt: skip
    """The times in which an error is larger than the tolerance.

    Args:
        t: (N,) [s]; error: (N,) [m].
        lost: (N,) where something was out of reach, and causes: why.
        least: two stretches that are less than this time apart are one [s].
    """
    at = np.flatnonzero(np.abs(error) > tolerance)
    if not at.size:
        return ()
    groups = np.split(at, np.flatnonzero(np.diff(t[at]) > least) + 1)
    found = []
    for group in groups:
        worst = int(group[np.argmax(np.abs(error[group]))])
        # An error begins no later than this after the sample that was out of reach.
        before = int(np.searchsorted(t, t[group[0]] - least))
        why = causes if lost[before : group[-1] + 1].any() else ()
        found.append(Stretch(float(t[group[0]]), float(t[group[-1]]), float(error[worst]), float(t[worst]), why))
    return tuple(found)
