"""Simulate recordings with a stored model, and score it where their outputs were recorded.

The scores are those of every other command, with ``y`` the recorded and ``ŷ`` the simulated output:

    fit % = 100 (1 − ‖y − ŷ‖ / ‖y − mean(y)‖),    RMSE = ‖y − ŷ‖ / √N,    residual over noise = RMSE / σ

The first samples of a recording give the displacement zero and, where the start is unknown, the initial state: they
are not scored. ``σ`` is the noise floor of the recording itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.derivatives import output_derivatives
from phnn.identification.evaluate import evaluate, likely_start, score_part, with_instants
from phnn.identification.plan import Plan
from phnn.network.elements import Network
from phnn.recordings.excitation import unknown_instants
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.trajectory import measured_network, simulate


class ErrorIndices(NamedTuple):
    """With y the recorded and ŷ the simulated output of N samples, and s the standard deviation of y over these:

        RMSE = ‖y − ŷ‖ / √N,    NRMSE = RMSE / s,    R² = 1 − NRMSE²,    MAE = Σ |y − ŷ| / N,    fit = 100 (1 − NRMSE)

    RMSE and MAE have the unit of y; the fit index is the fit % of MATLAB. Without samples all are NaN; where y is
    constant, so are those that divide by s.
    """

    rmse: float
    nrmse: float
    r_squared: float
    mae: float
    fit_index: float


def error_indices(recorded: Array, simulated: Array, skipped: int = 0) -> ErrorIndices:
    """Return the indices of one output.

    Args:
        recorded, simulated: (N,) samples of one unit.
        skipped: samples at the head that are left out, which a benchmark grants to find the initial state.
    """
    y, model = np.asarray(recorded, dtype=float)[skipped:], np.asarray(simulated, dtype=float)[skipped:]
    if not y.size:
        return ErrorIndices(*[np.nan] * len(ErrorIndices._fields))
    error = y - model
    rmse, spread = float(np.sqrt(np.mean(error**2))), float(np.std(y)) if np.ptp(y) > 0.0 else 0.0
    nrmse = rmse / spread if spread > 0.0 else np.nan
    return ErrorIndices(rmse, nrmse, 1.0 - nrmse**2, float(np.mean(np.abs(error))), 100.0 * (1.0 - nrmse))


def output_spread(setup: Setup, recording: Recording, substeps: int) -> Array | None:
    """Return (N,) standard error of a prediction by the unknown instants of the input's jumps; None where it has none.

    Without a recorded output each jump may lie anywhere in its sample interval.
    """
    unknown = unknown_instants(recording)
    if not unknown.size:
        return None
    begun = likely_start(setup, recording, substeps)
    timed, covariance = with_instants(setup, recording, substeps, begun)
    if covariance.size:
        columns = output_derivatives(simulate(setup, timed, substeps, initial=begun), (), instants=True)
        return np.asarray(np.sqrt(np.einsum("ng,gh,nh->n", columns, covariance, columns)))
    total = np.zeros(recording.t.size)
    for g, assumed in enumerate(unknown):
        # Over a whole interval the output is not linear in the instant: its ends are compared.
        first, last = (np.where(np.arange(unknown.size) == g, end, unknown) for end in (0.0, 1.0))
        ends = [simulate(setup, replace(recording, instants=at), substeps, initial=begun).y for at in (first, last)]
        total += (ends[1] - ends[0]) ** 2 * (1.0 / 12.0 + (assumed - 0.5) ** 2)
    return np.sqrt(total)


Array = NDArray[np.float64]

SCHEMA = "phnn.predict/1"
_NO_OUTPUT = "no output was recorded: nothing to compare the prediction with"
_CONSTANT = "the scored output is constant, so that fit % is undefined"


@dataclass(frozen=True)
class Predicted:
    """One recording as a model predicts it.

    Attributes:
        recording: what was recorded.
        y: (N,) simulated output, SI.
        table: ``time_s``, the simulated output and, where the input jumps between samples, its standard error.
        held_out: the manifest marks the recording with ``use: confirmation``.
        whole: all samples are scored, for the first ones give no initial state.
    """

    recording: Recording
    y: Array
    table: pd.DataFrame
    held_out: bool
    whole: bool = False

    @property
    def scored(self) -> slice:
        """Return the samples that are scored; none where no output was recorded."""
        if not np.isfinite(self.recording.y).all():
            return slice(0, 0)
        parts = () if self.whole else self.recording.parts
        first = next((p.first for p in parts if p.use == "confirmation"), 0)
        return slice(first, self.recording.t.size)

    @property
    def error(self) -> Array:
        """Return (n,) recorded minus simulated output of the scored samples, SI."""
        return np.asarray((self.recording.y - self.y)[self.scored])

    @property
    def spread(self) -> Array:
        """Return (n,) recorded output of the scored samples without its mean, SI."""
        y = self.recording.y[self.scored]
        # The mean of a constant is rounded.
        return np.asarray(y - (y.mean() if np.ptp(y) > 0.0 else y))

    def indices(self, skipped: int | None = None) -> ErrorIndices:
        """Return RMSE, NRMSE, R², MAE and fit index as nonlinear_benchmarks defines them; SI, NaN where undefined.

        Args:
            skipped: samples at the head that are not scored, the ``state_initialization_window_length`` of a benchmark;
                None for those that phnn does not score. Zero and initial state are estimated from the latter, which
                may be more than a benchmark grants.
        """
        first = self.scored.start if skipped is None else skipped
        recorded = self.recording.y if self.scored.stop else self.recording.y[:0]
        return error_indices(recorded, self.y[: recorded.size], first)

    def document(self, file: str) -> dict[str, Any]:
        """Return the entry of ``predict.json``; what is undefined is None.

        Args:
            file: name of the table's file.
        """
        r, rows = self.recording, self.scored
        entry: dict[str, Any] = {"file": file, "held_out": self.held_out, "samples": rows.stop - rows.start}
        if not entry["samples"]:
            return entry | dict.fromkeys(("fit_percent", "rmse", "residual_over_noise")) | {"notes": [_NO_OUTPUT]}
        score = score_part(r, self.y, rows.start, rows.stop, r.name, "confirmation")
        notes = [] if np.isfinite(score.fit_percent) else [_CONSTANT]
        return entry | {
            "fit_percent": score.fit_percent,
            "rmse": score.rmse,
            "unit": r.units.output,
            "residual_over_noise": score.residual_over_noise if r.noise_found else None,
            "noise_floor": r.noise if r.noise_found else None,
            "noise_source": r.noise_source,
            "scored_from_s": float(r.t[rows.start]),
            "notes": notes,
        }


def predicted(setup: Setup, recording: Recording, substeps: int, held_out: bool = False) -> Predicted:
    """Simulate one recording.

    Where its output was recorded, zero and initial state come from its first samples. Else it begins as its start says,
    and from an unknown start in the state that is expected.

    Args:
        substeps: integration steps in a sample interval.
    """
    if bool(np.isfinite(recording.y).all()):
        y = evaluate(setup, Plan((recording,), {recording.name: substeps}, workers=1), {}).outputs[recording.name]
    else:
        begun = likely_start(setup, recording, substeps)
        y = recording.sensor.limited(simulate(setup, recording, substeps, initial=begun).y)
    column = _column(measured_network(setup.network, recording), recording)
    table = pd.DataFrame({"time_s": recording.t, column: y})
    spread = output_spread(setup, recording, substeps)
    if spread is not None:
        table[f"{column}_std"] = spread
    return Predicted(recording, y, table, held_out)


def _column(network: Network, recording: Recording) -> str:
    """Return the name of the output's column, with its unit."""
    if recording.sensor.derivative:
        return f"output_{recording.units.output}"
    if network.senses:
        return "force_N" if recording.units.output == "N" else f"output_{recording.units.output}"
    unit = next(s.unit for s in network.storages if s.name == network.output)
    return "displacement_m" if unit == "m" else f"output_{unit.replace(' ', '')}"


def totals(predicted: Sequence[Predicted]) -> dict[str, dict[str, Any]]:
    """Return the scores over all recordings that have an output and, where the manifest marks some as held out, over
    these and over the others; empty where there is nothing to score."""
    scored = [p for p in predicted if p.error.size]
    groups = {"all": scored}
    if any(p.held_out for p in scored):
        groups["held_out"] = [p for p in scored if p.held_out]
        groups["others"] = [p for p in scored if not p.held_out]
    return {name: _total(some) for name, some in groups.items() if some}


def _total(some: Sequence[Predicted]) -> dict[str, Any]:
    """Return the scores over several recordings.

    RMSE and fit % are those of all samples together, each recording about its own mean; they need one unit. Residual
    over noise is the root mean square over the recordings that have a noise floor. What is undefined is None.
    """
    units = {p.recording.units.output for p in some}
    squares = sum(float(p.error @ p.error) for p in some)
    moved = sum(float(p.spread @ p.spread) for p in some)
    one = len(units) == 1
    over_noise = [float(np.mean(p.error**2)) / p.recording.noise**2 for p in some if p.recording.noise_found]
    return {
        "recordings": len(some),
        "fit_percent": 100.0 * (1.0 - float(np.sqrt(squares / moved))) if one and moved > 0.0 else None,
        "rmse": float(np.sqrt(squares / sum(p.error.size for p in some))) if one else None,
        "unit": units.pop() if one else None,
        "residual_over_noise": float(np.sqrt(np.mean(over_noise))) if over_noise else None,
    }


def document(predicted: Sequence[Predicted], files: dict[str, str], model: str) -> dict[str, Any]:
    """Return the content of ``predict.json``.

    Args:
        files: names of the tables' files by recording; model: where the model lies.
    """
    entries = {p.recording.name: p.document(files[p.recording.name]) for p in predicted}
    return {"schema": SCHEMA, "model": model, "recordings": entries, "totals": totals(predicted)}
