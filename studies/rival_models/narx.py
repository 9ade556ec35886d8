"""Polynomial NARX with terms chosen by forward regression, then refined by the error of free simulation.

The equation is that of `narx_model`. Orthogonal matching pursuit on the one-step error orders the terms; how many are
kept, the grid and the degree are chosen by free simulation of the samples set aside; the weights then follow from the
error of free simulation (Levenberg–Marquardt). The best candidate grows by the term whose sensitivity in free
simulation explains most of the remaining error, orthogonal to those of its terms, for as long as the samples set aside
are predicted better.

References: Billings 2013 (forward regression); Martins, Aguirre 2016 (NARX terms for hysteresis); Piroddi, Spinelli
2003 (simulation error). ``sysidentpy`` needs an older numpy than the one pinned, so that the regression is
scikit-learn's.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from phnn.errors import SolverFailed
from phnn.recordings.recording import Recording
from studies.rival_models.budget import Budget, Spent
from studies.rival_models.grid import Gridded, interval
from studies.rival_models.narx_model import (
    VARIABLES,
    Array,
    Data,
    NarxFitted,
    Powers,
    Terms,
    data_on,
    free,
    variables,
)
from studies.rival_models.rival import Fitted, Rival
from studies.rival_models.samples import Mask, Scales, scales_of
from studies.rivals import needed

PER_PERIOD, DEGREES, TERMS = (12.0, 24.0, 48.0), (1, 2, 3), (3, 5, 8, 12, 18)
_HOPELESS = 1e6  # residual over noise, only reached by a simulation that diverged
_UNSTABLE = 1e17  # sum of squares of a simulation that diverged
_EVALUATIONS, _FEW = 60, 25
_SEARCH, _GROWTH = 0.5, 0.9  # shares of the budget after which the search and the growth end
_MOST_TERMS, _PATIENCE, _PROBE = 40, 10, 1e-5  # of the growth; the probe is a weight's step for its sensitivity
_ROWS = 20_000  # of the one-step regression; more are thinned evenly


class Narx(Rival):
    """Polynomial NARX."""

    words = "polynomial NARX, terms by forward regression"
    source = "Billings 2013; Martins, Aguirre 2016; Piroddi, Spinelli 2003"
    how = "orthogonal matching pursuit on the one-step error, then least squares on the error of free simulation"

    def warm(self) -> None:
        needed("sklearn.linear_model")
        g = Gridded(np.zeros(3), np.zeros(3), 0.0, True, 0, 1.0)
        free(Terms(np.ones((1, 4), dtype=np.int64), False), np.zeros(1), g)

    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted:
        scales = scales_of(recordings)
        zero = float(np.mean(np.concatenate([r.y[r.mask("identification")] for r in recordings])))
        tried = list(_search(recordings, scales, zero, budget))
        if not tried:
            raise SolverFailed("narx: no polynomial was stable in free simulation: allow more time or other recordings")
        score, data, terms, weights = min(tried, key=lambda t: t[0])
        score, terms, weights = _grown(data, terms, weights, score, budget)
        both = tuple(f | c for f, c in zip(data.fit, data.check, strict=True))
        weights = _refined(data, terms, weights, both, budget, budget.most)
        facts = {
            "size": f"{len(weights)} terms of degree {int(terms.powers.sum(axis=1).max())}, grid {data.dt:.3g} s",
            "sizes_tried": len(tried), "check_over_noise": score, "processor_seconds": budget.used,
        }  # fmt: skip
        return NarxFitted(weights.size, facts, data.dt, scales, zero, terms, weights)


def _search(
    recordings: Sequence[Recording], scales: Scales, zero: float, budget: Budget
) -> Iterator[tuple[float, Data, Terms, Array]]:
    """Error on the samples set aside, with data, terms and weights of every candidate that is stable."""
    grids = sorted({interval(recordings, p): p for p in PER_PERIOD}.items(), reverse=True)
    plan = [(p, degree, long) for degree in DEGREES for long in (False, True) for _, p in grids]
    for k, (per_period, degree, long) in enumerate(plan):
        spare = budget.left - (1.0 - _SEARCH) * budget.seconds if np.isfinite(budget.seconds) else np.inf
        if spare <= 0.0:
            return
        own = Budget(spare / (len(plan) - k), budget.most)
        data = data_on(recordings, scales, zero, per_period)
        candidates = []
        for terms, weights in _pursued(data, degree, long):
            candidates.append((data.score(terms, weights), terms, weights))
        # The best of the one-step errors may not be the best after refinement: two are refined.
        for score, terms, weights in sorted(candidates, key=lambda c: c[0])[:2]:
            if score >= _HOPELESS:
                continue
            refined = _refined(data, terms, weights, data.fit, own, budget.most)
            yield data.score(terms, refined), data, terms, refined


def _pursued(data: Data, degree: int, long: bool) -> Iterator[tuple[Terms, Array]]:
    """Terms and weights for growing numbers of terms, by orthogonal matching pursuit on the one-step error."""
    preprocessing, linear = needed("sklearn.preprocessing"), needed("sklearn.linear_model")
    pairs = [variables(g, long) for g in data.gridded]
    v = np.concatenate([p[0][m] for p, m in zip(pairs, data.fit, strict=True)])
    target = np.concatenate([p[1][m] for p, m in zip(pairs, data.fit, strict=True)])
    weight = np.concatenate([np.full(m.sum(), 1.0 / g.noise) for g, m in zip(data.gridded, data.fit, strict=True)])
    stride = max(1, v.shape[0] // _ROWS)
    v, target, weight = v[::stride], (target * weight)[::stride], weight[::stride]
    powers = preprocessing.PolynomialFeatures(degree).fit(v[:1]).powers_.astype(np.int64)
    columns = np.stack([weight * np.prod(v**p, axis=1) for p in powers], axis=1)
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    counts = sorted({min(n, powers.shape[0], columns.shape[0]) for n in TERMS})
    with warnings.catch_warnings():
        # Terms that depend on others end the path early: nothing is lost.
        warnings.simplefilter("ignore", RuntimeWarning)
        path = linear.orthogonal_mp(columns / sizes, target, n_nonzero_coefs=counts[-1], return_path=True)
    path = path if path.ndim == 2 else path[:, None]
    for count in counts:
        weights = path[:, min(count, path.shape[1]) - 1]
        chosen = np.flatnonzero(weights)
        if chosen.size:
            yield Terms(np.ascontiguousarray(powers[chosen]), long), weights[chosen] / sizes[chosen]


def _grown(data: Data, terms: Terms, weights: Array, score: float, budget: Budget) -> tuple[float, Terms, Array]:
    """The terms with further ones, and the error on the samples set aside."""
    degree = max(DEGREES)
    features = needed("sklearn.preprocessing").PolynomialFeatures(degree)
    powers = features.fit(np.zeros((1, VARIABLES[True]))).powers_.astype(np.int64)
    best, worse = (score, terms, weights), 0
    widened = np.zeros((weights.size, VARIABLES[True]), dtype=np.int64)
    widened[:, : terms.powers.shape[1]] = terms.powers
    terms = Terms(widened, True)
    while worse < _PATIENCE and weights.size < _MOST_TERMS:
        spare = budget.left - (1.0 - _GROWTH) * budget.seconds if np.isfinite(budget.seconds) else np.inf
        if spare <= 0.0:
            break
        chosen = _next_term(data, terms, weights, powers, budget)
        if chosen is None:
            break
        terms = Terms(np.vstack([terms.powers, chosen[0]]), True)
        weights = _refined(data, terms, np.append(weights, chosen[1]), data.fit, Budget(spare, budget.most), _FEW)
        now = data.score(terms, weights)
        worse = 0 if now < best[0] else worse + 1
        best = (now, terms, weights) if now < best[0] else best
    return best


def _next_term(data: Data, terms: Terms, weights: Array, powers: Powers, budget: Budget) -> tuple[Powers, float] | None:
    """Powers of the term whose sensitivity explains most of the error of free simulation, and its first weight."""
    error = data.error(terms, weights, data.fit)
    own = {tuple(p) for p in terms.powers}
    steps = np.diag(_PROBE * np.maximum(np.abs(weights), 1e-6 * np.abs(weights).max()))
    held = np.stack([(data.error(terms, weights + h, data.fit) - error) / h.sum() for h in steps], axis=1)
    q = np.linalg.qr(held / np.linalg.norm(held, axis=0))[0]
    left, best = error - q @ (q.T @ error), (0.0, None, 0.0)
    for power in powers:
        if budget.left <= 0.0:
            return None
        if tuple(power) in own:
            continue
        larger, probe = Terms(np.vstack([terms.powers, power]), True), np.append(weights, _PROBE)
        d = (data.error(larger, probe, data.fit) - error) / _PROBE
        size = np.linalg.norm(d)
        d = d - q @ (q.T @ d)
        # What is left of a sensitivity that others span is rounding.
        if np.linalg.norm(d) > 1e-6 * size and np.isfinite(size):
            gain = float(left @ d) ** 2 / float(d @ d)
            if gain > best[0]:
                best = gain, power, -float(left @ d) / float(d @ d)
    return None if best[1] is None else (best[1], best[2])


def _refined(data: Data, terms: Terms, weights: Array, masks: Sequence[Mask], budget: Budget, most: int) -> Array:
    """Weights that make the error of free simulation smallest, as far as the time goes."""
    scale = np.maximum(np.abs(weights), 1e-6 * np.abs(weights).max())
    start, most = weights.copy(), min(most, budget.most)
    while float(np.sum(data.error(terms, start, masks) ** 2)) >= _UNSTABLE and np.abs(start[-1]) > 0.0:
        start[-1] *= 0.25 if np.abs(start[-1]) > 1e-12 * scale[-1] else 0.0
    best: list[Any] = [float(np.sum(data.error(terms, start, masks) ** 2)), start]

    def residual(x: Array) -> Array:
        budget.check()
        error = data.error(terms, x * scale, masks)
        cost = float(error @ error)
        if cost < best[0]:
            best[:] = cost, x * scale
        return error

    with contextlib.suppress(Spent):
        least_squares(residual, start / scale, method="trf", max_nfev=min(most, _EVALUATIONS), diff_step=1e-6)
    return np.asarray(best[1])
