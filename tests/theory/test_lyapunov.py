"""Proposition 1, second part: the shifted energy is a Lyapunov function of forced equilibria (eqs. (12), (15)–(18)).

Trajectories end in the set of these equilibria, at a member that depends on the start.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import march
from lyapunov import forced_equilibrium, shifted_energy, shifted_losses, shifted_rate
from networks import networks, random_states, solve_dense
from random_actuators import ALL, COMPILED, Actuator, random_actuator
from torch import Tensor

from phnn.models.actuator import TABLE_1, from_paper
from phnn.network import Network, PortHamiltonianSystem

seeds = st.integers(0, 2**31 - 1)
counts = st.integers(0, 6)
BATCH = 16


def numbers(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


@settings(max_examples=40, deadline=None)
@given(seeds, counts)
def test_forced_equilibrium_is_the_papers_and_at_rest(seed: int, hysterons: int) -> None:
    actuator, random = random_actuator(seed, hysterons, ALL, decades=3.0), np.random.default_rng(seed)
    u, charges = actuator.inputs(random, BATCH), actuator.charges(random, BATCH)
    x_star = forced_equilibrium(actuator.network, u, charges)
    system = PortHamiltonianSystem(actuator.network)
    with torch.no_grad():
        rate = system.vector_field(x_star, u)
        forces = (
            actuator.value("alpha") * (u[:, 0].abs() + (charges / actuator.capacities).abs().sum(-1)) + u[:, 1].abs()
        )
    # Not relative to the sum, in which forces may cancel.
    assert ((x_star - actuator.equilibrium(u, charges)).abs()[:, -2] <= 1e-14 * forces / actuator.value("k")).all()
    assert torch.equal(x_star[:, :hysterons], charges)
    assert torch.equal(rate[:, :-1], torch.zeros(BATCH, hysterons + 1, dtype=torch.float64))
    assert (rate[:, -1].abs() <= 1e-14 * forces).all()
    one = forced_equilibrium(actuator.network, u[0], charges)
    assert torch.equal(one[0], x_star[0])
    assert one.shape == x_star.shape


def settle(actuator: Actuator, x0: Tensor, u: Tensor) -> np.ndarray:
    """(n+1, N) compiled march through forty of the slowest time constants, in steps that resolve the fastest.

    A dead-zone hysteron conducts or does not; between the thresholds the actuator is linear.
    """
    n, ratio = actuator.n, actuator.value("alpha")
    skew = np.zeros((n + 2, n + 2))
    skew[:n, -1], skew[n, -1] = ratio, 1.0
    skew -= skew.T
    root = actuator.weights.sqrt().numpy()
    slopes = [actuator.value(f"rho_{i + 1}") for i in range(n)]
    rates: list[complex] = []
    for on in product((0.0, 1.0), repeat=n):
        lossy = np.diag([*(s * flag for s, flag in zip(slopes, on, strict=True)), 0.0, actuator.value("b")])
        found = np.linalg.eigvals(root[:, None] * (skew - lossy) * root)
        # Charges in dead zones stay: as many rates are zero.
        rates += list(found[np.argsort(np.abs(found))][on.count(0.0) :])
    duration, fastest = 40.0 / -np.max(np.real(rates)), np.max(np.abs(rates))
    steps = max(1000, int(duration * fastest / 3.0))
    inputs = np.broadcast_to(u.numpy(), (steps, 2))
    return march(actuator.network, np.ascontiguousarray(inputs), np.full(steps, duration / steps), x0.numpy()).states


@settings(max_examples=30, deadline=None)
@given(seeds, counts)
def test_every_trajectory_ends_in_the_set(seed: int, hysterons: int) -> None:
    actuator = random_actuator(seed, hysterons, ("dead_zone", "dead_zone", "linear"), decades=0.7)
    random = np.random.default_rng(seed)
    u, x0 = actuator.inputs(random, 1)[0], actuator.states(random, 1)[0]
    x = torch.from_numpy(settle(actuator, x0, u)[[0, -1]])
    start, end = actuator.distance(x, actuator.nearest(x, u))
    assert end <= 1e-9 * start


@pytest.mark.parametrize("kind", ["monotone", "symmetric", "window"])
@pytest.mark.parametrize("seed", range(2))
def test_learned_hysterons_end_in_the_set(kind: str, seed: int) -> None:
    actuator, random = random_actuator(seed, 2, (kind,), decades=0.3), np.random.default_rng(seed)
    u, x0 = actuator.inputs(random, 1)[0], actuator.states(random, 1)[0]
    steps = 8000
    run = march(actuator.network, np.tile(u.numpy(), (steps, 1)), np.full(steps, 0.25), x0.numpy())
    x = torch.from_numpy(run.states[[0, -1]])
    start, end = actuator.distance(x, actuator.nearest(x, u))
    assert end <= 1e-9 * start


def test_a_member_is_stable_but_not_attractive() -> None:
    actuator = random_actuator(1, 2, ("dead_zone",), decades=0.5)
    u, random = numbers(0.7, -0.2), np.random.default_rng(0)
    here, there = forced_equilibrium(actuator.network, u, actuator.charges(random, 2))
    assert actuator.distance(here, there) > 0.1
    stays = torch.from_numpy(settle(actuator, there, u))
    assert actuator.distance(stays, there).max() < 1e-9


def test_table_1_remembers_the_sign_of_its_last_voltage() -> None:
    laws = tuple(random_actuator(0, 2, ("dead_zone",)).laws)
    half = numbers(TABLE_1["d_1"] / 2, TABLE_1["d_2"] / 2)
    actuator = Actuator(from_paper(), laws, torch.stack([-half, half], dim=-1), 2.0 * half)
    none, left = numbers(0.0, 0.0), []
    for voltage in (75.0, -75.0):
        poled = torch.from_numpy(settle(actuator, torch.zeros(4, dtype=torch.float64), numbers(voltage, 0.0))[-1])
        left.append(torch.from_numpy(settle(actuator, poled, none)[-1]))
        assert actuator.distance(left[-1], actuator.nearest(left[-1], none)) < 1e-6 * actuator.distance(
            poled, 0.0 * poled
        )
    # Without input, at rest, and yet not at the origin.
    assert left[0][2] > 1e-6
    torch.testing.assert_close(left[0], -left[1], rtol=1e-6, atol=1e-12)


def drawn(seed: int, actuator: Actuator, count: int = BATCH) -> tuple[Tensor, Tensor, Tensor]:
    """(count, n+2) states and equilibria, and the (count, 2) constant inputs under which they are that."""
    random = np.random.default_rng(seed)
    u = actuator.inputs(random, count)
    x_star = forced_equilibrium(actuator.network, u, actuator.charges(random, count))
    # Near and far, on a scale of the equilibrium's own and of the hysterons'.
    x = actuator.states(random, count) + x_star * torch.from_numpy(random.choice([0.0, 1.0, 3.0], (count, 1)))
    return x, x_star, u


@settings(max_examples=40, deadline=None)
@given(seeds, counts)
def test_shifted_energy_is_positive_definite(seed: int, hysterons: int) -> None:
    actuator = random_actuator(seed, hysterons)
    system = PortHamiltonianSystem(actuator.network)
    x, x_star, _ = drawn(seed, actuator)
    with torch.no_grad():
        held = shifted_energy(system, x, x_star)
        torch.testing.assert_close(held, actuator.distance(x, x_star) ** 2, rtol=1e-10, atol=0.0)
        assert torch.equal(shifted_energy(system, x_star, x_star), torch.zeros(BATCH, dtype=torch.float64))
        assert (held > 0.0).all()
        # Radially unbounded: no more than quadratic, no less.
        far = shifted_energy(system, x_star + 1e3 * (x - x_star), x_star)
        torch.testing.assert_close(far, 1e6 * held, rtol=1e-9, atol=0.0)


@settings(max_examples=40, deadline=None)
@given(seeds, counts)
def test_rate_is_the_time_derivative_of_the_shifted_energy(seed: int, hysterons: int) -> None:
    actuator = random_actuator(seed, hysterons)
    system = PortHamiltonianSystem(actuator.network)
    x, x_star, u = drawn(seed, actuator)
    z = x.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(shifted_energy(system, z, x_star).sum(), z)
    with torch.no_grad():
        wanted = (gradient * system.vector_field(x, u)).sum(-1)
        terms = actuator.losses(x, x_star)
        # What cancels in the product: powers exchanged between storages and ports at the present efforts.
        efforts = (actuator.weights * x).abs()
        exchanged = (efforts.unsqueeze(-2) @ system.structure(x).abs() @ gradient.abs().unsqueeze(-1)).squeeze((-1, -2))
        pushed = gradient[..., -1].abs() * (u.abs() @ system.incidences(x)[1].abs().mT)[..., -1]
        tolerance = 1e-13 * (terms.sum(-1) + exchanged + pushed + (gradient * system.vector_field(x, u)).abs().sum(-1))
        torch.testing.assert_close(shifted_losses(system, x, x_star), terms, rtol=1e-11, atol=0.0)
        assert ((shifted_rate(system, x, x_star) - wanted).abs() <= tolerance).all()
        assert ((-terms.sum(-1) - wanted).abs() <= tolerance).all()


@settings(max_examples=60, deadline=None)
@given(seeds, counts)
def test_no_term_of_the_rate_is_positive(seed: int, hysterons: int) -> None:
    actuator = random_actuator(seed, hysterons)
    x, x_star, _ = drawn(seed, actuator)
    with torch.no_grad():
        losses = shifted_losses(PortHamiltonianSystem(actuator.network), x, x_star)
        efforts = (actuator.weights * x)[:, :hysterons]
        inside = (efforts >= actuator.zeros[:, 0]) & (efforts <= actuator.zeros[:, 1])
    assert (losses >= 0.0).all()
    # S_1 of the proof, and its complement.
    assert torch.equal(losses[:, :hysterons] == 0.0, inside)


@settings(max_examples=25, deadline=None)
@given(seeds, counts, st.floats(-3.0, 1.0))
def test_shifted_energy_never_rises_along_the_compiled_march(seed: int, hysterons: int, step: float) -> None:
    actuator, random = random_actuator(seed, hysterons, COMPILED), np.random.default_rng(seed)
    steps = 200
    u = actuator.inputs(random, 1)
    x0 = actuator.states(random, 1)
    h = 10.0**step * random.choice([1.0, 1.0, 0.3], steps)
    run = march(actuator.network, u.expand(steps, 2).numpy(), h, x0[0].numpy())
    never_rises(actuator, torch.from_numpy(run.states), u)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_shifted_energy_never_rises_where_laws_are_not_monotone(seed: int) -> None:
    actuator, random = random_actuator(seed, 2, ("slot",), decades=0.5), np.random.default_rng(seed)
    u, x0 = actuator.inputs(random, 1), actuator.states(random, 1)[0]
    with torch.no_grad():
        x = solve_dense(PortHamiltonianSystem(actuator.network), x0, u.expand(40, 2), 0.03)
    never_rises(actuator, x, u)


def never_rises(actuator: Actuator, x: Tensor, u: Tensor) -> None:
    """About five equilibria at once: those of random charges, and the one that the state is driven to."""
    random = np.random.default_rng(0)
    system = PortHamiltonianSystem(actuator.network)
    charges = torch.cat([actuator.charges(random, 4), actuator.nearest(x[-1:], u)[:, : actuator.n]])
    with torch.no_grad():
        for x_star in forced_equilibrium(actuator.network, u, charges):
            held = shifted_energy(system, x, x_star)
            assert (held[1:] - held[:-1]).max() <= 1e-12 * held[0]
            assert held[-1] < held[0]


@settings(max_examples=60, deadline=None)
@given(networks(monotone=True), seeds)
def test_monotone_networks_lose_about_any_state(network: Network, seed: int) -> None:
    # With monotone laws and convex energies nothing of the actuator is needed: (17) holds about every equilibrium.
    network = replace(network, resistors=tuple(replace(r, modulated_by=None) for r in network.resistors))
    system = PortHamiltonianSystem(network)
    x, _ = (torch.from_numpy(v) for v in random_states(network, seed, BATCH))
    with torch.no_grad():
        assert (shifted_losses(system, x, x.flip(0)) >= 0.0).all()
        assert (shifted_energy(system, x, x.flip(0)) >= -1e-12 * system.energy(x)).all()
