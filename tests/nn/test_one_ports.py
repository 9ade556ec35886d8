"""Learned one-ports: passive for every weight, accurate at every magnitude, one function for module and kernel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import numba
import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from networks import shaken
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.integrate.cache import compiled as kept
from phnn.laws import wide
from phnn.laws.namespace import TINY, sqrt
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, WideLaw
from phnn.network.bounded import LARGEST_WEIGHT
from phnn.network.checks import quotient_of
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


def train(law: nn.Module, x: Tensor, y: Tensor, unit: float, rate: float = 0.0) -> float:
    """Fit by a quasi-Newton method, or by 200 steps of Adam; the root mean square error relative to the target's."""
    optimiser: torch.optim.Optimizer
    optimiser = torch.optim.LBFGS(law.parameters(), max_iter=100, line_search_fn="strong_wolfe")
    if rate:
        optimiser = torch.optim.Adam(law.parameters(), rate)

    def misfit() -> Tensor:
        optimiser.zero_grad()
        loss = (((law(x) - y) / unit) ** 2).mean()
        loss.backward()
        return loss

    for _ in range(200 if rate else 1):
        optimiser.step(misfit)
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
    for found in (law.mean_effort(a, b), quotient_of(law.energy, a, b)):
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
    assert train(SectorMLP(SCALE, 3e4, width), effort, target, 3e4, rate=0.1) < 0.1


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


TYPICAL = 3e4
UNITS = 5
# Where a block of weights begins in the kernel's parameters: before and behind it stands what no law may read.
FIRST = 3

MODULES: dict[str, Callable[[int], nn.Module]] = {
    "damping": lambda width: SectorMLP(SCALE, TYPICAL, width),
    "symmetric_damping": lambda width: SectorMLP(SCALE, TYPICAL, width, symmetric=True),
    "monotone": lambda width: MonotoneMLP(SCALE, TYPICAL, width),
    "convex": lambda width: ConvexEnergyMLP(SCALE, TYPICAL, width),
}
LAWS: dict[str, WideLaw] = {**WIDE_RESISTORS, **WIDE_STORAGES}
every = pytest.mark.parametrize("name", LAWS)
few = settings(max_examples=12, deadline=None)
shakes = st.tuples(st.integers(0, 10**6), st.floats(0.0, 4.0))


def weights_of(module: nn.Module) -> Tensor:
    return module.weights().detach()  # type: ignore[operator]


def arguments(name: str, lowest: int = -12, highest: int = 6) -> list[NDArray[np.float64]]:
    """Arguments of both signs over many decades; for a storage all kinds of pairs of them."""
    decades = SCALE * 10.0 ** np.arange(lowest, highest + 1)
    x = np.concatenate([[0.0], *(m * decades for m in (1.0, -2.3, 4.7, -7.9))])
    return [x] if name in WIDE_RESISTORS else [np.concatenate([x, x, x]), np.concatenate([x, x[::-1], np.roll(x, 7)])]


def evaluate(name: str, given_: list[Any], weights: Any) -> Any:
    """The law on tensors or arrays."""
    return wide.evaluated(LAWS[name], weights, *given_)


# Compiled laws are global: numba keeps no machine code of closures.
_damping, _symmetric, _monotone, _convex = (
    wide.compiled(LAWS[name]) for name in ("damping", "symmetric_damping", "monotone", "convex")
)


def _damping_of(effort, theta, first, count, out):  # type: ignore[no-untyped-def]
    for n in range(len(out)):
        out[n] = _damping(effort[n], theta, first, count)


def _symmetric_of(effort, theta, first, count, out):  # type: ignore[no-untyped-def]
    for n in range(len(out)):
        out[n] = _symmetric(effort[n], theta, first, count)


def _monotone_of(effort, theta, first, count, out):  # type: ignore[no-untyped-def]
    for n in range(len(out)):
        out[n] = _monotone(effort[n], theta, first, count)


def _convex_of(a, b, theta, first, count, out):  # type: ignore[no-untyped-def]
    for n in range(len(out)):
        out[n] = _convex(a[n], b[n], theta, first, count)


# The compiled laws from code that can neither allocate nor count references, as the kernel is.
KERNELS: dict[str, Callable[..., Any]] = {
    name: kept(function, error_model="numpy", _nrt=False)
    for name, function in {
        "damping": _damping_of, "symmetric_damping": _symmetric_of, "monotone": _monotone_of, "convex": _convex_of,
    }.items()
}  # fmt: skip


def compiled(name: str, given_: list[Any], weights: NDArray[Any]) -> NDArray[Any]:
    """The compiled law at (N,) arguments."""
    theta = np.concatenate([np.full(FIRST, np.nan), weights, [np.nan]])
    out = np.empty(len(given_[0]), np.result_type(theta, *given_))
    KERNELS[name](*given_, theta, FIRST, UNITS, out)
    return out


def size_of_terms(name: str, given_: list[NDArray[np.float64]], weights: Tensor) -> NDArray[np.float64]:
    """(N,) size of what is summed in the law: its value where all of it has one sign."""
    if "damping" in name:
        heights = weights[0].abs() + weights[1:].reshape(-1, 3)[:, 0].abs().sum()
        return np.abs(given_[0]) * heights.item()
    ends = [torch.from_numpy(x) for x in given_]
    return sum(np.abs(evaluate(name, [x] * len(ends), weights).numpy()) for x in ends)


@every
@few
@given(shakes)
def test_compiled_values_are_those_of_the_torch_module(name: str, shake: tuple[int, float]) -> None:
    module, given_ = shaken(MODULES[name](UNITS), *shake), arguments(name)
    tensors = [torch.from_numpy(x) for x in given_]
    with torch.no_grad():
        value = module(*tensors) if name in WIDE_RESISTORS else module.mean_effort(*tensors)  # type: ignore[operator]
    weights = weights_of(module)
    bound = 1e-14 * size_of_terms(name, given_, weights)
    found = compiled(name, given_, weights.numpy())
    assert (np.abs(found - value.numpy()) <= bound).all()
    assert (np.abs(evaluate(name, given_, weights.numpy()) - value.numpy()) <= bound).all()


@every
@few
@given(shakes)
@example((236926, 4.0))
def test_complex_step_is_the_slope_of_autograd(name: str, shake: tuple[int, float]) -> None:
    weights, given_ = weights_of(shaken(MODULES[name](UNITS), *shake)), arguments(name)
    tensors = [torch.from_numpy(x).clone().requires_grad_(True) for x in given_]
    slopes = torch.autograd.grad(evaluate(name, tensors, weights).sum(), tensors)
    for k, slope in enumerate(slopes):
        moved = [x + TINY * 1j if i == k else x + 0j for i, x in enumerate(given_)]
        found = compiled(name, moved, weights.numpy() + 0j).imag / TINY
        # Where a sum changes sign its terms set the scale; their slopes are as large as those elsewhere. A hundredth of
        # these leaves a sum of many terms 45 units in the last place.
        scale = np.abs(slope.numpy()) + 1e-2 * np.abs(slope.numpy()).max()
        assert (np.abs(found - slope.numpy()) <= 1e-12 * scale).all()


@every
@pytest.mark.parametrize(("seed", "size"), [(0, 0.0), (2, 3.0)])
def test_complex_step_by_every_weight_is_the_slope_of_autograd(name: str, seed: int, size: float) -> None:
    weights, given_ = weights_of(shaken(MODULES[name](UNITS), seed, size)).requires_grad_(True), arguments(name)
    values = evaluate(name, [torch.from_numpy(x) for x in given_], weights)
    expected = torch.stack([torch.autograd.grad(v, weights, retain_graph=True)[0] for v in values]).numpy()
    theta = weights.detach().numpy()
    # In units of weight and result: positions enter by differences that may cancel.
    bound = 1e-12 * size_of_terms(name, given_, weights.detach())
    for k, weight in enumerate(theta):
        moved = theta + 0j
        moved[k] += TINY * 1j
        found = compiled(name, [x + 0j for x in given_], moved).imag / TINY
        assert (np.abs((found - expected[:, k]) * weight) <= bound).all()
    assert (np.abs(expected).max(0) > 0.0).all()


def squareplus(y: Any) -> Any:
    return (y + mpmath.sqrt(4 + y * y)) / 2


def logistic(y: Any) -> Any:
    return (1 + y / mpmath.sqrt(4 + y * y)) / 2


def exact_flow(effort: float, weights: NDArray[np.float64]) -> Any:
    """The flow of a monotone law by its definition."""
    total = mpmath.mpf(weights[0]) * effort
    for row in weights[1:].reshape(-1, 9):
        w0, k0, c0, w1, k1, c1, w2, k2, c2 = map(mpmath.mpf, row)
        total += w0 * (logistic(k0 * effort + c0) - logistic(c0))
        total += w1 * (squareplus(k1 * effort - c1) - squareplus(-c1))
        total -= w2 * (squareplus(-k2 * effort - c2) - squareplus(-c2))
    return total


def exact_energy(x: Any, weights: NDArray[np.float64]) -> Any:
    """The energy of a convex law by its definition."""
    total = mpmath.mpf(weights[0]) * x * x / 2
    for row in weights[1:].reshape(-1, 3):
        w, k, c = map(mpmath.mpf, row)
        total += w / k * (squareplus(k * x + c) - squareplus(c) - logistic(c) * k * x)
    return total


@pytest.mark.parametrize(("seed", "size"), [(0, 0.0), (2, 3.0)])
def test_monotone_law_has_the_digits_of_its_definition(seed: int, size: float) -> None:
    weights, given_ = weights_of(shaken(MODULES["monotone"](UNITS), seed, size)).numpy(), arguments("monotone")
    with mpmath.workdps(80):
        wanted = [float(exact_flow(x, weights)) for x in map(mpmath.mpf, given_[0])]
    np.testing.assert_allclose(compiled("monotone", given_, weights), wanted, rtol=1e-13)


@pytest.mark.parametrize(("seed", "size"), [(0, 0.0), (2, 3.0)])
def test_energy_and_mean_effort_have_the_digits_of_their_definition(seed: int, size: float) -> None:
    weights = weights_of(shaken(MODULES["convex"](UNITS), seed, size))
    start = arguments("convex")[0][:77:3]
    gaps = [g * s for g in (1e-300, 1e-30, 1e-15, 1e-9, 1e-4, 1e-1, 3.0) for s in (SCALE, -SCALE)]
    a, b = (m.ravel() for m in np.meshgrid(start, [*gaps, 0.0]))
    b = a + b
    with mpmath.workdps(700):
        energies = {x: exact_energy(mpmath.mpf(x), weights.numpy()) for x in {*a, *b}}
        slope = {x: mpmath.diff(lambda y: exact_energy(y, weights.numpy()), mpmath.mpf(x)) for x in {*a}}
        wanted = [
            float((energies[y] - energies[x]) / (mpmath.mpf(y) - mpmath.mpf(x)) if x != y else slope[x])
            for x, y in zip(a, b, strict=True)
        ]
    found = compiled("convex", [a, b], weights.numpy())
    assert (np.abs(found - wanted) <= 1e-13 * size_of_terms("convex", [a, b], weights)).all()
    values = [float(energies[x]) for x in a]
    np.testing.assert_allclose(a * evaluate("convex", [0.0 * a, a], weights.numpy()), values, rtol=1e-13)


@every
@few
@given(shakes)
def test_extreme_arguments_give_finite_values(name: str, shake: tuple[int, float]) -> None:
    weights, given_ = weights_of(shaken(MODULES[name](UNITS), *shake)).numpy(), arguments(name, -300, 60)
    assert np.isfinite(compiled(name, given_, weights)).all()
    for k in range(len(given_)):
        moved = [x + TINY * 1j if i == k else x + 0j for i, x in enumerate(given_)]
        slope = compiled(name, moved, weights + 0j).imag / TINY
        assert np.isfinite(slope).all()
        if LAWS[name].monotone:
            assert (slope >= -1e-12 * np.abs(slope).max()).all()


@every
def test_gradients_of_extreme_arguments_are_finite(name: str) -> None:
    weights = weights_of(shaken(MODULES[name](UNITS), 4, 2.0)).requires_grad_(True)
    tensors = [torch.from_numpy(x).clone().requires_grad_(True) for x in arguments(name, -300, 60)]
    gradients = torch.autograd.grad(evaluate(name, tensors, weights).sum(), [weights, *tensors])
    assert all(bool(torch.isfinite(g).all()) for g in gradients)


def test_square_root_and_its_slope_are_the_same_everywhere() -> None:
    x = 10.0 ** np.arange(-60.0, 61.0, 7.0)
    call = numba.njit(lambda x: sqrt(x))
    tensor = torch.from_numpy(x).clone().requires_grad_(True)
    sqrt(tensor).sum().backward()
    np.testing.assert_allclose(sqrt(tensor).detach().numpy(), np.sqrt(x), rtol=1e-15)
    np.testing.assert_allclose(sqrt(x), np.sqrt(x), rtol=1e-15)
    for n, value in enumerate(x):
        assert call(value) == sqrt(value) == np.sqrt(value)
        for function in (sqrt, call):
            np.testing.assert_allclose(
                function(complex(value, TINY)).imag / TINY,
                tensor.grad[n].item(),  # type: ignore[index]
                rtol=1e-14,
            )
