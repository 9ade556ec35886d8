"""What every member of the catalogue owes; a new effect is tested here without being asked."""

from __future__ import annotations

import importlib
import pkgutil
import string
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
import torch
from junctions import recording
from matplotlib.mathtext import MathTextParser

import phnn.effects
from phnn.configuration import config_folder
from phnn.effects import Effect, Scales, catalogue, effect
from phnn.effects.effect import LOCATIONS, has_spring
from phnn.errors import InputRefused
from phnn.integrate.residual import check, power_balance
from phnn.laws import STORAGE_LAWS
from phnn.models.actuator import from_paper, hrc
from phnn.models.network_file import load_network
from phnn.network import PortHamiltonianSystem
from phnn.setup import Setup
from phnn.simulate import Trajectory, output_derivatives, simulate
from phnn.units import quantity

torch.set_num_threads(1)

SCALES = Scales(
    voltage=75.0, displacement=1.2e-4, velocity=0.1, stiffness=24579.0, transducer=0.046, slowest=20.0,
    fastest=150.0, duration=0.02, noise=5e-8,
)  # fmt: skip
BASE = Setup(from_paper())
FOLDER = config_folder() / "network"
# What is no actuator: no hysteron, no transducer, no spring, no motion.
OTHERS = {
    "oscillator": Setup(load_network(FOLDER / "mass_spring_damper.yaml")),
    "mass": Setup(load_network(FOLDER / "mass_damper.yaml")),
    "tanks": Setup(load_network(FOLDER / "tanks.yaml")),
    "linear": Setup(hrc(0)),
}
EFFECTS = list(catalogue().values())
every = pytest.mark.parametrize("effect_", EFFECTS, ids=[e.name for e in EFFECTS])


def test_what_needs_a_part_does_not_apply_without_it() -> None:
    found = {name: {e.name for e in EFFECTS if e.applies(setup)} for name, setup in OTHERS.items()}
    everywhere = {e.name for e in EFFECTS if e.location in ("amplifier", "sensor")}
    for names in found.values():
        assert everywhere <= names
    assert {"creep", "cubic_stiffness", "quadratic_drag"} <= found["oscillator"]
    assert not {"electrostriction", "extra_hysteron", "hysteresis_asymmetry"} & found["oscillator"]
    assert found["oscillator"] - found["mass"] == {e.name for e in EFFECTS if e.applies is has_spring}
    assert not {"creep", "quadratic_drag", "extra_hysteron"} & found["tanks"]
    assert "electrostriction" in found["linear"]
    assert "hysteresis_asymmetry" not in found["linear"]


@cache
def drive() -> object:
    """Two amplitudes of a sine from rest."""
    t = np.arange(401) * 5e-5
    return recording(t, 75.0 * np.sin(2 * np.pi * 100.0 * t) * np.where(t < 0.01, 0.4, 1.0))


def run(setup: Setup) -> Trajectory:
    return simulate(setup, drive())  # type: ignore[arg-type]


@cache
def base() -> Trajectory:
    return run(BASE)


def point(effect_: Effect) -> dict[str, float]:
    """The first point of the effect's grid, made strong enough to be seen."""
    return effect_.scaled(effect_.grid(SCALES)[0], 50.0)


def is_sound(setup: Setup) -> None:
    """The network is port-Hamiltonian and passive, and the compiled march agrees with the module."""
    trajectory = run(setup)
    assert np.isfinite(trajectory.y).all()
    system = PortHamiltonianSystem(setup.network)
    assert check(trajectory, system=system) < 1e-10
    x = torch.from_numpy(trajectory.states)[::7]
    with torch.no_grad():
        j, d = system.structure(x), system.dissipation(x)
        held = system.energies(x)
    assert torch.equal(j, -j.mT)
    assert torch.equal(d, d.mT)
    assert (torch.linalg.eigvalsh(d) >= -1e-12 * d.abs().amax((-2, -1))[:, None]).all()
    assert (held >= 0.0).all()
    balance = power_balance(trajectory, system)
    size = balance.supplied.abs().sum(-1) + balance.dissipated.abs().sum(-1) + held.max()
    assert (balance.defect.abs() <= 1e-12 * size).all()
    assert (balance.dissipated >= -1e-12 * size[:, None]).all()


@every
class TestEveryEffect:
    def test_it_is_filed_under_its_name(self, effect_: Effect) -> None:
        module = importlib.import_module(f"phnn.effects.{effect_.name}")
        assert module.EFFECT is effect_ is effect(effect_.name)
        assert effect_.location in LOCATIONS
        assert effect_.references
        assert effect_.name not in effect_.neighbours
        assert effect_.neighbours

    def test_fingerprint_and_separation_are_one_sentence_each(self, effect_: Effect) -> None:
        for text in (effect_.fingerprint, effect_.separation):
            assert text[0].isupper()
            assert text.endswith(".")
            assert text.count(". ") == 0
        assert effect_.fingerprint != effect_.separation

    def test_it_applies_to_an_actuator_and_adds_itself_wherever_it_applies(self, effect_: Effect) -> None:
        assert effect_.can_be_added_to(BASE)
        for setup in OTHERS.values():
            if effect_.can_be_added_to(setup):
                assert not effect_.can_be_added_to(effect_.add_to(setup, effect_.grid(SCALES)[0]))

    def test_equation_is_mathtext(self, effect_: Effect) -> None:
        MathTextParser("path").parse(f"${effect_.equation}$")

    def test_statement_states_its_parameters(self, effect_: Effect) -> None:
        fields = {name for _, name, _, _ in string.Formatter().parse(effect_.statement) if name}
        assert fields
        assert fields <= set(effect_.parameters)
        setup = effect_.add_to(BASE, point(effect_))
        told = {name: quantity(setup.parameters[name].value, setup.parameters[name].unit) for name in fields}
        text = effect_.statement.format(**told)
        assert all(value in text for value in told.values())
        assert text.endswith(".")

    def test_every_grid_point_builds_and_simulates(self, effect_: Effect) -> None:
        for values in effect_.grid(SCALES):
            assert set(values) == set(effect_.parameters)
            setup = effect_.add_to(BASE, values)
            assert setup.name == f"model+{effect_.name}"
            assert set(setup.parameters) - set(BASE.parameters) == set(effect_.parameters)
            assert {name: setup.parameters[name].value for name in values} == values
            assert np.isfinite(run(setup).y).all()

    def test_structure_and_power_balance(self, effect_: Effect) -> None:
        setup = effect_.add_to(BASE, point(effect_))
        is_sound(setup)
        # What is not passive stands outside the passive core; what is stands inside it.
        assert (setup.network != BASE.network) == effect_.passive
        assert bool(setup.amplifier or setup.sensor) != effect_.passive

    def test_it_moves_the_output_and_vanishes_with_its_strength(self, effect_: Effect) -> None:
        values = point(effect_)
        moved = [difference(effect_, values)]
        assert moved[0] > 1e-4
        for share in (1e-2, 1e-4):
            if effect_.strength is None:
                # A limit beyond every command is no limit.
                weak = {name: value * (1.0 + 1.0 / share) for name, value in values.items()}
            elif effect_.rescale is not None:
                weak = values | {name: values[name] / share for name in ("C_x", "rho_x")}
            else:
                weak = values | {effect_.strength: values[effect_.strength] * share}
            moved.append(difference(effect_, weak))
        assert moved[1] < 0.2 * moved[0]
        assert moved[2] <= 0.02 * moved[1]

    def test_scaling_keeps_it_physical(self, effect_: Effect) -> None:
        values = point(effect_)
        for factor in (-3.0, 0.0, 0.5, 20.0):
            scaled = effect_.scaled(values, factor)
            assert set(scaled) == set(values)
            assert np.isfinite(run(effect_.add_to(BASE, scaled)).y).all()

    def test_only_an_amplifier_needs_the_command(self, effect_: Effect) -> None:
        assert effect_.needs_command == (effect_.location == "amplifier")

    def test_derivatives_agree_with_finite_differences(self, effect_: Effect) -> None:
        setup = effect_.add_to(BASE, point(effect_))
        names = [name for name in setup.free if name in effect_.parameters]
        trajectory = run(setup)
        got = output_derivatives(trajectory, names)
        for k, name in enumerate(names):
            value = setup.parameters[name].value
            step = 1e-5 * value
            ends = [run(setup.with_values({name: value + s})).y for s in (step, -step)]
            wanted = (ends[0] - ends[1]) / (2.0 * step)
            # The march has kinks, which a finite difference may straddle: a few samples may differ.
            wrong = np.abs(got[:, k] - wanted) > 1e-4 * np.abs(wanted).max()
            assert np.abs(wanted).max() > 0.0
            assert wrong.mean() < 0.05, name


def difference(effect_: Effect, values: dict[str, float]) -> float:
    """Largest change of the output by an effect, relative to the output."""
    y = run(effect_.add_to(BASE, values)).y
    return float(np.abs(y - base().y).max() / np.abs(base().y).max())


@pytest.mark.parametrize(("a", "b"), [pytest.param(a, b, id=f"{a.name}+{b.name}") for a, b in combinations(EFFECTS, 2)])
def test_every_pair_keeps_the_structure(a: Effect, b: Effect) -> None:
    first = b.add_to(a.add_to(BASE, point(a)), point(b))
    is_sound(first)
    second = a.add_to(b.add_to(BASE, point(b)), point(a))
    assert set(first.parameters) == set(second.parameters)


def test_order_of_two_effects_of_the_network_does_not_matter() -> None:
    for a, b in combinations([e for e in EFFECTS if e.passive], 2):
        if {a.name, b.name} == {"extra_hysteron", "hysteresis_asymmetry"}:
            continue  # The thresholds that follow are those of the hysterons that are there already.
        one = run(b.add_to(a.add_to(BASE, point(a)), point(b))).y
        two = run(a.add_to(b.add_to(BASE, point(b)), point(a))).y
        same = np.abs(one - two).max() < 1e-9 * np.abs(one).max()
        assert same, (a.name, b.name)


def test_the_catalogue_lists_every_file() -> None:
    files = {m.name for m in pkgutil.iter_modules(phnn.effects.__path__)} - {"effect"}
    assert set(catalogue()) == files


def test_an_effect_cannot_be_added_twice() -> None:
    for member in EFFECTS:
        once = member.add_to(BASE, point(member))
        with pytest.raises(InputRefused, match="rename one"):
            member.add_to(once, point(member))


def test_an_unknown_effect_is_refused_with_the_list() -> None:
    with pytest.raises(InputRefused, match=r"no effect called 'gravity': the catalogue has .*creep"):
        effect("gravity")


def test_a_softening_spring_stays_bounded_below() -> None:
    setup = effect("cubic_stiffness").add_to(BASE, {"kappa_3": -1.5, "q_0": SCALES.displacement})
    is_sound(setup)
    spring = setup.network.storages[2]
    values = [setup.parameters[n].value for n in spring.parameters]
    x = np.linspace(-1e-2, 1e-2, 1001)
    assert (STORAGE_LAWS[spring.law].energy(x, *values) >= 0.0).all()


def test_neighbours_that_exist_are_in_the_catalogue_or_planned() -> None:
    planned = {
        "delay", "sensor_lag", "contact_stop", "displacement_coupling", "quadratic_stiffness", "sensor_nonlinearity",
        "slew_limit",
    }  # fmt: skip
    for member in EFFECTS:
        assert set(member.neighbours) <= set(catalogue()) | planned, member.name


def test_setup_is_not_changed_by_adding() -> None:
    before = replace(BASE)
    for member in EFFECTS:
        member.add_to(BASE, point(member))
    assert before == BASE
