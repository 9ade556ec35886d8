<<<<<<< HEAD
"""Packages that only the rivals of phnn need."""
=======
"""Packages of other methods, which a study compares with: they are loaded where they are used."""
>>>>>>> diag

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from phnn.errors import InputRefused


def needed(name: str) -> ModuleType:
<<<<<<< HEAD
    """Import a module of a package that is not always installed.

    Raises:
        InputRefused: it is not installed; names the remedy.
=======
    """Import a package of another method.

    Raises:
        InputRefused: it is not installed.
>>>>>>> diag
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise InputRefused(f"{name} is not installed: pip install 'phnn[rivals]'") from error
