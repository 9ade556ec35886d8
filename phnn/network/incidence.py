"""Matrices whose entries are numbers or named ratios, assembled from present parameter values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor, nn

from phnn.network.elements import Port, Ratio, Resistor

Entry = tuple[int, int, Ratio]


class Incidence(nn.Module):
    """A matrix given by its entries ``(row, column, ratio)``; entries at one place add up.

    Called with the function that gives a named ratio's present value (...), it returns the (..., rows, columns)
    matrix, differentiable by the ratios that have names.
    """

    base: Tensor
    places: Tensor

    def __init__(self, rows: int, columns: int, entries: Sequence[Entry]) -> None:
        super().__init__()
        base = torch.zeros(rows, columns, dtype=torch.float64)
        named = [(i, j, ratio) for i, j, ratio in entries if isinstance(ratio, str)]
        for i, j, ratio in entries:
            if not isinstance(ratio, str):
                base[i, j] += ratio
        self.names = tuple(dict.fromkeys(ratio for _, _, ratio in named))
        places = torch.zeros(len(self.names), rows, columns, dtype=torch.float64)
        for i, j, ratio in named:
            places[self.names.index(ratio), i, j] += 1.0
        self.register_buffer("base", base, persistent=False)
        self.register_buffer("places", places, persistent=False)

    def forward(self, value: Callable[[str], Tensor]) -> Tensor:
        """(..., rows, columns) the matrix at present values."""
        matrix = self.base
        # A sum of products per entry, so that a matrix of one batch member never depends on the others.
        for name, places in zip(self.names, self.places, strict=True):
            matrix = matrix + value(name)[..., None, None] * places
        return matrix


def combined(
    row: Tensor,  # (..., n)
    matrix: Tensor,  # (n, k) or (..., n, k)
) -> Tensor:
    """(..., k) product of a row with a matrix, batched or not."""
    return row @ matrix if matrix.ndim == 2 else (row.unsqueeze(-2) @ matrix).squeeze(-2)


def columns(elements: Sequence[Resistor | Port], place: Mapping[str, int]) -> Incidence:
    """The (n, number of elements) matrix whose columns are the elements' ``on`` vectors."""
    vectors = [element.on for element in elements]
    entries: list[Entry] = [(place[name], j, ratio) for j, on in enumerate(vectors) for name, ratio in on.items()]
    return Incidence(len(place), len(elements), entries)
