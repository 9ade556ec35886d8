"""The models of a comparison: each fitted to the identification recordings and scored on all."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from phnn.comparison.result import Result, keep, kept
from phnn.comparison.settings import NETWORKS, Settings
from phnn.comparison.supply import Response, Supply, of_plant, of_setup, supply
from phnn.comparison.trained import Trained, Training, train
from phnn.diagnosis.tested import score_on_all
from phnn.identification.base import Progress, identify_base, identify_bouc_wen
from phnn.identification.evaluate import Evaluation, score_part
from phnn.identification.fit import Fit
from phnn.identification.identified import save_fit
from phnn.identification.plan import Plan
from phnn.identification.prepare import identification_plan
from phnn.identification.staged import identify_actuator
from phnn.learn.passivity import violations
from phnn.learn.plant import LatentPlant, NetworkPlant, Plant
from phnn.learn.starts import typical_states
from phnn.models.store import save
from phnn.recordings.digest import digest
from phnn.recordings.recording import Campaign
from phnn.results import Place
from phnn.setup import Setup
from studies.rival_models.names import NAMES as RIVALS
from studies.rival_models.names import rival

STATES = 10_000
# Parameters that a linear model has as well.
_MECHANICAL = ("m", "k", "b", "alpha")
KINDS = {
    "phs": "port-Hamiltonian network, hysterons with dead zones",
    "phs_neural": "port-Hamiltonian network, hysterons with learned resistors, started from phs",
    "phs_adjoint": "port-Hamiltonian network, hysterons with dead zones",
    "phs_neural_adjoint": "port-Hamiltonian network, hysterons with learned resistors",
    "neural_phs": "port-Hamiltonian system whose structure, dissipation and energy are learned",
    "bouc_wen": "Bouc–Wen block in front of a mass, spring and damper",
    "linear": "mass, spring and damper",
    "neural_ode": "black-box neural ordinary differential equation",
}
_LEAST_SQUARES = "least squares with exact forward sensitivities of the compiled power-preserving step"
_ADJOINT = "L-BFGS, torchdiffeq's odeint_adjoint with the compiled power-preserving step as its method"
GRADIENTS = {
    "phs": _LEAST_SQUARES,
    "bouc_wen": _LEAST_SQUARES,
    "linear": _LEAST_SQUARES,
    "phs_neural": "damped Gauss–Newton with exact forward sensitivities of the compiled power-preserving step",
    "phs_adjoint": _ADJOINT,
    "phs_neural_adjoint": _ADJOINT,
    "neural_phs": "implicit function theorem through the power-preserving step, one backward sweep",
    "neural_ode": "through the steps of the explicit method (torchdiffeq)",
}
_NO_ENERGY = "it has no energy to compare with the supply"
_HEAD = "the hysteresis is a block before the network and has no energy"


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

    def home(self, model: str) -> Place:
        """The folder of a model."""
        return self.place / model

    def result(self, model: str) -> Result:
        """A model's result: the one that lies in its folder, or that of fitting it now.

        Raises:
            InputRefused: the one that lies there was made otherwise.
        """
        if model in self.done:
            return self.done[model]
        made_with, recordings = self.settings.of(model), digest(self.campaign)
        found = kept(model, self.home(model).path, made_with, recordings) if self.settings.resume else None
        if found is None:
            found = _fitter(model)(self)
            keep(found, self.home(model), made_with, recordings)
        self.done[model] = found
        return found

    def plan(self) -> Plan:
        """The identification recordings with the sub-steps that the base model was found to need."""
        substeps = self.result("phs").substeps
        return replace(identification_plan(self.campaign, self.settings.options.workers), substeps=dict(substeps))


@dataclass(frozen=True)
class _Clock:
    """Seconds since it was made, as they pass and of the processor."""

    elapsed: float = field(default_factory=time.monotonic)
    processor: float = field(default_factory=time.process_time)

    @property
    def facts(self) -> dict[str, float]:
        """Both, as facts of a result."""
        return {
            "seconds": round(time.monotonic() - self.elapsed, 1),
            "processor_seconds": round(time.process_time() - self.processor, 2),
        }


def _phs(bench: Bench) -> Result:
    clock = _Clock()
    actuator = {"model": "piezo_actuator", "hysterons": bench.campaign.setup.get("hysterons", 2)}
    fitted, _ = identify_base(replace(bench.campaign, setup=actuator), bench.settings.options, bench.progress)
    return _identified(bench, "phs", fitted, clock.facts)


def _bouc_wen(bench: Bench) -> Result:
    plan, clock = bench.plan(), _Clock()
    fitted = identify_bouc_wen(plan, bench.campaign, bench.settings.options, bench.progress)
    return _identified(bench, "bouc_wen", fitted, clock.facts)


def _linear(bench: Bench) -> Result:
    plan, clock = bench.plan(), _Clock()
    bench.progress("identify linear")
    known = {n: a for n, a in bench.campaign.known.items() if n in _MECHANICAL}
    fitted = identify_actuator(plan, known, 0, 1, bench.settings.options.seed)
    return _identified(bench, "linear", fitted, clock.facts)


_FITTED: Mapping[str, Callable[[Bench], Result]] = {"phs": _phs, "bouc_wen": _bouc_wen, "linear": _linear}


def _fitter(model: str) -> Callable[[Bench], Result]:
    """How a model is fitted."""
    if model in RIVALS:
        return lambda bench: _rival(bench, model)
    return _FITTED.get(model, lambda bench: _trained(bench, model))


def _rival(bench: Bench, model: str) -> Result:
    """Fit a rival within its budget, score and judge it."""
    clock, chosen, settings = _Clock(), rival(model), bench.settings
    bench.progress(f"fit {model}, {settings.budget:g} s of the processor")
    fitted = chosen.fit(bench.campaign.recordings, settings.budget, settings.options.seed)
    times = clock.facts
    outputs = fitted.outputs(bench.campaign.recordings)
    parts = [
        score_part(r, y, p.first, p.last, p.name, p.use)
        for r, y in zip(bench.campaign.recordings, outputs, strict=True)
        for p in r.parts
        if p.use != "nuisance"
    ]
    found = Evaluation({r.name: y for r, y in zip(bench.campaign.recordings, outputs, strict=True)}, tuple(parts))
    facts = {
        "kind": f"{chosen.words} ({chosen.source})",
        "parameters": fitted.parameters,
        **times,
        "gradient": chosen.how,
        "seed": settings.options.seed,
        "budget": settings.budget,
        **fitted.facts,
        "passivity": _passivity(bench, model, fitted.outputs, None, _NO_ENERGY),
    }
    return Result(model, found, facts, {})


def _identified(bench: Bench, model: str, fitted: Fit, times: Mapping[str, float]) -> Result:
    """Score and judge a parametric model."""
    scores = score_on_all(fitted, bench.campaign)
    save_fit(fitted, bench.home(model))
    plant = None
    if not fitted.setup.amplifier:
        network = fitted.setup.network
        plant = NetworkPlant(network, typical_states(network, fitted.plan.recordings))
    facts = _facts(bench, model, len(fitted.variables.names)) | {
        **times,
        "passivity": _passivity(bench, model, of_setup(fitted.setup), plant, _HEAD),
    }
    return Result(model, scores, facts, dict(fitted.plan.substeps))


def _trained(bench: Bench, model: str) -> Result:
    """Train, score and judge a neural model."""
    recipe, options = bench.settings.recipes[model], bench.settings.options
    substeps, base = 1, None
    if model in NETWORKS:
        plan = bench.plan()
        base = bench.home("phs").path if model == "phs_neural" else None
        substeps = plan.finest
        hysterons = int(bench.campaign.setup.get("hysterons", 2))
        recipe = replace(recipe, model={**recipe.model, "hysterons": hysterons})
    training = Training(model, recipe, bench.campaign, bench.home(model), options.seed, bench.settings.resume)
    found = train(training, substeps, base, bench.progress)
    if isinstance(found.plant, NetworkPlant):
        save(Setup(found.plant.network, name=model), bench.home(model), substeps)
    facts = _facts(bench, model, found.parameters) | {
        "seconds": round(found.seconds, 1),
        "loss_by_stage": found.losses,
        "stopped_by": list(found.validation),
        "passivity": _passivity(bench, model, _response(found), found.plant, _NO_ENERGY),
    }
    return Result(model, found.evaluation, facts, {})


def _response(found: Trained) -> Response:
    """How a trained model answers to inputs of any sampling."""
    if isinstance(found.plant, LatentPlant):
        return of_plant(found.plant, found.solver)
    assert isinstance(found.plant, NetworkPlant)
    return of_setup(Setup(found.plant.network))


def _facts(bench: Bench, model: str, parameters: int) -> dict[str, Any]:
    return {
        "kind": KINDS[model],
        "parameters": parameters,
        "gradient": GRADIENTS[model],
        "seed": bench.settings.options.seed,
    }


def _passivity(bench: Bench, model: str, response: Response, plant: Plant | None, why: str) -> dict[str, Any]:
    """Both checks: the power balance at random states where a model has an energy, the supply under random inputs."""
    bench.progress(f"check the passivity of {model}")
    recordings = [r for r in bench.campaign.recordings if r.mask("identification").any()]
    seed, voltage = bench.settings.options.seed, max(float(np.abs(r.u).max()) for r in recordings)
    counted = None if plant is None else violations(plant, voltage, STATES, seed)
    balance: dict[str, Any] = {"states": STATES, "violations": counted}
    found: Supply = supply(response, recordings, bench.settings.inputs, seed)
    return {"power_balance": balance if counted is not None else balance | {"reason": why}, "supply": asdict(found)}
