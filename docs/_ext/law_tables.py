"""Sphinx extension: ``{laws} storage`` lists the laws of a kind with the order of their parameters, ``{kinds}`` the
kinds of effects."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from phnn import laws
from phnn.effects import catalogue, kinds

# By kind: the table, the function whose parameters are listed, and its arguments before them.
_KINDS: dict[str, tuple[dict[str, Any], str, int]] = {
    "storage": (laws.STORAGE_LAWS, "mean_effort", 2),
    "resistor": (laws.RESISTOR_LAWS, "flow", 2),
    "port": (laws.PORT_LAWS, "action", 1),
    "modulation": (laws.FACTOR_LAWS, "factor", 1),
    "memory": (laws.MEMORY_LAWS, "rate", 2),
}


def table(kind: str) -> str:
    """A Markdown table of the laws of a kind; a vertical bar of a formula is escaped."""
    laws_of_kind, function, leading = _KINDS[kind]
    lines = ["| law | parameters, in this order | what it is |", "|---|---|---|"]
    for name, law in laws_of_kind.items():
        called: Callable[..., Any] = getattr(law, function)
        names = list(inspect.signature(called).parameters)[leading:]
        parameters = [f"`{n}` ({d.words})" for n, d in zip(names, law.domains, strict=True)]
        lines.append(f"| `{name}` | {', '.join(parameters) or '–'} | {_first_line(called)} |")
    return "\n".join(lines)


def _first_line(function: Callable[..., Any]) -> str:
    return (inspect.getdoc(function) or "").split("\n")[0].replace("``", "`").replace("|", r"\|")


def kind_table() -> str:
    """A Markdown table of the kinds of effects in `phnn.effects.kinds`."""
    lines = ["| kind | location | what it is | effects of the catalogue |", "|---|---|---|---|"]
    for name, kind in vars(kinds).items():
        if isinstance(kind, kinds.Kind):
            of_kind = [f"`{n}`" for n, effect in catalogue().items() if effect.kind == kind]
            lines.append(f"| `{name}` | {kind.location} | {kind.name} | {', '.join(of_kind) or '–'} |")
    return "\n".join(lines)


class LawTable(SphinxDirective):
    """The table of one kind of law."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The parsed table."""
        return self.parse_text_to_nodes(table(self.arguments[0]))


class KindTable(SphinxDirective):
    """The table of the kinds of effects."""

    def run(self) -> list[nodes.Node]:
        """The parsed table."""
        return self.parse_text_to_nodes(kind_table())


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the directives."""
    app.add_directive("laws", LawTable)
    app.add_directive("kinds", KindTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
