"""The table of all models on several sets of recordings, and models in a loop.

The table fits every model with the same processor time to each set, several times with other seeds. A seed draws the
noise of recordings that are made, the actuator of those that are not of Table 1, and what a fit begins with. Of public
recordings, every model is fitted to the identification parts of a folder and scored on its held-out parts. With several
inputs (steering mirror) the first output is scored against the first input alone: the other inputs act as a disturbance
on all models alike.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from phnn.comparison.models import MODELS, Bench, Settings, compare, register_rival, title
from phnn.configuration import check, checked, config_folder, number, positive, whole
from phnn.diagnose.diagnosis import diagnose, score_on_all
from phnn.errors import InputRefused, SolverFailed
from phnn.identification.base import Progress, identify_base, quiet
from phnn.identification.plan import Options
from phnn.identification.prepare import own_zeros
from phnn.recordings import Campaign, read
from phnn.report.formatting import DASH, markdown_table, ratio
from phnn.results import Place
from studies import recordings as made
from studies.generator.plans import sine
from studies.recordings import PHS, TRUTHS, USES
from studies.rival_models.names import register_rivals
from studies.rival_models.runs import loops

STUDIES = ("table", "loops")
# In this order recordings are added: the first few span amplitude and frequency as well as they can.
_ADDED = ((50.0, 75.0), (1.0, 75.0), (150.0, 75.0), (100.0, 40.0), (10.0, 40.0), (25.0, 75.0), (100.0, 75.0))
_HELD = ((10.0, 75.0), (75.0, 75.0), (75.0, 40.0), (18.0, 60.0), (120.0, 55.0))
# Sets of the table: made ones of Table 1 by the second effect that they hold, of other actuators, and public folders.
TABLE, CREEP, _RESIDUAL_UM = "table_1", "creep", 0.5
# Of an actuator of hysterons with so many identification recordings, and five others held out.
FEW = {f"{PHS}_{count}": count for count in (1, 2, 4, 7)}
FOLDERS = ("piezo-stack", "steering-mirror", "silverbox", "emps", "tanks", "mr-damper", "shaking-table", "bouc-wen")
# phnn's own models of public recordings: that of the manifest, and that of a diagnosis.
_OWN = {"base": "phnn, model of the manifest", "diagnosed": "phnn, diagnosed"}
# Manifests with other names than usual: these identify on a quarter of the training samples.
_MANIFESTS = {"silverbox": "quarter.yaml", "bouc-wen": "period.yaml"}
# The second and the third realisation at 100 mV are contaminated; one of each amplitude identifies.
_MIRROR = ("100mV_1", "300mV_1", "100mV_test_1", "300mV_test_1")


@dataclass(frozen=True)
class Chosen:
    """The keys of ``configs/experiment/rivals.yaml`` beside those under ``compare``.

    Attributes:
        study: one of `STUDIES`; sets: of recordings, for the table; seeds: of actuators, noise and models.
        noise_um: standard deviation of the sensor's noise, µm; runs: of each model in a loop.
        folder: holds a folder for each set of public recordings.
    """

    study: str
    sets: tuple[str, ...]
    seeds: tuple[int, ...]
    folder: str | None
    noise_um: float = positive(0.05)
    runs: int = whole(20, least=1)

    def __post_init__(self) -> None:
        check(self)
        for seed in self.seeds:
            number("seeds", seed, 0)
        if self.study not in STUDIES:
            raise InputRefused(f"study: nothing is called {self.study!r}: choose from {', '.join(STUDIES)}")
        if not (self.sets and self.seeds):
            raise InputRefused("sets, seeds: one of them is empty: name one at least")
        for name in self.sets:
            if name not in (known := (TABLE, CREEP, *TRUTHS, *FEW, *FOLDERS)):
                raise InputRefused(f"sets: nothing is called {name!r}: choose from {', '.join(known)}")

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Chosen:
        """Take the composed configuration; a single value serves as a list of one. Raises InputRefused."""
        given = {name: config[name] for name in cls.__dataclass_fields__}
        for name in ("sets", "seeds"):
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
        InputRefused: an unknown study, or settings that it cannot use. SolverFailed: no actuator could be simulated.
    """
    register_rivals()
    for name, words in _OWN.items():
        register_rival(name, partial(_own, name), words)
    c, settings = Chosen.from_config(config), Settings.from_config(checked("compare", config["compare"]))
    place = Place(Path(config["out"] or f"out/rivals/{c.study}").resolve())
    if c.study == "loops":
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
            rows.extend(_compared(campaign, home, settings, {"set": name, "seed": seed}, progress))
            table, spent = pd.DataFrame(rows), f"{time.process_time() - began:.0f} processor seconds in this run"
            (place / "table.csv").write(table.to_csv(index=False).encode())
            (place / "table.md").write((table_page(table, settings, spent, absent) + "\n").encode())
    return pd.DataFrame(rows)


def _made(home: Place, name: str, seed: int, noise_um: float) -> Campaign:
    """Make the recordings of a set, and read them."""
    plan = made.comparison_plan()
    if name in FEW:
        added, held = (tuple(sine(f, a) for f, a in each) for each in (_ADDED[: FEW[name]], _HELD))
        chosen = dict.fromkeys((e.name for e in added), "identification")
        plan = chosen | dict.fromkeys((e.name for e in held), "confirmation"), (*added, *held)
    folder = (home / "recordings").own_folder()
    if name in (TABLE, CREEP):
        effect = "none" if name == TABLE else name
        made.write_recordings(folder, made.Conditions(effect, _RESIDUAL_UM, noise_um, seed=seed), plan)
    else:
        made.write_truth(folder, PHS if name in FEW else name, seed, plan, noise_um)
    return read(folder)


def _warm(settings: Settings, place: Place, progress: Progress) -> None:
    """Fit phnn's models to one short recording: what is compiled then takes no time from a model's budget."""
    chosen = tuple(m for m in settings.models if m in MODELS)
    if not chosen or (place / "warm").path.exists():
        return
    progress("compile")
    home, plan = place / "warm", ({sine(50.0).name: "identification"}, (sine(50.0, periods=1),))
    made.write_truth((home / "recordings").own_folder(), PHS, 0, plan, 0.05)
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
) -> Iterator[dict[str, Any]]:
    """Yield a row for each model on one folder; one that cannot be simulated states the reason in ``why``."""
    own = limited(replace(settings, options=replace(settings.options, seed=case["seed"])), settings.budget)
    told: Progress = lambda line: progress(f"{case['set']}, seed {case['seed']}: {line}")  # noqa: E731
    campaign, kinds = replace(campaign, recordings=own_zeros(campaign.recordings)), made.uses(campaign.recordings)
    bench = Bench(campaign, own, Place((home / "models").own_folder()), told)
    for model in own.models:
        row = case | {"model": model, "budget": settings.budget, "why": ""}
        try:
            result = bench.result(model)
        except SolverFailed as error:
            yield row | {"why": str(error)}
            continue
        row |= {n: result.facts.get(n, np.nan) for n in ("parameters", "evaluations", "processor_seconds", "seconds")}
        row |= {use: made.over_noise(result.evaluation, kinds, use) for use in USES}
        parts = result.evaluation.parts if case["set"] in FOLDERS else ()
        yield row | {f"rmse {p.name}": p.rmse for p in parts if p.use != "identification"}


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
            body.append([title(str(model)), f"{rows['parameters'].mean():.0f}", *cells, *effort,
                         DASH if np.isnan(count) else f"{count:.0f}"])  # fmt: skip
        lines += ["", f"## {name}", "", *markdown_table([*heads, "processor s", "wall s", "evaluations"], body)]
    lines += ["", *(f"* {r.set}, seed {r.seed}, {r.model}: {r.why}" for r in table[table["why"] != ""].itertuples())]
    return "\n".join(lines).rstrip()


_UNIT = 1e6, "10⁻⁶"  # of the errors on public recordings, in the unit of their output


def _spread(values: pd.Series[float]) -> str:
    """Write mean and standard deviation over seeds; a model that left the finite numbers says how often."""
    lost = int((~np.isfinite(values)).sum())
    if lost:
        return f"diverged {lost} of {len(values)}"
    return ratio(float(values.mean())) + (f" ± {ratio(float(values.std()))}" if len(values) > 1 else "")


def _words(table: pd.DataFrame, settings: Settings, spent: str) -> str:
    seeds = ", ".join(str(s) for s in dict.fromkeys(table["seed"]))
    return (
        f"Residual over noise, root mean square over recordings; seeds {seeds}. Budget of each model: "
        f"{settings.budget:g} seconds of one processor, twice as much for the neural ODE; {spent}. PHS, the linear "
        "model and Bouc–Wen blocks end when they converge; a training ends after the epoch in which its time is over."
    )


def _own(which: str, campaign: Campaign, seed: int, budget: float) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Fit the model that the recordings' manifest states, or the one of a diagnosis, which takes what time it needs."""
    options = Options(seed=seed, workers=1)
    if which == "base":
        fitted = identify_base(campaign, options)[0]
        return score_on_all(fitted, campaign).outputs, {"parameters": len(fitted.variables.names), "kind": "manifest"}
    found = diagnose(campaign, options)
    return found.after.outputs, {"parameters": len(found.chosen.fit.variables.names), "kind": found.verdict}


def one_to_one(folder: Path, name: str) -> Campaign:
    """Read a folder by the manifest of ``configs/recordings``, with one input and one output in each recording."""
    manifest = config_folder() / "recordings" / name / _MANIFESTS.get(name, "recordings.yaml")
    campaign = read(folder, manifest, allow_outside=True)
    chosen = [r for r in campaign.recordings if r.measures in ("", "y_1")]
    if name == "steering-mirror":
        chosen = [r for r in chosen if r.name.partition(".")[0] in _MIRROR]
    plain = (replace(r, further={}, measures="") for r in chosen)
    return replace(campaign, recordings=own_zeros(tuple(plain)))
