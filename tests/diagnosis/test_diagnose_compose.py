"""The procedure of composing, on models of which only their errors are known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any
from unittest import mock

import campaigns
import pytest

from phnn.criteria import CRITERIA
from phnn.diagnosis import compose as composing
from phnn.diagnosis import judge as judging
from phnn.diagnosis import nearest_law
from phnn.diagnosis.compose import Material, _chosen, _Grown, _still_needed
from phnn.diagnosis.finding import Finding, without_element
from phnn.diagnosis.judge import _Asked, _claimed, _composed, _of_their_own
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.composition import LeavesCase
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect, effect
from phnn.effects.learned import learned_elements
from phnn.effects.places.attached import attached
from phnn.errors import PhnnError
from phnn.identification import order
from phnn.identification.gain import Gain

NAMED = {"A": effect("creep"), "B": effect("amplifier_lowpass"), "C": effect("sensor_lag")}
LEARNED = {"L": learned_elements()["learned_amplifier"], "M": learned_elements()["learned_ratio_of_displacement"]}
ELEMENTS = NAMED | LEARNED
LETTER = {e.name: n for n, e in ELEMENTS.items()}


def a_gain(before: float, after: float, p: float | None = 1e-6) -> Gain:
    change = before**2 - after**2
    size = math.copysign(math.sqrt(abs(change)), change)
    return Gain(before, after, 1e-8 * size, size, 40 if p is not None else 3, p, None if p is None else 1.0 - p)


@dataclass(frozen=True)
class World:
    """What every model leaves on the recordings that choose, and the p-values of comparisons; others are sure."""

    left: dict[str, float]
    p_values: dict[tuple[str, str], float | None] = field(default_factory=dict)

    def fit(self, model: str) -> Any:
        setup = SimpleNamespace(values=dict, own=0)
        return SimpleNamespace(model=model, chi2=self.left[model] ** 2, cost=1e4 * self.left[model] ** 2, setup=setup)

    def scores(self, fitted: Any) -> str:
        return str(fitted.model)

    def over_noise(self, scores: str) -> float:
        return self.left[scores]

    def gain(self, before: tuple[Any, str], after: tuple[Any, str]) -> Gain:
        one, other = before[0].model, after[0].model
        falls = self.left[other] < self.left[one]
        return a_gain(self.left[one], self.left[other], self.p_values.get((one, other), 1e-4 if falls else 0.9))

    def trials(self, *models: str) -> list[Trial]:
        return [Trial(Candidate(ELEMENTS[m[-1]], {}, (), 1.0, 1e-3), self.fit(m)) for m in models]

    def grown(self, model: str) -> Any:
        return _Grown(tuple(a_finding(ELEMENTS[n]) for n in model), self.fit(model), model, self.left[model], MATERIAL)  # type: ignore[arg-type]

    def chosen(self, here: str, *models: str) -> str | None:
        able = sorted(self.trials(*models), key=lambda t: t.cost)
        found = _chosen(MATERIAL, self, self.grown(here), able, Record())  # type: ignore[arg-type]
        return None if found is None else str(found[1].model)  # type: ignore[attr-defined]

    def still(self, model: str, asked: int) -> str:
        def fit_with(base: Any, findings: tuple[Finding, ...], values: Any) -> Any:
            return self.fit("".join(sorted(LETTER[f.effect.name] for f in findings)))

        with mock.patch.object(composing, "fit_with", fit_with):
            here = _still_needed(MATERIAL, self, self.fit(""), self.grown(model), asked, Record())  # type: ignore[arg-type]
        return str(here.fit.model)  # type: ignore[attr-defined]


MATERIAL = Material(mock.Mock(), Search(list(NAMED.values())))


def a_finding(element: Effect, gained: Gain | None = None) -> Finding:
    trial = Trial(Candidate(element, {}, (), 10.0, 1e-3), None)
    return Finding(trial, (trial,), (trial,), mock.Mock(), gained=gained, learned=element.name.startswith("learned"))


class TestTheElementThatIsAdded:
    def test_is_the_one_that_predicts_best(self) -> None:
        assert World({"": 5.0, "A": 3.0, "B": 2.0}).chosen("", "A", "B") == "B"

    def test_is_the_next_one_where_the_best_may_be_chance(self) -> None:
        assert World({"": 5.0, "A": 3.0, "B": 3.05}, {("", "A"): 0.06}).chosen("", "A", "B") == "B"

    def test_is_no_learned_one_where_an_effect_predicts_as_well(self) -> None:
        assert World({"": 5.0, "M": 1.0, "A": 1.004}).chosen("", "M", "A") == "A"
        assert World({"": 5.0, "M": 1.0, "A": 1.2}).chosen("", "M", "A") == "M"

    def test_has_few_strengths_where_others_predict_as_well(self) -> None:
        assert World({"": 5.0, "L": 1.0, "M": 1.004}).chosen("", "L", "M") == "M"

    @pytest.mark.parametrize("p", [None, 0.04])
    def test_is_none_where_the_error_is_at_the_noise(self, p: float | None) -> None:
        assert World({"": 1.02, "A": 0.99}, {("", "A"): p}).chosen("", "A") is None
        assert World({"": 0.95, "A": 0.90}, {("", "A"): p}).chosen("", "A") is None


class TestAnElementThatWasAdded:
    def test_stays_where_the_error_rises_without_it(self) -> None:
        world = World({"": 5.0, "A": 3.0, "B": 4.6, "AB": 2.0}, {("B", "AB"): 0.06})
        assert world.still("AB", 1) == "AB"

    def test_goes_where_nothing_is_lost(self) -> None:
        assert World({"": 5.0, "A": 3.0, "B": 2.0, "AB": 2.0}).still("AB", 1) == "B"

    def test_goes_itself_where_another_one_that_has_gone_was_needed_for_it(self) -> None:
        assert World({"": 2.0, "A": 3.0, "B": 2.0, "AB": 2.0}).still("AB", 1) == ""

    def test_is_not_asked_beyond_the_first_ones(self) -> None:
        assert World({"": 5.0, "A": 2.0, "B": 3.0, "AB": 2.0}).still("AB", 1) == "AB"


def a_model(chi2: float, significant: bool) -> Any:
    return SimpleNamespace(significant=significant, linearised=SimpleNamespace(fit=SimpleNamespace(chi2=chi2)))


class TestANameInAComposedModel:
    def names(self, model: Any, *findings: Finding) -> list[str]:
        return [findings[place].effect.name for place in _claimed(findings, model, CRITERIA, Record())]

    def test_stands_beside_a_small_remainder(self) -> None:
        assert self.names(a_model(1.0, False), a_finding(NAMED["A"], a_gain(7.0, 1.0))) == ["creep"]

    def test_falls_beside_a_remainder_beyond_any_doubt_about_the_noise(self) -> None:
        for significant in (False, True):
            assert self.names(a_model(36.0, significant), a_finding(NAMED["A"], a_gain(7.0, 6.0))) == []

    def test_falls_where_it_was_never_asked_for(self) -> None:
        assert self.names(a_model(1.0, False), a_finding(NAMED["A"])) == []

    def test_stands_beside_more_of_the_same(self) -> None:
        creep = a_finding(NAMED["A"], a_gain(5.0, 2.0))
        more, other = (
            a_finding(learned_elements()[n], a_gain(3.0, 1.0)) for n in ("learned_relaxation", "learned_damper")
        )
        assert self.names(a_model(1.0, False), creep, more) == ["creep"]
        assert self.names(a_model(1.0, False), creep, more, other) == []

    def test_that_a_search_gave_is_claimed_anew_beside_what_was_added(self) -> None:
        before, added = a_finding(NAMED["A"], a_gain(10.0, 7.0)), a_finding(LEARNED["L"], a_gain(7.0, 1.0))
        whole = SimpleNamespace(chi2=1.0)
        model = SimpleNamespace(significant=False, linearised=SimpleNamespace(fit=whole))
        asked = _Asked(mock.Mock(), mock.Mock(), Search((), new_in_held_out=True))
        searched = mock.Mock(findings=(before,))
        with (
            mock.patch.object(judging, "compose", lambda *a: ((before, added), whole)),
            mock.patch.object(judging, "exact", lambda fitted, *_: fitted),
            mock.patch.object(Search, "scored", lambda *a: model),
        ):
            word, _, findings = _composed(asked, searched, (), "named", Record())
        assert word == "unknown"
        assert all(f.provisional for f in findings)

    def test_that_is_exchanged_is_claimed_anew_in_the_new_model(self) -> None:
        before, added = a_finding(NAMED["A"], a_gain(10.0, 2.0)), a_finding(NAMED["B"], a_gain(7.0, 1.0))
        other, fits = a_finding(NAMED["C"], a_gain(7.0, 1.0)), [SimpleNamespace(chi2=1.0), SimpleNamespace(chi2=1.0)]
        models = [SimpleNamespace(significant=False, linearised=SimpleNamespace(fit=f)) for f in fits]
        asked = _Asked(mock.Mock(), mock.Mock(), Search((), new_in_held_out=True))
        with (
            mock.patch.object(judging, "compose", lambda *a: ((before, added), fits[0])),
            mock.patch.object(judging, "exact", lambda fitted, *_: fitted),
            mock.patch.object(judging, "exchanged", lambda *a: ((before, other), fits[1])),
            mock.patch.object(judging, "share_of", lambda *a: 0.99),
            mock.patch.object(judging, "_word", lambda *a: ("named", "")),
            mock.patch.object(Search, "scored", lambda search, fitted: models[fits.index(fitted)]),
        ):
            word, model, findings = _composed(asked, mock.Mock(findings=()), (), "unknown", Record())
            assert (word, model.linearised.fit) == ("named", fits[1])
            assert [(f.effect.name, f.provisional) for f in findings] == [("creep", False), ("sensor_lag", False)]
            # What the new model leaves counts against all names.
            models[1].significant, fits[1].chi2 = True, 9.0
            word, _, findings = _composed(asked, mock.Mock(findings=()), (), "unknown", Record())
            assert all(f.provisional for f in findings)

    def test_is_not_that_of_a_part_of_a_neighbours_other_form(self) -> None:
        creep, second, *_ = (a_finding(e) for e in attached(effect("creep"), campaigns.base().setup))
        hysteron, drag = (a_finding(effect(n)) for n in ("extra_hysteron", "quadratic_drag"))
        for findings, stay in (
            ((creep, second, hysteron, drag), [creep, second, drag]),
            ((creep, hysteron), [creep, hysteron]),
            ((creep, second, drag), [creep, second, drag]),
        ):
            assert _of_their_own(findings, Record()) == stay

    def test_stands_beside_what_was_added_where_the_search_took_nearly_all_before(self) -> None:
        before, added = a_finding(NAMED["A"], a_gain(7.0, 1.0)), a_finding(LEARNED["L"], a_gain(4.0, 1.0))
        assert self.names(a_model(1.0, False), before, added) == []
        assert self.names(a_model(1.0, False), replace(before, first=0.93), added) == ["creep"]
        assert self.names(a_model(1.0, False), replace(before, first=0.85), added) == []

    def test_is_that_of_the_law_that_a_learned_element_is_near_to(self) -> None:
        spring = a_finding(learned_elements()["learned_spring"], a_gain(7.0, 1.0))
        law = Trial(Candidate(effect("cubic_stiffness"), {}, (), 10.0, 1e-3), None)
        assert self.names(a_model(1.0, False), spring) == []
        near = replace(spring, laws=(law,))
        assert self.names(a_model(1.0, False), near) == ["learned_spring"]
        assert near.named_as.name == "cubic_stiffness"
        assert not near.nameless


class TestTheEffectsThatCanReplaceALearnedElement:
    SPRING = learned_elements()["learned_spring"]
    LAWS = tuple(effect(n) for n in ("cubic_stiffness", "contact_stop", "coulomb_friction", "sensor_lag"))

    def found(self, left: dict[str, float], *tied: str) -> Finding:
        """The learned spring ``S`` of a model, with what each effect leaves in its place."""
        world: Any = World(left)

        def scored(search: Search, fitted: Any, effects: Any) -> Any:
            candidates = tuple(Candidate(e, {}, (), 1.0, 1e-3) for e in effects)
            return SimpleNamespace(naming=SimpleNamespace(candidates=candidates))

        def refit(fitted: Any, candidates: Any, *others: Any, **criteria: Any) -> list[Trial]:
            return [Trial(c, world.fit(c.effect.name)) for c in candidates]

        members = tuple(Trial(Candidate(effect(n), {}, (), 1.0, 1e-3), None) for n in tied)
        spring = replace(a_finding(self.SPRING, a_gain(left[""], left["S"])), members=members)
        with mock.patch.object(Search, "scores_of", scored), mock.patch.object(nearest_law, "refit", refit):
            (found,) = nearest_law.with_nearest_laws(
                world,
                world.fit(""),
                (spring,),
                world.fit("S"),
                Search(self.LAWS),
                Record(),
            )
        return found

    def names(self, left: dict[str, float], *tied: str) -> list[str]:
        return [t.candidate.effect.name for t in self.found(left, *tied).laws]

    def test_take_nearly_all_that_it_takes_the_best_one_first(self) -> None:
        left = {"": 10.0, "S": 1.0, "cubic_stiffness": 2.0, "contact_stop": 1.5}
        assert self.names(left) == ["contact_stop", "cubic_stiffness"]

    def test_are_none_where_it_takes_clearly_more(self) -> None:
        found = self.found({"": 10.0, "S": 1.0, "cubic_stiffness": 4.0, "contact_stop": 8.0})
        assert found.laws == ()
        assert found.nameless

    def test_of_other_kinds_belong_to_the_class_where_they_explained_as_much(self) -> None:
        left = {"": 10.0, "S": 1.0, "cubic_stiffness": 2.0, "contact_stop": 8.0, "sensor_lag": 1.5}
        assert self.names(left) == ["cubic_stiffness"]
        assert self.names(left, "sensor_lag") == ["sensor_lag", "cubic_stiffness"]

    def test_are_none_where_only_other_kinds_can(self) -> None:
        left = {"": 10.0, "S": 1.0, "cubic_stiffness": 8.0, "contact_stop": 8.0, "sensor_lag": 1.5}
        assert self.names(left, "sensor_lag") == []

    def test_hold_the_law_of_which_it_is_a_sum_however_little_one_term_takes(self) -> None:
        left = {"": 10.0, "S": 1.0, "creep": 9.0, "contact_stop": 9.0}
        relaxing = learned_elements()["learned_relaxation"]
        with mock.patch.multiple(type(self), SPRING=relaxing, LAWS=tuple(effect(n) for n in ("creep", "contact_stop"))):
            assert self.names(left) == ["creep"]
            assert self.names({**left, "S": 11.0}) == []


def test_what_the_effects_of_a_search_took_says_nothing_once_one_of_them_has_gone() -> None:
    one, other = (replace(a_finding(NAMED[n]), first=0.97) for n in "AB")
    added = a_finding(LEARNED["L"])
    assert [f.first for f in without_element((one, other, added), one)] == [None, None]
    assert [f.first for f in without_element((one, other, added), added)] == [0.97, 0.97]


class TestTheNumberOfHysterons:
    def chosen(self, left: dict[int, float], falls: float | None, known: tuple[str, ...] = ()) -> int:
        def gain(fewer: tuple[int, int], more: tuple[int, int]) -> Gain:
            return a_gain(left[fewer[0]], left[more[0]], falls)

        held = SimpleNamespace(growth=None, scores=lambda f: f, over_noise=lambda f: left[f], gain=gain)

        def identify(plan: Any, anchors: Any, count: int, starts: int, seed: int) -> int:
            if not left:
                raise PhnnError("cannot be simulated")
            return count

        with mock.patch.multiple(order, leave_out=lambda p, n: held, identify_actuator=identify):
            return order.hysterons_needed(mock.Mock(), dict.fromkeys(known, mock.Mock()), 1, 0, lambda m: None)

    def test_grows_as_long_as_the_error_falls(self) -> None:
        assert self.chosen({1: 9.0, 2: 5.0, 3: 2.0, 4: 1.99}, 1e-6) == 3
        assert self.chosen({1: 2.0, 2: 1.99, 3: 1.0, 4: 1.0}, 1e-6) == 1

    def test_is_the_default_where_no_test_is_possible(self) -> None:
        assert self.chosen({1: 6.0, 2: 2.0, 3: 1.5, 4: 1.4}, None) == order.DEFAULT_HYSTERONS
        assert self.chosen({1: 2.0, 2: 6.0, 3: 6.0, 4: 6.0}, None) == 1

    def test_is_never_below_what_an_anchor_asks_for(self) -> None:
        assert self.chosen({}, 1e-6, ("rho_3",)) == 3


def test_a_composed_model_forgets_what_the_search_fitted_without_an_element() -> None:
    world = World({"": 5.0, "A": 3.0, "AC": 1.0})
    stale = replace(a_finding(NAMED["A"]), others_alone=world.fit("AC"))
    model = mock.Mock(linearised=mock.Mock(fit=SimpleNamespace(chi2=9.0, cost=2e5, plan=None)))
    searched: Any = SimpleNamespace(findings=(), longest=None, model=model)
    grown = _Grown((stale,), world.fit("A"), "A", 1.0, MATERIAL_ON_BASE)  # type: ignore[arg-type]
    patched: dict[str, Any] = {
        "leave_out": lambda *a: world, "_on": lambda *a: world.fit(""), "_grown": lambda *a: grown,
        "_still_needed": lambda *a: grown, "fit_with": lambda *a, **k: world.fit("A"),
    }  # fmt: skip
    with (
        mock.patch.multiple(composing, **patched),
        mock.patch.object(_Grown, "leaves", property(lambda s: LeavesCase(1.0, 1, lambda: 1.0, CRITERIA))),
    ):
        findings, _ = composing.compose(MATERIAL_ON_BASE, searched, (), Record())
    assert [f.effect.name for f in findings] == ["creep"]
    assert all(f.others_alone is None for f in findings)


@pytest.mark.parametrize(
    ("grown", "base", "ends", "asked"), [(1.0, 2.0, 1.0, 1), (6.0, 2.0, 2.0, 2), (None, 6.0, 6.0, 2)]
)
def test_a_composed_model_is_fitted_to_all_recordings_from_where_it_was_grown(
    grown: float | None, base: float, ends: float, asked: int
) -> None:
    """From the base model's states only where that ends above the model of the search."""
    world = World({"A": 1.0})
    here, costs = world.grown("A"), {True: grown, False: base}
    known: list[bool] = []

    def fit_with(_: object, __: object, ___: object, origin: Any = None) -> Any:
        known.append(origin is here.fit)
        cost = costs[known[-1]]
        return None if cost is None else SimpleNamespace(cost=cost)

    with mock.patch.object(composing, "fit_with", fit_with):
        found = composing._on_all(mock.Mock(), here, SimpleNamespace(cost=5.0))  # type: ignore[arg-type]
    assert found is not None and found.cost == ends
    assert known == [True, False][:asked]


MATERIAL_ON_BASE = Material(mock.Mock(), Search([]))
