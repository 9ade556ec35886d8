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

from phnn.errors import InputRefused, SolverFailed
from phnn.identification.base import Progress
from phnn.learn.methods import method_of
from phnn.learn.objective import Objective
from phnn.learn.score import evaluate
from phnn.learn.settings import Settings
from phnn.learn.solvers import compiled, solver_for
from phnn.learn.starts import plant_for
from phnn.learn.windows import thinned
from phnn.recordings import Campaign, read
from phnn.results import Place, write_atomic
from studies.comparison.uses import CONFIRMATION, OUTSIDE, uses
from studies.generator.actuator import TABLE, simulate_all
from studies.generator.base import with_hysterons
from studies.generator.excitation import sine
from studies.generator.folder import MANIFEST, measured, refuse_strangers, write_manifest, write_recording
from studies.recordings import Conditions, comparison_plan, write_recordings

# Hysteron 1 of Table 1, slowed down until an explicit method can follow it: it relaxes at C/ϱ⁻¹ = 0.5 ms.
SLOW = {"C_1": 5.0e-7, "rho_1": 1.0e-3, "d_1": 8.0}
_SLOW_HZ, _SLOW_HELD_HZ, _WEIGHING = (50.0, 100.0, 150.0), (75.0, 120.0), 1e-4
# The first steps of L-BFGS are short, because nothing is known of the curvature: they say nothing of rest.
_LEAST_EPOCHS = 4


@dataclass(frozen=True)
class Way:
    """A trainer: how windows are solved, and what moves the parameters.

    Attributes:
        solver: its name and options, see `phnn.learn.solvers.solver_for`; method: one of `phnn.learn.methods`.
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


class _Counting(Objective):
    """An objective that counts how often it was solved."""

    solved = 0

    def forward(self) -> torch.Tensor:
        self.solved += 1
        return super().forward()


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
    found: list[Outcome] = []
    campaigns = {
        kind: _recordings((place / "recordings" / kind).own_folder(), kind, noise_um, seed) for kind in _kinds(cases)
    }
    for name, case in cases.items():
        for label in case.ways:
            told = _prefixed(progress, f"{name}, {label}")
            found.append(_trained(name, case, label, ways[label], campaigns[case.recordings], seed, told))
    return found


def _prefixed(progress: Progress, what: str) -> Progress:
    return lambda line: progress(f"{what}: {line}")


def _kinds(cases: Mapping[str, Case]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(c.recordings for c in cases.values()))


def _recordings(folder: Path, kind: str, noise_um: float, seed: int) -> Campaign:
    """Recordings made by the demonstration's generator, which shares no code with the models."""
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
    folder.mkdir(parents=True, exist_ok=True)
    sensor = np.random.default_rng(seed)
    actuator = with_hysterons(TABLE, 1, np.random.default_rng(seed)) | SLOW
    for excitation, q in zip(plan, simulate_all(actuator, plan), strict=True):
        y = measured(q, noise_um * 1e-6, 1e-9, sensor)
        write_recording(folder / f"{excitation.name}.csv", excitation, y, write_atomic)
    chosen = {e.name: "identification" if e.name in names else "confirmation" for e in plan}
    write_manifest(folder / MANIFEST, actuator["m"], plan, chosen, _WEIGHING, hysterons=1, write=write_atomic)


def _trained(name: str, case: Case, label: str, way: Way, campaign: Campaign, seed: int, progress: Progress) -> Outcome:
    """Train in one way."""
    used = [thinned(r, case.stride) for r in campaign.recordings if r.mask("identification").any()]

    def objective() -> _Counting:
        plant = plant_for(case.model, campaign, seed)
        made = _Counting(plant, compiled, used, way.window, case.substeps)
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
    scores = evaluate(trained.plant, compiled, campaign.recordings, 1, {})
    kinds = uses(campaign.recordings)
    held = []
    for kind in (CONFIRMATION, OUTSIDE):
        squares = [p.residual_over_noise**2 for p in scores.parts if kinds[p.name] == kind]
        held.append(float(np.sqrt(np.mean(squares))) if squares else None)
    progress(f"held out {held[0]} inside, {held[1]} beyond the identified range")
    return Outcome(name, label, tuple(curve), trained.solved, stopped, held[0], held[1])


def _epochs(
    objective: _Counting, way: Way, settings: Settings, case: Case, progress: Progress
) -> tuple[list[tuple[float, float]], bool]:
    """The curve of a training, and whether it came to rest."""
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


def plain(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """As dictionaries and lists."""
    return [asdict(o) for o in outcomes]
