"""Fit modal models to experiments, line by line.

For given modes and ports the outputs are linear in the shapes (c, d, g), which are solved for (Golub & Pereyra 1973);
derivatives leave out how the shapes and the mean squares at the ports follow (Kaufman 1975).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, null_space
from scipy.optimize import least_squares

from phnn.errors import SolverFailed
from phnn.modal.experiment import Experiment, Study
from phnn.modal.model import ModalModel, Steady
from phnn.models.modal import modal
from phnn.network.elements import Network
from phnn.recordings.recording import Units

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Ridge of the shapes over their own scale; the error of each experiment for a model without a steady state.
_RIDGE, _FAILED = 1e-11, 30.0
_LOGS, _DAMPING = (-40.0, 20.0), (-14.0, float(np.log(0.9)))
_HALF = float(np.sqrt(2.0))
# Relative changes of the sum of squares and of the parameters at which a fit ends.
_TOLERANCE, _MOVED = 3e-5, 1e-6


@dataclass(frozen=True, eq=False)
class Point:
    """A model, what it does in every experiment, and the shapes that leave least.

    Attributes:
        steady, columns: by experiment; later: (L, O) delays of the outputs; factor: inverse of the normal matrix.
    """

    model: ModalModel
    steady: tuple[Steady, ...]
    columns: tuple[Complex, ...]
    later: Complex
    shapes: Array
    factor: Array


class Problem:
    """Each experiment counts by its error over the measured motion.

    Args:
        model: where moves begin; pool: threads, one experiment each.
    """

    def __init__(
        self, model: ModalModel, experiments: Sequence[Experiment], study: Study, pool: ThreadPoolExecutor
    ) -> None:
        self.template, self.experiments, self.study, self.pool = model, experiments, study, pool
        logs = np.log(np.maximum(model.springs, 1e-300))
        self.origin = np.concatenate(
            [np.log(model.omega), np.log(model.zeta), model.b.ravel(), model.delay / study.dt, logs]
        )
        # The shapes of a linear model absorb the size of each row of ratios: these rows move across themselves alone.
        rows = [null_space(row[None]) if not logs.size else np.eye(row.size) for row in model.b]
        self.free = block_diag(np.eye(2 * model.omega.size), *rows, np.eye(model.delay.size + logs.size))
        # A mean square in time is twice the sum of squares of one half of the spectrum.
        self.wanted = [_HALF * np.fft.rfft(e.y, axis=0)[study.lines] / len(e.y) for e in experiments]
        self.scales = [1.0 / float(np.sqrt((np.abs(y) ** 2).sum())) for y in self.wanted]
        self._last: tuple[Array, Point | None] = (np.full(0, np.nan), None)

    def unpack(self, moved: Array) -> ModalModel:
        """The model that a move from the first one leads to; every one has positive energies, losses and springs."""
        m, shape = self.template.omega.size, self.template.b.shape
        sizes = np.cumsum([m, m, shape[0] * shape[1], self.template.delay.size])
        omega, zeta, b, delay, logs = np.split(self.origin + self.free @ moved, sizes)
        return replace(
            self.template,
            omega=np.exp(omega),
            zeta=np.exp(np.clip(zeta, *_DAMPING)),
            b=b.reshape(shape),
            delay=delay * self.study.dt,
            springs=np.exp(np.clip(logs, *_LOGS)),
        )

    def point(self, moved: Array) -> Point | None:
        """Return the model after a move; None if it has no steady state."""
        if not np.array_equal(self._last[0], moved):
            self._last = moved.copy(), self._point(self.unpack(moved))
        return self._last[1]

    def _point(self, model: ModalModel) -> Point | None:
        try:
            steady = tuple(self.pool.map(partial(self._steady, model), self.experiments))
        except SolverFailed:
            return None
        size = model.b.shape[1] + 2 * model.omega.size
        normal, right = np.zeros((size, size)), np.zeros((size, model.delay.size))
        columns, later = tuple(one.columns for one in steady), np.exp(-steady[0].s[:, None] * model.delay)
        for a, y, w in zip(columns, self.wanted, self.scales, strict=True):
            normal = normal + w * w * (a.conj().T @ a).real
            # The delay is taken from the measured side, where it changes no normal matrix.
            right = right + w * w * (a.conj().T @ (y * later.conj())).real
        scale = np.sqrt(np.diag(normal)) + 1e-300
        factor = np.linalg.inv(normal / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)) / np.outer(scale, scale)
        return Point(model, steady, columns, later, (factor @ right).T, factor)

    def _steady(self, model: ModalModel, experiment: Experiment) -> Steady:
        return model.steady(experiment, self.study.dt).at(self.study.lines, _HALF / len(experiment.u))

    def residual(self, moved: Array) -> Array:
        """(R,) real and imaginary parts on all excited lines of all experiments."""
        point = self.point(moved)
        if point is None:
            return np.full(2 * sum(y.size for y in self.wanted), _FAILED / np.sqrt(self.wanted[0].size))
        left = [
            w * ((a @ point.shapes.T) * point.later - y)
            for a, y, w in zip(point.columns, self.wanted, self.scales, strict=True)
        ]
        return np.concatenate([np.stack([x.real, x.imag], axis=2).ravel() for x in left])

    def slopes(self, moved: Array) -> Array:
        """(R, K) derivatives of the residual."""
        point = self.point(moved)
        assert point is not None
        slope = [point.model.slopes(one, point.shapes, self.study.dt) for one in point.steady]
        for o in range(len(point.shapes)):
            delayed = [a * point.later[:, o : o + 1] for a in point.columns]
            # What the shapes can do as well.
            pull = sum(w * w * (a.conj().T @ d[:, o]).real for a, d, w in zip(delayed, slope, self.scales, strict=True))
            follow = point.factor @ pull
            for a, d in zip(delayed, slope, strict=True):
                d[:, o] -= a @ follow
        rows = [w * np.stack([d.real, d.imag], axis=2) for d, w in zip(slope, self.scales, strict=True)]
        return np.concatenate([r.reshape(-1, len(self.origin)) for r in rows]) @ self.free


@dataclass(frozen=True, eq=False)
class ModalFit:
    """A model with the shapes of its outputs.

    Attributes:
        model: the fitted one; shapes: (O, 2 M + P) of q, q̇ and forces in each output, see `phnn.modal.model.Steady`.
        dt: s; cost: what is left of the fitted experiments, over what was measured, squared and averaged.
        inputs, outputs: names in their order; units: of both.
    """

    model: ModalModel
    shapes: Array
    dt: float
    cost: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: Units

    def to_network(self) -> Network:
        """Build the ordinary network of the modes, with the names of inputs and outputs; see `phnn.models.modal`.

            model = phnn.Model(phnn.Setup(phnn.load("out/modes/model").to_network()))

        What is slow at the ports follows the period before, which no network knows, and is left out. So are delays,
        rates and forces in the outputs.
        """
        shapes = dict(zip(self.outputs, self.shapes[:, : self.model.omega.size], strict=True))
        return modal(
            self.model.omega, self.model.zeta, self.model.b, self.inputs, self.units.input, shapes, self.units.output
        )

    def predict(self, experiment: Experiment) -> Array:
        """(N, O) outputs of an experiment, without their means."""
        steady = self.model.steady(experiment, self.dt)
        spectrum = (steady.columns @ self.shapes.T) * np.exp(-steady.s[:, None] * self.model.delay)
        spectrum[0] = 0.0
        return np.asarray(np.fft.irfft(spectrum, len(experiment.u), axis=0))

    def errors(self, experiments: Sequence[Experiment]) -> Array:
        """(O,) root mean square error over all recorded periods of some experiments."""
        squares = [((e.y - self.predict(e)) ** 2).mean(axis=0) + e.spread**2 for e in experiments]
        return np.asarray(np.sqrt(np.mean(squares, axis=0)))


def fit_modes(
    model: ModalModel, experiments: Sequence[Experiment], study: Study, iterations: int, workers: int = 1
) -> ModalFit:
    """Fit a model to experiments.

    Args:
        model: to begin with.
        iterations: how often all experiments may be simulated.
        workers: threads.

    Raises:
        SolverFailed: the first model has no steady state.
    """
    with ThreadPoolExecutor(workers) as pool:
        problem = Problem(model, experiments, study, pool)
        # Moves from where the fit begins: the first trust region then has the size of the residual, not of ln ω.
        start = np.zeros(problem.free.shape[1])
        if problem.point(start) is None:
            raise SolverFailed("the first model of the modes has no steady state: look at the recordings")
        result = least_squares(
            problem.residual, start, jac=problem.slopes, x_scale="jac", ftol=_TOLERANCE, xtol=_MOVED, gtol=None,
            max_nfev=iterations,
        )  # fmt: skip
        best = problem.point(result.x)
    assert best is not None
    cost = float(2.0 * result.cost / len(experiments))
    return ModalFit(best.model, best.shapes, study.dt, cost, study.inputs, study.outputs, study.units)
