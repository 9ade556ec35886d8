"""All models on recordings of several truths and seeds, and on growing numbers of recordings."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phnn.comparison.models import Result, Settings
from phnn.comparison.run import compare
from phnn.identification.base import Progress, quiet
from phnn.recordings import Campaign, read
from phnn.report.formatting import markdown_table, ratio
from phnn.results import Place
from studies.comparison.rivals import HEADS
from studies.comparison.uses import CONFIRMATION, OUTSIDE, USES, over_noise, uses
from studies.generator.excitation import Excitation, sine
from studies.recordings import comparison_plan
from studies.rival_models.truths import write_truth

COUNTS, ENOUGH = (1, 2, 4, 7), 1.2
_COLUMNS = ("truth", "seed", "recordings", "model", *USES, "parameters", "processor_seconds", "budget", "size")
# In this order recordings are added: the first few span amplitude and frequency as well as they can.
_ADDED = ((50.0, 75.0), (1.0, 75.0), (150.0, 75.0), (100.0, 40.0), (10.0, 40.0), (25.0, 75.0), (100.0, 75.0))
_HELD = ((10.0, 75.0), (75.0, 75.0), (75.0, 40.0), (18.0, 60.0), (120.0, 55.0))


@dataclass(frozen=True)
class Row:
    """One model on one set of recordings.

    Attributes:
        truth, seed: of the recordings; recordings: how many identify.
        scores: residual over noise by use, root mean square over its recordings.
    """

    truth: str
    seed: int
    recordings: int
    model: str
    scores: Mapping[str, float]
    parameters: int
    seconds: float
    budget: float
    size: str


def truths(
    place: Place, settings: Settings, chosen: Sequence[str], seeds: Sequence[int], noise_um: float,
    progress: Progress = quiet,
) -> list[Row]:  # fmt: skip
    """Fit all models to four sines of each truth and seed; score on those, and held out inside and outside.

    Writes ``truths.csv`` and ``truths.md`` after every set of recordings; finished models are read back.

    Raises:
        InputRefused: an unknown truth or model.
        SolverFailed: a truth or a model could not be simulated.
    """
    began, rows = time.process_time(), []
    for truth in chosen:
        for seed in seeds:
            home = place / f"{truth}_{seed}"
            folder = (home / "recordings").own_folder()
            write_truth(folder, truth, seed, comparison_plan(), noise_um)
            rows += _compared(read(folder), home, settings, (truth, seed), progress)
            spent = f"{time.process_time() - began:.0f} processor seconds in this run"
            (place / "truths.csv").write(table_csv(rows).encode())
            (place / "truths.md").write((truths_page(rows, settings, spent) + "\n").encode())
    return rows


def scarcity(
    place: Place, settings: Settings, truth: str, seeds: Sequence[int], noise_um: float, progress: Progress = quiet
) -> list[Row]:
    """Fit all models to 1, 2, 4 and 7 recordings of one truth; score on five others.

    Writes ``scarcity.csv`` and ``scarcity.md``.
    """
    began, rows = time.process_time(), []
    for seed in seeds:
        for count in COUNTS:
            home = place / f"{truth}_{seed}_{count}"
            folder = (home / "recordings").own_folder()
            write_truth(folder, truth, seed, _plan(count), noise_um)
            rows += _compared(read(folder), home, settings, (truth, seed), progress)
            spent = f"{time.process_time() - began:.0f} processor seconds in this run"
            (place / "scarcity.csv").write(table_csv(rows).encode())
            (place / "scarcity.md").write((scarcity_page(rows, settings, spent) + "\n").encode())
    return rows


def _plan(count: int) -> tuple[dict[str, str], tuple[Excitation, ...]]:
    """The first so many of the added sines identify; the same five are held out whatever their number."""
    added, held = (tuple(sine(f, a) for f, a in plan) for plan in (_ADDED[:count], _HELD))
    uses = {e.name: "identification" for e in added} | {e.name: "confirmation" for e in held}
    return uses, (*added, *held)


def _compared(
    campaign: Campaign, home: Place, settings: Settings, case: tuple[str, int], progress: Progress
) -> list[Row]:
    """All models on one folder, by `phnn.comparison`."""
    truth, seed = case
    settings = replace(settings, options=replace(settings.options, seed=seed))
    told: Progress = lambda line: progress(f"{truth}, seed {seed}: {line}")  # noqa: E731
    results = compare(campaign, Path(home.path) / "models", settings, told)
    count = sum(r.mask("identification").any() for r in campaign.recordings)
    kinds = uses(campaign.recordings)
    return [_row(result, kinds, (truth, seed, int(count)), settings.budget) for result in results.values()]


def _row(result: Result, kinds: Mapping[str, str], case: tuple[str, int, int], budget: float) -> Row:
    facts, model = result.facts, result.name
    return Row(
        *case, model, {use: over_noise(result.evaluation, kinds, use) for use in USES}, int(facts["parameters"]),
        float(facts.get("processor_seconds", facts["seconds"])), budget, str(facts.get("size", "")),
    )  # fmt: skip


def table_csv(rows: Sequence[Row]) -> str:
    """One line for each model and set of recordings."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for r in rows:
        scores = [r.scores[use] for use in USES]
        writer.writerow([r.truth, r.seed, r.recordings, r.model, *scores, r.parameters, r.seconds, r.budget, r.size])
    return out.getvalue()


def middle(rows: Sequence[Row], use: str) -> float:
    """Median residual over noise of one use, rows without a recording of this use left out; NaN without any."""
    found = [r.scores[use] for r in rows if not np.isnan(r.scores[use])]
    return float(np.median(found)) if found else float("nan")


def truths_page(rows: Sequence[Row], settings: Settings, spent: str) -> str:
    """Residual over noise by truth, use and model, and processor seconds: medians over the seeds."""
    models = list(dict.fromkeys(r.model for r in rows))
    body = []
    for truth in dict.fromkeys(r.truth for r in rows):
        for use, words in USES.items():
            own = [[r for r in rows if (r.truth, r.model) == (truth, m)] for m in models]
            body.append([truth, words, *(cell(middle(o, use)) for o in own)])
        body.append([truth, "processor seconds", *(_seconds(rows, truth, m) for m in models)])
    heads = ["truth", "recordings", *(HEADS[m] for m in models)]
    return "\n".join(["# Models on three truths", "", _words(rows, settings, spent), "", *markdown_table(heads, body)])


def _seconds(rows: Sequence[Row], truth: str, model: str) -> str:
    return ratio(float(np.median([r.seconds for r in rows if (r.truth, r.model) == (truth, model)])))


def cell(score: float) -> str:
    """A residual over noise in a table; a model that left the finite numbers says so."""
    return "diverged" if score == float("inf") else ratio(score)


def scarcity_page(rows: Sequence[Row], settings: Settings, spent: str) -> str:
    """Held-out residual over noise by number of recordings, and the number from which it stays below 1.2."""
    models, counts = (list(dict.fromkeys(getattr(r, n) for r in rows)) for n in ("model", "recordings"))
    body = []
    for model in models:
        found = [[r for r in rows if (r.model, r.recordings) == (model, c)] for c in counts]
        reached = [held_out(own) for own in found]
        enough = next(
            (str(c) for k, c in enumerate(counts) if all(x <= ENOUGH for x in reached[k:])), f"> {counts[-1]}"
        )
        body.append([HEADS[model], *(cell(x) for x in reached), enough])
    heads = ["model", *(f"from {c}" for c in counts), f"needed for {ENOUGH} × noise"]
    return "\n".join(
        ["# Models on few recordings", "", _words(rows, settings, spent), "", *markdown_table(heads, body)]
    )


def held_out(rows: Sequence[Row]) -> float:
    """Median over seeds of the root mean square over all held-out recordings, inside the identified range or not.

    The uses are weighted alike: with one recording nearly all others lie outside.
    """
    values = []
    for r in rows:
        known = [r.scores[u] for u in (CONFIRMATION, OUTSIDE) if np.isfinite(r.scores[u])]
        values.append(float(np.sqrt(np.mean(np.square(known)))) if known else float("inf"))
    return float(np.median(values))


def _words(rows: Sequence[Row], settings: Settings, spent: str) -> str:
    seeds = ", ".join(str(s) for s in dict.fromkeys(r.seed for r in rows))
    return (
        f"Residual over noise, median over the seeds {seeds}. Budget of each rival: {settings.budget:g} processor "
        f"seconds; {spent}. PHS, Bouc–Wen and the linear model are fitted until they converge; learned hysterons, the "
        "fully neural PHS and the neural ODE are trained by stages of their own, and their time is not that of the "
        "processor but what passed."
    )
