"""A bond graph as the yaml text that `phnn.models.network_file` reads."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from phnn.errors import InputRefused
from phnn.network.bondgraph import Bond, BondGraph, R, Se, Sf
from phnn.network.bondgraph.description import Element, Link
from phnn.network.elements import ModulatorState
from phnn.parameters import Parameter, positive

# Words that yaml takes for something else than a text.
_OTHER = ("on", "off", "yes", "no", "true", "false", "null", "nan", "inf")


def as_yaml(graph: BondGraph, about: str = "") -> str:
    """The text of a network file, one line an element, bond and parameter.

    Args:
        about: a line that says what the network is.

    Raises:
        InputRefused: a law is a torch module, which has no name.
    """
    lines = [f"about: {_scalar(about)}"] if about else []
    lines += [f"junctions: {_flow(graph.junctions)}", "elements:"]
    lines += [f"  {_scalar(e.name)}: {_flow(_element(e))}" for e in graph.elements]
    lines += ["bonds:", *(f"  - {_flow(_bond(b))}" for b in graph.bonds)] if graph.bonds else []
    if graph.modulations:
        said = {m.ratio: {"by": m.by, "law": m.law, "parameters": list(m.parameters)} for m in graph.modulations}
        lines += ["modulations:", *(f"  {_scalar(n)}: {_flow(m)}" for n, m in said.items())]
    if graph.memories:
        lines += ["memories:", *(f"  {_scalar(m.name)}: {_flow(_memory(m))}" for m in graph.memories)]
    lines += ["parameters:", *(f"  {_scalar(n)}: {_flow(_parameter(p))}" for n, p in graph.parameters.items())]
    lines.append(f"output: {_scalar(graph.output)}")
    return "\n".join([*lines, *([] if graph.merge else ["merge: false"])]) + "\n"


def _element(element: Element) -> dict[str, Any]:
    if not isinstance(element.law, str):
        raise InputRefused(f"the law of {element.name} is a torch module: a file holds laws that have a name")
    said: dict[str, Any] = {"type": type(element).__name__, "junction": element.junction, "law": element.law}
    said["parameters"] = list(element.parameters)
    if isinstance(element, R):
        said["direction"] = element.direction
        return said if element.reads is None else {**said, "reads": element.reads}
    said["unit"] = element.unit
    if isinstance(element, Se | Sf):
        if element.sign < 0:
            said["sign"] = element.sign
        return {k: v for k, v in said.items() if element.law != "linear" or k not in ("law", "parameters")}
    return said


def _memory(memory: ModulatorState) -> dict[str, Any]:
    of = {"of": list(memory.of)} if memory.of else {}
    return {"law": memory.law, "parameters": list(memory.parameters), **of, "unit": memory.unit}


def _bond(bond: Link) -> dict[str, Any]:
    ends = {"from": bond.start, "to": bond.end}
    return ends if isinstance(bond, Bond) else {"type": type(bond).__name__, **ends, "ratio": bond.ratio}


def _parameter(parameter: Parameter) -> dict[str, Any]:
    p, said = parameter, {"value": parameter.value, "unit": parameter.unit}
    usual = Parameter(p.name, p.value, p.unit)
    if p.positive:
        said["positive"] = True
        usual = positive(p.name, p.value, p.unit)
    for key in ("lower", "upper", "typical", "fixed", "description"):
        value = getattr(p, key)
        if value != getattr(usual, key) and not (isinstance(value, float) and math.isinf(value)):
            said[key] = value
    return said


def _flow(content: Mapping[str, Any]) -> str:
    return "{" + ", ".join(f"{_scalar(key)}: {_scalar(value)}" for key, value in content.items()) + "}"


def _scalar(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(map(_scalar, value)) + "]"
    if isinstance(value, str):
        plain = value.replace("_", "").replace(" ", "").replace("/", "").isalnum() and not value[0].isdigit()
        return value if plain and value.lower() not in _OTHER else json.dumps(value, ensure_ascii=False)
    return json.dumps(value)
