"""Training: of a system in Python, or from settings to a folder with the trained model, its logs and its scores."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from omegaconf import OmegaConf
from torch import nn

from phnn.errors import InputRefused
from phnn.identification.evaluate import Evaluation
from phnn.identification.prepare import single
from phnn.integrate.method import PortHamiltonianSystem
from phnn.integrate.scheme import can_compile
from phnn.learn.objective import Objective, evaluate, substeps_needed, whole
from phnn.learn.settings import Settings, check_same, settings_in
from phnn.learn.solvers import NetworkPlant, Plant, solver_for, thinned
from phnn.learn.starts import near_known_part, plant_for, typical_states
from phnn.learn.trainer import FILE as CHECKPOINT
from phnn.learn.trainer import LOG, METHODS, Trainer, as_bytes, method_of, with_gradients
from phnn.models.store import is_storable, save, stored
from phnn.network.elements import Network
from phnn.recordings import Campaign, read
from phnn.recordings.partition import candidate_of, choose
from phnn.recordings.recording import digest
from phnn.results import Origin, Place, claim, finished, finite
from phnn.setup import Setup

if TYPE_CHECKING:
    from phnn.model import Model

CONFIG, METRICS = "config.yaml", "metrics.json"
# What a training writes into its folder.
RESULTS = (CONFIG, CHECKPOINT, LOG, "tensorboard", "weights.pt", "model", METRICS)
# Fewer recordings than this are all needed for training.
_LEAST = 3
# Epochs of each method where none are stated.
_EPOCHS = {"gauss_newton": 60, "lbfgs": 50, "adam": 500}


@dataclass(frozen=True)
class Trained:
    """A trained model.

        trained = phnn.train(system, "recordings/")
        y = trained.model.simulate(t, voltage)

    Attributes:
        plant: the model with the coordinates in which it was trained.
        scores: of all recordings, each run from its own start to its end.
        history: a row an epoch: method, loss, validation, seconds.
        facts: what ``metrics.json`` holds.
    """

    plant: Plant
    scores: Evaluation
    history: Sequence[Mapping[str, Any]]
    facts: Mapping[str, Any]

    @property
    def loss(self) -> float:
        """Return the mean square of the residual over noise on training recordings, jumps between windows added."""
        return float(self.facts["loss"])

    @property
    def aside(self) -> tuple[str, ...]:
        """Return the names of the recordings that stopped the training."""
        return tuple(name for name, row in self.facts["recordings"].items() if row["validation"])

    @property
    def system(self) -> nn.Module:
        """Return the trained module."""
        return self.plant.core

    @property
    def model(self) -> Model:
        """Return the model with the trained network, for `Model.simulate`, ``phnn.predict`` and files.

        Raises:
            InputRefused: it is no network.
        """
        from phnn.model import Model

        if not isinstance(self.plant, NetworkPlant):
            raise InputRefused("only a network is a Model: use .system")
        return Model(Setup(self.plant.system.as_network(), name="trained"), int(self.facts["substeps"]))

    @property
    def over_noise(self) -> float:
        """Return the residual over noise of the recordings for confirmation, NaN where there are none."""
        return self.scores.over_noise("confirmation")


def train(
    system: PortHamiltonianSystem | Network,
    recordings: Campaign | str | Path,
    method: str | None = None,
    *,
    epochs: int | None = None,
    adjoint: str = "discrete",
    out: str | Path | None = None,
    say: Callable[[str], None] = lambda line: None,
    **settings: Any,
) -> Trained:
    """Train a system on recordings, in place, and score it on all of them.

        system = phnn.PortHamiltonianSystem(network)
        trained = phnn.train(system, "recordings/", method="lbfgs", epochs=40)
        trained.over_noise                                   # 1 at the noise floor, on recordings held out

    The loss is the mean square of the residual over noise, of recordings of several frequencies together; what is
    trained are all parameters that are not fixed and all weights of learned laws. Recordings set aside stop the
    training, and the numerical error is kept below a tenth of the noise.

    Args:
        system: is trained in place; of a network a system is made first.
        recordings: read, or their folder.
        method: ``gauss_newton``, ``lbfgs`` or ``adam``; None: the first where all laws have a kernel and recordings are
            not cut into windows, else the second.
        epochs: at most; 60, 50 and 500 where left out.
        adjoint: ``discrete``: gradients of the power-preserving steps; ``torchdiffeq``: the same, called as its method.
        out: folder for a checkpoint after every epoch, a log and TensorBoard; the same call goes on from there.
        say: told a line an epoch.
        settings: others of `phnn.learn.Settings`: ``seed``, ``window``, ``substeps``, ``stride``, ``validation``,
            ``patience``, ``rate``, ``optimiser``, ``scheduler`` …

    Raises:
        InputRefused: recordings or settings that cannot be used.
        SolverFailed: the model could not be simulated however small the steps of training.
    """
    if not isinstance(system, PortHamiltonianSystem | Network):
        raise InputRefused(f"system is a {type(system).__name__}: give a Network or a PortHamiltonianSystem")
    if "seeds" in settings:
        raise InputRefused("seeds is for phnn train: build and train a system for each seed")
    campaign = recordings if isinstance(recordings, Campaign) else read(recordings)
    single(campaign.recordings, "training follows one input to one output")
    module = PortHamiltonianSystem(system) if isinstance(system, Network) else system
    compiles = can_compile(module.network) and adjoint == "discrete" and not settings.get("window")
    chosen = method or ("gauss_newton" if compiles else "lbfgs")
    if chosen not in _EPOCHS or adjoint not in _ADJOINTS:
        raise InputRefused(
            f"method = {method!r}, adjoint = {adjoint!r}: choose {', '.join(_EPOCHS)} and {', '.join(_ADJOINTS)}"
        )
    given = {"tensorboard": out is not None, "resume": out is not None, **dict.fromkeys(_EPOCHS, 0)}
    given[chosen] = _EPOCHS[chosen] if epochs is None else epochs
    place = None if out is None else str(out)
    full = Settings.from_config(
        {"folder": str(campaign.folder), "out": place or "-", "solver": _ADJOINTS[adjoint]}
        | {"model": {"kind": "own", "network": sha256(repr(module.network).encode()).hexdigest()}}
        | given
        | settings
    )
    used = [r for r in campaign.recordings if r.mask("identification").any()]
    if not used:
        raise InputRefused(f"{campaign.folder}: no recording serves identification: name some in recordings.yaml")
    plant = NetworkPlant(module, typical_states(module, used))
    if place is None:
        return fitted(plant, campaign, full, None, "", say)
    with claim(
        full.home, "train", [Path(campaign.folder)], RESULTS, Origin({"recordings": digest(campaign)}, full.resume)
    ) as home:
        return fitted(plant, campaign, full, home, digest(campaign), say)


_ADJOINTS = {"discrete": {"name": "discrete_gradient"}, "torchdiffeq": {"name": "torchdiffeq", "adjoint": True}}


def fitted(
    plant: Plant,
    campaign: Campaign,
    settings: Settings,
    place: Place | None,
    recordings: str,
    say: Callable[[str], None],
) -> Trained:
    """Train a plant and score it.

    Args:
        place: gets checkpoint and logs; None for no files.
        recordings: hash of what is trained on, by which a checkpoint is known.
    """
    aside = validation_names(campaign, settings.validation)
    # Recordings that confirm are looked at once, at the end.
    chosen = [r for r in campaign.recordings if r.mask("identification").any()]
    used = [thinned(r, settings.stride) for r in chosen if r.name not in aside]
    held = [thinned(r, settings.stride) for r in chosen if r.name in aside]
    if not used:
        raise InputRefused("validation: every recording is set aside, none is left to train on: name fewer")
    solver = solver_for(settings.solver, plant)
    if isinstance(plant, NetworkPlant) and not plant.near:
        near_known_part(plant, campaign.recordings)
    substeps = settings.substeps or substeps_needed(plant, solver, used)
    objective = Objective(plant, solver, used, settings.window, substeps, settings.continuity)
    if not objective.trained():
        raise InputRefused("nothing can be trained: every parameter is fixed and every weight frozen")

    def validate() -> float:
        return float(whole(plant, solver, held, substeps, {})())

    # What cannot be trained in this way is refused before anything is written.
    for name in (n for n in METHODS if getattr(settings, n)):
        method_of(name, objective, settings, 1.0)
    if place is not None:
        (place / CONFIG).write(OmegaConf.to_yaml(OmegaConf.create(settings.plain())).encode())
    progress = Trainer(objective, validate if held else None, settings, place, say, recordings).run()
    starts = {
        w.name: x0
        for w, x0 in zip(objective.windows, objective.initial().detach(), strict=True)
        if not w.continues and not w.known
    }
    scores = evaluate(plant, solver, campaign.recordings, substeps, starts)
    began = time.perf_counter()
    loss = float(with_gradients(objective))
    facts = {
        "schema": "phnn.training/1", "model": dict(settings.model), "solver": dict(settings.solver),
        "seed": settings.seed, "parameters_trained": sum(p.numel() for p in objective.trained()), "loss": loss,
        "best_validation": progress.best, "epochs": len(progress.rows), "evaluations": objective.solved,
        "held_out_over_noise": scores.over_noise("confirmation"),
        "recordings": {
            p.name: {**p.numbers, "held_out": p.use == "confirmation", "validation": p.name in aside}
            for p in scores.parts
        },
        "seconds": progress.seconds, "gradient_seconds": time.perf_counter() - began, "substeps": substeps,
    }  # fmt: skip
    return Trained(plant, scores, progress.rows, finite(facts))


def train_folder(settings: Settings, say: Callable[[str], None] = lambda line: None) -> dict[str, Any]:
    """Train the model of some settings on a folder of recordings, once for each seed.

    Writes into ``settings.out``: ``config.yaml``, ``checkpoint.pt``, ``log.csv``, ``tensorboard/``, ``weights.pt``,
    ``metrics.json`` and, where laws have a form on disk, ``model/`` for `phnn predict`. A run that has ended stays as
    it is. Several seeds have a folder each, and ``metrics.json`` their mean and spread.

    Returns:
        What ``metrics.json`` holds.

    Raises:
        InputRefused: recordings or settings that cannot be used.
        SolverFailed: the model could not be simulated however small the steps of training.
    """
    if settings.seeds:
        return _several(settings, say)
    torch.manual_seed(settings.seed)
    campaign = read(settings.folder, settings.manifest, allow_outside=settings.allow_outside)
    single(campaign.recordings, "training follows one input to one output")
    base = None if settings.base is None else json.dumps(stored(Path(settings.base))[0])
    made_of = {"recordings": digest(campaign), "base": None if base is None else sha256(base.encode()).hexdigest()}
    origin = Origin(made_of, settings.resume, anew="resume=false")
    inputs = [Path(p) for p in (settings.folder, settings.base) if p]
    if settings.resume and finished(settings.home, "train", origin):
        ended = _ended(settings)
        if ended is not None:
            return ended
    with claim(settings.home, "train", inputs, RESULTS, origin) as place:
        if not settings.resume:
            (place / CHECKPOINT).remove()
            (place / METRICS).remove()
        plant = plant_for(settings.model, campaign, settings.seed, settings.base)
        trained = fitted(plant, campaign, settings, place, repr(made_of), say)
        write_plant(plant, settings.named, place, place / "model", trained.facts["substeps"])
        (place / METRICS).write_json(trained.facts)
        return dict(trained.facts)


def write_plant(plant: Plant, name: str, place: Place, folder: Place, substeps: int) -> None:
    """Write the weights of a plant and, where its laws have a form on disk, its network into a folder of its own."""
    (place / "weights.pt").write(as_bytes(plant.state_dict()))
    if isinstance(plant, NetworkPlant) and is_storable(plant.network):
        save(Setup(plant.network, name=name), folder, substeps)


def _several(settings: Settings, say: Callable[[str], None]) -> dict[str, Any]:
    """Train once for each seed; mean and standard deviation of what the runs have reached."""
    runs = []
    for seed in settings.seeds or ():
        run = replace(settings, seed=seed, seeds=None, out=str(settings.home / f"seed_{seed}"))
        runs.append(train_folder(run, lambda line, seed=seed: say(f"seed {seed}: {line}")))  # type: ignore[misc]

    def over_seeds(rows: Sequence[Mapping[str, Any]], *keys: str) -> dict[str, float]:
        values = {key: np.array([row[key] for row in rows], dtype=float) for key in keys}
        spread = {f"{k}_spread": v.std(ddof=1) if len(v) > 1 else np.nan for k, v in values.items()}
        return {k: v.mean() for k, v in values.items()} | spread

    table = {
        name: over_seeds([r["recordings"][name] for r in runs], "fit_percent", "rmse", "residual_over_noise")
        | {key: row[key] for key in ("held_out", "validation")}
        for name, row in runs[0]["recordings"].items()
    }
    content: dict[str, Any] = finite({
        "schema": "phnn.training/1", "model": runs[0]["model"], "seeds": [r["seed"] for r in runs], "recordings": table,
        **over_seeds(runs, "held_out_over_noise"), "seconds": sum(r["seconds"] for r in runs),
    })  # fmt: skip
    (Place(settings.home.resolve()) / METRICS).write_json(content)
    return content


def _ended(settings: Settings) -> dict[str, Any] | None:
    """Return what an earlier run on the same recordings has written at its end; None where there is none to keep."""
    config, metrics = settings.home / CONFIG, settings.home / METRICS
    if not (config.exists() and metrics.exists()):
        return None
    check_same(settings_in(config), settings.plain(), config)
    try:
        content: dict[str, Any] = json.loads(metrics.read_text(encoding="utf-8"))
        content["recordings"].items(), content["seed"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputRefused(f"{metrics}: cannot be read ({error}): delete it to score the run again") from error
    return content


def validation_names(campaign: Campaign, given: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the recordings that stop the training: as given; if None, some within the others' span.

    Raises:
        InputRefused: a name that no recording for identification has.
    """
    chosen = [r for r in campaign.recordings if r.mask("identification").any()]
    for name in given or ():
        if name not in [r.name for r in chosen]:
            raise InputRefused(f"validation: no recording {name} for identification among {[r.name for r in chosen]}")
    if given is not None or len(chosen) < _LEAST:
        return tuple(given or ())
    return tuple(sorted(choose([candidate_of(r, r.excitation) for r in chosen])))
