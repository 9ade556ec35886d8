"""Third-party packages that only rival methods need."""

from __future__ import annotations

import importlib
from types import ModuleType

from phnn.errors import InputRefused


def needed(name: str) -> ModuleType:
    """Import a package that rival methods need.

    Raises:
        InputRefused: the package is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputRefused(f"{name} is not installed: pip install 'phnn[rivals]'") from error
