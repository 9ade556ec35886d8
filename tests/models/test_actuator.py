"""The paper's actuator and its rival."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from junctions import recording

from phnn.errors import InputRefused
from phnn.integrate.equations import check
from phnn.integrate.program import compile_network
from phnn.models.actuator import TABLE_1, TABLE_2, bouc_wen, from_paper, hrc
from phnn.network import PortHamiltonianSystem
from phnn.setup import Setup
from phnn.trajectory import simulate

torch.set_num_threads(1)
T = np.arange(667) * 1e-5
SINE = recording(T, 75.0 * np.sin(2 * np.pi * 150.0 * T))


@pytest.mark.parametrize("hysterons", range(6))
def test_any_number_of_hysterons_runs(hysterons: int) -> None:
    network = hrc(hysterons)
    assert network.state_names == (*(f"Q_{i + 1}" for i in range(hysterons)), "q", "p")
    assert compile_network(network).leaves == network.state_names[:-1]
    assert check(simulate(Setup(network), SINE)) < 1e-12
    assert all(p.value > 0.0 for p in network.parameters.values())


def test_table_1_is_the_model_of_the_paper() -> None:
    network = from_paper()
    assert {n: p.value for n, p in network.parameters.items()} == TABLE_1
    # Proposition 1: J of eq. (10) in the order Q_1, Q_2, q, p.
    j = PortHamiltonianSystem(network).structure(torch.zeros(4, dtype=torch.float64))
    a = TABLE_1["alpha"]
    wanted = [[0, 0, 0, a], [0, 0, 0, a], [0, 0, 0, 1], [-a, -a, -1, 0]]
    assert torch.equal(j, torch.tensor(wanted, dtype=torch.float64))


def test_hysterons_differ_and_values_are_taken() -> None:
    network = hrc(4, {"d_3": 20.0, "k": 1e4})
    values = {n: p.value for n, p in network.parameters.items()}
    assert (values["d_3"], values["k"]) == (20.0, 1e4)
    assert values["d_4"] == 1.5 * values["d_2"]
    with pytest.raises(InputRefused, match="zero or more"):
        hrc(-1)
    with pytest.raises(InputRefused, match="no parameter called C_3"):
        hrc(2, {"C_3": 1.0})


def test_scaling_all_parameters_leaves_voltage_to_displacement_unchanged() -> None:
    # Only ratios are identifiable from voltage and displacement.
    scaled = {n: 3.0 * v for n, v in TABLE_1.items() if not n.startswith("d_")}
    q = simulate(Setup(hrc(2, scaled)), SINE).y
    np.testing.assert_allclose(q, simulate(Setup(from_paper()), SINE).y, rtol=1e-9, atol=1e-15)


def test_bouc_wen_has_the_weight_of_table_2() -> None:
    setup = bouc_wen()
    assert setup.values()["w"] * setup.values()["alpha"] == pytest.approx(TABLE_2["K_h"])
    assert "A" not in setup.free
    assert bouc_wen({"m": 1e-3, "w": 10.0}).values()["w"] == 10.0
