"""Effects find their places in a network by what its parts do; registered ones are refused where unsound."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
from effect_homes import ACTUATOR, BASE, EFFECTS, FOLDER, LEARNED, OF_ACTUATOR, OTHERS, added, home, point, run
from guided_rig import FORCE, REACH, SPEED, write_rig
from hypothesis import given, settings
from hypothesis import strategies as st

import phnn
from phnn.diagnose.diagnosis import diagnose
from phnn.effects import (
    Effect,
    Kind,
    Parts,
    Placed,
    Scales,
    at_sensor,
    catalogue,
    constant,
    effect,
    has_motion,
    in_all_forms,
    kinds,
    positive,
    register,
    registered,
    unregister,
)
from phnn.effects.effect import Values
from phnn.effects.places import attached, place_of
from phnn.errors import InputRefused
from phnn.models.network_file import load_network
from phnn.network.elements import Coupling, Resistor, Storage, relabelled
from phnn.network.roles import Motion, motions
from phnn.report.result import document
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


@pytest.mark.parametrize("effect_", EFFECTS, ids=[e.name for e in EFFECTS])
def test_an_attached_effect_is_a_value(effect_: Effect) -> None:
    where = home(effect_)
    mine = attached(effect_, renamed(where.setup))[0]
    assert mine == attached(effect_, renamed(where.setup))[0]
    for one, setup in ((mine, renamed(where.setup)), (effect_, where.setup)):
        again, values = pickle.loads(pickle.dumps(one)), one.grid(where.scales)[0]
        assert again == one
        changed = one.add_to(setup, values)
        assert again.add_to(setup, values) == changed == pickle.loads(pickle.dumps(changed))


def test_values_that_are_exchanged_have_the_names_of_the_network() -> None:
    plain = catalogue()["extra_hysteron"]
    base = renamed(ACTUATOR.setup)
    mine = attached(plain, base)[0]
    setup, known = mine.add_to(base, point(plain)), plain.add_to(ACTUATOR.setup, point(plain))
    assert mine.equivalents is not None
    assert plain.equivalents is not None
    found, expected = mine.equivalents(setup.values()), plain.equivalents(known.values())
    assert [{strange(n): v for n, v in values.items()} for values in expected] == found


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


# Names of the law's parameters: force, exponent of the speed, and the sizes at which the force is reached.
_RIGHT, _LEFT = ("F_h", "n_h", "v_h", "c_right"), ("F_h", "n_h", "v_h", "c_left")


def grid(scales: Scales) -> list[dict[str, float]]:
    """The law is linear in its strength: one point."""
    slope = 1.0 / scales.displacement
    force = 1e-4 * scales.stiffness * scales.displacement
    return [{"F_h": force, "n_h": 1.0, "v_h": scales.velocity, "c_right": slope, "c_left": -slope}]


GUIDE = Effect(
    name="guide_damping",
    kind=kinds.DAMPING_BY_DISPLACEMENT,
    equation=r"F = F_h\,c\,|q|\,v/v_h",
    statement="The guide brakes the more the farther it bends: with {F_h} at full displacement and {v_h}.",
    fingerprint="Damping grows with the amplitude at every frequency below the resonance.",
    separation="Small sines at the resonance about two offsets of the voltage: the peak is broader about the larger.",
    references=("Smith 2000, Flexures, ch. 4",),
    declares=(
        positive("F_h", "N", "braking force of the guide", 1e8, strength=True),
        constant("n_h", "1", "exponent of the speed"),
        constant("v_h", "m/s", "speed at which the guide brakes with its nominal force"),
        constant("c_right", "1/m", "inverse of the displacement at which it does"),
        constant("c_left", "1/m", "its mirror image"),
    ),
    adds=Parts(
        resistors=(
            Resistor("guide_right", "ramp_damper", {"p": 1.0}, _RIGHT, "q"),
            Resistor("guide_left", "ramp_damper", {"p": 1.0}, _LEFT, "q"),
        )
    ),
    grid=grid,
    applies=has_motion,
    neighbours=("quadratic_drag",),
)


def test_a_registered_effect_is_one_of_the_catalogue_until_it_is_taken_out() -> None:
    assert register(GUIDE) is GUIDE
    try:
        assert effect("guide_damping") is GUIDE
        assert list(catalogue())[-1] == "guide_damping"
        with pytest.raises(InputRefused, match="there already"):
            register(GUIDE)
    finally:
        unregister("guide_damping")
    assert "guide_damping" not in catalogue()
    with pytest.raises(InputRefused, match="was registered: there are none"):
        unregister("guide_damping")
    with registered(GUIDE):
        assert "guide_damping" in catalogue()
    assert "guide_damping" not in catalogue()


def test_an_effect_that_was_sent_to_another_process_is_the_same_one() -> None:
    # Functions of a notebook go by value, so that others come back.
    mine = replace(GUIDE, grid=lambda scales: grid(scales))
    again = pickle.loads(cloudpickle.dumps(mine))
    assert again.grid is not mine.grid
    assert again == mine
    assert hash(again) == hash(mine)
    assert again.grid(ACTUATOR.scales) == mine.grid(ACTUATOR.scales)
    assert again != replace(mine, equation="F = 0")


def weigh(setup: Setup, parameters: Placed) -> Setup:
    """A weight, which is a source of energy, beside the guide."""
    load = Parts((Storage("x_h", "weight", ("F_h",), "m"),), couplings=(Coupling("x_h", "p", 1.0),))
    return load(setup, parameters)


def undocumented(setup: Setup) -> bool:
    return has_motion(setup)


def on_nothing(setup: Setup) -> bool:
    """There is a flux capacitor."""
    return False


def growing(values: Values, factor: float) -> dict[str, float]:
    return {**values, "F_h": max(values["F_h"], 1e-3)}


def two_speeds(scales: Scales) -> list[dict[str, float]]:
    return [{**values, "v_i": 1.0} for values in grid(scales)]


ONE = GUIDE.declares[0]
UNSOUND: dict[str, tuple[dict[str, object], str]] = {
    "a name of another effect": ({"name": "creep"}, "there already"),
    "a name with blanks": ({"name": "guide damping"}, "lower-case words"),
    "a parameter of the base model": ({"declares": (replace(ONE, name="d_2"), *GUIDE.declares[1:])}, "the base model"),
    "a parameter of another effect": ({"declares": (replace(ONE, name="k_s"), *GUIDE.declares[1:])}, "to creep"),
    "a parameter twice": ({"declares": (*GUIDE.declares, ONE)}, "the effect twice"),
    "an unknown neighbour": ({"neighbours": ("gravity",)}, "not in the catalogue"),
    "a location that is none": ({"kind": Kind("wall", "dissipative")}, "no location is called 'wall'"),
    "no equation": ({"equation": r"\frac{1"}, "no LaTeX"),
    "a statement of other things": ({"statement": "It brakes with {F_j}."}, "names .'F_j'., which it does not declare"),
    "nowhere to be added": ({"applies": on_nothing}, "There is a flux capacitor"),
    "a condition without words": ({"applies": undocumented}, "no docstring"),
    "an undeclared value": ({"grid": two_speeds}, "its grid gives"),
    "a source of energy": ({"adds": weigh}, "not passive, and says otherwise"),
    "a strength that does not vanish": ({"rescale": growing}, "does not vanish"),
    "a law that is none": ({"adds": at_sensor("wobble")}, "wobble"),
}


@pytest.mark.parametrize("name", UNSOUND)
def test_what_is_unsound_is_refused_with_its_cause(name: str) -> None:
    changes, cause = UNSOUND[name]
    before = list(catalogue())
    with pytest.raises(InputRefused, match=cause):
        register(replace(GUIDE, **changes))  # type: ignore[arg-type]
    assert list(catalogue()) == before


def test_a_kind_that_is_a_word_is_refused() -> None:
    with pytest.raises(InputRefused, match=r"its kind is 'dissipative': give one of those of phnn\.effects\.kinds"):
        replace(effect("creep"), kind="dissipative")  # type: ignore[arg-type]


def test_a_base_model_of_the_user_serves_as_well() -> None:
    with registered(GUIDE, ACTUATOR):
        assert effect("guide_damping").can_be_added_to(BASE)


@pytest.mark.slow
def test_a_diagnosis_finds_locates_and_names_a_registered_effect(tmp_path: Path) -> None:
    write_rig(tmp_path, power=1.0)
    campaign = phnn.read(tmp_path)
    with registered(GUIDE):
        diagnosis = diagnose(campaign)
    assert diagnosis.places == ("mechanical",)
    assert diagnosis.verdict == "named"
    (claim,) = diagnosis.claims
    assert claim.effect == GUIDE
    assert diagnosis.probability["guide_damping"] == claim.probability
    values = diagnosis.final.setup.values()
    assert values["F_h"] / values["v_h"] * values["c_right"] == pytest.approx(FORCE / SPEED / REACH, rel=0.05)
    (missing,) = document(diagnosis)["missing"]
    assert (missing["effect"], missing["location"], missing["place"]) == ("guide_damping", "mechanical", "q")
    assert "The guide brakes" in missing["statement"]
