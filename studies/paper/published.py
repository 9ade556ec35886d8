"""Table 3 as printed, and the amplitudes that it implies.

A fit percentage and a root mean square error of the same recording give the spread of what was measured,

    std(y) = RMSE / (1 − fit/100),

so that Table 3 tells the amplitude √2 std(y) of every recorded sine although no recording was published. The printed
digits of the fit leave 0.1 to 0.2 % of it open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phnn.recordings.excitation import excitation_of
from phnn.recordings.recording import Recording

_NEAR = 0.05  # relative distance at which a sine still counts as one of the table's


@dataclass(frozen=True)
class Printed:
    """A line of Table 3: fit percentages and root mean square errors [m] of the two models."""

    phs_fit: float
    bouc_wen_fit: float
    phs_rmse: float
    bouc_wen_rmse: float

    def fit(self, model: str) -> float:
        """Fit percentage of ``"phs"`` or ``"bouc_wen"``."""
        return {"phs": self.phs_fit, "bouc_wen": self.bouc_wen_fit}[model]

    def rmse(self, model: str) -> float:
        """Root mean square error of ``"phs"`` or ``"bouc_wen"``, m."""
        return {"phs": self.phs_rmse, "bouc_wen": self.bouc_wen_rmse}[model]


TABLE_3 = {
    "1 Hz": Printed(97.11, 96.35, 2.3251e-6, 2.9358e-6),
    "10 Hz": Printed(97.23, 94.97, 2.2284e-6, 4.0418e-6),
    "25 Hz": Printed(97.41, 94.02, 2.0335e-6, 4.6937e-6),
    "50 Hz": Printed(96.59, 93.06, 2.6051e-6, 5.2988e-6),
    "75 Hz": Printed(96.69, 91.75, 2.4579e-6, 6.1254e-6),
    "100 Hz": Printed(96.99, 90.80, 2.2222e-6, 6.7942e-6),
    "150 Hz": Printed(96.98, 90.14, 2.1947e-6, 7.1673e-6),
    "Step": Printed(97.59, 97.07, 2.9342e-6, 3.5302e-6),
    "Chirp": Printed(95.36, 94.60, 3.6480e-6, 4.2410e-6),
}
_HERTZ = {float(name.split()[0]): name for name in TABLE_3 if name.endswith("Hz")}


def line_of(recording: Recording) -> str | None:
    """The line of Table 3 that a recording repeats, by the kind and frequency of its input; ``None`` where it has none.

    The amplitude is not asked for: the paper's was 75 V throughout.
    """
    found = excitation_of(recording.u, recording.dt)
    if found.kind == "steps":
        return "Step"
    if found.kind == "chirp":
        return "Chirp"
    near = [f for f in _HERTZ if abs(found.frequency - f) <= _NEAR * f]
    return _HERTZ[near[0]] if found.kind == "sine" and near else None


def implied_amplitude(fit_percent: float, rmse: float) -> float:
    """``√2 RMSE / (1 − fit/100)``: the amplitude of a recorded sine, in the unit of ``rmse``."""
    return float(np.sqrt(2.0) * rmse / (1.0 - fit_percent / 100.0))


def highest_fit(measured: float, model: float) -> float:
    """The fit percentage that a model of another amplitude cannot exceed, whatever its phase and shape.

    By the triangle inequality ``‖y − ŷ‖ ≥ |‖y − mean(y)‖ − ‖ŷ − mean(ŷ)‖|``, hence ``fit ≤ 100 (1 − |1 − Â/A|)``.
    """
    return 100.0 * (1.0 - abs(1.0 - model / measured))
