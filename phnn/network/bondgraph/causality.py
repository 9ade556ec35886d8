"""Who imposes what: integral causality for storages, the fitting one for resistors; refusals with their remedies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from phnn.errors import StructureViolated
from phnn.network.bondgraph.description import BondGraph, C, I, R, Se, Sf
from phnn.network.bondgraph.equations import Field, Form, Solution, Variable, solve
from phnn.network.bondgraph.structure import answer, argument, coenergy, rate, result, source


@dataclass(frozen=True)
class Branch:
    """A resistor in the network: what its law takes, by co-energies, and whether its declared direction was turned."""

    takes: Form
    inverted: bool


def stores_of(graph: BondGraph) -> list[C | I]:
    """The storages in the order of the graph."""
    return [e for e in graph.elements if isinstance(e, C | I)]


def resistors_of(graph: BondGraph) -> list[R]:
    """The resistors in the order of the graph."""
    return [e for e in graph.elements if isinstance(e, R)]


def sources_of(graph: BondGraph) -> list[Se | Sf]:
    """The sources in the order of the graph."""
    return [e for e in graph.elements if isinstance(e, Se | Sf)]


def is_invertible(resistor: R) -> bool:
    """Whether the law can be read in the other direction."""
    return bool(resistor.law == "linear")


def causal(graph: BondGraph, field: Field, equations: Sequence[Form], stores: Iterable[str]) -> Solution:
    """The equations solved for rates, source answers and arguments of laws, as far as they let themselves be solved."""
    either = [r.name for r in resistors_of(graph) if is_invertible(r)]
    strict = [r.name for r in resistors_of(graph) if not is_invertible(r)]
    inner = dict.fromkeys(v for form in equations for v in form if v.role == "inner")
    order = [
        *inner,
        *map(rate, names := list(stores)),
        *(answer(s.name) for s in sources_of(graph)),
        *map(argument, strict),
        *map(argument, either),
        *map(result, either),
        *map(result, strict),
        *map(coenergy, names),
        *(source(s.name) for s in sources_of(graph)),
    ]
    return solve(field, equations, order)


def check_sources(graph: BondGraph, solution: Solution) -> None:
    """Refuse sources that contradict each other or feed one another past every storage."""
    for element in sources_of(graph):
        name = element.name
        others = _names(solution.of(source(name)), "input") if solution.determined(source(name)) else []
        if others:
            raise StructureViolated(
                f"the sources {', '.join([name, *others])} contradict each other: put a storage between, or remove one"
            )
        if solution.determined(source(name)) or not solution.of(answer(name)):
            raise StructureViolated(
                f"no storage takes what the source {name} gives: join its junction with the rest or remove it"
            )
        fed = _names(solution.of(answer(name)), "input")
        if fed:
            raise StructureViolated(
                f"the sources {', '.join(dict.fromkeys([name, *fed]))} feed each other without a storage between: "
                "add the storage that takes up the difference, or remove one source"
            )


def branch(graph: BondGraph, solution: Solution, resistor: R) -> Branch:
    """How a resistor acts; of a power-conserving structure every rate follows once all resistors and sources do.

    Raises:
        StructureViolated: its law is declared in the wrong direction, it belongs to an algebraic loop, a source drives
            it directly, or nothing acts on it.
    """
    name = resistor.name
    takes, gives = solution.determined(argument(name)), solution.determined(result(name))
    if takes == gives:
        _refuse_loop(_ambiguous(graph, solution))
    form = solution.of(result(name) if gives else argument(name))
    if not form:
        raise StructureViolated(f"no storage acts on the resistor {name}: join its junction with the rest or remove it")
    if gives and not is_invertible(resistor):
        _refuse_direction(resistor, form)
    fellows = _names(form, "argument", "result")
    if fellows:
        _refuse_loop([name, *fellows])
    driving = _names(form, "input")
    if driving:
        raise StructureViolated(
            f"the source {', '.join(driving)} drives the resistor {name} directly, so that the input would not enter "
            "affinely: put a storage between them (a small capacitance or inertia), or use the other kind of source"
        )
    return Branch(form, gives)


def _ambiguous(graph: BondGraph, solution: Solution) -> list[str]:
    """Resistors of which the structure fixes both variables or neither: they fix each other."""
    names = [r.name for r in resistors_of(graph)]
    return [n for n in names if solution.determined(argument(n)) == solution.determined(result(n))]


def _refuse_loop(names: list[str]) -> None:
    raise StructureViolated(
        f"algebraic loop among the resistors {', '.join(dict.fromkeys(names))}: combine them in one law, "
        "or put a small storage between them"
    )


def _refuse_direction(resistor: R, form: Form) -> None:
    has, given, other = (
        ("f = φ(e)", "flow", "resistance") if resistor.direction == "conductance" else
        ("e = φ(f)", "effort", "conductance")
    )  # fmt: skip
    by = ", ".join(v.of for v in form)
    raise StructureViolated(
        f"the resistor {resistor.name} has the law {has}, but its {given} is imposed by {by}: give its inverse law "
        f"with the direction {other}, or hang it where its argument is imposed"
    )


def _names(form: Form, *roles: str) -> list[str]:
    return [v.of for v in form if v.role in roles]


def dependence(solution: Solution, name: str) -> Form | None:
    """What fixes the co-energy of a storage from outside; None where it has integral causality."""
    variable: Variable = coenergy(name)
    return solution.of(variable) if solution.determined(variable) else None
