"""The text of a network file, to be read back."""

from __future__ import annotations

import math
from typing import Any

import yaml

from phnn.network.bondgraph import BondGraph


def as_yaml(graph: BondGraph, about: str = "") -> str:
    """Return the text from which `phnn.models.network_file.load_graph` reads a bond graph."""

    def plain(value: Any, *left_out: str) -> dict[str, Any]:
        said = {key: v for key, v in vars(value).items() if key not in left_out and v is not None}
        said = {key: v for key, v in said.items() if not (isinstance(v, float) and math.isinf(v))}
        return {key: list(v) if isinstance(v, tuple) else v for key, v in said.items()}

    def bond(link: Any) -> dict[str, Any]:
        said = plain(link, "start", "end") | {"from": link.start, "to": link.end}
        return said | {"type": type(link).__name__} if "ratio" in said else said

    content = {
        "about": about,
        "junctions": dict(graph.junctions),
        "elements": {e.name: plain(e, "name") | {"type": type(e).__name__} for e in graph.elements},
        "bonds": [bond(link) for link in graph.bonds],
        "modulations": {m.ratio: plain(m, "ratio") for m in graph.modulations},
        "memories": {m.name: plain(m, "name") for m in graph.memories},
        "parameters": {name: plain(p, "name") for name, p in graph.parameters.items()},
        "output": graph.output,
        "merge": graph.merge,
    }
    return yaml.safe_dump(content, allow_unicode=True, sort_keys=False)
