"""The energy of several storages that move together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from phnn.laws import STORAGE_LAWS, gradient
from phnn.network.bounded import BoundedParameters
from phnn.parameters import Parameter


class _Known(nn.Module):
    """A storage law of `phnn.laws` with its parameters."""

    def __init__(self, law: str, values: Sequence[float]) -> None:
        super().__init__()
        self.law = STORAGE_LAWS[law]
        given = zip(values, self.law.domains, strict=True)
        self.free = BoundedParameters(
            {f"theta_{k}": Parameter(f"theta_{k}", v).within(d, f"the law {law}") for k, (v, d) in enumerate(given)}
        )

    def energy(self, x: Tensor) -> Tensor:
        return self.law.energy(x, *self.free.values().values())

    def mean_effort(self, a: Tensor, b: Tensor) -> Tensor:
        return self.law.mean_effort(a, b, *self.free.values().values())


class SumOfEnergies(nn.Module):
    """``H(x) = Σ_k H_k(ρ_k x)`` with the discrete gradient ``Σ_k ρ_k ē_k(ρ_k a, ρ_k b)``.

    Args:
        parts: (law, ρ, parameter values) of every storage; a law is a name in `phnn.laws` or a torch module, whose
            parameters are its own.

    Attributes:
        bounded: whether ``H ≥ 0``, which a weight is not.
    """

    def __init__(self, parts: Sequence[tuple[Any, float, Sequence[float]]]) -> None:
        super().__init__()
        self.bounded = all(STORAGE_LAWS[law].bounded for law, _, _ in parts if isinstance(law, str))
        laws = [_Known(law, values) if isinstance(law, str) else law for law, _, values in parts]
        self.parts: list[tuple[Any, float]] = [(law, ratio) for law, (_, ratio, _) in zip(laws, parts, strict=True)]
        self.laws = nn.ModuleList(laws)

    def energy(self, x: Tensor) -> Tensor:  # x: (...)
        """(...) ``H(x)`` [J]."""
        return torch.stack([law.energy(ratio * x) for law, ratio in self.parts]).sum(0)

    def mean_effort(
        self,
        a: Tensor,  # (...) energy variable at the start of a step
        b: Tensor,  # (...) and at its end
    ) -> Tensor:
        """(...) ``(H(b) − H(a))/(b − a)``; ``H'(a)`` where they are equal."""
        return torch.stack([ratio * self._part(law, ratio * a, ratio * b, a is b) for law, ratio in self.parts]).sum(0)

    def _part(self, law: Any, start: Tensor, end: Tensor, at_rest: bool) -> Tensor:
        if hasattr(law, "mean_effort"):
            return law.mean_effort(start, end)
        return gradient.effort(law.energy, start) if at_rest else gradient.mean_effort(law.energy, start, end)
