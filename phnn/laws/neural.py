"""Learned one-ports that are passive whatever their weights: damping, monotone resistors, convex energies.

Every law works on ``z = ε/s`` and returns multiples of a typical flow or effort, so that weights stay near one
for SI magnitudes of any size. One hidden layer is enough for a scalar argument: every monotone function on an
interval is a limit of positive sums of steps, every convex one of positive sums of hinges.

References: Amos, Xu & Kolter 2017 (input convex networks); Runje & Shankaranarayana 2023 (monotone networks
with convex, concave and saturating units).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from phnn.errors import InputRefused

_SERIES = 1e-3


def _softplus(x: Tensor) -> Tensor:
    """``S(x) = log(1 + eˣ)``; torch's default turns linear at 20, an error of 2e-9 that breaks the power balance."""
    return functional.softplus(x, threshold=50.0)


def _sigmoid_rise(c: Tensor, d: Tensor) -> Tensor:
    """``σ(c + d) − σ(c)`` without cancellation for small ``d``."""
    near = d.abs() < 1.0
    s, e = torch.sigmoid(c), torch.expm1(torch.where(near, d, 0.0))
    return torch.where(near, s * torch.sigmoid(-c) * e / (1.0 + s * e), torch.sigmoid(c + d) - s)


def _softplus_rise(c: Tensor, d: Tensor) -> Tensor:
    """``S(c + d) − S(c)`` without cancellation for small ``d``."""
    near = d.abs() < 1.0
    small = torch.log1p(torch.sigmoid(c) * torch.expm1(torch.where(near, d, 0.0)))
    return torch.where(near, small, _softplus(c + d) - _softplus(c))


def _softplus_mean(c: Tensor, d: Tensor) -> Tensor:
    """``(S(c + d) − S(c))/d``, tending to ``σ(c)``."""
    tiny = d.abs() < _SERIES
    s = torch.sigmoid(c)
    v = s * torch.sigmoid(-c)
    series = s + d * (v / 2.0 + d * (v * (1.0 - 2.0 * s) / 6.0 + d * v * (1.0 - 6.0 * v) / 24.0))
    apart = torch.where(tiny, 1.0, d)
    return torch.where(tiny, series, _softplus_rise(c, apart) / apart)


def _softplus_excess(c: Tensor, d: Tensor) -> Tensor:
    """``S(c + d) − S(c) − σ(c) d ≥ 0``: what a convex function has above its tangent."""
    tiny = d.abs() < _SERIES
    s = torch.sigmoid(c)
    v = s * torch.sigmoid(-c)
    series = d * d * v * (0.5 + d * ((1.0 - 2.0 * s) / 6.0 + d * (1.0 - 6.0 * v) / 24.0))
    apart = torch.where(tiny, 1.0, d)
    return torch.where(tiny, series, _softplus_rise(c, apart) - s * apart)


def _raw(positive: Tensor) -> nn.Parameter:
    """The parameter whose softplus is the given positive tensor."""
    return nn.Parameter(torch.log(torch.expm1(positive)))


def _spread(width: int, reach: float) -> Tensor:
    """(width,) even positions on ``[−reach, reach]``, none at zero for an even width."""
    return torch.linspace(-reach, reach, width, dtype=torch.float64)


def _check_scales(**scales: float) -> None:
    for name, scale in scales.items():
        if not 0.0 < scale < float("inf"):
            raise InputRefused(f"{name} = {scale:g}: give a positive typical magnitude in SI units")


class DampingMLP(nn.Module):
    """A sign-constrained resistor that may be silent on whole intervals and need not be monotone.

        φ(ε) = g ε max(N(ε/s), 0),   g = flow_scale/effort_scale,   hence ε φ(ε) ≥ 0 for every weight

    It starts as a resistor of conductance ``g/2``: where ``N`` is positive everything gets a gradient, and a
    dead zone opens where the data push ``N`` below zero. The kinks of the first layer are spread over
    ``|ε| ≤ 2.5 s`` so that its edge and the slope outside it can be resolved from the start.

    Args:
        effort_scale: typical effort ``s``, SI.
        flow_scale: typical flow, SI.
        hidden: widths of the hidden layers.
        symmetric: make ``φ`` odd by feeding ``|ε|/s``.
        seed: of the initial weights.

    Raises:
        InputRefused: a scale that is not positive.
    """

    conductance: Tensor
    scale: Tensor

    def __init__(
        self,
        effort_scale: float,
        flow_scale: float,
        hidden: Sequence[int] = (16, 16),
        symmetric: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__()
        _check_scales(effort_scale=effort_scale, flow_scale=flow_scale)
        self.symmetric = symmetric
        self.register_buffer("scale", torch.tensor(effort_scale, dtype=torch.float64))
        self.register_buffer("conductance", torch.tensor(flow_scale / effort_scale, dtype=torch.float64))
        random = torch.Generator().manual_seed(seed)
        widths = (1, *hidden, 1)
        layers = [nn.Linear(a, b, dtype=torch.float64) for a, b in pairwise(widths)]
        first, last = layers[0], layers[-1]
        with torch.no_grad():
            for layer in layers:
                bound = (6.0 / (layer.in_features + layer.out_features)) ** 0.5
                layer.weight.uniform_(-bound, bound, generator=random)
                layer.bias.zero_()
            first.weight.copy_(1.0 + torch.rand(first.weight.shape, generator=random, dtype=torch.float64))
            first.bias.copy_(-first.weight[:, 0] * _spread(first.out_features, 2.5))
            last.weight.mul_(0.3)
            last.bias.fill_(0.5)
        self.layers = nn.ModuleList(layers)

    def forward(self, effort: Tensor) -> Tensor:  # effort: (...)
        """(...) flow ``φ(ε)``."""
        z = (effort / self.scale).unsqueeze(-1)
        z = z.abs() if self.symmetric else z
        for layer in self.layers[:-1]:
            z = torch.tanh(layer(z))
        return self.conductance * effort * torch.relu(self.layers[-1](z).squeeze(-1))


class MonotoneMLP(nn.Module):
    """A monotone resistor through the origin, hence a sector law whose implicit step has one root.

        φ(ε)/f = a z + Σ_i w_i [σ(k_i z + c_i) − σ(c_i)]
                 + Σ_j w_j [S(k_j z − c_j) − S(−c_j)] − Σ_l w_l [S(−k_l z − c_l) − S(−c_l)],   z = ε/s

    with all of ``a, w, k > 0``, σ the logistic function (saturation, dry friction) and ``S`` its integral
    (hinges: dead zones with a slope outside, growing without bound).

    Args:
        effort_scale: typical effort ``s``, SI.
        flow_scale: typical flow ``f``, SI.
        width: number of units of each of the three kinds.

    Raises:
        InputRefused: a scale that is not positive.
    """

    monotone = True
    scale: Tensor
    flow: Tensor

    def __init__(self, effort_scale: float, flow_scale: float, width: int = 8) -> None:
        super().__init__()
        _check_scales(effort_scale=effort_scale, flow_scale=flow_scale)
        self.register_buffer("scale", torch.tensor(effort_scale, dtype=torch.float64))
        self.register_buffer("flow", torch.tensor(flow_scale, dtype=torch.float64))
        ones = torch.ones(3, width, dtype=torch.float64)
        self.slope = _raw(torch.tensor(0.1, dtype=torch.float64))
        self.weights = _raw(ones * 0.5 / width)
        self.gains = _raw(ones * 4.0)
        positions = torch.stack([_spread(width, 2.5), *[_spread(2 * width, 2.5)[width:]] * 2])
        self.positions = nn.Parameter(4.0 * positions)

    def forward(self, effort: Tensor) -> Tensor:  # effort: (...)
        """(...) flow ``φ(ε)``."""
        z = (effort / self.scale).unsqueeze(-1)
        w, k, c = _softplus(self.weights), _softplus(self.gains), self.positions
        steps = w[0] * _sigmoid_rise(c[0], k[0] * z)
        above = w[1] * _softplus_rise(-c[1], k[1] * z)
        below = w[2] * _softplus_rise(-c[2], -k[2] * z)
        return self.flow * (_softplus(self.slope) * z.squeeze(-1) + (steps + above - below).sum(-1))


class EnergyMLP(nn.Module):
    """A convex energy with its minimum of zero at zero, so that the network stays passive.

        H(x) = E s { a z²/2 + Σ_i (w_i/k_i) [S(k_i z + c_i) − S(c_i) − σ(c_i) k_i z] },   z = x/s
        H'(x) = E { a z + Σ_i w_i [σ(k_i z + c_i) − σ(c_i)] },                a, w, k > 0

    Each bracket is a convex function less its tangent at zero. The mean effort of a step is the difference
    quotient in closed form, without cancellation.

    Args:
        state_scale: typical energy variable ``s``, SI.
        effort_scale: typical effort ``E``, SI.
        width: number of units.

    Raises:
        InputRefused: a scale that is not positive.
    """

    convex = True
    scale: Tensor
    typical: Tensor

    def __init__(self, state_scale: float, effort_scale: float, width: int = 16) -> None:
        super().__init__()
        _check_scales(state_scale=state_scale, effort_scale=effort_scale)
        self.register_buffer("scale", torch.tensor(state_scale, dtype=torch.float64))
        self.register_buffer("typical", torch.tensor(effort_scale, dtype=torch.float64))
        self.curvature = _raw(torch.tensor(0.5, dtype=torch.float64))
        self.weights = _raw(torch.full((width,), 2.0 / width, dtype=torch.float64))
        self.gains = _raw(torch.full((width,), 3.0, dtype=torch.float64))
        self.positions = nn.Parameter(3.0 * _spread(width, 2.0))

    def energy(self, x: Tensor) -> Tensor:  # x: (...)
        """(...) ``H(x)``."""
        z = x / self.scale
        w, k = _softplus(self.weights), _softplus(self.gains)
        hinges = (w / k * _softplus_excess(self.positions, k * z.unsqueeze(-1))).sum(-1)
        return self.typical * self.scale * (0.5 * _softplus(self.curvature) * z * z + hinges)

    def mean_effort(
        self,
        a: Tensor,  # (...) energy variable at the start of a step
        b: Tensor,  # (...) and at its end
    ) -> Tensor:
        """(...) ``(H(b) − H(a))/(b − a)``, and ``H'(a)`` where ``b = a``."""
        start, end = (a / self.scale).unsqueeze(-1), (b / self.scale).unsqueeze(-1)
        w, k, c = _softplus(self.weights), _softplus(self.gains), self.positions
        rise = _softplus_mean(c + k * start, k * (end - start)) - torch.sigmoid(c)
        linear = 0.5 * _softplus(self.curvature) * (start + end).squeeze(-1)
        return self.typical * (linear + (w * rise).sum(-1))

    def forward(self, x: Tensor) -> Tensor:  # x: (...)
        """(...) effort ``H'(x)``."""
        return self.mean_effort(x, x)
