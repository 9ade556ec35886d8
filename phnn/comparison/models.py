"""A comparison: its models, their settings, how each is fitted, results that need no second fit, table and figure.

Every model is fitted to the identification samples and gives its output on all recordings. A model of your own joins by
`register_rival`.

Neural models are trained in stages, black boxes among them from a linear start: from weights at random some thousand
steps go by before a latent model has found that displacement follows voltage. Their linear relaxations have the static
gain of the recordings, and none of their values is fitted yet (Paduart et al. 2010; Schoukens & Ljung 2019):

    neural ODE            T ẋ_i = λ_i (c_i u/U − x_i),  y = Y Σ x_i       one fast lag, slow ones over the recorded band
    fully neural PHS      mass, spring, damper and linear hysterons, scaled so that H = ½|x|² and y = Y x_1
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from matplotlib import rc_context
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Printed

from phnn.configuration import check, compose, positive
from phnn.diagnose.diagnosis import score_on_all
from phnn.errors import InputRefused
from phnn.identification.base import Progress, identify_base, identify_bouc_wen, quiet
from phnn.identification.evaluate import Evaluation, PartScore, scored, with_zero
from phnn.identification.identified import save_fit
from phnn.identification.plan import Options, Plan
from phnn.identification.prepare import identification_plan, own_zeros, single
from phnn.identification.staged import identify_actuator
from phnn.identification.starting_points import MECHANICAL
from phnn.learn import Settings as Stage
from phnn.learn.objective import evaluate
from phnn.learn.run import fitted as trained
from phnn.learn.run import validation_names, write_plant
from phnn.learn.solvers import solver_for, thinned
from phnn.learn.starts import plant_for, scales_of
from phnn.recordings import Campaign, campaign_of
from phnn.recordings.recording import Recording, digest
from phnn.report.figures.style import CATEGORIES, RC, literal, log_axis, new_figure, png, quiet_grid
from phnn.report.formatting import markdown_table, number, percent, ratio
from phnn.results import Origin, Place, claim, file_name, finite, same

Array = NDArray[np.float64]
# Of a campaign, a seed and processor seconds: outputs by recording, and facts.
RivalFit = Callable[[Campaign, int, float], tuple[Mapping[str, Array], Mapping[str, Any]]]

_SCHEMA = "phnn.compared/2"
_FILE, _OUTPUTS = "result.json", "outputs.npz"
_LEAST_SQUARES = "least squares with exact forward sensitivities of the compiled power-preserving step"
_ADJOINT = "L-BFGS, torchdiffeq's odeint_adjoint with the compiled power-preserving step as its method"


@dataclass(frozen=True)
class Kind:
    """Attributes:
    title: of the model's column; words: what it is; how: by what it is fitted.
    """

    title: str
    words: str
    how: str = _LEAST_SQUARES


# In the order in which they are fitted and shown: phs_neural begins from phs.
MODELS = {
    "phs": Kind("PHS", "port-Hamiltonian network, hysterons with dead zones"),
    "phs_neural": Kind(
        "PHS, learned hysterons", "port-Hamiltonian network, hysterons with learned resistors, started from phs",
        "damped Gauss–Newton with exact forward sensitivities of the compiled power-preserving step",
    ),
    "hybrid": Kind(
        "PHS, learned multi-port", "port-Hamiltonian network with a learned dissipation on hysterons and mass together "
        "and a learned transducer ratio, started from phs", "L-BFGS through the power-preserving step",
    ),
    "phs_adjoint": Kind("PHS, by adjoint", "port-Hamiltonian network, hysterons with dead zones", _ADJOINT),
    "phs_neural_adjoint": Kind(
        "PHS, learned hysterons, by adjoint", "port-Hamiltonian network, hysterons with learned resistors", _ADJOINT
    ),
    "neural_phs": Kind(
        "fully neural PHS", "port-Hamiltonian system whose structure, dissipation and energy are learned",
        "implicit function theorem through the power-preserving step, one backward sweep",
    ),
    "bouc_wen": Kind("Bouc–Wen", "Bouc–Wen block in front of a mass, spring and damper"),
    "linear": Kind("linear", "mass, spring and damper"),
    "neural_ode": Kind(
        "neural ODE", "black-box neural ordinary differential equation",
        "through the steps of the explicit method (torchdiffeq)",
    ),
}  # fmt: skip
# Networks whose time step the identified model tells, and models that begin without an identified one.
NETWORKS, BLACK_BOXES = ("phs_neural", "hybrid", "phs_adjoint", "phs_neural_adjoint"), ("neural_phs", "neural_ode")
TRAINED = (*NETWORKS, *BLACK_BOXES)
_RIVALS: dict[str, tuple[RivalFit, str]] = {}


def register_rival(name: str, fit: RivalFit, title: str = "") -> None:
    """Add a model of your own to the comparisons of this process; ``models=[phs,NAME]`` then names it.

        def follow(campaign, seed, budget):
            gain = max(np.ptp(r.y) for r in campaign.recordings) / max(np.ptp(r.u) for r in campaign.recordings)
            return {r.name: gain * r.u for r in campaign.recordings}, {"parameters": 1}

        register_rival("proportional", follow)

    Args:
        name: of the model and of its folder; a rival of the same name is replaced.
        fit: fits to the identification samples (``r.mask("identification")``) of a campaign. It gets the campaign, the
            seed and the processor seconds of ``budget``, which it may use. It returns the output (N,) by recording's
            name for all recordings, in SI, and facts that json can hold; ``parameters``, ``kind`` and ``gradient`` are
            shown. The zero of each recording is added to the output as for every other model.
        title: of its column; the name if empty.

    Raises:
        InputRefused: the name belongs to a model of phnn or cannot be that of a folder.
    """
    if name in (*MODELS, "all") or file_name(name) != name:
        raise InputRefused(f"rival {name!r}: this name is taken or no file name: choose another")
    _RIVALS[name] = fit, title or name


def known() -> tuple[str, ...]:
    """Return the names of all models, registered rivals last."""
    return (*MODELS, *_RIVALS)


def title(model: str) -> str:
    """Return the title of a model's column."""
    return MODELS[model].title if model in MODELS else _RIVALS[model][1]


@dataclass(frozen=True)
class Recipe:
    """How a neural model is trained.

    Attributes:
        model: its kind and arguments, see `phnn.learn.starts`.
        solver: its name and options, see `phnn.learn.solvers`.
        longest_step: recordings are thinned to steps of at most this many time units ``1/(2π f)`` of the highest
            frequency, where they are sampled finer; null for no thinning.
        least_per_period: samples that a period keeps at least.
        stages: settings of `phnn.learn.Settings` by name, one training after the other.
    """

    model: Mapping[str, Any]
    solver: Mapping[str, Any]
    longest_step: float | None
    least_per_period: int
    stages: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Settings:
    """One comparison; the keys of ``configs/compare.yaml``.

    Attributes:
        options: of the identification of parametric models.
        models: which to fit, in the order of `known`.
        resume: read finished models of an earlier run back, and go on where a training was stopped.
        recipes: of the neural models, by name.
        budget: processor seconds of each rival.
    """

    options: Options
    models: tuple[str, ...]
    resume: bool
    recipes: Mapping[str, Recipe]
    budget: float = positive(60.0)

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """Return the settings of a composed configuration.

        Raises:
            InputRefused: an unknown model, or none.
        """
        asked = config["models"]
        names = [asked] if isinstance(asked, str) else list(asked)
        there = ", ".join(known())
        for name in names:
            if name not in (*known(), "all"):
                raise InputRefused(f"models: nothing is called {name!r}: choose from {there}, or all")
        chosen = tuple(m for m in known() if m in names or "all" in names)
        if not chosen:
            raise InputRefused(f"models: none is named: choose from {there}, or all")
        recipes = {name: Recipe(**config[name]) for name in TRAINED}
        return cls(Options.from_config(config), chosen, bool(config["resume"]), recipes, config["budget"])

    def of(self, model: str) -> dict[str, Any]:
        """Return all that the result of one model depends on besides the recordings, as plain numbers and texts."""
        # Threads share the work and leave the result as it is.
        inputs: dict[str, Any] = {"seed": self.options.seed}
        if model in TRAINED:
            inputs |= {"recipe": vars(self.recipes[model])}
        if model not in MODELS:
            inputs |= {"budget": self.budget}
        elif model not in BLACK_BOXES:
            inputs |= {n: getattr(self.options, n) for n in ("starts", "error_bound_sigma")}
        return inputs


@dataclass(frozen=True)
class Result:
    """One model on all recordings.

    Attributes:
        name: of the model.
        evaluation: its outputs and scores.
        facts: what else there is to say of it: kind, number of parameters, seconds, how it was fitted, seed.
        substeps: steps a sample interval by recording, of a model that others begin from.
    """

    name: str
    evaluation: Evaluation
    facts: Mapping[str, Any]
    substeps: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Bench:
    """What every model is fitted with.

    Attributes:
        campaign: the recordings; settings: of the comparison; place: where the results go; progress: told what is done.
        done: models that were fitted or read back, because others begin from them.
    """

    campaign: Campaign
    settings: Settings
    place: Place
    progress: Progress
    done: dict[str, Result] = field(default_factory=dict)

    def result(self, model: str) -> Result:
        """Return a model's result: the one that lies in its folder, or that of fitting it now.

        Raises:
            InputRefused: the one that lies there was made otherwise.
        """
        if model in self.done:
            return self.done[model]
        made_with = {**self.settings.of(model), "recordings": digest(self.campaign), "schema": _SCHEMA}
        result = _kept((self.place / model).path, made_with) if self.settings.resume else None
        if result is None:
            if model in (*NETWORKS, "bouc_wen", "linear"):
                # They take its time step; its seconds are not theirs.
                self.result("phs")
            passed, used = time.monotonic(), time.process_time()
            result = _FITTERS.get(model, _rival)(self, model)
            wall, processor = time.monotonic() - passed, time.process_time() - used
            seconds = {"seconds": round(wall, 1), "processor_seconds": round(processor, 2)}
            result = replace(result, facts={**seconds, **result.facts})
            _keep(result, self.place / model, made_with)
        self.done[model] = result
        return result

    def plan(self) -> Plan:
        """Return the identification recordings with the sub-steps that the base model was found to need."""
        substeps = self.result("phs").substeps
        return replace(identification_plan(self.campaign, self.settings.options.workers), substeps=dict(substeps))

    def facts(self, model: str, facts: Mapping[str, Any]) -> dict[str, Any]:
        """Return what there is to say of a model of phnn."""
        return {"kind": MODELS[model].words, "gradient": MODELS[model].how, "seed": self.settings.options.seed, **facts}


def _keep(result: Result, place: Place, made_with: Mapping[str, Any]) -> None:
    """Write a result into the folder of its model; the outputs first, so that a result is whole once it is there."""
    buffer = io.BytesIO()
    np.savez(buffer, *result.evaluation.outputs.values())
    (place / _OUTPUTS).write(buffer.getvalue())
    content = {
        "model": result.name, "made_with": made_with, "outputs": list(result.evaluation.outputs),
        "parts": [asdict(p) for p in result.evaluation.parts], "facts": result.facts, "substeps": result.substeps,
    }  # fmt: skip
    (place / _FILE).write_json(content)


def _kept(folder: Path, made_with: Mapping[str, Any]) -> Result | None:
    """Return the result that `_keep` wrote, None where there is none."""
    path = folder / _FILE
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        with np.load(folder / _OUTPUTS) as stored:
            outputs = {name: stored[f"arr_{k}"] for k, name in enumerate(content["outputs"])}
        # An infinite score is null in json.
        rows: list[dict[str, Any]] = [{n: np.inf if v is None else v for n, v in p.items()} for p in content["parts"]]
        result = Result(
            content["model"],
            Evaluation(outputs, tuple(PartScore(**row) for row in rows)),
            content["facts"],
            content["substeps"],
        )
        before = dict(content["made_with"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputRefused(f"{path}: cannot be read ({type(error).__name__}): delete {folder}") from error
    now = json.loads(json.dumps(finite(made_with)))
    same(path, before, now, "take another --out, or resume=false to fit it anew")
    return result


def _identified(bench: Bench, model: str) -> Result:
    """Identify, score and save a parametric model."""
    campaign, options = bench.campaign, bench.settings.options
    if model == "phs":
        actuator = {"model": "piezo_actuator", "hysterons": campaign.setup.get("hysterons", 2)}
        fitted, _ = identify_base(replace(campaign, setup=actuator), options, bench.progress)
    elif model == "bouc_wen":
        fitted = identify_bouc_wen(bench.plan(), campaign, options, bench.progress)
    else:
        bench.progress("identify linear")
        known = {n: a for n, a in campaign.known.items() if n in MECHANICAL}
        fitted = identify_actuator(bench.plan(), known, 0, 1, options.seed)
    scores = score_on_all(fitted, campaign)
    save_fit(fitted, bench.place / model)
    facts = bench.facts(model, {"parameters": len(fitted.variables.names)})
    return Result(model, scores, facts, dict(fitted.plan.substeps))


def _trained(bench: Bench, model: str) -> Result:
    """Train a neural model stage by stage, score and save it; finished stages are read back from their checkpoints.

    The model is scored at the samples the recordings have; those for confirmation are looked at once, at the end.
    """
    recipe, seed, campaign = bench.settings.recipes[model], bench.settings.options.seed, bench.campaign
    substeps, base = 1, None
    if model in NETWORKS:
        substeps = bench.plan().finest
        base = str((bench.place / "phs").path) if model in ("phs_neural", "hybrid") else None
        stated = campaign.setup.get("hysterons", 2)
        recipe = replace(recipe, model={**recipe.model, "hysterons": stated if isinstance(stated, int) else 2})
    torch.manual_seed(seed)
    aside = validation_names(campaign, None)
    plant = plant_for(recipe.model, campaign, seed, base)
    used = [r for r in campaign.recordings if r.mask("identification").any()]
    thin = replace(campaign, recordings=tuple(_thinned(used, recipe, scales_of(used).time)))
    losses, solved = {}, 0
    for stage in recipe.stages:

        def told(line: str, what: str = f"train {model}, {stage}") -> None:
            bench.progress(f"{what}: {line}")

        settings = replace(_stage(bench, model, recipe, stage), validation=aside)
        done = trained(plant, thin, settings, bench.place / model / stage, digest(campaign), told).facts
        losses[stage], solved = done["best_validation"], solved + done["evaluations"]
    bench.progress(f"score {model}")
    scores = evaluate(plant, solver_for(recipe.solver, plant), campaign.recordings, substeps, {})
    write_plant(plant, model, bench.place / model, bench.place / model, substeps)
    count = sum(p.numel() for p in plant.trained())
    facts = {"parameters": count, "evaluations": solved, "loss_by_stage": losses, "stopped_by": list(aside)}
    return Result(model, scores, bench.facts(model, facts))


def _stage(bench: Bench, model: str, recipe: Recipe, stage: str) -> Stage:
    """Return the settings of one stage of a training."""
    none = {"adam": 0, "lbfgs": 0, "gauss_newton": 0, "tensorboard": False}
    common = {
        "folder": bench.campaign.folder, "out": str((bench.place / model / stage).path), "model": dict(recipe.model),
        "solver": dict(recipe.solver), "seed": bench.settings.options.seed, "resume": bench.settings.resume,
    }  # fmt: skip
    for key in recipe.stages[stage]:
        if key in common:
            raise InputRefused(f"{model}.stages.{stage}.{key}: is set for the whole model; leave it out here")
    return Stage.from_config(none | dict(recipe.stages[stage]) | common)


def _thinned(recordings: Sequence[Recording], recipe: Recipe, unit: float) -> list[Recording]:
    """Return recordings at the samples that training uses, each weighing as much as with all of its samples.

    A slow recording needs steps as short as a fast one's dynamics, not as many samples a period.
    """
    if recipe.longest_step is None or not recordings:
        return list(recordings)
    longest = recipe.longest_step * unit
    thin = [thinned(r, _stride(r, longest, recipe.least_per_period)) for r in recordings]
    shares = np.array([f.t.size / r.t.size for f, r in zip(thin, recordings, strict=True)])
    mean = sum(f.t.size for f in thin) / sum(r.t.size for r in recordings)
    # The loss is a mean over samples of the residual over noise: a larger noise takes the weight of surplus samples.
    return [replace(f, noise=f.noise * float(np.sqrt(s / mean))) for f, s in zip(thin, shares, strict=True)]


def _stride(recording: Recording, longest: float, least: int) -> int:
    """Return every how many samples: steps no longer than the longest, and no fewer of them a period than the least."""
    most = longest / recording.dt
    if recording.period is not None:
        most = min(most, recording.period / recording.dt / least)
    return max(1, min(int(most), recording.t.size // 64))


def _rival(bench: Bench, model: str) -> Result:
    """Fit and score a registered rival."""
    (fit, _), settings = _RIVALS[model], bench.settings
    bench.progress(f"fit {model}, {settings.budget:g} s of the processor")
    given, details = fit(bench.campaign, settings.options.seed, settings.budget)
    facts = {
        "kind": "rival", "parameters": "", "gradient": "", "seed": settings.options.seed, "budget": settings.budget,
        **details,
    }  # fmt: skip
    outputs = {r.name: _checked(model, r, given) for r in bench.campaign.recordings}
    return Result(model, scored(bench.campaign.recordings, outputs), facts)


def _checked(model: str, recording: Recording, given: Mapping[str, Array]) -> Array:
    """Return a rival's output on one recording, with the recording's own zero."""
    if recording.name not in given:
        raise InputRefused(f"rival {model}: has no output for recording {recording.name}: give all recordings")
    y = np.asarray(given[recording.name], dtype=np.float64)
    if y.shape != recording.t.shape:
        raise InputRefused(f"rival {model}: {recording.name} has shape {y.shape}: give {recording.t.shape[0]} samples")
    return with_zero(recording, y) if np.isfinite(y).all() else y


_FITTERS: dict[str, Callable[[Bench, str], Result]] = {
    **dict.fromkeys(("phs", "bouc_wen", "linear"), _identified), **dict.fromkeys(TRAINED, _trained)
}  # fmt: skip


# ---- From recordings to a table and a figure

Results = Mapping[str, Result]

RESULTS = ("compare.json", "models.json", "compare.csv", "compare.md", "compare.png")
USES = {"identification": "identified", "confirmation": "held out"}
_MARKS = "DoXsv^P<>phd8"


def compare(
    campaign: Campaign | str | Path,
    out: str | Path,
    settings: Settings | Sequence[str] = (),
    progress: Progress = quiet,
    overwrite: bool = False,
) -> dict[str, Result]:
    """Fit several kinds of model to the identification recordings; return them, scored on all, by name.

        results = phnn.compare(phnn.read("recordings/"), "compared/", ["models=[phs,linear]"])
        results["linear"].evaluation.over_noise("confirmation")  # held-out residual over noise

    Writes ``compare.json`` and ``models.json`` after every model, ``compare.csv``, ``compare.md`` and ``compare.png``
    at the end, and each model into a folder of its own. Models that were finished before are read back.

    Args:
        campaign: recordings with their uses, or their folder.
        out: where the results go.
        settings: which models, and how they are fitted: ``key=value``, as for ``phnn compare``,
            see ``configs/compare.yaml``.
        progress: called with a line of text at every stage.
        overwrite: replace results that were changed since.

    Raises:
        InputRefused: a setting is unknown or out of range, recordings cannot be used, or results of other settings lie
            in ``out``.
    """
    if not isinstance(settings, Settings):
        settings = Settings.from_config(compose("compare", settings))
    campaign, out = campaign_of(campaign), Path(out)
    # Models know themselves what they were made of, so that one can be added to those that were fitted before.
    origin = Origin(resume=settings.resume, anew="resume=false")
    with claim(out, "compare", campaign.inputs, (*RESULTS, *settings.models), origin, overwrite) as place:
        single(campaign.recordings, "a comparison follows one input to one output")
        # Not every model that is compared has a parameter for a shared zero.
        bench = Bench(replace(campaign, recordings=own_zeros(campaign.recordings)), settings, place, progress)
        results: dict[str, Result] = {}
        for model in settings.models:
            results[model] = bench.result(model)
            (place / "compare.json").write_json(scores(results))
            (place / "models.json").write_json({m: r.facts for m, r in results.items()})
        progress("draw")
        (place / "compare.png").write(draw(results))
        (place / "compare.csv").write(table_csv(results).encode())
        (place / "compare.md").write(page(results, campaign.folder).encode())
    return results


def scores(results: Results) -> dict[str, dict[str, dict[str, Any]]]:
    """Return ``compare.json`` as a mapping, lengths in m."""
    return {
        model: {p.name: {**p.numbers, "held_out": p.use != "identification"} for p in result.evaluation.parts}
        for model, result in results.items()
    }


def _rows(results: Results) -> Iterator[tuple[str, str, dict[str, PartScore]]]:
    """Yield name, use and the scores of all models of every recording or part, identified ones first."""
    entries = {model: {p.name: p for p in result.evaluation.parts} for model, result in results.items()}
    first = next(iter(entries.values()))
    for use in USES:
        yield from ((n, use, {m: parts[n] for m, parts in entries.items()}) for n, p in first.items() if p.use == use)


def table_csv(results: Results) -> str:
    """Return one line for each recording and model, SI."""
    head = ["recording", "use", "model", "fit_percent", "rmse_m", "residual_over_noise"]
    rows = [[name, use, m, *p.numbers.values()] for name, use, parts in _rows(results) for m, p in parts.items()]
    return pd.DataFrame(rows, columns=head).to_csv(index=False, na_rep="nan", lineterminator="\n")


def _table(results: Results) -> tuple[list[str], list[list[str]]]:
    """Return heads and cells of the table of fits: fit percentage, and the residual over noise in brackets."""
    cells = [
        [n, USES[use], *(f"{percent(p.fit_percent, 2)}  ({ratio(p.residual_over_noise)})" for p in parts.values())]
        for n, use, parts in _rows(results)
    ]
    return ["recording", "use", *map(title, results)], cells


def page(results: Results, folder: str) -> str:
    """Return the comparison as markdown."""
    over = [
        [words, *(ratio(r.evaluation.over_noise(use)) for r in results.values())]
        for use, words in USES.items()
        if np.isfinite(next(iter(results.values())).evaluation.over_noise(use))
    ]
    models = [
        [title(m), *(str(r.facts[n]) for n in ("kind", "parameters")), number(r.facts["seconds"]), r.facts["gradient"]]
        for m, r in results.items()
    ]
    lines = [f"# All models on {folder}", "", "Fitted to the identification recordings, scored on all.", ""]
    lines += ["## Fit in percent, and residual over noise in brackets", "", *markdown_table(*_table(results)), ""]
    lines += markdown_table(["residual over noise, root mean square", *map(title, results)], over)
    lines += ["", "![Residual over noise, by recording and model](compare.png)", "", "## Models", ""]
    return "\n".join([*lines, *markdown_table(["model", "kind", "parameters", "seconds", "fitted by"], models), ""])


def draw(results: Results) -> bytes:
    """Return a picture with one dot a model and recording on a logarithmic axis of the residual over noise."""
    rows = list(_rows(results))
    with rc_context(RC):
        figure = new_figure(9.2, 1.5 + 0.31 * len(rows))
        axes = figure.subplots()
        for k, model in enumerate(results):
            known = [(parts[model].residual_over_noise, at) for at, (_, _, parts) in enumerate(rows)]
            known = [(x, at) for x, at in known if 0.0 < x < np.inf]
            axes.scatter(
                [x for x, _ in known], [at for _, at in known], s=34, color=CATEGORIES[k % len(CATEGORIES)],
                marker=_MARKS[k % len(_MARKS)], label=literal(title(model)), zorder=3, alpha=0.9,
            )  # fmt: skip
        log_axis(axes)
        axes.axvline(1.0, color="#4d555c", linewidth=1.0, dashes=(3, 2), zorder=0, label="noise floor")
        axes.set_yticks(range(len(rows)), [f"{literal(n, 34)}  ({USES[use]})" for n, use, _ in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        quiet_grid(axes)
        axes.set_xlabel("residual over noise (logarithmic)")
        figure.legend(loc="outside upper right", ncols=4)
        return png(figure)


def show(results: Results, console: Console) -> None:
    """Print fit and residual over noise, recordings grouped by use."""
    heads, cells = _table(results)
    printed = Printed(*heads, title="fit % (residual over noise)")
    for row, after in zip(cells, [*cells[1:], cells[-1]], strict=True):
        printed.add_row(*(escape(cell) for cell in row), end_section=row[1] != after[1])
    console.print(printed)
