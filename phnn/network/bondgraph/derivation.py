"""From a bond graph to its port-Hamiltonian network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from phnn.errors import StructureViolated
from phnn.network.bondgraph.assemble import assemble
from phnn.network.bondgraph.causality import (
    Branch,
    branch,
    causal,
    check_sources,
    dependence,
    resistors_of,
    stores_of,
)
from phnn.network.bondgraph.description import BondGraph, C, I
from phnn.network.bondgraph.equations import Field, Form, Solution, Variable
from phnn.network.bondgraph.imposed import sensed_source, with_contact
from phnn.network.bondgraph.merging import (
    Merge,
    absorbed,
    check_dependent,
    is_linear,
    merged_linear,
    merged_nonlinear,
)
from phnn.network.bondgraph.structure import coenergy, junction_equations, rate
from phnn.network.elements import Network
from phnn.parameters import Parameter


@dataclass(frozen=True)
class Derivation:
    """A network and how it came about.

    Attributes:
        network: the result.
        merges: storages that went into others, and what became of their parameters.
        inverted: linear resistors that act in the other direction than the declared one.
    """

    network: Network
    merges: tuple[Merge, ...]
    inverted: tuple[str, ...]


def derive(graph: BondGraph) -> Derivation:
    """Assign causality, merge what is not independent, and read off ``J``, ``b_r`` and ``g``.

    Raises:
        StructureViolated: a conflict that no assignment resolves, or a structure with products of parameters; names the
            elements and the remedy.
    """
    source = sensed_source(graph)
    if source is None:
        return _Derivation(graph).result()
    found = _Derivation(with_contact(graph, source)).result()
    return replace(found, network=replace(found.network, senses=source.name))


class _Derivation:
    """The storages and parameters as they are merged."""

    def __init__(self, graph: BondGraph) -> None:
        self.graph = graph
        self.field = Field(graph.ratios)
        self.stores: dict[str, C | I] = {s.name: s for s in stores_of(graph)}
        self.parameters: dict[str, Parameter] = dict(graph.parameters)
        self.merges: list[Merge] = []

    def result(self) -> Derivation:
        solution = self._integral()
        check_sources(self.graph, solution)
        branches = {r.name: branch(self.graph, solution, r) for r in resistors_of(self.graph)}
        rates = {name: solution.of(rate(name)) for name in self.stores}
        if self.graph.merge:
            branches, rates = self._side_by_side(branches, rates)
        network = assemble(self.graph, self.field, tuple(self.stores.values()), self.parameters, rates, branches)
        inverted = tuple(name for name, b in branches.items() if b.inverted)
        return Derivation(network, tuple(self.merges), inverted)

    def _integral(self) -> Solution:
        """The solved structure after storages with derivative causality have gone into others."""
        equations: list[Form] = junction_equations(self.graph, self.field)
        while True:
            solution = causal(self.graph, self.field, equations, self.stores)
            found = ((n, form) for n in self.stores if (form := dependence(solution, n)) is not None)
            name, form = next(found, ("", {}))
            if not name:
                return solution
            other = check_dependent(self.stores[name], form, self.stores)
            ratio = form[coenergy(other.name)]
            pair = {name: {other.name: self.field.number(1) / ratio}, other.name: {name: ratio}}
            kept = self._kept(pair)
            ((gone, ratio),) = pair[kept].items()
            self._merge_linear(kept, gone, ratio, compliant=True)
            equations = absorbed(self.field, equations, gone, kept, ratio)

    def _kept(self, ratios: Mapping[str, Mapping[str, Any]]) -> str:
        """Which of several storages stays: the output, else the first by which the others' ratios are no quotients.

        Args:
            ratios: for each storage, those of the others if it stays.
        """
        whole = [n for n, of in ratios.items() if all(self.field.is_polynomial(r) for r in of.values())]
        return self.graph.output if self.graph.output in ratios else [*whole, *ratios][0]

    def _side_by_side(
        self, branches: dict[str, Branch], rates: dict[str, Form]
    ) -> tuple[dict[str, Branch], dict[str, Form]]:
        """Merge storages with proportional rates; what remains no longer refers to those that are gone."""
        for names in _proportional(rates):
            ratios = {b: {a: _quotient(rates[a], rates[b]) for a in names if a != b} for b in names}
            kept = self._kept(ratios)
            for gone, ratio in ratios[kept].items():
                linear = is_linear(self.stores[kept]) and is_linear(self.stores[gone])
                (self._merge_linear if linear else self._merge_nonlinear)(kept, gone, ratio)
        left = {coenergy(n) for n in self.stores}

        def without(form: Form) -> dict[Variable, Any]:
            return {v: c for v, c in form.items() if v.role != "coenergy" or v in left}

        # The effort of the kept storage is now that of both: in the other rows its own entry already says so.
        return (
            {n: Branch(without(b.takes), b.inverted) for n, b in branches.items()},
            {n: without(form) for n, form in rates.items() if n in self.stores},
        )

    def _merge_linear(self, kept: str, gone: str, ratio: Any, compliant: bool = False) -> None:
        self._refuse_modulated(kept, gone, ratio)
        store = self.stores[kept]
        own = store.parameters[0]
        # A parameter that others use as well keeps its meaning for them.
        shared = [n for e in self.graph.elements for n in e.parameters].count(own) > 1
        self.stores[kept], present, merge = merged_linear(
            store, self.stores[gone], self.field.expression(ratio), self.parameters,
            f"{own}_{kept}" if shared else own, compliant,
        )  # fmt: skip
        self.parameters[present.name] = present
        self._drop(gone, merge)

    def _merge_nonlinear(self, kept: str, gone: str, ratio: Any) -> None:
        self._refuse_modulated(kept, gone, ratio)
        self.stores[kept], merge = merged_nonlinear(
            self.stores[kept], self.stores[gone], self.field.expression(ratio), self.parameters
        )
        self._drop(gone, merge)

    def _refuse_modulated(self, kept: str, gone: str, ratio: Any) -> None:
        names = set(map(str, self.field.expression(ratio).free_symbols))
        for m in self.graph.modulations:
            if m.ratio in names:
                raise StructureViolated(
                    f"the ratio {m.ratio} follows {m.by}, but merging {gone} into {kept} takes it for constant: "
                    f"leave {gone} out and give {kept} what both are at a fixed ratio"
                )

    def _drop(self, gone: str, merge: Merge) -> None:
        reads = {r.name: r.reads for r in resistors_of(self.graph)} | {m.ratio: m.by for m in self.graph.modulations}
        for name, read in reads.items():
            if read == gone:
                raise StructureViolated(
                    f"{name} reads the storage {gone}, which is merged into {merge.kept}: "
                    f"let it read {merge.kept}, or set merge to false"
                )
        del self.stores[gone]
        self.merges.append(merge)


def _proportional(rates: dict[str, Form]) -> list[Sequence[str]]:
    """Groups of storages whose rates are multiples of each other; one that nothing moves is in none."""
    groups: dict[frozenset[tuple[Variable, Any]], list[str]] = {}
    for name, form in rates.items():
        if form:
            first = form[min(form)]
            groups.setdefault(frozenset((v, c / first) for v, c in form.items()), []).append(name)
    return [names for names in groups.values() if len(names) > 1]


def _quotient(form: Form, other: Form) -> Any:
    return form[min(form)] / other[min(other)]
