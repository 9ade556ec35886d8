"""Proposition 1, first part: the hysteron actuator is passive, whatever its hysterons (eqs. (8), (13), (14))."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import march
from random_actuators import COMPILED, random_actuator
from torch import Tensor

from phnn.integrate.program import compile_network
from phnn.network import PortHamiltonianSystem

torch.set_num_threads(1)
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
