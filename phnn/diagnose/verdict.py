"""The verdict: the only place that turns probabilities into a word.

Two results are kept apart. The model that is written is the one that predicts best. The word says how much of its
physics is proven:

| word | when |
|---|---|
| ``none`` | no element: the base model is the most probable one, near the noise, and explains the output |
| ``named`` | every element is proven |
| ``equivalent`` | a few alternatives together are |
| ``unknown`` | otherwise: the model predicts better, and its physics is not proven |

An element is proven if the models that hold it have together a probability of `Criteria.proven`, the error of held-out
recordings falls with the model and does not rise with the element, and no learned element is part of the model. Models
are weighed among each other; that the catalogue may lack what acts is a probability of its own, which lowers all
others. Rules are asked in order; each reads the facts and nothing of the others, and the first that applies decides.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from phnn.criteria import Criteria
from phnn.diagnose.number import Key, Visited, Weighed, best_to_write, family, is_learned, key_of
from phnn.effects import Effect
from phnn.identification.fit import EXPLAINS

NAMED, EQUIVALENT, UNKNOWN, NONE = "named", "equivalent", "unknown", "none"
# Status of an element beside the words of a verdict.
LIKELY, LEARNED, PROVISIONAL = "likely", "learned", "provisional"
# Alternatives that are still a class.
CLASS = 4
# From this probability on an element is likely among what is listed, and the base model the most probable one.
_HALF = 0.5


@dataclass(frozen=True)
class Claim:
    """One effect in the model that is written, and its status.

    Attributes:
        effect: which; copies: the further ones of its family, as of a creep with several times.
        status: ``named``, ``equivalent``, ``likely``, ``learned`` or ``provisional``.
        probability: of all models that hold its family; of a learned element, that of models with it.
        alike: other effects of which one may stand in its place, the most probable first.
        without: the best model that was visited with all other elements; None where none was.
        share: of the excess over the noise without it, what it takes; None where nothing is in excess.
    """

    effect: Effect
    status: str
    probability: float
    alike: tuple[Effect, ...]
    without: Visited | None
    share: float | None
    copies: tuple[Effect, ...] = ()

    @property
    def elements(self) -> tuple[Effect, ...]:
        """Return the effect and its copies."""
        return (self.effect, *self.copies)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Their names of parameters."""
        return tuple(n for e in self.elements for n in e.parameters)

    @property
    def learned(self) -> bool:
        """Return whether it is a learned element, which has no name."""
        return is_learned(self.effect)

    @property
    def claimed(self) -> bool:
        """Return whether its name is given: alone, or as one of a class."""
        return self.status in (NAMED, EQUIVALENT)

    @property
    def name(self) -> str:
        """Return the name under which it counts."""
        return family(self.effect)


@dataclass(frozen=True)
class Facts:
    """What the rules of a verdict read.

    Attributes:
        elements: of the model that is written; learned: how many of them are learned.
        none: probability that nothing is missing.
        certain: probability of the least certain element of the most probable model.
        alternatives: how many sets of effects together have `Criteria.proven` of the weight; exchangeable: in these
            another effect stands in the place of each that is not proven.
        complete: probability that the catalogue holds all physics of the recordings; it bounds all others.
        base_left: mean square of the residual of the base model over that of the noise, on fitted recordings.
        explained: share of the squares of the fitted outputs that the base model takes; nearly none of an output that
            follows no input.
        falls: whether the held-out error falls with the model, and rises with none of its elements.
        new: whether held-out recordings bring an amplitude or a frequency that the others lack.
        promising: candidates that promised a material gain to the base model; remaining: that still promise one to the
            model that is written, and were not denied by held-out recordings.
        early: the search ended before it was done.
        criteria: all thresholds.
    """

    elements: int
    learned: int
    none: float
    certain: float
    alternatives: int
    exchangeable: bool
    complete: float
    base_left: float
    explained: float
    falls: bool
    new: bool
    promising: int
    remaining: int
    early: bool
    criteria: Criteria


@dataclass(frozen=True)
class Rule:
    """A rule of the verdict.

    Attributes:
        name: what it says when it applies; applies: whether it does; word: the verdict then.
        numbers: names of the facts that it reads.
        needed: the case that goes wrong without it.
    """

    name: str
    applies: Callable[[Facts], bool]
    word: str
    numbers: tuple[str, ...]
    needed: str


RULES: tuple[Rule, ...] = (
    Rule(
        "nothing_promises",
        lambda f: f.explained >= EXPLAINS and not f.promising and not f.early and f.base_left <= f.criteria.far**2,
        NONE, ("explained", "promising", "remaining", "base_left"),
        "process noise of a tenth of the drive raises the residual above the floor, and no candidate explains it",
    ),
    Rule(
        "the_base_model_is_enough",
        lambda f: f.explained >= EXPLAINS and f.none >= _HALF and f.base_left <= f.criteria.explained and not f.early,
        NONE, ("explained", "none", "base_left"),
        "a gain of a hundredth of the noise, which BIC would accept",
    ),
    Rule(
        "nothing_helps", lambda f: not f.elements, UNKNOWN, ("elements", "base_left"),
        "tanks with a valve that no element describes",
    ),
    Rule(
        "the_search_ended_early", lambda f: f.early, UNKNOWN, ("early",),
        "a pair of which one effect was tried when the time was up",
    ),
    Rule(
        "an_element_is_learned", lambda f: f.learned > 0, UNKNOWN, ("learned",),
        "a friction beside a hysteresis of eight plays",
    ),
    Rule(
        "something_is_left", lambda f: f.complete < f.criteria.proven, UNKNOWN, ("complete",),
        "a sensor nonlinearity and a creep, which are near to three others that act: 1.13 × the power of the noise",
    ),
    Rule(
        "held_out_recordings_deny_it", lambda f: not f.falls, UNKNOWN, ("falls",),
        "a drift that one long recording has by chance",
    ),
    Rule(
        "held_out_recordings_are_not_new", lambda f: f.certain >= f.criteria.proven and not f.new, EQUIVALENT, ("new",),
        "one recording cut in blocks: what fits one block fits the next",
    ),
    Rule(
        "every_element_is_proven", lambda f: f.certain >= f.criteria.proven, NAMED, ("certain",),
        "all listed effects",
    ),
    Rule(
        "a_class_is_proven",
        lambda f: f.exchangeable and f.alternatives <= CLASS and f.none <= 1.0 - f.criteria.proven, EQUIVALENT,
        ("exchangeable", "alternatives", "none"),
        "a delay of a hundredth of a period, which a lag of the sensor explains as well",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Applied:
    """A rule that was asked, with the facts that it read."""

    rule: str
    applies: bool
    outcome: str
    numbers: Mapping[str, float]

    def document(self) -> dict[str, Any]:
        """Return it as a row of ``diagnosis.json``."""
        return {
            "rule": self.rule, "element": "", "applies": self.applies,
            "outcome": self.outcome if self.applies else "", "numbers": dict(self.numbers),
        }  # fmt: skip


@dataclass(frozen=True)
class Verdict:
    """Attributes:
    word: ``named``, ``equivalent``, ``unknown`` or ``none``.
    probability: of every effect that some model holds, and of ``none``; the largest first.
    claims: the effects of the model that is written, in the order in which they were added.
    rules: all that were asked, in order; the last one gave the word.
    """

    word: str
    probability: dict[str, float]
    claims: tuple[Claim, ...]
    rules: tuple[Applied, ...]

    @property
    def claimed(self) -> tuple[Claim, ...]:
        """Return the elements whose names are given."""
        return tuple(c for c in self.claims if c.claimed)


def conclude(
    weighed: Weighed, model: Visited, new: bool, promising: tuple[int, int], criteria: Criteria, early: bool = False
) -> Verdict:
    """Return the verdict on the models of a search.

    Args:
        model: the one that is written.
        new: held-out recordings bring an amplitude or a frequency that the others lack.
        promising: candidates that promise a material gain to the base model, and to the one that is written; of the
            latter those that were not denied by held-out recordings.
        early: the search ended before it was done.
    """
    base = next(m for m in weighed.models if not m.elements)
    complete = _complete(weighed, model, promising[1], criteria)
    probability = {n: complete * p for n, p in weighed.probability.items()}
    proven = _enough(weighed, criteria)
    together = [tuple(e for e in model.elements if family(e) == n) for n in dict.fromkeys(map(family, model.elements))]
    claims = [_claim(elements, model, weighed, probability, proven, base) for elements in together]
    facts = Facts(
        elements=len(claims),
        learned=sum(c.learned for c in claims),
        none=probability["none"],
        certain=min((c.probability for c in claims), default=0.0),
        alternatives=len(proven),
        exchangeable=all(c.probability >= criteria.proven or c.alike for c in claims),
        complete=complete,
        base_left=base.left,
        explained=base.fit.explained,
        falls=not model.left_held_out >= base.left_held_out and all(_predicts(c, model, criteria) for c in claims),
        new=new,
        promising=promising[0],
        remaining=promising[1],
        early=early,
        criteria=criteria,
    )
    asked = []
    word = UNKNOWN
    for rule in RULES:
        applies = rule.applies(facts)
        asked.append(Applied(rule.name, applies, rule.word, {n: float(getattr(facts, n)) for n in rule.numbers}))
        if applies:
            word = rule.word
            break
    final_claims = () if word == NONE else tuple(_with_status(c, word, new, model, criteria) for c in claims)
    return Verdict(word, probability, final_claims, tuple(asked))


def _complete(weighed: Weighed, model: Visited, remaining: int, criteria: Criteria) -> float:
    """Return the probability that the catalogue holds all physics of the recordings.

    No weight of models can tell it: they compare what was tried. It is taken as ``min(1, √(e/χ²))``, with the mean
    square χ², over that of the noise, of the model to write without learned elements. e is what a model may leave:
    `Criteria.explained` where a learned element is written, or something still promises a gain; the square of
    `Criteria.far` where nothing does, for then it may be noise that was stated too low. Where something promises a
    gain to a model with elements it is a half at most: that model may be the nearest likeness of what acts.
    """
    nameable = [m for m in weighed.models if not any(map(is_learned, m.elements))]
    best = model if model in nameable else best_to_write(nameable, criteria)
    most = criteria.explained if remaining or best is not model else criteria.far**2
    return float(min(_HALF if remaining and best.elements else 1.0, (most / max(best.left_most, 1e-300)) ** 0.5))


def denied(effect: Effect, model: Visited, visited: Mapping[Key, Visited], criteria: Criteria) -> bool:
    """Return whether an effect was fitted to its end beside a model, and predicts held-out recordings no better."""
    more = visited.get(key_of((*model.elements, effect)))
    if more is None or not more.converged:
        return False
    return more.left_held_out >= model.left_held_out * (1.0 - criteria.material_share) ** 2


def _enough(weighed: Weighed, criteria: Criteria) -> list[tuple[str, ...]]:
    """Return the smallest number of alternatives that together are proven."""
    together, chosen = 0.0, []
    for families, share in weighed.alternatives:
        chosen.append(families)
        together += share
        if together >= criteria.proven:
            break
    return chosen


def _claim(
    elements: tuple[Effect, ...], model: Visited, weighed: Weighed, probability: Mapping[str, float],
    proven: Sequence[tuple[str, ...]], base: Visited,
) -> Claim:  # fmt: skip
    effect, *copies = elements
    name = family(effect)
    rest = tuple(e for e in model.elements if e not in elements)
    without = next((m for m in weighed.models if m.key == key_of(rest)), None)
    rest_families = set(model.families) - {name}
    others = {f for families in proven for f in families if set(families) - {f} == rest_families} - {name}
    holders = [e for m in weighed.models for e in m.elements if family(e) in others and not is_learned(e)]
    alike = {family(e): e for e in reversed(holders)}
    ranked = sorted(alike, key=lambda n: -probability[n])
    status = LIKELY if weighed.probability.get(name, 0.0) >= _HALF else PROVISIONAL
    return Claim(
        effect, status, probability.get(name, 0.0), tuple(alike[n] for n in ranked), without,
        _share(model, without or base), tuple(copies),
    )  # fmt: skip


def _share(model: Visited, without: Visited) -> float | None:
    """Return the share of the excess over the noise that the difference of two models takes."""
    if not without.left > 1.0:
        return None
    return (without.left - model.left) / (without.left - 1.0)


def _predicts(claim: Claim, model: Visited, criteria: Criteria) -> bool:
    """Return whether the held-out error does not rise with an element, or nothing is known of it; what has no
    parameter, but terms of each recording, predicts nothing."""
    if not claim.effect.parameters and model.nuisances:
        return False
    if claim.without is None or not model.held_out:
        return True
    return model.left_held_out < claim.without.left_held_out * (1.0 + criteria.material_share) ** 2


def _with_status(claim: Claim, word: str, new: bool, model: Visited, criteria: Criteria) -> Claim:
    """Return a claim with its status: inside an unknown whole an element is likely at most."""
    proven = claim.probability >= criteria.proven and _predicts(claim, model, criteria)
    if claim.learned:
        return replace(claim, status=LEARNED)
    if word not in (NAMED, EQUIVALENT):
        return claim
    return replace(claim, status=NAMED if proven and (word == NAMED or (new and not claim.alike)) else word)
