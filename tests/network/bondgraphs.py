"""Random linear bond graphs, their frequency response from the constitutive equations alone, and their text."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import yaml

from phnn.errors import StructureViolated
from phnn.laws import PORT_LAWS
from phnn.network import Network, PortHamiltonianSystem
from phnn.network.bondgraph import GY, TF, Bond, BondGraph, C, I, R, Se, Sf
from phnn.parameters import Parameter, as_table, positive


def random_graph(seed: int) -> BondGraph:
    """A tree of up to four junctions with linear elements; many such graphs have conflicts."""
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 5))
    junctions = {f"j{k}": int(random.integers(2)) for k in range(count)}
    parameters: list[Parameter] = []
    bonds: list[Bond | TF | GY] = []
    for k in range(1, count):
        ends = [f"j{random.integers(k)}", f"j{k}"]
        random.shuffle(ends)
        kind = random.choice(["bond", "number", "name", "gyrator"], p=[0.55, 0.15, 0.15, 0.15])
        if kind == "bond":
            bonds.append(Bond(*ends))
        elif kind == "gyrator":
            bonds.append(GY(*ends, 1.0 if random.random() < 0.5 else -0.5))
        else:
            ratio = float(random.choice([-1.0, 2.0])) if kind == "number" else f"r{k}"
            if isinstance(ratio, str):
                parameters.append(Parameter(ratio, float(random.uniform(0.3, 2.0))))
            bonds.append(TF(*ends, ratio))
    elements: list[C | I | R | Se | Sf] = []
    for k in range(int(random.integers(2, 6))):
        on, kind = f"j{random.integers(count)}", random.choice(["C", "I", "R"])
        name = f"x{k}"
        parameters.append(positive(f"v{k}", float(random.uniform(0.3, 3.0)), "1"))
        if kind == "R":
            direction = str(random.choice(["conductance", "resistance"]))
            elements.append(R(name, on, "linear", (f"v{k}",), direction))
        else:
            law = str(random.choice(["capacitor", "spring"]))
            elements.append((C if kind == "C" else I)(name, on, law, (f"v{k}",)))
    stores = [e.name for e in elements if isinstance(e, C | I)]
    if not stores:
        parameters.append(positive("v", 0.7, "1"))
        elements.append(C("q", "j0", "spring", ("v",)))
        stores = ["q"]
    source = Se if random.random() < 0.5 else Sf
    elements.append(source("u", f"j{random.integers(count)}", "1", int(random.choice([1, -1]))))
    return BondGraph(
        junctions, tuple(elements), tuple(bonds), as_table(parameters), stores[int(random.integers(len(stores)))]
    )


def solvable_graph(seed: int) -> BondGraph:
    """The first of a sequence of random graphs that has a network with or without merging; about every fourth has."""
    for number in np.random.default_rng(seed).integers(2**31, size=200):
        graph = random_graph(int(number))
        try:
            replace(graph, merge=False).network()
        except StructureViolated:
            continue
        return graph
    raise AssertionError("none of 200 random graphs has a network")


def response(graph: BondGraph, s: complex) -> tuple[complex, complex]:
    """Output state and port answer per unit of input at ``s``, every effort and flow an unknown.

    The output is that of a graph without merging: its own energy variable.
    """
    columns: dict[str, int] = {}

    def at(name: str) -> int:
        return columns.setdefault(name, len(columns))

    value = {n: p.value for n, p in graph.parameters.items()}
    rows: list[tuple[dict[int, complex], complex]] = []
    ends: dict[str, list[tuple[int, int, int]]] = {j: [] for j in graph.junctions}
    for element in graph.elements:
        e, f = at("e " + element.name), at("f " + element.name)
        ends[element.junction].append((e, f, 1 if isinstance(element, Se | Sf) else -1))
        if isinstance(element, Se | Sf):
            rows.append(({e if isinstance(element, Se) else f: 1.0}, element.sign))
        elif isinstance(element, R):
            given, taken = (f, e) if element.direction == "conductance" else (e, f)
            rows.append(({given: 1.0, taken: -value[element.parameters[0]]}, 0.0))
        else:
            moving, force = (f, e) if isinstance(element, C) else (e, f)
            kappa = value[element.parameters[0]] ** (1 if element.law == "spring" else -1)
            rows.append(({force: s, moving: -kappa}, 0.0))
    for i, bond in enumerate(graph.bonds):
        e1, f1, e2, f2 = (at(f"{v} {i}") for v in ("e1", "f1", "e2", "f2"))
        ends[bond.start].append((e1, f1, -1))
        ends[bond.end].append((e2, f2, 1))
        given = getattr(bond, "ratio", 1.0)
        ratio = value[given] if isinstance(given, str) else given
        pairs = ((e1, f2), (e2, f1)) if isinstance(bond, GY) else ((e1, e2), (f2, f1))
        rows += [({left: 1.0, right: -ratio}, 0.0) for left, right in pairs]
    for name, kind in graph.junctions.items():
        common = [e if kind == 0 else f for e, f, _ in ends[name]]
        rows += [({common[0]: 1.0, other: -1.0}, 0.0) for other in common[1:]]
        if ends[name]:
            rows.append(({(f if kind == 0 else e): float(sign) for e, f, sign in ends[name]}, 0.0))
    matrix, right = np.zeros((len(rows), len(columns)), complex), np.zeros(len(rows), complex)
    for i, (row, known) in enumerate(rows):
        right[i] = known
        for j, coefficient in row.items():
            matrix[i, j] += coefficient
    x = np.linalg.lstsq(matrix, right)[0]
    assert np.abs(matrix @ x - right).max() < 1e-9 * max(1.0, np.abs(x).max())
    output = next(e for e in graph.elements if e.name == graph.output)
    moved = x[columns[("f " if isinstance(output, C) else "e ") + output.name]] / s
    port = next(e for e in graph.elements if isinstance(e, Se | Sf))
    return moved, port.sign * x[columns[("f " if isinstance(port, Se) else "e ") + port.name]]


def network_response(network: Network, s: complex) -> tuple[complex, complex]:
    """The same of a linear network by its matrices."""
    import torch

    system = PortHamiltonianSystem(network)
    n = len(network.storages)
    eye = torch.eye(n, dtype=torch.float64)
    none = torch.zeros(n, len(network.ports), dtype=torch.float64)
    a = system.vector_field(eye, none).detach().numpy().T
    hessian = system.efforts(eye).detach().numpy().T
    b = system.incidences(eye[0])[1].detach().numpy()[:, 0]
    port = network.ports[0]
    # Behind a linear resistor the port is that of the equivalent source: its answer lacks what the resistor takes.
    b = b * PORT_LAWS[port.law].slope(0.0, *(network.parameters[n].value for n in port.parameters))
    x = np.linalg.solve(s * np.eye(n) - a, b)
    return x[network.state_names.index(network.output)], b @ hessian @ x


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
