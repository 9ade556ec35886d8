"""The equations of one step as functions of an exported program, unrolled for one network.

They are those of `phnn.integrate.step`: the same junctions, reducible storages and rules. Every sum is written out, so
that the function reads like the model. The state of rest is that of `phnn.integrate.rest`: nothing flows, storages with
resistors are empty, and those without hold what displacements ``y`` of the junctions carry into them, so that no force
is left on any junction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partialmethod
from typing import Any

from phnn.exporting import solvers
from phnn.exporting.laws import Elements
from phnn.integrate import scheme
from phnn.laws import MEMORY_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.leaf import rc_flow, relaxation
from phnn.network.elements import ModulatorState, Network, Ratio, Storage, is_linear
from phnn.network.roles import imposed


def drives(balance: Balance, memory: ModulatorState) -> list[str]:
    """Return the terms of the mean drive: powers of resistors, efforts of storages, actions of ports.

    Of a reducible storage all resistors drive the modulator state or none does, see `phnn.integrate.scheme`.
    """
    network = balance.network
    resistors, ports = {r.name: r for r in network.resistors}, [p.name for p in network.ports]
    terms: list[str] = []
    emptied: set[str] = set()
    for name in network.drives_of(memory):
        if name in network.storage_names:
            terms.append(balance.mean(name))
        elif name in ports:
            terms.append(balance.action(name))
        elif set(resistors[name].on) <= set(balance.known):
            terms.append(balance.power(name))
        else:
            (storage,) = resistors[name].on
            if storage not in emptied:
                # Its resistors together dissipate ``i ē − ΔH/h``.
                x, end = balance.x(storage), balance.end(storage)
                stored = balance.e.law(balance.storage(storage), "mean_effort", x, end)
                supplied = f"{balance.current(storage)} * {balance.mean(storage)}"
                terms.append(f"({supplied} - {stored} * ({end} - {x}) / H)")
            emptied.add(storage)
    return terms


# The displacement at which a slope is taken, as a share of that which a storage's unit effort needs.
_SHARE = 1e-3


class Rest:
    """Writes the lines of ``rest_balance(s)``, which fills ``force`` and ``size`` at the displacements ``y``."""

    def __init__(self, balance: Balance) -> None:
        self.b, self.e, self.network = balance, balance.e, balance.network
        self.lossless = [n for n in balance.reducible if balance.rules[n] == scheme.LOSSLESS]

    def floors(self) -> list[float]:
        """Return the stiffness that acts on every junction near zero."""
        total = dict.fromkeys(self.b.junctions, 0.0)
        for name in self.lossless:
            for other, ratio, _ in self.b.links(name):
                factor = self.e.parameters[ratio].value if isinstance(ratio, str) else float(ratio)
                total[other] += factor * factor * self._slope(name)
        return [float(value) for value in total.values()]

    def _slope(self, name: str) -> float:
        storage = self.b.storage(name)
        if not isinstance(storage.law, str):
            return 1.0
        law, values = STORAGE_LAWS[storage.law], self.e.values(storage.parameters)
        ends = [float(law.mean_effort(x, x, *values)) for x in (-_SHARE, _SHARE)]
        return (ends[1] - ends[0]) / (2.0 * _SHARE)

    def write(self) -> list[str]:
        """Return the lines of the function; states are left at those of the displacements."""
        lines = self._states()
        modulated = dict.fromkeys(m.ratio for m in self.network.modulations)
        lines += [f"{self.b.ratio(r)} = {self.e.parameter(r)}" for r in modulated]
        for m in self.network.modulations:
            name = self.b.ratio(m.ratio)
            read = "0.0" if m.by in self.b.junctions else self.b.x(m.by)
            lines.append(f"{name} = {name} * {self.e.law(m, 'factor', read)}")
        for j in range(len(self.b.junctions)):
            lines += [f"s.force[{j}] = 0.0", f"s.size[{j}] = 0.0"]
        for name in self.lossless:
            effort = self.e.law(self.b.storage(name), "mean_effort", self.b.x(name), self.b.x(name))
            lines.append(f"effort = {effort}")
            for other, ratio, sign in self.b.links(name):
                lines += self._added(other, scaled(sign, self.b.ratio(ratio), "effort"))
        for p in self.network.ports:
            for name, ratio in p.on.items():
                if name in self.b.junctions:
                    lines += self._added(name, scaled(-1, self.b.ratio(ratio), self.b.action(p.name)))
        return lines

    def _added(self, junction: str, term: str) -> list[str]:
        j = self.b.junctions.index(junction)
        return added(f"s.force[{j}]", f"s.size[{j}]", term)

    def _states(self) -> list[str]:
        lines = [f"{self.b.x(name)} = 0.0" for name in self.network.storage_names if name not in self.lossless]
        for name in self.lossless:
            terms = []
            for other, ratio, sign in self.b.links(name):
                plain = self.e.parameter(ratio) if isinstance(ratio, str) else repr(float(ratio))
                terms.append(scaled(sign, plain, f"s.y[{self.b.junctions.index(other)}]"))
            lines.append(f"{self.b.x(name)} = {' + '.join(terms) or '0.0'}")
        ports = [p.name for p in self.network.ports]
        for memory in self.network.memories:
            names = self.network.drives_of(memory)
            held = [(self.b.storage(n), self.b.x(n)) for n in names if n in self.lossless]
            terms = [self.e.law(storage, "mean_effort", x, x) for storage, x in held]
            drive = " + ".join([*terms, *(self.b.action(n) for n in names if n in ports)]) or "0.0"
            rest = f"{self.e.law(memory, 'rate', '0.0', drive)} / {self.e.law(memory, 'decay')}"
            lines.append(f"{self.b.x(memory.name)} = {'0.0' if MEMORY_LAWS[memory.law].anew else rest}")
        return lines


def searched(balance: Balance, name: str) -> str:
    """Return the end state and mean effort of a reducible storage, as an expression with two values."""
    key, e = balance.e.states.of(name), balance.e
    x, current, storage = balance.x(name), balance.current(name), balance.storage(name)
    lost = _lost(balance, name)

    def translated(solver: Callable[..., Any], **named: str) -> str:
        return e.sources.name_of(solver, f"storage {name}", {"lost": lost, "H": "H", **named}, f"_{key}")

    if balance.rules[name] == scheme.RADAU:
        value = translated(solvers.first_stage_value)
        first = translated(solvers.first_root, value=value)
        value = translated(solvers.second_stage_value, first_stage=first)
        stages = translated(solvers.radau, first_stage=first, value=value)
        balance.lines.append(f"one_{key}, two_{key} = {stages}(s, {x}, {current})")
        return f"two_{key}, {balance.stiffness(name)} * (0.75 * one_{key} + 0.25 * two_{key})"
    lines, about = [f"return {e.law(storage, 'mean_effort', 'a', 'b')}"], f"Mean effort of {name} between two states"
    mean = e.program.add(f"effort_{key}", ("a", "b"), lines, about, of_state=False)
    value = translated(solvers.gradient_value, mean_effort=mean)
    end = translated(solvers.gradient, mean_effort=mean, value=value)
    balance.lines.append(f"two_{key} = {end}(s, {x}, {current})")
    return f"two_{key}, {e.law(storage, 'mean_effort', x, f'two_{key}')}"


def _lost(balance: Balance, name: str) -> str:
    """Add the function of the flow into a storage's resistors, at its state or mean effort; return its name."""
    key, e = balance.e.states.of(name), balance.e
    at_state = balance.rules[name] == scheme.RADAU
    effort = f"{balance.stiffness(name)} * state" if at_state else "state"
    lines, total = [f"effort = {effort}"], []
    for r in (balance.network.resistors[k] for k in scheme.resistors_of(balance.network, name)):
        read = "0.0"
        if r.modulated_by is not None:
            read = e.program.state(f"read_{e.names.of(r.name)}", f"what {r.name} reads")
            balance.lines.append(f"{read} = {balance.reading(r.modulated_by)}")
        if isinstance(r.on[name], str) and r.on[name] in balance.modulated:
            ratio = e.program.state(f"gain_{e.names.of(r.name)}", f"ratio of {r.name}")
            balance.lines.append(f"{ratio} = {balance.ratio(r.on[name])}")
        else:
            ratio = balance.ratio(r.on[name])
        total.append(scaled(1, ratio, e.law(r, "flow", scaled(1, ratio, "effort"), read)))
    lines.append(f"return {' + '.join(total)}")
    about = f"Flow into the resistors of {name} {'at its state' if at_state else 'at its mean effort'}"
    return e.program.add(f"lost_into_{key}", ("state",), lines, about)


class Balance:
    """Writes the lines of ``balance(s)``.

    Attributes:
        junctions, reducible: storages whose mean efforts are the unknowns of a step, and the others.
        moved: the storage whose mean effort a source imposes, in a tuple, empty where none does. The effort that the
            source needs for that is the field ``supplied``; its rigid contact has no states of its own.
        known: junctions and what is moved: the balance of forces is written for these.
        storages: names of all storages that have a state in the program.
        rules: how each reducible storage is advanced.
    """

    def __init__(self, elements: Elements, network: Network, h: float) -> None:
        self.e, self.network, self.h = elements, network, h
        given = imposed(network)
        contact = () if given is None else (given.contact, network.output)
        self.moved = () if given is None else (given.motion.momentum,)
        self.junctions = tuple(n for n in scheme.junctions_of(network) if n not in (*contact, *self.moved))
        self.known = (*self.junctions, *self.moved)
        self.storages = tuple(n for n in network.storage_names if n not in contact)
        self.reducible = tuple(n for n in self.storages if n not in self.known)
        self.rules = {n: scheme.rule_of(network, n, scheme.Scheme.DISCRETE_GRADIENT) for n in self.reducible}
        self.couplings = {
            c: times for c, times in scheme.merged_couplings(network).items() if not {*c[:2]} & {*contact}
        }
        self.modulated = {m.ratio for m in network.modulations}
        self.lines: list[str] = []

    def storage(self, name: str) -> Storage:
        """Return the storage of a name."""
        return self.network.storages[self.network.storage_names.index(name)]

    def is_linear(self, name: str) -> bool:
        """Return whether the unknown of a junction is its mean effort; else it is its end state."""
        return is_linear(self.storage(name))

    def x(self, name: str) -> str:
        """Return the field of a state."""
        field = self.e.program.states.setdefault(name, f"x_{self.e.states.of(name)}")
        units = {s.name: s.unit for s in self.network.storages} | {m.name: m.unit for m in self.network.memories}
        return self.e.program.state(field, f"state {name} [{units[name]}]")

    def _field(self, name: str, kind: str, about: str) -> str:
        """Return the field of the state that holds something of an element in a step."""
        names = self.e.names if kind in ("action", "power") else self.e.states
        return self.e.program.state(f"{kind}_{names.of(name)}", about.format(name))

    # Of a state; of a storage, whose constant flow is that into a reducible one; of a port's mean input; of a resistor
    # between junctions.
    end = partialmethod(_field, kind="end", about="{} at the end of the step")
    mean = partialmethod(_field, kind="mean", about="mean effort of {} in the step")
    current = partialmethod(_field, kind="current", about="flow into {} in the step")
    action = partialmethod(_field, kind="action", about="action of the port {} in the step")
    power = partialmethod(_field, kind="power", about="mean power of {} in the step")

    def flow(self, name: str) -> str:
        """Return the local variable of a junction's mean effort."""
        return f"flow_{self.e.states.of(name)}"

    def change(self, name: str) -> str:
        """Return the local variable of a junction's change of state."""
        return f"change_{self.e.states.of(name)}"

    def ratio(self, ratio: Ratio) -> str:
        """Return a ratio: a number, the constant of a parameter, or a local variable if it is modulated."""
        if not isinstance(ratio, str):
            return repr(float(ratio))
        return f"ratio_{self.e.names.of(ratio)}" if ratio in self.modulated else self.e.parameter(ratio)

    def capacity(self, name: str) -> str:
        """Return the constant ``1/s`` of a linear storage, ``E = s x``."""
        value = 1.0 / self.stiffness_of(name)
        return self.e.derived(f"capacity_{self.e.states.of(name)}", value, f"1/s of {name}, effort = s state")

    def stiffness_of(self, name: str) -> float:
        """Return ``s`` of a linear storage, or of another one at rest."""
        storage = self.storage(name)
        law = STORAGE_LAWS[storage.law]
        x = scheme.NEAR_REST
        return float(law.mean_effort(x, x, *self.e.values(storage.parameters))) / x

    def write(self) -> list[str]:
        """Return the lines of the function."""
        self._flows()
        self._modulate()
        for name in self.reducible:
            if name not in self._read_early:
                self._current(name)
        self._junctions()
        for name in self.reducible:
            self.lines.append(f"{self.end(name)}, {self.mean(name)} = {self._advanced(name)}")
            for other, ratio, sign in self.links(name):
                self._add(other, scaled(sign, self.ratio(ratio), self.mean(name)))
        for j, name in enumerate(self.known):
            key = self.e.states.of(name)
            if name in self.moved:
                about = "mean effort that the source of the motion needs in the step"
                self.lines.append(f"{self.e.program.state('supplied', about)} = force_{key}")
            else:
                self.lines += [f"s.force[{j}] = force_{key}", f"s.size[{j}] = size_{key}"]
            self.lines.append(f"{self.end(name)} = {self.x(name)} + {self.change(name)}")
            self.lines.append(f"{self.mean(name)} = {self.flow(name)}")
        return self.lines

    def _flows(self) -> None:
        given = {name: self.action(self.network.senses) for name in self.moved}
        given |= {name: f"s.y[{j}]" for j, name in enumerate(self.junctions)}
        for name, y in given.items():
            x, flow = self.x(name), self.flow(name)
            if name in self.moved or self.is_linear(name):
                self.lines.append(f"{flow} = {y}")
                self.lines.append(f"{self.change(name)} = 2.0 * ({flow} * {self.capacity(name)} - {x})")
            else:
                self.lines.append(f"{flow} = {self.e.law(self.storage(name), 'mean_effort', x, y)}")
                self.lines.append(f"{self.change(name)} = {y} - {x}")

    @property
    def _read_early(self) -> list[str]:
        """Return the reducible storages that a ratio follows: their own ratios follow modulator states alone."""
        return list(dict.fromkeys(m.by for m in self.network.modulations if m.by in self.reducible))

    def _modulate(self) -> None:
        for ratio in dict.fromkeys(m.ratio for m in self.network.modulations):
            self.lines.append(f"{self.ratio(ratio)} = {self.e.parameter(ratio)}")
        by_state = [m for m in self.network.modulations if m.by in self.network.storage_names]
        slow = [m for m in self.network.modulations if m not in by_state]
        for group in (slow, by_state):
            for m in group:
                name = self.ratio(m.ratio)
                self.lines.append(f"{name} = {name} * {self.e.law(m, 'factor', self.reading(m.by))}")
            if group is slow:
                for name in self._read_early:
                    self._current(name)

    def reading(self, name: str | None) -> str:
        """Return what a law reads: a state in the middle of the step, or a modulator state at its start."""
        if name is None:
            return "0.0"
        if name in self.known:
            return f"{self.x(name)} + 0.5 * {self.change(name)}"
        return f"{self.x(name)} + 0.5 * H * {self.current(name)}" if name in self.reducible else self.x(name)

    def links(self, name: str) -> Iterable[tuple[str, Ratio, int]]:
        """Return the junctions to which a reducible storage is coupled, with ratio and sign of its flow."""
        for (to, of, ratio), times in self.couplings.items():
            for one, other, sign in ((to, of, times), (of, to, -times)):
                if one == name:
                    yield other, ratio, sign

    def _current(self, name: str) -> None:
        terms = [scaled(sign, self.ratio(ratio), self.flow(other)) for other, ratio, sign in self.links(name)]
        terms += [scaled(1, self.ratio(p.on[name]), self.action(p.name)) for p in self.network.ports if name in p.on]
        self.lines.append(f"{self.current(name)} = {' + '.join(terms) or '0.0'}")

    def _add(self, junction: str, term: str) -> None:
        key = self.e.states.of(junction)
        self.lines += added(f"force_{key}", f"size_{key}", term)

    def _junctions(self) -> None:
        rate = self.e.derived("rate", 1.0 / self.h, "1/H [1/s]")
        for name in self.known:
            key, change = self.e.states.of(name), self.change(name)
            self.lines.append(f"force_{key} = {change} * {rate}")
            self.lines.append(f"size_{key} = (absolute({change}) + absolute({self.x(name)})) * {rate}")
        for r in self.network.resistors:
            if set(r.on) <= set(self.known):
                effort = " + ".join(scaled(1, self.ratio(b), self.flow(name)) for name, b in r.on.items())
                lost = f"lost_{self.e.names.of(r.name)}"
                self.lines.append(f"{lost} = {self.e.law(r, 'flow', effort, self.reading(r.modulated_by))}")
                if any(r.name in self.network.drives_of(m) for m in self.network.memories):
                    self.lines.append(f"{self.power(r.name)} = ({effort}) * {lost}")
                for name, b in r.on.items():
                    self._add(name, scaled(1, self.ratio(b), lost))
        for (to, of, ratio), times in self.couplings.items():
            if {to, of} <= set(self.known):
                self._add(to, scaled(-times, self.ratio(ratio), self.flow(of)))
                self._add(of, scaled(times, self.ratio(ratio), self.flow(to)))
        for p in self.network.ports:
            for name, ratio in p.on.items():
                if name in self.known:
                    self._add(name, scaled(-1, self.ratio(ratio), self.action(p.name)))

    def _advanced(self, name: str) -> str:
        """Return the end state and mean effort of a reducible storage, as an expression with two values."""
        x, current, rule, storage = self.x(name), self.current(name), self.rules[name], self.storage(name)
        if rule == scheme.LOSSLESS:
            return f"{x} + H * {current}, {self.e.law(storage, 'mean_effort', x, f'{x} + H * {current}')}"
        if rule == scheme.EXACT:
            return self._exact(name)
        if rule == scheme.PATH:
            (r,) = scheme.resistors_of(self.network, name)
            return self.e.law(self.network.resistors[r], "path", x, current, "H", self.stiffness(name))
        return searched(self, name)

    def stiffness(self, name: str) -> str:
        """Return the constant ``s`` of a linear storage."""
        key = self.e.states.of(name)
        return self.e.derived(f"stiffness_{key}", self.stiffness_of(name), f"s of {name}, effort = s state")

    def _exact(self, name: str) -> str:
        """Return the exact flow of a storage with one piecewise linear resistor and any number of linear ones."""
        key, s = self.e.states.of(name), self.stiffness_of(name)
        first, *others = (self.network.resistors[k] for k in scheme.resistors_of(self.network, name))
        assert all(map(scheme.is_leak, others))
        leak = float(sum(RESISTOR_LAWS[r.law].flow(1.0, 0.0, *self.e.values(r.parameters)) for r in others))
        leak_one, leak_two = (
            self.e.derived(f"leak_{i}_{key}", float(v), f"relaxation of {name} by its leaks alone in a step")
            for i, v in enumerate(relaxation(self.h * leak * s))
        )
        leaking = self.e.derived(f"leak_{key}", leak, f"conductance of the leaks of {name}")
        if first.modulated_by is None:
            law = RESISTOR_LAWS[first.law]
            assert law.thresholds is not None
            rho, low, high = (float(v) for v in law.thresholds(0.0, *self.e.values(first.parameters)))
            pairs = {"rho": (rho, "slope"), "low": (low, "lower threshold"), "high": (high, "upper threshold")}
            given = [self.e.derived(f"{k}_{key}", v, f"{about} of {first.name}") for k, (v, about) in pairs.items()]
            both = [
                self.e.derived(f"slide_{i}_{key}", float(v), f"relaxation of {name} beyond its thresholds in a step")
                for i, v in enumerate(relaxation(self.h * (rho + leak) * s))
            ]
        else:
            given, both = [f"{part}_{key}" for part in ("rho", "low", "high")], [f"one_{key}", f"two_{key}"]
            self.lines.append(
                f"{', '.join(given)} = {self.e.law(first, 'thresholds', self.reading(first.modulated_by))}"
            )
            duration = f"H * ({given[0]} + {leaking}) * {self.stiffness(name)}"
            self.lines.append(f"{', '.join(both)} = {self.e.call(relaxation, f'resistor {first.name}', duration)}")
        arguments = (self.x(name), self.current(name), "H", self.stiffness(name), *given, leaking, *both)
        return self.e.call(rc_flow, f"storage {name}", *arguments, leak_one, leak_two)


def added(force: str, size: str, term: str) -> list[str]:
    """Return the lines that add a term to what is left of an equation, and to the size of its terms."""
    return [f"term = {term}", f"{force} = {force} + term", f"{size} = {size} + absolute(term)"]


def scaled(sign: float, ratio: str, value: str) -> str:
    """Return ``sign · ratio · value`` without factors of one."""
    number = float(sign)
    if ratio.lstrip("-").replace(".", "").replace("e-", "").isdigit():
        number, ratio = number * float(ratio), "1.0"
    factors = [repr(abs(number))] if abs(number) != 1.0 else []
    factors += [ratio] if ratio != "1.0" else []
    return ("-" if number < 0.0 else "") + " * ".join([*factors, value])
