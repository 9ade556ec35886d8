"""Studies of rivals: all models on actuators of three kinds, on few recordings, and on public recordings.

Of public recordings, every model is fitted to the identification parts of a folder and scored on its held-out parts.
The ratio of the best model of phnn to the best rival is below one where phnn predicts better. With several inputs
(steering mirror) the first output is scored against the first input alone: the other inputs act as a disturbance on all
models alike.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from phnn.comparison.models import Settings
from phnn.comparison.run import compare
from phnn.configuration import check, checked, config_folder, number, positive, whole
from phnn.diagnose.diagnosis import diagnose, score_on_all
from phnn.errors import InputRefused, SolverFailed
from phnn.identification.base import Progress, identify_base, quiet
from phnn.identification.evaluate import Evaluation, PartScore, score_part
from phnn.identification.zero import own_zeros
from phnn.recordings import Campaign, read
from phnn.report.formatting import DASH, markdown_table, ratio
from phnn.report.result import document
from phnn.results import Place
from studies.comparison.uses import CONFIRMATION, OUTSIDE, USES, over_noise, uses
from studies.generator.plans import sine
from studies.recordings import comparison_plan
from studies.rival_models.names import HEADS, NAMES, register_rivals, rival
from studies.rival_models.runs import long, loops
from studies.rival_models.truths import write_truth

STUDIES = ("truths", "scarcity", "real", "loops", "long")
COUNTS, ENOUGH = (1, 2, 4, 7), 1.2
# In this order recordings are added: the first few span amplitude and frequency as well as they can.
_ADDED = ((50.0, 75.0), (1.0, 75.0), (150.0, 75.0), (100.0, 40.0), (10.0, 40.0), (25.0, 75.0), (100.0, 75.0))
_HELD = ((10.0, 75.0), (75.0, 75.0), (75.0, 40.0), (18.0, 60.0), (120.0, 55.0))
FOLDERS = ("piezo-stack", "steering-mirror", "silverbox", "emps", "tanks", "mr-damper", "shaking-table")
_OWN = {"base": "phnn, base model", "diagnosed": "phnn, diagnosed"}  # that of the manifest, that of phnn diagnose
# A manifest with another name than usual: this one identifies on a quarter of the training samples.
_MANIFESTS = {"silverbox": "quarter.yaml"}
# The second and the third realisation at 100 mV are contaminated; one of each amplitude identifies.
_MIRROR = ("100mV_1", "300mV_1", "100mV_test_1", "300mV_test_1")


@dataclass(frozen=True)
class Chosen:
    """The keys of ``configs/experiment/rivals.yaml`` beside those under ``compare``.

    Attributes:
        study: one of `STUDIES`; truths: kinds of actuator; seeds: of actuators, noise and models.
        noise_um: standard deviation of the sensor's noise, µm.
        runs: of each model in a loop; samples, drives: of long runs.
        folder, only: of real recordings; diagnoses: whether the models of diagnoses join them.
    """

    study: str
    truths: tuple[str, ...]
    seeds: tuple[int, ...]
    only: tuple[str, ...]
    folder: str | None
    diagnoses: bool
    noise_um: float = positive(0.05)
    runs: int = whole(20, least=1)
    samples: int = whole(10_000_000, least=1)
    drives: int = whole(3, least=1)

    def __post_init__(self) -> None:
        check(self)
        for seed in self.seeds:
            number("seeds", seed, 0)
        if self.study not in STUDIES:
            raise InputRefused(f"study: nothing is called {self.study!r}: choose from {', '.join(STUDIES)}")
        if self.study == "real" and self.folder is None:
            raise InputRefused("folder: is not given: name the folder that holds a folder for each set of recordings")
        if not isinstance(self.diagnoses, bool):
            raise InputRefused(f"diagnoses: {self.diagnoses!r} is neither true nor false")
        if self.study != "real" and not (self.truths and self.seeds):
            raise InputRefused("truths, seeds: one of them is empty: name one at least")

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Chosen:
        """Take the composed configuration; a single value serves as a list of one. Raises InputRefused."""
        given = {name: config[name] for name in cls.__dataclass_fields__}
        for name in ("truths", "seeds", "only"):
            value = given[name]
            given[name] = tuple(value) if isinstance(value, list | tuple) else () if value is None else (value,)
        return cls(**given)


def run(config: Mapping[str, Any], progress: Progress = quiet) -> Path:
    """Carry out one study; finished models of an earlier run in the same folder are read back.

    Args:
        config: the keys of ``configs/experiment/rivals.yaml``.
        progress: told what is done.

    Returns:
        The page of markdown that was written.

    Raises:
        InputRefused: an unknown study, or settings that it cannot use.
        SolverFailed: an actuator or a model could not be simulated.
    """
    register_rivals()
    c, settings = Chosen.from_config(config), Settings.from_config(checked("compare", config["compare"]))
    place = Place(Path(config["out"] or f"out/rivals/{c.study}").resolve())
    if c.study == "real":
        real(place, settings, Path(str(c.folder)), c.only, c.diagnoses, progress)
    elif c.study in ("truths", "scarcity"):
        contest(c.study, place, settings, c.truths, c.seeds, c.noise_um, progress)
    elif c.study == "loops":
        loops(place, settings, c.seeds, c.noise_um, c.runs, progress)
    else:
        long(place, settings, c.seeds, c.noise_um, (c.samples, c.drives), progress)
    return place.path / f"{c.study}.md"


def contest(
    study: str, place: Place, settings: Settings, chosen: Sequence[str], seeds: Sequence[int], noise_um: float,
    progress: Progress = quiet,
) -> pd.DataFrame:  # fmt: skip
    """Fit all models to simulated recordings; write csv and markdown after every set of recordings.

    ``truths`` takes four sines of each kind of actuator and seed, and scores on those, and held out inside and outside.
    ``scarcity`` takes 1, 2, 4 and 7 recordings of the first kind and seed, and scores on five others.

    Returns:
        A row for each model on each set of recordings: residual over noise by use, root mean square over recordings.
    """
    began, rows = time.process_time(), list[dict[str, Any]]()
    for truth in chosen if study == "truths" else chosen[:1]:
        for seed in seeds:
            for count in COUNTS if study == "scarcity" else (None,):
                plan = comparison_plan()
                if count is not None:
                    added, held = (tuple(sine(f, a) for f, a in each) for each in (_ADDED[:count], _HELD))
                    uses = dict.fromkeys((e.name for e in added), "identification")
                    plan = uses | dict.fromkeys((e.name for e in held), "confirmation"), (*added, *held)
                home = place / (f"{truth}_{seed}" if count is None else f"{truth}_{seed}_{count}")
                folder = (home / "recordings").own_folder()
                write_truth(folder, truth, seed, plan, noise_um)
                case = {"truth": truth, "seed": seed}
                rows += _compared(read(folder), home, settings, case, progress)
                spent = f"{time.process_time() - began:.0f} processor seconds in this run"
                table, page = pd.DataFrame(rows), truths_page if study == "truths" else scarcity_page
                (place / f"{study}.csv").write(table.to_csv(index=False).encode())
                (place / f"{study}.md").write((page(table, settings, spent) + "\n").encode())
    return pd.DataFrame(rows)


def _compared(
    campaign: Campaign, home: Place, settings: Settings, case: dict[str, Any], progress: Progress
) -> list[dict[str, Any]]:
    """Return a row for each model on one folder, by `phnn.comparison`."""
    own = replace(settings, options=replace(settings.options, seed=case["seed"]))
    told: Progress = lambda line: progress(f"{case['truth']}, seed {case['seed']}: {line}")  # noqa: E731
    kinds, results = uses(campaign.recordings), compare(campaign, Path(home.path) / "models", own, told)
    case = case | {"recordings": sum(bool(r.mask("identification").any()) for r in campaign.recordings)}
    rows = []
    for model, result in results.items():
        facts, scores = result.facts, {use: over_noise(result.evaluation, kinds, use) for use in USES}
        seconds = float(facts.get("processor_seconds", facts["seconds"]))
        made = {"parameters": int(facts["parameters"]), "processor_seconds": seconds, "budget": settings.budget}
        rows.append(case | {"model": model} | scores | made | {"size": str(facts.get("size", ""))})
    return rows


def truths_page(table: pd.DataFrame, settings: Settings, spent: str) -> str:
    """Return the page of residual over noise by truth, use and model, and processor seconds: medians over seeds."""
    models, body = list(dict.fromkeys(table["model"])), []
    for truth, own in table.groupby("truth", sort=False):
        middle = own.groupby("model").median(numeric_only=True)
        for use, words in (*USES.items(), ("processor_seconds", "processor seconds")):
            body.append([str(truth), words, *(_cell(middle[use][m]) for m in models)])
    heads = ["truth", "recordings", *(HEADS[m] for m in models)]
    lines = ["# Models on three truths", "", _words(table, settings, spent), "", *markdown_table(heads, body)]
    return "\n".join(lines)


def _cell(score: float) -> str:
    """Write a residual over noise; a model that left the finite numbers says so."""
    return "diverged" if score == float("inf") else ratio(score)


def scarcity_page(table: pd.DataFrame, settings: Settings, spent: str) -> str:
    """Return the page of held-out residual over noise by number of recordings, and the number from which it stays
    below 1.2."""
    counts, body = list(dict.fromkeys(table["recordings"])), []
    for model, own in table.groupby("model", sort=False):
        reached = [held_out(own[own["recordings"] == c]) for c in counts]
        near = (str(c) for k, c in enumerate(counts) if all(x <= ENOUGH for x in reached[k:]))
        body.append([HEADS[str(model)], *(_cell(x) for x in reached), next(near, f"> {counts[-1]}")])
    heads = ["model", *(f"from {c}" for c in counts), f"needed for {ENOUGH} × noise"]
    lines = ["# Models on few recordings", "", _words(table, settings, spent), "", *markdown_table(heads, body)]
    return "\n".join(lines)


def held_out(rows: pd.DataFrame) -> float:
    """Return the median over seeds of the root mean square over all held-out recordings, inside the range or not.

    The uses are weighted alike: with one recording nearly all others lie outside.
    """
    squares = rows[[CONFIRMATION, OUTSIDE]].replace(np.inf, np.nan) ** 2
    return float(np.sqrt(squares.mean(axis=1)).fillna(np.inf).median())


def _words(table: pd.DataFrame, settings: Settings, spent: str) -> str:
    seeds = ", ".join(str(s) for s in dict.fromkeys(table["seed"]))
    return (
        f"Residual over noise, median over the seeds {seeds}. Budget of each rival: {settings.budget:g} processor "
        f"seconds; {spent}. PHS, Bouc–Wen and the linear model are fitted until they converge; learned hysterons, the "
        "fully neural PHS and the neural ODE are trained by stages of their own, and their time is not that of the "
        "processor but what passed."
    )


def real(
    place: Place, settings: Settings, folder: Path, only: Sequence[str], diagnoses: bool, progress: Progress = quiet
) -> pd.DataFrame:
    """Fit the base model of each manifest and the rivals among ``settings.models`` to all folders that are there.

    Writes ``real.csv`` and ``real.md`` after every model.

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
    rows: list[dict[str, Any]] = []
    models = ["base", *(["diagnosed"] if diagnoses else []), *(m for m in settings.models if m in NAMES)]
    for name in there:
        campaign, budget = one_to_one(folder / name, name), settings.budget
        for model in models:
            progress(f"{name}: fit {model}")
            began, why = time.process_time(), ""
            try:
                parts = _parts(campaign, model, replace(settings, budget=budget), place / name, progress)
            except (InputRefused, SolverFailed) as error:
                # A model that cannot be fitted states the reason in the place of its score.
                parts, why = (), str(error)
            held, identified = (Evaluation({}, parts).over_noise(use) for use in ("confirmation", "identification"))
            seconds, given = time.process_time() - began, float("nan") if model in _OWN else budget
            row = {"recordings": name, "model": model, "held_out": held, "identified": identified}
            rows.append(row | {"processor_seconds": seconds, "budget": given, "why_not": why})
            budget = max(budget, seconds) if model == "diagnosed" else budget
            table = pd.DataFrame(rows)
            (place / "real.csv").write(table.assign(seed=settings.options.seed).to_csv(index=False).encode())
            (place / "real.md").write((real_page(table, settings) + "\n").encode())
    return pd.DataFrame(rows)


def one_to_one(folder: Path, name: str) -> Campaign:
    """Read a folder by the manifest of ``configs/recordings``, with one input and one output in each recording."""
    manifest = config_folder() / "recordings" / name / _MANIFESTS.get(name, "recordings.yaml")
    campaign = read(folder, manifest, allow_outside=True)
    chosen = [r for r in campaign.recordings if r.measures in ("", "y_1")]
    if name == "steering-mirror":
        chosen = [r for r in chosen if r.name.partition(".")[0] in _MIRROR]
    plain = (replace(r, further={}, measures="") for r in chosen)
    return replace(campaign, recordings=own_zeros(tuple(plain)))


def _parts(
    campaign: Campaign, model: str, settings: Settings, home: Place, progress: Progress
) -> tuple[PartScore, ...]:
    """Fit a model and return its scores on all parts of the recordings."""
    if model == "base":
        return score_on_all(identify_base(campaign, settings.options)[0], campaign).parts
    if model == "diagnosed":
        diagnosis = diagnose(campaign, settings.options, progress)
        (home / "diagnosis.json").write_json(document(diagnosis))
        return diagnosis.after.parts
    outputs = rival(model).fit(campaign.recordings, settings.budget, settings.options.seed).outputs(campaign.recordings)
    return tuple(
        score_part(r, y, p.first, p.last, p.name, p.use)
        for r, y in zip(campaign.recordings, outputs, strict=True)
        for p in r.parts
        if p.use != "nuisance"
    )


def real_page(table: pd.DataFrame, settings: Settings) -> str:
    """Return the page of held-out residual over noise by folder and model, and the ratio of the best of phnn to the
    best rival."""
    models, body = list(dict.fromkeys(table["model"])), []
    for name, rows in table.groupby("recordings", sort=False):
        scores = rows.set_index("model")["held_out"]
        known = scores[np.isfinite(scores)]
        ours, theirs = known[known.index.isin(list(_OWN))], known[~known.index.isin(list(_OWN))]
        best = DASH if theirs.empty else HEADS[str(theirs.idxmin())]
        compared = DASH if ours.empty or theirs.empty else ratio(float(ours.min() / theirs.min()))
        body.append([str(name), *(_cell(scores.get(m, np.nan)) for m in models), best, compared])
    taken = table[table["model"] == "diagnosed"]["processor_seconds"]
    spent = (
        f"Each rival had {settings.budget:g} processor seconds. "
        if taken.empty
        else f"A diagnosis took {taken.min():.0f} to {taken.max():.0f} processor seconds, and each rival had as many, "
        f"{settings.budget:g} at least; held-out recordings may take elements out of a diagnosis's model, and no rival "
        "has seen them. "
    )
    words = (
        f"Residual over noise on the held-out parts, root mean square. Seed {settings.options.seed}. {spent}"
        "Below 1 in the last column, phnn predicts better."
    )
    heads = ["recordings", *(_OWN.get(m) or HEADS[m] for m in models), "best rival", "phnn / best rival"]
    failed = table[table["why_not"] != ""]
    why = [f"* {r.recordings}, {r.model}: {r.why_not}" for r in failed.itertuples()]
    return "\n".join(["# Models on public recordings", "", words, "", *markdown_table(heads, body), "", *why])
