"""All models on made recordings that also go beyond the identified range: fits by use, cycles and passivity."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from phnn.comparison.models import BLACK_BOXES, MODELS, Result, Settings
from phnn.comparison.run import compare
from phnn.errors import SolverFailed
from phnn.identification.base import Progress, quiet
from phnn.identification.zero import own_zeros
from phnn.learn.plant import NetworkPlant, Plant
from phnn.learn.run import violations
from phnn.learn.solvers import Solver, solver_for
from phnn.learn.starts import plant_for, typical_states
from phnn.learn.windows import windows_of
from phnn.models.store import load
from phnn.recordings import Campaign, read
from phnn.recordings.excitation import active_span
from phnn.recordings.recording import Part, Recording, dominant_frequency, unrecorded
from phnn.report.formatting import DASH, markdown_table, number, percent, ratio
from phnn.results import claim
from phnn.setup import Setup
from phnn.signals.least_squares import HARMONICS, deviation, harmonic_weights
from phnn.trajectory import simulate
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
        inputs: random voltages under which the supplied energy is accounted for, see `studies.comparison.run`.

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
        plant = plant_for(recipe.model, campaign, settings.options.seed)
        plant.load_state_dict(torch.load(home / "weights.pt", weights_only=True))
        return of_plant(plant, solver_for(recipe.solver, plant)), plant
    setup, _ = load(home)
    if setup.amplifier:
        # A block before the network has no energy.
        return of_setup(setup), None
    recordings: Sequence = [r for r in campaign.recordings if r.mask("identification").any()]
    return of_setup(setup), NetworkPlant(setup.network, typical_states(setup.network, recordings))


Array = NDArray[np.float64]


@dataclass(frozen=True)
class CycleErrors:
    """Attributes:
    area: relative error ``(Â − A)/|A|`` of the signed loop area; area_noise: its standard deviation by the noise.
    harmonics: ``|Ŷ_k − Y_k|`` for k = 1…5, m; harmonic_noise: root mean square of each by the noise, m.
    """

    area: float
    area_noise: float
    harmonics: tuple[float, ...]
    harmonic_noise: float


def cycle_errors(recording: Recording, part: Part, model: Array) -> CycleErrors | None:
    """The errors of a model on one part of a recording; None where its input does not repeat within it.

    Args:
        recording: what was measured.
        part: the samples that count. The first period of a recording is left out where there is another one: a start
            from rest is no cycle yet.
        model: (N,) output of the model at all samples, m.
    """
    if recording.period is None:
        return None
    begin, end = active_span(recording.u)
    first, last = max(part.first, begin), min(part.last, end)
    per_period = recording.period / recording.dt
    # A recording of n periods that ends one sample before it would begin again has n of them.
    whole = min(_periods(last - first, per_period), max(1, _periods(last - begin, per_period) - 1))
    if whole < 1 or last - first <= per_period or per_period < 2 * HARMONICS + 2:
        return None
    error = model - recording.y
    rows = slice(first, last)
    loop, area = _loop(recording, rows)
    rows_whole = slice(last - round(whole * per_period), last)
    waves = harmonic_weights(recording.t[rows_whole], recording.period)
    return CycleErrors(
        area=float(loop @ error[rows]) / abs(area),
        area_noise=recording.noise * deviation(loop, recording.noise_correlation) / abs(area),
        harmonics=tuple(np.abs(waves @ error[rows_whole]).tolist()),
        harmonic_noise=recording.noise * deviation(waves[0], recording.noise_correlation),
    )


def _periods(samples: int, per_period: float) -> int:
    """Whole periods in a number of samples."""
    return int(samples / per_period + 1e-6)


def _loop(recording: Recording, rows: slice) -> tuple[Array, float]:
    """Weights of a loop's area, and the area; infinite where there is no loop, so that no error is relative to it."""
    assert recording.period is not None
    weights = area_weights(recording.t[rows], recording.u[rows], recording.period)
    area = float(weights @ recording.y[rows])
    return weights, area if area else np.inf


def area_weights(t: Array, u: Array, period: float) -> Array:
    """(N,) weights of the samples in ``∮ y du`` over the last period, by the trapezoidal rule.

    Args:
        t: (N,) times, s; u: (N,) input; period: s, at most as long as the times span.
    """
    weights = np.zeros(t.size)
    begin = t[-1] - period
    inside = int(np.searchsorted(t, begin, side="right"))
    # The period begins between two samples, at a value of the output that lies between theirs.
    before = max(inside - 1, 0)
    share = (begin - t[before]) / (t[inside] - t[before]) if inside > before else 0.0
    # The input closes the loop exactly, so that a displacement zero drops out.
    du = np.diff(np.concatenate([[u[-1]], u[inside:]]))
    weights[inside:] = 0.5 * du
    weights[inside:-1] += 0.5 * du[1:]
    weights[before] += 0.5 * du[0] * (1.0 - share)
    weights[inside] += 0.5 * du[0] * share
    return weights


Response = Callable[[Sequence[Recording]], list[Array]]

_TONES, _SAMPLES, _PERIODS = 4, 257, 2
_DECADES, _WEAKEST = 1.0, 0.03
# What counts as extracted, over all that went to and fro: more than solvers and the trapezoidal rule are wrong by.
_TOLERANCE = 1e-3
_BATCH = 1000


def supply(respond: Response, recordings: Sequence[Recording], count: int, seed: int = 0) -> tuple[int, int]:
    """Simulate a model from rest under random inputs and account for the energy that it was supplied with.

    Args:
        respond: displacement (N,) for inputs from rest.
        recordings: give frequencies and largest input: those for identification.
        count: how many inputs.
        seed: of the inputs.

    Returns:
        Under how many inputs ``W`` falls below zero by more than a thousandth of ``∫|V q̇| dt``, or the output leaves
        the finite numbers; and how many could be simulated.
    """
    inputs, shares = random_inputs(recordings, count, seed), list[float]()
    for first in range(0, count, _BATCH):
        batch = inputs[first : first + _BATCH]
        with suppress(SolverFailed):
            shares += [extracted(r.u, q) for r, q in zip(batch, respond(batch), strict=True)]
    return sum(s > _TOLERANCE for s in shares), len(shares)


def extracted(u: Array, q: Array) -> float:
    """Largest energy below zero over all that went to and fro, ``max_t −W(t) / ∫|V q̇| dt``; ∞ if ``q`` diverged."""
    if not np.isfinite(q).all():
        return float("inf")
    power = 0.5 * (u[1:] + u[:-1]) * np.diff(q)
    moved = float(np.abs(power).sum())
    return max(0.0, -float(np.cumsum(power).min()) / moved) if moved else 0.0


def random_inputs(recordings: Sequence[Recording], count: int, seed: int) -> list[Recording]:
    """Sums of four sines from zero within the decade below the highest frequency, peaks over a range of sizes."""
    random = np.random.default_rng(seed)
    highest = max(dominant_frequency(r) for r in recordings)
    largest = max(float(np.abs(r.u).max()) for r in recordings)
    found = []
    for k in range(count):
        frequencies = highest * 10.0 ** (-_DECADES * random.random(_TONES))
        t = np.linspace(0.0, _PERIODS / frequencies.min(), _SAMPLES)
        u = np.sin(2.0 * np.pi * np.outer(t, frequencies)) @ random.standard_normal(_TONES)
        u *= largest * _WEAKEST ** random.random() / np.abs(u).max()
        found.append(unrecorded(f"random {k}", t, u))
    return found


def of_setup(setup: Setup) -> Response:
    """The response of a network behind its amplifier."""

    def respond(inputs: Sequence[Recording]) -> list[Array]:
        return [simulate(setup, r).y for r in inputs]

    return respond


def of_plant(plant: Plant, solver: Solver) -> Response:
    """The response of a trained model, all inputs at once."""

    @torch.no_grad()
    def respond(inputs: Sequence[Recording]) -> list[Array]:
        windows = windows_of(inputs, 0, 1)
        states = solver(plant, windows, torch.zeros(len(inputs), plant.scale.numel(), dtype=torch.float64))
        return [plant.measured(x).numpy() for x in states]

    return respond
