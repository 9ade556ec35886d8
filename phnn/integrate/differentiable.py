"""The compiled integration as a differentiable torch operation with bounded memory.

    F(X; θ, u, h) = 0,     dL/dθ = −μᵀ ∂F/∂θ,     (∂F/∂X)ᵀ μ = ∂L/∂X

The forward pass computes the states ``X`` of all steps. The backward pass goes window by window from the end. It
integrates the window again from its first state and computes the multipliers ``μ`` in one compiled sweep. One
vectorised evaluation of ``F`` by the torch module, differentiated once, then gives the gradients by all parameters,
inputs and steps. The cost of a gradient hardly depends on the number of parameters. Between the passes one state is
kept for each window.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import dense, kernel, sweep
from phnn.integrate.compilable import can_compile
from phnn.integrate.inputs import check, refuse_unfit_march
from phnn.integrate.program import Program, compile_network
from phnn.integrate.residual import march_residual
from phnn.integrate.scheme import Scheme
from phnn.network.system import PortHamiltonianSystem

Array = NDArray[np.float64]

WINDOW = 1 << 16
# Fewer steps are differentiated faster by one evaluation for all members of a batch than by a sweep for each.
_LONG = 4096


def simulate_torch(
    system: PortHamiltonianSystem,
    u_mean: Tensor,  # (n, P) mean inputs of the steps
    h: Tensor | float,  # (n,) steps [s], or one for all
    x0: Tensor,  # (N,) initial state, in the order of ``system.state_names``
    only: Sequence[str] | None = None,
    window: int = WINDOW,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
    start: float = 0.0,
) -> Tensor:
    """Integrate the steps of a system, differentiable by its parameters, ``u_mean``, ``x0`` and ``h``.

    The compiled kernel solves networks for which `phnn.integrate.compilable.can_compile` is true;
    `phnn.integrate.dense` solves the others in torch. Steps and gradients are the same.

    Args:
        scheme: the discretisation.
        only: names of the storages whose states are wanted; all of them otherwise.
        window: steps that the backward pass holds in memory at once.
        start: time of the first state, for messages.

    Returns:
        (n+1, N) states at the ends of the steps, or (n+1, len(only)).

    Raises:
        InputRefused: a shape that does not fit, a value that is not finite or not float64, a step that is not positive,
            a window below one, or a storage that does not exist.
        SolverFailed: a step has no solution; names the time.
    """
    steps = torch.as_tensor(h, dtype=torch.float64).expand(u_mean.shape[:1])
    refuse_unfit_march(system, u_mean, steps, x0)
    if window < 1:
        raise InputRefused(f"window = {window}: give a number of steps of one or more")
    for name in only or ():
        if name not in system.state_names:
            raise InputRefused(f"no storage called {name!r}: there are {', '.join(system.state_names)}")
    wanted = [system.state_names.index(name) for name in (system.state_names if only is None else only)]
    if not can_compile(system.network):
        path = dense.march(system, x0, u_mean, steps.unsqueeze(-1), scheme, start)
        return dense.with_derivatives(system, path, x0, u_mean, steps.unsqueeze(-1), scheme)[:, wanted]
    program = compile_network(system.network, scheme)
    march = March(system, program, wanted, window, start)
    return _Implicit.apply(march, u_mean, steps, x0, *march.parameters)


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
    if u.ndim < 2 or u.shape[-2] < 2:
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
    mean = 0.5 * (u[..., 1:, :] + u[..., :-1, :])
    mean = mean.movedim(-2, 0)
    x = simulated(system, start, mean, mean.new_full(mean.shape[:1], dt), scheme).movedim(0, -2)
    return x, system.port_outputs(x, u)


def simulated(
    system: PortHamiltonianSystem,
    x0: Tensor,  # (..., n)
    u: Tensor,  # (N, ..., P) mean inputs of the steps
    h: Tensor,  # (N,) steps [s]
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
    start: float = 0.0,
) -> Tensor:
    """(N+1, ..., n) states, differentiable, of a batch; by compiled code where it can.

    Args:
        start: time of the first state, for messages.

    Raises:
        InputRefused, SolverFailed: as of `simulate`.
    """
    check(system, x0, u, float(h.detach().min()))
    compiles = x0.device.type == "cpu" and x0.dtype == torch.float64 and can_compile(system.network)
    members = x0.reshape(-1, x0.shape[-1])
    inputs = u.expand(u.shape[0], *x0.shape[:-1], u.shape[-1]).reshape(u.shape[0], len(members), -1)
    if compiles and (x0.ndim == 1 or len(h) >= _LONG):
        runs = [simulate_torch(system, inputs[:, k], h, x, scheme=scheme, start=start) for k, x in enumerate(members)]
        return torch.stack(runs, dim=1).reshape(-1, *x0.shape)
    steps = dense.shaped(x0, h)
    if compiles:
        march = March(system, compile_network(system.network, scheme), start=start)
        found = [march.steps(_array(inputs[:, k]), _array(h), _array(x), start)[0] for k, x in enumerate(members)]
        path = torch.from_numpy(np.stack(found, axis=1)).reshape(-1, *x0.shape)
    else:
        path = dense.march(system, x0, u, steps, scheme, start)
    return dense.with_derivatives(system, path, x0, u, steps, scheme)


class _Equations(nn.Module):
    """The residual of an integration as a module."""

    def __init__(self, system: PortHamiltonianSystem) -> None:
        super().__init__()
        self.system = system

    def forward(self, program: Program, states: Tensor, efforts: Tensor, u: Tensor, h: Tensor) -> Tensor:
        return march_residual(self.system, program, states, efforts, u, h).value


class March:
    """The integration of a system in windows.

    Raises:
        SolverFailed: a step has no solution.
    """

    def __init__(
        self,
        system: PortHamiltonianSystem,
        program: Program,
        wanted: Sequence[int] = (),
        window: int = WINDOW,
        start: float = 0.0,
    ) -> None:
        self.start = start
        self.equations, self.program, self.wanted, self.window = _Equations(system), program, list(wanted), window
        named = {n: p for n, p in self.equations.named_parameters() if p.requires_grad}
        self.names, self.parameters = tuple(named), tuple(named.values())
        present = system.present_values()
        values = {name: (present[name] if name in present else system.value(name)).item() for name in program.names}
        self.theta = program.filled(values, system.network)

    def forward(self, u: Array, h: Array, x0: Array) -> tuple[Array, list[Array]]:
        """(n+1, len(wanted)) states and the state at the beginning of every window."""
        out = np.empty((h.size + 1, len(self.wanted)))
        out[0] = x0[self.wanted]
        starts = [x0]
        for first in range(0, h.size, self.window):
            part = slice(first, min(first + self.window, h.size))
            states, _ = self.steps(u[part], h[part], starts[-1], self.start + float(h[:first].sum()))
            out[part.start + 1 : part.stop + 1] = states[1:, self.wanted]
            starts.append(states[-1].copy())
        return out, starts

    def steps(self, u: Array, h: Array, x0: Array, begin: float = 0.0) -> tuple[Array, Array]:
        """(n+1, N) states and (n, N) mean efforts of one window."""
        states, efforts = np.empty((h.size + 1, x0.size)), np.empty((h.size, x0.size))
        done = kernel.march(self.program, self.theta, x0, u, h, states, efforts)
        if done < h.size:
            raise SolverFailed(
                f"no solution of the step at t = {begin + h[:done].sum():.6g} s; a parameter probably has an "
                "unphysical value: bound it, or use smaller steps"
            )
        return states, efforts

    def pull_back(
        self, inputs: Sequence[Tensor], starts: list[Array], wanted: Array, needs: Sequence[bool]
    ) -> tuple[list[Tensor | None], Array]:
        """Gradients by the inputs ``(u, h, *parameters)`` where needed, and (N,) by the initial state."""
        u, h, *values = inputs
        parameters = [p.detach().requires_grad_(need) for p, need in zip(values, needs[2:], strict=True)]
        found = [torch.zeros_like(v) if need else None for v, need in zip(inputs, needs, strict=True)]
        carry = np.zeros(starts[0].size)
        none = np.zeros(0, np.int64)
        for k in range(len(starts) - 2, -1, -1):
            part = slice(k * self.window, min((k + 1) * self.window, h.shape[0]))
            own_u, own_h = (v[part].detach().requires_grad_(need) for v, need in zip((u, h), needs[:2], strict=True))
            states, efforts = self.steps(_array(own_u), _array(own_h), starts[k])
            cotangent = np.zeros_like(states)
            cotangent[1:, self.wanted] = wanted[part.start + 1 : part.stop + 1]
            multipliers = np.empty((own_h.shape[0], states.shape[1] + len(self.program.junctions)))
            march = sweep.Integrated(self.program, self.theta, states, efforts, _array(own_u), _array(own_h))
            _, carry = sweep.adjoint(march, none, cotangent, multipliers, carry)
            if any(needs):
                self._add_gradients(found, part, [own_u, own_h, *parameters], states, efforts, multipliers)
        carry[self.wanted] += wanted[0]
        return found, carry

    def _add_gradients(
        self, found: list[Tensor | None], part: slice, inputs: list[Tensor], states: Array, efforts: Array, mu: Array
    ) -> None:
        """Add ``−μᵀ ∂F/∂(inputs)`` of one window."""
        n = states.shape[1]
        with torch.enable_grad():
            arguments = (self.program, torch.from_numpy(states), torch.from_numpy(efforts), inputs[0], inputs[1])
            # By name, because the caller may have replaced the module's parameters for the duration of the call.
            residual = torch.func.functional_call(
                self.equations, dict(zip(self.names, inputs[2:], strict=True)), arguments
            )
            if not residual.requires_grad:
                # A network may hold parameters and ports that do not occur in any of its equations.
                return
            # The sweep's multipliers of the balances already carry the minus sign of the implicit function theorem.
            weights = torch.from_numpy(np.hstack([-mu[:, :n], mu[:, n:]]))
            asked = [i for i, v in enumerate(found) if v is not None]
            gradients = torch.autograd.grad(residual, [inputs[i] for i in asked], weights, allow_unused=True)
        for i, gradient in zip(asked, gradients, strict=True):
            if gradient is not None:
                own = found[i][part] if i < 2 else found[i]  # type: ignore[index]
                own += gradient  # type: ignore[operator]


class _Implicit(torch.autograd.Function):
    """The integrated states; the backward pass is the adjoint sweep."""

    @staticmethod
    def forward(ctx: Any, march: March, u: Tensor, h: Tensor, x0: Tensor, *parameters: Tensor) -> Tensor:
        out, starts = march.forward(_array(u), _array(h), _array(x0))
        ctx.march, ctx.starts = march, starts
        ctx.save_for_backward(u, h, *parameters)
        return torch.from_numpy(out)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, wanted: Tensor) -> Any:
        needs = [*ctx.needs_input_grad[1:3], *ctx.needs_input_grad[4:]]
        found, by_start = ctx.march.pull_back(ctx.saved_tensors, ctx.starts, _array(wanted), needs)
        return None, found[0], found[1], torch.from_numpy(by_start), *found[2:]


def _array(tensor: Tensor) -> Array:
    return np.ascontiguousarray(tensor.detach().numpy())
