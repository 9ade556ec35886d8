"""A port-Hamiltonian system whose structure, dissipation and energy are all neural networks: the usual baseline."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.models.perceptron import Perceptron
from phnn.models.scales import Scales


class FullyNeural(nn.Module):
    """Latent states, everything learned, passive whatever the weights.

        T ẋ = [J(x) − L(x) L(x)ᵀ] ∇H(x) + g u/U,      y = Y x_1
        H(x) = ½|x|² + Σ_i w_i [S(z_i) − S(b_i) − σ(b_i) W_i x],      z = W x + b

    ``J`` is skew and ``L Lᵀ`` positive semidefinite by the way they are filled; ``S(z) = (z + √(4 + z²))/2`` grows
    linearly, so that ``H`` is bounded below whatever the sign of ``w``, and its tangent at zero is taken out, so that
    zero input holds the zero state. The conjugate output is ``gᵀ∇H``; what is measured is the first state.

    ``H`` is not a sum over states, so that the coordinate-wise discrete gradient would depend on their order. A sum of
    functions of one projection each has a symmetric one in closed form,

        ∇̄H(a, b) = (a + b)/2 + Wᵀ w ∘ [ΔS/Δz − σ(b)],       ∇̄H·(b − a) = H(b) − H(a) exactly,

    which needs neither the quadrature of the mean-value gradient nor the division by |b − a|² of Gonzalez's; with
    ``J`` and ``L`` at mid-step the step keeps the power balance for every step size, as that of the networks does.

    Args:
        scales: ``T``, ``U`` and ``Y``; the states have none.
        states: number of latent states.
        width: of the hidden layers of ``J`` and ``L``, and number of units of ``H``.
        seed: of the initial weights.

    Raises:
        InputRefused: fewer than two states, or no unit.

    References: Greydanus, Dzamba & Yosinski 2019; Desai et al. 2021 (learned port-Hamiltonian systems); Gonzalez 1996;
    McLachlan, Quispel & Robidoux 1999 (discrete gradients).
    """

    def __init__(self, scales: Scales, states: int = 4, width: int = 32, seed: int = 0) -> None:
        super().__init__()
        if states < 2 or width < 1:
            raise InputRefused(f"states = {states}, width = {width}: give two states and one unit at least")
        random = torch.Generator().manual_seed(seed)
        self.scales = scales
        self.states = states
        self.skew = Perceptron((states, width, states * (states - 1) // 2), random)
        self.lower = Perceptron((states, width, states * (states + 1) // 2), random)
        with torch.no_grad():
            self.skew.biases[-1].normal_(generator=random)
            self.lower.biases[-1].normal_(generator=random)
        drawn = torch.randn(width, states, generator=random, dtype=torch.float64)
        self.directions = nn.Parameter(drawn)
        self.positions = nn.Parameter(torch.randn(width, generator=random, dtype=torch.float64))
        self.heights = nn.Parameter(torch.zeros(width, dtype=torch.float64))
        self.inlet = nn.Parameter(torch.randn(states, generator=random, dtype=torch.float64))

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the latent states."""
        return tuple(f"x_{k + 1}" for k in range(self.states))

    def energy(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(...) ``H(x)``, dimensionless."""
        z = x @ self.directions.mT + self.positions
        tangent = _step(self.positions) * (x @ self.directions.mT)
        return 0.5 * x.square().sum(-1) + ((_hinge(z) - _hinge(self.positions) - tangent) * self.heights).sum(-1)

    def mean_efforts(
        self,
        a: Tensor,  # (..., n) state at the start of a step
        b: Tensor,  # (..., n) and at its end
    ) -> Tensor:
        """(..., n) ``∇̄H(a, b)``; ``∇H(a)`` where ``b = a``."""
        product = _hinge(a @ self.directions.mT + self.positions) * _hinge(b @ self.directions.mT + self.positions)
        slope = product / (1.0 + product) - _step(self.positions)
        return 0.5 * (a + b) + (slope * self.heights) @ self.directions

    def efforts(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(..., n) ``∇H(x)``."""
        return self.mean_efforts(x, x)

    def structure(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(..., n, n) ``J(x) = A − Aᵀ``."""
        half = _filled(self.skew(x), self.states, -1)
        return half - half.mT

    def dissipation(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(..., n, n) ``L(x) L(x)ᵀ``."""
        lower = _filled(self.lower(x), self.states, 0)
        return lower @ lower.mT

    def rate(
        self,
        efforts: Tensor,  # (..., n) efforts, of a state or averaged over a step
        x: Tensor,  # (..., n) where structure and dissipation are taken
        u: Tensor,  # (..., 1) [V]
    ) -> Tensor:
        """(..., n) ``ẋ`` [1/s] for any effort."""
        half = _filled(self.skew(x), self.states, -1)
        lower = _filled(self.lower(x), self.states, 0)
        e = efforts.unsqueeze(-1)
        moved = (half - half.mT) @ e - lower @ (lower.mT @ e)
        return (moved.squeeze(-1) + self.inlet * (u / self.scales.input)) / self.scales.time

    def vector_field(
        self,
        x: Tensor,  # (..., n)
        u: Tensor,  # (..., 1) [V]
    ) -> Tensor:
        """(..., n) ``ẋ`` [1/s]."""
        return self.rate(self.efforts(x), x, u)

    def measured(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(...) ``y`` [m]."""
        return self.scales.output * x[..., 0]


def _hinge(z: Tensor) -> Tensor:
    """``S(z)`` without cancellation for negative arguments."""
    root = torch.sqrt(4.0 + z.square())
    return torch.where(z > 0.0, 0.5 * (z + root), 2.0 / (root - z))


def _step(z: Tensor) -> Tensor:
    """``σ(z) = S'(z)``."""
    squared = _hinge(z).square()
    return squared / (1.0 + squared)


def _filled(entries: Tensor, n: int, diagonal: int) -> Tensor:
    """(..., n, n) matrices whose lower triangle, up to a diagonal, holds the entries (..., K)."""
    rows, columns = torch.tril_indices(n, n, diagonal)
    matrix = entries.new_zeros(*entries.shape[:-1], n * n)
    return matrix.index_copy(-1, rows * n + columns, entries).reshape(*entries.shape[:-1], n, n)
