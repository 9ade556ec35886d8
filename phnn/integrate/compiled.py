"""How functions become machine code: the ways to compile one, and a cache that notices every edited source."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.extending import intrinsic

import phnn

# What compiled code is made from; torch modules beside them may be edited without compiling anew.
_SOURCES = (
    "laws/*.py",
    "integrate/compiled.py",
    "integrate/dispatch.py",
    "integrate/tables.py",
    "integrate/lookups.py",
    "integrate/constants.py",
    "integrate/roots.py",
    "integrate/step.py",
    "integrate/memories.py",
    "integrate/stages.py",
    "integrate/elimination.py",
    "integrate/solve.py",
    "integrate/quick.py",
    "integrate/linearise.py",
    "integrate/pieces.py",
    "integrate/recursion.py",
    "integrate/kernel.py",
    "integrate/sweep.py",
    "modal/elements.py",
    "modal/march.py",
)

# Stands in the caller. numba hands the wish to be inlined on to whatever is compiled inside, unless it is refused.
inline = numba.njit(error_model="numpy", forceinline=True)
# A call, as far as LLVM does not find otherwise: see `stay_outside`.
plain = numba.njit(error_model="numpy", forceinline=False)
# A loop over steps. It owns no memory: reference counts of arrays would cost most of the time.
loop = numba.njit(error_model="numpy", _nrt=False)


def entry(function: Callable[..., Any]) -> Any:
    """What python calls: its machine code is kept, per version of the sources."""
    with _kernel_cache():
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)


def loop_entry(function: Callable[..., Any]) -> Any:
    """A `loop` that python calls."""
    with _kernel_cache():
        return numba.njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(function)


@intrinsic
def stay_outside(typing_context: Any) -> Any:
    """Called in the body of a compiled function: keeps LLVM from inlining that function.

    Left alone it inlines everything that is called from few places, level by level, and compiles for minutes.
    """

    def mark(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.none(), mark


def fingerprint() -> str:
    """Hash of the sources a kernel is made from: numba's own cache does not see an edited callee elsewhere."""
    root = Path(phnn.__file__).parent
    digest = hashlib.sha256()
    for pattern in _SOURCES:
        for path in sorted(root.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@contextmanager
def _kernel_cache() -> Iterator[None]:
    """Where functions that are declared inside this context keep their machine code."""
    home = os.environ.get("PHNN_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(Path(home) / "phnn" / fingerprint())
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before
