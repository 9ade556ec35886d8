"""Networks of several sizes trained with Adam under one budget, each stopped by the samples set aside.

Every size gets the same share; the best one goes on with the rest. The learning rate falls as half a cosine over a
training's time. What counts is the state with the least error on the samples set aside, not the last one.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from phnn.errors import SolverFailed
from studies.rival_models.budget import Budget

_SEARCH = 0.6  # share of the budget for all sizes together
_RATE, _LEAST = 5e-3, 2e-4  # learning rate, at the beginning and at the end
_CHECKS = 30  # of the samples set aside in a training
_CLIP = 1.0  # norm of the gradient


class Trained(ABC):
    """A network with its loss on the fitted samples, and its error over noise on those set aside."""

    module: nn.Module

    @abstractmethod
    def loss(self) -> Tensor:
        """Mean square of the scaled residual on a batch."""

    @abstractmethod
    def check(self) -> float:
        """Residual over noise on the samples set aside, in free simulation; infinite where it diverged."""


@dataclass(frozen=True)
class Best:
    """The best network: what trained it, its size, its error, updates taken, and how many sizes were tried."""

    trained: Any
    size: Any
    score: float
    updates: int
    tried: int


def search(build: Callable[[Any], Trained], sizes: Sequence[Any], budget: Budget, seed: int) -> Best:
    """Train all sizes, then the best one further.

    Raises:
        SolverFailed: no network could be simulated.
    """
    torch.manual_seed(seed)
    found: list[tuple[float, int, Any, Trained]] = []
    updates = 0
    for k, size in enumerate(sizes):
        share = _SEARCH / len(sizes) / (1.0 - _SEARCH * k / len(sizes))
        trained = build(size)
        score, count = train(trained, budget.part(share), _RATE)
        updates += count
        found.append((score, k, size, trained))
        if budget.left <= 0.0:
            break
    score, _, size, trained = min(found, key=lambda f: (f[0], f[1]))
    if budget.left > 0.0:
        before = copy.deepcopy(trained.module.state_dict())
        again, count = train(trained, budget, 0.5 * _RATE)
        updates += count
        if again >= score:
            trained.module.load_state_dict(before)
        score = min(score, again)
    if not np.isfinite(score):
        raise SolverFailed("no network stayed finite in simulation: allow more time, or scale the recordings")
    return Best(trained, size, score, updates, len(found))


def train(trained: Trained, budget: Budget, rate: float) -> tuple[float, int]:
    """Train until the budget or the number of updates is spent; leaves the best state in the module.

    Returns:
        Its error on the samples set aside, and the number of updates.
    """
    optimiser = torch.optim.Adam(trained.module.parameters(), lr=rate)
    best, kept = trained.check(), copy.deepcopy(trained.module.state_dict())
    checked, count = 0.0, 0
    while True:
        progress = count / budget.most
        if math.isfinite(budget.seconds):
            progress = max(progress, budget.used / max(budget.seconds, 1e-9))
        if progress - checked >= 1.0 / _CHECKS or progress >= 1.0:
            checked, score = progress, trained.check()
            if score < best:
                best, kept = score, copy.deepcopy(trained.module.state_dict())
        if progress >= 1.0:
            break
        for group in optimiser.param_groups:
            group["lr"] = _LEAST + 0.5 * max(rate - _LEAST, 0.0) * (1.0 + math.cos(math.pi * progress))
        optimiser.zero_grad()
        loss = trained.loss()
        loss.backward()
        nn.utils.clip_grad_norm_(trained.module.parameters(), _CLIP)
        optimiser.step()
        count += 1
    trained.module.load_state_dict(kept)
    return best, count
