"""Polynomial NARX with terms chosen by forward regression, then refined by the error of free simulation.

    y_k = y_{k−1} + Σ_j w_j Π_i v_i^{p_ij},   v = (y, u, Δu, |Δu|) or with (Δy, Δ²u) as well, Δ over a grid interval

Differences in place of lags span the same polynomials and are better conditioned on a fine grid. ``|Δu|`` lets a
polynomial have a hysteresis that does not depend on rate, as in a Duhem model. Orthogonal matching pursuit on the
one-step error orders the terms; how many are kept, the grid and the degree are chosen by free simulation of the samples
set aside; the weights then follow from the error of free simulation (Levenberg–Marquardt). The best candidate grows by the
term whose sensitivity in free simulation explains most of the remaining error, orthogonal to those of its terms, for as
long as the samples set aside are predicted better.

References: Billings 2013 (forward regression); Martins, Aguirre 2016 (NARX terms for hysteresis); Piroddi, Spinelli
2003 (simulation error). ``sysidentpy`` needs an older numpy than the one pinned, so that the regression is
scikit-learn's.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from phnn.errors import SolverFailed
from phnn.integrate.cache import compiled
from phnn.recordings.recording import Recording
from phnn.studies.rival_models.budget import Budget, Spent
from phnn.studies.rival_models.grid import Gridded, back, gridded, interval, on_grid
from phnn.studies.rival_models.rival import Fitted, Rival, State, Stepper
from phnn.studies.rival_models.samples import Mask, Scales, scales_of, split
from phnn.studies.rivals import needed

Array = NDArray[np.float64]
Powers = NDArray[np.int64]

PER_PERIOD, DEGREES, TERMS = (12.0, 24.0, 48.0), (1, 2, 3), (3, 5, 8, 12, 18)
_VARIABLES = {False: 4, True: 6}
_LONG = 20_000  # samples within which an equilibrium is reached
_HOPELESS = 1e6  # residual over noise, only reached by a simulation that diverged
_UNSTABLE = 1e17  # sum of squares of a simulation that diverged
_DIVERGED = 50.0  # scaled output that no stable model reaches
_EVALUATIONS, _FEW = 60, 25
_SEARCH, _GROWTH = 0.5, 0.9  # shares of the budget after which the search and the growth end
_MOST_TERMS, _PATIENCE, _PROBE = 40, 10, 1e-5  # of the growth; the probe is a weight's step for its sensitivity
_ROWS = 20_000  # of the one-step regression; more are thinned evenly


def _simulate(u: Any, before: float, y: Any, y_last: float, powers: Any, weights: Any, long: bool, most: float) -> Any:
    """Free simulation from ``y[0] = y[1]`` of the caller; the outputs are written into ``y``. True if it stayed small."""
    v = np.zeros(powers.shape[1])
    last, older, now = before, before, y_last
    previous = y[0]
    for n in range(u.size):
        du = u[n] - last
        v[0], v[1], v[2], v[3] = now, u[n], du, abs(du)
        if long:
            v[4], v[5] = now - previous, du - (last - older)
        change = 0.0
        for j in range(weights.size):
            term = weights[j]
            for i in range(v.size):
                for _ in range(powers[j, i]):
                    term *= v[i]
            change += term
        previous, older, last = now, last, u[n]
        now = now + change
        if not abs(now) < most:
            return False
        y[n] = now
    return True


simulate_kernel = compiled(_simulate)


@dataclass(frozen=True)
class Terms:
    """Powers (T, V) of the terms, and whether ``Δy`` and ``Δ²u`` are among the variables.
    """

    powers: Powers
    long: bool


def _free(terms: Terms, weights: Array, g: Gridded) -> Array:
    """(N,) scaled outputs of free simulation; not finite where it diverged.

    From rest the output before the first sample is zero; else the first two measured outputs begin it.
    """
    y = np.zeros(g.u.size)
    known = not g.rest and np.isfinite(g.y[:2]).all()
    if known:
        y[:2] = g.y[:2]
        tail = y[1:]
        good = simulate_kernel(
            g.u[2:], g.u[1], rest := np.concatenate([tail[:1], np.zeros(g.u.size - 2)])[: g.u.size - 2].copy(),
            y[1], terms.powers, weights, terms.long, _DIVERGED,
        )  # fmt: skip
        y[2:] = rest
    else:
        good = simulate_kernel(g.u, g.before, y, 0.0, terms.powers, weights, terms.long, _DIVERGED)
    return y if good else np.full(y.size, np.inf)


def _variables(g: Gridded, long: bool) -> tuple[Array, Array]:
    """(N, V) variables of the one-step error and its targets (N,), from measured outputs."""
    last_u = np.concatenate([[g.before], g.u[:-1]])
    last_y = np.concatenate([[0.0 if g.rest else g.y[0]], g.y[:-1]])
    du = g.u - last_u
    rows = [last_y, g.u, du, np.abs(du)]
    if long:
        rows += [np.diff(last_y, prepend=last_y[0]), np.diff(du, prepend=0.0)]
    return np.column_stack(rows), g.y - last_y


@dataclass(frozen=True)
class NarxFitted(Fitted):
    """Terms with weights (T,) on a grid of ``grid`` s."""

    grid: float = 0.0
    scales: Scales = None  # type: ignore[assignment]
    zero: float = 0.0
    terms: Terms = None  # type: ignore[assignment]
    weights: Array = None  # type: ignore[assignment]

    @property
    def dt(self) -> float | None:
        return self.grid

    def simulate(self, recording: Recording) -> Array:
        g = gridded(recording, self.grid, self.scales, self.zero)
        return back(recording, _free(self.terms, self.weights, g), self.grid, g.run_in, self.scales)

    def stepper(self, dt: float) -> Stepper:
        self._same_interval(dt)
        return _Stepper(self)


class _Stepper(Stepper):
    def __init__(self, fitted: NarxFitted) -> None:
        self.dt, self._fitted = fitted.grid, fitted

    def rest(self, u: float) -> State:
        """The equilibrium that free simulation reaches from zero under a constant input."""
        x = u / self._fitted.scales.u
        y = 0.0
        if x != 0.0:
            g = Gridded(np.full(_LONG, x), np.full(_LONG, np.nan), x, True, 0, 1.0)
            y = float(_free(self._fitted.terms, self._fitted.weights, g)[-1])
        return np.array([y, y, x, x])

    def step(self, state: State, u: float) -> tuple[State, float]:
        now, previous, last, older = state
        f, x = self._fitted, u / self._fitted.scales.u
        v = [now, x, x - last, abs(x - last)]
        if f.terms.long:
            v += [now - previous, x - 2.0 * last + older]
        y = now + float(np.prod(np.power(v, f.terms.powers), axis=1) @ f.weights)
        return np.array([y, now, x, last]), y * f.scales.y




@dataclass(frozen=True)
class _Data:
    """Recordings on one grid with the masks of `Split` there; ``checked`` recorded samples are set aside."""

    dt: float
    gridded: tuple[Gridded, ...]
    fit: tuple[Mask, ...]
    check: tuple[Mask, ...]
    checked: int

    def score(self, terms: Terms, weights: Array) -> float:
        """Residual over noise on the samples set aside, as many as were recorded."""
        return float(np.sqrt(np.sum(self.error(terms, weights, self.check) ** 2) / self.checked))

    def error(self, terms: Terms, weights: Array, masks: Sequence[Mask]) -> Array:
        """(M,) residual of free simulation over noise, each recording's mean taken out."""
        found = []
        for g, mask in zip(self.gridded, masks, strict=True):
            if mask.any():
                e = (g.y - _free(terms, weights, g))[mask] / g.noise
                found.append(e - e.mean() if np.isfinite(e).all() else np.full(e.size, 1e9))
        return np.concatenate(found)


def _data(recordings: Sequence[Recording], scales: Scales, zero: float, per_period: float) -> _Data:
    dt, parts = interval(recordings, per_period), split(recordings)
    grids = [gridded(r, dt, scales, zero) for r in recordings]
    masks = (
        tuple(on_grid(r, m, dt, g.run_in, g.u.size) for r, m, g in zip(recordings, side, grids, strict=True))
        for side in (parts.fit, parts.check)
    )
    return _Data(dt, tuple(grids), *masks, sum(int(m.sum()) for m in parts.check))


class Narx(Rival):
    """Polynomial NARX."""

    words = "polynomial NARX, terms by forward regression"
    source = "Billings 2013; Martins, Aguirre 2016; Piroddi, Spinelli 2003"
    how = "orthogonal matching pursuit on the one-step error, then least squares on the error of free simulation"

    def warm(self) -> None:
        needed("sklearn.linear_model")
        g = Gridded(np.zeros(3), np.zeros(3), 0.0, True, 0, 1.0)
        _free(Terms(np.ones((1, 4), dtype=np.int64), False), np.zeros(1), g)

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
) -> Iterator[tuple[float, _Data, Terms, Array]]:
    """Error on the samples set aside, with data, terms and weights of every candidate that is stable."""
    grids = sorted({interval(recordings, p): p for p in PER_PERIOD}.items(), reverse=True)
    plan = [(p, degree, long) for degree in DEGREES for long in (False, True) for _, p in grids]
    for k, (per_period, degree, long) in enumerate(plan):
        spare = budget.left - (1.0 - _SEARCH) * budget.seconds if np.isfinite(budget.seconds) else np.inf
        if spare <= 0.0:
            return
        own = Budget(spare / (len(plan) - k), budget.most)
        data = _data(recordings, scales, zero, per_period)
        candidates = []
        for terms, weights in _pursued(data, degree, long):
            candidates.append((data.score(terms, weights), terms, weights))
        # The best of the one-step errors may not be the best after refinement: two are refined.
        for score, terms, weights in sorted(candidates, key=lambda c: c[0])[:2]:
            if score >= _HOPELESS:
                continue
            refined = _refined(data, terms, weights, data.fit, own, budget.most)
            yield data.score(terms, refined), data, terms, refined


def _pursued(data: _Data, degree: int, long: bool) -> Iterator[tuple[Terms, Array]]:
    """Terms and weights for growing numbers of terms, by orthogonal matching pursuit on the one-step error."""
    preprocessing, linear = needed("sklearn.preprocessing"), needed("sklearn.linear_model")
    pairs = [_variables(g, long) for g in data.gridded]
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


def _grown(data: _Data, terms: Terms, weights: Array, score: float, budget: Budget) -> tuple[float, Terms, Array]:
    """The terms with further ones, and the error on the samples set aside."""
    degree = max(DEGREES)
    features = needed("sklearn.preprocessing").PolynomialFeatures(degree)
    powers = features.fit(np.zeros((1, _VARIABLES[True]))).powers_.astype(np.int64)
    best, worse = (score, terms, weights), 0
    widened = np.zeros((weights.size, _VARIABLES[True]), dtype=np.int64)
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


def _next_term(
    data: _Data, terms: Terms, weights: Array, powers: Powers, budget: Budget
) -> tuple[Powers, float] | None:
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


def _refined(data: _Data, terms: Terms, weights: Array, masks: Sequence[Mask], budget: Budget, most: int) -> Array:
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

    try:
        least_squares(residual, start / scale, method="trf", max_nfev=min(most, _EVALUATIONS), diff_step=1e-6)
    except Spent:
        pass
    return np.asarray(best[1])


