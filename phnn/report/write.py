"""Write the figures and the page of a report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phnn.report.domain_words import in_own_words
from phnn.report.evidence import Evidence
from phnn.report.reading import read_document
from phnn.report.shares import ledger_shares
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
    shares, unsupplied = ledger_shares(evidence.ledger)
    gallery = draw_gallery(content, evidence, shares)
    page = render_page(content, evidence, gallery, shares, unsupplied)
    for drawing in gallery.drawings:
        (place / "figures" / drawing.file).write(drawing.png)
    (place / "report.html").write(page.encode("utf-8"))
