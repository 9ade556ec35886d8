"""The discretisation of a step: how a network is solved, what its unknowns are, whether compiled code can take it.

Every scheme advances energy variables ``x``, under the mean inputs ``ū`` of a step of size ``h``, by

    (x⁺ − x)/h = J ē − Σ_r b_r φ_r(b_rᵀ ē, q̄_r) + g ψ(ū),

with modulating variables ``q̄`` at mid-step, and modulator states by their exact flow under the mean drives of the
step. Schemes differ only in the mean effort ``ē`` of dissipative *reducible* storages: linear storages ``e = s x`` with
resistors of their own, such as hysterons, that are coupled to no other reducible one.

======================  ============================================================================================
every other storage     discrete gradient, ``ē = (H(x⁺) − H(x))/(x⁺ − x)`` (Itoh & Abe 1988; Gonzalez 1996)
reducible storage:
``DISCRETE_GRADIENT``   exact flow of ``ẋ = i − φ(s x)``, ``ē = (1/h) ∫ s x dt``, if one resistor is piecewise linear
                        and all others are linear; otherwise as under ``RADAU``
``RADAU``               two-stage Radau IIA of ``ẋ = i − φ(s x)``, ``ē = s (3/4 X₁ + 1/4 X₂)`` (`phnn.integrate.roots`)
``MIDPOINT``            discrete gradient too, which is the implicit midpoint rule: ``ē = s (x + x⁺)/2``
======================  ============================================================================================

All of them are passive at every step size, ``H(x⁺) − H(x) ≤ h Σ_p ψ_p(ū) gᵀē``. The first two are L-stable in reducible
storages: they damp a storage that relaxes much faster than a step, where ``MIDPOINT`` lets it ring.

*Junctions* are the storages whose mean efforts ``v̄`` are the unknowns of a step. All others are *reducible*: each is
coupled to junctions only, so that under constant ``v̄`` it obeys a scalar equation of its own,

    ẋ_l = i_l − Σ_r b_r φ_r(b_r E_l(x_l)),     i_l = Σ_j a_lj v̄_j + Σ_p g_lp ψ_p(u_p).

Every coupling has a junction at one end at least (a vertex cover of the graph of J), and a resistor that joins several
storages joins junctions only. The equation to solve has as many unknowns as there are junctions: one for the actuator,
for any number of hysterons.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any

from phnn.errors import InputRefused
from phnn.laws import RESISTOR_LAWS
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, form_of, has_kernel
from phnn.network.elements import Network, Ratio, Resistor, WithLaw, fault_of_laws, is_linear
from phnn.network.roles import imposed


class Scheme(Enum):
    """A discretisation; see the table above. Its value is the name that settings use."""

    DISCRETE_GRADIENT = "discrete_gradient"
    RADAU = "radau"
    MIDPOINT = "midpoint"

    @classmethod
    def named(cls, name: str) -> Scheme:
        """Return the scheme with a given name.

        Raises:
            InputRefused: no scheme has this name; lists the names.
        """
        for scheme in cls:
            if scheme.value == name:
                return scheme
        raise InputRefused(f"scheme = {name!r}: choose one of {', '.join(s.value for s in cls)}")


# Rules of a reducible storage: no resistors; exact flow; two-stage Radau IIA; discrete gradient; a law of the path.
LOSSLESS, EXACT, RADAU, GRADIENT, PATH = range(5)
# A state so small that every spring is linear up to it; a power of two, so that a linear one is divided exactly.
NEAR_REST = 2.0**-80
# Parameters that the kernels pass to a law.
SCALARS = 5
_LINEAR_RESISTORS = ("linear", "maxwell")
# Their codes in the kernel's tables.
LINEAR_RESISTOR_CODES = tuple(code for code, name in enumerate(RESISTOR_LAWS) if name in _LINEAR_RESISTORS)


def junctions_of(network: Network) -> tuple[str, ...]:
    """Return the storages whose mean efforts are the unknowns of a step, in the order of the network."""
    forced = {name for r in network.resistors if len(r.on) > 1 for name in r.on}
    forced |= {name for m in network.multi_ports for b in m.columns for name in b}
    forced |= {name for e in network.shared_energies for name in e.of}
    if (given := imposed(network)) is not None:
        # The rigid contact between them stores hardly any energy: both its force and the velocity are unknowns.
        forced |= {given.contact, given.motion.momentum}
    lossy = {name for r in network.resistors for name in r.on}
    edges = [{c.to, c.of} for c in network.couplings if c.to != c.of]
    # A ratio that follows a modulator state is known before the step.
    modulated = {m.ratio for m in network.modulations if m.by in network.storage_names}
    reads = {r.modulated_by for r in network.resistors} | {m.by for m in network.modulations}
    reads |= {name for m in network.multi_ports for name in m.reads}
    following = {n for c in network.couplings if c.ratio in modulated for n in (c.to, c.of)}
    following |= {n for p in network.ports for n, ratio in p.on.items() if ratio in modulated}
    # Laws read these storages at mid-step, so that the unknowns alone must determine them.
    forced |= {name for name in reads if name is not None and (name in lossy or name in following)}
    order, chosen = network.storage_names, set(forced)
    linear = {s.name: is_linear(s) for s in network.storages}
    while open_edges := [e for e in edges if not e & chosen]:
        degrees = {n: sum(n in e for e in open_edges) for n in order}
        # Among equals, prefer a linear storage, whose end state follows from its effort; then, by convention, the last
        # (the momentum).
        chosen.add(max(order, key=lambda n: (degrees[n], linear[n], order.index(n))))
    for name in order:
        # A storage that was chosen early may be coupled with junctions only: as a reducible storage it adds no unknown.
        if name in chosen - forced and all(e & (chosen - {name}) for e in edges):
            chosen.remove(name)
    return tuple(n for n in order if n in chosen)


def is_leak(resistor: Resistor) -> bool:
    """Return whether the flow of a resistor is linear in its effort."""
    return isinstance(resistor.law, str) and resistor.law in _LINEAR_RESISTORS


def resistors_of(network: Network, storage: str) -> list[int]:
    """Return the numbers of the resistors that act on one storage alone, linear ones after the one with a dead zone."""
    on = [k for k, r in enumerate(network.resistors) if tuple(r.on) == (storage,)]
    return sorted(on, key=lambda k: is_leak(network.resistors[k]))


def rule_of(network: Network, storage: str, scheme: Scheme) -> int:
    """Return the rule that advances a reducible storage, one of the tables'."""
    resistors = [network.resistors[k] for k in resistors_of(network, storage)]
    if not resistors:
        return LOSSLESS
    if scheme is Scheme.DISCRETE_GRADIENT and len(resistors) == 1 and _follows_the_path(network, storage, resistors[0]):
        return PATH
    if not is_linear(network.storages[network.storage_names.index(storage)]) or scheme is Scheme.MIDPOINT:
        return GRADIENT
    if not all(has_kernel(r.law) for r in resistors):
        # No kernel has to be matched: stages of their own would take three times as long.
        return GRADIENT
    first, others = resistors[0].law, resistors[1:]
    piecewise = isinstance(first, str) and RESISTOR_LAWS[first].thresholds is not None
    plain = all(r.on[storage] == 1.0 for r in resistors) and all(map(is_leak, others))
    return EXACT if scheme is Scheme.DISCRETE_GRADIENT and piecewise and plain else RADAU


def _follows_the_path(network: Network, storage: str, resistor: Resistor) -> bool:
    """Return whether a step of a storage has the closed form of a law of the path.

    The velocity that the law reads must be all of the current into the storage, whose law must be the right one.
    """
    law = RESISTOR_LAWS.get(resistor.law) if isinstance(resistor.law, str) else None
    if law is None or law.path is None or resistor.on[storage] != 1.0:
        return False
    storages = {s.name: s for s in network.storages}
    momentum, spring, given = storages.get(resistor.modulated_by or ""), storages[storage], resistor.parameters
    curved = (spring.law, spring.parameters[1:]) == (law.spring, (given[0], given[2]))
    ways = [(c.to, c.of, c.ratio) for c in network.couplings if storage in (c.to, c.of)]
    return (
        (curved if law.spring else is_linear(spring))
        and momentum is not None
        and (momentum.law, momentum.parameters) == ("capacitor", given[-1:])
        and ways == [(storage, momentum.name, 1.0)]
        and not any(storage in p.on for p in network.ports)
    )


def reducible(network: Network, scheme: Scheme) -> dict[str, int]:
    """The reducible storages that a scheme advances by another rule than the discrete gradient, and this rule."""
    junctions = junctions_of(network)
    rules = {name: rule_of(network, name, scheme) for name in network.storage_names if name not in junctions}
    return {name: rule for name, rule in rules.items() if rule in (EXACT, RADAU, PATH)}


def merged_couplings(network: Network) -> dict[tuple[str, str, Ratio], int]:
    """How often every ratio couples two storages. Opposite couplings cancel here and leave no rounding errors."""
    order = network.storage_names
    times: dict[tuple[str, str, Ratio], int] = {}
    for c in network.couplings:
        forward = order.index(c.to) < order.index(c.of)
        key = (c.to, c.of, c.ratio) if forward else (c.of, c.to, c.ratio)
        times[key] = times.get(key, 0) + (1 if forward else -1)
    return {key: count for key, count in times.items() if count and key[0] != key[1]}


# By kind of element: the torch modules that pass their weights to the kernel.
WIDE: dict[str, Mapping[str, Any]] = {"storage": WIDE_STORAGES, "resistor": WIDE_RESISTORS}


def can_compile(network: Network) -> bool:
    """Return whether the compiled kernels solve a network."""
    return not obstacle(network)


def obstacle(network: Network) -> str:
    """Return the reason why the compiled kernels cannot solve a network, with the remedy; empty if they can."""
    obstacles = map(_law_obstacle, network.with_laws())
    return fault_of_laws(network) or next(filter(None, obstacles), "") or partly_driven(network, network.storage_names)


def _law_obstacle(one: WithLaw) -> str:
    law = one.element.law
    if not isinstance(law, str):
        known = form_of(law) in WIDE.get(one.kind, ())
        why = "this torch module has no kernel: take simulate, predict or phnn.train, and no imposed motion"
        return "" if known else f"{one.called}: {why}"
    count = len(one.element.parameters)
    return "" if count <= SCALARS else f"{one.called}: {count} parameters; the kernel passes {SCALARS}"


def partly_driven(network: Network, storages: Iterable[str]) -> str:
    """Return the message for a modulator state that only some of the resistors on one storage drive; empty if there is
    no such state.

    For each of the given storages, a step knows only the total power that the resistors acting on this storage alone
    dissipate.
    """
    for memory in network.memories:
        drives = network.drives_of(memory)
        for storage in storages:
            resistors = [r.name for r in network.resistors if tuple(r.on) == (storage,)]
            named = [name for name in resistors if name in drives]
            missing = [name for name in resistors if name not in drives]
            if named and missing:
                return (
                    f"modulator state {memory.name}: {named[0]} drives it and {missing[0]}, on the same storage "
                    f"{storage}, does not: name both or neither, or take Scheme.MIDPOINT"
                )
    return ""
