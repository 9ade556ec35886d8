"""Imposed motion: a source of flow whose conjugate effort is measured.

A shaking table moves a damper, a load cell measures the force that this takes. In the bond graph the source ``Sf``
stands at the 1-junction of the specimen and is itself the output. Between the two stands a *contact*: a 0-junction
with a spring that is rigid but for rounding, through which the source moves the junction,

    ẋ_c = u − v,   e_c = x_c/c,      ṗ_I = e_c,      m₀ v̇ = e_c − Σ efforts of the specimen,      ẋ_t = v

Its effort is the force. The impulse ``p_I`` sums it up over time and takes no flow; the sensor differentiates it again,
so that what is measured at a sample is the mean force of the steps around it. A junction without an inertia gets the
mass ``m₀``, which is nothing but for rounding, and one without a spring keeps its travel ``x_t`` in a spring without
stiffness. All these are ordinary storages: the power balance holds as in any other network.
"""

from __future__ import annotations

from dataclasses import replace

from phnn.errors import StructureViolated
from phnn.network.bondgraph.description import Bond, BondGraph, C, Element, I, Sf
from phnn.parameters import Parameter, constant

# Compliance [m/N] of the contact and mass [kg] of a massless junction, SI of whatever domain: in sums with any quantity
# that can be measured they are lost in rounding. `phnn.integrate.solve` therefore takes the velocity for that of the
# source, and the force for what the balance needs.
_RIGID, _MASSLESS = 1e-60, 1e-30
# By the unit of an imposed flow: that of its effort, and of their integrals over time.
_UNITS = {
    "m/s": ("N", "m", "N s"),
    "rad/s": ("N m", "rad", "N m s"),
    "A": ("V", "C", "V s"),
    "m³/s": ("Pa", "m³", "Pa s"),
}  # fmt: skip


def effort_unit(flow_unit: str) -> str:
    """SI unit of the effort whose product with a flow is power; ``1`` where it is not known."""
    return _units(flow_unit)[0]


def integral_unit(flow_unit: str) -> str:
    """SI unit of the integral of a flow over time: of a displacement for a velocity; ``1`` where it is not known."""
    return _units(flow_unit)[1]


def _units(flow_unit: str) -> tuple[str, str, str]:
    return _UNITS.get(flow_unit.replace("m3", "m³").replace(" ", ""), ("1", "1", "1"))


def sensed_source(graph: BondGraph) -> Sf | None:
    """The source of flow that is the output of a graph."""
    return next((e for e in graph.elements if isinstance(e, Sf) and e.name == graph.output), None)


def with_contact(graph: BondGraph, source: Sf) -> BondGraph:
    """The graph with the contact through which a source imposes its flow; its output is the impulse.

    Raises:
        StructureViolated: the source stands at a 0-junction, whose effort a storage there already is.
    """
    if graph.junctions[source.junction] != 1:
        raise StructureViolated(
            f"the output {source.name} is a source of flow at the 0-junction {source.junction}: put it at a "
            f"1-junction, or name a storage at {source.junction} as the output"
        )
    contact, (_, travel, impulse) = f"{source.name}_contact", _units(source.unit)
    here = [e for e in graph.elements if e.junction == source.junction]
    names = (contact, f"{source.name}_travel", f"{source.name}_massless", f"{source.name}_impulse")
    added: list[Element] = []
    parameters: list[Parameter] = []

    def storage(kind: type[C | I], junction: str, name: str, law: str, value: float, unit: str, about: str) -> None:
        parameter = constant(f"{name}_none", value, "1", about)
        added.append(kind(name, junction, law, (parameter.name,), unit))
        parameters.append(parameter)

    if not any(isinstance(e, C) for e in here):
        storage(C, source.junction, names[1], "spring", 0.0, travel, "no stiffness: keeps the displacement alone")
    storage(C, contact, names[0], "capacitor", _RIGID, travel, "compliance of the rigid contact")
    storage(I, contact, names[3], "spring", 0.0, impulse, "no compliance: sums up the force alone")
    if not any(isinstance(e, I) for e in here):
        storage(I, source.junction, names[2], "capacitor", _MASSLESS, impulse, "mass of a massless junction")
    moved = tuple(replace(e, junction=contact) if e is source else e for e in graph.elements)
    return replace(
        graph,
        junctions={**graph.junctions, contact: 0},
        elements=(*moved, *added),
        bonds=(Bond(contact, source.junction), *graph.bonds),
        parameters={**graph.parameters, **{p.name: p for p in parameters}},
        output=names[3],
    )
