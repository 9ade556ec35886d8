"""`torchdiffeq.odeint` with guards against silent failures and failures without a stated reason.

* A right-hand side that is not finite is reported with its time and cause, not as "underflow in dt".
* Adaptive steps stop at the times where the input jumps, so that no short pulse is stepped over.
* Only dopri5 interpolates outputs as accurately as it steps; the steps of the other methods end at the outputs.
* The continuous adjoint integrates backwards, where a decay at rate r grows by exp(r Δt) between two outputs. It is
refused if that growth makes its gradients wrong. The power-preserving step has its own adjoint, the transpose of its
steps, which is exact at any spacing (`phnn.integrate.method`).
"""

from __future__ import annotations

from typing import Any

import torch
import torchdiffeq
from torch import Tensor, nn

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate import method as own
from phnn.integrate.method import METHOD
from phnn.integrate.scheme import Scheme
from phnn.network.system import DrivenSystem, PortHamiltonianSystem

ADAPTIVE = ("dopri5", "dopri8", "bosh3", "adaptive_heun", "fehlberg2")
FIXED = ("euler", "midpoint", "heun2", "heun3", "rk4")

# Largest decay rate × output spacing at which the adjoint's backward integration is still trusted.
ADJOINT_LIMIT = 5.0
_PROBES = 24
_MAX_STEPS = 1_000_000
# A state of this size is the result of instability, not of a law that fails at ordinary values.
_ASTRONOMIC = 1e30


def odeint(
    system: nn.Module,
    x0: Tensor,  # (..., n) initial state
    t: Tensor,  # (N,) output times, increasing [s]
    method: str = "dopri5",
    rtol: float = 1e-7,
    atol: float | Tensor = 1e-12,
    adjoint: bool = False,
    jump_t: Tensor | None = None,
    max_steps: int = _MAX_STEPS,
    step_size: float | None = None,
    scheme: Scheme = Scheme.DISCRETE_GRADIENT,
) -> Tensor:
    """Solve ``ẋ = system(t, x)`` with torchdiffeq.

    Args:
        system: module called as ``system(t, x)``, such as ``system.with_input(u)``.
        method: an adaptive (`ADAPTIVE`) or fixed-grid method (`FIXED`, one step per output interval), or
            "phnn": the power-preserving step, of port-Hamiltonian systems alone.
        rtol, atol: tolerances of adaptive methods; ``atol`` in the units of the state, a number or (n,).
        adjoint: gradients by the continuous adjoint instead of by a graph; those of "phnn" are exact either way.
        jump_t: (K,) times at which the input or its slope jumps (its knots).
        max_steps: adaptive steps allowed between two outputs.
        step_size: longest step of "phnn" [s]; one step per output interval where it is left out.
        scheme: its discretisation of reducible storages.

    Returns:
        (N, ..., n) states at the output times.

    Raises:
        InputRefused: not float64, times not increasing, an unsuitable method, tensors that the adjoint would
            not differentiate by, or an output grid too coarse for the adjoint.
        SolverFailed: the right-hand side is not finite, or the step size vanished; names time and cause.
    """
    _check_inputs(system, x0, t, method, jump_t, step_size)
    if method == METHOD:
        if own.SOLVERS is None:
            return own.solve(system, x0, t, step_size, scheme)  # type: ignore[arg-type]
        return torchdiffeq.odeint(system, x0, t, method=METHOD, options={"step_size": step_size, "scheme": scheme})
    watched = _Watched(system, remember=adjoint or jump_t is not None)
    _check_first(watched, t, x0, adjoint)
    jumps = _inside(jump_t, t)
    chosen: dict[str, Any] = {"rtol": rtol, "atol": atol, "method": method}
    # A fixed grid needs no options but to see both sides of a jump at an output.
    chosen["options"] = {"perturb": True} if method in FIXED else {"max_num_steps": max_steps, "jump_t": jumps}
    if method in ADAPTIVE and method != "dopri5":
        chosen["options"]["step_t"] = t[~torch.isin(t, jumps)].detach()
    if adjoint:
        # The augmented state has other components, so that its tolerance must be a number.
        chosen["adjoint_atol"] = float(torch.as_tensor(atol).min())
    try:
        xs = (torchdiffeq.odeint_adjoint if adjoint else torchdiffeq.odeint)(watched, x0, t, **chosen)
    except AssertionError as error:
        raise SolverFailed(_cause_of_stop(watched, str(error), max_steps)) from error
    _check_finite(watched, xs, t, method)
    # torchdiffeq forgets all later jumps once a step ends on one.
    begun = {float(time) for time, _ in watched.visited}
    for jump in jumps.tolist():
        if jump not in begun:
            raise SolverFailed(f"the jump at t = {jump:.6g} s was stepped over: change rtol a little and solve again")
    if adjoint:
        _check_spacing(watched, t)
    return xs


def fastest_decay(
    system: nn.Module,
    t: Tensor,  # ()
    x: Tensor,  # (..., n)
) -> float:
    """Return the fastest decay rate ``max(−Re λ)`` [1/s] of the linearisation at a time, over a batch of states."""
    with torch.enable_grad():
        z = x.detach().requires_grad_(True)
        rate = system(t.detach(), z)
        # Members of a batch do not see each other: one backward pass gives one row for all of them.
        rows = [torch.autograd.grad(rate[..., i].sum(), z, retain_graph=True)[0] for i in range(rate.shape[-1])]
    return float((-torch.linalg.eigvals(torch.stack(rows, dim=-2)).real).max().clamp_min(0.0))


class _Watched(nn.Module):
    """The right-hand side; it records the latest time and the first value that was not finite."""

    def __init__(self, system: nn.Module, remember: bool) -> None:
        super().__init__()
        self.system = system
        self.remember = remember
        self.visited: list[tuple[Tensor, Tensor]] = []
        self.first_bad: tuple[Tensor, Tensor] | None = None

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        rate = self.system(t, x)
        if self.first_bad is None and not bool(torch.isfinite(rate).all()):
            self.first_bad = (t.detach(), x.detach())
        return rate

    def callback_step(self, t: Tensor, x: Tensor, dt: Tensor) -> None:
        """Called by torchdiffeq before every attempted step."""
        if not self.remember:
            self.visited.clear()
        self.visited.append((t.detach(), x.detach()))


def _check_inputs(
    system: nn.Module, x0: Tensor, t: Tensor, method: str, jump_t: Tensor | None, step_size: float | None
) -> None:
    for name, value in (("initial state", x0), ("vector of output times", t), *system.named_parameters()):
        if value.dtype != torch.float64:
            raise InputRefused(
                f"the {name} is {value.dtype}: convert it with .double(); 32-bit time resolves only 7.6 µs at 100 s"
            )
    if t.ndim != 1 or t.shape[0] < 2 or not bool((t[1:] > t[:-1]).all()):
        raise InputRefused(
            "output times must be one increasing vector of at least two: a dissipative system cannot be integrated "
            "backwards"
        )
    if method not in (*ADAPTIVE, *FIXED, METHOD):
        raise InputRefused(
            f"method {method!r} is not supported: choose one of {', '.join((*ADAPTIVE, *FIXED, METHOD))}; "
            "gradients of the multistep methods are inexact and scipy's have none"
        )
    inner = system.system if isinstance(system, DrivenSystem) else system
    if method != METHOD and isinstance(inner, PortHamiltonianSystem) and inner.network.senses:
        raise InputRefused(
            f"an imposed motion acts through a rigid contact, whose rates {method} cannot follow: "
            f"use method={METHOD!r} or phnn.Model.simulate"
        )
    if step_size is not None and method != METHOD:
        raise InputRefused(f"step_size is for {METHOD}: {method} steps by rtol, or from output to output of t")
    if jump_t is not None and method not in ADAPTIVE:
        raise InputRefused(f"{method} steps from output to output: put the jump times into t, or use dopri5")


def _inside(jump_t: Tensor | None, t: Tensor) -> Tensor:
    """Distinct jump times inside the interval: torchdiffeq refuses repeated ones."""
    if jump_t is None:
        return t[:0].detach()
    jumps = torch.unique(jump_t.detach().to(t))
    return jumps[(jumps > t[0]) & (jumps < t[-1])]


def _check_first(watched: _Watched, t: Tensor, x0: Tensor, adjoint: bool) -> None:
    """Check that the first evaluation is finite and, for the adjoint, depends only on registered parameters."""
    with torch.enable_grad():
        rate = watched(t[0].detach(), x0.detach())
    if watched.first_bad is not None:
        raise SolverFailed(f"at t = {float(t[0]):.6g} s {_why_not_finite(watched)}")
    known, seen, stack = {id(p) for p in watched.parameters()}, set(), [rate.grad_fn] if adjoint else []
    while stack:
        node = stack.pop()
        if node is None or node in seen:
            continue
        seen.add(node)
        stack.extend(parent for parent, _ in node.next_functions)
        tensor = getattr(node, "variable", None)
        if tensor is not None and id(tensor) not in known:
            raise InputRefused(
                f"a tensor of shape {tuple(tensor.shape)} that requires a gradient is used but is no parameter of "
                "the module: the adjoint would leave its gradient out; register it (an input as nn.Module), or "
                "use adjoint=False"
            )


def _check_finite(watched: _Watched, xs: Tensor, t: Tensor, method: str) -> None:
    """Check that every state of the solution is finite."""
    finite = torch.isfinite(xs).reshape(len(t), -1).all(1)
    if bool(finite.all()):
        return
    cause = f"{method} is unstable at this step; use more output times, dopri5, or method={METHOD!r}"
    if watched.first_bad is not None and float(watched.first_bad[1].abs().max()) < _ASTRONOMIC:
        cause = _why_not_finite(watched)
    raise SolverFailed(f"the solution is not finite from t = {float(t[~finite][0]):.6g} s on: {cause}")


def _check_spacing(watched: _Watched, t: Tensor) -> None:
    """Refuse output times between which the adjoint's backward integration amplifies errors beyond use."""
    visited = watched.visited
    chosen = torch.linspace(0, len(visited) - 1, min(_PROBES, len(visited))).round().long().tolist()
    rate, when = max((fastest_decay(watched.system, *visited[k]), float(visited[k][0])) for k in chosen)
    spacing = float((t[1:] - t[:-1]).max())
    if rate * spacing > ADJOINT_LIMIT:
        raise InputRefused(
            f"the continuous adjoint would return wrong gradients: a mode decays at {rate:.3g} 1/s (t = {when:.4g} s) "
            f"while outputs are {spacing:.3g} s apart, a product of {rate * spacing:.3g} where at most "
            f"{ADJOINT_LIMIT:g} is safe; space outputs at most {ADJOINT_LIMIT / rate:.2g} s, use adjoint=False, or "
            f"method={METHOD!r}, whose own adjoint is exact at any spacing"
        )


def _why_not_finite(watched: _Watched) -> str:
    """Name the first cause that is not finite: a parameter, the state, the input, or the right-hand side itself."""
    assert watched.first_bad is not None
    (t, x), system = watched.first_bad, watched.system
    for name, parameter in system.named_parameters():
        if not bool(torch.isfinite(parameter).all()):
            return f"the right-hand side is not finite because the parameter {name} is not: lower the learning rate"
    if not bool(torch.isfinite(x).all()):
        return "the state is not finite: check the initial state and the stability of the model"
    drive = getattr(system, "input", None)
    with torch.no_grad():
        if callable(drive) and not bool(torch.isfinite(drive(t)).all()):
            return "the input u(t) is not finite: repair the recording there, or its interpolation"
        bad = ~torch.isfinite(system(t, x))
    names = getattr(getattr(system, "system", system), "state_names", [f"component {i}" for i in range(x.shape[-1])])
    marked = torch.nonzero(bad.reshape(-1, bad.shape[-1]).any(0)).flatten().tolist()
    return f"the right-hand side is not finite in {', '.join(names[i] for i in marked)}: check the laws there"


def _cause_of_stop(watched: _Watched, message: str, max_steps: int) -> str:
    """The reason behind an assertion of torchdiffeq's step control."""
    if watched.first_bad is not None:
        return f"at t = {float(watched.first_bad[0]):.6g} s {_why_not_finite(watched)}"
    place = f"at t = {float(watched.visited[-1][0]) if watched.visited else float('nan'):.6g} s"
    remedy = f"solve with method={METHOD!r}, which has no such limit"
    if "max_num_steps" in message:
        return (
            f"{place} {max_steps} steps did not reach the next output (the system is stiff): {remedy}, or loosen rtol"
        )
    if "underflow in dt" in message:
        return (
            f"{place} the step size vanished though every value is finite (a jump, or stiffness beyond the method): "
            f"give the times of jumps in the input as jump_t, or {remedy}"
        )
    return f"{place} torchdiffeq stopped: {message}; {remedy}"
