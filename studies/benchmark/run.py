"""Answers of a tool to a benchmark, and the scores of answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from phnn.errors import InputRefused, SolverFailed
from phnn.intake.files import named_file
from phnn.intake.json_file import load_json
from phnn.intake.limits import LIMITS
from phnn.parallel import executor
from phnn.results import Place
from studies.benchmark.answer import FILE, Answer, read_answer, write_answer
from studies.benchmark.folders import card_of, case_folder, digest_of, opened
from studies.benchmark.page import page
from studies.benchmark.score import Score, scored
from studies.benchmark.tally import by_group, summary
from studies.benchmark.time_limit import limited
from studies.benchmark.tools import Tool, tool
from studies.results import write_results

Say = Callable[[str], None]
_TOOL = "tool.json"
# Of everything that a tool draws.
_SEED = 0
ANSWERS, SCORES = ("answers", _TOOL), ("scores.csv", "groups.csv", "leaderboard.csv", "leaderboard.md")


def answer_all(
    folder: Path, name: str, place: Place, where: str, say: Say, first: int | None = None, training: Path | None = None,
    limit: float | None = None,
) -> None:  # fmt: skip
    """Let a tool answer all cases of a benchmark; what was answered before is kept.

    Args:
        folder: of the benchmark; name: of the tool.
        place: claimed for the answers.
        where: see `phnn.parallel.executor`; say: called with a line of progress.
        first: so many cases alone; all if left out.
        training: see `studies.benchmark.tools.tool`.
        limit: processor seconds of one case, after which the tool has no answer to it; None for as many as it takes.

    Raises:
        InputRefused: no benchmark, no such tool, or an executor that cannot keep a limit.
    """
    card = card_of(folder)
    (place / "answers").own_folder()
    (place / _TOOL).write_json({"tool": name, "seed": _SEED, "sha256": card["sha256"], "limit": limit})
    todo = [c for c in card["cases"][:first] if not (place / "answers" / c / FILE).path.exists()]
    work = partial(_answered, folder, partial(tool, name, training), place, limit)
    for count, (index, failed) in enumerate(executor(where).each(work, todo), start=1):
        say(f"{name}: {count} of {len(todo)}, {todo[index]}" + (f": no answer, {failed}" if failed else ""))


def _answered(folder: Path, found_tool: Callable[[], Tool], place: Place, limit: float | None, case: str) -> str:
    """Answer one case; returns why the tool has no answer, empty where it has one."""
    known, answers, began = case_folder(folder, case), found_tool(), time.process_time()
    try:
        with limited(limit):
            found = answers(known, _SEED)
    except SolverFailed as error:
        # Anything else is a fault of the tool's code, which ends the run.
        found = Answer({}, failed=str(error))
    found = replace(found, seconds=time.process_time() - began)
    write_answer(found, place / "answers" / case, _times(known / "exam"))
    return found.failed


def _times(exam: Path) -> dict[str, NDArray[np.float64]]:
    return {path.stem: pd.read_csv(path)["time_s"].to_numpy(dtype=float) for path in sorted(exam.glob("*.csv"))}


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
    if (answers / _TOOL).exists() and _benchmark_of(answers) != card["sha256"]:
        raise InputRefused(f"{answers}: these answers are to another benchmark than {folder}: answer this one")
    home = answers / "answers" if (answers / "answers").is_dir() else answers
    found = []
    for case in card["cases"][:first]:
        entry, sealed, exam = opened(folder, case)
        try:
            found.append(scored(entry, sealed, exam, read_answer(home / case)))
        except InputRefused as error:
            raise InputRefused(f"{answers}: {case}: {error}") from error
    return found


def _benchmark_of(answers: Path) -> str:
    """The hash of the benchmark that a tool of phnn's answered."""
    content = load_json(
        named_file(answers / _TOOL, (answers,)), LIMITS.json_bytes, "the tool of answers", "answer anew"
    )
    return str(content.get("sha256")) if isinstance(content, dict) else ""


def write_scores(found: Mapping[str, Sequence[Score]], place: Place) -> str:
    """Write the scores of tools as tables; returns their page as markdown.

    Args:
        found: by tool; place: claimed for them.
    """
    rows = pd.DataFrame([{"tool": name, **_flat(s)} for name, scores in found.items() for s in scores])
    groups = pd.concat([by_group(scores).assign(tool=name) for name, scores in found.items()])
    figures = {name: summary(scores) for name, scores in found.items()}
    table = pd.DataFrame(figures)
    texts = {
        "scores.csv": rows.to_csv(index=False),
        "groups.csv": groups.to_csv(index=False),
        "leaderboard.csv": table.to_csv(index_label="figure"),
        "leaderboard.md": page(found),
    }
    write_results(place, texts)
    return texts["leaderboard.md"]


def _flat(score: Score) -> dict[str, object]:
    return {n: "+".join(v) if isinstance(v, tuple) else v for n, v in asdict(score).items()}
