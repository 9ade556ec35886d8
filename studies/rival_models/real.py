"""Rivals and models of phnn on public recordings of one input and one output.

Every model is fitted to the identification parts of a folder and scored on its held-out parts. The ratio of the best
model of phnn to the best rival is below one where phnn predicts better. With several inputs (steering mirror) the first
output is scored against the first input alone: the other inputs act as a disturbance on all models alike.
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phnn.comparison.models import Settings
from phnn.configuration import config_folder
from phnn.diagnosis.diagnosis import diagnose
from phnn.diagnosis.tested import score_on_all
from phnn.errors import InputRefused, SolverFailed
from phnn.identification.base import Progress, identify_base, quiet
from phnn.identification.evaluate import PartScore, score_part
from phnn.identification.zero import own_zeros
from phnn.recordings import Campaign, read
from phnn.report.formatting import DASH, markdown_table, ratio
from phnn.report.result import document
from phnn.results import Place
from studies.comparison.rivals import HEADS
from studies.rival_models.contest import cell
from studies.rival_models.names import NAMES, rival

FOLDERS = ("piezo-stack", "steering-mirror", "silverbox", "emps", "tanks", "mr-damper", "shaking-table")
BASE, DIAGNOSED = "base", "diagnosed"  # the model that the manifest names, and that of phnn diagnose
_OWN = (BASE, DIAGNOSED)
_COLUMNS = ("recordings", "model", "held_out", "identified", "processor_seconds", "budget", "seed", "why_not")
# A manifest with another name than usual: this one identifies on a quarter of the training samples.
_MANIFESTS = {"silverbox": "quarter.yaml"}
# The second and the third realisation at 100 mV are contaminated; one of each amplitude identifies.
_MIRROR = ("100mV_1", "300mV_1", "100mV_test_1", "300mV_test_1")


@dataclass(frozen=True)
class Scored:
    """One model on one folder: residual over noise, root mean square over parts; ``why_not`` it has no score.

    A rival had ``budget`` processor seconds; a model of phnn has none.
    """

    recordings: str
    model: str
    held_out: float
    identified: float
    seconds: float
    budget: float = float("nan")
    why_not: str = ""


def real(
    place: Place, settings: Settings, folder: Path, only: Sequence[str], diagnoses: bool, progress: Progress = quiet
) -> list[Scored]:
    """Fit the base model of each manifest and the rivals among ``settings.models`` to all folders that are there.

    Writes ``real.csv`` and ``real.md`` after every folder.

    Args:
        folder: holds folders of the names ``FOLDERS``.
        only: which of them; all where empty.
        diagnoses: whether the model of a diagnosis joins them; its ``diagnosis.json`` is kept in ``NAME/``, and each
            rival has the processor time that it took, ``settings.budget`` at least.

    Raises:
        InputRefused: an unknown name, or no folder of these names.
    """
    unknown = [name for name in only if name not in FOLDERS]
    if unknown:
        raise InputRefused(f"only: no manifest is known for {unknown[0]!r}: choose from {', '.join(FOLDERS)}")
    there = [n for n in FOLDERS if (folder / n).is_dir() and (not only or n in only)]
    if not there:
        raise InputRefused(f"{folder}: has no folder called {', '.join(only or FOLDERS)}")
    rows: list[Scored] = []
    for name in there:
        campaign = one_to_one(folder / name, name)
        for found in _scored(campaign, name, settings, place / name if diagnoses else None, progress):
            rows.append(found)
            (place / "real.csv").write(_csv(rows, settings).encode())
            (place / "real.md").write((page(rows, settings) + "\n").encode())
    return rows


def one_to_one(folder: Path, name: str) -> Campaign:
    """The folder by the manifest of ``configs/recordings``, its recordings with one input and one output each."""
    manifest = config_folder() / "recordings" / name / _MANIFESTS.get(name, "recordings.yaml")
    campaign = read(folder, manifest, allow_outside=True)
    chosen = [r for r in campaign.recordings if r.measures in ("", "y_1")]
    if name == "steering-mirror":
        chosen = [r for r in chosen if r.name.partition(".")[0] in _MIRROR]
    plain = (replace(r, further={}, measures="") for r in chosen)
    return replace(campaign, recordings=own_zeros(tuple(plain)))


def _scored(
    campaign: Campaign, name: str, settings: Settings, home: Place | None, progress: Progress
) -> Iterator[Scored]:
    """All models on one folder; a model that cannot be fitted states the reason in the place of its score."""
    chosen = [BASE, *([DIAGNOSED] if home is not None else []), *(m for m in settings.models if m in NAMES)]
    budget = settings.budget
    for model in chosen:
        progress(f"{name}: fit {model}")
        began, why = time.process_time(), ""
        try:
            if model == BASE:
                fit, _ = identify_base(campaign, settings.options)
                parts = score_on_all(fit, campaign).parts
            elif model == DIAGNOSED and home is not None:
                parts = _diagnosed(campaign, settings, home, progress)
            else:
                parts = _rival(campaign, model, budget, settings.options.seed)
        except (InputRefused, SolverFailed) as error:
            parts, why = (), str(error)
        identified, held = (_over_noise(parts, use) for use in ("identification", "confirmation"))
        seconds = time.process_time() - began
        yield Scored(name, model, held, identified, seconds, float("nan") if model in _OWN else budget, why)
        if model == DIAGNOSED:
            budget = max(budget, seconds)


def _diagnosed(campaign: Campaign, settings: Settings, home: Place, progress: Progress) -> tuple[PartScore, ...]:
    """The model that a diagnosis leaves, on all recordings; its verdict and what it has added are kept."""
    found = diagnose(campaign, settings.options, progress)
    (home / "diagnosis.json").write_json(document(found))
    return found.after.parts


def _rival(campaign: Campaign, model: str, budget: float, seed: int) -> tuple[PartScore, ...]:
    fitted = rival(model).fit(campaign.recordings, budget, seed)
    outputs = fitted.outputs(campaign.recordings)
    return tuple(
        score_part(r, y, p.first, p.last, p.name, p.use)
        for r, y in zip(campaign.recordings, outputs, strict=True)
        for p in r.parts
        if p.use != "nuisance"
    )


def _over_noise(parts: Sequence[PartScore], use: str) -> float:
    found = [p.residual_over_noise for p in parts if p.use == use]
    return float(np.sqrt(np.mean(np.square(found)))) if found else float("nan")


def _csv(rows: Sequence[Scored], settings: Settings) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for r in rows:
        found = [r.recordings, r.model, r.held_out, r.identified, r.seconds, r.budget]
        writer.writerow([*found, settings.options.seed, r.why_not])
    return out.getvalue()


def page(rows: Sequence[Scored], settings: Settings) -> str:
    """Held-out residual over noise by folder and model, and the ratio of the best of phnn to the best rival."""
    models = list(dict.fromkeys(r.model for r in rows))
    body = []
    for name in dict.fromkeys(r.recordings for r in rows):
        own = {r.model: r.held_out for r in rows if r.recordings == name}
        ours, theirs = (
            min((x for m, x in own.items() if (m in _OWN) is side and np.isfinite(x)), default=np.nan)
            for side in (True, False)
        )
        best = min((m for m in own if m not in _OWN and np.isfinite(own[m])), key=lambda m: own[m], default=None)
        cells = [cell(own.get(m, np.nan)) for m in models]
        compared = ratio(ours / theirs) if np.isfinite(ours / theirs) else DASH
        body.append([name, *cells, DASH if best is None else HEADS[best], compared])
    shown = {BASE: "phnn, base model", DIAGNOSED: "phnn, diagnosed"}
    heads = ["recordings", *(shown.get(m) or HEADS[m] for m in models), "best rival", "phnn / best rival"]
    words = (
        f"Residual over noise on the held-out parts, root mean square. Seed {settings.options.seed}. "
        + _budget([r.seconds for r in rows if r.model == DIAGNOSED], settings.budget)
        + "Below 1 in the last column, phnn predicts better."
    )
    why = [f"* {r.recordings}, {r.model}: {r.why_not}" for r in rows if r.why_not]
    return "\n".join(["# Models on public recordings", "", words, "", *markdown_table(heads, body), "", *why])


def _budget(diagnoses: Sequence[float], least: float) -> str:
    """What a reader has to know of the time that each model had."""
    if not diagnoses:
        return f"Each rival had {least:g} processor seconds. "
    return (
        f"A diagnosis took {min(diagnoses):.0f} to {max(diagnoses):.0f} processor seconds, and each rival had as many, "
        f"{least:g} at least; held-out recordings may take elements out of a diagnosis's model, and no rival has seen "
        "them. "
    )
