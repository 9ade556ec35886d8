"""The test whether effects act at the location of a mismatch."""

from __future__ import annotations

from collections.abc import Sequence

from phnn.criteria import LOCATING, SELECTION, Locating, Selection
from phnn.diagnose.locations import Location
from phnn.diagnosis.finding import Finding
from phnn.diagnosis.trial import Trial, class_of, simplest_first
from phnn.effects import Effect


def located(location: Location, rule: Locating = LOCATING) -> bool:
    """Whether a location explains enough to be believed."""
    return location.scores[location.name] > rule.located


def elsewhere(
    named: Sequence[Effect], location: Location, left: Location, little: bool = False, rule: Locating = LOCATING
) -> bool:
    """Whether what is left lies elsewhere than everything that was named.

    The right element in another form leaves something at its own place; one that confounds leaves it where the truth
    is. Where what is left is too little to be located, the whole mismatch is asked, if that can be: for the kind of
    element, or for the place alone.

    Args:
        location: of the whole mismatch; left: of what is left.
        little: whether so little is left that the place alone decides.
        rule: when a location is believed.
    """
    asked = left if located(left, rule) else location
    if asked is location and little:
        explained, most = max(asked.ranks[e.location] for e in named), asked.ranks[asked.name]
    else:
        explained, most = max(_explained(asked, e) for e in named), max(asked.ranks[d] for d in asked.details)
    return located(asked, rule) and explained < most - rule.tied


def _explained(location: Location, effect: Effect) -> float:
    """Share explained by functions of the effect's own kinds; without such functions, by all of its location."""
    return max(of_its_kinds(location, effect), default=location.ranks[effect.location])


def of_its_kinds(location: Location, effect: Effect) -> list[float]:
    """What functions of each of an effect's own kinds explain, as far as there are any."""
    return [location.ranks[k.key] for k in (effect.kind, *effect.related_kinds) if k.key in location.details]


def of_the_kind(effect: Effect, learned: Effect) -> bool:
    """Whether an effect of the catalogue and a learned element may be two forms of one thing, at one place."""
    related = effect.kind == learned.kind or effect.name in learned.neighbours
    return related and (effect.location, effect.place) == (learned.location, learned.place)


def may_be_part_of(learned: Effect, effect: Effect) -> bool:
    """Whether a learned element may take what an effect stands for: at its place, and not more of the same."""
    return learned.location == effect.location and not learned.is_more_of(effect)


def further_forms(named: Finding, findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Learned elements beside an effect that are more of it, so that all together are another form of the effect."""
    return tuple(f for f in findings if f.nameless and of_the_kind(named.effect, f.effect))


def in_another_form(named: Finding, findings: Sequence[Finding]) -> bool:
    """Whether a name stands for another form of the effect: a learned element is all of it, or more of it."""
    return bool(named.laws or further_forms(named, findings))


def may_lie(effect: Effect, location: Location, rule: Locating = LOCATING) -> bool:
    """Whether an effect lies where some of what is left is explained, as far as that can be told.

    A tone at a frequency of the drive is no tone of the surroundings, however well it fits.
    """
    return (
        not located(location, rule) or location.ranks[effect.location] > rule.possible * location.ranks[location.name]
    )


def in_place(trials: list[Trial], location: Location, rule: Selection = SELECTION) -> list[Trial]:
    """Sort the trials: among the ones that tie with the best, the one whose location explains most comes first.

    Of several there it is the simplest.
    """
    if not trials or trials[0].fit is None:
        return trials
    members = simplest_first(class_of(trials, rule=rule))
    first = max(members, key=lambda t: location.ranks[t.candidate.effect.location])
    return [first, *(t for t in trials if t is not first)]
