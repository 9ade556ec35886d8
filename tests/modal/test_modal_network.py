"""The network of a modal model: its equations, its structure, and its simulation against the march of modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from phnn.errors import InputRefused, StructureViolated
from phnn.integrate import kernel
from phnn.integrate.partition import junctions_of
from phnn.integrate.program import compile_network
from phnn.modal.elements import DRAG, HARDENING, LINEAR, SLOW, SOFTENING, STOP, PortElement
from phnn.modal.model import ModalModel, march
from phnn.model import Model
from phnn.network import Network, PortHamiltonianSystem
from phnn.setup import Setup

Array = NDArray[np.float64]

torch.set_num_threads(1)

# Parts at the ports, each kind alone and all together.
PARTS = {
    "linear": [],
    "stop": [STOP, STOP],
    "softening": [SOFTENING],
    "hardening": [HARDENING],
    "drag": [DRAG],
    "all": [STOP, STOP, SOFTENING, HARDENING, DRAG],
}
# Weights that give a few tenths of the force at the extensions and velocities of these tests.
WEIGHT = {STOP: 0.2, SOFTENING: 0.2, HARDENING: 0.03, DRAG: 2e-6, SLOW: 0.1}
SPAN = 0.06
by_parts = pytest.mark.parametrize("name", PARTS)


def model_of(kinds: list[int], modes: int = 3, ports: int = 2, seed: int = 5) -> ModalModel:
    rng = np.random.default_rng(seed)
    omega = np.sort(2.0 * np.pi * rng.uniform(20.0, 200.0, modes))
    zeta, b = rng.uniform(0.005, 0.05, modes), rng.standard_normal((modes, ports))
    element = PortElement(("made",), np.array(kinds, dtype=np.int64), np.ones(len(kinds))) if kinds else LINEAR
    k = np.array([WEIGHT[kind] for kind in kinds]) * rng.uniform(0.5, 1.5, (ports, len(kinds)))
    return ModalModel(omega, zeta, b, np.zeros(1), element, k, rng.uniform(0.2, 1.0, (ports, len(kinds))))


def inputs(t: Array) -> Array:
    """(n, 2) two tones, silent before zero."""
    return np.stack([np.sin(2.0 * np.pi * 37.0 * t), 0.7 * np.sin(2.0 * np.pi * 91.0 * t)], axis=1)


def extensions_by_march(model: ModalModel, u: Array, h: float) -> Array:
    done = march(u, model.structure, model.parts, h, periods=1)
    assert done.solved
    return np.asarray(done.q @ model.b)


def extensions_by_network(model: ModalModel, u: Array, h: float) -> Array:
    network = model.to_network()
    program = compile_network(network)
    shape = len(program.states)
    states, efforts = np.empty((len(u) + 1, shape)), np.empty((len(u), shape))
    steps = np.full(len(u), h)
    assert kernel.march(program, program.theta(network), np.zeros(shape), u, steps, states, efforts) == len(u)
    return np.asarray(states[:-1, : model.omega.size] @ model.b)


def random_state(network: Network, model: ModalModel, seed: int) -> dict[str, float]:
    """A state of the modes, with the deflections of stops and the extensions of springs that belong to it."""
    rng = np.random.default_rng(seed)
    modes, ports = model.b.shape
    q, v = rng.standard_normal(modes), model.omega * rng.standard_normal(modes)
    state = {f"q_{i + 1}": q[i] for i in range(modes)} | {
        f"p_{i + 1}": v[i] / model.omega[i] ** 2 for i in range(modes)
    }
    for j in range(ports):
        for a, r in enumerate(model.thresholds[j]):
            state[f"x_{j + 1}_{a + 1}"] = float(q @ model.b[:, j])
            state[f"s_{j + 1}_{a + 1}"] = float(rng.uniform(-r, r))
    return {name: state[name] for name in network.state_names}


@by_parts
def test_its_vector_field_is_that_of_the_modes(name: str) -> None:
    model = model_of(PARTS[name])
    network = model.to_network()
    system = PortHamiltonianSystem(network)
    modes, ports = model.b.shape
    for seed in range(5):
        state = random_state(network, model, seed)
        u = np.random.default_rng(seed).standard_normal(ports)
        x = torch.tensor(list(state.values()), dtype=torch.float64)
        rate = dict(zip(state, system.vector_field(x, torch.from_numpy(u)).tolist(), strict=True))
        q = np.array([state[f"q_{i + 1}"] for i in range(modes)])
        v = model.omega**2 * np.array([state[f"p_{i + 1}"] for i in range(modes)])
        extension, velocity, pushed = q @ model.b, v @ model.b, np.zeros(ports)
        for j, a in np.ndindex(model.k.shape):
            kind, k, r = model.element.kinds[a], model.k[j, a], model.thresholds[j, a]
            s = state.get(f"s_{j + 1}_{a + 1}", 0.0)
            y = extension[j]
            pushed[j] += k * {
                STOP: s, SOFTENING: y / np.sqrt(1.0 + (y / r) ** 2), HARDENING: y**3,
                DRAG: abs(velocity[j]) * velocity[j],
            }[kind]  # fmt: skip
            # Within its threshold a stop follows the extension.
            for one in (f"s_{j + 1}_{a + 1}", f"x_{j + 1}_{a + 1}"):
                assert rate.get(one, velocity[j]) == pytest.approx(velocity[j], rel=1e-12)
        wanted = model.omega**2 * (model.b @ (u - pushed) - q) - 2.0 * model.zeta * model.omega * v
        found = model.omega**2 * np.array([rate[f"p_{i + 1}"] for i in range(modes)])
        assert np.allclose(found, wanted, rtol=1e-12, atol=1e-9)
        assert np.allclose([rate[f"q_{i + 1}"] for i in range(modes)], v, rtol=1e-12)
        # Ports and extensions are collocated: the conjugate output is the velocity of the extension.
        assert np.allclose(system.port_outputs(x, torch.from_numpy(u)).tolist(), velocity, rtol=1e-12)


@by_parts
@torch.no_grad()
def test_its_structure_is_skew_and_it_dissipates(name: str) -> None:
    network = model_of(PARTS[name]).to_network()
    system = PortHamiltonianSystem(network)
    x = 3.0 * torch.randn(
        200, len(network.state_names), dtype=torch.float64, generator=torch.Generator().manual_seed(1)
    )
    u = torch.randn(200, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    j, d = system.structure(x), system.dissipation(x)
    assert torch.equal(j, -j.mT)
    # D = B diag(φ/ε) Bᵀ, products in another order above and below the diagonal.
    torch.testing.assert_close(d, d.mT, rtol=1e-14, atol=1e-14 * float(d.abs().max()))
    eigenvalues = torch.linalg.eigvalsh(d)
    assert (eigenvalues >= -1e-13 * eigenvalues.abs().amax()).all()
    balance = system.power_balance(x, u)
    assert (balance.dissipated >= 0.0).all() and (system.energy(x) >= 0.0).all()
    scale = (system.efforts(x) * system.vector_field(x, u)).abs().sum(-1)
    assert (balance.defect.abs() <= 1e-12 * scale).all()


@by_parts
def test_network_and_march_tend_to_each_other_by_the_square_of_the_step(name: str) -> None:
    """Inputs are held over each step at the value of its middle, for both.

    A step of the network is a discrete gradient; a step of the march is a closed form of the modes with discrete
    gradients of the parts. Both err by C h², so that they differ by (C₁ − C₂) h²: a quarter at half the step. Where a
    stop begins to slide within a step adds a term of the same order that is not smooth; hence the bound 3, not 4.
    """
    model, differences = model_of(PARTS[name]), []
    for h in (2e-4, 1e-4, 5e-5):
        u = inputs(h * (np.arange(round(SPAN / h)) + 0.5))
        x, other = extensions_by_march(model, u, h), extensions_by_network(model, u, h)
        differences.append(float(np.abs(other - x).max() / np.abs(x).max()))
    assert differences[0] > 3.0 * differences[1] > 9.0 * differences[2]
    assert differences[2] < 5e-3


def test_a_model_of_the_network_simulates() -> None:
    model = model_of(PARTS["all"])
    n, h = 1200, 5e-5
    t = h * np.arange(n)
    u = inputs(t)
    q = Model(Setup(model.to_network(("input", "force_2")))).simulate(t, u[:, 0], further={"force_2": u[:, 1]})
    done = march(inputs(t + 0.5 * h), model.structure, model.parts, h, periods=1)
    assert np.abs(q - done.q[:, 0]).max() < 5e-3 * np.abs(q).max()


def test_the_unknowns_of_a_step_are_the_modes_whatever_is_at_the_ports() -> None:
    # Each stop is coupled with all modes, more often than a mode is coupled with anything.
    network = model_of([STOP] * 3, modes=8, ports=2).to_network()
    assert junctions_of(network) == tuple(f"p_{i}" for i in range(1, 9))


def test_a_slow_part_has_no_network() -> None:
    model = model_of([STOP, SLOW])
    with pytest.raises(StructureViolated, match="self_heating"):
        model.to_network()
    # A weight of zero pushes nothing.
    without = replace(model, k=model.k * [1.0, 0.0])
    assert "s_1_1" in without.to_network().storage_names


def test_names_of_ports() -> None:
    model = model_of([])
    assert [p.name for p in model.to_network().ports] == ["port_1", "port_2"]
    assert [(p.name, p.unit) for p in model.to_network(("a", "b"), "N").ports] == [("a", "N"), ("b", "N")]
    for wrong in (("a",), ("a", "a")):
        with pytest.raises(InputRefused, match="2 different names"):
            model.to_network(wrong)
