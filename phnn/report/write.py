"""Write the figures and the page of a report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from phnn.report.document import read_document
from phnn.report.evidence import Evidence
from phnn.report.files import write_atomic
from phnn.report.shares import ledger_shares


def write_report(document: Mapping[str, Any], evidence: Evidence, folder: Path) -> None:
    """Write ``folder/figures/*.png`` and ``folder/report.html``, one self-contained page that opens offline.

    Figures that an earlier report left in ``figures/`` and this one does not have are removed; other files stay.
    The page is written last: where it exists, the report is complete. The same input gives the same bytes.

    Args:
        document: the content of ``diagnosis.json``; entries that are null or absent are shown as absent.
        evidence: traces, curves and tables.
        folder: where to write; made where it does not exist.

    Raises:
        InputRefused: the verdict is none of the four, or the folder cannot be written to.
    """
    # drawing libraries take a third of a second to load: not before something is drawn
    from phnn.report.gallery import OWN_FILES, draw_gallery
    from phnn.report.page import render_page

    content = read_document(document)
    shares, unsupplied = ledger_shares(evidence.ledger)
    gallery = draw_gallery(content, evidence, shares)
    page = render_page(content, evidence, gallery, shares, unsupplied)
    figures = Path(folder) / "figures"
    for drawing in gallery.drawings:
        write_atomic(figures / drawing.file, drawing.png)
    current = {drawing.file for drawing in gallery.drawings}
    for old in figures.glob("*.png"):
        if OWN_FILES.fullmatch(old.name) and old.name not in current:
            old.unlink(missing_ok=True)
    write_atomic(Path(folder) / "report.html", page.encode("utf-8"))
