"""Rules of composing: whether a further element is added to a model, and which of them stay."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from phnn.criteria import Criteria
from phnn.diagnosis.rules import Applied, Record
from phnn.identification.gain import Gain

NAME, NO_NAME, EXCHANGED = "name", "no name", "exchange"


@dataclass(frozen=True)
class LeavesCase:
    """What a model leaves on the recordings that it was grown on, and on those that choose.

    Attributes:
        chi2: larger mean square of the two [noise²]; elements: how many the model has.
        p_value: gives the p-value, which takes long.
    """

    chi2: float
    elements: int
    p_value: Callable[[], float]
    criteria: Criteria


def model_is_at_the_noise(case: LeavesCase) -> Applied:
    """The model leaves no more than the noise floor is known to."""
    doubt = case.criteria.selection.noise_doubt
    numbers = {"residual_over_noise": math.sqrt(case.chi2), "noise_doubt": doubt}
    return Applied(case.chi2 < doubt**2, "stop", numbers)


def model_leaves_no_more_than_chance(case: LeavesCase) -> Applied:
    """What the model leaves is no more than chance would, nor more than any doubt about the noise level."""
    level, most = case.criteria.selection.level, case.criteria.composition.composed_beyond
    numbers = {"residual_over_noise": math.sqrt(case.chi2), "composed_beyond": most}
    if case.chi2 > most**2:
        return Applied(False, "stop", numbers)
    p_value = case.p_value()
    return Applied(p_value >= level, "stop", {**numbers, "p_value": p_value, "level": level})


def model_has_enough_elements(case: LeavesCase) -> Applied:
    """The model has as many elements as may be composed."""
    most = case.criteria.composition.most_elements
    return Applied(case.elements >= most, "stop", {"elements": case.elements, "most_elements": most})


@dataclass(frozen=True)
class GainCase:
    """What one more element gains on the recordings that choose."""

    found: Gain
    criteria: Criteria


def _numbers(case: GainCase) -> dict[str, float | None]:
    rule, found = case.criteria.composition, case.found
    numbers = {"before": found.before, "after": found.after, "p_value": found.falls, "blocks": float(found.blocks)}
    numbers |= {"composed_share": rule.composed_share, "composed_level": rule.composed_level}
    numbers |= {"composed_far": rule.composed_far, "composed_far_level": rule.composed_far_level}
    return numbers | {"share_of_noise": found.share_of_noise, "material": case.criteria.confirmation.material}


def element_predicts_better(case: GainCase) -> Applied:
    """With the element, the recordings that were left out are predicted better: by what matters, not by chance."""
    found, criteria = case.found, case.criteria
    falls = criteria.composition.falls(found.before, found.after, found.falls)
    matters = criteria.confirmation.falls(found.before, found.after, found.share_of_noise)
    return Applied(falls and matters, "add", _numbers(case))


def element_does_not_predict_better(case: GainCase) -> Applied:
    """The recordings that were left out do not ask for the element."""
    return Applied(True, "leave out", _numbers(case))


@dataclass(frozen=True)
class ClaimCase:
    """One element of a composed model.

    Attributes:
        nameless: it is a learned element, and no law of the catalogue comes near it.
        takes: mean square [noise²] that it takes from recordings that were left out.
        leaves: mean square [noise²] that has no name: what the model leaves, and what elements without a name take.
        first: share of the excess that the effects of the search took before anything was added to them; None of any
            other element.
    """

    nameless: bool
    takes: float
    leaves: float
    criteria: Criteria
    first: float | None = None


def learned_element_has_no_name(case: ClaimCase) -> Applied:
    """A learned element stands for physics that no list has."""
    return Applied(case.nameless, NO_NAME, {})


def took_nearly_all_before(case: ClaimCase) -> Applied | None:
    """Before anything was added, the effects of the search took nearly all of the excess."""
    if case.first is None:
        return None
    least = case.criteria.composition.first_takes
    return Applied(case.first >= least, NAME, {"share": case.first, "first_takes": least})


def too_much_has_no_name(case: ClaimCase) -> Applied:
    """What has no name is no small part of what the element takes: it may be what the element stands for.

    An element that was never asked for takes nothing.
    """
    most = case.criteria.composition.claim_leaves
    numbers = {"takes": case.takes, "leaves": case.leaves, "claim_leaves": most}
    return Applied(case.takes <= 0.0 or case.leaves > most * case.takes, NO_NAME, numbers)


def little_has_no_name(case: ClaimCase) -> Applied:
    """What has no name is a small part of what the element takes."""
    return Applied(True, NAME, {"takes": case.takes, "leaves": case.leaves})


@dataclass(frozen=True)
class LawCase:
    """A law of the catalogue in the place of a learned element of its kind.

    Attributes:
        takes: mean square [noise²] that it takes from recordings that were left out; learned: that the element takes.
        term: whether the element is a sum of several such laws.
    """

    takes: float
    learned: float
    criteria: Criteria
    term: bool = False


def law_takes_nearly_all(case: LawCase) -> Applied:
    """The law takes nearly all that the learned element takes: this is the same physics in another form."""
    least = case.criteria.composition.law_takes
    numbers = {"takes": case.takes, "learned_takes": case.learned, "law_takes": least}
    return Applied(case.learned > 0.0 and case.takes >= least * case.learned, "another form", numbers)


def element_is_a_sum_of_it(case: LawCase) -> Applied:
    """The learned element is a sum of several such laws: more of the same physics."""
    numbers = {"takes": case.takes, "learned_takes": case.learned}
    return Applied(case.term and case.learned > 0.0, "another form", numbers)


LEAVES = (model_is_at_the_noise, model_has_enough_elements, model_leaves_no_more_than_chance)


def element_is_still_needed(case: GainCase) -> Applied:
    """Without the element, the recordings that were left out are predicted worse by what matters.

    Unlike for adding, no p-value is asked: an element that was added goes only if nothing is lost with it.
    """
    found, criteria = case.found, case.criteria
    taken = found.before**2 - found.after**2
    share = taken > criteria.composition.composed_share * max(found.before**2 - 1.0, 0.0)
    matters = criteria.confirmation.falls(found.before, found.after, found.share_of_noise)
    return Applied(share and matters, "keep", _numbers(case))


@dataclass(frozen=True)
class WholeCase:
    """A composed model refitted to all identification recordings, and the model of the search.

    Attributes:
        composed: sum of squares [noise²]; None where it cannot be fitted.
        searched: the same of the model of the search.
    """

    composed: float | None
    searched: float


def composed_model_fits_no_better(case: WholeCase) -> Applied:
    """On all identification recordings together the composed model fits no better than that of the search."""
    worse = case.composed is None or case.composed >= case.searched
    return Applied(worse, "model of the search", {"composed": case.composed, "searched": case.searched})


@dataclass(frozen=True)
class ExchangeCase:
    """An element of a model and the best of its neighbours in its place, all others there.

    Attributes:
        own, other: Schwarz's criterion of both models; other is None where no neighbour came near enough to be refitted
            to the end.
        least: a neighbour has to lower the criterion by more; 0 for a special case of the element.
    """

    own: float
    other: float | None
    least: float

    @property
    def numbers(self) -> dict[str, float | None]:
        """What is compared."""
        return {"own": self.own, "other": self.other, "least": self.least}


@dataclass(frozen=True)
class CopiesCase:
    """An element beside others.

    Attributes:
        copies: the largest number of copies in which one of its neighbours acts beside it.
    """

    copies: int


def neighbour_acts_several_times(case: CopiesCase) -> Applied:
    """A neighbour that needs several copies has another form, of which the element may be a part."""
    return Applied(case.copies > 1, NO_NAME, {"copies": case.copies})


def neighbour_fits_better(case: ExchangeCase) -> Applied:
    """With a neighbour in the place of the element the model has a clearly lower criterion of Schwarz."""
    better = case.other is not None and case.other < case.own - case.least
    return Applied(better, EXCHANGED, case.numbers)


def element_stays(case: ExchangeCase) -> Applied:
    """No neighbour is clearly better in the place of the element."""
    return Applied(True, "keep", case.numbers)


GAIN = (element_predicts_better, element_does_not_predict_better)
KEPT = (element_is_still_needed, element_does_not_predict_better)
WHOLE = (composed_model_fits_no_better,)
CLAIM = (learned_element_has_no_name, took_nearly_all_before, too_much_has_no_name, little_has_no_name)
EXCHANGE = (neighbour_fits_better, element_stays)
COPIES = (neighbour_acts_several_times,)
LAW = (law_takes_nearly_all, element_is_a_sum_of_it)


def is_exchanged(case: ExchangeCase, element: str, record: Record) -> bool:
    """Whether a neighbour takes the place of an element, by the rules of ``EXCHANGE``."""
    decided = record.decide(EXCHANGE, case, element)
    return decided is not None and decided.outcome == EXCHANGED


def has_name(case: ClaimCase, element: str, record: Record) -> bool:
    """Whether an element of a composed model has a name, by the rules of ``CLAIM``."""
    decided = record.decide(CLAIM, case, element)
    return decided is not None and decided.outcome == NAME
