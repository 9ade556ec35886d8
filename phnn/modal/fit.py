"""Fit modal models to experiments."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from phnn.errors import SolverFailed
from phnn.modal.experiment import Experiment, Study
from phnn.modal.model import ModalModel
from phnn.modal.problem import Problem

Array = NDArray[np.float64]

# Relative changes of the sum of squares and of the parameters at which a fit ends.
_TOLERANCE, _MOVED = 3e-5, 1e-6


@dataclass(frozen=True, eq=False)
class ModalFit:
    """A model with the shapes of its outputs.

    Attributes:
        model: the fitted one; shapes: (O, 2 M + P) of q, q̇ and forces in each output, see `phnn.modal.model.Seen`.
        dt: s; cost: what is left of the fitted experiments, over what was measured, squared and averaged.
    """

    model: ModalModel
    shapes: Array
    dt: float
    cost: float

    def predict(self, experiment: Experiment) -> Array:
        """(N, O) outputs of an experiment, without their means."""
        seen = self.model.seen(experiment, self.dt)
        spectrum = (seen.columns @ self.shapes.T) * np.exp(-seen.s[:, None] * self.model.delay)
        spectrum[0] = 0.0
        return np.asarray(np.fft.irfft(spectrum, len(experiment.u), axis=0))

    def errors(self, experiment: Experiment) -> Array:
        """(O,) root mean square error over all recorded periods."""
        left = ((experiment.y - self.predict(experiment)) ** 2).mean(axis=0)
        return np.asarray(np.sqrt(left + experiment.spread**2))


def fit_modes(
    model: ModalModel, experiments: Sequence[Experiment], study: Study, iterations: int, workers: int = 1
) -> ModalFit:
    """Fit a model to experiments.

    Args:
        model: to begin with.
        iterations: how often all experiments may be simulated.
        workers: threads.

    Raises:
        SolverFailed: the first model cannot be integrated.
    """
    with ThreadPoolExecutor(workers) as pool:
        problem = Problem(model, experiments, study, pool)
        # Moves from where the fit begins: the first trust region then has the size of the residual, not of ln ω.
        start = np.zeros(problem.origin.size)
        if problem.point(start) is None:
            raise SolverFailed(f"{model.element.name}: the first model cannot be integrated")
        found = least_squares(
            problem.residual, start, jac=problem.slopes, x_scale="jac", ftol=_TOLERANCE, xtol=_MOVED, gtol=None,
            max_nfev=iterations,
        )  # fmt: skip
        best = problem.point(found.x)
    assert best is not None
    return ModalFit(best.model, best.shapes, study.dt, float(2.0 * found.cost / len(experiments)))
