"""All models on made recordings that also go beyond the identified range: fits by use, cycles and passivity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from phnn.comparison.models import BLACK_BOXES, MODELS, Result, Settings
from phnn.comparison.run import compare
from phnn.comparison.training import started_plant
from phnn.identification.base import Progress, quiet
from phnn.identification.zero import own_zeros
from phnn.learn.plant import NetworkPlant, Plant
from phnn.learn.run import violations
from phnn.learn.solvers import solver_for
from phnn.learn.starts import typical_states
from phnn.models.store import load
from phnn.recordings import Campaign, read
from phnn.report.formatting import DASH, markdown_table, number, percent, ratio
from phnn.results import claim
from studies.comparison.cycles import CycleErrors, cycle_errors
from studies.comparison.supply import Response, of_plant, of_setup, supply
from studies.comparison.uses import USES, over_noise, uses
from studies.recordings import Conditions, comparison_plan, write_recordings
from studies.rival_models.names import HEADS

_SIGNALS = "sines from rest, three periods of 2500 samples"
_STATES = 10_000
Results = Mapping[str, Result]


def compare_on_made(
    out: Path, conditions: Conditions, settings: Settings, inputs: int, progress: Progress = quiet
) -> dict[str, Result]:
    """Make recordings in ``out/recordings``, compare in ``out/models``, and write ``out/comparison.md``.

    Args:
        inputs: random voltages under which the supplied energy is accounted for, see `studies.comparison.supply`.

    Raises:
        InputRefused: settings, or a folder that holds files of others.
        SolverFailed: the second effect cannot be made as strong as asked.
    """
    with claim(out, "comparison", (), ("recordings", "models", "comparison.md")) as place:
        progress("make recordings")
        folder = (place / "recordings").own_folder()
        made = write_recordings(folder, conditions, comparison_plan())
        campaign = read(folder)
        campaign = replace(campaign, recordings=own_zeros(campaign.recordings))
        models = (place / "models").own_folder()
        results = compare(campaign, models, settings, progress)
        lines = [f"# All models on {campaign.folder}", "", made.words(_SIGNALS), "", *_fits(campaign, results)]
        lines += ["", "## Steady cycles", "", *_cycles(campaign, results), "", "## Models", ""]
        lines += _models(campaign, results, models, settings, inputs, progress)
        (place / "comparison.md").write(("\n".join(lines) + "\n").encode())
    return results


def _fits(campaign: Campaign, results: Results) -> list[str]:
    """Fit percentage and residual over noise, recordings grouped by use, and the root mean square of each group."""
    kinds, heads = uses(campaign.recordings), [HEADS[m] for m in results]
    scores = [{p.name: p for p in r.evaluation.parts} for r in results.values()]
    body = [
        [name, words, *(f"{percent(s[name].fit_percent, 2)}  ({ratio(s[name].residual_over_noise)})" for s in scores)]
        for use, words in USES.items()
        for name, own in kinds.items()
        if own == use
    ]
    groups = [
        [words, *(ratio(over_noise(r.evaluation, kinds, use)) for r in results.values())] for use, words in USES.items()
    ]
    return [
        "## Fit in percent, and residual over noise in brackets", "",
        *markdown_table(["recording", "use", *heads], body), "",
        *markdown_table(["residual over noise, root mean square", *heads], groups),
    ]  # fmt: skip


def _cycles(campaign: Campaign, results: Results) -> list[str]:
    """Errors of the loop's area and of three harmonics, and what the noise alone does to both."""
    body = []
    for r in campaign.recordings:
        for part in r.parts:
            found = [cycle_errors(r, part, x.evaluation.outputs[r.name]) for x in results.values()]
            first = found[0]
            if part.use != "nuisance" and first is not None:
                noise = f"±{number(100 * first.area_noise, 2)} %; ±{number(1e9 * first.harmonic_noise, 2)} nm"
                body.append([part.name, noise, *map(_cycle, found)])
    words = (
        "Relative error of the hysteresis loop's signed area, in percent, and error of the harmonics 1, 2 and 3 of the "
        "displacement, in nm; what the noise alone does to either stands in its column."
    )
    return [words, "", *markdown_table(["recording", "noise", *(HEADS[m] for m in results)], body)]


def _cycle(cycles: CycleErrors | None) -> str:
    if cycles is None:
        return DASH
    harmonics = ", ".join(number(1e9 * e, 2) for e in cycles.harmonics[:3])
    return f"{number(100 * cycles.area, 2)} %; {harmonics} nm"


def _models(
    campaign: Campaign, results: Results, home: Path, settings: Settings, inputs: int, progress: Progress
) -> list[str]:
    """Both checks of passivity, where a model can be loaded again, beside what else there is to say of it."""
    recordings = [r for r in campaign.recordings if r.mask("identification").any()]
    seed, voltage = settings.options.seed, max(float(np.abs(r.u).max()) for r in recordings)
    body = []
    for model, result in results.items():
        counted = supplied = DASH
        if model in MODELS:
            progress(f"check the passivity of {model}")
            response, plant = _loaded(model, campaign, home / model, settings)
            count = None if plant is None else violations(plant, voltage, _STATES, seed)
            counted = "no energy" if count is None else f"{count} of {_STATES}"
            supplied = "{} of {}".format(*supply(response, recordings, inputs, seed))
        facts = result.facts
        about = [facts["kind"], str(facts["parameters"]), number(facts["seconds"])]
        body.append([HEADS[model], *about, counted, supplied, facts["gradient"]])
    heads = ["model", "kind", "parameters", "seconds", "power balance", "supply", "fitted by"]
    words = (
        "Power balance: at how many random states and inputs storage grows faster than energy is supplied at the "
        "model's own port. Supply: under how many random voltages from rest ∫ V q̇ dt falls below zero by more "
        "than a thousandth of ∫ |V q̇| dt, which no passive actuator with the paper's port allows."
    )
    return [*markdown_table(heads, body), "", words]


def _loaded(model: str, campaign: Campaign, home: Path, settings: Settings) -> tuple[Response, Plant | None]:
    """A finished model from its folder: its response, and its plant where it has an energy."""
    if model in BLACK_BOXES:
        recipe = settings.recipes[model]
        plant = started_plant(recipe, campaign, settings.options.seed)
        plant.load_state_dict(torch.load(home / "weights.pt", weights_only=True))
        return of_plant(plant, solver_for(recipe.solver, plant)), plant
    setup, _ = load(home)
    if setup.amplifier:
        # A block before the network has no energy.
        return of_setup(setup), None
    recordings: Sequence = [r for r in campaign.recordings if r.mask("identification").any()]
    return of_setup(setup), NetworkPlant(setup.network, typical_states(setup.network, recordings))
