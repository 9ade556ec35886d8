"""The laws that were registered from outside the package: which they are, and a hash over their code.

Compiled kernels hold the code of every registered law. Machine code that is kept between runs is therefore valid only
for the same laws in the same order, and worker processes register the laws of their parent.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from phnn.laws.law import TABLES, register

_PACKAGE = __name__.partition(".")[0]


def registered_outside() -> list[Any]:
    """The laws from outside the package, in the order of their tables."""
    return [law for table in TABLES.values() for law in table.values() if not all(map(_of_package, _functions(law)))]


def register_again(law: Any) -> None:
    """Register a law of another process, unless importing its module has done so."""
    if not any(law.name in table and isinstance(law, kind) for kind, table in TABLES.items()):
        register(law)


def hash_of_own_laws() -> bytes:
    """Hash of the laws from outside the package; empty if there are none.

    It covers the code of their functions, and of the functions and values of their modules that they use.
    """
    digest = hashlib.sha256()
    laws = registered_outside()
    for law in laws:
        digest.update(repr((type(law).__name__, law.name, len(law.example))).encode())
        for function in _functions(law):
            _add(digest, function, set())
    return digest.digest() if laws else b""


def _functions(law: Any) -> list[Callable[..., Any]]:
    return [f for f in (getattr(law, x.name) for x in fields(law)) if callable(f)]


def _of_package(value: Any) -> bool:
    return str(getattr(value, "__module__", "")).partition(".")[0] == _PACKAGE


def _add(digest: Any, value: Any, seen: set[int]) -> None:
    """Add a value that compiled code may contain, and for a function all values that it uses."""
    function: Callable[..., Any] = getattr(value, "py_func", value)  # of a function that numba has compiled
    if isinstance(function, FunctionType):
        if id(function) in seen or _of_package(function):
            return
        seen.add(id(function))
        _add_code(digest, function.__code__)
        for name in _names(function.__code__):
            _add(digest, function.__globals__.get(name), seen)
        cells = [cell.cell_contents for cell in function.__closure__ or ()]
        for held in (*cells, *(function.__defaults__ or ())):
            _add(digest, held, seen)
    elif isinstance(value, np.ndarray):
        digest.update(repr((value.dtype, value.shape)).encode() + value.tobytes())
    elif isinstance(value, bool | int | float | complex | str | tuple | np.generic):
        digest.update(repr(value).encode())
    elif not isinstance(value, ModuleType):
        digest.update(str(getattr(value, "__qualname__", type(value))).encode())


def _add_code(digest: Any, code: CodeType) -> None:
    digest.update(code.co_code + repr((code.co_names, code.co_varnames, code.co_freevars)).encode())
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            _add_code(digest, constant)
        else:
            digest.update(repr(constant).encode())


def _names(code: CodeType) -> list[str]:
    """Global names that a function and the functions inside it use."""
    inner = [name for c in code.co_consts if isinstance(c, CodeType) for name in _names(c)]
    return [*code.co_names, *inner]
