"""From a model to its program: the same steps as `phnn.simulate` takes, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from phnn.errors import SolverFailed
from phnn.exporting import solvers
from phnn.exporting.chain import Chain
from phnn.exporting.laws import Elements, refuse
from phnn.exporting.program import Names, Program, function, one_line, prefix
from phnn.exporting.step import Balance, Rest, drives
from phnn.integrate.compilable import obstacle
from phnn.integrate.program import compile_network
from phnn.integrate.rest import equilibrium
from phnn.laws.other import advanced
from phnn.network.elements import ModulatorState
from phnn.setup import Setup

Hold = Literal["linear", "zero_order"]
HOLDS = ("linear", "zero_order")
ROOTS = ("init", "step", "substep", "output")


def build(
    setup: Setup,
    dt: float,
    substeps: int,
    hold: Hold = "linear",
    name: str = "",
    further: Sequence[str] = (),
    initial_input: float = 0.0,
) -> Program:
    """The program of a model.

    Args:
        setup: amplifier, network and sensor.
        dt: sample time [s]; substeps: integration steps in it.
        hold: the input between two samples: ``linear`` from one to the next, or ``zero_order``, held.
        name: prefix of what targets make public; that of the model if empty.
        further: ports that are inputs beside the first; the input of the others is zero.
        initial_input: of the first port, at whose rest the program begins if it cannot compute rest by itself.

    Raises:
        InputRefused: a law or block has no exported form; names it, the cause and the remedy.
    """
    network = setup.network
    if reason := obstacle(network):
        raise refuse(setup.name, reason, "export a model with laws of the package")
    if network.senses:
        raise refuse(setup.name, "its output is a rate, which needs the sample after", "let its output be a storage")
    builder = _Builder(setup, dt, substeps, hold, name, further)
    return builder.program(initial_input)


class _Builder:
    """Writes all functions of a program."""

    def __init__(self, setup: Setup, dt: float, substeps: int, hold: Hold, name: str, further: Sequence[str]) -> None:
        network, self.h = setup.network, dt / substeps
        inputs = (network.ports[0], *(p for p in network.ports[1:] if p.name in further))
        names = Names()
        self.key = {p.name: names.of(p.name) for p in inputs}
        storage = next(s for s in network.storages if s.name == network.output)
        self.p = Program(
            prefix(name, setup.name), one_line(setup.name), dt, substeps, hold,
            tuple((self.key[p.name], one_line(p.unit)) for p in inputs),
            (one_line(storage.name), one_line(storage.unit)),
        )  # fmt: skip
        self.p.constant("H", self.h, "step of the integration [s]")
        self.setup, self.network, self.inputs = setup, network, inputs
        self.e = Elements(self.p, setup.parameters)
        self.b = Balance(self.e, network, self.h)
        self.chain = Chain(self.e, setup, self.h, hold)
        self.rest = Rest(self.b)
        self.further = [self.key[p.name] for p in inputs[1:]]

    def program(self, initial_input: float) -> Program:
        """The finished program."""
        self.p.from_rest = self.rest.follows_input
        self._solver_fields()
        self._add("balance", (), self.b.write(), "Equations of a step at the unknowns y: what is left, and its terms")
        solve = self._solver("balance", "FLOORS", "")
        self._init(self._rest_solver() if self.p.from_rest else "", initial_input)
        self._substep(solve)
        self._step()
        self._output()
        self.p.prune(ROOTS)
        return self.p

    def _add(self, name: str, arguments: tuple[str, ...], lines: list[str], about: str) -> None:
        self.p.functions[name] = function(name, arguments, lines, self.p.functions, about)

    def _solver_fields(self) -> None:
        m = max(len(self.b.junctions), 1)
        p = self.p
        for j, name in enumerate(self.b.junctions):
            p.state(f"found_{j}", f"unknown of {name} in the last step")
            p.state(f"before_{j}", "and in the one before")
        p.state("y", "unknowns of a step: mean effort or end state of every junction", (m,))
        p.state("force", "what is left of the equations", (m,))
        p.state("size", "size of their terms", (m,))
        p.state("slope", "latest slope of the equation")
        p.state("known", "whether the derivatives are known")
        for name in ("base", "scale", "step", "begun"):
            p.state(name, "work of the solver", (m,))
        for name in ("jacobian", "matrix"):
            p.state(name, "work of the solver", (m, m))

    def _solver(self, balance: str, table: str, suffix: str) -> str:
        """The solver of ``balance``; returns its name, empty where there are no unknowns."""
        m = len(self.b.junctions)
        if m == 0:
            return ""
        floors = self._floors() if not suffix else self.rest.floors()
        about = "least slope of every equation in its unknown"
        self.p.table(table, (tuple(map(float, floors)),), about)
        renamed = {"balance": balance, "UNKNOWNS": str(m), "FLOORS": table}
        if m > 1:
            return self.e.sources.name_of(solvers.solve_many, "solver", renamed, f"solve{suffix}", suffix)
        value = self.e.sources.name_of(solvers.balance_value, "solver", renamed, "", suffix)
        renamed = renamed | {"value": value}
        return self.e.sources.name_of(solvers.solve_one, "solver", renamed, f"solve{suffix}", suffix)

    def _rest_solver(self) -> str:
        self._add("rest_balance", (), self.rest.write(), "Forces on the junctions at rest at the displacements y")
        return self._solver("rest_balance", "REST_FLOORS", "_rest")

    def _floors(self) -> list[float]:
        linear = (2.0 / self.b.stiffness_of(n) if self.b.is_linear(n) else 1.0 for n in self.b.junctions)
        return [float(value) / self.h for value in linear]

    def _actions(self, values: dict[str, str]) -> list[str]:
        return [f"{self.b.action(p.name)} = {self.e.action(p, values[p.name])}" for p in self.network.ports]

    def _init(self, solve: str, initial_input: float) -> None:
        first = self.inputs[0].name
        given = {p.name: f"u_{self.key[p.name]}" for p in self.inputs[1:]}
        zero = {p.name: "0.0" for p in self.network.ports if p not in self.inputs}
        lines = ["s.count = 0.0", "s.u = u"] if self.chain_counts else ["s.u = u"]
        self.p.state("u", "last input")
        lines += [f"s.u_{n} = u_{n}" for n in self.further]
        for n in self.further:
            self.p.state(f"u_{n}", f"last input of the port {n}")
        lines += [*self.chain.begin, *self._actions({first: "u", **given, **zero})]
        lines += self._at_rest(solve) if solve else self._stored(initial_input)
        for j, name in enumerate(self.b.junctions):
            start = f"{self.b.x(name)}"
            if self.b.is_linear(name):
                start = f"{start} / {self.b.capacity(name)}"
            lines += [f"s.found_{j} = {start}", f"s.before_{j} = {start}"]
        lines += [*self._unknown(), *[f"s.slope = {self._floors()[0]!r}"] * (len(self.b.junctions) == 1)]
        self._add("init", ("u", *(f"u_{n}" for n in self.further)), lines, "Begin at rest under constant inputs")

    @property
    def chain_counts(self) -> bool:
        """Whether something follows the time since the start."""
        # Sources are written with the step, after init.
        return bool(self.setup.sources) or "count" in self.p.fields

    def _at_rest(self, solve: str) -> list[str]:
        m, one = len(self.b.junctions), len(self.b.junctions) == 1
        lines = [f"s.y[{j}] = 0.0" for j in range(m)]
        lines += self._unknown()
        lines += [f"s.slope = {self.rest.floors()[0]!r}"] if one else []
        return [*lines, f"solved = {solve}(s)", "if solved < 1.0:", *[f"    {x} = 0.0" for x in self._storages()]]

    def _unknown(self) -> list[str]:
        """No derivatives are known yet: those of one equation are a slope, of several a matrix."""
        m = len(self.b.junctions)
        cleared = [f"for i in range({m}):", f"    for j in range({m}):", "        s.jacobian[i][j] = 0.0"]
        return ["s.known = 0.0", *(cleared if m > 1 else [])]

    def _storages(self) -> list[str]:
        return [self.b.x(name) for name in self.network.storage_names]

    def _stored(self, initial_input: float) -> list[str]:
        """The state of rest under one input, where something flows at rest."""
        program, u = compile_network(self.network), np.zeros(len(self.network.ports))
        u[0] = initial_input
        try:
            values = equilibrium(program, self.network, u).tolist()
        except SolverFailed:
            values = [0.0] * len(program.states)
        return [f"{self.b.x(name)} = {value!r}" for name, value in zip(program.states, values, strict=True)]

    def _substep(self, solve: str) -> None:
        first = self.inputs[0].name
        means = {p.name: f"mean_{self.key[p.name]}" for p in self.inputs[1:]}
        zero = {p.name: "0.0" for p in self.network.ports if p not in self.inputs}
        heard = {s.port: self.chain.source(s) for s in self.setup.sources}
        lines = [*self.chain.step, "mean = (u_start + 4.0 * u_middle + u_end) / 6.0"]
        lines += self._actions({**zero, first: "mean", **means, **heard})
        m = len(self.b.junctions)
        lines += [f"s.y[{j}] = 2.0 * s.found_{j} - s.before_{j}" for j in range(m)]
        lines += [f"solved = {solve}(s)"] if solve else ["balance(s)", "solved = 1.0"]
        for j in range(m):
            lines += [f"s.before_{j} = s.found_{j}", f"s.found_{j} = s.y[{j}]"]
        for memory in self.network.memories:
            lines += self._remembered(memory)
        states = (*self.network.storage_names, *(m.name for m in self.network.memories))
        lines += [f"{self.b.x(name)} = {self.b.end(name)}" for name in states]
        lines += ["s.count = s.count + 1.0"] if self.chain_counts else []
        arguments = ("u_start", "u_middle", "u_end", *means.values())
        self._add(
            "substep", arguments, [*lines, "return solved"], "One step; 1 where its equations were solved, else 0"
        )

    def _remembered(self, memory: ModulatorState) -> list[str]:
        """The step of a modulator state by its mean drive."""
        key = self.e.states.of(memory.name)
        x, what = self.b.x(memory.name), f"memory {memory.name}"
        rate = self.e.memory(memory, "rate", x, f"drive_{key}")
        decay = self.e.memory(memory, "decay")
        lines = [f"drive_{key} = {' + '.join(drives(self.b, memory)) or '0.0'}"]
        return [*lines, f"{self.b.end(memory.name)} = {self.e.call(advanced, what, x, 'H', rate, decay)}"]

    def _step(self) -> None:
        k = self.p.substeps
        lines = ["solved = 1.0"]
        if self.p.hold == "linear":
            lines += [f"rise = (u - s.u) / {k}.0", *(f"rise_{n} = (u_{n} - s.u_{n}) / {k}.0" for n in self.further)]
            points = [f"s.u + (i + {at}) * rise" for at in ("0.0", "0.5", "1.0")]
            further = [f"s.u_{n} + (i + 0.5) * rise_{n}" for n in self.further]
        else:
            points, further = ["u"] * 3, [f"u_{n}" for n in self.further]
        lines += [
            f"for i in range({k}):",
            f"    done = substep(s, {', '.join([*points, *further])})",
            "    solved = solved * done",
            "s.u = u",
            *(f"s.u_{n} = u_{n}" for n in self.further),
            "return solved",
        ]
        about = "One sample time, to the given input; 1 where all its steps were solved, else 0"
        self._add("step", ("u", *(f"u_{n}" for n in self.further)), lines, about)

    def _output(self) -> None:
        lines = [f"y = {self.b.x(self.network.output)}", *self.chain.output, "return y"]
        self._add("output", (), lines, "What is measured now")
