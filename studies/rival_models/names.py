"""Rivals by name; what a rival needs is loaded when it is asked for."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from phnn.errors import InputRefused

if TYPE_CHECKING:
    from studies.rival_models.rival import Rival

_CLASSES = {
    "prandtl_ishlinskii": "hysteresis.PrandtlIshlinskii",
    "preisach": "hysteresis.Preisach",
    "dahl": "hysteresis.Dahl",
    "hammerstein": "hysteresis.Hammerstein",
    "narx": "narx.Narx",
    "gru": "networks.Gru",
    "lstm": "networks.Lstm",
    "subnet": "networks.Subnet",
}
NAMES = tuple(_CLASSES)


def rival(name: str) -> Rival:
    """Return the rival of a name.

    Raises:
        InputRefused: nothing has this name, or a package that it needs is not installed.
    """
    if name not in _CLASSES:
        raise InputRefused(f"models: nothing is called {name!r}: choose from {', '.join(NAMES)}")
    module, _, kind = _CLASSES[name].partition(".")
    chosen: Rival = getattr(importlib.import_module(f"studies.rival_models.{module}"), kind)()
    return chosen
