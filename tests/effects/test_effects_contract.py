"""What every member of the catalogue owes; a new effect is tested here without being asked."""

from __future__ import annotations

import importlib
import pkgutil
import string
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import torch
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
    added,
    base,
    home,
    is_sound,
    point,
    run,
    sources,
)
from matplotlib.mathtext import MathTextParser

import phnn.effects
from phnn.derivatives import output_derivatives
from phnn.effects import Effect, catalogue, effect, has_spring, in_all_forms
from phnn.effects.formulas import formulas
from phnn.effects.kinds import LOCATIONS
from phnn.effects.learned import learned_elements
from phnn.errors import InputRefused
from phnn.laws import STORAGE_LAWS
from phnn.units import quantity

torch.set_num_threads(1)

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
        places = ("", catalogue()), ("learned.", learned_elements()), ("formulas.", formulas())
        folder, members = next((f, m) for f, m in places if effect_.name in m)
        module = importlib.import_module(f"phnn.effects.{folder}{effect_.name.removeprefix('learned_')}")
        assert module.EFFECT is members[effect_.name]
        assert effect_ in (module.EFFECT, *module.EFFECT.forms)
        assert (effect_.location, effect_.kind) == (module.EFFECT.location, module.EFFECT.kind)
        assert not effect_.forms or effect_ is module.EFFECT
        assert effect_.location in LOCATIONS
        assert effect_.references
        assert effect_.name not in effect_.neighbours
        assert effect_.neighbours

    def test_every_parameter_has_a_plausible_range_or_says_that_none_is_known(self, effect_: Effect) -> None:
        assert set(effect_.plausible) == set(effect_.parameters)
        for name, found in effect_.plausible.items():
            assert found.lower < found.upper
            assert bool(found.source) == bool(np.isfinite([found.lower, found.upper]).all()), name
            assert not found.over or found.over in home(effect_).setup.parameters
            # What says of itself where it comes from is long enough to do so, and part of a sentence.
            assert not found.source or (len(found.source) > 15 and not found.source.endswith("."))

    def test_fingerprint_and_separation_are_one_sentence_each(self, effect_: Effect) -> None:
        for text in (effect_.fingerprint, effect_.separation):
            assert text[0].isupper()
            assert text.endswith(".")
            assert text.count(". ") == 0
        assert effect_.fingerprint != effect_.separation

    def test_it_applies_to_an_actuator_and_adds_itself_wherever_it_applies(self, effect_: Effect) -> None:
        assert effect_.can_be_added_to(home(effect_).setup)
        for setup in OTHERS.values():
            if effect_.can_be_added_to(setup):
                assert not effect_.can_be_added_to(effect_.add_to(setup, effect_.grid(SCALES)[0]))
            elif not effect_.applies(setup):
                with pytest.raises(InputRefused, match=r"cannot be added to model; it can be where this holds: [A-Z]"):
                    effect_.add_to(setup, effect_.grid(SCALES)[0])

    def test_equation_is_mathtext(self, effect_: Effect) -> None:
        MathTextParser("path").parse(f"${effect_.equation}$")

    def test_statement_states_its_parameters(self, effect_: Effect) -> None:
        fields = {name for _, name, _, _ in string.Formatter().parse(effect_.statement) if name}
        assert fields or not effect_.parameters
        assert fields <= set(effect_.parameters)
        setup = effect_.add_to(home(effect_).setup, point(effect_))
        told = {name: quantity(setup.parameters[name].value, setup.parameters[name].unit) for name in fields}
        text = effect_.statement.format(**told)
        assert all(value in text for value in told.values())
        assert text.endswith(".")

    def test_every_grid_point_builds_and_simulates(self, effect_: Effect) -> None:
        where = home(effect_)
        for values in effect_.grid(where.scales):
            assert set(values) == set(effect_.parameters)
            setup = effect_.add_to(where.setup, values)
            assert setup.name == f"model+{effect_.name}"
            assert set(setup.parameters) - set(where.setup.parameters) == set(effect_.parameters)
            assert {name: setup.parameters[name].value for name in values} == values
            assert np.isfinite(run(setup, where).y).all()

    def test_structure_and_power_balance(self, effect_: Effect) -> None:
        where = home(effect_)
        setup = effect_.add_to(where.setup, point(effect_))
        is_sound(setup, where)
        # What is not passive stands outside the passive core, or is a source; what is stands inside it.
        inside = setup.network != where.setup.network
        assert bool(setup.amplifier or setup.sensor or setup.own != where.setup.own) != inside
        assert effect_.passive == (inside and not any(sources(setup.network)))

    def test_it_moves_the_output_and_vanishes_with_its_strength(self, effect_: Effect) -> None:
        values = point(effect_)
        moved = [difference(effect_, values)]
        if effect_.add_to(home(effect_).setup, values).own != home(effect_).setup.own:
            assert moved[0] == 0.0  # Amplitude and phase of a line, the course of a sensor are every recording's own.
            return
        assert moved[0] > 1e-4
        if not effect_.parameters:
            return  # There is nothing by which it could be weaker.
        for share in (1e-2, 1e-4):
            if effect_.strength is None:
                # A limit beyond every command is no limit.
                weak = values | {effect_.parameters[0]: values[effect_.parameters[0]] * (1.0 + 1.0 / share)}
            else:
                weak = effect_.scaled(values, 1e-2)
                weak = weak if share == 1e-2 else effect_.scaled(weak, 1e-2)
            moved.append(difference(effect_, weak))
        assert moved[1] < 0.2 * moved[0]
        assert moved[2] <= 0.02 * moved[1]

    def test_scaling_keeps_it_physical(self, effect_: Effect) -> None:
        values = point(effect_)
        for factor in (-3.0, 0.0, 0.5, 20.0):
            scaled = effect_.scaled(values, factor)
            assert set(scaled) == set(values)
            assert np.isfinite(added(effect_, scaled).y).all()

    def test_only_an_amplifier_needs_the_command(self, effect_: Effect) -> None:
        assert effect_.needs_command == (effect_.location == "amplifier")

    def test_derivatives_agree_with_finite_differences(self, effect_: Effect) -> None:
        where = home(effect_)
        setup = effect_.add_to(where.setup, point(effect_))
        names = [name for name in setup.free if name in effect_.parameters]
        trajectory = run(setup, where)
        got = output_derivatives(trajectory, names)
        for k, name in enumerate(names):
            value = setup.parameters[name].value
            step = 1e-5 * (abs(value) or setup.parameters[name].typical)
            ends = [run(setup.with_values({name: value + s}), where).y for s in (step, -step)]
            wanted = (ends[0] - ends[1]) / (2.0 * step)
            # The march has kinks, which a finite difference may straddle: a few samples may differ.
            wrong = np.abs(got[:, k] - wanted) > 1e-4 * np.abs(wanted).max()
            assert np.abs(wanted).max() > 0.0
            assert wrong.mean() < 0.05, name


def difference(effect_: Effect, values: dict[str, float]) -> float:
    """Largest change of the output by an effect, relative to the output."""
    where = home(effect_)
    return float(np.abs(added(effect_, values).y - base(where).y).max() / np.abs(base(where).y).max())


# A threshold follows one state: of two effects that would change it, the second does not apply.
EXCLUSIVE = [{"hysteresis_asymmetry", "rate_dependent_threshold"}]
PAIRS = [(a, b) for a, b in combinations(EFFECTS, 2) if home(a) is home(b)]


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
    is_sound(first, where)
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


def test_the_catalogue_lists_every_file() -> None:
    others = {
        "additions", "bent", "conditions", "declaration", "effect", "formulas", "kinds", "learned", "places", "rim",
    }  # fmt: skip
    assert set(catalogue()) == {m.name for m in pkgutil.iter_modules(phnn.effects.__path__)} - others


def test_an_effect_cannot_be_added_twice() -> None:
    for member in EFFECTS:
        once = member.add_to(home(member).setup, point(member))
        assert not member.can_be_added_to(once)
        with pytest.raises(InputRefused, match="rename one" if member.parameters else "cannot be added to"):
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


def test_two_forms_of_an_effect_exclude_each_other() -> None:
    for member in EFFECTS:
        setups = [form.add_to(home(member).setup, point(form)) for form in in_all_forms([member])]
        for form in in_all_forms([member]):
            assert not any(form.can_be_added_to(setup) for setup in setups)


def test_neighbours_are_in_the_catalogue() -> None:
    for member in (*EFFECTS, *LEARNED, *FORMULAS):
        assert set(member.neighbours) <= set(catalogue()), member.name


def test_setup_is_not_changed_by_adding() -> None:
    for where in (ACTUATOR, TANKS):
        before = replace(where.setup)
        for member in EFFECTS:
            if home(member) is where:
                member.add_to(where.setup, point(member))
        assert before == where.setup
