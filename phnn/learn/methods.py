"""The optimisers as methods of one epoch each, with all of their state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.learn.gauss_newton import GaussNewton
from phnn.learn.objective import Objective
from phnn.learn.settings import Settings

METHODS = ("adam", "lbfgs", "gauss_newton")

_LEAST_RATE = 0.01
_HISTORY = 30
# A trial of a line search that cannot be simulated counts as this many times the loss at its start.
_BAD = 1e3


class Method(Protocol):
    """One epoch at a time."""

    def __call__(self, epoch: int) -> float:
        """Take one epoch of the method; the loss before it."""

    def state_dict(self) -> dict[str, Any]:
        """All that the next epoch depends on beside the parameters."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""


def method_of(name: str, objective: Objective, settings: Settings, factor: float) -> Method:
    """A method by its name; ``factor`` lowers the rate of learning after failures."""
    if name == "gauss_newton":
        return GaussNewton(objective)
    if name == "lbfgs":
        return QuasiNewton(objective, settings.lbfgs_iterations)
    return Adam(objective, settings.rate * factor, settings.adam)


def with_gradients(objective: Objective) -> Tensor:
    """() the loss, gradients left in ``.grad`` of all that is trained.

    Raises:
        SolverFailed: the model could not be simulated, or loss or gradient are not finite.
    """
    objective.zero_grad()
    loss = objective()
    loss.backward()
    gradients = [p.grad for p in objective.trained() if p.grad is not None]
    if not bool(torch.isfinite(loss)) or not all(bool(torch.isfinite(g).all()) for g in gradients):
        value = float(loss.detach())
        raise SolverFailed(f"the loss is {value:g} or its gradient not finite: lower the rate of learning")
    return loss.detach()


class Adam:
    """Adam along a cosine from the full rate to a hundredth of it (Kingma & Ba 2015; Loshchilov & Hutter 2017)."""

    def __init__(self, objective: Objective, rate: float, epochs: int) -> None:
        self.objective, self.rate, self.epochs = objective, rate, epochs
        self.optimiser = torch.optim.Adam(objective.trained(), lr=rate)

    def now(self, epoch: int) -> float:
        """The rate of an epoch."""
        share = 0.5 * (1.0 + math.cos(math.pi * epoch / self.epochs))
        return self.rate * (_LEAST_RATE + (1.0 - _LEAST_RATE) * share)

    def __call__(self, epoch: int) -> float:
        """One step."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.now(epoch)
        loss = with_gradients(self.objective)
        self.optimiser.step()
        return float(loss)

    def state_dict(self) -> dict[str, Any]:
        """Moments and step counts."""
        return self.optimiser.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.optimiser.load_state_dict(dict(state))


class QuasiNewton:
    """Several iterations of L-BFGS with a strong Wolfe line search (Liu & Nocedal 1989)."""

    def __init__(self, objective: Objective, iterations: int) -> None:
        self.objective = objective
        self.optimiser = torch.optim.LBFGS(
            objective.trained(), max_iter=iterations, history_size=_HISTORY, line_search_fn="strong_wolfe"
        )

    def __call__(self, epoch: int) -> float:
        """Iterations up to the limit."""
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
        """History of gradients and steps."""
        return self.optimiser.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.optimiser.load_state_dict(dict(state))
