"""Physical parameters behind free coordinates: bounds, exactness, and what modules must survive."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import phnn
from phnn.errors import InputRefused, SolverFailed
from phnn.models.actuator import from_paper, hrc
from phnn.models.store import load, save
from phnn.network import Coupling, Network, Port, PortHamiltonianSystem, Resistor, Storage
from phnn.network.bounded import BoundedParameters
from phnn.nn import ConvexEnergyMLP, SectorMLP
from phnn.parameters import Parameter, as_table, positive
from phnn.setup import Setup

many = settings(max_examples=200, deadline=None)
magnitudes = st.floats(-9.0, 9.0).map(lambda e: 10.0**e)
coordinates = st.one_of(st.floats(-50.0, 50.0), st.floats(allow_nan=False, allow_infinity=False))


def read(parameters: BoundedParameters) -> float:
    return parameters.value("a").item()


def moved(parameters: BoundedParameters, **z: float) -> BoundedParameters:
    with torch.no_grad():
        for name, value in z.items():
            parameters.z[name].fill_(value)
    return parameters


def one(p: Parameter) -> BoundedParameters:
    return BoundedParameters({p.name: p})


def oscillator(**values: float) -> Network:
    """A driven mass on a spring with a damper, of parameters that state no bounds."""
    return Network(
        (Storage("q", "spring", ("k",)), Storage("p", "capacitor", ("m",))),
        (Resistor("damper", "linear", {"p": 1.0}, ("b",)),),
        (Coupling("q", "p"),),
        (Port("force", {"p": 1.0}),),
        as_table([Parameter(n, v, "SI") for n, v in ({"m": 2.0, "k": 8.0, "b": 0.5} | values).items()]),
    )


@many
@given(magnitudes, coordinates)
def test_a_positive_parameter_stays_strictly_within_its_bounds(value: float, z: float) -> None:
    for p in (positive("a", value, "1"), positive("a", value, "1", span=1.5), Parameter("a", value, positive=True)):
        found = read(moved(one(p), a=z))
        assert p.lower < found < p.upper
        assert found > 0.0
        assert math.isfinite(found)


@many
@given(st.floats(-3.0, 3.0), coordinates)
def test_a_parameter_of_any_sign_stays_within_two_bounds(value: float, z: float) -> None:
    p = Parameter("a", value, lower=-3.0, upper=3.0, typical=0.05)
    found = read(moved(one(p), a=z))
    assert -3.0 <= found <= 3.0
    assert -3.0 < found < 3.0 or found == value
    free = read(moved(one(Parameter("a", value, typical=0.05)), a=z))
    assert math.isfinite(free)
    if abs(z) < 1e6:
        assert free == pytest.approx(value + 0.05 * z, rel=1e-12)


@many
@given(magnitudes, st.floats(-6.0, 6.0))
def test_a_coordinate_is_a_relative_change_of_a_parameter_and_of_its_inverse(value: float, z: float) -> None:
    p = one(positive("a", value, "1"))
    assert read(moved(p, a=z)) == pytest.approx(value * math.exp(z), rel=1e-14)
    assert p.slope("a") == pytest.approx(value * math.exp(z), rel=1e-14)
    assert read(moved(one(positive("a", 1.0 / value, "1")), a=-z)) == pytest.approx(math.exp(-z) / value, rel=1e-14)


@many
@given(st.floats(-1e3, 1e3))
def test_slopes_are_derivatives_and_never_vanish(z: float) -> None:
    for p in (
        positive("a", 3e-7, "1"), Parameter("a", 0.2, lower=-3.0, upper=3.0, typical=0.05), Parameter("a", -2.0),
        Parameter("a", 1.0, lower=0.0), Parameter("a", 0.0, lower=0.0, typical=0.1),
    ):  # fmt: skip
        found = one(p)
        slope = moved(found, a=z).slope("a")
        h = 1e-6 * max(1.0, abs(z))
        ends = [read(moved(found, a=z + s * h)) for s in (1.0, -1.0)]
        half = found.table[1, 0].item()
        if abs(abs(z) - half) > 2.0 * h and not (p.value == p.lower and abs(z) < 2.0 * h):
            assert slope == pytest.approx((ends[0] - ends[1]) / (2.0 * h), rel=1e-4, abs=1e-9 * abs(ends[0]) / h)
        assert slope != 0.0


def test_a_value_on_its_bound_is_exact_and_can_leave_it() -> None:
    for p in (Parameter("a", 0.0, lower=0.0, typical=0.1), Parameter("a", 2.0, upper=2.0, lower=-1.0)):
        found = one(p)
        assert read(found) == p.value
        assert found.slope("a") != 0.0
        for z in (-0.5, 0.5, -1e9, 1e9):
            assert p.lower < read(moved(found, a=z)) < p.upper
    assert read(moved(one(Parameter("a", 1.0, lower=1.0, upper=1.0)), a=3.0)) == 1.0


@many
@given(st.floats(-40.0, 40.0))
def test_conversion_to_32_bits_keeps_values(z: float) -> None:
    for p in (positive("a", 2.0, "1"), Parameter("a", 0.0), Parameter("a", 1.0, lower=0.0), Parameter("a", 2e4)):
        found = moved(one(p), a=z * (1.0 if p.positive else 1e6))
        before = read(found)
        assert read(found.to(torch.float32)) == pytest.approx(before, rel=1e-5, abs=1e-30)


@pytest.mark.parametrize("value", [-1.0, 0.0, math.nan, math.inf, 1e30])
def test_values_outside_are_refused_by_name_and_nothing_is_set(value: float) -> None:
    system = PortHamiltonianSystem(from_paper())
    with pytest.raises(InputRefused, match=r"parameter b (=|is)"):
        system.set_values({"k": 2e4, "b": value})
    assert system.value("k").item() == from_paper().parameters["k"].value
    with pytest.raises(InputRefused, match="no free parameter 'stiffness': there are m, k"):
        system.set_values({"stiffness": 1.0})


def test_what_is_set_is_read_to_the_last_bit_and_trains_on_from_there() -> None:
    system = PortHamiltonianSystem(from_paper())
    moved(system.free, k=0.3)
    system.set_values({"k": 20000.1, "rho_2": 3.3e-5})
    assert (system.value("k").item(), system.value("rho_2").item()) == (20000.1, 3.3e-5)
    system.value("k").backward()
    assert system.free.z["k"].grad == pytest.approx(20000.1)


def test_states_copies_and_pickles_hold_the_values(tmp_path: Path) -> None:
    system = PortHamiltonianSystem(hrc(2, {"k": 2.1e4}))
    moved(system.free, k=0.123, C_1=-0.7, rho_2=4.0)
    system.set_values({"b": 4.2})
    again = PortHamiltonianSystem(from_paper())
    again.load_state_dict(system.state_dict())
    torch.save(system, tmp_path / "system.pt")
    stored = torch.load(tmp_path / "system.pt", weights_only=False)
    for other in (again, copy.deepcopy(system), pickle.loads(pickle.dumps(system)), stored):
        for name in system.network.parameters:
            assert other.value(name).item() == system.value(name).item(), name
    moved(system.free, k=0.5)
    assert again.value("k") != system.value("k")
    save(Setup(again.as_network()), tmp_path / "model")
    assert load(tmp_path / "model")[0].network.parameters["k"].value == again.value("k").item()


def test_32_bits_and_batches_of_coordinates() -> None:
    system = PortHamiltonianSystem(from_paper())
    x = torch.randn(3, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 1e-6
    wanted = system.vector_field(x, torch.ones(3, 2, dtype=torch.float64))
    z = torch.tensor([0.0, 0.1, -0.2], dtype=torch.float64)
    batch = torch.func.functional_call(system, {"free.z.k": z, "free.z.alpha": -z}, (torch.zeros(()), x))
    for i, own in enumerate(z.tolist()):
        single = PortHamiltonianSystem(from_paper())
        moved(single.free, k=own, alpha=-own)
        torch.testing.assert_close(batch[i], single(torch.zeros(()), x[i]), rtol=1e-13, atol=0.0)
    small = PortHamiltonianSystem(from_paper()).float()
    found = small.vector_field(x.float(), torch.ones(3, 2))
    assert found.dtype == torch.float32
    torch.testing.assert_close(found.double(), wanted, rtol=1e-4, atol=1e-6)


def test_derivatives_of_second_order_and_maps_over_states() -> None:
    system = PortHamiltonianSystem(from_paper())
    x = torch.tensor([[1e-6, 2e-6, 1e-6, 1e-6]], dtype=torch.float64)
    (first,) = torch.autograd.grad(system.energy(x).sum(), system.free.z["k"], create_graph=True)
    (second,) = torch.autograd.grad(first, system.free.z["k"])
    # H is linear in k = k₀ eᶻ.
    assert second.item() == pytest.approx(first.item(), rel=1e-12)
    mapped = torch.func.vmap(lambda s: system(torch.zeros(()), s))(x.expand(5, 4))
    torch.testing.assert_close(mapped[0], system(torch.zeros(()), x[0]))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"b": -1.0}, r"parameter b = -1 SI must be zero or positive in the law linear of resistor damper"),
        ({"m": -1.0}, r"parameter m = -1 SI must be positive in the law capacitor of storage p"),
        ({"m": 0.0}, r"parameter m = 0 SI must be positive"),
        ({"k": -8.0}, r"parameter k = -8 SI must be zero or positive in the law spring of storage q"),
    ],
)
def test_networks_that_could_deliver_energy_are_refused_by_name(values: dict[str, float], words: str) -> None:
    with pytest.raises(InputRefused, match=words):
        oscillator(**values)
    # Once in a network, a mass is positive by itself.
    with pytest.raises(InputRefused, match=words.partition(" in the law")[0]):
        oscillator().with_values(values)


def test_bounds_that_laws_ask_for_are_those_of_the_network() -> None:
    network = oscillator(k=0.0)
    assert network.parameters["b"].lower == network.parameters["k"].lower == 0.0
    assert network.parameters["m"].positive
    system = PortHamiltonianSystem(network)
    assert system.value("k").item() == 0.0
    moved(system.free, b=-1e6, m=-1e6, k=-1e6)
    assert all(v.item() > 0.0 for v in system.present_values().values())


def with_laws(storage: object = "spring", resistor: object = "linear", reads: str | None = None) -> Network:
    base = oscillator()
    return Network(
        (Storage("q", storage, ("k",) if storage == "spring" else ()), base.storages[1]),
        (Resistor("damper", resistor, {"p": 1.0}, ("b",) if resistor == "linear" else (), reads),),
        base.couplings, base.ports, base.parameters,
    )  # fmt: skip


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e7])
def test_parameters_that_are_no_numbers_are_named_wherever_a_system_is_evaluated(bad: float) -> None:
    x, u = torch.ones(2, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    network = with_laws(ConvexEnergyMLP(1.0, 1.0, 2), SectorMLP(1.0, 1.0, 2))
    for spoil, name in (
        (lambda s: s.free.z["m"], "parameter m is not finite"),
        (lambda s: s.laws["resistor_damper"].heights, r"parameter (resistor_damper\.)?heights is not finite"),
        (lambda s: s.laws["storage_q"].gains, r"parameter (storage_q\.)?gains is not finite"),
    ):
        if math.isfinite(bad) and "heights" not in name and "gains" not in name:
            continue  # The coordinate of a parameter may be any number: the parameter has bounds.
        system = PortHamiltonianSystem(copy.deepcopy(network))
        system.vector_field(x, u)
        # A way that no version of a tensor counts, as that of `torch.nn.utils.vector_to_parameters` is.
        spoil(system).data.fill_(bad)
        for evaluate in (
            lambda s: s.energy(x), lambda s: s.dissipation(x), lambda s: s.structure(x), lambda s: s.efforts(x),
            lambda s: s.vector_field(x, u), lambda s: s.power_balance(x, u), lambda s: s.as_network(),
            lambda s: phnn.simulate(s, torch.ones(5, 1, dtype=torch.float64)),
        ):  # fmt: skip
            with pytest.raises(SolverFailed, match=f"{name} or too large"):
                evaluate(system)
