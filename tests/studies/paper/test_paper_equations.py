"""Eqs. (2), (9) and (19) as the paper prints them, written once more here, against the models."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch
from junctions import recording
from scipy.integrate import solve_ivp

from phnn.laws import RESISTOR_LAWS
from phnn.models.actuator import TABLE_1, from_paper
from phnn.models.bouc_wen import TABLE_2, bouc_wen
from phnn.network import PortHamiltonianSystem
from phnn.simulate import simulate
from studies.generator.plans import PEAK, sine

torch.set_num_threads(1)


def dead_zone(x: float, rho: float, d: float) -> float:
    """Eq. (2)."""
    if x < -d / 2:
        return rho * (x + d / 2)
    if x > d / 2:
        return rho * (x - d / 2)
    return 0.0


@pytest.mark.parametrize("number", [1, 2])
def test_dead_zone_is_equation_2(number: int) -> None:
    rho, d = TABLE_1[f"rho_{number}"], TABLE_1[f"d_{number}"]
    sizes = d * np.array([0.0, 0.1, 0.25, 0.4999, 0.5, 0.5001, 0.75, 1.0, 3.0])
    for x in (*sizes, *-sizes):
        wanted = dead_zone(x, rho, d)
        assert RESISTOR_LAWS["dead_zone"].flow(x, 0.0, rho, d) == pytest.approx(wanted, rel=1e-13, abs=1e-16 * rho)
        tensors = [torch.tensor(v, dtype=torch.float64) for v in (x, 0.0, rho, d)]
        assert RESISTOR_LAWS["dead_zone"].flow(*tensors).item() == pytest.approx(wanted, rel=1e-13, abs=1e-16 * rho)


def test_leak_of_each_hysteron_of_table_1_is_equation_2() -> None:
    # In the whole actuator: eq. (3) at rest, where the charge moves by its leak alone.
    system = PortHamiltonianSystem(from_paper())
    for number in (1, 2):
        c, rho, d = (TABLE_1[f"{n}_{number}"] for n in ("C", "rho", "d"))
        for volts in (-2.0 * d, -0.51 * d, -0.49 * d, 0.2 * d, 0.5 * d, 0.6 * d, 5.0 * d):
            x = torch.zeros(1, 4, dtype=torch.float64)
            x[0, number - 1] = c * volts
            rate = system.vector_field(x, torch.zeros(1, 2, dtype=torch.float64))[0, number - 1]
            assert rate.item() == pytest.approx(-dead_zone(volts, rho, d), rel=1e-12, abs=1e-14 * rho)


def test_hamiltonian_is_equation_9() -> None:
    # H = x' diag(1/C_1, 1/C_2, k, 1/m) x / 2, and its gradient.
    network = from_paper()
    assert network.state_names == ("Q_1", "Q_2", "q", "p")
    diagonal = np.array([1.0 / TABLE_1["C_1"], 1.0 / TABLE_1["C_2"], TABLE_1["k"], 1.0 / TABLE_1["m"]])
    x = np.random.default_rng(0).standard_normal((50, 4)) * np.sqrt(1e-3 / diagonal)
    system, states = PortHamiltonianSystem(network), torch.from_numpy(x)
    np.testing.assert_allclose(system.energy(states).detach(), 0.5 * (x**2) @ diagonal, rtol=1e-13)
    np.testing.assert_allclose(system.efforts(states).detach(), x * diagonal, rtol=1e-13)


@pytest.mark.parametrize("hertz", [1.0, 100.0])
def test_bouc_wen_is_equation_19(hertz: float) -> None:
    driven = sine(hertz, PEAK, 2, 8000)
    v, w = TABLE_2, 2.0 * np.pi * hertz

    def rate(t: float, x: np.ndarray) -> list[float]:
        h, delta, p = x
        voltage, slope = PEAK * np.sin(w * t), PEAK * w * np.cos(w * t)
        return [
            v["A"] * slope - v["beta"] * abs(slope) * h - v["gamma"] * abs(h) * slope,
            p / v["m"],
            -v["k"] * delta - v["b"] * p / v["m"] + v["K_v"] * voltage - v["K_h"] * h,
        ]

    # One piece between two turns of the voltage, where |V̇| has its kinks.
    turns = [0.0, *(np.arange(4) / 2 + 0.25) / hertz, 2.0 / hertz]
    x, path = np.zeros(3), np.empty(driven.samples)
    for start, end in pairwise(turns):
        inside = (driven.t >= start) & (driven.t < end)
        asked = np.append(driven.t[inside], end)
        found = solve_ivp(rate, (start, end), x, "Radau", asked, rtol=1e-9, atol=[1e-12, 1e-14, 1e-16]).y
        path[inside], x = found[1, :-1], found[:, -1]
    y = simulate(bouc_wen(), recording(driven.t, driven.voltage(driven.t)), 2).y
    # At 1 Hz a step is a fifth of the mechanical period, in which the oscillator is set in motion.
    assert np.abs(y - path).max() < 5e-5 * np.abs(path).max()
