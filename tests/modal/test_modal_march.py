"""The march of modes and the network of a modal model: closed forms, other integrators, and balances of power."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from phnn.errors import InputRefused, StructureViolated
from phnn.integrate import solve
from phnn.integrate.partition import junctions_of
from phnn.integrate.program import compile_network
from phnn.modal.elements import DRAG, HARDENING, LINEAR, SLOW, SOFTENING, STOP, PortElement
from phnn.modal.model import ModalModel, Parts, Structure, march
from phnn.model import Model
from phnn.network import Network, PortHamiltonianSystem
from phnn.setup import Setup

torch.set_num_threads(1)

Array = NDArray[np.float64]

ALL = np.array([STOP, STOP, SOFTENING, HARDENING, DRAG, SLOW])


def structure(seed: int, modes: int, ports: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    omega = np.sort(2.0 * np.pi * rng.uniform(20.0, 200.0, modes))
    return omega, rng.uniform(0.005, 0.05, modes), rng.standard_normal((modes, ports))


def elements_of(seed: int, ports: int) -> tuple[Array, Array]:
    """Weights and thresholds of all kinds of parts, strong enough to matter."""
    rng = np.random.default_rng(seed + 1)
    k = rng.uniform(0.0, 0.3, (ports, ALL.size))
    k[:, ALL == DRAG] *= 1e-5
    return k, rng.uniform(0.2, 2.0, (ports, ALL.size))


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**31), modes=st.integers(1, 5), ports=st.integers(1, 3), h=st.floats(1e-4, 4e-3))
def test_what_is_supplied_is_stored_or_lost_in_every_step(seed: int, modes: int, ports: int, h: float) -> None:
    omega, zeta, b = structure(seed, modes, ports)
    k, r = elements_of(seed, ports)
    rng = np.random.default_rng(seed + 2)
    n = 60
    u = rng.standard_normal((n, ports))
    done = march(u, Structure(omega, zeta, b), Parts(ALL, k, r), h, before=np.full(ports, 0.5), periods=1)
    assert done.solved
    x = done.q @ b
    dx, mean = np.diff(x, axis=0), done.s[:-1]
    force = u[:-1] - (k * mean).sum(axis=2)
    # Modes take up what the forces do: their stored energy and a loss that is never negative.
    q, v = done.q, velocities(u, done.s, k, omega, zeta, b, h)
    energy = 0.5 * (q**2 + (v / omega) ** 2).sum(axis=1)
    lost = (force * dx).sum(axis=1) - np.diff(energy)
    scale = np.abs(force * dx).sum(axis=1).max() + energy.max()
    assert lost.min() >= -1e-9 * scale
    for kind, stored in (
        (SOFTENING, lambda y, r: r**2 * (np.sqrt(1.0 + (y / r) ** 2) - 1.0)),
        (HARDENING, lambda y, r: 0.25 * y**4),
        (SLOW, lambda y, r: 0.5 * y**2 / (1.0 + 0.5 / r**2)),
    ):
        for a in np.flatnonzero(kind == ALL):
            work = mean[:, :, a] * dx
            assert np.allclose(work, np.diff(stored(x, r[:, a]), axis=0), rtol=1e-8, atol=1e-9 * scale)
    for a in np.flatnonzero(ALL == STOP):
        s = np.zeros((n, ports))
        for i in range(n - 1):
            s[i + 1] = np.clip(s[i] + dx[i], -r[:, a], r[:, a])
        loss = mean[:, :, a] * dx - 0.5 * np.diff(s**2, axis=0)
        assert loss.min() >= -1e-9 * scale
        assert loss.max() > 0.0 or np.abs(x - x[0]).max() < r[:, a].min()
    for a in np.flatnonzero(ALL == DRAG):
        assert (mean[:, :, a] * dx).min() >= 0.0


def velocities(u: Array, s: Array, k: Array, omega: Array, zeta: Array, b: Array, h: float) -> Array:
    """(n, M) q̇ that belongs to the forces of a march from rest, by the matrix exponential of scipy."""
    from scipy.linalg import expm

    force = (u - (k * s).sum(axis=2)) @ b.T
    out = np.zeros_like(force)
    for i, (w, z) in enumerate(zip(omega, zeta, strict=True)):
        step = expm(np.array([[0.0, 1.0], [-(w**2), -2.0 * z * w]]) * h)
        state = np.zeros(2)
        for n in range(len(u) - 1):
            rest = np.array([force[n, i], 0.0])
            state = rest + step @ (state - rest)
            out[n + 1, i] = state[1]
    return out


@pytest.mark.parametrize("kind", [STOP, SOFTENING, HARDENING, DRAG])
def test_a_march_follows_an_adaptive_integrator(kind: int) -> None:
    omega, zeta, b = structure(5, 2, 1)
    k = np.array([[1e-5 if kind == DRAG else 0.2]]) / float((b**2).sum())
    r, h, n = np.array([[0.6]]), 2e-5, 4000
    u = np.sin(2.0 * np.pi * 37.0 * h * (np.arange(n) + 0.5))[:, None]
    done = march(u, Structure(omega, zeta, b), Parts(np.array([kind]), k, r), h, periods=1)

    def slope(t: float, state: Array) -> Array:
        q, v, s = state[:2], state[2:4], state[4]
        x, rate = float(q @ b[:, 0]), float(v @ b[:, 0])
        e = {
            STOP: s,
            SOFTENING: x / np.sqrt(1.0 + (x / r[0, 0]) ** 2),
            HARDENING: x**3,
            DRAG: abs(rate) * rate,
        }[kind]
        f = np.sin(2.0 * np.pi * 37.0 * t) - k[0, 0] * e
        sliding = (s >= r[0, 0] and rate > 0.0) or (s <= -r[0, 0] and rate < 0.0)
        return np.concatenate([v, omega**2 * (b[:, 0] * f - q) - 2.0 * zeta * omega * v, [0.0 if sliding else rate]])

    times = h * np.arange(n)
    other = solve_ivp(slope, (0.0, times[-1]), np.zeros(5), t_eval=times, rtol=1e-8, atol=1e-10, max_step=5e-5)
    x = done.q @ b[:, 0]
    assert np.abs(x - other.y[:2].T @ b[:, 0]).max() < 2e-3 * np.abs(x).max()


def test_a_slow_spring_softens_with_the_period_before() -> None:
    omega, zeta, b = structure(5, 2, 1)
    k, r, h = np.array([[0.3]]), np.array([[0.5]]), 2e-4
    u = np.sin(2.0 * np.pi * np.arange(500) / 500.0)[:, None]
    done = march(u, Structure(omega, zeta, b), Parts(np.array([SLOW]), k, r), h, periods=60)
    x = done.q @ b[:, 0]
    # Far below resonance the port is a spring: its compliance in parallel with what the slow spring is by now.
    stiffness = 1.0 / (1.0 + (x**2).mean() / 0.25)
    part = done.s[:, 0, 0] @ x / (x @ x)
    assert part == pytest.approx(stiffness, rel=1e-3)


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
    assert solve.march(program, program.theta(network), np.zeros(shape), u, steps, states, efforts) == len(u)
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
