"""Polynomial NARX with terms chosen by forward regression, then refined by the error of free simulation.

    y_k = y_{k−1} + Σ_j w_j Π_i v_i^{p_ij},   v = (y, u, Δu, |Δu|) or with (Δy, Δ²u) as well, Δ over a grid interval

Differences in place of lags span the same polynomials and are better conditioned on a fine grid. ``|Δu|`` lets a
polynomial have a hysteresis that does not depend on rate, as in a Duhem model (Martins, Aguirre 2016). Orthogonal
matching pursuit on the one-step error orders the terms (forward regression by orthogonal least squares, Billings 2013);
how many are kept, the grid and the degree are chosen by free simulation of the samples set aside; the weights then
follow from the error of free simulation (Piroddi, Spinelli 2003). The regression is scikit-learn's.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import least_squares

from phnn.errors import SolverFailed
from phnn.recordings.recording import Recording
from studies.rival_models.grid import Data, Gridded, GridStepper, OnGrid, data_on, interval
from studies.rival_models.names import needed
from studies.rival_models.rival import Budget, Fitted, Mask, Rival, Spent, State

Array = NDArray[np.float64]
Powers = NDArray[np.int64]

PER_PERIOD, DEGREES, TERMS = (12.0, 24.0, 48.0), (1, 2, 3), (3, 5, 8, 12, 18)
_SHORT, _LONG = 4, 6  # variables without and with Δy and Δ²u
_REST = 20_000  # samples within which an equilibrium is reached
_DIVERGED = 50.0  # scaled output that no stable model reaches
_HOPELESS, _UNSTABLE = 1e6, 1e9  # residual over noise of a candidate that is left out, and of one that diverged
_EVALUATIONS, _SEARCH = 60, 0.6  # of a refinement; share of the budget after which the search ends
_ROWS = 20_000  # of the one-step regression; more are thinned evenly


@njit(cache=True)
def _simulate(u: Array, start: Array, y: Array, powers: Powers, weights: Array, most: float) -> bool:
    """Simulate freely into ``y``; ``start`` holds the input before, the one before that, and two outputs alike.

    Returns False where an output left ``±most``.
    """
    v = np.zeros(6)
    last, older, now, previous = start
    for n in range(u.size):
        du = u[n] - last
        v[0], v[1], v[2], v[3], v[4], v[5] = now, u[n], du, abs(du), now - previous, du - (last - older)
        change = 0.0
        for j in range(weights.size):
            term = weights[j]
            for i in range(powers.shape[1]):
                for _ in range(powers[j, i]):
                    term *= v[i]
            change += term
        previous, older, last = now, last, u[n]
        now = now + change
        if not abs(now) < most:
            return False
        y[n] = now
    return True


def free(powers: Powers, weights: Array, g: Gridded) -> Array:
    """Return (N,) scaled outputs of free simulation; not finite where it diverged.

    From rest the output before the first sample is zero; else the first two measured outputs begin it.
    """
    y, first = np.zeros(g.u.size), 0
    start = np.array([g.before, g.before, 0.0, 0.0])
    if not g.rest and g.known >= 2 and np.isfinite(g.y[:2]).all():
        y[:2], first = g.y[:2], 2
        start = np.array([g.u[1], g.u[0], g.y[1], g.y[0]])
    good = _simulate(g.u[first:], start, y[first:], powers, weights, _DIVERGED)
    return y if good else np.full(y.size, np.inf)


class _Stepper(GridStepper):
    """The state is an array: the last input, the one before, and two outputs alike, scaled."""

    def rest(self, u: float) -> State:
        """Return the equilibrium that free simulation reaches from zero under a constant input."""
        x = u / self._fitted.scales.u
        return self.run(np.array([x, x, 0.0, 0.0]), np.full(_REST, u))[0] if x else np.zeros(4)

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        f, x, y = self._fitted, u / self._fitted.scales.u, np.full(u.size, np.nan)
        _simulate(x, state, y, f.powers, f.weights, np.inf)
        inputs, outputs = np.append(state[[1, 0]], x), np.append(state[[3, 2]], y)
        return np.array([inputs[-1], inputs[-2], outputs[-1], outputs[-2]]), y * f.scales.y


@dataclass(frozen=True)
class NarxFitted(OnGrid):
    """Terms with powers (T, V) and weights (T,) on a grid."""

    steps = _Stepper
    powers: Powers = None  # type: ignore[assignment]
    weights: Array = None  # type: ignore[assignment]

    def run_grid(self, g: Gridded) -> Array:
        return free(self.powers, self.weights, g)


def error(data: Data, powers: Powers, weights: Array, masks: Sequence[Mask]) -> Array:
    """Return the (M,) residual of free simulation over noise, each recording's mean taken out."""
    rows = []
    for g, mask in zip(data.gridded, masks, strict=True):
        if mask.any():
            e = (g.y - free(powers, weights, g))[mask] / g.noise
            rows.append(e - e.mean() if np.isfinite(e).all() else np.full(e.size, _UNSTABLE))
    return np.concatenate(rows)


def score(data: Data, powers: Powers, weights: Array) -> float:
    """Return the residual over noise on the samples set aside, as many as were recorded."""
    return float(np.sqrt(np.sum(error(data, powers, weights, data.check) ** 2) / data.checked))


class Narx(Rival):
    """Polynomial NARX."""

    words = "polynomial NARX, terms by forward regression"
    source = "Billings 2013; Martins, Aguirre 2016; Piroddi, Spinelli 2003"
    how = "orthogonal matching pursuit on the one-step error, then least squares on the error of free simulation"

    def warm(self) -> None:
        needed("sklearn.linear_model")
        still = np.zeros(3)
        free(np.ones((1, _SHORT), dtype=np.int64), np.zeros(1), Gridded(still, still, still, 0.0, True, 0, 1.0))

    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted:
        tried = list(_search(recordings, budget))
        if not tried:
            raise SolverFailed("narx: no polynomial was stable in free simulation: allow more time or other recordings")
        least, data, powers, weights = min(tried, key=lambda t: t[0])
        both = [f | c for f, c in zip(data.fit, data.check, strict=True)]
        weights = _refined(data, powers, weights, both, budget)
        facts = {
            "size": f"{len(weights)} terms of degree {int(powers.sum(axis=1).max())}, grid {data.dt:.3g} s",
            "sizes_tried": len(tried), "check_over_noise": least, "processor_seconds": budget.used,
        }  # fmt: skip
        return NarxFitted(weights.size, facts, data.dt, data.scales, data.zero, powers, weights)


def _search(recordings: Sequence[Recording], budget: Budget) -> Iterator[tuple[float, Data, Powers, Array]]:
    """Yield the error on the samples set aside, with data, powers and weights, of every candidate that is stable."""
    grids = sorted({interval(recordings, p): p for p in PER_PERIOD}.items(), reverse=True)
    plan = [(p, degree, count) for degree in DEGREES for count in (_SHORT, _LONG) for _, p in grids]
    for k, (per_period, degree, count) in enumerate(plan):
        own = budget.share(_SEARCH, len(plan) - k)
        if own.seconds <= 0.0:
            return
        data = data_on(recordings, per_period)
        candidates = [(score(data, *found), *found) for found in pursued(data, degree, count)]
        # The best of the one-step errors may not be the best after refinement: two are refined.
        for least, powers, weights in sorted(candidates, key=lambda c: c[0])[:2]:
            if least < _HOPELESS:
                refined = _refined(data, powers, weights, data.fit, own)
                yield score(data, powers, refined), data, powers, refined


def pursued(data: Data, degree: int, count: int) -> Iterator[tuple[Powers, Array]]:
    """Yield powers and weights for growing numbers of terms, by orthogonal matching pursuit on the one-step error."""
    preprocessing, linear = needed("sklearn.preprocessing"), needed("sklearn.linear_model")
    rows = []
    for g, mask in zip(data.gridded, data.fit, strict=True):
        last_u = np.concatenate([[g.before], g.u[:-1]])
        last_y = np.concatenate([[0.0 if g.rest else g.y[0]], g.y[:-1]])
        du = g.u - last_u
        each = [last_y, g.u, du, np.abs(du), np.diff(last_y, prepend=last_y[0]), np.diff(du, prepend=0.0)]
        rows.append(np.column_stack([*each[:count], g.y - last_y, np.full(g.u.size, 1.0 / g.noise)])[mask])
    joined = np.concatenate(rows)
    joined = joined[:: max(1, joined.shape[0] // _ROWS)]
    v, target, weight = joined[:, :count], joined[:, -2] * joined[:, -1], joined[:, -1]
    powers = preprocessing.PolynomialFeatures(degree).fit(v[:1]).powers_.astype(np.int64)
    columns = np.stack([weight * np.prod(v**p, axis=1) for p in powers], axis=1)
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    counts = sorted({min(n, *columns.shape) for n in TERMS})
    with warnings.catch_warnings():
        # Terms that depend on others end the path early: nothing is lost.
        warnings.simplefilter("ignore", RuntimeWarning)
        path = linear.orthogonal_mp(columns / sizes, target, n_nonzero_coefs=counts[-1], return_path=True)
    path = path if path.ndim == 2 else path[:, None]
    for number in counts:
        weights = path[:, min(number, path.shape[1]) - 1]
        chosen = np.flatnonzero(weights)
        if chosen.size:
            yield np.ascontiguousarray(powers[chosen]), weights[chosen] / sizes[chosen]


def _refined(data: Data, powers: Powers, weights: Array, masks: Sequence[Mask], budget: Budget) -> Array:
    """Return weights that make the error of free simulation smallest, as far as the time goes."""
    scale = np.maximum(np.abs(weights), 1e-6 * np.abs(weights).max())
    best: list[Any] = [np.inf, weights]

    def residual(x: Array) -> Array:
        budget.check()
        rows = error(data, powers, x * scale, masks)
        cost = float(rows @ rows)
        if cost < best[0]:
            best[:] = cost, x * scale
        return rows

    with contextlib.suppress(Spent):
        least_squares(residual, weights / scale, max_nfev=min(budget.most, _EVALUATIONS), diff_step=1e-6)
    return np.asarray(best[1])
