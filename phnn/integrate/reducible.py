"""A step of reducible storages in torch, batched and differentiable, by the rules of `phnn.integrate.scheme`.

    ẋ = i − φ(s x),     φ(ε) = Σ_r b_r φ_r(b_r ε, q̄_r)

under a constant current ``i``. The exact flow is `phnn.laws.leaf.rc_flow`, which the compiled kernel calls too. The
stages of Radau IIA are found without gradients, and one Newton step from them carries the derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from phnn.errors import SolverFailed
from phnn.integrate.cache import loop_entry
from phnn.integrate.partition import resistors_of
from phnn.integrate.roots import NOTHING, TOLERANCE
from phnn.integrate.stages import radau_defects
from phnn.integrate.table_access import NEAR_REST
from phnn.integrate.tables import EXACT, PATH
from phnn.laws import RESISTOR_LAWS
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.namespace import TINY
from phnn.network.system import PortHamiltonianSystem

# Newton steps for both stages at once; then each stage is searched in a bracket.
_QUICK = 15
# Steps of a bracketed search: half of them halve the bracket, down to neighbouring floats.
_BRACKETED = 250
# The precision that tolerances are stated for; and the multiple of rounding that a search may end with.
_DOUBLE, _NOISE = 2.2e-16, 45.0

Lost = Callable[[Tensor], Tensor]


class Surroundings(NamedTuple):
    """Quantities that the storages of a step share.

    Attributes:
        middle: (..., N) state that laws read at mid-step.
        branches: (n, R) or (..., n, R) ratios of the resistors.
        h: step [s], a number or (...).
    """

    system: PortHamiltonianSystem
    middle: Tensor
    branches: Tensor
    h: float | Tensor

    def losses(self, k: int) -> list[Lost]:
        """``ε ↦ b φ(b ε)`` of every resistor that acts on storage ``k`` alone, at efforts (...)."""
        return [self._loss(k, r) for r in resistors_of(self.system.network, self.system.state_names[k])]

    def lost(self, k: int, effort: Tensor) -> Tensor:
        """(...) flow into all resistors."""
        return sum((loss(effort) for loss in self.losses(k)), torch.zeros_like(effort))

    def _loss(self, k: int, r: int) -> Lost:
        ratio = self.branches[..., k, r]
        return lambda effort: ratio * self.system.branch_flow(r, ratio * effort, self.middle)


def advanced(
    around: Surroundings,
    k: int,
    rule: int,
    x: Tensor,  # (...) state at the start of the step
    current: Tensor,  # (...) constant inflow
    stages: tuple[Tensor, Tensor] | None = None,
) -> tuple[Tensor, Tensor]:
    """(...) end state and mean effort of storage ``k``.

    Args:
        rule: ``EXACT``, ``PATH`` or ``RADAU``.
        stages: the stages of Radau IIA, if they are known.
    """
    small = torch.full_like(current, NEAR_REST)
    stiffness = around.system.mean_effort(k, small, small) / NEAR_REST
    if rule == EXACT:
        return _exact_flow(around, k, stiffness, x, current)
    if rule == PATH:
        (r,) = resistors_of(around.system.network, around.system.state_names[k])
        resistor = around.system.network.resistors[r]
        path = RESISTOR_LAWS[resistor.law].path
        assert path is not None
        return path(x + 0.0 * current, current, around.h, stiffness, *map(around.system.value, resistor.parameters))
    if stages is None:
        with torch.no_grad():
            stages = _radau_stages(around, k, stiffness, x, current)
    return _radau(around, k, stiffness, x, current, stages)


def _exact_flow(around: Surroundings, k: int, s: Tensor, x: Tensor, current: Tensor) -> tuple[Tensor, Tensor]:
    system, h, one = around.system, around.h, torch.ones_like(current)
    first, *others = resistors_of(system.network, system.state_names[k])
    rho, low, high = _thresholds(around, first, one)
    leak = sum((system.branch_flow(r, one, around.middle) for r in others), torch.zeros_like(one))
    if one.device.type == "cpu" and one.dtype == torch.float64:
        sizes = torch.as_tensor(h, dtype=one.dtype)
        return _CompiledFlow.apply(*torch.broadcast_tensors(x, current, sizes, s, rho, low, high, leak))
    relaxed = *relaxation(h * (rho + leak) * s), *relaxation(h * leak * s)
    return rc_flow(x + 0.0 * one, current, h + 0.0 * one, s, rho, low, high, leak, *relaxed)


@loop_entry
def _flows(v: Any, active: Any, found: Any, slopes: Any) -> None:
    """Fill end and mean effort ``found`` (2, M) of `rc_flow` at its first arguments ``v`` (8, M), and their
    derivatives ``slopes`` (A, 2, M) by the active ones of these, by complex steps."""
    for m in range(v.shape[1]):
        for k in range(active.shape[0]):
            j = active[k]
            x, i = complex(v[0, m], TINY * (j == 0)), complex(v[1, m], TINY * (j == 1))
            h, s = complex(v[2, m], TINY * (j == 2)), complex(v[3, m], TINY * (j == 3))
            rho, low = complex(v[4, m], TINY * (j == 4)), complex(v[5, m], TINY * (j == 5))
            high, leak = complex(v[6, m], TINY * (j == 6)), complex(v[7, m], TINY * (j == 7))
            one, two = relaxation(h * (rho + leak) * s)
            leak_one, leak_two = relaxation(h * leak * s)
            end, mean = rc_flow(x, i, h, s, rho, low, high, leak, one, two, leak_one, leak_two)
            found[0, m], found[1, m] = end.real, mean.real
            slopes[k, 0, m], slopes[k, 1, m] = end.imag / TINY, mean.imag / TINY


class _CompiledFlow(torch.autograd.Function):
    """The exact flow in compiled code."""

    @staticmethod
    def forward(ctx: Any, *values: Tensor) -> tuple[Tensor, Tensor]:
        ctx.active = [j for j, need in enumerate(ctx.needs_input_grad) if need]
        v, shape = np.stack([value.detach().numpy().ravel() for value in values]), values[0].shape
        active = np.array(ctx.active or [-1])
        found, slopes = np.empty((2, v.shape[1])), np.empty((active.size, 2, v.shape[1]))
        _flows(v, active, found, slopes)
        ctx.save_for_backward(torch.from_numpy(slopes).reshape(-1, 2, *shape))
        end, mean = torch.from_numpy(found).reshape(2, *shape).unbind()
        return end.clone(), mean.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, by_end: Tensor, by_mean: Tensor) -> Any:
        found = dict(zip(ctx.active, ctx.saved_tensors[0], strict=False))
        return tuple(by_end * found[j][0] + by_mean * found[j][1] if j in found else None for j in range(8))


def _thresholds(around: Surroundings, r: int, like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    system = around.system
    resistor = system.network.resistors[r]
    thresholds = RESISTOR_LAWS[resistor.law].thresholds
    if thresholds is None:
        raise SolverFailed(f"{resistor.name}: the law {resistor.law} has no exact flow: take Scheme.RADAU")
    name = resistor.modulated_by
    q = torch.zeros_like(like) if name is None else around.middle[..., system.state_names.index(name)]
    return thresholds(q, *map(system.value, resistor.parameters))


def _radau(
    around: Surroundings, k: int, s: Tensor, x: Tensor, current: Tensor, stages: tuple[Tensor, Tensor]
) -> tuple[Tensor, Tensor]:
    """One Newton step from the stages, whose matrix ``[[a, 1/2], [−9/2, b]]`` has no gradients of its own."""
    one, two = stages
    h = around.h
    fixed = h.detach() if isinstance(h, Tensor) else h
    slopes = [_with_slope(around, k, s.detach(), stage)[1] for stage in stages]
    lost = [around.lost(k, s * stage) for stage in stages]
    g1, g2 = radau_defects(one - x, two - x, current, h, lost[0], lost[1])
    a, b = 1.5 + fixed * slopes[0], 2.5 + fixed * slopes[1]
    determinant = a * b + 2.25
    one = one - (b * g1 - 0.5 * g2) / determinant
    two = two - (4.5 * g1 + a * g2) / determinant
    return two, s * (0.75 * one + 0.25 * two)


def _with_slope(around: Surroundings, k: int, s: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """(...) flow lost at a state and its slope, both without gradients."""
    with torch.enable_grad():
        at = state.detach().clone().requires_grad_(True)
        lost = around.lost(k, s * at)
        (slope,) = torch.autograd.grad(lost.sum(), at, materialize_grads=True)
    return lost.detach(), slope


def _radau_stages(around: Surroundings, k: int, s: Tensor, x: Tensor, current: Tensor) -> tuple[Tensor, Tensor]:
    """Both stages: Newton's method, then two nested scalar searches where it does not converge.

    The first defect increases with the first stage. With the first stage as its root, the second defect increases with
    the second stage (`phnn.integrate.stages.make_radau`).
    """
    h = around.h
    x = (x + 0.0 * current).detach()
    i, one, two = current.detach(), x, x
    tolerance = TOLERANCE * torch.finfo(x.dtype).eps / _DOUBLE

    def at(state: Tensor) -> tuple[Tensor, Tensor]:
        return _with_slope(around, k, s.detach(), state)

    for _ in range(_QUICK):
        (taken1, slope1), (taken2, slope2) = at(one), at(two)
        a, b = 1.5 + h * slope1, 2.5 + h * slope2
        if not bool(((a > 0.0) & (b > 0.0)).all()):
            break
        g1, g2 = radau_defects(one - x, two - x, i, h, taken1, taken2)
        size = one.abs() + two.abs() + x.abs() + h * i.abs()
        size1 = size + h * (taken1.abs() + (slope1 * one).abs())
        size2 = size + h * (taken2.abs() + (slope2 * two).abs())
        small = [g.abs() <= tolerance * size + NOTHING for g, size in ((g1, size1), (g2, size2))]
        if bool((small[0] & small[1]).all()):
            return one, two
        determinant = a * b + 2.25
        one, two = one - (b * g1 - 0.5 * g2) / determinant, two - (4.5 * g1 + a * g2) / determinant

    def first(second: Tensor) -> Tensor:
        def defect(stage: Tensor) -> tuple[Tensor, Tensor]:
            taken, slope = at(stage)
            return radau_defects(stage - x, second - x, i, h, taken, 0.0 * taken)[0], 1.5 + h * slope

        return _increasing_root(defect, second, 1.5)

    def defect(second: Tensor) -> tuple[Tensor, Tensor]:
        taken, slope = at(second)
        value = radau_defects(first(second) - x, second - x, i, h, 0.0 * taken, taken)[1]
        return value, 2.5 + h * slope + 2.25 / (1.5 + h * at(first(second))[1])

    two = _increasing_root(defect, x, 2.5)
    return first(two), two


def _increasing_root(function: Callable[[Tensor], tuple[Tensor, Tensor]], guess: Tensor, floor: float) -> Tensor:
    """(...) roots of increasing functions with a slope of at least ``floor``: Newton's method within brackets."""
    y, last = guess, torch.full_like(guess, torch.inf)
    low, high = torch.full_like(guess, -torch.inf), torch.full_like(guess, torch.inf)
    for _ in range(_BRACKETED):
        value, slope = function(y)
        low, high = torch.where(value <= 0.0, y, low), torch.where(value >= 0.0, y, high)
        newton = y - value / slope
        good = (newton >= low) & (newton <= high) & (slope > 0.0) & (value.abs() <= 0.5 * last)
        # Twice the step that the least slope allows leads beyond the root.
        inside = torch.where((high - low).isfinite(), 0.5 * low + 0.5 * high, y - 2.0 * value / floor)
        # The search ends when a step has the size of rounding, or is little larger and no longer helps because of
        # rounding.
        least = torch.where(good, 1.0, _NOISE) * torch.finfo(y.dtype).eps * y.abs()
        arrived = (value == 0.0) | ((slope > 0.0) & ((newton - y).abs() <= least))
        following = torch.where(arrived, y, torch.where(good, newton, inside))
        if bool((following == y).all()):
            break
        y, last = following, value.abs()
    return y


def shares(flows: list[Tensor]) -> list[Tensor]:
    """The shares of a storage's loss in its resistors: proportional to their flows at its mean effort."""
    if len(flows) <= 1:
        return [torch.ones_like(f) for f in flows]
    total = torch.stack(flows).abs().sum(0)
    return [torch.where(total > 0.0, f.abs() / total, 1.0 / len(flows)) for f in flows]
