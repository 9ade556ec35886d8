"""The kinds of cases and what each of them can conceal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from phnn.demo.concealed import Concealed
from phnn.demo.inner import Base, Plan, Rng
from phnn.demo.listed import LISTED, LOCATIONS, drawn

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
        return tuple(LOCATIONS[name] for name in self.effects)

    def concealed(self, index: int, rng: Rng, base: Base, plan: Plan) -> Concealed:
        """Effect number ``index`` with its shape drawn."""
        return drawn(self.effects[index], rng, base, plan)


_ROUNDS: dict[str, Callable[[], tuple[Choice, ...]]] = {
    "none": lambda: (Choice(),),
    "same": lambda: tuple(Choice((name,)) for name in LISTED),
}
STRATA = tuple(_ROUNDS)


@cache
def choices(stratum: str) -> tuple[Choice, ...]:
    """All that cases of a stratum can conceal."""
    return _ROUNDS[stratum]()
