"""Docstrings for Sphinx: indented examples become highlighted code, indented equations become literal text."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from textwrap import dedent
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # Examples are run where Sphinx is not installed.
    from sphinx.application import Sphinx

_INDENT = "    "
# Sections of a docstring; what is indented below them is no example.
_SECTIONS = ("Args:", "Attributes:", "Raises:", "Returns:", "Yields:", "Example:", "Examples:", "Note:")


def is_code(text: str) -> bool:
    """Whether a text is Python that does something, and no equation or table."""
    try:
        body = ast.parse(text).body
    except SyntaxError:
        return False
    return any(not isinstance(n, ast.Expr) or isinstance(n.value, ast.Call) for n in body)


def indented_blocks(lines: list[str]) -> Iterator[tuple[int, int]]:
    """First and last line (exclusive) of each indented paragraph outside sections."""
    start, section = None, False
    for i, line in enumerate([*lines, ""]):
        inside = line.startswith(_INDENT)
        if line and not inside:
            section = line.strip() in _SECTIONS
        if inside and start is None and not section and i > 0 and not lines[i - 1].strip():
            start = i
        if start is not None and not inside:
            yield start, i
            start = None


def marked(lines: list[str]) -> list[str]:
    """The lines of a docstring with a directive before each indented block."""
    found, done = [], 0
    for first, last in indented_blocks(lines):
        block = lines[first:last]
        directive = ".. code-block:: " + ("python" if is_code(dedent("\n".join(block))) else "text")
        found += [*lines[done:first], directive, "", *block, ""]
        done = last
    return [*found, *lines[done:]]


def examples(docstring: str) -> list[str]:
    """The examples of a docstring that are code."""
    lines = docstring.splitlines()
    blocks = (dedent("\n".join(lines[a:b])).strip() for a, b in indented_blocks(lines))
    return [b for b in blocks if is_code(b)]


def _process(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    # numpy and torch write in other formats.
    lines[:] = marked(lines)


def setup(app: Sphinx) -> dict[str, Any]:
    """Treat docstrings before napoleon does."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _process, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
