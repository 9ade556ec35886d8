"""The modal model and its network: closed forms, other integrators, derivatives, and balances of power."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

import phnn
from phnn.errors import InputRefused
from phnn.modal.experiment import Experiment
from phnn.modal.model import ModalModel
from phnn.network.roles import linearised_at_rest

torch.set_num_threads(1)

Array = NDArray[np.float64]

DT = 1e-3


def model_of(seed: int = 5, modes: int = 3, ports: int = 2, reach: float = 1.0) -> ModalModel:
    """Modes between 20 and 200 Hz, with springs at the ports that matter."""
    rng = np.random.default_rng(seed)
    omega = np.sort(2.0 * np.pi * rng.uniform(20.0, 200.0, modes))
    springs = rng.uniform(0.01, 0.1, ports)
    return ModalModel(
        omega, rng.uniform(0.005, 0.05, modes), rng.standard_normal((modes, ports)), np.array([3e-4, 0.0]),
        springs, reach * rng.uniform(0.5, 2.0, ports),
    )  # fmt: skip


def experiment_of(ports: int, seed: int = 1, size: int = 256, zero_order: bool = False) -> Experiment:
    u = np.random.default_rng(seed).standard_normal((size, ports))
    return Experiment("made", False, u - u.mean(axis=0), np.zeros((size, 2)), np.zeros(2), zero_order)


def matrices(model: ModalModel, k: Array) -> tuple[Array, Array]:
    """``A`` and ``B`` in q and p, with springs k at the ports."""
    square = np.diag(model.omega**2)
    zero, one = np.zeros_like(square), np.eye(model.omega.size)
    b = model.b
    damping = np.diag(2.0 * model.zeta * model.omega)
    a = np.block([[zero, square], [-one - b @ np.diag(k) @ b.T, -damping]])
    return a, np.concatenate([np.zeros_like(b), b])


def test_the_steady_state_is_that_of_a_held_input_step_by_step() -> None:
    model, experiment = model_of(), experiment_of(2, zero_order=True)
    steady = model.steady(experiment, DT)
    n = len(experiment.u)
    x = np.fft.irfft(steady.x, n, axis=0)
    softened = 1.0 / (1.0 + x.var(axis=0) / model.reach**2)
    assert (softened < 0.95).all()
    a, b = matrices(model, model.springs * softened)
    step = expm(DT * a)
    forced = np.linalg.solve(a, (step - np.eye(len(a))) @ b)
    state = np.zeros(len(a))
    for _ in range(60):
        states = []
        for u in experiment.u:
            states.append(state)
            state = step @ state + forced @ u
    q = np.array(states)[:, : model.omega.size]
    assert np.abs(np.fft.irfft(steady.q, n, axis=0) - (q - q.mean(axis=0))).max() < 2e-3 * q.std()


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**31), modes=st.integers(1, 5), ports=st.integers(1, 3), reach=st.floats(0.01, 10.0))
def test_ports_take_up_power_at_every_line(seed: int, modes: int, ports: int, reach: float) -> None:
    steady = model_of(seed, modes, ports, reach).steady(experiment := experiment_of(ports, seed), DT)
    u = np.fft.rfft(experiment.u, axis=0)
    supplied = (u.conj() * steady.s[:, None] * steady.x).sum(axis=1).real
    assert (supplied >= -1e-9 * np.abs(u * steady.s[:, None] * steady.x).sum(axis=1)).all()


def moved(model: ModalModel, k: int, by: float) -> ModalModel:
    """The model after a move of the k-th variable of a fit."""
    sizes = [model.omega.size, model.zeta.size, model.b.size, model.delay.size, model.springs.size]
    omega, zeta, b, delay, springs = np.split(by * (np.arange(sum(sizes)) == k), np.cumsum(sizes)[:-1])
    return replace(
        model,
        omega=model.omega * np.exp(omega),
        zeta=model.zeta * np.exp(zeta),
        b=model.b + b.reshape(model.b.shape),
        delay=model.delay + delay * DT,
        springs=model.springs * np.exp(springs),
    )


def test_slopes_are_differences_where_the_mean_square_does_not_matter() -> None:
    model, experiment = model_of(reach=1e6), experiment_of(2)
    shapes = np.random.default_rng(2).standard_normal((2, 2 * 3 + 2))

    def seen(model: ModalModel) -> NDArray[np.complex128]:
        steady = model.steady(experiment, DT)
        return np.asarray((steady.columns @ shapes.T) * np.exp(-steady.s[:, None] * model.delay))

    slopes = model.slopes(model.steady(experiment, DT), shapes, DT)
    for k in range(slopes.shape[2]):
        difference = (seen(moved(model, k, 1e-5)) - seen(moved(model, k, -1e-5))) / 2e-5
        assert np.allclose(slopes[:, :, k], difference, rtol=0.0, atol=1e-5 * np.abs(slopes).max()), k


def test_the_vector_field_of_the_network_is_that_of_the_modes() -> None:
    model = model_of()
    c = np.array([0.3, -0.2, 1.0])
    network = phnn.models.modal(model.omega, model.zeta, model.b, outputs={"tip": c})
    a, b = linearised_at_rest(network)
    own, inputs = matrices(model, np.zeros(2))
    places = [network.state_names.index(f"{kind}_{i}") for kind in "qp" for i in (1, 2, 3)]
    assert np.allclose(a[np.ix_(places, places)], own) and np.allclose(b[places], inputs)
    tip = network.state_names.index("tip")
    assert np.allclose(a[tip, places], np.concatenate([np.zeros(3), c * model.omega**2]))
    assert not a[:, tip].any() and not b[tip].any() and network.output == "tip"


def test_names_of_ports() -> None:
    model = model_of()
    named = phnn.models.modal(model.omega, model.zeta, model.b, ("left", "right"), "N")
    assert [(p.name, p.unit) for p in named.ports] == [("left", "N"), ("right", "N")]
    assert {p.name for p in phnn.models.modal(model.omega, model.zeta, model.b).ports} == {"port_1", "port_2"}
    for names in (("left",), ("left", "left")):
        with pytest.raises(InputRefused, match="2 different names"):
            phnn.models.modal(model.omega, model.zeta, model.b, names)
    with pytest.raises(InputRefused, match="positive frequency"):
        phnn.models.modal(-model.omega, model.zeta, model.b)
