"""The catalogue: the effects of this package, and those that a user registers."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from phnn.effects.effect import Effect
from phnn.errors import InputRefused, meant

if TYPE_CHECKING:
    from phnn.effects.soundness import Home

_CHAPTERS = tuple(
    f"phnn.effects.{chapter}"
    for chapter in ("amplifier", "electrical", "environment", "hysteresis", "mechanical", "sensor", "tanks")
)
_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
# Names by which laws refer to existing parts: the moving part, its transducer and the hysterons.
_ROLES = re.compile(r"[kmb]|alpha|(C|rho|d)_\d+")
_registered: dict[str, Effect] = {}


def catalogue() -> dict[str, Effect]:
    """All effects by name, registered ones last."""
    return {**_own(), **_registered}


@cache
def _own() -> dict[str, Effect]:
    return gathered(*_CHAPTERS)


def gathered(*modules: str) -> dict[str, Effect]:
    """The effects that modules define under public names, by their own names in alphabetical order."""
    defined = [item for module in modules for item in vars(importlib.import_module(module)).items()]
    members = [member for name, member in defined if isinstance(member, Effect) and not name.startswith("_")]
    return {member.name: member for member in sorted(members, key=lambda member: member.name)}


def effect(name: str) -> Effect:
    """One effect by name.

    Raises:
        InputRefused: there is no such effect; the message lists those that exist.
    """
    if name not in catalogue():
        raise InputRefused(
            f"no effect called {name!r}{meant(name, catalogue())}: the catalogue has {', '.join(catalogue())}"
        )
    return catalogue()[name]


def in_all_forms(effects: Iterable[Effect]) -> list[Effect]:
    """Effects and their other forms."""
    return [form for e in effects for form in (e, *e.forms)]


def register(effect: Effect, home: Home | None = None) -> Effect:
    """Add an effect of your own to the catalogue of this process, so that every diagnosis looks for it.

    It must pass the checks of the catalogue's own effects (`phnn.effects.soundness`). They simulate it on a small base
    model; this takes some seconds.

    Example:
        >>> from phnn.effects import Effect, register  # doctest: +SKIP
        >>> register(Effect(name="position_damping", ...))  # doctest: +SKIP

    Args:
        effect: see docs/write-your-own-effect.md.
        home: a base model to which it can be added, with sizes and a recording. The default is the piezo actuator of
            the paper, or a pair of tanks if the effect applies to these alone.

    Returns:
        The effect.

    Raises:
        InputRefused: a name is taken, the effect applies to no base model, or a check fails; nothing is registered.
    """
    from phnn.effects.soundness import check_effect, home_of

    _refuse_taken_names(effect)
    where = home or home_of(effect)
    if where is None:
        raise InputRefused(
            f"effect {effect.name} can be added neither to the actuator nor to the tanks, which both lack: "
            f"{(effect.applies.__doc__ or 'its condition').strip()} Give a base model with register(effect, home)"
        )
    check_effect(effect, where)
    _registered[effect.name] = effect
    return effect


def unregister(name: str) -> None:
    """Remove a registered effect from the catalogue.

    Raises:
        InputRefused: no effect of this name was registered.
    """
    if name not in _registered:
        raise InputRefused(f"no effect called {name!r} was registered: there are {', '.join(_registered) or 'none'}")
    del _registered[name]


@contextmanager
def registered(effect: Effect, home: Home | None = None) -> Iterator[Effect]:
    """Register an effect for the duration of a ``with`` block; see `register`."""
    register(effect, home)
    try:
        yield effect
    finally:
        unregister(effect.name)


def _refuse_taken_names(effect: Effect) -> None:
    from phnn.effects.formulas import formulas
    from phnn.effects.learned import learned_elements

    others = {**catalogue(), **learned_elements(), **formulas()}
    if effect.name in others:
        raise InputRefused(f"an effect called {effect.name!r} is there already: choose another name")
    if not _NAME.fullmatch(effect.name):
        raise InputRefused(f"effect {effect.name!r}: name it by lower-case words with underscores, position_damping")
    strange = [n for n in effect.neighbours if n not in catalogue()]
    if strange:
        raise InputRefused(f"effect {effect.name}: its neighbours {strange} are not in the catalogue: leave them out")
    if any((f.name, f.kind) != (effect.name, effect.kind) for f in effect.forms):
        raise InputRefused(f"effect {effect.name}: its forms have other names or kinds: derive them with or_as")
    owners = {n: e.name for e in in_all_forms(others.values()) for n in e.parameters}
    for form in in_all_forms([effect]):
        for name in form.parameters:
            if name in owners or _ROLES.fullmatch(name) or form.parameters.count(name) > 1:
                whose = owners.get(name, "the base model" if _ROLES.fullmatch(name) else "the effect twice")
                raise InputRefused(f"effect {effect.name}: the parameter {name!r} belongs to {whose}: rename it")
