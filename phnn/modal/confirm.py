"""Score models on recordings that are held out: realisations of a fitted amplitude, or whole amplitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phnn.errors import SolverFailed
from phnn.modal.experiment import Experiment, Study
from phnn.modal.fit import ModalFit


@dataclass(frozen=True)
class Score:
    """Errors of a model on some experiments.

    Attributes:
        rmse: (O,) root mean square error of each output over all recorded periods, in the outputs' unit.
        share: of all outputs together, over the effective value of what was measured.
    """

    rmse: list[float]
    share: float


@dataclass(frozen=True)
class HeldOut:
    """Scores of one model; None where nothing is held out, or where a step of the model has no solution.

    Attributes:
        levels: on the held-out realisations of each fitted amplitude.
        apart: at each amplitude that is held out as a whole.
    """

    levels: tuple[Score | None, ...]
    apart: tuple[Score | None, ...]

    @property
    def all(self) -> tuple[Score | None, ...]:
        """Of the fitted amplitudes, then of the others."""
        return self.levels + self.apart


def held_out_scores(fit: ModalFit, study: Study) -> HeldOut:
    """Score a model on everything that is held out."""
    levels = tuple(_score(fit, study.held_out(i)) for i in range(len(study.levels)))
    return HeldOut(levels, tuple(_score(fit, level) for level in study.apart))


def _score(fit: ModalFit, held: Sequence[Experiment]) -> Score | None:
    if not held:
        return None
    try:
        errors = np.mean([fit.errors(e) ** 2 for e in held], axis=0)
    except SolverFailed:
        return None
    measured = np.mean([(e.y**2).mean(axis=0) + e.spread**2 for e in held], axis=0)
    return Score(np.sqrt(errors).tolist(), float(np.sqrt(errors.sum() / max(measured.sum(), 1e-300))))
