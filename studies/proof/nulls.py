"""Counts of nulls by family: whatever the noise and the input, the whole command must say ``none``.

Beside a background it may also name that; see `studies.proof.grades`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studies.proof.grades import WRONG
from studies.proof.outcome import Outcome


@dataclass(frozen=True)
class Count:
    """Nulls of one family.

    Attributes:
        family: its name.
        cases: how many.
        right: right answers; named: false names, classes included; unknown: something that is not there; failed: no
            answer.
        false: the names, with how often each was given.
        seconds: of a diagnosis, median.
    """

    family: str
    cases: int
    right: int
    named: int
    unknown: int
    failed: int
    false: str
    seconds: float


def counts(outcomes: Sequence[Outcome]) -> list[Count]:
    """One row per family, in the order of the cases."""
    families = dict.fromkeys(o.family for o in outcomes if o.family)
    return [_count(name, [o for o in outcomes if o.family == name]) for name in families]


def _count(name: str, outcomes: Sequence[Outcome]) -> Count:
    verdicts = [o.verdict for o in outcomes if o.grade == WRONG]
    named = ["+".join(o.named) for o in outcomes if o.grade == WRONG and o.verdict in ("named", "equivalent")]
    seconds = [o.seconds for o in outcomes if np.isfinite(o.seconds)]
    return Count(
        family=name,
        cases=len(outcomes),
        right=len(outcomes) - len(verdicts),
        named=len(named),
        unknown=verdicts.count("unknown"),
        failed=sum(bool(o.failure) for o in outcomes),
        false=", ".join(f"{n} ({named.count(n)})" for n in dict.fromkeys(named)),
        seconds=float(np.median(seconds)) if seconds else float("nan"),
    )
