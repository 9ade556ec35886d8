"""Networks in continuous time: a neural ODE and two learned port-Hamiltonian systems, trained in output error.

    neural ODE    ẋ = A x + B u + N(x, u)
    OE-pHNN       ẋ = (J(x) − R(x)) ∇H(x) + G(x) u,   H = ½ |x|² + a network
    sPHNN         the same with H(x) = ½ |x|² + F(x) − F(0) − ∇F(0)ᵀ x, F convex: H is least at rest

    J = S − Sᵀ,   R = L Lᵀ,   y = C x

S, L and G are networks of the state. Displacement and voltage are no power pair, so that the output is learned beside
the ports. Time is over the grid interval, and every sample takes one Runge–Kutta step of fourth order, with the input
as recorded in the middle of the interval. All begin as the best linear model: its modes turn and decay, which is a skew
J and a positive R with H = ½ |x|². Lags over the band of the recordings stand beside them.

They are trained on the error of free simulation; an unknown start is fitted to the first samples of a recording. The
authors of both port-Hamiltonian networks take Adam on short sections, whose starts an encoder tells. Here damped
Gauss–Newton steps on whole recordings take their place: within the same time they come much further. The derivative of
a step by state and weights is that of torch, for many samples at once; those of the outputs follow by
``S_k+1 = ∂Φ/∂x S_k + ∂Φ/∂θ``.

References: Moradi, Beintema, Jaensson, Tóth, Schoukens 2025, arXiv 2502.14432 (OE-pHNN); Roth, Klein, Kannapinn,
Peters, Weeger 2025, arXiv 2502.02480 (sPHNN); Chen et al. 2018 (neural ODE).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from scipy.signal import residue
from torch import Tensor, nn
from torch.func import functional_call, jacrev, vmap

from phnn.errors import SolverFailed
from phnn.recordings.recording import Recording
from studies.rival_models.grid import Gridded, GridStepper, OnGrid, data_on
from studies.rival_models.networks import PER_PERIOD, Linear, linear_model
from studies.rival_models.rival import Budget, Fitted, Mask, Rival, Spent, State

Array = NDArray[np.float64]

_FASTEST = 1.5  # |pole| times the grid interval at the start: Runge–Kutta steps stay stable
_RATES = (2e-3, 0.3)  # of the lags at the start, over the grid interval
_FAINT = 0.05  # random weights of outputs at the start
_CHUNK, _ROWS = 1024, 12_000  # samples whose derivatives are taken at once; rows of the normal equations
_FIRST, _REST, _FORGOTTEN = 100, 2000, 1000  # samples that tell an unknown start, of a rest, and of a run-in that count
_SEARCH, _PATIENCE = 0.5, 8  # share of the budget for all sizes; steps without a better check
_DAMPING, _EASED, _RAISED, _MOST = 1e-2, 0.3, 4.0, 1e7
_FREE = 0.3  # by how much a weight leaves its start for one noise in one sample: the spread of weights that torch draws
_BLACK, _OPEN, _STABLE = 0, 1, 2


def modes(linear: Linear, states: int) -> tuple[Array, Array, Array]:
    """Return (n, n), (n,), (n,) matrices A, B, C of the linear model in modal form, lags beside it.

    Poles that one step cannot follow are slowed down; the static gain of each mode stays.
    """
    shares, poles, _ = residue(*linear.transfer)
    a, b, c = np.zeros((states, states)), np.zeros(states), np.zeros(states)
    k = 0
    for share, pole in sorted(zip(shares, poles, strict=True), key=lambda pair: -abs(pair[0] / pair[1])):
        size = 2 if pole.imag > 0.0 else 1
        if pole.imag < 0.0 or k + size > states:
            continue
        slowed = min(1.0, _FASTEST / abs(pole))
        p, r = slowed * pole, share / abs(pole)
        b[k] = abs(p)
        if size == 2:
            a[k : k + 2, k : k + 2] = [[p.real, p.imag], [-p.imag, p.real]]
            c[k : k + 2] = 2.0 * r.real, 2.0 * r.imag
        else:
            a[k, k], c[k] = p.real, r.real
        k += size
    rates = np.geomspace(*_RATES, max(1, states - k))[: states - k]
    a[range(k, states), range(k, states)], b[k:] = -rates, rates
    return a, b, c


class Field(nn.Module):
    """A vector field with a linear output; see the formulas above.

    Args:
        kind: which of the three; states, width: how many, and hidden units of each network.
    """

    def __init__(self, kind: int, states: int, width: int, linear: Linear) -> None:
        super().__init__()
        self.kind, self.states = kind, states
        n = states
        a, b, c = (torch.from_numpy(x) for x in modes(linear, n))
        self.first = nn.Linear(n + 1 if kind == _BLACK else n, width, dtype=torch.float64)
        self.last = nn.Linear(width, n if kind == _BLACK else n * (2 * n + 1), dtype=torch.float64)
        self.c = nn.Parameter(c + _FAINT * torch.randn(n, dtype=torch.float64))
        with torch.no_grad():
            self.last.weight.mul_(_FAINT)
            self.last.bias.zero_()
        if kind == _BLACK:
            self.a, self.b = nn.Parameter(a), nn.Parameter(b)
            return
        # The modal form is a skew part and a decay: J, R and G begin there.
        low = torch.diag(torch.sqrt(torch.clamp(-torch.diag(a), min=1e-6)))
        self.last.bias.data = torch.cat([0.25 * (a - a.mT).flatten(), low.flatten(), b])
        self.energy = nn.Linear(n, width, dtype=torch.float64)
        self.curved = nn.Parameter(torch.full((width,), -2.0 if kind == _STABLE else 0.01, dtype=torch.float64))

    def weight(self) -> Tensor:
        """Return the factors (W,) of the energy's units, positive where the energy is convex."""
        return nn.functional.softplus(self.curved) if self.kind == _STABLE else self.curved

    def gradient(self, x: Tensor) -> Tensor:
        """Return ∇H (B, n) of states."""
        inner, bias = self.energy(x), self.energy.bias
        if self.kind == _OPEN:
            return x + (self.weight() * (1.0 - torch.tanh(inner) ** 2)) @ self.energy.weight
        return x + (self.weight() * (torch.sigmoid(inner) - torch.sigmoid(bias))) @ self.energy.weight

    def field(self, x: Tensor, u: Tensor) -> Tensor:
        """Return ẋ (B, n) at states and scaled inputs (B, 1), per grid interval."""
        if self.kind == _BLACK:
            return x @ self.a.mT + u * self.b + self.last(torch.tanh(self.first(torch.cat([x, u], dim=-1))))
        s, low, g = self.structure(x)
        e = self.gradient(x)[..., None]
        return (s @ e - s.mT @ e - low @ (low.mT @ e))[..., 0] + g * u

    def structure(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return S (B, n, n), L (B, n, n) and G (B, n) at states."""
        n = self.states
        s, low, g = self.last(torch.tanh(self.first(x))).split([n * n, n * n, n], dim=-1)
        return s.unflatten(-1, (n, n)), low.unflatten(-1, (n, n)), g

    def forward(self, x: Tensor, u: Tensor) -> Tensor:
        """Return the states (B, n) one grid interval later; inputs are (B, 3), at its start, middle and end."""
        u0, middle, u1 = u.split(1, dim=-1)
        f0 = self.field(x, u0)
        f1 = self.field(x + 0.5 * f0, middle)
        f2 = self.field(x + 0.5 * f1, middle)
        return x + (f0 + 2.0 * (f1 + f2) + self.field(x + f2, u1)) / 6.0

    def run(self, x: Array, u: Array) -> Array:
        """Return (N + 1, n) states from the first on, under inputs (N, 3); not finite where they diverge."""
        empty = torch.zeros(0, 0, dtype=torch.float64)
        energy = (self.energy.weight, self.energy.bias, self.weight()) if self.kind != _BLACK else None
        linear = (self.a, self.b) if self.kind == _BLACK else (empty, empty[0:0].flatten())
        layers = [*self.first.parameters(), *self.last.parameters(), *(energy or (empty, *2 * (empty.flatten(),)))]
        out = np.empty((len(u) + 1, x.size))
        out[0] = x
        _rollout(self.kind, out, np.ascontiguousarray(u), *(p.detach().numpy() for p in (*layers, *linear)))
        return out


@njit(cache=True, error_model="numpy")
def _field(
    kind: int, x: Array, u: float, w0: Array, b0: Array, w1: Array, b1: Array, we: Array, be: Array, weight: Array,
    a: Array, b: Array,
) -> Array:  # fmt: skip
    """Return ẋ (n,), as `Field.field` does."""
    n = x.size
    if kind == _BLACK:
        z = np.empty(n + 1)
        z[:n], z[n] = x, u
        return a @ x + b * u + w1 @ np.tanh(w0 @ z + b0) + b1
    inner = we @ x + be
    if kind == _OPEN:
        slopes = weight * (1.0 - np.tanh(inner) ** 2)
    else:
        slopes = weight * (1.0 / (1.0 + np.exp(-inner)) - 1.0 / (1.0 + np.exp(-be)))
    e = x + slopes @ we
    entries = w1 @ np.tanh(w0 @ x + b0) + b1
    s, low = entries[: n * n].copy().reshape(n, n), entries[n * n : 2 * n * n].copy().reshape(n, n)
    return s @ e - e @ s - low @ (e @ low) + entries[2 * n * n :] * u


@njit(cache=True, error_model="numpy")
def _rollout(
    kind: int, x: Array, u: Array, w0: Array, b0: Array, w1: Array, b1: Array, we: Array, be: Array, weight: Array,
    a: Array, b: Array,
) -> None:  # fmt: skip
    """Simulate into the states (N + 1, n), whose first row is given."""
    for k in range(len(u)):
        now, u0, um, u1 = x[k].copy(), u[k, 0], u[k, 1], u[k, 2]
        f0 = _field(kind, now, u0, w0, b0, w1, b1, we, be, weight, a, b)
        f1 = _field(kind, now + 0.5 * f0, um, w0, b0, w1, b1, we, be, weight, a, b)
        f2 = _field(kind, now + 0.5 * f1, um, w0, b0, w1, b1, we, be, weight, a, b)
        f3 = _field(kind, now + f2, u1, w0, b0, w1, b1, we, be, weight, a, b)
        x[k + 1] = now + (f0 + 2.0 * (f1 + f2) + f3) / 6.0


class _Stepper(GridStepper):
    """The state holds the network's and the last scaled input."""

    def rest(self, u: float) -> State:
        x = u / self._fitted.scales.u
        return self._fitted.rest(x), x

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        x = np.append(state[1], u / self._fitted.scales.u)
        path = self._fitted.net.run(state[0], np.column_stack([x[:-1], 0.5 * (x[:-1] + x[1:]), x[1:]]))
        return (path[-1], x[-1]), path[1:] @ self._fitted.net.c.detach().numpy() * self._fitted.scales.y


@dataclass(frozen=True)
class ContinuousFitted(OnGrid):
    """A trained vector field on a grid."""

    steps = _Stepper
    net: Field = None  # type: ignore[assignment]

    def rest(self, u: float) -> Array:
        """Return the state (n,) after a rest at a scaled input: zero for zero, else what follows from there."""
        x = np.zeros(self.net.states)
        return self.net.run(x, np.full((_REST, 3), u))[-1] if u else x

    def start(self, g: Gridded) -> Array:
        """Return the state (n,) before a recording: at rest, else the one that its first outputs tell best."""
        x, count = self.rest(g.before), min(_FIRST, g.known)
        if g.rest or g.run_in or count <= x.size or not np.isfinite(g.y[:count]).all():
            return x
        u, c, step = g.fine[:count], self.net.c.detach().numpy(), 1e-4
        for _ in range(3):
            paths = np.stack([self.net.run(x + step * e, u)[1:] @ c for e in (0.0 * x, *np.eye(x.size))])
            if not np.isfinite(paths).all():
                break
            columns = np.column_stack([(paths[1:] - paths[0]).T / step, np.ones(count)])
            x = x + np.linalg.lstsq(columns, g.y[:count] - paths[0], rcond=1e-3)[0][:-1]
        return x

    def states(self, g: Gridded) -> Array:
        """Return (N + 1, n) states, the first before the recording."""
        return self.net.run(self.start(g), g.fine)

    def run_grid(self, g: Gridded) -> Array:
        return np.asarray(self.states(g)[1:] @ self.net.c.detach().numpy())


class _Training:
    """Damped Gauss–Newton on the error of free simulation, over noise, and on how far weights leave their start."""

    def __init__(self, fitted: ContinuousFitted, grids: Sequence[Gridded], fit: Sequence[Mask], check: Sequence[Mask]):
        self.fitted, self.net, self.damping, self.steps, self.evaluations = fitted, fitted.net, _DAMPING, 0, 0
        self.origin = nn.utils.parameters_to_vector(self.net.parameters()).detach()
        self.fit, self.check = ([(g, m) for g, m in zip(grids, ms, strict=True) if m.any()] for ms in (fit, check))
        self.best, self.kept, self.since = self.error(self.check), copy.deepcopy(self.net.state_dict()), 0

    def error(self, used: Sequence[tuple[Gridded, Mask]]) -> float:
        """Return the mean square of the error over noise, recordings' means taken out; infinite where it diverged."""
        self.evaluations += 1
        parts = [((g.y - self.fitted.run_grid(g))[m] / g.noise) for g, m in used]
        squares = np.concatenate([(e - e.mean()) ** 2 for e in parts])
        return float(squares.mean()) if np.isfinite(squares).all() else math.inf

    def cost(self) -> float:
        """Return what a step has to lower: the error on the samples to fit, and the share of the weights."""
        moved = nn.utils.parameters_to_vector(self.net.parameters()).detach() - self.origin
        return self.error(self.fit) + float(moved.square().sum()) / (_FREE**2 * sum(m.sum() for _, m in self.fit))

    def run(self, budget: Budget) -> float:
        """Step until the budget is spent or the check no longer falls; leave the best weights, return their check."""
        try:
            while self.steps < budget.most and self.since < _PATIENCE and self._step(budget):
                self.steps, self.since = self.steps + 1, self.since + 1
                score = self.error(self.check)
                if score < self.best:
                    self.since = 0 if score < 0.999 * self.best else self.since
                    self.best, self.kept = score, copy.deepcopy(self.net.state_dict())
        except Spent:
            pass
        self.net.load_state_dict(self.kept)
        return self.best

    def _step(self, budget: Budget) -> bool:
        """Take one step; return whether one was found."""
        normal, slope = self._normal(budget)
        scale = np.maximum(np.diag(normal), 1e-6 * np.diag(normal).max())
        before, cost = nn.utils.parameters_to_vector(self.net.parameters()).detach(), self.cost()
        while self.damping < _MOST:
            step = np.linalg.solve(normal + self.damping * np.diag(scale), slope)
            self._move(before + torch.from_numpy(step))
            if self.cost() < cost:
                self.damping = max(_EASED * self.damping, 1e-8)
                return True
            self.damping *= _RAISED
            if budget.left <= 0.0:
                break
        self._move(before)
        return False

    @torch.no_grad()
    def _move(self, values: Tensor) -> None:
        nn.utils.vector_to_parameters(values, self.net.parameters())

    def _normal(self, budget: Budget) -> tuple[Array, Array]:
        """Return JᵀJ (P, P) and Jᵀ r (P,) of the weighted outputs, over the number of samples."""
        size = sum(p.numel() for p in self.net.parameters())
        total, slope, samples = np.zeros((size, size)), np.zeros(size), sum(int(m.sum()) for _, m in self.fit)
        stride = max(1, samples // _ROWS)
        for g, mask in self.fit:
            states = self.fitted.states(g)
            # Most of a run-in is forgotten: its last part gives the sensitivities that a recording begins with.
            first = max(0, g.run_in - _FORGOTTEN)
            rows = self._sensitivities(states[first:], g.fine[first:], budget)[mask[first:]]
            rows = rows[::stride] / g.noise
            error = (g.y - states[1:] @ self.net.c.detach().numpy())[mask][::stride] / g.noise
            rows -= rows.mean(axis=0)
            total, slope = total + rows.T @ rows, slope + rows.T @ (error - error.mean())
        moved = (nn.utils.parameters_to_vector(self.net.parameters()).detach() - self.origin).numpy()
        return (total * stride + np.eye(size) / _FREE**2) / samples, (slope * stride - moved / _FREE**2) / samples

    def _sensitivities(self, x: Array, u: Array, budget: Budget) -> Array:
        """Return (N, P) derivatives of the outputs by all parameters, from states (N + 1, n) under inputs (N, 3)."""
        named = dict(self.net.named_parameters())
        sizes, n = [p.numel() for p in named.values()], self.net.states

        def step(weights: dict[str, Tensor], x: Tensor, u: Tensor) -> Tensor:
            return functional_call(self.net, weights, (x, u))

        slopes = vmap(jacrev(step, argnums=(0, 1)), in_dims=(None, 0, 0))
        state, c = np.zeros((n, sum(sizes))), self.net.c.detach().numpy()
        place = sum(sizes[: list(named).index("c")])
        out = np.empty((len(u), sum(sizes)))
        weights = {k: p.detach() for k, p in named.items()}
        for first in range(0, len(u), _CHUNK):
            budget.check()
            last = min(first + _CHUNK, len(u))
            by, into = slopes(weights, torch.from_numpy(x[first:last]), torch.from_numpy(u[first:last]))
            driven = torch.cat([p.reshape(last - first, n, -1) for p in by.values()], dim=-1).numpy()
            out[first:last] = _chained(state, into.numpy(), driven, c)
        out[:, place : place + n] += x[1:]
        return out


@njit(cache=True)
def _chained(state: Array, into: Array, driven: Array, c: Array) -> Array:
    """Return (N, P) rows ``Cᵀ S_k`` of ``S ← A_k S + B_k``; the state ``S`` (n, P) is moved on."""
    out = np.empty((into.shape[0], state.shape[1]))
    for k in range(into.shape[0]):
        state[:] = np.dot(into[k], state) + driven[k]
        out[k] = np.dot(c, state)
    return out


class _Continuous(Rival):
    """A network in continuous time, from the best linear model; the best one of several sizes goes on."""

    kind: int
    sizes: Sequence[tuple[int, int]] = ((4, 8),)  # states, hidden units
    how = "from the best linear model, damped Gauss–Newton on the error of free simulation"

    def warm(self) -> None:
        net = Field(self.kind, 3, 3, Linear(np.zeros(1), np.ones(1), (np.ones(1), np.ones(2))))
        net.run(np.zeros(3), np.zeros((1, 3)))
        _chained(np.zeros((3, 2)), np.zeros((1, 3, 3)), np.zeros((1, 3, 2)), np.zeros(3))

    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted:
        data = data_on(recordings, PER_PERIOD)
        linear = linear_model(recordings, data, budget)
        torch.manual_seed(seed)
        tried: list[tuple[float, int, _Training]] = []
        both = [f | c for f, c in zip(data.fit, data.check, strict=True)]
        for k, (states, width) in enumerate(self.sizes):
            net = Field(self.kind, states, width, linear)
            fitted = ContinuousFitted(0, {}, data.dt, data.scales, data.zero, net)
            training = _Training(fitted, data.gridded, data.fit, data.check)
            # One size needs no choice.
            turn = budget.share(_SEARCH, len(self.sizes) - k) if len(self.sizes) > 1 else replace(budget, most=0)
            tried.append((training.run(turn), k, training))
            if budget.left <= 0.0:
                break
        score, k, training = min(tried, key=lambda t: t[:2])
        if budget.left > 0.0:
            # The samples set aside have chosen the size: all of them together begin at the start again.
            training._move(training.origin)
            last = _Training(training.fitted, data.gridded, both, both)
            last.run(budget)
            tried.append((score, k, last))
        if not np.isfinite(score):
            raise SolverFailed("no network stayed finite in simulation: allow more time, or scale the recordings")
        checked = sum(int(m.sum()) for m in data.check)
        facts: dict[str, Any] = {
            "size": f"{self.sizes[k]}, grid {data.dt:.3g} s", "sizes_tried": len({k for _, k, _ in tried}),
            "steps": sum(t.steps for *_, t in tried), "evaluations": sum(t.evaluations for *_, t in tried),
            "check_over_noise": math.sqrt(score * checked / data.checked), "processor_seconds": budget.used,
        }  # fmt: skip
        count = sum(p.numel() for p in training.net.parameters())
        return replace(training.fitted, parameters=count, facts=facts)


class NeuralOde(_Continuous):
    """A neural ordinary differential equation."""

    words, source = "neural ordinary differential equation, from the best linear model", "Chen et al. 2018"
    kind, sizes, times = _BLACK, ((4, 16), (6, 32)), 2.0


class OePhnn(_Continuous):
    """An output-error port-Hamiltonian network."""

    words, source, kind = "output-error port-Hamiltonian network (OE-pHNN)", "Moradi et al. 2025", _OPEN


class SPhnn(_Continuous):
    """A stable port-Hamiltonian network."""

    words, source, kind = "stable port-Hamiltonian network with a convex energy (sPHNN)", "Roth et al. 2025", _STABLE
