"""The power-preserving step as a method of torchdiffeq, which is its own adjoint and exact at any step.

    system = phnn.PortHamiltonianSystem(network)      # makes the method known to torchdiffeq
    x = torchdiffeq.odeint(system.with_input(u), x0, t, method="phnn")
    x = torchdiffeq.odeint_adjoint(system.with_input(u), x0, t, method="phnn", options={"step_size": h})

``driven`` is a `PortHamiltonianSystem` (inputs at zero) or its ``with_input(u)``, ``x0`` is (..., n). Every interval
between two outputs is divided into the fewest equal steps of at most ``step_size`` [s]; without ``step_size`` it is one
step. Outputs are ends of steps and never interpolated, so that the power balance holds between them too. The input of a
step is its mean by two-point Gauss–Legendre quadrature, exact for cubic ``u(t)``. The nodes lie inside the step, so
that ``u`` may jump where steps meet. Tolerances have no meaning here and are ignored.

A step solves ``R_k(x_k, x_{k+1}; θ) = 0`` (see `phnn.integrate.equations`), by default with
``Scheme.DISCRETE_GRADIENT``; the option ``scheme`` selects another one. Compiled code takes the steps where all laws
have a kernel. Gradients are those of the computed states,

    λ_k = ∂L/∂x_k − (∂R_k/∂x_k)ᵀ μ_k,     (∂R_k/∂x_{k+1})ᵀ μ_k = λ_{k+1},     dL/dθ = −Σ_k (∂R_k/∂θ)ᵀ μ_k

by ``x0`` and the parameters of the system, its laws and its input; with `odeint` also by ``t``, for a fixed number of
steps. `odeint_adjoint` keeps the states, goes back over the same steps, and then drops them; torchdiffeq calls it once
for every interval, a third of a millisecond each. `odeint` gives the same gradients in one sweep. A second pass over a
retained graph integrates again.

Other adjoint methods of torchdiffeq are refused: with steps of their own they are wrong where outputs are far apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from phnn.errors import InputRefused
from phnn.integrate import hooks
from phnn.integrate.dense import recursion, shaped, transposed
from phnn.integrate.differentiable import simulated
from phnn.integrate.equations import linearised, step_residual
from phnn.integrate.inputs import port_inputs
from phnn.integrate.scheme import Scheme
from phnn.network.driven import DrivenSystem
from phnn.network.system import PortHamiltonianSystem

METHOD = "phnn"

# Nodes of the two-point rule as shares of a step.
_EARLY, _LATE = 0.5 - 3.0**-0.5 / 2.0, 0.5 + 3.0**-0.5 / 2.0
# Tolerance, so that rounding does not add a step to an interval that is a whole number of steps.
_ROUNDING = 1e-9
# Steps whose graph the adjoint holds at a time.
_BLOCK = 4096


class _Solve:
    """The steps of one solve, the states at their ends, and derivatives by initial state and parameters.

    Raises:
        InputRefused: times that are not finite float64, fewer than two, or a ``step_size`` that is not positive.
    """

    def __init__(
        self,
        driven: DrivenSystem | PortHamiltonianSystem,
        x0: Tensor,  # (..., n)
        t: Tensor,  # (K,) output times, increasing
        step_size: float | None,
        scheme: Scheme,
    ) -> None:
        if t.dtype != torch.float64 or t.shape[0] < 2 or not bool(torch.isfinite(t).all()):
            raise InputRefused(
                f"{t.shape[0]} output times of {t.dtype}: give at least two, all finite, converted with .double()"
            )
        if step_size is not None and not 0.0 < step_size < float("inf"):
            raise InputRefused(f"step_size = {step_size:g} s: give a positive, finite step")
        self.driven, self.x0, self.scheme = driven, x0, scheme
        self.system = driven.system if isinstance(driven, DrivenSystem) else driven
        spacing = t.diff()
        least = torch.ones_like(spacing) if step_size is None else spacing.detach() / step_size * (1.0 - _ROUNDING)
        counts = least.ceil().clamp_min(1.0).long()
        self.output_at = [0, *counts.cumsum(0).tolist()]
        self.interval = {time: i for i, time in enumerate(t.tolist()[1:])}
        first = torch.tensor(self.output_at[:-1], device=t.device).repeat_interleave(counts)
        self.h = (spacing / counts).repeat_interleave(counts)
        self.start = t[:-1].repeat_interleave(counts) + (torch.arange(len(first), device=t.device) - first) * self.h
        self.path: Tensor | None = None
        self.transposed: tuple[Tensor, ...] = ()

    def inputs(self, steps: slice = slice(None)) -> Tensor:
        """(N, ..., P) mean inputs of some of the steps."""
        start, h = self.start[steps], self.h[steps]
        if isinstance(self.driven, DrivenSystem):
            u = 0.5 * (self._input(start + _EARLY * h) + self._input(start + _LATE * h))
        else:
            u = self.x0.new_zeros(len(h), len(self.system.network.ports))
        return port_inputs(self.system, u, self.x0.ndim - 1)

    def _input(self, t: Tensor) -> Tensor:
        """(N, ..., P) inputs at many times (N,), one after the other where the function cannot take all of them."""
        given: Any = self.driven.input
        if hasattr(given, "at_times"):
            return torch.as_tensor(given.at_times(t))
        try:
            return torch.as_tensor(torch.func.vmap(given)(t))
        except (RuntimeError, ValueError):
            return torch.stack([given(time) for time in t])

    def differentiable(self) -> Tensor:
        """(K, ..., n) states at the output times, with the graph of all steps."""
        return self._states()[self.output_at]

    def recorded(self) -> Tensor:
        """(K, ..., n) states at the output times; those of all steps are kept for `pull_back`."""
        self.path = self.march()
        return self.path[self.output_at]

    def march(self) -> Tensor:
        """(N+1, ..., n) states without gradients."""
        with torch.no_grad():
            return self._states()

    def _states(self) -> Tensor:
        start = float(self.start[0].detach())
        return simulated(self.system, self.x0, self.inputs(), self.h, self.scheme, start)

    def pull_back(self, i: int, wanted: Tensor, parameters: tuple[Tensor, ...]) -> tuple[Tensor, list[Tensor]]:
        """Pull ``∂L`` by the state at the end of interval ``i`` back to its start; at the first one, the last to be
        called, also all ``μ_k`` to the parameters."""
        if self.path is None:
            self.path = self.march()
        if not self.transposed:
            self._transpose(self.path)
        inverse, carry, mu = self.transposed
        steps = slice(*self.output_at[i : i + 2])
        back = torch.cat([torch.zeros_like(carry[:1]), -carry[steps].flip(0)])
        totals = recursion(back, torch.cat([wanted.unsqueeze(0), wanted.new_zeros(len(back) - 1, *wanted.shape)]))
        mu[steps] = -(inverse[steps] @ totals[:-1].flip(0).unsqueeze(-1)).squeeze(-1)
        sums = [torch.zeros_like(p) for p in parameters]
        if i == 0:
            self._add_gradients(self.path, mu, parameters, sums)
            self.path, self.transposed = None, ()
        return totals[-1], sums

    def _transpose(self, path: Tensor) -> None:
        """Keep ``A_k⁻ᵀ``, ``B_kᵀ A_k⁻ᵀ`` and room for the ``μ_k`` of all steps."""
        found = []
        for part in self._blocks():
            _, by_next, by_start = self._equations(linearised, path, part)
            found.append(transposed(by_next, by_start))
        inverses, carries = (torch.cat(column) for column in zip(*found, strict=True))
        self.transposed = inverses, carries, torch.zeros_like(path[1:])

    def _add_gradients(self, path: Tensor, mu: Tensor, parameters: tuple[Tensor, ...], sums: list[Tensor]) -> None:
        """Add ``Σ_k (∂R_k/∂θ)ᵀ μ_k`` to the sums."""
        for part in self._blocks() if parameters else ():
            with torch.enable_grad():
                residual = self._equations(step_residual, path, part)
                if not residual.requires_grad:
                    continue
                found = torch.autograd.grad(residual, parameters, mu[part], allow_unused=True)
            for total, gradient in zip(sums, found, strict=True):
                if gradient is not None:
                    total += gradient

    def _blocks(self) -> list[slice]:
        return [slice(k, k + _BLOCK) for k in range(0, len(self.h), _BLOCK)]

    def _equations(self, of: Callable[..., Any], path: Tensor, part: slice) -> Any:
        h = shaped(self.x0, self.h[part].detach())
        return of(self.system, path[:-1][part], path[1:][part], self.inputs(part), h, self.scheme)


class PowerPreserving:
    """The solver that torchdiffeq constructs for ``method="phnn"``, forwards, and once for every interval backwards.

    Raises:
        InputRefused: the right-hand side is not a port-Hamiltonian system, the times decrease, there is an option other
            than ``step_size`` and ``scheme`` or an event function, or the adjoint is asked for gradients by ``t``.
        SolverFailed: a step has no solution; names time, state and remedy.
    """

    def __init__(
        self,
        func: Any,
        y0: Tensor,
        step_size: float | None = None,
        scheme: Scheme = Scheme.DISCRETE_GRADIENT,
        **others: Any,
    ) -> None:
        # torchdiffeq adds these three itself.
        if unknown := ", ".join(sorted(set(others) - {"rtol", "atol", "norm"})):
            raise InputRefused(f"{METHOD} has no option {unknown}: leave it out, it takes step_size and scheme")
        self.backwards: _Backwards | None = None
        if known := hooks.augmented(func):
            self.backwards = _Backwards(known, y0)
            return
        inner, self.holder = hooks.behind(func)
        if hooks.is_reversed(inner):
            raise InputRefused("the output times decrease: a dissipative system cannot be integrated backwards")
        _refuse_other_systems(inner)
        self.driven, self.y0, self.step_size = inner, y0, step_size
        self.scheme = Scheme.named(scheme) if isinstance(scheme, str) else scheme

    @staticmethod
    def valid_callbacks() -> set[str]:
        """None: all steps are found before their graph is made."""
        return set()

    def integrate(self, t: Tensor) -> Tensor:
        """(K, ..., n) states at the output times (K,), or the augmented state at both ends of an interval."""
        if self.backwards is not None:
            return self.backwards.integrate(t)
        if self.holder is None:
            return _Solve(self.driven, self.y0, t, self.step_size, self.scheme).differentiable()
        if t.requires_grad:
            raise InputRefused("odeint_adjoint offers no gradients by t here: use odeint, or t.detach()")
        self.holder.solve = _Solve(self.driven, self.y0.detach(), t, self.step_size, self.scheme)
        # From here on only a continuous adjoint evaluates the vector field.
        self.holder.register_forward_pre_hook(_refuse_other_adjoint)
        return self.holder.solve.recorded()

    def integrate_until_event(self, t0: Tensor, event_fn: Any) -> Tensor:
        """Always raise: the solver supports no events."""
        raise InputRefused(f"{METHOD} does not look for events: look for them in its states")


class _Backwards:
    """The transposed steps of an interval.

    Raises:
        InputRefused: the forward pass took another method.
    """

    def __init__(self, known: dict[str, Any], y0: Tensor) -> None:
        solve = getattr(known.get("func"), "solve", None)
        if solve is None:
            raise InputRefused(f"adjoint_method={METHOD!r} is for the steps of method={METHOD!r} alone: give both")
        self.solve: _Solve = solve
        self.parameters: tuple[Tensor, ...] = known["adjoint_params"]
        self.y0 = y0

    def integrate(self, t: Tensor) -> Tensor:
        """(2, A) the augmented state (by t, x, by x, by parameters) at the end and the start of an interval.

        torchdiffeq passes the negated time, and replaces the state by the one that the forward solve returned.
        """
        shape = self.solve.x0.shape
        size = shape.numel()
        by_t, x, by_x, by_parameters = self.y0.tensor_split([1, 1 + size, 1 + 2 * size])
        interval = self.solve.interval[-t[0].item()]
        by_start, found = self.solve.pull_back(interval, by_x.reshape(shape), self.parameters)
        more = torch.cat([f.reshape(-1) for f in found]) if found else torch.zeros_like(by_parameters)
        return torch.stack([self.y0, torch.cat([by_t, x, by_start.reshape(-1), by_parameters + more])])


_OTHER_ADJOINT = (
    f"a continuous adjoint of {METHOD} is wrong where outputs are far apart for a decay: leave adjoint_method out, or "
    "use odeint"
)


def _refuse_other_adjoint(module: Any, arguments: Any) -> None:
    raise InputRefused(_OTHER_ADJOINT)


def _refuse_other_systems(inner: Any) -> None:
    if not isinstance(inner, DrivenSystem | PortHamiltonianSystem):
        raise InputRefused(
            f"the right-hand side is a {type(inner).__name__}, which has no energy to take the discrete gradient "
            "of: give a PortHamiltonianSystem or its with_input(u) and one state tensor, or another method"
        )


def solve(
    driven: DrivenSystem | PortHamiltonianSystem, x0: Tensor, t: Tensor, step_size: float | None, scheme: Scheme
) -> Tensor:
    """The states that ``torchdiffeq.odeint`` with ``method="phnn"`` returns, without torchdiffeq."""
    _refuse_other_systems(driven)
    return _Solve(driven, x0, t, step_size, scheme).differentiable()


hooks.add_methods({METHOD: PowerPreserving})
