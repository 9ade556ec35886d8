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
from phnn.effects.effect import Effect, Scales, SpecialCase, Values
from phnn.effects.places.names import Roles, roles_of
from phnn.network.elements import Network
from phnn.network.roles import charges, motions
from phnn.setup import Setup

_AT_EVERY_MOTION = ("mechanical", "environment")
_FURTHER = ("second", "third")


def attached(effect: Effect, setup: Setup) -> list[Effect]:
    """Attach an effect at every place where it may act, with as many copies as may act there; the measured motion comes
    first.

    Args:
        setup: without any effect; elements that effects have added have no role of their own.
    """
    found = motions(setup.network)
    places = found[1:] if effect.location in _AT_EVERY_MOTION else ()
    measured = found[0] if found else None
    at = [roles_of(setup.network, motion) for motion in (measured, *places)]
    return [e for roles in at for e in _as_often_as_it_may(effect, roles)]


def _as_often_as_it_may(effect: Effect, roles: Roles) -> list[Effect]:
    """All copies of an effect that may act at one place; each requires the previous one."""
    found = [_at(effect, roles)]
    for which in _FURTHER[: effect.at_most - 1]:
        one = _at(effect, replace(roles, which=which))
        found.append(replace(one, name=f"{which} {found[0].name}", which=which, after=found[-1].parameters, forms=()))
    return found


def place_of(effect: Effect, network: Network) -> str:
    """The element or port of a network at which an effect acts; several are separated by commas."""
    driven, measured = (p.name for p in network.ports[:1]), (m.displacement for m in motions(network)[:1])
    if effect.location in ("amplifier", "coupling", "thermal"):
        return next(driven, "")
    if effect.location in ("hysteron", "electrical") and charges(network):
        return ", ".join(charges(network))
    if effect.location == "sensor":
        return network.senses or network.output
    return effect.place or next(measured, network.output)


def _where(roles: Roles) -> str:
    """The last part of an effect's name."""
    return f" at {roles.place}" if roles.place else ""


def _at(effect: Effect, roles: Roles) -> Effect:
    """The effect with its law, values and parameters under the names of a network."""
    if roles.plain:
        return effect
    names = {n: roles.added(n) for n in effect.parameters}
    statement = effect.statement
    for role, name in names.items():
        statement = statement.replace("{" + role + "}", "{" + name + "}")
    where = _where(roles)
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
        special_cases=tuple(SpecialCase(s.name + where, _Translated(s.values, roles)) for s in effect.special_cases),
        declares=tuple(_renamed(d, roles) for d in effect.declares),
        neighbours=tuple(n + where for n in effect.neighbours),
        forms=tuple(_at(form, roles) for form in effect.forms),
    )


def _renamed(declared: Declared, roles: Roles) -> Declared:
    """A parameter with its name in a network."""
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
        found = self.law(self.roles.by_role(given) if isinstance(given, Mapping) else given, *further)
        return self.roles.by_name(found) if isinstance(found, Mapping) else [self.roles.by_name(v) for v in found]
