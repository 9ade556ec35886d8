"""The parts of a bond graph as values: junctions, one-ports that hang on them, and bonds between them.

Conventions (Karnopp, Margolis & Rosenberg 2012; the paper's Table A.5): power flows into ``C``, ``I`` and ``R``, out of
``Se`` and ``Sf``, and along a bond from its start to its end. Effort ``e`` times flow ``f`` is power.

    0-junction: all efforts equal, Σ ± f = 0        1-junction: all flows equal, Σ ± e = 0
    C: ẋ = f, e = H'(x)        I: ẋ = e, f = H'(x)        R: f = φ(e) or e = φ(f)        Se: e = ±u        Sf: f = ±u
    TF: f_end = r f_start, e_start = r e_end        GY: e_start = r f_end, e_end = r f_start
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from phnn.errors import StructureViolated
from phnn.network.elements import Modulation, ModulatorState, Network, Ratio
from phnn.parameters import Parameter

if TYPE_CHECKING:
    from phnn.network.bondgraph.derivation import Derivation

DIRECTIONS = ("conductance", "resistance")


@dataclass(frozen=True)
class C:
    """A store of displacement: charge on a capacitor, elongation of a spring, volume in a tank.

    Attributes:
        name: of its energy variable.
        junction: the one that it hangs on.
        law: name of a storage law in `phnn.laws`, or a torch module with ``energy(x)``.
        parameters: names of the law's parameters, in the law's order.
        unit: of the energy variable.
    """

    name: str
    junction: str
    law: Any = "capacitor"
    parameters: tuple[str, ...] = ()
    unit: str = "1"


@dataclass(frozen=True)
class I:  # noqa: E742 - the letter of every bond graph
    """A store of momentum: of a mass, flux linkage of a coil; ``capacitor`` is the law ``H = p²/(2m)``."""

    name: str
    junction: str
    law: Any = "capacitor"
    parameters: tuple[str, ...] = ()
    unit: str = "1"


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
class Se:
    """A source of effort ``sign · ψ(u)``, a port of the network; its conjugate is the flow that it delivers."""

    name: str
    junction: str
    unit: str = "V"
    sign: int = 1
    law: str = "linear"
    parameters: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sf:
    """A source of flow ``sign · ψ(u)``, a port of the network; its conjugate is the effort that it meets."""

    name: str
    junction: str
    unit: str = "1"
    sign: int = 1
    law: str = "linear"
    parameters: tuple[str, ...] = ()


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


@dataclass(frozen=True)
class GY:
    """A gyrator: ``e_start = r f_end``, ``e_end = r f_start``; the ratio is given as that of a transformer."""

    start: str
    end: str
    ratio: Ratio = 1.0


Element = C | I | R | Se | Sf
Link = Bond | TF | GY


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
            motion and whose effort is measured (`phnn.network.bondgraph.imposed`).
        merge: whether storages with proportional rates become one (see `phnn.network.bondgraph.merging`).
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
        _once([*(e.name for e in self.elements), *(m.name for m in self.memories)], "elements")
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
        """Names of the parameters that are ratios of transformers and gyrators."""
        ratios = [b.ratio for b in self.bonds if not isinstance(b, Bond)]
        return tuple(dict.fromkeys(r.removeprefix("1/") for r in ratios if isinstance(r, str)))

    def derive(self) -> Derivation:
        """The network with what was merged and inverted on the way to it.

        Raises:
            StructureViolated: the graph has no network, with the elements and the remedy.
        """
        # sympy takes half a second to load: not before a graph is solved.
        from phnn.network.bondgraph.derivation import derive

        return derive(self)

    def network(self) -> Network:
        """The port-Hamiltonian network of the graph. Raises StructureViolated as `derive` does."""
        return self.derive().network


def _check_element(element: Element) -> None:
    if isinstance(element, R) and element.direction not in DIRECTIONS:
        raise StructureViolated(
            f"{element.name} has the direction {element.direction!r}: "
            "write conductance for f = φ(e) or resistance for e = φ(f)"
        )
    if isinstance(element, Se | Sf) and element.sign not in (1, -1):
        raise StructureViolated(f"the source {element.name} has the sign {element.sign!r}: write 1 or -1")


def _once(names: list[str], what: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise StructureViolated(f"two {what} are called {name}: rename one")


def _among(name: Any, accepted: Iterable[str], what: str) -> None:
    names = list(accepted)
    if name not in names:
        raise StructureViolated(f"{what} {name!r}, which is not defined; there are {', '.join(names) or 'none'}")
