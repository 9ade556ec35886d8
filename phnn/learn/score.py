"""Score a trained plant on every part of every recording, each run from its own start to its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from phnn.identification.evaluate import Evaluation, score_part
from phnn.learn.objective import Objective, estimated_start
from phnn.learn.plant import Plant
from phnn.learn.solvers import Solver
from phnn.learn.windows import starts_at_zero
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


def set_aside(recordings: Sequence[Recording], names: Sequence[str]) -> tuple[list[Recording], list[Recording]]:
    """Recordings to train on, and those that stop the training, of the ones that serve identification.

    Recordings that confirm are in neither: they are looked at once, at the end.
    """
    chosen = [r for r in recordings if r.mask("identification").any()]
    return [r for r in chosen if r.name not in names], [r for r in chosen if r.name in names]
