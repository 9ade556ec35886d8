"""The network from solved equations: every coefficient becomes a number or one named parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sympy import Expr

from phnn.errors import StructureViolated
from phnn.laws import RESISTOR_LAWS
from phnn.network.bondgraph.causality import Branch, resistors_of, sources_of
from phnn.network.bondgraph.description import BondGraph, C, I, R, Se, Sf
from phnn.network.bondgraph.equations import Field, Form
from phnn.network.bondgraph.structure import coenergy, source
from phnn.network.elements import Coupling, Network, Port, Ratio, Resistor, Storage
from phnn.parameters import Parameter, constant

# φ = ε/(R · 1): the law "maxwell" with a constant of one is the inverse of "linear", and R stays the parameter.
_INVERSE, _ONE = "maxwell", "one"


def assemble(
    graph: BondGraph,
    field: Field,
    stores: Sequence[C | I],
    parameters: Mapping[str, Parameter],
    rates: Mapping[str, Form],
    branches: Mapping[str, Branch],
) -> Network:
    """The network of ``ẋ_k = Σ_l J_kl e_l − Σ_r b_rk φ_r + Σ_p g_kp ψ_p(u_p)`` with ``ε_r = Σ_k b_rk e_k``.

    The entries of ``J`` are read above the diagonal, those of ``b`` from what the laws take: the junctions conserve
    power, so that the rest repeats them.

    Raises:
        StructureViolated: an entry that is neither a number nor plus or minus one parameter.
    """
    names = [s.name for s in stores]
    couplings = []
    for i, k in enumerate(names):
        for m in names[i + 1 :]:
            if coefficient := rates[k].get(coenergy(m)):
                sign, ratio = _signed(field.expression(coefficient), f"between the storages {k} and {m}")
                # A number carries its sign; a name's sign is who is named first.
                couplings.append(Coupling(k, m, ratio) if sign > 0 else Coupling(m, k, ratio))
    one = constant(_unused(_ONE, parameters), 1.0, "1", f"makes the law {_INVERSE} the inverse of linear")
    parameters = {**parameters, one.name: one}
    resistors = tuple(_resistor(r, branches[r.name], field, names, parameters, one.name) for r in resistors_of(graph))
    ports = tuple(_port(s, rates, field, names) for s in sources_of(graph))
    used: list[Ratio] = [n for s in stores for n in s.parameters]
    used += [n for r in resistors for n in (*r.parameters, *r.on.values())]
    used += [n for p in ports for n in (*p.parameters, *p.on.values())] + [c.ratio for c in couplings]
    used += [n for m in graph.modulations for n in m.parameters] + [n for m in graph.memories for n in m.parameters]
    table = {n: p for n, p in parameters.items() if n in used}
    storages = tuple(Storage(s.name, s.law, s.parameters, s.unit) for s in stores)
    return Network(storages, resistors, tuple(couplings), ports, table, graph.output, graph.modulations, graph.memories)


def _unused(name: str, taken: Mapping[str, Parameter]) -> str:
    return _unused(name + "_", taken) if name in taken else name


def _resistor(
    resistor: R, acts: Branch, field: Field, names: Sequence[str], parameters: Mapping[str, Parameter], one: str
) -> Resistor:
    where = f"at the resistor {resistor.name}"
    law, given = (_INVERSE, (*resistor.parameters, one)) if acts.inverted else (resistor.law, resistor.parameters)
    takes = {n: field.expression(c) for n in names if (c := acts.takes.get(coenergy(n)))}
    turned = {n: -c for n, c in takes.items()}
    # φ(−ε) = −φ(ε): an odd law may as well look from the other side.
    if _minuses(turned) < _minuses(takes) and _is_odd(resistor.law, [parameters[n].value for n in resistor.parameters]):
        takes = turned
    return Resistor(resistor.name, law, {n: _positive(c, where) for n, c in takes.items()}, given, resistor.reads)


def _port(element: Se | Sf, rates: Mapping[str, Form], field: Field, names: Sequence[str]) -> Port:
    where = f"at the source {element.name}"
    on = {n: _positive(field.expression(c), where) for n in names if (c := rates[n].get(source(element.name)))}
    return Port(element.name, on, element.law, element.parameters, element.unit)


def _minuses(coefficients: Mapping[str, Expr]) -> tuple[int, bool]:
    """How many named ratios have a minus, which cannot stay, and whether the first entry has one."""
    minus = [_is_negative(c) for c in coefficients.values()]
    named = [not c.is_number for c in coefficients.values()]
    return sum(m and n for m, n in zip(minus, named, strict=True)), minus[0]


def _is_negative(coefficient: Expr) -> bool:
    return bool(coefficient.could_extract_minus_sign())


def _is_odd(law: Any, values: Sequence[float]) -> bool:
    """Whether ``φ(−ε) = −φ(ε)``, tried over many magnitudes; not known of a torch module."""
    if not isinstance(law, str) or law not in RESISTOR_LAWS:
        return False
    flow = RESISTOR_LAWS[law].flow
    efforts = np.logspace(-9.0, 9.0, 91)
    return bool(np.array_equal(flow(-efforts, 0.0, *values), -flow(efforts, 0.0, *values)))


def _signed(coefficient: Expr, where: str) -> tuple[int, Ratio]:
    """Sign and parameter of ``±name``; a number is (1, number).

    Raises:
        StructureViolated: anything else, with the product that arises.
    """
    if coefficient.is_number:
        return 1, float(coefficient)
    sign = -1 if _is_negative(coefficient) else 1
    name = sign * coefficient
    if not name.is_Symbol:
        raise StructureViolated(
            f"the ratio {coefficient} arises {where}: introduce a parameter for it and use that in one transformer or "
            "gyrator, for a network takes a number or a single parameter"
        )
    return sign, str(name)


def _positive(coefficient: Expr, where: str) -> Ratio:
    """A number or a name.

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
