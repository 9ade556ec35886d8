"""What every registered law owes the networks it is used in; a new law is tested here without being asked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from torch import Tensor

from phnn.errors import StructureViolated
from phnn.laws import (
    MEMORY_LAWS,
    PORT_LAWS,
    RESISTOR_LAWS,
    STORAGE_LAWS,
    MemoryLaw,
    PortLaw,
    ResistorLaw,
    StorageLaw,
    register,
)
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.namespace import TINY, absolute, sqrt
from phnn.laws.resistor import piecewise_linear

Law = StorageLaw | ResistorLaw | PortLaw | MemoryLaw
# Away from every kink of the examples, of both signs, over some decades.
POINTS = np.array([-2.3, -0.71, -0.113, -0.0021, 0.0017, 0.094, 0.83, 1.9])


def named(table: dict[str, Any]) -> Any:
    return pytest.mark.parametrize("law", table.values(), ids=table.keys())


def functions(law: Law) -> dict[str, tuple[Callable[..., Any], int]]:
    """The functions of a law that numbers go through, with their number of arguments before the parameters."""
    if isinstance(law, StorageLaw):
        return {"energy": (law.energy, 1), "mean_effort": (law.mean_effort, 2)}
    if isinstance(law, PortLaw):
        return {"action": (law.action, 1), "slope": (law.slope, 1)}
    if isinstance(law, MemoryLaw):
        return {"rate": (law.rate, 2)}
    thresholds = {} if law.thresholds is None else {"thresholds": (law.thresholds, 1)}
    return {"flow": (law.flow, 2), **thresholds}


EVERY = [
    pytest.param(law, function, leading, id=f"{law.name}-{name}")
    for table in (STORAGE_LAWS, RESISTOR_LAWS, PORT_LAWS, MEMORY_LAWS)
    for law in table.values()
    for name, (function, leading) in functions(law).items()
]


def arguments(leading: int) -> list[np.ndarray]:
    """Arguments that differ from each other."""
    return [np.roll(POINTS, k) for k in range(leading)]


def stacked(values: Any, like: Any) -> Any:
    """A tuple of results as one array or tensor, constants spread over the points."""
    parts = values if isinstance(values, tuple) else (values,)
    if isinstance(like, Tensor):
        return torch.stack([torch.as_tensor(p, dtype=like.dtype) + 0.0 * like.detach() for p in parts])
    return np.stack([p + 0.0 * like for p in parts])


class TestEveryFunction:
    """Floats, arrays and tensors agree, and so do both ways to a derivative."""

    @pytest.mark.parametrize(("law", "function", "leading"), EVERY)
    def test_numpy_torch_and_floats_agree(self, law: Law, function: Callable[..., Any], leading: int) -> None:
        given_ = arguments(leading)
        array = stacked(function(*given_, *law.example), given_[0])
        tensors = [torch.from_numpy(a) for a in given_]
        tensor = stacked(function(*tensors, *law.example), tensors[0])
        np.testing.assert_allclose(tensor.numpy(), array, rtol=1e-14, atol=1e-300)
        single = [stacked(function(*map(float, row), *law.example), row[0]) for row in zip(*given_, strict=True)]
        np.testing.assert_allclose(np.stack(single, -1), array, rtol=1e-14, atol=1e-300)

    @pytest.mark.parametrize(("law", "function", "leading"), EVERY)
    def test_complex_step_is_the_slope_of_autograd(self, law: Law, function: Callable[..., Any], leading: int) -> None:
        values = [*arguments(leading), *(np.full(POINTS.size, p) for p in law.example)]
        for k in range(len(values)):
            moved = [v + TINY * 1j if i == k else v for i, v in enumerate(values)]
            slope = np.imag(stacked(function(*moved), values[0] + 0j)) / TINY
            tensors = [torch.from_numpy(v).clone().requires_grad_(i == k) for i, v in enumerate(values)]
            parts = stacked(function(*tensors), tensors[0])
            # Ties in results that do not depend on the argument.
            anchor = 0.0 * tensors[k]
            rows = [torch.autograd.grad((p + anchor).sum(), tensors[k], retain_graph=True)[0] for p in parts]
            expected = torch.stack(rows).numpy()
            np.testing.assert_allclose(slope, expected, rtol=1e-12, atol=1e-14)


@named(STORAGE_LAWS)
class TestEveryStorage:
    def test_energy_is_zero_at_zero_and_negative_only_where_the_law_says_so(self, law: StorageLaw) -> None:
        assert law.energy(0.0, *law.example) == 0.0
        assert (law.energy(np.linspace(-50.0, 50.0, 2001), *law.example) >= 0.0).all() == law.bounded

    def test_mean_effort_is_the_quotient_of_energies(self, law: StorageLaw) -> None:
        a, b = (m.ravel() for m in np.meshgrid(POINTS, POINTS + 0.0317))
        quotient = (law.energy(b, *law.example) - law.energy(a, *law.example)) / (b - a)
        np.testing.assert_allclose(law.mean_effort(a, b, *law.example), quotient, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(law.mean_effort(b, a, *law.example), law.mean_effort(a, b, *law.example), rtol=1e-12)

    def test_its_limit_is_the_slope_of_the_energy(self, law: StorageLaw) -> None:
        x = torch.from_numpy(POINTS).clone().requires_grad_(True)
        (effort,) = torch.autograd.grad(law.energy(x, *law.example).sum(), x)
        for gap in (0.0, 1e-300, 1e-15, 1e-9):
            near = law.mean_effort(POINTS, POINTS * (1.0 + gap) + gap, *law.example)
            np.testing.assert_allclose(near, effort.numpy(), rtol=1e-12 + 1e3 * gap, atol=1e-14 + 1e3 * gap)

    def test_effort_rises_where_the_law_says_convex(self, law: StorageLaw) -> None:
        x = np.linspace(-4.0, 4.0, 4001)
        rises = np.diff(law.mean_effort(x, x, *law.example)) >= -1e-12
        assert rises.all() == law.convex


def test_a_turbulent_pipe_is_linear_for_small_and_a_root_for_large_efforts() -> None:
    pipe = RESISTOR_LAWS["turbulent"].flow
    np.testing.assert_allclose(pipe(1e-6, 0.0, 0.7, 0.4, 0.9), 0.7e-6, rtol=1e-5)
    np.testing.assert_allclose(pipe(4e12, 0.0, 0.7, 0.4, 0.9), 2.0 * pipe(1e12, 0.0, 0.7, 0.4, 0.9), rtol=1e-5)
    flow = pipe(POINTS, 0.0, 0.7, 0.4, 0.9)
    np.testing.assert_allclose(flow * (1.0 + 0.4 * np.abs(flow) / 0.9), 0.7 * POINTS, rtol=1e-14)


def test_a_stop_on_the_negative_side_mirrors_the_positive_one() -> None:
    stop, a, b = STORAGE_LAWS["stop"], POINTS, np.roll(POINTS, 3)
    np.testing.assert_allclose(stop.energy(-a, 2.0, -0.3), stop.energy(a, 2.0, 0.3))
    np.testing.assert_allclose(stop.mean_effort(-a, -b, 2.0, -0.3), -stop.mean_effort(a, b, 2.0, 0.3))


def effort_grid() -> tuple[np.ndarray, np.ndarray]:
    """Rising efforts over many decades, and displacements."""
    efforts = np.sort(np.concatenate([[0.0], POINTS, 1e3 * POINTS, 1e-12 * POINTS]))
    effort, q = np.meshgrid(efforts, np.concatenate([[0.0], 40.0 * POINTS]))
    return effort, q


@named(RESISTOR_LAWS)
class TestEveryResistor:
    def test_sector_condition_at_every_displacement(self, law: ResistorLaw) -> None:
        effort, q = effort_grid()
        flow = law.flow(effort, q, *law.example)
        assert (effort * flow >= 0.0).all()
        assert (flow[effort == 0.0] == 0.0).all()
        assert np.abs(flow).max() > 0.0

    def test_flow_rises_where_the_law_says_monotone(self, law: ResistorLaw) -> None:
        effort, q = effort_grid()
        assert (np.diff(law.flow(effort, q, *law.example), axis=1) >= 0.0).all() == law.monotone


@named({name: law for name, law in RESISTOR_LAWS.items() if law.thresholds is not None})
def test_thresholds_describe_the_flow(law: ResistorLaw) -> None:
    effort, q = effort_grid()
    rho, low, high = law.thresholds(q, *law.example)  # type: ignore[misc]
    assert (np.asarray(rho) >= 0.0).all()
    assert (np.asarray(low) <= 0.0).all()
    assert (np.asarray(high) >= 0.0).all()
    wanted = law.flow(effort, q, *law.example)
    np.testing.assert_allclose(piecewise_linear(effort, rho, low, high), wanted, rtol=1e-14)


@named(PORT_LAWS)
def test_slope_of_a_port_is_the_derivative_of_its_action(law: PortLaw) -> None:
    u = torch.from_numpy(POINTS).clone().requires_grad_(True)
    (slope,) = torch.autograd.grad(law.action(u, *law.example).sum(), u)
    np.testing.assert_allclose(law.slope(POINTS, *law.example), slope.numpy(), rtol=1e-14)
    assert law.action(0.0, *law.example) == 0.0


def test_a_name_is_registered_once() -> None:
    for law in (STORAGE_LAWS["spring"], RESISTOR_LAWS["linear"], PORT_LAWS["linear"]):
        with pytest.raises(StructureViolated, match="choose another name"):
            register(law)
    with pytest.raises(StructureViolated, match=r"the slope of φ\(0\) = nan"):
        register(ResistorLaw("without_slope", lambda effort, q, c: c * sqrt(absolute(effort)) * effort, (1.0,)))


def loss(x: float, end: float, current: float, mean: float, h: float, capacitance: float) -> float:
    """Energy dissipated in the resistor of a leaf during a step, ``h i ē − ΔH``."""
    return h * current * mean - 0.5 * (end - x) * (end + x) / capacitance


def amounts(low: float, high: float) -> st.SearchStrategy[float]:
    """Values whose squares keep their digits: next to the smallest numbers relative accuracy does not exist."""
    return st.floats(low, high).map(lambda v: 0.0 if abs(v) < 1e-60 else v)


leaves = st.fixed_dictionaries(
    {
        "x": amounts(-3.0, 3.0),
        "current": amounts(-5.0, 5.0),
        "h": st.floats(-4.0, 1.0).map(lambda e: 10.0**e),
        "capacitance": st.floats(-1.5, 1.0).map(lambda e: 10.0**e),
        # Relaxation from far slower than the step to far faster.
        "rho": st.one_of(st.just(0.0), st.floats(-6.0, 7.0).map(lambda e: 10.0**e)),
        "low": st.one_of(st.just(0.0), amounts(-2.0, 0.0)),
        "high": st.one_of(st.just(0.0), amounts(0.0, 2.0)),
        # Mostly none, as in the actuator.
        "leak": st.one_of(st.just(0.0), st.just(0.0), st.floats(-6.0, 5.0).map(lambda e: 10.0**e)),
    }
)
Leaf = dict[str, float]


def advanced(x, current, h, capacitance, rho, low, high, leak):  # type: ignore[no-untyped-def]
    """End state and mean effort of a leaf."""
    s = 1.0 / capacitance
    known = *relaxation(h * (rho + leak) * s), *relaxation(h * leak * s)
    return rc_flow(x, current, h, s, rho, low, high, leak, *known)


def reference(leaf: Leaf) -> tuple[float, float, float]:
    """End state, mean effort and loss by Radau, both integrals carried along."""
    c, rho, low, high, i, leak = (leaf[k] for k in ("capacitance", "rho", "low", "high", "current", "leak"))

    def rate(t: float, z: np.ndarray) -> list[float]:
        e = z[0] / c
        flow = piecewise_linear(e, rho, low, high) + leak * e
        return [float(i - flow), e, float(e * flow)]

    def jacobian(t: float, z: np.ndarray) -> np.ndarray:
        e = z[0] / c
        outside = e > high or e < low
        flow = float(piecewise_linear(e, rho, low, high)) + leak * e
        slope = (rho if outside else 0.0) / c + leak / c
        return np.array([[-slope, 0.0, 0.0], [1.0 / c, 0.0, 0.0], [flow / c + e * slope, 0.0, 0.0]])

    sol = solve_ivp(rate, (0.0, leaf["h"]), [leaf["x"], 0.0, 0.0], "Radau", rtol=1e-11, atol=1e-13, jac=jacobian)
    return sol.y[0, -1], sol.y[1, -1] / leaf["h"], sol.y[2, -1]


class TestExactLeaf:
    @settings(max_examples=40, deadline=None)
    @given(leaves)
    def test_agrees_with_radau(self, leaf: Leaf) -> None:
        end, mean, lost = reference(leaf)
        got_end, got_mean = advanced(**leaf)
        size = abs(leaf["x"]) + leaf["h"] * abs(leaf["current"]) + 1e-6
        assert abs(got_end - end) < 2e-8 * size
        assert abs(got_mean - mean) < 2e-8 * size / leaf["capacitance"]
        got = loss(leaf["x"], got_end, leaf["current"], got_mean, leaf["h"], leaf["capacitance"])
        # h i ē − ΔH is the energy that the resistor takes: the exchanged power is exact.
        assert abs(got - lost) < 1e-7 * size**2 / leaf["capacitance"]

    @pytest.mark.parametrize("side", [1.0, -1.0])
    @pytest.mark.parametrize("leak", [0.0, 1e-10])
    def test_a_steep_one_that_turns_at_its_threshold_moves_on_inside(self, side: float, leak: float) -> None:
        # Just beyond; what it would slide to lies 1e-17 inside, which rounding makes the threshold.
        x, current = side * (1.0 + 1e-15), -side * 1e-9
        end, mean = advanced(x, current, 1.0, 1.0, 1e8, -1.0, 1.0, leak)
        moved = current - side * leak
        assert abs(end - side - moved) < 1e-5 * abs(moved)
        assert abs(mean - side - 0.5 * moved) < 1e-5 * abs(moved)

    @settings(max_examples=600, deadline=None)
    @given(leaves, st.sampled_from([1e-9, 1.0, 1e9]))
    def test_is_passive_to_rounding_at_any_stiffness(self, leaf: Leaf, units: float) -> None:
        leaf = leaf | {"x": leaf["x"] * units, "capacitance": leaf["capacitance"] * units}
        leaf = leaf | {"current": leaf["current"] * units, "rho": leaf["rho"] * units}
        leaf = leaf | {"leak": leaf["leak"] * units}
        end, mean = advanced(**leaf)
        lost = loss(leaf["x"], end, leaf["current"], mean, leaf["h"], leaf["capacitance"])
        given_ = abs(leaf["h"] * leaf["current"] * mean)
        held = (leaf["x"] ** 2 + end**2) / leaf["capacitance"]
        assert np.isfinite([end, mean]).all()
        assert lost >= -1e-14 * (given_ + held)

    @settings(max_examples=200, deadline=None)
    @given(leaves, st.floats(0.01, 0.99))
    def test_is_a_flow(self, leaf: Leaf, share: float) -> None:
        # Two parts of a step are the whole of it: exactness that does not depend on another solver.
        first, mean_1 = advanced(**(leaf | {"h": share * leaf["h"]}))
        second, mean_2 = advanced(**(leaf | {"h": (1.0 - share) * leaf["h"], "x": first}))
        end, mean = advanced(**leaf)
        # Currents below 1e-100 count as none.
        size = abs(leaf["x"]) + leaf["h"] * abs(leaf["current"]) + 1e-80
        assert abs(second - end) <= 1e-12 * size
        assert abs(share * mean_1 + (1.0 - share) * mean_2 - mean) <= 1e-12 * size / leaf["capacitance"]

    @settings(max_examples=100, deadline=None)
    @given(leaves)
    def test_tensors_have_the_value_of_floats_and_finite_gradients(self, leaf: Leaf) -> None:
        tensors = {k: torch.tensor(v, dtype=torch.float64, requires_grad=True) for k, v in leaf.items()}
        end, mean = advanced(**tensors)
        wanted = advanced(**leaf)
        size = abs(leaf["x"]) + leaf["h"] * abs(leaf["current"]) + 1e-80
        assert abs(end.item() - wanted[0]) <= 1e-14 * size
        assert abs(mean.item() - wanted[1]) <= 1e-14 * size / leaf["capacitance"]
        gradients = torch.autograd.grad(end + mean, list(tensors.values()), allow_unused=True)
        assert all(g is None or bool(torch.isfinite(g)) for g in gradients)
