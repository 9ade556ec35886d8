"""The paper's actuator, its rival, and the one that warms up: joined with others, refused where it makes no sense."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from junctions import march, recording, warming

from phnn.configuration import config_folder
from phnn.errors import InputRefused, StructureViolated
from phnn.integrate.equations import check
from phnn.integrate.program import compile_network
from phnn.integrate.rest import equilibrium
from phnn.models.actuator import TABLE_1, TABLE_2, bouc_wen, from_paper, hrc
from phnn.models.network_file import load_graph
from phnn.network import ModulatorState, Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.network.bondgraph import BondGraph, C
from phnn.network.elements import interconnect, renamed
from phnn.parameters import Parameter, as_table, positive
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


SPRING, STIFF = Storage("s", "spring", ("stiff",)), positive("stiff", 1e3, "N/m")
FILE = config_folder() / "network" / "thermal_hrc.yaml"


def test_at_rest_the_body_has_the_temperature_of_the_ambient() -> None:
    run = simulate(Setup(warming({"T_a": 310.0})), recording(np.arange(5) * 1e-4, np.zeros(5)))
    np.testing.assert_allclose(run.states[:, -1], 310.0 - 293.15, rtol=1e-13)
    assert np.abs(run.y).max() == 0.0


def test_a_steady_current_heats_to_its_steady_temperature() -> None:
    # A tank filled steadily, its outlet's loss kept by a body: P = u²/g, ϑ = R_T P.
    network = Network(
        (Storage("volume", "capacitor", ("A",)),),
        (Resistor("outlet", "linear", {"volume": 1.0}, ("g",)),),
        (),
        (Port("pump", {"volume": 1.0}),),
        as_table(Parameter(n, v) for n, v in {"A": 2.0, "g": 0.5, "C_T": 3.0, "R_T": 4.0, "T": 290.0}.items()),
        "volume",
        memories=(ModulatorState("theta", "thermal", ("C_T", "R_T", "T", "T")),),
    )
    u = np.array([0.3])
    np.testing.assert_allclose(equilibrium(network, u), [0.3 / 0.5 * 2.0, 4.0 * 0.3**2 / 0.5], rtol=1e-12)
    assert equilibrium(network, np.zeros(1)).tolist() == [0.0, 0.0]


def test_a_ratio_that_moves_is_not_merged_into_a_stiffness() -> None:
    graph = load_graph(FILE)
    capacitor = C("Q_C", "electrical", "capacitor", ("C_E",), "C")
    parameters = {**graph.parameters, "C_E": Parameter("C_E", 1.7e-7, "F", positive=True)}
    with pytest.raises(StructureViolated, match="alpha follows theta, but merging Q_C into q takes it for constant"):
        BondGraph(
            graph.junctions, (*graph.elements, capacitor), graph.bonds, parameters, "q", True, graph.modulations,
            graph.memories,
        ).network()  # fmt: skip


def joined() -> Network:
    return interconnect(renamed(warming(), "a_"), "a_force", renamed(hrc(1), "b_"), "b_force", SPRING, (STIFF,))


def test_heat_stays_in_the_network_that_dissipates_it() -> None:
    network = joined()
    assert network.state_names[-1] == "a_theta"
    assert network.memories[0].of == ("a_hysteron_1", "a_hysteron_2", "a_damper")
    u = np.zeros((200, len(network.ports)))
    u[:, 0] = 75.0
    run = march(network, u, np.full(200, 1e-5), np.zeros(len(network.state_names)))
    assert check(run) < 1e-12
    # What the other one dissipates warms nobody.
    assert run.efforts[-1, -1] > 0.0
    with pytest.raises(StructureViolated, match="both networks have a memory theta"):
        other = replace(renamed(hrc(0), "b_"), memories=(ModulatorState("theta", "relaxing", ("b_m",), ("b_p",)),))
        interconnect(warming(), "force", other, "b_force", SPRING, (STIFF,))
