"""The kinds of cases, and the effects that each can conceal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from studies.generator.concealed import Concealed
from studies.generator.inner import Base, Plan, Rng
from studies.generator.listed import LISTED, LOCATIONS, drawn, may_be_paired
from studies.generator.other_base import HYSTERONS, acts_on
from studies.generator.other_form import FORMS
from studies.generator.unlisted import UNLISTED, UNLISTED_LOCATIONS

CANONICAL = "canonical"


@dataclass(frozen=True)
class Choice:
    """What a case conceals.

    Attributes:
        effects: names; empty for nothing.
        form: of the law: "canonical", the name of another form, or "unlisted".
        withheld: names of the catalogue that the diagnosis must do without.
    """

    effects: tuple[str, ...] = ()
    form: str = CANONICAL
    withheld: tuple[str, ...] = ()

    @property
    def location(self) -> tuple[str, ...]:
        """Canonical location of each effect."""
        return tuple({**LOCATIONS, **UNLISTED_LOCATIONS}[name] for name in self.effects)

    def concealed(self, index: int, rng: Rng, base: Base, plan: Plan) -> Concealed:
        """Effect number ``index`` with its shape drawn."""
        name = self.effects[index]
        if self.form in FORMS:
            return FORMS[self.form][1](rng, base, plan)
        if name in UNLISTED:
            return UNLISTED[name](rng, base, plan)
        return drawn(name, rng, base, plan)


def _together(number: int) -> tuple[Choice, ...]:
    """Sets of listed effects of which any two may be paired."""
    sets = combinations(LISTED, number)
    return tuple(Choice(s) for s in sets if all(may_be_paired(*pair) for pair in combinations(s, 2)))


def _mixed(every: tuple[Choice, ...]) -> tuple[Choice, ...]:
    """In an order in which neighbours share no more effects than others do, always the same."""
    return tuple(every[i] for i in np.random.default_rng(0).permutation(len(every)))


_ROUNDS: dict[str, Callable[[], tuple[Choice, ...]]] = {
    "none": lambda: (Choice(),),
    "same": lambda: tuple(Choice((name,)) for name in LISTED),
    "other": lambda: tuple(Choice((name,), form) for form, (name, _) in FORMS.items()),
    "outside": lambda: (
        *(Choice((name,), withheld=(name,)) for name in LISTED),
        *(Choice((name,), "unlisted") for name in UNLISTED),
    ),
    "pair": lambda: _together(2),
    "triple": lambda: _mixed(_together(3)),
}
STRATA = tuple(_ROUNDS)


@cache
def choices(stratum: str) -> tuple[Choice, ...]:
    """All that cases of a stratum can conceal."""
    return _ROUNDS[stratum]()


def in_turn(stratum: str, number: int, base: str = HYSTERONS) -> tuple[Choice, ...]:
    """What case ``number`` of a stratum conceals, and what instead where that cannot be made strong enough.

    What is withheld is known before a case is made; nothing takes the place of an effect whose name is withheld.

    Args:
        base: hysteresis of the actuator; what acts on hysterons is left out where there are none.
    """
    everything = tuple(c for c in choices(stratum) if all(acts_on(name, base) for name in c.effects))
    first = number % len(everything)
    order = everything[first:] + everything[:first]
    return tuple(choice for choice in order if choice.withheld == order[0].withheld)
