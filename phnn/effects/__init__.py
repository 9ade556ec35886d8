"""The catalogue of left-out physics: every module of this folder that defines ``EFFECT`` is a member."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from functools import cache

from phnn.effects.effect import Effect, Scales
from phnn.errors import InputRefused

__all__ = ["Effect", "Scales", "catalogue", "effect", "gathered", "in_all_forms"]


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
