"""Effects find their places in a network by what its parts do, whatever they are called."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from effect_homes import ACTUATOR, FOLDER, LEARNED, OF_ACTUATOR, OTHERS, added, home, point, run
from hypothesis import given, settings
from hypothesis import strategies as st

from phnn.effects import Effect, catalogue, in_all_forms
from phnn.effects.places import attached, place_of
from phnn.models.network_file import load_network
from phnn.network.elements import relabelled
from phnn.network.roles import Motion, motions
from phnn.setup import Setup

FORMS = in_all_forms([*OF_ACTUATOR, *LEARNED])
every = pytest.mark.parametrize("effect_", FORMS, ids=["-".join((e.name, *e.parameters)) for e in FORMS])
TWO_MASSES = Setup(load_network(FOLDER / "two_masses.yaml"))


def strange(name: str) -> str:
    """Another name for every name, and for some of them one that an effect would like to have."""
    return {"Q_1": "s", "hysteron_1": "base", "rho_1": "k_s", "d_1": "c_2", "C_1": "tau_s"}.get(name, f"the_{name}")


def renamed(setup: Setup) -> Setup:
    return replace(setup, network=relabelled(setup.network, strange, strange))


@every
def test_other_names_change_nothing_but_names(effect_: Effect) -> None:
    where = home(effect_)
    known = attached(effect_, where.setup)[0]
    assert known == effect_
    assert known.special_cases == effect_.special_cases
    other = renamed(where.setup)
    mine = attached(effect_, other)[0]
    assert mine.canonical == effect_.name
    assert mine.applies(other)
    assert [tuple(p.values()) for p in mine.grid(where.scales)] == [
        tuple(p.values()) for p in effect_.grid(where.scales)
    ]
    values = point(effect_)
    names = dict(zip(effect_.parameters, mine.parameters, strict=True))
    setup = mine.add_to(other, {names[n]: v for n, v in values.items()})
    assert set(setup.parameters) == set(other.parameters) | set(mine.parameters)
    assert not mine.can_be_added_to(setup)
    assert np.array_equal(run(setup, where).y, added(effect_, values).y)
    mine.statement.format(**dict.fromkeys(mine.parameters, "?"))
    assert place_of(mine, other.network) in ("the_q", "the_voltage", "s, the_Q_2")


@pytest.mark.parametrize("effect_", OF_ACTUATOR, ids=[e.name for e in OF_ACTUATOR])
def test_an_attached_effect_is_a_value(effect_: Effect) -> None:
    mine = attached(effect_, renamed(home(effect_).setup))[0]
    assert pickle.loads(pickle.dumps(mine)) == mine
    assert mine == attached(effect_, renamed(home(effect_).setup))[0]


@pytest.mark.parametrize("name", ["creep", "cubic_stiffness", "hysteresis_asymmetry", "self_heating", "base_motion"])
@pytest.mark.parametrize("other", ["extra_hysteron", "quadratic_stiffness", "electrostriction", "sensor_lag"])
def test_two_effects_under_other_names(name: str, other: str) -> None:
    first, second = catalogue()[name], catalogue()[other]
    expected = second.add_to(first.add_to(ACTUATOR.setup, point(first)), point(second))
    base = renamed(ACTUATOR.setup)
    one, two = attached(first, base)[0], attached(second, base)[0]
    found = base
    for mine, plain in ((one, first), (two, second)):
        names = dict(zip(plain.parameters, mine.parameters, strict=True))
        found = mine.add_to(found, {names[n]: v for n, v in point(plain).items()})
    assert np.array_equal(run(found).y, run(expected).y)


def test_values_that_are_exchanged_have_the_names_of_the_network() -> None:
    plain = catalogue()["extra_hysteron"]
    base = renamed(ACTUATOR.setup)
    mine = attached(plain, base)[0]
    setup, known = mine.add_to(base, point(plain)), plain.add_to(ACTUATOR.setup, point(plain))
    assert mine.equivalents is not None
    assert plain.equivalents is not None
    found, expected = mine.equivalents(setup.values()), plain.equivalents(known.values())
    assert [{strange(n): v for n, v in values.items()} for values in expected] == found
    creep, special = plain.special_cases[0], mine.special_cases[0]
    theirs = attached(catalogue()["creep"], base)[0].parameters
    assert dict(zip(theirs, (creep.values(known.values())[n] for n in ("k_s", "tau_s")), strict=True)).items() <= (
        special.values(setup.values()).items()
    )


def test_every_motion_of_a_network_is_found_the_measured_one_first() -> None:
    network = TWO_MASSES.network
    assert motions(network) == (Motion("q_1", "p_1"), Motion("q_2", "p_2"))
    assert motions(replace(network, output="q_2"))[0] == Motion("q_2", "p_2")
    assert motions(OTHERS["tanks"].network) == ()


def test_what_effects_add_is_no_motion_of_its_own() -> None:
    for plain in (e for e in OF_ACTUATOR if e.location == "mechanical"):
        setup = plain.add_to(ACTUATOR.setup, point(plain))
        assert motions(setup.network)[0] == Motion("q", "p")
        assert len(motions(setup.network)) == 1


@pytest.mark.parametrize("name", ["cubic_stiffness", "quadratic_drag", "creep", "contact_stop", "coulomb_friction"])
def test_a_mechanical_effect_comes_once_for_every_motion(name: str) -> None:
    every_one = attached(catalogue()[name], TWO_MASSES)
    here, there = (e for e in every_one if not e.which)
    assert len(every_one) == 2 * catalogue()[name].at_most
    assert (here.name, here.place, place_of(here, TWO_MASSES.network)) == (name, "", "q_1")
    assert (there.name, there.canonical, there.place) == (f"{name} at q_2", name, "q_2")
    assert there.statement.startswith("At q_2: ")
    both = TWO_MASSES
    for effect_ in (here, there):
        both = effect_.add_to(both, effect_.grid(ACTUATOR.scales)[0])
    assert {*here.parameters, *there.parameters} <= set(both.parameters)
    # Seen from the other mass the second one is the first.
    turned = attached(catalogue()[name], replace(TWO_MASSES, network=replace(TWO_MASSES.network, output="q_2")))[0]
    assert turned.place == ""
    assert turned.parameters == here.parameters


@pytest.mark.parametrize("base", [ACTUATOR.setup, renamed(ACTUATOR.setup), TWO_MASSES], ids=["stage", "renamed", "two"])
@pytest.mark.parametrize("effect_", [e for e in OF_ACTUATOR if e.at_most > 1], ids=lambda e: e.name)
def test_several_of_one_effect_add_up_in_any_order(effect_: Effect, base: Setup) -> None:
    every_one = attached(effect_, base)
    of_a_place = [e for e in every_one if e.place == every_one[-1].place]
    assert [e.which for e in of_a_place] == ["", "second", "third"][: effect_.at_most]
    assert {e.canonical for e in of_a_place} == {effect_.name}
    first, second = of_a_place[:2]
    assert first.can_be_added_to(base)
    assert not second.can_be_added_to(base)
    # Two equal relaxing springs are one of twice their stiffness.
    values = {"k_s": 40.0, "tau_s": 0.02}
    named = [dict(zip(e.parameters, values.values(), strict=True)) for e in (first, second)]
    one = first.add_to(base, named[0])
    assert second.can_be_added_to(one)
    assert not second.can_be_added_to(second.add_to(one, named[1]))
    both = [second.add_to(one, named[1]), first.add_to(second.add_to(base, named[1]), named[0])]
    double = first.add_to(base, {**named[0], first.parameters[0]: 80.0})
    expected = run(double).y
    for setup in both:
        assert np.max(np.abs(run(setup).y - expected)) < 1e-9 * np.max(np.abs(expected))


def test_what_is_not_mechanical_comes_once() -> None:
    for effect_ in (e for e in catalogue().values() if e.location in ("amplifier", "sensor")):
        assert len(attached(effect_, TWO_MASSES)) == 1


@given(st.permutations(range(5)))
@settings(deadline=None, max_examples=20)
def test_the_order_of_elements_does_not_choose_the_motion(order: list[int]) -> None:
    network = TWO_MASSES.network
    shuffled = replace(network, storages=tuple(network.storages[i] for i in order))
    assert motions(shuffled)[0] == Motion("q_1", "p_1")
    assert set(motions(shuffled)) == set(motions(network))
