"""Port-Hamiltonian models of piezoelectric actuators from recordings, and the physics they leave out.

    import phnn

    campaign  = phnn.read("recordings/")
    diagnosis = phnn.diagnose(campaign)
    print(diagnosis)
    diagnosis.write("out/")
    y = diagnosis.model.simulate(t, voltage)

Names are loaded when they are first used, so that importing the package costs little.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phnn import control, effects, models, nn, plot
    from phnn.check import check
    from phnn.comparison.models import compare
    from phnn.errors import InputRefused, PhnnError, SolverFailed
    from phnn.exporting.write import export
    from phnn.identification.identified import identify
    from phnn.identification.plan import Options
    from phnn.integrate.differentiable import simulate
    from phnn.learn.run import Trained, train
    from phnn.model import Model
    from phnn.network.elements import Network
    from phnn.network.system import PortHamiltonianSystem
    from phnn.predictor import load, predict
    from phnn.recordings import describe, read
    from phnn.setup import Setup
    from phnn.verbs import Diagnosis, diagnose

    __version__: str

# Where each public name is defined; None for the module of that name.
_DEFINED_IN = {
    "read": "phnn.recordings",
    "check": "phnn.check",
    "describe": "phnn.recordings",
    "identify": "phnn.identification.identified",
    "diagnose": "phnn.verbs",
    "predict": "phnn.predictor",
    "simulate": "phnn.integrate.differentiable",
    "train": "phnn.learn.run",
    "compare": "phnn.comparison.models",
    "export": "phnn.exporting.write",
    "load": "phnn.predictor",
    "control": None,
    "models": None,
    "effects": None,
    "nn": None,
    "plot": None,
    "Diagnosis": "phnn.verbs",
    "InputRefused": "phnn.errors",
    "Model": "phnn.model",
    "Network": "phnn.network.elements",
    "Options": "phnn.identification.plan",
    "PhnnError": "phnn.errors",
    "PortHamiltonianSystem": "phnn.integrate.method",
    "Setup": "phnn.setup",
    "SolverFailed": "phnn.errors",
    "Trained": "phnn.learn.run",
}

__all__ = [
    "Diagnosis",
    "InputRefused",
    "Model",
    "Network",
    "Options",
    "PhnnError",
    "PortHamiltonianSystem",
    "Setup",
    "SolverFailed",
    "Trained",
    "check",
    "compare",
    "control",
    "describe",
    "diagnose",
    "effects",
    "export",
    "identify",
    "load",
    "models",
    "nn",
    "plot",
    "predict",
    "read",
    "simulate",
    "train",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        # The installed distribution knows it from pyproject.toml, the one place where it stands.
        from importlib.metadata import version

        return version("phnn")
    if name not in _DEFINED_IN:
        raise AttributeError(f"module 'phnn' has no attribute {name!r}; it has {', '.join(__all__)}")
    module = _DEFINED_IN[name]
    return importlib.import_module(f"phnn.{name}") if module is None else getattr(importlib.import_module(module), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """The package, in which a room such as `phnn.diagnose` does not take the place of the verb of its name."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (isinstance(value, ModuleType) and _DEFINED_IN.get(name)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
