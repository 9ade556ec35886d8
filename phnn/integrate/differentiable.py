"""The steps of any network as one differentiable torch operation: one solver in torch, and one gradient for all steps.

    R_k(x_k, x_{k+1}; θ) = 0,     A_k = ∂R_k/∂x_{k+1},     B_k = ∂R_k/∂x_k
    λ_k = ∂L/∂x_k − B_kᵀ μ_k,     A_kᵀ μ_k = λ_{k+1},     dL/dθ = −Σ_k μ_kᵀ ∂R_k/∂θ

Compiled code (`phnn.integrate.kernel`) takes the steps where it can: in 64 bits, on the processor, laws with a kernel.
Torch takes all others, and the numbers are the same. The forward pass keeps the states of all steps. The
backward pass goes over them block by block from the end: it evaluates the residuals of a block at once with their
Jacobians (`phnn.integrate.equations`) and finds all multipliers ``μ`` in one sweep, so that the cost of a gradient
hardly depends on the number of parameters.

Torch solves many steps at once, of all members of a batch. Newton's step of a stretch is the recursion

    A_k δ_{k+1} = −R_k − B_k δ_k,     δ_0 = 0,

so that no python loop runs over the samples (Lim et al. 2024, "Parallelizing non-linear sequential models over the
sequence length"). Where it does not converge a stretch is shortened, down to one step and then to growing parts of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed, StructureViolated
from phnn.integrate import kernel
from phnn.integrate.equations import linearised, means, reducible_rules, step_residual
from phnn.integrate.program import compile_network
from phnn.integrate.scheme import Scheme, can_compile, partly_driven
from phnn.integrate.sweep import closed_cycle
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.wide import has_kernel, is_passive_by_form
from phnn.network.checks import check_state, evaluation
from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem

Array = NDArray[np.float64]

# Residuals are measured in units of the terms of their own equation: rounding, and what is accepted where the
# iteration stops; in units of the numbers' precision.
_ROUNDING, _ACCEPTED = 450.0, 45000.0
_ITERATIONS, _POLISHES, _HALVINGS = 25, 3, 30
_KEPT = 0.1  # share by which a residual has to fall for a Jacobian to be kept
# Steps, of all members of a batch together, whose equations the backward pass holds in memory at once.
BLOCK = 1 << 16
_FIRST, _MOST = 32, 512  # steps of the first stretch, and of the longest
_AT_ONCE = 1 << 11  # steps of all members of a batch, whose derivatives by all weights are held in memory together
_TOGETHER = 1 << 14  # steps of all members of a batch together, of a stretch that begins near its solution
_FEWEST = 8  # steps at the head of a stretch that are kept where the others were not solved
_SMALLEST_PART = 2.0**-10
# Shares of a step at which slopes of laws, and the sign of the Jacobian's determinant, are looked at.
_ALONG = 9


def simulate(
    system: PortHamiltonianSystem,
    u: Tensor,  # (..., T, P) inputs at the samples, or (..., T, 1) of the first port
    x0: Tensor | None = None,  # (..., n) state at the first sample; None: zero
    dt: float = 1e-4,  # sample interval [s]
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> tuple[Tensor, Tensor]:
    """Simulate a batch of inputs; returns the states (..., T, n) and port outputs (..., T, P).

        system = phnn.PortHamiltonianSystem(phnn.models.hrc(hysterons=2))
        u = torch.as_tensor(voltage)[:, None]             # (T, P) samples of the inputs
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
    _check(system, x0, u, h)
    compiles = x0.device.type == "cpu" and x0.dtype == torch.float64 and can_compile(system.network)
    return Steps(system, scheme, near, compiles).solve(x0, u, h, start)


def port_inputs(system: PortHamiltonianSystem, u: Tensor, batch_dimensions: int) -> Tensor:
    """Return the (N, ..., P) inputs of all ports; inputs without a batch dimension serve every member of the batch."""
    count = len(system.network.ports)
    if u.ndim == 1 and count >= 1:
        u = torch.cat([u.unsqueeze(-1), u.new_zeros(u.shape[0], count - 1)], dim=-1)
    return u.reshape(u.shape[0], *[1] * batch_dimensions, u.shape[-1]) if u.ndim == 2 else u


def _check(system: PortHamiltonianSystem, x0: Tensor, u: Tensor, h: Tensor) -> None:
    """Refuse an unsuitable initial state (..., n), inputs of all ports (N, ..., P) or steps (...)."""
    refused = h.detach()[~((h > 0.0) & (h < torch.inf))]
    if refused.numel():
        raise InputRefused(f"a step is {float(refused[0]):g} s: give positive, finite steps")
    check_state(x0, system.state_names)
    numbers = next(system.parameters(), x0.new_zeros(0, dtype=torch.float64)).dtype
    for name, value in (("initial state", x0), ("mean input", u)):
        if value.dtype != numbers:
            to = ".double()" if numbers == torch.float64 else ".float()"
            raise InputRefused(f"the {name} is {value.dtype}, and the system {numbers}: convert it with {to}")
        if not bool(torch.isfinite(value).all()):
            where = tuple(torch.nonzero(~torch.isfinite(value))[0].tolist())
            raise InputRefused(f"the {name} is not finite at index {where}: remove or repair that sample")
    system.actions(u[:1])
    fits = u.ndim == x0.ndim + 1 and all(a in (1, b) for a, b in zip(u.shape[1:-1], x0.shape[:-1], strict=True))
    if not fits:
        raise InputRefused(f"inputs of shape {tuple(u.shape)} do not fit an initial state {tuple(x0.shape)}")


class Steps(nn.Module):
    """The steps of a system. Called with the states at their starts and ends it returns their residuals.

    Args:
        near: (N+1, ..., n) states from which the iteration in torch begins.
        compiles: whether compiled code takes the steps.
    """

    def __init__(
        self,
        system: PortHamiltonianSystem,
        scheme: Scheme = Scheme.DISCRETE_GRADIENT,
        near: Tensor | None = None,
        compiles: bool = False,
    ) -> None:
        super().__init__()
        self.system, self.scheme, self.near, self.compiles = system, scheme, near, compiles

    @property
    def trained(self) -> dict[str, Tensor]:
        """Return all that gradients are asked by, by name."""
        return {name: p for name, p in self.named_parameters() if p.requires_grad}

    def solve(self, x0: Tensor, u: Tensor, h: Tensor, start: float = 0.0) -> Tensor:
        """Return the states (N+1, ..., n), differentiable; arguments as of `simulated`, whose checks are left out."""
        u = u.expand(len(u), *x0.shape[:-1], u.shape[-1])
        h = h.reshape(*h.shape, *[1] * (u.ndim - h.ndim))
        return _Implicit.apply(self, start, x0, u, h, *self.trained.values())

    def states(self, x0: Tensor, u: Tensor, h: Tensor, start: float) -> Tensor:
        """Return the states (N+1, ..., n) without gradients.

        Raises:
            SolverFailed: a step has no solution; names the time.
        """
        if not self.compiles:
            return march(self.system, x0, u, h, self.scheme, start, self.near)
        program = compile_network(self.system.network, self.scheme)
        values = self.system.present_values()
        theta = program.filled(
            {n: (values[n] if n in values else self.system.value(n)).item() for n in program.names}, self.system.network
        )
        members = prod(x0.shape[:-1])
        # (B, N, k) arrays of the members of a batch.
        starts, inputs, sizes = (
            np.ascontiguousarray(v.detach().reshape(len(v), members, v.shape[-1]).transpose(0, 1).numpy())
            for v in (x0.unsqueeze(0), u, h.expand(*u.shape[:-1], 1))
        )
        states, efforts = np.empty((len(starts), len(u) + 1, x0.shape[-1])), np.empty((len(u), x0.shape[-1]))
        for b, x in enumerate(starts[:, 0]):
            done = kernel.march(program, theta, x, inputs[b], sizes[b, :, 0], states[b], efforts)
            if done < len(u):
                raise SolverFailed(
                    f"no solution of the step at t = {start + sizes[b, :done].sum():.6g} s; a parameter probably has "
                    "an unphysical value: bound it, or use smaller steps"
                )
        return torch.from_numpy(states).transpose(0, 1).reshape(len(u) + 1, *x0.shape)

    def forward(self, x: Tensor, ends: Tensor, u: Tensor, h: Tensor, linearise: bool = True) -> tuple[Tensor, ...]:
        """Return residuals (N, ..., n) and their derivatives by ``ends`` and ``x`` unless these are not asked for."""
        if not linearise:
            return (step_residual(self.system, x, ends, u, h, self.scheme),)
        return linearised(self.system, x, ends, u, h, self.scheme)


def _multipliers(by_next: Tensor, by_start: Tensor, wanted: Tensor, carry: Tensor) -> tuple[Tensor, Tensor]:
    """Return ``−μ`` (N, ..., n) of some steps, and (..., n) ``∂L/∂x`` at their start, without that state's own, from
    those ``wanted`` (N, ..., n) at their ends and what later steps ``carry`` (..., n) to the last of them."""
    inverse = torch.linalg.inv(by_next).mT
    back = by_start.mT @ inverse
    # λ_k = w_k − (Bᵀ A⁻ᵀ)_{k+1} λ_{k+1}, from the end.
    wanted = torch.cat([wanted[:-1], (wanted[-1] + carry).unsqueeze(0)])
    totals = recursion(-back.flip(0).roll(1, 0), wanted.flip(0)).flip(0)
    return -_times(inverse, totals), -_times(back[0], totals[0])


class _Implicit(torch.autograd.Function):
    """The states of a solve; the backward pass is the sweep of the adjoint."""

    @staticmethod
    def forward(ctx: Any, steps: Steps, start: float, x0: Tensor, u: Tensor, h: Tensor, *parameters: Tensor) -> Tensor:
        states = steps.states(x0, u, h, start)
        ctx.steps, ctx.names = steps, tuple(steps.trained)
        ctx.save_for_backward(states, u, h, *parameters)
        return states

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, wanted: Tensor) -> Any:
        states, *inputs = ctx.saved_tensors
        needs = ctx.needs_input_grad[3:]
        gradients = [torch.zeros_like(v) if need else None for v, need in zip(inputs, needs, strict=True)]
        carry, length = torch.zeros_like(wanted[0]), max(1, BLOCK // max(1, prod(wanted.shape[1:-1])))
        for first in reversed(range(0, len(states) - 1, length)):
            part = slice(first, first + length)
            block = [v[part] if i < 2 else v for i, v in enumerate(inputs)]
            block = [v.detach().requires_grad_(need) for v, need in zip(block, needs, strict=True)]
            with torch.enable_grad():
                # By name, because the caller may have replaced the module's parameters for the duration of the call.
                named = dict(zip(ctx.names, block[2:], strict=True))
                residual, by_next, by_start = _with(named, ctx.steps, states[:-1][part], states[1:][part], *block[:2])
            weights, carry = _multipliers(by_next, by_start, wanted[1:][part], carry)
            asked = [i for i, need in enumerate(needs) if need]
            # A network may hold parameters and ports that do not occur in any of its equations.
            if not (asked and residual.requires_grad):
                continue
            by_input = torch.autograd.grad(residual, [block[i] for i in asked], weights, allow_unused=True)
            for i, gradient in zip(asked, by_input, strict=True):
                if gradient is not None:
                    total: Any = gradients[i]
                    (total[part] if i < 2 else total).add_(gradient)
        return None, None, wanted[0] + carry, *gradients


# ------------------------------------------------------------------------------------------- solving in torch


@torch.no_grad()
@evaluation
def march(
    system: PortHamiltonianSystem,
    x0: Tensor,  # (..., n)
    u: Tensor,  # (N, ..., P)
    h: Tensor,  # (N, ..., 1) [s], which multiplies states
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
    start: float = 0.0,
    near: Tensor | None = None,
    alone: bool = False,
) -> Tensor:
    """(N+1, ..., n) states, without gradients, of steps that need not be equal; messages count time from ``start``.

    Args:
        near: (N+1, ..., n) states to begin the iteration from, all steps at once; not used where it has another shape.
        alone: fail where this does not converge.

    Raises:
        SolverFailed: a step has no solution connected to its start; names time, state and remedy.
        StructureViolated: the scheme cannot compute the drive of a modulator state; names both.
    """
    names = [system.state_names[k] for k in reducible_rules(system, scheme)]
    if reason := partly_driven(system.network, names):
        raise StructureViolated(f"{scheme}: {reason}")
    guess = x0.new_zeros(0) if near is None else near
    fits = guess.shape == (len(h) + 1, *x0.shape)
    longest = max(_FIRST, _TOGETHER // max(1, prod(x0.shape[:-1]))) if fits else _MOST
    states, length, done = [x0.detach().unsqueeze(0)], longest if fits else _FIRST, 0
    while done < h.shape[0]:
        part = slice(done, min(done + length, h.shape[0]))
        run = _Run(system, states[-1][-1], u[part].detach(), h[part].detach(), scheme)
        root = _newton(run, guess[1:][part] if fits else run.x.expand(h[part].shape[0], *run.x.shape))
        if not root.cause:
            done, length = part.stop, min(2 * length, longest)
        elif root.solved >= _FEWEST:
            done, length = done + root.solved, length if fits else max(_FEWEST, 2 * root.solved)
            root = _Root(root.x[: root.solved])
        elif fits and alone:
            raise SolverFailed(root.cause)
        elif fits:
            fits, length, longest = False, _FIRST, _MOST
            continue
        elif length > 1:
            length = max(1, (part.stop - done) // 4)
            continue
        else:
            root = _Root(_by_parts(run, start + float(h[:done].flatten(1).amax(1).sum())))
            done += 1
        states.append(root.x)
    return torch.cat(states)


class _Root(NamedTuple):
    """End states (N, ..., n) of a stretch, or the reason ``cause`` why there are none; it is empty on success.

    Of a stretch that was not solved the first ``solved`` steps are: what happens later does not act on them.
    """

    x: Tensor
    cause: str = ""
    solved: int = 0


class _Run(NamedTuple):
    """A stretch of steps from ``x`` (..., n) under ``u`` (N, ..., P) of sizes ``h`` (N, ..., 1) [s]."""

    system: PortHamiltonianSystem
    x: Tensor
    u: Tensor
    h: Tensor
    scheme: Scheme

    def starts(self, z: Tensor) -> Tensor:
        """Return (N, ..., n) states at the starts of steps that end at ``z``."""
        return torch.cat([self.x.unsqueeze(0), z[:-1]])


def _by_parts(run: _Run, t: float) -> Tensor:
    """Return (1, ..., n) end of one step, found along growing parts of it."""
    done, part, guess = 0.0, 0.25, run.x.unsqueeze(0)
    while done < 1.0:
        part = min(part, 1.0 - done)
        root = _newton(run._replace(h=(done + part) * run.h), guess, damped=True)
        if not root.cause:
            done, guess, part = done + part, root.x, 2.0 * part
        elif part > _SMALLEST_PART:
            part *= 0.5
        else:
            h = float(run.h.max())
            raise SolverFailed(
                f"the step from t = {t:.6g} s to {t + h:.6g} s has no solution: {root.cause}, at "
                f"{done:.3f} of the step; take a step below {max(done, _SMALLEST_PART) * h:.2g} s, or laws that "
                "are monotone (MonotoneMLP) and convex (ConvexEnergyMLP)"
            )
    return guess


def _newton(run: _Run, z: Tensor, damped: bool = False) -> _Root:
    """Newton's method for all steps of a stretch and all members of a batch at once, damped where laws are steep."""
    system, precision = run.system, torch.finfo(z.dtype).eps
    worst = torch.inf
    for _ in range(_ITERATIONS):
        x = run.starts(z)
        residual, by_next, by_start = linearised(system, x, z, run.u, run.h, run.scheme)
        residual = residual.detach()
        if not bool(torch.isfinite(residual).all()):
            return _Root(z, f"the vector field is not finite ({_names(system, ~torch.isfinite(residual))})")
        scale = _sizes(by_next, z) + _sizes(by_start, x) + torch.finfo(z.dtype).tiny
        if not bool(torch.isfinite(scale).all()):
            return _Root(z, f"the step's Jacobian is not finite ({_names(system, ~torch.isfinite(scale))})")
        worst = float((residual.abs() / scale).max())
        if worst <= _ROUNDING * precision:
            break
        columns, info = torch.linalg.solve_ex(by_next, torch.cat([residual.unsqueeze(-1), by_start], dim=-1))
        if bool((info > 0).any()):
            return _Root(z, "the step's Jacobian is singular")
        moved, carry = -columns[..., 0], -columns[..., 1:]
        step = recursion(carry, moved)
        for _ in range(_HALVINGS if damped else 0):
            ahead = step_residual(system, run.starts(z + step), z + step, run.u, run.h, run.scheme)
            if float((ahead.abs() / scale).max()) < worst:
                break
            step = 0.5 * step
        if bool((z + step == z).all()):
            break
        z = z + step
        for _ in range(_POLISHES):
            # The Jacobian is kept while it serves: near the solution a residual alone costs half.
            residual = step_residual(system, run.starts(z), z, run.u, run.h, run.scheme)
            before, worst = worst, float((residual.abs() / scale).max())
            if not worst <= max(_KEPT * before, _ROUNDING * precision):
                break
            z = z - recursion(carry, torch.linalg.solve(by_next, residual))
            if worst <= _ROUNDING * precision:
                break
        if worst <= _ROUNDING * precision:
            break
    # The comparison also fails for NaN.
    if not worst <= _ACCEPTED * precision:
        bad = ~(residual.abs() <= _ACCEPTED * precision * scale)
        wrong = ~(residual.abs() <= _ROUNDING * precision * scale).flatten(1).all(1)
        solved = int(wrong.float().argmax())
        if solved and not _is_sure(run._replace(u=run.u[:solved], h=run.h[:solved]), z[:solved]):
            solved = 0
        return _Root(z, f"Newton's iteration stopped at a residual of {worst:.1e} ({_names(system, bad)})", solved)
    if not _is_sure(run, z):
        return _Root(z, "the solution is not connected to the previous state (a law falls too steeply for this step)")
    return _Root(z)


def _is_sure(run: _Run, z: Tensor) -> bool:
    """Return whether the steps have one solution each, or theirs are connected to their starts."""
    return _has_one_root(run, z) or _is_connected(run, z)


def _sizes(matrix: Tensor, state: Tensor) -> Tensor:
    """Return (..., n) size of the terms of a linear form, and so of the effect of rounding the state."""
    return (matrix.abs() @ state.abs().unsqueeze(-1)).squeeze(-1)


def _has_one_root(run: _Run, z: Tensor) -> bool:
    """Return whether all efforts and flows rise along the steps, which then have exactly one solution each: by the
    laws' forms, or where these say nothing, at points between start and end."""
    system = run.system
    network, x = system.network, run.starts(z)
    # States that a law or ratio follows within the step, unlike those of modulators. Multi-ports of a known form are
    # smooth on the scale of their states.
    if ({r.modulated_by for r in network.resistors} | {m.by for m in network.modulations}) & set(network.storage_names):
        return False
    together = [m.law for m in network.multi_ports] + [e.law for e in network.shared_energies]
    if not all(map(is_passive_by_form, together)):
        return False
    for k, storage in enumerate(network.storages):
        known = STORAGE_LAWS[storage.law] if isinstance(storage.law, str) else storage.law
        sure = has_kernel(storage.law) and known.convex
        if not (sure or _rises(lambda at, k=k: system.mean_effort(k, at, at), x[..., k], z[..., k])):  # type: ignore[misc]
            return False
    ends = [system.branch_efforts(system.efforts(at), at) for at in (x, z)]
    for r, resistor in enumerate(network.resistors):
        known = RESISTOR_LAWS[resistor.law] if isinstance(resistor.law, str) else resistor.law
        sure = has_kernel(resistor.law) and known.monotone
        flow = lambda at, r=r: system.branch_flow(r, at, x.expand(*at.shape, x.shape[-1]))  # noqa: E731
        if not (sure or _rises(flow, ends[0][..., r], ends[1][..., r])):
            return False
    return True


def _between(a: Tensor, b: Tensor) -> Tensor:
    """Return (9, ...) points on the way from ``a`` to ``b``."""
    way = torch.linspace(0.0, 1.0, _ALONG, dtype=a.dtype, device=a.device)
    return a + way.reshape(-1, *[1] * a.ndim) * (b - a)


def _rises(law: Callable[[Tensor], Tensor], a: Tensor, b: Tensor) -> bool:
    """Return whether a law's slope is positive or zero at points between ``a`` and ``b``."""
    with torch.enable_grad():
        at = _between(a, b).requires_grad_(True)
        # A constant law has a slope too.
        (slope,) = torch.autograd.grad((law(at) + 0.0 * at).sum(), at)
    return bool((slope >= 0.0).all())


def _is_connected(run: _Run, z: Tensor) -> bool:
    """Return whether the Jacobian's determinant stays positive along the way from the start of every step to its end.

    The determinant is one at ``h = 0`` and negative on the branch between two folds. If it stays positive on the way,
    exactly one root lies there for every shorter step too (proved in one dimension, sampled in others).
    """
    x = run.starts(z)
    points, u = _between(x, z), run.u.expand(_ALONG, *run.u.shape)
    by_next = linearised(run.system, x.expand_as(points), points, u, run.h, run.scheme)[1]
    return bool((torch.linalg.det(by_next) > 0.0).all())


def _names(system: PortHamiltonianSystem, bad: Tensor) -> str:
    """Return the names of the states that a mask (..., n) marks anywhere."""
    marked = bad.reshape(-1, bad.shape[-1]).any(0).tolist()
    return ", ".join(name for name, flag in zip(system.state_names, marked, strict=True) if flag)


def recursion(m: Tensor, r: Tensor) -> Tensor:
    """Return (N, ..., n) solution of ``x_k = r_k + m_k x_{k−1}`` with ``x_{−1} = 0``, by cyclic reduction.

    Two steps make one of half as many, whose solution is every second ``x_k`` (Blelloch 1990, "Prefix sums and their
    applications").
    """
    if r.shape[0] == 1:
        return r
    first, second = m[0::2], m[1::2]
    pairs = second.shape[0]
    later = recursion(second @ first[:pairs], r[1::2] + _times(second, r[0::2][:pairs]))
    before = torch.cat([torch.zeros_like(r[:1]), later])[: first.shape[0]]
    earlier = r[0::2] + _times(first, before)
    both = torch.stack([earlier[:pairs], later], dim=1).flatten(0, 1)
    return both if first.shape[0] == pairs else torch.cat([both, earlier[-1:]])


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    """Return (..., n) product."""
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


# ------------------------------------------------------------------------------------------------ derivatives


@torch.no_grad()
def sensitivities(
    steps: Steps, states: Tensor, u: Tensor, h: Tensor, nodes: Sequence[Tensor], row: int
) -> list[Tensor]:
    """Return derivatives of one state at nodes of every member, by all that is trained and then by its initial state.

    Args:
        states: (N+1, B, n), of the steps ``h`` (N, B, 1) under ``u`` (N, B, P).
        nodes: (K,) of every member, increasing; row: number of the state.

    Returns:
        (K, W + n) for every member, the weights in the order of ``steps.named_parameters()``.

    Raises:
        RuntimeError: a law does what `torch.func.vmap` cannot follow.
    """
    members, n = states.shape[1:]
    weights = {name: p.detach() for name, p in steps.trained.items()}
    by = torch.eye(n).to(states).expand(members, n, n)
    by = torch.cat([by.new_zeros(members, n, sum(p.numel() for p in weights.values())), by], dim=-1)
    gradients = [by.new_empty(len(k), by.shape[-1]) for k in nodes]
    each = [dict(zip(k.tolist(), range(len(k)), strict=True)) for k in nodes]

    def keep(node: int) -> None:
        for b, place in enumerate(each):
            if node in place:
                gradients[b][place[node]] = by[b, row]

    keep(0)
    length = max(1, _AT_ONCE // members)
    for first in range(0, len(h), length):
        part = slice(first, first + length)
        x, ends = states[:-1][part], states[1:][part]
        _, by_next, by_start = linearised(steps.system, x, ends, u[part], h[part], steps.scheme)
        by_weights = _by_weights(steps, weights, x, ends, u[part], h[part]) if weights else by_start[..., :0]
        inverse = -torch.linalg.inv(by_next)
        carry, by_weights = inverse @ by_start, inverse @ by_weights
        for k in range(len(x)):
            by = torch.cat([torch.baddbmm(by_weights[k], carry[k], by[..., :-n]), carry[k] @ by[..., -n:]], dim=-1)
            keep(first + k + 1)
    return gradients


def _with(given: Mapping[str, Tensor], module: nn.Module, *arguments: Any) -> Any:
    """Call a module with other tensors in the place of some parameters, by all names under which it holds these.

    `functional_call` ties two names of one weight itself, but leaves a module that stands at two places without it.
    """
    known = dict(module.named_parameters())
    tensors = {id(known[name]): v for name, v in given.items()}
    everywhere = {
        f"{at}.{name}" if at else name: tensors[id(p)]
        for at, one in module.named_modules() for name, p in one.named_parameters(recurse=False, remove_duplicate=False)
        if id(p) in tensors
    }  # fmt: skip
    return torch.func.functional_call(module, everywhere, arguments, tie_weights=False)


def _by_weights(steps: Steps, weights: Mapping[str, Tensor], x: Tensor, ends: Tensor, u: Tensor, h: Tensor) -> Tensor:
    """Return (N, B, n, W) derivatives of the residuals of single steps."""

    def residual(given: dict[str, Tensor], *step: Tensor) -> Tensor:
        return _with(given, steps, *step, False)[0]

    flat = [v.expand(*x.shape[:-1], v.shape[-1]).flatten(0, 1) for v in (x, ends, u, h)]
    jacobians = torch.func.vmap(torch.func.jacrev(residual), (None, 0, 0, 0, 0))(dict(weights), *flat)
    return torch.cat([v.reshape(*v.shape[:2], -1) for v in jacobians.values()], dim=-1).unflatten(0, x.shape[:-1])


@torch.no_grad()
def first_order(
    steps: Steps, states: Tensor, u: Tensor, h: Tensor, moved: Mapping[str, Tensor], start: Tensor
) -> Tensor:
    """Return (N+1, ..., n) changes of the states by small changes of weights and of the initial state (..., n)."""
    weights = {name: p.detach() for name, p in steps.named_parameters() if name in moved}
    x, ends = states[:-1], states[1:]

    def residual(given: dict[str, Tensor]) -> Tensor:
        return _with(given, steps, x, ends, u, h, False)[0]

    change = torch.func.jvp(residual, (weights,), ({name: moved[name] for name in weights},))[1]
    _, by_next, by_start = linearised(steps.system, x, ends, u, h, steps.scheme)
    change[0] += _times(by_start[0], start)
    inverse = -torch.linalg.inv(by_next)
    return torch.cat([start.unsqueeze(0), recursion(inverse @ by_start, _times(inverse, change))])


# ---------------------------------------------------------------------------------- networks and arrays


def integrated(
    network: Network, x0: Array, u: Array, h: Array, cycle: int, scheme: Scheme, start: float
) -> tuple[Array, Array]:
    """Return the states (N+1, n) and mean efforts (N, n) of a network under mean inputs (N, P), as arrays.

    Args:
        x0: (n,) initial state; where the first ``cycle`` steps are a period, a guess of that of the steady cycle.
        start: time of the first state, for messages.

    Raises:
        SolverFailed: a step has no solution, with its time; or there is no steady cycle.
    """
    system, inputs, steps = PortHamiltonianSystem(network), torch.from_numpy(u), torch.from_numpy(h).unsqueeze(-1)

    def period(x: Array) -> Array:
        return march(system, torch.from_numpy(x), inputs[:cycle], steps[:cycle], scheme, start).numpy()

    def monodromy(states: Array) -> Array:
        x, ends = torch.from_numpy(states[:-1]), torch.from_numpy(states[1:])
        _, by_next, by_start = linearised(system, x, ends, inputs[:cycle], steps[:cycle], scheme)
        total = torch.eye(x.shape[-1]).to(x)
        for carry in -torch.linalg.solve(by_next, by_start):
            total = carry @ total
        return total.numpy()

    x0 = closed_cycle(period, monodromy, x0, network.state_names) if cycle else x0
    x = torch.from_numpy(np.asarray(x0, dtype=float))
    states = march(system, x, inputs, steps, scheme, start)
    with torch.no_grad():
        efforts = means(system, scheme, states[:-1], states[1:], inputs, steps).efforts
    return states.numpy(), efforts.numpy()


def by_start(
    network: Network, states: Array, u: Array, h: Array, nodes: NDArray[np.int64], row: int, scheme: Scheme
) -> Array:
    """(K, n) derivatives of one state at nodes of a trajectory by its initial state; arguments as of `integrated`."""
    steps = Steps(PortHamiltonianSystem(network).requires_grad_(False), scheme)
    x, inputs, sizes = (torch.from_numpy(np.ascontiguousarray(v)).unsqueeze(1) for v in (states, u, h[:, None]))
    return sensitivities(steps, x, inputs, sizes, [torch.from_numpy(nodes)], row)[0].numpy()
