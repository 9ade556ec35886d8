"""The parts of a port-Hamiltonian network, as values: storages, resistors, couplings, ports.

    ẋ = [J(x) − D(x)] ∇H(x) + g(x) u,   y = g(x)ᵀ ∇H(x),   H(x) = Σ_k H_k(x_k)
    D(x) ∇H = Σ_r b_r φ_r(b_rᵀ ∇H),     ε φ_r(ε) ≥ 0

Slow states ``ż = f(z, s)`` (`ModulatorState`) stand beside them; ``J``, ``g`` and the ``φ_r`` may follow these.

A ratio or parameter is referred to by name, so that elements can share one (the transducer ratio α
appears in every hysteron coupling and in the voltage port).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from phnn.errors import StructureViolated
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
class Modulation:
    """A ratio that follows a state: for ``ratio`` stands ``ratio · f(x_by; θ)``, in ``J(x)`` and ``g(x)`` alike.

    Several modulations of one ratio multiply.

    The structure stays skew at every state, so that a modulated transformer neither stores nor dissipates.

    Attributes:
        ratio: name of the parameter that is the ratio at ``f = 1``.
        by: storage whose energy variable, or memory, is read.
        law: name of a factor law in `phnn.laws`.
        parameters: names of the law's parameters, in the law's order.
    """

    ratio: str
    by: str
    law: str
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
        kind: storage, resistor, port, modulation or memory; name: what it is called among these.
        element: the element itself; laws: those of its kind, by name.
    """

    kind: str
    name: str
    element: Any
    laws: Mapping[str, Any]

    @property
    def called(self) -> str:
        """Kind and name, for messages."""
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

    def __post_init__(self) -> None:
        states = self.state_names
        if len(set(states)) != len(states):
            raise StructureViolated(f"two storages share a name among {states}: rename one")
        referred = [name for c in self.couplings for name in (c.to, c.of)] + [self.output]
        referred += [n for r in self.resistors for n in r.on] + [n for p in self.ports for n in p.on]
        reads = [r.modulated_by for r in self.resistors if r.modulated_by] + [m.by for m in self.modulations]
        for names, known in ((referred, self.storage_names), (reads, states)):
            for name in names:
                if name not in known:
                    raise StructureViolated(f"an element refers to the storage {name!r}; there are {', '.join(known)}")
        if self.senses and self.senses not in [p.name for p in self.ports]:
            raise StructureViolated(f"the effort at the port {self.senses!r} is measured, but there is no such port")
        for name in self._parameter_references():
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
            if memory.law not in MEMORY_LAWS or MEMORY_LAWS[memory.law].heat is None:
                continue
            for name in self.drives_of(memory):
                if name not in resistors:
                    raise StructureViolated(f"memory {memory.name} holds heat: let resistors drive it, not {name}")
                if name in kept:
                    raise StructureViolated(
                        f"{name} heats both {kept[name]} and {memory.name}: name the resistors of each, every one once"
                    )
                kept[name] = memory.name

    def _passive_parameters(self) -> dict[str, Parameter]:
        """The parameters with their bounds inside the domains of the laws that take them."""
        table = dict(self.parameters)
        for one in self.with_laws():
            law = one.element.law
            # What no law is called is refused where the network is made to run.
            domains = one.laws[law].domains if isinstance(law, str) and law in one.laws else ()
            for name, domain in zip(one.element.parameters, domains, strict=False):
                table[name] = table[name].within(domain, f"the law {law} of {one.called}")
        return table

    def with_laws(self) -> Iterator[WithLaw]:
        """Every element that has a law."""
        # Laws are compiled by numba, which takes longer to load than a program that builds no network may.
        from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS

        yield from (WithLaw("storage", s.name, s, STORAGE_LAWS) for s in self.storages)
        yield from (WithLaw("resistor", r.name, r, RESISTOR_LAWS) for r in self.resistors)
        yield from (WithLaw("port", p.name, p, PORT_LAWS) for p in self.ports)
        yield from (WithLaw("modulation", f"of {m.ratio}", m, FACTOR_LAWS) for m in self.modulations)
        yield from (WithLaw("memory", m.name, m, MEMORY_LAWS) for m in self.memories)

    def _parameter_references(self) -> list[str]:
        names = [n for one in self.with_laws() for n in one.element.parameters] + [m.ratio for m in self.modulations]
        ratios: list[Ratio] = [c.ratio for c in self.couplings]
        ratios += [v for r in self.resistors for v in r.on.values()] + [v for p in self.ports for v in p.on.values()]
        return names + [v for v in ratios if isinstance(v, str)]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state vector: the energy variables, then the modulator states."""
        return (*self.storage_names, *(m.name for m in self.memories))

    @property
    def storage_names(self) -> tuple[str, ...]:
        """Names of the energy variables."""
        return tuple(s.name for s in self.storages)

    def drives_of(self, memory: ModulatorState) -> tuple[str, ...]:
        """Names of what drives a memory."""
        return memory.of or tuple(r.name for r in self.resistors)

    def with_values(self, values: Mapping[str, float]) -> Network:
        """The same network with other parameter values."""
        return replace(self, parameters=with_values(self.parameters, values))

    def extend(
        self,
        storages: tuple[Storage, ...] = (),
        resistors: tuple[Resistor, ...] = (),
        couplings: tuple[Coupling, ...] = (),
        parameters: tuple[Parameter, ...] = (),
        modulations: tuple[Modulation, ...] = (),
        memories: tuple[ModulatorState, ...] = (),
    ) -> Network:
        """The network with more elements; the momentum stays the last storage as in the paper's (9)."""
        return replace(
            self,
            storages=(*self.storages[:-1], *storages, self.storages[-1]),
            resistors=(*self.resistors, *resistors),
            couplings=(*self.couplings, *couplings),
            modulations=(*self.modulations, *modulations),
            memories=(*self.memories, *memories),
            parameters=as_table((*self.parameters.values(), *parameters)),
        )
