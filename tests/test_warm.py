"""Warming up compiles what later calls use, so that they compile nothing."""

from __future__ import annotations

import campaigns
import numpy as np
import pytest

from phnn.derivatives import output_derivatives, output_gradient
from phnn.integrate import general, quick, sweep
from phnn.models.actuator import hrc
from phnn.models.neural import LearnedLaws, neural_hrc
from phnn.models.variants import hrcl
from phnn.network.elements import Network
from phnn.setup import Setup
from phnn.simulate import simulate
from phnn.warm import warm_up

KERNELS = {
    "march": general._compiled,
    "quick march": quick._compiled,
    "sensitivities": sweep._sensitivities,
    "adjoint": sweep._adjoint,
}


@pytest.mark.parametrize(
    "network", [hrc(2), neural_hrc(1, LearnedLaws(3)), hrcl(1).network()], ids=["hrc", "neural", "hrcl"]
)
def test_nothing_is_left_to_compile(network: Network) -> None:
    warm_up()
    known = {name: list(function.signatures) for name, function in KERNELS.items()}
    assert all(known.values())
    t = np.arange(21) * 1e-4
    recording = campaigns.recorded(Setup(network), "sine", t, 5.0 * np.sin(300.0 * t), 1e-9, 0)
    trajectory = simulate(Setup(network), recording)
    names = [name for name, p in network.parameters.items() if not p.fixed]
    output_derivatives(trajectory, names, (0,), np.ones((20, 1)), [(names[0], np.ones(20))])
    output_gradient(trajectory, names, np.ones(21))
    assert {name: list(function.signatures) for name, function in KERNELS.items()} == known
