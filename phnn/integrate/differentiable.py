"""The compiled march as a differentiable torch operation.

    F(X; θ, u, h) = 0,     dL/dθ = −μᵀ ∂F/∂θ,     (∂F/∂X)ᵀ μ = ∂L/∂X

The march finds the states ``X`` of all steps; one compiled backward sweep gives the multipliers ``μ``; one
vectorised evaluation of ``F`` by the torch module, differentiated once, gives the gradients by all parameters,
inputs and steps. The cost of a gradient hardly depends on how many parameters there are.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from phnn.errors import InputRefused, SolverFailed, StructureViolated
from phnn.integrate import kernel, sweep
from phnn.integrate.dense import solve_dense
from phnn.integrate.program import Program, compile_network
from phnn.integrate.residual import march_residual, network_order
from phnn.network.system import PortHamiltonianSystem

Array = NDArray[np.float64]


def simulate_torch(
    system: PortHamiltonianSystem,
    u_mean: Tensor,  # (n, P) mean inputs of the steps
    h: Tensor | float,  # (n,) steps [s], or one for all
    x0: Tensor,  # (L+1,) initial state
    order: str = "program",
) -> Tensor:
    """March the steps of a system, differentiable by its parameters, ``u_mean``, ``x0`` and ``h``.

    Networks with one junction take the compiled march; all others, neural laws among them, the torch step of
    `phnn.integrate.dense`, where gradients by ``h`` are not offered.

    Args:
        order: of the states in ``x0`` and in the result: ``"program"`` (the leaves and, last, the momentum of the
            junction) or ``"network"`` (as in ``system.state_names``). They differ only where the momentum is not
            the last storage; networks without a kernel are always in their own order.

    Returns:
        (n+1, L+1) states at the ends of the steps.

    Raises:
        InputRefused: a shape that does not fit, a value that is not finite or not float64, a step that is not
            positive, or an unknown order.
        SolverFailed: a step has no solution; names the time.
    """
    if order not in ("program", "network"):
        raise InputRefused(f"order = {order!r}: choose 'program' or 'network'")
    steps = torch.as_tensor(h, dtype=torch.float64).expand(u_mean.shape[:1])
    _check(system, u_mean, steps, x0)
    try:
        program = compile_network(system.network)
    except StructureViolated:
        return _dense(system, u_mean, steps, x0)
    places = network_order(system, program)
    own = order == "network"
    start = x0[torch.tensor(places).argsort()] if own else x0
    path = _compiled(system, program, u_mean, steps, start)
    return path[:, places] if own else path


def _compiled(system: PortHamiltonianSystem, program: Program, u: Tensor, h: Tensor, x0: Tensor) -> Tensor:
    values = [system.value(name).item() for name in program.names]
    theta = np.array([*values, *program.constants])
    march = _March(program, theta, _array(u), _array(h), _array(x0))
    path = torch.from_numpy(march.states)
    if not torch.is_grad_enabled() or u.shape[0] == 0:
        return path if u.shape[0] else x0.unsqueeze(0)
    residual = march_residual(system, program, path, torch.from_numpy(march.velocity), u, h).value
    if not (residual.requires_grad or x0.requires_grad):
        return path
    return _Implicit.apply(march, residual, x0)


class _March:
    """One compiled march and what its adjoint needs to know.

    Raises:
        SolverFailed: a step has no solution.
    """

    def __init__(self, program: Program, theta: Array, u: Array, h: Array, x0: Array) -> None:
        self.u, self.h = u, h
        self.network = (program.leaves, program.modulators, program.resistors, program.ports, program.inertia, theta)
        self.states = np.empty((h.size + 1, x0.size))
        self.velocity = np.empty(h.size)
        efforts = np.empty((h.size, x0.size - 1))
        done = kernel.march(*self.network, x0, u, h, self.states, self.velocity, efforts)
        if done < h.size:
            raise SolverFailed(
                f"no solution of the step at t = {h[:done].sum():.6g} s; a parameter is probably far from physical: "
                "bound it, or use smaller steps"
            )

    def multipliers(self, cotangent: Array) -> Array:
        """(n+1, L+2) as filled by `sweep.adjoint`."""
        out = np.zeros((self.h.size + 1, self.states.shape[1] + 1))
        sweep.adjoint(*self.network, self.states, self.velocity, self.u, self.h, cotangent, out)
        return out


class _Implicit(torch.autograd.Function):
    """The states of the march; backward by the adjoint sweep. The residual carries the graph to all parameters."""

    @staticmethod
    def forward(ctx, march, residual, x0):  # type: ignore[no-untyped-def]
        ctx.march = march
        return torch.from_numpy(march.states.copy())

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, wanted):  # type: ignore[no-untyped-def]
        found = torch.from_numpy(ctx.march.multipliers(_array(wanted)))
        # The sweep's multiplier of the junction already carries the minus sign of the implicit function theorem.
        by_residual = torch.cat([-found[1:, :-1], found[1:, -1:]], dim=-1)
        return None, by_residual, found[0, :-1]


def _dense(system: PortHamiltonianSystem, u: Tensor, h: Tensor, x0: Tensor) -> Tensor:
    """Runs of equal steps, each by the torch step."""
    lengths = torch.unique_consecutive(h.detach(), return_counts=True)[1].tolist()
    pieces, first, x = [x0.unsqueeze(0)], 0, x0
    for length in lengths:
        path = solve_dense(system, x, u[first : first + length], float(h[first]))
        pieces.append(path[1:])
        first, x = first + length, path[-1]
    return torch.cat(pieces)


def _array(tensor: Tensor) -> Array:
    return np.ascontiguousarray(tensor.detach().numpy())


def _check(system: PortHamiltonianSystem, u: Tensor, h: Tensor, x0: Tensor) -> None:
    states, ports = len(system.state_names), len(system.network.ports)
    for name, tensor, shape in (("initial state", x0, (states,)), ("mean input", u, (u.shape[0], ports))):
        if tuple(tensor.shape) != shape:
            raise InputRefused(f"the {name} has shape {tuple(tensor.shape)}: this network needs {shape}")
    for name, tensor in (("initial state", x0), ("mean input", u), ("step", h)):
        if tensor.dtype != torch.float64:
            raise InputRefused(f"the {name} is {tensor.dtype}: convert it with .double(), the march needs 64 bits")
        if not bool(torch.isfinite(tensor).all()):
            place = tuple(torch.nonzero(~torch.isfinite(tensor))[0].tolist())
            raise InputRefused(f"the {name} is not finite at index {place}: remove or repair that sample")
    if not bool((h > 0.0).all()):
        raise InputRefused(f"a step is {float(h.min()):g} s: give positive steps")
