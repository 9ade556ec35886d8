"""Results of a study in its folder: pages and tables as text, documents as json, figures as pictures."""

from __future__ import annotations

import subprocess
from collections.abc import Collection, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused
from phnn.report.figures.style import Drawing
from phnn.results import Place, write_atomic

_FIGURES = "figures"


def write_results(
    place: Place, texts: Mapping[str, str], documents: Mapping[str, Any] | None = None, drawings: Sequence[Drawing] = ()
) -> None:
    """Write results into a claimed folder.

    Args:
        texts: markdown, html and csv by the names of their files; the last one stands for a finished study.
        documents: plain data by the names of their files; numbers may be infinite.
        drawings: their pictures go into ``figures/``.
    """
    for drawing in drawings:
        (place / _FIGURES / drawing.file).write(drawing.png)
    for name, document in (documents or {}).items():
        (place / name).write_json(document)
    for name, text in texts.items():
        (place / name).write(text.encode())


def fill(page: Path, name: str, text: str) -> None:
    """Put a table into a page of markdown, between the lines ``<!-- begin NAME -->`` and ``<!-- end NAME -->``.

    Raises:
        InputRefused: the page is absent, or has no such lines.
    """
    write_atomic(page, filled(page, name, text).encode())


def filled(page: Path, name: str, text: str) -> str:
    """The page with a table in its place. Raises InputRefused as `fill` does."""
    begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
    try:
        before = page.read_text(encoding="utf-8")
    except OSError as error:
        raise InputRefused(f"{page}: cannot be read ({error.strerror}): name a page of markdown") from error
    head, found, rest = before.partition(begin)
    _, closed, tail = rest.partition(end)
    if not found or not closed:
        raise InputRefused(f"{page}: has no lines {begin.strip()} and {end}: write them where the table belongs")
    return f"{head}{begin}\n{text.strip()}\n\n{end}{tail}"


def stamped(text: str, commits: Collection[str] = ()) -> str:
    """A table with the commits that made its numbers below it; the present one where none is given."""
    return f"{text.strip()}\n\n*Made with commit {', '.join(sorted(commits)) or commit()} on {date.today()}.*"


def commit() -> str:
    """The short name of the commit whose code runs, with a plus where files differ from it."""
    words = ("git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=8", "--exclude=*", "--dirty=+")
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def figure_lines(drawings: Sequence[Drawing]) -> list[str]:
    """The figures as the last part of a page of markdown; empty without figures."""
    lines = (line for d in drawings for line in (f"![{d.alt}]({_FIGURES}/{d.file})", ""))
    return ["## Figures", "", *lines] if drawings else []
