"""Fit modal models to experiments."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from phnn.errors import SolverFailed
from phnn.modal.experiment import Experiment, Study
from phnn.modal.model import ModalModel, Seen

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# For given modes, ports and elements the outputs are linear in the shapes (c, d, g), which are solved for (Golub &
# Pereyra 1973); derivatives leave out how the shapes follow (Kaufman 1975).


# What a small change of the extension changes at an element is described by ``δe_j = κ_j(s) δx_j`` with
#
#     κ_j(s) = κ_j0 + i κ_j1 + s κ_j2,
#
# the real coefficients of which come from the element's own response by least squares (describing function for random
# excitation: Booton 1954; Pintelon & Schoukens 2012, ch. 3). The loop through modes and ports is then closed exactly,
#
#     δx = (1 + Z κ)⁻¹ δx⁰,     Z_jl = Σ_i b_ij H_i b_il,
#
# so that derivatives are exact for a linear model and good to a share of what the element feeds back otherwise.
def output_slopes(model: ModalModel, seen: Seen, shapes: Array, dt: float) -> Complex:
    """(F, O, K) derivatives of the outputs behind their delays by ln ω, ln ζ, b, delays in samples and ln k.

    Args:
        shapes: (O, 2 M + P), held fast.
    """
    modes, ports = model.b.shape
    s, h = seen.s, model.transfer(seen.s)
    observed = shapes[:, :modes] + shapes[:, modes : 2 * modes] * seen.rate[:, None, None]
    kappa = _equivalent(model, seen)
    z = np.einsum("ij,fi,il->fjl", model.b, h, model.b, optimize=True)
    loop = np.linalg.inv(np.eye(ports) + z * kappa[:, None, :])
    by_force = np.einsum("foi,fi,ij->foj", observed, h, model.b, optimize=True) + shapes[:, 2 * modes :]
    # What an extension that is added from outside does to the outputs, through the elements.
    by_extension = -np.einsum("fol,fl,flj->foj", by_force, kappa, loop, optimize=True)
    by_mode = observed + by_extension @ model.b.T
    pulled = seen.force @ model.b.T
    denominator = s[:, None] ** 2 + 2.0 * model.zeta * model.omega * s[:, None] + model.omega**2
    damping = 2.0 * model.zeta * model.omega * s[:, None] / denominator
    omega = by_mode * (h * (2.0 - damping - 2.0 * model.omega**2 / denominator) * pulled)[:, None, :]
    zeta = by_mode * (-h * damping * pulled)[:, None, :]
    b = np.einsum("foi,fi,fj->foij", by_mode, h, seen.force, optimize=True)
    b = b + by_extension[:, :, None, :] * seen.q[:, None, :, None]
    outputs = seen.columns @ shapes.T
    delay = np.einsum("fo,op->fop", -s[:, None] * dt * outputs, np.eye(len(shapes)))
    closed = by_force + by_extension @ z
    k = -closed[:, :, :, None] * (model.k * seen.parts)[:, None, :, :]
    size = (len(s), len(shapes), -1)
    every = np.concatenate([omega, zeta, b.reshape(size), delay, k.reshape(size)], axis=2)
    return np.asarray(every * np.exp(-s[:, None] * model.delay)[:, :, None])


def _equivalent(model: ModalModel, seen: Seen) -> Complex:
    """(F, P) what an element answers to a change of its extension."""
    x, e = seen.q @ model.b, (model.k * seen.parts).sum(axis=2)
    found = np.zeros(x.shape, dtype=complex)
    if not model.k.size:
        return found
    basis = np.stack([np.ones_like(seen.s), 1j * np.ones_like(seen.s), seen.rate], axis=1)
    for j in range(x.shape[1]):
        columns = basis * x[:, j : j + 1]
        stacked = np.concatenate([columns.real, columns.imag])
        answer = np.concatenate([e[:, j].real, e[:, j].imag])
        found[:, j] = basis @ np.linalg.lstsq(stacked, answer, rcond=None)[0]
    return found


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
