"""Passivity-based control: the closed loop is a passive network, and the sampled law is the same law."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import phnn
from phnn.control import Controller, shape, simulate
from phnn.models.variants import thermal_hrc
from phnn.network.elements import Network, Port
from phnn.network.lyapunov import forced_equilibrium, shifted_energy, shifted_rate
from phnn.setup import Block, Setup

DT = 5e-5
ACTUATOR = phnn.models.hrc(hysterons=2)
LIMITS = (-100.0, 150.0)


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def learned(resistor: type = phnn.nn.MonotoneMLP) -> Network:
    """An actuator of learned hysterons and a learned spring."""
    network = phnn.models.hrc(hysterons=2).replace("q", phnn.nn.ConvexEnergyMLP(1e-4, 3.0))
    for i in (1, 2):
        network = network.replace(f"hysteron_{i}", resistor(effort_scale=20.0, flow_scale=1e-3))
    return network


NETWORKS = {
    "paper": ACTUATOR,
    "five": phnn.models.hrc(hysterons=5),
    "none": phnn.models.hrc(hysterons=0),
    "monotone": learned(),
}


@pytest.fixture(params=NETWORKS)
def controller(request: pytest.FixtureRequest) -> Controller:
    return shape(NETWORKS[request.param])


def test_the_equilibrium_is_the_papers_at_the_ends_of_the_dead_zones() -> None:
    for q_star in (120e-6, -120e-6):
        x, u = shape(ACTUATOR).equilibrium(q_star)
        values = {n: p.value for n, p in ACTUATOR.parameters.items()}
        ends = [math.copysign(values[f"C_{i}"] * values[f"d_{i}"] / 2.0, q_star) for i in (1, 2)]
        np.testing.assert_allclose(x[:2], ends, rtol=1e-11)
        torch.testing.assert_close(forced_equilibrium(ACTUATOR, tensor(u, 0.0), x[:2]), x, rtol=1e-12, atol=0.0)
    small, _ = shape(ACTUATOR).equilibrium(1e-6)
    np.testing.assert_allclose(small[:2], values["alpha"] * 1e-6, rtol=1e-12)  # all charge stays


def test_the_closed_loop_rests_at_its_equilibrium(controller: Controller) -> None:
    x, u = controller.equilibrium(50e-6)
    closed = phnn.PortHamiltonianSystem(controller.closed_loop())
    rest = controller.begin(x, 50e-6)
    forces = closed.efforts(rest).abs().max() * controller.mechanics.alpha
    assert closed.vector_field(rest, tensor(0.0)).abs().max() < 1e-12 * forces
    assert x[controller.mechanics.q] == 50e-6
    plant = phnn.PortHamiltonianSystem(controller.network)
    assert plant.vector_field(x, tensor(u, 0.0)).abs().max() < 1e-12 * forces


@pytest.mark.parametrize("integral", [None, 0.0])
@pytest.mark.parametrize("network", [*NETWORKS.values(), learned(phnn.nn.SectorMLP)])
def test_the_closed_loop_is_passive_at_any_state(network: Network, integral: float | None) -> None:
    closed = phnn.PortHamiltonianSystem(shape(network, integral=integral).closed_loop())
    scale = tensor(*({"m": 1e-4, "kg m/s": 1e-3}.get(s.unit, 1e-5) for s in closed.network.storages))
    x = scale * torch.randn(200, len(scale), dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    balance = closed.power_balance(x, torch.randn(200, 1, dtype=torch.float64))
    assert balance.dissipated.min() >= 0.0
    terms = balance.dissipated.sum(-1) + balance.supplied.abs().sum(-1)
    assert (balance.defect.abs() < 1e-9 * terms).all()
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
        q = x[:, closed.state_names.index("q")]
    # Hysteresis leaves one of the set of equilibria, and the springs decide how far from q*.
    assert abs(q[-1] - q_star) < 0.02 * abs(q_star)
    assert energy[-1] < 0.02 * energy[0]


@pytest.mark.parametrize("times", [0.5, 4.0])
def test_added_stiffness_leaves_the_stated_share_of_an_offset(times: float) -> None:
    plant = phnn.models.hrc(hysterons=0)
    ours = shape(plant.with_values({"k": 1.1 * 24579.0}), stiffness=times * 24579.0)
    loop = phnn.PortHamiltonianSystem(replace(ours, network=plant).closed_loop())
    start = ours.begin(torch.zeros(2, dtype=torch.float64), 50e-6)
    x, _ = phnn.simulate(loop, torch.zeros(8000, 1, dtype=torch.float64), start, 1e-5)
    added = ours.stiffness + ours.damping * ours.integral
    assert x[-1, -2].item() - 50e-6 == pytest.approx(0.1 * 24579.0 * 50e-6 / (24579.0 + added), rel=1e-6)


@pytest.mark.parametrize("leak", [True, False])
def test_sampled_with_the_models_own_plant_follows_a_smooth_reference(leak: bool) -> None:
    reference = 40e-6 * np.sin(2.0 * np.pi * 60.0 * DT * np.arange(400)) ** 3
    law = shape(ACTUATOR).sampled(DT, leak=leak, bandwidth=math.inf)
    run = simulate(ACTUATOR, law, reference, DT, substeps=1)
    assert np.abs(run.displacement[2:] - reference[2:]).max() < 1e-8


def test_sampled_removes_the_offset_that_the_leak_leaves() -> None:
    wrong = ACTUATOR.with_values({n: 1.1 * ACTUATOR.parameters[n].value for n in ("k", "d_1", "d_2")})
    reference = np.full(1200, 50e-6)
    ends = {}
    for leak in (True, False):
        law = shape(wrong, limits=LIMITS).sampled(DT, leak=leak)
        ends[leak] = abs(simulate(ACTUATOR, law, reference, DT).displacement[-1] - 50e-6)
    assert ends[True] > 1e-6
    assert ends[False] < 5e-9


def test_at_the_limits_the_integral_does_not_wind_up() -> None:
    reference = np.concatenate([np.full(800, 400e-6), np.full(800, 40e-6)])
    run = simulate(ACTUATOR, shape(ACTUATOR, limits=LIMITS).sampled(DT), reference, DT)
    assert run.voltage.max() == LIMITS[1]
    assert run.voltage.min() >= LIMITS[0]
    assert np.abs(run.displacement[900:] - 40e-6).max() < 3e-6  # within 5 ms after the limit was left


@pytest.mark.parametrize(("stiffness", "integral", "slope"), itertools.product((0.3, 1.0), (0.0, 0.4), (0.9, 1.1)))
def test_noise_and_wrong_masses_leave_the_sampled_loop_stable(stiffness: float, integral: float, slope: float) -> None:
    wrong = ACTUATOR.with_values({n: slope * ACTUATOR.parameters[n].value for n in ("m", "k", "alpha")})
    law = shape(wrong, stiffness=stiffness * 24579.0, integral=integral * 7000.0).sampled(DT)
    run = simulate(ACTUATOR, law, np.full(600, 30e-6), DT, noise=5e-8, seed=2)
    assert run.displacement[400:].std() < 6e-8
    assert np.std(run.measured - run.displacement) == pytest.approx(5e-8, rel=0.1)


def test_learned_models_are_controlled() -> None:
    network = learned(phnn.nn.SectorMLP)
    run = simulate(network, shape(phnn.Model(Setup(network))).sampled(DT), np.full(600, 30e-6), DT)
    assert abs(run.displacement[-1] - 30e-6) < 1e-9


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        ("hrc", {}, "a str: give a Model"),
        (Setup(ACTUATOR, amplifier=(Block("lowpass"),)), {}, "has lowpass beside its network"),
        (ACTUATOR, {"stiffness": -1.0}, "stiffness = -1 N/m: give a positive"),
        (ACTUATOR, {"damping": 0.0}, "damping = 0 N s/m: give a positive"),
        (ACTUATOR, {"integral": 1e6}, "give 0 or more, and a finite corner above it"),
        (ACTUATOR, {"limits": (1.0, -1.0)}, "give the lowest voltage"),
        (replace(ACTUATOR, ports=()), {}, "no input port"),
        (replace(ACTUATOR, ports=(Port("voltage", {"q": 1.0}),)), {}, "does not push the mass"),
        (thermal_hrc(), {}, "leave out the port law, modulations, modulator states"),
    ],
)
def test_what_cannot_be_controlled_is_refused(model: object, options: dict[str, object], message: str) -> None:
    with pytest.raises(phnn.InputRefused, match=message):
        shape(model, **options)  # type: ignore[arg-type]


def test_what_the_law_cannot_do_is_refused() -> None:
    ours = shape(ACTUATOR, limits=LIMITS)
    with pytest.raises(phnn.InputRefused, match=r"takes 170.* V, outside of -100 to 150 V: give a displacement nearer"):
        ours.equilibrium(300e-6)
    with pytest.raises(phnn.InputRefused, match="finite displacement"):
        ours.equilibrium(math.nan)
    with pytest.raises(phnn.InputRefused, match=r"sampled loop is unstable.*sample faster"):
        ours.sampled(2e-4)
    with pytest.raises(phnn.InputRefused, match="dt = 0"):
        ours.sampled(0.0)
    with pytest.raises(phnn.InputRefused, match="noise = -1"):
        simulate(ACTUATOR, ours.sampled(DT), [0.0, 1e-6], DT, noise=-1.0)
