"""The cases of a proof."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from studies.generator import Case, Conditions, draw_case
from studies.generator.cases import PLAIN
from studies.proof.families import family, seed_of
from studies.proof.settings import FAST, FULL, GROUPS, NULLS, Settings

# Residual over noise of what is concealed in the full tier; noncentrality in the fast tier.
LEVELS = (2.0, 10.0)
DELTAS = (1.0, 30.0)
_ROOM = 100_000


@dataclass(frozen=True)
class Task:
    """One case of a proof.

    Attributes:
        tier: ``fast`` or ``full``; group: which count of the settings it belongs to; number: in its group.
        seed: of the case; plan: its set of recordings.
        family: of a null; noise: what is asked for, empty for that of the seed; conditions: what else is asked for.
    """

    tier: str
    group: str
    number: int
    seed: int
    plan: str
    family: str = ""
    noise: str = ""
    conditions: Conditions = PLAIN

    @property
    def name(self) -> str:
        """Unique in a proof; names files."""
        parts = (self.tier, self.group, *([self.family.replace(":", "-")] if self.family else []))
        return f"{'_'.join(parts)}_{self.number:04d}"

    def case(self) -> Case:
        """What is concealed; everything follows from the seed."""
        asked: dict[str, Any] = {"noise": self.noise or None, "conditions": self.conditions}
        if self.group == "fast_weak":
            return draw_case(self.seed, "same", self.plan, deltas=DELTAS, **asked)
        stratum = {"fast_none": "none", "few": "same", NULLS: "none"}.get(self.group, self.group)
        return draw_case(self.seed, stratum, self.plan, levels=LEVELS, **asked)


def tasks(settings: Settings) -> list[Task]:
    """All cases; those of a group stay the same when its number grows."""
    plans = {"fast_none": settings.fast_plan, "fast_weak": settings.fast_plan, "few": "few"}
    found = [
        Task(
            FAST if group.startswith(FAST) else FULL,
            group,
            number,
            _seed(settings.seed, group, number),
            plans.get(group, settings.plan),
            noise=settings.noise,
            conditions=settings.conditions,
        )
        for group in GROUPS
        for number in range(settings.count(group))
    ]
    return found + _nulls(settings)


def _nulls(settings: Settings) -> list[Task]:
    families = [family(name, settings.null_plan) for name in settings.null_families]
    return [
        Task(FULL, NULLS, number, seed_of(settings.seed, f.name, number), f.plan, f.name, f.noise, settings.conditions)
        for f in families
        for number in range(settings.count(NULLS))
    ]


def _seed(seed: int, group: str, number: int) -> int:
    """Consecutive in a group, so that every effect has its turn; which one comes first is drawn."""
    first = seed_of(seed, group, 0) % (_ROOM // 2)
    return _ROOM * (seed * len(GROUPS) + GROUPS.index(group)) + first + number
