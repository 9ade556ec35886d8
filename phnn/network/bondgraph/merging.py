"""Storages that are not independent, made one.

Two cases, with the stiffness ``κ`` of a linear storage, ``H = κ x²/2``:

* proportional rates, ``ẋ_a = ρ ẋ_b`` (springs side by side; the paper's ``Q̇_C = α q̇``): from ``x_a = ρ x_b`` follows
  the energy ``H_b(x) + H_a(ρ x)`` of one state, for linear ones ``κ = κ_b + ρ² κ_a``. Both are taken to have been
  uncharged together, so a graph in which they start otherwise (two tanks that fill each other) sets ``merge`` to false.
* proportional co-energies, ``e_a = ρ e_b`` (masses on one shaft, capacitors side by side), where one storage has
  derivative causality: the state is ``x = x_b + ρ x_a`` and ``1/κ = 1/κ_b + ρ²/κ_a``, for linear storages only.

In both only the total acts on anything outside, so that no recording can tell the two parameters apart: the network
keeps the one of the storage that remains, with the total as its value, and `Merge` says what it is made of.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from sympy import Expr, lambdify

from phnn.errors import StructureViolated
from phnn.network.bondgraph.description import C, I
from phnn.network.bondgraph.equations import Field, Form, Variable, plus, times
from phnn.network.bondgraph.structure import coenergy, rate
from phnn.parameters import Parameter

_LINEAR = ("capacitor", "spring")


@dataclass(frozen=True)
class Merge:
    """One storage that went into another.

    Attributes:
        kept, gone: names of the storages.
        ratio: ``ρ`` as text.
        parameter: the parameter of the kept storage, now that of both; None where the laws are not linear.
        statement: what became of the two, for a person.
    """

    kept: str
    gone: str
    ratio: str
    parameter: str | None
    statement: str


def is_linear(store: C | I) -> bool:
    """Whether the energy is quadratic."""
    return isinstance(store.law, str) and store.law in _LINEAR


def value_of(ratio: Expr, parameters: Mapping[str, Parameter]) -> float:
    """A ratio at the present values of its parameters."""
    symbols = sorted(ratio.free_symbols, key=str)
    return float(lambdify(symbols, ratio)(*(parameters[str(s)].value for s in symbols)))


def merged_linear(
    kept: C | I, gone: C | I, ratio: Expr, parameters: Mapping[str, Parameter], name: str, compliant: bool
) -> tuple[C | I, Parameter, Merge]:
    """The kept storage and its parameter, now of both.

    Args:
        name: what that parameter is called.
        compliant: add ``ρ²/κ_a`` to ``1/κ_b`` (proportional co-energies) rather than ``ρ² κ_a`` to ``κ_b``.
    """
    own, other = kept.parameters[0], gone.parameters[0]
    # What adds up is κ or 1/κ, which a law's parameter is or is the inverse of.
    inverse = [(s.law == "spring") == compliant for s in (kept, gone)]
    parts = [
        1.0 / parameters[n].value if i else parameters[n].value for n, i in zip((own, other), inverse, strict=True)
    ]
    total = parts[0] + value_of(ratio, parameters) ** 2 * parts[1]
    value = 1.0 / total if inverse[0] else total
    square = str(ratio**2).replace("**", "^")
    added = f"{square}/{other}" if inverse[1] else other if square == "1" else f"{square}*{other}"
    formula = f"1/{name} stands for 1/{own} + {added}" if inverse[0] else f"{name} stands for {own} + {added}"
    was = parameters[own]
    present = replace(
        was, name=name, value=value, lower=min(was.lower, value), upper=max(was.upper, value),
        fixed=was.fixed and parameters[other].fixed, description=f"{was.description or own}; {formula}",
    )  # fmt: skip
    relation = f"e({gone.name}) = {ratio}*e({kept.name})" if compliant else f"{gone.name} = {ratio}*{kept.name}"
    statement = (
        f"{gone.name} is merged into {kept.name}, because {relation}: {formula}; only this total acts, so it is what "
        f"can be estimated, and {other} is no parameter of the network"
    )
    return replace(kept, parameters=(name,)), present, Merge(kept.name, gone.name, str(ratio), name, statement)


def merged_nonlinear(kept: C | I, gone: C | I, ratio: Expr, parameters: Mapping[str, Parameter]) -> tuple[C | I, Merge]:
    """The kept storage with the energy ``H_b(x) + H_a(ρ x)``, a torch module with both laws' parameters as its own.

    Raises:
        StructureViolated: the ratio is a parameter that may be estimated, which the module would not follow.
    """
    moving = [str(s) for s in sorted(ratio.free_symbols, key=str) if not parameters[str(s)].fixed]
    if moving:
        raise StructureViolated(
            f"{gone.name} = {ratio}*{kept.name} have laws that are not linear, so their energies are added at a fixed "
            f"ratio: make {', '.join(moving)} fixed, or set merge to false, which keeps both as states"
        )
    from phnn.network.bondgraph.sum_of_energies import SumOfEnergies

    law = SumOfEnergies([(s.law, r, [parameters[n].value for n in s.parameters]) for s, r in (
        (kept, 1.0), (gone, value_of(ratio, parameters))
    )])  # fmt: skip
    statement = (
        f"{gone.name} is merged into {kept.name}, because {gone.name} = {ratio}*{kept.name}: the energies are added in "
        f"a torch module, which holds the parameters {', '.join(kept.parameters + gone.parameters) or 'of both'}"
    )
    return replace(kept, law=law, parameters=()), Merge(kept.name, gone.name, str(ratio), None, statement)


def check_dependent(store: C | I, form: Form, stores: Mapping[str, C | I]) -> C | I:
    """The storage that a storage with derivative causality can be merged with.

    Raises:
        StructureViolated: a source fixes it, several storages do, or a law is not linear.
    """
    what = "effort" if isinstance(store, C) else "flow"
    fixing = [v.of for v in form if v.role == "input"]
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
    """The equations with ``e_gone = ρ e_kept`` inserted and ``ẋ = ẋ_kept + ρ ẋ_gone`` for the rate of the kept one."""
    inner = {rate(n): Variable("inner", f"rate {n} within {kept}, {len(equations)}") for n in (gone, kept)}

    def insert(form: Form) -> Form:
        parts = [
            {coenergy(kept): ratio * c} if v == coenergy(gone) else {inner.get(v, v): c} for v, c in form.items()
        ]  # fmt: skip
        return {v: c for v, c in plus(*parts).items() if c}

    total = {inner[rate(kept)]: field.number(1), inner[rate(gone)]: ratio}
    return [*map(insert, equations), plus({rate(kept): field.number(1)}, times(field.number(-1), total))]
