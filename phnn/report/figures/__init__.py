"""The figures of a report; each function takes values and returns a matplotlib figure."""

from __future__ import annotations

from phnn.report.figures.fingerprint import draw_fingerprint
from phnn.report.figures.ledger import draw_ledger
from phnn.report.figures.locations import draw_locations
from phnn.report.figures.overview import draw_overview
from phnn.report.figures.picture import draw_picture
from phnn.report.figures.recording import draw_recording
from phnn.report.figures.style import RC, Drawing, png, svg

__all__ = [
    "RC",
    "Drawing",
    "draw_fingerprint",
    "draw_ledger",
    "draw_locations",
    "draw_overview",
    "draw_picture",
    "draw_recording",
    "png",
    "svg",
]
