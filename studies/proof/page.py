"""What a proof comes to: counts with binomial intervals, ``report.html``, tables and figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray
from scipy.stats import binomtest, norm

from phnn.criteria import Criteria
from phnn.report.figures.style import AFTER, BEFORE, FAINT, INK, RC, Drawing, new_figure, png, quiet_grid
from phnn.report.formatting import DASH, number
from phnn.report.plain import plain_page
from phnn.results import Place
from studies.proof.cases import FAST, FULL, Settings
from studies.proof.grade import EXACT, WRONG, Outcome, inside
from studies.results import write_results

Array = NDArray[np.float64]

_STRONG = 2.0
_THRESHOLD = Criteria().score


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
        ends = binomtest(self.hits, self.cases).proportion_ci(0.95)
        return float(ends.low), float(ends.high)


def _right(outcome: Outcome) -> bool:
    return outcome.grade != WRONG


def _wrong(outcome: Outcome) -> bool:
    return outcome.grade == WRONG


def _strong(outcome: Outcome) -> bool:
    """Tell whether the base model leaves at least twice the noise."""
    return outcome.base >= _STRONG


def rates(outcomes: Sequence[Outcome]) -> list[Rate]:
    """Return every rate that a proof is held against."""
    another = [o for o in outcomes if o.base_family]
    outcomes = [o for o in outcomes if not o.base_family]
    full = [o for o in outcomes if o.tier == FULL]

    def of(stratum: str) -> list[Outcome]:
        return [o for o in full if o.stratum == stratum and o.group != "few" and not o.family]

    same = [o for o in of("same") if _strong(o)]
    # A hysteron that the manifest leaves out is missing; a background may be named.
    nothing = [o for o in outcomes if o.stratum == "none" and not o.truth]
    rows: list[tuple[str, Sequence[Outcome], Callable[[Outcome], bool], str]] = [
        ("same form: right, or in a stated class of at most 4", same, _right, "≥ 95 %"),
        ("same form: exactly right", same, lambda o: o.grade == EXACT, "≥ 85 %"),
        ("same form: location among at most 3", same, lambda o: o.located != "no", "≥ 95 %"),
        ("same form: location alone", same, lambda o: o.located == "alone", "≥ 85 %"),
        ("same form: location before naming, first", same, lambda o: o.dictionary in o.places, DASH),
        ("other form: name or class", of("other"), _right, "≥ 85 %"),
        ("other form: remainder flagged", of("other"), lambda o: o.remainder == "unknown", DASH),
        ("outside: unknown at the right location", of("outside"), _right, "≥ 85 %"),
        ("pairs: both", of("pair"), _right, "≥ 80 %"),
        ("triples: all three", of("triple"), _right, "≥ 60 %"),
        ("few recordings: right, or in a stated class", [o for o in full if o.group == "few"], _right, DASH),
        ("nothing missing: false alarms, score stage", [o for o in nothing if o.tier == FAST], _wrong, "≤ 2 %"),
        ("nothing missing: false alarms, whole command", [o for o in of("none") if not o.truth], _wrong, "≤ 2 %"),
        ("nothing missing: false alarms, nulls of all families", [o for o in nothing if o.family], _wrong, "≤ 1 %"),
    ]
    others = []
    if another:
        bare, concealed = ([o for o in another if bool(o.truth) == some] for some in (False, True))
        others = [
            ("another hysteresis, nothing concealed: at the hysteron, held-out error falls", bare),
            ("another hysteresis, effect concealed: name, class, or unknown at a true location", concealed),
        ]
    return [
        *(Rate(label, sum(map(hit, chosen)), len(chosen), target) for label, chosen, hit, target in rows),
        *coverage([o for o in full if _right(o)]),
        *(Rate(label, sum(map(_right, chosen)), len(chosen), DASH) for label, chosen in others),
    ]


def coverage(outcomes: Sequence[Outcome]) -> list[Rate]:
    """Count how often intervals of 68 and 95 % contain the true parameter, where the answer is right."""
    errors = {
        "base parameters": [e for o in outcomes for e in o.base_errors],
        "effect parameters": [e for o in outcomes for e in o.effect_errors],
        "base parameters, mass taken as exact,": [e for o in outcomes for e in o.base_by_noise],
        "effect parameters, mass taken as exact,": [e for o in outcomes for e in o.effect_by_noise],
    }
    return [
        Rate(f"{what} inside their {100 * share:.0f} % interval", sum(inside(some, share)), len(some), target)
        for what, some in errors.items()
        for share, target in ((0.68, DASH), (0.95, "90–98 %"))
    ]


@dataclass(frozen=True)
class Detection:
    """Detection against noncentrality.

    Attributes:
        delta, cases: (B,) centres of the bins, and cases in them.
        found, named: (B,) shares of verdicts that are not ``none``, and of those with the right name or class.
        limit: (B,) the same of the Neyman–Pearson test along the effect's own direction, ``Φ(δ − z)``.
        half: noncentrality detected in half the cases, of the limit, the verdicts and the names.
    """

    delta: Array
    found: Array
    named: Array
    cases: Array
    limit: Array
    half: tuple[float, float, float]


def detection(outcomes: Sequence[Outcome], bins: int = 10) -> Detection | None:
    """Return the detection curve of the weak cases; None where there are none."""
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
    """Return the probability of detection along an effect's own direction at a verdict's rate of false alarms."""
    return np.asarray(norm.cdf(delta - _THRESHOLD))


def half_point(delta: Array, hit: Array) -> float:
    """Return where a logistic curve in ``log δ`` through the hits passes one half; NaN where none does."""
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
    """Count how often each concealed effect was given which name; ``none`` and ``unknown`` among the names."""
    table: dict[str, Counter[str]] = {}
    for o in outcomes:
        if o.tier == FULL and o.stratum == stratum and len(o.truth) == 1:
            said = "+".join(o.named) if o.verdict in ("named", "equivalent") else o.verdict
            table.setdefault(o.truth[0], Counter())[said] += 1
    return dict(sorted(table.items()))


def reliability(outcomes: Sequence[Outcome], levels: Sequence[float]) -> Array:
    """Return the share (L,) of the cases without anything missing whose p-value is at or below each level."""
    p = np.array([o.p_value for o in outcomes if o.group == "fast_none"])
    return np.array([float(np.mean(p <= level)) if p.size else np.nan for level in levels])


def quantiles(values: Iterable[float], shares: Sequence[float]) -> list[float]:
    """Return quantiles of the finite values; NaN without any."""
    finite = [v for v in values if np.isfinite(v)]
    return [float(np.quantile(finite, s)) if finite else float("nan") for s in shares]


def _median(values: Iterable[float]) -> float:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.median(finite)) if finite else float("nan")


@dataclass(frozen=True)
class Count:
    """Nulls of one family: whatever the noise and the input, the whole command must say ``none``.

    Beside a background it may also name that; see `studies.proof.grade`.

    Attributes:
        right, named, unknown, failed: right answers; false names, classes included; something that is not there; none.
        false: the names, with how often each was given; seconds: of a diagnosis, median.
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
    """Return one row per family of nulls, in the order of the cases."""
    rows = []
    for family in dict.fromkeys(o.family for o in outcomes if o.family):
        own = [o for o in outcomes if o.family == family]
        wrong = [o for o in own if _wrong(o)]
        named = ["+".join(o.named) for o in wrong if o.verdict in ("named", "equivalent")]
        rows.append(
            Count(
                family=family,
                cases=len(own),
                right=len(own) - len(wrong),
                named=len(named),
                unknown=sum(o.verdict == "unknown" for o in wrong),
                failed=sum(bool(o.failure) for o in own),
                false=", ".join(f"{n} ({named.count(n)})" for n in dict.fromkeys(named)),
                seconds=_median(o.seconds for o in own),
            )
        )
    return rows


_LEVELS = np.array([0.003, 0.01, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0])


def draw_all(outcomes: Sequence[Outcome]) -> list[Drawing]:
    """Draw those figures for which there are cases."""
    drawings = []
    with rc_context(RC):
        if (curve := detection(outcomes)) is not None:
            drawings.append(_detection(curve))
        if any(o.group == "fast_none" for o in outcomes):
            drawings.append(_reliability(outcomes))
        for stratum, words in (("same", "in the form of the catalogue"), ("other", "in another form")):
            if table := confusion(outcomes, stratum):
                drawings.append(_confusion(table, f"confusion-{stratum}", f"Concealed {words}, and what was said"))
        moved = [o for o in outcomes if o.tier == FULL and o.stratum == "same" and np.isfinite(o.held_after)]
        if moved:
            drawings.append(_improvement(moved))
    return drawings


def _drawing(name: str, title: str, figure: Figure) -> Drawing:
    """Return a figure with its title as the alternative text."""
    return Drawing(f"{name}.png", title, title, png(figure))


def _detection(curve: Detection) -> Drawing:
    figure = new_figure(7.2, 3.6)
    axes: Axes = figure.subplots()
    quiet_grid(axes)
    fine = np.geomspace(curve.delta.min(), curve.delta.max(), 200)
    axes.plot(fine, limit(fine), color=FAINT, lw=2.0, label="limit: effect's own direction")
    axes.plot(curve.delta, curve.found, "o-", color=AFTER, label="verdict is not none")
    axes.plot(curve.delta, curve.named, "s--", color=BEFORE, label="right name or class")
    axes.set(xscale="log", xlabel="noncentrality of the concealed effect", ylabel="share of cases", ylim=(-0.03, 1.03))
    axes.legend(loc="lower right")
    return _drawing("detection", "Detection and naming against strength", figure)


def _reliability(outcomes: Sequence[Outcome]) -> Drawing:
    figure = new_figure(4.2, 3.8)
    axes: Axes = figure.subplots()
    quiet_grid(axes)
    axes.plot(_LEVELS, _LEVELS, color=FAINT, lw=2.0, label="calibrated")
    axes.plot(_LEVELS, reliability(outcomes, _LEVELS.tolist()), "o-", color=AFTER, label="nothing missing")
    axes.set(xscale="log", yscale="log", xlabel="stated p-value", ylabel="share of cases at or below")
    axes.legend(loc="lower right")
    return _drawing("reliability", "Stated p-values where nothing is missing", figure)


def _confusion(table: Mapping[str, Counter[str]], name: str, title: str) -> Drawing:
    rows = list(table)
    said = {n for counts in table.values() for n in counts}
    columns = [n for n in rows if n in said] + sorted(said - set(rows))
    counts = np.array([[table[r][c] for c in columns] for r in rows], dtype=float)
    figure = new_figure(2.6 + 0.34 * len(columns), 1.9 + 0.27 * len(rows))
    axes: Axes = figure.subplots()
    shares = counts / counts.sum(axis=1, keepdims=True)
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.3, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", color=INK, fontsize=8.0)
    axes.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=55, ha="right")
    axes.set_yticks(range(len(rows)), [r.replace("_", " ") for r in rows])
    axes.set(xlabel="said", ylabel="concealed")
    return _drawing(name, title, figure)


def _improvement(outcomes: Sequence[Outcome]) -> Drawing:
    figure = new_figure(7.2, 3.4)
    left, right = figure.subplots(1, 2)
    right_ones = [o for o in outcomes if _right(o)]
    pairs = (
        (left, "held_before", "held_after", "residual over noise, held out"),
        (right, "worst_before", "worst_after", "worst error of a group of parameters"),
    )
    for axes, before, after, label in pairs:
        quiet_grid(axes)
        for chosen, colour, mark in ((outcomes, FAINT, "x"), (right_ones, AFTER, "o")):
            x = np.array([getattr(o, before) for o in chosen])
            y = np.array([getattr(o, after) for o in chosen])
            axes.plot(x, y, mark, color=colour, ms=4.0, label="right" if chosen is right_ones else "all")
        axes.set(xscale="log", yscale="log", xlabel="before", ylabel="after", title=label)
        # Between the decades they would run into one another.
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_minor_formatter(NullFormatter())
    left.legend(loc="upper left")
    return _drawing("improvement", "Before and after the diagnosis", figure)


def write_proof(outcomes: Sequence[Outcome], settings: Settings, digest: str, place: Place) -> list[Rate]:
    """Write tables, figures and the page; returns the rates."""
    found, nulls, drawings = rates(outcomes), counts(outcomes), draw_all(outcomes)
    rows = [(r.label, r.target, r.hits, r.cases, *r.interval) for r in found]
    tables = {
        "cases.csv": pd.DataFrame([o.row() for o in outcomes]),
        "rates.csv": pd.DataFrame(rows, columns=["what", "target", "hits", "cases", "low", "high"]),
    }
    if nulls:
        tables["nulls.csv"] = pd.DataFrame([asdict(c) for c in nulls])
    page = plain_page(
        "studies.proof",
        "page.html",
        outcomes=outcomes,
        settings=settings,
        digest=digest,
        failed=sum(bool(o.failure) for o in outcomes),
        rates=found,
        numbers=numbers(outcomes),
        drawings=drawings,
        nulls=nulls,
        wrong=[o for o in outcomes if _wrong(o) and o.group != "fast_weak"],
    )
    texts = {name: table.to_csv(index=False) for name, table in tables.items()}
    write_results(place, {**texts, "report.html": page.decode()}, drawings=drawings)
    return found


def numbers(outcomes: Sequence[Outcome]) -> list[tuple[str, str, str]]:
    """Return figures that are no rates, with their targets: label, value, target."""
    found: list[tuple[str, str, str]] = []
    if (curve := detection(outcomes)) is not None:
        limit, seen, named = curve.half
        found += [
            ("strength detected in half the cases, over the limit's", _shown(seen / limit), "≤ 2"),
            ("strength named rightly in half the cases, over the limit's", _shown(named / limit), "≤ 3"),
        ]
    same = [o for o in outcomes if o.tier == FULL and o.stratum == "same" and o.group != "few" and _strong(o)]
    if same:
        median, ninth = quantiles((o.held_after for o in same), (0.5, 0.9))
        before = quantiles((o.held_before for o in same), (0.5,))[0]
        start = quantiles((o.worst_before for o in same if _right(o)), (0.5,))[0]
        end, worst = quantiles((o.worst_after for o in same if _right(o)), (0.5, 0.9))
        found += [
            ("held-out residual over noise before, median", _shown(before), DASH),
            ("held-out residual over noise after, median", _shown(median), "≤ 1.1"),
            ("held-out residual over noise after, 90th percentile", _shown(ninth), "≤ 1.5"),
            ("worst scale-free group of the base model, median error", _percent(start), DASH),
            ("worst scale-free group after a right diagnosis, median error", _percent(end), "≤ 1 %"),
            ("worst scale-free group after a right diagnosis, 90th percentile", _percent(worst), "≤ 1 %"),
        ]
    if spread := [abs(e) for o in outcomes if o.tier == FULL and _right(o) for e in o.effect_errors]:
        median = float(np.median(spread))
        found.append(("effect parameters: median error over its standard error", _shown(median), "≤ 1"))
    for tier in (FAST, FULL):
        median = _median(o.seconds for o in outcomes if o.tier == tier)
        if np.isfinite(median):
            found.append((f"seconds a case, {tier} tier: median", number(median), DASH))
    return found


def _shown(value: float) -> str:
    return number(value) if np.isfinite(value) else DASH


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %" if np.isfinite(value) else DASH
