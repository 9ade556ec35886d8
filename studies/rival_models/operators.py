"""Operators without memory of rate: columns of outputs whose weighted sum drives the linear dynamics.

Inputs are over the largest identified one. An operator's state is an array, whose last element is the last input, so
that whole recordings and single samples take the same code.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.integrate.cache import compiled

Array = NDArray[np.float64]


class Operator(ABC):
    """Columns of an input.

    Attributes:
        positive: weights are non-negative.
        ridge: of the weights, over the mean of the squared columns.
    """

    positive: bool = False
    ridge: float = 1e-10

    @property
    def start(self) -> Array:
        """(P,) shape parameters from which a fit begins; none where the shape is fixed."""
        return np.zeros(0)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest shape parameters."""
        return np.zeros(0), np.zeros(0)

    @abstractmethod
    def rest(self, shape: Array, u: float) -> Array:
        """State after a monotone change from zero to ``u`` and a rest there."""

    @abstractmethod
    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        """``(N, K)`` columns for inputs ``u`` (N,), and the state behind them.

        Args:
            rates: (N,) ``|u̇|`` over the largest amplitude and the highest angular frequency.
        """


def _plays(w: Any, low: Any, high: Any, reach: Any, out: Any) -> None:
    """``w ← max(low − r, min(high + r, w))`` sample by sample, in place; ``reach`` is (N, K), ``out`` (N, K)."""
    for n in range(low.size):
        for k in range(w.size):
            x = w[k]
            if x > high[n] + reach[n, k]:
                x = high[n] + reach[n, k]
            if x < low[n] - reach[n, k]:
                x = low[n] - reach[n, k]
            w[k] = x
            out[n, k] = x


def _dahl(z: Any, last: float, u: Any, inverse: Any, out: Any) -> None:
    """``dz/du = (1 − z sgn u̇)/δ``, whose solution between two samples is an exponential; in place."""
    for n in range(u.size):
        change = u[n] - last
        side = 1.0 if change > 0.0 else -1.0
        for k in range(z.size):
            if change != 0.0:
                z[k] = side + (z[k] - side) * np.exp(-abs(change) * inverse[k])
            out[n, k] = z[k]
        last = u[n]


plays_kernel, dahl_kernel = compiled(_plays), compiled(_dahl)


def warm() -> None:
    """Compile or load the kernels."""
    plays_kernel(np.zeros(1), np.zeros(2), np.zeros(2), np.zeros((2, 1)), np.zeros((2, 1)))
    dahl_kernel(np.zeros(1), 0.0, np.zeros(2), np.ones(1), np.zeros((2, 1)))


def played(w: Array, low: Array, high: Array, reach: Array) -> Array:
    """``(N, K)`` outputs of generalised plays; the states ``w`` (K,) are moved on."""
    out = np.empty(reach.shape)
    plays_kernel(w, np.ascontiguousarray(low), np.ascontiguousarray(high), np.ascontiguousarray(reach), out)
    return out


def polynomials(u: Array, degree: int) -> Array:
    """``(N, degree)`` Chebyshev polynomials without the constant one."""
    return np.asarray(np.polynomial.chebyshev.chebvander(u, degree)[:, 1:])


@dataclass(frozen=True)
class Static(Operator):
    """Polynomials of the input, up to ``degree``."""

    degree: int

    def rest(self, shape: Array, u: float) -> Array:
        return np.array([u])

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        return polynomials(u, self.degree), u[-1:].copy()


@dataclass(frozen=True)
class Plays(Operator):
    """Generalised plays with evenly spaced thresholds, and the input itself.

        w_i = max(γ₊(u) − r_i, min(γ₋(u) + r_i, w_i)),   r_i = i/n + λ |u̇|

    The envelopes γ± are ``u`` itself (``"none"``), ``[tanh(a u + b ± c) − tanh(b ± c)] / (a sech² b)`` (``"tanh"``), or
    ``u + a u² + b u³ ± c u²`` (``"cubic"``). A rate-dependent one has λ ≥ 0.

    References: Al Janaideh, Su, Rakheja 2009 (plays with tanh envelopes); Al Janaideh, Krejčí 2011 (rate-dependent
    thresholds).
    """

    count: int
    envelope: str = "none"
    rate: bool = False

    positive = True
    ridge = 1e-9

    @property
    def start(self) -> Array:
        shapes = {"none": (), "tanh": (np.log(0.3), 0.0, 0.0), "cubic": (0.0, 0.0, 0.0)}
        return np.array([*shapes[self.envelope], *([0.01] if self.rate else [])])

    @property
    def bounds(self) -> tuple[Array, Array]:
        low = {"none": (), "tanh": (np.log(0.01), -2.0, -0.5), "cubic": (-0.45, -0.3, -0.3)}[self.envelope]
        high = {"none": (), "tanh": (np.log(3.0), 2.0, 0.5), "cubic": (0.45, 2.0, 0.3)}[self.envelope]
        return np.array([*low, *([0.0] if self.rate else [])]), np.array([*high, *([1.0] if self.rate else [])])

    def _envelopes(self, shape: Array, u: Array) -> tuple[Array, Array]:
        """γ₊ that carries a rising play, γ₋ that carries a falling one."""
        if self.envelope == "none":
            return u, u
        if self.envelope == "cubic":
            a, b, c = shape[:3]
            middle = u + a * u**2 + b * u**3
            return middle + c * u**2, middle - c * u**2
        a, b, c = np.exp(shape[0]), shape[1], shape[2]
        slope = a / np.cosh(b) ** 2
        up, down = ((np.tanh(a * u + b + s) - np.tanh(b + s)) / slope for s in (c, -c))
        return up, down

    def rest(self, shape: Array, u: float) -> Array:
        one = np.array([u])
        up, down = self._envelopes(shape, one)
        w = np.zeros(self.count + 1)
        played(w, up, down, np.linspace(0.0, 1.0, self.count + 1, endpoint=False)[None, :])
        return np.array([*w, u])

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        up, down = self._envelopes(shape, u)
        reach = np.broadcast_to(np.linspace(0.0, 1.0, self.count + 1, endpoint=False), (u.size, self.count + 1))
        if self.rate:
            reach = reach + (shape[-1] * rates)[:, None]
        w = state[:-1].copy()
        columns = played(w, up, down, reach)
        return np.column_stack([u, columns]), np.array([*w, u[-1]])


@dataclass(frozen=True)
class Preisach(Operator):
    """A discretised Preisach plane.

    In the coordinates ``r = (α − β)/2`` and ``s = (α + β)/2`` of a relay with the thresholds ``α ≥ β``, a relay is up
    where the play of radius ``r`` lies above ``s``. A density that is constant in ``s`` over a cell of one line of
    constant ``r`` therefore gives the column ``clip((P_r(u) − s_k)/Δs, 0, 1)``: continuous, unlike that of relays. The
    outer cells have no outer end, so that an input beyond the identified range does not saturate the model.

    References: Mayergoyz 1991 (the plane); Brokate, Sprekels 1996, Sec. 2.4 (by plays).
    """

    lines: int
    cells: int
    ridge: float = 1e-7

    positive = True

    @property
    def radii(self) -> Array:
        """(lines,) radii of the plays."""
        return np.linspace(0.0, 1.0, self.lines, endpoint=False)

    def rest(self, shape: Array, u: float) -> Array:
        one, w = np.array([u]), np.zeros(self.lines)
        played(w, one, one, self.radii[None, :])
        return np.array([*w, u])

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        w = state[:-1].copy()
        found = played(w, u, u, np.broadcast_to(self.radii, (u.size, self.lines)))
        columns = [self._line(found[:, k], 1.0 - r) for k, r in enumerate(self.radii)]
        return np.column_stack(columns), np.array([*w, u[-1]])

    def _line(self, p: Array, reach: float) -> Array:
        """Cells of one line, on which plays lie within ``±reach`` while the input stays in its range."""
        count = max(1, round(self.cells * reach))
        edges = np.linspace(-reach, reach, count + 1)
        low, high = edges[:-1].copy(), edges[1:].copy()
        low[0], high[-1] = -np.inf, np.inf
        return np.asarray((np.clip(p[:, None], low, high) - edges[:-1]) / (edges[1] - edges[0]))


@dataclass(frozen=True)
class Dahl(Operator):
    """Dahl operators ``dz_i/du = (1 − z_i sgn u̇)/δ_i`` beside polynomials of the input.

    With ``leaning``, ``u z_i`` as well: a Duhem model whose loop is wider on one side (Coleman, Hodgdon 1986).

    References: Dahl 1968; Visintin 1994, Ch. V (Duhem).
    """

    degree: int
    count: int
    leaning: bool = False

    ridge = 1e-9

    @property
    def start(self) -> Array:
        return np.log(np.geomspace(0.08, 0.6, self.count) if self.count > 1 else np.array([0.3]))

    @property
    def bounds(self) -> tuple[Array, Array]:
        return np.full(self.count, np.log(1e-3)), np.full(self.count, np.log(30.0))

    def rest(self, shape: Array, u: float) -> Array:
        z = np.zeros(self.count)
        dahl_kernel(z, 0.0, np.array([u]), np.exp(-shape), np.empty((1, self.count)))
        return np.array([*z, u])

    def run(self, shape: Array, state: Array, u: Array, rates: Array) -> tuple[Array, Array]:
        z, out = state[:-1].copy(), np.empty((u.size, self.count))
        dahl_kernel(z, float(state[-1]), np.ascontiguousarray(u), np.exp(-shape), out)
        columns = [polynomials(u, self.degree), out, *([u[:, None] * out] if self.leaning else [])]
        return np.column_stack(columns), np.array([*z, u[-1]])
