"""The decorators that compile functions to machine code, and their options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba import types
from numba.extending import intrinsic

from phnn.integrate.cache import compiled
from phnn.integrate.hooks import called_by_compiled, loop_options

# numba's wrappers, by which Python or C call a function, take a third of the compilation: only entries have one.
_WITHOUT_WRAPPERS = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True, **loop_options()}


def inline(function: Callable[..., Any]) -> Any:
    """Compile a function that LLVM inlines into its callers, which are compiled themselves."""
    # Inlining is done by the caller only: numba would pass the wish on to every function that is compiled inside.
    return called_by_compiled(numba.njit(forceinline=True, **_WITHOUT_WRAPPERS)(function))


def plain(function: Callable[..., Any]) -> Any:
    """Compile a function that compiled ones call; LLVM may inline it: see `stay_outside`."""
    return called_by_compiled(numba.njit(forceinline=False, **_WITHOUT_WRAPPERS)(function))


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function that python calls; its machine code is kept for each version of the sources."""
    return compiled(function, nogil=True, error_model="numpy", no_cfunc_wrapper=True)


def loop_entry(function: Callable[..., Any]) -> Any:
    """Compile a loop over steps that Python calls.

    It allocates no memory: reference counts of arrays would take most of the time.
    """
    return compiled(function, nogil=True, error_model="numpy", no_cfunc_wrapper=True, **loop_options())


@intrinsic
def stay_outside(typing_context: Any) -> Any:
    """Keep LLVM from inlining the compiled function that calls this in its body.

    Otherwise LLVM inlines every function with few call sites, level by level, and the compilation takes minutes.
    """

    def mark(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.none(), mark
