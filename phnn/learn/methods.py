"""The optimisers as methods of one epoch each, with all of their state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from phnn.errors import InputRefused, SolverFailed
from phnn.integrate.differentiable import Steps, first_order, march, sensitivities
from phnn.integrate.scheme import can_compile
from phnn.learn.objective import Objective
from phnn.learn.settings import Settings, instantiate
from phnn.learn.solvers import NetworkPlant, Window, discrete_gradient, grouped, near, remember, together

Array = NDArray[np.float64]

_DAMPING, _EASED, _RAISED, _MOST = 1e-2, 0.3, 4.0, 1e8
# Weights that the recordings do not see at all must not move at all.
_FLOOR = 1e-3


class GaussNewton:
    """One damped step an epoch; what is kept between them is the damping alone.

        (JᵀJ + λ diag JᵀJ) δ = −Jᵀ r,     r = (y − ŷ − zero)/σ

    A Jacobian of a hundred columns costs a few gradients, and some tens of steps replace thousands of a first-order
    method. Compiled code has the derivatives of networks without learned laws; those of others are taken in torch, many
    steps at once. Where a law has no kernel torch takes the steps too, and begins a trial where the derivatives lead.

    Raises:
        InputRefused: the plant is no network, its solver has no sensitivities, or recordings are cut into windows.

    References: Levenberg 1944, Marquardt 1963.
    """

    def __init__(self, objective: Objective) -> None:
        plant = objective.plant
        whole = objective.solver is discrete_gradient and not any(w.continues for w in objective.windows)
        if not isinstance(plant, NetworkPlant) or not whole:
            raise InputRefused(
                "gauss_newton is for networks on whole recordings with solver=discrete_gradient: set gauss_newton=0 "
                "and lbfgs=100, or window=0"
            )
        self.objective, self.plant, self.damping = objective, plant, _DAMPING
        self.steps = Steps(plant.system, compiles=can_compile(plant.system.network))
        # Members, windows, inputs and steps of windows of equal lengths: no step is wasted.
        self.groups: list[tuple[list[int], list[Window], Tensor, Tensor]] = []
        for members in grouped([len(w.h) for w in objective.windows]):
            windows = [objective.windows[k] for k in members]
            u, h = together(plant, windows)
            self.groups.append((members, windows, u, h.unsqueeze(-1)))
        self.states: list[Tensor] = []

    def state_dict(self) -> dict[str, Any]:
        """Return what the next step depends on beside the parameters."""
        return {"damping": self.damping}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.damping = float(state["damping"])

    def __call__(self, epoch: int) -> float:
        """Take one step; returns the loss before it.

        Raises:
            SolverFailed: the present model cannot be simulated.
        """
        residual, jacobian = self.linearised()
        n = residual.size
        cost = float(residual @ residual) / n
        normal, slope = jacobian.T @ jacobian, jacobian.T @ residual
        scale = np.maximum(np.diag(normal), _FLOOR * np.diag(normal).max())
        before = self.objective.present()
        while self.damping < _MOST:
            vector = torch.from_numpy(-np.linalg.solve(normal + self.damping * np.diag(scale), slope))
            pieces = vector.split([p.numel() for p in before])
            step = [v.reshape(p.shape) for v, p in zip(pieces, before, strict=True)]
            if self._cost(before, step) < cost:
                self.damping = max(self.damping * _EASED, 1e-10)
                return cost
            self.damping *= _RAISED
        self.objective.move_to(before)
        self.damping = _DAMPING
        return cost

    @torch.no_grad()
    def _cost(self, before: Sequence[Tensor], step: Sequence[Tensor]) -> float:
        """Return the loss after a step, which is taken; infinite where the model cannot be simulated there."""
        after = [p + s for p, s in zip(before, step, strict=True)]
        try:
            if self.steps.compiles:
                self.objective.move_to(after)
                return float(self.objective())
            x0 = self.objective.initial()
            names = {id(p): name for name, p in self.steps.named_parameters()}
            # Initial states come last in a step.
            moved = {names[id(p)]: s for p, s in zip(self.plant.trained(), step, strict=False)}
            self.objective.move_to(after)
            start = self.objective.initial() - x0
            self.objective.move_to(before)
            given = zip(self.groups, self.states, strict=True)
            guesses = [x + first_order(self.steps, x, u, h, moved, start[m]) for (m, _, u, h), x in given]
            self.objective.move_to(after)
            states = self._solved(guesses, alone=True)
            return float(self.objective.residuals(self._outputs(states)).square().mean())
        except SolverFailed:
            return float("inf")

    @torch.no_grad()
    def _solved(self, guesses: Sequence[Tensor | None], alone: bool = False) -> list[Tensor]:
        """Return (N+1, B, n) states of the windows of every group; those that torch has found are remembered."""
        x0, found = self.objective.initial(), []
        for (members, windows, u, h), guess in zip(self.groups, guesses, strict=True):
            if self.steps.compiles:
                found.append(self.steps.states(x0[members], u, h, 0.0))
            else:
                found.append(march(self.plant.system, x0[members], u, h, near=guess, alone=alone))
                remember(self.plant, windows, found[-1])
        return found

    def _outputs(self, states: Sequence[Tensor]) -> list[Tensor]:
        """Return (S,) output of every window."""
        found: list[Tensor] = [states[0]] * len(self.objective.windows)
        for (members, windows, *_), x in zip(self.groups, states, strict=True):
            for b, (k, w) in enumerate(zip(members, windows, strict=True)):
                found[k] = self.plant.measured(x[w.nodes, b])
        return found

    def linearised(self) -> tuple[Array, Array]:
        """Return (N,) residual over noise and (N, K) its derivatives by all that is trained."""
        o, scale = self.objective, self.plant.scale.numpy()
        o.solved += 1
        self.states = self._solved([None if self.steps.compiles else near(self.plant, w) for _, w, *_ in self.groups])
        trained, row = self.steps.trained.values(), self.plant.system.state_names.index(self.plant.network.output)
        places = dict(zip(map(id, trained), np.cumsum([0, *(p.numel() for p in trained)]), strict=False))
        order = np.concatenate([places[id(p)] + np.arange(p.numel()) for p in self.plant.trained()])
        rows = [np.zeros(0)] * len(o.windows)
        for (members, windows, u, h), x in zip(self.groups, self.states, strict=True):
            try:
                derivatives = sensitivities(self.steps, x, u, h, [w.nodes for w in windows], row)
            except RuntimeError as error:
                raise InputRefused(f"gauss_newton cannot follow a law ({error}): take lbfgs") from error
            for k, w, by in zip(members, windows, map(Tensor.numpy, derivatives), strict=True):
                of_start = np.zeros((len(by), o.offsets.numel()))
                if not w.known:
                    first = o.unknown.index(k) * scale.size
                    of_start[:, first : first + scale.size] = by[:, -scale.size :] * scale
                inside = np.concatenate([by[:, order], of_start], axis=1)[o.masks[w.recording].numpy()]
                rows[k] = -(inside - inside.mean(0)) / o.recordings[w.recording].noise
        return o.residuals(self._outputs(self.states)).detach().numpy(), np.concatenate(rows)


METHODS = ("adam", "lbfgs", "gauss_newton")

_LEAST_RATE = 0.01
_HISTORY = 30
# A trial of a line search that cannot be simulated counts as this many times the loss at its start.
_BAD = 1e3


def method_of(name: str, objective: Objective, settings: Settings, factor: float) -> Method:
    """Return a method by its name; ``factor`` lowers the rate of learning after failures."""
    if name == "gauss_newton":
        return GaussNewton(objective)
    if name == "lbfgs":
        return QuasiNewton(objective, settings.lbfgs_iterations)
    return Stepwise(objective, settings, factor)


def with_gradients(objective: Objective) -> Tensor:
    """Return () the loss, gradients left in ``.grad`` of all that is trained.

    Raises:
        SolverFailed: the model could not be simulated, or loss or gradient are not finite.
    """
    objective.zero_grad()
    loss = objective()
    try:
        loss.backward()
    except AssertionError as error:
        raise SolverFailed(f"the way back failed ({error}): the model is stiff, set solver.adjoint=false") from error
    gradients = [p.grad for p in objective.trained() if p.grad is not None]
    if not bool(torch.isfinite(loss)) or not all(bool(torch.isfinite(g).all()) for g in gradients):
        value = float(loss.detach())
        raise SolverFailed(f"the loss is {value:g} or its gradient not finite: lower the rate of learning")
    return loss.detach()


class Stepwise:
    """A torch optimiser, a step an epoch: Adam along a cosine from the full rate to a hundredth of it (Kingma & Ba
    2015; Loshchilov & Hutter 2017), or one of the user's choice, with a scheduler if there is one."""

    def __init__(self, objective: Objective, settings: Settings, factor: float) -> None:
        self.objective, self.settings, self.rate = objective, settings, settings.rate * factor
        own, trained = settings.optimiser, objective.trained()
        self.optimiser: torch.optim.Optimizer = (
            torch.optim.Adam(trained, lr=self.rate) if own is None else _made(own, "params", trained)
        )
        for group in self.optimiser.param_groups if own is not None else ():
            group["lr"] = factor * group["lr"]
        given = None if own is None else settings.scheduler
        self.scheduler: Any = None if given is None else _made(given, "optimizer", self.optimiser)

    def __call__(self, epoch: int) -> float:
        """Return one step."""
        if self.settings.optimiser is None:
            share = 0.5 * (1.0 + math.cos(math.pi * epoch / self.settings.adam))
            for group in self.optimiser.param_groups:
                group["lr"] = self.rate * (_LEAST_RATE + (1.0 - _LEAST_RATE) * share)
        loss = with_gradients(self.objective)
        self.optimiser.step()
        if self.scheduler is not None:
            self.scheduler.step()
        return float(loss)

    def state_dict(self) -> dict[str, Any]:
        """Return the state of optimiser and scheduler."""
        later = None if self.scheduler is None else self.scheduler.state_dict()
        return {"optimiser": self.optimiser.state_dict(), "scheduler": later}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.optimiser.load_state_dict(dict(state["optimiser"]))
        if self.scheduler is not None:
            self.scheduler.load_state_dict(dict(state["scheduler"]))


def _made(given: Any, name: str, argument: Any) -> Any:
    """Return what a function makes of its argument, or a mapping with ``_target_`` of an argument of this name."""
    try:
        return given(argument) if callable(given) else instantiate({**given, "_partial_": True})(**{name: argument})
    except (TypeError, ValueError, KeyError) as error:
        raise InputRefused(f"the {'optimiser' if name == 'params' else 'scheduler'} cannot be made: {error}") from error


class QuasiNewton:
    """Several iterations of L-BFGS with a strong Wolfe line search (Liu & Nocedal 1989)."""

    def __init__(self, objective: Objective, iterations: int) -> None:
        self.objective = objective
        self.optimiser = torch.optim.LBFGS(
            objective.trained(), max_iter=iterations, history_size=_HISTORY, line_search_fn="strong_wolfe"
        )

    def __call__(self, epoch: int) -> float:
        """Return the iterations up to the limit."""
        first: list[float] = []

        def closure() -> Tensor:
            try:
                loss = with_gradients(self.objective)
            except SolverFailed:
                if not first:
                    raise
                for p in self.objective.trained():
                    p.grad = torch.zeros_like(p)
                return torch.tensor(_BAD * first[0], dtype=torch.float64)
            first.append(float(loss))
            return loss

        step: Callable[[Callable[[], Tensor]], Any] = self.optimiser.step
        step(closure)
        return first[0]

    def state_dict(self) -> dict[str, Any]:
        """Return the history of gradients and steps."""
        return self.optimiser.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.optimiser.load_state_dict(dict(state))


# One epoch a call, which returns the loss before it; what the next one depends on beside the parameters is its state.
Method = GaussNewton | QuasiNewton | Stepwise
