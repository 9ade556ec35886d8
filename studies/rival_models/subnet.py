"""A state-space network whose initial states come from an encoder of past inputs and outputs (SUBNET).

    x_0 = e(u_{−n..−1}, y_{−n..−1}),   x_{k+1} = x_k + A x_k + B u_k + f(x_k, u_k),   y_k = C x_k + D u_k + h(x_k, u_k)

A training begins with the best linear model in ``A, B, C, D``. The encoder ``e``, ``f`` and ``h`` are perceptrons of
one hidden layer. All are trained on windows that begin anywhere, the error being that of simulation from the encoded
state, truncated after a window. Recordings are on a grid of 16 samples a period of the highest frequency, input and
output over their half ranges.

Reference: Beintema, Schoukens, Tóth 2023, Deep subspace encoders for nonlinear system identification, Automatica 156.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.integrate.cache import compiled
from phnn.recordings.recording import Recording
from studies.rival_models.budget import Budget
from studies.rival_models.grid import Gridded, OnGrid, gridded, interval, on_grid
from studies.rival_models.linear_start import Linear, linear_model
from studies.rival_models.rival import Fitted, Rival, State, Stepper, anchored
from studies.rival_models.samples import Split, over_noise, scales_of, split
from studies.rival_models.torch_search import Trained, search

Array = NDArray[np.float64]

PER_PERIOD, WINDOW, BATCH = 16.0, 80, 128
SIZES = ((3, 16), (6, 24), (8, 48))  # states, hidden units
_LAGS = 12  # past samples that the encoder sees
_SMALL = 0.05  # of the random weights of what is not linear, at the beginning
_SEEN, _RIDGE = 2000, 0.1  # samples of each recording that start the encoder, and the weight of its ridge
_DIVERGED = 1e3
_RUN_IN = 400  # samples of constant input before a rest ends


class Net(nn.Module):
    """Encoder, state and output networks."""

    def __init__(self, states: int, width: int) -> None:
        super().__init__()
        last = nn.Linear(width, states, dtype=torch.float64)
        self.encoder = nn.Sequential(nn.Linear(2 * _LAGS, width, dtype=torch.float64), nn.Tanh(), last)
        self.encoded = nn.Linear(2 * _LAGS, states, dtype=torch.float64)
        self.linear = nn.Linear(states + 1, states, bias=False, dtype=torch.float64)
        self.inner, self.change = (
            nn.Linear(states + 1, width, dtype=torch.float64),
            nn.Linear(width, states, dtype=torch.float64),
        )
        self.out = nn.Linear(states + 1, 1, dtype=torch.float64)
        self.seen, self.shown = (
            nn.Linear(states + 1, width, dtype=torch.float64),
            nn.Linear(width, 1, bias=False, dtype=torch.float64),
        )
        with torch.no_grad():
            # Lags of different slowness; `start` puts the best linear model in front of them.
            self.linear.weight.zero_()
            self.linear.weight[:, :states] = -torch.diag(torch.logspace(-2.5, -0.5, states, dtype=torch.float64))
            self.linear.weight[:, states] = -torch.diagonal(self.linear.weight[:, :states])
            for layer in (self.change, self.shown, last):
                layer.weight.mul_(_SMALL)
                if layer.bias is not None:
                    layer.bias.zero_()

    @torch.no_grad()
    def start(self, linear: Linear, grids: Sequence[Gridded]) -> None:
        """Begin as the best linear model in the first states; the encoder finds its states by least squares."""
        step, driven, shown, direct = (torch.tensor(x) for x in linear.realised(grids))
        n, all_states = step.shape[0], self.linear.weight.shape[0]
        self.linear.weight[:n] = 0.0
        self.linear.weight[:n, :n] = step - torch.eye(n, dtype=torch.float64)
        self.linear.weight[:n, all_states] = driven
        self.out.weight.zero_()
        self.out.bias.zero_()
        self.out.weight[0, :n], self.out.weight[0, all_states] = shown, direct
        found = []
        for g in grids:
            x, states = torch.zeros(1, all_states, dtype=torch.float64), []
            for u in torch.tensor(g.u[:_SEEN])[:, None, None]:
                states.append(x[0])
                x = x + self.linear(torch.cat([x, u], dim=1))
            found.append(torch.stack(states))
        past = torch.tensor(np.concatenate([_past(g, np.arange(min(_SEEN, g.u.size))) for g in grids]))
        columns = torch.cat([past, _RIDGE * torch.eye(past.shape[1], dtype=torch.float64)])
        wanted = torch.cat([torch.cat(found), torch.zeros(past.shape[1], all_states, dtype=torch.float64)])
        self.encoded.weight.copy_(torch.linalg.lstsq(columns, wanted).solution.T)
        self.encoded.bias.zero_()

    def begin(self, past: Tensor) -> Tensor:
        """States (B, n) from past inputs and outputs (B, 2·lags)."""
        found: Tensor = self.encoder(past) + self.encoded(past)
        return found

    def step(self, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Next states and outputs (B,) for inputs (B, 1)."""
        z = torch.cat([x, u], dim=1)
        y = self.out(z) + self.shown(torch.tanh(self.seen(z)))
        return x + self.linear(z) + self.change(torch.tanh(self.inner(z))), y[:, 0]


def _rollout(x: Any, u: Any, f: Any, g: Any, most: float, out: Any) -> bool:
    """Simulate in place; ``f`` and ``g`` are the matrices of the state and the output network. False if it diverged."""
    n = x.size
    z = np.zeros(n + 1)
    linear, inner, inner_bias, change, change_bias = f
    direct, direct_bias, seen, seen_bias, shown = g
    for k in range(u.size):
        z[:n], z[n] = x, u[k]
        out[k] = (direct @ z)[0] + direct_bias[0] + (shown @ np.tanh(seen @ z + seen_bias))[0]
        x[:] = x + linear @ z + change @ np.tanh(inner @ z + inner_bias) + change_bias
        if not abs(out[k]) < most or not np.abs(x).max() < most:
            return False
    return True


rollout_kernel = compiled(_rollout)


def _matrices(net: Net) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """The weights that `_rollout` takes."""
    inner = (net.linear.weight, net.inner.weight, net.inner.bias, net.change.weight, net.change.bias)
    outer = (net.out.weight, net.out.bias, net.seen.weight, net.seen.bias, net.shown.weight)
    f, g = (tuple(w.detach().numpy().copy() for w in side) for side in (inner, outer))
    return f, g


@dataclass(frozen=True)
class SubnetFitted(OnGrid):
    """A trained network on a grid."""

    net: Net = None  # type: ignore[assignment]

    @torch.no_grad()
    def begin(self, g: Gridded) -> tuple[Array, int]:
        """State, and the sample of the grid that it belongs to: behind the encoder's past unless from rest."""
        first = 0 if g.rest or not np.isfinite(g.y[:_LAGS]).all() else min(_LAGS, g.known)
        past = torch.tensor(_past(g, np.array([first])))
        return self.net.begin(past)[0].numpy().copy(), first

    def simulate(self, recording: Recording) -> Array:
        g = self.gridded(recording)
        x, first = self.begin(g)
        y = np.zeros(g.u.size)
        y[:first] = g.y[:first]
        tail = np.zeros(g.u.size - first)
        good = rollout_kernel(x, np.ascontiguousarray(g.u[first:]), *_matrices(self.net), _DIVERGED, tail)
        y[first:] = tail
        return self.back(recording, y if good else np.full(y.size, np.inf), g)

    def stepper(self, dt: float) -> Stepper:
        self._same_interval(dt)
        return _Stepper(self)


class _Stepper(Stepper):
    def __init__(self, fitted: SubnetFitted) -> None:
        self.dt, self._fitted, self._matrices = fitted.grid, fitted, _matrices(fitted.net)

    @torch.no_grad()
    def rest(self, u: float) -> State:
        """From zero the encoder's state, as recordings from rest begin; else that after a long constant input."""
        x = u / self._fitted.scales.u
        past = np.concatenate([np.full(_LAGS, x), np.zeros(_LAGS)])[None]
        state = self._fitted.net.begin(torch.tensor(past))[0].numpy().copy()
        if x != 0.0:
            rollout_kernel(state, np.full(_RUN_IN, x), *self._matrices, _DIVERGED, np.zeros(_RUN_IN))
        return state

    def step(self, state: State, u: float) -> tuple[State, float]:
        state, y = state.copy(), np.zeros(1)
        rollout_kernel(state, np.array([u / self._fitted.scales.u]), *self._matrices, _DIVERGED, y)
        return state, float(y[0]) * self._fitted.scales.y

    def run(self, state: State, u: Array) -> tuple[State, Array]:
        state, y = state.copy(), np.full(u.size, np.nan)
        rollout_kernel(state, u / self._fitted.scales.u, *self._matrices, np.inf, y)
        return state, y * self._fitted.scales.y


def _past(g: Gridded, first: NDArray[np.int64]) -> Array:
    """(B, 2·lags) inputs and outputs before the samples ``first`` (B,); before the recording it rests."""
    u = np.concatenate([np.full(_LAGS, g.before), g.u])
    y = np.concatenate([np.zeros(_LAGS), np.where(np.isfinite(g.y), g.y, 0.0)])
    rows = first[:, None] + np.arange(_LAGS)
    return np.concatenate([u[rows], y[rows]], axis=1)


class _Batches(Trained):
    """Windows that begin at random samples of random recordings."""

    module: Net

    def __init__(self, fitted: SubnetFitted, recordings: Sequence[Recording], parts: Split, seed: int) -> None:
        self.module, self._fitted, self._recordings, self._parts = fitted.net, fitted, recordings, parts
        self._rng = np.random.default_rng(seed)
        self._used = []
        for r, mask in zip(recordings, parts.fit, strict=True):
            if mask.any():
                g = gridded(r, fitted.grid, fitted.scales, fitted.zero)
                self._used.append((g, on_grid(r, mask, fitted.grid, g.run_in, g.u.size), mask.sum() / r.noise**2))
        shares = np.array([share for _, _, share in self._used])
        self._shares = shares / shares.sum()

    @property
    def grids(self) -> list[Gridded]:
        """Recordings that are fitted."""
        return [g for g, _, _ in self._used]

    def loss(self) -> Tensor:
        counts = self._rng.multinomial(BATCH, self._shares)
        rows = [self._windows(g, m, n) for (g, m, _), n in zip(self._used, counts, strict=True) if n]
        past, u, y, w = (torch.tensor(np.concatenate(column)) for column in zip(*rows, strict=True))
        x, total = self._fitted.net.begin(past), torch.zeros((), dtype=torch.float64)
        for k in range(WINDOW):
            x, found = self._fitted.net.step(x, u[:, k : k + 1])
            total = total + torch.sum(w[:, k] * (found - y[:, k]) ** 2)
        return total / w.sum()

    def _windows(self, g: Gridded, mask: NDArray[np.bool_], count: int) -> tuple[Array, Array, Array, Array]:
        """Past, inputs, outputs and weights of windows of one recording; those that reach beyond its end are cut."""
        least = 0 if g.rest else min(_LAGS, g.u.size - 2)
        first = self._rng.integers(least, max(least + 1, g.u.size - WINDOW // 4), count)
        rows = first[:, None] + np.arange(WINDOW)
        inside = rows < g.u.size
        rows = np.minimum(rows, g.u.size - 1)
        weights = (inside & mask[rows]).astype(float)
        # Windows of short recordings hold fewer samples, and weigh as much as the others.
        weights *= WINDOW / np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
        return _past(g, first), g.u[rows], np.where(np.isfinite(g.y), g.y, 0.0)[rows], weights

    def check(self) -> float:
        chosen = [(r, m) for r, m in zip(self._recordings, self._parts.check, strict=True) if m.any()]
        outputs = [anchored(r, self._fitted.simulate(r), np.zeros((r.t.size, 0))) for r, _ in chosen]
        return over_noise([r for r, _ in chosen], outputs, [m for _, m in chosen])


class Subnet(Rival):
    """A subspace encoder network."""

    words = "state-space network with an encoder (SUBNET)"
    source = "Beintema, Schoukens, Tóth 2023"
    how = "from the best linear model, Adam on the truncated error of simulation from encoded states"

    def warm(self) -> None:
        rollout_kernel(np.zeros(2), np.zeros(2), *_matrices(Net(2, 3)), 1.0, np.zeros(2))

    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted:
        scales, parts, grid = scales_of(recordings), split(recordings), interval(recordings, PER_PERIOD)
        zero = float(np.mean(np.concatenate([r.y[r.mask("identification")] for r in recordings])))

        linear = linear_model(recordings, parts.fit, scales, grid, budget)

        def build(size: tuple[int, int]) -> _Batches:
            found = _Batches(SubnetFitted(0, {}, grid, scales, zero, Net(*size)), recordings, parts, seed)
            found.module.start(linear, found.grids)
            return found

        best = search(build, SIZES, budget, seed)
        net = best.trained.module
        facts = {
            "size": f"{best.size[0]} states, {best.size[1]} units, grid {grid:.3g} s", "sizes_tried": best.tried,
            "updates": best.updates, "check_over_noise": best.score, "processor_seconds": budget.used,
        }  # fmt: skip
        return SubnetFitted(sum(p.numel() for p in net.parameters()), facts, grid, scales, zero, net)
