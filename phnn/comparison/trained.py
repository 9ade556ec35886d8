"""The neural models of a comparison, each trained in stages to its end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from phnn.comparison.linear_start import begin_linear
from phnn.comparison.settings import Recipe
from phnn.errors import InputRefused
from phnn.identification.base import Progress
from phnn.identification.evaluate import Evaluation
from phnn.learn import Settings, checkpoint
from phnn.learn.objective import Objective
from phnn.learn.plant import LatentPlant, Plant
from phnn.learn.run import validation_names
from phnn.learn.score import evaluate, set_aside, whole
from phnn.learn.solvers import Solver, solver_for
from phnn.learn.starts import plant_for
from phnn.learn.trainer import Trainer
from phnn.learn.windows import thinned
from phnn.models.fully_neural import FullyNeural
from phnn.models.neural_ode import NeuralODE
from phnn.recordings.digest import digest
from phnn.recordings.recording import Campaign, Recording
from phnn.results import Place

START = "linear"


@dataclass(frozen=True)
class Trained:
    """A neural model after its training.

    Attributes:
        plant, solver: the model and what it was trained with.
        evaluation: on all recordings, at the samples they were recorded with.
        parameters: numbers that were trained, of the model alone.
        seconds: of training.
        losses: mean square of the residual over noise on the recordings that stopped the training, by stage.
        validation: names of those recordings.
    """

    plant: Plant
    solver: Solver
    evaluation: Evaluation
    parameters: int
    seconds: float
    losses: dict[str, float]
    validation: tuple[str, ...]


@dataclass(frozen=True)
class Training:
    """What one model is trained with.

    Attributes:
        name: of the model, for what is said.
        recipe: how.
        campaign: recordings; those for confirmation are looked at once, at the end.
        place: gets one folder a stage.
        seed: of initial weights.
        resume: go on from what lies in the folder.
    """

    name: str
    recipe: Recipe
    campaign: Campaign
    place: Place
    seed: int
    resume: bool


def train(training: Training, substeps: int, base: Path | None, progress: Progress) -> Trained:
    """Train one model, stage by stage; a stage that was finished before is read back from its checkpoint.

    Args:
        training: what the model is trained with.
        substeps: steps a sample interval when it is scored; training takes those of its stages.
        base: identified model to start from.
        progress: told one line an epoch.

    Raises:
        InputRefused: settings that cannot be used, or other than those of the training that lies there.
        SolverFailed: the model could not be simulated however small the steps of training.
    """
    recipe, campaign, place = training.recipe, training.campaign, training.place
    torch.manual_seed(training.seed)
    aside = validation_names(campaign, None)
    plant = _plant(recipe, campaign, training.seed, base)
    solver = solver_for(recipe.solver, plant)
    used, held = (_thinned(rs, recipe, plant) for rs in set_aside(campaign.recordings, aside))
    seconds, losses = 0.0, {}
    for stage in recipe.stages:
        settings = _settings(training, stage)
        objective = Objective(plant, solver, used, settings.window, settings.substeps, settings.continuity)
        told = _told(progress, f"train {training.name}, {stage}")
        validate = _validation(plant, solver, held, settings.substeps) if held else None
        found = Trainer(objective, validate, settings, place / stage, told, digest(campaign)).run()
        seconds, losses[stage] = seconds + found.seconds, found.best
    progress(f"score {training.name}")
    scores = evaluate(plant, solver, campaign.recordings, substeps, {})
    count = sum(p.numel() for p in plant.trained())
    (place / "weights.pt").write(checkpoint.as_bytes(plant.state_dict()))
    return Trained(plant, solver, scores, count, seconds, losses, aside)


def _plant(recipe: Recipe, campaign: Campaign, seed: int, base: Path | None) -> Plant:
    """The plant before training."""
    arguments = dict(recipe.model)
    linear = arguments.pop("start", None) if arguments.get("kind") in ("fully_neural", "neural_ode") else None
    if linear not in (None, "random", START):
        raise InputRefused(f"model.start = {linear!r}: choose {START} or random")
    plant = plant_for(arguments, campaign, seed, None if base is None else str(base))
    if linear == START and isinstance(plant, LatentPlant):
        assert isinstance(plant.core, FullyNeural | NeuralODE)
        begin_linear(plant.core, campaign, seed)
    return plant


def _settings(training: Training, stage: str) -> Settings:
    """The settings of one stage.

    Raises:
        InputRefused: a key that training does not have.
    """
    recipe, given = training.recipe, training.recipe.stages[stage]
    none = {"adam": 0, "lbfgs": 0, "gauss_newton": 0, "tensorboard": False}
    own = {
        "folder": training.campaign.folder, "out": str((training.place / stage).path), "model": dict(recipe.model),
        "solver": dict(recipe.solver), "seed": training.seed, "resume": training.resume,
    }  # fmt: skip
    for key in given:
        if key in own:
            raise InputRefused(f"{training.name}.stages.{stage}.{key}: is set for the whole model; leave it out here")
    return Settings.from_config(none | dict(given) | own)


def _validation(plant: Plant, solver: Solver, held: Sequence[Recording], substeps: int) -> Callable[[], float]:
    return lambda: float(whole(plant, solver, held, substeps)())


def _told(progress: Progress, what: str) -> Progress:
    return lambda line: progress(f"{what}: {line}")


def _thinned(recordings: Sequence[Recording], recipe: Recipe, plant: Plant) -> list[Recording]:
    """Recordings at the samples that training uses, each weighing as much as with all of its samples.

    A slow recording needs steps as short as a fast one's dynamics, not as many samples a period.
    """
    if recipe.longest_step is None or not recordings:
        return list(recordings)
    assert isinstance(plant.core, FullyNeural | NeuralODE)
    longest = recipe.longest_step * plant.core.scales.time
    found = [thinned(r, _stride(r, longest, recipe.least_per_period)) for r in recordings]
    shares = np.array([f.t.size / r.t.size for f, r in zip(found, recordings, strict=True)])
    mean = sum(f.t.size for f in found) / sum(r.t.size for r in recordings)
    # The loss is a mean over samples of the residual over noise: a larger noise takes the weight of surplus samples.
    return [replace(f, noise=f.noise * float(np.sqrt(s / mean))) for f, s in zip(found, shares, strict=True)]


def _stride(recording: Recording, longest: float, least: int) -> int:
    """Every how many samples: steps no longer than the longest, and no fewer of them a period than the least."""
    most = longest / recording.dt
    if recording.period is not None:
        most = min(most, recording.period / recording.dt / least)
    return max(1, min(int(most), recording.t.size // 64))
