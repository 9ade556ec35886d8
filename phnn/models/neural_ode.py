"""A black-box neural ordinary differential equation: the baseline without any structure."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.laws.diverged import LARGEST_WEIGHT, check_weights
from phnn.nn.learned_system import Scales
from phnn.nn.multi_ports import Perceptron


class NeuralODE(nn.Module):
    """``T ẋ = f(x, u/U) − f(0, 0)``, ``y = Y c x`` with a perceptron ``f`` and a learned row ``c``.

    Nothing keeps it passive, nor even stable; only zero input holds the zero state, so that a recording from rest
    starts there. `torchdiffeq` solves it: it has no energy that a discrete gradient could be taken of.

    Args:
        scales: ``T``, ``U`` and ``Y``; the states have none.
        states: number of latent states.
        width: of two hidden layers.
        seed: of the initial weights.

    Raises:
        InputRefused: no state, or no unit.
        SolverFailed: at an evaluation, where training has carried a weight beyond use; names it.

    References: Chen, Rubanova, Bettencourt & Duvenaud 2018.
    """

    def __init__(self, scales: Scales, states: int = 4, width: int = 32, seed: int = 0) -> None:
        super().__init__()
        if states < 1 or width < 1:
            raise InputRefused(f"states = {states}, width = {width}: give one state and one unit at least")
        random = torch.Generator().manual_seed(seed)
        self.scales = scales
        self.states = states
        self.field = Perceptron((states + 1, width, width, states), random, last=0.5)
        drawn = torch.randn(states, generator=random, dtype=torch.float64)
        self.readout = nn.Parameter(drawn * states**-0.5)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the latent states."""
        return tuple(f"x_{k + 1}" for k in range(self.states))

    def vector_field(
        self,
        x: Tensor,  # (..., n)
        u: Tensor,  # (..., 1) [V]
    ) -> Tensor:
        """(..., n) ``ẋ`` [1/s]."""
        check_weights(self, largest=LARGEST_WEIGHT)
        both = torch.cat([x, (u / self.scales.input).expand(*x.shape[:-1], 1)], dim=-1)
        return (self.field(both) - self.field(both.new_zeros(both.shape[-1]))) / self.scales.time

    def measured(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(...) ``y`` [m]."""
        return self.scales.output * (x @ self.readout)
