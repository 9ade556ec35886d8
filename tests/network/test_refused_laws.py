"""Laws that others write: what is refused with its counterexample, and what is accepted."""

from __future__ import annotations

import pytest
import torch
from test_bounded import with_laws

from phnn.errors import StructureViolated
from phnn.laws import RESISTOR_LAWS, ResistorLaw, StorageLaw, register
from phnn.network import PortHamiltonianSystem

torch.set_num_threads(1)


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
        law.strength.fill_(-5.0)
    assert (system.dissipation(x) == 0.0).all()
    assert (system.power_balance(x, torch.zeros(2, 1, dtype=torch.float64)).dissipated == 0.0).all()


def test_registered_laws_are_tried_in_the_domains_of_their_parameters() -> None:
    with pytest.raises(StructureViolated, match=r"law pump with parameters 0\.5: φ\("):
        register(ResistorLaw("pump", lambda e, q, g: -g * e, (0.5,)))
    with pytest.raises(StructureViolated, match=r"law dip with parameters 0\.5: H\("):
        register(StorageLaw("dip", lambda x, k: k * x * x * (x - 1.0), lambda a, b, k: k * a, (0.5,)))
    with pytest.raises(StructureViolated, match="1 parameters and 2 domains"):
        ResistorLaw("odd", lambda e, q, g: g * e, (0.5,), domains=RESISTOR_LAWS["coulomb"].domains)
    assert not {"pump", "odd"} & set(RESISTOR_LAWS)
