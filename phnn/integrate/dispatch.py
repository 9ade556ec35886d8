"""Compiled look-up of laws by their position in the registry, with a cache that notices edited laws."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba

import phnn
from phnn.laws import law as law_module

# What compiled code is made from; torch modules beside them may be edited without compiling anew.
_SOURCES = (
    "laws/*.py",
    "integrate/dispatch.py",
    "integrate/program.py",
    "integrate/step.py",
    "integrate/kernel.py",
    "integrate/sweep.py",
)


def _fingerprint() -> str:
    """Hash of the sources a kernel is made from: numba's own cache does not see an edited callee elsewhere."""
    root = Path(phnn.__file__).parent
    digest = hashlib.sha256()
    for pattern in _SOURCES:
        for path in sorted(root.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@contextmanager
def kernel_cache() -> Iterator[None]:
    """Compile inside this context: the machine code is kept per version of the sources."""
    home = os.environ.get("PHNN_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(Path(home) / "phnn" / _fingerprint())
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def look_up(name: str, functions: Sequence[Callable[..., Any] | None], counts: Sequence[int], leading: int) -> Any:
    """A compiled ``name(code, a_1…a_leading, p0, p1, p2, p3)`` calling the function at position ``code``.

    Args:
        functions: by code; None where a law lacks this function.
        counts: how many of the four parameters each takes.
        leading: number of arguments before the parameters.
    """
    arguments = [f"a{i}" for i in range(leading)]
    parameters = [f"p{i}" for i in range(4)]
    scope: dict[str, Any] = {}
    lines = [f"def {name}(code, {', '.join(arguments + parameters)}):"]
    present = [(code, f, n) for code, (f, n) in enumerate(zip(functions, counts, strict=True)) if f is not None]
    for code, function, count in present:
        scope[f"f{code}"] = numba.njit(function, forceinline=True, error_model="numpy")
        call = f"return f{code}({', '.join(arguments + parameters[:count])})"
        # The last one needs no test, so that the function returns on every path.
        lines.append(f"    {call}" if code == present[-1][0] else f"    if code == {code}:\n        {call}")
    # The text is built from positions only.
    exec("\n".join(lines), scope)
    return numba.njit(scope[name], forceinline=True, error_model="numpy")


def storage_table() -> Any:
    """``mean_effort(code, a, b, p0…p3)``."""
    laws = list(law_module.STORAGE_LAWS.values())
    return look_up("mean_effort", [x.mean_effort for x in laws], [len(x.example) for x in laws], 2)


def threshold_table() -> Any:
    """``thresholds(code, q, p0…p3)``."""
    laws = list(law_module.RESISTOR_LAWS.values())
    return look_up("thresholds", [x.thresholds for x in laws], [len(x.example) for x in laws], 1)


def flow_table() -> Any:
    """``flow(code, effort, q, p0…p3)``."""
    laws = list(law_module.RESISTOR_LAWS.values())
    return look_up("flow", [x.flow for x in laws], [len(x.example) for x in laws], 2)


def port_table() -> Any:
    """``action(code, u, p0…p3)``."""
    laws = list(law_module.PORT_LAWS.values())
    return look_up("action", [x.action for x in laws], [len(x.example) for x in laws], 1)
