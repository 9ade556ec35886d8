"""A network as a torch module: its energy, efforts, structure, vector field and power balance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor, nn

from phnn.errors import InputRefused
from phnn.laws import FACTOR_LAWS, PORT_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.wide import form_of, is_passive_by_form
from phnn.network import checks
from phnn.network.bounded import LARGEST_WEIGHT, BoundedParameters, check_weights
from phnn.network.elements import MultiPort, Network, Ratio, WithLaw, check_laws

Entry = tuple[int, int, Ratio]


class Incidence(nn.Module):
    """A matrix given by its entries ``(row, column, ratio)``; entries at one place add up.

    Called with the function that gives a named ratio's present value (...), it returns the (..., rows, columns)
    matrix, differentiable by the ratios that have names.
    """

    base: Tensor
    places: Tensor

    def __init__(self, rows: int, columns: int, entries: Sequence[Entry]) -> None:
        super().__init__()
        base = torch.zeros(rows, columns, dtype=torch.float64)
        named = [(i, j, ratio) for i, j, ratio in entries if isinstance(ratio, str)]
        for i, j, ratio in entries:
            if not isinstance(ratio, str):
                base[i, j] += ratio
        self.names = tuple(dict.fromkeys(ratio for _, _, ratio in named))
        places = torch.zeros(len(self.names), rows, columns, dtype=torch.float64)
        for i, j, ratio in named:
            places[self.names.index(ratio), i, j] += 1.0
        self.register_buffer("base", base, persistent=False)
        self.register_buffer("places", places, persistent=False)

    def forward(self, value: Callable[[str], Tensor]) -> Tensor:
        """Return (..., rows, columns) the matrix at present values."""
        matrix = self.base
        # A sum of products per entry, so that a matrix of one batch member never depends on the others.
        for name, places in zip(self.names, self.places, strict=True):
            matrix = matrix + value(name)[..., None, None] * places
        return matrix


def combined(row: Tensor, matrix: Tensor) -> Tensor:
    """Return (..., k) product of a row (..., n) with a matrix, (n, k) or batched."""
    return row @ matrix if matrix.ndim == 2 else (row.unsqueeze(-2) @ matrix).squeeze(-2)


def columns(vectors: Sequence[Mapping[str, Ratio]], place: Mapping[str, int], n: int) -> Incidence:
    """Return the (n, number of vectors) matrix whose columns are vectors by the names of storages."""
    entries: list[Entry] = [(place[name], j, ratio) for j, on in enumerate(vectors) for name, ratio in on.items()]
    return Incidence(n, len(vectors), entries)


class PortHamiltonianSystem(nn.Module):
    """The port-Hamiltonian system of a network.

        system = phnn.PortHamiltonianSystem(phnn.models.hrc(hysterons=2))
        system.vector_field(x, u)                            # (..., n) ẋ

        ẋ = J ∇H(x) − Σ_r b_r φ_r(b_rᵀ∇H, q_r) + g ψ(u),     y = ψ'(u) gᵀ∇H,     H(x) = Σ_k H_k(x_k)

    Multi-ports add ``−Σ_m B_m φ_m(B_mᵀ∇H, q_m)`` to the rates, or to ``J`` where they conserve power, and shared
    energies add ``H_s(x)`` of several storages. ``J`` is a matrix less its transpose, hence skew; every ``φ_r`` is a
    sector law, hence ``dH/dt ≤ Σ ψ(u) gᵀ∇H``. All tensors are batched, ``x`` is (..., n), ``u`` is (..., P), in SI and
    float64.

    Modulator states have no energy in ``H``: ``x`` has them last, ``ẋ`` their rates, and efforts and matrices leave
    them out.

    The passivity inequality survives any training: parameters that are trained are kept inside their bounds by
    `BoundedParameters`, learned laws are passive for all weights, and of another module that is a law the part of its
    flow that would deliver power is left out. Every evaluation refuses parameters that are not finite.

    Attributes:
        network: the network as built, with its own copies of torch modules; `as_network` has the present values.
        free: the parameters that are trained. `value` reads a physical value, `set_values` sets some.
        constants: the values of parameters that are fixed, as buffers.
        laws: the laws that are torch modules.

    Raises:
        StructureViolated: an unknown law, a wrong number of law parameters, a name that torch cannot register,
            a neural law that is not in float64, or one that is found outside its sector or below its energy at rest.
    """

    def __init__(self, network: Network) -> None:
        super().__init__()
        # Copies, for what is trained in one system is not to move in another one.
        network = self.network = network.copied()
        self.constants = nn.Module()
        self.laws = nn.ModuleDict()
        for name, parameter in network.parameters.items():
            checks.check_name(name, self.constants if parameter.fixed else nn.ParameterDict())
            if parameter.fixed:
                constant = torch.tensor(parameter.value, dtype=torch.float64)
                # They belong to the network and not to a state of training, which could carry others in.
                self.constants.register_buffer(name, constant, persistent=False)
        self.free = BoundedParameters({n: p for n, p in network.parameters.items() if not p.fixed})
        self._present: checks.Present = None
        check_laws(network)
        for one in network.with_laws():
            if not isinstance(one.element.law, str):
                self._register(one)
        place, n = {name: k for k, name in enumerate(network.state_names)}, len(network.storages)
        self._factors = tuple((place[m.by], m) for m in network.modulations)
        self._modulators = tuple(None if r.modulated_by is None else place[r.modulated_by] for r in network.resistors)
        self._half = Incidence(n, n, [(place[c.to], place[c.of], c.ratio) for c in network.couplings])
        self._branches = columns([r.on for r in network.resistors], place, n)
        self._inputs = columns([p.on for p in network.ports], place, n)
        self.multi_ports = [_Placed(m, place, n) for m in network.multi_ports]
        self._columns = nn.ModuleList(m.columns for m in self.multi_ports)
        self.shared = [([place[name] for name in e.of], e.law) for e in network.shared_energies]

    def _register(self, one: WithLaw) -> None:
        """Check a law that is a torch module, and make it a part of this module."""
        key, element = f"{one.kind}_{one.name}".replace(" ", "_"), one.element
        name = f"the law of {one.name}"
        if one.kind == "multi_port":
            checks.check(element.law, ports=len(element.on), reads=len(element.reads), name=name)
        elif one.kind == "shared_energy":
            checks.check(element.law, storage=True, ports=len(element.of), name=name)
        elif one.kind == "modulation":
            checks.check_factor(element.law, name)
        else:
            reads = int(getattr(element, "modulated_by", None) is not None)
            checks.check(element.law, storage=one.kind == "storage", reads=reads, name=name)
        checks.check_name(key, self.laws)
        self.laws[key] = element.law

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the energy variables and then the modulator states, in the order of ``x``."""
        return self.network.state_names

    def value(self, name: str) -> Tensor:
        """Return () present value of a parameter [SI]."""
        # Kept for the time of one evaluation only: from a tensor kept longer the adjoint method would get no gradient.
        present = checks.present_of(self)
        if present is not None and name in present:
            return present[name]
        return self.free.value(name) if name in self.free else getattr(self.constants, name)

    def set_values(self, values: Mapping[str, float]) -> None:
        """Set parameters that are not fixed [SI]; of fixed ones build the network with other values.

        Raises:
            InputRefused: an unknown or fixed name, or a value that is not finite or outside the parameter's bounds.
        """
        self.free.assign(values)

    def present_values(self) -> dict[str, Tensor]:
        """Return the values of all free parameters, once they and all weights have been found finite.

        Raises:
            SolverFailed: one is not; names it.
        """
        for key, law in self.laws.items():
            check_weights(law, f"{key}.", LARGEST_WEIGHT if form_of(law) else math.inf)
        return self.free.values()

    def ratios(
        self,
        x: Tensor,  # (..., n) state that modulated ratios read
    ) -> Callable[[str], Tensor]:
        """Return the function from a ratio's name to its value (...) at a state."""

        def ratio(name: str) -> Tensor:
            value = self.value(name)
            for place, m in self._factors:
                if m.ratio == name:
                    known = FACTOR_LAWS[m.law].factor if isinstance(m.law, str) else m.law
                    value = value * known(x[..., place], *map(self.value, m.parameters))
            return value

        return ratio

    def as_network(self) -> Network:
        """Return the network with the present parameter values, and with copies of the laws as they are now."""
        return self.shown().copied()

    def shown(self) -> Network:
        """Return the same, with the laws that the system goes on using."""
        return self.network.with_values({name: value.item() for name, value in self.present_values().items()})

    @checks.evaluation
    def energies(self, x: Tensor) -> Tensor:  # x: (..., n)
        """Return (..., n) energy of every storage [J]."""
        checks.check_state(x, self.state_names)
        values = []
        for k, s in enumerate(self.network.storages):
            known = STORAGE_LAWS[s.law].energy if isinstance(s.law, str) else checks.energy_of(s.law)
            values.append(known(x[..., k], *map(self.value, s.parameters)))
        return torch.stack(values, dim=-1)

    def energy(self, x: Tensor) -> Tensor:  # x: (..., n)
        """Return (...) stored energy ``H(x)`` [J]."""
        return self.energies(x).sum(-1) + sum(checks.energy_of(law)(x[..., places]) for places, law in self.shared)

    @checks.evaluation
    def mean_efforts(
        self,
        a: Tensor,  # (..., n) state at the start of a step
        b: Tensor,  # (..., n) and at its end
    ) -> Tensor:
        """Return (..., n) discrete gradient ``ē_k = (H_k(b_k) − H_k(a_k))/(b_k − a_k)``; ``∇H(a)`` where ``b = a``."""
        checks.check_state(a, self.state_names)
        first = len(self.network.storages)
        ends = zip(a.unbind(-1)[:first], (a if a is b else b).unbind(-1)[:first], strict=True)
        efforts = [self.mean_effort(k, start, end) for k, (start, end) in enumerate(ends)]
        return self.with_shared(torch.stack(efforts, dim=-1), a, b)

    def with_shared(self, efforts: Tensor, a: Tensor, b: Tensor) -> Tensor:
        """Return (..., n) mean efforts of the storages' own energies, and those of shared energies added to them."""
        for places, law in self.shared:
            at = torch.tensor(places, device=efforts.device)
            start = a[..., places]
            efforts = efforts.index_add(-1, at, checks.mean_efforts_of(law, start, start if a is b else b[..., places]))
        return efforts

    @checks.evaluation
    def mean_effort(
        self,
        k: int,
        a: Tensor,  # (...) energy variable of storage k at the start of a step
        b: Tensor,  # (...) and at its end
    ) -> Tensor:
        """Return (...) ``ē_k`` of one storage."""
        s = self.network.storages[k]
        if isinstance(s.law, str):
            return STORAGE_LAWS[s.law].mean_effort(a, b, *map(self.value, s.parameters))
        return checks.mean_effort_of(s.law, a, b)

    def efforts(self, x: Tensor) -> Tensor:  # x: (..., n)
        """Return (..., n) efforts ``e = ∇H(x)``."""
        return self.mean_efforts(x, x)

    @checks.evaluation
    def structure(self, x: Tensor) -> Tensor:  # x: (..., n)
        """Return (..., n, n) interconnection ``J = A − Aᵀ``: skew to the last bit."""
        skew = self._skew(x)
        return skew.expand(*x.shape[:-1], *skew.shape[-2:])

    def interconnection(self, x: Tensor) -> Tensor:  # x: (..., n)
        """Return (n, n) or (..., n, n) ``J`` of the couplings, without that of multi-ports."""
        half = self._half(self.ratios(x))
        return half - half.mT

    def _skew(self, x: Tensor) -> Tensor:
        """Return (n, n) or (..., n, n) ``J``, without leading dimensions where it does not depend on ``x``."""
        skew = self.interconnection(x)
        for port in self.multi_ports:
            if port.conserves:
                b = port.columns(self.ratios(x))
                half = b @ port.law.lower(x[..., port.reads]) @ b.mT
                skew = skew + (half - half.mT)
        return skew

    @checks.evaluation
    def dissipation(self, x: Tensor) -> Tensor:  # x: (..., n)
        """Return (..., n, n) ``D(x) = Σ_r b_r (φ_r(ε_r)/ε_r) b_rᵀ ⪰ 0``, with the slope of ``φ_r`` where ``ε_r = 0``.

        For inspection (eq. (11)): the vector field itself never divides by an effort.
        """
        branches, efforts = self.incidences(x)[0], self.efforts(x)
        n = branches.shape[-2]
        total = branches.new_zeros(*x.shape[:-1], n, n)
        if self.network.resistors:
            epsilon = combined(efforts, branches)
            each = [self._conductance(r, epsilon[..., r], x) for r in range(epsilon.shape[-1])]
            total = total + (branches * torch.stack(each, dim=-1).unsqueeze(-2)) @ branches.mT
        for port in self.multi_ports:
            if not port.conserves:
                b = port.columns(self.ratios(x))
                total = total + b @ port.dissipation(combined(efforts, b), x) @ b.mT
        return total

    def _conductance(self, r: int, epsilon: Tensor, x: Tensor) -> Tensor:
        """Return ``φ_r(ε)/ε`` with its limit at ``ε = 0``."""
        # Where efforts and flows are still normal numbers: 1e-151 in 64 bits, 1e-19 in 32.
        least = torch.finfo(epsilon.dtype).tiny ** 0.49
        silent = epsilon.abs() < least
        probe = torch.where(silent, least, epsilon)
        ratio = self.branch_flow(r, probe, x) / probe
        if isinstance(self.network.resistors[r].law, str) or not bool(silent.any()):
            return ratio
        # A module need not resolve its value at so small an effort; its slope it knows.
        slope = checks.slope_of(lambda e: self.branch_flow(r, e, x), torch.zeros_like(epsilon)).clamp_min(0.0)
        return torch.where(silent, slope, ratio)

    @checks.evaluation
    def incidences(
        self,
        x: Tensor,  # (..., n) state that modulated ratios read
    ) -> tuple[Tensor, Tensor]:
        """Return (..., n, R) columns ``b_r`` of the resistors and (..., n, P) columns ``g_p`` of the ports.

        Without leading dimensions where no ratio is modulated.
        """
        ratios = self.ratios(x)
        return self._branches(ratios), self._inputs(ratios)

    @checks.evaluation
    def branch_efforts(
        self,
        efforts: Tensor,  # (..., n)
        x: Tensor,  # (..., n) state that modulated ratios read
    ) -> Tensor:
        """Return (..., R) effort ``ε_r = b_rᵀ e`` on every resistor."""
        return combined(efforts, self._branches(self.ratios(x)))

    @checks.evaluation
    def branch_flows(
        self,
        epsilon: Tensor,  # (..., R) effort on every resistor
        x: Tensor,  # (..., n) state that modulated laws read
    ) -> Tensor:
        """Return (..., R) flow ``φ_r(ε_r, q_r)`` through every resistor."""
        if not self.network.resistors:
            return epsilon
        return torch.stack([self.branch_flow(r, e, x) for r, e in enumerate(epsilon.unbind(-1))], dim=-1)

    @checks.evaluation
    def branch_flow(
        self,
        r: int,
        epsilon: Tensor,  # (...) effort on resistor r
        x: Tensor,  # (..., n) state that modulated laws read
    ) -> Tensor:
        """Return (...) ``φ_r(ε, q_r)`` of one resistor."""
        resistor, place = self.network.resistors[r], self._modulators[r]
        q = torch.zeros_like(epsilon) if place is None else x[..., place]
        if isinstance(resistor.law, str):
            return RESISTOR_LAWS[resistor.law].flow(epsilon, q, *map(self.value, resistor.parameters))
        flow = resistor.law(epsilon) if place is None else resistor.law(epsilon, q)
        # Training may carry a module of unknown form out of its sector.
        return flow if is_passive_by_form(resistor.law) else torch.where(epsilon * flow < 0.0, 0.0 * flow, flow)

    @checks.evaluation
    def actions(
        self,
        u: Tensor,  # (..., P)
    ) -> Tensor:
        """Return (..., P) ``ψ_p(u_p)`` of every port.

        Raises:
            InputRefused: the last dimension is not the number of ports.
        """
        return self._of_ports("action", u)

    def _of_ports(self, part: str, u: Tensor) -> Tensor:
        """Return (..., P) ``action`` or ``slope`` of every port's law at its input."""
        ports = self.network.ports
        if u.shape[-1:] != (len(ports),):
            raise InputRefused(
                f"an input has shape {tuple(u.shape)}: its last dimension must be {len(ports)}, the number of ports "
                f"({', '.join(p.name for p in ports) or 'none'})"
            )
        values = [
            getattr(PORT_LAWS[p.law], part)(v, *map(self.value, p.parameters))
            for v, p in zip(u.unbind(-1), ports, strict=True)
        ]
        return torch.stack(values, dim=-1) if values else u

    @checks.evaluation
    def rate(
        self,
        efforts: Tensor,  # (..., n) efforts, of a state or averaged over a step
        x: Tensor,  # (..., n) state that modulated laws read
        u: Tensor,  # (..., P)
    ) -> Tensor:
        """Return (..., n) ``J e − Σ_r b_r φ_r(b_rᵀ e) + g ψ(u)`` of the storages for any effort ``e``."""
        branches, inputs = self.incidences(x)
        conserved = combined(efforts, self._skew(x).mT)
        lost = combined(self.branch_flows(combined(efforts, branches), x), branches.mT)
        for b, _, flows in self._through_multi_ports(efforts, x):
            lost = lost + combined(flows, b.mT)
        return conserved - lost + combined(self.actions(u), inputs.mT)

    def _through_multi_ports(self, efforts: Tensor, x: Tensor) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Return columns (n, k), efforts and flows (..., k) of every multi-port that is not part of ``J``."""
        ports = []
        for port in self.multi_ports:
            if not port.conserves:
                b = port.columns(self.ratios(x))
                epsilon = combined(efforts, b)
                ports.append((b, epsilon, port.flows(epsilon, x)))
        return ports

    @checks.evaluation
    def vector_field(
        self,
        x: Tensor,  # (..., n)
        u: Tensor,  # (..., P)
    ) -> Tensor:
        """Return (..., n) ``ẋ``."""
        efforts = self.efforts(x)
        rate = self.rate(efforts, x, u)
        if not self.network.memories:
            return rate
        slow = x[..., len(self.network.storages) :]
        return torch.cat([rate, checks.rates_of(self, slow, checks.drives_of(self, efforts, x, u))], dim=-1)

    @checks.evaluation
    def port_outputs(
        self,
        x: Tensor,  # (..., n)
        u: Tensor,  # (..., P)
    ) -> Tensor:
        """Return (..., P) ``y = ψ'(u) gᵀ∇H``, conjugate to ``u``: current at a voltage port, velocity at a force port.

        For a nonlinear port ``yᵀu`` also fills the port's own field energy; what enters ``H`` is ``ψ(u) gᵀ∇H``.
        """
        return self._of_ports("slope", u) * combined(self.efforts(x), self.incidences(x)[1])

    @checks.evaluation
    def power(
        self,
        efforts: Tensor,  # (..., n) efforts, of a state or averaged over a step
        x: Tensor,  # (..., n) state that modulated laws read
        u: Tensor,  # (..., P)
        stored: Tensor,  # (...) rate of change of the stored energy [W]
    ) -> checks.PowerBalance:
        """Return the balance of a given rate of storage at given efforts."""
        epsilon = self.branch_efforts(efforts, x)
        dissipated = epsilon * self.branch_flows(epsilon, x)
        more = [(e * flows).sum(-1, keepdim=True) for _, e, flows in self._through_multi_ports(efforts, x)]
        dissipated = torch.cat([dissipated, *more], dim=-1) if more else dissipated
        supplied = self.actions(u) * combined(efforts, self.incidences(x)[1])
        return checks.PowerBalance(stored, dissipated, supplied, stored - supplied.sum(-1) + dissipated.sum(-1))

    @checks.evaluation
    def power_balance(
        self,
        x: Tensor,  # (..., n)
        u: Tensor,  # (..., P)
    ) -> checks.PowerBalance:
        """Return the power balance at a state."""
        efforts = self.efforts(x)
        return self.power(efforts, x, u, (efforts * self.rate(efforts, x, u)).sum(-1))

    def forward(
        self,
        t: Tensor,  # () time, not used: the system is autonomous
        x: Tensor,  # (..., n)
    ) -> Tensor:
        """Return (..., n) ``ẋ`` with every input at zero, in the order of arguments that `torchdiffeq.odeint` calls."""
        return self.vector_field(x, x.new_zeros(len(self.network.ports)))

    def with_input(self, u: Callable[[Tensor], Tensor], ports: Sequence[str] | None = None) -> DrivenSystem:
        """Return this system driven by ``u(t)``; see `DrivenSystem`."""
        return DrivenSystem(self, u, ports)


class _Placed:
    """A multi-port with its place in a system, which has its law and its columns among its modules."""

    def __init__(self, port: MultiPort, place: Mapping[str, int], n: int) -> None:
        self.columns = columns(port.columns, place, n)
        self.reads = [place[name] for name in port.reads]
        self.law = port.law
        self.conserves = is_passive_by_form(port.law) and hasattr(port.law, "lower")

    def flows(self, epsilon: Tensor, x: Tensor) -> Tensor:
        """Return (..., k) ``φ(ε, q)``; of a law of unknown form zero where it would deliver power."""
        flows = self.law(epsilon, x[..., self.reads]) if self.reads else self.law(epsilon)
        if is_passive_by_form(self.law):
            return flows
        return torch.where((epsilon * flows).sum(-1, keepdim=True) < 0.0, 0.0 * flows, flows)

    def dissipation(self, epsilon: Tensor, x: Tensor) -> Tensor:
        """Return (..., k, k) a matrix ``⪰ 0`` that gives ``φ(ε, q)`` from ``ε``: the law's own, or ``φ φᵀ/(εᵀφ)``."""
        if is_passive_by_form(self.law):
            root = self.law.root(epsilon, x[..., self.reads])
            return root @ root.mT
        flows = self.flows(epsilon, x)
        power = (epsilon * flows).sum(-1)[..., None, None]
        outer = flows.unsqueeze(-1) * flows.unsqueeze(-2)
        return torch.where(power > 0.0, outer / torch.where(power > 0.0, power, 1.0), 0.0)


class DrivenSystem(nn.Module):
    """``ẋ = f(x, u(t))``, sharing the parameters of the system.

    Args:
        system: the system that is driven.
        u: time () to input (..., k), or () for a single port. A module's parameters become this module's, so that
            the adjoint method differentiates by them; tensors that a plain function carries do not.
        ports: names of the k ports that ``u`` fills, the others stay at zero; all ports where left out.

    Raises:
        InputRefused: a port that the network does not have, or an input of the wrong shape.
    """

    def __init__(
        self, system: PortHamiltonianSystem, u: Callable[[Tensor], Tensor], ports: Sequence[str] | None = None
    ) -> None:
        super().__init__()
        self.system = system
        self.u = u
        known = [p.name for p in system.network.ports]
        names = known if ports is None else list(ports)
        for name in names:
            if name not in known:
                raise InputRefused(f"no port called {name!r}: this network has {', '.join(known) or 'none'}")
        self.ports = tuple(names)
        self._places = None if names == known else tuple(known.index(name) for name in names)
        self._count = len(known)

    def input(
        self,
        t: Tensor,  # ()
    ) -> Tensor:
        """Return (..., P) the inputs of all ports at a time."""
        value = self.u(t)
        if value.ndim == 0 and len(self.ports) == 1:
            value = value.unsqueeze(-1)
        if value.shape[-1:] != (len(self.ports),):
            raise InputRefused(
                f"the input function returned shape {tuple(value.shape)} at t = {float(t):g} s: its last dimension "
                f"must be {len(self.ports)} ({', '.join(self.ports)}); name the ports it fills with ports=(...)"
            )
        if self._places is None:
            return value
        full = value.new_zeros(*value.shape[:-1], self._count)
        return full.index_copy(-1, torch.tensor(self._places, device=value.device), value)

    def forward(
        self,
        t: Tensor,  # ()
        x: Tensor,  # (..., n)
    ) -> Tensor:
        """Return (..., n) ``ẋ`` at a time and state."""
        return self.system.vector_field(x, self.input(t))
