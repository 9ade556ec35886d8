"""Checks of the torch module of a network: names, learned laws, and the tensors that it is evaluated at.

Here are also the terms of a power balance, and the one reading of all parameters for all that one call evaluates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial, wraps
from threading import get_ident
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from phnn.errors import InputRefused, StructureViolated
from phnn.laws.sector import READ, check_energy, check_sector
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES
from phnn.network.elements import Port, Resistor, Storage


class PowerBalance(NamedTuple):
    """``dH/dt = Σ supplied − Σ dissipated``; the defect is a rounding error.

    Attributes:
        stored: (...) ``∇Hᵀ ẋ`` [W].
        dissipated: (..., R) ``ε_r φ_r(ε_r) ≥ 0`` of every resistor [W].
        supplied: (..., P) ``ψ(u) gᵀ∇H`` of every port [W].
        defect: (...) ``stored − Σ supplied + Σ dissipated`` [W].
    """

    stored: Tensor
    dissipated: Tensor
    supplied: Tensor
    defect: Tensor


P = ParamSpec("P")
R = TypeVar("R")

# The thread that is evaluating a system, and the values that it has read.
Present = tuple[int, dict[str, Tensor]] | None


def present_of(system: Any) -> dict[str, Tensor] | None:
    """Values read for the evaluation that is going on in this thread, None outside of one."""
    present = system._present
    return present[1] if present is not None and present[0] == get_ident() else None


def evaluation(method: Callable[Concatenate[Any, P], R]) -> Callable[Concatenate[Any, P], R]:
    """Make a method of a system read and check all parameters once, for itself and all that it calls."""

    @wraps(method)
    def evaluate(system: Any, *args: P.args, **kwargs: P.kwargs) -> R:
        if present_of(system) is not None:
            return method(system, *args, **kwargs)
        system._present = (get_ident(), system.present_values())
        try:
            return method(system, *args, **kwargs)
        finally:
            system._present = None

    return evaluate


Array = NDArray[np.float64]


def check_name(name: str, holder: nn.Module) -> None:
    """Refuse what torch cannot register: a dot, or an attribute that the holding module has already."""
    if not name or "." in name or hasattr(holder, name):
        raise StructureViolated(f"torch cannot register the name {name!r}: rename it (no dots, no python method names)")


def check_state(x: Tensor, names: Sequence[str]) -> None:
    """Refuse states (..., n) whose last dimension is not the number of state names."""
    if x.shape[-1:] != (len(names),):
        raise InputRefused(
            f"a state has shape {tuple(x.shape)}: its last dimension must be {len(names)} ({', '.join(names)})"
        )


def check_input(u: Tensor, ports: Sequence[Port]) -> None:
    """Refuse inputs (..., P) whose last dimension is not the number of ports."""
    if u.shape[-1:] != (len(ports),):
        raise InputRefused(
            f"an input has shape {tuple(u.shape)}: its last dimension must be {len(ports)}, the number of ports "
            f"({', '.join(p.name for p in ports) or 'none'})"
        )


def is_learned(law: Any) -> bool:
    """Whether a module is a learned law of the package, whose form keeps it passive for all weights."""
    form = getattr(law, "law", None)
    return isinstance(form, str) and (form in WIDE_RESISTORS or form in WIDE_STORAGES)


def check_module(kind: str, element: Storage | Resistor) -> None:
    """Refuse a law that is no torch module, not in float64, or not passive with its present weights.

    Args:
        kind: ``storage`` or ``resistor``.

    Raises:
        StructureViolated: with the remedy, and the counterexample where the law is not passive.
    """
    law, what = element.law, f"the law of {element.name}"
    if not isinstance(law, nn.Module):
        raise StructureViolated(f"{what} is {law!r}: give a law's name or a torch module")
    for name, tensor in law.named_parameters():
        if tensor.dtype != torch.float64:
            raise StructureViolated(f"{name} in {what} is {tensor.dtype}: convert the law with .double()")
    if is_learned(law):
        return
    what = f"{what}, a {type(law).__name__}"
    if kind == "storage":
        # A sum of energies with a weight among them says itself that it is a source.
        if getattr(law, "bounded", True):
            check_energy(_of_arrays(law.energy), what)  # type: ignore[arg-type]
    elif isinstance(element, Resistor) and element.modulated_by is not None:
        for q in READ:
            check_sector(_of_arrays(partial(_reading, law, q)), what, read=q)
    else:
        check_sector(_of_arrays(law), what)


def _reading(law: nn.Module, q: float, effort: Tensor) -> Tensor:
    """The flow of a law that reads a constant state."""
    return law(effort, torch.full_like(effort, q))


def _of_arrays(function: Callable[[Tensor], Tensor]) -> Callable[[Array], Array]:
    """A function of tensors as one of arrays, without gradients."""

    def call(points: Array) -> Array:
        with torch.no_grad():
            return function(torch.from_numpy(points)).double().numpy()

    return call
