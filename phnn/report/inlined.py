"""Pictures as parts of a page."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

from markupsafe import Markup

if TYPE_CHECKING:
    # Pages without pictures need no drawing library.
    from phnn.report.figures import Drawing


def image(drawing: Drawing) -> Markup:
    """The picture as part of the page, sized so that a point of print is a point on the screen."""
    width, height = (int.from_bytes(drawing.png[start : start + 4], "big") for start in (16, 20))
    data = base64.b64encode(drawing.png).decode("ascii")
    return Markup('<img src="data:image/png;base64,{}" alt="{}" width="{}" height="{}">').format(
        data, drawing.alt, round(width * 96 / 150), round(height * 96 / 150)
    )


def svg_link(drawing: Drawing) -> str:
    """The picture as SVG, in a link."""
    return "data:image/svg+xml;base64," + base64.b64encode(drawing.svg).decode("ascii")
