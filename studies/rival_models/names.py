"""Rivals by name; what a rival needs is loaded when it is asked for."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from phnn.errors import InputRefused

if TYPE_CHECKING:
    from studies.rival_models.rival import Rival

_ROOM = "studies.rival_models"
_CLASSES = {
    "prandtl_ishlinskii": ("hysteresis", "PrandtlIshlinskii"),
    "preisach": ("hysteresis", "PreisachPlane"),
    "dahl": ("hysteresis", "DahlDuhem"),
    "hammerstein": ("hysteresis", "Hammerstein"),
    "narx": ("narx", "Narx"),
    "gru": ("recurrent", "Gru"),
    "lstm": ("recurrent", "Lstm"),
    "subnet": ("subnet", "Subnet"),
}
NAMES = tuple(_CLASSES)


def rival(name: str) -> Rival:
    """The rival of a name.

    Raises:
        InputRefused: nothing has this name, or a package that it needs is not installed.
    """
    if name not in _CLASSES:
        raise InputRefused(f"models: nothing is called {name!r}: choose from {', '.join(NAMES)}")
    module, kind = _CLASSES[name]
    found: Rival = getattr(importlib.import_module(f"{_ROOM}.{module}"), kind)()
    return found
