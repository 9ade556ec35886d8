"""One training run: from settings to a folder with the trained model, its logs and its scores."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf
from torch import Tensor

from phnn.errors import InputRefused
from phnn.identification.evaluate import Evaluation
from phnn.identification.prepare import single
from phnn.learn import checkpoint, logs
from phnn.learn.methods import with_gradients
from phnn.learn.objective import Objective
from phnn.learn.plant import NetworkPlant, Plant
from phnn.learn.score import evaluate, set_aside, substeps_needed, whole
from phnn.learn.settings import Settings, check_same, settings_in
from phnn.learn.solvers import solver_for
from phnn.learn.starts import plant_for
from phnn.learn.trainer import Progress, Trainer
from phnn.learn.windows import thinned
from phnn.models.store import FILE, save
from phnn.recordings import Campaign, read
from phnn.recordings.excitation import excitation_of
from phnn.recordings.partition import candidate_of, choose
from phnn.recordings.stored import digest
from phnn.results import Origin, Place, claim, finished, sha256_of
from phnn.setup import Setup

# States reach this many times beyond the typical ones.
_BEYOND = 10.0
# What is lost to rounding, relative to the sum of the absolute powers.
_ROUNDING = 1e-12


def violations(plant: Plant, voltage: float, states: int = 10_000, seed: int = 0) -> int | None:
    """How many random states and inputs have ``dH/dt > yᵀu`` by more than rounding; None for a model without energy.

    Args:
        plant: of any kind.
        voltage: typical input [V].
        states: how many are drawn, over three decades of size up to ten times the typical one.
        seed: of the draw.
    """
    random = torch.Generator().manual_seed(seed)
    direction = torch.randn(states, plant.scale.numel(), generator=random, dtype=torch.float64)
    size = _BEYOND * 10.0 ** (-3.0 * torch.rand(states, 1, generator=random, dtype=torch.float64))
    x = direction * size * plant.scale
    u = voltage * torch.randn(states, generator=random, dtype=torch.float64)
    with torch.no_grad():
        gained, supplied, scale = _powers(plant, x, u)
    if scale is None:
        return None
    # Also what is not a number: such a model is not passive.
    return int((~(gained - supplied <= _ROUNDING * scale)).sum())


def _powers(plant: Plant, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
    """(K,) rate of storage, supply, and the sum of the absolute terms."""
    if not isinstance(plant, NetworkPlant):
        return x[:, 0], x[:, 0], None
    efforts, inputs = plant.system.efforts(x), plant.inputs(u)
    supplied = (plant.system.port_outputs(x, inputs) * inputs).sum(-1)
    terms = efforts * plant.system.rate(efforts, x, inputs)
    return terms.sum(-1), supplied, terms.abs().sum(-1) + supplied.abs()


CONFIG, METRICS = "config.yaml", "metrics.json"
# What a training writes into its folder.
RESULTS = (CONFIG, checkpoint.FILE, logs.FILE, "tensorboard", "weights.pt", "model", METRICS)
_STATES = 10_000
# Fewer recordings than this are all needed for training.
_LEAST = 3


def train(settings: Settings, say: Callable[[str], None] = lambda line: None) -> dict[str, Any]:
    """Train a model on a folder of recordings.

    Writes into ``settings.out``: ``config.yaml``, ``checkpoint.pt``, ``log.csv``, ``tensorboard/``, ``weights.pt``,
    ``metrics.json`` and, for networks, ``model/`` for `phnn predict`. A run that has ended stays as it is.

    Returns:
        What ``metrics.json`` holds.

    Raises:
        InputRefused: recordings or settings that cannot be used.
        SolverFailed: the model could not be simulated however small the steps of training.
    """
    torch.manual_seed(settings.seed)
    campaign = read(settings.folder, settings.manifest, allow_outside=settings.allow_outside)
    single(campaign.recordings, "training follows one input to one output")
    made_of = {"recordings": digest(campaign), "base": _hash(settings.base)}
    origin = Origin(made_of, settings.resume, anew="resume=false")
    inputs = [Path(p) for p in (settings.folder, settings.base) if p]
    if settings.resume and finished(settings.home, "train", origin):
        ended = _ended(settings)
        if ended is not None:
            return ended
    with claim(settings.home, "train", inputs, RESULTS, origin) as place:
        if not settings.resume:
            (place / checkpoint.FILE).remove()
            (place / METRICS).remove()
        return _train(settings, campaign, place, repr(made_of), say)


def _train(
    settings: Settings, campaign: Campaign, place: Place, recordings: str, say: Callable[[str], None]
) -> dict[str, Any]:
    """Train in a folder that is claimed."""
    (place / CONFIG).write(OmegaConf.to_yaml(OmegaConf.create(settings.plain())).encode())
    training, validation = set_aside(campaign.recordings, validation_names(campaign, settings.validation))
    if not training:
        raise InputRefused("validation: every recording is set aside, none is left to train on: name fewer")
    plant = plant_for(settings.model, campaign, settings.seed, settings.base)
    solver = solver_for(settings.solver, plant)
    used = [thinned(r, settings.stride) for r in training]
    substeps = settings.substeps or substeps_needed(plant, solver, used)
    objective = Objective(plant, solver, used, settings.window, substeps, settings.continuity)
    held = [thinned(r, settings.stride) for r in validation]

    def validate() -> float:
        return float(whole(plant, solver, held, substeps)())

    progress = Trainer(objective, validate if held else None, settings, place, say, recordings).run()
    scores = evaluate(plant, solver, campaign.recordings, substeps, _initial(objective))
    content = _metrics(settings, plant, objective, progress, scores, [r.name for r in validation])
    (place / "weights.pt").write(checkpoint.as_bytes(plant.state_dict()))
    if isinstance(plant, NetworkPlant):
        save(Setup(plant.network, name=str(settings.model["kind"])), place / "model", substeps)
    (place / METRICS).write_json(content)
    return content


def _hash(base: str | None) -> str | None:
    """Of the model that training starts from."""
    if base is None:
        return None
    path = Path(base) / FILE if Path(base).is_dir() else Path(base)
    return sha256_of(path) if path.is_file() else None


def _ended(settings: Settings) -> dict[str, Any] | None:
    """What an earlier run on the same recordings has written at its end; None where there is none to keep.

    Raises:
        InputRefused: that run had other settings, or its file is damaged.
    """
    config, metrics = settings.home / CONFIG, settings.home / METRICS
    if not (config.exists() and metrics.exists()):
        return None
    check_same(settings_in(config), settings.plain(), config)
    try:
        content: dict[str, Any] = json.loads(metrics.read_text(encoding="utf-8"))
        content["recordings"].items()
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputRefused(f"{metrics}: cannot be read ({error}): delete it to score the run again") from error
    return content


def validation_names(campaign: Campaign, given: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the recordings that stop the training: as given, or where None some within the span of the others.

    Raises:
        InputRefused: a name that no recording for identification has.
    """
    chosen = [r for r in campaign.recordings if r.mask("identification").any()]
    for name in given or ():
        if name not in [r.name for r in chosen]:
            raise InputRefused(f"validation: no recording {name} for identification among {[r.name for r in chosen]}")
    if given is not None or len(chosen) < _LEAST:
        return tuple(given or ())
    return tuple(sorted(choose([candidate_of(r, excitation_of(r.u, r.dt)) for r in chosen])))


def _initial(objective: Objective) -> dict[str, torch.Tensor]:
    """Estimated initial states of the recordings trained on."""
    x0 = objective.initial().detach()
    return {
        objective.recordings[w.recording].name: x0[k]
        for k, w in enumerate(objective.windows)
        if not w.continues and not w.known
    }


def _metrics(
    settings: Settings, plant: Plant, objective: Objective, progress: Progress, scores: Evaluation, aside: list[str]
) -> dict[str, Any]:
    began = time.perf_counter()
    loss = with_gradients(objective)
    seconds = time.perf_counter() - began
    voltage = max(float(np.abs(r.u).max()) for r in objective.recordings)
    table = {
        p.name: {
            "fit_percent": p.fit_percent,
            "rmse": p.rmse,
            "residual_over_noise": p.residual_over_noise,
            "held_out": p.use == "confirmation",
            "validation": p.name in aside,
        }
        for p in scores.parts
    }
    return {
        "schema": "phnn.training/1",
        "model": dict(settings.model),
        "solver": dict(settings.solver),
        "seed": settings.seed,
        "parameters_trained": sum(p.numel() for p in objective.trained()),
        "loss": float(loss),
        "best_validation": progress.best if np.isfinite(progress.best) else None,
        "epochs": len(progress.rows),
        "held_out_over_noise": _finite(scores.over_noise("confirmation")),
        "recordings": table,
        "passivity": {"states": _STATES, "violations": violations(plant, voltage, _STATES, settings.seed)},
        "seconds": progress.seconds,
        "gradient_seconds": seconds,
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
