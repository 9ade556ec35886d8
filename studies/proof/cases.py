"""The cases of a proof: its settings, and what is concealed in which recordings.

A family of nulls is an input kind (``ramp``), a noise (``process:0.1``), or one of each (``ramp+process:0.1``).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from phnn.configuration import check, whole
from phnn.errors import InputRefused
from studies.generator.cases import PLAIN, Conditions
from studies.generator.noise import asked
from studies.generator.plans import KINKED
from studies.sealed.run import Task

# Residual over noise of what is concealed in the full tier; noncentrality in the fast tier.
LEVELS = (2.0, 10.0)
DELTAS = (1.0, 30.0)
_ROOM = 100_000  # seeds of a group

FAST = ("fast_none", "fast_weak")
STRATA = ("none", "same", "other", "outside", "pair", "triple")
GROUPS = (*FAST, *STRATA, "few")
NULLS = "nulls"
# Of the nulls, see `family`.
FAMILIES = (
    "white", "first_order", "process:0.03", "process:0.1", "process:0.5", "pink:0.1", "heavy", "quantised", "jittered",
    "step", "ramp", "triangle", "stair", "smooth",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/prove.yaml``, which says what each of them means.

    Of the nulls there are as many for each of ``null_families``, see `family`; ``noise`` is that of all other cases,
    see `studies.generator.noise`, and empty for that of the seed; ``executor``: see `phnn.parallel.executor`.
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

    def __post_init__(self) -> None:
        check(self)

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """Return the settings of a composed configuration.

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
        """Return the cases of a group; of the nulls, those in each family."""
        return int(getattr(self, group)) if not self.only or group in self.only else 0

    @property
    def changes_cases(self) -> dict[str, Any]:
        """What decides a case and its answer; how many there are and where they are worked on does not."""
        found = {n: getattr(self, n) for n in ("seed", "fast_plan", "plan", "starts", "max_effects")}
        conditions = {n: v for n, v in asdict(self.conditions).items() if v != getattr(PLAIN, n)}
        noise = {"noise": self.noise} if self.noise else {}
        return found | conditions | noise | ({"null_plan": self.null_plan} if self.count(NULLS) else {})


def family(name: str, plan: str) -> tuple[str, str]:
    """Return the set of recordings and the noise of a family of nulls, as `draw_case` takes them.

    Args:
        name: as it is asked for.
        plan: the set of recordings, without a kind of input.

    Raises:
        InputRefused: the name has two inputs, two noises, or something that is neither.
    """
    parts = name.split("+")
    inputs = [p for p in parts if p in KINKED]
    noises = [p for p in parts if p not in KINKED]
    if len(inputs) > 1 or len(noises) > 1:
        raise InputRefused(f"null_families: {name!r} has two inputs or two noises: join one of each, as in ramp+pink")
    for noise in noises:
        try:
            asked(noise)
        except InputRefused as error:
            raise InputRefused(
                f"null_families: {name!r} is no family: name an input ({', '.join(KINKED)}), a noise or both ({error})"
            ) from error
    return "_".join([plan, *inputs]), "".join(noises)


def seed_of(seed: int, name: str, number: int) -> int:
    """Return the seed of a null: its own for every family, however many families there are."""
    word = hashlib.sha256(f"{seed} {name} {number}".encode()).digest()
    return int.from_bytes(word[:6], "big")


def tasks(settings: Settings) -> list[Task]:
    """Return all cases; those of a group stay the same when its number grows."""
    plans = {"fast_none": settings.fast_plan, "fast_weak": settings.fast_plan, "few": "few"}
    strata = {"fast_none": "none", "fast_weak": "same", "few": "same"}
    cases = []
    for index, group in enumerate(GROUPS):
        # Consecutive seeds, so that every effect has its turn; which one comes first is drawn.
        first = _ROOM * (settings.seed * len(GROUPS) + index) + seed_of(settings.seed, group, 0) % (_ROOM // 2)
        task = Task(
            group, first, strata.get(group, group), plans.get(group, settings.plan), LEVELS,
            DELTAS if group == "fast_weak" else None, settings.noise, settings.conditions, fast=group in FAST,
        )  # fmt: skip
        cases += [replace(task, seed=first + n) for n in range(settings.count(group))]
    for name in settings.null_families:
        plan, noise = family(name, settings.null_plan)
        for n in range(settings.count(NULLS)):
            seed, conditions = seed_of(settings.seed, name, n), settings.conditions
            cases.append(Task(NULLS, seed, "none", plan, LEVELS, None, noise, conditions, family=name))
    return cases
