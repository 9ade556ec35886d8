"""Port-Hamiltonian models of piezoelectric actuators from recordings, and the physics they leave out.

    from phnn.diagnosis import diagnose

    campaign  = phnn.read("recordings/")
    diagnosis = diagnose(campaign)
    phnn.write(diagnosis, "out/")

Names are loaded when they are first used, so that importing the package costs little.
"""

from __future__ import annotations

import importlib
from typing import Any

_WHERE = {
    "read": ("phnn.recordings", "read"),
    "describe": ("phnn.recordings", "describe"),
    "Options": ("phnn.identification.base", "Options"),
    "write": ("phnn.report.result", "write"),
    "Setup": ("phnn.setup", "Setup"),
    "load": ("phnn.models.store", "load"),
    "PortHamiltonianSystem": ("phnn.network.system", "PortHamiltonianSystem"),
}

__all__ = sorted(_WHERE)


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'phnn' has no attribute {name!r}; it has {', '.join(__all__)}")
    module, attribute = _WHERE[name]
    return getattr(importlib.import_module(module), attribute)
