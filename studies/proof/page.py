"""Carry a proof out, and tell what it comes to: rates with binomial intervals, tables and a page of markdown."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import norm

from phnn.criteria import Criteria
from phnn.identification.options import Options
from phnn.report.formatting import DASH, markdown_table, number
from phnn.results import Origin, Place, claim
from studies.proof.cases import FAST, NULLS, Settings, tasks
from studies.results import write_results
from studies.sealed.grade import UNKNOWN, WRONG, Case, share_interval
from studies.sealed.run import Say, run

Array = NDArray[np.float64]

RESULTS = ("log", "cases.csv", "rates.csv", "nulls.csv", "report.md")
_STRONG = 2.0  # residual over noise of a base model that lacks something clearly
_THRESHOLD = Criteria().score


def claimed(out: Path, settings: Settings, overwrite: bool = False) -> AbstractContextManager[Place]:
    """Claim a folder for a proof; one that was begun there goes on if the same settings decide its cases."""
    return claim(out, "prove", (), RESULTS, Origin(settings.changes_cases, resume=True), overwrite)


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


@dataclass(frozen=True)
class Rate:
    """``hits`` of ``cases``, with the exact 95 % interval."""

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
        return share_interval(self.hits, self.cases)


def is_right(case: Case) -> bool:
    """Whether an answer is right, alone or as one of a stated class."""
    return case.grade != WRONG


def _is_wrong(case: Case) -> bool:
    return case.grade == WRONG


def rates(cases: Sequence[Case]) -> list[Rate]:
    """Return every rate that a proof is held against."""
    another = [c for c in cases if c.another_base]
    bare, concealed = ([c for c in another if bool(c.row["effects"]) == some] for some in (False, True))
    own = [c for c in cases if not c.another_base]
    # A hysteron that the manifest leaves out is missing; a background may be named.
    nothing = [c for c in own if c.row["stratum"] == "none" and not c.row["effects"]]

    def of(group: str, among: Sequence[Case] = own) -> list[Case]:
        return [c for c in among if c.row["group"] == group]

    same = [c for c in of("same") if c.row.get("base", 0.0) >= _STRONG]
    rows: list[tuple[str, Sequence[Case], Callable[[Case], bool], str]] = [
        ("same form: right, or in a stated class of at most 4", same, is_right, "≥ 95 %"),
        ("same form: exactly right", same, lambda c: c.grade == "exact", "≥ 85 %"),
        ("same form: location among at most 3", same, lambda c: c.located != "no", "≥ 95 %"),
        ("same form: location alone", same, lambda c: c.located == "alone", "≥ 85 %"),
        ("same form: location before naming, first", same, lambda c: _first(c) in c.places, DASH),
        ("other form: name or class", of("other"), is_right, "≥ 85 %"),
        ("outside: unknown", of("outside"), is_right, DASH),
        ("outside: unknown at the right location", of("outside"), _is_placed, "≥ 85 %"),
        ("pairs: both", of("pair"), is_right, "≥ 80 %"),
        ("triples: all three", of("triple"), is_right, "≥ 60 %"),
        ("few recordings: right, or in a stated class", of("few"), is_right, DASH),
        ("nothing missing: false alarms, score stage", of("fast_none", nothing), _is_wrong, "≤ 2 %"),
        ("nothing missing: stated p-value at most 5 %", of("fast_none", nothing), _is_improbable, DASH),
        ("nothing missing: false alarms, whole command", of("none", nothing), _is_wrong, "≤ 2 %"),
        ("nothing missing: false alarms, nulls of all families", of(NULLS, nothing), _is_wrong, "≤ 1 %"),
        ("another hysteresis, nothing concealed: at the hysteron, held-out error falls", bare, is_right, DASH),
        ("another hysteresis, effect concealed: name or class, or unknown outside", concealed, is_right, DASH),
    ]  # fmt: skip
    found = [Rate(label, sum(map(hit, chosen)), len(chosen), target) for label, chosen, hit, target in rows]
    return found + coverage([c for c in cases if is_right(c)])


def _is_placed(case: Case) -> bool:
    return is_right(case) and case.located != "no"


def _is_improbable(case: Case) -> bool:
    return bool(case.row.get("p_value", 1.0) <= 0.05)


def _first(case: Case) -> str:
    return str(next(iter(case.row.get("located", ())), ""))


def coverage(cases: Sequence[Case]) -> list[Rate]:
    """Count how often intervals of 68 and 95 % contain the true parameter, where the answer is right.

    The interval of 68 % is the part of the stated one that it would be for a normal variable.
    """
    words = {
        "base": "base parameters", "effect": "effect parameters",
        "base_by_noise": "base parameters, mass taken as exact,",
        "effect_by_noise": "effect parameters, mass taken as exact,",
    }  # fmt: skip
    errors = {what: _errors(cases, kind) for kind, what in words.items()}
    return [
        Rate(
            f"{what} inside their {100 * share:.0f} % interval",
            sum(abs(e) <= norm.ppf(0.5 + 0.5 * share) for e in some), len(some), target,
        )
        for what, some in errors.items() for share, target in ((0.68, DASH), (0.95, "90–98 %"))
    ]  # fmt: skip


def _errors(cases: Iterable[Case], kind: str) -> list[float]:
    return [e for c in cases for e in c.row.get("errors", {}).get(kind, {}).values()]


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
    same = [c for c in cases if c.row["group"] == "same" and c.row.get("base", 0.0) >= _STRONG]
    if same:
        held = [[c.held_out[i] for c in same] for i in (0, 1)]
        worst = [[c.row["worst"][i] for c in same if is_right(c)] for i in (0, 1)]
        found += [
            ("held-out residual over noise before, median", _shown(quantile(held[0])), DASH),
            ("held-out residual over noise after, median", _shown(quantile(held[1])), "≤ 1.1"),
            ("held-out residual over noise after, 90th percentile", _shown(quantile(held[1], 0.9)), "≤ 1.5"),
            ("worst scale-free group of the base model, median error", _percent(quantile(worst[0])), DASH),
            ("worst scale-free group after a right diagnosis, median error", _percent(quantile(worst[1])), "≤ 1 %"),
            (
                "worst scale-free group after a right diagnosis, 90th percentile",
                _percent(quantile(worst[1], 0.9)), "≤ 1 %",
            ),
        ]  # fmt: skip
    if spread := [abs(e) for e in _errors([c for c in cases if is_right(c)], "effect")]:
        found.append(("effect parameters: median error over its standard error", _shown(quantile(spread)), "≤ 1"))
    for tier, chosen in (("fast", True), ("full", False)):
        seconds = quantile(c.row.get("seconds", np.nan) for c in cases if (c.row["group"] in FAST) is chosen)
        if np.isfinite(seconds):
            found.append((f"processor seconds a case, {tier} tier: median", number(seconds), DASH))
    return found


def _shown(value: float) -> str:
    return number(value) if np.isfinite(value) else DASH


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %" if np.isfinite(value) else DASH


def nulls(cases: Sequence[Case]) -> pd.DataFrame:
    """Return a row for each family of nulls: whatever the noise and the input, the whole command must say ``none``.

    Beside a background it may also name that; see `studies.sealed.grade`. ``named``: false names, classes included;
    ``failed``: no answer; ``false``: the names, with how often each was given; ``seconds``: median.
    """
    rows = []
    for family in dict.fromkeys(c.row["family"] for c in cases if c.row["family"]):
        own = [c for c in cases if c.row["family"] == family]
        wrong = [c for c in own if _is_wrong(c)]
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
    each = rates(cases)
    rows = pd.DataFrame([row(c) for c in cases])
    tables = {
        "cases.csv": rows,
        "rates.csv": pd.DataFrame(
            [(r.label, r.target, r.hits, r.cases, *r.interval) for r in each],
            columns=["what", "target", "hits", "cases", "low", "high"],
        ),
    }
    if len(by_family := nulls(cases)):
        tables["nulls.csv"] = by_family
    wrong = rows[(rows["grade"] == WRONG) & (rows["group"] != "fast_weak")]
    shown = wrong[["group", "seed", "truth", "level", "verdict", "members", "location", "places", "outcome", "failure"]]
    shares = [
        (r.label, r.target, f"{100 * r.share:.1f} %", f"{r.hits} of {r.cases}", "{:.1f} – {:.1f} %".format(*_ends(r)))
        for r in each if r.cases
    ]  # fmt: skip
    parts = {
        "Rates": (("what", "target", "share", "cases", "95 % interval"), shares),
        "Numbers": (("what", "value", "target"), numbers(cases)),
        "Nulls by family": (list(by_family), by_family.to_numpy().tolist()),
        "Wrong answers": (list(shown), shown.to_numpy().tolist()),
    }
    failed = sum("failure" in c.row for c in cases)
    lines = [
        "# Effects concealed in simulated recordings, and what the diagnosis says", "",
        f"{len(cases)} cases, all drawn from the seed {settings.seed}. The SHA-256 of what they conceal was printed "
        f"before the first diagnosis: {digest}. {failed} diagnoses ended without an answer.", "",
    ]  # fmt: skip
    for title, (head, body) in parts.items():
        text = [[number(v) if isinstance(v, float) else str(v) for v in line] for line in body]
        lines += [f"## {title}", "", *(markdown_table(list(head), text) if text else ["None."]), ""]
    texts: Mapping[str, str] = {name: table.to_csv(index=False) for name, table in tables.items()}
    write_results(place, {**texts, "report.md": "\n".join(lines)})
    return "\n".join(lines)


def _ends(rate: Rate) -> tuple[float, ...]:
    return tuple(100 * end for end in rate.interval)
