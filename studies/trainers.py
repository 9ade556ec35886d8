"""Trainers side by side, from the same start on the same recordings: Gauss–Newton, `odeint_adjoint`, backpropagation.

Every trainer makes the same loss small (`phnn.learn.objective`), until an epoch lowers it by less than a stated share
or its time is up. Seconds are those of one processor: a machine that is shared slows the clock, not these.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib import rc_context
from matplotlib.figure import Figure

from phnn.errors import InputRefused, SolverFailed
from phnn.identification.base import Progress
from phnn.learn.objective import Objective, evaluate
from phnn.learn.settings import Settings
from phnn.learn.solvers import discrete_gradient, solver_for, thinned
from phnn.learn.starts import plant_for
from phnn.learn.trainer import method_of
from phnn.recordings import Campaign, read
from phnn.report.figures.style import CATEGORIES, RC, literal, new_figure, png, quiet_grid
from phnn.report.formatting import markdown_table
from phnn.results import Place, write_atomic
from studies.generator.cases import with_hysterons
from studies.generator.noise import Noise
from studies.generator.plans import sine
from studies.generator.seal import MANIFEST, refuse_strangers, reported, write_folder
from studies.generator.world import TABLE, simulate_all
from studies.recordings import CONFIRMATION, OUTSIDE, Conditions, comparison_plan, over_noise, uses, write_recordings
from studies.results import write_results

# Hysteron 1 of Table 1, slowed down until an explicit method can follow it: it relaxes at C/ϱ⁻¹ = 0.5 ms.
SLOW = {"C_1": 5.0e-7, "rho_1": 1.0e-3, "d_1": 8.0}
_SLOW_HZ, _SLOW_HELD_HZ, _WEIGHING = (50.0, 100.0, 150.0), (75.0, 120.0), 1e-4
# The first steps of L-BFGS are short, because nothing is known of the curvature: they say nothing of rest.
_LEAST_EPOCHS = 4


@dataclass(frozen=True)
class Way:
    """A trainer: how windows are solved, and what moves the parameters.

    Attributes:
        solver: its name and options, see `phnn.learn.solvers.solver_for`; method: one of `phnn.learn.trainer`.
        window: samples of a window, 0 for whole recordings; the initial states of windows are trained as well.
        iterations: of L-BFGS in an epoch.
        seconds: after which it is stopped, where this is less than the limit of the case.
        words: for the table.
    """

    words: str
    solver: Mapping[str, Any]
    method: str
    window: int = 0
    iterations: int = 10
    seconds: float = float("inf")


@dataclass(frozen=True)
class Case:
    """A model with the recordings it is trained on.

    Attributes:
        model: arguments of `phnn.learn.starts.plant_for`.
        recordings: ``table``: the four sines of the paper; ``slow``: three sines of one slow hysteron.
        stride, substeps: every how many samples, and steps a sample interval.
        ways: names of trainers, the one that the others are compared with first.
        seconds: after which a trainer is stopped; tolerance: share of the loss that an epoch must lower it by.
    """

    words: str
    model: Mapping[str, Any]
    recordings: str
    stride: int
    substeps: int
    ways: tuple[str, ...]
    seconds: float
    tolerance: float


@dataclass(frozen=True)
class Outcome:
    """Where a trainer ended.

    Attributes:
        curve: (seconds, loss) at the beginning of every epoch and at the end.
        gradients: loss with gradient, or linearisations of Gauss–Newton and the losses of its trials, that were taken.
        stopped: by the tolerance, or else by its time.
        inside, beyond: residual over noise of held-out recordings within and beyond the identified range.
    """

    case: str
    way: str
    curve: tuple[tuple[float, float], ...]
    gradients: int
    stopped: bool
    inside: float | None
    beyond: float | None

    @property
    def seconds(self) -> float:
        """Of training."""
        return self.curve[-1][0]

    @property
    def loss(self) -> float:
        """At the end."""
        return self.curve[-1][1]


def compare_trainers(
    place: Place, cases: Mapping[str, Case], ways: Mapping[str, Way], noise_um: float, seed: int, progress: Progress
) -> list[Outcome]:
    """Train every case in every way, one after another.

    Args:
        place: gets the recordings.
        noise_um: standard deviation of the sensor's noise, µm; seed: of noise and initial weights.

    Raises:
        InputRefused: recordings of another kind than those that can be made here, or a model that does not exist.
    """
    torch.set_num_threads(1)
    campaigns = {
        kind: _recordings((place / "recordings" / kind).own_folder(), kind, noise_um, seed)
        for kind in dict.fromkeys(c.recordings for c in cases.values())
    }
    outcomes = []
    for name, case in cases.items():
        for label in case.ways:

            def told(line: str, what: str = f"{name}, {label}") -> None:
                progress(f"{what}: {line}")

            outcomes.append(_trained(name, case, label, ways[label], campaigns[case.recordings], seed, told))
    return outcomes


def _recordings(folder: Path, kind: str, noise_um: float, seed: int) -> Campaign:
    """Make recordings by the generator of sealed cases, which shares no code with the models."""
    if not (folder / MANIFEST).exists():
        if kind == "table":
            write_recordings(folder, Conditions(noise_um=noise_um, seed=seed), comparison_plan())
        elif kind == "slow":
            _write_slow(folder, noise_um, seed)
        else:
            raise InputRefused(f"recordings: {kind!r}: choose table or slow")
    return read(folder)


def _write_slow(folder: Path, noise_um: float, seed: int) -> None:
    plan = tuple(sine(f) for f in sorted((*_SLOW_HZ, *_SLOW_HELD_HZ)))
    names = {sine(f).name for f in _SLOW_HZ}
    refuse_strangers(folder, plan)
    sensor = np.random.default_rng(seed)
    actuator = with_hysterons(TABLE, 1, np.random.default_rng(seed)) | SLOW
    reports = [reported(q, Noise(noise_um * 1e-6, 1e-9), sensor) for q in simulate_all(actuator, plan)]
    chosen = {e.name: "identification" if e.name in names else "confirmation" for e in plan}
    write_folder(folder, actuator["m"], plan, reports, chosen, _WEIGHING, hysterons=1, write=write_atomic)


def _trained(name: str, case: Case, label: str, way: Way, campaign: Campaign, seed: int, progress: Progress) -> Outcome:
    """Train in one way."""
    used = [thinned(r, case.stride) for r in campaign.recordings if r.mask("identification").any()]

    def objective() -> Objective:
        plant = plant_for(case.model, campaign, seed)
        made = Objective(plant, discrete_gradient, used, way.window, case.substeps)
        # Windows begin on the trajectory of the untrained model, which the compiled kernel computes for all trainers.
        made.solver = solver_for(way.solver, plant)
        made.solved = 0
        return made

    settings = Settings(folder="", out="", solver=way.solver, window=way.window, lbfgs_iterations=way.iterations)
    # What is compiled is compiled before the clock starts.
    warm = objective()
    method_of(way.method, warm, replace(settings, lbfgs_iterations=1), 1.0)(0)
    trained = objective()
    curve, stopped = _epochs(trained, way, settings, case, progress)
    scores = evaluate(trained.plant, discrete_gradient, campaign.recordings, 1, {})
    kinds = uses(campaign.recordings)
    over = (over_noise(scores, kinds, kind) for kind in (CONFIRMATION, OUTSIDE))
    held = [None if np.isnan(value) else value for value in over]
    progress(f"held out {held[0]} inside, {held[1]} beyond the identified range")
    return Outcome(name, label, tuple(curve), trained.solved, stopped, held[0], held[1])


def _epochs(
    objective: Objective, way: Way, settings: Settings, case: Case, progress: Progress
) -> tuple[list[tuple[float, float]], bool]:
    """Return the curve of a training, and whether it came to rest."""
    method = method_of(way.method, objective, settings, 1.0)
    curve: list[tuple[float, float]] = []
    began, spent, stopped = time.process_time(), 0.0, False
    while spent < min(case.seconds, way.seconds):
        loss = method(len(curve))
        curve.append((spent, loss))
        spent = time.process_time() - began
        progress(f"epoch {len(curve)}: {spent:.1f} s, loss {loss:.6g}")
        stopped = len(curve) > _LEAST_EPOCHS and curve[-2][1] - loss < case.tolerance * loss
        if stopped:
            break
    solved = objective.solved
    with torch.no_grad():
        try:
            curve.append((spent, float(objective())))
        except SolverFailed:
            curve.append((spent, float("inf")))
    objective.solved = solved
    return curve, stopped


# What is written into the folder of results.
RESULTS = ("recordings", "trainers.json", "trainers.md", "curves.csv", "curves.png")
_LEAST_SECONDS = 1e-2


def run(place: Place, config: Mapping[str, Any], progress: Progress) -> str:
    """Compare trainers as configured; write ``trainers.json``, ``trainers.md``, ``curves.csv`` and ``curves.png``.

    Returns:
        The table, as markdown.

    Raises:
        InputRefused: a case or a trainer that does not exist, or a key that they do not have.
    """
    ways = {name: Way(**given) for name, given in config["ways"].items()}
    chosen = list(config["only"] or config["cases"])
    for name in chosen:
        if name not in config["cases"]:
            raise InputRefused(f"only: no case {name!r}: choose from {', '.join(config['cases'])}")
        for way in config["cases"][name]["ways"]:
            if way not in ways:
                raise InputRefused(f"{name}: no trainer {way!r}: choose from {', '.join(ways)}")
    cases = {n: Case(**{**config["cases"][n], "ways": tuple(config["cases"][n]["ways"])}) for n in chosen}
    outcomes = compare_trainers(place, cases, ways, float(config["noise_um"]), int(config["seed"]), progress)
    text = table(outcomes, cases, ways)
    with rc_context(RC):
        (place / "curves.png").write(png(figure(outcomes, cases, ways)))
    documents = {"trainers.json": {"seed": config["seed"], "outcomes": [asdict(o) for o in outcomes]}}
    write_results(place, {"curves.csv": curves(outcomes), "trainers.md": text}, documents)
    return text


def table(outcomes: Sequence[Outcome], cases: Mapping[str, Case], ways: Mapping[str, Way]) -> str:
    """Return one row a trainer; times as multiples of that of the first trainer of the case."""
    head = (
        "model", "trainer", "loss at the end", "held out, inside", "held out, beyond", "solved", "ms each",
        "time over Gauss–Newton",
    )  # fmt: skip
    first = {o.case: o.seconds for o in reversed(outcomes)}
    rows = []
    for o in outcomes:
        ratio = f"{o.seconds / first[o.case]:.1f}" if o.stopped else f"> {o.seconds / first[o.case]:.0f}, stopped"
        rows.append([
            cases[o.case].words, ways[o.way].words, f"{o.loss:.4g}",
            *("–" if v is None else f"{v:.3g}" for v in (o.inside, o.beyond)),
            str(o.gradients), f"{1e3 * o.seconds / o.gradients:.0f}", ratio,
        ])  # fmt: skip
    return "\n".join([*markdown_table(head, rows), ""])


def curves(outcomes: Sequence[Outcome]) -> str:
    """Return all curves as csv."""
    rows = [f"{o.case},{o.way},{s:.4f},{loss:.9g}\n" for o in outcomes for s, loss in o.curve]
    return "case,trainer,seconds,loss\n" + "".join(rows)


def figure(outcomes: Sequence[Outcome], cases: Mapping[str, Case], ways: Mapping[str, Way]) -> Figure:
    """Draw loss against seconds, one panel a case."""
    drawn = new_figure(3.4 * len(cases), 3.2)
    colours = dict(zip(ways, CATEGORIES, strict=False))
    for number, (name, case) in enumerate(cases.items(), start=1):
        axes = drawn.add_subplot(1, len(cases), number)
        for o in (o for o in outcomes if o.case == name):
            seconds = [max(s, _LEAST_SECONDS) for s, _ in o.curve]
            axes.loglog(seconds, [loss for _, loss in o.curve], color=colours[o.way], label=literal(ways[o.way].words))
        axes.axhline(1.0, color="0.6", linewidth=0.8)
        axes.set_title(literal(case.words), fontsize="small")
        axes.set(xlabel="seconds of one processor", ylabel="loss (1: noise)" if number == 1 else "")
        axes.legend(fontsize="x-small")
        quiet_grid(axes)
    return drawn
