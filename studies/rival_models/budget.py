"""The processor time that a fit may take, the same for every rival."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field


class Spent(Exception):
    """The budget is spent: the best model so far counts."""


@dataclass(frozen=True)
class Budget:
    """Processor seconds of this process, all threads together, from the moment it is made.

    Attributes:
        seconds: how many; infinity for no limit.
        most: evaluations or updates of each candidate at most. A fit that ends by this number, and not by its time,
            gives the same model on every run.
    """

    seconds: float
    most: int = 10**9
    began: float = field(default_factory=time.process_time)

    @property
    def used(self) -> float:
        """Processor seconds since the beginning."""
        return time.process_time() - self.began

    @property
    def left(self) -> float:
        """Processor seconds that are left, 0 at least."""
        return max(0.0, self.seconds - self.used)

    def part(self, share: float) -> Budget:
        """A budget that begins now with a share of what is left."""
        return Budget(share * self.left if math.isfinite(self.seconds) else self.seconds, self.most)

    def check(self) -> None:
        """Stop a fit at the deadline.

        Raises:
            Spent: nothing is left.
        """
        if self.left <= 0.0:
            raise Spent
