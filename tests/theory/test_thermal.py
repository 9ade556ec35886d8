"""The actuator that warms up: both laws of thermodynamics in every step, and the isothermal limit."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import march, recording, warming
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from torch import Tensor

from phnn.errors import StructureViolated
from phnn.integrate import quick
from phnn.integrate.equations import check, power_balance
from phnn.laws import MEMORY_LAWS
from phnn.laws.leaf import relaxation
from phnn.models.actuator import hrc
from phnn.network import ModulatorState, Network, PortHamiltonianSystem
from phnn.network.checks import decays_of, rates_of
from phnn.setup import Setup
from phnn.trajectory import Trajectory, simulate

Array = NDArray[np.float64]
# A small body that follows fast, so that a short simulation shows what takes minutes otherwise.
FAST = {"C_T": 2e-4, "R_T": 50.0, "kappa_alpha": 0.02, "kappa_rho": 0.1, "kappa_d": -0.05}


def drawn(seed: int) -> Trajectory:
    """Parameters over decades, an ambient of its own, steps of all sizes, inputs with jumps."""
    random = np.random.default_rng(seed)
    network = warming()
    values = {n: p.value * 10.0 ** random.uniform(-0.5, 0.5) for n, p in network.parameters.items() if p.positive}
    # Where a coupling grows without bound and heat hardly leaves, temperature runs away: none of these does.
    values |= {"C_T": 10.0 ** random.uniform(-2.0, 1.0), "R_T": 10.0 ** random.uniform(-1.0, 3.0)}
    values |= {n: random.normal() * 0.01 for n in ("kappa_alpha", "kappa_rho", "kappa_d")}
    values |= {"T_a": random.uniform(250.0, 350.0)}
    steps = 60
    h = 10.0 ** random.uniform(-6.0, 1.0) * random.choice([1.0, 1.0, 0.2], steps)
    u = random.normal(size=(steps, 2)) * random.choice([0.0, 75.0], (steps, 1))
    x0 = np.zeros(5)
    x0[-1] = random.uniform(-20.0, 20.0)
    return march(network.with_values(values), u, h, x0)


NAMES = ("received", "stored", "released", "entropy", "ambient")


def bodies(system: PortHamiltonianSystem) -> list[tuple[int, list[Any]]]:
    """Place in the state of every body, with its heat capacity, resistance, ambient and reference temperature."""
    memories = enumerate(system.network.memories, len(system.network.storages))
    return [(k, [*map(system.value, m.parameters)]) for k, m in memories if MEMORY_LAWS[m.law].heats]


def thermal_energy(system: PortHamiltonianSystem, x: Tensor) -> Tensor:
    """(N,) ``Σ C_T (T − T_ref)`` [J]."""
    return sum((capacity * x[:, k] for k, (capacity, *_) in bodies(system)), 0.0 * x[:, 0])


def balances(trajectory: Trajectory) -> tuple[PortHamiltonianSystem, SimpleNamespace, Tensor]:
    """The module, heat [J] and entropy [J/K] of every step, each (n, B), and (n,) what was supplied [J]."""
    system = PortHamiltonianSystem(trajectory.setup.network)
    first, x, h = len(system.network.storages), torch.from_numpy(trajectory.states), torch.from_numpy(trajectory.h)
    drives, columns = torch.from_numpy(trajectory.efforts[:, first:]), []
    with torch.no_grad():
        start, decay = x[:-1, first:], h[:, None] * decays_of(system)
        mean = start + h[:, None] * relaxation(decay)[1] * rates_of(system, start, drives)
        for k, (capacity, resistance, ambient, reference) in bodies(system):
            a, b = x[:-1, k], x[1:, k]
            released = h * (mean[:, k - first] - (ambient - reference)) / resistance
            entropy = capacity * torch.log1p((b - a) / (reference + a))
            columns.append([h * drives[:, k - first], capacity * (b - a), released, entropy, released / ambient])
    heat = SimpleNamespace(**{n: torch.stack(c, -1) for n, *c in zip(NAMES, *columns, strict=True)})
    return system, heat, power_balance(trajectory, system).supplied.sum(-1)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31 - 1))
def test_total_energy_changes_by_what_is_supplied_and_released(seed: int) -> None:
    trajectory = drawn(seed)
    check(trajectory)
    system, thermal, supplied = balances(trajectory)
    x = torch.from_numpy(trajectory.states)
    with torch.no_grad():
        total, stored = system.energy(x) + thermal_energy(system, x), system.energy(x)
        size = stored[1:] + stored[:-1] + thermal_energy(system, x).abs()[1:] + thermal.released.abs().sum(-1)
    size = size + supplied.abs() + 1e-200
    defect = total.diff() + thermal.released.sum(-1) - supplied
    assert (defect.abs() <= 1e-12 * size).all()
    assert ((total[-1] - total[0] + thermal.released.sum() - supplied.sum()).abs() <= 1e-12 * size.sum()).all()
    # What became heat is what the resistors dissipated, and the heat adds up by itself.
    dissipated = power_balance(trajectory, system).dissipated.sum(-1)
    assert ((thermal.received.sum(-1) - dissipated).abs() <= 1e-12 * size).all()
    assert ((thermal.stored - thermal.received + thermal.released).abs().sum(-1) <= 1e-12 * size).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31 - 1))
def test_entropy_of_body_and_ambient_never_falls(seed: int) -> None:
    trajectory = drawn(seed)
    system, thermal, supplied = balances(trajectory)
    x = torch.from_numpy(trajectory.states)
    with torch.no_grad():
        held = system.energy(x) + thermal_energy(system, x).abs()
    # Where nothing is lost, or the body has the temperature of the ambient, rounding of energies is left, at 200 K.
    size = ((held[1:] + held[:-1] + supplied.abs()) / 200.0).unsqueeze(-1)
    size = size + thermal.entropy.abs() + thermal.ambient.abs()
    assert ((thermal.entropy + thermal.ambient) >= -1e-12 * size).all()
    assert (trajectory.states[:, -1] > -293.15).all()


def driven(seconds: float, frequency: float, h: float, amplitude: float = 75.0) -> tuple[Array, Array]:
    """Inputs and steps of a sine."""
    n = round(seconds / h)
    t = h * (np.arange(n) + 0.5)
    u = np.zeros((n, 2))
    u[:, 0] = amplitude * np.sin(2 * np.pi * frequency * t)
    return u, np.full(n, h)


@pytest.mark.parametrize("values", [{"C_T": 1e300}, {"kappa_alpha": 0.0, "kappa_rho": 0.0, "kappa_d": 0.0}])
def test_the_isothermal_limit_is_the_actuator_bit_for_bit(
    values: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(quick, "serves", lambda program: False)
    u, h = driven(0.02, 150.0, 1e-5)
    warm = march(warming(values), u, h, np.zeros(5))
    isothermal = march(hrc(2), u, h, np.zeros(4))
    np.testing.assert_array_equal(warm.states[:, :4], isothermal.states)
    np.testing.assert_array_equal(warm.efforts[:, :4], isothermal.efforts)
    assert np.any(warm.states[-1, 4] > 0.0)


def continuous(network: Network, frequency: float, t: Array) -> Array:
    """(5, N) the irreversible port-Hamiltonian system with the entropy as its state, written anew; by Radau.

    Ṡ = (Σ e h⁻¹(e, T) + b v² − (T − T_a)/R_T)/T,     T = T_ref exp(S/C_T)
    """
    c = {n: p.value for n, p in network.parameters.items()}

    def rate(t: float, z: Array) -> list[float]:
        e, q, v = z[:2], 1e-6 * z[2], 1e-3 * z[3]
        temperature = c["T_ref"] * np.exp(1e-6 * z[4] / c["C_T"])
        rise = temperature - c["T_ref"]
        alpha = c["alpha"] * (1.0 + c["kappa_alpha"] * rise)
        flows = []
        for i in (1, 2):
            half = 0.5 * c[f"d_{i}"] * max(1.0 + c["kappa_d"] * rise, 0.0)
            slope = c[f"rho_{i}"] * max(1.0 + c["kappa_rho"] * rise, 0.0)
            flows.append(slope * (max(e[i - 1] - half, 0.0) + min(e[i - 1] + half, 0.0)))
        force = alpha * (75.0 * np.sin(2 * np.pi * frequency * t) - e.sum()) - c["k"] * q - c["b"] * v
        heat = e @ np.array(flows) + c["b"] * v * v - (temperature - c["T_a"]) / c["R_T"]
        return [
            (alpha * v - flows[0]) / c["C_1"], (alpha * v - flows[1]) / c["C_2"], 1e6 * v, 1e3 * force / c["m"],
            1e6 * heat / temperature,
        ]  # fmt: skip

    found = solve_ivp(rate, (0.0, t[-1]), np.zeros(5), "Radau", t, rtol=1e-8, atol=1e-8).y
    found[2] *= 1e-6
    found[4] = c["T_ref"] * np.expm1(1e-6 * found[4] / c["C_T"])
    return found


def test_the_march_tends_to_the_irreversible_system() -> None:
    # The first hysteron slower, so that Radau needs no steps of its microsecond.
    network = warming(FAST | {"rho_1": 6e-3})
    seconds, frequency = 0.03, 100.0
    errors = []
    for h in (2e-5, 1e-5):
        n = round(seconds / h)
        t = h * np.arange(n + 1)
        voltage = 75.0 * np.sin(2 * np.pi * frequency * t)
        run = simulate(Setup(network), recording(t, voltage))
        if not errors:
            exact = continuous(network, frequency, t[:: n // 30])
        got = run.states[run.nodes][:: n // 30]
        errors.append([float(np.abs(got[:, k] - exact[k]).max() / np.abs(exact[k]).max()) for k in (2, 4)])
    assert exact[4, -1] > 0.5
    (q_coarse, rise_coarse), (q_fine, rise_fine) = errors
    assert q_fine < 5e-5 and rise_fine < 5e-5
    # Second order in the displacement, as far as the temperature, which is read half a step late, does not matter.
    assert q_fine < 0.3 * q_coarse
    assert rise_fine == pytest.approx(0.5 * rise_coarse, rel=0.1)


def test_heat_is_kept_once_and_by_what_dissipates() -> None:
    base = warming()
    body = base.memories[0]
    with pytest.raises(StructureViolated, match="damper heats both theta and case"):
        replace(base, memories=(body, replace(body, name="case", of=("damper",))))
    with pytest.raises(StructureViolated, match="holds heat: let resistors drive it, not voltage"):
        replace(base, memories=(replace(body, of=("voltage",)),))
    with pytest.raises(StructureViolated, match="driven by 'nobody', nothing has this name"):
        replace(base, memories=(replace(body, of=("nobody",)),))
    with pytest.raises(StructureViolated, match="each once"):
        replace(base, memories=(ModulatorState("z", "relaxing", ("R_T",), ("damper", "voltage")), body))
    with pytest.raises(StructureViolated, match="share a name"):
        replace(base, memories=(replace(body, name="q"),))


def test_two_bodies_share_what_is_dissipated() -> None:
    base = warming()
    ceramic, case = (replace(base.memories[0], name=n, of=of) for n, of in (
        ("theta", ("hysteron_1", "hysteron_2")), ("case", ("damper",))))  # fmt: skip
    u, h = driven(0.01, 100.0, 1e-5)
    run = march(replace(base, memories=(ceramic, case)), u, h, np.zeros(6))
    check(run)
    _, thermal, _ = balances(run)
    dissipated = power_balance(run).dissipated
    torch.testing.assert_close(thermal.received[:, 1], dissipated[:, 2], rtol=1e-10, atol=1e-20)
    torch.testing.assert_close(thermal.received[:, 0], dissipated[:, 0] + dissipated[:, 1], rtol=1e-10, atol=1e-20)


def gains(amplitude: float, frequency: float, periods: int, values: dict[str, float]) -> tuple[Array, Trajectory]:
    """Amplitude of the displacement in every period of a sine."""
    per_period = 1000
    u, h = driven(periods / frequency, frequency, 1.0 / (per_period * frequency), amplitude)
    run = march(warming(values), u, h, np.zeros(5))
    q = run.states[1:, 2].reshape(periods, per_period)
    return 0.5 * np.ptp(q, axis=1), run


def test_gain_recovers_at_rest() -> None:
    values = {"C_T": 1e-3, "R_T": 200.0, "kappa_alpha": 1e-3, "kappa_rho": 0.0, "kappa_d": 0.0}
    _, run = gains(75.0, 100.0, 60, values)
    hot = float(run.states[-1, 4])
    # Two time constants R_T C_T = 0.2 s at rest, and the same sine again.
    u, h = driven(0.03, 100.0, 5e-5)
    pause, waiting = np.zeros((4000, 2)), np.full(4000, 1e-4)
    again = march(run.setup.network, np.vstack([pause, u]), np.concatenate([waiting, h]), run.states[-1])
    assert again.states[4000, 4] == pytest.approx(hot * np.exp(-2.0), rel=0.05)
    # The charges that the first sine has left stay what they are, whatever the temperature.
    cold = march(run.setup.network, u, h, np.append(again.states[4000, :4], 0.0))
    straight = march(run.setup.network, u, h, np.append(again.states[4000, :4], hot))
    cooled, first, warm = (np.ptp(r.states[-200:, 2]) for r in (again, cold, straight))
    assert 0.0 < cooled / first - 1.0 < 0.25 * (warm / first - 1.0)
