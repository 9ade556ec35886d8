"""Laws of a network's elements as expressions of an exported program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from phnn.errors import InputRefused
from phnn.exporting.names import Names, one_line
from phnn.exporting.program import Function, Program, function
from phnn.exporting.sources import Sources
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES
from phnn.parameters import Parameter


class Elements:
    """Expressions of laws and parameters; what they name is added to the program.

    Args:
        program: to be filled.
        parameters: of the setup, by name.
    """

    def __init__(self, program: Program, parameters: Mapping[str, Parameter]) -> None:
        self.program, self.parameters = program, parameters
        self.sources = Sources(program.functions)
        self.names, self.states, self.tables = Names(), Names(), Names()

    def parameter(self, name: str) -> str:
        """The constant of a parameter."""
        p = self.parameters[name]
        about = one_line(f"{name}: {p.description or 'parameter'} [{p.unit}]")
        return self.program.constant(f"P_{self.names.of(name)}", p.value, about)

    def derived(self, name: str, value: float, about: str) -> str:
        """A constant that follows from parameters and the step."""
        return self.program.constant(f"D_{name}", value, about)

    def values(self, names: Sequence[str]) -> list[float]:
        """Values of parameters."""
        return [self.parameters[n].value for n in names]

    def call(self, source: Callable[..., Any], what: str, *arguments: str) -> str:
        """A call of one of the package's functions."""
        return f"{self.sources.name_of(source, what)}({', '.join(arguments)})"

    def law(self, law: Any, part: str, what: str, leading: Sequence[str], names: Sequence[str]) -> str:
        """A call of a part of a registered law, such as ``mean_effort``, with the constants of its parameters."""
        return self.call(getattr(law, part), what, *leading, *(self.parameter(n) for n in names))

    def mean_effort(self, storage: Any, a: str, b: str) -> str:
        """``(H(b) − H(a))/(b − a)`` of a storage."""
        what = f"storage {storage.name}"
        if isinstance(storage.law, str):
            return self.law(STORAGE_LAWS[storage.law], "mean_effort", what, (a, b), storage.parameters)
        return f"{self._sum_over_units(WIDE_STORAGES, storage, what, ('a', 'b'))}({a}, {b})"

    def flow(self, resistor: Any, effort: str, q: str) -> str:
        """``φ(ε, q)`` of a resistor."""
        what = f"resistor {resistor.name}"
        if isinstance(resistor.law, str):
            return self.law(RESISTOR_LAWS[resistor.law], "flow", what, (effort, q), resistor.parameters)
        return f"{self._sum_over_units(WIDE_RESISTORS, resistor, what, ('effort',))}({effort})"

    def thresholds(self, resistor: Any, q: str) -> str:
        """``(ρ, lo, hi)(q)`` of a piecewise linear resistor."""
        what = f"resistor {resistor.name}"
        return self.law(RESISTOR_LAWS[resistor.law], "thresholds", what, (q,), resistor.parameters)

    def action(self, port: Any, u: str) -> str:
        """``ψ(u)`` of a port."""
        if port.law == "linear":
            return u
        return self.law(PORT_LAWS[port.law], "action", f"port {port.name}", (u,), port.parameters)

    def factor(self, modulation: Any, q: str) -> str:
        """``f(q)`` of a modulation."""
        what = f"modulation of {modulation.ratio}"
        return self.law(FACTOR_LAWS[modulation.law], "factor", what, (q,), modulation.parameters)

    def memory(self, memory: Any, part: str, *leading: str) -> str:
        """``rate`` or ``decay`` of a modulator state."""
        return self.law(MEMORY_LAWS[memory.law], part, f"memory {memory.name}", leading, memory.parameters)

    def _sum_over_units(self, known: Mapping[str, Any], element: Any, what: str, arguments: tuple[str, ...]) -> str:
        """A function of a law that is a sum over units, with its weights in a table; returns its name."""
        law = known[element.law.law]
        name = f"law_{self.tables.of(what)}"
        if name in self.program.functions:
            return name
        weights = [float(w) for w in element.law.weights().detach().tolist()]
        head, units = weights[: law.head], weights[law.head :]
        rows = tuple(tuple(units[i : i + law.per_unit]) for i in range(0, len(units), law.per_unit))
        table = f"W_{self.tables.of(what)}"
        self.program.table(table, rows, one_line(f"weights of {what}, a row for each unit"))
        given = [self.derived(f"{name}_{i}", w, one_line(f"weight of {what}")) for i, w in enumerate(head)]
        entries = [f"{table}[i][{j}]" for j in range(law.per_unit)]
        lines = [
            "total = 0.0",
            f"for i in range({len(rows)}):",
            f"    total = total + {self.call(law.unit, what, *arguments, *entries)}",
            f"return {self.call(law.combine, what, *arguments, 'total', *given)}",
        ]
        self._add(name, arguments, lines, f"law of {what}")
        return name

    def _add(self, name: str, arguments: tuple[str, ...], lines: list[str], about: str) -> None:
        known = self.program.functions
        known[name] = self.plain(name, arguments, lines, one_line(about))

    def plain(self, name: str, arguments: tuple[str, ...], lines: list[str], about: str) -> Function:
        """A function that does not know the state."""
        return function(name, arguments, lines, self.program.functions, about, of_state=False)


def refuse(what: str, cause: str, remedy: str) -> InputRefused:
    """What cannot be exported, why, and what to do."""
    return InputRefused(f"{what}: cannot be exported: {cause}: {remedy}")
