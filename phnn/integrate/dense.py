"""The steps of any port-Hamiltonian system solved in torch, differentiable, under every `phnn.integrate.scheme.Scheme`.

Every scheme uses the coordinate-wise discrete gradient ``ē``. Modulating variables are taken at mid-step, modulator
states at the start of the step. Then ``H(x⁺) − H(x) = h (Σ ψ(ū) gᵀē − Σ ε̄_r φ_r(ε̄_r))`` for every step size, and the
simulation is passive too. Reducible storages take the mean efforts of their own rule. The steps are those of the
compiled integration.

Each step is solved by a damped Newton iteration with the dense Jacobian. Gradients follow from the implicit function
theorem: one vectorised evaluation of all residuals and one backward sweep over the stored states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from phnn.errors import SolverFailed, StructureViolated
from phnn.integrate.compilable import partly_driven
from phnn.integrate.equations import jacobians, powers_of_steps, reducible_rules, sizes, step_residual
from phnn.integrate.inputs import check, port_inputs
from phnn.integrate.scheme import Scheme
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.wide import form_of
from phnn.network.checks import PowerBalance
from phnn.network.system import PortHamiltonianSystem

# Residuals are measured in units of the largest terms of their own equation.
_TOLERANCE = 1e-13
_ACCEPTED = 1e-11
_ITERATIONS = 40
_HALVINGS = 25
_SMALLEST_PART = 2.0**-10
_SAMPLES = 9


def solve_dense(
    system: PortHamiltonianSystem,
    x0: Tensor,  # (..., n) initial state
    u_mean: Tensor,  # (N, ..., P) mean input of every step, or (N,) for the first port with the others at zero
    h: float,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> Tensor:
    """Integrate ``N`` power-preserving steps.

    Args:
        system: any system, neural laws included.
        h: step [s].
        scheme: the discretisation.

    Returns:
        (N+1, ..., n) states, differentiable by ``x0``, ``u_mean`` and the system's parameters.

    Raises:
        InputRefused: not float64, not finite, a shape that does not fit, or a step that is not positive.
        SolverFailed: a step has no solution connected to its start; names time, state and remedy.
        StructureViolated: the scheme cannot compute the drive of a modulator state; names both.
    """
    u = port_inputs(system, u_mean, x0.ndim - 1)
    check(system, x0, u, h)
    return with_derivatives(system, march(system, x0, u, [h] * u.shape[0], scheme), x0, u, h, scheme)


def march(
    system: PortHamiltonianSystem,
    x0: Tensor,  # (..., n)
    u: Tensor,  # (N, ..., P)
    h: list[float],
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
    start: float = 0.0,
) -> Tensor:
    """(N+1, ..., n) states, without gradients, of steps that need not be equal; messages count time from ``start``.

    Raises:
        SolverFailed, StructureViolated: as of `solve_dense`.
    """
    refuse_unknown_drives(system, scheme)
    with torch.no_grad():
        states, t = [x0.detach()], start
        for u_step, h_step in zip(u, h, strict=True):
            states.append(_step(_Step(system, states[-1], u_step, h_step, scheme), t))
            t += h_step
        return torch.stack(states)


def refuse_unknown_drives(system: PortHamiltonianSystem, scheme: Scheme) -> None:
    """Refuse a modulator state whose drive the scheme cannot compute."""
    names = [system.state_names[k] for k in reducible_rules(system, scheme)]
    if reason := partly_driven(system.network, names):
        raise StructureViolated(f"{scheme}: {reason}")


def with_derivatives(
    system: PortHamiltonianSystem,
    path: Tensor,  # (N+1, ..., n)
    x0: Tensor,  # (..., n)
    u: Tensor,  # (N, ..., P)
    h: float | Tensor,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> Tensor:
    """The integrated ``path`` as a differentiable function of ``x0``, ``u``, the parameters and a tensor ``h``."""
    if not torch.is_grad_enabled() or u.shape[0] == 0:
        return path
    residual = step_residual(system, path[:-1], path[1:], u, h, scheme)
    if not (residual.requires_grad or x0.requires_grad):
        return path
    by_next, by_start = jacobians(system, path[:-1], path[1:], u.detach(), h, scheme)
    return _Implicit.apply(path, by_next, by_start, residual, x0)


def ledger(
    system: PortHamiltonianSystem,
    states: Tensor,  # (N+1, ..., n) as returned by `solve_dense`
    u_mean: Tensor,  # (N, ..., P) or (N,)
    h: float,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> PowerBalance:
    """Mean powers of every step (N, ...) at the mean efforts of the step, which balance the energy exactly; nodal
    efforts do not."""
    return powers_of_steps(system, scheme, states, port_inputs(system, u_mean, states.ndim - 2), h)


class _Implicit(torch.autograd.Function):
    """The stored path, with the derivatives of the path that solves the recursion.

    ``R_n(x_n, x_{n+1}; θ) = 0`` gives ``δx_{n+1} = −A_n⁻¹ (δR_n + B_n δx_n)``. This system is block-bidiagonal; the
    backward pass sweeps its transpose. The residual carries the graph to all parameters and inputs.
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


@dataclass(frozen=True)
class _Root:
    """The end state of a step, or the reason ``cause`` why there is none; ``cause`` is empty on success."""

    x: Tensor
    cause: str = ""


class _Step(NamedTuple):
    """A step from ``x`` (..., n) under ``u`` (..., P) of size ``h`` [s]."""

    system: PortHamiltonianSystem
    x: Tensor
    u: Tensor
    h: float
    scheme: Scheme

    def part(self, share: float) -> _Step:
        """A shorter step from the same state."""
        return self._replace(h=share * self.h)

    def residual(self, z: Tensor) -> Tensor:
        """(..., n) residual of an end state."""
        return step_residual(self.system, self.x, z, self.u, self.h, self.scheme)

    def jacobian(self, z: Tensor) -> Tensor:
        """(..., n, n) derivative of the residual by the end state."""
        return jacobians(self.system, self.x, z, self.u, self.h, self.scheme)[0]

    def sizes(self, z: Tensor, jacobian: Tensor) -> Tensor:
        """(..., n) size of the terms of the residual."""
        return sizes(self.system, self.scheme, self.x, z, self.u, self.h, jacobian)


def _step(step: _Step, t: float) -> Tensor:
    """The end of one step: Newton from its start and, where that fails, along growing parts of the step."""
    # Starting from x, not from an extrapolation, keeps the root that is connected with the previous state.
    root = _newton(step, step.x)
    if root.cause:
        # Whole steps pass kinks at which a line search stops.
        root = _newton(step, step.x, damped=False)
    if not root.cause:
        return root.x
    done, part, guess = 0.0, 0.25, step.x
    while done < 1.0:
        part = min(part, 1.0 - done)
        root = _newton(step.part(done + part), guess)
        if not root.cause:
            done, guess, part = done + part, root.x, 2.0 * part
        elif part > _SMALLEST_PART:
            part *= 0.5
        else:
            raise SolverFailed(
                f"the step from t = {t:.6g} s to {t + step.h:.6g} s has no solution: {root.cause}, at "
                f"{done:.3f} of the step; take a step below {max(done, _SMALLEST_PART) * step.h:.2g} s, or laws that "
                "are monotone (MonotoneMLP) and convex (ConvexEnergyMLP)"
            )
    return guess


def _newton(step: _Step, guess: Tensor, damped: bool = True) -> _Root:
    """Newton's method for all members of a batch at once, each with its own damping, or with whole steps."""
    system, z = step.system, guess.clone()
    residual = step.residual(z)
    if not bool(torch.isfinite(residual).all()):
        return _Root(z, f"the vector field is not finite ({_names(system, ~torch.isfinite(residual))})")
    for _ in range(_ITERATIONS):
        jacobian = step.jacobian(z)
        scale = step.sizes(z, jacobian)
        size = (residual.abs() / scale).amax(-1)
        if bool((size <= _TOLERANCE).all()):
            break
        moved, info = torch.linalg.solve_ex(jacobian, -residual.unsqueeze(-1))
        if bool((info > 0).any()):
            return _Root(z, "the step's Jacobian is singular")
        if damped:
            following, residual_next = _line_search(step, z, moved.squeeze(-1), residual, scale)
        else:
            following = z + moved.squeeze(-1)
            residual_next = step.residual(following)
        if bool((following == z).all()):
            break
        z, residual = following, residual_next
        # The current scale decides: a new Jacobian would only be needed for another step.
        if bool((residual.abs() <= _TOLERANCE * scale).all()):
            break
    relative = residual.abs() / scale
    # The comparison also fails for NaN.
    if bool((bad := ~(relative <= _ACCEPTED)).any()):
        return _Root(z, f"Newton's iteration stopped at a residual of {float(relative.max()):.1e} "
                     f"({_names(system, bad)})")  # fmt: skip
    if not (_has_one_root(system) or _is_connected(step, guess, z)):
        return _Root(z, "the solution is not connected to the previous state (a law falls too steeply for this step)")
    return _Root(z)


def _has_one_root(system: PortHamiltonianSystem) -> bool:
    """Whether all energies are convex and all resistors monotone: every step then has exactly one solution."""
    convex = (
        STORAGE_LAWS[s.law].convex if isinstance(s.law, str) else bool(form_of(s.law)) and s.law.convex
        for s in system.network.storages
    )
    monotone = (
        RESISTOR_LAWS[r.law].monotone if isinstance(r.law, str) else bool(form_of(r.law)) and r.law.monotone
        for r in system.network.resistors
    )
    network = system.network
    # Modulator states are known before the step.
    reads = {r.modulated_by for r in network.resistors} | {m.by for m in network.modulations}
    return not reads & set(network.storage_names) and all(convex) and all(monotone)


def _is_connected(step: _Step, guess: Tensor, z: Tensor) -> bool:
    """Whether the Jacobian's determinant stays positive along the way from the guess to the solution.

    The determinant is one at ``h = 0`` and negative on the branch between two folds. If it stays positive on the way,
    exactly one root lies there for every shorter step too (proved in one dimension, sampled in others).
    """
    x, u = step.x, step.u
    way = torch.linspace(0.0, 1.0, _SAMPLES, dtype=x.dtype, device=x.device).reshape(-1, *[1] * x.ndim)
    points = guess + way * (z - guess)
    expanded = step._replace(x=x.expand_as(points), u=u.expand(*points.shape[:-1], u.shape[-1]))
    return bool((torch.linalg.det(expanded.jacobian(points)) > 0.0).all())


def _line_search(step: _Step, z: Tensor, d: Tensor, residual: Tensor, scale: Tensor) -> tuple[Tensor, Tensor]:
    """Halve the Newton step ``d`` of every member until its residual falls; members whose residual never falls do not
    move."""
    before = torch.linalg.vector_norm(residual / scale, dim=-1)
    damping = torch.ones_like(before)
    best, best_residual = z, residual
    waiting = torch.ones_like(before, dtype=torch.bool)
    for _ in range(_HALVINGS):
        trial = z + damping.unsqueeze(-1) * d
        found = step.residual(trial)
        after = torch.linalg.vector_norm(found / scale, dim=-1)
        good = waiting & (after < (1.0 - 1e-4 * damping) * before)
        best = torch.where(good.unsqueeze(-1), trial, best)
        best_residual = torch.where(good.unsqueeze(-1), found, best_residual)
        waiting = waiting & ~good & (before > 0.0)
        if not bool(waiting.any()):
            break
        damping = torch.where(waiting, 0.5 * damping, damping)
    return best, best_residual


def _names(system: PortHamiltonianSystem, bad: Tensor) -> str:
    """Names of the states that a mask (..., n) marks anywhere."""
    marked = bad.reshape(-1, bad.shape[-1]).any(0).tolist()
    return ", ".join(name for name, flag in zip(system.state_names, marked, strict=True) if flag)
