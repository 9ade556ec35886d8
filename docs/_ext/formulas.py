"""Formulas as inline SVG, drawn by the function that draws them in reports: no script is loaded from elsewhere."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

from phnn.report.page import formula

_LOG = logging.getLogger(__name__)


def _block(self: Any, node: nodes.math_block) -> None:
    """Write a displayed formula; a formula that cannot be drawn is a warning."""
    drawn = str(formula(node.astext()))
    if "<svg" not in drawn:
        _LOG.warning("formula cannot be drawn: %s", node.astext(), location=node)
    self.body.append(drawn)
    raise nodes.SkipNode


def _inline(self: Any, node: nodes.math) -> None:
    """Write a formula within a line."""
    drawn = str(formula(node.astext()))
    if "<svg" not in drawn:
        _LOG.warning("formula cannot be drawn: %s", node.astext(), location=node)
    self.body.append(drawn.replace("<div", "<span").replace("</div>", "</span>").replace("equation", "inline-equation"))
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer ``svg``."""
    app.add_html_math_renderer("svg", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
