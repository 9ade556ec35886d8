"""The study of long runs: fit all to recordings of one actuator, run each freely over many samples, and count."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np

from phnn.comparison.models import Settings
from phnn.errors import InputRefused, OutputFailed, SolverFailed
from phnn.identification.base import Progress, quiet
from phnn.recordings import Campaign
from phnn.report.formatting import DASH, markdown_table
from phnn.results import Place
from studies.comparison.rivals import HEADS
from studies.generator.excitation import PEAK
from studies.rival_models.compiled_stepper import compiled_stepper
from studies.rival_models.coupled import DT, each_model, fitted_stepper, how_fitted
from studies.rival_models.long_runs import DRIFTED, LEAST, PERIOD, LongRun, drawn_drive, long_run
from studies.rival_models.truths import base_of


@dataclass(frozen=True)
class Runs:
    """Attributes:
    samples: of a run; drives: how many runs of each model.

    Raises:
        InputRefused: fewer than twenty periods of the voltage, or no run.
    """

    samples: int
    drives: int

    def __post_init__(self) -> None:
        # Models on a grid of their own have longer intervals.
        least = LEAST * round(PERIOD / DT)
        if self.samples < least:
            raise InputRefused(f"samples = {self.samples}: give {least} or more, {LEAST} periods of the voltage")
        if self.drives < 1:
            raise InputRefused(f"drives = {self.drives}: give 1 or more")


@dataclass(frozen=True)
class Row:
    """One run: ``seed`` of the actuator, interval ``dt`` [s], number of the drive, and what became of the run; None
    where the model was not fitted, with the reason in ``why``."""

    seed: int
    model: str
    dt: float
    drive: int
    found: LongRun | None
    why: str = ""


def long(
    place: Place, settings: Settings, seeds: Sequence[int], noise_um: float, runs: Runs, progress: Progress = quiet
) -> list[Row]:
    """Run each model of the paper's actuator freely; writes ``long.csv`` and ``long.md`` after each model.

    Models that are neither ``phs`` nor a rival are left out: they have no form that takes single samples.

    Raises:
        InputRefused: no model is left.
        SolverFailed: the truth could not be simulated.
    """
    began, rows = time.process_time(), list[Row]()
    for seed, campaign, model in each_model(place, settings, seeds, noise_um, progress):
        rows += _rows(campaign, model, settings, seed, runs)
        spent = f"{time.process_time() - began:.0f} processor seconds"
        (place / "long.csv").write(table(rows).encode())
        (place / "long.md").write(page(rows, settings, runs, spent).encode())
    return rows


def _rows(campaign: Campaign, model: str, settings: Settings, seed: int, runs: Runs) -> list[Row]:
    base = base_of(seed)
    try:
        stepper = fitted_stepper(campaign, model, settings, seed, compiled_stepper)
    except (SolverFailed, OutputFailed) as error:
        return [Row(seed, model, float("nan"), 0, None, str(error))]
    gain, found = base["alpha"] / base["k"], []
    for number in range(runs.drives):
        # Outputs of a model that diverges may overflow before they are counted.
        with np.errstate(over="ignore", invalid="ignore"):
            done = long_run(stepper, drawn_drive(PEAK, seed, number), gain, runs.samples)
        found.append(Row(seed, model, stepper.dt, number, done))
    return found


def table(rows: Sequence[Row]) -> str:
    """One line of csv for each run."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [f.name for f in fields(LongRun)]
    writer.writerow(["seed", "model", "dt_s", "drive", *names, "why"])
    for r in rows:
        writer.writerow([r.seed, r.model, r.dt, r.drive, *(astuple(r.found) if r.found else [""] * len(names)), r.why])
    return out.getvalue()


def page(rows: Sequence[Row], settings: Settings, runs: Runs, spent: str) -> str:
    """The page of markdown: counts, largest drift and motion, and processor time by model."""
    body = [_line(model, rows) for model in dict.fromkeys(r.model for r in rows)]
    words = (
        f"{how_fitted([r.seed for r in rows], settings)} and then ran freely over {runs.samples:,} samples, "
        f"{'once under a' if runs.drives == 1 else f'{runs.drives} times under another'} periodic voltage, from rest "
        f"under another voltage, which jumps to the drive at the first sample. For the last tenth the voltage is zero. "
        f"Drift: r.m.s. difference between the periods of {PERIOD:g} s at a hundredth of the run and at the end of the "
        f"drive, over the output's r.m.s.; above {DRIFTED:g}, ten times what the port-Hamiltonian model leaves in "
        f"200,000 samples, a model drifted. Late drift: the same from the middle of the drive to its end. Motion: "
        f"r.m.s. about the mean in the last quarter of the rest over that in the first. All three are the largest of "
        f"all runs; {spent}."
    )
    heads = [
        "model", "interval [ms]", "runs", "diverged", "after samples", "drifted", "drift", "late drift",
        "gained motion", "motion", "processor seconds", "µs a sample",
    ]  # fmt: skip
    return "\n".join(["# Models over long runs", "", words, "", *markdown_table(heads, body), ""])


def _line(model: str, rows: Sequence[Row]) -> list[str]:
    own = [(r.dt, r.found) for r in rows if r.model == model and r.found is not None]
    found = [f for _, f in own]
    lost, whole = [f for f in found if f.diverged], [f for f in found if not f.diverged]
    samples = sum(f.samples for f in whole)
    return [
        HEADS[model],
        ", ".join(dict.fromkeys(f"{1e3 * dt:.3g}" for dt, _ in own)) or DASH,
        str(len(found)),
        str(len(lost)),
        f"{min(f.samples for f in lost):,}" if lost else DASH,
        str(sum(f.drifted for f in found)),
        _largest([f.drift for f in found]),
        _largest([f.late for f in found]),
        str(sum(f.gained for f in found)),
        _largest([f.motion for f in found]),
        f"{sum(f.seconds for f in found):.3g}",
        f"{1e6 * sum(f.seconds for f in whole) / samples:.3g}" if samples else DASH,
    ]


def _largest(values: Sequence[float]) -> str:
    """The largest number of the runs that have one."""
    known = [v for v in values if not np.isnan(v)]
    return f"{max(known):.2g}" if known else DASH
