"""Recurrent networks from input to output: gated recurrent units and long short-term memory.

    h_k = cell(h_{k−1}, (u_k, Δu_k, l_k)),   y_k = c·h_k + d u_k + f l_k + e

``l`` is the output of the best linear model, with which a training begins (d = e = 0, f = 1, c small). Recordings are
put on a grid of 16 samples a period of the highest frequency, input and output over their half ranges. The whole
recordings are passed through without gradient now and then, which gives the states in which windows of 64 samples
begin; all windows together are one batch (truncated backpropagation with stored states). A recording weighs as much as
with the samples it was recorded with.

References: Cho et al. 2014 (GRU); Hochreiter, Schmidhuber 1997 (LSTM); Kapturowski et al. 2019 (stored states).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.recordings.recording import Recording
from studies.rival_models.budget import Budget
from studies.rival_models.grid import Gridded, OnGrid, gridded, interval, on_grid
from studies.rival_models.linear_start import Linear, linear_model
from studies.rival_models.rival import Fitted, Rival, State, Stepper, anchored
from studies.rival_models.samples import Split, over_noise, scales_of, split
from studies.rival_models.torch_search import Trained, search

Array = NDArray[np.float64]

PER_PERIOD, WINDOW, SIZES = 16.0, 64, (8, 16, 32)
_REFRESH = 8  # updates between two passes that store states
_RUN_IN = 100  # samples of constant input before a rest ends
_SMALL = 0.1  # of random output weights, at the beginning
_STEEP = 8.0  # times which the scaled Δu is given: about one for the fastest sine


class Cell(nn.Module):
    """The recurrent layer with its output."""

    def __init__(self, kind: str, hidden: int) -> None:
        super().__init__()
        layer = nn.GRU if kind == "gru" else nn.LSTM
        self.layer = layer(3, hidden, batch_first=True, dtype=torch.float64)
        self.out = nn.Linear(hidden, 1, dtype=torch.float64)
        self.direct = nn.Linear(2, 1, bias=False, dtype=torch.float64)
        with torch.no_grad():
            self.out.weight.mul_(_SMALL)
            self.out.bias.zero_()
            self.direct.weight.copy_(torch.tensor([[0.0, 1.0]]))

    def forward(self, x: Tensor, state: Any = None) -> tuple[Tensor, Any]:
        """Outputs (B, T) of inputs (B, T, 3), and the last state."""
        h, state = self.layer(x, state)
        return (self.out(h) + self.direct(x[..., ::2]))[..., 0], state


def _inputs(u: Array, last: float, linear: Array) -> Tensor:
    """(1, T, 3) of scaled inputs and outputs of the linear model (T,)."""
    return torch.tensor(np.stack([u, _STEEP * np.diff(u, prepend=last), linear], axis=-1))[None]


@dataclass(frozen=True)
class RecurrentFitted(OnGrid):
    """A trained cell on a grid."""

    cell: Cell = None  # type: ignore[assignment]
    linear: Linear = None  # type: ignore[assignment]

    def inputs(self, g: Gridded) -> Tensor:
        """(1, T, 3) what the cell sees of a recording."""
        return _inputs(g.u, g.before, self.linear.run(g.u, self.linear.start(g))[0])

    @torch.no_grad()
    def rested(self, u: float) -> Any:
        """The cell's state after a rest at a scaled input."""
        constant = np.full(_RUN_IN, u)
        return self.cell(_inputs(constant, u, self.linear.run(constant, self.linear.rest(u))[0]))[1]

    @torch.no_grad()
    def simulate(self, recording: Recording) -> Array:
        g = self.gridded(recording)
        y, _ = self.cell(self.inputs(g), self.rested(g.before))
        return self.back(recording, y[0].numpy(), g)

    def stepper(self, dt: float) -> Stepper:
        self._same_interval(dt)
        return _Stepper(self)


class _Stepper(Stepper):
    def __init__(self, fitted: RecurrentFitted) -> None:
        self.dt, self._fitted = fitted.grid, fitted

    def rest(self, u: float) -> State:
        x = u / self._fitted.scales.u
        return self._fitted.rested(x), self._fitted.linear.rest(x), x

    @torch.no_grad()
    def step(self, state: State, u: float) -> tuple[State, float]:
        inner, kept, last = state
        x = np.array([u / self._fitted.scales.u])
        linear, kept = self._fitted.linear.run(x, kept)
        y, inner = self._fitted.cell(_inputs(x, last, linear), inner)
        return (inner, kept, float(x[0])), float(y[0, 0]) * self._fitted.scales.y

    @torch.no_grad()
    def run(self, state: State, u: Array) -> tuple[State, Array]:
        inner, kept, last = state
        x = u / self._fitted.scales.u
        linear, kept = self._fitted.linear.run(x, kept)
        y, inner = self._fitted.cell(_inputs(x, last, linear), inner)
        return (inner, kept, float(x[-1])), y[0].numpy() * self._fitted.scales.y


class _Windows(Trained):
    """Windows of all recordings, padded at their ends, with stored initial states."""

    def __init__(self, fitted: RecurrentFitted, recordings: Sequence[Recording], parts: Split) -> None:
        self.module, self._fitted, self._recordings, self._parts = fitted.cell, fitted, recordings, parts
        self._grids = [gridded(r, fitted.grid, fitted.scales, fitted.zero) for r in recordings]
        self._used = [(g, m, r) for g, m, r in zip(self._grids, parts.fit, recordings, strict=True) if m.any()]
        shapes = [
            self._cut(g, fitted.inputs(g)[0], on_grid(r, m, fitted.grid, g.run_in, g.u.size)) for g, m, r in self._used
        ]
        self._x, self._y, self._w = (torch.cat(column) for column in zip(*shapes, strict=True))
        self._w = self._w / self._w.sum()
        self._states: Any = None
        self._age = 0

    @staticmethod
    def _cut(g: Gridded, x: Tensor, mask: NDArray[np.bool_]) -> tuple[Tensor, Tensor, Tensor]:
        """Inputs (B, T, 3), outputs and weights (B, T) of one recording's windows."""
        count = -(-g.u.size // WINDOW)
        spare = count * WINDOW - g.u.size
        x = torch.cat([x, x[-1:].expand(spare, 3)])
        y = np.concatenate([np.where(np.isfinite(g.y), g.y, 0.0), np.zeros(spare)])
        w = np.concatenate([mask / g.noise**2, np.zeros(spare)])
        shape = (count, WINDOW)
        return x.reshape(*shape, 3), torch.tensor(y).reshape(shape), torch.tensor(w).reshape(shape)

    @torch.no_grad()
    def _store(self) -> None:
        """Pass whole recordings through, and keep the state in front of every window."""
        kept, first = [], 0
        for g, _, _ in self._used:
            state = self._fitted.rested(g.before)
            for k in range(-(-g.u.size // WINDOW)):
                kept.append(state)
                _, state = self._fitted.cell(self._x[first + k : first + k + 1], state)
            first += -(-g.u.size // WINDOW)
        if isinstance(kept[0], tuple):
            self._states = tuple(torch.cat([s[i] for s in kept], dim=1) for i in range(2))
        else:
            self._states = torch.cat(kept, dim=1)

    def loss(self) -> Tensor:
        if self._age % _REFRESH == 0:
            self._store()
        self._age += 1
        y, _ = self._fitted.cell(self._x, self._states)
        return torch.sum(self._w * (y - self._y) ** 2)

    def check(self) -> float:
        chosen = [(r, m) for r, m in zip(self._recordings, self._parts.check, strict=True) if m.any()]
        outputs = [anchored(r, self._fitted.simulate(r), np.zeros((r.t.size, 0))) for r, _ in chosen]
        return over_noise([r for r, _ in chosen], outputs, [m for _, m in chosen])


class Recurrent(Rival):
    """A recurrent network; ``kind`` is ``"gru"`` or ``"lstm"``."""

    kind: str
    how = "from the best linear model, Adam on windows with stored states, truncated backpropagation"

    def _fit(self, recordings: Sequence[Recording], budget: Budget, seed: int) -> Fitted:
        scales, parts, grid = scales_of(recordings), split(recordings), interval(recordings, PER_PERIOD)
        zero = float(np.mean(np.concatenate([r.y[r.mask("identification")] for r in recordings])))

        linear = linear_model(recordings, parts.fit, scales, grid, budget)

        def build(hidden: int) -> _Windows:
            begun = RecurrentFitted(0, {}, grid, scales, zero, Cell(self.kind, hidden), linear)
            return _Windows(begun, recordings, parts)

        best = search(build, SIZES, budget, seed)
        cell = best.trained.module
        facts = {
            "size": f"{best.size} units, grid {grid:.3g} s", "sizes_tried": best.tried, "updates": best.updates,
            "check_over_noise": best.score, "processor_seconds": budget.used,
        }  # fmt: skip
        count = sum(p.numel() for p in cell.parameters()) + linear.a.size + linear.b.size
        return RecurrentFitted(count, facts, grid, scales, zero, cell, linear)


class Gru(Recurrent):
    """Gated recurrent units."""

    kind = "gru"
    words = "recurrent network of gated recurrent units"
    source = "Cho et al. 2014"


class Lstm(Recurrent):
    """Long short-term memory."""

    kind = "lstm"
    words = "recurrent network of long short-term memory"
    source = "Hochreiter, Schmidhuber 1997"
