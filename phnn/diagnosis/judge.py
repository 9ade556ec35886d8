"""The verdict: named, equivalent, unknown or none, and the same question about the remainder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from phnn.criteria import SELECTION, Criteria
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.locations import GROUPS, Location
from phnn.diagnosis.compose import Material, compose
from phnn.diagnosis.exchange import exchanged
from phnn.diagnosis.finding import Finding, effects_of, own_parameters
from phnn.diagnosis.learn import learn
from phnn.diagnosis.name import Naming
from phnn.diagnosis.place import in_another_form, located
from phnn.diagnosis.rules import Applied, Record
from phnn.diagnosis.rules.composition import COPIES, ClaimCase, CopiesCase, has_name
from phnn.diagnosis.rules.search import BASE, BaseCase
from phnn.diagnosis.rules.verdict import VERDICT, VerdictCase
from phnn.diagnosis.scored import Scored, excess
from phnn.diagnosis.search import Search
from phnn.diagnosis.select import Selected, exact, misplaced, select, share_of
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect
from phnn.identification.fit import Fit
from phnn.rescue import extra, move, needed


@dataclass(frozen=True)
class Immaterial:
    """Something significant that is too small to matter.

    Attributes:
        candidate: the effect that explains it best, None where only a generic function does.
        rms: what it explains, root mean square, in the output's unit; share_of_noise: the same over the noise.
    """

    candidate: str | None
    rms: float
    share_of_noise: float


@dataclass(frozen=True)
class Judgement:
    """Attributes:
    verdict: ``named``, ``equivalent``, ``unknown`` or ``none``.
    linearised, naming, location: of the base model; location is None for ``none``, and where the search failed before.
    findings: elements added, in order; empty for ``none``. Of an ``unknown`` all of them are provisional.
    tried: refits of a first effect, also where none was accepted.
    final: the best model that these recordings support, whatever the verdict; the base fit for ``none``.
    remainder: scores on the final model's residual; None for ``none``.
    remainder_location: where what remains seems to be.
    immaterial: for ``none``: what is significant all the same.
    remainder_immaterial: what of the remainder is significant, and too small to matter.
    rules: all that were asked, in order.
    """

    verdict: str
    linearised: LinearisedFit
    naming: Naming
    location: Location | None
    final: Fit
    final_linearised: LinearisedFit
    findings: tuple[Finding, ...] = ()
    tried: tuple[Trial, ...] = ()
    remainder: Naming | None = None
    remainder_location: Location | None = None
    immaterial: Immaterial | None = None
    remainder_immaterial: Immaterial | None = None
    rules: tuple[Applied, ...] = ()

    @property
    def claimed(self) -> tuple[Finding, ...]:
        """The elements whose names are claimed."""
        return tuple(f for f in self.findings if not f.provisional)

    @property
    def places(self) -> tuple[str, ...]:
        """Where the mismatch is, the likeliest place first; empty for ``none``.

        Of a name that is claimed, or a formula that describes the mismatch, it is the element's: a refit knows better
        than local functions did before. So it is of an element without either that explains well, and of elements at
        one place that together explain most. Several elements at different places are no tie.
        """
        if self.location is None:
            return ()
        if self.claimed:
            return tuple(dict.fromkeys(t.candidate.effect.location for t in self.claimed[0].alike))
        able = [f for f in self.findings if f.described is not None or (f.share or 0.0) > SELECTION.explains_well]
        most = max(able, key=lambda f: f.gained.rms if f.gained is not None else 0.0, default=None)
        if most is not None:
            return (most.effect.location,)
        where = {f.effect.location for f in self.findings}
        if len(where) == 1 and self._explained > SELECTION.explains_further:
            return tuple(where)
        return (self.location.name, *self.location.tied)

    @property
    def detail(self) -> str:
        """Kind of what is missing at the first of the places; empty for ``none``."""
        if self.location is None:
            return ""
        first = self.places[0]
        if first == self.location.name:
            return self.location.detail
        acting = (e for f in (*self.claimed, *self.findings) for e in (f.named_as, f.effect))
        return next(e.kind.name for e in acting if e.location == first)

    @property
    def _explained(self) -> float:
        """Share of the base model's excess over the noise that the final model takes."""
        return 1.0 - excess(self.final) / max(excess(self.linearised.fit), 1e-300)


def judge(found: Scored, search: Search) -> Judgement:
    """Locate, name, compose and judge.

    A search for effects comes first; where it explains everything, its words stand. Where something is left, the model
    is composed further, of effects and learned elements. Elements of that model have names only by the rules of
    `phnn.diagnosis.rules.composition.CLAIM`.

    Args:
        found: the scores of the base model.
        search: what there is to add to it, and how that is chosen.
    """
    linearised, naming, record = found.linearised, found.naming, Record()
    record.decide(BASE, BaseCase(naming.p_value, search.criteria.selection))
    location = needed("location of the mismatch", lambda: found.remaining, None, ends=True)
    if location is None:
        word = "unknown" if found.significant else "none"
        return Judgement(word, linearised, naming, None, linearised.fit, linearised, rules=tuple(record.asked))
    nothing: tuple[Selected, tuple[Trial, ...]] = Selected((), found, 1.0), ()
    selected, tried = move("search for effects", partial(select, found, search), nothing)
    record.asked.extend(selected.rules)
    asked = _Asked(found, location, search)
    word, also = needed("verdict", lambda: _word(asked, selected, record), ("unknown", location.name))
    word, model, findings = _composed(asked, selected, tried, word, record)
    return Judgement(
        word, linearised, naming, _also(location, also), model.linearised.fit, model.linearised, findings, tried,
        model.naming, model.remaining, rules=tuple(record.asked),
    )  # fmt: skip


@dataclass(frozen=True)
class _Asked:
    """What a verdict is asked of: scores and location of the base model, and how it was searched."""

    found: Scored
    location: Location
    search: Search


def _word(asked: _Asked, selected: Selected, record: Record, beside: Sequence[Finding] = ()) -> tuple[str, str]:
    """The verdict on a selection, and a location that comes into question beside that of the whole mismatch.

    Args:
        beside: all elements of the model, those without a name among them.
    """
    linearised, location, criteria = asked.found.linearised, asked.location, asked.search.criteria
    rule = criteria.selection
    here = selected.model
    final, left = here.linearised.fit, here.remaining
    share = share_of(linearised.fit, final, asked.found.naming)
    alone = None
    if location.name == "mechanical" and left is not None and share < rule.explains_well:
        kind = GROUPS[location.group].kind
        alone = extra("a learned element at the location", lambda: learn(linearised, kind), None)
    case = VerdictCase(
        effects=len(selected.findings),
        members=max((len(f.alike) for f in selected.findings), default=0),
        share=share,
        chi2=final.chi2,
        misplaced=bool(selected.findings) and misplaced(selected, location, criteria),
        excess=excess(final),
        learned=excess(alone) if alone is not None else None,
        new_in_held_out=asked.search.new_in_held_out,
        rule=rule,
        another_form=any(in_another_form(f, beside) for f in selected.findings),
    )
    decided = record.decide(VERDICT, case)
    assert decided is not None
    further = case.misplaced and share > rule.explains_further and left is not None
    if decided.outcome == "unknown" and further and left is not None and located(left, criteria.location):
        return decided.outcome, left.name
    return decided.outcome, location.name


def _composed(
    asked: _Asked, selected: Selected, tried: tuple[Trial, ...], word: str, record: Record
) -> tuple[str, Scored, tuple[Finding, ...]]:
    """Verdict, model and elements after composing, where the search has left something."""
    named = selected.findings if word != "unknown" else ()
    composed = partial(_after_composing, asked, selected, tried, word, named, record)
    word, model, findings, named = move("composition", composed, (word, selected.model, selected.findings, named))
    names = effects_of(_of_their_own(named, record))
    word = "equivalent" if word == "named" and len(names) < len(named) else word
    kept = tuple(replace(f, provisional=f.effect not in names) for f in findings)
    return word, model, kept


def _after_composing(
    asked: _Asked,
    selected: Selected,
    tried: tuple[Trial, ...],
    word: str,
    named: tuple[Finding, ...],
    record: Record,
) -> tuple[str, Scored, tuple[Finding, ...], tuple[Finding, ...]]:
    """Verdict, model and elements after composing, and the elements whose names are claimed."""
    base = asked.found.linearised
    # Grown on some of the recordings, a model has to predict the others too.
    material = Material(base.fit, replace(asked.search, reach=base.scales))
    findings, fitted = compose(material, selected, tried, record)
    model = selected.model
    if fitted is not model.linearised.fit:
        fitted = exact(fitted, own_parameters(findings), asked.search.criteria.selection)
        model = asked.search.scored(fitted)
        if word == "unknown":
            findings = tuple(replace(f, first=None) for f in findings)
        word, named = "unknown", ()
        # Whatever had a name before has to claim it anew beside what was added.
        if places := _claimed(findings, model, asked.search.criteria, record):
            exchange = partial(_exchanged, asked, findings, model, places, record)
            # A name that was not held against its neighbours is not claimed.
            lost: tuple[tuple[Finding, ...], Scored, list[int]] = findings, model, []
            findings, model, places = move("neighbours of the elements", exchange, lost)
            claimed = tuple(findings[place] for place in places)
            share = share_of(base.fit, model.linearised.fit, asked.found.naming)
            word, _ = _word(asked, Selected(claimed, model, share), record, findings)
            named = claimed if word != "unknown" else ()
    return word, model, findings, named


def _exchanged(
    asked: _Asked, findings: tuple[Finding, ...], model: Scored, places: list[int], record: Record
) -> tuple[tuple[Finding, ...], Scored, list[int]]:
    """Elements, model and places of names after the names were held against their neighbours."""
    search, before = asked.search, model.linearised.fit
    findings, fitted = exchanged(asked.found.linearised.fit, findings, model, search, record, places)
    if fitted is before:
        return findings, model, places
    # The new element asks for other sub-steps, and its name is claimed beside the same others as the old one's was.
    model = search.scored(exact(fitted, own_parameters(findings), search.criteria.selection))
    claimed = _claimed(findings, model, search.criteria, record)
    return findings, model, [place for place in places if place in claimed]


def _of_their_own(named: Sequence[Finding], record: Record) -> list[Finding]:
    """Elements that are not part of a neighbour's other form."""
    kept = []
    for finding in named:
        beside = Counter(f.effect.title for f in named if f.effect.is_neighbour_of(finding.effect))
        case = CopiesCase(max(beside.values(), default=0))
        if not beside or record.decide(COPIES, case, finding.effect.name) is None:
            kept.append(finding)
    return kept


def _claimed(findings: Sequence[Finding], model: Scored, criteria: Criteria, record: Record) -> list[int]:
    """Places of the elements of a composed model beside which what has no name is small, the weakest asked first.

    What an element takes that has no name has none either, unless it is more of the same. A remainder beyond any doubt
    about the noise counts even where it may be chance.
    """
    chi2 = model.linearised.fit.chi2
    counts = model.significant or chi2 > criteria.composition.composed_beyond**2
    nameless = criteria.selection.beyond_doubt(chi2) if counts else 0.0
    weakest_first = sorted(findings, key=lambda f: (not f.nameless, f.takes))
    claimed: list[Finding] = []
    unclaimed: list[tuple[Effect, float]] = []
    for finding in weakest_first:
        effect, taken = finding.effect, finding.takes
        others = sum(took for other, took in unclaimed if not other.is_more_of(effect))
        case = ClaimCase(finding.nameless, taken, nameless + others, criteria, finding.first)
        if has_name(case, effect.name, record):
            claimed.append(finding)
        else:
            unclaimed.append((effect, taken))
    return [place for place, f in enumerate(findings) if f in claimed]


def _also(location: Location, name: str) -> Location:
    """The location with a further one beside it."""
    return location if name == location.name else replace(location, tied=tuple(dict.fromkeys((*location.tied, name))))


def unexplained(linearised: LinearisedFit, naming: Naming, location: Location, tried: tuple[Trial, ...]) -> Judgement:
    """Real, and nothing to add to the base model."""
    return Judgement("unknown", linearised, naming, location, linearised.fit, linearised, (), tried, naming, location)


def immaterial(judgement: Judgement, found: Immaterial) -> Judgement:
    """Nothing worth telling is missing: the base model stands, and what is significant is told with its size."""
    linearised = judgement.linearised
    return Judgement(
        "none", linearised, judgement.naming, None, linearised.fit, linearised, tried=judgement.tried, immaterial=found
    )  # fmt: skip
