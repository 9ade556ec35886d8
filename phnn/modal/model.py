"""The modal model: its steady state under a periodic input, its fit, its file and its predictions.

    q̈_i/ω_i² + 2ζ_i q̇_i/ω_i + q_i = Σ_j b_ij f_j,     x_j = Σ_i b_ij q_i
    f_j = u_j − k_j φ_j x_j,     φ_j = 1/(1 + ⟨x_j²⟩/r_j²)

``⟨x²⟩`` is the mean square over a period: the springs soften slowly, as those of a material that warms. Within a
period the structure is linear, so that the loop through modes and ports is closed line by line,

    x = (1 + Z κ)⁻¹ Z u,     Z_jl(s) = Σ_i b_ij H_i(s) b_il,     κ_j = k_j φ_j,

where x and ``φ`` are solved for together. Springs are never negative: the model is passive in every steady cycle.

It is fitted line by line. For given modes and ports the outputs are linear in the shapes (c, d, g), which are solved
for (Golub & Pereyra 1973). Derivatives leave out how shapes and mean squares at the ports follow (Kaufman 1975).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import block_diag, null_space
from scipy.optimize import least_squares, root

from phnn.errors import InputRefused, SolverFailed
from phnn.modal.experiment import Experiment, Study, experiment_of, experiments_of
from phnn.models.actuator import modal
from phnn.models.store import a_list, a_name, a_number, a_tensor, an_object
from phnn.network.elements import Network
from phnn.prediction import Predicted
from phnn.recordings.manifest import shown
from phnn.recordings.recording import Campaign, Recording, Units
from phnn.results import printable

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SCHEMA = "phnn.modal-model/3"

# Unit of rates in the shapes of outputs [rad/s].
RATE = 2e3 * np.pi
# Largest change of ``φ`` over a period in the steady state: the target, and what is accepted.
_SETTLED, _TOLERABLE = 1e-12, 1e-8
# Further starts of the search for a steady state.
_STARTS = 30
# A held input has images about the multiples of the sampling rate, which modes fold back; those up to this one count.
_IMAGES = 8


class Steady(NamedTuple):
    """Spectra of one period in the steady state, on all lines or on some.

    Attributes:
        s: (F,) rad/s; q: (F, M) modes; x: (F, P) extensions of the ports; force: (F, P) upon the modes.
        kappa: (P,) stiffness ``k φ`` of the ports.
    """

    s: Complex
    q: Complex
    x: Complex
    force: Complex
    kappa: Array

    @property
    def columns(self) -> Complex:
        """Return (F, 2 M + P) what outputs are made of: q, q̇ over the reference rate, and forces."""
        return np.concatenate([self.q, self.q * (self.s / RATE)[:, None], self.force], axis=1)

    def at(self, lines: NDArray[np.int64], scale: float) -> Steady:
        """Return the steady state on some lines only, with the motion in other units."""
        q, x, force = (scale * a[lines] for a in (self.q, self.x, self.force))
        return Steady(self.s[lines], q, x, force, self.kappa)


@dataclass(frozen=True, eq=False)
class ModalModel:
    """Modes with slow springs at the ports; the output shapes are fitted separately.

    Attributes:
        omega, zeta: (M,) natural frequencies [rad/s] and damping ratios.
        b: (M, P) ratios between modes and ports, over the square root of a mode's static compliance.
        delay: (O,) of the outputs [s].
        springs: (P,) stiffness k of the slow springs; (0,) for the linear model.
        reach: (P,) extension r at which a spring has half of its stiffness.
    """

    omega: Array
    zeta: Array
    b: Array
    delay: Array
    springs: Array
    reach: Array

    def transfer(self, s: Complex) -> Complex:
        """Return (F, M) ``H_i``: the modes by the force upon each."""
        return np.asarray(self.omega**2 / (s[:, None] ** 2 + 2.0 * self.zeta * self.omega * s[:, None] + self.omega**2))

    def impedance(self, s: Complex) -> Complex:
        """Return (F, P, P) ``Z``: the extensions of the ports by the forces upon the modes."""
        return np.asarray((self.b.T * self.transfer(s)[:, None, :]) @ self.b)

    def steady(self, experiment: Experiment, dt: float) -> Steady:
        """Return the steady state under the inputs of an experiment.

        Raises:
            SolverFailed: no steady state was found.
        """
        n = len(experiment.u)
        f = np.asarray(np.fft.rfftfreq(n, dt), dtype=np.float64)
        u = np.asarray(np.fft.rfft(experiment.u, axis=0), dtype=np.complex128)
        images = range(-_IMAGES, _IMAGES + 1) if experiment.zero_order else (0,)
        shifted = [f + m / dt for m in images]
        drives = [u]
        if experiment.zero_order:
            # By the spectrum of a value that is held for a sampling interval.
            drives = [u * (np.sinc(g * dt) * np.exp(-1j * np.pi * g * dt))[:, None] for g in shifted]
        rates = [np.asarray(2j * np.pi * g, dtype=np.complex128) for g in shifted]
        impedances = [self.impedance(s) for s in rates]

        def extended(kappa: Array) -> list[Complex]:
            return [_closed(z, kappa, d) for z, d in zip(impedances, drives, strict=True)]

        def change(softened: Array) -> Array:
            x = np.sum(extended(self.springs * softened), axis=0)
            square = 2.0 * (np.abs(x[1:]) ** 2).sum(axis=0) / n**2
            return np.asarray(1.0 / (1.0 + square / self.reach**2) - softened)

        kappa = np.zeros(self.b.shape[1])
        if self.springs.size:
            # The map of [0, 1]^P into itself has a fixed point (Brouwer); Newton's method may miss it from one start.
            further = np.random.default_rng(0).random((_STARTS, kappa.size))
            for start in (1.0 + change(np.ones_like(kappa)), *further):
                softened = root(change, start, tol=_SETTLED).x
                if np.abs(change(softened)).max() <= _TOLERABLE:
                    break
            else:
                raise SolverFailed(f"{experiment.name}: the ports of the modes come to no steady state")
            kappa = self.springs * softened
        x = extended(kappa)
        forces = [d - kappa * a for d, a in zip(drives, x, strict=True)]
        q = np.sum([self.transfer(s) * (g @ self.b.T) for s, g in zip(rates, forces, strict=True)], axis=0)
        middle = len(images) // 2
        return Steady(rates[middle], q, np.sum(x, axis=0), forces[middle], kappa)

    def slopes(self, steady: Steady, shapes: Array, dt: float) -> Complex:
        """Return (F, O, K) derivatives of delayed outputs by ln ω, ln ζ, b, delays in samples and ln k, ``φ`` fixed.

        Args:
            shapes: (O, 2 M + P), held fast.
        """
        modes, ports = self.b.shape
        s, h = steady.s, self.transfer(steady.s)
        observed = shapes[:, :modes] + shapes[:, modes : 2 * modes] * (s / RATE)[:, None, None]
        z = self.impedance(s)
        loop = np.linalg.inv(np.eye(ports) + z * steady.kappa)
        by_force = (observed * h[:, None, :]) @ self.b + shapes[:, 2 * modes :]
        # What an extension that is added from outside does to the outputs, through the springs.
        by_extension = -(by_force * steady.kappa) @ loop
        by_mode = observed + by_extension @ self.b.T
        pulled = steady.force @ self.b.T
        denominator = s[:, None] ** 2 + 2.0 * self.zeta * self.omega * s[:, None] + self.omega**2
        damping = 2.0 * self.zeta * self.omega * s[:, None] / denominator
        omega = by_mode * (h * (2.0 - damping - 2.0 * self.omega**2 / denominator) * pulled)[:, None, :]
        zeta = by_mode * (-h * damping * pulled)[:, None, :]
        b = (by_mode * h[:, None, :])[:, :, :, None] * steady.force[:, None, None, :]
        b = b + by_extension[:, :, None, :] * steady.q[:, None, :, None]
        delay = (-s[:, None] * dt * (steady.columns @ shapes.T))[:, :, None] * np.eye(len(shapes))
        springs = -(by_force + by_extension @ z) * (steady.kappa * steady.x)[:, None, :]
        every = np.concatenate([omega, zeta, b.reshape(*by_force.shape[:2], -1), delay, springs], axis=2)
        every = every[:, :, : every.shape[2] - ports + self.springs.size]
        return np.asarray(every * np.exp(-s[:, None] * self.delay)[:, :, None])


def _closed(z: Complex, kappa: Array, drive: Complex) -> Complex:
    """Return (F, P) extensions in the closed loop."""
    moved = np.einsum("fjl,fl->fj", z, drive)
    if not kappa.any():
        return np.asarray(moved)
    return np.asarray(np.linalg.solve(np.eye(z.shape[1]) + z * kappa, moved[:, :, None])[:, :, 0])


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
        """Return the model after a move from the first one; every one has positive energies, losses and springs."""
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
            every = self.pool.map(lambda one: (model.steady(one, self.study.dt), len(one.u)), self.experiments)
            steady = tuple(response.at(self.study.lines, _HALF / size) for response, size in every)
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

    def residual(self, moved: Array) -> Array:
        """Return (R,) real and imaginary parts on all excited lines of all experiments."""
        point = self.point(moved)
        if point is None:
            return np.full(2 * sum(y.size for y in self.wanted), _FAILED / np.sqrt(self.wanted[0].size))
        errors = [
            w * ((a @ point.shapes.T) * point.later - y)
            for a, y, w in zip(point.columns, self.wanted, self.scales, strict=True)
        ]
        return np.concatenate([np.stack([x.real, x.imag], axis=2).ravel() for x in errors])

    def slopes(self, moved: Array) -> Array:
        """Return (R, K) derivatives of the residual."""
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
        """Return (N, O) outputs of an experiment, without their means."""
        steady = self.model.steady(experiment, self.dt)
        spectrum = (steady.columns @ self.shapes.T) * np.exp(-steady.s[:, None] * self.model.delay)
        spectrum[0] = 0.0
        return np.asarray(np.fft.irfft(spectrum, len(experiment.u), axis=0))

    def errors(self, experiments: Sequence[Experiment]) -> Array:
        """Return (O,) root mean square error over all recorded periods of some experiments."""
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


def model_document(fit: ModalFit) -> dict[str, Any]:
    """Return all that is needed to simulate the model again, SI."""
    m = fit.model
    return {
        "schema": SCHEMA,
        "inputs": list(fit.inputs),
        "outputs": list(fit.outputs),
        "units": fit.units._asdict(),
        "dt_s": fit.dt,
        "frequency_Hz": (m.omega / (2.0 * np.pi)).tolist(),
        "damping_ratio": m.zeta.tolist(),
        "ports": m.b.tolist(),
        "delay_s": m.delay.tolist(),
        "springs": m.springs.tolist(),
        "reach": m.reach.tolist(),
        "shapes": fit.shapes.tolist(),
        "left_of_fitted": float(np.sqrt(fit.cost)),
    }


def model_from(document: Mapping[str, Any]) -> ModalFit:
    """Return the model of a document; what is returned is passive at its ports, whatever the document says.

    Raises:
        InputRefused: it is not such a document, something in it is missing, or a value lies outside its domain.
    """
    if document.get("schema") != SCHEMA:
        raise InputRefused(f"schema {shown(document.get('schema'))} is not {SCHEMA!r}: give a file of phnn modes")
    try:
        return _model(document)
    except KeyError as error:
        raise InputRefused(f"the model is incomplete (no {error}): run phnn modes again") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise InputRefused(f"the model is damaged ({printable(str(error))}): run phnn modes again") from error


def _model(document: Mapping[str, Any]) -> ModalFit:
    inputs, outputs = (tuple(a_name(n, x) for n in a_list(document[x], x)) for x in ("inputs", "outputs"))
    units = Units(**{end: a_name(unit, end) for end, unit in an_object(document["units"], "units").items()})
    modes, ports = len(a_list(document["frequency_Hz"], "frequency_Hz")), len(inputs)
    if not modes or not ports or not outputs:
        raise ValueError("a model has one mode, one input and one output at least")
    frequency, zeta = _numbers(document, "frequency_Hz", modes), _numbers(document, "damping_ratio", modes)
    springs = _numbers(document, "springs", ports if document["springs"] else 0)
    reach, dt = _numbers(document, "reach", ports), a_number(document["dt_s"], "dt_s")
    if frequency.min() <= 0.0 or not 0.0 < zeta.min() <= zeta.max() < 1.0:
        raise ValueError("frequencies are positive and damping ratios lie between 0 and 1")
    if (springs < 0.0).any() or reach.min() <= 0.0 or dt <= 0.0:
        raise ValueError("springs are 0 or more, reach and dt_s are positive")
    delay = _numbers(document, "delay_s", len(outputs))
    model = ModalModel(2.0 * np.pi * frequency, zeta, _numbers(document, "ports", modes, ports), delay, springs, reach)
    shapes = _numbers(document, "shapes", len(outputs), 2 * modes + ports)
    cost = a_number(document["left_of_fitted"], "left_of_fitted") ** 2
    return ModalFit(model, shapes, dt, cost, inputs, outputs, units)


def _numbers(document: Mapping[str, Any], name: str, *shape: int) -> Array:
    """Return finite numbers of a given shape. Raises ValueError otherwise."""
    numbers = a_tensor(document[name], name).numpy()
    if numbers.shape != shape:
        raise ValueError(f"{name} has the shape {numbers.shape} where {shape} belongs")
    return numbers


def predicted_modes(fit: ModalFit, campaign: Campaign) -> tuple[Predicted, ...]:
    """Predict every recording of a folder in the periodic steady state, in the order of the campaign.

    A modal model says nothing about the mean of an output: where one was recorded, the prediction takes it over, and
    all samples are scored. Nothing else of the recorded output is used.

    Raises:
        InputRefused: a recording is not periodic, or its inputs, outputs or units are not those of the model.
        SolverFailed: the model has no steady state.
    """
    known: dict[str, Predicted] = {}
    for views in experiments_of(campaign).values():
        _check(fit, views)
        first = views[0]
        period = replace(fit, dt=first.dt).predict(experiment_of(first.name, views))
        known |= {r.name: _one(r, period, fit, r.name in campaign.held_out) for r in views}
    return tuple(known[r.name] for r in campaign.recordings)


def _one(recording: Recording, period: Array, fit: ModalFit, held_out: bool) -> Predicted:
    """Return one recorded output, or all outputs of the model side by side where none was recorded."""
    repeated = np.resize(period, (recording.t.size, period.shape[1]))
    if not np.isfinite(recording.y).all():
        unit = fit.units.output.replace(" ", "")
        table = pd.DataFrame(
            {"time_s": recording.t} | {f"{n}_{unit}": y for n, y in zip(fit.outputs, repeated.T, strict=True)}
        )
        return Predicted(recording, repeated[:, 0], table, held_out, whole=True)
    y = repeated[:, fit.outputs.index(recording.measures or "output")] + recording.y.mean()
    unit = recording.units.output
    column = "displacement_m" if unit == "m" else f"output_{unit.replace(' ', '')}"
    return Predicted(recording, y, pd.DataFrame({"time_s": recording.t, column: y}), held_out, whole=True)


def _check(fit: ModalFit, views: Sequence[Recording]) -> None:
    """Refuse recordings with other inputs, outputs or units than the model has."""
    first = views[0]
    recorded = [r for r in views if np.isfinite(r.y).all()]
    inputs, outputs = ("input", *first.further), [r.measures or "output" for r in recorded]
    if inputs != fit.inputs:
        raise InputRefused(
            f"{first.source}: inputs {', '.join(inputs)}, where the model has {', '.join(fit.inputs)}: name the "
            f"ports in recordings.yaml as they were named when the model was fitted"
        )
    if unknown := [o for o in outputs if o not in fit.outputs]:
        raise InputRefused(
            f"{first.source}: outputs {', '.join(unknown)}, where the model has {', '.join(fit.outputs)}: name "
            f"the outputs in recordings.yaml as they were named when the model was fitted"
        )
    if recorded and first.units != fit.units:
        raise InputRefused(
            f"{first.source}: {first.units.output} by {first.units.input}, where the model gives "
            f"{fit.units.output} by {fit.units.input}: correct the units in recordings.yaml"
        )
