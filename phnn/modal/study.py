"""The study of a campaign: modes at every amplitude alone, one linear model for all, and one with slow ports.

A structure is linear, within these recordings, where one linear model leaves no more than one for each amplitude does.
Otherwise springs at the ports that soften with the mean square of their motion describe what moves. They are no
proof of a cause: hysteresis and springs that soften at once move resonances as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Listing

from phnn.configuration import check, whole
from phnn.errors import SolverFailed
from phnn.modal.experiment import Experiment, Study, first_modes
from phnn.modal.model import ModalFit, ModalModel, fit_modes, model_document
from phnn.models.store import FILE
from phnn.report.formatting import DASH, display_unit, plain, short
from phnn.report.page import Section, Table, page
from phnn.results import Place

SCHEMA = "phnn.modes/3"
# The models of a study, by the names of their files.
LINEAR, SLOW = "linear", "slow_ports"
# One linear model is as good as one for each amplitude up to this factor.
_AS_GOOD = 1.1
# Extension at which a spring has half of its stiffness, over the effective extension at the lowest amplitude; how stiff
# it is at the start, over the stiffness of its port.
_REACH, _STIFFNESS = 8.0, 0.03


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/modes.yaml``.

    Attributes:
        experiments: of each amplitude that are fitted; the others of identification choose between models.
        iterations: derivatives of a fit; workers: threads.
    """

    experiments: int = whole(2, least=1)
    iterations: int = whole(100, least=1)
    workers: int = whole(2, least=1)

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """Read the settings from the composed configuration."""
        return cls(**{n: config[n] for n in cls.__dataclass_fields__})


@dataclass(frozen=True)
class Result:
    """A finished study.

    Attributes:
        study: what was studied; alone: a linear model for each amplitude, and the error by which it was judged.
        models: one model for all amplitudes each, by name; choosing: their errors by amplitude.
        final: name of the model that leaves least of the experiments that choose.
    """

    study: Study
    alone: tuple[ModalFit, ...]
    alone_by: tuple[float, ...]
    models: dict[str, ModalFit]
    choosing: dict[str, tuple[float, ...]]
    final: str

    @property
    def linear_serves(self) -> bool:
        """Return whether one linear model is as good as one for each amplitude."""
        return SLOW not in self.models

    @cached_property
    def document(self) -> dict[str, Any]:
        """Return the study as plain data, SI; all models predict all held-out recordings for it."""
        study = self.study
        return {
            "schema": SCHEMA,
            "linear_serves": self.linear_serves,
            "final": self.final,
            "inputs": list(study.inputs),
            "outputs": list(study.outputs),
            "units": dict(zip(("input", "output"), study.units, strict=True)),
            "sampling_interval_s": study.dt,
            "left_out": dict(study.left_out),
            "levels": [
                _level(level)
                | {
                    "linear_alone": {
                        "frequency_Hz": sorted((fit.model.omega / (2.0 * np.pi)).tolist()),
                        "choosing_error": error,
                        "held_out": scored(fit, study.held_out(i)),
                    }
                }
                for i, (level, fit, error) in enumerate(zip(study.levels, self.alone, self.alone_by, strict=True))
            ],
            "held_out_levels": [_level(level) for level in study.apart],
            "models": {
                name: {
                    "choosing_error": list(self.choosing[name]),
                    "held_out": [scored(fit, study.held_out(i)) for i in range(len(study.levels))],
                    "held_out_levels": [scored(fit, level) for level in study.apart],
                }
                for name, fit in self.models.items()
            },
        }


def _level(level: Sequence[Experiment]) -> dict[str, Any]:
    return {
        "amplitude": level[0].amplitude,
        "experiments": [e.name for e in level],
        "held_out": [e.name for e in level if e.held_out],
    }


def scored(fit: ModalFit, experiments: Sequence[Experiment]) -> dict[str, Any] | None:
    """Return the errors of a model at one amplitude; None without experiments, or where it has no steady state.

    ``rmse`` is the root mean square error of each output over all recorded periods, in its unit; ``share`` is that of
    all outputs together over the effective value of what was measured.
    """
    if not experiments:
        return None
    try:
        errors = fit.errors(experiments)
    except SolverFailed:
        return None
    measured = np.mean([(e.y**2).mean(axis=0) + e.spread**2 for e in experiments], axis=0).sum()
    return {"rmse": errors.tolist(), "share": float(np.sqrt((errors**2).sum() / max(measured, 1e-300)))}


def study_modes(study: Study, settings: Settings, progress: Callable[[str], None]) -> Result:
    """Find the modes, and fit one model to all amplitudes: linear, and with slow ports where that does not serve.

    Raises:
        InputRefused: there is no oscillation within the excited lines.
        SolverFailed: a first model has no steady state.
    """
    levels = range(len(study.levels))
    alone = []
    for i, level in enumerate(study.levels):
        progress(f"modes at {level[0].amplitude:.3g} {study.units[0]}")
        alone.append(_alone(study, i, settings))
    alone_by = tuple(_effective_error(fit, study, i, settings) for i, fit in enumerate(alone))
    # Ratios of size one for every mode: a linear fit does not see how strongly ports are joined to it.
    b = alone[0].model.b
    start = replace(alone[0].model, b=b / np.linalg.norm(b, axis=1)[:, None])
    fitted = [e for i in levels for e in study.identification(i)[: settings.experiments]]
    progress("one linear model for all amplitudes")
    models = {LINEAR: fit_modes(start, fitted, study, settings.iterations, settings.workers)}
    choosing = {LINEAR: tuple(_effective_error(models[LINEAR], study, i, settings) for i in levels)}
    if any(error > _AS_GOOD * least for error, least in zip(choosing[LINEAR], alone_by, strict=True)):
        progress("one model with slow ports for all amplitudes")
        slow = _with_slow_ports(start, study)
        models[SLOW] = fit_modes(slow, fitted, study, settings.iterations, settings.workers)
        choosing[SLOW] = tuple(_effective_error(models[SLOW], study, i, settings) for i in levels)
    final = min(models, key=lambda name: float(np.linalg.norm(choosing[name])))
    return Result(study, tuple(alone), alone_by, models, choosing, final)


def _alone(study: Study, level: int, settings: Settings) -> ModalFit:
    fitted = study.identification(level)
    omega, zeta, b, late = first_modes(study, fitted)
    ports = len(study.inputs)
    delay = np.full(len(study.outputs), late * study.dt)
    model = ModalModel(omega, zeta, b, delay, np.zeros(0), np.ones(ports))
    few = fitted[: max(settings.experiments, ports)]
    return fit_modes(model, few, study, settings.iterations, settings.workers)


def _with_slow_ports(model: ModalModel, study: Study) -> ModalModel:
    """Return a linear model with a spring at every port, too weak yet to matter much at any amplitude."""
    low = model.steady(study.identification(0)[0], study.dt)
    effective = np.sqrt(2.0) * np.linalg.norm(low.x[1:], axis=0) / len(study.levels[0][0].u)
    return replace(model, springs=_STIFFNESS / (model.b**2).sum(axis=0), reach=_REACH * effective)


def _effective_error(fit: ModalFit, study: Study, level: int, settings: Settings) -> float:
    """Return the effective error over measurement of the experiments of identification that no model was fitted to, all
    where there are no others, each counting alike; inf without a steady state."""
    known = study.identification(level)
    choosing = known[max(settings.experiments, len(study.inputs)) :] or known
    try:
        shares = [(fit.errors([e]) ** 2).sum() / (e.y**2).mean(axis=0).sum() for e in choosing]
    except SolverFailed:
        return float("inf")
    return float(np.sqrt(np.mean(shares)))


# What stands in the folder of a result.
RESULTS = ("modes.json", "report.html", "model", "models")
_SHOWN = {LINEAR: "one linear model", SLOW: "one model with slow ports", "": "linear, a model for each amplitude"}


def write_modes(result: Result, folder: str, place: Place) -> None:
    """Write ``modes.json``, a page and all models; ``folder`` is that of the recordings."""
    (place / "modes.json").write_json(result.document)
    (place / "model" / FILE).write_json(model_document(result.models[result.final]))
    alone = {f"linear_at_level_{i}": fit for i, fit in enumerate(result.alone, start=1)}
    for name, fit in {**alone, **result.models}.items():
        (place / "models" / f"{name}.json").write_json(model_document(fit))
    left_out = _left_out(result)
    sections = [
        Section(None, [_conclusion(result), folder, _errors(result)]),
        Section(f"Modes of {_SHOWN[result.final]}", [_modes(result)], open=True),
        *([Section("Left out", left_out)] if left_out else []),
    ]
    (place / "report.html").write(page(f"Modes: {folder}", "Modes of a structure", sections))


def show(result: Result, out: Console) -> None:
    """Print the errors of all models, and what they say."""
    errors = _errors(result)
    listing = Listing(*errors.head)
    for row in errors.rows:
        listing.add_row(*row)
    out.print(listing)
    for sentence in [*(f"left out: {text}" for text in _left_out(result)), _conclusion(result)]:
        out.print(escape(sentence))


def _left_out(result: Result) -> list[str]:
    return [f"{name}: {reason}" for name, reason in result.study.left_out.items()]


def _errors(result: Result) -> Table:
    """Return the errors of all models at each amplitude: to choose by, and held out, averaged over the outputs."""
    alone = [level["linear_alone"] for level in result.document["levels"]]
    rows = {
        name: (m["choosing_error"], m["held_out"], m["held_out_levels"])
        for name, m in result.document["models"].items()
    }
    # Each of these models knows one amplitude alone.
    nothing = [None] * len(result.study.apart)
    rows[""] = [a["choosing_error"] for a in alone], [a["held_out"] for a in alone], nothing
    largest = max((max(s["rmse"]) for _, *scores in rows.values() for held in scores for s in held if s), default=1e-6)
    unit = display_unit(largest, result.study.units.output)
    levels, apart = (
        [f"{short(level[0].amplitude)} {result.study.units.input}" for level in some]
        for some in (result.study.levels, result.study.apart)
    )
    head = [cell for level in levels for cell in (f"left, {level} (%)", f"held out, {level} ({unit.name})")]
    head += [f"amplitude held out, {level} ({unit.name})" for level in apart]

    def error(score: dict[str, Any] | None) -> str:
        return plain(float(np.mean(score["rmse"])) / unit.scale) if score else DASH

    table = []
    for name, (residual, held, further) in rows.items():
        pairs = [(plain(100.0 * share), error(score)) for share, score in zip(residual, held, strict=True)]
        table.append([_SHOWN[name], *(cell for pair in pairs for cell in pair), *map(error, further)])
    return Table(["model", *head], table)


def _modes(result: Result) -> Table:
    """Return frequency, damping, the ratio to every input and the shape at every output of the final model's modes."""
    study, fit = result.study, result.models[result.final]
    model = fit.model
    head = ["mode", "Hz", "damping, %"]
    head += [f"{name} (J½/{study.units.input})" for name in study.inputs]
    head += [f"{name} ({study.units.output}/J½)" for name in study.outputs]
    rows = [
        [
            str(number),
            *(plain(x, 4) for x in (model.omega[i] / (2.0 * np.pi), 100.0 * model.zeta[i])),
            *(plain(x) for x in (*model.b[i], *fit.shapes[:, i])),
        ]
        for number, i in enumerate(np.argsort(model.omega), start=1)
    ]
    return Table(head, rows, 0)


def _conclusion(result: Result) -> str:
    count = result.models[result.final].model.omega.size
    modes = f"{count} mode{'s' if count > 1 else ''}"
    if len(result.study.levels) == 1:
        return f"{modes} at one amplitude. Record at a second amplitude to see what changes with it."
    if result.linear_serves:
        return f"{modes}, and one linear model serves at every amplitude: these recordings show no change with it."
    if result.final == LINEAR:
        return f"{modes} that move with amplitude; slow springs at the ports do not describe how."
    return (
        f"{modes} that move with amplitude; springs at the ports that soften with the mean square of their "
        f"motion describe it. This proves no cause."
    )
