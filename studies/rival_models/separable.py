"""Models that are linear in their weights: an operator's columns, weighted and summed, drive linear dynamics.

    y = L_θ [Σ_k w_k φ_k(u; η)] + zero

For given dynamics θ and shape η the weights are a linear least-squares problem, non-negative where the operator asks
for it. Variable projection (Golub, Pereyra 2003) leaves a small nonlinear problem in (θ, η).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares, nnls
from scipy.signal import lfilter, lfilter_zi

from phnn.errors import SolverFailed
from phnn.recordings.recording import Recording
from studies.rival_models.budget import Budget, Spent
from studies.rival_models.dynamics import HELD, Dynamics, filtered, free_responses
from studies.rival_models.operators import Operator, warm
from studies.rival_models.rival import Fitted, Rival, State, Stepper, anchored
from studies.rival_models.samples import Mask, Scales, over_noise, scales_of, split

Array = NDArray[np.float64]

# Share of the budget for the choice of a size; the rest refits the chosen one to all identification samples.
_SEARCH = 0.7
_EVALUATIONS = 400
_EXCITED = 1e-2  # least norm of a column, over the largest, from which on the ridge is in proportion to it
_STEP = 1e-5  # of finite differences
# Further starts of the last fit, and the standard deviation of their parameters about the best ones.
_AGAIN, _SPREAD = 6, 0.5
_BLOCK = 10_000  # samples of a long run whose columns are held at once: some hundred columns are 20 MB
# Starts of the dynamics: ω over the highest excited frequency, ζ.
STARTS = ((4.0, 0.3), (1.0, 0.1), (0.1, 1.0))


@dataclass(frozen=True)
class Structure:
    """An operator before dynamics; parameters are those of the dynamics, then those of the operator's shape."""

    operator: Operator
    dynamics: Dynamics
    scales: Scales

    @property
    def start(self) -> Array:
        """(P,) where a fit begins."""
        return np.concatenate([self.dynamics.start, self.operator.start])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest values."""
        dynamics, shape = self.dynamics.bounds, self.operator.bounds
        return np.concatenate([dynamics[0], shape[0]]), np.concatenate([dynamics[1], shape[1]])

    def columns(self, x: Array, recording: Recording) -> Array:
        """``(N, K)`` columns behind the dynamics; a periodic recording is run through once before."""
        theta, shape = self.parted(x)
        u, before = recording.u / self.scales.u, recording.u[0] / self.scales.u
        if recording.start.state == "rest":
            before = recording.start.input_before / self.scales.u
        cycle = recording.cycle
        if cycle:
            u = np.concatenate([u[-cycle:], u])
        rates = np.abs(np.diff(u, prepend=before)) / (recording.dt * self.scales.rate)
        state = self.operator.rest(shape, float(before))
        rest, _ = self.operator.run(shape, state, np.array([before]), np.zeros(1))
        found, _ = self.operator.run(shape, state, u, rates)
        b, a = self.dynamics.filter(theta, recording.dt, recording.interpolation == HELD)
        return filtered(b, a, found, rest[0])[cycle:]

    def nuisance(self, x: Array, recording: Recording) -> Array:
        """``(N, order)`` free responses where the start is unknown, ``(N, 0)`` otherwise."""
        if recording.start.state != "unknown":
            return np.zeros((recording.t.size, 0))
        theta, _ = self.parted(x)
        b, a = self.dynamics.filter(theta, recording.dt, recording.interpolation == HELD)
        return free_responses(b, a, recording.t.size)

    def parted(self, x: Array) -> tuple[Array, Array]:
        """Parameters of the dynamics, and of the shape."""
        count = self.dynamics.start.size
        return x[:count], x[count:]


@dataclass(frozen=True)
class Separable(Fitted):
    """A fitted structure: parameters ``x`` (P,), weights (K,) in units of the output over those of the columns."""

    structure: Structure = None  # type: ignore[assignment]
    x: Array = None  # type: ignore[assignment]
    weights: Array = None  # type: ignore[assignment]

    @property
    def dt(self) -> float | None:
        return None

    def simulate(self, recording: Recording) -> Array:
        return np.asarray(self.structure.columns(self.x, recording) @ self.weights)

    def free(self, recording: Recording) -> Array:
        return self.structure.nuisance(self.x, recording)

    def stepper(self, dt: float) -> Stepper:
        return _Stepper(self, dt)


class _Stepper(Stepper):
    def __init__(self, fitted: Separable, dt: float) -> None:
        self.dt, self._fitted, self._scales = dt, fitted, fitted.structure.scales
        theta, self._shape = fitted.structure.parted(fitted.x)
        self._b, self._a = fitted.structure.dynamics.filter(theta, dt, held=False)
        self._operator = fitted.structure.operator

    def rest(self, u: float) -> State:
        x = u / self._scales.u
        state = self._operator.rest(self._shape, x)
        columns, _ = self._operator.run(self._shape, state, np.array([x]), np.zeros(1))
        return state, lfilter_zi(self._b, self._a) * float(columns[0] @ self._fitted.weights)

    def step(self, state: State, u: float) -> tuple[State, float]:
        inner, kept = state
        x = np.array([u / self._scales.u])
        rate = np.abs(x - inner[-1]) / (self.dt * self._scales.rate)
        columns, inner = self._operator.run(self._shape, inner, x, rate)
        y, kept = lfilter(self._b, self._a, columns @ self._fitted.weights, zi=kept)
        return (inner, kept), float(y[0])

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        (inner, kept), found = state, []
        for first in range(0, u.size, _BLOCK):
            x = u[first : first + _BLOCK] / self._scales.u
            rates = np.abs(np.diff(x, prepend=inner[-1])) / (self.dt * self._scales.rate)
            columns, inner = self._operator.run(self._shape, inner, x, rates)
            y, kept = lfilter(self._b, self._a, columns @ self._fitted.weights, zi=kept)
            found.append(y)
        return (inner, kept), np.concatenate(found)


class _Projection:
    """The residual over noise with the weights and every recording's zero and initial state at their best values."""

    def __init__(self, structure: Structure, recordings: Sequence[Recording], masks: Sequence[Mask], budget: Budget):
        pairs = [(r, m) for r, m in zip(recordings, masks, strict=True) if m.any()]
        self.structure, self.pairs, self.budget = structure, pairs, budget
        self.best: tuple[float, Array, Array] | None = None

    def __call__(self, x: Array) -> Array:
        """(M,) residual over noise."""
        self.budget.check()
        blocks, targets = [], []
        for r, mask in self.pairs:
            rows = np.column_stack([self.structure.columns(x, r)[mask], r.y[mask]]) / r.noise
            own = np.column_stack([np.ones(mask.sum()), self.structure.nuisance(x, r)[mask]])
            q = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
            rows -= q @ (q.T @ rows)
            blocks.append(rows[:, :-1])
            targets.append(rows[:, -1])
        weights = self._weights(blocks, targets)
        residual = np.concatenate([t - b @ weights for b, t in zip(blocks, targets, strict=True)])
        cost = float(residual @ residual) if np.isfinite(residual).all() else np.inf
        if np.isfinite(cost) and (self.best is None or cost < self.best[0]):
            self.best = cost, x.copy(), weights
        return np.nan_to_num(residual, nan=1e9, posinf=1e9, neginf=-1e9)

    def _weights(self, blocks: Sequence[Array], targets: Sequence[Array]) -> Array:
        gram = sum((b.T @ b for b in blocks), start=np.zeros((blocks[0].shape[1],) * 2))
        right = sum((b.T @ t for b, t in zip(blocks, targets, strict=True)), start=np.zeros(gram.shape[0]))
        # A column that these samples hardly excite is held by the ridge: elsewhere it may be large.
        sizes = np.sqrt(np.diag(gram))
        scale = np.maximum(sizes, max(_EXCITED * float(sizes.max()), 1e-300))
        gram, right = gram / np.outer(scale, scale), right / scale
        gram[np.diag_indices_from(gram)] += self.structure.operator.ridge
        try:
            root = cholesky(gram)
            if self.structure.operator.positive:
                found = nnls(root, solve_triangular(root, right, trans="T"), maxiter=10 * right.size)[0]
            else:
                found = solve_triangular(root, solve_triangular(root, right, trans="T"))
        except (np.linalg.LinAlgError, RuntimeError, ValueError):
            return np.full(right.size, np.nan)
        return np.asarray(found / scale)


def fit_structure(
    structure: Structure,
    recordings: Sequence[Recording],
    masks: Sequence[Mask],
    starts: Sequence[Array],
    budget: Budget,
) -> Separable | None:
    """The best parameters from several starts; None where no time was left for one evaluation that is finite."""
    projection = _Projection(structure, recordings, masks, budget)
    low, high = structure.bounds
    most = min(budget.most, _EVALUATIONS)
    try:
        for start in starts:
            inside = np.clip(start, low + 1e-9, high - 1e-9)
            least_squares(
                projection,
                inside,
                bounds=(low, high),
                diff_step=_STEP,
                x_scale=0.3,
                max_nfev=most,
                xtol=1e-6,
                ftol=1e-6,
            )
    except Spent:
        pass
    except (np.linalg.LinAlgError, ValueError) as error:
        if projection.best is None:
            raise SolverFailed(f"{structure.operator}: the fit failed ({error}): scale the recordings") from error
    if projection.best is None:
        return None
    _, x, weights = projection.best
    return Separable(x.size + int(np.count_nonzero(weights)), {}, structure, x, weights)


class SeparableRival(Rival):
    """A family of structures from small to large.

    Attributes:
        sizes: operator and number of lags of each.
    """

    sizes: Sequence[tuple[Operator, int]]

    def warm(self) -> None:
        warm()

    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted:
        scales, parts = scales_of(recordings), split(recordings)
        tried: list[tuple[float, Separable]] = []
        for k, (operator, lags) in enumerate(self.sizes):
            structure = Structure(operator, Dynamics(lags, scales.rate), scales)
            spare = budget.left - (1.0 - _SEARCH) * budget.seconds if np.isfinite(budget.seconds) else 0.0
            share = spare / (len(self.sizes) - k) / budget.left if budget.left and np.isfinite(budget.seconds) else 1.0
            if share <= 0.0:
                break
            starts = _starts(structure, tried)
            found = fit_structure(structure, recordings, parts.fit, starts, budget.part(share))
            if found is not None:
                outputs = [anchored(r, found.simulate(r), found.free(r)) for r in recordings]
                tried.append((over_noise(recordings, outputs, parts.check), found))
        if not tried:
            raise SolverFailed(f"{self.words}: no candidate was simulated within the budget: allow more time")
        score, best = min(tried, key=lambda t: t[0])
        last = fit_structure(best.structure, recordings, parts.both, _around(best, seed), budget)
        facts: dict[str, Any] = {
            "size": str(best.structure.operator), "lags": best.structure.dynamics.lags, "sizes_tried": len(tried),
            "check_over_noise": score, "processor_seconds": budget.used,
        }  # fmt: skip
        return replace(last or best, facts=facts)


def _around(best: Separable, seed: int) -> list[Array]:
    """Starts of the last fit: the best parameters, then random ones about them for as long as there is time."""
    rng = np.random.default_rng(seed)
    low, high = best.structure.bounds
    moved = (best.x + _SPREAD * rng.standard_normal(best.x.size) for _ in range(_AGAIN))
    return [best.x, *(np.clip(x, low, high) for x in moved)]


def _starts(structure: Structure, tried: Sequence[tuple[float, Separable]]) -> list[Array]:
    """The dynamics of the best size so far first; starts of its own for the first size."""
    if tried:
        best = min(tried, key=lambda t: t[0])[1]
        found = structure.start
        theta, shape = best.structure.parted(best.x)
        count = min(theta.size, structure.dynamics.start.size)
        found[:count] = theta[:count]
        if type(best.structure.operator) is type(structure.operator) and shape.size == structure.operator.start.size:
            found[structure.dynamics.start.size :] = shape
        return [found]
    starts = []
    for omega, zeta in STARTS:
        start = structure.start
        start[:2] = np.log(omega), np.log(zeta)
        starts.append(start)
    return starts
