"""A polynomial difference equation on a grid of time, simulated freely or sample by sample.

    y_k = y_{k−1} + Σ_j w_j Π_i v_i^{p_ij},   v = (y, u, Δu, |Δu|) or with (Δy, Δ²u) as well, Δ over a grid interval

Differences in place of lags span the same polynomials and are better conditioned on a fine grid. ``|Δu|`` lets a
polynomial have a hysteresis that does not depend on rate, as in a Duhem model (Martins, Aguirre 2016).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import compiled
from phnn.recordings.recording import Recording
from studies.rival_models.grid import Gridded, OnGrid, gridded, interval, on_grid
from studies.rival_models.rival import State, Stepper
from studies.rival_models.samples import Mask, Scales, split

Array = NDArray[np.float64]
Powers = NDArray[np.int64]

VARIABLES = {False: 4, True: 6}
_LONG = 20_000  # samples within which an equilibrium is reached
_DIVERGED = 50.0  # scaled output that no stable model reaches


def _simulate(u: Any, start: Any, y: Any, powers: Any, weights: Any, long: bool, most: float) -> bool:
    """Free simulation into ``y``; ``start`` holds the input before, the one before that, and two outputs alike.

    Returns False where an output left ``±most``.
    """
    v = np.zeros(powers.shape[1])
    last, older, now, previous = start
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
    """Powers (T, V) of the terms, and whether ``Δy`` and ``Δ²u`` are among the variables."""

    powers: Powers
    long: bool


def free(terms: Terms, weights: Array, g: Gridded) -> Array:
    """(N,) scaled outputs of free simulation; not finite where it diverged.

    From rest the output before the first sample is zero; else the first two measured outputs begin it.
    """
    y, first = np.zeros(g.u.size), 0
    start = np.array([g.before, g.before, 0.0, 0.0])
    if not g.rest and g.known >= 2 and np.isfinite(g.y[:2]).all():
        y[:2], first = g.y[:2], 2
        start = np.array([g.u[1], g.u[0], g.y[1], g.y[0]])
    tail = y[first:]
    good = simulate_kernel(g.u[first:], start, tail, terms.powers, weights, terms.long, _DIVERGED)
    return y if good else np.full(y.size, np.inf)


def variables(g: Gridded, long: bool) -> tuple[Array, Array]:
    """(N, V) variables of the one-step error and its targets (N,), from measured outputs."""
    last_u = np.concatenate([[g.before], g.u[:-1]])
    last_y = np.concatenate([[0.0 if g.rest else g.y[0]], g.y[:-1]])
    du = g.u - last_u
    rows = [last_y, g.u, du, np.abs(du)]
    if long:
        rows += [np.diff(last_y, prepend=last_y[0]), np.diff(du, prepend=0.0)]
    return np.column_stack(rows), g.y - last_y


@dataclass(frozen=True)
class NarxFitted(OnGrid):
    """Terms with weights (T,) on a grid."""

    terms: Terms = None  # type: ignore[assignment]
    weights: Array = None  # type: ignore[assignment]

    def simulate(self, recording: Recording) -> Array:
        g = self.gridded(recording)
        return self.back(recording, free(self.terms, self.weights, g), g)

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
            y = float(free(self._fitted.terms, self._fitted.weights, g)[-1])
        return np.array([y, y, x, x])

    def step(self, state: State, u: float) -> tuple[State, float]:
        now, previous, last, older = state
        f, x = self._fitted, u / self._fitted.scales.u
        v = [now, x, x - last, abs(x - last)]
        if f.terms.long:
            v += [now - previous, x - 2.0 * last + older]
        y = now + float(np.prod(np.power(v, f.terms.powers), axis=1) @ f.weights)
        return np.array([y, now, x, last]), y * f.scales.y

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        now, previous, last, older = state
        f, x, y = self._fitted, u / self._fitted.scales.u, np.full(u.size, np.nan)
        start = np.array([last, older, now, previous])
        simulate_kernel(x, start, y, f.terms.powers, f.weights, f.terms.long, np.inf)
        ends = np.array([*np.append(now, y)[:-3:-1], *np.append(last, x)[:-3:-1]])
        return ends, y * f.scales.y


@dataclass(frozen=True)
class Data:
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
                e = (g.y - free(terms, weights, g))[mask] / g.noise
                found.append(e - e.mean() if np.isfinite(e).all() else np.full(e.size, 1e9))
        return np.concatenate(found)


def data_on(recordings: Sequence[Recording], scales: Scales, zero: float, per_period: float) -> Data:
    dt, parts = interval(recordings, per_period), split(recordings)
    grids = [gridded(r, dt, scales, zero) for r in recordings]
    fit, check = (
        tuple(on_grid(r, m, dt, g.run_in, g.u.size) for r, m, g in zip(recordings, side, grids, strict=True))
        for side in (parts.fit, parts.check)
    )
    return Data(dt, tuple(grids), fit, check, sum(int(m.sum()) for m in parts.check))
