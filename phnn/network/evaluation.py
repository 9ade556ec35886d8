"""One reading of all parameters for everything that one call of a system evaluates."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from threading import get_ident
from typing import Any, Concatenate, ParamSpec, TypeVar

from torch import Tensor

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
