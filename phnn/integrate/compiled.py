"""The decorators that compile functions to machine code, and their options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba import types
from numba.extending import intrinsic

from phnn.integrate.cache import compiled
from phnn.integrate.hooks import loop_options

# Inlining is done by the caller only: numba would pass the wish on to every function that is compiled inside.
inline = numba.njit(error_model="numpy", forceinline=True)
# A plain call, unless LLVM decides otherwise: see `stay_outside`.
plain = numba.njit(error_model="numpy", forceinline=False)
# A loop over steps. It allocates no memory: reference counts of arrays would take most of the time.
loop = numba.njit(error_model="numpy", **loop_options())


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function that python calls; its machine code is kept for each version of the sources."""
    return compiled(function, nogil=True, error_model="numpy")


def loop_entry(function: Callable[..., Any]) -> Any:
    """Compile a `loop` that python calls."""
    return compiled(function, nogil=True, error_model="numpy", **loop_options())


@intrinsic
def stay_outside(typing_context: Any) -> Any:
    """Keep LLVM from inlining the compiled function that calls this in its body.

    Otherwise LLVM inlines every function with few call sites, level by level, and the compilation takes minutes.
    """

    def mark(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.none(), mark
