"""Counts over graded cases: rates with binomial intervals, confusion, detection against strength, reliability."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, norm

from phnn.diagnosis.scored import SIGNIFICANT
from phnn.report.formatting import DASH
from studies.proof.coverage import SHARES, inside
from studies.proof.grades import EXACT, WRONG
from studies.proof.outcome import Outcome
from studies.proof.settings import FAST, FULL

Array = NDArray[np.float64]

_STRONG = 2.0
_THRESHOLD = float(norm.isf(SIGNIFICANT))


@dataclass(frozen=True)
class Rate:
    """``hits`` of ``cases``, with the exact 95 % interval (Clopper & Pearson 1934)."""

    label: str
    hits: int
    cases: int
    target: str

    @property
    def share(self) -> float:
        """NaN without cases."""
        return self.hits / self.cases if self.cases else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Exact 95 % interval of the probability."""
        if not self.cases:
            return 0.0, 1.0
        found = binomtest(self.hits, self.cases).proportion_ci(0.95)
        return float(found.low), float(found.high)


def rate(label: str, outcomes: Iterable[Outcome], hit: Callable[[Outcome], bool], target: str) -> Rate:
    """Count the hits among some outcomes."""
    chosen = list(outcomes)
    return Rate(label, sum(map(hit, chosen)), len(chosen), target)


def strong(outcome: Outcome) -> bool:
    """Whether the base model leaves at least twice the noise."""
    return outcome.base >= _STRONG


def rates(outcomes: Sequence[Outcome]) -> list[Rate]:
    """Every rate that a proof is held against."""
    another = [o for o in outcomes if o.base_family]
    outcomes = [o for o in outcomes if not o.base_family]
    full = [o for o in outcomes if o.tier == FULL]

    def of(stratum: str) -> list[Outcome]:
        return [o for o in full if o.stratum == stratum and o.group != "few" and not o.family]

    same = [o for o in of("same") if strong(o)]
    # A hysteron that the manifest leaves out is missing; a background may be named.
    nothing = [o for o in outcomes if o.stratum == "none" and not o.truth]
    return [
        rate("same form: right, or in a stated class of at most 4", same, lambda o: o.grade != WRONG, "≥ 95 %"),
        rate("same form: exactly right", same, lambda o: o.grade == EXACT, "≥ 85 %"),
        rate("same form: location among at most 3", same, lambda o: o.located != "no", "≥ 95 %"),
        rate("same form: location alone", same, lambda o: o.located == "alone", "≥ 85 %"),
        rate("same form: location before naming, first", same, lambda o: o.dictionary in o.places, "–"),
        rate("other form: name or class", of("other"), lambda o: o.grade != WRONG, "≥ 85 %"),
        rate("other form: remainder flagged", of("other"), lambda o: o.remainder == "unknown", "–"),
        rate("outside: unknown at the right location", of("outside"), lambda o: o.grade != WRONG, "≥ 85 %"),
        rate("pairs: both", of("pair"), lambda o: o.grade != WRONG, "≥ 80 %"),
        rate("triples: all three", of("triple"), lambda o: o.grade != WRONG, "≥ 60 %"),
        rate("few recordings: right, or in a stated class", [o for o in full if o.group == "few"],
             lambda o: o.grade != WRONG, "–"),
        rate("nothing missing: false alarms, score stage", [o for o in nothing if o.tier == FAST],
             lambda o: o.grade == WRONG, "≤ 2 %"),
        rate("nothing missing: false alarms, whole command", [o for o in of("none") if not o.truth],
             lambda o: o.grade == WRONG, "≤ 2 %"),
        rate("nothing missing: false alarms, nulls of all families", [o for o in nothing if o.family],
             lambda o: o.grade == WRONG, "≤ 1 %"),
        *coverage([o for o in full if o.grade != WRONG]),
        *_of_another_hysteresis(another),
    ]  # fmt: skip


def _of_another_hysteresis(outcomes: Sequence[Outcome]) -> list[Rate]:
    """Rates of the cases whose actuator has no hysterons; nothing where there are none."""
    if not outcomes:
        return []
    said = {
        "another hysteresis, nothing concealed: at the hysteron, held-out error falls": False,
        "another hysteresis, effect concealed: name, class, or unknown at a true location": True,
    }
    return [
        rate(label, [o for o in outcomes if bool(o.truth) == concealed], lambda o: o.grade != WRONG, DASH)
        for label, concealed in said.items()
    ]


def coverage(outcomes: Sequence[Outcome]) -> list[Rate]:
    """How often intervals of 68 and 95 % contain the true parameter, where the answer is right."""
    errors = {
        "base parameters": [e for o in outcomes for e in o.base_errors],
        "effect parameters": [e for o in outcomes for e in o.effect_errors],
        "base parameters, mass taken as exact,": [e for o in outcomes for e in o.base_by_noise],
        "effect parameters, mass taken as exact,": [e for o in outcomes for e in o.effect_by_noise],
    }
    targets = {0.68: DASH, 0.95: "90–98 %"}
    return [
        Rate(f"{what} inside their {100 * share:.0f} % interval", sum(inside(found, share)), len(found), targets[share])
        for what, found in errors.items()
        for share in SHARES
    ]


@dataclass(frozen=True)
class Detection:
    """Detection against noncentrality.

    Attributes:
        delta: (B,) centres of the bins; found, named: (B,) shares of verdicts that are not ``none``, and of those with
            the right name or class; cases: (B,).
        limit: (B,) probability of detection of the Neyman–Pearson test along the effect's own direction at the same
            rate of false alarms, ``Φ(δ − z)``.
        half: noncentrality detected in half the cases, of the limit, the verdicts and the names.
    """

    delta: Array
    found: Array
    named: Array
    cases: Array
    limit: Array
    half: tuple[float, float, float]


def detection(outcomes: Sequence[Outcome], bins: int = 10) -> Detection | None:
    """Detection curve of the weak cases; None where there are none."""
    weak = [o for o in outcomes if o.group == "fast_weak"]
    if not weak:
        return None
    delta = np.array([o.delta for o in weak])
    found = np.array([o.verdict != "none" for o in weak], dtype=float)
    named = np.array([o.grade != WRONG for o in weak], dtype=float)
    edges = np.geomspace(delta.min(), delta.max() * (1.0 + 1e-9), bins + 1)
    place = np.clip(np.searchsorted(edges, delta, side="right") - 1, 0, bins - 1)
    cases = np.bincount(place, minlength=bins).astype(float)
    filled = cases > 0
    mean = [np.bincount(place, v, bins)[filled] / cases[filled] for v in (np.log(delta), found, named)]
    centres = np.exp(mean[0])
    return Detection(
        centres, mean[1], mean[2], cases[filled], limit(centres),
        (_THRESHOLD, half_point(delta, found), half_point(delta, named)),
    )  # fmt: skip


def limit(delta: Array) -> Array:
    """Probability of detection along an effect's own direction, at the rate of false alarms that a verdict states."""
    return np.asarray(norm.cdf(delta - _THRESHOLD))


def half_point(delta: Array, hit: Array) -> float:
    """Noncentrality at which a logistic curve in ``log δ`` through the hits passes one half; NaN where none does."""
    x = np.log(delta)
    if hit.all() or not hit.any():
        return float("nan")
    w = np.zeros(2)
    design = np.column_stack([np.ones_like(x), x])
    for _ in range(100):
        p = 1.0 / (1.0 + np.exp(-np.clip(design @ w, -30.0, 30.0)))
        # A little ridge keeps the curve finite where hits and misses do not overlap.
        hessian = (design * (p * (1.0 - p))[:, None]).T @ design + 1e-3 * np.eye(2)
        step = np.linalg.solve(hessian, design.T @ (hit - p) - 1e-3 * w)
        w = w + step
        if np.abs(step).max() < 1e-10:
            break
    return float(np.exp(-w[0] / w[1])) if w[1] > 0.0 else float("nan")


def confusion(outcomes: Sequence[Outcome], stratum: str) -> dict[str, Counter[str]]:
    """How often each concealed effect was given which name; ``none`` and ``unknown`` among the names."""
    table: dict[str, Counter[str]] = {}
    for o in outcomes:
        if o.tier == FULL and o.stratum == stratum and len(o.truth) == 1:
            said = "+".join(o.named) if o.verdict in ("named", "equivalent") else o.verdict
            table.setdefault(o.truth[0], Counter())[said] += 1
    return dict(sorted(table.items()))


def reliability(outcomes: Sequence[Outcome], levels: Sequence[float]) -> Array:
    """(L,) share of the cases without anything missing whose p-value is at or below each level."""
    p = np.array([o.p_value for o in outcomes if o.group == "fast_none"])
    return np.array([float(np.mean(p <= level)) if p.size else np.nan for level in levels])


def quantiles(values: Iterable[float], shares: Sequence[float]) -> list[float]:
    """Quantiles of the finite ones; NaN without any."""
    finite = [v for v in values if np.isfinite(v)]
    return [float(np.quantile(finite, s)) if finite else float("nan") for s in shares]
