"""Results of a study in its folder: pages and tables as text, documents as json, figures as pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from phnn.output import Place
from phnn.report.figures import Drawing

_FIGURES = "figures"


def write_results(
    place: Place,
    texts: Mapping[str, str],
    documents: Mapping[str, Any] | None = None,
    drawings: Sequence[Drawing] = (),
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


def figure_lines(drawings: Sequence[Drawing]) -> list[str]:
    """The figures as the last part of a page of markdown; empty without figures."""
    if not drawings:
        return []
    return ["## Figures", "", *(line for d in drawings for line in (f"![{d.alt}]({_FIGURES}/{d.file})", ""))]
