"""The steps of any network as one differentiable torch operation with bounded memory.

    F(X; θ, u, h) = 0,     dL/dθ = −μᵀ ∂F/∂θ,     (∂F/∂X)ᵀ μ = ∂L/∂X

The forward pass keeps the states ``X`` of all steps. The backward pass goes over them block by block from the end. It
finds the multipliers ``μ`` of a block in one sweep. One vectorised evaluation of ``F`` by the torch module,
differentiated once, then gives the gradients by all parameters, inputs and steps. The cost of a gradient hardly depends
on the number of parameters.

Compiled code solves and sweeps where it can: in 64 bits, on the processor, laws with a kernel. `phnn.integrate.dense`
does it in torch for all others. Steps and gradients are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import kernel, sweep
from phnn.integrate.compilable import can_compile
from phnn.integrate.dense import Dense
from phnn.integrate.inputs import check
from phnn.integrate.program import compile_network
from phnn.integrate.residual import steps_residual
from phnn.integrate.scheme import Scheme
from phnn.network.system import PortHamiltonianSystem

Array = NDArray[np.float64]

# Steps, of all members of a batch together, whose equations the backward pass holds in memory at once.
BLOCK = 1 << 16


def simulate(
    system: PortHamiltonianSystem,
    u: Tensor,  # (..., T, P) inputs at the samples, or (..., T, 1) of the first port
    x0: Tensor | None = None,  # (..., n) state at the first sample; None: zero
    dt: float = 1e-4,  # sample interval [s]
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> tuple[Tensor, Tensor]:
    """Simulate a batch of inputs; returns the states (..., T, n) and port outputs (..., T, P).

        system = phnn.PortHamiltonianSystem(phnn.models.hrc(hysterons=2))
        x, y = phnn.simulate(system, u, dt=1e-4)          # differentiable by parameters, u and x0

    One power-preserving step leads from sample to sample, under the mean of its two inputs. Compiled code takes the
    steps where it can (64 bits, on the processor, laws with a kernel), torch all others; their numbers are the same.

    Raises:
        InputRefused: shapes that do not fit, a value that is not finite or not of the system's numbers, or fewer than
            two samples.
        SolverFailed: a step has no solution; names the time.
    """
    if not (isinstance(system, PortHamiltonianSystem) and isinstance(u, Tensor) and u.is_floating_point()):
        raise InputRefused(f"a {type(system).__name__} and a {type(u).__name__}: give a system and a tensor of floats")
    if (x0 is not None and not x0.ndim) or u.ndim < 2 or u.shape[-2] < 2:
        raise InputRefused(f"u has shape {tuple(u.shape)}: give (..., T, P), inputs of P ports at two samples or more")
    ports, states = len(system.network.ports), len(system.state_names)
    if u.shape[-1] == 1 and ports > 1:
        u = torch.cat([u, u.new_zeros(*u.shape[:-1], ports - 1)], dim=-1)
    start = u.new_zeros(states) if x0 is None else x0
    try:
        batch = torch.broadcast_shapes(u.shape[:-2], start.shape[:-1])
    except RuntimeError as error:
        raise InputRefused(f"x0 of shape {tuple(start.shape)} does not fit u of shape {tuple(u.shape)}") from error
    u, start = u.expand(*batch, *u.shape[-2:]), start.expand(*batch, start.shape[-1])
    mean = (0.5 * (u[..., 1:, :] + u[..., :-1, :])).movedim(-2, 0)
    x = simulated(system, start, mean, dt, scheme).movedim(0, -2)
    return x, system.port_outputs(x, u)


def simulated(
    system: PortHamiltonianSystem,
    x0: Tensor,  # (..., n)
    u: Tensor,  # (N, ..., P) mean inputs of the steps
    h: float | Tensor,  # steps [s]: one for all, (N,), or (N, ...) of every member of a batch its own
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
    start: float = 0.0,
    near: Tensor | None = None,
) -> Tensor:
    """Integrate the steps of a batch; returns the states (N+1, ..., n), differentiable by parameters, x0, u and h.

    Args:
        start: time of the first state, for messages.
        near: (N+1, ..., n) states from which the iteration in torch begins, of the same steps at other parameters.

    Raises:
        InputRefused, SolverFailed: as of `simulate`.
    """
    h = torch.as_tensor(h, dtype=x0.dtype, device=x0.device)
    h = h.expand(len(u), *x0.shape[: max(0, h.ndim - 1)])
    check(system, x0, u, h)
    compiles = x0.device.type == "cpu" and x0.dtype == torch.float64 and can_compile(system.network)
    return solved(Compiled(system, scheme) if compiles else Dense(system, scheme, near), x0, u, h, start)


def solved(steps: Compiled | Dense, x0: Tensor, u: Tensor, h: Tensor, start: float = 0.0) -> Tensor:
    """Integrate as `simulated` does, by the given code and without a check of the arguments."""
    u = u.expand(len(u), *x0.shape[:-1], u.shape[-1])
    h = h.reshape(*h.shape, *[1] * (u.ndim - h.ndim))
    return _Implicit.apply(steps, start, x0, u, h, *_trained(steps).values())


def _trained(steps: nn.Module) -> dict[str, Tensor]:
    return {name: p for name, p in steps.named_parameters() if p.requires_grad}


class Compiled(nn.Module):
    """The compiled steps of a system. Called with states and mean efforts it returns the residuals of the steps."""

    def __init__(self, system: PortHamiltonianSystem, scheme: Scheme) -> None:
        super().__init__()
        self.system, self.program = system, compile_network(system.network, scheme)
        present = system.present_values()
        values = {n: (present[n] if n in present else system.value(n)).item() for n in self.program.names}
        self.theta = self.program.filled(values, system.network)

    def solve(self, x0: Tensor, u: Tensor, h: Tensor, start: float) -> tuple[Tensor, Tensor]:
        """(N+1, ..., n) states and (N, ..., n) mean efforts.

        Raises:
            SolverFailed: a step has no solution; names the time.
        """
        starts, inputs, sizes = _members(x0.unsqueeze(0)), _members(u), _members(h.expand(*u.shape[:-1], 1))[..., 0]
        states = np.empty((len(starts), len(u) + 1, x0.shape[-1]))
        efforts = np.empty_like(states[:, 1:])
        for b, x in enumerate(starts[:, 0]):
            done = kernel.march(self.program, self.theta, x, inputs[b], sizes[b], states[b], efforts[b])
            if done < len(u):
                raise SolverFailed(
                    f"no solution of the step at t = {start + sizes[b, :done].sum():.6g} s; a parameter probably has "
                    "an unphysical value: bound it, or use smaller steps"
                )
        return _batch(states, x0.shape), _batch(efforts, x0.shape)

    def weights(
        self, residual: Tensor, given: Sequence[Tensor], wanted: Tensor, carry: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return ``−μ`` (N, ..., n+m) of some steps, and (..., n) ``∂L/∂x`` at their start; see `Dense.weights`."""
        x, ends, efforts, u, h = given
        states, cotangent = (_members(torch.cat([v[:1], w])) for v, w in ((x, ends), (0.0 * wanted, wanted)))
        means, inputs, sizes = (_members(v) for v in (efforts, u, h.expand(*u.shape[:-1], 1)))
        before = _members(carry.unsqueeze(0))[:, 0]
        mu = np.empty((len(before), len(u), residual.shape[-1]))
        for b, later in enumerate(before):
            march = sweep.Integrated(self.program, self.theta, states[b], means[b], inputs[b], sizes[b, :, 0])
            before[b] = sweep.adjoint(march, np.zeros(0, np.int64), cotangent[b], mu[b], later)[1]
        # The sweep's multipliers of the balances carry the minus sign already.
        mu[..., : x.shape[-1]] *= -1.0
        return _batch(mu, carry.shape), torch.from_numpy(before).reshape(carry.shape)

    def forward(self, x: Tensor, ends: Tensor, efforts: Tensor, u: Tensor, h: Tensor) -> tuple[Tensor, ...]:
        """(N, ..., n+m) residuals of the steps, and what `weights` is given."""
        sizes = h.expand(*u.shape[:-1], 1).reshape(-1)
        start, end, means, inputs = (v.flatten(0, -2) for v in (x, ends, efforts, u))
        found = steps_residual(self.system, self.program, start, end, means, inputs, sizes)
        return found.value.reshape(*u.shape[:-1], -1), x, ends, efforts, u.detach(), h.detach()


def _members(tensor: Tensor) -> Array:
    """(B, N, k) array of the members of a batch, from a tensor (N, ..., k)."""
    flat = tensor.detach().reshape(tensor.shape[0], prod(tensor.shape[1:-1]), tensor.shape[-1])
    return np.ascontiguousarray(flat.transpose(0, 1).numpy())


def _batch(members: Array, shape: torch.Size) -> Tensor:
    """(N, ..., k) tensor of arrays (B, N, k) of the members of a batch whose states have a shape (..., n)."""
    return torch.from_numpy(members).transpose(0, 1).reshape(members.shape[1], *shape[:-1], members.shape[2])


class _Implicit(torch.autograd.Function):
    """The states of a solve; the backward pass is the sweep of the adjoint."""

    @staticmethod
    def forward(ctx: Any, steps: Any, start: float, x0: Tensor, u: Tensor, h: Tensor, *parameters: Tensor) -> Tensor:
        states, efforts = steps.solve(x0, u, h, start)
        ctx.steps, ctx.names = steps, tuple(_trained(steps))
        ctx.save_for_backward(states, efforts, u, h, *parameters)
        return states

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, wanted: Tensor) -> Any:
        states, efforts, *inputs = ctx.saved_tensors
        needs = ctx.needs_input_grad[3:]
        found = [torch.zeros_like(v) if need else None for v, need in zip(inputs, needs, strict=True)]
        carry, length = torch.zeros_like(wanted[0]), max(1, BLOCK // max(1, prod(wanted.shape[1:-1])))
        for first in reversed(range(0, len(efforts), length)):
            part = slice(first, first + length)
            x, ends = states[:-1][part], states[1:][part]
            own = [v[part] if i < 2 else v for i, v in enumerate(inputs)]
            own = [v.detach().requires_grad_(need) for v, need in zip(own, needs, strict=True)]
            with torch.enable_grad():
                # By name, because the caller may have replaced the module's parameters for the duration of the call.
                named = dict(zip(ctx.names, own[2:], strict=True))
                residual, *given = torch.func.functional_call(
                    ctx.steps, named, (x, ends, efforts[part], *own[:2]), tie_weights=False
                )
            weights, carry = ctx.steps.weights(residual, given, wanted[1:][part], carry)
            asked = [i for i, need in enumerate(needs) if need]
            # A network may hold parameters and ports that do not occur in any of its equations.
            if not (asked and residual.requires_grad):
                continue
            gradients = torch.autograd.grad(residual, [own[i] for i in asked], weights, allow_unused=True)
            for i, gradient in zip(asked, gradients, strict=True):
                if gradient is not None:
                    total: Any = found[i]
                    (total[part] if i < 2 else total).add_(gradient)
        return None, None, wanted[0] + carry, *found
