"""Candidates for one more element of a composed model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phnn.criteria import Criteria
from phnn.diagnose.locations import Location
from phnn.diagnosis.name import Candidate
from phnn.diagnosis.place import of_its_kinds
from phnn.diagnosis.scored import Scored
from phnn.diagnosis.search import Search
from phnn.diagnosis.trial import Trial
from phnn.effects import Effect
from phnn.identification.fit import Fit


def begun_again(tried: Sequence[Trial], base: Fit, criteria: Criteria) -> list[Candidate]:
    """The best refits of an earlier search as candidates that begin where those ended."""
    known = [(t.candidate, t.fit.setup.values()) for t in tried if t.fit is not None and t.cost < base.cost]
    return [
        replace(c, values={n: v[n] for n in c.effect.parameters}, others=())
        for c, v in known[: criteria.composition.composed_refits]
    ]


def is_named(search: Search, candidate: Candidate) -> bool:
    """Whether a candidate belongs to the catalogue."""
    return any(candidate.effect is e for e in search.effects)


def further_candidates(search: Search, model: Scored, again: Sequence[Candidate]) -> list[Candidate]:
    """What may be added: effects begun again from earlier refits, those of the best scores, learned elements at the
    places that explain most; best score first.

    A score has one direction, and a learned element many: it is refitted however small its score is.

    Args:
        search: what there is to add.
        model: the model that is composed, with its scores.
        again: candidates that are begun again from where earlier refits ended.
    """
    rule, setup = search.criteria.composition, model.linearised.fit.setup
    ranked = [c for c in model.naming.candidates if c.effect.can_be_added_to(setup)]
    begun = [_at(c, ranked) for c in again]
    left = [c for c in ranked if all(c.effect is not b.effect for b in begun)]
    named = [c for c in left if is_named(search, c)]
    where = model.remaining
    learned = [c for c in left if not is_named(search, c)]
    learned.sort(key=lambda c: -_explains(where, c.effect))
    chosen = [*begun, *named[: max(rule.composed_refits - len(begun), 1)]]
    learned = learned[: rule.learned_refits]
    most = max((c.score for c in (*chosen, *learned)), default=0.0)
    chosen += [replace(c, score=most) for c in learned]
    return sorted(chosen, key=lambda c: -c.score)


def _at(begun: Candidate, ranked: Sequence[Candidate]) -> Candidate:
    """A candidate with its present score and the values at which it is begun again."""
    found = next((c for c in ranked if c.effect is begun.effect), None)
    return begun if found is None else replace(found, values=begun.values, others=(found.values,))


def _explains(where: Location | None, effect: Effect) -> float:
    """What functions at a learned element's place, of its kind where there are such, explain of what is left."""
    if where is None:
        return 0.0
    return max(of_its_kinds(where, effect), default=where.ranks.get(effect.location, 0.0))
