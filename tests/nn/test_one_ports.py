"""Learned one-ports: passive for every weight, accurate at every magnitude, able to learn what they are for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import shaken
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.laws import gradient
from phnn.laws.diverged import LARGEST_WEIGHT
from phnn.nn import ConvexEnergyMLP, MonotoneMLP, SectorMLP

torch.set_num_threads(1)
fuzzy = settings(max_examples=60, deadline=None)
SCALE = 1e-5


def magnitudes(seed: int, count: int = 200) -> Tensor:
    """Arguments from far below to far above the typical magnitude, of both signs."""
    random = torch.Generator().manual_seed(seed)
    exponent = torch.rand(count, generator=random, dtype=torch.float64) * 10.0 - 8.0
    sign = torch.where(torch.rand(count, generator=random) < 0.5, -1.0, 1.0)
    return torch.cat([sign * SCALE * 10.0**exponent, torch.zeros(1, dtype=torch.float64)])


def train(law: nn.Module, x: Tensor, y: Tensor, unit: float) -> float:
    """Fit by a quasi-Newton method; the root mean square error relative to the target's."""
    optimiser = torch.optim.LBFGS(law.parameters(), max_iter=100, line_search_fn="strong_wolfe")

    def misfit() -> Tensor:
        optimiser.zero_grad()
        loss = (((law(x) - y) / unit) ** 2).mean()
        loss.backward()
        return loss

    optimiser.step(misfit)
    with torch.no_grad():
        return float((law(x) - y).norm() / y.norm())


def train_in_steps(law: nn.Module, x: Tensor, y: Tensor, unit: float, rate: float) -> float:
    """The same by 200 steps of Adam."""
    optimiser = torch.optim.Adam(law.parameters(), rate)
    for _ in range(200):
        optimiser.zero_grad()
        (((law(x) - y) / unit) ** 2).mean().backward()
        optimiser.step()
    with torch.no_grad():
        return float((law(x) - y).norm() / y.norm())


@fuzzy
@given(st.integers(0, 10**6), st.floats(0.0, 5.0), st.booleans())
def test_damping_lies_in_the_sector_whatever_the_weights(seed: int, size: float, symmetric: bool) -> None:
    law = shaken(SectorMLP(SCALE, 3e4, symmetric=symmetric), seed, size)
    effort = magnitudes(seed)
    flow = law(effort)
    assert torch.isfinite(flow).all()
    assert (effort * flow >= 0.0).all()
    assert flow[-1] == 0.0
    if symmetric:
        assert torch.equal(law(-effort), -flow)


@fuzzy
@given(st.integers(0, 10**6), st.floats(0.0, 5.0))
def test_monotone_law_is_monotone_and_passes_through_zero(seed: int, size: float) -> None:
    law = shaken(MonotoneMLP(SCALE, 3e4), seed, size)
    effort = magnitudes(seed).sort().values
    flow = law(effort)
    assert (flow.diff() >= -1e-12 * flow.abs().max()).all()
    assert law(torch.zeros((), dtype=torch.float64)) == 0.0
    assert (effort * flow >= 0.0).all()


@fuzzy
@given(st.integers(0, 10**6), st.floats(0.0, 5.0))
def test_energy_is_convex_with_minimum_zero_at_zero(seed: int, size: float) -> None:
    law = shaken(ConvexEnergyMLP(SCALE, 3e4), seed, size)
    x = magnitudes(seed).sort().values
    energy, effort = law.energy(x), law(x)
    unit = SCALE * 3e4
    assert (energy >= -1e-14 * unit).all()
    assert law.energy(torch.zeros((), dtype=torch.float64)) == 0.0
    assert law(torch.zeros((), dtype=torch.float64)) == 0.0
    assert (effort.diff() >= -1e-10 * effort.abs().max()).all()


@pytest.mark.parametrize("difference", [0.0, 1e-14, 1e-9, 1e-6, 1e-4, 1e-2, 1.0])
def test_mean_effort_and_its_slope_agree_with_quadrature(difference: float) -> None:
    law = shaken(ConvexEnergyMLP(1.0, 1.0), 1, 0.5)
    a = torch.linspace(-1.5, 1.5, 31, dtype=torch.float64)
    b = (a + difference).requires_grad_(True)
    nodes, weights = (torch.as_tensor(v) for v in np.polynomial.legendre.leggauss(40))
    tau = 0.5 * (1.0 + nodes)
    reference = (law(a.unsqueeze(-1) + (b - a).unsqueeze(-1) * tau) * 0.5 * weights).sum(-1)
    for found in (law.mean_effort(a, b), gradient.mean_effort(law.energy, a, b)):
        torch.testing.assert_close(found, reference, rtol=1e-9, atol=1e-10)
        slope, wanted = (torch.autograd.grad(v.sum(), b, retain_graph=True)[0] for v in (found, reference))
        torch.testing.assert_close(slope, wanted, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("law", [SectorMLP(SCALE, 3e4), MonotoneMLP(SCALE, 3e4)], ids=["damping", "monotone"])
def test_a_dead_zone_with_a_slope_is_learned(law: nn.Module) -> None:
    effort = SCALE * torch.linspace(-2.0, 2.0, 201, dtype=torch.float64)
    half, slope = 0.7 * SCALE, 2.0 * 3e4 / SCALE
    target = slope * (effort - effort.clamp(-half, half))
    assert train(law, effort, target, 3e4) < 0.01
    if isinstance(law, SectorMLP):
        # Zero on an interval, not merely small.
        assert (law(effort[(effort.abs() > 0) & (effort.abs() < 0.8 * half)]) == 0.0).double().mean() > 0.9


@pytest.mark.parametrize("width", [8, 128])
def test_a_damper_of_any_width_survives_a_high_rate_of_training(width: int) -> None:
    effort = SCALE * torch.linspace(-2.0, 2.0, 101, dtype=torch.float64)
    target = 2.0 * 3e4 / SCALE * (effort - effort.clamp(-0.7 * SCALE, 0.7 * SCALE))
    assert train_in_steps(SectorMLP(SCALE, 3e4, width), effort, target, 3e4, rate=0.1) < 0.1


def test_gradients_do_not_depend_on_the_units() -> None:
    large, small = SectorMLP(1.0, 1.0), SectorMLP(1e-7, 1e-5)
    z = torch.linspace(-2.0, 2.0, 11, dtype=torch.float64)
    for law, effort, flow in ((large, 1.0, 1.0), (small, 1e-7, 1e-5)):
        ((law(effort * z) / flow) ** 2).sum().backward()
    for a, b in zip(large.parameters(), small.parameters(), strict=True):
        torch.testing.assert_close(a.grad, b.grad)
        assert a.grad is not None


@pytest.mark.parametrize("make", [SectorMLP, MonotoneMLP, ConvexEnergyMLP])
def test_weights_are_physical(make: Callable[..., nn.Module]) -> None:
    dimensionless, physical = shaken(make(1.0, 1.0), 3, 0.5), shaken(make(SCALE, 3e4), 3, 0.5)
    z = torch.linspace(-2.0, 2.0, 11, dtype=torch.float64)
    torch.testing.assert_close(physical(SCALE * z), 3e4 * dimensionless(z), rtol=1e-12, atol=0.0)
    # Gradients of everything a module has reach it through its one vector of weights.
    physical.weights().sum().backward()  # type: ignore[operator]
    assert all(p.grad is not None and bool((p.grad != 0.0).all()) for p in physical.parameters())


@pytest.mark.parametrize("make", [SectorMLP, MonotoneMLP, ConvexEnergyMLP])
def test_a_law_without_units_is_refused(make: Callable[..., nn.Module]) -> None:
    with pytest.raises(InputRefused, match="at least one unit"):
        make(1.0, 1.0, 0)
    assert bool(torch.isfinite(make(1.0, 1.0, 1)(torch.ones((), dtype=torch.float64))))


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_scales_that_are_not_positive_are_refused(scale: float) -> None:
    for make in (SectorMLP, MonotoneMLP, ConvexEnergyMLP):
        with pytest.raises(InputRefused, match="positive typical magnitude"):
            make(1.0, scale)


@pytest.mark.parametrize("seed", range(5))
def test_energies_of_the_largest_weights_fit_into_32_bits(seed: int) -> None:
    # Products of steps and hinges reach 40 decades, and an overflow would come back as an effort of zero.
    law, random = ConvexEnergyMLP(1.0, 1.0, 5), torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for weight in law.parameters():
            sign = torch.sign(torch.randn(weight.shape, generator=random, dtype=torch.float64))
            weight.copy_(sign * LARGEST_WEIGHT * torch.rand(weight.shape, generator=random, dtype=torch.float64))
        a, b = (10.0 * torch.randn(200, generator=random, dtype=torch.float64) for _ in range(2))
        exact = law.mean_effort(a, b)
        assert exact.abs().max() > 0.0
        found = law.to(torch.float32).mean_effort(a.float(), b.float()).double()
    assert ((found - exact).abs() <= 1e-4 * exact.abs() + 1e-25).all()
