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

import torch
import torchdiffeq
from torch import Tensor

from phnn.errors import InputRefused
from phnn.integrate import hooks
from phnn.integrate.method import check_options
from phnn.integrate.sampled import SampledRuns, Solved
from phnn.integrate.scheme import Scheme
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
