"""What the console commands do: thin covers over reading, identifying, diagnosing and writing."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from phnn.check import check as check_recordings
from phnn.diagnosis.diagnosis import Diagnosis
from phnn.diagnosis.diagnosis import diagnose as run_diagnosis
from phnn.diagnosis.tested import score_on_all
from phnn.identification.base import Progress, identify_base
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit
from phnn.identification.options import Options
from phnn.identification.prepare import prepare
from phnn.intake.names import printable
from phnn.models.store import save
from phnn.network.roles import auxiliary
from phnn.output import Place, claim, finite, unique_names
from phnn.prediction import document
from phnn.predictor import predictor
from phnn.recordings import Campaign, read
from phnn.report import console_summary
from phnn.report.formatting import interval
from phnn.report.predicted import score_table
from phnn.report.result import RESULTS, evidence, write_into
from phnn.warm import compile_later_kernels

Config = Mapping[str, Any]
_PIPE = 200


@contextmanager
def _progress() -> Iterator[Progress]:
    """A status line on a terminal; silence in a pipe."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda message: None
        return
    with console.status("reading") as status:
        yield status.update


def check(
    folder: Path, manifest: Path | None, out: Path | None = None, outside: bool = False, overwrite: bool = False
) -> None:
    """Print what was understood of a folder of recordings, what was noticed, and what they can show.

    Raises:
        InputRefused: what `identify` would refuse, with the same message. Several inputs or outputs without a network
            are for `modes` and pass.
    """
    campaign = read(folder, manifest, allow_outside=outside)
    if "network" in campaign.setup or not any(r.further or r.measures for r in campaign.recordings):
        prepare(campaign)
    checked = check_recordings(campaign)
    print(printable(checked.text(), lines=True))
    if out is not None:
        from phnn.report.checked import write_check  # draws

        with claim(out, "check", [folder], ("check.json", "check.html"), overwrite=overwrite) as place:
            write_check(checked, place)


def template(folder: Path, out: Path | None, outside: bool = False) -> None:
    """Print a first manifest for a folder of unknown layout, or write it into a new file."""
    from phnn.template import template as first_manifest
    from phnn.template import write_template

    with _progress():
        if out is None:
            text = first_manifest(folder, outside)
        else:
            write_template(folder, out, outside)
    print(text.rstrip() if out is None else f"written: {out}; correct what is marked as guessed")


def identify(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Fit the base model; writes ``base/`` and ``identify.json``."""
    options = Options.from_config(config)
    campaign = read(folder, manifest, allow_outside=outside)
    with claim(out, "identify", [folder], ("base", "identify.json"), overwrite=overwrite) as place:
        parameters, scores = _identify(campaign, options, place)
    console = Console()
    table = Table("parameter", "value", "standard error", "95 % interval", "note", title=f"base model of {folder}")
    for name, row in parameters.items():
        error_text = f"{row['std']:.2g}" if row["std"] is not None else "–"
        value = f"{row['value']:.5g} {row['unit']}"
        table.add_row(name, value, error_text, interval(row["interval_95"]), str(row["held"] or ""))
    console.print(table)
    console.print(_score_table({"base": scores}))


def _identify(campaign: Campaign, options: Options, place: Place) -> tuple[dict[str, Any], Evaluation]:
    """Fit the base model and write it; its table of parameters, and its scores."""
    with _progress() as progress:
        fitted, error = identify_base(campaign, options, progress)
        scores = score_on_all(fitted, campaign)
    _keep(fitted, place / "base")
    std, hidden = fitted.std(), auxiliary(fitted.setup.network)
    parameters = {
        n: {
            "value": p.value,
            "unit": p.unit,
            "std": finite(std.get(n)),
            "interval_95": fitted.interval(n),
            "held": _note(fitted, n),
        }
        for n, p in fitted.setup.parameters.items()
        if n not in hidden
    }
    content = {
        "parameters": parameters,
        "fit": scores.table(),
        "numerical_error_sigma": error.sigma,
        "seed": options.seed,
    }
    (place / "identify.json").write_json(content)
    return parameters, scores


def diagnose(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Diagnose a folder; writes ``diagnosis.json``, ``report.html``, ``model/``, ``base/`` and ``figures/``."""
    options = Options.from_config(config)
    campaign = read(folder, manifest, allow_outside=outside)
    with claim(out, "diagnose", [folder], RESULTS, overwrite=overwrite) as place:
        diagnose_into(campaign, place, options, out)


def diagnose_into(campaign: Campaign, place: Place, options: Options, out: Path) -> Diagnosis:
    """Diagnose, write what `diagnose` writes, and print it; ``out`` is the place as the user calls it."""
    compile_later_kernels()
    with _progress() as progress:
        diagnosis = run_diagnosis(campaign, options, progress, on_base=lambda fitted: _keep(fitted, place / "base"))
        progress("write the report")
        shown = evidence(diagnosis)
        document = write_into(diagnosis, place, shown)
    console = Console()
    console.print(console_summary(document, shown))
    console.print(f"report: {out / 'report.html'}   seed: {options.seed}")
    return diagnosis


def diagnose_quietly(folder: Path, place: Place, config: Config) -> Diagnosis:
    """The same without a word on the terminal; the settings as in ``configs/diagnose.yaml``."""
    options = Options.from_config(config)
    diagnosis = run_diagnosis(read(folder), options)
    write_into(diagnosis, place)
    return diagnosis


def _keep(fitted: Fit, place: Place) -> None:
    save(fitted.setup, place, max(fitted.plan.steps_of(r) for r in fitted.plan.recordings))


def predict(
    model: Path, folder: Path, out: Path, manifest: Path | None, outside: bool = False, overwrite: bool = False
) -> None:
    """Simulate the recordings of a folder with a stored model; writes one ``NAME.csv`` per recording and
    ``predict.json`` with fit %, RMSE and residual over noise wherever the output was recorded.

    Where the input jumps between two samples, a further column says how uncertain that makes the output.
    """
    simulator = predictor(model, outside)
    campaign = read(folder, manifest, need_output=False, allow_outside=outside)
    predictions = simulator(campaign)
    files, found = unique_names((r.name for r in campaign.recordings), ".csv"), []
    results = (*files.values(), "predict.json")
    with claim(out, "predict", [model, folder], results, overwrite=overwrite) as place:
        for one in predictions:
            name = files[one.recording.name]
            (place / name).write(one.table.to_csv(index=False).encode())
            found.append(one)
            print(out / name)
        content = document(found, files, printable(str(model)))
        (place / "predict.json").write_json(content)
    table = score_table(content)
    if table is not None:
        console = Console()
        (console if console.is_terminal else Console(width=_PIPE)).print(table)
    print(f"results: {out / 'predict.json'}")


def compare(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Fit several kinds of model to a folder; see `phnn.comparison.run.compare` for what it writes."""
    from phnn.comparison.run import compare as run_comparison
    from phnn.comparison.run import show
    from phnn.comparison.settings import Settings

    settings = Settings.from_config(config)
    with _progress() as progress:
        campaign = read(folder, manifest, allow_outside=outside)
        table = run_comparison(campaign, out, settings, progress, overwrite)
    # A pipe has no width: the whole table fits there.
    console = Console()
    show(table, console if console.is_terminal else Console(width=_PIPE))
    print(f"results: {out / 'compare.md'}   seed: {settings.options.seed}")


def modes(
    folder: Path, out: Path, manifest: Path | None, config: Config, outside: bool = False, overwrite: bool = False
) -> None:
    """Find the modes of a structure and what moves with amplitude; see `phnn.report.modes` for what it writes."""
    from phnn.modal.experiment import study_of
    from phnn.modal.settings import Settings
    from phnn.modal.store import channels_of, model_document
    from phnn.modal.study import study_modes
    from phnn.report.modes import RESULTS as MODES
    from phnn.report.modes import show, write_modes

    settings = Settings.from_config(config)
    study = study_of(read(folder, manifest, allow_outside=outside))
    channels = channels_of(study)
    with (
        claim(out, "modes", [folder], MODES, overwrite=overwrite) as place,
        _progress() as progress,
    ):
        result = study_modes(
            study,
            settings,
            progress,
            lambda name, fit: (place / "models" / f"{name}.json").write_json(model_document(fit, channels)),
        )
        progress("write the report")
        write_modes(result, str(folder), place)
    console = Console()
    show(result, console if console.is_terminal else Console(width=_PIPE))
    print(f"report: {out / 'report.html'}")


def train(config: Config) -> None:
    """Train a model on a folder; see `phnn.learn.run.train` for what it writes."""
    from phnn.learn import Settings
    from phnn.learn import train as run_training

    settings = Settings.from_config(config)
    with _progress() as progress:
        content = run_training(settings, progress)
    console = Console()
    table = Table("recording", "use", "fit %", "residual over noise", title=f"{settings.model['kind']}, trained")
    for name, row in content["recordings"].items():
        use = "held out" if row["held_out"] else "stopped the training" if row["validation"] else "trained on"
        table.add_row(escape(name), use, f"{row['fit_percent']:.2f}", f"{row['residual_over_noise']:.3g}")
    console.print(table)
    console.print(f"results: {settings.home}   seed: {settings.seed}")


def gather(folder: Path) -> pd.DataFrame:
    """Print the table of the training runs in a folder; writes ``runs.csv`` there."""
    from phnn.learn.gather import gather as gather_runs

    found = gather_runs(folder)
    (Place(folder.resolve()) / "runs.csv").write(found.to_csv(index=False).encode())
    columns = [c for c in found.columns if c not in ("run", "reason")]
    table = Table(*columns, title=f"runs in {folder}")
    for row in found[columns].astype(object).to_numpy().tolist():
        table.add_row(*("–" if pd.isna(v) else f"{v:.4g}" if isinstance(v, float) else escape(str(v)) for v in row))
    console = Console() if sys.stdout.isatty() else Console(width=160)
    console.print(table)
    for name, reason in found.loc[found["state"] == "failed", ["run", "reason"]].to_numpy().tolist():
        print(f"{name}: {reason}")
    print(f"results: {folder / 'runs.csv'}")
    return found


def _note(fitted: Fit, name: str) -> str | None:
    if not np.isfinite(fitted.std().get(name, 0.0)):
        return "not identified by these recordings"
    return fitted.held.get(name)


def _score_table(scores: Mapping[str, Evaluation]) -> Table:
    table = Table("recording", "use", *scores, title="fit %, and residual over noise")
    parts = next(iter(scores.values())).parts
    for i, part in enumerate(parts):
        cells = [f"{s.parts[i].fit_percent:.2f}  {s.parts[i].residual_over_noise:.3g}" for s in scores.values()]
        table.add_row(escape(part.name), "held out" if part.use == "confirmation" else "identified", *cells)
    return table
