"""Two networks joined through ports: the equations of both, with what one port gives the other takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import random_network
from test_bounded import with_laws

from phnn.errors import InputRefused, StructureViolated
from phnn.laws import RESISTOR_LAWS, ResistorLaw, StorageLaw, register
from phnn.models.actuator import hrc
from phnn.network import Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.network.elements import interconnect, renamed
from phnn.parameters import positive


class _Negative(torch.nn.Module):
    """``φ = −s ε`` beyond a threshold."""

    def __init__(self, threshold: float = 0.0, sign: float = -1.0) -> None:
        super().__init__()
        self.threshold = threshold
        self.strength = torch.nn.Parameter(torch.tensor(sign, dtype=torch.float64))

    def forward(self, effort: torch.Tensor, q: torch.Tensor | None = None) -> torch.Tensor:
        beyond = effort.abs() > self.threshold if q is None else q * effort.abs() > self.threshold
        return torch.where(beyond, self.strength * effort, effort)


class _Falling(torch.nn.Module):
    def __init__(self, function: object) -> None:
        super().__init__()
        self.energy = function


@pytest.mark.parametrize("threshold", [0.0, 1e-9, 3.0, 1e9])
def test_a_law_outside_the_sector_is_refused_with_the_counterexample(threshold: float) -> None:
    with pytest.raises(StructureViolated, match=r"law of damper, a _Negative: φ\(.*ε φ\(ε\) = -.* < 0"):
        PortHamiltonianSystem(with_laws(resistor=_Negative(threshold)))
    # Of a law that reads a state, at some state.
    with pytest.raises(StructureViolated, match=r"reading q = "):
        PortHamiltonianSystem(with_laws(resistor=_Negative(threshold), reads="q"))


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda e: torch.log(e.abs()) * 0.0 + e, "finite"),
        (lambda e: 0.1 + e, "delivers power"),
        (lambda e: torch.where((e - 1.7).abs() < 0.02, -e, e), "delivers power"),
        (lambda e: -1e-3 * torch.sin(e), "delivers power"),
    ],
)
def test_other_laws_that_no_resistor_has_are_refused(law: object, words: str) -> None:
    module = torch.nn.Module()
    module.forward = law  # type: ignore[assignment]
    with pytest.raises(StructureViolated, match=words):
        PortHamiltonianSystem(with_laws(resistor=module))


def test_honest_laws_are_accepted() -> None:
    for law in (torch.sinh, torch.tanh, lambda e: e**3, lambda e: torch.relu(e - 1.0), lambda e: (e + 1.0) - 1.0):
        module = torch.nn.Module()
        module.forward = law  # type: ignore[assignment]
        PortHamiltonianSystem(with_laws(resistor=module))
    for energy in (lambda x: 0.25 * x**4, lambda x: torch.cosh(x), lambda x: 3.0 + x**2):
        PortHamiltonianSystem(with_laws(storage=_Falling(energy)))


@pytest.mark.parametrize(
    "energy", [lambda x: -(x**2), lambda x: x**2 - x, lambda x: x**4 - x**2, lambda x: torch.sin(x) ** 2 - 1e-3 * x]
)
def test_an_energy_below_that_at_rest_is_refused(energy: object) -> None:
    with pytest.raises(StructureViolated, match=r"law of q, a _Falling: H\(.*\) = .* lies below H\(0\)"):
        PortHamiltonianSystem(with_laws(storage=_Falling(energy)))


def test_a_user_law_that_training_carries_out_of_its_sector_delivers_no_power() -> None:
    law = _Negative(sign=1.0)
    system = PortHamiltonianSystem(with_laws(resistor=law))
    x = torch.tensor([[0.3, 2.0], [0.1, -4.0]], dtype=torch.float64)
    assert (system.dissipation(x)[:, 1, 1] == 1.0).all()
    with torch.no_grad():
        system.laws["resistor_damper"].strength.fill_(-5.0)
    assert (system.dissipation(x) == 0.0).all()
    assert (system.power_balance(x, torch.zeros(2, 1, dtype=torch.float64)).dissipated == 0.0).all()


def test_registered_laws_are_tried_in_the_domains_of_their_parameters() -> None:
    with pytest.raises(StructureViolated, match=r"law pump with parameters 0\.5: φ\("):
        register(ResistorLaw("pump", lambda e, q, g: -g * e, (0.5,)))
    with pytest.raises(StructureViolated, match=r"law dip with parameters 0\.5: H\("):
        register(StorageLaw("dip", lambda a, b, k: k * (a * a + a * b + b * b - a - b), (0.5,)))
    with pytest.raises(StructureViolated, match="1 parameters and 2 domains"):
        ResistorLaw("odd", lambda e, q, g: g * e, (0.5,), domains=RESISTOR_LAWS["coulomb"].domains)
    assert not {"pump", "odd"} & set(RESISTOR_LAWS)


seeds = st.integers(0, 2**31 - 1)
STIFF, RHO = positive("stiff", 1.7, "1"), positive("rho", 0.6, "1")


def pair(seed: int) -> tuple[Network, Network]:
    """Two random networks with linear ports, those to be joined last and of numbers."""
    random = np.random.default_rng(seed)
    networks = []
    for k, prefix in enumerate(("a_", "b_")):
        drawn = random_network(seed + k, int(random.integers(1, 5)), int(random.integers(0, 4)), 2)
        ports = tuple(replace(p, law="linear", parameters=()) for p in drawn.ports)
        last = replace(ports[1], on={n: float(random.normal()) for n in ports[1].on})
        networks.append(renamed(replace(drawn, ports=(ports[0], last)), prefix))
    return networks[0], networks[1]


@settings(max_examples=60, deadline=None)
@given(seeds, st.sampled_from(["feedback", "storage", "resistor"]))
def test_joined_networks_are_both_with_their_ports_connected(seed: int, kind: str) -> None:
    one, other = pair(seed)
    given_kind = {
        "feedback": "feedback",
        "storage": Storage("s", "spring", ("stiff",)),
        "resistor": Resistor("r", "quadratic_drag", {}, ("rho",)),
    }[kind]
    extra = {"feedback": (), "storage": (STIFF,), "resistor": (RHO,)}[kind]
    joint = interconnect(one, "a_u1", other, "b_u1", given_kind, extra)  # type: ignore[arg-type]
    system, first, second = (PortHamiltonianSystem(n) for n in (joint, one, other))
    n1, n2 = len(one.storages), len(other.storages)
    random = np.random.default_rng(seed)
    x = torch.from_numpy(random.normal(size=(7, len(joint.storages))))
    u = torch.from_numpy(random.normal(size=(7, 2)))
    x1, x2 = x[:, -n1:], x[:, :n2]
    none = torch.zeros(7, 1, dtype=torch.float64)
    y1 = first.port_outputs(x1, torch.cat([u[:, :1], none], -1))[:, 1]
    y2 = second.port_outputs(x2, torch.cat([u[:, 1:], none], -1))[:, 1]
    if kind == "feedback":
        u1, u2 = -y2, y1
    elif kind == "storage":
        u1 = u2 = -1.7 * x[:, n2]
    else:
        u1 = u2 = -0.6 * (y1 + y2).abs() * (y1 + y2)
    parts = [second.vector_field(x2, torch.stack([u[:, 1], u2], -1))]
    parts += [(y1 + y2)[:, None]] if kind == "storage" else []
    parts += [first.vector_field(x1, torch.stack([u[:, 0], u1], -1))]
    torch.testing.assert_close(system.vector_field(x, u), torch.cat(parts, -1), rtol=1e-9, atol=1e-9)


def test_the_first_network_keeps_its_output_and_its_momentum_last() -> None:
    joint = interconnect(
        hrc(1), "force", renamed(hrc(0), "b_"), "b_force", Storage("s", "spring", ("stiff",)), (STIFF,)
    )
    assert joint.state_names == ("b_q", "b_p", "s", "Q_1", "q", "p")
    assert joint.output == "q"
    assert [p.name for p in joint.ports] == ["voltage", "b_voltage"]
    assert joint.parameters["b_k"].name == "b_k"


def test_a_named_ratio_passes_where_the_other_is_one() -> None:
    follower = renamed(replace(hrc(0), ports=(Port("in", {"p": -1.0}),)), "b_")
    joint = interconnect(hrc(0), "voltage", follower, "b_in")
    structure = PortHamiltonianSystem(joint).structure(torch.zeros(4, dtype=torch.float64))
    alpha = hrc(0).parameters["alpha"].value
    assert structure[1, 3] == -alpha
    with pytest.raises(StructureViolated, match=r"the product b_alpha\*alpha arises between b_p and p"):
        interconnect(hrc(0), "voltage", renamed(hrc(0), "b_"), "b_voltage")


def test_what_cannot_be_joined_is_refused() -> None:
    other = renamed(hrc(0), "b_")
    curved = replace(other, ports=(replace(other.ports[0], law="electrostriction", parameters=("b_k",)),))
    for arguments, message in (
        ((hrc(0), "forse", other, "b_force"), "no port called 'forse': there are voltage, force"),
        ((hrc(0), "force", hrc(0), "force"), r"both networks have a storage p: give one a prefix with renamed\(\)"),
        ((hrc(0), "force", curved, "b_voltage"), "the port b_voltage has the law electrostriction"),
        ((hrc(0), "force", other, "b_force", "rigid"), "kind = 'rigid': write feedback"),
        (
            (hrc(0), "force", other, "b_force", Storage("q", "spring", ("stiff",)), (STIFF,)),
            "two storages share a name",
        ),
    ):
        with pytest.raises(StructureViolated, match=message):
            interconnect(*arguments)  # type: ignore[arg-type]
    with pytest.raises(InputRefused, match="two parameters are called k"):
        interconnect(hrc(0), "force", other, "b_force", Storage("s", "spring", ("k",)), (positive("k", 1.0, "1"),))
