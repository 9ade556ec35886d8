"""Rivals whose hysteresis, or static curve, is an operator in front of linear dynamics.

    y = L_θ [Σ_k w_k φ_k(u; η)] + zero,
    L(s) = (1 + z s/ω) / (s²/ω² + 2 ζ s/ω + 1)  ·  Π_i (1 + k_i τ_i s) / (1 + τ_i s)

For given dynamics θ and shape η the weights are a linear least-squares problem, non-negative where the operator asks
for it. Variable projection (Golub, Pereyra 2003) leaves a small nonlinear problem in (θ, η). Inputs are over the
largest identified one. An operator's state is an array, whose last element is the last input, so that whole recordings
and single samples take the same code.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares, nnls
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from phnn.errors import SolverFailed
from phnn.recordings.recording import Recording
from studies.rival_models.rival import (
    Budget,
    Fitted,
    Mask,
    Rival,
    Scales,
    Spent,
    State,
    Stepper,
    over_noise,
    run_in,
    scales_of,
    split,
)

Array = NDArray[np.float64]

# Share of the budget for the choice of a size; the rest refits the chosen one to all identification samples.
_SEARCH, _EVALUATIONS = 0.7, 400
_EXCITED = 1e-2  # least norm of a column, over the largest, from which on the ridge is in proportion to it
_STEP = 1e-5  # of finite differences
_AGAIN, _SPREAD = 6, 0.5  # further starts of the last fit, and their standard deviation about the best parameters
_BLOCK = 10_000  # samples of a long run whose columns are held at once: some hundred columns are 20 MB
# Starts of the dynamics: ω over the highest excited frequency, ζ.
STARTS = ((4.0, 0.3), (1.0, 0.1), (0.1, 1.0))
# Least and largest ln ω/rate, ln ζ, z; first, least and largest ln rate·τ, k.
_LOW, _HIGH = (np.log(1e-3), np.log(1e-3), -10.0), (np.log(300.0), np.log(300.0), 10.0)
_LAG = ((0.0, 0.9), (np.log(1e-4), -5.0), (np.log(1e4), 20.0))


@njit(cache=True)
def _play_loop(w: Array, low: Array, high: Array, reach: Array, out: Array) -> None:
    """``w ← max(low − r, min(high + r, w))`` sample by sample, in place; ``reach`` is (N, K), ``out`` (N, K)."""
    for n in range(low.size):
        for k in range(w.size):
            w[k] = max(low[n] - reach[n, k], min(high[n] + reach[n, k], w[k]))
            out[n, k] = w[k]


@njit(cache=True)
def _dahl_loop(z: Array, last: float, u: Array, inverse: Array, out: Array) -> None:
    """``dz/du = (1 − z sgn u̇)/δ``, whose solution between two samples is an exponential; in place."""
    for n in range(u.size):
        change = u[n] - last
        side = 1.0 if change > 0.0 else -1.0
        for k in range(z.size):
            if change != 0.0:
                z[k] = side + (z[k] - side) * np.exp(-abs(change) * inverse[k])
            out[n, k] = z[k]
        last = u[n]


def played(w: Array, low: Array, high: Array, reach: Array) -> Array:
    """Return (N, K) outputs of generalised plays; the states ``w`` (K,) are moved on."""
    out = np.empty((low.size, w.size))
    reach = np.ascontiguousarray(np.broadcast_to(reach, out.shape))
    _play_loop(w, np.ascontiguousarray(low), np.ascontiguousarray(high), reach, out)
    return out


class Operator(ABC):
    """Columns of an input.

    Attributes:
        states: numbers of the state beside the last input.
        positive: weights are non-negative; ridge: of the weights, over the mean of the squared columns.
    """

    states: int = 0
    positive: bool = False
    ridge: float = 1e-10

    @property
    def shape(self) -> tuple[Array, Array, Array]:
        """First, least and largest shape parameters (P,); none where the shape is fixed."""
        return np.zeros(0), np.zeros(0), np.zeros(0)

    @abstractmethod
    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        """Return (N, K) columns for inputs ``u`` (N,), and the state behind them.

        Args:
            rates: (N,) ``|u̇|`` over the largest amplitude and the highest angular frequency.
        """

    def rest(self, shape: Array, u: float) -> tuple[Array, Array]:
        """Return (1, K) columns and the state after a monotone change from zero to ``u`` and a rest there."""
        return self.run(shape, np.zeros(self.states + 1), np.array([u]), np.zeros(1))


def _polynomials(u: Array, degree: int) -> Array:
    """Return (N, degree) Chebyshev polynomials without the constant one."""
    return np.asarray(np.polynomial.chebyshev.chebvander(u, degree)[:, 1:])


@dataclass(frozen=True)
class Static(Operator):
    """Polynomials of the input, up to ``degree``."""

    degree: int

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        return _polynomials(u, self.degree), u[-1:].copy()


@dataclass(frozen=True)
class Plays(Operator):
    """Generalised plays with evenly spaced thresholds, and the input itself.

        w_i = max(γ₊(u) − r_i, min(γ₋(u) + r_i, w_i)),   r_i = i/n + λ |u̇|

    The envelopes γ± are ``u`` itself, or ``u + a u² + b u³ ± c u²`` of a ``curved`` one. A rate-dependent one has
    λ ≥ 0 (Al Janaideh, Krejčí 2011).
    """

    count: int
    curved: bool = False
    rate: bool = False

    positive = True
    ridge = 1e-9

    @property
    def states(self) -> int:  # type: ignore[override]
        return self.count + 1

    @property
    def shape(self) -> tuple[Array, Array, Array]:
        each = [(0.0, -0.45, 0.45), (0.0, -0.3, 2.0), (0.0, -0.3, 0.3)] * self.curved + [(0.01, 0.0, 1.0)] * self.rate
        first, low, high = np.array(each).reshape(-1, 3).T
        return first, low, high

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        up = down = u
        if self.curved:
            middle = u + shape[0] * u**2 + shape[1] * u**3
            up, down = middle + shape[2] * u**2, middle - shape[2] * u**2
        reach = np.linspace(0.0, 1.0, self.count + 1, endpoint=False)[None, :]
        if self.rate:
            reach = reach + (shape[-1] * rates)[:, None]
        w = state[:-1].copy()
        columns = played(w, up, down, reach)
        return np.column_stack([u, columns]), np.array([*w, u[-1]])


@dataclass(frozen=True)
class Plane(Operator):
    """A discretised Preisach plane.

    In the coordinates ``r = (α − β)/2`` and ``s = (α + β)/2`` of a relay with the thresholds ``α ≥ β``, a relay is up
    where the play of radius ``r`` lies above ``s``. A density that is constant in ``s`` over a cell of one line of
    constant ``r`` therefore gives the column ``clip((P_r(u) − s_k)/Δs, 0, 1)``: continuous, unlike that of relays. The
    outer cells have no outer end, so that an input beyond the identified range does not saturate the model
    (Brokate, Sprekels 1996, Sec. 2.4).
    """

    lines: int
    cells: int

    positive = True
    ridge = 1e-7

    @property
    def states(self) -> int:  # type: ignore[override]
        return self.lines

    @property
    def radii(self) -> Array:
        """(lines,) radii of the plays."""
        return np.linspace(0.0, 1.0, self.lines, endpoint=False)

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        w = state[:-1].copy()
        plays = played(w, u, u, self.radii[None, :])
        columns = [self._line(plays[:, k], 1.0 - r) for k, r in enumerate(self.radii)]
        return np.column_stack(columns), np.array([*w, u[-1]])

    def _line(self, p: Array, reach: float) -> Array:
        """Return the cells of one line, on which plays lie within ``±reach`` while the input stays in its range."""
        edges = np.linspace(-reach, reach, max(1, round(self.cells * reach)) + 1)
        low, high = edges[:-1].copy(), edges[1:].copy()
        low[0], high[-1] = -np.inf, np.inf
        return np.asarray((np.clip(p[:, None], low, high) - edges[:-1]) / (edges[1] - edges[0]))


@dataclass(frozen=True)
class Duhem(Operator):
    """Dahl operators ``dz_i/du = (1 − z_i sgn u̇)/δ_i`` beside polynomials of the input.

    With ``leaning``, ``u z_i`` as well: a Duhem model whose loop is wider on one side (Coleman, Hodgdon 1986).
    """

    degree: int
    count: int
    leaning: bool = False

    ridge = 1e-9

    @property
    def states(self) -> int:  # type: ignore[override]
        return self.count

    @property
    def shape(self) -> tuple[Array, Array, Array]:
        first = np.log(np.geomspace(0.08, 0.6, self.count) if self.count > 1 else np.array([0.3]))
        return first, np.full(self.count, np.log(1e-3)), np.full(self.count, np.log(30.0))

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        z, out = state[:-1].copy(), np.empty((u.size, self.count))
        _dahl_loop(z, float(state[-1]), np.ascontiguousarray(u), np.exp(-shape), out)
        columns = [_polynomials(u, self.degree), out, *([u[:, None] * out] if self.leaning else [])]
        return np.column_stack(columns), np.array([*z, u[-1]])


def transfer(theta: Array, rate: float) -> tuple[Array, Array]:
    """Return numerator and denominator of the dynamics in s over ``rate``; ``theta`` as in `discretised`."""
    omega, zeta = rate * np.exp(theta[0]), np.exp(theta[1])
    a, b = np.array([1.0 / omega**2, 2.0 * zeta / omega, 1.0]), np.array([theta[2] / omega, 1.0])
    for log_tau, lead in theta[3:].reshape(-1, 2):
        tau = np.exp(log_tau) / rate
        a, b = np.polymul(a, [tau, 1.0]), np.polymul(b, [lead * tau, 1.0])
    return b, a


def discretised(theta: Array, rate: float, dt: float, held: bool) -> tuple[Array, Array]:
    """Return numerator and denominator in z⁻¹ of the dynamics, exact for inputs held or linear between samples.

    Args:
        theta: (ln ω/rate, ln ζ, z, ln rate·τ_1, k_1, …); rate: unit of ω, rad/s; dt: sampling interval, s.
    """
    # In units of dt: coefficients in seconds would be numbers of very different size.
    b, a = transfer(theta, rate * dt)
    n = a.size - 1
    row = np.concatenate([np.zeros(n - b.size), b])[None, :] / a[0]
    companion = (np.vstack([-a[1:] / a[0], np.eye(n)[:-1]]), np.eye(n)[:, :1], row, np.zeros((1, 1)))
    step, driven, shown, direct, _ = cont2discrete(companion, 1.0, method="zoh" if held else "foh")
    impulse = [direct, *(shown @ np.linalg.matrix_power(step, k) @ driven for k in range(n))]
    denominator = np.asarray(np.poly(step).real, dtype=np.float64)
    numerator: Array = np.convolve(denominator, np.ravel(impulse))[: n + 1]
    # Rounding would leave a static gain that differs from one where poles lie close to one.
    return numerator * (denominator.sum() / numerator.sum()), denominator


def free_responses(b: Array, a: Array, samples: int) -> Array:
    """Return (N, order) outputs of a filter without input from unit states."""
    order = a.size - 1
    return np.asarray(lfilter(b, a, np.zeros((samples, order)), axis=0, zi=np.eye(order))[0])


@dataclass(frozen=True)
class Structure:
    """An operator before dynamics with so many lags; parameters are those of the dynamics, then of the shape."""

    operator: Operator
    lags: int
    scales: Scales

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest parameters."""
        _, low, high = self.operator.shape
        return np.array([*_LOW, *_LAG[1] * self.lags, *low]), np.array([*_HIGH, *_LAG[2] * self.lags, *high])

    def start(self, omega: float, zeta: float) -> Array:
        """Return the (P,) parameters from which a fit begins."""
        lags = [x for k in range(self.lags) for x in (_LAG[0][0] + 2.0 * k, _LAG[0][1])]
        return np.array([np.log(omega), np.log(zeta), 0.0, *lags, *self.operator.shape[0]])

    def parted(self, x: Array) -> tuple[Array, Array]:
        """Return the parameters of the dynamics, and of the shape."""
        return x[: 3 + 2 * self.lags], x[3 + 2 * self.lags :]

    def filter(self, x: Array, dt: float, held: bool = False) -> tuple[Array, Array]:
        """Return numerator and denominator in z⁻¹ at the sampling interval ``dt`` [s]."""
        return discretised(self.parted(x)[0], self.scales.rate, dt, held)

    def columns(self, x: Array, recording: Recording) -> Array:
        """Return (N, K) columns behind the dynamics; a periodic recording is run through once before."""
        shape = self.parted(x)[1]
        u, before = recording.u / self.scales.u, recording.u[0] / self.scales.u
        if recording.start.state == "rest":
            before = recording.start.input_before / self.scales.u
        cycle = run_in(recording)
        if cycle:
            u = np.concatenate([u[-cycle:], u])
        rates = np.abs(np.diff(u, prepend=before)) / (recording.dt * self.scales.rate)
        resting, state = self.operator.rest(shape, float(before))
        columns, _ = self.operator.run(shape, state, u, rates)
        b, a = self.filter(x, recording.dt, recording.interpolation == "zero_order")
        return np.asarray(lfilter(b, a, columns, axis=0, zi=lfilter_zi(b, a)[:, None] * resting)[0])[cycle:]

    def stepper(self, fitted: Separable, dt: float) -> Stepper:
        """Return a fitted structure sample by sample, at the interval ``dt`` [s]."""
        return _Stepper(fitted, dt)

    def nuisance(self, x: Array, recording: Recording) -> Array:
        """Return (N, order) free responses where the start is unknown, (N, 0) otherwise."""
        if recording.start.state != "unknown":
            return np.zeros((recording.t.size, 0))
        b, a = self.filter(x, recording.dt, recording.interpolation == "zero_order")
        return free_responses(b, a, recording.t.size)


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
        return self.structure.stepper(self, dt)


class _Stepper(Stepper):
    def __init__(self, fitted: Separable, dt: float) -> None:
        self.dt, self._weights, self._scales = dt, fitted.weights, fitted.structure.scales
        self._shape, self._operator = fitted.structure.parted(fitted.x)[1], fitted.structure.operator
        self._b, self._a = fitted.structure.filter(fitted.x, dt)

    def rest(self, u: float) -> State:
        columns, state = self._operator.rest(self._shape, u / self._scales.u)
        return state, lfilter_zi(self._b, self._a) * float(columns[0] @ self._weights)

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        (inner, kept), outputs = state, []
        for first in range(0, u.size, _BLOCK):
            x = u[first : first + _BLOCK] / self._scales.u
            rates = np.abs(np.diff(x, prepend=inner[-1])) / (self.dt * self._scales.rate)
            columns, inner = self._operator.run(self._shape, inner, x, rates)
            y, kept = lfilter(self._b, self._a, columns @ self._weights, zi=kept)
            outputs.append(y)
        return (inner, kept), np.concatenate(outputs)


class _Projection:
    """The residual over noise with the weights and every recording's zero and initial state at their best values."""

    def __init__(self, structure: Structure, recordings: Sequence[Recording], masks: Sequence[Mask], budget: Budget):
        pairs = [(r, m) for r, m in zip(recordings, masks, strict=True) if m.any()]
        self.structure, self.pairs, self.budget = structure, pairs, budget
        self.best: tuple[float, Array, Array] | None = None
        self.evaluations = 0

    def __call__(self, x: Array) -> Array:
        """Return the (M,) residual over noise."""
        self.budget.check()
        self.evaluations += 1
        blocks = []
        for r, mask in self.pairs:
            rows = np.column_stack([self.structure.columns(x, r)[mask], r.y[mask]]) / r.noise
            own = np.column_stack([np.ones(mask.sum()), self.structure.nuisance(x, r)[mask]])
            q = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
            blocks.append(rows - q @ (q.T @ rows))
        joined = np.concatenate(blocks)
        weights = self._weights(joined[:, :-1], joined[:, -1])
        residual = joined[:, -1] - joined[:, :-1] @ weights
        cost = float(residual @ residual) if np.isfinite(residual).all() else np.inf
        if np.isfinite(cost) and (self.best is None or cost < self.best[0]):
            self.best = cost, x.copy(), weights
        return np.nan_to_num(residual, nan=1e9, posinf=1e9, neginf=-1e9)

    def _weights(self, columns: Array, target: Array) -> Array:
        gram, right = columns.T @ columns, columns.T @ target
        # A column that these samples hardly excite is held by the ridge: elsewhere it may be large.
        sizes = np.sqrt(np.diag(gram))
        scale = np.maximum(sizes, max(_EXCITED * float(sizes.max()), 1e-300))
        gram, right = gram / np.outer(scale, scale), right / scale
        gram[np.diag_indices_from(gram)] += self.structure.operator.ridge
        try:
            root = cholesky(gram)
            turned = solve_triangular(root, right, trans="T")
            positive = self.structure.operator.positive
            weights = nnls(root, turned, maxiter=10 * right.size)[0] if positive else solve_triangular(root, turned)
        except (np.linalg.LinAlgError, RuntimeError, ValueError):
            return np.full(right.size, np.nan)
        return np.asarray(weights / scale)


def fit_structure(
    structure: Structure,
    recordings: Sequence[Recording],
    masks: Sequence[Mask],
    starts: Sequence[Array],
    budget: Budget,
) -> Separable | None:
    """Return the best parameters from several starts; None where no time was left for one evaluation that is finite."""
    projection = _Projection(structure, recordings, masks, budget)
    low, high = structure.bounds
    options: dict[str, Any] = {"bounds": (low, high), "diff_step": _STEP, "x_scale": 0.3, "xtol": 1e-6, "ftol": 1e-6}
    try:
        with suppress(Spent):
            for start in starts:
                inside = np.clip(start, low + 1e-9, high - 1e-9)
                least_squares(projection, inside, max_nfev=min(budget.most, _EVALUATIONS), **options)
    except (np.linalg.LinAlgError, ValueError) as error:
        if projection.best is None:
            raise SolverFailed(f"{structure.operator}: the fit failed ({error}): scale the recordings") from error
    if projection.best is None:
        return None
    _, x, weights = projection.best
    facts = {"evaluations": projection.evaluations}
    return Separable(x.size + int(np.count_nonzero(weights)), facts, structure, x, weights)


class SeparableRival(Rival):
    """A family of structures from small to large.

    Attributes:
        sizes: operator and number of lags of each; leading: how many of them serve as a start for the others alone.
    """

    sizes: Sequence[tuple[Operator, int]]
    leading: int = 0
    how = "variable projection: weights by least squares, dynamics and shape by a trust region with finite differences"

    def join(self, operator: Operator, lags: int, scales: Scales) -> Structure:
        """Return an operator with its dynamics."""
        return Structure(operator, lags, scales)

    def warm(self) -> None:
        played(np.zeros(1), np.zeros(2), np.zeros(2), np.zeros((2, 1)))
        _dahl_loop(np.zeros(1), 0.0, np.zeros(2), np.ones(1), np.zeros((2, 1)))

    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted:
        scales, parts = scales_of(recordings), split(recordings)
        tried: list[tuple[float, Separable]] = []
        for k, (operator, lags) in enumerate(self.sizes):
            own = budget.share(_SEARCH, len(self.sizes) - k)
            if own.seconds <= 0.0:
                break
            structure = self.join(operator, lags, scales)
            fitted = fit_structure(structure, recordings, parts.fit, _starts(structure, tried, self.leading), own)
            if fitted is not None:
                tried.append((over_noise(fitted, recordings, parts.check), fitted))
        if not tried:
            raise SolverFailed(f"{self.words}: no candidate was simulated within the budget: allow more time")
        score, best = min(tried[self.leading :] or tried, key=lambda t: t[0])
        # From the best parameters, then from random ones about them for as long as there is time.
        rng, (low, high) = np.random.default_rng(seed), best.structure.bounds
        moved = (best.x + _SPREAD * rng.standard_normal(best.x.size) for _ in range(_AGAIN))
        starts = [best.x, *(np.clip(x, low, high) for x in moved)]
        last = fit_structure(best.structure, recordings, parts.both, starts, budget)
        evaluations = sum(f.facts["evaluations"] for f in [*(f for _, f in tried), *([last] if last else [])])
        facts: dict[str, Any] = {
            "size": str(best.structure.operator), "lags": best.structure.lags, "sizes_tried": len(tried),
            "evaluations": evaluations, "check_over_noise": score, "processor_seconds": budget.used,
        }  # fmt: skip
        return replace(last or best, facts=facts)


def _starts(structure: Structure, tried: Sequence[tuple[float, Separable]], leading: int) -> list[Array]:
    """Return the dynamics of the best size so far; starts of its own for the first size that counts as well."""
    further = [structure.start(*start) for start in STARTS] if len(tried) <= leading else []
    if not tried:
        return further
    best = min(tried, key=lambda t: t[0])[1]
    start, (theta, shape) = structure.start(*STARTS[0]), best.structure.parted(best.x)
    number = min(theta.size, structure.parted(start)[0].size)
    start[:number] = theta[:number]
    if type(best.structure.operator) is type(structure.operator) and shape.size == structure.operator.shape[0].size:
        start[3 + 2 * structure.lags :] = shape
    return [start, *further]


class PrandtlIshlinskii(SeparableRival):
    """Generalised Prandtl–Ishlinskii, with and without thresholds that grow with the rate."""

    words = "generalised Prandtl–Ishlinskii operator in front of second-order dynamics"
    source = "Al Janaideh, Su, Rakheja 2009; Al Janaideh, Krejčí 2011"
    sizes = (
        (Plays(6), 0), (Plays(6, rate=True), 0), (Plays(6, True, True), 0), (Plays(14, True, True), 0),
        (Plays(14, True, True), 1), (Plays(30, True, True), 1),
    )  # fmt: skip


class Preisach(SeparableRival):
    """Preisach."""

    words = "discretised Preisach plane in front of second-order dynamics"
    source = "Mayergoyz 1991; Brokate, Sprekels 1996"
    sizes = ((Plane(4, 6), 0), (Plane(8, 10), 0), (Plane(12, 12), 0), (Plane(12, 12), 1), (Plane(20, 16), 1))


class Dahl(SeparableRival):
    """Dahl, and Duhem with a loop that leans."""

    words = "Dahl and Duhem operators beside a polynomial, in front of second-order dynamics"
    source = "Dahl 1968; Coleman, Hodgdon 1986"
    sizes = ((Duhem(1, 1), 0), (Duhem(3, 2), 0), (Duhem(3, 2, True), 0), (Duhem(3, 3, True), 1), (Duhem(5, 4, True), 1))


class Hammerstein(SeparableRival):
    """A static polynomial in front of linear dynamics."""

    words = "static polynomial in front of linear dynamics of order 2 to 4 (Hammerstein)"
    source = "Narendra, Gallman 1966; Schoukens, Tiels 2017"
    sizes = ((Static(1), 0), (Static(3), 0), (Static(5), 0), (Static(3), 1), (Static(5), 2), (Static(9), 2))
