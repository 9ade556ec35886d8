"""The best linear model on a grid, from which networks begin.

From random weights some thousand updates go by before a network has found that the output follows the input; a linear
start is usual (Schoukens, Tóth 2020, On the initialization of nonlinear LFR model identification with the best linear
approximation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, lfilter_zi

from phnn.errors import SolverFailed
from phnn.recordings.recording import Recording
from studies.rival_models.budget import Budget
from studies.rival_models.dynamics import Dynamics, free_responses
from studies.rival_models.grid import Gridded
from studies.rival_models.operators import Static
from studies.rival_models.samples import Mask, Scales
from studies.rival_models.separable import STARTS, Structure, fit_structure

Array = NDArray[np.float64]

_SHARE = 0.1  # of the budget
_LAGS = 1
_FIRST = 100  # grid samples that tell an unknown start


@dataclass(frozen=True)
class Linear:
    """Scaled output of a scaled input on the grid: numerator ``b`` and denominator ``a`` in z⁻¹, third order."""

    b: Array
    a: Array

    def rest(self, u: float) -> Array:
        """The filter's state after a rest at a scaled input."""
        return np.asarray(lfilter_zi(self.b, self.a) * u)

    def run(self, u: Array, state: Array) -> tuple[Array, Array]:
        """(N,) outputs, and the state behind them."""
        y, state = lfilter(self.b, self.a, u, zi=state)
        return np.asarray(y), np.asarray(state)

    def start(self, g: Gridded) -> Array:
        """The filter's state in front of a recording: at rest, else the one that its first outputs tell best."""
        rest = self.rest(g.before)
        count = min(_FIRST, g.known)
        if g.rest or count < self.a.size or not np.isfinite(g.y[:count]).all():
            return rest
        missing = g.y[:count] - self.run(g.u[:count], rest)[0]
        # A constant beside the free responses: the recording's zero.
        columns = np.column_stack([free_responses(self.b, self.a, count), np.ones(count)])
        return np.asarray(rest + np.linalg.lstsq(columns, missing, rcond=1e-6)[0][:-1])

    def realised(self, grids: Sequence[Gridded]) -> tuple[Array, Array, Array, float]:
        """``A, B, C, D`` whose states have unit variance and no correlation under the inputs of the grids."""
        n = self.a.size - 1
        step = np.zeros((n, n))
        step[0], step[1:, :-1] = -self.a[1:], np.eye(n - 1)
        c = self.b[1:] - self.b[0] * self.a[1:]
        states = np.concatenate([companion_states(self.a, g.u) for g in grids])
        _, sizes, axes = np.linalg.svd(states, full_matrices=False)
        sizes = np.maximum(sizes / np.sqrt(states.shape[0]), 1e-12 * sizes[0])
        to, back = axes.T * sizes, axes / sizes[:, None]
        return back @ step @ to, back[:, 0], c @ to, float(self.b[0])


def companion_states(a: Array, u: Array) -> Array:
    """(N, n) states of the controllable form before each sample, from zero."""
    first = np.concatenate([[0.0], lfilter([1.0], a, u)[:-1]])
    return np.column_stack([np.concatenate([np.zeros(k), first[: u.size - k]]) for k in range(a.size - 1)])


def linear_model(
    recordings: Sequence[Recording], masks: Sequence[Mask], scales: Scales, dt: float, budget: Budget
) -> Linear:
    """Fit second-order dynamics with one more lag to the masked samples, for inputs that are linear on the grid.

    Raises:
        SolverFailed: the time does not suffice for one evaluation.
    """
    structure = Structure(Static(1), Dynamics(_LAGS, scales.rate), scales)
    starts = [np.concatenate([np.log(start), structure.start[2:]]) for start in STARTS]
    found = fit_structure(structure, recordings, masks, starts, budget.part(_SHARE))
    if found is None:
        raise SolverFailed("no linear model was found within the budget: allow more time")
    b, a = structure.dynamics.filter(found.x, dt, held=False)
    return Linear(b * float(found.weights[0]) / scales.y, a)
