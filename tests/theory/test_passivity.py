"""Proposition 1, first part: the hysteron actuator is passive, whatever its hysterons (eqs. (8), (13), (14)).

Passive hysterons whose zeros are not one fixed interval satisfy (14), and yet the function (15) may rise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import march
from lyapunov import forced_equilibrium, shifted_energy, shifted_losses, shifted_rate
from random_actuators import COMPILED, Slot, edge, random_actuator, window
from torch import Tensor, nn

from phnn.effects.hysteresis import HYSTERESIS_ASYMMETRY as ASYMMETRY
from phnn.integrate.program import compile_network
from phnn.models.actuator import TABLE_1, from_paper, hrc
from phnn.network import Network, PortHamiltonianSystem
from phnn.setup import Setup

seeds = st.integers(0, 2**31 - 1)
counts = st.integers(0, 6)
BATCH = 16


def energy_rate(system: PortHamiltonianSystem, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """(...) ``∇Hᵀẋ``, the gradient by automatic differentiation, and the size of its terms."""
    z = x.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(system.energy(z).sum(), z)
    with torch.no_grad():
        rate = system.vector_field(x, u)
        # What flows between the storages cancels in the sum.
        exchanged = gradient.abs().unsqueeze(-2) @ system.structure(x).abs() @ gradient.abs().unsqueeze(-1)
    return (gradient * rate).sum(-1), (gradient * rate).abs().sum(-1) + exchanged.squeeze((-1, -2))


@settings(max_examples=60, deadline=None)
@given(seeds, counts)
def test_stored_power_is_supplied_less_dissipated(seed: int, hysterons: int) -> None:
    actuator, random = random_actuator(seed, hysterons), np.random.default_rng(seed)
    system = PortHamiltonianSystem(actuator.network)
    x, u = actuator.states(random, BATCH), actuator.inputs(random, BATCH)
    stored, size = energy_rate(system, x, u)
    with torch.no_grad():
        efforts = actuator.weights * x
        lost = actuator.losses(x, torch.zeros_like(x))
        # Eq. (7) with (10): y = [α p/m, −p/m].
        y = efforts[..., -1:] * torch.tensor([actuator.value("alpha"), -1.0], dtype=torch.float64)
        supplied = (y * u).sum(-1)
        tolerance = 1e-13 * (size + lost.sum(-1) + (y * u).abs().sum(-1))
        torch.testing.assert_close(system.port_outputs(x, u), y, rtol=1e-13, atol=0.0)
        assert ((stored - supplied + lost.sum(-1)).abs() <= tolerance).all()
        # (14), but not strictly: nothing is lost where nothing moves and all hysterons are in their dead zones.
        assert (lost >= 0.0).all()
        assert (stored <= supplied + tolerance).all()


@settings(max_examples=30, deadline=None)
@given(seeds, counts)
def test_dissipation_matrix_is_the_papers(seed: int, hysterons: int) -> None:
    actuator, random = random_actuator(seed, hysterons), np.random.default_rng(seed)
    x = actuator.states(random, BATCH)
    with torch.no_grad():
        efforts = actuator.weights * x
        lost = actuator.losses(x, torch.zeros_like(x))
        diagonal = torch.zeros_like(x)
        diagonal[:, :hysterons] = lost[:, :-1] / efforts[:, :hysterons] ** 2
        diagonal[:, -1] = actuator.value("b")
        wanted = torch.diag_embed(diagonal)
        torch.testing.assert_close(PortHamiltonianSystem(actuator.network).dissipation(x), wanted, rtol=1e-12, atol=0.0)
        assert (wanted >= 0.0).all()


@settings(max_examples=40, deadline=None)
@given(seeds, counts, st.floats(-3.0, 1.0))
def test_from_rest_no_input_extracts_energy(seed: int, hysterons: int, step: float) -> None:
    actuator, random = random_actuator(seed, hysterons, COMPILED), np.random.default_rng(seed)
    steps = 100
    h = np.full(steps, 10.0**step)
    u = np.cumsum(actuator.inputs(random, steps).numpy() * random.choice([0.0, 1.0], (steps, 1)), axis=0)
    run = march(actuator.network, u, h, np.zeros(hysterons + 2))
    assert compile_network(actuator.network).junctions == ("p",)
    velocity = run.efforts[:, -1]
    power = velocity * (actuator.value("alpha") * u[:, 0] - u[:, 1])
    supplied = np.concatenate([[0.0], np.cumsum(h * power)])
    stored = PortHamiltonianSystem(actuator.network).energy(torch.from_numpy(run.states)).detach().numpy()
    size = np.concatenate([[0.0], np.cumsum(h * np.abs(power))]) + stored
    assert (stored >= 0.0).all()
    assert (stored <= supplied + 1e-11 * size).all()


def with_law(law: nn.Module, hysterons: int = 1, values: dict[str, float] | None = None) -> Network:
    """An actuator whose first hysteron has another law; its other parameters are one where they are not given."""
    plain = hrc(hysterons)
    network = plain.with_values(dict.fromkeys(plain.parameters, 1.0) | (values or {}))
    first = replace(network.resistors[0], law=law, parameters=())
    return replace(network, resistors=(first, *network.resistors[1:]))


def with_slopes(left: float, right: float) -> Network:
    """Table 1 with its second hysteron alone, which conducts this much more or less on either side of its zeros."""
    half = 0.5 * TABLE_1["d_2"]
    law = window(-half, half, TABLE_1["rho_2"] * 2.0 * half, 20.0, (left, right))
    return with_law(law, 1, {n: TABLE_1[n] for n in ("m", "k", "b", "alpha")} | {"C_1": TABLE_1["C_2"]})


FOLLOWING = ASYMMETRY.add_to(Setup(from_paper()), {"kappa_d": 0.5, "q_d": 1e-4}).network
LOOPS = {
    "equation 2": (from_paper(), 50.0, 0.0, 1e-6),
    "equal slopes": (with_slopes(1.0, 1.0), 50.0, 0.0, 1e-6),
    "other slopes": (with_slopes(0.5, 1.5), 50.0, 0.009, 0.011),
    "other slopes, slow": (with_slopes(0.5, 1.5), 0.1, 0.0, 1e-4),
    "thresholds by displacement, slow": (FOLLOWING, 0.1, 0.025, 0.03),
}


@pytest.mark.parametrize("case", LOOPS)
def test_an_asymmetric_damping_law_gives_an_asymmetric_loop(case: str) -> None:
    network, hertz, least, most = LOOPS[case]
    u = np.zeros((12000, 2))
    u[:, 0] = 75.0 * np.sin(2.0 * np.pi * (np.arange(12000) + 0.5) / 2000)
    run = march(network, u, np.full(12000, 1.0 / (2000 * hertz)), np.zeros(len(network.storages)))
    q = run.states[-2000:, network.state_names.index("q")]
    # A loop is symmetric where half a period later all is the same with the other sign, a constant aside.
    even = 0.5 * (q[:1000] + q[1000:])
    assert least <= np.abs(even - even.mean()).max() / (0.5 * np.ptp(q)) <= most


@settings(max_examples=30, deadline=None)
@given(seeds, st.floats(0.1, 10.0), st.floats(0.1, 10.0))
def test_unequal_thresholds_alone_only_shift_the_loop(seed: int, low: float, high: float) -> None:
    # Charge and displacement moved by constants, it is the actuator with the same dead zone about zero.
    middle, x = 0.5 * (high - low), torch.from_numpy(np.random.default_rng(seed).normal(0.0, 5.0, (BATCH, 3)))
    one_sided, even = (
        PortHamiltonianSystem(with_law(Slot(*ends, 1.0, 0.0, 1.0)))
        for ends in ((-low, high), (-low - middle, high - middle))
    )
    u, shift = x[:, :2].flip(0), middle * torch.tensor([1.0, -1.0, 0.0], dtype=torch.float64)
    with torch.no_grad():
        torch.testing.assert_close(one_sided.vector_field(x + shift, u), even.vector_field(x, u), rtol=0.0, atol=1e-12)


logs = st.floats(-3.0, 3.0)


class ThreeZeros(nn.Module):
    """``φ(ε) = ρ ε (|ε|/z − 1)²``: a sector law that vanishes at ``0`` and ``±z`` and nowhere else."""

    def __init__(self, rho: float, zero: float) -> None:
        super().__init__()
        self.rho, self.zero = rho, zero

    def forward(self, effort: Tensor) -> Tensor:
        return self.rho * effort * (effort.abs() / self.zero - 1.0) ** 2


@settings(max_examples=60, deadline=None)
@given(seeds, st.integers(1, 5), logs, logs, logs)
def test_separated_zeros_are_passive_and_repel(seed: int, hysterons: int, rho: float, zero: float, c: float) -> None:
    z, capacity = 10.0**zero, 10.0**c
    network = with_law(ThreeZeros(10.0**rho, z), hysterons, {"C_1": capacity})
    system, random = PortHamiltonianSystem(network), np.random.default_rng(seed)
    u = torch.from_numpy(random.normal(size=2))
    charges = torch.from_numpy(0.4 * random.uniform(-1.0, 1.0, hysterons))
    charges[0] = capacity * z
    x_star = forced_equilibrium(network, u, charges)
    share = torch.from_numpy(random.uniform(0.01, 0.99, 20))
    x = x_star.expand(20, -1).clone()
    x[:, 0] *= share
    other = forced_equilibrium(network, u, torch.cat([torch.zeros(1, dtype=torch.float64), charges[1:]]))
    anywhere = x_star + (1.0 + z + capacity * z) * torch.from_numpy(random.normal(size=(200, hysterons + 2)))
    with torch.no_grad():
        # Every charge between the zeros makes (15) rise.
        assert (shifted_rate(system, x, x_star) > 0.0).all()
        assert (shifted_losses(system, x, x_star)[:, 0] < 0.0).all()
        # The sector condition alone makes the model passive, and (17) non-positive about an uncharged hysteron.
        assert (system.power_balance(anywhere, u.expand(200, 2)).dissipated >= 0.0).all()
        assert (shifted_losses(system, anywhere, other) >= 0.0).all()


def test_learned_damping_may_have_separated_zeros() -> None:
    # Nothing in a sign-constrained law forbids a gap below the window in which it is silent.
    law, u, steps = window(2.0, 3.0, 1.0, 8.0), torch.zeros(2, dtype=torch.float64), 2000
    low = 2.5 - edge(lambda s: law(2.5 - s), 2.0)
    assert 1.9 < low < 2.1
    network = with_law(law)
    # From nine tenths of a separated zero, in mechanical balance and without inputs, it goes to the other one.
    x0 = 0.9 * low * np.array([1.0, -1.0, 0.0])
    x = torch.from_numpy(march(network, np.zeros((steps, 2)), np.full(steps, 0.05), x0).states)
    system = PortHamiltonianSystem(network)
    x_star, origin = forced_equilibrium(network, u, torch.tensor([[low + 1e-12], [0.0]], dtype=torch.float64))
    with torch.no_grad():
        held, stored = shifted_energy(system, x, x_star), system.energy(x)
        about_origin = shifted_energy(system, x, origin)
    # It moves away from the start, and ends ten times as far from the equilibrium as it began.
    assert (held[1:] > held[0]).all()
    assert held[-1] > 99.0 * held[0]
    # The stored energy never rises meanwhile: passivity does not see it.
    torch.testing.assert_close(about_origin, stored, rtol=1e-12, atol=0.0)
    assert (stored[1:] - stored[:-1]).max() <= 1e-9 * stored[0]
    assert stored[-1] < 1e-6 * stored[0]


def test_thresholds_that_follow_the_displacement_may_make_it_rise() -> None:
    system, u = PortHamiltonianSystem(FOLLOWING), torch.tensor([75.0, 0.0], dtype=torch.float64)
    charges = torch.tensor([0.45 * TABLE_1["d_1"] * TABLE_1["C_1"], 0.0], dtype=torch.float64)
    x_star = forced_equilibrium(FOLLOWING, u, charges)
    # Moved back the dead zone is narrower, and the charge that was silent leaks.
    x = x_star + torch.tensor([-0.01 * charges[0].item(), 0.0, -3e-4, 0.0], dtype=torch.float64)
    z = x.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(shifted_energy(system, z, x_star), z)
    with torch.no_grad():
        rate = shifted_rate(system, x, x_star)
        torch.testing.assert_close(gradient @ system.vector_field(x, u), rate, rtol=1e-9, atol=0.0)
        assert rate > 0.0
        anywhere = x_star * torch.from_numpy(np.random.default_rng(0).normal(0.0, 3.0, (500, 4)))
        anywhere[:, 3] = torch.linspace(-1e-3, 1e-3, 500)
        uncharged = forced_equilibrium(FOLLOWING, u, torch.zeros(2, dtype=torch.float64))
        assert (system.power_balance(anywhere, u.expand(500, 2)).dissipated >= 0.0).all()
        assert (shifted_losses(system, anywhere, uncharged) >= 0.0).all()
