"""Write the figures and the page of a report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, Any

from phnn.report.document import Document
from phnn.report.domain_words import in_own_words
from phnn.report.evidence import Evidence
from phnn.report.reading import lost_parts, read_document
from phnn.report.shares import ledger_shares
from phnn.report.verdicts import ended_sentence, headline, lost_sentence
from phnn.rescue import documents, needed, warnings

if TYPE_CHECKING:
    from phnn.report.figures import Drawing
from phnn.results import Place


def write_report(document: Mapping[str, Any], evidence: Evidence, place: Place) -> None:
    """Write ``figures/*.png`` and ``report.html`` into a claimed folder, one self-contained page that opens offline.

    The page is written last: where it exists, the report is complete. The same input gives the same bytes.

    Args:
        document: the content of ``diagnosis.json``; entries that are null or absent are shown as absent.
        evidence: traces, curves and tables.
        place: where to write.

    Raises:
        InputRefused: the verdict is not one of the four, or the folder cannot be written to.
    """
    # drawing libraries take a third of a second to load: not before something is drawn
    from phnn.report.gallery import draw_gallery
    from phnn.report.page import render_page

    content = in_own_words(read_document(document))

    def page() -> tuple[Sequence[Drawing], str]:
        shares, unsupplied = ledger_shares(evidence.ledger)
        gallery = draw_gallery(content, evidence, shares)
        told = replace(content, warnings=(*content.warnings, *lost_parts(documents(warnings()))))
        return gallery.drawings, render_page(told, evidence, gallery, shares, unsupplied)

    plain: tuple[Sequence[Drawing], str] = (), ""
    drawings, text = needed("page of the report", page, plain)
    for drawing in drawings:
        (place / "figures" / drawing.file).write(drawing.png)
    (place / "report.html").write((text or _plain_page(document, content, evidence)).encode("utf-8"))


def _plain_page(document: Mapping[str, Any], content: Document, evidence: Evidence) -> str:
    """The answer without figures and tables, where the page of the report cannot be made."""
    lost = [lost_sentence(part) for part in (*content.warnings, *lost_parts(documents(warnings())))]
    lines = [headline(content, evidence.verdict_sentence), ended_sentence(content), *lost]
    paragraphs = "".join(f"<p>{escape(line)}</p>" for line in lines if line)
    whole = escape(json.dumps(document, indent=1, ensure_ascii=False))
    head = f"<!doctype html><html lang=en><meta charset=utf-8><title>Diagnosis: {content.verdict}</title>"
    return f"{head}<h1>Verdict: {content.verdict}</h1>{paragraphs}<pre>{whole}</pre></html>\n"
