"""The parts of a bond graph as values: junctions, one-ports that hang on them, and bonds between them.

Conventions (Karnopp, Margolis & Rosenberg 2012; the paper's Table A.5): power flows into ``C``, ``I`` and ``R``, out of
``Se`` and ``Sf``, and along a bond from its start to its end. Effort ``e`` times flow ``f`` is power.

    0-junction: all efforts equal, Σ ± f = 0        1-junction: all flows equal, Σ ± e = 0
    C: ẋ = f, e = H'(x)        I: ẋ = e, f = H'(x)        R: f = φ(e) or e = φ(f)        Se: e = ±u        Sf: f = ±u
    TF: f_end = r f_start, e_start = r e_end        GY: e_start = r f_end, e_end = r f_start

Motion can be imposed: a source of flow whose conjugate effort is measured. A shaking table moves a damper, a load cell
measures the force that this takes. In the bond graph the source ``Sf`` stands at the 1-junction of the specimen and is
itself the output. Between the two stands a *contact*: a 0-junction with a spring that is rigid but for rounding,
through which the source moves the junction,

    ẋ_c = u − v,   e_c = x_c/c,      ṗ_I = e_c,      m₀ v̇ = e_c − Σ efforts of the specimen,      ẋ_t = v

Its effort is the force. The impulse ``p_I`` sums it up over time and takes no flow; the sensor differentiates it again,
so that what is measured at a sample is the mean force of the steps around it. A junction without an inertia gets the
mass ``m₀``, which is nothing but for rounding, and one without a spring keeps its travel ``x_t`` in a spring without
stiffness. All these are ordinary storages: the power balance holds as in any other network.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from phnn.errors import StructureViolated
from phnn.network.elements import Modulation, ModulatorState, Network, Ratio
from phnn.parameters import Parameter, constant

if TYPE_CHECKING:
    from phnn.network.bondgraph.derivation import Derivation


DIRECTIONS = ("conductance", "resistance")


@dataclass(frozen=True)
class _Store:
    """A store of energy.

    Attributes:
        name: of its energy variable.
        junction: the one that it hangs on.
        law: name of a storage law in `phnn.laws`, or a torch module with ``energy(x)``; of a mass or coil
            ``capacitor`` is the law ``H = p²/(2m)``.
        parameters: names of the law's parameters, in the law's order.
        unit: of the energy variable.
    """

    name: str
    junction: str
    law: Any = "capacitor"
    parameters: tuple[str, ...] = ()
    unit: str = "1"


class C(_Store):
    """A store of displacement: charge on a capacitor, elongation of a spring, volume in a tank."""


class I(_Store):  # noqa: E742 - the letter of every bond graph
    """A store of momentum: of a mass, flux linkage of a coil."""


@dataclass(frozen=True)
class R:
    """A resistor by its law ``φ``.

    Attributes:
        direction: ``conductance`` for ``f = φ(e)``, ``resistance`` for ``e = φ(f)``. A ``linear`` law is inverted where
            the rest of the graph asks for it; any other must stand where its argument is what the graph supplies.
        reads: storage whose energy variable, or memory, the law may read.
    """

    name: str
    junction: str
    law: Any = "linear"
    parameters: tuple[str, ...] = ()
    direction: str = "conductance"
    reads: str | None = None


@dataclass(frozen=True)
class _Source:
    """A source ``sign · ψ(u)``, a port of the network."""

    name: str
    junction: str
    unit: str = "1"
    sign: int = 1
    law: str = "linear"
    parameters: tuple[str, ...] = ()


@dataclass(frozen=True)
class Se(_Source):
    """A source of effort; its conjugate is the flow that it delivers."""

    unit: str = "V"


class Sf(_Source):
    """A source of flow; its conjugate is the effort that it meets."""


@dataclass(frozen=True)
class Bond:
    """Power from one junction to another, effort and flow unchanged."""

    start: str
    end: str


@dataclass(frozen=True)
class TF:
    """A transformer: ``f_end = r f_start``, ``e_start = r e_end``.

    The ratio is a number, a parameter's name, or ``1/name`` for a parameter that is given the other way round.
    """

    start: str
    end: str
    ratio: Ratio = 1.0


class GY(TF):
    """A gyrator: ``e_start = r f_end``, ``e_end = r f_start``; the ratio is given as that of a transformer."""


Element = C | I | R | Se | Sf
Link = Bond | TF


@dataclass(frozen=True)
class BondGraph:
    """A bond graph, from which a port-Hamiltonian network follows.

        graph = BondGraph(
            {"mass": 1},
            (C("q", "mass", "spring", ("k",), "m"), I("p", "mass", "capacitor", ("m",), "kg m/s"),
             R("damper", "mass", "linear", ("b",), "resistance"), Se("force", "mass", "N")),
            parameters=as_table([positive("k", 8.0, "N/m"), positive("m", 2.0, "kg"), positive("b", 0.5, "N s/m")]),
        )
        network = graph.network()

    Attributes:
        junctions: name to 0 (common effort) or 1 (common flow).
        elements: what hangs on them; storages become states in this order.
        bonds: between junctions.
        parameters: by name.
        output: the storage whose energy variable is measured; or a source of flow at a 1-junction, which imposes a
            motion and whose effort is measured (`phnn.network.bondgraph.description`).
        merge: whether storages with proportional rates become one (see `phnn.network.bondgraph.derivation`).
        modulations: ratios of transformers and gyrators that follow a storage or a memory.
        memories: modulator states, slow states that laws and ratios may read, the last ones of the network.

    Raises:
        StructureViolated: a junction that is neither 0 nor 1, a name given twice, a reference to nothing, a direction
            that does not exist, a ratio or sign of zero, or a parameter that nothing uses.
    """

    junctions: Mapping[str, int]
    elements: tuple[Element, ...]
    bonds: tuple[Link, ...] = ()
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    output: str = "q"
    merge: bool = True
    modulations: tuple[Modulation, ...] = ()
    memories: tuple[ModulatorState, ...] = ()

    def __post_init__(self) -> None:
        for name, kind in self.junctions.items():
            if kind not in (0, 1) or isinstance(kind, bool):
                raise StructureViolated(
                    f"junction {name} is {kind!r}: write 0 for a common effort or 1 for a common flow"
                )
        names = [*(e.name for e in self.elements), *(m.name for m in self.memories)]
        for name in names:
            if names.count(name) > 1:
                raise StructureViolated(f"two elements are called {name}: rename one")
        for element in self.elements:
            _among(element.junction, self.junctions, f"{element.name} hangs on the junction")
            _check_element(element)
        for bond in self.bonds:
            for end in (bond.start, bond.end):
                _among(end, self.junctions, f"a {type(bond).__name__} ends at the junction")
            if bond.start == bond.end:
                raise StructureViolated(f"a {type(bond).__name__} joins {bond.start} with itself: leave it out")
            if not isinstance(bond, Bond) and bond.ratio == 0.0:
                raise StructureViolated(f"the {type(bond).__name__} from {bond.start} has ratio 0: leave it out")
        stores = [e.name for e in self.elements if isinstance(e, C | I)]
        sources = [e.name for e in self.elements if isinstance(e, Sf)]
        what = "the output is the storage or source of flow" if sources else "the output is the storage"
        _among(self.output, [*stores, *sources], what)
        read = [*stores, *(m.name for m in self.memories)]
        for element in self.elements:
            if isinstance(element, R) and element.reads is not None:
                _among(element.reads, read, f"{element.name} reads the storage")
        modulated = [m.ratio for m in self.modulations]
        if len(set(modulated)) != len(modulated):
            raise StructureViolated(f"a ratio among {modulated} is modulated twice: multiply the factors in one law")
        for modulation in self.modulations:
            _among(modulation.ratio, self.ratios, "a modulation is of the ratio")
            _among(modulation.by, read, f"the ratio {modulation.ratio} reads the storage")
        self._check_parameters()

    def _check_parameters(self) -> None:
        used = {n for e in self.elements for n in e.parameters} | set(self.ratios)
        used |= {n for m in self.modulations for n in m.parameters} | {n for m in self.memories for n in m.parameters}
        for name in sorted(used):
            _among(name, self.parameters, "an element or bond uses the parameter")
        for name in self.parameters:
            if name not in used:
                raise StructureViolated(f"nothing uses the parameter {name}: remove it or name it where it acts")

    @property
    def ratios(self) -> tuple[str, ...]:
        """Return the names of the parameters that are ratios of transformers and gyrators."""
        ratios = [b.ratio for b in self.bonds if not isinstance(b, Bond)]
        return tuple(dict.fromkeys(r.removeprefix("1/") for r in ratios if isinstance(r, str)))

    def derive(self) -> Derivation:
        """Return the network with what was merged and inverted on the way to it.

        Raises:
            StructureViolated: the graph has no network, with the elements and the remedy.
        """
        # sympy takes half a second to load: not before a graph is solved.
        from phnn.network.bondgraph.derivation import derive

        return derive(self)

    def network(self) -> Network:
        """Return the port-Hamiltonian network of the graph. Raises StructureViolated as `derive` does."""
        return self.derive().network


def _check_element(element: Element) -> None:
    if isinstance(element, R) and element.direction not in DIRECTIONS:
        raise StructureViolated(
            f"{element.name} has the direction {element.direction!r}: "
            "write conductance for f = φ(e) or resistance for e = φ(f)"
        )
    if isinstance(element, Se | Sf) and element.sign not in (1, -1):
        raise StructureViolated(f"the source {element.name} has the sign {element.sign!r}: write 1 or -1")


def _among(name: Any, accepted: Iterable[str], what: str) -> None:
    names = list(accepted)
    if name not in names:
        raise StructureViolated(f"{what} {name!r}, which is not defined; there are {', '.join(names) or 'none'}")


# Compliance [m/N] of the contact and mass [kg] of a massless junction, SI of whatever domain: in sums with any quantity
# that can be measured they are lost in rounding. `phnn.integrate.kernel` therefore takes the velocity for that of the
# source, and the force for what the balance needs.
_RIGID, MASSLESS = 1e-60, 1e-30
# By the unit of an imposed flow: that of its effort, and of their integrals over time.
_UNITS = {
    "m/s": ("N", "m", "N s"),
    "rad/s": ("N m", "rad", "N m s"),
    "A": ("V", "C", "V s"),
    "m³/s": ("Pa", "m³", "Pa s"),
}  # fmt: skip


def effort_unit(flow_unit: str) -> str:
    """Return the SI unit of the effort whose product with a flow is power; ``1`` where it is not known."""
    return _units(flow_unit)[0]


def integral_unit(flow_unit: str) -> str:
    """Return the SI unit of a flow's integral over time, of a velocity the displacement's; ``1`` if unknown."""
    return _units(flow_unit)[1]


def _units(flow_unit: str) -> tuple[str, str, str]:
    return _UNITS.get(flow_unit.replace("m3", "m³").replace(" ", ""), ("1", "1", "1"))


def sensed_source(graph: BondGraph) -> Sf | None:
    """Return the source of flow that is the output of a graph."""
    return next((e for e in graph.elements if isinstance(e, Sf) and e.name == graph.output), None)


def with_contact(graph: BondGraph, source: Sf) -> BondGraph:
    """Return the graph with the contact through which a source imposes its flow; its output is the impulse.

    Raises:
        StructureViolated: the source stands at a 0-junction, whose effort a storage there already is.
    """
    if graph.junctions[source.junction] != 1:
        raise StructureViolated(
            f"the output {source.name} is a source of flow at the 0-junction {source.junction}: put it at a "
            f"1-junction, or name a storage at {source.junction} as the output"
        )
    contact, (_, travel, impulse) = f"{source.name}_contact", _units(source.unit)
    neighbours = [e for e in graph.elements if e.junction == source.junction]
    names = (contact, f"{source.name}_travel", f"{source.name}_massless", f"{source.name}_impulse")
    added: list[Element] = []
    parameters: list[Parameter] = []

    def storage(kind: type[C | I], junction: str, name: str, law: str, value: float, unit: str, about: str) -> None:
        parameter = constant(f"{name}_none", value, "1", about)
        added.append(kind(name, junction, law, (parameter.name,), unit))
        parameters.append(parameter)

    if not any(isinstance(e, C) for e in neighbours):
        storage(C, source.junction, names[1], "spring", 0.0, travel, "no stiffness: keeps the displacement alone")
    storage(C, contact, names[0], "capacitor", _RIGID, travel, "compliance of the rigid contact")
    storage(I, contact, names[3], "spring", 0.0, impulse, "no compliance: sums up the force alone")
    if not any(isinstance(e, I) for e in neighbours):
        storage(I, source.junction, names[2], "capacitor", MASSLESS, impulse, "mass of a massless junction")
    moved = tuple(replace(e, junction=contact) if e is source else e for e in graph.elements)
    return replace(
        graph,
        junctions={**graph.junctions, contact: 0},
        elements=(*moved, *added),
        bonds=(Bond(contact, source.junction), *graph.bonds),
        parameters={**graph.parameters, **{p.name: p for p in parameters}},
        output=names[3],
    )
