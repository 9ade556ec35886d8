"""A multilayer perceptron in float64 from a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused


class Perceptron(nn.Module):
    """Affine layers with tanh between them; weights have variance 1/fan-in, those of the last layer times ``last²``.

    Args:
        sizes: of input, hidden layers and output.
        random: source of the initial weights.
        last: size of the last layer's weights.
    """

    def __init__(self, sizes: Sequence[int], random: torch.Generator, last: float = 1.0) -> None:
        super().__init__()
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for k, (inputs, outputs) in enumerate(pairwise(sizes)):
            size = (last if k == len(sizes) - 2 else 1.0) * inputs**-0.5
            drawn = torch.randn(outputs, inputs, generator=random, dtype=torch.float64)
            self.weights.append(nn.Parameter(size * drawn))
            spread = 0.0 if k == len(sizes) - 2 else 0.5
            drawn = torch.randn(outputs, generator=random, dtype=torch.float64)
            self.biases.append(nn.Parameter(spread * drawn))

    def forward(self, x: Tensor) -> Tensor:  # x: (..., sizes[0])
        """(..., sizes[-1])."""
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = x @ weight.mT + bias
            if k < len(self.weights) - 1:
                x = torch.tanh(x)
        return x


@dataclass(frozen=True)
class Scales:
    """What one dimensionless unit is.

    Attributes:
        time: [s]; input: [V]; output: [m].

    Raises:
        InputRefused: one of them is not positive.
    """

    time: float
    input: float
    output: float

    def __post_init__(self) -> None:
        for name, value in (("time", self.time), ("input", self.input), ("output", self.output)):
            if not 0.0 < value < float("inf"):
                raise InputRefused(f"the scale of the {name} is {value:g}: give a positive typical magnitude in SI")
