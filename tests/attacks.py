"""Optimisers that train a subject on objectives at random, or against passivity, and what is violated afterwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from subjects import Subject
from torch import Tensor

from phnn.errors import SolverFailed

OPTIMISERS: dict[str, Callable[[list[Tensor]], torch.optim.Optimizer]] = {
    "adam": lambda p: torch.optim.Adam(p, 0.1),
    "sgd": lambda p: torch.optim.SGD(p, 10.0),
    "lbfgs": lambda p: torch.optim.LBFGS(p, 1.0, max_iter=2),
}
OBJECTIVES = ("random", "hostile")
# What is lost to rounding, relative to the sum of the absolute terms.
ROUNDING = {torch.float64: 1e-11, torch.float32: 2e-4}
# Beyond these multiples of typical states, products of states, stiffnesses and weights leave the numbers' range.
REACH = {torch.float64: 1e6, torch.float32: 1e2}
_FEW = 16


def objective(subject: Subject, kind: str, seed: int) -> Tensor:
    """() a loss: any rates at random; or energies below that at rest and powers that come out of the dissipation."""
    x, u = subject.states(_FEW, seed, 1.0)
    m = subject.module
    efforts = m.efforts(x)
    if kind == "hostile":
        return relative(m.energy(x)) + relative(subject.lost(efforts, x))
    wanted = torch.randn(efforts.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    rate = subject.balanced_rate(efforts, x, u)
    scale = rate.detach().abs().mean() + 1e-30
    return (rate / scale - wanted.to(rate.dtype)).square().mean() + relative(m.energy(x)) * wanted[0, 0].to(rate.dtype)


def relative(values: Tensor) -> Tensor:
    """() the mean over its present size, so that its gradient by relative changes is of order one."""
    return (values / (values.detach().abs().mean() + 1e-30)).mean()


def train(subject: Subject, optimiser: str, kind: str, steps: int, seed: int = 0) -> str:
    """Take steps, each towards other states; what the evaluation said where it refused to go on, else nothing."""
    parameters = [p for p in subject.module.parameters() if p.requires_grad]
    if not parameters:
        return ""
    method = OPTIMISERS[optimiser](parameters)
    for step in range(steps):

        def closure(step: int = step) -> Tensor:
            method.zero_grad()
            loss = objective(subject, kind, seed + step)
            if loss.requires_grad:
                loss.backward()
            return loss

        try:
            method.step(closure)
        except SolverFailed as error:
            return str(error)
    return ""


@dataclass
class Violations:
    """How many of the states violate what."""

    dissipation: int = 0
    skew: int = 0
    energy: int = 0
    balance: int = 0
    infinite: int = 0

    def __bool__(self) -> bool:
        return any(vars(self).values())


@torch.no_grad()
def violations(subject: Subject, count: int, seed: int = 1) -> Violations:
    """Count states at which ``D``, ``J``, ``H``, the balance of a step or a number are not what they must be."""
    m = subject.module
    dtype = next(m.parameters()).dtype
    eps = ROUNDING[dtype]
    a, u = subject.states(count, seed, REACH[dtype])
    b, _ = subject.states(count, seed + 7, REACH[dtype])
    d, j, energy = m.dissipation(a), m.structure(a), m.energy(a)
    found = Violations()
    values = (d, j, energy, m.efforts(a), m.mean_efforts(a, b))
    finite = torch.stack([torch.isfinite(v).reshape(count, -1).all(-1) for v in values]).all(0)
    found.infinite = int((~finite).sum())
    least = torch.linalg.eigvalsh((0.5 * (d + d.mT))[finite].double())
    found.dissipation = int((least[:, 0] < -eps * least.abs().amax(-1)).sum())
    found.skew = int((j + j.mT != 0.0).reshape(count, -1).any(-1).sum())
    found.energy = int((energy < m.energy(torch.zeros_like(a))).sum())
    # The step: its work is the change of energy, and its power what the ports supply less what is lost.
    efforts = m.mean_efforts(a, b)
    energies = efforts.shape[-1]
    work = efforts * (b - a)[..., :energies]
    change = m.energy(b) - energy
    off = (work.sum(-1) - change).abs() > eps * (work.abs().sum(-1) + energy + m.energy(b))
    middle = 0.5 * (a + b)
    terms = efforts * subject.balanced_rate(efforts, middle, u)
    lost, supplied = subject.lost(efforts, middle), subject.supplied(efforts, middle, u)
    exchanged = (efforts.abs().unsqueeze(-2) @ m.structure(middle).abs() @ efforts.abs().unsqueeze(-1)).squeeze(
        (-1, -2)
    )
    size = terms.abs().sum(-1) + lost.abs() + supplied.abs() + exchanged
    off |= (terms.sum(-1) - supplied + lost).abs() > eps * size
    off |= lost < -eps * size
    found.balance = int(off.sum())
    return found
