"""Passivity-based control: the closed loop is a passive network, and the sampled law is the same law."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from lyapunov import forced_equilibrium, shifted_energy, shifted_rate

import phnn
from phnn.configuration import config_folder
from phnn.control import Controller, shape, simulate
from phnn.models.network_file import load_network
from phnn.network.elements import Network, Port
from phnn.network.roles import linearised_at_rest
from phnn.setup import Block, Setup

DT = 5e-5
ACTUATOR = phnn.models.hrc(hysterons=2)
LIMITS = (-100.0, 150.0)


def learned(resistor: type = phnn.nn.MonotoneMLP) -> Network:
    """An actuator of learned hysterons and a learned spring."""
    network = phnn.models.hrc(hysterons=2).replace("q", phnn.nn.ConvexEnergyMLP(1e-4, 3.0))
    for i in (1, 2):
        network = network.replace(f"hysteron_{i}", resistor(effort_scale=20.0, flow_scale=1e-3))
    return network


NETWORKS = [ACTUATOR, phnn.models.hrc(hysterons=5), phnn.models.hrc(hysterons=0), learned()]


@pytest.fixture(params=NETWORKS, ids=["paper", "five", "none", "monotone"])
def controller(request: pytest.FixtureRequest) -> Controller:
    return shape(request.param)


def test_the_equilibrium_is_the_papers_at_the_ends_of_the_dead_zones() -> None:
    for q_star in (120e-6, -120e-6):
        x, u = shape(ACTUATOR).equilibrium(q_star)
        values = {n: p.value for n, p in ACTUATOR.parameters.items()}
        ends = [math.copysign(values[f"C_{i}"] * values[f"d_{i}"] / 2.0, q_star) for i in (1, 2)]
        np.testing.assert_allclose(x[:2], ends, rtol=1e-11)
        papers = forced_equilibrium(ACTUATOR, torch.tensor([u, 0.0], dtype=torch.float64), x[:2])
        torch.testing.assert_close(papers, x, rtol=1e-12, atol=0.0)
    small, _ = shape(ACTUATOR).equilibrium(1e-6)
    np.testing.assert_allclose(small[:2], values["alpha"] * 1e-6, rtol=1e-12)  # all charge stays


def test_the_closed_loop_rests_at_its_equilibrium(controller: Controller) -> None:
    x, _ = controller.equilibrium(50e-6)
    closed = phnn.PortHamiltonianSystem(controller.closed_loop())
    rest = controller.begin(x, 50e-6)
    forces = closed.efforts(rest).abs().max() * controller.mechanics.alpha
    assert closed.vector_field(rest, torch.zeros(1, dtype=torch.float64)).abs().max() < 1e-12 * forces
    assert x[controller.mechanics.q] == 50e-6


@pytest.mark.parametrize("integral", [None, 0.0])
@pytest.mark.parametrize("network", [*NETWORKS, learned(phnn.nn.SectorMLP)])
def test_the_closed_loop_is_passive_at_any_state(network: Network, integral: float | None) -> None:
    closed = phnn.PortHamiltonianSystem(shape(network, integral=integral).closed_loop())
    scale = torch.tensor([{"m": 1e-4, "kg m/s": 1e-3}.get(s.unit, 1e-5) for s in closed.network.storages])
    drawn = torch.randn(200, len(scale) + 1, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    x = scale * drawn[:, 1:]
    balance = closed.power_balance(x, drawn[:, :1])
    assert balance.dissipated.min() >= 0.0
    assert (balance.defect.abs() < 1e-9 * (balance.dissipated.sum(-1) + balance.supplied.abs().sum(-1))).all()
    d, j = closed.dissipation(x), closed.structure(x)
    assert torch.equal(j, -j.mT)
    # Entries differ by many decades: scaled by the diagonal.
    size = d.diagonal(dim1=-2, dim2=-1).clamp_min(1e-30).rsqrt()
    assert torch.linalg.eigvalsh(size.unsqueeze(-1) * d * size.unsqueeze(-2)).min() > -1e-12


@pytest.mark.parametrize("q_star", [50e-6, -20e-6])
def test_the_shifted_energy_falls_to_the_equilibria(controller: Controller, q_star: float) -> None:
    x_star, _ = controller.equilibrium(q_star)
    closed = phnn.PortHamiltonianSystem(controller.closed_loop())
    star, start = (controller.begin(x, q_star) for x in (x_star, torch.zeros_like(x_star)))
    with torch.no_grad():
        x, _ = phnn.simulate(closed, torch.zeros(4000, 1, dtype=torch.float64), start, 1e-5)
        energy = shifted_energy(closed, x, star)
        assert energy.diff().max() < 1e-12 * energy[0]
        assert shifted_rate(closed, x, star).max() <= 1e-12 * energy[0] / 1e-5
    assert abs(x[-1, closed.state_names.index("q")] - q_star) < 0.02 * abs(q_star)
    assert energy[-1] < 0.02 * energy[0]


@pytest.mark.parametrize("times", [0.5, 4.0])
def test_added_stiffness_leaves_the_stated_share_of_an_offset(times: float) -> None:
    plant = phnn.models.hrc(hysterons=0)
    ours = shape(plant.with_values({"k": 1.1 * 24579.0}), stiffness=times * 24579.0)
    loop = phnn.PortHamiltonianSystem(replace(ours, network=plant).closed_loop())
    start = ours.begin(torch.zeros(2, dtype=torch.float64), 50e-6)
    x, _ = phnn.simulate(loop, torch.zeros(8000, 1, dtype=torch.float64), start, 1e-5)
    total = 24579.0 + ours.stiffness + ours.damping * ours.integral
    assert x[-1, -2].item() - 50e-6 == pytest.approx(0.1 * 24579.0 * 50e-6 / total, rel=1e-6)


def test_sampled_with_the_models_own_plant_follows_a_smooth_reference() -> None:
    reference = 40e-6 * np.sin(2.0 * np.pi * 60.0 * DT * np.arange(400)) ** 3
    run = simulate(ACTUATOR, shape(ACTUATOR).sampled(DT, bandwidth=math.inf), reference, DT, substeps=1)
    assert np.abs(run.displacement[2:] - reference[2:]).max() < 1e-8


def test_sampled_removes_the_offset_that_the_leak_leaves() -> None:
    wrong = ACTUATOR.with_values({n: 1.1 * ACTUATOR.parameters[n].value for n in ("k", "d_1", "d_2")})
    laws = [shape(wrong, limits=LIMITS).sampled(DT, leak=leak) for leak in (True, False)]
    left = [abs(simulate(ACTUATOR, law, np.full(1200, 50e-6), DT).displacement[-1] - 50e-6) for law in laws]
    assert left[0] > 1e-6 > 5e-9 > left[1]


def test_at_the_limits_the_integral_does_not_wind_up() -> None:
    reference = np.concatenate([np.full(800, 400e-6), np.full(800, 40e-6)])
    run = simulate(ACTUATOR, shape(ACTUATOR, limits=LIMITS).sampled(DT), reference, DT)
    assert (run.voltage.max(), run.voltage.min() >= LIMITS[0]) == (LIMITS[1], True)
    assert np.abs(run.displacement[900:] - 40e-6).max() < 3e-6  # within 5 ms after the limit was left


def test_circuit_and_sampled_law_are_the_law_of_the_page() -> None:
    ours, s = shape(ACTUATOR), 2j * math.pi * 800.0
    c, w, a, alpha = ours.damping, ours.corner, ours.integral, ours.mechanics.alpha
    gain = (ours.stiffness + c * w * s / (s + w) + c * a**2 / (s + a)) / alpha  # voltage per displacement
    rates, current = linearised_at_rest(ours.circuit)
    charges = np.linalg.solve(s * np.eye(3) - rates, current[:, 0])
    capacitances = [ours.circuit.parameters[n].value for n in ("control_C_s", "control_C_f")]
    assert abs((charges[:2] / capacitances).sum() * s * alpha / gain - 1.0) < 1e-12
    law, t = ours.sampled(1e-6, leak=True), 1e-6 * np.arange(5000)
    voltage = np.array([law(y, 0.0) for y in 1e-6 * np.exp(s * t).imag])
    waves = np.stack([np.exp(s * t).imag, np.exp(s * t).real], axis=1)[-1250:]  # one period
    found = np.linalg.lstsq(waves, voltage[-1250:], rcond=None)[0] / 1e-6
    assert abs((found[0] + 1j * found[1]) / -gain - 1.0) < 0.02


@pytest.mark.parametrize(("plant", "share"), [(ACTUATOR, 0.9), (ACTUATOR, 1.1), (learned(phnn.nn.SectorMLP), 1.0)])
def test_noise_and_wrong_parameters_leave_the_sampled_loop_stable(plant: Network, share: float) -> None:
    wrong = plant.with_values({n: share * p.value for n, p in plant.parameters.items() if n in ("m", "k", "alpha")})
    run = simulate(plant, shape(phnn.Model(Setup(wrong))).sampled(DT), np.full(600, 30e-6), DT, noise=5e-8, seed=2)
    assert run.displacement[400:].std() < 6e-8
    assert abs(run.displacement[400:].mean() - 30e-6) < 1e-8
    assert np.std(run.measured - run.displacement) == pytest.approx(5e-8, rel=0.1)


OURS = shape(ACTUATOR, limits=LIMITS)
REFUSED: dict[str, Callable[[], object]] = {
    "a str: give a Model": lambda: shape("hrc"),  # type: ignore[arg-type]
    "has lowpass beside its network": lambda: shape(Setup(ACTUATOR, amplifier=(Block("lowpass"),))),
    "stiffness = -1 N/m: give a positive": lambda: shape(ACTUATOR, stiffness=-1.0),
    "damping = 0 N s/m: give a positive": lambda: shape(ACTUATOR, damping=0.0),
    "give 0 or more, and a finite corner above it": lambda: shape(ACTUATOR, integral=1e6),
    "give the lowest voltage": lambda: shape(ACTUATOR, limits=(1.0, -1.0)),
    "no input port": lambda: shape(replace(ACTUATOR, ports=())),
    "does not push the mass": lambda: shape(replace(ACTUATOR, ports=(Port("voltage", {"q": 1.0}),))),
    "leave out the port law, modulations, modulator states": lambda: shape(
        load_network(config_folder() / "network/thermal_hrc.yaml")
    ),
    r"takes 170.* V, outside of -100 to 150 V: give a displacement nearer": lambda: OURS.equilibrium(300e-6),
    "finite displacement": lambda: OURS.equilibrium(math.nan),
    r"sampled loop is unstable.*sample faster": lambda: OURS.sampled(2e-4),
    "dt = 0": lambda: OURS.sampled(0.0),
    "noise = -1": lambda: simulate(ACTUATOR, OURS.sampled(DT), [0.0, 1e-6], DT, noise=-1.0),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_the_law_cannot_do_is_refused(message: str) -> None:
    with pytest.raises(phnn.InputRefused, match=message):
        REFUSED[message]()
