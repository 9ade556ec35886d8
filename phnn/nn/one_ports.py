"""Learned one-ports that are passive whatever their weights: damping, monotone resistors, convex energies.

Every module holds dimensionless weights, which stay near one for any SI magnitudes, and evaluates an additive-unit
law (`phnn.laws.wide`) with the physical ones, ``weights()``; the compiled kernel evaluates the same law with the same
vector. One hidden layer is enough for a scalar argument: every monotone function on an interval is a limit of positive
sums of steps, every convex one of positive sums of hinges.

References: Amos, Xu & Kolter 2017 (input convex networks); Runje & Shankaranarayana 2023 (monotone networks
with convex, concave and saturating units); Barron 2021 (squareplus).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from phnn.errors import InputRefused
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, evaluated, register_compiled
from phnn.network.bounded import LARGEST_WEIGHT, check_weights


def _positive(raw: Tensor) -> Tensor:
    """Return the softplus to the last digit; torch's default turns linear at 20, where that is an error of 2e-9."""
    return functional.softplus(raw, threshold=50.0)


def _raw(positive: Tensor) -> nn.Parameter:
    """Return the parameter whose softplus is the given positive tensor."""
    return nn.Parameter(torch.log(torch.expm1(positive)))


def _full(value: float, *shape: int) -> Tensor:
    return torch.full(shape, value, dtype=torch.float64)


def _spread(width: int, reach: float) -> Tensor:
    """Return (width,) even positions on ``[−reach, reach]``, none at zero for an even width."""
    return torch.linspace(-reach, reach, width, dtype=torch.float64)


def _flat(law: nn.Module, head: Tensor, *of_units: Tensor) -> Tensor:
    """Join ``[head, w_1, w_2, …]`` from a head of one weight and (U,) tensors of every kind of unit weight."""
    check_weights(law, largest=LARGEST_WEIGHT)
    return torch.cat([head.reshape(1), torch.stack(of_units, dim=-1).reshape(-1)])


def scales(name: str, given: float | Sequence[float], count: int = 1) -> Tensor:
    """Return the (count,) typical magnitudes, one for all or one each.

    Raises:
        InputRefused: one is not positive, or there are others than ``count``.
    """
    scale = torch.as_tensor(given, dtype=torch.float64)
    if scale.ndim > 1 or (scale.ndim and len(scale) != count) or not bool(((scale > 0.0) & scale.isfinite()).all()):
        raise InputRefused(f"{name} = {given}: give a positive typical magnitude in SI units, or {count} of them")
    return scale.expand(count).clone()


def _check(width: int) -> None:
    if width < 1:
        raise InputRefused(f"width = {width}: a learned law needs at least one unit")


class _Units:
    """An additive-unit law, by its name, with the module's physical weights; a resistor, unless it says otherwise."""

    law: str
    positions: nn.Parameter
    weights: Callable[[], Tensor]

    @property
    def units(self) -> int:
        """Return the number of units."""
        return self.positions.shape[-1]

    def forward(self, effort: Tensor) -> Tensor:  # effort: (...)
        """Return (...) flow ``φ(ε)``."""
        return evaluated(WIDE_RESISTORS[self.law], self.weights(), effort)


class SectorMLP(_Units, nn.Module):
    """A sign-constrained resistor that may be silent on whole intervals and need not be monotone.

        φ(ε) = g ε max(c₀ + Σ_i (w_i/√U) tanh(k_i z + c_i), 0),   z = ε/s,   g = flow_scale/effort_scale,

    hence ``ε φ(ε) ≥ 0`` for every weight. It starts as a resistor of conductance near ``g/2``: where the sum is
    positive everything gets a gradient, and a dead zone opens where the data push it below zero. Divided by the root
    of their number ``U``, the units cannot push it there all at once at a usual rate of training. Their centres are
    spread over ``|ε| ≤ 2.5 s`` so that the edge and the slope outside it can be resolved from the start.

    Args:
        effort_scale: typical effort ``s``, SI.
        flow_scale: typical flow, SI.
        width: number of units.
        symmetric: make ``φ`` odd by feeding ``|ε|/s``.
        seed: of the initial weights.

    Raises:
        InputRefused: a scale that is not positive, or no unit.
    """

    scale: Tensor
    conductance: Tensor

    def __init__(
        self, effort_scale: float, flow_scale: float, width: int = 32, symmetric: bool = False, seed: int = 0
    ) -> None:
        super().__init__()
        _check(width)
        self.law = "symmetric_damping" if symmetric else "damping"
        self.monotone = WIDE_RESISTORS[self.law].monotone
        self.register_buffer("scale", scales("effort_scale", effort_scale)[0])
        self.register_buffer("conductance", scales("flow_scale", flow_scale)[0] / self.scale)
        random = torch.Generator().manual_seed(seed)
        gains = 1.0 + torch.rand(width, generator=random, dtype=torch.float64)
        self.offset = nn.Parameter(_full(0.5))
        self.heights = nn.Parameter(_full(0.0, width).uniform_(-0.7, 0.7, generator=random))
        self.gains = nn.Parameter(gains)
        self.positions = nn.Parameter(-gains * _spread(width, 2.5))

    def weights(self) -> Tensor:
        """Return (1 + 3U,) physical weights ``[g c₀, g w_1/√U, k_1/s, c_1, …]``."""
        g, scale = self.conductance.abs(), self.scale.abs()  # of either sign in a state that is loaded
        return _flat(self, g * self.offset, g / self.units**0.5 * self.heights, self.gains / scale, self.positions)


class MonotoneMLP(_Units, nn.Module):
    """A monotone resistor through the origin, hence a sector law whose implicit step has one root.

        φ(ε)/f = a z + Σ_i w_i [σ(k_i z + c_i) − σ(c_i)]
                 + Σ_j w_j [S(k_j z − c_j) − S(−c_j)] − Σ_l w_l [S(−k_l z − c_l) − S(−c_l)],   z = ε/s

    with all of ``a, w, k > 0``, ``S(y) = (y + √(4 + y²))/2`` (hinges: dead zones with a slope outside, growing
    without bound) and its derivative ``σ`` (steps: saturation, dry friction).

    Args:
        effort_scale: typical effort ``s``, SI.
        flow_scale: typical flow ``f``, SI.
        width: number of steps, and of hinges of each direction.

    Raises:
        InputRefused: a scale that is not positive, or no unit.
    """

    law, monotone = "monotone", WIDE_RESISTORS["monotone"].monotone
    scale: Tensor
    flow: Tensor

    def __init__(self, effort_scale: float, flow_scale: float, width: int = 8) -> None:
        super().__init__()
        _check(width)
        self.register_buffer("scale", scales("effort_scale", effort_scale)[0])
        self.register_buffer("flow", scales("flow_scale", flow_scale)[0])
        outer = _spread(2 * width, 2.5)[width:]
        self.slope = _raw(_full(0.1))
        # Rows: steps, hinges that rise to the right, hinges that rise to the left.
        self.heights = _raw(_full(0.5 / width, 3, width))
        self.gains = _raw(_full(4.0, 3, width))
        self.positions = nn.Parameter(4.0 * torch.stack([_spread(width, 2.5), outer, outer]))

    def weights(self) -> Tensor:
        """Return (1 + 9U,) physical weights ``[f a/s, f w_1, k_1/s, c_1, …]``, three weights for each row of a unit."""
        flow, scale = self.flow.abs(), self.scale.abs()
        heights, gains = flow * _positive(self.heights), _positive(self.gains) / scale
        rows = zip(heights, gains, self.positions, strict=True)
        return _flat(self, flow / scale * _positive(self.slope), *(w for row in rows for w in row))


class ConvexEnergyMLP(_Units, nn.Module):
    """A convex energy with its minimum of zero at zero, so that the network stays passive.

        H(x) = E s { a z²/2 + Σ_i (w_i/k_i) [S(k_i z + c_i) − S(c_i) − σ(c_i) k_i z] },   z = x/s
        H'(x) = E { a z + Σ_i w_i [σ(k_i z + c_i) − σ(c_i)] },                a, w, k > 0

    with ``S(y) = (y + √(4 + y²))/2`` and its derivative ``σ``. Each bracket is a convex function less its tangent at
    zero. The mean effort of a step is the difference quotient in closed form, without cancellation.

    Args:
        state_scale: typical energy variable ``s``, SI.
        effort_scale: typical effort ``E``, SI.
        width: number of units.

    Raises:
        InputRefused: a scale that is not positive, or no unit.
    """

    law, convex = "convex", WIDE_STORAGES["convex"].monotone
    scale: Tensor
    typical: Tensor

    def __init__(self, state_scale: float, effort_scale: float, width: int = 16) -> None:
        super().__init__()
        _check(width)
        self.register_buffer("scale", scales("state_scale", state_scale)[0])
        self.register_buffer("typical", scales("effort_scale", effort_scale)[0])
        self.curvature = _raw(_full(0.5))
        self.heights = _raw(_full(2.0 / width, width))
        self.gains = _raw(_full(3.0, width))
        self.positions = nn.Parameter(3.0 * _spread(width, 2.0))

    def weights(self) -> Tensor:
        """Return (1 + 3U,) physical weights ``[E a/s, E w_1, k_1/s, c_1, …]``."""
        typical, scale = self.typical.abs(), self.scale.abs()
        heights, gains = typical * _positive(self.heights), _positive(self.gains) / scale
        return _flat(self, typical / scale * _positive(self.curvature), heights, gains, self.positions)

    def energy(self, x: Tensor) -> Tensor:  # x: (...)
        """Return (...) ``H(x)``."""
        return x * self.mean_effort(0.0 * x, x)

    def mean_effort(
        self,
        a: Tensor,  # (...) energy variable at the start of a step
        b: Tensor,  # (...) and at its end
    ) -> Tensor:
        """Return (...) ``(H(b) − H(a))/(b − a)``, and ``H'(a)`` where ``b = a``."""
        return evaluated(WIDE_STORAGES[self.law], self.weights(), a, b)

    def forward(self, x: Tensor) -> Tensor:  # x: (...)
        """Return (...) effort ``H'(x)``."""
        return self.mean_effort(x, x)


register_compiled(SectorMLP, "damping", "symmetric_damping")
register_compiled(MonotoneMLP, "monotone")
register_compiled(ConvexEnergyMLP, "convex")
