"""The junction structure of a bond graph as linear equations between rates, co-energies, law variables and sources, and
their solution by elimination in an order of preference.

Every variable of power is a column. The equations are brought to reduced row echelon form with the columns in an order
that says what should follow from what: in each row the leftmost variable, the pivot, is expressed by variables further
right that are free. With rates and inputs of laws on the left, and outputs of laws and sources on the right, this *is*
the assignment of causality, and where it fails the pivots say which elements are in conflict.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

from sympy import QQ, Expr, Symbol
from sympy.polys.matrices import DomainMatrix

from phnn.network.bondgraph.description import GY, Bond, BondGraph, C, Element, I, Link, R, Se
from phnn.network.elements import Ratio


class Variable(NamedTuple):
    """A column: whose variable, and its role: ``rate``, ``coenergy``, ``argument``, ``result``, ``input``, …"""

    role: str
    of: str


Form = Mapping[Variable, Any]
"""A linear form: variable to coefficient in the field."""


class Field:
    """Rational functions of the ratios that have names, over the rationals; floats are exact rationals."""

    def __init__(self, names: Sequence[str]) -> None:
        self.domain = QQ.frac_field(*(Symbol(n) for n in names)) if names else QQ

    def number(self, value: Ratio | int) -> Any:
        """Return the element of the field that is a number, a named ratio or, as ``1/name``, its inverse."""
        if isinstance(value, str):
            named = self.domain.from_sympy(Symbol(value.removeprefix("1/")))
            return self.domain.one / named if value.startswith("1/") else named
        exact = Fraction(value)
        return self.domain.convert(QQ(exact.numerator, exact.denominator))

    def expression(self, coefficient: Any) -> Expr:
        """Return the coefficient for a person."""
        return self.domain.to_sympy(coefficient)

    def is_polynomial(self, coefficient: Any) -> bool:
        """Return whether no named ratio stands in a denominator."""
        return bool(self.expression(coefficient).as_numer_denom()[1].is_number)


Solution = Mapping[Variable, Form]
"""Every variable that follows from free ones, as a linear form of these; free ones are no keys."""


def solve(field: Field, equations: Iterable[Form], order: Sequence[Variable]) -> Solution:
    """Eliminate.

    Args:
        equations: linear forms that are zero.
        order: all variables, the ones to be expressed first.
    """
    place = {variable: i for i, variable in enumerate(order)}
    rows = []
    for form in equations:
        row = [field.domain.zero] * len(order)
        for variable, coefficient in form.items():
            row[place[variable]] += coefficient
        rows.append(row)
    if not rows:
        return {}
    reduced, pivots = DomainMatrix(rows, (len(rows), len(order)), field.domain).rref()
    dense = reduced.to_dense().to_list()
    return {
        order[pivot]: {order[j]: -c for j, c in enumerate(dense[i]) if c and j != pivot}
        for i, pivot in enumerate(pivots)
    }


def plus(*forms: Form) -> dict[Variable, Any]:
    """Return the sum of linear forms."""
    total: dict[Variable, Any] = {}
    for form in forms:
        for variable, coefficient in form.items():
            total[variable] = total[variable] + coefficient if variable in total else coefficient
    return total


def times(factor: Any, form: Form) -> dict[Variable, Any]:
    """Return a linear form times an element of the field."""
    return {variable: factor * coefficient for variable, coefficient in form.items()}


# Columns by the name of an element: ``ẋ`` of a storage (flow of a C, effort of an I) and its co-energy ``H'(x)``; what
# the law of a resistor takes and gives in its declared direction; ``ψ(u)`` of a source, and what it does not impose.
rate, coenergy, argument, result, source, answer = (
    partial(Variable, role) for role in ("rate", "coenergy", "argument", "result", "input", "answer")
)


@dataclass(frozen=True)
class _End:
    """One end of a bond at a junction: its effort, its flow, and 1 where power comes in."""

    effort: Form
    flow: Form
    inwards: int


def junction_equations(graph: BondGraph, field: Field) -> list[Form]:
    """Return linear forms that are zero: what the 0- and 1-junctions say about all that is attached."""
    ends: dict[str, list[_End]] = {name: [] for name in graph.junctions}
    for element in graph.elements:
        ends[element.junction].append(_element_end(element, field))
    for i, bond in enumerate(graph.bonds):
        for name, end in zip((bond.start, bond.end), _bond_ends(bond, str(i), field), strict=True):
            ends[name].append(end)
    equations: list[Form] = []
    for name, kind in graph.junctions.items():
        attached = ends[name]
        common = [end.effort if kind == 0 else end.flow for end in attached]
        summed = [end.flow if kind == 0 else end.effort for end in attached]
        minus = field.number(-1)
        equations += [plus(common[0], times(minus, other)) for other in common[1:]]
        equations.append(
            plus(*(form if end.inwards > 0 else times(minus, form) for form, end in zip(summed, attached, strict=True)))
        )
    return [form for form in equations if form]


def _element_end(element: Element, field: Field) -> _End:
    one = field.number(1)

    def alone(variable: Variable) -> dict[Variable, Any]:
        return {variable: one}

    name = element.name
    if isinstance(element, C):
        return _End(alone(coenergy(name)), alone(rate(name)), -1)
    if isinstance(element, I):
        return _End(alone(rate(name)), alone(coenergy(name)), -1)
    if isinstance(element, R):
        ends = alone(argument(name)), alone(result(name))
        effort, flow = ends if element.direction == "conductance" else ends[::-1]
        return _End(effort, flow, -1)
    imposed = {source(name): field.number(element.sign)}
    if isinstance(element, Se):
        return _End(imposed, alone(answer(name)), 1)
    return _End(alone(answer(name)), imposed, 1)


def _bond_ends(bond: Link, key: str, field: Field) -> tuple[_End, _End]:
    a, b = Variable("inner", f"{key}a"), Variable("inner", f"{key}b")
    one = field.number(1)
    ratio = one if isinstance(bond, Bond) else field.number(bond.ratio)
    if isinstance(bond, GY):
        # a is the flow at the start, b the flow at the end.
        return _End({b: ratio}, {a: one}, -1), _End({a: ratio}, {b: one}, 1)
    # a is the flow at the start, b the effort at the end.
    return _End({b: ratio}, {a: one}, -1), _End({b: one}, {a: ratio}, 1)
