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
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from phnn.errors import InputRefused
from phnn.identification.base import Progress
from phnn.identification.evaluate import Evaluation
from phnn.learn import Settings, checkpoint
from phnn.learn.objective import Objective
from phnn.learn.plant import LatentPlant, Plant
from phnn.learn.run import validation_names
from phnn.learn.score import evaluate, set_aside, substeps_needed, whole
from phnn.learn.solvers import Solver, solver_for
from phnn.learn.starts import plant_for, unfitted
from phnn.learn.trainer import Trainer
from phnn.learn.windows import thinned
from phnn.models.fully_neural import FullyNeural
from phnn.models.neural_ode import NeuralODE
from phnn.recordings.recording import Campaign, Recording, dominant_frequency
from phnn.recordings.stored import digest
from phnn.results import Place

_LINEAR = "linear"
# Of a neural ODE: rate of the fast lag over that of the highest frequency, and what each slow lag adds to the gain.
_FAST, _SLOW = 1.5, 0.1
# Points at which its perceptron is fitted, in typical sizes, and the ridge that keeps its weights small.
_POINTS, _REACH, _RIDGE = 4000, 1.5, 1e-6
# Layers that are less curved than usual carry a linear field within some percent.
_GENTLE = 0.5
# Size of what is left of random last layers: none at all would give the layers before them no gradient.
_LEFT = 0.05


@dataclass(frozen=True)
class Recipe:
    """How a neural model is trained.

    Attributes:
        model: its kind and arguments, see `phnn.learn.starts`; ``start: linear`` for the black boxes.
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
        trained, seconds, the mean square of the residual over noise on the recordings that stopped each stage, and the
        names of those.

    Raises:
        InputRefused: settings that cannot be used, or other than those of the training that lies there.
        SolverFailed: the model could not be simulated however small the steps of training.
    """
    recipe, campaign, place = training.recipe, training.campaign, training.place
    torch.manual_seed(training.seed)
    aside = validation_names(campaign, None)
    plant = started_plant(recipe, campaign, training.seed, base)
    solver = solver_for(recipe.solver, plant)
    used, held = (_thinned(rs, recipe, plant) for rs in set_aside(campaign.recordings, aside))
    seconds, losses = 0.0, {}
    for stage in recipe.stages:
        settings = _settings(training, stage)
        steps = settings.substeps or substeps_needed(plant, solver, used)
        objective = Objective(plant, solver, used, settings.window, steps, settings.continuity)
        told = partial(_told, progress, f"train {training.name}, {stage}")
        validate = partial(_loss, plant, solver, held, steps) if held else None
        found = Trainer(objective, validate, settings, place / stage, told, digest(campaign)).run()
        seconds, losses[stage] = seconds + found.seconds, found.best
    progress(f"score {training.name}")
    scores = evaluate(plant, solver, campaign.recordings, substeps, {})
    count = sum(p.numel() for p in plant.trained())
    (place / "weights.pt").write(checkpoint.as_bytes(plant.state_dict()))
    facts = {"parameters": count, "seconds": round(seconds, 1), "loss_by_stage": losses, "stopped_by": list(aside)}
    return plant, scores, facts


def started_plant(recipe: Recipe, campaign: Campaign, seed: int, base: Path | None = None) -> Plant:
    """Return the plant before training."""
    arguments = dict(recipe.model)
    linear = arguments.pop("start", None) if arguments.get("kind") in ("fully_neural", "neural_ode") else None
    if linear not in (None, "random", _LINEAR):
        raise InputRefused(f"model.start = {linear!r}: choose {_LINEAR} or random")
    plant = plant_for(arguments, campaign, seed, None if base is None else str(base))
    if linear == _LINEAR and isinstance(plant, LatentPlant):
        assert isinstance(plant.core, FullyNeural | NeuralODE)
        begin_linear(plant.core, campaign, seed)
    return plant


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


def _loss(plant: Plant, solver: Solver, held: Sequence[Recording], substeps: int) -> float:
    return float(whole(plant, solver, held, substeps)())


def _told(progress: Progress, what: str, line: str) -> None:
    progress(f"{what}: {line}")


def _thinned(recordings: Sequence[Recording], recipe: Recipe, plant: Plant) -> list[Recording]:
    """Return recordings at the samples that training uses, each weighing as much as with all of its samples.

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
    """Return every how many samples: steps no longer than the longest, and no fewer of them a period than the least."""
    most = longest / recording.dt
    if recording.period is not None:
        most = min(most, recording.period / recording.dt / least)
    return max(1, min(int(most), recording.t.size // 64))


@torch.no_grad()
def begin_linear(core: FullyNeural | NeuralODE, campaign: Campaign, seed: int) -> None:
    """Set the weights of a latent model such that it begins as linear relaxations.

    Args:
        core: changed in place.
        campaign: gives gain and band, from the recordings for identification.
        seed: of the points at which a perceptron is fitted.
    """
    if isinstance(core, NeuralODE):
        recordings = [r for r in campaign.recordings if r.mask("identification").any()]
        _lags(core, recordings, torch.Generator().manual_seed(seed))
    else:
        _hysterons(core, campaign)


def _lags(core: NeuralODE, recordings: Sequence[Recording], random: torch.Generator) -> None:
    """Fit the field ``−λ_i x_i + λ_i c_i u`` by least squares in the last layer."""
    n = core.states
    slow = [2.0 * np.pi * dominant_frequency(r) * core.scales.time for r in recordings]
    spread = torch.logspace(np.log10(min(slow)), np.log10(max(slow)), n - 1, dtype=torch.float64)
    rates = torch.cat([torch.tensor([_FAST]).double(), spread])
    gains = torch.full((n,), _SLOW, dtype=torch.float64)
    gains[0] = 1.0 - _SLOW * (n - 1)
    points = _REACH * (2.0 * torch.rand(_POINTS, n + 1, generator=random, dtype=torch.float64) - 1.0)
    wanted = rates * (gains * points[:, -1:] - points[:, :-1])
    hidden = points
    for weight, bias in zip(core.field.weights[:-1], core.field.biases[:-1], strict=True):
        weight.mul_(_GENTLE)
        hidden = torch.tanh(hidden @ weight.mT + bias)
    columns = torch.cat([hidden, torch.ones(_POINTS, 1, dtype=torch.float64)], dim=1)
    normal = columns.mT @ columns + _RIDGE * _POINTS * torch.eye(columns.shape[1], dtype=torch.float64)
    found = torch.linalg.solve(normal, columns.mT @ wanted)
    core.field.weights[-1].copy_(found[:-1].mT)
    core.field.biases[-1].copy_(found[-1])
    core.readout.fill_(1.0)


def _hysterons(core: FullyNeural, campaign: Campaign) -> None:
    """Set displacement, momentum and the charges of linear hysterons, in units of the root of their energy."""
    count = core.states - 2
    values = unfitted(campaign, count)
    m, k, b, alpha = (values[name] for name in ("m", "k", "b", "alpha"))
    capacities = [values[f"C_{i + 1}"] for i in range(count)]
    unit = k * core.scales.output**2
    roots = torch.tensor([k, 1.0 / m, *(1.0 / c for c in capacities)], dtype=torch.float64).div(unit).sqrt()
    structure = torch.zeros(core.states, core.states, dtype=torch.float64)
    structure[1, 0], structure[2:, 1] = -1.0, alpha
    loss = torch.tensor([0.0, b, *(values[f"rho_{i + 1}"] for i in range(count))], dtype=torch.float64)
    factor = core.scales.time * unit
    _constant(
        core.skew, (factor * roots[:, None] * structure * roots)[*torch.tril_indices(core.states, core.states, -1)]
    )
    lower = torch.diag((factor * roots**2 * loss).sqrt())
    _constant(core.lower, lower[*torch.tril_indices(core.states, core.states)])
    core.inlet.zero_()
    core.inlet[1] = core.scales.time * core.scales.input * roots[1] * alpha


def _constant(perceptron: torch.nn.Module, values: torch.Tensor) -> None:
    """Make a perceptron give nearly the same everywhere."""
    perceptron.weights[-1].mul_(_LEFT)  # type: ignore[index]
    perceptron.biases[-1].copy_(values)  # type: ignore[index]
