"""The neural models of a comparison: each is trained in stages to its end, the black boxes from a linear start.

From weights at random some thousand steps go by before a latent model has found that displacement follows voltage. So
it starts as linear relaxations with the static gain of the recordings, none of whose values are fitted yet:

    neural ODE            T ẋ_i = λ_i (c_i u/U − x_i),  y = Y Σ x_i       one fast lag, slow ones over the recorded band
    fully neural PHS      mass, spring, damper and linear hysterons, scaled so that H = ½|x|² and y = Y x_1

References: Paduart et al. 2010; Schoukens & Ljung 2019 (best linear approximation as a start).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from phnn.errors import InputRefused
from phnn.identification.base import Progress
from phnn.identification.evaluate import Evaluation
from phnn.learn import Settings, checkpoint
from phnn.learn.plant import Plant
from phnn.learn.run import fitted, validation_names
from phnn.learn.score import evaluate
from phnn.learn.solvers import solver_for
from phnn.learn.starts import plant_for, scales_of
from phnn.learn.windows import thinned
from phnn.recordings.recording import Campaign, Recording
from phnn.recordings.stored import digest
from phnn.results import Place


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
class Training:
    """What one model is trained with.

    Attributes:
        name: of the model, for messages.
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


def train(
    training: Training, substeps: int, base: Path | None, progress: Progress
) -> tuple[Plant, Evaluation, dict[str, Any]]:
    """Train one model, stage by stage; a stage that was finished before is read back from its checkpoint.

    Args:
        training: what the model is trained with.
        substeps: steps a sample interval when it is scored; training takes those of its stages.
        base: identified model to start from.
        progress: told one line an epoch.

    Returns:
        The model; its scores on all recordings, at the samples they were recorded with; and facts: numbers that were
        trained, seconds, simulations of the loss, the validation of each stage, and the recordings that stopped it.

    Raises:
        InputRefused: settings that cannot be used, or other than those of the training that lies there.
        SolverFailed: the model could not be simulated however small the steps of training.
    """
    recipe, campaign = training.recipe, training.campaign
    torch.manual_seed(training.seed)
    aside = validation_names(campaign, None)
    plant = plant_for(recipe.model, campaign, training.seed, None if base is None else str(base))
    used = [r for r in campaign.recordings if r.mask("identification").any()]
    thin = replace(campaign, recordings=tuple(_thinned(used, recipe, scales_of(used).time)))
    seconds, losses, solved = 0.0, {}, 0
    for stage in recipe.stages:

        def told(line: str, what: str = f"train {training.name}, {stage}") -> None:
            progress(f"{what}: {line}")

        settings = replace(_settings(training, stage), validation=aside)
        done = fitted(plant, thin, settings, training.place / stage, digest(campaign), told).facts
        seconds, solved = seconds + done["seconds"], solved + done["evaluations"]
        losses[stage] = done["best_validation"]
    progress(f"score {training.name}")
    scores = evaluate(plant, solver_for(recipe.solver, plant), campaign.recordings, substeps, {})
    count = sum(p.numel() for p in plant.trained())
    (training.place / "weights.pt").write(checkpoint.as_bytes(plant.state_dict()))
    facts = {"parameters": count, "seconds": round(seconds, 1), "evaluations": solved, "loss_by_stage": losses}
    return plant, scores, {**facts, "stopped_by": list(aside)}


def _settings(training: Training, stage: str) -> Settings:
    """Return the settings of one stage.

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


def _thinned(recordings: Sequence[Recording], recipe: Recipe, unit: float) -> list[Recording]:
    """Return recordings at the samples that training uses, each weighing as much as with all of its samples.

    A slow recording needs steps as short as a fast one's dynamics, not as many samples a period.
    """
    if recipe.longest_step is None or not recordings:
        return list(recordings)
    longest = recipe.longest_step * unit
    found = [thinned(r, _stride(r, longest, recipe.least_per_period)) for r in recordings]
    shares = np.array([f.t.size / r.t.size for f, r in zip(found, recordings, strict=True)])
    mean = sum(f.t.size for f in found) / sum(r.t.size for r in recordings)
    # The loss is a mean over samples of the residual over noise: a larger noise takes the weight of surplus samples.
    return [replace(f, noise=f.noise * float(np.sqrt(s / mean))) for f, s in zip(found, shares, strict=True)]


def _stride(recording: Recording, longest: float, least: int) -> int:
    """Return every how many samples: steps no longer than the longest, and no fewer of them a period than the least."""
    most = longest / recording.dt
    if recording.period is not None:
        most = min(most, recording.period / recording.dt / least)
    return max(1, min(int(most), recording.t.size // 64))
