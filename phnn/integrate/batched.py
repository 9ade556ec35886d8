"""Power-preserving steps of many windows at once, for systems that are not networks of one-ports.

    x⁺ − x = h ẋ(∇̄H(x, x⁺), (x + x⁺)/2, ū)

``∇̄H`` is the discrete gradient that the system defines. Such a system has no reducible storages, so that all schemes
are the same.

Newton's method keeps its Jacobian from step to step. It computes a new one where the convergence becomes slow. The
gradients are those of the solution, by the implicit function theorem, and do not depend on the iteration.
"""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.integrate.dense import with_derivatives
from phnn.integrate.equations import jacobians, step_residual

# Tolerance of the residual, relative to one plus the largest state.
_TOLERANCE = 1e-13
_ITERATIONS = 40
_QUICK = 0.2
_HALVINGS = 12


class Energetic(Protocol):
    """A system with a discrete gradient."""

    def rate(self, efforts: Tensor, x: Tensor, u: Tensor) -> Tensor:
        """(..., n) ``ẋ`` at efforts, a state and inputs."""

    def mean_efforts(self, a: Tensor, b: Tensor) -> Tensor:
        """(..., n) discrete gradient between two states."""


def march(
    system: Energetic,
    x0: Tensor,  # (B, n) initial states, dimensionless
    u: Tensor,  # (N, B, P) mean inputs of the steps
    h: Tensor,  # (N, B, 1) steps [s]
) -> Tensor:
    """(N+1, B, n) states, differentiable by ``x0``, ``u``, ``h`` and the parameters of the system.

    Raises:
        SolverFailed: a step has no solution; names its number.
    """
    path = [x0.detach()]
    solver = _Newton(system)
    with torch.no_grad():
        for n in range(u.shape[0]):
            guess = path[-1] if n == 0 else 2.0 * path[-1] - path[-2]
            path.append(solver.step(path[-1], guess, u[n], h[n], n))
    return with_derivatives(system, torch.stack(path), x0, u, h)  # type: ignore[arg-type]


class _Newton:
    """Newton's method that keeps its Jacobian while the iteration converges."""

    def __init__(self, system: Energetic) -> None:
        self.system = system
        self.inverse: Tensor | None = None
        self.scale = torch.ones(())

    def step(self, x: Tensor, guess: Tensor, u: Tensor, h: Tensor, n: int) -> Tensor:
        """(B, n) end of one step."""
        self.scale = 1.0 + x.abs().amax(-1)
        z, residual = guess, self._residual(x, guess, u, h)
        size, fresh = self._size(residual), False
        for _ in range(_ITERATIONS):
            if bool((size <= _TOLERANCE).all()):
                return z
            if self.inverse is None:
                self._renew(x, z, u, h)
                fresh = True
            assert self.inverse is not None
            moved = z - (self.inverse @ residual.unsqueeze(-1)).squeeze(-1)
            found = self._residual(x, moved, u, h)
            after = self._size(found)
            if bool((after <= torch.clamp(_QUICK * size, min=_TOLERANCE)).all()):
                z, residual, size = moved, found, after
            elif not fresh:
                self._renew(x, z, u, h)
                fresh = True
            else:
                z, residual, size = self._searched(x, z, moved, size, u, h)
                self.inverse, fresh = None, False
        raise SolverFailed(
            f"step {n + 1} of {float(h.max()):.3g} s has no solution (residual {float(size.max()):.1e}): take shorter "
            "steps (substeps), or a lower rate of learning"
        )

    def _residual(self, x: Tensor, z: Tensor, u: Tensor, h: Tensor) -> Tensor:
        return step_residual(self.system, x, z, u, h)  # type: ignore[arg-type]

    def _renew(self, x: Tensor, z: Tensor, u: Tensor, h: Tensor) -> None:
        jacobian = jacobians(self.system, x, z, u, h)[0]  # type: ignore[arg-type]
        self.inverse = torch.linalg.inv_ex(jacobian)[0]

    def _searched(
        self, x: Tensor, z: Tensor, full: Tensor, size: Tensor, u: Tensor, h: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Damp each member's Newton step until its residual falls."""
        share = torch.ones_like(size)
        for _ in range(_HALVINGS):
            moved = z + share.unsqueeze(-1) * (full - z)
            found = self._residual(x, moved, u, h)
            after = self._size(found)
            worse = ~(after < size) & (size > _TOLERANCE)
            if not bool(worse.any()):
                break
            share = torch.where(worse, 0.5 * share, share)
        return moved, found, after

    def _size(self, residual: Tensor) -> Tensor:
        """(B,) largest component, relative to the state at the start of the step."""
        return residual.abs().amax(-1) / self.scale
