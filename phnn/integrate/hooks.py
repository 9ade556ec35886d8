"""The undocumented parts of torchdiffeq that the package uses.

``SOLVERS`` takes our steps as methods of `torchdiffeq`; ``_PerturbFunc``, ``_ReverseFunc`` and the closure of the
augmented dynamics show them the system and the solve behind the functions that they are given. Without these parts
`phnn.integrate.ode.odeint` takes the same steps, with gradients by a graph.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from functools import cache
from typing import Any

# Name of each part: its module, and its attribute there.
_PARTS = {
    "methods": ("torchdiffeq._impl.odeint", "SOLVERS"),
    "perturbed function": ("torchdiffeq._impl.misc", "_PerturbFunc"),
    "reversed function": ("torchdiffeq._impl.misc", "_ReverseFunc"),
}


@cache
def part(name: str) -> Any:
    """Return a private part of torchdiffeq; None where it is gone."""
    module, attribute = _PARTS[name]
    try:
        return getattr(importlib.import_module(module), attribute, None)
    except ImportError:
        return None


def add_methods(methods: Mapping[str, type]) -> None:
    """Register methods with `torchdiffeq.odeint` and `torchdiffeq.odeint_adjoint`, if they accept any."""
    if takes_methods():
        part("methods").update(methods)


def takes_methods() -> bool:
    """Whether torchdiffeq accepts methods that read the system which they integrate."""
    return all(part(name) is not None for name in _PARTS)


def behind(func: Any) -> tuple[Any, Any]:
    """The right-hand side behind the function that torchdiffeq gives a method, and the wrapper of ``odeint_adjoint``.

    Every call makes a new wrapper, which lives as long as the graph of its result. Attributes set on it therefore
    belong to this solve alone. Under ``odeint`` there is no wrapper: None.
    """
    inner = func.base_func
    if isinstance(inner, part("perturbed function")):
        return inner.base_func, inner
    return inner, None


def is_reversed(func: Any) -> bool:
    """Whether a right-hand side runs backwards in time."""
    return isinstance(func, part("reversed function"))


def augmented(func: Any) -> dict[str, Any]:
    """The closure variables of the augmented dynamics of torchdiffeq's backward pass; empty for any other function."""
    while hasattr(func, "base_func"):
        func = func.base_func
    known = dict(inspect.getclosurevars(func).nonlocals) if inspect.isfunction(func) else {}
    return known if "adjoint_params" in known else {}
