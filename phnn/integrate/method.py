"""The power-preserving step as a method of torchdiffeq, which is its own adjoint and exact at any step.

    system = phnn.PortHamiltonianSystem(network)      # makes the method known to torchdiffeq
    x = torchdiffeq.odeint(system.with_input(u), x0, t, method="phnn")
    x = torchdiffeq.odeint_adjoint(system.with_input(u), x0, t, method="phnn", options={"step_size": h})

The function is a `PortHamiltonianSystem` (inputs at zero) or its ``with_input(u)``, ``x0`` is (..., n). Every interval
between two outputs is divided into the fewest equal steps of at most ``step_size`` [s]; without ``step_size`` it is one
step. Outputs are ends of steps and never interpolated, so that the power balance holds between them too. The input of a
step is its mean by two-point Gauss–Legendre quadrature, whose nodes lie inside the step: ``u`` may jump where steps
meet. Tolerances have no meaning here and are ignored. The option ``scheme`` selects another `Scheme`.

Gradients are those of the computed states (`phnn.integrate.differentiable`), by ``x0`` and the parameters of the
system, its laws and its input; with `odeint` also by ``t``, for a fixed number of steps. `odeint_adjoint` gives the
same gradients by the same sweep: torchdiffeq asks it interval by interval, and all is computed at the last one asked
for, the first in time. Another ``adjoint_method`` is refused: a continuous adjoint is wrong for distant outputs.

torchdiffeq offers no way to add a method. Three of its undocumented parts are used here: ``SOLVERS`` takes the method,
``_PerturbFunc`` and ``_ReverseFunc`` show it the system behind the function that it is given, and so does the closure
of the augmented dynamics. Without these parts `solve` still takes the same steps.
"""

from __future__ import annotations

import inspect
from typing import Any

import torch
from torch import Tensor

from phnn.errors import InputRefused
from phnn.integrate.differentiable import port_inputs, simulated
from phnn.integrate.scheme import Scheme
from phnn.network.system import DrivenSystem, PortHamiltonianSystem

try:
    from torchdiffeq._impl.misc import _PerturbFunc, _ReverseFunc
    from torchdiffeq._impl.odeint import SOLVERS
except ImportError:  # gone from torchdiffeq
    SOLVERS = None

METHOD = "phnn"

# Nodes of the two-point rule as shares of a step.
_EARLY, _LATE = 0.5 - 3.0**-0.5 / 2.0, 0.5 + 3.0**-0.5 / 2.0
# Tolerance, so that rounding does not add a step to an interval that is a whole number of steps.
_ROUNDING = 1e-9


def solve(
    driven: DrivenSystem | PortHamiltonianSystem,
    x0: Tensor,  # (..., n)
    t: Tensor,  # (K,) output times, increasing
    step_size: float | None = None,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> Tensor:
    """Return the (K, ..., n) states of ``torchdiffeq.odeint`` with ``method="phnn"``, without torchdiffeq.

    Raises:
        InputRefused: the right-hand side is not a port-Hamiltonian system; times that are not finite float64, or fewer
            than two; a ``step_size`` that is not positive.
        SolverFailed: a step has no solution; names time, state and remedy.
    """
    if not isinstance(driven, DrivenSystem | PortHamiltonianSystem):
        raise InputRefused(
            f"the right-hand side is a {type(driven).__name__}, which has no energy to take the discrete gradient "
            "of: give a PortHamiltonianSystem or its with_input(u) and one state tensor, or another method"
        )
    if t.dtype != torch.float64 or t.shape[0] < 2 or not bool(torch.isfinite(t).all()):
        raise InputRefused(
            f"{t.shape[0]} output times of {t.dtype}: give at least two, all finite, converted with .double()"
        )
    if step_size is not None and not 0.0 < step_size < float("inf"):
        raise InputRefused(f"step_size = {step_size:g} s: give a positive, finite step")
    spacing = t.diff()
    least = torch.ones_like(spacing) if step_size is None else spacing.detach() / step_size * (1.0 - _ROUNDING)
    counts = least.ceil().clamp_min(1.0).long()
    ends = counts.cumsum(0)
    number = torch.arange(int(ends[-1]), device=t.device) - (ends - counts).repeat_interleave(counts)
    h = (spacing / counts).repeat_interleave(counts)
    start = t[:-1].repeat_interleave(counts) + number * h
    if isinstance(driven, DrivenSystem):
        system, u = driven.system, 0.5 * (_inputs(driven, start + _EARLY * h) + _inputs(driven, start + _LATE * h))
    else:
        system, u = driven, x0.new_zeros(len(h), len(driven.network.ports))
    states = simulated(system, x0, port_inputs(system, u, x0.ndim - 1), h, scheme, float(t[0].detach()))
    return states if step_size is None else states[[0, *ends.tolist()]]


def _inputs(driven: DrivenSystem, t: Tensor) -> Tensor:
    """Return (N, ..., P) inputs at many times (N,), one after the other where the function cannot take all of them."""
    try:
        return torch.as_tensor(torch.func.vmap(driven.input)(t))
    except (RuntimeError, ValueError):
        return torch.stack([driven.input(time) for time in t])


class PowerPreserving:
    """The solver that torchdiffeq constructs for ``method="phnn"``, forwards, and once for every interval backwards.

    Raises:
        InputRefused: as of `solve`; or the times decrease, there is another option than ``step_size`` and ``scheme``,
            an event function, a gradient by ``t`` asked of the adjoint, or another method in the forward pass.
        SolverFailed: a step has no solution; names time, state and remedy.
    """

    def __init__(
        self,
        func: Any,
        y0: Tensor,
        step_size: float | None = None,
        scheme: Scheme | str = Scheme.DISCRETE_GRADIENT,
        **others: Any,
    ) -> None:
        # torchdiffeq adds these three itself.
        if unknown := ", ".join(sorted(set(others) - {"rtol", "atol", "norm"})):
            raise InputRefused(f"{METHOD} has no option {unknown}: leave it out, it takes step_size and scheme")
        self.y0, self.step_size = y0, step_size
        self.scheme = Scheme.named(scheme) if isinstance(scheme, str) else scheme
        # Calls of odeint_adjoint wrap the function twice. The wrapper lives as long as the graph of the result.
        self.driven, self.holder = func.base_func, None
        if isinstance(self.driven, _PerturbFunc):
            self.driven, self.holder = self.driven.base_func, self.driven
        if isinstance(self.driven, _ReverseFunc) and not _backwards(self.driven):
            raise InputRefused("the output times decrease: a dissipative system cannot be integrated backwards")

    @staticmethod
    def valid_callbacks() -> set[str]:
        """None: all steps are found at once."""
        return set()

    def integrate(self, t: Tensor) -> Tensor:
        """Return (K, ..., n) states at the output times (K,), or the augmented state at both ends of an interval."""
        if known := _backwards(self.driven):
            return self._pulled_back(t, known)
        if self.holder is None:
            return solve(self.driven, self.y0, t, self.step_size, self.scheme)
        if t.requires_grad:
            raise InputRefused("odeint_adjoint offers no gradients by t here: use odeint, or t.detach()")
        with torch.enable_grad():
            x0 = self.y0.detach().requires_grad_(True)
            x = solve(self.driven, x0, t, self.step_size, self.scheme)
        self.holder.recording = t, x0, x, []
        # From here on only a continuous adjoint evaluates the vector field.
        self.holder.register_forward_pre_hook(_refuse_other_adjoint)
        return x.detach()

    def _pulled_back(self, t: Tensor, known: dict[str, Any]) -> Tensor:
        """Return (2, A) the augmented state (by t, x, by x, by parameters) at the end and the start of an interval.

        torchdiffeq passes negated times, and adds the gradient by the output at the start to ``by x``. That is returned
        as zero but in the first interval, so that what comes for an interval is the gradient by the output at its end.
        """
        recording = getattr(known["func"], "recording", None)
        if recording is None:
            raise InputRefused(f"adjoint_method={METHOD!r} is for the steps of method={METHOD!r} alone: give both")
        times, x0, x, wanted = recording
        size = x0.numel()
        by_t, state, by_x, by_parameters = self.y0.tensor_split([1, 1 + size, 1 + 2 * size])
        if -t[0] == times[-1]:
            wanted.clear()
        wanted.append(by_x.reshape(x0.shape))
        flat_gradients = torch.zeros_like(self.y0[1 + size :])
        if len(wanted) == len(x) - 1:
            asked, by_x = (x0, *known["adjoint_params"]), torch.stack([torch.zeros_like(x0), *wanted[::-1]])
            gradients = torch.autograd.grad(x, asked, by_x, True, allow_unused=True, materialize_grads=True)
            flat_gradients = torch.cat([g.reshape(-1) for g in gradients])
        by_parameters = by_parameters + flat_gradients[size:]
        return torch.stack([self.y0, torch.cat([by_t, state, flat_gradients[:size], by_parameters])])

    def integrate_until_event(self, t0: Tensor, event_fn: Any) -> Tensor:
        """Always raise: the solver supports no events."""
        raise InputRefused(f"{METHOD} does not look for events: look for them in its states")


def _backwards(func: Any) -> dict[str, Any]:
    """The closure variables of the augmented dynamics of torchdiffeq's backward pass; empty for any other function."""
    while hasattr(func, "base_func"):
        func = func.base_func
    known = dict(inspect.getclosurevars(func).nonlocals) if inspect.isfunction(func) else {}
    return known if "adjoint_params" in known else {}


def _refuse_other_adjoint(module: Any, arguments: Any) -> None:
    raise InputRefused(
        f"a continuous adjoint of {METHOD} is wrong where outputs are far apart for a decay: leave adjoint_method out, "
        "or use odeint"
    )


if SOLVERS is not None:
    SOLVERS[METHOD] = PowerPreserving
