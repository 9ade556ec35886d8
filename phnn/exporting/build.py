"""From a model to its program: the same steps as `phnn.trajectory` takes, one after the other."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import numpy as np

from phnn.chain import AMPLIFIERS, SENSORS, SOURCES, amplifiers
from phnn.errors import SolverFailed
from phnn.exporting import solvers
from phnn.exporting.laws import Elements, refused
from phnn.exporting.program import Names, Program, one_line, prefix
from phnn.exporting.step import Balance, Rest, drives
from phnn.integrate.program import GYRATORS, LEAF_INLETS, compile_network, rows_of
from phnn.integrate.rest import equilibrium
from phnn.integrate.scheme import obstacle
from phnn.laws.other import advanced
from phnn.network.bondgraph.description import MASSLESS, effort_unit
from phnn.setup import Block, Setup, Source

# Blocks without a memory are translated from `phnn.chain` as they are. Of those with a state the package has the step
# of half a sub-step, which is translated; only what carries it from point to point stands here.

_POINTS = ("u_start", "u_middle", "u_end")
# Longest delay in steps: the state holds as many rows of the input.
_LONGEST = 10000
# A delayed point this close to the end of a step, in steps, counts as on it.
_ROUNDED = 1e-9


class Chain:
    """Writes the lines by which an input becomes the voltage at the port, and a state the output.

    Attributes:
        begin: lines of ``init``: from the constant command ``u`` to the voltage at rest, in the same variable.
        step: lines of ``substep``: from the command at start, middle and end of the step to the voltage there.
        output: lines of ``output``: from the network's output ``y`` to the recorded one.
    """

    def __init__(self, elements: Elements, setup: Setup, h: float, hold: str) -> None:
        self.e, self.h, self.hold = elements, h, hold
        self.begin: list[str] = []
        self.step: list[str] = []
        self.output: list[str] = []
        dynamic: dict[str, Callable[[Block, str], None]] = {
            "lowpass": self._lowpass, "fading": self._lowpass, "second_order_lowpass": self._second_order,
            "slew_limit": self._slew,
            "bouc_wen": self._of_path, "slipping": self._of_path, "delay": self._delay,
        }  # fmt: skip
        for k, block in enumerate(setup.amplifier):
            what = f"amplifier {block.kind}"
            if not AMPLIFIERS[block.kind].remembers:
                for lines, points in ((self.begin, ("u",)), (self.step, _POINTS)):
                    lines += [f"{u} = {self._static(AMPLIFIERS, block, what, u, '0.0', '0.0')}" for u in points]
            elif block.kind in dynamic:
                dynamic[block.kind](block, f"{block.kind}_{k + 1}")
            else:
                raise refused(what, "it has no step of its own", "export a model without it")
        for block in setup.sensor:
            what = f"sensor {block.kind}"
            if SENSORS[block.kind].remembers:
                cause = "it needs the output after the instant that it is asked for"
                raise refused(what, cause, "leave the sensor out (--no-sensor), the output is then what it senses")
            time = "s.count * H"
            self.e.program.state("count", "steps since the start")
            self.output.append(f"y = {self._static(SENSORS, block, what, 'y', time)}")

    def source(self, source: Source) -> str:
        """Return the mean of a source over a step, by Simpson's rule; it begins with the first step."""
        what = f"source {source.kind}"
        self.e.program.state("count", "steps since the start")
        values = [self._static(SOURCES, source, what, f"(s.count + {at}) * H") for at in ("0.0", "0.5", "1.0")]
        return f"({values[0]} + 4.0 * {values[1]} + {values[2]}) / 6.0"

    def _static(self, kinds: dict, block: Block | Source, what: str, *leading: str) -> str:
        return self.e.call(kinds[block.kind].law, what, *leading, *(self.e.parameter(n) for n in block.parameters))

    def _weights(self, key: str, names: tuple[str, ...], values: tuple[np.ndarray, ...]) -> list[str]:
        about = f"weight of {key.rpartition('_')[0]} over half a step"
        return [self.e.derived(f"{key}_{n}", float(v[0]), about) for n, v in zip(names, values, strict=True)]

    def _lowpass(self, block: Block, key: str) -> None:
        # Of a fading input a share of the low-pass is taken away.
        rest = f"- {self.e.parameter(block.parameters[0])} * " if block.kind == "fading" else ""
        state = self.e.program.state(key, "output of the amplifier's low-pass")
        values = amplifiers.first_order_weights(np.array([self.h]), *self.e.values(block.parameters[-1:]))
        weights = self._weights(key, ("keep", "old", "new"), values)
        step = partial(self.e.call, amplifiers.first_order_step, key, state)
        self._follow(state, lambda a, b: [f"{state} = {step(a, b, *weights)}"], rest)

    def _slew(self, block: Block, key: str) -> None:
        state = self.e.program.state(key, "output of the slew-rate limit")
        reach = f"0.5 * H * {self.e.parameter(block.parameters[0])}"
        self._follow(state, lambda a, b: [f"{state} = {self.e.call(amplifiers.slew_step, key, state, b, reach)}"])

    def _follow(self, state: str, stepped: Callable[[str, str], list[str]], rest: str = "") -> None:
        """Add a block whose state is its output, in equilibrium equal to its input; ``rest`` stands between input and
        state where the output is the input less a part of the state."""
        self.begin.append(f"{state} = u")
        self.begin += [f"u = u {rest}{state}"] if rest else []
        self.step += [
            f"v_start = {state}",
            *stepped("u_start", "u_middle"),
            f"v_middle = {state}",
            *stepped("u_middle", "u_end"),
            *(f"u_{at} = {f'u_{at} {rest}' if rest else ''}v_{at}" for at in ("start", "middle")),
            f"u_end = {f'u_end {rest}' if rest else ''}{state}",
        ]

    def _second_order(self, block: Block, key: str) -> None:
        state = self.e.program.state(key, "output of the amplifier's low-pass")
        rate = self.e.program.state(f"{key}_rate", "and its derivative by the time in units of tau")
        tau, zeta = self.e.values(block.parameters)
        values = amplifiers.second_order_weights(np.array([self.h]), tau, zeta)
        s, *weights = self._weights(key, ("s", "even", "odd"), values)
        damping = self.e.parameter(block.parameters[1])

        def stepped(a: str, b: str) -> list[str]:
            slope = f"({b} - {a}) / {s}"
            moved = self.e.call(amplifiers.second_order_step, key, f"{state} - {a}", rate, slope, *weights, damping)
            return [f"v_off, {rate} = {moved}", f"{state} = {b} + v_off"]

        self._follow(state, stepped)
        self.begin.append(f"{rate} = 0.0")

    def _of_path(self, block: Block, key: str) -> None:
        last = self.e.program.state(f"{key}_last", "last input of the Bouc-Wen hysteresis")
        state = self.e.program.state(key, "state of the Bouc-Wen hysteresis")
        values = [self.e.parameter(n) for n in block.parameters]
        advance = amplifiers.bouc_wen_step if block.kind == "bouc_wen" else amplifiers.slip_step
        weight, shape = (values[-1], values[:-1]) if block.kind == "bouc_wen" else (values[0], values[1:])
        self.begin += [f"{last} = u", f"{state} = 0.0"]
        for u in _POINTS:
            self.step += [
                f"{state} = {self.e.call(advance, key, state, f'{u} - {last}', *shape)}",
                f"{last} = {u}",
                f"{u} = {u} - {weight} * {state}",
            ]

    def _delay(self, block: Block, key: str) -> None:
        """A ring of rows, each the input at start, middle and end of a step, read at the point ``τ`` ago."""
        what = "amplifier delay"
        if self.hold == "zero_order":
            cause = "an input that jumps at every sample has no parabola"
            raise refused(what, cause, "take --input linear and a target other than fmu")
        steps = self.e.values(block.parameters)[0] / self.h
        whole = math.floor(steps)
        if whole > _LONGEST:
            raise refused(what, f"it lasts {whole} steps, at most {_LONGEST} are kept", "take larger steps")
        rows = whole + 2
        ring = self.e.program.state(f"{key}_rows", "input at start, middle and end of past steps", (rows, 3))
        at = self.e.program.state(f"{key}_at", "row of the present step", index=True)
        self.begin += [f"for i in range({rows}):", *(f"    {ring}[i][{k}] = u" for k in range(3)), f"{at} = 0"]
        self.step += [f"{ring}[{at}][{k}] = {u}" for k, u in enumerate(_POINTS)]
        for k, u in enumerate(_POINTS):
            # Points of the present step lie ``steps − k/2`` before its start.
            back = max(math.ceil(steps - 0.5 * k - _ROUNDED), 0)
            share = self.e.derived(
                f"{key}_share_{k}", back - (steps - 0.5 * k), "place within the delayed step, 0 to 1"
            )
            row = f"{key}_{k}"
            self.step += [f"{row} = {at} - {back}", f"if {row} < 0:", f"    {row} = {row} + {rows}"]
            entries = (f"{ring}[{row}][{i}]" for i in range(3))
            self.step.append(f"{u}, unused = {self.e.call(amplifiers.parabola, key, *entries, share)}")
        self.step += [f"{at} = {at} + 1", f"if {at} >= {rows}:", f"    {at} = 0"]


Hold = Literal["linear", "zero_order"]
HOLDS = ("linear", "zero_order")
ROOTS = ("init", "step", "substep", "output")


class Builder:
    """Writes all functions of a program; arguments as of `phnn.export`, ``hold`` is its ``input``.

    Raises:
        InputRefused: a law or block has no exported form; names it, the cause and the remedy.
    """

    def __init__(self, setup: Setup, dt: float, substeps: int, hold: Hold, name: str, ports: Sequence[str]) -> None:
        network, self.h = setup.network, dt / substeps
        if reason := obstacle(network):
            raise refused(setup.name, reason, "export a model with laws of the package")
        inputs = (network.ports[0], *(p for p in network.ports[1:] if p.name in ports))
        names = Names()
        self.key = {p.name: names.of(p.name) for p in inputs}
        measured = next((s.name, s.unit) for s in network.storages if s.name == network.output)
        if network.senses:
            # What the source of an imposed motion needs for it.
            measured = network.senses, next(effort_unit(p.unit) for p in network.ports if p.name == network.senses)
        self.p = Program(
            prefix(name, setup.name), one_line(setup.name), dt, substeps, hold,
            tuple((self.key[p.name], one_line(p.unit)) for p in inputs),
            (one_line(measured[0]), one_line(measured[1])),
        )  # fmt: skip
        self.p.constant("H", self.h, "step of the integration [s]")
        self.setup, self.network, self.inputs = setup, network, inputs
        self.e = Elements(self.p, setup.parameters)
        self.b = Balance(self.e, network, self.h)
        self.chain = Chain(self.e, setup, self.h, hold)
        self.rest = Rest(self.b)
        for name in self.b.moved if hold == "zero_order" else ():
            if self.network.parameters[self.b.storage(name).parameters[0]].value > MASSLESS:
                cause = f"{name} has an inertia, and its imposed motion jumps at every sample"
                raise refused(setup.name, cause, "take --input linear and a target other than fmu")
        self.further = [self.key[p.name] for p in inputs[1:]]
        # Whether something follows the time since the start; sources are written with the step, after init.
        self.counts = bool(setup.sources) or "count" in self.p.fields

    def program(self, initial_input: float) -> Program:
        """Return the finished program."""
        # Whether displacements of the junctions say all about rest: there are some, and no input acts beside them.
        program = compile_network(self.network)
        inlets = sum(len(rows_of(program.table, kind)) for kind in (LEAF_INLETS, GYRATORS))
        self.p.from_rest = bool(program.junctions) and not inlets and all(f > 0.0 for f in self.rest.floors())
        self._solver_fields()
        self.p.add("balance", (), self.b.write(), "Equations of a step at the unknowns y: what is left, and its terms")
        solve = self._solver("balance", "FLOORS", self._floors(), "")
        rest = ""
        if self.p.from_rest:
            self.p.add("rest_balance", (), self.rest.write(), "Forces on the junctions at rest at the displacements y")
            rest = self._solver("rest_balance", "REST_FLOORS", self.rest.floors(), "_rest")
        self._init(rest, solve, initial_input)
        self._substep(solve)
        self._step()
        # Efforts of a step hold in its middle: two of them tell that at its end.
        signal = "1.5 * s.effort - 0.5 * s.effort_before" if self.b.moved else self.b.x(self.network.output)
        lines = [f"y = {signal}", *self.chain.output, "return y"]
        self.p.add("output", (), lines, "What is measured now")
        self.p.functions = self.p.needed(*ROOTS)
        return self.p

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

    def _solver(self, balance: str, table: str, floors: Sequence[float], suffix: str) -> str:
        """Write the solver of ``balance`` and return its name; empty where there are no unknowns."""
        m = len(self.b.junctions)
        if m == 0:
            return ""
        self.p.table(table, (tuple(floors),), "least slope of every equation in its unknown")
        renamed = {"balance": balance, "UNKNOWNS": str(m), "FLOORS": table}
        if m > 1:
            return self.e.sources.name_of(solvers.solve_many, "solver", renamed, suffix, f"solve{suffix}")
        renamed["value"] = self.e.sources.name_of(solvers.balance_value, "solver", renamed, suffix)
        return self.e.sources.name_of(solvers.solve_one, "solver", renamed, suffix, f"solve{suffix}")

    def _floors(self) -> list[float]:
        linear = (2.0 / self.b.stiffness_of(n) if self.b.is_linear(n) else 1.0 for n in self.b.junctions)
        return [value / self.h for value in linear]

    def _actions(self, u: str, heard: dict[str, str]) -> list[str]:
        """Return the actions of all ports: on `u`, on `u_NAME` of further ports, else on a heard source, or 0."""
        values = {name: f"{u}_{key}" for name, key in self.key.items()} | {self.inputs[0].name: u} | heard
        given = ((p, values.get(p.name, "0.0")) for p in self.network.ports)
        return [f"{self.b.action(p.name)} = {self.e.law(p, 'action', value)}" for p, value in given]

    def _init(self, rest: str, solve: str, initial_input: float) -> None:
        lines = ["s.count = 0.0", "s.u = u"] if self.counts else ["s.u = u"]
        self.p.state("u", "last input")
        lines += [f"s.u_{n} = u_{n}" for n in self.further]
        for n in self.further:
            self.p.state(f"u_{n}", f"last input of the port {n}")
        lines += [*self.chain.begin, *self._actions("u", {})]
        lines += self._at_rest(rest) if rest else self._stored(initial_input)
        for j, name in enumerate(self.b.junctions):
            start = self.b.x(name)
            if self.b.is_linear(name):
                start = f"{start} / {self.b.capacity(name)}"
            lines += [f"s.found_{j} = {start}", f"s.before_{j} = {start}"]
        lines += self._unknown(self._floors())
        if self.b.moved:
            (moved,) = self.b.moved
            lines.append(f"{self.b.x(moved)} = {self.b.action(self.network.senses)} * {self.b.capacity(moved)}")
            lines += [f"s.y[{j}] = s.found_{j}" for j in range(len(self.b.junctions))]
            solved = [f"solved = {solve}(s)", "if solved < 1.0:", "    s.supplied = 0.0"]
            lines += [*(solved if solve else ["balance(s)"]), "s.effort = s.supplied"]
            lines += ["s.effort_before = s.effort", "s.begins = 1.0"]
            self.p.state("effort", "mean effort at the source in the last step")
            self.p.state("effort_before", "and in the one before")
            self.p.state("begins", "whether no step was taken yet")
        self.p.add("init", ("u", *(f"u_{n}" for n in self.further)), lines, "Begin at rest under constant inputs")

    def _at_rest(self, solve: str) -> list[str]:
        return [
            *(f"s.y[{j}] = 0.0" for j in range(len(self.b.junctions))),
            *self._unknown(self.rest.floors()),
            f"solved = {solve}(s)",
            "if solved < 1.0:",
            *(f"    {self.b.x(n)} = 0.0" for n in self.network.storage_names),
        ]

    def _unknown(self, floors: Sequence[float]) -> list[str]:
        """Begin without known derivatives: one equation with its least slope, several with an empty matrix."""
        m = len(floors)
        cleared = [f"for i in range({m}):", f"    for j in range({m}):", "        s.jacobian[i][j] = 0.0"]
        return ["s.known = 0.0", *(cleared if m > 1 else [f"s.slope = {floor!r}" for floor in floors])]

    def _stored(self, initial_input: float) -> list[str]:
        """Return the state of rest under one input, where something flows at rest."""
        program, u = compile_network(self.network), np.zeros(len(self.network.ports))
        u[0] = initial_input
        try:
            values = equilibrium(self.network, u).tolist()
        except SolverFailed:
            values = [0.0] * len(program.states)
        known = (*self.b.storages, *(m.name for m in self.network.memories))
        states = zip(program.states, values, strict=True)
        return [f"{self.b.x(name)} = {value!r}" for name, value in states if name in known]

    def _substep(self, solve: str) -> None:
        heard = {s.port: self.chain.source(s) for s in self.setup.sources}
        lines = [*self.chain.step, "mean = (u_start + 4.0 * u_middle + u_end) / 6.0"]
        lines += self._actions("mean", heard)
        m = len(self.b.junctions)
        lines += [f"s.y[{j}] = 2.0 * s.found_{j} - s.before_{j}" for j in range(m)]
        lines += [f"solved = {solve}(s)"] if solve else ["balance(s)", "solved = 1.0"]
        for j in range(m):
            lines += [f"s.before_{j} = s.found_{j}", f"s.found_{j} = s.y[{j}]"]
        for memory in self.network.memories:
            # By the exact flow under its mean drive.
            x, drive = self.b.x(memory.name), f"drive_{self.e.states.of(memory.name)}"
            rate, decay = self.e.law(memory, "rate", x, drive), self.e.law(memory, "decay")
            lines.append(f"{drive} = {' + '.join(drives(self.b, memory)) or '0.0'}")
            end = self.e.call(advanced, f"memory {memory.name}", x, "H", rate, decay)
            lines.append(f"{self.b.end(memory.name)} = {end}")
        states = (*self.b.storages, *(m.name for m in self.network.memories))
        lines += [f"{self.b.x(name)} = {self.b.end(name)}" for name in states]
        if self.b.moved:
            # That of init holds at its instant, half a step later than a mean before the first one would.
            lines += ["s.effort_before = s.effort", "if s.begins > 0.0:"]
            lines += ["    s.effort_before = 2.0 * s.effort - s.supplied", "s.begins = 0.0", "s.effort = s.supplied"]
        lines += ["s.count = s.count + 1.0"] if self.counts else []
        arguments = ("u_start", "u_middle", "u_end", *(f"mean_{n}" for n in self.further))
        self.p.add(
            "substep", arguments, [*lines, "return solved"], "One step; 1 where its equations were solved, else 0"
        )

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
            # The effort jumps with a held input.
            *(
                ["    if i < 1:", "        s.effort_before = s.effort"]
                if self.b.moved and self.p.hold != "linear"
                else []
            ),
            "s.u = u",
            *(f"s.u_{n} = u_{n}" for n in self.further),
            "return solved",
        ]
        about = "One sample time, to the given input; 1 where all its steps were solved, else 0"
        self.p.add("step", ("u", *(f"u_{n}" for n in self.further)), lines, about)
