"""Carry a proof out, and tell what it comes to: rates with binomial intervals, tables and a page of markdown."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import norm

from phnn.criteria import Criteria
from phnn.identification.plan import Options
from phnn.report.formatting import DASH, markdown_table, number
from phnn.results import Origin, Place, claim
from studies.proof.cases import FAST, NULLS, Settings, tasks
from studies.results import write_results
from studies.sealed.grade import UNKNOWN, WRONG, Case, share_interval
from studies.sealed.run import Say, run

Array = NDArray[np.float64]

RESULTS = ("log", "cases.csv", "rates.csv", "nulls.csv", "report.md")
_STRONG = 2.0  # residual over noise of a base model that lacks something clearly
_THRESHOLD, _RIDGE = Criteria().score, 5e-4
# What is counted where something is concealed, in the order of the targets below.
_MEASURES: dict[str, Callable[[Case], bool]] = {
    "right, or in a stated class of at most 4": lambda c: c.grade != WRONG,
    "location among at most 3": lambda c: c.located != "no",
    "location alone": lambda c: c.located == "alone",
    "exactly right": lambda c: c.grade == "exact",
    "location before naming, first": lambda c: next(iter(c.row.get("located", ())), "") in c.places,
}
_CONCEALED = {
    "same": ("same form", "≥ 95 %", "≥ 95 %", "≥ 85 %", "≥ 85 %", DASH), "other": ("other form", "≥ 85 %"),
    "outside": ("outside", "≥ 85 %", "≥ 85 %"), "pair": ("pairs", "≥ 80 %"), "triple": ("triples", "≥ 60 %"),
    "few": ("few recordings", DASH),
}  # fmt: skip
_NOTHING = {
    "fast_none": ("score stage", "≤ 2 %"), "none": ("whole command", "≤ 2 %"),
    NULLS: ("nulls of all families", "≤ 1 %"),
}  # fmt: skip
# Parameters by the kind of their errors. The interval of 68 % is the part of the stated one that it would be for a
# normal variable.
_INTERVALS = {
    "base": "base parameters", "effect": "effect parameters", "base_by_noise": "base parameters, mass taken as exact,",
    "effect_by_noise": "effect parameters, mass taken as exact,",
}  # fmt: skip


def claimed(out: Path, settings: Settings) -> AbstractContextManager[Place]:
    """Claim a folder for a proof; one that was begun there goes on if the same settings decide its cases."""
    return claim(out, "prove", (), RESULTS, Origin(settings.changes_cases, resume=True))


def prove(settings: Settings, place: Place, say: Say) -> tuple[list[Case], str]:
    """Return all cases of a proof, diagnosed, in order; and the hash of what they conceal.

    Args:
        place: see `claimed`; gets the log.
        say: called with a line of text: the hash before the first diagnosis, then progress.
    """
    todo = tasks(settings)
    digest = hashlib.sha256("\n".join(repr(t.case()) for t in todo).encode()).hexdigest()
    say(f"sealed {len(todo)} cases; SHA-256 of what they conceal, in order: {digest}")
    options = Options(seed=settings.seed, starts=settings.starts, max_effects=settings.max_effects, workers=1)
    log = (place / "log").own_folder() / "cases.jsonl"
    rows = run(todo, log, options, settings.executor, say)
    # One that could not be made conceals nothing.
    return [Case(row) for row in rows if "effects" in row], digest


def is_right(case: Case) -> bool:
    """Whether an answer is right, alone or as one of a stated class."""
    return case.grade != WRONG


def rates(cases: Sequence[Case]) -> pd.DataFrame:
    """Return every share that a proof is held against: what, target, hits, cases, share and its exact interval."""
    own = [c for c in cases if not c.another_base]
    another = [c for c in cases if c.another_base]
    rows: list[tuple[str, str, int, int]] = []

    def count(what: str, chosen: Sequence[Case], hit: Callable[[Case], bool], target: str = DASH) -> None:
        rows.append((what, target, sum(map(hit, chosen)), len(chosen)))

    for group, (words, *targets) in _CONCEALED.items():
        chosen = [c for c in own if c.row["group"] == group and (group != "same" or _is_strong(c))]
        for (measure, hit), target in zip(_MEASURES.items(), targets, strict=False):
            count(f"{words}: {measure}", chosen, hit, target)
    for group, (words, target) in _NOTHING.items():
        # A hysteron that the manifest leaves out is missing; a background may be named.
        chosen = [c for c in own if c.row["group"] == group and not c.row["effects"]]
        count(f"nothing missing: false alarms, {words}", chosen, lambda c: not is_right(c), target)
        if group == "fast_none":
            count("nothing missing: stated p-value at most 5 %", chosen, lambda c: c.row.get("p_value", 1.0) <= 0.05)
    for words, some in (("nothing concealed", False), ("effect concealed", True)):
        count(f"another hysteresis, {words}: right", [c for c in another if bool(c.row["effects"]) is some], is_right)
    for kind, words in _INTERVALS.items():
        errors = _errors([c for c in cases if is_right(c)], kind)
        for share, target in ((0.68, DASH), (0.95, "90–98 %")):
            inside = sum(abs(e) <= norm.ppf(0.5 + 0.5 * share) for e in errors)
            rows.append((f"{words} inside their {100 * share:.0f} % interval", target, inside, len(errors)))
    table = pd.DataFrame(rows, columns=["what", "target", "hits", "cases"])
    ends = [share_interval(hits, total) for _, _, hits, total in rows]
    return table.assign(share=table["hits"] / table["cases"], low=[e[0] for e in ends], high=[e[1] for e in ends])


def _is_strong(case: Case) -> bool:
    """Whether the base model leaves at least twice the noise."""
    return float(case.row.get("base", 0.0)) >= _STRONG


def _errors(cases: Iterable[Case], kind: str) -> list[float]:
    return [e for c in cases for e in c.row.get("errors", {}).get(kind, {}).values()]


def half_point(delta: Array, hit: Array) -> float:
    """Return where a logistic curve in ``log δ`` through the hits passes one half; NaN where none does."""
    x = np.log(delta)
    if hit.all() or not hit.any():
        return float("nan")

    def cost(w: Array) -> float:
        # A little ridge keeps the curve finite where hits and misses do not overlap.
        logit = w[0] + w[1] * x
        return float(np.logaddexp(0.0, logit).sum() - hit @ logit + _RIDGE * (w @ w))

    w = minimize(cost, np.zeros(2)).x
    return float(np.exp(-w[0] / w[1])) if w[1] > 0.0 else float("nan")


def detection(cases: Sequence[Case]) -> tuple[float, float] | None:
    """Return the noncentrality of weak effects that half the verdicts notice, and that half of them name, over that of
    the Neyman–Pearson test along the effect's own direction, ``Φ(δ − z)``; None without such cases."""
    weak = [c for c in cases if c.row["group"] == "fast_weak"]
    if not weak:
        return None
    delta = np.array([c.row["delta"] for c in weak])
    noticed = np.array([c.answer.word not in ("", "none") for c in weak], dtype=float)
    named = np.array([is_right(c) for c in weak], dtype=float)
    return half_point(delta, noticed) / _THRESHOLD, half_point(delta, named) / _THRESHOLD


def quantile(values: Iterable[float], share: float = 0.5) -> float:
    """Return a quantile of the finite values; NaN without any."""
    finite = [v for v in values if np.isfinite(v)]
    return float(np.quantile(finite, share)) if finite else float("nan")


def numbers(cases: Sequence[Case]) -> list[tuple[str, str, str]]:
    """Return figures that are no rates, with their targets: label, value, target."""
    found: list[tuple[str, str, str]] = []
    if (halves := detection(cases)) is not None:
        found += [
            ("strength detected in half the cases, over the limit's", _shown(halves[0]), "≤ 2"),
            ("strength named rightly in half the cases, over the limit's", _shown(halves[1]), "≤ 3"),
        ]
    if same := [c for c in cases if c.row["group"] == "same" and _is_strong(c)]:
        held = [[c.held_out[i] for c in same] for i in (0, 1)]
        found += [
            ("held-out residual over noise before, median", _shown(quantile(held[0])), DASH),
            ("held-out residual over noise after, median", _shown(quantile(held[1])), "≤ 1.1"),
            ("held-out residual over noise after, 90th percentile", _shown(quantile(held[1], 0.9)), "≤ 1.5"),
        ]
    if spread := [abs(e) for e in _errors([c for c in cases if is_right(c)], "effect")]:
        found.append(("effect parameters: median error over its standard error", _shown(quantile(spread)), "≤ 1"))
    for tier, chosen in (("fast", True), ("full", False)):
        seconds = quantile(c.row.get("seconds", np.nan) for c in cases if (c.row["group"] in FAST) is chosen)
        if np.isfinite(seconds):
            found.append((f"processor seconds a case, {tier} tier: median", number(seconds), DASH))
    return found


def _shown(value: float) -> str:
    return number(value) if np.isfinite(value) else DASH


def nulls(cases: Sequence[Case]) -> pd.DataFrame:
    """Return a row for each family of nulls: whatever the noise and the input, the whole command must say ``none``.

    Beside a background it may also name that; see `studies.sealed.grade`. ``named``: false names, classes included;
    ``failed``: no answer; ``false``: the names, with how often each was given; ``seconds``: median.
    """
    rows = []
    for family in dict.fromkeys(c.row["family"] for c in cases if c.row["family"]):
        own = [c for c in cases if c.row["family"] == family]
        wrong = [c for c in own if not is_right(c)]
        names = [_named(c) for c in wrong if c.answer.word not in ("", "none", UNKNOWN)]
        false = ", ".join(f"{n} ({names.count(n)})" for n in dict.fromkeys(names))
        unknown, failed = (sum(c.answer.word == word for c in wrong) for word in (UNKNOWN, ""))
        seconds = quantile(c.row.get("seconds", np.nan) for c in own)
        rows.append((family, len(own), len(own) - len(wrong), len(names), unknown, failed, false, seconds))
    return pd.DataFrame(rows, columns=["family", "cases", "right", "named", "unknown", "failed", "false", "seconds"])


def _named(case: Case) -> str:
    """Return the names that an answer gives."""
    return "+".join(names[0] for status, names in case.answer.claims if status in ("named", "equivalent"))


def row(case: Case) -> dict[str, Any]:
    """Return a case as a row of ``cases.csv``."""
    own, (before, after) = case.row, case.held_out
    members = dict.fromkeys(n for status, names in case.answer.claims if status != "learned" for n in names)
    chosen = {n: own.get(n, "") for n in ("group", "seed", "plan", "family", "form", "level", "delta", "base")}
    return chosen | {
        "truth": "+".join(own["effects"]), "withheld": "+".join(own["withheld"]), "verdict": case.answer.word,
        "named": _named(case), "members": "+".join(members), "location": "+".join(own.get("places", ())),
        "places": "+".join(case.places), "located": case.located, "grade": case.grade,
        "outcome": case.outcome(case.answer), "score": own.get("score"), "p_value": own.get("p_value"),
        "held_before": before, "held_after": after, "seconds": own.get("seconds"), "failure": own.get("failure", ""),
    }  # fmt: skip


def write_proof(cases: Sequence[Case], settings: Settings, digest: str, place: Place) -> str:
    """Write tables and the page; return the page, markdown."""
    rows = pd.DataFrame([row(c) for c in cases])
    tables = {"cases.csv": rows, "rates.csv": rates(cases), "nulls.csv": nulls(cases)}
    counted = tables["rates.csv"][tables["rates.csv"]["cases"] > 0]
    wrong = rows[(rows["grade"] == WRONG) & (rows["group"] != "fast_weak")]
    listed = ["group", "seed", "truth", "level", "verdict", "members", "location", "places", "outcome", "failure"]
    parts = {
        "Rates": counted, "Numbers": pd.DataFrame(numbers(cases), columns=["what", "value", "target"]),
        "Nulls by family": tables["nulls.csv"], "Wrong answers": wrong[listed],
    }  # fmt: skip
    failed = sum("failure" in c.row for c in cases)
    lines = [
        "# Effects concealed in simulated recordings, and what the diagnosis says", "",
        f"{len(cases)} cases, all drawn from the seed {settings.seed}. The SHA-256 of what they conceal was printed "
        f"before the first diagnosis: {digest}. {failed} diagnoses ended without an answer.", "",
    ]  # fmt: skip
    for title, part in parts.items():
        body = [[number(v) if isinstance(v, float) else str(v) for v in line] for line in part.to_numpy().tolist()]
        lines += [f"## {title}", "", *(markdown_table(list(part), body) if body else ["None."]), ""]
    texts = {name: table.to_csv(index=False) for name, table in tables.items()}
    write_results(place, {**texts, "report.md": "\n".join(lines)})
    return "\n".join(lines)
