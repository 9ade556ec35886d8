"""Translation between the names of a network and the role names in which the laws of effects are written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from phnn.network.elements import Network, relabelled
from phnn.network.roles import Motion, drive_ratio, hysterons, measured_displacement, motions
from phnn.setup import Block, Setup, Source

# No law refers to a name with this prefix.
_ELSEWHERE = "elsewhere·"

Label = Callable[[str], str]
Pairs = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Roles:
    """The roles of a network's names.

    Attributes:
        elements, parameters: pairs of a role and the name that has it.
        taken: all names of the network, which additions must not use.
        place: displacement of the motion, if that is not the measured one.
        which: "second" or "third" copy of an effect; empty for the first.
    """

    elements: Pairs
    parameters: Pairs
    taken: frozenset[str]
    place: str = ""
    which: str = ""

    @property
    def plain(self) -> bool:
        """Whether every name equals its role."""
        return not self._set_apart and all(role == name for role, name in (*self.elements, *self.parameters))

    @property
    def _set_apart(self) -> bool:
        """Whether all additions of an effect get other names than in its law."""
        return bool(self.place or self.which)

    @property
    def _ending(self) -> str:
        where = f"_at_{self.place}" if self.place else ""
        which = f"_{self.which}" if self.which else ""
        return where + which or "_added"

    def added(self, name: str) -> str:
        """Name of an effect's addition."""
        return name + self._ending if self._set_apart or name in self.taken else name

    def parameter(self, role: str) -> str:
        """Name of the parameter with a role, or of a parameter that an effect adds."""
        return self._name(self.parameters, role)

    def by_role(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values of parameters, given by name."""
        return {self._role(self.parameters, n): v for n, v in values.items()}

    def by_name(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values of parameters, given by role."""
        return {self._name(self.parameters, n): v for n, v in values.items()}

    def inwards(self, setup: Setup) -> Setup:
        """The setup with role names."""
        return _relabelled(
            setup, lambda n: self._role(self.elements, n), lambda n: self._role(self.parameters, n)
        )  # fmt: skip

    def outwards(self, setup: Setup) -> Setup:
        """Give a setup with role names the names of the network again."""
        return _relabelled(
            setup, lambda n: self._name(self.elements, n), lambda n: self._name(self.parameters, n)
        )  # fmt: skip

    def _role(self, pairs: Pairs, name: str) -> str:
        for role, own in pairs:
            if own == name:
                return role
        if name not in self.taken and name.endswith(self._ending):
            return name.removesuffix(self._ending)
        # Additions of effects at the measured motion already have the names of their laws.
        return _ELSEWHERE + name if self._set_apart or name in self.taken else name

    def _name(self, pairs: Pairs, role: str) -> str:
        if role.startswith(_ELSEWHERE):
            return role.removeprefix(_ELSEWHERE)
        return next((own for known, own in pairs if known == role), None) or self.added(role)


def roles_of(network: Network, motion: Motion | None) -> Roles:
    """The roles around a motion of a network without effects; without a motion, those of its hysterons and ports
    alone."""
    elements: list[tuple[str, str]] = []
    parameters: list[tuple[str, str]] = []
    storages = {s.name: s for s in network.storages}
    if motion is not None:
        elements += [("q", motion.displacement), ("p", motion.momentum)]
        parameters += [("k", n) for n in storages[motion.displacement].parameters[:1]]
        parameters += [("m", n) for n in storages[motion.momentum].parameters[:1]]
        alone = [r for r in network.resistors if r.law == "linear" and set(r.on) == {motion.momentum}]
        parameters += [("b", r.parameters[0]) for r in alone[:1]]
        ratio = drive_ratio(network, motion.momentum)
        if ratio is not None:
            parameters.append(("alpha", ratio))
            elements.append(("voltage", network.ports[0].name))
    for i, resistor in enumerate(hysterons(network), start=1):
        charge = next(iter(resistor.on))
        elements.append((f"Q_{i}", charge))
        names = (*storages[charge].parameters[:1], *resistor.parameters[:2])
        parameters += list(zip((f"C_{i}", f"rho_{i}", f"d_{i}"), names, strict=True))
    taken = {*network.state_names, *(r.name for r in network.resistors), *(p.name for p in network.ports)}
    place = "" if motion is None or motion.displacement == measured_displacement(network) else motion.displacement
    return Roles(_once(elements), _once(parameters), frozenset(taken | set(network.parameters)), place)


def values_by_role(network: Network) -> dict[str, float]:
    """Values of a network's parameters by role, for its measured motion and its hysterons."""
    known = {n: p.value for n, p in network.parameters.items()}
    return roles_of(network, next(iter(motions(network)), None)).by_role(known)


def _once(pairs: list[tuple[str, str]]) -> Pairs:
    """The pairs without repeated names or roles."""
    found: dict[str, str] = {}
    for role, name in pairs:
        if name not in found.values():
            found.setdefault(role, name)
    return tuple(found.items())


def _relabelled(setup: Setup, element: Label, parameter: Label) -> Setup:
    def block(given: Block) -> Block:
        return Block(given.kind, tuple(parameter(n) for n in given.parameters))

    return replace(
        setup,
        network=relabelled(setup.network, element, parameter),
        amplifier=tuple(map(block, setup.amplifier)),
        sensor=tuple(map(block, setup.sensor)),
        block_parameters={
            parameter(n): replace(p, name=parameter(n)) for n, p in (setup.block_parameters or {}).items()
        },
        sources=tuple(
            Source(s.kind, element(s.port), tuple(parameter(n) for n in s.parameters)) for s in setup.sources
        ),
    )
