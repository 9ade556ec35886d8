"""A network of one's own: a bond graph in a yaml file, in the words of `phnn.network.bondgraph`.

junctions: {mass: 1}                                # 0: common effort, 1: common flow
elements:                                           # storages become states in this order
  q:      {type: C, junction: mass, law: spring, parameters: [k], unit: m}
  p:      {type: I, junction: mass, law: capacitor, parameters: [m], unit: kg m/s}
  damper: {type: R, junction: mass, law: linear, parameters: [b], direction: resistance}
  force:  {type: Se, junction: mass, unit: N}
bonds: []                                           # {from: a, to: b}, {type: TF, from: a, to: b, ratio: alpha}
modulations: {}                                     # alpha: {by: theta, law: affine, parameters: [kappa, T_s]}
memories: {}                                        # theta: {law: thermal, parameters: [C_T, R_T, T_a, T_ref], unit: K}
parameters:
  k: {value: 8.0, unit: N/m, positive: true}        # lower, upper, typical, fixed, description
  m: {value: 2.0, unit: kg, positive: true}
  b: {value: 0.5, unit: N s/m, positive: true}
output: q
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from phnn.errors import InputRefused, StructureViolated
from phnn.intake import LIMITS, load_yaml, named_file
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.models.actuator import hrc
from phnn.network.bondgraph import GY, TF, Bond, BondGraph, C, I, R, Se, Sf
from phnn.network.bondgraph.description import DIRECTIONS, Element, Link
from phnn.network.elements import Modulation, ModulatorState, Network, Ratio
from phnn.parameters import Parameter, positive
from phnn.recordings.manifest import READY, choice, flag, label, mapping, number, shown
from phnn.results import printable

_TOP = ("about", "junctions", "elements", "bonds", "modulations", "memories", "parameters", "output", "merge")
_PARAMETER = ("value", "unit", "positive", "lower", "upper", "typical", "fixed", "description")
_NUMBERS = ("lower", "upper", "typical")
# By type: the class, and the laws that there are.
_ELEMENTS: dict[str, tuple[type[Any], Mapping[str, Any]]] = {
    "C": (C, STORAGE_LAWS), "I": (I, STORAGE_LAWS), "R": (R, RESISTOR_LAWS), "Se": (Se, PORT_LAWS),
    "Sf": (Sf, PORT_LAWS),
}  # fmt: skip
# How the fields of an element are read; its law comes with its parameters.
_FIELDS: dict[str, Callable[[Any, str], Any]] = {
    "junction": label, "unit": label, "reads": label, "sign": lambda value, where: value,
    "direction": lambda value, where: choice(value, DIRECTIONS, where),
}  # fmt: skip


def load_network(path: Path | str) -> Network:
    """Return the network of a bond graph in a file.

    Raises:
        InputRefused: as `load_graph`, or a graph without a network: names the elements and the remedy.
    """
    graph = load_graph(path)
    try:
        return graph.network()
    except (StructureViolated, InputRefused) as error:
        raise InputRefused(f"{printable(Path(path).name)}: {error}") from error


def load_graph(path: Path | str) -> BondGraph:
    """Return the bond graph in a file.

    Raises:
        InputRefused: a file that cannot be read, or says something that is not understood; names file, key, value and
            remedy.
    """
    source = named_file(Path(path), absent="give the path of a network's yaml file")
    return _graph(load_yaml(source), source.name)


def ready(name: str, values: Mapping[str, float] | None = None, units: tuple[str, str] = ("1", "1")) -> Network:
    """Return a ready model by its name, one of `phnn.recordings.manifest.READY`.

        motor = phnn.models.ready("motor", {"R": 2.1})

    Args:
        values: of its parameters, SI; those left out only set the shape, and an identification scales them.
        units: of input and output, SI, for a model of any input and output.

    Raises:
        InputRefused: no such model; the message lists all.
    """
    if name == "piezo_actuator":
        return hrc(2, dict(values or {}))
    table = mapping(load_yaml(named_file(Path(__file__).with_name("ready.yaml"))), "ready.yaml")
    if name not in table:
        raise InputRefused(f"model {name!r}: the ready models are {', '.join(READY)}")
    content = {key: entry for key, entry in table[name].items() if key != "equation"}
    first, last = units
    per = "" if first == "1" else f"/({first})" if set(first) & {" ", "/"} else f"/{first}"
    known = {"input": first, "output": last, "output/input": f"{last}{per}"}
    for entry in (*content["elements"].values(), *content["parameters"].values()):
        entry |= {"unit": known[entry["unit"]]} if entry.get("unit") in known else {}
    return _graph(content, name).network().with_values(values or {})


def _graph(content: Any, name: str) -> BondGraph:
    """Return the bond graph that a mapping describes; raises as `load_graph`."""
    top = mapping({} if content is None else content, name, _TOP)
    for key in ("junctions", "elements", "parameters", "output"):
        if key not in top:
            raise InputRefused(f"{name}: no {key!r}: a network has {', '.join(_TOP[1:])}")
    junctions = mapping(top["junctions"], f"{name}: junctions")
    listed = top.get("bonds", [])
    if not isinstance(listed, list):
        raise InputRefused(
            f"{name}: bonds: expected a list, found {shown(listed)}: write `- {{from: a, to: b}}` entries"
        )
    for key in ("junctions", "elements", "bonds", "parameters", "modulations", "memories"):
        if isinstance(entry := top.get(key), list | Mapping) and len(entry) > LIMITS.elements:
            raise InputRefused(
                f"{name}: {key}: there are {len(entry)}, at most {LIMITS.elements} are accepted: split the network"
            )
    try:
        return BondGraph(
            {label(j, f"{name}: junctions"): kind for j, kind in junctions.items()},
            tuple(_each(top, "elements", _element, name)),
            tuple(_bond(entry, f"{name}: bonds[{i}]") for i, entry in enumerate(listed)),
            {p.name: p for p in _each(top, "parameters", _parameter, name)},
            label(top["output"], f"{name}: output"),
            flag(top.get("merge", True), f"{name}: merge"),
            tuple(_each(top, "modulations", _modulation, name)),
            tuple(_each(top, "memories", _memory, name)),
        )
    except StructureViolated as error:
        raise InputRefused(f"{name}: {error}") from error


def _element(name: str, entry: Any, where: str) -> Element:
    content = mapping(entry, where)
    make, laws = _ELEMENTS[choice(content.get("type"), tuple(_ELEMENTS), f"{where}: type")]
    keys = ["type", *(f.name for f in fields(make) if f.name != "name")]
    if "junction" not in content:
        raise InputRefused(f"{where}: no `junction`: name the junction that it hangs on")
    mapping(content, where, keys)
    law, parameters = _law(content, laws, where)
    # The classes have the units of an actuator where none is given.
    given: dict[str, Any] = ({"unit": "1"} if "unit" in keys else {}) | dict(content)
    further = {key: read(given[key], f"{where}: {key}") for key, read in _FIELDS.items() if key in given}
    element: Element = make(name, law=law, parameters=parameters, **further)
    return element


def _law(content: Mapping[str, Any], laws: Mapping[str, Any], where: str) -> tuple[str, tuple[str, ...]]:
    """Return a law's name, the first there is where none is given, and the names of its parameters."""
    law = choice(content.get("law", next(iter(laws))), tuple(laws), f"{where}: law")
    given = content.get("parameters", [])
    names = given if isinstance(given, list) else [given]
    parameters = tuple(label(n, f"{where}: parameters") for n in names)
    wanted = len(laws[law].example)
    if len(parameters) != wanted:
        raise InputRefused(
            f"{where}: parameters: the law {law} takes {wanted}, {len(parameters)} are given: name {wanted} in a list"
        )
    return law, parameters


def _each(top: Mapping[str, Any], key: str, make: Callable[[str, Any, str], Any], file: str) -> list[Any]:
    given = {label(n, f"{file}: {key}"): content for n, content in mapping(top.get(key, {}), f"{file}: {key}").items()}
    return [make(n, content, f"{file}: {key}: {n}") for n, content in given.items()]


def _modulation(ratio: str, entry: Any, where: str) -> Modulation:
    content = mapping(entry, where, ("by", "law", "parameters"))
    if "by" not in content:
        raise InputRefused(f"{where}: no `by`: name the storage or memory that the ratio follows")
    return Modulation(ratio, label(content["by"], f"{where}: by"), *_law(content, FACTOR_LAWS, where))


def _memory(name: str, entry: Any, where: str) -> ModulatorState:
    content = mapping(entry, where, ("law", "parameters", "of", "unit"))
    law, parameters = _law(content, MEMORY_LAWS, where)
    of = content.get("of", [])
    drives = tuple(label(n, f"{where}: of") for n in (of if isinstance(of, list) else [of]))
    return ModulatorState(name, law, parameters, drives, label(content.get("unit", "1"), f"{where}: unit"))


def _bond(entry: Any, where: str) -> Link:
    content = mapping(entry, where)
    kind = choice(content.get("type", "bond"), ("bond", "TF", "GY"), f"{where}: type")
    mapping(content, where, ("type", "from", "to") if kind == "bond" else ("type", "from", "to", "ratio"))
    for key in ("from", "to"):
        if key not in content:
            raise InputRefused(f"{where}: no `{key}`: a bond goes from one junction to another")
    start, end = (label(content[key], f"{where}: {key}") for key in ("from", "to"))
    if kind == "bond":
        return Bond(start, end)
    ratio = content.get("ratio", 1.0)
    given: Ratio = label(ratio, f"{where}: ratio") if isinstance(ratio, str) else number(ratio, f"{where}: ratio")
    return TF(start, end, given) if kind == "TF" else GY(start, end, given)


def _parameter(name: str, entry: Any, where: str) -> Parameter:
    content = mapping({"value": entry} if isinstance(entry, int | float) else entry, where, _PARAMETER)
    if "value" not in content:
        raise InputRefused(f"{where}: no value: write {{value: ..., unit: ...}} in SI units")
    value = number(content["value"], f"{where}: value")
    unit = label(content.get("unit", "1"), f"{where}: unit")
    about = printable(str(content.get("description", "")))
    numbers: dict[str, Any] = {key: number(content[key], f"{where}: {key}") for key in _NUMBERS if key in content}
    above_zero = flag(content.get("positive", False), f"{where}: positive")
    if above_zero:
        number(value, f"{where}: value", above=0.0)
    base = positive(name, value, unit, about) if above_zero else Parameter(name, value, unit, description=about)
    try:
        return replace(base, fixed=flag(content.get("fixed", False), f"{where}: fixed"), **numbers)
    except InputRefused as error:
        raise InputRefused(f"{where}: {error}") from error
