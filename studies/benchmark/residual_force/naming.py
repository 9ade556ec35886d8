"""From the candidates that explain a residual force to an answer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from phnn.effects import catalogue
from studies.benchmark.answer import Answer
from studies.benchmark.residual_force.prediction import Forced, examination

# The most that is believed of anything, and the least of what cannot be excluded. The other numbers here were chosen on
# twelve cases of a seed of their own, whose answers were known.
MOST, LEAST = 0.9, 0.05
# Share of the residual's excess over the noise that the table has to explain, or something else is missing.
EXPLAINED = 0.5
# Places that are stated at most.
_PLACES = 3


@dataclass(frozen=True)
class Weighed:
    """Attributes:
    significant: the candidates, or any force, predict left-out blocks better than the base by more than chance.
    frequencies: share of the draws in which each effect is selected; under the empty name what the catalogue does not
        list.
    explained: share of the excess over the noise, in left-out blocks.
    """

    significant: bool
    frequencies: Mapping[str, float]
    explained: float


def answer_of(weighed: Weighed, model: Forced, folder: Path) -> Answer:
    """An answer with the predictions of a model."""
    predictions = examination(model, folder)
    if not weighed.significant:
        return Answer({}, none=MOST, unlisted=LEAST, predictions=predictions)
    trusted = weighed.explained >= EXPLAINED
    scale = MOST if trusted else MOST * max(0.0, weighed.explained)
    names = {name: scale * p for name, p in weighed.frequencies.items() if name}
    strange = MOST * weighed.frequencies.get("", 0.0)
    unlisted = (
        strange if trusted else max(strange, MOST * (1.0 - weighed.explained) if weighed.explained < 1.0 else 0.0)
    )
    unlisted = min(MOST, max(LEAST, unlisted))
    return Answer(names, LEAST, unlisted, places_of(names), predictions)


def places_of(names: Mapping[str, float]) -> tuple[str, ...]:
    """Locations by the sum of the probabilities of their effects, the most probable first; three at most."""
    known, sums = catalogue(), Counter[str]()
    for name, probability in names.items():
        sums[known[name].location] += probability  # type: ignore[assignment]
    return tuple(place for place, _ in sums.most_common(_PLACES))
