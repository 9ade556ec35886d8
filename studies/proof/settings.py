"""The size of a proof, and the settings with which it is carried out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from phnn.configuration import check, whole
from phnn.errors import InputRefused
from studies.generator.conditions import PLAIN, Conditions
from studies.generator.families import asked
from studies.proof.families import family

FAST, FULL = "fast", "full"
STRATA = ("none", "same", "other", "outside", "pair", "triple")
GROUPS = ("fast_none", "fast_weak", *STRATA, "few")
NULLS = "nulls"
# Of the nulls, see `studies.proof.families`.
FAMILIES = (
    "white", "first_order", "process:0.03", "process:0.1", "process:0.5", "pink:0.1", "heavy", "quantised", "jittered",
    "step", "ramp", "triangle", "stair", "smooth",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/prove.yaml``.

    Attributes:
        seed: every case follows from it and its own number.
        fast_none, fast_weak: cases of the fast tier, which ends with the score.
        none, same, other, outside, pair, triple: cases of the full tier by stratum.
        few: how many of the full tier's cases of the stratum ``same`` have few recordings.
        nulls: cases of the full tier with nothing concealed, for each of ``null_families``.
        only: groups of cases to take part; empty for all.
        null_families: see `studies.proof.families`.
        noise: family of all cases but the nulls by family, see `generator.families`; empty for that of the seed.
        background, hysterons, wrong_order, anchor_error, base: of all cases, see `studies.generator.Conditions`.
        fast_plan, plan, null_plan: sets of recordings of the two tiers and of the nulls by family.
        executor: where cases are worked on, see `phnn.parallel.executor`.
        starts: starting points of a fit; max_effects: how many effects a diagnosis may name.
        keep: whether recordings and whole reports are kept.
    """

    seed: int = whole(2026)
    fast_none: int = whole(400)
    fast_weak: int = whole(400)
    none: int = whole(20)
    same: int = whole(60)
    other: int = whole(20)
    outside: int = whole(20)
    pair: int = whole(12)
    triple: int = whole(0)
    few: int = whole(8)
    nulls: int = whole(0)
    only: tuple[str, ...] = ()
    null_families: tuple[str, ...] = FAMILIES
    noise: str = ""
    background: bool = PLAIN.background
    hysterons: int = whole(PLAIN.hysterons)
    wrong_order: bool = PLAIN.wrong_order
    anchor_error: bool = PLAIN.anchor_error
    base: str = PLAIN.base
    fast_plan: str = "short"
    plan: str = "demo"
    null_plan: str = "short"
    executor: str = "processes:2"
    starts: int = whole(4, least=1)
    max_effects: int = whole(3)
    keep: bool = False

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """From the composed configuration.

        Raises:
            InputRefused: a number is out of range, no case is asked for, or a group or family is unknown.
        """
        lists = {n: tuple(str(v) for v in config[n]) for n in ("only", "null_families")}
        found = cls(**({n: config[n] for n in cls.__dataclass_fields__} | lists))
        unknown = [n for n in found.only if n not in (*GROUPS, NULLS)]
        if unknown:
            raise InputRefused(f"only: no group is called {unknown[0]!r}: take some of {', '.join((*GROUPS, NULLS))}")
        for name in found.null_families:
            family(name, found.null_plan)
        if found.noise:
            asked(found.noise)
        counts = {n: found.count(n) for n in (*GROUPS, NULLS)}
        if not any(counts.values()):
            raise InputRefused("no cases: give numbers of cases, 0 or more, not all 0")
        another = found.conditions.base != PLAIN.base
        if another and counts[NULLS]:
            raise InputRefused(
                f"nothing must be missing in nulls: {found.base} is, so set nulls=0 or base={PLAIN.base}"
            )
        other = found.conditions.hysterons != PLAIN.hysterons or found.wrong_order or another
        if other and (counts["fast_none"] or counts["fast_weak"]):
            raise InputRefused(
                "the fast tier fits two hysterons, rightly stated: set fast_none=0 fast_weak=0, or use only"
            )
        return found

    @property
    def conditions(self) -> Conditions:
        """What all cases are asked to have."""
        return Conditions(self.background, self.hysterons, self.wrong_order, self.anchor_error, self.base)

    def count(self, group: str) -> int:
        """Cases of a group; of the nulls, in each family."""
        taken = not self.only or group in self.only
        return int(getattr(self, group)) if taken else 0

    @property
    def changes_cases(self) -> dict[str, Any]:
        """What decides a case and its answer; how many there are and where they are worked on does not."""
        found = {n: getattr(self, n) for n in ("seed", "fast_plan", "plan", "starts", "max_effects")}
        conditions = {n: v for n, v in asdict(self.conditions).items() if v != getattr(PLAIN, n)}
        noise = {"noise": self.noise} if self.noise else {}
        return found | conditions | noise | ({"null_plan": self.null_plan} if self.count(NULLS) else {})
