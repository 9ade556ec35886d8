"""The grades of answers: an answer is compared with the sealed truth.

Nothing missing:
    ``none``. Beside a background its names are exact too, and ``unknown`` counts as a class if the held-out error
    really falls: a background is physics that acts in the recordings, but leaves less than the noise.
Effects missing:
    their names, or a stated class of at most `CLASS` with each of them; names of the background may stand beside, and
    so may elements of the model that claim no name.
Effects whose names are withheld:
    ``unknown`` at their location, tied with at most two others.
Another hysteresis than that of hysterons, nothing concealed:
    a mismatch that is located at the hysteron, or names of what acts there only, where the held-out error really falls;
    a class if the location is tied. ``none`` is right only where the fitted model is at the noise anyway.
Another hysteresis and effects:
    their names or a class, beside which what acts on the hysteron may stand; ``unknown`` at the location of the effect
    or at the hysteron counts as a class.

The held-out error really falls where it falls by more than the share that `phnn.criteria` calls material.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from phnn.criteria import CRITERIA
from studies.generator import Sealed
from studies.generator.cases import LOCATION

# A class or a set of locations larger than this helps nobody.
CLASS, TIED = 4, 3
EXACT, IN_CLASS, WRONG = "exact", "class", "wrong"
# Held-out residual over noise up to which a model is at the noise; the target of a right diagnosis.
AT_NOISE = 1.1

Class = tuple[str, ...]


@dataclass(frozen=True)
class Said:
    """What an answer says.

    Attributes:
        verdict: ``none``, ``named``, ``equivalent``, ``unknown``, or ``failed``.
        classes: of each entry, its name and those that are stated as equivalent.
        locations: of each entry; empty where it states none.
        place, tied: where the mismatch lies, and where it may lie as well.
        before, after: residual over noise on held-out recordings; NaN without any.
    """

    verdict: str
    classes: tuple[Class, ...]
    locations: tuple[str, ...]
    place: str
    tied: tuple[str, ...]
    before: float
    after: float

    @property
    def names(self) -> bool:
        """Whether effects are named."""
        return self.verdict in ("named", "equivalent") and bool(self.classes)

    @property
    def gains(self) -> bool:
        """Whether the held-out error falls by more than the share that counts as material."""
        return self.after < (1.0 - CRITERIA.confirmation.material_share) * self.before

    def located(self, places: Iterable[str]) -> str:
        """``alone``, ``tied`` or ``no``: whether the location is one of some places."""
        if self.place in places and not self.tied:
            return "alone"
        return "tied" if len(self.tied) < TIED and set(places) & {self.place, *self.tied} else "no"


def expected(sealed: Sealed) -> tuple[str, ...]:
    """What is missing from the base model: what was concealed, and a hysteron where the manifest states too few."""
    lacks = sealed.hysterons > sealed.stated_hysterons and "extra_hysteron" not in sealed.effects
    return (*sealed.effects, *(["extra_hysteron"] if lacks and not sealed.base_family else []))


def true_places(sealed: Sealed) -> tuple[str, ...]:
    """Where something is missing that a case is about."""
    return (*sealed.location, *([LOCATION] if sealed.base_family else []))


def grade(sealed: Sealed, said: Said) -> str:
    """``exact``, ``class`` or ``wrong``, as the table above says."""
    truth = expected(sealed)
    background = set(sealed.background_effects) - set(truth)
    beside = [
        _beside(c, where, sealed, truth, background) for c, where in zip(said.classes, said.locations, strict=True)
    ]
    # Beside names, an element without one is a part of the model and claims nothing.
    claims = [c[0] != "unknown" or not said.names for c in said.classes]
    told = [c for c, aside, claim in zip(said.classes, beside, claims, strict=True) if claim and not aside]
    if sealed.stratum == "outside":
        unknown = said.verdict == "unknown" and said.located(true_places(sealed)) != "no"
        return EXACT if unknown else WRONG
    if not truth:
        return _of_another_hysteresis(said, told) if sealed.base_family else _of_nothing(said, told, background)
    if sealed.base_family and said.verdict == "unknown":
        return IN_CLASS if said.located(true_places(sealed)) != "no" else WRONG
    return _of_effects(truth, told) if said.names else WRONG


def _beside(c: Class, where: str, sealed: Sealed, truth: tuple[str, ...], background: set[str]) -> bool:
    """Whether an entry is right, and says nothing of what the case is about."""
    if set(c) & set(truth):
        return False
    of_base = bool(sealed.base_family and sealed.effects) and where == LOCATION and c[0] != "unknown"
    return of_base or (bool(set(c) & background) and len(c) <= CLASS)


def _of_nothing(said: Said, told: list[Class], background: set[str]) -> str:
    if said.verdict == "none":
        return EXACT
    if said.names and not told:
        return EXACT if all(c[0] in background and len(c) == 1 for c in said.classes) else IN_CLASS
    nameless = said.verdict == "unknown" and all(c[0] == "unknown" for c in told)
    return IN_CLASS if nameless and background and said.gains else WRONG


def _of_another_hysteresis(said: Said, told: list[Class]) -> str:
    """By place and held-out gain: the hysteresis itself has no name in the catalogue."""
    if said.verdict == "none":
        return EXACT if said.before <= AT_NOISE else WRONG
    located = said.located((LOCATION,)) if said.verdict == "unknown" else "no"
    if said.names and told:
        here = all(where == LOCATION for c, where in zip(said.classes, said.locations, strict=True) if c in told)
        located = "alone" if here else "no"
    if located == "no" or not said.gains:
        return WRONG
    return EXACT if located == "alone" else IN_CLASS


def _of_effects(truth: tuple[str, ...], told: list[Class]) -> str:
    if len(told) != len(truth):
        return WRONG
    if {c[0] for c in told} == set(truth):
        return EXACT if all(len(c) == 1 for c in told) else IN_CLASS
    return IN_CLASS if all(any(t in c and len(c) <= CLASS for c in told) for t in truth) else WRONG
