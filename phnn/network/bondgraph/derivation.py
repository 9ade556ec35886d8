"""From a bond graph to its port-Hamiltonian network.

First it is decided who imposes what: integral causality for storages, the fitting one for resistors; what cannot be is
refused with its remedy. Then storages that are not independent become one. At last every coefficient of the solved
equations becomes a number or one named parameter. Storages become one in two cases, with the stiffness ``κ`` of a
linear storage, ``H = κ x²/2``:

* proportional rates of linear storages, ``ẋ_a = ρ ẋ_b`` (springs side by side; the paper's ``Q̇_C = α q̇``): from
  ``x_a = ρ x_b`` follows ``κ = κ_b + ρ² κ_a``. Both are taken to have been uncharged together, so a graph in which they
  start otherwise (two tanks that fill each other) sets ``merge`` to false.
* proportional co-energies, ``e_a = ρ e_b`` (masses on one shaft, capacitors side by side), where one storage has
  derivative causality: the state is ``x = x_b + ρ x_a`` and ``1/κ = 1/κ_b + ρ²/κ_a``, for linear storages only.

In both only the total acts on anything outside, so that no recording can tell the two parameters apart: the network
keeps the one of the storage that remains, with the total as its value, and `Merge` says what it is made of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sympy import Expr

from phnn.errors import StructureViolated
from phnn.laws import RESISTOR_LAWS
from phnn.network.bondgraph.description import BondGraph, C, I, R, Se, Sf, sensed_source, with_contact
from phnn.network.bondgraph.equations import (
    Field,
    Form,
    Solution,
    Variable,
    answer,
    argument,
    coenergy,
    junction_equations,
    plus,
    rate,
    result,
    solve,
    source,
    times,
)
from phnn.network.elements import Coupling, Network, Port, Ratio, Resistor, Storage, is_linear
from phnn.parameters import Parameter, constant


@dataclass(frozen=True)
class Branch:
    """A resistor in the network: its law's argument by co-energies and sources; whether its direction is turned."""

    takes: Form
    inverted: bool


def is_invertible(resistor: R) -> bool:
    """Return whether the law can be read in the other direction."""
    return bool(resistor.law == "linear")


def check_sources(sources: Sequence[Se | Sf], solution: Solution) -> None:
    """Refuse sources that contradict each other or feed one another past every storage."""
    for element in sources:
        name = element.name
        others = _names(solution.get(source(name), {}), "input")
        if others:
            raise StructureViolated(
                f"the sources {', '.join([name, *others])} contradict each other: put a storage between, or remove one"
            )
        if source(name) in solution or not solution[answer(name)]:
            raise StructureViolated(
                f"no storage takes what the source {name} gives: join its junction with the rest or remove it"
            )
        fed = _names(solution[answer(name)], "input")
        if fed:
            raise StructureViolated(
                f"the sources {', '.join(dict.fromkeys([name, *fed]))} feed each other without a storage between: "
                "add the storage that takes up the difference, or remove one source"
            )


def branch(resistors: Sequence[R], solution: Solution, resistor: R) -> Branch:
    """Return how a resistor acts; of a power-conserving structure every rate follows once all resistors and sources do.

    Raises:
        StructureViolated: its law is declared in the wrong direction, it belongs to an algebraic loop, a source drives
            it directly, or nothing acts on it.
    """
    name = resistor.name
    takes, gives = argument(name) in solution, result(name) in solution
    if takes == gives:
        # Resistors of which the structure fixes both variables or neither fix each other.
        names = [r.name for r in resistors]
        _refuse_loop([n for n in names if (argument(n) in solution) == (result(n) in solution)])
    form = solution[result(name) if gives else argument(name)]
    if not form:
        raise StructureViolated(f"no storage acts on the resistor {name}: join its junction with the rest or remove it")
    if gives and not is_invertible(resistor):
        _refuse_direction(resistor, form)
    fellows = _names(form, "argument", "result")
    if fellows:
        _refuse_loop([name, *fellows])
    driving = _names(form, "input")
    if driving and not (is_invertible(resistor) or resistor.law == _INVERSE):
        raise StructureViolated(
            f"the source {', '.join(driving)} drives the resistor {name} directly, whose law is not linear, so that "
            "the input would not enter affinely: make the resistor linear, put a storage between them (a small "
            "capacitance or inertia), or use the other kind of source"
        )
    if driving and len(driving) == len(form):
        raise StructureViolated(
            f"the source {', '.join(driving)} alone fixes what the resistor {name} takes, so that nothing recorded "
            "depends on it: leave the resistor out, or put a storage between"
        )
    return Branch(form, gives)


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


@dataclass(frozen=True)
class Merge:
    """One storage that went into another.

    Attributes:
        kept, gone: names of the storages.
        ratio: ``ρ`` as text.
        parameter: the parameter of the kept storage, now that of both.
        statement: what became of the two, for a person.
    """

    kept: str
    gone: str
    ratio: str
    parameter: str
    statement: str


def merged(
    kept: C | I, gone: C | I, ratio: Expr, parameters: Mapping[str, Parameter], name: str, compliant: bool
) -> tuple[C | I, Parameter, Merge]:
    """Return the kept storage and its parameter, now of both.

    Args:
        name: what that parameter is called.
        compliant: add ``ρ²/κ_a`` to ``1/κ_b`` (proportional co-energies) rather than ``ρ² κ_a`` to ``κ_b``.
    """
    stays, goes = kept.parameters[0], gone.parameters[0]
    # What adds up is κ or 1/κ, which a law's parameter is or is the inverse of.
    inverse = [(s.law == "spring") == compliant for s in (kept, gone)]
    parts = [
        1.0 / parameters[n].value if i else parameters[n].value for n, i in zip((stays, goes), inverse, strict=True)
    ]
    factor = float(ratio.subs({symbol: parameters[str(symbol)].value for symbol in ratio.free_symbols}))
    total = parts[0] + factor**2 * parts[1]
    value = 1.0 / total if inverse[0] else total
    square = str(ratio**2).replace("**", "^")
    added = f"{square}/{goes}" if inverse[1] else goes if square == "1" else f"{square}*{goes}"
    formula = f"1/{name} stands for 1/{stays} + {added}" if inverse[0] else f"{name} stands for {stays} + {added}"
    was = parameters[stays]
    present = replace(
        was, name=name, value=value, lower=min(was.lower, value), upper=max(was.upper, value),
        fixed=was.fixed and parameters[goes].fixed, description=f"{was.description or stays}; {formula}",
    )  # fmt: skip
    relation = f"e({gone.name}) = {ratio}*e({kept.name})" if compliant else f"{gone.name} = {ratio}*{kept.name}"
    statement = (
        f"{gone.name} is merged into {kept.name}, because {relation}: {formula}; only this total acts, so it is what "
        f"can be estimated, and {goes} is no parameter of the network"
    )
    return replace(kept, parameters=(name,)), present, Merge(kept.name, gone.name, str(ratio), name, statement)


def check_dependent(store: C | I, form: Form, stores: Mapping[str, C | I]) -> C | I:
    """Return the storage that a storage with derivative causality can be merged with.

    Raises:
        StructureViolated: a source fixes it, several storages do, or a law is not linear.
    """
    what = "effort" if isinstance(store, C) else "flow"
    fixing = _names(form, "input")
    if fixing:
        raise StructureViolated(
            f"the source {', '.join(fixing)} fixes the {what} of the storage {store.name}: put a small storage of the "
            "other kind between them, use the other kind of source, or leave the storage out"
        )
    others = [v.of for v in form]
    remedy = "put a resistor, or a small storage of the other kind, between them"
    if len(others) != 1:
        by = f"{', '.join(others)} together fix" if others else "the junctions fix at zero"
        raise StructureViolated(f"{by} the {what} of the storage {store.name}: {remedy}")
    other = stores[others[0]]
    for each in (store, other):
        if not is_linear(each):
            raise StructureViolated(
                f"the storages {store.name} and {other.name} fix each other's {what}, and the law of {each.name} is "
                f"not linear: {remedy}"
            )
    return other


def absorbed(field: Field, equations: list[Form], gone: str, kept: str, ratio: Any) -> list[Form]:
    """Insert ``e_gone = ρ e_kept``, and ``ẋ = ẋ_kept + ρ ẋ_gone`` for the rate of the kept storage."""
    inner = {rate(n): Variable("inner", f"rate {n} within {kept}, {len(equations)}") for n in (gone, kept)}

    def insert(form: Form) -> Form:
        parts = [
            {coenergy(kept): ratio * c} if v == coenergy(gone) else {inner.get(v, v): c} for v, c in form.items()
        ]  # fmt: skip
        return {v: c for v, c in plus(*parts).items() if c}

    total = {inner[rate(kept)]: field.number(1), inner[rate(gone)]: ratio}
    return [*map(insert, equations), plus({rate(kept): field.number(1)}, times(field.number(-1), total))]


# φ = ε/(R · 1): the law "maxwell" with a constant of one is the inverse of "linear", and R stays the parameter.
_INVERSE, _ONE = "maxwell", "one"


def _unused(name: str, taken: Mapping[str, Parameter]) -> str:
    return _unused(name + "_", taken) if name in taken else name


def _minuses(coefficients: Mapping[str, Expr]) -> tuple[int, bool]:
    """Return how many named ratios have a minus, which cannot stay, and whether the first entry has one."""
    minus = [bool(c.could_extract_minus_sign()) for c in coefficients.values()]
    named = [not c.is_number for c in coefficients.values()]
    return sum(m and n for m, n in zip(minus, named, strict=True)), minus[0]


def _is_odd(law: Any, values: Sequence[float]) -> bool:
    """Return whether ``φ(−ε) = −φ(ε)``, tried over many magnitudes; not known of a torch module."""
    if not isinstance(law, str) or law not in RESISTOR_LAWS:
        return False
    flow = RESISTOR_LAWS[law].flow
    efforts = np.logspace(-9.0, 9.0, 91)
    return bool(np.array_equal(flow(-efforts, 0.0, *values), -flow(efforts, 0.0, *values)))


def _signed(coefficient: Expr, where: str) -> tuple[int, Ratio]:
    """Return the sign and parameter of ``±name``; a number is (1, number).

    Raises:
        StructureViolated: anything else, with the product that arises.
    """
    if coefficient.is_number:
        return 1, float(coefficient)
    sign = -1 if coefficient.could_extract_minus_sign() else 1
    name = sign * coefficient
    if not name.is_Symbol:
        raise StructureViolated(
            f"the ratio {coefficient} arises {where}: introduce a parameter for it and use that in one transformer or "
            "gyrator, for a network takes a number or a single parameter"
        )
    return sign, str(name)


def _positive(coefficient: Expr, where: str) -> Ratio:
    """Return a number or a name.

    Raises:
        StructureViolated: as `_signed`, or minus a parameter.
    """
    sign, ratio = _signed(coefficient, where)
    if sign < 0:
        raise StructureViolated(
            f"the ratio {coefficient} arises {where}, where a minus has no place: turn its sign or the start "
            "and end of its bonds round, or give the negative ratio a parameter of its own"
        )
    return ratio


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
    derivation = _Derivation(with_contact(graph, source)).result()
    return replace(derivation, network=replace(derivation.network, senses=source.name))


class _Derivation:
    """The storages and parameters of a graph as they are merged, and the network of what remains."""

    def __init__(self, graph: BondGraph) -> None:
        self.graph, self.field = graph, Field(graph.ratios)
        self.resistors = [e for e in graph.elements if isinstance(e, R)]
        self.sources = [e for e in graph.elements if isinstance(e, Se | Sf)]
        self.stores: dict[str, C | I] = {s.name: s for s in graph.elements if isinstance(s, C | I)}
        self.parameters: dict[str, Parameter] = dict(graph.parameters)
        self.merges: list[Merge] = []

    def result(self) -> Derivation:
        solution = self._integral()
        check_sources(self.sources, solution)
        branches = {r.name: branch(self.resistors, solution, r) for r in self.resistors}
        rates = {name: solution[rate(name)] for name in self.stores}
        if self.graph.merge:
            branches, rates = self._side_by_side(branches, rates)
        inverted = tuple(name for name, b in branches.items() if b.inverted)
        return Derivation(self._network(branches, rates), tuple(self.merges), inverted)

    def _integral(self) -> Solution:
        """Return the solved structure after storages with derivative causality have gone into others."""
        equations: list[Form] = junction_equations(self.graph, self.field)
        while True:
            solution = self._solved(equations)
            # A storage whose co-energy is fixed from outside has no integral causality.
            name = next((n for n in self.stores if coenergy(n) in solution), "")
            if not name:
                return solution
            form = solution[coenergy(name)]
            other = check_dependent(self.stores[name], form, self.stores)
            ratio = form[coenergy(other.name)]
            pair = {name: {other.name: self.field.number(1) / ratio}, other.name: {name: ratio}}
            kept = self._kept(pair)
            ((gone, ratio),) = pair[kept].items()
            self._merge(kept, gone, ratio, compliant=True)
            equations = absorbed(self.field, equations, gone, kept, ratio)

    def _solved(self, equations: Sequence[Form]) -> Solution:
        """Solve the equations for rates, source answers and arguments of laws, as far as they can be solved."""
        either = [r.name for r in self.resistors if is_invertible(r)]
        strict = [r.name for r in self.resistors if not is_invertible(r)]
        inner = dict.fromkeys(v for form in equations for v in form if v.role == "inner")
        order = [
            *inner,
            *map(rate, self.stores),
            *(answer(s.name) for s in self.sources),
            *map(argument, strict),
            *map(argument, either),
            *map(result, either),
            *map(result, strict),
            *map(coenergy, self.stores),
            *(source(s.name) for s in self.sources),
        ]
        return solve(self.field, equations, order)

    def _kept(self, ratios: Mapping[str, Mapping[str, Any]]) -> str:
        """Choose which storage stays: the output, else the first by which the others' ratios are no quotients.

        Args:
            ratios: for each storage, those of the others if it stays.
        """
        whole = [n for n, of in ratios.items() if all(self.field.is_polynomial(r) for r in of.values())]
        return self.graph.output if self.graph.output in ratios else [*whole, *ratios][0]

    def _side_by_side(
        self, branches: dict[str, Branch], rates: dict[str, Form]
    ) -> tuple[dict[str, Branch], dict[str, Form]]:
        """Merge linear storages with proportional rates; what remains no longer refers to those that are gone."""
        for names in _proportional({n: form for n, form in rates.items() if is_linear(self.stores[n])}):
            ratios = {b: {a: rates[a][min(rates[a])] / rates[b][min(rates[b])] for a in names if a != b} for b in names}
            kept = self._kept(ratios)
            for gone, ratio in ratios[kept].items():
                self._merge(kept, gone, ratio)
        present = {coenergy(n) for n in self.stores}

        def without(form: Form) -> dict[Variable, Any]:
            return {v: c for v, c in form.items() if v.role != "coenergy" or v in present}

        # The effort of the kept storage is now that of both: in the other rows its own entry already says so.
        return (
            {n: Branch(without(b.takes), b.inverted) for n, b in branches.items()},
            {n: without(form) for n, form in rates.items() if n in self.stores},
        )

    def _merge(self, kept: str, gone: str, ratio: Any, compliant: bool = False) -> None:
        """Let one storage become part of another; nothing may read it, nor a ratio between them be modulated."""
        expression = self.field.expression(ratio)
        names = set(map(str, expression.free_symbols))
        for m in self.graph.modulations:
            if m.ratio in names:
                raise StructureViolated(
                    f"the ratio {m.ratio} follows {m.by}, but merging {gone} into {kept} takes it for constant: "
                    f"leave {gone} out and give {kept} what both are at a fixed ratio"
                )
        reads = {r.name: r.reads for r in self.resistors} | {m.ratio: m.by for m in self.graph.modulations}
        for name, read in reads.items():
            if read == gone:
                raise StructureViolated(
                    f"{name} reads the storage {gone}, which is merged into {kept}: "
                    f"let it read {kept}, or set merge to false"
                )
        store = self.stores[kept]
        parameter = store.parameters[0]
        # A parameter that others use as well keeps its meaning for them.
        shared = [n for e in self.graph.elements for n in e.parameters].count(parameter) > 1
        name = f"{parameter}_{kept}" if shared else parameter
        self.stores[kept], self.parameters[name], merge = merged(
            store, self.stores.pop(gone), expression, self.parameters, name, compliant
        )
        self.merges.append(merge)

    def _network(self, branches: Mapping[str, Branch], rates: Mapping[str, Form]) -> Network:
        """Return the network of ``ẋ_k = Σ_l J_kl e_l − Σ_r b_rk φ_r + Σ_p g_kp ψ_p(u_p)`` with ``ε_r = Σ_k b_rk e_k``.

        The entries of ``J`` are read above the diagonal, those of ``b`` from what the laws take: the junctions conserve
        power, so that the rest repeats them.

        Raises:
            StructureViolated: an entry that is neither a number nor plus or minus one parameter.
        """
        names = list(self.stores)
        couplings = []
        for i, k in enumerate(names):
            for m in names[i + 1 :]:
                if coefficient := rates[k].get(coenergy(m)):
                    sign, ratio = _signed(self.field.expression(coefficient), f"between the storages {k} and {m}")
                    # A number carries its sign; a name's sign is who is named first.
                    couplings.append(Coupling(k, m, ratio) if sign > 0 else Coupling(m, k, ratio))
        one = constant(_unused(_ONE, self.parameters), 1.0, "1", f"makes the law {_INVERSE} the inverse of linear")
        resistors = tuple(self._resistor(r, branches[r.name], one.name) for r in self.resistors)
        ports = tuple(self._port(s, branches, rates) for s in self.sources)
        storages = tuple(Storage(s.name, s.law, s.parameters, s.unit) for s in self.stores.values())
        of = self.graph
        network = Network(
            storages, resistors, tuple(couplings), ports, {**self.parameters, one.name: one}, of.output,
            of.modulations, of.memories,
        )  # fmt: skip
        used = network.parameter_references()
        return replace(network, parameters={n: p for n, p in network.parameters.items() if n in used})

    def _resistor(self, resistor: R, acts: Branch, one: str) -> Resistor:
        where = f"at the resistor {resistor.name}"
        law, given = (_INVERSE, (*resistor.parameters, one)) if acts.inverted else (resistor.law, resistor.parameters)
        takes = {n: self.field.expression(c) for n in self.stores if (c := acts.takes.get(coenergy(n)))}
        turned = {n: -c for n, c in takes.items()}
        # φ(−ε) = −φ(ε): an odd law may as well look from the other side.
        values = [self.parameters[n].value for n in resistor.parameters]
        if _minuses(turned) < _minuses(takes) and _is_odd(resistor.law, values):
            takes = turned
        return Resistor(resistor.name, law, {n: _positive(c, where) for n, c in takes.items()}, given, resistor.reads)

    def _port(self, element: Se | Sf, branches: Mapping[str, Branch], rates: Mapping[str, Form]) -> Port:
        """Return the port of a source, which acts on rates directly or through one linear resistor.

        A resistor takes ``ε = bᵀe + c u`` and gives ``φ = G ε`` back: ``ẋ −= b G bᵀe`` is its damping, and
        ``−b c`` the ratio of a port that acts with ``G u``, or ``u/R``.
        """
        where, name = f"at the source {element.name}", source(element.name)
        on = {n: _positive(self.field.expression(c), where) for n in self.stores if (c := rates[n].get(name))}
        behind = [r for r in self.resistors if name in branches[r.name].takes]
        if not behind:
            return Port(element.name, on, element.law, element.parameters, element.unit)
        if len(behind) > 1 or on or element.law != "linear":
            paths = [*(r.name for r in behind), *on]
            raise StructureViolated(
                f"the source {element.name} acts in several ways ({', '.join(paths)}) or by the law {element.law}, and "
                "a port has one law: give each way a source of its own, and let `ports` in recordings.yaml read the "
                "column"
            )
        (resistor,) = behind
        takes = branches[resistor.name].takes
        acts = {n: -takes[name] * c for n in self.stores if (c := takes.get(coenergy(n)))}
        ratios = {n: _positive(self.field.expression(c), where) for n, c in acts.items()}
        law = "resistance" if branches[resistor.name].inverted else "conductance"
        law = _INVERSE if resistor.law == _INVERSE else law
        return Port(element.name, ratios, law, resistor.parameters, element.unit)


def _proportional(rates: dict[str, Form]) -> list[Sequence[str]]:
    """Return the groups of storages whose rates are multiples of each other; one that nothing moves is in none."""
    groups: dict[frozenset[tuple[Variable, Any]], list[str]] = {}
    for name, form in rates.items():
        if form:
            first = form[min(form)]
            groups.setdefault(frozenset((v, c / first) for v, c in form.items()), []).append(name)
    return [names for names in groups.values() if len(names) > 1]
