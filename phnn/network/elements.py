"""The parts of a port-Hamiltonian network, as values: storages, resistors, couplings, ports.

    ẋ = [J(x) − D(x)] ∇H(x) + g(x) u,   y = g(x)ᵀ ∇H(x),   H(x) = Σ_k H_k(x_k)
    D(x) ∇H = Σ_r b_r φ_r(b_rᵀ ∇H),     ε φ_r(ε) ≥ 0

Slow states ``ż = f(z, s)`` (`ModulatorState`) stand beside them; ``J``, ``g`` and the ``φ_r`` may follow these.

A ratio or parameter is referred to by name, so that elements can share one (the transducer ratio α
appears in every hysteron coupling and in the voltage port).

Two networks joined through power-conjugate ports are again one network, passive where both are. What the ports
exchange leaves one system as it enters the other: the joint ``J`` is skew, ``D`` and ``H`` are of both (van der Schaft
& Jeltsema 2014, "Port-Hamiltonian Systems Theory").
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple

from phnn.errors import StructureViolated
from phnn.html import table, titled
from phnn.parameters import Parameter, as_table, with_values

Ratio = str | float


@dataclass(frozen=True)
class Storage:
    """A scalar energy ``H_k(x_k)``.

    Attributes:
        name: name of the energy variable (``Q_1``, ``q``, ``p``).
        law: name of a storage law in `phnn.laws`, or a torch module with ``energy(x)``.
        parameters: names of the law's parameters, in the law's order.
        unit: unit of the energy variable.
    """

    name: str
    law: Any
    parameters: tuple[str, ...] = ()
    unit: str = "1"


@dataclass(frozen=True)
class Resistor:
    """A scalar sector law ``φ_r`` on one linear combination of efforts ``ε = b_rᵀ ∇H``.

    Attributes:
        name: for tables and the energy ledger.
        law: name of a resistor law in `phnn.laws`, or a torch module ``φ(ε)`` with ``ε φ(ε) ≥ 0``.
        on: storage name to ratio, the vector ``b_r``.
        parameters: names of the law's parameters, in the law's order.
        modulated_by: storage whose energy variable, or memory, the law may read (never change).
    """

    name: str
    law: Any
    on: Mapping[str, Ratio]
    parameters: tuple[str, ...] = ()
    modulated_by: str | None = None


@dataclass(frozen=True)
class Coupling:
    """``J[to, of] = ratio`` and ``J[of, to] = −ratio``: skew because only one number is kept."""

    to: str
    of: str
    ratio: Ratio = 1.0


@dataclass(frozen=True)
class Port:
    """An input ``u`` acting through the column ``g``: ``ẋ += g ψ(u)``, ``y = ψ'(u) gᵀ∇H``.

    Attributes:
        name: ``voltage`` or ``force``.
        on: storage name to ratio.
        law: ``linear`` (``ψ(u) = u``) or a port law in `phnn.laws`.
        parameters: names of the law's parameters.
    """

    name: str
    on: Mapping[str, Ratio]
    law: str = "linear"
    parameters: tuple[str, ...] = ()
    unit: str = "V"


@dataclass(frozen=True)
class MultiPort:
    """A law on several efforts together, ``ẋ −= Σ_i b_i φ_i(ε, q)`` with ``ε_i = b_iᵀ ∇H`` and ``εᵀφ(ε, q) ≥ 0``.

    Attributes:
        name: for tables and the energy ledger.
        law: a torch module: ``φ(ε)``, or ``φ(ε, q)`` where it reads states; (..., k) and (..., s) to (..., k).
        on: the k combinations of efforts, each a storage's name, or names to ratios.
        reads: storages and modulator states whose s values the law is given as ``q``.
    """

    name: str
    law: Any
    on: tuple[str | Mapping[str, Ratio], ...]
    reads: tuple[str, ...] = ()
    parameters: ClassVar[tuple[str, ...]] = ()

    @property
    def columns(self) -> tuple[Mapping[str, Ratio], ...]:
        """Return the vectors ``b_i``."""
        return tuple({one: 1.0} if isinstance(one, str) else one for one in self.on)


@dataclass(frozen=True)
class SharedEnergy:
    """An energy of several storages together, which is added to their own: ``H(x) += H_s(x_of)``.

    Attributes:
        name: for messages.
        law: a torch module with ``energy(x)``, (..., k) to (...), least at rest.
        of: names of the k storages.
    """

    name: str
    law: Any
    of: tuple[str, ...]
    parameters: ClassVar[tuple[str, ...]] = ()


@dataclass(frozen=True)
class Modulation:
    """A ratio that follows a state: for ``ratio`` stands ``ratio · f(x_by; θ)``, in ``J(x)`` and ``g(x)`` alike.

    Several modulations of one ratio multiply.

    The structure stays skew at every state, so that a modulated transformer neither stores nor dissipates.

    Attributes:
        ratio: name of the parameter that is the ratio at ``f = 1``.
        by: storage whose energy variable, or memory, is read.
        law: name of a factor law in `phnn.laws`, or a torch module ``f(x)``.
        parameters: names of the law's parameters, in the law's order.
    """

    ratio: str
    by: str
    law: Any
    parameters: tuple[str, ...] = ()


@dataclass(frozen=True)
class ModulatorState:
    """A slow scalar state ``ż = f(z, s; θ)`` that laws and ratios may follow: a temperature, a state of polarisation.

    A step reads it as it is at its start, and advances it at its end by the mean drive ``s`` of the step.

    Attributes:
        name: of the state.
        law: name of a law of modulator states in `phnn.laws`.
        parameters: names of the law's parameters, in the law's order.
        of: what drives it; ``s`` is the sum of the powers that the named resistors dissipate, of the efforts of named
            storages, or of the actions of named ports. All resistors where it is empty.
        unit: of the state.
    """

    name: str
    law: str
    parameters: tuple[str, ...] = ()
    of: tuple[str, ...] = ()
    unit: str = "1"


class WithLaw(NamedTuple):
    """An element that has a law.

    Attributes:
        kind: storage, resistor, port, modulation, memory, multi_port or shared_energy; name: its name among these.
        element: the element itself; laws: those of its kind, by name.
    """

    kind: str
    name: str
    element: Any
    laws: Mapping[str, Any]

    @property
    def called(self) -> str:
        """Return the kind and name, for messages."""
        return f"{self.kind} {self.name}"


@dataclass(frozen=True)
class Network:
    """A port-Hamiltonian network as a value; ``PortHamiltonianSystem(network)`` makes it run.

        network = phnn.models.hrc(hysterons=2)
        network.parameters["k"].value                        # stiffness [N/m]

    Attributes:
        storages, resistors, couplings, ports: the elements.
        parameters: by name; their bounds are kept inside what the laws ask for (a capacitance is positive, a damping is
            not negative), whatever the network is built from.
        output: the storage whose energy variable is measured.
        modulations: ratios that follow a state; the factors of one that follows several multiply.
        memories: modulator states; the state vector has them after the storages.
        senses: the port that imposes a motion, where its effort is measured; ``output`` is then the impulse, the
            integral of that effort, and the sensor differentiates it.
        multi_ports: laws on several efforts together.
        shared_energies: energies of several storages together.

    Raises:
        StructureViolated: elements that do not fit together.
        InputRefused: a parameter value with which a law would not be passive.
    """

    storages: tuple[Storage, ...]
    resistors: tuple[Resistor, ...]
    couplings: tuple[Coupling, ...]
    ports: tuple[Port, ...]
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    output: str = "q"
    modulations: tuple[Modulation, ...] = ()
    memories: tuple[ModulatorState, ...] = ()
    senses: str = ""
    multi_ports: tuple[MultiPort, ...] = ()
    shared_energies: tuple[SharedEnergy, ...] = ()

    def __post_init__(self) -> None:
        states = self.state_names
        if len(set(states)) != len(states):
            raise StructureViolated(f"two storages share a name among {states}: rename one")
        referred = [name for c in self.couplings for name in (c.to, c.of)] + [self.output]
        referred += [n for on in self._vectors() for n in on] + [n for e in self.shared_energies for n in e.of]
        reads = [r.modulated_by for r in self.resistors if r.modulated_by] + [m.by for m in self.modulations]
        reads += [n for m in self.multi_ports for n in m.reads]
        for names, known in ((referred, self.storage_names), (reads, states)):
            for name in names:
                if name not in known:
                    raise StructureViolated(f"an element refers to the storage {name!r}; there are {', '.join(known)}")
        if self.senses and self.senses not in [p.name for p in self.ports]:
            raise StructureViolated(f"the effort at the port {self.senses!r} is measured, but there is no such port")
        for name in self.parameter_references():
            if name not in self.parameters:
                raise StructureViolated(f"an element refers to the parameter {name!r}, which is not defined")
        for memory in self.memories:
            self._check_drives(memory)
        self._check_heat()
        object.__setattr__(self, "parameters", self._passive_parameters())

    def _check_drives(self, memory: ModulatorState) -> None:
        resistors, ports = [r.name for r in self.resistors], [p.name for p in self.ports]
        for name in memory.of:
            count = sum(names.count(name) for names in (resistors, list(self.storage_names), ports))
            if count != 1:
                known = ", ".join((*resistors, *self.storage_names, *ports))
                what = "nothing has this name" if count == 0 else "several elements do: rename one"
                raise StructureViolated(f"memory {memory.name} is driven by {name!r}, {what}; there are {known}")
        if len({name in resistors for name in memory.of}) > 1 or len(set(memory.of)) != len(memory.of):
            raise StructureViolated(
                f"memory {memory.name} is driven by {', '.join(memory.of)}: name resistors, whose powers add up, or "
                "storages and ports, each once"
            )

    def _check_heat(self) -> None:
        """What is dissipated becomes heat in one place."""
        if not self.memories:
            return
        # Laws are compiled by numba, which takes longer to load than a network that has no need of it may.
        from phnn.laws import MEMORY_LAWS

        kept: dict[str, str] = {}
        resistors = [r.name for r in self.resistors]
        for memory in self.memories:
            if memory.law not in MEMORY_LAWS or not MEMORY_LAWS[memory.law].heats:
                continue
            if self.multi_ports:
                raise StructureViolated(
                    f"memory {memory.name} holds heat, and no multi-port tells how much it dissipates: replace "
                    f"{self.multi_ports[0].name} by resistors"
                )
            for name in self.drives_of(memory):
                if name not in resistors:
                    raise StructureViolated(f"memory {memory.name} holds heat: let resistors drive it, not {name}")
                if name in kept:
                    raise StructureViolated(
                        f"{name} heats both {kept[name]} and {memory.name}: name the resistors of each, every one once"
                    )
                kept[name] = memory.name

    def _passive_parameters(self) -> dict[str, Parameter]:
        """Return the parameters with their bounds inside the domains of the laws that take them."""
        table = dict(self.parameters)
        for one in self.with_laws():
            law = one.element.law
            # What no law is called is refused where the network is made to run.
            domains = one.laws[law].domains if isinstance(law, str) and law in one.laws else ()
            for name, domain in zip(one.element.parameters, domains, strict=False):
                table[name] = table[name].within(domain, f"the law {law} of {one.called}")
        return table

    def with_laws(self) -> Iterator[WithLaw]:
        """Return every element that has a law."""
        # Laws are compiled by numba, which takes longer to load than a program that builds no network may.
        from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS

        yield from (WithLaw("storage", s.name, s, STORAGE_LAWS) for s in self.storages)
        yield from (WithLaw("resistor", r.name, r, RESISTOR_LAWS) for r in self.resistors)
        yield from (WithLaw("port", p.name, p, PORT_LAWS) for p in self.ports)
        yield from (WithLaw("modulation", f"of {m.ratio} by {m.by}", m, FACTOR_LAWS) for m in self.modulations)
        yield from (WithLaw("memory", m.name, m, MEMORY_LAWS) for m in self.memories)
        yield from (WithLaw("multi_port", m.name, m, {}) for m in self.multi_ports)
        yield from (WithLaw("shared_energy", e.name, e, {}) for e in self.shared_energies)

    def _vectors(self) -> list[Mapping[str, Ratio]]:
        """Return the combinations of efforts on which resistors, ports and multi-ports act."""
        alone = [*(r.on for r in self.resistors), *(p.on for p in self.ports)]
        return [*alone, *(column for m in self.multi_ports for column in m.columns)]

    def ratios(self) -> list[Ratio]:
        """Return the ratios of all couplings, and of all combinations of efforts."""
        return [*(c.ratio for c in self.couplings), *(ratio for on in self._vectors() for ratio in on.values())]

    def parameter_references(self) -> list[str]:
        """Return the names of the parameters that elements refer to."""
        names = [n for one in self.with_laws() for n in one.element.parameters] + [m.ratio for m in self.modulations]
        return names + [ratio for ratio in self.ratios() if isinstance(ratio, str)]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the state vector: the energy variables, then the modulator states."""
        return (*self.storage_names, *(m.name for m in self.memories))

    @property
    def storage_names(self) -> tuple[str, ...]:
        """Return the names of the energy variables."""
        return tuple(s.name for s in self.storages)

    def equations(self) -> dict[str, str]:
        """Return the right-hand side of every state's equation as text.

        ``e(x)`` is the effort ``∂H/∂x`` of a storage, a resistor's name its law, and a port's name its input.
        """
        terms: dict[str, list[str]] = {name: [] for name in self.storage_names}
        for c in self.couplings:
            terms[c.to].append(_term(c.ratio, f"e({c.of})"))
            terms[c.of].append(_term(c.ratio, f"e({c.to})", minus=True))
        for r in self.resistors:
            inside = _sum(_term(ratio, f"e({name})") for name, ratio in r.on.items())
            for name, ratio in r.on.items():
                terms[name].append(_term(ratio, f"{r.name}({inside})", minus=True))
        for m in self.multi_ports:
            inside = ", ".join(_sum(_term(v, f"e({n})") for n, v in column.items()) for column in m.columns)
            for i, column in enumerate(m.columns, 1):
                for name, ratio in column.items():
                    terms[name].append(_term(ratio, f"{m.name}_{i}({inside})", minus=True))
        for p in self.ports:
            drive = p.name if p.law == "linear" else f"{p.law}({p.name})"
            for name, ratio in p.on.items():
                terms[name].append(_term(ratio, drive))
        slow = {m.name: f"{m.law}({', '.join((m.name, *self.drives_of(m)))})" for m in self.memories}
        return {name: _sum(some) for name, some in terms.items()} | slow

    def _repr_html_(self) -> str:
        stored = {s.name: f"{_law(s)}({', '.join((s.name, *s.parameters))})" for s in self.storages}
        units = {s.name: s.unit for s in self.storages} | {m.name: m.unit for m in self.memories}
        rows = ((n, units[n], stored.get(n, ""), f"d{n}/dt = {text}") for n, text in self.equations().items())
        laws = ((r.name, f"{_law(r)}({', '.join(r.parameters)})") for r in self.resistors)
        return titled(
            "Network", table(("state", "unit", "energy H", "equation"), rows), table(("resistor", "law"), laws)
        )

    def drives_of(self, memory: ModulatorState) -> tuple[str, ...]:
        """Return the names of what drives a memory."""
        return memory.of or tuple(r.name for r in self.resistors)

    def copied(self) -> Network:
        """Return the same network with copies of those laws that are torch modules; what shared a law still does."""
        if all(isinstance(one.element.law, str) for one in self.with_laws()):
            return self
        memo: dict[int, Any] = {}

        def own(elements: tuple[Any, ...]) -> tuple[Any, ...]:
            return tuple(e if isinstance(e.law, str) else replace(e, law=copy.deepcopy(e.law, memo)) for e in elements)

        groups = ("storages", "resistors", "modulations", "multi_ports", "shared_energies")
        copies: dict[str, Any] = {name: own(getattr(self, name)) for name in groups}
        return replace(self, **copies)

    def replace(self, name: str, law: Any, parameters: tuple[str, ...] = ()) -> Network:
        """Return the network with another law on a resistor or storage, without the parameters that become unused.

            phnn.models.hrc(hysterons=2).replace("hysteron_1", phnn.nn.SectorMLP(effort_scale=20.0, flow_scale=1e-3))

        Args:
            name: of a resistor, or of a storage.
            law: name of a law, or a torch module: ``φ(ε)`` of a resistor, ``energy(x)`` of a storage.
            parameters: names of the law's parameters, which the network has already.

        Raises:
            StructureViolated: nothing has this name, or the parameters are not those of the law.
        """
        names = (*self.storage_names, *(r.name for r in self.resistors))
        if name not in names:
            raise StructureViolated(f"no resistor or storage is called {name!r}; there are {', '.join(names)}")

        def with_law(element: Any) -> Any:
            return replace(element, law=law, parameters=parameters) if element.name == name else element

        storages, resistors = (tuple(map(with_law, elements)) for elements in (self.storages, self.resistors))
        made = replace(self, storages=storages, resistors=resistors)
        check_laws(made)
        used, before = set(made.parameter_references()), set(self.parameter_references())
        return replace(made, parameters={n: p for n, p in made.parameters.items() if n in used or n not in before})

    def with_values(self, values: Mapping[str, float]) -> Network:
        """Return the same network with other parameter values."""
        return replace(self, parameters=with_values(self.parameters, values))

    def extend(
        self,
        storages: tuple[Storage, ...] = (),
        resistors: tuple[Resistor, ...] = (),
        couplings: tuple[Coupling, ...] = (),
        parameters: tuple[Parameter, ...] = (),
        modulations: tuple[Modulation, ...] = (),
        memories: tuple[ModulatorState, ...] = (),
        multi_ports: tuple[MultiPort, ...] = (),
        shared_energies: tuple[SharedEnergy, ...] = (),
    ) -> Network:
        """Return the network with more elements; the momentum stays the last storage as in the paper's (9)."""
        return replace(
            self,
            storages=(*self.storages[:-1], *storages, self.storages[-1]),
            resistors=(*self.resistors, *resistors),
            couplings=(*self.couplings, *couplings),
            modulations=(*self.modulations, *modulations),
            memories=(*self.memories, *memories),
            multi_ports=(*self.multi_ports, *multi_ports),
            shared_energies=(*self.shared_energies, *shared_energies),
            parameters=as_table((*self.parameters.values(), *parameters)),
        )


def is_linear(storage: Any) -> bool:
    """Return whether the effort of a storage, in a network or a bond graph, is linear in its state."""
    return isinstance(storage.law, str) and storage.law in ("capacitor", "spring")


Label = Callable[[str], str]


def _law(element: Storage | Resistor) -> str:
    return element.law if isinstance(element.law, str) else type(element.law).__name__


def _term(ratio: Ratio, what: str, minus: bool = False) -> str:
    """Return a signed term of an equation."""
    if isinstance(ratio, str):
        return f"{'− ' if minus else '+ '}{ratio} {what}"
    sign = "− " if minus != (ratio < 0.0) else "+ "
    size = abs(ratio)
    return f"{sign}{'' if size == 1.0 else f'{size:.4g} '}{what}"


def _sum(terms: Iterable[str]) -> str:
    return " ".join(terms).removeprefix("+ ") or "0"


# Fields that hold names of elements, and those that hold names of parameters.
_OF_ELEMENTS = ("name", "to", "of", "on", "by", "reads", "modulated_by", "output", "senses")
_OF_PARAMETERS = ("parameters", "ratio")


def relabelled(network: Network, element: Label, parameter: Label) -> Network:
    """Return the same network with every name replaced.

    Args:
        element: gives the name of a storage, resistor, port or memory; parameter: that of a parameter. Two names must
            not become one.
    """

    def label(role: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {element(n): label("ratio", ratio) for n, ratio in value.items()}
        if isinstance(value, tuple):
            return tuple(label(role, one) for one in value)
        if is_dataclass(value) and not isinstance(value, type):
            return replace(value, **{f.name: label(f.name, getattr(value, f.name)) for f in fields(value)})
        if not isinstance(value, str) or not value:
            return value
        return element(value) if role in _OF_ELEMENTS else parameter(value) if role in _OF_PARAMETERS else value

    parts = {f.name: label(f.name, getattr(network, f.name)) for f in fields(network) if f.name != "parameters"}
    table = {parameter(n): replace(p, name=parameter(n)) for n, p in network.parameters.items()}
    return replace(network, **parts, parameters=table)


def check_laws(network: Network) -> None:
    """Check that every named law exists and is given as many parameters as it takes.

    Raises:
        StructureViolated: names element and law, and what is accepted.
    """
    if fault := fault_of_laws(network):
        raise StructureViolated(fault)


def fault_of_laws(network: Network) -> str:
    """Return what is wrong with the laws that a network names; empty if nothing is."""
    return next(filter(None, map(_fault, network.with_laws())), "")


def _fault(one: WithLaw) -> str:
    law, given = one.element.law, one.element.parameters
    if not isinstance(law, str):
        if given:
            return f"{one.called}: a law that is a torch module holds its own parameters; leave out {', '.join(given)}"
        return _misfit(one)
    if law not in one.laws:
        return f"{one.called}: no law called {law!r}; there are {', '.join(one.laws)}"
    wanted = len(one.laws[law].example)
    if len(given) == wanted:
        return ""
    return f"{one.called}: the law {law} takes {wanted} parameters, {len(given)} are given"


def _misfit(one: WithLaw) -> str:
    """Return what a torch module was made for, where that is not what its element has."""
    from phnn.laws.wide import is_passive_by_form

    element, made = one.element, getattr(one.element.law, "counts", {})
    role, kind = getattr(type(element.law), "ROLE", ""), type(element.law).__name__
    together = ("multi_port", "shared_energy", "modulation")
    if role != one.kind and (role or (one.kind in together and is_passive_by_form(element.law))):
        return f"{one.called}: a {kind} is the law of a {role or 'storage or resistor'}, not of a {one.kind}"
    counts = {"ports": len(element.on), "reads": len(element.reads)} if isinstance(element, MultiPort) else {}
    counts |= {"states": len(element.of)} if isinstance(element, SharedEnergy) else {}
    wrong = [f"{made[n]} {n}, the element has {k}" for n, k in counts.items() if made.get(n, k) != k]
    return f"{one.called}: its law is made for {wrong[0]}" if wrong else ""


Kind = Literal["feedback"] | Storage | Resistor


def interconnect(
    one: Network,
    port: str,
    other: Network,
    other_port: str,
    kind: Kind = "feedback",
    parameters: tuple[Parameter, ...] = (),
) -> Network:
    """Join a port of one network with a port of another.

        feedback:          u₁ = −y₂,  u₂ = y₁          (a force port with a velocity port)
        a `Storage`:       ẋ_s = y₁ + y₂,  u₁ = u₂ = −H_s'(x_s)          (two force ports through a spring)
        a `Resistor`:      u₁ = u₂ = −φ(y₁ + y₂)          (two force ports through a damper; its ``on`` is left empty)

    Two force ports on masses cannot be joined rigidly: their momenta would depend on each other. A spring between them
    says how stiff the joint is.

    Args:
        one: keeps its output, and its storages stay the last ones.
        port, other_port: names of the ports, which are ports no longer.
        kind: how they are joined.
        parameters: of the storage or resistor between.

    Returns:
        A network with the storages of ``other``, the storage between and those of ``one``, and the ports that are left.

    Raises:
        StructureViolated: no such port, a port with a law that is not linear, names that both networks use, a product
            of two named ratios, or a memory that the joined port or no resistor at all drives.
    """
    near, far = _port(one, port), _port(other, other_port)
    _check_names(one, other)
    storages, resistors, couplings = _between(near, far, kind)
    return Network(
        (*other.storages, *storages, *one.storages),
        (*other.resistors, *one.resistors, *resistors),
        (*other.couplings, *one.couplings, *couplings),
        (*(p for p in one.ports if p is not near), *(p for p in other.ports if p is not far)),
        as_table((*one.parameters.values(), *other.parameters.values(), *parameters)),
        one.output,
        (*one.modulations, *other.modulations),
        (*_driven_states(one), *_driven_states(other)),
        one.senses if one.senses != port else "",
        (*one.multi_ports, *other.multi_ports),
        (*one.shared_energies, *other.shared_energies),
    )


def _between(
    near: Port, far: Port, kind: Kind
) -> tuple[tuple[Storage, ...], tuple[Resistor, ...], tuple[Coupling, ...]]:
    """Return what joins two ports; see `interconnect`."""
    if isinstance(kind, Storage):
        ratios = [*near.on.items(), *far.on.items()]
        return (kind,), (), tuple(Coupling(kind.name, k, ratio) for k, ratio in ratios)
    if isinstance(kind, Resistor):
        return (), (replace(kind, on={**near.on, **far.on}),), ()
    if kind == "feedback":
        pairs = ((to, a, of, b) for to, a in far.on.items() for of, b in near.on.items())
        return (), (), tuple(_coupling(to, a, of, b) for to, a, of, b in pairs)
    raise StructureViolated(f"kind = {kind!r}: write feedback, or give the Storage or Resistor between the ports")


def renamed(network: Network, prefix: str) -> Network:
    """Prefix the names of the storages, resistors, ports, modulator states and parameters of a network."""
    return relabelled(network, prefix.__add__, prefix.__add__)


def _driven_states(network: Network) -> tuple[ModulatorState, ...]:
    """Return the modulator states, with the drives of their own network and no resistor of another."""
    for memory in network.memories:
        if not network.drives_of(memory):
            raise StructureViolated(f"memory {memory.name} is driven by nothing: leave it out before joining")
    return tuple(replace(m, of=network.drives_of(m)) for m in network.memories)


def _port(network: Network, name: str) -> Port:
    for port in network.ports:
        if port.name == name:
            if port.law != "linear":
                raise StructureViolated(
                    f"the port {name} has the law {port.law}: only linear ports exchange the power of their "
                    "conjugates; join another port"
                )
            return port
    raise StructureViolated(f"no port called {name!r}: there are {', '.join(p.name for p in network.ports) or 'none'}")


def _check_names(one: Network, other: Network) -> None:
    for what, these, those in (
        ("storage", one.storage_names, other.storage_names),
        ("memory", [m.name for m in one.memories], [m.name for m in other.memories]),
        ("resistor", [r.name for r in one.resistors], [r.name for r in other.resistors]),
        ("port", [p.name for p in one.ports], [p.name for p in other.ports]),
        ("multi-port", [m.name for m in one.multi_ports], [m.name for m in other.multi_ports]),
        ("shared energy", [e.name for e in one.shared_energies], [e.name for e in other.shared_energies]),
        ("parameter", one.parameters, other.parameters),
    ):
        shared = sorted(set(these) & set(those))
        if shared:
            raise StructureViolated(f"both networks have a {what} {shared[0]}: give one a prefix with renamed()")


def _coupling(to: str, a: Ratio, of: str, b: Ratio) -> Coupling:
    """Return ``J[to, of] = a b``."""
    if not isinstance(a, str) and not isinstance(b, str):
        return Coupling(to, of, a * b)
    number, name = (a, b) if isinstance(b, str) else (b, a)
    if isinstance(number, str) or abs(number) != 1.0:
        raise StructureViolated(
            f"the product {a}*{b} arises between {to} and {of}: introduce a parameter for it, or join the ports "
            "through a storage, which takes each ratio by itself"
        )
    return Coupling(to, of, name) if number > 0.0 else Coupling(of, to, name)
