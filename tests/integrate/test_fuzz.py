"""Random networks of any topology through the compiled march, in numbers."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
import torch
from junctions import trajectory_of
from networks import random_network, remembering

from phnn.integrate import kernel
from phnn.integrate.equations import check, linearised, power_balance
from phnn.integrate.program import compile_network
from phnn.network import Network, PortHamiltonianSystem, Resistor
from phnn.nn import SectorMLP

STEPS = 20
# Of a step without solution: one that has one.
SHORT = 1e-2


def drawn(seed: int, monotone: bool, memories: bool = False) -> tuple[Network, np.ndarray, np.ndarray, np.ndarray]:
    """A network with rates from 1e-3 to 1e9 1/s, inputs with jumps, steps of several sizes and an initial state."""
    random = np.random.default_rng(seed)
    counts = int(random.integers(1, 7)), int(random.integers(0, 6)), int(random.integers(1, 4))
    network = random_network(seed, *counts, monotone=monotone, rich=True)
    network = remembering(network, seed) if memories else network
    h = 10.0 ** random.uniform(-5.0, -0.5) * random.choice([1.0, 1.0, 0.3], STEPS)
    u = random.normal(size=(STEPS, len(network.ports))) * random.choice([0.0, 1.0, 10.0], (STEPS, 1))
    return network, u, h, random.normal(size=len(network.state_names)) * random.choice([0.0, 1.0])


def solved(network: Network, u: np.ndarray, h: np.ndarray, x0: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """How many steps were solved, states and efforts."""
    program = compile_network(network)
    states, efforts = np.full((h.size + 1, x0.size), np.nan), np.full((h.size, x0.size), np.nan)
    return kernel.march(program, program.theta(network), x0, u, h, states, efforts), states, efforts


def defect(network: Network, u: np.ndarray, h: np.ndarray, states: np.ndarray, efforts: np.ndarray) -> float:
    """Largest defect of the power balance, relative to the energies of its step; also checks the residual.

    Among the energies is what stiff laws make of the unknowns' own rounding: a conductance of 1e9 turns the last digit
    of an effort into 1e-7 of a flow.
    """
    trajectory = trajectory_of(network, u, h, states, efforts)
    system = PortHamiltonianSystem(network)
    check(trajectory, 1e-10, system)
    balance = power_balance(trajectory, system)
    held = system.energy(torch.from_numpy(states)).detach()
    size = balance.supplied.abs().sum(-1) + balance.dissipated.abs().sum(-1) + held[1:] + held[:-1] + 1e-200
    x, sizes = torch.from_numpy(states), torch.from_numpy(h[:, None])
    _, by_next, by_start = linearised(system, x[:-1], x[1:], torch.from_numpy(u), sizes)
    terms = (by_next.abs() @ x[1:].abs().unsqueeze(-1) + by_start.abs() @ x[:-1].abs().unsqueeze(-1)).squeeze(-1)
    size = size + (terms.detach() * torch.from_numpy(efforts).abs()).sum(-1)
    assert (balance.dissipated >= -1e-13 * size[:, None]).all()
    return float((balance.defect.abs() / size).max())


def all_monotone(seeds: Iterable[int], memories: bool = False) -> None:
    for seed in seeds:
        network, u, h, x0 = drawn(seed, monotone=True, memories=memories)
        done, states, efforts = solved(network, u, h, x0)
        assert done == STEPS, f"network {seed}: step {done} was not solved"
        assert defect(network, u, h, states, efforts) <= 1e-10, f"network {seed}"


def any_law(seeds: Iterable[int]) -> int:
    """How many of these networks were solved in full. Where a step of the others has no solution, what was solved
    before is finite and balanced, and steps small beside those of the march lead on from there."""
    count = 0
    for seed in seeds:
        network, u, h, x0 = drawn(seed, monotone=False)
        learned = SectorMLP(1.0, 10.0 ** (seed % 7 - 3), 8, seed=seed)
        name = network.state_names[seed % len(network.state_names)]
        network = Network(
            network.storages, (*network.resistors, Resistor("learned", learned, {name: 1.0})), network.couplings,
            network.ports, network.parameters, network.output, network.modulations,
        )  # fmt: skip
        done, states, efforts = solved(network, u, h, x0)
        assert np.isfinite(states[: done + 1]).all(), f"network {seed}"
        assert np.isfinite(efforts[:done]).all(), f"network {seed}"
        if done:
            assert defect(network, u[:done], h[:done], states[: done + 1], efforts[:done]) <= 1e-8, f"network {seed}"
        if done == STEPS:
            count += 1
            continue
        short, held = np.full(STEPS, SHORT * h[done]), np.repeat(u[done : done + 1], STEPS, axis=0)
        assert solved(network, held, short, states[done])[0] == STEPS, f"network {seed}: no short step either"
    return count


def test_stiff_monotone_networks_are_always_solved() -> None:
    # The last three are steep: the slope of the step before leads far from the root, or to terms that overflow.
    all_monotone((*range(50), 184, 934, 8054))


def test_memories_do_not_get_in_the_way() -> None:
    all_monotone(range(25), memories=True)


@pytest.mark.slow
def test_ten_thousand_stiff_monotone_networks_are_always_solved() -> None:
    all_monotone(range(10_000))


def test_other_networks_are_solved_or_shorter_steps_lead_on() -> None:
    assert any_law(seed for seed in range(52) if seed not in (4, 42)) == 50
    # A network with laws that follow states or fall, a step of which has no solution.
    assert any_law((4,)) == 0
    with pytest.raises(AssertionError, match="no short step either"):
        # Of this one a hundredth of a step has none either: a falling law behind a stiff one.
        any_law((42,))


@pytest.mark.slow
def test_of_a_thousand_other_networks_a_step_in_a_hundred_needs_to_be_shorter() -> None:
    assert any_law(range(1000)) >= 990
