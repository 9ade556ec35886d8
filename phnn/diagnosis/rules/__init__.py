"""Rules of a diagnosis: ordered tables of small named functions, each asked once and recorded with its numbers.

A rule is a function of a case, a value that holds all it needs to know. It returns None where it has nothing to say of
the case, and otherwise whether it applies, the numbers that it compared, and the outcome. In a table, the first rule
that applies decides. All rules that were asked are recorded in order, those too that did not apply.

The tables stand in `phnn.diagnosis.rules.search`, ``.composition``, ``.verdict``, ``.element`` and ``.held_out``.

| table | asked | outcomes |
|---|---|---|
| ``search.BASE`` | of the base model | ``none``, ``search`` |
| ``search.REFIT`` | of the best refit, before it is scored | ``stop`` |
| ``search.STEP`` | of every model with one more effect | ``discard and stop``, ``stop``, ``go on`` |
| ``search.FORM`` | of a model that leaves something | ``stop``, ``go on`` |
| ``search.KEEP`` | of the last effect, the one before, … | ``keep``, ``withdraw`` |
| ``verdict.VERDICT`` | of what the search has kept | ``named``, ``equivalent``, ``unknown`` |
| ``composition.LEAVES`` | of a model that may be composed further | ``stop`` |
| ``composition.GAIN`` | of one more element, by recordings that were left out | ``add``, ``leave out`` |
| ``composition.KEPT`` | of an element of a composed model, by the same recordings | ``keep``, ``leave out`` |
| ``composition.WHOLE`` | of the composed model and that of the search | ``model of the search`` |
| ``composition.LAW`` | of a law in the place of a learned element | ``another form`` |
| ``composition.EXCHANGE`` | of an element of a composed model and its neighbours | ``exchange``, ``keep`` |
| ``composition.COPIES`` | of an element with a name beside its neighbours | ``no name`` |
| ``composition.CLAIM`` | of an element of a composed model | ``name``, ``no name`` |
| ``element.ELEMENT`` | of every element | see `phnn.diagnosis.tested.Outcome` |
| ``element.LEFT`` | of an element that claims a name | ``no name`` |
| ``held_out.MODEL`` | of all elements together | ``none``, ``unknown``, ``equivalent``, ``named``, ``kept`` |
| ``held_out.NAMELESS`` | of a base model to which nothing is added | ``none`` |
| ``held_out.REMAINDER`` | of what the final model leaves | ``immaterial`` |
| ``held_out.NUMERICS`` | of the verdict ``named`` | ``equivalent`` |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

C = TypeVar("C")


@dataclass(frozen=True)
class Applied:
    """What one rule found.

    Attributes:
        applies: whether its condition holds.
        outcome: what follows if it holds.
        numbers: what was compared with what.
        rule: its name; element: what it was asked of, empty for the whole model. Both are set by `Record.decide`.
    """

    applies: bool
    outcome: str
    numbers: Mapping[str, float | None]
    rule: str = ""
    element: str = ""

    def document(self) -> dict[str, Any]:
        """An entry of ``rules`` in ``diagnosis.json``; the outcome is null where the rule does not apply."""
        entry: dict[str, Any] = {"rule": self.rule, "applies": self.applies, "numbers": dict(self.numbers)}
        entry["outcome"] = self.outcome if self.applies else None
        return entry | ({"element": self.element} if self.element else {})


Rule = Callable[[C], Applied | None]


@dataclass
class Record:
    """Rules in the order in which they were asked."""

    asked: list[Applied] = field(default_factory=list)

    def decide(self, table: Sequence[Rule[C]], case: C, element: str = "") -> Applied | None:
        """The first rule of a table that applies; None where none does."""
        for rule in table:
            found = rule(case)
            if found is None:
                continue
            found = replace(found, rule=rule.__name__, element=element)
            self.asked.append(found)
            if found.applies:
                return found
        return None
