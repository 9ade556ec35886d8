"""The blocks before and behind the network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phnn.chain.amplifiers import bouc_wen, lowpass, saturation
from phnn.chain.sensors import drift
from phnn.errors import InputRefused, StructureViolated
from phnn.laws.namespace import TINY
from phnn.models.actuator import from_paper
from phnn.models.bouc_wen import TABLE_2
from phnn.parameters import Parameter, positive
from phnn.setup import AMPLIFIERS, SENSORS, Block, Setup

H = np.full(400, 1e-3)
NODES = np.concatenate([[0.0], np.cumsum(H)])
FINE_T = np.column_stack([NODES[:-1], NODES[:-1] + 0.5e-3, NODES[1:]])


def command(t: Any) -> Any:
    """Reversals at several amplitudes, from 3 V."""
    return 3.0 + 40.0 * np.sin(2 * np.pi * 7.0 * t) * (0.3 + t) + 15.0 * np.sin(2 * np.pi * 19.0 * t)


def slope(t: float) -> float:
    return float(np.imag(command(complex(t, TINY))) / TINY)


@pytest.mark.parametrize("tau", [1e-6, 2e-3, 0.05, 30.0])
def test_lowpass_solves_its_equation(tau: float) -> None:
    got = lowpass(command(FINE_T), H, 3.0, tau)
    exact = solve_ivp(
        lambda t, v: (command(t) - v) / tau, (0.0, 0.4), [3.0], "Radau", FINE_T[:, 1], rtol=1e-9, atol=1e-9
    ).y[0]  # fmt: skip
    # The input is taken as straight between the points of the sub-steps.
    assert np.abs(got[:, 1] - exact).max() < 1e-2
    np.testing.assert_allclose(got[1:, 0], got[:-1, 2], rtol=1e-14)
    assert got[0, 0] == pytest.approx(3.0)


def test_lowpass_is_exact_for_a_ramp_and_after_a_jump() -> None:
    tau, t = 0.02, FINE_T
    ramp = lowpass(5.0 * t, H, 0.0, tau)
    np.testing.assert_allclose(ramp, 5.0 * (t - tau * (1.0 - np.exp(-t / tau))), atol=1e-12)
    jump = lowpass(np.ones_like(t), H, 0.0, tau)
    np.testing.assert_allclose(jump, 1.0 - np.exp(-t / tau), atol=1e-12)


@pytest.mark.parametrize(
    ("beta", "gamma"), [(TABLE_2["beta"], TABLE_2["gamma"]), (0.05, 0.02), (0.02, 0.02), (0.03, -0.02), (1e-7, 0.0)]
)
def test_bouc_wen_solves_equation_19(beta: float, gamma: float) -> None:
    a, weight = TABLE_2["A"], TABLE_2["K_h"] / TABLE_2["K_v"]
    fine = command(FINE_T)
    got = (fine - bouc_wen(fine, H, 3.0, a, beta, gamma, weight)) / weight

    def rate(t: float, h: np.ndarray) -> list[float]:
        v = slope(t)
        return [a * v - beta * abs(v) * h[0] - gamma * abs(h[0]) * v]

    exact = solve_ivp(rate, (0.0, 0.4), [0.0], "DOP853", FINE_T[:, 1], rtol=1e-9, atol=1e-12, max_step=2e-3).y[0]
    # A reversal inside a sub-step is the only approximation.
    assert np.abs(got[:, 1] - exact).max() < 1e-3 * np.abs(exact).max()


def test_bouc_wen_does_not_depend_on_the_rate() -> None:
    args = (TABLE_2["A"], TABLE_2["beta"], TABLE_2["gamma"], 40.0)
    fine = command(FINE_T)
    np.testing.assert_array_equal(bouc_wen(fine, H, 3.0, *args), bouc_wen(fine, 100.0 * H, 3.0, *args))
    # A monotone stretch in one step or in many is the same.
    rise = np.linspace(0.0, 60.0, 801)
    many = np.column_stack([rise[:-2:2], rise[1:-1:2], rise[2::2]])
    once = np.array([[0.0, 30.0, 60.0]])
    assert bouc_wen(once, H[:1], 0.0, *args)[0, 2] == pytest.approx(bouc_wen(many, H, 0.0, *args)[-1, 2], rel=1e-12)


def test_saturation_clips_both_ways() -> None:
    got = saturation(command(FINE_T), H, 3.0, 12.5)
    np.testing.assert_array_equal(got, np.clip(command(FINE_T), -12.5, 12.5))
    assert got.max() == 12.5
    assert got.min() == -12.5


def test_drift_adds_a_ramp() -> None:
    np.testing.assert_allclose(drift(np.ones(3), np.array([0.0, 2.0, 4.0]), 0.5), [1.0, 2.0, 3.0])


VALUES = {"lowpass": (2e-3,), "saturation": (12.5,), "bouc_wen": (0.0087, 0.006, 0.014, 40.0)}


@pytest.mark.parametrize("kind", AMPLIFIERS)
def test_complex_steps_through_every_block_are_its_derivatives(kind: str) -> None:
    block: Callable[..., Any] = AMPLIFIERS[kind]
    values, fine = VALUES[kind], command(FINE_T)
    for k, value in enumerate(values):
        moved = [complex(v, TINY) if i == k else v for i, v in enumerate(values)]
        got = np.imag(block(fine, H, 3.0, *moved)) / TINY
        step = 1e-6 * value
        ends = [
            block(fine, H, 3.0, *(v + s * (i == k) for i, v in enumerate(values))) for s in (step, -step)
        ]  # fmt: skip
        wanted = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(got, wanted, atol=2e-6 * np.abs(wanted).max())
        assert np.abs(wanted).max() > 0.0


def test_tables_have_the_blocks() -> None:
    assert set(VALUES) == set(AMPLIFIERS)
    assert SENSORS["drift"] is drift


def chain() -> Setup:
    tau = positive("tau_a", 1e-3, "s")
    return (
        Setup(from_paper())
        .with_block("amplifier", Block("lowpass", ("tau_a",)), (tau,))
        .with_block("sensor", Block("drift", ("rate",)), (Parameter("rate", 1e-7, fixed=True),))
    )


def test_values_reach_network_and_blocks() -> None:
    setup = chain()
    assert [b.kind for b in (*setup.amplifier, *setup.sensor)] == ["lowpass", "drift"]
    moved = setup.with_values({"tau_a": 2e-3, "k": 2e4})
    assert moved.values()["tau_a"] == 2e-3
    assert moved.network.parameters["k"].value == 2e4
    assert setup.values()["k"] == 24579.0
    assert "rate" not in setup.free
    assert {"tau_a", "k"} <= set(setup.free)
    assert list(setup.parameters)[:4] == ["m", "k", "b", "alpha"]
    assert moved.with_values(setup.values()) == setup


def test_names_that_are_not_there_or_twice_are_refused() -> None:
    with pytest.raises(StructureViolated, match="no parameter called tau in model"):
        chain().with_values({"tau": 1.0})
    with pytest.raises(InputRefused, match="two parameters are called m"):
        Setup(from_paper()).with_block("amplifier", Block("lowpass", ("m",)), (positive("m", 1.0, "s"),)).values()
