"""The catalogue of left-out physics: every module of this folder that defines ``EFFECT`` is a member.

Everything that an effect is written with stands here; docs/write-your-own-effect.md builds one.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from functools import cache

from phnn.effects import kinds
from phnn.effects.additions import (
    Chain,
    OfEveryRecording,
    Parts,
    Placed,
    at_amplifier,
    at_sensor,
    with_network,
    with_resistors,
)
from phnn.effects.conditions import (
    always,
    has_dead_zones,
    has_motion,
    has_plain_dead_zones,
    has_spring,
    has_tanks,
    has_transducer,
)
from phnn.effects.declaration import (
    Declared,
    Plausible,
    bounded,
    constant,
    limit,
    positive,
    signed,
    time_constant,
)
from phnn.effects.effect import Effect, Scales, Special
from phnn.effects.kinds import Kind
from phnn.errors import InputRefused

__all__ = [
    "Chain",
    "Declared",
    "Effect",
    "Kind",
    "OfEveryRecording",
    "Parts",
    "Placed",
    "Plausible",
    "Scales",
    "Special",
    "always",
    "at_amplifier",
    "at_sensor",
    "bounded",
    "catalogue",
    "constant",
    "effect",
    "gathered",
    "has_dead_zones",
    "has_motion",
    "has_plain_dead_zones",
    "has_spring",
    "has_tanks",
    "has_transducer",
    "in_all_forms",
    "kinds",
    "limit",
    "positive",
    "signed",
    "time_constant",
    "with_network",
    "with_resistors",
]


@cache
def catalogue() -> dict[str, Effect]:
    """All effects by name."""
    return gathered(__name__, __path__)


def gathered(package: str, folders: Iterable[str]) -> dict[str, Effect]:
    """The effects by name that the modules of a package define as ``EFFECT``."""
    found = {}
    for module in pkgutil.iter_modules(folders):
        member = getattr(importlib.import_module(f"{package}.{module.name}"), "EFFECT", None)
        if member is not None:
            found[member.name] = member
    return found


def effect(name: str) -> Effect:
    """One effect by name.

    Raises:
        InputRefused: there is no such effect; the message lists those that exist.
    """
    if name not in catalogue():
        raise InputRefused(f"no effect called {name!r}: the catalogue has {', '.join(catalogue())}")
    return catalogue()[name]


def in_all_forms(effects: Iterable[Effect]) -> list[Effect]:
    """Effects and their other forms."""
    return [form for e in effects for form in (e, *e.forms)]
