"""Answers compared with the seals of their cases, and figures over many of them as tables and a page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import gammaln, xlogy

from phnn.effects import catalogue
from phnn.errors import InputRefused
from phnn.intake import LIMITS, load_json, named_file
from phnn.report.formatting import DASH, markdown_table, number
from phnn.results import Place
from studies.benchmark.bench import (
    GROUPS,
    NONE,
    OUTPUT,
    PLANS,
    STRENGTHS,
    TOOL_CARD,
    UNLISTED,
    Answer,
    Entry,
    card_of,
    digest_of,
    opened,
    read_answer,
)
from studies.generator import Sealed
from studies.results import write_results
from studies.sealed.grade import NAMED, RIGHT, Case, calibration_error, share_interval
from studies.sealed.grade import Answer as Verdict
from studies.sealed.run import truth_of

Array = NDArray[np.float64]

SCORES = ("scores.csv", "groups.csv", "leaderboard.csv", "leaderboard.md")
_NAMED = ("same", "other", "pair")  # groups with listed effects and nothing beside them
# Of an interval of a difference: level of each side; values of q; differences that are tried; halvings; rounding.
_LEVEL, _NUISANCE, _COARSE, _HALVINGS, _ROUNDING = 0.025, 101, 0.02, 8, 1e-9


@dataclass(frozen=True)
class Score:
    """One case, scored.

    Attributes:
        case, group, strength, plan: which case; truth: what was concealed, sorted: names, or one of `NONE` and
            `UNLISTED`; places: of it.
        claimed: what the answer claims, sorted.
        right: whether exactly the truth is claimed; what a background holds may stand beside.
        first: whether the truth is what the answer gives the highest probabilities to, claimed or not.
        placed: whether the first place is one of the true ones; placed_within: any of the first three.
        confidence: the highest probability that was stated; confirmed: whether what it was given to is true.
        brier: sum of squared distances of all probabilities from 0 or 1.
        error: of the predictions over the noise, root mean square over the recordings of the examination; infinite
            where one is missing.
        seconds: of the processor; failed: whether the tool had no answer.
    """

    case: str
    group: str
    strength: str
    plan: str
    truth: tuple[str, ...]
    places: tuple[str, ...]
    claimed: tuple[str, ...]
    right: bool
    first: bool
    placed: bool
    placed_within: bool
    confidence: float
    confirmed: bool
    brier: float
    error: float
    seconds: float
    failed: bool

    @property
    def false_alarm(self) -> bool:
        """Whether something is claimed where nothing was concealed."""
        return self.group == "none" and bool(set(self.claimed) - {NONE})

    @property
    def kind(self) -> str:
        """What cases are balanced over: none, outside, pairs, and each listed effect."""
        return self.group if self.group in ("none", "outside", "pair") else "+".join(self.truth)


def scored(entry: Entry, sealed: Sealed, exam: Mapping[str, pd.DataFrame], answer: Answer) -> Score:
    """Score an answer.

    Args:
        exam: tables of the examination by recording, with the outputs.

    Raises:
        InputRefused: a prediction has another length than its recording.
    """
    case = Case({"group": entry.group, **truth_of(sealed)})
    truth, beside = case.truth or frozenset([UNLISTED if case.outside else NONE]), case.beside
    stated, places = answer.probabilities, tuple(dict.fromkeys(sealed.location))
    best = max(stated, key=lambda name: stated[name])
    names = {**dict.fromkeys((*catalogue(), NONE, UNLISTED), 0.0), **stated}
    answered, among = not answer.failed, answer.places if not answer.failed else ()
    # A background may be named or not.
    brier = sum((p - (name in truth)) ** 2 for name, p in names.items() if name not in beside)
    without = replace(answer, names={n: p for n, p in answer.names.items() if n not in beside})
    return Score(
        entry.name, entry.group, entry.strength, entry.plan, tuple(sorted(truth)), places,
        tuple(sorted(answer.claims)), answered and case.outcome(_verdict(answer, beside)) == RIGHT,
        answered and without.first(len(truth)) == truth, bool(set(among[:1]) & set(places)),
        bool(set(among[:3]) & set(places)), stated[best], answered and best in truth | beside, brier,
        _prediction_error(exam, answer.predictions, sealed), answer.seconds, bool(answer.failed),
    )  # fmt: skip


def _verdict(answer: Answer, beside: frozenset[str]) -> Verdict:
    """Return what an answer claims as a verdict: with a name beside them, neither `NONE` nor `UNLISTED` is one."""
    words = {frozenset([NONE]): "none", frozenset([UNLISTED]): "unknown"}
    claims = answer.claims if NONE in answer.claims else answer.claims - beside
    return Verdict([], {}, words.get(claims, NAMED), tuple((NAMED, (name,)) for name in answer.claims))


def _prediction_error(exam: Mapping[str, pd.DataFrame], predictions: Mapping[str, Array], sealed: Sealed) -> float:
    """Return the error over the noise without the zero of each recording, which nobody can know.

    Infinite where a prediction is missing, or is no number somewhere.
    """
    squares = []
    for name, table in exam.items():
        if name not in predictions:
            return float("inf")
        y, predicted = 1e-6 * table[OUTPUT].to_numpy(dtype=float), np.asarray(predictions[name], dtype=float)
        if predicted.shape != y.shape:
            raise InputRefused(f"{name}: {predicted.size} samples are predicted, the recording has {y.size}")
        noise = sealed.noise_rms.get(name, float(np.hypot(sealed.noise, sealed.quantisation / np.sqrt(12.0))))
        squares.append(float(np.var(y - predicted)) / noise**2)
    error = float(np.sqrt(np.mean(squares)))
    return error if np.isfinite(error) else float("inf")


def scores_of(folder: Path, answers: Path, first: int | None = None) -> list[Score]:
    """Open the seals of a benchmark and score the answers of a tool.

    Args:
        answers: holds a folder with an answer for each case, or ``answers/`` with these.
        first: so many cases alone, in the order of the benchmark, which is drawn; all if left out.

    Raises:
        InputRefused: a seal was changed since, or an answer is absent or damaged; names it.
    """
    card = card_of(folder)
    if digest_of(folder, card["cases"]) != card["sha256"]:
        raise InputRefused(f"{folder}: a case or a seal is not as bench.json was written with: make the cases again")
    own = answers / TOOL_CARD
    if own.exists():
        content = load_json(named_file(own, (answers,)), LIMITS.json_bytes, "the tool of answers", "answer anew")
        if not isinstance(content, dict) or content.get("sha256") != card["sha256"]:
            raise InputRefused(f"{answers}: these answers are to another benchmark than {folder}: answer this one")
    home, scores = answers / "answers" if (answers / "answers").is_dir() else answers, []
    for case in card["cases"][:first]:
        entry, sealed, exam = opened(folder, case)
        try:
            scores.append(scored(entry, sealed, exam, read_answer(home / case)))
        except InputRefused as error:
            raise InputRefused(f"{answers}: {case}: {error}") from error
    return scores


def balanced_accuracy(scores: Sequence[Score]) -> float:
    """Return the mean over the kinds of truth of the share that is right; NaN without cases."""
    kinds: dict[str, list[bool]] = {}
    for s in scores:
        kinds.setdefault(s.kind, []).append(s.right)
    return _mean(float(np.mean(right)) for right in kinds.values())


def listed(scores: Sequence[Score]) -> list[Score]:
    """Return those with listed effects and nothing beside them: groups same, other and pair."""
    return [s for s in scores if s.group in _NAMED]


def summary(scores: Sequence[Score]) -> dict[str, float]:
    """Return the figures of a tool, by label; shares from 0 to 1."""
    concealing, named = [s for s in scores if s.group != "none"], listed(scores)
    return {
        "cases": len(scores),
        "without an answer": sum(s.failed for s in scores),
        "balanced accuracy of claims": balanced_accuracy(scores),
        "names claimed rightly (same, other, pair)": _mean(s.right for s in named),
        "names first in probability (same, other, pair)": _mean(s.first for s in named),
        "location right": _mean(s.placed for s in concealing),
        "location among three": _mean(s.placed_within for s in concealing),
        "false alarms": _mean(s.false_alarm for s in scores if s.group == "none"),
        "calibration error": calibration_error([(s.confidence, s.confirmed) for s in scores if not s.failed]),
        "Brier score": _mean(s.brier for s in scores),
        "prediction error / noise, median": _median(s.error for s in scores),
        "prediction error / noise in `outside` and `background`, median": _median(
            s.error for s in scores if s.group in ("outside", "background")
        ),
        "processor seconds a case, median": _median(s.seconds for s in scores),
    }


def _mean(values: Iterable[float]) -> float:
    each = list(values)
    return float(np.mean(each)) if each else float("nan")


def _median(values: Iterable[float]) -> float:
    each = list(values)
    return float(np.median(each)) if each else float("nan")


def by_group(scores: Sequence[Score]) -> pd.DataFrame:
    """Return a row for each group, and of what conceals something for each strength and set of recordings: cases,
    rightly claimed, with the exact 95 % interval."""
    concealing, rows = [s for s in scores if s.group != "none"], []
    wanted = [("group", g, scores) for g in GROUPS]
    wanted += [("strength", x, concealing) for x in STRENGTHS] + [("recordings", x, concealing) for x in PLANS]
    for what, value, among in wanted:
        chosen = [s for s in among if value in (s.group, s.strength, s.plan)]
        if chosen:
            right = sum(s.right for s in chosen)
            rows.append((what, value, len(chosen), right, right / len(chosen), *share_interval(right, len(chosen))))
    return pd.DataFrame(rows, columns=["of", "value", "cases", "right", "share", "low", "high"])


@cache
def paired_interval(cases: int, gained: int, lost: int) -> tuple[float, float]:
    """Return the exact 95 % interval of the share of right answers of the first tool less that of the second.

    Of ``n`` cases ``b`` are right with the first tool alone and ``c`` with the second alone: multinomial with
    probabilities ``q + Δ`` and ``q``. The interval holds every difference ``Δ`` that two one-sided tests do not reject,
    with the score statistic of Tango (1998, Statistics in Medicine 17, 891),

        T(b, c; Δ) = (b − c − n Δ) / √(n (2 q̂ + Δ (1 − Δ))),

    ``q̂`` the likeliest ``q`` for this ``Δ``. A test's p-value is the largest over all ``q`` of the exact probability of
    a statistic that is as extreme (Tang, Tang & Chan 2003, Statistics in Medicine 22, 1217): the interval holds the
    true difference at least as often as it says, however few cases there are.

    Args:
        cases: how many; gained: right with the first alone; lost: right with the second alone.

    Raises:
        ValueError: more cases differ than there are.
    """
    if min(gained, lost) < 0 or gained + lost > cases:
        raise ValueError(f"{gained} + {lost} of {cases} cases cannot differ")
    if not cases:
        return -1.0, 1.0
    return _lower(cases, gained, lost), -_lower(cases, lost, gained)


def _lower(n: int, b: int, c: int) -> float:
    """Return the least difference that is not too small for what was counted."""
    at, share = -1.0, (b - c) / n
    while at + _COARSE < share and _too_small(n, b, c, at + _COARSE):
        at += _COARSE
    low, high = at, min(at + _COARSE, share)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _too_small(n, b, c, middle) else (low, middle)
    return low


def _too_small(n: int, b: int, c: int, delta: float) -> bool:
    """Whether a difference makes a statistic as large as that of the counts improbable, whatever ``q``."""
    if delta <= -1.0:
        return False
    ways, all_b, all_c = _tables(n)
    extreme = _statistic(n, all_b, all_c, delta) >= _statistic(n, np.array([b]), np.array([c]), delta) - _ROUNDING
    q = np.linspace(max(0.0, -delta), 0.5 * (1.0 - delta), _NUISANCE)[:, None]
    some_b, some_c = all_b[extreme], all_c[extreme]
    chance = xlogy(some_b, q + delta) + xlogy(some_c, q)
    chance = chance + xlogy(n - some_b - some_c, np.maximum(1.0 - 2.0 * q - delta, 0.0))
    return bool(np.exp(ways[extreme] + chance).sum(axis=1).max() <= _LEVEL)


@cache
def _tables(n: int) -> tuple[Array, Array, Array]:
    """Return logarithms of the number of ways to each pair of counts, and the counts."""
    b, c = (counts[np.add.outer(range(n + 1), range(n + 1)) <= n].astype(float) for counts in np.indices((n + 1,) * 2))
    return gammaln(n + 1) - gammaln(b + 1) - gammaln(c + 1) - gammaln(n - b - c + 1), b, c


def _statistic(n: int, b: Array, c: Array, delta: float) -> Array:
    """Return Tango's score statistic; zero over zero is zero."""
    linear = (2.0 * n - b + c) * delta - b - c
    product = -c * delta * (1.0 - delta)
    q = (np.sqrt(np.maximum(linear**2 - 8.0 * n * product, 0.0)) - linear) / (4.0 * n)
    spread = np.sqrt(np.maximum(n * (2.0 * q + delta * (1.0 - delta)), 0.0))
    off = b - c - n * delta
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.abs(off) < _ROUNDING, 0.0, off / spread)


def write_scores(found: Mapping[str, Sequence[Score]], place: Place) -> str:
    """Write the scores of tools as tables; return their page as markdown.

    Args:
        found: by tool; place: claimed for them.
    """
    rows = pd.DataFrame([{"tool": name, **_flat(s)} for name, scores in found.items() for s in scores])
    groups = pd.concat([by_group(scores).assign(tool=name) for name, scores in found.items()])
    table = pd.DataFrame({name: summary(scores) for name, scores in found.items()})
    csv = (rows.to_csv(index=False), groups.to_csv(index=False), table.to_csv(index_label="figure"))
    texts = dict(zip(SCORES, (*csv, page(found)), strict=True))
    write_results(place, texts)
    return texts[SCORES[-1]]


def _flat(score: Score) -> dict[str, object]:
    return {n: "+".join(v) if isinstance(v, tuple) else v for n, v in asdict(score).items()}


def page(found: Mapping[str, Sequence[Score]]) -> str:
    """Return a page of markdown: wrong answers of the first tool, the figures of all tools, where each is better.

    Args:
        found: scores by tool; the first tool is the one that others are compared with.
    """
    first = next(iter(found))
    figures = {name: summary(scores) for name, scores in found.items()}
    body = [[label, *(_shown(of[label]) for of in figures.values())] for label in figures[first]]
    lines = [f"## Wrong answers of {first}", "", *_wrong(found[first]), ""]
    lines += ["## All tools", "", *markdown_table(["", *figures], body), ""]
    lines += ["## Rightly claimed, with exact 95 % intervals", "", *_groups(found), ""]
    if len(found) > 1:
        lines += [f"## {first} against each", "", *_against(found), ""]
    return "\n".join(lines)


def _shown(value: float) -> str:
    """Write a figure in a table; counts are whole numbers."""
    if isinstance(value, int):
        return str(value)
    return "∞" if value == np.inf else number(value) if np.isfinite(value) else DASH


def _wrong(scores: Sequence[Score]) -> list[str]:
    """Return a row for each case that is not right; a sentence where there is none."""

    def names(each: Sequence[str]) -> str:
        return " + ".join(each) or "nothing"

    rows = [
        [s.case, s.group, s.strength, s.plan, names(s.truth), "no answer" if s.failed else names(s.claimed)]
        for s in scores
        if not s.right
    ]
    head = ["case", "group", "strength", "recordings", "concealed", "claimed"]
    return markdown_table(head, rows) if rows else [f"None of {len(scores)} answers is wrong."]


def _groups(found: Mapping[str, Sequence[Score]]) -> list[str]:
    wanted = {**{group: (group,) for group in GROUPS}, ", ".join(_NAMED): _NAMED}

    def cell(scores: Sequence[Score], groups: Sequence[str]) -> str:
        own = [s.right for s in scores if s.group in groups]
        if not own:
            return DASH
        low, high = share_interval(sum(own), len(own))
        return f"{100 * sum(own) / len(own):.0f} % ({100 * low:.0f} to {100 * high:.0f})"

    first = next(iter(found.values()))
    body = [
        [f"{label} ({sum(s.group in groups for s in first)})", *(cell(scores, groups) for scores in found.values())]
        for label, groups in wanted.items()
    ]
    return markdown_table(["group (cases)", *found], body)


def compared(first: Sequence[Score], second: Sequence[Score]) -> tuple[int, int, int]:
    """Return how many cases two tools answered, how many are right with the first alone, and with the second alone.

    Raises:
        ValueError: they answered other cases.
    """
    pairs = [(a.right, b.right) for a, b in zip(first, second, strict=True) if a.case == b.case]
    if len(pairs) != len(first):
        raise ValueError("the scores are of different cases")
    return len(pairs), sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs)


def _against(found: Mapping[str, Sequence[Score]]) -> list[str]:
    """Return how many more names the first tool has right in the same cases, with the exact 95 % interval."""
    (tool, first), *others = found.items()
    body = []
    for name, scores in others:
        cases, gained, lost = compared(listed(first), listed(scores))
        low, high = paired_interval(cases, gained, lost)
        share = 100 * (gained - lost) / cases if cases else 0.0
        points = f"{share:+.0f} ({100 * low:+.0f} to {100 * high:+.0f})" if cases else DASH
        won = [s.case for s, own in zip(scores, first, strict=True) if s.right and not own.right]
        body.append([name, points, str(gained), str(lost), ", ".join(won) or DASH])
    head = [
        "against", "names right, points more", f"names right with {tool} alone", "names right with the other alone",
        "all cases right with the other alone",
    ]  # fmt: skip
    return markdown_table(head, body)
