"""Attach effects to a network by the roles of its parts, whatever their names.

The law of an effect is written for role names (see `phnn.effects.effect.Effect`). An attached effect builds it under
these names and then restores the names of the network. If a network has several motions, effects of mechanics or of the
surroundings are attached once for each motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from phnn.effects.additions import Placed
from phnn.effects.declaration import Declared
from phnn.effects.effect import Effect, Scales, Values
from phnn.network.elements import Network, relabelled
from phnn.network.roles import Motion, charges, drive_ratio, hysterons, measured_displacement, motions
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
        """Return whether every name equals its role."""
        return not self._set_apart and all(role == name for role, name in (*self.elements, *self.parameters))

    @property
    def _set_apart(self) -> bool:
        """Return whether all additions of an effect get other names than in its law."""
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
        """Return the setup with role names."""
        return _relabelled(setup, lambda n: self._role(self.elements, n), lambda n: self._role(self.parameters, n))

    def outwards(self, setup: Setup) -> Setup:
        """Give a setup with role names the names of the network again."""
        return _relabelled(setup, lambda n: self._name(self.elements, n), lambda n: self._name(self.parameters, n))

    def _role(self, pairs: Pairs, name: str) -> str:
        for role, known_name in pairs:
            if known_name == name:
                return role
        if name not in self.taken and name.endswith(self._ending):
            return name.removesuffix(self._ending)
        # Additions of effects at the measured motion already have the names of their laws.
        return _ELSEWHERE + name if self._set_apart or name in self.taken else name

    def _name(self, pairs: Pairs, role: str) -> str:
        if role.startswith(_ELSEWHERE):
            return role.removeprefix(_ELSEWHERE)
        return next((known_name for known, known_name in pairs if known == role), None) or self.added(role)


def roles_of(network: Network, motion: Motion | None) -> Roles:
    """Return the roles around a motion of a network without effects; without a motion, those of its hysterons and ports
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
    """Return the pairs without repeated names or roles."""
    by_role: dict[str, str] = {}
    for role, name in pairs:
        if name not in by_role.values():
            by_role.setdefault(role, name)
    return tuple(by_role.items())


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


_AT_EVERY_MOTION = ("mechanical", "environment")
_FURTHER = ("second", "third")


def attached(effect: Effect, setup: Setup) -> list[Effect]:
    """Attach an effect at every place where it may act, with as many copies as may act there; the measured motion comes
    first.

    Args:
        setup: without any effect; elements that effects have added have no role of their own.
    """
    all_motions = motions(setup.network)
    places = all_motions[1:] if effect.location in _AT_EVERY_MOTION else ()
    measured = all_motions[0] if all_motions else None
    at = [roles_of(setup.network, motion) for motion in (measured, *places)]
    return [e for roles in at for e in _as_often_as_it_may(effect, roles)]


def _as_often_as_it_may(effect: Effect, roles: Roles) -> list[Effect]:
    """Return all copies of an effect that may act at one place; each requires the previous one."""
    copies = [_at(effect, roles)]
    for which in _FURTHER[: effect.at_most - 1]:
        e = _at(effect, replace(roles, which=which))
        copies.append(replace(e, name=f"{which} {copies[0].name}", which=which, after=copies[-1].parameters, forms=()))
    return copies


def place_of(effect: Effect, network: Network) -> str:
    """Return the element or port of a network at which an effect acts; several are separated by commas."""
    driven, measured = (p.name for p in network.ports[:1]), (m.displacement for m in motions(network)[:1])
    if effect.location in ("amplifier", "coupling", "thermal"):
        return next(driven, "")
    if effect.location in ("hysteron", "electrical") and charges(network):
        return ", ".join(charges(network))
    if effect.location == "sensor":
        return network.senses or network.output
    return effect.place or next(measured, network.output)


def _at(effect: Effect, roles: Roles) -> Effect:
    """Return the effect with its law, values and parameters under the names of a network."""
    if roles.plain:
        return effect
    names = {n: roles.added(n) for n in effect.parameters}
    statement = effect.statement
    for role, name in names.items():
        statement = statement.replace("{" + role + "}", "{" + name + "}")
    where = f" at {roles.place}" if roles.place else ""
    return replace(
        effect,
        name=effect.name + where,
        place=roles.place,
        statement=f"At {roles.place}: {statement}" if roles.place else statement,
        adds=_Added(effect, roles),
        applies=_Asked(effect.applies, roles),
        grid=_Translated(effect.grid, roles),
        rescale=None if effect.rescale is None else _Translated(effect.rescale, roles),
        equivalents=None if effect.equivalents is None else _Translated(effect.equivalents, roles),
        declares=tuple(_renamed(d, roles) for d in effect.declares),
        neighbours=tuple(n + where for n in effect.neighbours),
        forms=tuple(_at(form, roles) for form in effect.forms),
    )


def _renamed(declared: Declared, roles: Roles) -> Declared:
    """Return a parameter with its name in a network."""
    over = declared.plausible.over
    plausible = replace(declared.plausible, over=roles.parameter(over) if over else "")
    return replace(declared, name=roles.added(declared.name), plausible=plausible)


# Values, not closures: an attached effect is sent to other processes.


@dataclass(frozen=True)
class _Added:
    effect: Effect
    roles: Roles

    @property
    def passive(self) -> bool:
        return self.effect.passive

    @property
    def signless(self) -> bool:
        return getattr(self.effect.adds, "signless", False)

    def __call__(self, setup: Setup, parameters: Placed) -> Setup:
        values = self.roles.by_role({n: p.value for n, p in parameters.items()})
        return self.roles.outwards(self.effect.build(self.roles.inwards(setup), values))


@dataclass(frozen=True)
class _Asked:
    condition: Callable[[Setup], bool]
    roles: Roles

    @property
    def __doc__(self) -> str | None:  # type: ignore[override]
        return self.condition.__doc__

    def __call__(self, setup: Setup) -> bool:
        return self.condition(self.roles.inwards(setup))


@dataclass(frozen=True)
class _Translated:
    """A function of scales, or of parameter values, that gives one or several sets of values."""

    law: Callable[..., Any]
    roles: Roles

    def __call__(self, given: Scales | Values, *further: float) -> Any:
        values = self.law(self.roles.by_role(given) if isinstance(given, Mapping) else given, *further)
        return self.roles.by_name(values) if isinstance(values, Mapping) else [self.roles.by_name(v) for v in values]
