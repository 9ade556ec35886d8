"""Packages that only the rivals of phnn need."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from phnn.errors import InputRefused


def needed(name: str) -> ModuleType:
    """Import a module of a package that is not always installed.

    Raises:
        InputRefused: it is not installed; names the remedy.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise InputRefused(f"{name} is not installed: pip install 'phnn[rivals]'") from error
