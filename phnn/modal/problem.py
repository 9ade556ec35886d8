"""Residuals of experiments as a function of one vector, with what is linear in the outputs projected out.

For given modes, ports and elements the outputs are linear in the shapes (c, d, g), which are solved for (Golub &
Pereyra 1973); derivatives leave out how the shapes follow (Kaufman 1975).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phnn.errors import SolverFailed
from phnn.modal.experiment import Experiment, Study
from phnn.modal.model import ModalModel, Seen
from phnn.modal.slopes import output_slopes

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Ridge of the shapes over their own scale; the error of each experiment for a model that cannot be integrated.
_RIDGE, _FAILED = 1e-11, 30.0
_LOGS, _DAMPING = (-40.0, 20.0), (-14.0, float(np.log(0.9)))
_HALF = float(np.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class Point:
    """A model, what it does in every experiment, and the shapes that leave least.

    Attributes:
        seen, columns: by experiment; later: (L, O) delays of the outputs; factor: inverse of the normal matrix.
    """

    model: ModalModel
    seen: tuple[Seen, ...]
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
        logs = np.log(np.maximum(model.k, 1e-300)).ravel()
        self.origin = np.concatenate(
            [np.log(model.omega), np.log(model.zeta), model.b.ravel(), model.delay / study.dt, logs]
        )
        # A mean square in time is twice the sum of squares of one half of the spectrum.
        self.wanted = [_HALF * np.fft.rfft(e.y, axis=0)[study.lines] / len(e.y) for e in experiments]
        self.weights = [1.0 / float(np.sqrt((np.abs(y) ** 2).sum())) for y in self.wanted]
        self._last: tuple[Array, Point | None] = (np.full(0, np.nan), None)

    def unpack(self, moved: Array) -> ModalModel:
        """The model that a move from the first one leads to; every one has positive energies, losses and weights."""
        z = self.origin + moved
        m, shape = self.template.omega.size, self.template.b.shape
        omega, zeta, b, delay, k = np.split(z, np.cumsum([m, m, shape[0] * shape[1], self.template.delay.size]))
        return replace(
            self.template,
            omega=np.exp(omega),
            zeta=np.exp(np.clip(zeta, *_DAMPING)),
            b=b.reshape(shape),
            delay=delay * self.study.dt,
            k=np.exp(np.clip(k, *_LOGS)).reshape(self.template.k.shape),
        )

    def point(self, moved: Array) -> Point | None:
        """Return the model after a move; None if it cannot be integrated."""
        if not np.array_equal(self._last[0], moved):
            self._last = moved.copy(), self._point(self.unpack(moved))
        return self._last[1]

    def _point(self, model: ModalModel) -> Point | None:
        try:
            seen = tuple(self.pool.map(partial(self._seen, model), self.experiments))
        except SolverFailed:
            return None
        size = model.b.shape[1] + 2 * model.omega.size
        normal, right = np.zeros((size, size)), np.zeros((size, model.delay.size))
        columns, later = tuple(one.columns for one in seen), np.exp(-seen[0].s[:, None] * model.delay)
        for a, y, w in zip(columns, self.wanted, self.weights, strict=True):
            normal = normal + w * w * (a.conj().T @ a).real
            # The delay is taken from the measured side, where it changes no normal matrix.
            right = right + w * w * (a.conj().T @ (y * later.conj())).real
        scale = np.sqrt(np.diag(normal)) + 1e-300
        factor = np.linalg.inv(normal / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)) / np.outer(scale, scale)
        return Point(model, seen, columns, later, (factor @ right).T, factor)

    def _seen(self, model: ModalModel, experiment: Experiment) -> Seen:
        return model.seen(experiment, self.study.dt).at(self.study.lines, _HALF / len(experiment.u))

    def residual(self, moved: Array) -> Array:
        """(R,) real and imaginary parts on all excited lines of all experiments."""
        point = self.point(moved)
        if point is None:
            return np.full(2 * sum(y.size for y in self.wanted), _FAILED / np.sqrt(self.wanted[0].size))
        left = [
            w * ((a @ point.shapes.T) * point.later - y)
            for a, y, w in zip(point.columns, self.wanted, self.weights, strict=True)
        ]
        return np.concatenate([np.stack([x.real, x.imag], axis=2).ravel() for x in left])

    def slopes(self, moved: Array) -> Array:
        """(R, K) derivatives of the residual."""
        point = self.point(moved)
        assert point is not None
        slope = [output_slopes(point.model, one, point.shapes, self.study.dt) for one in point.seen]
        for o in range(len(point.shapes)):
            delayed = [a * point.later[:, o : o + 1] for a in point.columns]
            # What the shapes can do as well.
            pull = sum(
                w * w * (a.conj().T @ d[:, o]).real for a, d, w in zip(delayed, slope, self.weights, strict=True)
            )
            follow = point.factor @ pull
            for a, d in zip(delayed, slope, strict=True):
                d[:, o] -= a @ follow
        rows = [w * np.stack([d.real, d.imag], axis=2) for d, w in zip(slope, self.weights, strict=True)]
        return np.concatenate([r.reshape(-1, moved.size) for r in rows])
