"""Studies of rivals: the table of all models on several sets of recordings, few recordings, and public ones.

The table fits every model with the same processor time to each set, several times with other seeds. A seed draws the
noise of recordings that are made, the actuator of those that are not of Table 1, and what a fit begins with.

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

from phnn.comparison.models import MODELS, Settings
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
from studies.generator.plans import sine
from studies.recordings import (
    PHS,
    TRUTHS,
    USES,
    Conditions,
    comparison_plan,
    over_noise,
    uses,
    write_recordings,
    write_truth,
)
from studies.rival_models.names import HEADS, NAMES, register_rivals, rival
from studies.rival_models.runs import loops

STUDIES = ("table", "real", "loops")
# In this order recordings are added: the first few span amplitude and frequency as well as they can.
_ADDED = ((50.0, 75.0), (1.0, 75.0), (150.0, 75.0), (100.0, 40.0), (10.0, 40.0), (25.0, 75.0), (100.0, 75.0))
_HELD = ((10.0, 75.0), (75.0, 75.0), (75.0, 40.0), (18.0, 60.0), (120.0, 55.0))
# Sets of the table: made ones of Table 1 by the second effect that they hold, of other actuators, and public folders.
TABLE, CREEP, _RESIDUAL_UM = "table_1", "creep", 0.5
# Of an actuator of hysterons with so many identification recordings, and five others held out.
FEW = {f"{PHS}_{count}": count for count in (1, 2, 4, 7)}
FOLDERS = ("piezo-stack", "steering-mirror", "silverbox", "emps", "tanks", "mr-damper", "shaking-table", "bouc-wen")
_OWN = {"base": "phnn, base model", "diagnosed": "phnn, diagnosed"}  # that of the manifest, that of phnn diagnose
# Manifests with other names than usual: these identify on a quarter of the training samples.
_MANIFESTS = {"silverbox": "quarter.yaml", "bouc-wen": "period.yaml"}
# The second and the third realisation at 100 mV are contaminated; one of each amplitude identifies.
_MIRROR = ("100mV_1", "300mV_1", "100mV_test_1", "300mV_test_1")


@dataclass(frozen=True)
class Chosen:
    """The keys of ``configs/experiment/rivals.yaml`` beside those under ``compare``.

    Attributes:
        study: one of `STUDIES`; sets: of recordings, for the table; seeds: of actuators, noise and models.
        noise_um: standard deviation of the sensor's noise, µm.
        runs: of each model in a loop.
        folder, only: of real recordings; diagnoses: whether the models of diagnoses join them.
    """

    study: str
    sets: tuple[str, ...]
    seeds: tuple[int, ...]
    only: tuple[str, ...]
    folder: str | None
    diagnoses: bool
    noise_um: float = positive(0.05)
    runs: int = whole(20, least=1)

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
        if self.study != "real" and not (self.sets and self.seeds):
            raise InputRefused("sets, seeds: one of them is empty: name one at least")
        for name in self.sets:
            if name not in (known := (TABLE, CREEP, *TRUTHS, *FEW, *FOLDERS)):
                raise InputRefused(f"sets: nothing is called {name!r}: choose from {', '.join(known)}")

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Chosen:
        """Take the composed configuration; a single value serves as a list of one. Raises InputRefused."""
        given = {name: config[name] for name in cls.__dataclass_fields__}
        for name in ("sets", "seeds", "only"):
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
    elif c.study == "loops":
        loops(place, settings, c.seeds, c.noise_um, c.runs, progress)
    else:
        contest(c, place, settings, progress)
    return place.path / f"{c.study}.md"


def contest(c: Chosen, place: Place, settings: Settings, progress: Progress = quiet) -> pd.DataFrame:
    """Fit all models to all sets of recordings, seed by seed; write ``table.csv`` and ``table.md`` after each.

    Public folders that are not there are left out, and the page says so.

    Returns:
        A row for each model on each set of recordings: residual over noise by use, root mean square over recordings.
    """
    began, rows = time.process_time(), list[dict[str, Any]]()
    absent = [n for n in c.sets if n in FOLDERS and not (c.folder and (Path(c.folder) / n).is_dir())]
    _warm(settings, place, progress)
    for seed in c.seeds:
        for name in (n for n in c.sets if n not in absent):
            home = place / f"{name}_{seed}"
            public = name in FOLDERS
            campaign = one_to_one(Path(str(c.folder)) / name, name) if public else _made(home, name, seed, c.noise_um)
            rows += _compared(campaign, home, settings, {"set": name, "seed": seed}, progress)
            table, spent = pd.DataFrame(rows), f"{time.process_time() - began:.0f} processor seconds in this run"
            (place / "table.csv").write(table.to_csv(index=False).encode())
            (place / "table.md").write((table_page(table, settings, spent, absent) + "\n").encode())
    return pd.DataFrame(rows)


def _made(home: Place, name: str, seed: int, noise_um: float) -> Campaign:
    """Make the recordings of a set, and read them."""
    plan = comparison_plan()
    if name in FEW:
        added, held = (tuple(sine(f, a) for f, a in each) for each in (_ADDED[: FEW[name]], _HELD))
        chosen = dict.fromkeys((e.name for e in added), "identification")
        plan = chosen | dict.fromkeys((e.name for e in held), "confirmation"), (*added, *held)
    folder = (home / "recordings").own_folder()
    if name in (TABLE, CREEP):
        effect = "none" if name == TABLE else name
        write_recordings(folder, Conditions(effect, _RESIDUAL_UM, noise_um, seed=seed), plan)
    else:
        write_truth(folder, PHS if name in FEW else name, seed, plan, noise_um)
    return read(folder)


def _warm(settings: Settings, place: Place, progress: Progress) -> None:
    """Fit phnn's models to one short recording: what is compiled then takes no time from a model's budget."""
    chosen = tuple(m for m in settings.models if m in MODELS)
    if not chosen or (place / "warm").path.exists():
        return
    progress("compile")
    home, plan = place / "warm", ({sine(50.0).name: "identification"}, (sine(50.0, periods=1),))
    write_truth((home / "recordings").own_folder(), PHS, 0, plan, 0.05)
    own = limited(replace(settings, models=chosen, options=replace(settings.options, starts=1)), 0.1)
    compare(read((home / "recordings").path), Path(home.path) / "models", own)


def limited(settings: Settings, budget: float) -> Settings:
    """Return settings under which every training has the processor seconds of a rival, shared among its stages."""
    recipes = {
        name: replace(r, stages={k: {**s, "seconds": budget / len(r.stages)} for k, s in r.stages.items()})
        for name, r in settings.recipes.items()
    }
    return replace(settings, budget=budget, recipes=recipes)


def _compared(
    campaign: Campaign, home: Place, settings: Settings, case: dict[str, Any], progress: Progress
) -> list[dict[str, Any]]:
    """Return a row for each model on one folder, by `phnn.comparison`."""
    own = limited(replace(settings, options=replace(settings.options, seed=case["seed"])), settings.budget)
    told: Progress = lambda line: progress(f"{case['set']}, seed {case['seed']}: {line}")  # noqa: E731
    kinds, results = uses(campaign.recordings), compare(campaign, Path(home.path) / "models", own, told)
    case = case | {"recordings": sum(bool(r.mask("identification").any()) for r in campaign.recordings)}
    rows = []
    for model, result in results.items():
        facts, scores = result.facts, {use: over_noise(result.evaluation, kinds, use) for use in USES}
        made = {n: facts.get(n, np.nan) for n in ("parameters", "evaluations", "processor_seconds", "seconds")}
        errors = {f"rmse {p.name}": p.rmse for p in result.evaluation.parts if p.use != "identification"}
        row = case | {"model": model} | scores | made | {"budget": settings.budget, "size": str(facts.get("size", ""))}
        rows.append(row | (errors if case["set"] in FOLDERS else {}))
    return rows


def table_page(table: pd.DataFrame, settings: Settings, spent: str, absent: Sequence[str] = ()) -> str:
    """Return the page of mean and standard deviation over seeds: errors, effort and size of every model, by set."""
    lines = ["# All models on the same recordings", "", _words(table, settings, spent)]
    lines += ["", *(f"{name}: skipped, its folder is not there." for name in absent)]
    for name, own in table.groupby("set", sort=False):
        official = [n for n in own.columns if n.startswith("rmse ") and own[n].notna().any()]
        scored = [n for n in USES if own[n].notna().any()]
        heads = ["model", "parameters", *(USES[n] for n in scored)]
        heads += [f"{n.removeprefix('rmse ')} [{_UNIT[1]}]" for n in official]
        body = []
        for model, rows in own.groupby("model", sort=False):
            cells = [_spread(rows[n]) for n in scored] + [_spread(_UNIT[0] * rows[n]) for n in official]
            effort = [f"{rows[n].mean():.0f}" for n in ("processor_seconds", "seconds")]
            count = rows["evaluations"].mean()
            body.append([HEADS[str(model)], f"{rows['parameters'].mean():.0f}", *cells, *effort,
                         DASH if np.isnan(count) else f"{count:.0f}"])  # fmt: skip
        lines += ["", f"## {name}", "", *markdown_table([*heads, "processor s", "wall s", "evaluations"], body)]
    return "\n".join(lines)


_UNIT = 1e6, "10⁻⁶"  # of the errors on public recordings, in the unit of their output


def _spread(values: pd.Series[float]) -> str:
    """Write mean and standard deviation over seeds; a model that left the finite numbers says how often."""
    lost = int((~np.isfinite(values)).sum())
    if lost:
        return f"diverged {lost} of {len(values)}"
    return ratio(float(values.mean())) + (f" ± {ratio(float(values.std()))}" if len(values) > 1 else "")


def _cell(score: float) -> str:
    """Write a residual over noise; a model that left the finite numbers says so."""
    return "diverged" if score == float("inf") else ratio(score)


def _words(table: pd.DataFrame, settings: Settings, spent: str) -> str:
    seeds = ", ".join(str(s) for s in dict.fromkeys(table["seed"]))
    return (
        f"Residual over noise, root mean square over recordings; seeds {seeds}. Budget of each model: "
        f"{settings.budget:g} seconds of one processor, twice as much for the neural ODE; {spent}. PHS, the linear "
        "model and Bouc–Wen blocks end when they converge; a training ends after the epoch in which its time is over."
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
