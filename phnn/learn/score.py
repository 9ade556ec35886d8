"""Score a trained plant on every part of every recording, each run from its own start to its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from phnn.identification.evaluate import Evaluation, score_part
from phnn.integrate.compilable import can_compile
from phnn.learn.objective import Objective, estimated_start
from phnn.learn.plant import NetworkPlant, Plant
from phnn.learn.solvers import Solver, near
from phnn.learn.windows import Window, starts_at_zero, windows_of
from phnn.nn.learned_system import LearnedSystem
from phnn.recordings.recording import Recording


def whole(
    plant: Plant,
    solver: Solver,
    recordings: Sequence[Recording],
    substeps: int,
    initial: Mapping[str, Tensor] | None = None,
    use: str = "identification",
) -> Objective:
    """The objective on whole recordings, the initial states given, known, or estimated from the first samples."""
    objective = Objective(plant, solver, recordings, 0, substeps, use=use)
    given = initial or {}
    for k, r in enumerate(recordings):
        if not starts_at_zero(r):
            objective.origin[k] = given[r.name] if r.name in given else estimated_start(plant, solver, r, substeps)
    return objective


def evaluate(
    plant: Plant, solver: Solver, recordings: Sequence[Recording], substeps: int, initial: Mapping[str, Tensor]
) -> Evaluation:
    """Simulate all recordings and score their parts, as `phnn.identification.evaluate` does.

    Args:
        initial: (n,) initial states estimated in training, by recording name.
    """
    objective = whole(plant, solver, recordings, substeps, initial)
    outputs, parts = {}, []
    with torch.no_grad():
        found = objective.outputs()
    for r, y in zip(recordings, (f.numpy() for f in found), strict=True):
        masks = (r.mask("identification"), r.mask("nuisance"), r.t >= 0.0)
        mask = next(m for m in masks if m.any())
        outputs[r.name] = y + (r.y[mask] - y[mask]).mean()
        parts += [
            score_part(r, outputs[r.name], p.first, p.last, p.name, p.use) for p in r.parts if p.use != "nuisance"
        ]
    return Evaluation(outputs, tuple(parts))


# Most sub-steps, and the share of the noise below which the numerical error of an output has to be.
_MOST, _ERROR = 16, 0.1
# Samples of a piece.
_PIECE = 128


@torch.no_grad()
def substeps_needed(plant: Plant, solver: Solver, recordings: Sequence[Recording]) -> int:
    """Find how many sub-steps keep the error of every recording's output below a tenth of its noise.

    Halving a step of second order takes three quarters of its error. Where nothing but weights is in a model, its steps
    are part of what is learned: it takes one. Of laws without a kernel short pieces are integrated: the steepest of
    every recording, and its first.
    """
    if not isinstance(plant, NetworkPlant) or isinstance(plant.system, LearnedSystem):
        return 1
    whole = can_compile(plant.system.network)
    chosen = [] if whole else _pieces(windows_of(recordings, _PIECE, 1))

    def outputs(substeps: int) -> list[tuple[float, Tensor]]:
        if whole:
            found = Objective(plant, solver, recordings, substeps=substeps).outputs()
            return [(r.noise, y) for r, y in zip(recordings, found, strict=True)]
        windows = windows_of(recordings, _PIECE, substeps)
        pieces = [windows[k] for k in chosen]
        begun = [near(plant, [w]) for w in pieces]
        x0 = torch.stack(
            [
                torch.zeros_like(plant.scale) if w.known or b is None else b[0, 0]
                for w, b in zip(pieces, begun, strict=True)
            ]
        )
        found = solver(plant, pieces, x0)
        return [(recordings[w.recording].noise, plant.measured(x)) for w, x in zip(pieces, found, strict=True)]

    count, before = 1, outputs(1)
    while count < _MOST:
        after = outputs(2 * count)
        pairs = [(noise, a - b) for (noise, a), (_, b) in zip(before, after, strict=True)]
        if all(4.0 / 3.0 * float((d - d.mean()).square().mean().sqrt()) <= _ERROR * noise for noise, d in pairs):
            break
        count, before = 2 * count, after
    return count


def _pieces(windows: Sequence[Window]) -> list[int]:
    """Number of every recording's first window, and of the one whose input changes fastest between samples."""
    found = []
    for r in dict.fromkeys(w.recording for w in windows):
        own = [k for k, w in enumerate(windows) if w.recording == r]
        rates = [float(((windows[k].fine[:, 2] - windows[k].fine[:, 0]) / windows[k].h).abs().amax()) for k in own]
        found += sorted({own[0], own[int(np.argmax(rates))]})
    return found


def set_aside(recordings: Sequence[Recording], names: Sequence[str]) -> tuple[list[Recording], list[Recording]]:
    """Recordings to train on, and those that stop the training, of the ones that serve identification.

    Recordings that confirm are in neither: they are looked at once, at the end.
    """
    chosen = [r for r in recordings if r.mask("identification").any()]
    return [r for r in chosen if r.name not in names], [r for r in chosen if r.name in names]
