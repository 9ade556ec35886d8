"""The paper's actuator and its variants as bond graphs (Fig. 5, Secs. 2.4.1 and 2.4.2)."""

from __future__ import annotations

from phnn.models.actuator import hrc
from phnn.network.bondgraph import TF, Bond, BondGraph, C, I, R, Se
from phnn.network.bondgraph.description import Element, Link
from phnn.parameters import as_table, positive


def hrc_graph(hysterons: int, capacitance: float, values: dict[str, float] | None = None) -> BondGraph:
    p = hrc(hysterons, values).parameters
    junctions: dict[str, int] = {"electrical": 1, "mechanical": 1}
    elements: list[Element] = []
    bonds: list[Link] = [TF("mechanical", "electrical", "alpha")]
    for i in range(1, hysterons + 1):
        junctions[f"hysteron_{i}"] = 0
        bonds.append(Bond("electrical", f"hysteron_{i}"))
        elements.append(C(f"Q_{i}", f"hysteron_{i}", "capacitor", (f"C_{i}",), "C"))
        elements.append(R(f"hysteron_{i}", f"hysteron_{i}", "dead_zone", (f"rho_{i}", f"d_{i}")))
    elements += [
        C("Q_C", "electrical", "capacitor", ("C",), "C"),
        C("q", "mechanical", "spring", ("k",), "m"),
        I("p", "mechanical", "capacitor", ("m",), "kg m/s"),
        R("damper", "mechanical", "linear", ("b",), "resistance"),
        Se("voltage", "electrical", "V"),
        Se("force", "mechanical", "N", -1),
    ]
    return BondGraph(junctions, tuple(elements), tuple(bonds), as_table([*p.values(), positive("C", capacitance, "F")]))
