"""How functions become machine code: the ways to compile one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba import types
from numba.extending import intrinsic

from phnn.integrate.cache import compiled
from phnn.integrate.hooks import loop_options

# Stands in the caller. numba hands the wish to be inlined on to whatever is compiled inside, unless it is refused.
inline = numba.njit(error_model="numpy", forceinline=True)
# A call, as far as LLVM does not find otherwise: see `stay_outside`.
plain = numba.njit(error_model="numpy", forceinline=False)
# A loop over steps. It owns no memory: reference counts of arrays would cost most of the time.
loop = numba.njit(error_model="numpy", **loop_options())


def entry(function: Callable[..., Any]) -> Any:
    """What python calls: its machine code is kept, per version of the sources."""
    return compiled(function, nogil=True, error_model="numpy")


def loop_entry(function: Callable[..., Any]) -> Any:
    """A `loop` that python calls."""
    return compiled(function, nogil=True, error_model="numpy", **loop_options())


@intrinsic
def stay_outside(typing_context: Any) -> Any:
    """Called in the body of a compiled function: keeps LLVM from inlining that function.

    Left alone it inlines everything that is called from few places, level by level, and compiles for minutes.
    """

    def mark(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.none(), mark
