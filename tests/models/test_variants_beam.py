"""The cantilever in modes, and the actuator that drives it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from junctions import march
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from phnn.errors import InputRefused
from phnn.models.actuator import TABLE_1, hrc
from phnn.models.variants import cantilever, deflection, driven_beam, mode_shapes, wave_numbers
from phnn.network import Network, PortHamiltonianSystem

torch.set_num_threads(1)
# A silica fibre of 125 µm, 20 mm long: first frequency 250 Hz.
LENGTH, RIGIDITY, MASS = 0.02, 72e9 * np.pi * 125e-6**4 / 64, 2200.0 * np.pi / 4 * 125e-6**2 * 0.02
JOINT = 2e4


def driven(hysterons: int, modes: int, place: float = 0.15) -> Network:
    return driven_beam(hrc(hysterons), cantilever(modes, LENGTH, RIGIDITY, MASS, place), JOINT)


def frequencies(network: Network) -> np.ndarray:
    """Imaginary parts of the eigenvalues of the linearised network at rest, each once, ascending."""
    system = PortHamiltonianSystem(network)
    n = len(network.storages)
    u = torch.zeros(n, len(network.ports), dtype=torch.float64)
    found = np.linalg.eigvals(
        system.vector_field(torch.eye(n, dtype=torch.float64) * 1e-9, u).detach().numpy().T / 1e-9
    )
    return np.sort(found.imag[found.imag > 0.0])


def finite_elements(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass matrix of a clamped beam of cubic elements, EI = ρA = L = 1, without the clamped end."""
    h = 1.0 / count
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                  [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]) / h**3  # fmt: skip
    m = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                  [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]) * h / 420  # fmt: skip
    stiffness, mass = np.zeros((2, 2 * count + 2, 2 * count + 2))
    for e in range(count):
        at = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
        stiffness[at] += k
        mass[at] += m
    return stiffness[2:, 2:], mass[2:, 2:]


def test_wave_numbers_solve_the_characteristic_equation_and_are_the_tabled_ones() -> None:
    z = wave_numbers(12)
    np.testing.assert_allclose(z[:4], [1.87510407, 4.69409113, 7.85475744, 10.99554073], rtol=1e-8)
    assert np.abs(np.cos(z) * np.cosh(z) + 1.0).max() < 1e-13 * np.cosh(z[-1]) * z[-1]
    np.testing.assert_allclose(z[4:], (np.arange(4, 12) + 0.5) * np.pi, rtol=1e-6)


def test_modes_are_those_of_finite_elements() -> None:
    stiffness, mass = finite_elements(40)
    squares, vectors = eigh(stiffness, mass, subset_by_index=[0, 5])
    np.testing.assert_allclose(squares, wave_numbers(6) ** 4, rtol=1e-4)
    shapes = mode_shapes(np.linspace(0.0, 1.0, 41)[1:], 6)
    found = vectors[::2] * np.sign(vectors[-2] * shapes[-1])
    np.testing.assert_allclose(found, shapes, atol=1e-3)


def test_modes_are_orthonormal_clamped_and_stay_finite() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(200)
    shapes = mode_shapes(0.5 * (nodes + 1.0), 30)
    np.testing.assert_allclose((shapes.T * 0.5 * weights) @ shapes, np.eye(30), atol=1e-11)
    assert np.abs(mode_shapes(0.0, 30)).max() < 1e-12
    assert np.abs(mode_shapes(1e-6, 30)).max() < 1e-7
    np.testing.assert_allclose(np.abs(mode_shapes(1.0, 30)), 2.0, rtol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 8), st.floats(0.01, 2.0), st.floats(1e-7, 10.0), st.floats(1e-6, 1.0), st.floats(1e-4, 0.3))
def test_the_network_has_the_closed_form_frequencies(
    modes: int, length: float, rigidity: float, mass: float, damping: float
) -> None:
    network = cantilever(modes, length, rigidity, mass, damping=damping)
    omega = wave_numbers(modes) ** 2 * np.sqrt(rigidity / (mass * length**3))
    np.testing.assert_allclose(frequencies(network), omega * np.sqrt(1.0 - damping**2), rtol=1e-8)


def test_static_deflection_is_the_textbook_one() -> None:
    network = cantilever(40, LENGTH, RIGIDITY, MASS)
    stiffness = np.array([network.parameters[f"beam_k_{i + 1}"].value for i in range(40)])
    on = np.array(list(network.ports[0].on.values()))
    states = np.concatenate([on / stiffness, np.zeros(40)])
    x = np.linspace(0.0, 1.0, 11)
    wanted = LENGTH**3 / (6.0 * RIGIDITY) * x**2 * (3.0 - x)
    np.testing.assert_allclose(deflection(network, states, MASS, x), wanted, atol=2e-6 * wanted[-1])
    assert deflection(network, states[None], MASS).shape == (1,)


def test_joint_frequencies_are_those_of_the_joint_masses_and_springs() -> None:
    modes, place = 3, 0.15
    network = driven(0, modes, place)
    still = network.with_values({"b": 1e-9} | {f"beam_c_{i + 1}": 1e-9 for i in range(modes)})
    pull = np.concatenate([mode_shapes(place, modes) / np.sqrt(MASS), [-1.0]])
    squares = wave_numbers(modes) ** 4 * RIGIDITY / (MASS * LENGTH**3)
    stiffness = np.diag([*squares, TABLE_1["k"]]) + JOINT * np.outer(pull, pull)
    wanted = np.sqrt(eigh(stiffness, np.diag([1.0] * modes + [TABLE_1["m"]]), eigvals_only=True))
    np.testing.assert_allclose(frequencies(still), wanted, rtol=1e-7)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 3), st.integers(1, 4), st.integers(0, 2**31 - 1))
def test_joint_system_is_skew_passive_and_keeps_the_power_balance(hysterons: int, modes: int, seed: int) -> None:
    network = driven(hysterons, modes)
    system = PortHamiltonianSystem(network)
    random = np.random.default_rng(seed)
    x = torch.from_numpy(random.normal(size=(10, len(network.storages))) * 1e-4)
    u = torch.from_numpy(random.normal(size=(10, 1)) * 50.0)
    structure = system.structure(x)
    assert torch.equal(structure, -structure.mT)
    balance = system.power_balance(x, u)
    assert (balance.dissipated >= 0.0).all()
    size = (system.efforts(x).abs() * system.vector_field(x, u).abs()).sum(-1)
    assert (balance.defect.abs() <= 1e-12 * size).all()
    assert [p.name for p in network.ports] == ["voltage"]


def equations(modes: int, place: float) -> Callable[[float, np.ndarray], np.ndarray]:
    """The actuator with one hysteron on a beam, written down by hand: states q_i, p_i, s, Q, q, p."""
    v, shapes = TABLE_1, mode_shapes(place, modes) / np.sqrt(MASS)
    squares = wave_numbers(modes) ** 4 * RIGIDITY / (MASS * LENGTH**3)

    def field(t: float, x: np.ndarray) -> np.ndarray:
        q_i, p_i, (s, charge, q, p) = x[:modes], x[modes : 2 * modes], x[2 * modes :]
        speed, volt = p / v["m"], charge / v["C_1"]
        leak = v["rho_1"] * (max(volt - 0.5 * v["d_1"], 0.0) + min(volt + 0.5 * v["d_1"], 0.0))
        drive = v["alpha"] * (75.0 * np.sin(2 * np.pi * 250.0 * t) - volt)
        force = drive - v["k"] * q - v["b"] * speed + JOINT * s
        beam = -squares * q_i - 0.01 * np.sqrt(squares) * p_i - shapes * JOINT * s
        return np.concatenate([p_i, beam, [shapes @ p_i - speed, v["alpha"] * speed - leak, speed, force]])

    return field


def test_the_compiled_step_simulates_the_driven_beam() -> None:
    network = driven(1, 3)
    n, h, steps = len(network.storages), 2e-6, 4000
    voltage = 75.0 * np.sin(2 * np.pi * 250.0 * h * (np.arange(steps) + 0.5))
    found = march(network, voltage[:, None], np.full(steps, h), np.zeros(n))
    size = np.abs(found.states).max(0)
    wanted = solve_ivp(equations(3, 0.15), (0.0, steps * h), np.zeros(n), "Radau", rtol=1e-6, atol=1e-8 * size)
    assert wanted.success
    np.testing.assert_allclose(found.states[-1] / size, wanted.y[:, -1] / size, atol=2e-3)
    # Efforts are means over the steps: what is stored is what was supplied less what was dissipated.
    system, states = PortHamiltonianSystem(network), torch.from_numpy(found.states)
    stored = system.energy(states).diff() / h
    balance = system.power(torch.from_numpy(found.efforts), states[:-1], torch.from_numpy(voltage[:, None]), stored)
    assert (balance.stored - balance.supplied.sum(-1) <= 1e-9 * balance.supplied.abs().max()).all()
    tip = deflection(network, found.states, MASS)
    assert np.abs(tip).max() > 2.0 * size[network.state_names.index("q")]


def test_what_is_no_beam_is_refused() -> None:
    for build, message in (
        (lambda: cantilever(0, 1.0, 1.0, 1.0), "modes = 0: give a count of one or more"),
        (lambda: cantilever(1, 1.0, 1.0, 1.0, place=1.5), r"a place 1\.5 is not on the beam"),
        (lambda: cantilever(1, -1.0, 1.0, 1.0), "length = -1 of the beam: give a positive number"),
        (lambda: cantilever(1, 1.0, 1.0, 1.0, damping=0.0), "damping = 0 of the beam"),
    ):
        with pytest.raises(InputRefused, match=message):
            build()
