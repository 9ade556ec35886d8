"""How large a proof is, and how it is carried out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phnn.errors import InputRefused

FAST, FULL = "fast", "full"
STRATA = ("none", "same", "other", "outside", "pair")


@dataclass(frozen=True)
class Settings:
    """The keys of ``configs/prove.yaml``.

    Attributes:
        seed: every case follows from it and its own number.
        fast_none, fast_weak: cases of the fast tier, which ends with the score.
        none, same, other, outside, pair: cases of the full tier by stratum.
        few: how many of the full tier's cases of the stratum ``same`` have few recordings.
        fast_plan, plan: sets of recordings of the two tiers.
        executor: where cases are worked on, see `phnn.ensemble.executor.executor`.
        starts: starting points of a fit; max_effects: how many effects a diagnosis may name.
        keep: whether recordings and whole reports are kept.
    """

    seed: int
    fast_none: int
    fast_weak: int
    none: int
    same: int
    other: int
    outside: int
    pair: int
    few: int
    fast_plan: str
    plan: str
    executor: str
    starts: int
    max_effects: int
    keep: bool

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Settings:
        """From the composed configuration.

        Raises:
            InputRefused: a number of cases is negative, or all are zero.
        """
        found = cls(**{n: config[n] for n in cls.__dataclass_fields__})
        counts = {n: getattr(found, n) for n in ("fast_none", "fast_weak", *STRATA, "few")}
        wrong = [f"{n}={c}" for n, c in counts.items() if c < 0]
        if wrong or not any(counts.values()):
            raise InputRefused(f"{wrong[0] if wrong else 'no cases'}: give numbers of cases, 0 or more, not all 0")
        return found

    @property
    def changes_cases(self) -> dict[str, Any]:
        """What decides a case and its answer; how many there are and where they are worked on does not."""
        return {n: getattr(self, n) for n in ("seed", "fast_plan", "plan", "starts", "max_effects")}
