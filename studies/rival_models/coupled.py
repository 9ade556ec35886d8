"""The study of models in a loop: fit all to recordings of one actuator, close the loop around each, and count."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass, fields, replace

from phnn.comparison.models import Settings
from phnn.errors import InputRefused, SolverFailed
from phnn.identification.base import Progress, quiet
from phnn.identification.identified import identify
from phnn.model import Model
from phnn.recordings import Campaign, read
from phnn.report.formatting import markdown_table
from phnn.results import Place
from studies.comparison.rivals import HEADS
from studies.generator.excitation import PEAK
from studies.recordings import comparison_plan
from studies.rival_models.loops import ExportedStepper, Loops, closed, drawn_runs
from studies.rival_models.names import NAMES, rival
from studies.rival_models.rival import Stepper
from studies.rival_models.truths import PHS, base_of, write_truth

# Length of a run, and the sampling interval of models that take any, s; highest frequency of its drive, Hz.
_LENGTH, DT, _HIGHEST_HZ = 0.4, 1e-4, 150.0


@dataclass(frozen=True)
class Row:
    """One model: ``seed`` of the actuator, interval ``dt`` [s], and what became of its loops; None where it cannot be
    stepped or was not fitted, with the reason in ``why``."""

    seed: int
    model: str
    dt: float
    found: Loops | None
    why: str = ""


def loops(
    place: Place, settings: Settings, seeds: Sequence[int], noise_um: float, runs: int, progress: Progress = quiet
) -> list[Row]:
    """Close the loop around each model of the paper's actuator; writes ``loops.csv`` and ``loops.md``.

    Models that are neither ``phs`` nor a rival are left out: they have no form that takes single samples.

    Raises:
        InputRefused: no model is left.
        SolverFailed: the truth could not be simulated.
    """
    began, rows = time.process_time(), list[Row]()
    for seed, campaign, model in each_model(place, settings, seeds, noise_um, progress):
        rows.append(_row(campaign, model, settings, seed, runs))
        spent = f"{time.process_time() - began:.0f} processor seconds"
        (place / "loops.csv").write(_csv(rows).encode())
        (place / "loops.md").write(_page(rows, settings, spent).encode())
    return rows


def each_model(
    place: Place, settings: Settings, seeds: Sequence[int], noise_um: float, progress: Progress
) -> Iterator[tuple[int, Campaign, str]]:
    """Each seed with recordings of the paper's actuator and each model that takes single samples.

    Raises:
        InputRefused: no model is left.
        SolverFailed: the truth could not be simulated.
    """
    models = _stepped(settings.models)
    for seed in seeds:
        folder = (place / f"{PHS}_{seed}" / "recordings").own_folder()
        write_truth(folder, PHS, seed, comparison_plan(), noise_um)
        campaign = read(folder)
        for model in models:
            progress(f"seed {seed}: {model}")
            yield seed, campaign, model


def _row(campaign: Campaign, model: str, settings: Settings, seed: int, runs: int) -> Row:
    base = base_of(seed)
    try:
        stepper = fitted_stepper(campaign, model, settings, seed, ExportedStepper)
    except SolverFailed as error:
        return Row(seed, model, float("nan"), None, str(error))
    stiffness = base["k"] / base["alpha"]
    drawn = drawn_runs(runs, (_LENGTH, stepper.dt), PEAK, _HIGHEST_HZ, stiffness, seed)
    return Row(seed, model, stepper.dt, closed(stepper, drawn, 1.0 / stiffness))


def _stepped(models: Sequence[str]) -> list[str]:
    """Those models that take single samples: ``phs`` and the rivals.

    Raises:
        InputRefused: no model is left.
    """
    found = [m for m in models if m in (PHS, *NAMES)]
    if not found:
        raise InputRefused(f"models: none of {', '.join(models)} takes single samples: name {PHS} or a rival")
    return found


def fitted_stepper(
    campaign: Campaign, model: str, settings: Settings, seed: int, exported: Callable[[Model, float], Stepper]
) -> Stepper:
    """Fit a model to a campaign, and give it sample by sample; at 1e-4 s where any interval serves.

    Args:
        exported: makes the stepper of the identified port-Hamiltonian model at a sampling interval [s].

    Raises:
        SolverFailed: the model could not be fitted.
    """
    if model == PHS:
        options = replace(settings.options, seed=seed, workers=1)
        return exported(identify(None, campaign, options).model, DT)
    fitted = rival(model).fit(campaign.recordings, settings.budget, seed)
    return fitted.stepper(fitted.dt or DT)


def how_fitted(seeds: Sequence[int], settings: Settings) -> str:
    """The beginning of a page: what the models were fitted to, and in what time."""
    listed = ", ".join(str(s) for s in dict.fromkeys(seeds))
    return (
        f"Each model was fitted to four recordings of the paper's actuator (seeds {listed}; {settings.budget:g} "
        "processor seconds for each rival)"
    )


def _csv(rows: Sequence[Row]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["seed", "model", "dt_s", *(f.name for f in fields(Loops)), "why"])
    for r in rows:
        counts = astuple(r.found) if r.found else [""] * len(fields(Loops))
        writer.writerow([r.seed, r.model, r.dt, *counts, r.why])
    return out.getvalue()


def _page(rows: Sequence[Row], settings: Settings, spent: str) -> str:
    body = []
    for model in dict.fromkeys(r.model for r in rows):
        own = [r.found for r in rows if r.model == model and r.found is not None]
        total = sum(f.runs for f in own)
        counts = [str(sum(getattr(f, name) for f in own)) for name in ("diverged", "unsolved", "gained")]
        body.append([HEADS[model], str(total), *counts])
    words = (
        f"{how_fitted([r.seed for r in rows], settings)} and then met a spring of a tenth to three times the "
        f"actuator's stiffness. Runs of {_LENGTH:g} s, from rest under another voltage than that at which the drive "
        f"begins; {spent}."
    )
    heads = ["model", "runs", "diverged", "of these without a solution", "moved more after the drive"]
    return "\n".join(["# Models in a loop with a compliant load", "", words, "", *markdown_table(heads, body), ""])
