"""Which cases a proof consists of."""

from __future__ import annotations

from dataclasses import dataclass

from phnn.demo import Case, draw_case
from phnn.prove.settings import FAST, FULL, STRATA, Settings

# Residual over noise of what is concealed in the full tier; noncentrality in the fast tier.
LEVELS = (2.0, 10.0)
DELTAS = (1.0, 30.0)
_GROUPS = ("fast_none", "fast_weak", *STRATA, "few")
_ROOM = 100_000


@dataclass(frozen=True)
class Task:
    """One case of a proof.

    Attributes:
        tier: ``fast`` or ``full``; group: which count of the settings it belongs to; number: in its group.
        seed: of the case; plan: its set of recordings.
    """

    tier: str
    group: str
    number: int
    seed: int
    plan: str

    @property
    def name(self) -> str:
        """Unique in a proof; names files."""
        return f"{self.tier}_{self.group}_{self.number:04d}"

    def case(self) -> Case:
        """What is concealed; everything follows from the seed."""
        if self.group == "fast_weak":
            return draw_case(self.seed, "same", self.plan, deltas=DELTAS)
        stratum = {"fast_none": "none", "few": "same"}.get(self.group, self.group)
        return draw_case(self.seed, stratum, self.plan, levels=LEVELS)


def tasks(settings: Settings) -> list[Task]:
    """All cases; those of a group stay the same when its number grows."""
    plans = {"fast_none": settings.fast_plan, "fast_weak": settings.fast_plan, "few": "few"}
    return [
        Task(
            FAST if group.startswith(FAST) else FULL,
            group,
            number,
            _seed(settings.seed, group, number),
            plans.get(group, settings.plan),
        )
        for group in _GROUPS
        for number in range(getattr(settings, group))
    ]


def _seed(seed: int, group: str, number: int) -> int:
    """Consecutive in a group, so that every effect has its turn."""
    return _ROOM * (seed * len(_GROUPS) + _GROUPS.index(group)) + number
