"""Random hysteron actuators with all kinds of damping laws whose zeros form one interval, for tests of Sec. 2.3.

What the paper writes is written here once more, from parameter values and with functions of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from phnn.models.actuator import hrc
from phnn.network import Network, Resistor
from phnn.nn import MonotoneMLP, SectorMLP

Law = Callable[[Tensor], Tensor]
# Laws that compiled code knows; `Slot` is one that a user would write.
COMPILED = ("dead_zone", "linear", "quadratic_drag", "monotone", "symmetric", "window")
ALL = (*COMPILED, "slot")


class Slot(nn.Module):
    """Silent on ``[lo, hi]``; outside, at the distance ``s`` from it, ``φ = ρ s (1 + r sin(s/w))``: rising and falling.

    With ``|r| < 1`` a sector law whose zeros are one interval, in general neither symmetric nor monotone.
    """

    def __init__(self, low: float, high: float, rho: float, ripple: float, period: float) -> None:
        super().__init__()
        self.low, self.high, self.rho, self.ripple, self.period = low, high, rho, ripple, period

    def forward(self, effort: Tensor) -> Tensor:
        s = effort - effort.clamp(self.low, self.high)
        return self.rho * s * (1.0 + self.ripple * torch.sin(s / self.period))


def window(low: float, high: float, flow: float, sharpness: float, slopes: Sequence[float] = (1.0, 1.0)) -> SectorMLP:
    """``φ = g ε max(1 + tanh(k (ε − hi)) − tanh(k (ε − lo)), 0)``, silent at zero and nearly on ``[lo, hi]``.

    The sum falls and then rises, so that it is negative on one interval. Where zero lies outside of ``[lo, hi]``, the
    zeros of the law are separated. With ``slopes`` the conductances on the left and on the right are these times ``g``.
    """
    width = high - low
    law, (left, right) = SectorMLP(width, flow, 2), slopes
    with torch.no_grad():
        law.offset.fill_(0.5 * (left + right))
        law.heights.copy_(2.0**0.5 * torch.tensor([0.75 * right + 0.25 * left, -0.25 * right - 0.75 * left]))
        law.gains.fill_(sharpness)
        law.positions.copy_(-sharpness / width * torch.tensor([high, low], dtype=torch.float64))
    return law


def _symmetric(random: np.random.Generator, size: float, flow: float) -> SectorMLP:
    """A conductance that rises with ``|ε|``: silent on one symmetric interval, or at zero alone."""
    law = SectorMLP(size, flow, int(random.integers(1, 6)), symmetric=True, seed=int(random.integers(2**31)))
    with torch.no_grad():
        law.heights.abs_()
        law.offset.copy_(float(random.uniform(-0.9, 0.5)) * law.heights.sum() / law.units**0.5)
    return law


def _monotone(random: np.random.Generator, size: float, flow: float) -> MonotoneMLP:
    law = MonotoneMLP(size, flow, int(random.integers(1, 5)))
    with torch.no_grad():
        for weight in law.parameters():
            weight.add_(torch.from_numpy(np.asarray(random.normal(size=tuple(weight.shape)))))
    return law


def edge(law: Law, reach: float) -> float:
    """The end of the interval of zeros towards ``reach``, where the law is not silent, by finer and finer grids."""
    silent, loud = 0.0, reach
    with torch.no_grad():
        for _ in range(6):
            grid = torch.linspace(silent, loud, 1001, dtype=torch.float64)
            first = int((law(grid) != 0.0).to(torch.int8).argmax())
            silent, loud = grid[max(first - 1, 0)].item(), grid[first].item()
    return silent


@dataclass(frozen=True)
class Actuator:
    """An actuator and what the paper says about it.

    Attributes:
        network: states ``Q_1 … Q_n, q, p``.
        laws: the ``h_i⁻¹``.
        zeros: (n, 2) the intervals on which they vanish [V].
        sizes: (n,) typical voltages of the hysterons.
    """

    network: Network
    laws: tuple[Law, ...]
    zeros: Tensor
    sizes: Tensor

    def value(self, name: str) -> float:
        return self.network.parameters[name].value

    @property
    def n(self) -> int:
        return len(self.laws)

    @property
    def capacities(self) -> Tensor:
        """(n,) ``C_i``."""
        return torch.tensor([self.value(f"C_{i + 1}") for i in range(self.n)], dtype=torch.float64)

    @property
    def weights(self) -> Tensor:
        """(n+2,) the diagonal of 𝓗 in (9)."""
        mechanical = torch.tensor([self.value("k"), 1.0 / self.value("m")], dtype=torch.float64)
        return torch.cat([1.0 / self.capacities, mechanical])

    def losses(self, x: Tensor, x_star: Tensor) -> Tensor:  # x: (..., n+2)
        """(..., n+1) the terms of (17): those of the hysterons, then ``b (p/m)²``."""
        efforts, stars = self.weights * x, self.weights * x_star
        terms = [(efforts[..., i] - stars[..., i]) * law(efforts[..., i]) for i, law in enumerate(self.laws)]
        return torch.stack([*terms, self.value("b") * efforts[..., -1] ** 2], dim=-1)

    def equilibrium(self, u: Tensor, charges: Tensor) -> Tensor:  # u: (..., 2), charges: (..., n)
        """(..., n+2) the equilibrium (12)."""
        alpha, k = self.value("alpha"), self.value("k")
        held = (charges * self.weights[: self.n]).sum(-1)
        q = alpha / k * (u[..., 0] - held) - u[..., 1] / k
        return torch.cat([charges, q.unsqueeze(-1), torch.zeros_like(q).unsqueeze(-1)], dim=-1)

    def charges(self, random: np.random.Generator, count: int) -> Tensor:
        """(count, n) random charges inside the intervals of zeros, the ends among them."""
        share = torch.from_numpy(random.uniform(-0.2, 1.2, (count, self.n)).clip(0.0, 1.0))
        # An end that rounding pushes out would be none.
        efforts = (1.0 - 1e-12) * torch.lerp(self.zeros[:, 0], self.zeros[:, 1], share)
        return efforts / self.weights[: self.n]

    def nearest(self, x: Tensor, u: Tensor) -> Tensor:
        """(..., n+2) the equilibrium whose charges are those of a state, brought into the intervals of zeros."""
        inside = (1.0 - 1e-12) * self.zeros
        efforts = (self.weights[: self.n] * x[..., : self.n]).clamp(inside[:, 0], inside[:, 1])
        return self.equilibrium(u, efforts / self.weights[: self.n])

    def distance(self, x: Tensor, x_star: Tensor) -> Tensor:
        """(...) ``√H_L`` by (15)."""
        return (0.5 * self.weights * (x - x_star) ** 2).sum(-1).sqrt()

    def inputs(self, random: np.random.Generator, count: int) -> Tensor:
        """(count, 2) voltages and forces of the size that moves the hysterons, or none."""
        volts = (1.0 + float(self.sizes.sum())) * random.normal(size=(count, 2)) * random.choice([0.0, 1.0, 3.0])
        return torch.from_numpy(volts * np.array([1.0, self.value("alpha")]))

    def states(self, random: np.random.Generator, count: int) -> Tensor:
        """(count, n+2) states with comparable energies in all storages, hysterons inside and outside their zeros."""
        efforts = self.sizes * torch.from_numpy(random.normal(size=(count, self.n)))
        charges = efforts / self.weights[: self.n]
        energy = 1.0 + (0.5 * efforts * charges).sum(-1, keepdim=True)
        rest = torch.from_numpy(random.normal(size=(count, 2))) * (2.0 * energy / self.weights[self.n :]).sqrt()
        return torch.cat([charges, rest], dim=-1)


def random_actuator(seed: int, hysterons: int, kinds: Sequence[str] = ALL, decades: float = 2.0) -> Actuator:
    """An actuator that depends on the arguments alone, every parameter within some decades of one."""
    random = np.random.default_rng(seed)

    def spread() -> float:
        return float(10.0 ** random.uniform(-decades, decades))

    plain = hrc(hysterons)
    network = plain.with_values({name: spread() for name in plain.parameters})
    drawn = [_drawn(network, i + 1, str(random.choice(kinds)), random) for i in range(hysterons)]
    resistors = (*(resistor for resistor, _, _ in drawn), network.resistors[-1])
    zeros = np.array([ends for _, _, ends in drawn]).reshape(hysterons, 2)
    sizes = np.array([network.parameters[f"d_{i + 1}"].value for i in range(hysterons)])
    laws = tuple(law for _, law, _ in drawn)
    return Actuator(replace(network, resistors=resistors), laws, torch.from_numpy(zeros), torch.from_numpy(sizes))


def _drawn(
    network: Network, i: int, kind: str, random: np.random.Generator
) -> tuple[Resistor, Law, tuple[float, float]]:
    """The resistor of hysteron ``i``, its law and the interval on which that vanishes."""
    rho, d = (network.parameters[f"{name}_{i}"].value for name in ("rho", "d"))
    low, high = (-d * random.uniform(0.1, 1.0), d * random.uniform(0.1, 1.0))
    named: dict[str, tuple[tuple[str, ...], Law, tuple[float, float]]] = {
        "dead_zone": (
            (f"rho_{i}", f"d_{i}"),
            lambda e: rho * ((e - d / 2).clamp(min=0.0) + (e + d / 2).clamp(max=0.0)),
            (-d / 2, d / 2),
        ),
        "linear": ((f"rho_{i}",), lambda e: rho * e, (0.0, 0.0)),
        "quadratic_drag": ((f"rho_{i}",), lambda e: rho * e.abs() * e, (0.0, 0.0)),
    }
    on = {f"Q_{i}": 1.0}
    if kind in named:
        parameters, law, ends = named[kind]
        return Resistor(f"hysteron_{i}", kind, on, parameters), law, ends
    module = _module(kind, low, high, rho, d, random)
    return Resistor(f"hysteron_{i}", module, on), module, (edge(module, -20.0 * d), edge(module, 20.0 * d))


def _module(kind: str, low: float, high: float, rho: float, d: float, random: np.random.Generator) -> Any:
    if kind == "slot":
        return Slot(low, high, rho, random.uniform(-0.9, 0.9), d * random.uniform(0.05, 1.0))
    if kind == "window":
        return window(low, high, rho * (high - low), random.uniform(2.0, 10.0))
    return {"symmetric": _symmetric, "monotone": _monotone}[kind](random, d, rho * d)
