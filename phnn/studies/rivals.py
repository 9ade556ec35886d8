"""Packages of other methods, which a study compares with: they are loaded where they are used."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from phnn.errors import InputRefused


def needed(name: str) -> ModuleType:
    """Import a package of another method.

    Raises:
        InputRefused: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise InputRefused(f"{name} is not installed: pip install 'phnn[rivals]'") from error
