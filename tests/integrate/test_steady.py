"""Steady states: nothing moves in them, they are reached, and a network without one is refused by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from junctions import march

from phnn.configuration import config_folder
from phnn.errors import SolverFailed
from phnn.integrate.program import compile_network
from phnn.integrate.rest import equilibrium
from phnn.integrate.steady import steady_derivative, steady_slope, steady_state
from phnn.models.network_file import load_network
from phnn.network import Network, PortHamiltonianSystem, Resistor
from phnn.parameters import Parameter

VOLTAGES = (3.0, 40.0)


def named(name: str) -> Network:
    return load_network(config_folder() / "network" / f"{name}.yaml")


# A constant force moves the one, and a constant velocity the other, for ever.
RESTLESS = ("mass_damper", "friction_rig")
NETWORKS = {p.stem: p.stem for p in (config_folder() / "network").glob("*.yaml") if p.stem not in RESTLESS}


def inputs(network: Network, first: float) -> np.ndarray:
    return np.array([first, *[0.0] * (len(network.ports) - 1)])


@pytest.mark.parametrize("first", VOLTAGES)
@pytest.mark.parametrize("name", sorted(NETWORKS))
def test_nothing_moves_in_a_steady_state(name: str, first: float) -> None:
    network = named(name)
    u = inputs(network, first)
    x = equilibrium(compile_network(network), network, u)
    assert np.isfinite(x).all()
    assert x.any()
    # An independent witness: the compiled march stays where it is.
    steps = 50
    states = march(network, np.tile(u, (steps, 1)), np.full(steps, 1e-5), x).states
    np.testing.assert_allclose(states, np.tile(x, (steps + 1, 1)), rtol=1e-9, atol=1e-12 * np.abs(x).max())


@pytest.mark.parametrize("first", VOLTAGES)
def test_networks_with_the_same_map_rest_at_the_same_place(first: float) -> None:
    places = []
    for name in ("hrc", "series_rl", "series_rc", "parallel_rl"):
        network = named(name)
        x = equilibrium(compile_network(network), network, inputs(network, first))
        places.append(x[network.state_names.index("q")])
    np.testing.assert_allclose(places, places[0], rtol=1e-12)
    # What flowed into a node stays there: its charges are those that the mass has moved.
    network = named("series_rc")
    x = dict(zip(network.state_names, steady_state(network, inputs(network, first)), strict=True))
    alpha = network.parameters["alpha"].value
    for i in (1, 2):
        assert x[f"Q_C{i}"] + x[f"Q_{i}"] == pytest.approx(alpha * x["q"], rel=1e-12)


def test_currents_may_flow_in_a_steady_state() -> None:
    network, v = named("hrcl"), 40.0
    p = {n: q.value for n, q in network.parameters.items()}
    x = dict(zip(network.state_names, steady_state(network, inputs(network, v)), strict=True))
    # All voltage is across the hysteron, which carries it into the inductor; the displacement forgets it.
    assert x["Q_1"] == pytest.approx(p["C_1"] * v, rel=1e-12)
    assert x["phi"] == pytest.approx(p["L"] * p["rho_1"] * (v - 0.5 * p["d_1"]), rel=1e-12)
    assert abs(x["q"]) < 1e-15 * v
    below = dict(zip(network.state_names, steady_state(network, inputs(network, 3.0)), strict=True))
    assert abs(below["phi"]) < 1e-15


def test_tanks_fill_to_their_steady_state() -> None:
    network, pumped = named("tanks"), 2e-6
    p = {n: q.value for n, q in network.parameters.items()}
    second = pumped / p["g_out"]
    exact = np.array([p["A_1"] * (second + pumped / p["g"]), p["A_2"] * second])
    x = steady_state(network, np.array([pumped]))
    np.testing.assert_allclose(x, exact, rtol=1e-12)
    filled = march(network, np.full((4000, 1), pumped), np.full(4000, 1.0), np.zeros(2)).states[-1]
    np.testing.assert_allclose(filled, x, rtol=1e-9)
    slope = steady_derivative(network, np.array([pumped]), ["g_out", "g", "A_2"])
    outlet, pipe = -pumped / p["g_out"] ** 2, -pumped / p["g"] ** 2
    expected = [[p["A_1"] * outlet, p["A_1"] * pipe, 0.0], [p["A_2"] * outlet, 0.0, second]]
    np.testing.assert_allclose(slope, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max(axis=0).min())
    np.testing.assert_allclose(steady_slope(network, np.array([pumped]), 0), exact / pumped, rtol=1e-12)


def test_derivatives_of_currents_that_flow_are_exact() -> None:
    network, v = named("hrcl"), 40.0
    p = {n: q.value for n, q in network.parameters.items()}
    names, excess = ["C_1", "L", "rho_1", "d_1"], v - 0.5 * p["d_1"]
    place = {name: network.state_names.index(name) for name in ("Q_1", "phi")}
    # Q_1 = C_1 v and phi = L rho_1 (v − d_1/2), as above.
    assert steady_derivative(network, inputs(network, v), []).shape == (len(network.state_names), 0)
    found = steady_derivative(network, inputs(network, v), names)
    expected = [p["rho_1"] * excess, p["L"] * excess, -0.5 * p["L"] * p["rho_1"]]
    np.testing.assert_allclose(found[place["phi"], 1:], expected, rtol=1e-10)
    assert found[place["Q_1"], 0] == pytest.approx(v, rel=1e-10)
    slope = steady_slope(network, inputs(network, v), 0)
    assert slope[place["phi"]] == pytest.approx(p["L"] * p["rho_1"], rel=1e-10)
    assert slope[place["Q_1"]] == pytest.approx(p["C_1"], rel=1e-10)


def test_the_beam_bends_as_its_stiffness_says() -> None:
    network, v = named("driven_beam"), 40.0
    x = torch.from_numpy(equilibrium(compile_network(network), network, inputs(network, v)))
    system = PortHamiltonianSystem(network)
    efforts = dict(zip(network.state_names, system.efforts(x).tolist(), strict=True))
    # The joint carries what the actuator's own spring does not hold of the voltage's force.
    alpha = network.parameters["alpha"].value
    assert efforts["q"] + efforts["joint"] == pytest.approx(alpha * v, rel=1e-12)
    assert all(abs(efforts[n]) < 1e-12 * v for n in efforts if n.startswith(("Q_", "beam_p")))


def test_what_moves_for_ever_is_refused_by_name() -> None:
    network = named("mass_damper")
    with pytest.raises(SolverFailed, match=r"moves q for ever, nothing holds it.* declare start: unknown"):
        equilibrium(compile_network(network), network, np.array([30.0]))
    assert not equilibrium(compile_network(network), network, np.zeros(1)).any()


@pytest.mark.parametrize("force", [0.5, 30.0])
@pytest.mark.parametrize("exponent", [0.0, 0.5])
def test_friction_that_grows_with_the_distance_holds_nothing(exponent: float, force: float) -> None:
    # A speed that is small beside the place is none the less a speed; it was taken for rest at 1e7 to 1e55 m.
    bare = named("mass_damper")
    values = {"drag": 0.01, "square": 2.0, "v_d": 0.003, "F_h": 1e-3, "n_h": exponent, "v_h": 0.5, "c_h": -20.0}
    resistors = (
        Resistor("drag", "power_damper", {"p": 1.0}, ("drag", "drag", "square", "v_d")),
        Resistor("guide", "ramp_damper", {"p": 1.0}, ("F_h", "n_h", "v_h", "c_h"), "q"),
    )
    parameters = {**bare.parameters, **{n: Parameter(n, v) for n, v in values.items()}}
    network = replace(bare, resistors=resistors, parameters=parameters)
    with pytest.raises(SolverFailed, match=r"moves q.* for ever, nothing holds"):
        equilibrium(compile_network(network), network, np.array([force]))
    assert not equilibrium(compile_network(network), network, np.zeros(1)).any()
