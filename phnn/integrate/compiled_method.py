"""The compiled integration as a method of torchdiffeq, with the transpose of its steps as the adjoint method.

    import phnn.integrate.compiled_method  # makes both methods known to torchdiffeq

    runs = SampledRuns(system, u, h, nodes)
    ends = torchdiffeq.odeint_adjoint(runs, runs.start(x0), torch.tensor([0.0, 1.0], dtype=torch.float64),
                                      method="compiled_discrete_gradient", options={},
                                      adjoint_method="compiled_discrete_gradient_adjoint", adjoint_options={})
    states = runs.samples(ends[-1])

The steps, and so the states and their exact gradients, are those of `phnn.integrate.differentiable`.
`phnn.integrate.method` solves the same steps in torch, for laws of any form and for inputs that are functions of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import torchdiffeq
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.integrate import hooks, sweep
from phnn.integrate.differentiable import March, simulate_torch
from phnn.integrate.inputs import refuse_unfit_march
from phnn.integrate.method import check_options
from phnn.integrate.program import Program, compile_network
from phnn.integrate.residual import steps_residual
from phnn.integrate.scheme import Scheme
from phnn.network.checks import evaluation
from phnn.network.system import PortHamiltonianSystem

COMPILED = "compiled_discrete_gradient"
COMPILED_ADJOINT = "compiled_discrete_gradient_adjoint"


def sampled_states(
    system: PortHamiltonianSystem,
    u: Sequence[Tensor],  # (n_b, P) mean inputs of the steps of every run
    h: Sequence[Tensor],  # (n_b,) their sizes [s]
    nodes: Sequence[Tensor],  # (S_b,) step indices of the samples
    x0: Tensor,  # (B, n) initial states
    adjoint: bool = True,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> list[Tensor]:
    """(S_b, n) states at the samples of every run, by `torchdiffeq.odeint_adjoint` or, without a graph of its own,
    by `torchdiffeq.odeint`; differentiable by ``x0`` and the parameters of the system.

    Raises:
        InputRefused: see `SampledRuns`.
        SolverFailed: a step has no solution.
    """
    runs = SampledRuns(system, u, h, nodes, scheme)
    if not hooks.takes_methods():
        return runs.samples(runs.differentiable(runs.start(x0)))
    ends = x0.new_tensor([0.0, 1.0])
    if adjoint:
        found = torchdiffeq.odeint_adjoint(
            runs, runs.start(x0), ends, method=COMPILED, options={}, adjoint_method=COMPILED_ADJOINT, adjoint_options={}
        )
    else:
        found = torchdiffeq.odeint(runs, runs.start(x0), ends, method=COMPILED, options={})
    return runs.samples(found[-1])


class CompiledDiscreteGradient:
    """The solver that torchdiffeq constructs for ``method="compiled_discrete_gradient"``.

    Raises:
        InputRefused: the right-hand side is not a `SampledRuns`, the output times are not 0 and 1 or require a
            gradient, or an option or an event function is given.
        SolverFailed: a step has no solution; names time and remedy.
    """

    def __init__(self, func: Any, y0: Tensor, **others: Any) -> None:
        check_options(COMPILED, others)
        inner, self.holder = hooks.behind(func)
        if not isinstance(inner, SampledRuns):
            raise InputRefused(
                f"the right-hand side is a {type(inner).__name__}: {COMPILED} integrates SampledRuns from 0 to 1; for "
                "a system with an input that is a function of time take method='discrete_gradient'"
            )
        self.runs, self.y0 = inner, y0

    @staticmethod
    def valid_callbacks() -> set[str]:
        """None: all steps are taken in one call."""
        return set()

    def integrate(self, t: Tensor) -> Tensor:
        """(2, B, (1 + S) n) states at the start and the end."""
        if t.requires_grad or t.tolist() != [0.0, 1.0]:
            raise InputRefused(f"{COMPILED} goes from 0 to 1, without gradients by these: the runs hold true times")
        if self.holder is None:
            return torch.stack([self.y0, self.runs.differentiable(self.y0)])
        self.holder.solved = self.runs.solve(self.y0)
        return torch.stack([self.y0, self.holder.solved.end])

    def integrate_until_event(self, t0: Tensor, event_fn: Any) -> Tensor:
        """Always raise: the solver supports no events."""
        raise InputRefused(f"{COMPILED} does not look for events: look for them in its states")


class CompiledDiscreteGradientAdjoint:
    """The solver that torchdiffeq constructs for ``adjoint_method="compiled_discrete_gradient_adjoint"``.

    Raises:
        InputRefused: it is not used for the backward pass of ``method="compiled_discrete_gradient"``, or it got
            options.
    """

    def __init__(self, func: Any, y0: Tensor, **others: Any) -> None:
        check_options(COMPILED_ADJOINT, others)
        known = hooks.augmented(func)
        solved = getattr(known.get("func"), "solved", None)
        if solved is None:
            raise InputRefused(f"{COMPILED_ADJOINT} is the adjoint_method of odeint_adjoint for {COMPILED!r} alone")
        self.solved: Solved = solved
        self.parameters: tuple[Tensor, ...] = known["adjoint_params"]
        self.y0 = y0

    valid_callbacks = CompiledDiscreteGradient.valid_callbacks

    def integrate(self, t: Tensor) -> Tensor:
        """(2, A) the augmented state (by t, x, by x, by parameters) at the end and the start."""
        size = self.solved.end.numel()
        by_t, x, by_x, by_parameters = self.y0.tensor_split([1, 1 + size, 1 + 2 * size])
        by_start, found = self.solved.pull_back(by_x.reshape(self.solved.end.shape), self.parameters)
        more = torch.cat([f.reshape(-1) for f in found]) if found else torch.zeros_like(by_parameters)
        return torch.stack([self.y0, torch.cat([by_t, x, by_start.reshape(-1), by_parameters + more])])


hooks.add_methods({COMPILED: CompiledDiscreteGradient, COMPILED_ADJOINT: CompiledDiscreteGradientAdjoint})


Array = NDArray[np.float64]

# Steps whose graph the backward pass holds at a time.
_STEPS = 1 << 16


class SampledRuns(nn.Module):
    """The right-hand side above, to be integrated from 0 to 1 by the method ``compiled_discrete_gradient``.

    Args:
        system: of all runs; its parameters are those of this module.
        u: (n_b, P) mean inputs of the steps of every run.
        h: (n_b,) steps [s] of every run.
        nodes: (S_b,) increasing step indices of the samples of every run.
        scheme: the discretisation.

    Raises:
        InputRefused: no run, or shapes that do not fit.
        StructureViolated: a law that has no compiled form.
    """

    def __init__(
        self,
        system: PortHamiltonianSystem,
        u: Sequence[Tensor],
        h: Sequence[Tensor],
        nodes: Sequence[Tensor],
        scheme: Scheme = Scheme.DISCRETE_GRADIENT,
    ) -> None:
        super().__init__()
        self.system = system
        if not len(u) == len(h) == len(nodes) or not u:
            raise InputRefused(f"{len(u)} inputs, {len(h)} lists of steps and {len(nodes)} of samples: give one a run")
        self.scheme, self.program = scheme, compile_network(system.network, scheme)
        self.u, self.h, self.nodes = tuple(u), tuple(h), tuple(nodes)
        rest = torch.zeros(len(system.state_names), dtype=torch.float64)
        for inputs, steps, samples in zip(self.u, self.h, self.nodes, strict=True):
            refuse_unfit_march(system, inputs, steps, rest)
            if samples.ndim != 1 or not 0 <= int(samples.min()) <= int(samples.max()) <= steps.shape[0]:
                raise InputRefused(f"samples must be step indices from 0 to {steps.shape[0]}")

    @property
    def most(self) -> int:
        """Number of samples that a record has room for."""
        return max(n.shape[0] for n in self.nodes)

    def start(self, x0: Tensor) -> Tensor:  # x0: (B, n)
        """(B, (1 + S) n) initial states with empty records."""
        return torch.cat([x0, x0.new_zeros(x0.shape[0], self.most * x0.shape[1])], dim=1)

    def samples(self, end: Tensor) -> list[Tensor]:  # end: (B, (1 + S) n)
        """(S_b, n) states at the samples of every run."""
        records = end.reshape(end.shape[0], 1 + self.most, -1)[:, 1:]
        return [r[: n.shape[0]] for r, n in zip(records, self.nodes, strict=True)]

    def forward(self, s: Tensor, state: Tensor) -> Tensor:
        """Refused: sampling is an impulse, which no method can step over that evaluates the right-hand side."""
        raise InputRefused(
            "sampled runs are impulses in time: integrate them with method='compiled_discrete_gradient' and "
            "adjoint_method='compiled_discrete_gradient_adjoint'"
        )

    def differentiable(self, state: Tensor) -> Tensor:
        """(B, (1 + S) n) state at the end, with a graph of one node a run."""
        x0 = self._initial(state)
        paths = [
            simulate_torch(self.system, u, h, x, scheme=self.scheme) for u, h, x in zip(self.u, self.h, x0, strict=True)
        ]
        return self._with_records(paths)

    def solve(self, state: Tensor) -> Solved:
        """The solved runs without a graph.

        Raises:
            SolverFailed: a step has no solution; names its time.
        """
        return Solved(self, self._initial(state.detach()))

    def _initial(self, state: Tensor) -> Tensor:
        """(B, n) states at the start."""
        n = len(self.system.state_names)
        if state.shape != (len(self.u), (1 + self.most) * n):
            raise InputRefused(f"a state of shape {tuple(state.shape)}: give that of SampledRuns.start")
        return state[:, :n]

    def _with_records(self, paths: Sequence[Tensor]) -> Tensor:
        rows = []
        for path, nodes in zip(paths, self.nodes, strict=True):
            room = path.new_zeros((self.most - nodes.shape[0]) * path.shape[1])
            rows.append(torch.cat([path[-1], path[nodes].reshape(-1), room]))
        return torch.stack(rows)


class Solved:
    """All steps of all runs, and derivatives by initial states and parameters.

    Args:
        runs: the runs to solve.
        x0: (B, n) initial states.
    """

    def __init__(self, runs: SampledRuns, x0: Tensor) -> None:
        self.runs, self.march = runs, March(runs.system, runs.program)
        self.paths = [
            self.march.steps(u.numpy(), h.numpy(), x.numpy().copy())
            for u, h, x in zip(runs.u, runs.h, x0, strict=True)
        ]  # fmt: skip
        program, free = self.march.program, runs.system.free
        names = () if program.modules else program.names
        self.active = np.array([k for k, name in enumerate(names) if name in free], dtype=np.int64)
        self.end = runs._with_records([torch.from_numpy(states) for states, _ in self.paths])

    def pull_back(self, wanted: Tensor, parameters: Sequence[Tensor]) -> tuple[Tensor, list[Tensor]]:
        """Pull ``∂L`` by the end, (B, (1 + S) n), back to the start, of the same shape, and to the parameters."""
        n = wanted.shape[1] // (1 + self.runs.most)
        by_start, weights, gradient = torch.zeros_like(wanted), [], np.zeros(self.active.size)
        for b, nodes in enumerate(self.runs.nodes):
            cotangent = np.zeros_like(self.paths[b][0])
            cotangent[nodes.numpy()] = wanted[b, n:].reshape(-1, n)[: nodes.shape[0]].numpy()
            cotangent[-1] += wanted[b, :n].numpy()
            by_theta, carry, mu = self._transposed(b, cotangent)
            # No result depends on the content of a record at the start.
            by_start[b, :n] = torch.from_numpy(carry + cotangent[0])
            gradient += by_theta
            weights.append(mu)
        if self.march.program.modules:
            return by_start, self._by_modules(np.concatenate(weights), parameters)
        return by_start, self._by_values(gradient, parameters)

    def _transposed(self, b: int, cotangent: Array) -> tuple[Array, Array, Array]:
        """``∂L/∂θ`` (K,) by active values, ``∂L/∂x₀`` (n,) by later nodes, and ``μ`` (n_b, n + m), of one run."""
        march, (states, efforts) = self.march, self.paths[b]
        u, h = self.runs.u[b].numpy(), self.runs.h[b].numpy()
        mu = np.empty((h.size, states.shape[1] + len(march.program.junctions)))
        run = sweep.Integrated(march.program, march.theta, states, efforts, u, h)
        by_theta, carry = sweep.adjoint(run, self.active, cotangent, mu)
        return by_theta, carry, mu

    def _by_values(self, gradient: Array, parameters: Sequence[Tensor]) -> list[Tensor]:
        """Convert ``∂L/∂θ`` by physical values, which the compiled sweep has computed, to derivatives by parameters."""
        with torch.enable_grad():
            values = self.runs.system.present_values()
            asked = [values[self.march.program.names[k]] for k in self.active]
            weights = [torch.tensor(g, dtype=torch.float64) for g in gradient]
            found = (
                torch.autograd.grad(asked, tuple(parameters), weights, allow_unused=True)
                if asked and parameters
                else (None,) * len(parameters)
            )
        return [torch.zeros_like(p) if f is None else f for p, f in zip(parameters, found, strict=True)]

    def _by_modules(self, mu: Array, parameters: Sequence[Tensor]) -> list[Tensor]:
        """``−μᵀ ∂F/∂θ`` by the torch module, for learned laws: they have too many weights for a sweep."""
        sums = [torch.zeros_like(p) for p in parameters]
        if not parameters:
            return sums
        x, following, efforts = (
            torch.from_numpy(np.concatenate(parts))
            for parts in zip(*((s[:-1], s[1:], e) for s, e in self.paths), strict=True)
        )
        # The sweep's multipliers of the balances already carry the minus sign of the implicit function theorem.
        mu[:, : x.shape[1]] *= -1.0
        u, h, weights = torch.cat(self.runs.u), torch.cat(self.runs.h), torch.from_numpy(mu)
        system, program = self.runs.system, self.march.program
        for first in range(0, h.shape[0], _STEPS):
            part = slice(first, first + _STEPS)
            with torch.enable_grad():
                residual = _residual(system, program, x[part], following[part], efforts[part], u[part], h[part])
                found: Sequence[Any] = torch.autograd.grad(
                    residual, tuple(parameters), weights[part], allow_unused=True
                )
            for total, gradient in zip(sums, found, strict=True):
                if gradient is not None:
                    total += gradient
        return sums


@evaluation
def _residual(system: PortHamiltonianSystem, program: Program, *steps: Tensor) -> Tensor:
    """(n, N + m) residuals of steps, all parameters read once."""
    return steps_residual(system, program, *steps).value
