"""The procedure of composing, on models of which only their errors are known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest

from phnn.criteria import CRITERIA
from phnn.diagnosis import compose as composing
from phnn.diagnosis import nearest_law
from phnn.diagnosis.compose import Material, _chosen, _Grown, _still_needed
from phnn.diagnosis.finding import Finding, without_element
from phnn.diagnosis.judge import _claimed
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.rules import Record
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect, effect
from phnn.effects.learned import learned_elements
from phnn.errors import PhnnError
from phnn.identification import order
from phnn.identification.gain import Gain

NAMED = {"A": effect("creep"), "B": effect("amplifier_lowpass")}
LEARNED = {"L": learned_elements()["learned_amplifier"], "M": learned_elements()["learned_ratio_of_displacement"]}
ELEMENTS = NAMED | LEARNED
LETTER = {e.name: n for n, e in ELEMENTS.items()}
MATERIAL = Material(mock.Mock(), Search(list(NAMED.values())))


def a_gain(before: float, after: float, p: float | None = 1e-6) -> Gain:
    change = before**2 - after**2
    size = math.copysign(math.sqrt(abs(change)), change)
    return Gain(before, after, 1e-8 * size, size, 40 if p is not None else 3, p, None if p is None else 1.0 - p)


def a_finding(element: Effect, gained: Gain | None = None) -> Finding:
    trial = Trial(Candidate(element, {}, (), 10.0, 1e-3), None)
    return Finding(trial, (trial,), (trial,), mock.Mock(), gained=gained, learned=element.name.startswith("learned"))


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

    def grown(self, model: str) -> Any:
        return _Grown(tuple(a_finding(ELEMENTS[n]) for n in model), self.fit(model), model, self.left[model], MATERIAL)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("left", "p_values", "chosen"),
    [
        ({"": 5.0, "A": 3.0, "B": 2.0}, {}, "B"),  # predicts best
        ({"": 5.0, "A": 3.0, "B": 3.05}, {("", "A"): 0.06}, "B"),  # the best may be chance
        ({"": 5.0, "M": 1.0, "A": 1.004}, {}, "A"),  # an effect predicts as well as a learned element
        ({"": 5.0, "M": 1.0, "A": 1.2}, {}, "M"),
        ({"": 5.0, "L": 1.0, "M": 1.004}, {}, "M"),  # as well with fewer strengths
        ({"": 1.02, "A": 0.99}, {("", "A"): None}, None),  # at the noise
        ({"": 0.95, "A": 0.90}, {("", "A"): 0.04}, None),
    ],
)
def test_the_element_that_is_added(left: dict[str, float], p_values: dict[Any, Any], chosen: str | None) -> None:
    world = World(left, p_values)
    able = [Trial(Candidate(ELEMENTS[m], {}, (), 1.0, 1e-3), world.fit(m)) for m in left if m]
    found = _chosen(MATERIAL, world, world.grown(""), sorted(able, key=lambda t: t.cost), Record())  # type: ignore[arg-type]
    assert (None if found is None else found[1].model) == chosen  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("left", "p_values", "still"),
    [
        ({"": 5.0, "A": 3.0, "B": 4.6, "AB": 2.0}, {("B", "AB"): 0.06}, "AB"),  # the error rises without it
        ({"": 5.0, "A": 3.0, "B": 2.0, "AB": 2.0}, {}, "B"),  # nothing is lost without it
        ({"": 2.0, "A": 3.0, "B": 2.0, "AB": 2.0}, {}, ""),  # B was needed for A alone
        ({"": 5.0, "A": 2.0, "B": 3.0, "AB": 2.0}, {}, "AB"),  # the last one has just been asked
    ],
)
def test_an_element_stays_where_the_others_need_it(left: dict[str, float], p_values: Any, still: str) -> None:
    world = World(left, p_values)

    def fit_with(base: Any, findings: tuple[Finding, ...], values: Any) -> Any:
        return world.fit("".join(sorted(LETTER[f.effect.name] for f in findings)))

    with mock.patch.object(composing, "fit_with", fit_with):
        found = _still_needed(MATERIAL, world, world.fit(""), world.grown("AB"), 1, Record())  # type: ignore[arg-type]
    assert found.fit.model == still  # type: ignore[attr-defined]


CREEP, SPRING = NAMED["A"], learned_elements()["learned_spring"]
RELAXES, DAMPS = (a_finding(learned_elements()[f"learned_{n}"], a_gain(3.0, 1.0)) for n in ("relaxation", "damper"))
LAW = Trial(Candidate(effect("cubic_stiffness"), {}, (), 10.0, 1e-3), None)


@pytest.mark.parametrize(
    ("findings", "chi2", "names"),
    [
        ([a_finding(CREEP, a_gain(7.0, 1.0))], 1.0, ["creep"]),
        ([a_finding(CREEP, a_gain(7.0, 6.0))], 36.0, []),  # a remainder beyond any doubt about the noise
        ([a_finding(CREEP)], 1.0, []),  # never asked for
        ([a_finding(CREEP, a_gain(5.0, 2.0)), RELAXES], 1.0, ["creep"]),  # more of the same
        ([a_finding(CREEP, a_gain(5.0, 2.0)), RELAXES, DAMPS], 1.0, []),
        ([replace(a_finding(CREEP, a_gain(7.0, 1.0)), first=0.93), DAMPS], 1.0, ["creep"]),  # nearly all before
        ([a_finding(SPRING, a_gain(7.0, 1.0))], 1.0, []),
        ([replace(a_finding(SPRING, a_gain(7.0, 1.0)), laws=(LAW,))], 1.0, ["cubic_stiffness"]),  # near to a law
    ],
)
def test_a_name_in_a_composed_model(findings: list[Finding], chi2: float, names: list[str]) -> None:
    for significant in (False, chi2 > 1.0):
        model: Any = SimpleNamespace(
            significant=significant, linearised=SimpleNamespace(fit=SimpleNamespace(chi2=chi2))
        )
        claimed = _claimed(tuple(findings), model, CRITERIA, Record())
        assert [findings[place].named_as.name for place in claimed] == names


LAWS = ("cubic_stiffness", "contact_stop", "coulomb_friction", "sensor_lag")
MEMORIES = ("creep", "contact_stop")


@pytest.mark.parametrize(
    ("element", "left", "tied", "laws"),
    [
        ("spring", {"cubic_stiffness": 2.0, "contact_stop": 1.5}, (), ["contact_stop", "cubic_stiffness"]),
        ("spring", {"cubic_stiffness": 4.0, "contact_stop": 8.0}, (), []),  # the spring takes clearly more
        ("spring", {"cubic_stiffness": 2.0, "contact_stop": 8.0, "sensor_lag": 1.5}, (), ["cubic_stiffness"]),
        (
            "spring", {"cubic_stiffness": 2.0, "contact_stop": 8.0, "sensor_lag": 1.5}, ("sensor_lag",),
            ["sensor_lag", "cubic_stiffness"],
        ),
        ("spring", {"cubic_stiffness": 8.0, "contact_stop": 8.0, "sensor_lag": 1.5}, ("sensor_lag",), []),
        ("relaxation", {"creep": 9.0, "contact_stop": 9.0}, (), ["creep"]),  # a sum of creeps, one of them weak
        ("relaxation", {"creep": 9.0, "contact_stop": 9.0, "S": 11.0}, (), []),
    ],
)  # fmt: skip
def test_effects_that_can_replace_a_learned_element(
    element: str, left: dict[str, float], tied: tuple[str, ...], laws: list[str]
) -> None:
    """The learned element ``S`` of a model, with what each effect leaves in its place."""
    world: Any = World({"": 10.0, "S": 1.0} | left)

    def scored(search: Search, fitted: Any, effects: Any) -> Any:
        return SimpleNamespace(naming=SimpleNamespace(candidates=[Candidate(e, {}, (), 1.0, 1e-3) for e in effects]))

    def refit(fitted: Any, candidates: Any, *others: Any, **criteria: Any) -> list[Trial]:
        return [Trial(c, world.fit(c.effect.name)) for c in candidates]

    members = tuple(Trial(Candidate(effect(n), {}, (), 1.0, 1e-3), None) for n in tied)
    gained = a_gain(world.left[""], world.left["S"])
    finding = replace(a_finding(learned_elements()[f"learned_{element}"], gained), members=members)
    search = Search(tuple(effect(n) for n in (LAWS if element == "spring" else MEMORIES)))
    with mock.patch.object(Search, "scores_of", scored), mock.patch.object(nearest_law, "refit", refit):
        (found,) = nearest_law.with_nearest_laws(world, world.fit(""), (finding,), world.fit("S"), search, Record())
    assert [t.candidate.effect.name for t in found.laws] == laws
    assert found.nameless is not bool(laws)


def test_what_the_effects_of_a_search_took_says_nothing_once_one_of_them_has_gone() -> None:
    one, other = (replace(a_finding(NAMED[n]), first=0.97) for n in "AB")
    added = a_finding(LEARNED["L"])
    assert [f.first for f in without_element((one, other, added), one)] == [None, None]
    assert [f.first for f in without_element((one, other, added), added)] == [0.97, 0.97]


@pytest.mark.parametrize(
    ("left", "falls", "known", "chosen"),
    [
        ({1: 9.0, 2: 5.0, 3: 2.0, 4: 1.99}, 1e-6, (), 3),  # as long as the error falls
        ({1: 2.0, 2: 1.99, 3: 1.0, 4: 1.0}, 1e-6, (), 1),
        ({1: 6.0, 2: 2.0, 3: 1.5, 4: 1.4}, None, (), order.DEFAULT_HYSTERONS),  # no test is possible
        ({1: 2.0, 2: 6.0, 3: 6.0, 4: 6.0}, None, (), 1),
        ({}, 1e-6, ("rho_3",), 3),  # an anchor asks for it
    ],
)
def test_the_number_of_hysterons(
    left: dict[int, float], falls: float | None, known: tuple[str, ...], chosen: int
) -> None:
    def gain(fewer: tuple[int, int], more: tuple[int, int]) -> Gain:
        return a_gain(left[fewer[0]], left[more[0]], falls)

    def identify(plan: Any, anchors: Any, count: int, starts: int, seed: int) -> int:
        if not left:
            raise PhnnError("cannot be simulated")
        return count

    held = SimpleNamespace(growth=None, scores=lambda f: f, over_noise=lambda f: left[f], gain=gain)
    with mock.patch.multiple(order, leave_out=lambda p, n: held, identify_actuator=identify):
        anchors = dict.fromkeys(known, mock.Mock())
        assert order.hysterons_needed(mock.Mock(), anchors, 1, 0, lambda m: None) == chosen
