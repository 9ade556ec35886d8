"""The solvers of windows: the compiled power-preserving step, the step of latent models, or torchdiffeq.

Every solver takes a plant, windows and their (B, n) initial states and returns the (S_b, n) states at the samples of
each window, differentiable by the plant's parameters and the initial states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate.compiled_method import COMPILED, sampled_states
from phnn.integrate.dense import with_derivatives
from phnn.integrate.differentiable import simulate_torch
from phnn.integrate.equations import jacobians, step_residual
from phnn.integrate.method import METHOD
from phnn.integrate.ode import ADAPTIVE, odeint
from phnn.learn.plant import NetworkPlant, Plant
from phnn.learn.windows import Window
from phnn.models.fully_neural import FullyNeural

#     x⁺ − x = h ẋ(∇̄H(x, x⁺), (x + x⁺)/2, ū)
#
# ``∇̄H`` is the discrete gradient that the system defines. Such a system has no reducible storages, so that all schemes
# are the same.
#
# Newton's method keeps its Jacobian from step to step. It computes a new one where the convergence becomes slow. The
# gradients are those of the solution, by the implicit function theorem, and do not depend on the iteration.
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


_ROUNDING = 1e-9

Solver = Callable[[Plant, Sequence[Window], Tensor], list[Tensor]]


def solver_for(settings: Mapping[str, Any], plant: Plant) -> Solver:
    """The solver of a training run.

    Args:
        settings: ``name`` is ``discrete_gradient``: the compiled kernel for networks, a batched one for a fully neural
            model; or ``torchdiffeq``, with ``method``, ``adjoint``, ``rtol`` and ``atol`` (in typical states).

    Raises:
        InputRefused: an unknown solver or option, or one that does not suit the model.
    """
    options = dict(settings)
    name = options.pop("name")
    if name == "torchdiffeq":
        unknown = sorted(set(options) - {"method", "adjoint", "rtol", "atol"})
        if unknown:
            raise InputRefused(f"solver.{unknown[0]}: torchdiffeq takes method, adjoint, rtol and atol")
        return Torchdiffeq(plant, **options)
    if name != METHOD:
        raise InputRefused(f"solver.name = {name!r}: choose {METHOD} or torchdiffeq")
    if options:
        raise InputRefused(f"solver.{min(options)}: {METHOD} has no options")
    if isinstance(plant, NetworkPlant):
        return compiled
    if isinstance(plant.core, FullyNeural):
        return averaged
    raise InputRefused(
        f"{METHOD} needs an energy, which a {type(plant.core).__name__} has not: take solver=torchdiffeq"
    )


def compiled(plant: Plant, windows: Sequence[Window], x0: Tensor) -> list[Tensor]:
    """Integrate each window by the compiled kernel of its network."""
    assert isinstance(plant, NetworkPlant)
    return [
        simulate_torch(plant.system, plant.inputs(w.mean), w.h, start)[w.nodes]
        for w, start in zip(windows, x0, strict=True)
    ]


def averaged(plant: Plant, windows: Sequence[Window], x0: Tensor) -> list[Tensor]:
    """All windows of a latent model at once, shorter ones continued by a constant input."""
    assert isinstance(plant.core, FullyNeural)
    u = pad_sequence([w.mean for w in windows])
    h = pad_sequence([w.h for w in windows])
    # Short windows are padded with steps of zero length, which change nothing and cost no time.
    states = march(plant.core, x0, plant.inputs(u), h.unsqueeze(-1))
    return [states[w.nodes, b] for b, w in enumerate(windows)]


class Torchdiffeq:
    """Windows by torchdiffeq, in batches.

    The methods of torchdiffeq see all windows at once in the time ``τ`` that counts steps, ``dx/dτ = h_b f(x, u_b)``:
    windows of recordings at different rates then share their output times. The power-preserving step in torch goes
    window lengths and steps apart, one batch for each, in true time. The compiled one takes all windows at once, each
    in the share of its own time.

    Args:
        method: ``compiled_discrete_gradient`` (`phnn.integrate.compiled_method`), for networks whose laws have compiled
            forms, or any of `phnn.integrate.ode.odeint`.
        adjoint: gradients by `odeint_adjoint`.
        rtol, atol: of adaptive methods; ``atol`` in units of the typical states.
    """

    def __init__(
        self, plant: Plant, method: str = COMPILED, adjoint: bool = True, rtol: float = 1e-7, atol: float = 1e-9
    ) -> None:
        if method in (METHOD, COMPILED) and not isinstance(plant, NetworkPlant):
            raise InputRefused(f"method = {method} under torchdiffeq is for networks: take rk4 or dopri5")
        self.method, self.adjoint, self.rtol, self.atol = method, adjoint, rtol, atol

    def __call__(self, plant: Plant, windows: Sequence[Window], x0: Tensor) -> list[Tensor]:
        """States at the samples of each window."""
        if self.method == COMPILED:
            return self._compiled(plant, windows, x0)
        found: list[Tensor] = [x0] * len(windows)
        for members in self._batches(windows):
            solve = self._preserving if self.method == METHOD else self._general
            states = solve(plant, [windows[b] for b in members], x0[members])
            for k, b in enumerate(members):
                found[b] = states[windows[b].nodes, k]
        return found

    def _batches(self, windows: Sequence[Window]) -> list[list[int]]:
        if self.method != METHOD:
            return [list(range(len(windows)))]
        alike: dict[bytes, list[int]] = {}
        for b, w in enumerate(windows):
            alike.setdefault(w.h.numpy().tobytes(), []).append(b)
        return list(alike.values())

    def _compiled(self, plant: Plant, windows: Sequence[Window], x0: Tensor) -> list[Tensor]:
        assert isinstance(plant, NetworkPlant)
        u, h, nodes = zip(*((plant.inputs(w.mean), w.h, w.nodes) for w in windows), strict=True)
        return sampled_states(plant.system, u, h, nodes, x0, self.adjoint)

    def _preserving(self, plant: Plant, windows: Sequence[Window], x0: Tensor) -> Tensor:
        assert isinstance(plant, NetworkPlant)
        h = windows[0].h
        t = torch.cat([h.new_zeros(1), h.cumsum(0)])
        held = _Held(t, torch.stack([w.fine for w in windows], dim=1), plant)
        return odeint(plant.system.with_input(held), x0, t, self.method, adjoint=self.adjoint)

    def _general(self, plant: Plant, windows: Sequence[Window], x0: Tensor) -> Tensor:
        counted = _Counted(plant, windows)
        t = torch.arange(counted.h.shape[0] + 1, dtype=torch.float64)
        jumps = counted.jumps() if self.method in ADAPTIVE else None
        atol = self.atol * plant.scale
        return odeint(counted, x0, t, self.method, self.rtol, atol, self.adjoint, jumps)


def _quadratic(fine: Tensor, share: Tensor) -> Tensor:
    """The parabola through the values at the start, middle and end of a step, at a share of it."""
    start, middle, end = fine.unbind(-1)
    linear, bend = -3.0 * start + 4.0 * middle - end, 2.0 * start - 4.0 * middle + 2.0 * end
    return start + share * (linear + share * bend)


class _Held(nn.Module):
    """(B, P) inputs of a batch at a true time."""

    def __init__(self, t: Tensor, fine: Tensor, plant: NetworkPlant) -> None:
        super().__init__()
        self.t, self.fine, self.inputs = t, fine, plant.inputs

    def forward(self, t: Tensor) -> Tensor:
        step = min(max(int(torch.searchsorted(self.t, t.detach(), right=True)) - 1, 0), self.fine.shape[0] - 1)
        share = (t - self.t[step]) / (self.t[step + 1] - self.t[step])
        return self.inputs(_quadratic(self.fine[step], share))


class _Counted(nn.Module):
    """``dx/dτ`` of a batch in the time that counts steps."""

    def __init__(self, plant: Plant, windows: Sequence[Window]) -> None:
        super().__init__()
        self.plant = plant
        self.fine = pad_sequence([w.fine for w in windows])
        self.h = pad_sequence([w.h for w in windows])

    def forward(self, tau: Tensor, x: Tensor) -> Tensor:
        step = min(int(tau), self.h.shape[0] - 1)
        u = _quadratic(self.fine[step], tau - step)
        return self.h[step].unsqueeze(-1) * self.plant.rate(x, u)

    def jumps(self) -> Tensor:
        """Nodes where the input or the size of a step jumps."""
        # Both sides of a smooth joint come out of a spline, equal up to rounding.
        apart = (self.fine[1:, :, 0] - self.fine[:-1, :, 2]).abs() > _ROUNDING * self.fine.abs().max()
        moved = apart | (self.h[1:] != self.h[:-1])
        return (torch.nonzero(moved.any(1)).flatten() + 1).double()
