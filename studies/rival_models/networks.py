"""Networks from input to output beside the best linear model: a GRU, and a state-space network with an encoder.

    z_k = (u_k, 8 Δu_k),   y_k = l_k + h(x_k, z_k),   x_{k+1} = f(x_k, z_k)

``l`` is the output of the best linear model: from random weights some thousand updates go by before a network has
learned that the output follows the input (Schoukens, Tóth 2020). Recordings are on a grid of 16 samples a period of the
highest frequency, input and output over their half ranges. All are trained with Adam on windows that begin anywhere.
The state at a window's beginning is that of a recurrent network after the samples in front of it, or what the encoder
makes of their inputs and outputs. Every size gets the same share of the time; the best one goes on with the rest. What
counts is the state with the least error on the samples set aside.

References: Cho et al. 2014 (GRU); Beintema, Schoukens, Tóth 2023, Automatica 156
(SUBNET).
"""

from __future__ import annotations

import copy
import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter, lfilter_zi
from torch import Tensor, nn

from phnn.errors import SolverFailed
from phnn.recordings.recording import Recording
from studies.rival_models.grid import Data, Gridded, GridStepper, OnGrid, data_on
from studies.rival_models.hysteresis import STARTS, Static, Structure, fit_structure, free_responses, transfer
from studies.rival_models.rival import Budget, Fitted, Rival, State, over_noise, split

Array = NDArray[np.float64]

PER_PERIOD, WINDOW, BATCH = 16.0, 64, 64
_PAST, _LAGS = 32, 12  # samples in front of a window; of these, what the encoder sees
_LINEAR, _SEARCH = 0.1, 0.6  # shares of the budget for the linear model, and then for all sizes together
_RATE, _LEAST, _CLIP = 5e-3, 2e-4, 1.0  # learning rate, first and last; norm of the gradient
_CHECKS = 20  # of the samples set aside, in a training
_SMALL = 0.1  # of random output weights, at the beginning
_STEEP = 8.0  # factor of the scaled Δu: about one for the fastest sine
_FIRST = 100  # grid samples that tell an unknown start
_REST = 400  # samples of constant input before a rest ends


@dataclass(frozen=True)
class Linear:
    """Scaled output of a scaled input on the grid: numerator ``b`` and denominator ``a`` in z⁻¹, third order.

    ``transfer`` is the same in s times the grid interval.
    """

    b: Array
    a: Array
    transfer: tuple[Array, Array] = (np.zeros(1), np.ones(1))

    def run(self, u: Array, state: Array) -> tuple[Array, Array]:
        """Return (N,) outputs, and the filter's state behind them."""
        y, state = lfilter(self.b, self.a, u, zi=state)
        return np.asarray(y), np.asarray(state)

    def rest(self, u: float) -> Array:
        """Return the filter's state after a rest at a scaled input."""
        return np.asarray(lfilter_zi(self.b, self.a) * u)

    def start(self, g: Gridded) -> Array:
        """Return the state in front of a recording: at rest, else the one that its first outputs tell best."""
        rest, count = self.rest(g.before), min(_FIRST, g.known)
        if g.rest or count < self.a.size or not np.isfinite(g.y[:count]).all():
            return rest
        missing = g.y[:count] - self.run(g.u[:count], rest)[0]
        # A constant beside the free responses: the recording's zero.
        columns = np.column_stack([free_responses(self.b, self.a, count), np.ones(count)])
        return np.asarray(rest + np.linalg.lstsq(columns, missing, rcond=1e-6)[0][:-1])


def linear_model(recordings: Sequence[Recording], data: Data, budget: Budget) -> Linear:
    """Fit second-order dynamics with one lag, for inputs that are linear on the grid.

    Raises:
        SolverFailed: the time does not suffice for one evaluation.
    """
    structure = Structure(Static(1), 1, data.scales)
    starts = [structure.start(*start) for start in STARTS]
    fitted = fit_structure(structure, recordings, split(recordings).fit, starts, budget.part(_LINEAR))
    if fitted is None:
        raise SolverFailed("no linear model was found within the budget: allow more time")
    b, a = structure.filter(fitted.x, data.dt)
    gain = float(fitted.weights[0]) / data.scales.y
    numerator, denominator = transfer(structure.parted(fitted.x)[0], data.scales.rate * data.dt)
    return Linear(b * gain, a, (numerator * gain, denominator))


class Net(nn.Module):
    """A network; rows (B, T, 4) hold input, its steep change, the linear model's output, and the measured output."""

    @abstractmethod
    def begin(self, past: Tensor) -> Any:
        """Return the state behind rows (B, P, 4)."""

    @abstractmethod
    def forward(self, rows: Tensor, state: Any) -> tuple[Tensor, Any]:
        """Return outputs (B, T) of rows, and the state behind them; measured outputs take no part."""

    def simulate(self, rows: Tensor, state: Any) -> tuple[Tensor, Any]:
        """Return the same for one long sequence without gradient."""
        outputs: tuple[Tensor, Any] = self(rows, state)
        return outputs


class RecurrentNet(Net):
    """Gated recurrent units of torch with a linear output."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.layer = nn.GRU(3, hidden, batch_first=True, dtype=torch.float64)
        self.out = nn.Linear(hidden, 1, dtype=torch.float64)
        _shrink(self.out)

    def begin(self, past: Tensor) -> Any:
        return self.layer(past[..., :3])[1]

    def forward(self, rows: Tensor, state: Any) -> tuple[Tensor, Any]:
        h, state = self.layer(rows[..., :3], state)
        return rows[..., 2] + self.out(h)[..., 0], state


class EncodedNet(Net):
    """A state-space network whose first state an encoder tells; its perceptrons have one hidden layer."""

    def __init__(self, states: int, width: int) -> None:
        super().__init__()

        def perceptron(inputs: int, outputs: int) -> nn.Sequential:
            first, last = (nn.Linear(a, b, dtype=torch.float64) for a, b in ((inputs, width), (width, outputs)))
            _shrink(last)
            return nn.Sequential(first, nn.Tanh(), last)

        self.encoder = perceptron(2 * _LAGS, states)
        self.linear = nn.Linear(states + 2, states, bias=False, dtype=torch.float64)
        self.f, self.h = perceptron(states + 2, states), perceptron(states + 2, 1)
        with torch.no_grad():
            # Lags of different slowness.
            slow = torch.logspace(-2.5, -0.5, states, dtype=torch.float64)
            self.linear.weight.copy_(torch.cat([-torch.diag(slow), slow[:, None], 0.0 * slow[:, None]], dim=1))

    def begin(self, past: Tensor) -> Any:
        late = past[:, -_LAGS:]
        encoded: Tensor = self.encoder(torch.cat([late[..., 0], late[..., 3] - late[..., 2]], dim=1))
        return encoded

    def forward(self, rows: Tensor, state: Any) -> tuple[Tensor, Any]:
        outputs = []
        for k in range(rows.shape[1]):
            z = torch.cat([state, rows[:, k, :2]], dim=1)
            outputs.append(rows[:, k, 2] + self.h(z)[:, 0])
            state = state + self.linear(z) + self.f(z)
        return torch.stack(outputs, dim=1), state

    def simulate(self, rows: Tensor, state: Any) -> tuple[Tensor, Any]:
        weights = [p.detach().numpy() for part in (self.linear, self.f, self.h) for p in part.parameters()]
        x, y = state[0].numpy().copy(), np.empty(rows.shape[1])
        _rollout(x, np.ascontiguousarray(rows[0, :, :3].numpy()), y, *weights)
        return torch.from_numpy(y)[None], torch.from_numpy(x)[None]


@njit(cache=True)
def _rollout(
    x: Array, rows: Array, y: Array, a: Array, f0: Array, f0b: Array, f1: Array, f1b: Array, h0: Array, h0b: Array,
    h1: Array, h1b: Array,
) -> None:  # fmt: skip
    """Simulate the state-space network into ``y``; the state ``x`` is moved on."""
    z = np.empty(x.size + 2)
    for k in range(y.size):
        z[: x.size], z[x.size :] = x, rows[k, :2]
        y[k] = rows[k, 2] + (h1 @ np.tanh(h0 @ z + h0b))[0] + h1b[0]
        x[:] = x + a @ z + f1 @ np.tanh(f0 @ z + f0b) + f1b


@torch.no_grad()
def _shrink(layer: Any) -> None:
    layer.weight.mul_(_SMALL)
    layer.bias.zero_()


def _rows(u: Array, last: float, linear: Array, y: Array | float = 0.0) -> Array:
    """Return (N, 4) rows of scaled values; ``last``: the input before them."""
    return np.column_stack([u, _STEEP * np.diff(u, prepend=last), linear, np.broadcast_to(y, u.shape)])


def _tensor(rows: Array) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(rows))[None]


class _Stepper(GridStepper):
    """The state holds those of the network and of the linear model, and the last scaled input."""

    def rest(self, u: float) -> State:
        x = u / self._fitted.scales.u
        return self._fitted.rested(x), self._fitted.linear.rest(x), x

    @torch.no_grad()
    def run(self, state: State, u: Array) -> tuple[State, Array]:
        inner, kept, last = state
        x = u / self._fitted.scales.u
        linear, kept = self._fitted.linear.run(x, kept)
        y, inner = self._fitted.net.simulate(_tensor(_rows(x, last, linear)), inner)
        return (inner, kept, float(x[-1])), y[0].numpy() * self._fitted.scales.y


@dataclass(frozen=True)
class NetFitted(OnGrid):
    """A trained network beside a linear model, on a grid."""

    steps = _Stepper
    net: Net = None  # type: ignore[assignment]
    linear: Linear = None  # type: ignore[assignment]

    def rows(self, g: Gridded) -> Array:
        """Return (P + N, 4) rows of a recording behind those of the rest in front of it."""
        u = np.full(_PAST, g.before)
        before = _rows(u, g.before, self.linear.run(u, self.linear.rest(g.before))[0])
        linear = self.linear.run(g.u, self.linear.start(g))[0]
        return np.concatenate([before, _rows(g.u, g.before, linear, np.where(np.isfinite(g.y), g.y, 0.0))])

    @torch.no_grad()
    def rested(self, u: float) -> Any:
        """Return the network's state after a rest at a scaled input."""
        constant = np.full(_REST if u else _PAST, u)
        rows = _rows(constant, u, self.linear.run(constant, self.linear.rest(u))[0])
        state = self.net.begin(_tensor(rows[:_PAST]))
        return self.net.simulate(_tensor(rows), state)[1] if u else state

    @torch.no_grad()
    def run_grid(self, g: Gridded) -> Array:
        rows, first = self.rows(g), 0
        state = self.rested(g.before)
        # An encoder begins behind the first measured outputs of a recording that does not begin at rest.
        if isinstance(self.net, EncodedNet) and not g.rest and g.known >= _LAGS and np.isfinite(g.y[:_LAGS]).all():
            first = _LAGS
            state = self.net.begin(_tensor(rows[: _PAST + first]))
        y = self.net.simulate(_tensor(rows[_PAST + first :]), state)[0][0].numpy()
        return np.concatenate([g.y[:first], y])


class _Windows:
    """Windows that begin at random samples of random recordings, each recording weighted by samples over noise."""

    def __init__(self, fitted: NetFitted, data: Data, seed: int) -> None:
        self._rng, self._used = np.random.default_rng(seed), []
        for g, mask in zip(data.gridded, data.fit, strict=True):
            if mask.any():
                weights = np.concatenate([np.zeros(_PAST), mask / mask.mean(), np.zeros(WINDOW)])
                rows = np.concatenate([fitted.rows(g), np.zeros((WINDOW, 4))])
                self._used.append((rows, weights, g.u.size, mask.sum() / g.noise**2))
        shares = np.array([share for *_, share in self._used])
        self._shares = shares / shares.sum()

    def loss(self, net: Net) -> Tensor:
        """Return the weighted mean square of the scaled residual on a batch."""
        batch, weights = [], []
        for (rows, weight, size, _), n in zip(self._used, self._rng.multinomial(BATCH, self._shares), strict=True):
            first = self._rng.integers(0, max(1, size - WINDOW // 4), n)
            places = first[:, None] + np.arange(_PAST + WINDOW)
            batch.append(rows[places])
            weights.append(weight[places[:, _PAST:]])
        z, w = torch.from_numpy(np.concatenate(batch)), torch.from_numpy(np.concatenate(weights))
        y, _ = net(z[:, _PAST:], net.begin(z[:, :_PAST]))
        return torch.sum(w * (y - z[:, _PAST:, 3]) ** 2) / w.sum()


class NetRival(Rival):
    """Networks of several sizes."""

    sizes: Sequence[Any]
    how = "from the best linear model, Adam on the error of simulation over windows"

    @abstractmethod
    def build(self, size: Any) -> Net:
        """Return a network with random weights."""

    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted:
        data = data_on(recordings, PER_PERIOD)
        linear = linear_model(recordings, data, budget)
        torch.manual_seed(seed)
        tried: list[tuple[float, int, Any, NetFitted]] = []
        updates = 0
        for k, size in enumerate(self.sizes):
            net = self.build(size)
            fitted = NetFitted(0, {}, data.dt, data.scales, data.zero, net, linear)
            share = _SEARCH / len(self.sizes) / (1.0 - _SEARCH * k / len(self.sizes))
            score, number = _train(fitted, recordings, _Windows(fitted, data, seed), budget.part(share), _RATE)
            updates += number
            tried.append((score, k, size, fitted))
            if budget.left <= 0.0:
                break
        score, _, size, fitted = min(tried, key=lambda t: t[:2])
        if budget.left > 0.0:
            score, number = _train(fitted, recordings, _Windows(fitted, data, seed + 1), budget, 0.5 * _RATE)
            updates += number
        if not np.isfinite(score):
            raise SolverFailed("no network stayed finite in simulation: allow more time, or scale the recordings")
        facts = {
            "size": f"{size}, grid {data.dt:.3g} s", "sizes_tried": len(tried), "evaluations": updates,
            "check_over_noise": score, "processor_seconds": budget.used,
        }  # fmt: skip
        parameters = sum(p.numel() for p in fitted.net.parameters()) + linear.a.size + linear.b.size
        return replace(fitted, parameters=parameters, facts=facts)


def _train(
    fitted: NetFitted, recordings: Sequence[Recording], windows: _Windows, budget: Budget, rate: float
) -> tuple[float, int]:
    """Train until the budget or the number of updates is spent; leave the best weights in the network.

    The learning rate falls as half a cosine over the training's time.

    Returns:
        The error on the samples set aside, and the number of updates.
    """
    net, check = fitted.net, split(recordings).check
    optimiser = torch.optim.Adam(net.parameters(), lr=rate)
    best, kept = over_noise(fitted, recordings, check), copy.deepcopy(net.state_dict())
    checked, count = 0.0, 0
    while True:
        progress = count / budget.most
        if math.isfinite(budget.seconds):
            progress = max(progress, budget.used / max(budget.seconds, 1e-9))
        if progress - checked >= 1.0 / _CHECKS or progress >= 1.0:
            checked, score = progress, over_noise(fitted, recordings, check)
            if score < best:
                best, kept = score, copy.deepcopy(net.state_dict())
        if progress >= 1.0:
            break
        for group in optimiser.param_groups:
            group["lr"] = _LEAST + 0.5 * max(rate - _LEAST, 0.0) * (1.0 + math.cos(math.pi * progress))
        optimiser.zero_grad()
        windows.loss(net).backward()
        nn.utils.clip_grad_norm_(net.parameters(), _CLIP)
        optimiser.step()
        count += 1
    net.load_state_dict(kept)
    return best, count


class Gru(NetRival):
    """Gated recurrent units."""

    words = "recurrent network of gated recurrent units"
    source = "Cho et al. 2014"
    sizes = (8, 16, 32)  # units

    def build(self, size: Any) -> Net:
        return RecurrentNet(size)


class Subnet(NetRival):
    """A subspace encoder network."""

    words = "state-space network with an encoder (SUBNET)"
    source = "Beintema, Schoukens, Tóth 2023"
    sizes = ((3, 16), (6, 24), (8, 48))  # states, hidden units

    def warm(self) -> None:
        net = EncodedNet(2, 3)
        net.simulate(torch.zeros(1, 2, 4, dtype=torch.float64), torch.zeros(1, 2, dtype=torch.float64))

    def build(self, size: Any) -> Net:
        return EncodedNet(*size)
