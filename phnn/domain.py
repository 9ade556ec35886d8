"""The values of a law's parameter for which the law keeps its promise (a sector, an energy with a minimum)."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Domain:
    """An interval that ends at zero or is the whole line.

    Attributes:
        lower: 0 or −∞.
        closed: whether ``lower`` itself is allowed.
        words: the condition as a message says it.
    """

    lower: float
    closed: bool
    words: str

    def __contains__(self, value: float) -> bool:
        return math.isfinite(value) and (value > self.lower or (self.closed and value == self.lower))

    def __and__(self, other: Domain) -> Domain:
        """The stricter of two domains."""
        return max(self, other, key=lambda d: (d.lower, not d.closed))


ANY = Domain(-math.inf, False, "finite")
NONNEGATIVE = Domain(0.0, True, "zero or positive")
POSITIVE = Domain(0.0, False, "positive")
