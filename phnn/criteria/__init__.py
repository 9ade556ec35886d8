"""Criteria of a diagnosis: every number that decides something, with unit, meaning and evidence, in one place.

``Criteria.table()`` lists them. One of them is overridden by ``criteria.NAME=value`` on the command line, or by
``Options(criteria={"NAME": value})``. Numbers that do not decide (grid sizes, tolerances of linear algebra) stay beside
the code that uses them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from phnn.criteria.composition import COMPOSITION, Composition
from phnn.criteria.confirmation import CONFIRMATION, Confirmation
from phnn.criteria.criterion import Criterion, row
from phnn.criteria.location import LOCATING, Locating
from phnn.criteria.noise import NOISE, Noise
from phnn.criteria.refits import RACE, REFITS, Race, Refits
from phnn.criteria.selection import SELECTION, Selection
from phnn.errors import InputRefused, meant

__all__ = [
    "COMPOSITION",
    "CONFIRMATION",
    "CRITERIA",
    "LOCATING",
    "NOISE",
    "RACE",
    "REFITS",
    "SELECTION",
    "Composition",
    "Confirmation",
    "Criteria",
    "Criterion",
    "Locating",
    "Noise",
    "Race",
    "Refits",
    "Selection",
]


@dataclass(frozen=True)
class Criteria:
    """All criteria, by the stage that reads them; names are unique over all stages.

    Attributes:
        noise: what the noise is.
        location: where a mismatch is.
        refits: how long refits last, and where they begin.
        race: which refits go on.
        selection: what is added and kept, and the verdict.
        composition: what is added to a composed model.
        confirmation: what held-out recordings confirm.
    """

    noise: Noise = NOISE
    location: Locating = LOCATING
    refits: Refits = REFITS
    race: Race = RACE
    selection: Selection = SELECTION
    composition: Composition = COMPOSITION
    confirmation: Confirmation = CONFIRMATION

    @staticmethod
    def table() -> tuple[Criterion, ...]:
        """One row for every criterion, in the order in which a diagnosis reads them."""
        groups = {f.name: getattr(CRITERIA, f.name) for f in fields(Criteria)}
        return tuple(row(name, f) for name, group in groups.items() for f in fields(group))

    def values(self) -> dict[str, float]:
        """All values by name."""
        return {r.name: getattr(getattr(self, r.group), r.name) for r in self.table()}

    def changed(self) -> dict[str, float]:
        """Values that differ from their defaults, by name."""
        return {r.name: v for r, v in zip(self.table(), self.values().values(), strict=True) if v != r.default}

    def with_values(self, values: Mapping[str, float]) -> Criteria:
        """The criteria with some values replaced.

        Raises:
            InputRefused: no criterion of this name; a value that is not positive; a fraction where a count is asked.
        """
        known = {r.name: r for r in self.table()}
        changed: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            if name not in known:
                hint = meant(name, known)
                raise InputRefused(f"no criterion is called {name!r}{hint}: take one of {', '.join(known)}")
            changed.setdefault(known[name].group, {})[name] = _checked(known[name], value)
        groups = {group: replace(getattr(self, group), **given) for group, given in changed.items()}
        return replace(self, **groups)


def _checked(criterion: Criterion, value: float) -> float:
    """The value, as the type of the default.

    Raises:
        InputRefused: it is not positive, or a fraction where a count is asked.
    """
    number = not isinstance(value, bool) and isinstance(value, int | float)
    if not number or not 0.0 < value < math.inf:
        raise InputRefused(f"criteria.{criterion.name}={value} must be a positive number [{criterion.unit}]")
    if isinstance(criterion.default, int):
        if value != int(value):
            raise InputRefused(f"criteria.{criterion.name}={value} must be a whole number [{criterion.unit}]")
        return int(value)
    return float(value)


CRITERIA = Criteria()
