"""The use of each part of a recording for a model: identification, interpolation, or extrapolation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phnn.identification.evaluate import Evaluation
from phnn.recordings.excitation import Excitation, excitation_of
from phnn.recordings.recording import Recording

IDENTIFICATION, CONFIRMATION, OUTSIDE = "identification", "confirmation", "outside"
USES = {IDENTIFICATION: "identified", CONFIRMATION: "held out, inside", OUTSIDE: "held out, outside"}
# What lies nearer than this to the edge of the range is still within it.
_SAME = 0.05


@dataclass(frozen=True)
class Range:
    """What the identification recordings reach.

    Attributes:
        low_Hz, high_Hz: of all that oscillate; NaN where none does.
        smallest: least amplitude (half the range of the input) of those; peak: largest absolute input of all.
    """

    low_Hz: float
    high_Hz: float
    smallest: float
    peak: float

    def holds(self, excitation: Excitation, peak: float) -> bool:
        """Whether an input stays within; steps have no frequency and no least amplitude."""
        if peak > (1.0 + _SAME) * self.peak:
            return False
        if not _oscillates(excitation) or np.isnan(self.high_Hz):
            return True
        return (
            excitation.low_Hz >= (1.0 - _SAME) * self.low_Hz
            and excitation.high_Hz <= (1.0 + _SAME) * self.high_Hz
            and excitation.amplitude >= (1.0 - _SAME) * self.smallest
        )


def identified_range(recordings: Sequence[Recording]) -> Range:
    """The range of the recordings that serve identification, at least in part."""
    chosen = [r for r in recordings if r.mask("identification").any()]
    moving = [e for e in (excitation_of(r.u, r.dt) for r in chosen) if _oscillates(e)]
    return Range(
        low_Hz=min((e.low_Hz for e in moving), default=float("nan")),
        high_Hz=max((e.high_Hz for e in moving), default=float("nan")),
        smallest=min((e.amplitude for e in moving), default=float("nan")),
        peak=max((_peak(r) for r in chosen), default=0.0),
    )


def uses(recordings: Sequence[Recording]) -> dict[str, str]:
    """Use by name of the part: ``identification``, ``confirmation``, or ``outside`` for a recording held out that lies
    outside the identified range of frequency or amplitude.
    """
    reached = identified_range(recordings)
    found = {}
    for r in recordings:
        inside = reached.holds(excitation_of(r.u, r.dt), _peak(r))
        for part in r.parts:
            if part.use != "nuisance":
                found[part.name] = part.use if part.use == IDENTIFICATION or inside else OUTSIDE
    return found


def over_noise(evaluation: Evaluation, kinds: Mapping[str, str], use: str) -> float:
    """Root mean square of the residual over noise over the parts of one use, as `uses` gives it; NaN for none."""
    found = [p.residual_over_noise for p in evaluation.parts if kinds[p.name] == use]
    return float(np.sqrt(np.mean(np.square(found)))) if found else float("nan")


def _oscillates(excitation: Excitation) -> bool:
    return excitation.high_Hz > 0.0


def _peak(recording: Recording) -> float:
    return float(np.abs(recording.u).max())
