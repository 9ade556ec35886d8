"""Rivals by name, and the third-party packages that they need; both are loaded when they are asked for."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from phnn.errors import InputRefused

if TYPE_CHECKING:
    from studies.rival_models.rival import Rival

_CLASSES = {
    "prandtl_ishlinskii": ("Prandtl–Ishlinskii", "hysteresis.PrandtlIshlinskii"),
    "preisach": ("Preisach", "hysteresis.Preisach"),
    "dahl": ("Dahl", "hysteresis.Dahl"),
    "hammerstein": ("Hammerstein", "hysteresis.Hammerstein"),
    "narx": ("NARX", "narx.Narx"),
    "gru": ("GRU", "networks.Gru"),
    "lstm": ("LSTM", "networks.Lstm"),
    "subnet": ("SUBNET", "networks.Subnet"),
}
NAMES = tuple(_CLASSES)
TITLES = {name: title for name, (title, _) in _CLASSES.items()}


def rival(name: str) -> Rival:
    """Return the rival of a name.

    Raises:
        InputRefused: nothing has this name, or a package that it needs is not installed.
    """
    if name not in _CLASSES:
        raise InputRefused(f"models: nothing is called {name!r}: choose from {', '.join(NAMES)}")
    module, _, kind = _CLASSES[name][1].partition(".")
    chosen: Rival = getattr(importlib.import_module(f"studies.rival_models.{module}"), kind)()
    return chosen


def needed(package: str) -> ModuleType:
    """Import a package that only rival methods need. Raises InputRefused where it is not installed."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise InputRefused(f"{package} is not installed: pip install 'phnn[rivals]'") from error
