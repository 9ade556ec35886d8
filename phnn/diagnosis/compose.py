"""Compose the model that predicts left-out recordings best, before any of its elements is named.

The model is fitted to some of the identification recordings, and the others choose its elements
(`phnn.identification.left_out`). Candidates are effects of the catalogue and learned elements. Of the refits that fit
best, the one that predicts the left-out recordings best is added. Their error must fall by more than chance and by more
than the criteria demand of a further element. Then every element is tested again, and the model is refitted to all
identification recordings. No name is claimed here, and no held-out recording is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

from phnn.criteria import Criteria
from phnn.diagnosis.candidates import begun_again, further_candidates, is_named
from phnn.diagnosis.finding import Finding, effects_of, without_element
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.nearest_law import with_nearest_laws
from phnn.diagnosis.refit import refit
from phnn.diagnosis.retest import fit_with
from phnn.diagnosis.rules import Record
from phnn.diagnosis.rules.composition import GAIN, KEPT, LEAVES, WHOLE, GainCase, LeavesCase, WholeCase
from phnn.diagnosis.scored import Scored
from phnn.diagnosis.search import Search
from phnn.diagnosis.select import Selected
from phnn.diagnosis.trial import Trial, class_of
from phnn.identification.evaluate import Evaluation
from phnn.identification.fit import Fit
from phnn.identification.gain import Gain
from phnn.identification.left_out import LeftOut, leave_out
from phnn.identification.staged import fit_identified, stated_only
from phnn.rescue import attempt, move

# A refit, its fit and what that predicts.
_Shown = tuple[Trial, Fit, Evaluation]
# Rounds of adding an element, and of asking which are still needed, per element of the largest model.
_ROUNDS = 2


@dataclass(frozen=True)
class Material:
    """What a model may be composed of, and how.

    Attributes:
        base: the fit without any element, to all identification recordings.
        search: what there is to add to it, and how that is chosen.
    """

    base: Fit
    search: Search

    @property
    def criteria(self) -> Criteria:
        """Every threshold."""
        return self.search.criteria


@dataclass(frozen=True)
class _Grown:
    """A model fitted to the recordings it is grown on, what it predicts on all, and its residual over noise on those
    that choose."""

    findings: tuple[Finding, ...]
    fit: Fit
    scores: Evaluation
    left: float
    material: Material

    @cached_property
    def model(self) -> Scored:
        """With its scores, which take longest: only of a model that may be composed further."""
        return self.material.search.scored_with_learned(self.fit)

    @property
    def leaves(self) -> LeavesCase:
        """Few recordings may be fitted by much, so that those that choose have their say."""
        most = max(self.fit.chi2, self.left**2)
        return LeavesCase(most, len(self.findings), lambda: self.model.naming.p_value, self.material.criteria)

    @property
    def pair(self) -> tuple[Fit, Evaluation]:
        return self.fit, self.scores


def compose(
    material: Material, searched: Selected, tried: Sequence[Trial], record: Record
) -> tuple[tuple[Finding, ...], Fit]:
    """Add elements to a model as long as recordings that were left out are predicted better.

    Args:
        material: what there is to choose from.
        searched: what a search for effects has kept; it begins with those, too, that the search has withdrawn.
        tried: refits of a first element, which are begun again from where they ended.
        record: of the rules that are asked.

    Returns:
        The elements of the model, in order, and its fit to all identification recordings: those of ``searched`` where
        nothing is added.
    """
    criteria, kept, final = material.criteria, searched.findings, searched.model.linearised.fit
    asked = LeavesCase(final.chi2, len(kept), lambda: searched.model.naming.p_value, criteria)
    if record.decide(LEAVES, asked) is not None:
        return kept, final
    start = searched.longest or searched
    held = leave_out(final.plan, criteria.confirmation.held_out_blocks)
    base = attempt("fit of the base model to some recordings", partial(_on, held, material.base), None)
    if base is None:
        return kept, final
    begun = base if not start.findings else fit_with(base, start.findings, start.model.linearised.fit.setup.values())
    if begun is None:
        return kept, final
    here = _grown(material, held, start.findings, begun)
    if start is searched:
        here = replace(here, findings=_with_share(held, base, here))
    here = _still_needed(material, held, base, here, len(here.findings), record)
    again = [] if here.findings else begun_again(tried, material.base, criteria)
    for _ in range(_ROUNDS * criteria.composition.most_elements):
        part = f"element {len(here.findings) + 1} of the composed model"
        grown = move(part, partial(_grow, material, held, base, here, again, record), None)
        if grown is None:
            break
        here, again = grown, []
    if not here.findings or _same(here.findings, kept):
        return kept, final
    whole = move("fit of the composed model to all recordings", lambda: _on_all(material.base, here, final), None)
    if record.decide(WHOLE, WholeCase(None if whole is None else whole.cost, final.cost)) is not None or whole is None:
        return kept, final
    found = move(
        "effects that can replace learned elements",
        lambda: with_nearest_laws(held, base, here.findings, here.fit, material.search, record),
        here.findings,
    )
    # A fit of the search without an element may have elements that this model lacks.
    return tuple(replace(f, others_alone=None) for f in found), whole


def _on_all(base: Fit, here: _Grown, final: Fit) -> Fit | None:
    """The composed model fitted to all identification recordings, from the parameters and initial states that it has.

    If it ends above the model of the search it has met a local optimum, and is fitted from the base model's states.
    """
    values = here.fit.setup.values()
    found = fit_with(base, here.findings, values, origin=here.fit)
    if found is not None and found.cost < final.cost:
        return found
    again = fit_with(base, here.findings, values)
    return min((f for f in (found, again) if f is not None), key=lambda f: f.cost, default=None)


def _with_share(held: LeftOut, base: Fit, here: _Grown) -> tuple[Finding, ...]:
    """The elements of the search, with the share of the excess that all of them take before anything is added."""
    share = held.gain((base, held.scores(base)), here.pair).share
    return tuple(replace(f, first=share) for f in here.findings)


def _same(some: Sequence[Finding], others: Sequence[Finding]) -> bool:
    """Whether two models have the same effects."""
    return effects_of(some) == effects_of(others)


def _on(held: LeftOut, fitted: Fit) -> Fit:
    """A fit, made again on the recordings that models are grown on."""
    plan = replace(held.growth, substeps=fitted.plan.substeps)
    again = fit_identified(fitted.setup, plan, stated_only(fitted.held), origin=None)
    return replace(again, alternatives=fitted.alternatives)


def _grow(
    material: Material, held: LeftOut, base: Fit, here: _Grown, again: Sequence[Candidate], record: Record
) -> _Grown | None:
    """The model with one more element, and without those that it needs no more; None where nothing is to be added."""
    if record.decide(LEAVES, here.leaves) is not None:
        return None
    further = _further(material, held, here, again, record)
    return None if further is None else _still_needed(material, held, base, further, len(further.findings) - 1, record)


def _grown(material: Material, held: LeftOut, findings: tuple[Finding, ...], fitted: Fit) -> _Grown:
    scores = held.scores(fitted)
    if findings:
        material.search.visit(findings, fitted)
    return _Grown(findings, fitted, scores, held.over_noise(scores), material)


def _further(
    material: Material, held: LeftOut, here: _Grown, again: Sequence[Candidate], record: Record
) -> _Grown | None:
    """The model with the one more element that the left-out recordings choose; None where they ask for none."""
    criteria = material.criteria
    candidates = further_candidates(material.search, here.model, again)
    many = len(candidates)
    material.search.progress(
        f"{here.left:.3g} × noise on recordings that choose; refit {many} candidates for a further element"
    )
    trials = refit(here.fit, candidates, material.search.executor, criteria=criteria)
    able = [t for t in trials if t.fit is not None and t.fit.cost < here.fit.cost]
    found = _chosen(material, held, here, able[: criteria.composition.asked_of_selection], record)
    if found is None:
        return None
    best, fitted, gained = found
    ordered = [best, *(t for t in trials if t is not best)]
    alike = class_of(ordered, here.model.significant, criteria.selection)
    finding = Finding(
        best,
        (best, *(t for t in alike if t is not best and is_named(material.search, t.candidate))),
        tuple(ordered),
        here.model.naming,
        level=criteria.selection.level,
        gained=gained,
        learned=not is_named(material.search, best.candidate),
    )
    return _grown(material, held, (*here.findings, finding), fitted)


def _ordered(material: Material, held: LeftOut, here: _Grown, shown: Sequence[_Shown]) -> list[_Shown]:
    """Refits in the order in which the left-out recordings are asked for them."""
    rule = material.criteria.confirmation
    best = min(shown, key=lambda s: held.over_noise(s[2]), default=None)

    def rank(s: _Shown) -> tuple[bool, bool, bool, int, float]:
        assert best is not None
        between = held.gain((s[1], s[2]), (best[1], best[2]))
        worse = rule.falls(between.before, between.after, between.share_of_noise)
        candidate = s[0].candidate
        simple = () if worse else (not is_named(material.search, candidate), len(candidate.effect.all_strengths))
        learned, size = simple or (True, 0)
        return s[1].setup.own != here.fit.setup.own, worse, learned, size, held.over_noise(s[2])

    return sorted(shown, key=rank)


def _chosen(
    material: Material, held: LeftOut, here: _Grown, able: Sequence[Trial], record: Record
) -> tuple[Trial, Fit, Gain] | None:
    """The refit with which the left-out recordings are predicted best, as far as they ask for it.

    Among refits that predict equally well, effects of the catalogue come before learned elements, which fit noise
    more easily, and few parameters before many. If one does not improve predictions, the next may. Nuisances of a
    recording are fitted to the very samples that choose, so effects with nuisances come last.
    """
    shown = [(t, t.fit, held.scores(t.fit)) for t in able if t.fit is not None]
    for trial, fitted, scores in _ordered(material, held, here, shown):
        gained = held.gain(here.pair, (fitted, scores))
        decided = record.decide(GAIN, GainCase(gained, material.criteria), trial.candidate.effect.name)
        if decided is not None and decided.outcome == "add":
            return trial, fitted, gained
    return None


def _still_needed(material: Material, held: LeftOut, base: Fit, grown: _Grown, asked: int, record: Record) -> _Grown:
    """The model without those of its elements without which the left-out recordings are predicted as well.

    Where one goes, the others gain something else, and all are asked.

    Args:
        asked: how many of them are asked, from the first on.
    """
    place, end = 0, len(grown.findings) - asked
    while place < len(grown.findings) - end:
        finding = grown.findings[place]
        others = without_element(grown.findings, finding)
        alone = fit_with(base, others, grown.fit.setup.values()) if others else base
        if alone is None:
            place += 1
            continue
        gained = held.gain((alone, held.scores(alone)), grown.pair)
        decided = record.decide(KEPT, GainCase(gained, material.criteria), finding.effect.name)
        if decided is not None and decided.outcome == "keep":
            found = replace(finding, gained=gained)
            grown = replace(grown, findings=(*grown.findings[:place], found, *grown.findings[place + 1 :]))
            place += 1
            continue
        grown, place, end = _grown(material, held, others, alone), 0, 0
    return grown
