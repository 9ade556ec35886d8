"""What every member of the catalogue owes; a new effect is tested here without being asked."""

from __future__ import annotations

import math
import pkgutil
import string
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from effect_homes import (
    ACTUATOR,
    BASE,
    EFFECTS,
    FORMULAS,
    LEARNED,
    OF_ACTUATOR,
    OTHERS,
    SCALES,
    TANKS,
    home,
    is_sound,
    point,
    run,
)

import phnn.effects
from phnn.effects import Effect, catalogue, effect, has_spring, in_all_forms
from phnn.effects.effect import gathered
from phnn.effects.formulas import formulas
from phnn.effects.learned import learned_elements
from phnn.effects.soundness import CHECKS, Check
from phnn.errors import InputRefused
from phnn.laws import STORAGE_LAWS
from phnn.recordings.recording import unrecorded

FORMS = in_all_forms([*EFFECTS, *LEARNED, *FORMULAS])
every = pytest.mark.parametrize("effect_", FORMS, ids=["-".join((e.name, *e.parameters)) for e in FORMS])


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


@every
class TestEveryEffect:
    def test_it_is_filed_under_its_name(self, effect_: Effect) -> None:
        member = {**catalogue(), **learned_elements(), **formulas()}[effect_.name]
        assert effect_ in (member, *member.forms)
        assert (effect_.location, effect_.kind) == (member.location, member.kind)
        assert effect_.neighbours

    def test_it_applies_to_an_actuator_and_adds_itself_wherever_it_applies(self, effect_: Effect) -> None:
        assert effect_.can_be_added_to(home(effect_).setup)
        for setup in OTHERS.values():
            if effect_.can_be_added_to(setup):
                assert not effect_.can_be_added_to(effect_.add_to(setup, effect_.grid(SCALES)[0]))
            elif not effect_.applies(setup):
                with pytest.raises(InputRefused, match=r"cannot be added to model; it can be where this holds: [A-Z]"):
                    effect_.add_to(setup, effect_.grid(SCALES)[0])

    def test_its_texts_are_whole(self, effect_: Effect) -> None:
        assert effect_.references
        assert set(effect_.neighbours) <= set(catalogue()) - {effect_.name}
        assert effect_.fingerprint != effect_.separation
        for text in (effect_.fingerprint, effect_.separation):
            assert text[0].isupper()
            assert text.endswith(".")
            assert ". " not in text

    def test_its_statement_shows_its_values(self, effect_: Effect) -> None:
        fields = {name for _, name, _, _ in string.Formatter().parse(effect_.statement) if name}
        assert fields or not effect_.parameters
        assert effect_.statement.endswith(".")

    def test_its_plausible_ranges_have_a_source(self, effect_: Effect) -> None:
        for known in effect_.plausible.values():
            assert known.lower < known.upper
            assert bool(known.source) == (math.isfinite(known.lower) and math.isfinite(known.upper))
            assert not known.over or known.over in home(effect_).setup.parameters
            assert not known.source or (len(known.source) > 15 and not known.source.endswith("."))

    @pytest.mark.parametrize("check", CHECKS, ids=lambda c: c.__name__)
    def test_it_is_sound(self, effect_: Effect, check: Check) -> None:
        check(effect_, home(effect_))


# A threshold follows one state: of two effects that would change it, the second does not apply.
EXCLUSIVE = [{"hysteresis_asymmetry", "rate_dependent_threshold"}]
PAIRS = [(a, b) for a, b in combinations(EFFECTS, 2) if home(a) is home(b)]
# Structure is the same whatever the step: every fourth sample of the drives will do.
SHORTER = {w: replace(w, drive=unrecorded("home", w.drive.t[::4], w.drive.u[::4])) for w in (ACTUATOR, TANKS)}


@pytest.mark.parametrize(("a", "b"), [pytest.param(a, b, id=f"{a.name}+{b.name}") for a, b in PAIRS])
def test_every_pair_keeps_the_structure(a: Effect, b: Effect) -> None:
    where = home(a)
    with_a, with_b = a.add_to(where.setup, point(a)), b.add_to(where.setup, point(b))
    possible = {b.can_be_added_to(with_a), a.can_be_added_to(with_b)}
    assert possible == ({False} if {a.name, b.name} in EXCLUSIVE else {True})
    if possible == {False}:
        with pytest.raises(InputRefused, match=f"{b.name} cannot be added to model.{a.name}; it can be where"):
            b.add_to(with_a, point(b))
        return
    first = b.add_to(with_a, point(b))
    is_sound(first, SHORTER[where])
    second = a.add_to(with_b, point(a))
    assert set(first.parameters) == set(second.parameters)


def test_order_of_two_effects_of_the_network_does_not_matter() -> None:
    # What they change are the hysterons that are there already.
    early = {"hysteresis_asymmetry", "rate_dependent_threshold", "charge_leakage"}
    for a, b in combinations([e for e in OF_ACTUATOR if not (e.needs_command or e.location == "sensor")], 2):
        if {a.name, b.name} in EXCLUSIVE or ("extra_hysteron" in {a.name, b.name} and early & {a.name, b.name}):
            continue
        one = run(b.add_to(a.add_to(BASE, point(a)), point(b))).y
        two = run(a.add_to(b.add_to(BASE, point(b)), point(a))).y
        same = np.abs(one - two).max() < 1e-9 * np.abs(one).max()
        assert same, (a.name, b.name)


def test_no_chapter_of_the_catalogue_is_forgotten() -> None:
    chapters = [f"phnn.effects.{module.name}" for module in pkgutil.iter_modules(phnn.effects.__path__)]
    assert set(gathered(*chapters)) == {member.name for member in (*EFFECTS, *LEARNED, *FORMULAS)}


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


def test_two_forms_of_an_effect_exclude_each_other_and_themselves() -> None:
    for member in EFFECTS:
        setups = [form.add_to(home(member).setup, point(form)) for form in in_all_forms([member])]
        for form in in_all_forms([member]):
            assert not any(form.can_be_added_to(setup) for setup in setups)
        with pytest.raises(InputRefused, match="rename one" if member.parameters else "cannot be added to"):
            member.add_to(setups[0], point(member))
