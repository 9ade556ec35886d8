"""A number that decides something in a diagnosis, with its unit, meaning and evidence."""

from __future__ import annotations

from dataclasses import Field, dataclass, field
from typing import Any

# The evidence of a value that no calculation or measurement gives: the study varies it.
STUDIED = "Choice: no calculation gives it. docs/criteria.md shows the effect of halving and doubling it."


@dataclass(frozen=True)
class Criterion:
    """A row of the table of criteria.

    Attributes:
        group: the stage that reads it; name: as in ``criteria.NAME=value``.
        default: its value where nobody overrides it; unit: ``1`` for a pure number.
        meaning: what is compared with what, and what follows.
        evidence: why this value: a calculation, a measurement, or that it is a choice.
        origin: where the scale of the value begins: 1 for a ratio that is larger than one by a margin.
    """

    group: str
    name: str
    default: float
    unit: str
    meaning: str
    evidence: str
    origin: float

    def times(self, factor: float) -> float:
        """The value with its margin over the origin multiplied; a count stays a whole number, one at least."""
        value = self.origin + factor * (self.default - self.origin)
        return max(1, round(value)) if isinstance(self.default, int) else value


def criterion(default: float, unit: str, meaning: str, evidence: str, origin: float = 0.0) -> Any:
    """A dataclass field that knows its unit, meaning and evidence."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "evidence": evidence, "origin": origin})


def row(group: str, found: Field[Any]) -> Criterion:
    """The table's row of a field that `criterion` made."""
    default: Any = found.default
    return Criterion(group, found.name, default, **found.metadata)
