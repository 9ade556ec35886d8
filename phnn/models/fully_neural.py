"""A port-Hamiltonian system whose structure, dissipation and energy are all neural networks: the usual baseline."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.laws.diverged import LARGEST_WEIGHT, check_weights
from phnn.laws.wide import convex_energy_unit
from phnn.models.perceptron import Perceptron, Scales

# Size of all heights together at r = 0.
_BEND = 0.2


class FullyNeural(nn.Module):
    """Latent states, everything learned, passive whatever the weights.

        T ẋ = [J(x) − L(x) L(x)ᵀ] ∇H(x) + g u/U,      y = Y x_1
        H(x) = ½|x|² + Σ_i w_i [S(z_i) − S(b_i) − σ(b_i) W_i x],      z = W x + b,   w_i = c S(r_i/c) > 0

    ``J`` is skew and ``L Lᵀ`` positive semidefinite by the way they are filled. ``S(z) = (z + √(4 + z²))/2`` is convex
    and each bracket is ``S`` less its tangent at ``x = 0``, hence not negative: ``H(x) ≥ ½|x|² ≥ H(0) = 0`` and
    ``∇H(0) = 0`` for all weights ``r, W, b``. What is stored at rest is the least, nothing can be delivered from there,
    and zero input holds the zero state. Brackets are evaluated as products of positive numbers, so that rounding keeps
    the sign too. The conjugate output is ``gᵀ∇H``; what is measured is the first state.

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
        SolverFailed: at an evaluation, where training has carried a weight beyond use; names it.

    References: Amos, Xu & Kolter 2017 (input convex networks); Kolter & Manek 2019 (a convex network less its value at
    rest, plus a quadratic, is a Lyapunov function by construction); Barron 2021 (squareplus); Greydanus, Dzamba &
    Yosinski 2019; Desai et al. 2021 (learned port-Hamiltonian systems); Gonzalez 1996; McLachlan, Quispel & Robidoux
    1999 (discrete gradients).
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
        # At r = 0 all units together bend the energy by some percent, and r moves w by half as much.
        self.smoothing = _BEND / width
        self.inlet = nn.Parameter(torch.randn(states, generator=random, dtype=torch.float64))

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the latent states."""
        return tuple(f"x_{k + 1}" for k in range(self.states))

    def energy(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(...) ``H(x)``, dimensionless."""
        bent = convex_energy_unit(x @ self.directions.mT, self._weights(), 1.0, self.positions)
        return 0.5 * x.square().sum(-1) + bent.sum(-1)

    def _weights(self) -> Tensor:
        """(U,) ``w > 0``."""
        self._check()
        return self.smoothing * _hinge(self.heights / self.smoothing)

    def _check(self) -> None:
        check_weights(self, largest=LARGEST_WEIGHT)

    def mean_efforts(
        self,
        a: Tensor,  # (..., n) state at the start of a step
        b: Tensor,  # (..., n) and at its end
    ) -> Tensor:
        """(..., n) ``∇̄H(a, b)``; ``∇H(a)`` where ``b = a``."""
        at_a = _hinge(a @ self.directions.mT + self.positions)
        product = at_a * (at_a if a is b else _hinge(b @ self.directions.mT + self.positions))
        at_rest = _hinge(self.positions).square()
        # Both quotients are the same number at rest, so that the effort is zero there to the last bit.
        slope = product / (1.0 + product) - at_rest / (1.0 + at_rest)
        return 0.5 * (a + b) + (slope * self._weights()) @ self.directions

    def efforts(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(..., n) ``∇H(x)``."""
        return self.mean_efforts(x, x)

    def structure(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(..., n, n) ``J(x) = A − Aᵀ``."""
        self._check()
        half = _filled(self.skew(x), self.states, -1)
        return half - half.mT

    def dissipation(self, x: Tensor) -> Tensor:  # x: (..., n)
        """(..., n, n) ``L(x) L(x)ᵀ``."""
        self._check()
        lower = _filled(self.lower(x), self.states, 0)
        return lower @ lower.mT

    def rate(
        self,
        efforts: Tensor,  # (..., n) efforts, of a state or averaged over a step
        x: Tensor,  # (..., n) where structure and dissipation are taken
        u: Tensor,  # (..., 1) [V]
    ) -> Tensor:
        """(..., n) ``ẋ`` [1/s] for any effort."""
        self._check()
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


def _filled(entries: Tensor, n: int, diagonal: int) -> Tensor:
    """(..., n, n) matrices whose lower triangle, up to a diagonal, holds the entries (..., K)."""
    rows, columns = torch.tril_indices(n, n, diagonal)
    matrix = entries.new_zeros(*entries.shape[:-1], n * n)
    return matrix.index_copy(-1, rows * n + columns, entries).reshape(*entries.shape[:-1], n, n)
