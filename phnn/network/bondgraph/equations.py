"""The linear equations of a junction structure, and their solution by elimination in an order of preference.

Every variable of power is a column. The equations are brought to reduced row echelon form with the columns in an order
that says what should follow from what: in each row the leftmost variable, the pivot, is expressed by variables further
right that are free. With rates and inputs of laws on the left, and outputs of laws and sources on the right, this *is*
the assignment of causality, and where it fails the pivots say which elements are in conflict.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from sympy import QQ, Expr, Symbol
from sympy.polys.matrices import DomainMatrix

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
        """The element of the field that is a number, a named ratio or, as ``1/name``, its inverse."""
        if isinstance(value, str):
            named = self.domain.from_sympy(Symbol(value.removeprefix("1/")))
            return self.domain.one / named if value.startswith("1/") else named
        exact = Fraction(value)
        return self.domain.convert(QQ(exact.numerator, exact.denominator))

    def expression(self, coefficient: Any) -> Expr:
        """The coefficient for a person."""
        return self.domain.to_sympy(coefficient)

    def is_polynomial(self, coefficient: Any) -> bool:
        """Whether no named ratio stands in a denominator."""
        return bool(self.expression(coefficient).as_numer_denom()[1].is_number)


@dataclass(frozen=True)
class Solution:
    """Pivots by the free variables further right."""

    rows: Mapping[Variable, Form]

    def determined(self, variable: Variable) -> bool:
        """Whether a variable follows from free ones."""
        return variable in self.rows

    def of(self, variable: Variable) -> Form:
        """The variable as a linear form of free variables; a free one is itself no key."""
        return self.rows[variable]


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
        return Solution({})
    reduced, pivots = DomainMatrix(rows, (len(rows), len(order)), field.domain).rref()
    dense = reduced.to_dense().to_list()
    return Solution(
        {
            order[pivot]: {order[j]: -c for j, c in enumerate(dense[i]) if c and j != pivot}
            for i, pivot in enumerate(pivots)
        }
    )


def plus(*forms: Form) -> dict[Variable, Any]:
    """The sum of linear forms."""
    total: dict[Variable, Any] = {}
    for form in forms:
        for variable, coefficient in form.items():
            total[variable] = total[variable] + coefficient if variable in total else coefficient
    return total


def times(factor: Any, form: Form) -> dict[Variable, Any]:
    """A linear form times an element of the field."""
    return {variable: factor * coefficient for variable, coefficient in form.items()}
