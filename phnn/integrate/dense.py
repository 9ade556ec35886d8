"""The steps of any network solved in torch, differentiable, under every `phnn.integrate.scheme.Scheme`.

Every scheme uses the coordinate-wise discrete gradient ``ē``. Modulating variables are taken at mid-step, modulator
states at the start of the step. Then ``H(x⁺) − H(x) = h (Σ ψ(ū) gᵀē − Σ ε̄_r φ_r(ε̄_r))`` for every step size, and the
simulation is passive too. Reducible storages take the mean efforts of their own rule. The steps are those of the
compiled integration.

Many steps are solved at once, of all members of a batch. The residuals ``R_k(x_k, x_{k+1})`` of a stretch and their
Jacobians ``A_k = ∂R_k/∂x_{k+1}``, ``B_k = ∂R_k/∂x_k`` are evaluated together, and Newton's step is the recursion

    A_k δ_{k+1} = −R_k − B_k δ_k,     δ_0 = 0,

so that no python loop runs over the samples (Lim et al. 2024, "Parallelizing non-linear sequential models over the
sequence length"). Where it does not converge a stretch is shortened, down to one step and then to growing parts of it.
The multipliers of the implicit function theorem, ``δx_{k+1} = −A_k⁻¹ (δR_k + B_k δx_k)``, are the same recursion
backwards, transposed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import prod
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import SolverFailed, StructureViolated
from phnn.integrate.compilable import partly_driven
from phnn.integrate.equations import linearised, means, reducible_rules, step_residual
from phnn.integrate.scheme import Scheme
from phnn.integrate.steady import steady_state
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.wide import has_kernel, is_passive_by_form
from phnn.network.checks import evaluation
from phnn.network.elements import Network
from phnn.network.system import PortHamiltonianSystem

Array = NDArray[np.float64]

# Residuals are measured in units of the terms of their own equation: rounding, and what is accepted where the
# iteration stops; in units of the numbers' precision.
_ROUNDING, _ACCEPTED = 450.0, 45000.0
_ITERATIONS, _POLISHES = 25, 3
_KEPT = 0.1  # share by which a residual has to fall for a Jacobian to be kept
_FIRST, _MOST = 32, 512  # steps of the first stretch, and of the longest
_AT_ONCE = 1 << 11  # steps of all members of a batch, whose derivatives by all weights are held in memory together
_TOGETHER = 1 << 14  # steps of all members of a batch together, of a stretch that begins near its solution
_FEWEST = 8  # steps at the head of a stretch that are kept where the others were not solved
_CYCLES, _CLOSED, _NEUTRAL = 30, 1e-9, 1e-9  # of a steady cycle: iterations, relative change at its end, rank
_SMALLEST_PART = 2.0**-10
# Shares of a step at which slopes of laws, and the sign of the Jacobian's determinant, are looked at.
_ALONG = 9


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


def integrated(
    network: Network, x0: Array | None, u: Array, h: Array, cycle: int, held: Array, scheme: Scheme, start: float
) -> tuple[Array, Array]:
    """Return the states (N+1, n) and mean efforts (N, n) of a network under mean inputs (N, P), as arrays.

    Args:
        x0: (n,) initial state; None: the steady one under the inputs ``held`` (P,) or, where the first ``cycle`` steps
            are a period, that of the steady cycle.
        start: time of the first state, for messages.

    Raises:
        SolverFailed: as of `Dense.solve`; or there is no steady state or cycle.
    """
    system, inputs, steps = PortHamiltonianSystem(network), torch.from_numpy(u), torch.from_numpy(h).unsqueeze(-1)
    x = torch.from_numpy(steady_state(network, held) if x0 is None else np.asarray(x0, dtype=float))
    for _ in range(_CYCLES if cycle and x0 is None else 0):
        states = march(system, x, inputs[:cycle], steps[:cycle], scheme, start)
        _, by_next, by_start = linearised(system, states[:-1], states[1:], inputs[:cycle], steps[:cycle], scheme)
        period = torch.eye(len(x)).to(x)
        for carry in -torch.linalg.solve(by_next, by_start):
            period = carry @ period
        # What no cycle changes keeps its value.
        moved = torch.linalg.pinv(torch.eye(len(x)).to(x) - period, rtol=_NEUTRAL) @ (states[-1] - x)
        x = x + moved
        if bool((moved.abs() <= _CLOSED * states.abs().amax(0)).all()):
            break
    else:
        if cycle and x0 is None:
            raise SolverFailed("no steady cycle was found: begin the recording at rest, or state its start as unknown")
    states = march(system, x, inputs, steps, scheme, start)
    with torch.no_grad():
        efforts = means(system, scheme, states[:-1], states[1:], inputs, steps).efforts
    return states.numpy(), efforts.numpy()


def by_start(network: Network, states: Array, u: Array, h: Array, nodes: NDArray[np.int64], row: int) -> Array:
    """(K, n) derivatives of one state at nodes of a trajectory by its initial state; arguments as of `integrated`."""
    steps = Dense(PortHamiltonianSystem(network).requires_grad_(False))
    x, inputs, sizes = (torch.from_numpy(np.ascontiguousarray(v)).unsqueeze(1) for v in (states, u, h[:, None]))
    return sensitivities(steps, x, inputs, sizes, [torch.from_numpy(nodes)], row)[0].numpy()


class Dense(nn.Module):
    """The steps of a system in torch. Called with states at their starts and ends it returns their residuals.

    Args:
        near: states from which the iteration begins, (N+1, ..., n).
    """

    def __init__(
        self,
        system: PortHamiltonianSystem,
        scheme: Scheme = Scheme.DISCRETE_GRADIENT,
        near: Tensor | None = None,
    ) -> None:
        super().__init__()
        self.system, self.scheme, self.near = system, scheme, near

    def solve(self, x0: Tensor, u: Tensor, h: Tensor, start: float) -> tuple[Tensor, Tensor]:
        """(N+1, ..., n) states, and an empty tensor (N, ..., 0) in the place of mean efforts."""
        states = march(self.system, x0, u, h, self.scheme, start, self.near)
        return states, states[1:, ..., :0]

    @staticmethod
    def weights(residual: Tensor, given: Sequence[Tensor], wanted: Tensor, carry: Tensor) -> tuple[Tensor, Tensor]:
        """Return ``−μ`` (N, ..., n) of some steps, and (..., n) ``∂L/∂x`` at their start, without that state's own.

        Args:
            residual, given: what a call has returned for the steps.
            wanted: (N, ..., n) ``∂L/∂x`` at the ends of the steps.
            carry: (..., n) what later steps add to the last of them.
        """
        by_next, by_start = given
        inverse = torch.linalg.inv(by_next).mT
        back = by_start.mT @ inverse
        # λ_k = w_k − (Bᵀ A⁻ᵀ)_{k+1} λ_{k+1}, from the end.
        wanted = torch.cat([wanted[:-1], (wanted[-1] + carry).unsqueeze(0)])
        totals = recursion(-back.flip(0).roll(1, 0), wanted.flip(0)).flip(0)
        return -_times(inverse, totals), -_times(back[0], totals[0])

    def forward(
        self, x: Tensor, ends: Tensor, none: Tensor, u: Tensor, h: Tensor, linearise: bool = True
    ) -> tuple[Tensor, ...]:
        """(N, ..., n) residuals of the steps, with their derivatives by ``ends`` and ``x`` unless these are not asked
        for."""
        if not linearise:
            return (step_residual(self.system, x, ends, u, h, self.scheme),)
        return linearised(self.system, x, ends, u, h, self.scheme)


def recursion(m: Tensor, r: Tensor) -> Tensor:
    """(N, ..., n) solution of ``x_k = r_k + m_k x_{k−1}`` with ``x_{−1} = 0``, by cyclic reduction.

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
    """(..., n) product."""
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


@torch.no_grad()
def sensitivities(
    steps: Dense, states: Tensor, u: Tensor, h: Tensor, nodes: Sequence[Tensor], row: int
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
    weights = {name: p.detach() for name, p in steps.named_parameters() if p.requires_grad}
    by = torch.eye(n).to(states).expand(members, n, n)
    by = torch.cat([by.new_zeros(members, n, sum(p.numel() for p in weights.values())), by], dim=-1)
    found = [by.new_empty(len(k), by.shape[-1]) for k in nodes]
    each = [dict(zip(k.tolist(), range(len(k)), strict=True)) for k in nodes]

    def keep(node: int) -> None:
        for b, place in enumerate(each):
            if node in place:
                found[b][place[node]] = by[b, row]

    keep(0)
    length = max(1, _AT_ONCE // members)
    for first in range(0, len(h), length):
        part = slice(first, first + length)
        x, ends = states[:-1][part], states[1:][part]
        _, by_next, by_start = linearised(steps.system, x, ends, u[part], h[part], steps.scheme)
        own = _by_weights(steps, weights, x, ends, u[part], h[part]) if weights else by_start[..., :0]
        inverse = -torch.linalg.inv(by_next)
        carry, own = inverse @ by_start, inverse @ own
        for k in range(len(x)):
            by = torch.cat([torch.baddbmm(own[k], carry[k], by[..., :-n]), carry[k] @ by[..., -n:]], dim=-1)
            keep(first + k + 1)
    return found


def _by_weights(steps: Dense, weights: Mapping[str, Tensor], x: Tensor, ends: Tensor, u: Tensor, h: Tensor) -> Tensor:
    """(N, B, n, W) derivatives of the residuals of single steps."""

    def residual(given: dict[str, Tensor], *step: Tensor) -> Tensor:
        return torch.func.functional_call(steps, given, (*step[:2], step[0][:0], *step[2:], False), tie_weights=False)[
            0
        ]

    flat = [v.expand(*x.shape[:-1], v.shape[-1]).flatten(0, 1) for v in (x, ends, u, h)]
    found = torch.func.vmap(torch.func.jacrev(residual), (None, 0, 0, 0, 0))(dict(weights), *flat)
    return torch.cat([v.reshape(*v.shape[:2], -1) for v in found.values()], dim=-1).unflatten(0, x.shape[:-1])


@torch.no_grad()
def first_order(
    steps: Dense, states: Tensor, u: Tensor, h: Tensor, moved: Mapping[str, Tensor], start: Tensor
) -> Tensor:
    """(N+1, ..., n) changes of the states by small changes of weights and of the initial state (..., n)."""
    weights = {name: p.detach() for name, p in steps.named_parameters() if name in moved}
    x, ends = states[:-1], states[1:]

    def residual(given: dict[str, Tensor]) -> Tensor:
        return torch.func.functional_call(steps, given, (x, ends, x[:0], u, h, False), tie_weights=False)[0]

    change = torch.func.jvp(residual, (weights,), ({name: moved[name] for name in weights},))[1]
    _, by_next, by_start = linearised(steps.system, x, ends, u, h, steps.scheme)
    change[0] += _times(by_start[0], start)
    inverse = -torch.linalg.inv(by_next)
    return torch.cat([start.unsqueeze(0), recursion(inverse @ by_start, _times(inverse, change))])


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

    def first(self, steps: int) -> _Run:
        """The first steps of the stretch."""
        return self._replace(u=self.u[:steps], h=self.h[:steps])

    def starts(self, z: Tensor) -> Tensor:
        """(N, ..., n) states at the starts of steps that end at ``z``."""
        return torch.cat([self.x.unsqueeze(0), z[:-1]])


def _by_parts(run: _Run, t: float) -> Tensor:
    """(1, ..., n) end of one step, found along growing parts of it."""
    done, part, guess = 0.0, 0.25, run.x.unsqueeze(0)
    while done < 1.0:
        part = min(part, 1.0 - done)
        root = _newton(run._replace(h=(done + part) * run.h), guess)
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


def _newton(run: _Run, z: Tensor) -> _Root:
    """Newton's method for all steps of a stretch and all members of a batch at once."""
    system, precision = run.system, torch.finfo(z.dtype).eps
    worst = torch.inf
    for _ in range(_ITERATIONS):
        x = run.starts(z)
        residual, by_next, by_start = linearised(system, x, z, run.u, run.h, run.scheme)
        residual = residual.detach()
        if not bool(torch.isfinite(residual).all()):
            return _Root(z, f"the vector field is not finite ({_names(system, ~torch.isfinite(residual))})")
        scale = _sizes(by_next, z) + _sizes(by_start, x) + torch.finfo(z.dtype).tiny
        worst = float((residual.abs() / scale).max())
        if worst <= _ROUNDING * precision:
            break
        columns, info = torch.linalg.solve_ex(by_next, torch.cat([residual.unsqueeze(-1), by_start], dim=-1))
        if bool((info > 0).any()):
            return _Root(z, "the step's Jacobian is singular")
        moved, carry = -columns[..., 0], -columns[..., 1:]
        following = z + recursion(carry, moved)
        if bool((following == z).all()):
            break
        z = following
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
        if solved and not _is_sure(run.first(solved), z[:solved]):
            solved = 0
        return _Root(z, f"Newton's iteration stopped at a residual of {worst:.1e} ({_names(system, bad)})", solved)
    if not _is_sure(run, z):
        return _Root(z, "the solution is not connected to the previous state (a law falls too steeply for this step)")
    return _Root(z)


def _is_sure(run: _Run, z: Tensor) -> bool:
    """Whether the steps have one solution each, or theirs are connected to their starts."""
    return _has_one_root(run, z) or _is_connected(run, z)


def _sizes(matrix: Tensor, state: Tensor) -> Tensor:
    """(..., n) size of the terms of a linear form, and so of the effect of rounding the state."""
    return (matrix.abs() @ state.abs().unsqueeze(-1)).squeeze(-1)


def _has_one_root(run: _Run, z: Tensor) -> bool:
    """Whether all efforts and flows rise along the steps, which then have exactly one solution each: by the laws'
    forms, or where these say nothing, at points between start and end."""
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
    """(9, ...) points on the way from ``a`` to ``b``."""
    way = torch.linspace(0.0, 1.0, _ALONG, dtype=a.dtype, device=a.device)
    return a + way.reshape(-1, *[1] * a.ndim) * (b - a)


def _rises(law: Callable[[Tensor], Tensor], a: Tensor, b: Tensor) -> bool:
    """Whether a law's slope is positive or zero at points between ``a`` and ``b``."""
    with torch.enable_grad():
        at = _between(a, b).requires_grad_(True)
        (slope,) = torch.autograd.grad(law(at).sum(), at)
    return bool((slope >= 0.0).all())


def _is_connected(run: _Run, z: Tensor) -> bool:
    """Whether the Jacobian's determinant stays positive along the way from the start of every step to its end.

    The determinant is one at ``h = 0`` and negative on the branch between two folds. If it stays positive on the way,
    exactly one root lies there for every shorter step too (proved in one dimension, sampled in others).
    """
    x = run.starts(z)
    points, u = _between(x, z), run.u.expand(_ALONG, *run.u.shape)
    by_next = linearised(run.system, x.expand_as(points), points, u, run.h, run.scheme)[1]
    return bool((torch.linalg.det(by_next) > 0.0).all())


def _names(system: PortHamiltonianSystem, bad: Tensor) -> str:
    """Names of the states that a mask (..., n) marks anywhere."""
    marked = bad.reshape(-1, bad.shape[-1]).any(0).tolist()
    return ", ".join(name for name, flag in zip(system.state_names, marked, strict=True) if flag)
