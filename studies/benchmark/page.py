"""The page of a benchmark: wrong answers first, then the figures of all tools, then where each is better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from phnn.report.formatting import DASH, markdown_table, number
from studies.benchmark.score import Score
from studies.benchmark.settings import GROUPS
from studies.benchmark.tally import Difference, difference, listed, summary
from studies.proof.page import Rate

Found = Mapping[str, Sequence[Score]]


def page(found: Found) -> str:
    """Markdown.

    Args:
        found: scores by tool; the first tool is the one that others are compared with.
    """
    tool = next(iter(found))
    lines = [f"## Wrong answers of {tool}", "", *_wrong(found[tool]), ""]
    lines += ["## All tools", "", *leaderboard({name: summary(scores) for name, scores in found.items()}), ""]
    lines += ["## Rightly claimed, with exact 95 % intervals", "", *_groups(found), ""]
    if len(found) > 1:
        lines += [f"## {tool} against each", "", *_against(found), ""]
    return "\n".join(lines)


def leaderboard(figures: Mapping[str, Mapping[str, float]]) -> list[str]:
    """The lines of a table: a row for each figure, a column for each tool."""
    labels = next(iter(figures.values())).keys()
    body = [[label, *(_shown(of[label]) for of in figures.values())] for label in labels]
    return markdown_table(["", *figures], body)


def _shown(value: float) -> str:
    """A figure in a table; counts are whole numbers."""
    if isinstance(value, int):
        return str(value)
    return "∞" if value == np.inf else number(value) if np.isfinite(value) else DASH


def _wrong(scores: Sequence[Score]) -> list[str]:
    """A row for each case that is not right; a sentence where there is none."""
    rows = [
        [s.case, s.group, s.strength, s.plan, _names(s.truth), "no answer" if s.failed else _names(s.claimed)]
        for s in scores
        if not s.right
    ]
    head = ["case", "group", "strength", "recordings", "concealed", "claimed"]
    return markdown_table(head, rows) if rows else [f"None of {len(scores)} answers is wrong."]


def _names(names: Sequence[str]) -> str:
    return " + ".join(names) or "nothing"


def _groups(found: Found) -> list[str]:
    wanted = [*GROUPS, "same, other, pair"]

    def chosen(scores: Sequence[Score], group: str) -> list[Score]:
        return listed(scores) if group == wanted[-1] else [s for s in scores if s.group == group]

    def cell(scores: Sequence[Score]) -> str:
        rate = Rate("", sum(s.right for s in scores), len(scores), "")
        low, high = rate.interval
        return f"{100 * rate.share:.0f} % ({100 * low:.0f} to {100 * high:.0f})" if scores else DASH

    first = next(iter(found.values()))
    body = [
        [f"{group} ({len(chosen(first, group))})", *(cell(chosen(scores, group)) for scores in found.values())]
        for group in wanted
    ]
    return markdown_table(["group (cases)", *found], body)


def _against(found: Found) -> list[str]:
    """How many more names the first tool has right in the same cases, with the exact 95 % interval."""
    (tool, first), *others = found.items()
    body = []
    for name, scores in others:
        of = difference(listed(first), listed(scores))
        won = [s.case for s, own in zip(scores, first, strict=True) if s.right and not own.right]
        body.append([name, _points(of), str(of.gained), str(of.lost), ", ".join(won) or DASH])
    head = [
        "against",
        "names right, points more",
        f"names right with {tool} alone",
        "names right with the other alone",
        "all cases right with the other alone",
    ]
    return markdown_table(head, body)


def _points(of: Difference) -> str:
    low, high = of.interval
    return f"{100 * of.share:+.0f} ({100 * low:+.0f} to {100 * high:+.0f})" if of.cases else DASH
