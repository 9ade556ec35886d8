"""The power-preserving step of any port-Hamiltonian system, in torch and differentiable.

    x⁺ − x = h [ J ē − Σ_r b_r φ_r(b_rᵀ ē, q̄_r) + g ψ(ū) ],      ē_k = (H_k(x⁺_k) − H_k(x_k))/(x⁺_k − x_k)

with the coordinate-wise discrete gradient ``ē`` (Itoh & Abe 1988; Gonzalez 1996) and modulating variables at
mid-step, memories at its start. Then for every step size ``H(x⁺) − H(x) = h (Σ ψ(ū) gᵀē − Σ ε̄_r φ_r(ε̄_r))``: the
simulation is passive too. Memories follow their exact flow under the mean drives of the step.

Each step is solved by a damped Newton iteration with the dense Jacobian. Gradients follow from the implicit
function theorem: one vectorised evaluation of all residuals and one backward sweep over the stored states.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from phnn.errors import InputRefused, SolverFailed
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.network import memory
from phnn.network.incidence import combined
from phnn.network.power import PowerBalance
from phnn.network.system import PortHamiltonianSystem

# Residuals are measured in units of the largest rounding-free terms of their own equation.
_TOLERANCE = 1e-13
_ACCEPTED = 1e-11
_ITERATIONS = 40
_HALVINGS = 25
_SMALLEST_PART = 2.0**-10
_SAMPLES = 9


def step_residual(
    system: PortHamiltonianSystem,
    x: Tensor,  # (..., n) state at the start of the step
    x_next: Tensor,  # (..., n) and at its end
    u: Tensor,  # (..., P) mean input of the step
    h: float | Tensor,  # [s], one for all or shaped to multiply states
) -> Tensor:
    """(..., n) what the step equation leaves: zero at its solution. All steps at once where batched over them."""
    efforts = system.mean_efforts(x, x_next)
    if not _remembers(system):
        return x_next - x - h * system.rate(efforts, 0.5 * (x + x_next), u)
    middle, first = memory.between(system, x, x_next), len(system.network.storages)
    end = memory.ends(system, x[..., first:], memory.drives(system, efforts, middle, u), h)
    moved = x_next[..., :first] - x[..., :first] - h * system.rate(efforts, middle, u)
    return torch.cat([moved, x_next[..., first:] - end], dim=-1)


def _remembers(system: object) -> bool:
    """Whether a system, which need not be a network, has memories."""
    return isinstance(system, PortHamiltonianSystem) and bool(system.network.memories)


def solve_dense(
    system: PortHamiltonianSystem,
    x0: Tensor,  # (..., n) initial state
    u_mean: Tensor,  # (N, ..., P) mean input of every step, or (N,) for the first port with the others at zero
    h: float,
) -> Tensor:
    """March ``N`` power-preserving steps.

    Args:
        system: any system, neural laws included.
        h: step [s].

    Returns:
        (N+1, ..., n) states, differentiable by ``x0``, ``u_mean`` and the system's parameters.

    Raises:
        InputRefused: not float64, not finite, a shape that does not fit, or a step that is not positive.
        SolverFailed: a step has no solution connected to its start; names time, state and remedy.
    """
    u = port_inputs(system, u_mean, x0.ndim - 1)
    check(system, x0, u, h)
    return with_derivatives(system, march(system, x0, u, [h] * u.shape[0]), x0, u, h)


def march(system: PortHamiltonianSystem, x0: Tensor, u: Tensor, h: list[float], start: float = 0.0) -> Tensor:
    """(N+1, ..., n) states, without gradients, of steps that need not be equal; messages count time from ``start``."""
    with torch.no_grad():
        states, t = [x0.detach()], start
        for u_step, h_step in zip(u, h, strict=True):
            states.append(_step(system, states[-1], u_step, h_step, t))
            t += h_step
        return torch.stack(states)


def with_derivatives(system: PortHamiltonianSystem, path: Tensor, x0: Tensor, u: Tensor, h: float | Tensor) -> Tensor:
    """The marched ``path`` as a differentiable function of ``x0``, ``u``, the parameters and a tensor ``h``."""
    if not torch.is_grad_enabled() or u.shape[0] == 0:
        return path
    residual = step_residual(system, path[:-1], path[1:], u, h)
    if not (residual.requires_grad or x0.requires_grad):
        return path
    by_next, by_start = jacobians(system, path[:-1], path[1:], u.detach(), h)
    return _Implicit.apply(path, by_next, by_start, residual, x0)


def ledger(
    system: PortHamiltonianSystem,
    states: Tensor,  # (N+1, ..., n) as returned by `solve_dense`
    u_mean: Tensor,  # (N, ..., P) or (N,)
    h: float,
) -> PowerBalance:
    """Mean powers of every step (N, ...) at the step's own efforts, which are exact where nodal efforts are not."""
    u = port_inputs(system, u_mean, states.ndim - 2)
    x, x_next = states[:-1], states[1:]
    stored = (system.energy(x_next) - system.energy(x)) / h
    return system.power(system.mean_efforts(x, x_next), memory.between(system, x, x_next), u, stored)


class _Implicit(torch.autograd.Function):
    """The stored path, with the derivatives of the path that solves the recursion.

    ``R_n(x_n, x_{n+1}; θ) = 0`` gives ``δx_{n+1} = −A_n⁻¹ (δR_n + B_n δx_n)``, a block-bidiagonal system whose
    transpose is swept backwards. The residual carries the graph to all parameters and inputs.
    """

    @staticmethod
    def forward(ctx, path, by_next, by_start, residual, x0):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(by_next, by_start)
        return path.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, wanted):  # type: ignore[no-untyped-def]
        by_next, by_start = ctx.saved_tensors
        inverse = torch.linalg.inv(by_next).mT
        carry = by_start.mT @ inverse
        total = wanted[-1]
        totals = [total]
        for n in range(by_next.shape[0] - 1, 0, -1):
            total = wanted[n] - (carry[n] @ total.unsqueeze(-1)).squeeze(-1)
            totals.append(total)
        stacked = torch.stack(totals[::-1])
        by_residual = -(inverse @ stacked.unsqueeze(-1)).squeeze(-1)
        by_x0 = wanted[0] - (carry[0] @ stacked[0].unsqueeze(-1)).squeeze(-1)
        return None, None, None, by_residual, by_x0


def port_inputs(system: PortHamiltonianSystem, u: Tensor, batch_dimensions: int) -> Tensor:
    """(N, ..., P) inputs of all ports; inputs that are not batched serve every member of the batch."""
    count = len(system.network.ports)
    if u.ndim == 1 and count >= 1:
        u = torch.cat([u.unsqueeze(-1), u.new_zeros(u.shape[0], count - 1)], dim=-1)
    return u.reshape(u.shape[0], *[1] * batch_dimensions, u.shape[-1]) if u.ndim == 2 else u


def check(system: PortHamiltonianSystem, x0: Tensor, u: Tensor, h: float) -> None:
    """Refuse an initial state, inputs of all ports (N, ..., P) or a step that `march` cannot use."""
    if not 0.0 < h < float("inf"):
        raise InputRefused(f"the step is {h:g} s: give a positive, finite step")
    refuse_unfit("initial state", x0)
    refuse_unfit("mean input", u)
    system.actions(u[:1])
    fits = u.ndim == x0.ndim + 1 and all(a in (1, b) for a, b in zip(u.shape[1:-1], x0.shape[:-1], strict=True))
    if not fits:
        raise InputRefused(f"inputs of shape {tuple(u.shape)} do not fit an initial state {tuple(x0.shape)}")


def refuse_unfit(name: str, value: Tensor) -> None:
    """Refuse what is not float64 or not finite."""
    if value.dtype != torch.float64:
        raise InputRefused(f"the {name} is {value.dtype}: convert it with .double(), the step needs 64 bits")
    if not bool(torch.isfinite(value).all()):
        where = tuple(torch.nonzero(~torch.isfinite(value))[0].tolist())
        raise InputRefused(f"the {name} is not finite at index {where}: remove or repair that sample")


@dataclass(frozen=True)
class _Root:
    """The end state of a step, or why there is none (then ``cause`` is not empty)."""

    x: Tensor
    cause: str = ""


def _step(system: PortHamiltonianSystem, x: Tensor, u: Tensor, h: float, t: float) -> Tensor:
    """The end of one step: Newton from its start and, where that fails, along growing parts of the step."""
    # Starting from x, not from an extrapolation, keeps to the root connected with the previous state.
    root = _newton(system, x, x, u, h)
    if not root.cause:
        return root.x
    done, part, guess = 0.0, 0.25, x
    while done < 1.0:
        part = min(part, 1.0 - done)
        root = _newton(system, x, guess, u, (done + part) * h)
        if not root.cause:
            done, guess, part = done + part, root.x, 2.0 * part
        elif part > _SMALLEST_PART:
            part *= 0.5
        else:
            raise SolverFailed(
                f"the step from t = {t:.6g} s to {t + h:.6g} s has no solution: {root.cause}, at "
                f"{done:.3f} of the step; take a step below {max(done, _SMALLEST_PART) * h:.2g} s, or laws that are "
                "monotone (MonotoneMLP) and convex (EnergyMLP)"
            )
    return guess


def _newton(system: PortHamiltonianSystem, x: Tensor, guess: Tensor, u: Tensor, h: float) -> _Root:
    """Damped Newton for all members of a batch at once, each with its own damping."""
    z = guess.clone()
    residual = step_residual(system, x, z, u, h)
    if not bool(torch.isfinite(residual).all()):
        return _Root(z, f"the vector field is not finite ({_names(system, ~torch.isfinite(residual))})")
    for _ in range(_ITERATIONS):
        jacobian = jacobians(system, x, z, u, h)[0]
        scale = _scale(system, x, z, u, h, jacobian)
        size = (residual.abs() / scale).amax(-1)
        if bool((size <= _TOLERANCE).all()):
            break
        step, info = torch.linalg.solve_ex(jacobian, -residual.unsqueeze(-1))
        if bool((info > 0).any()):
            return _Root(z, "the step's Jacobian is singular")
        moved, residual_next = _line_search(system, x, z, step.squeeze(-1), residual, scale, u, h)
        if bool((moved == z).all()):
            break
        z, residual = moved, residual_next
        # Judged by the scale at hand: the next Jacobian would only be needed for another step.
        if bool((residual.abs() <= _TOLERANCE * scale).all()):
            break
    relative = residual.abs() / scale
    if bool((relative > _ACCEPTED).any()):
        return _Root(z, f"Newton's iteration stopped at a residual of {float(relative.max()):.1e} "
                     f"({_names(system, relative > _ACCEPTED)})")  # fmt: skip
    if not (_has_one_root(system) or _is_connected(system, x, guess, z, u, h)):
        return _Root(z, "the solution is not connected to the previous state (a law falls too steeply for this step)")
    return _Root(z)


def _has_one_root(system: PortHamiltonianSystem) -> bool:
    """Convex energies and monotone resistors: then every step, however long, has exactly one solution."""
    convex = (
        STORAGE_LAWS[s.law].convex if isinstance(s.law, str) else getattr(s.law, "convex", False)
        for s in system.network.storages
    )
    monotone = (
        RESISTOR_LAWS[r.law].monotone if isinstance(r.law, str) else getattr(r.law, "monotone", False)
        for r in system.network.resistors
    )
    network = system.network
    # A memory is known before the step.
    reads = {r.modulated_by for r in network.resistors} | {m.by for m in network.modulations}
    return not reads & set(network.storage_names) and all(convex) and all(monotone)


def _is_connected(system: PortHamiltonianSystem, x: Tensor, guess: Tensor, z: Tensor, u: Tensor, h: float) -> bool:
    """Whether the residual is monotone along the way from the guess to the solution.

    Its determinant is one at ``h = 0`` and negative on the branch between two folds. Where it stays positive
    on the way, exactly one root lies there for every shorter step too (proved in one dimension, and sampled).
    """
    way = torch.linspace(0.0, 1.0, _SAMPLES, dtype=x.dtype, device=x.device).reshape(-1, *[1] * x.ndim)
    points = guess + way * (z - guess)
    jacobian = jacobians(system, x.expand_as(points), points, u.expand(*points.shape[:-1], u.shape[-1]), h)[0]
    return bool((torch.linalg.det(jacobian) > 0.0).all())


def _line_search(
    system: PortHamiltonianSystem, x: Tensor, z: Tensor, d: Tensor, residual: Tensor, scale: Tensor, u: Tensor, h: float
) -> tuple[Tensor, Tensor]:
    """Halve the Newton step ``d`` of every member until its residual falls; those that never do stay where they are."""
    before = torch.linalg.vector_norm(residual / scale, dim=-1)
    damping = torch.ones_like(before)
    best, best_residual = z, residual
    waiting = torch.ones_like(before, dtype=torch.bool)
    for _ in range(_HALVINGS):
        trial = z + damping.unsqueeze(-1) * d
        found = step_residual(system, x, trial, u, h)
        after = torch.linalg.vector_norm(found / scale, dim=-1)
        good = waiting & (after < (1.0 - 1e-4 * damping) * before)
        best = torch.where(good.unsqueeze(-1), trial, best)
        best_residual = torch.where(good.unsqueeze(-1), found, best_residual)
        waiting = waiting & ~good & (before > 0.0)
        if not bool(waiting.any()):
            break
        damping = torch.where(waiting, 0.5 * damping, damping)
    return best, best_residual


def _scale(system: PortHamiltonianSystem, x: Tensor, z: Tensor, u: Tensor, h: float, jacobian: Tensor) -> Tensor:
    """(..., n) size of the terms that cancel in every row of the residual, and of what rounding ``x⁺`` does to it."""
    efforts = system.mean_efforts(x, z)
    middle = memory.between(system, x, z)
    branches, inputs = system.incidences(middle)
    flows = combined(system.branch_flows(combined(efforts, branches), middle).abs(), branches.abs().mT)
    forces = combined(system.actions(u).abs(), inputs.abs().mT)
    conserved = (system.structure(middle).abs() @ efforts.abs().unsqueeze(-1)).squeeze(-1)
    rounding = (jacobian.abs() @ z.abs().unsqueeze(-1)).squeeze(-1)
    total = x.abs() + rounding
    first = efforts.shape[-1]
    total = torch.cat([total[..., :first] + h * (conserved + flows + forces), total[..., first:]], dim=-1)
    return torch.where(total > 0.0, total, 1.0)


def jacobians(
    system: PortHamiltonianSystem, x: Tensor, z: Tensor, u: Tensor, h: float | Tensor
) -> tuple[Tensor, Tensor]:
    """(..., n, n) derivatives of the residual by the end and by the start of the step, row by row.

    Members of a batch do not see each other, so that one backward pass gives one row for all of them.
    """
    with torch.enable_grad():
        end, start = z.detach().requires_grad_(True), x.detach().requires_grad_(True)
        residual = step_residual(system, start, end, u, h)
        rows = [
            torch.autograd.grad(residual[..., i].sum(), (end, start), retain_graph=True)
            for i in range(residual.shape[-1])
        ]
    return torch.stack([r[0] for r in rows], dim=-2), torch.stack([r[1] for r in rows], dim=-2)


def _names(system: PortHamiltonianSystem, bad: Tensor) -> str:
    """Names of the states that a mask (..., n) marks anywhere."""
    marked = bad.reshape(-1, bad.shape[-1]).any(0).tolist()
    return ", ".join(name for name, flag in zip(system.state_names, marked, strict=True) if flag)
