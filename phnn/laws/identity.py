"""The laws that were registered from outside the package: which they are, and a hash over their code.

Compiled kernels hold the code of every registered law. Machine code that is kept between runs is therefore valid only
for the same laws in the same order, and worker processes register the laws of their parent.
"""

from __future__ import annotations

import hashlib
from dataclasses import fields
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from phnn.laws.law import TABLES, is_of_package, register

# Their functions change with their versions only, which are part of the name of the kept code.
_KNOWN = ("phnn", "numpy", "math", "cmath", "numba", "builtins")
_NUMBERS = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))


class UnknownContent(Exception):
    """A law uses a value whose changes cannot be recognised; the message names it."""


def registered_outside() -> list[Any]:
    """Return the laws from outside the package, in the order of their tables."""
    return [law for table in TABLES.values() for law in table.values() if not is_of_package(law)]


def register_again(law: Any) -> None:
    """Register a law of another process, unless importing its module has done so."""
    if not any(law.name in table and isinstance(law, kind) for kind, table in TABLES.items()):
        register(law)


def hash_of_own_laws() -> bytes:
    """Return a hash of the laws from outside the package; empty if there are none.

    Raises:
        UnknownContent: as `content`.
    """
    laws, seen, parts = registered_outside(), list[Any](), []
    for law in laws:
        functions = {f.name: v for f in fields(law) if callable(v := getattr(law, f.name)) or v is None}
        contents = [(name, content(function, f"the law {law.name}", seen)) for name, function in functions.items()]
        parts.append((type(law).__name__, law.name, len(law.example), contents))
    return hashlib.sha256(repr(parts).encode()).digest() if laws else b""


def content(value: Any, owner: str, seen: list[Any]) -> Any:
    """Return what compiled code may contain of a value, in numbers, texts and tuples whose `repr` tells all apart.

    Args:
        owner: what uses the value, for the message; seen: functions that were met before.

    Raises:
        UnknownContent: it uses something else than numbers, arrays, tuples, functions of Python files and of numpy.
    """
    value = getattr(value, "py_func", value)  # of a function that numba has compiled
    if isinstance(value, _NUMBERS):
        return value
    if isinstance(value, np.generic | np.ndarray) and value.dtype != object:
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(content(item, owner, seen) for item in value)
    if isinstance(value, frozenset):
        return sorted(map(repr, value))
    if isinstance(value, CodeType):
        names = value.co_names, value.co_varnames, value.co_freevars
        return value.co_code, names, content(value.co_consts, owner, seen)
    if _is_known(value):
        return "known", str(getattr(value, "__module__", "")), str(getattr(value, "__qualname__", value))
    if not isinstance(value, FunctionType):
        raise UnknownContent(f"{owner} uses {getattr(value, '__name__', type(value).__name__)}")
    if value in seen:
        return "again", seen.index(value)
    seen.append(value)
    name, used = f"{value.__module__}.{value.__qualname__}", _names(value.__code__)
    held = [(n, value.__globals__[n]) for n in used if n in value.__globals__]
    cells = tuple(c.cell_contents for c in value.__closure__ or ())
    parts = (value.__code__, *held, cells, value.__defaults__ or (), *sorted((value.__kwdefaults__ or {}).items()))
    return name, content(parts, name, seen)


def _is_known(value: Any) -> bool:
    """Return whether a value belongs to the package or to a library whose version is known."""
    if isinstance(value, ModuleType):
        return value.__name__.partition(".")[0] in _KNOWN
    if isinstance(value, np.ufunc):
        return str(getattr(np, value.__name__, None)) == str(value)
    if isinstance(value, FunctionType | BuiltinFunctionType | type):
        return str(value.__module__).partition(".")[0] in _KNOWN
    return False


def _names(code: CodeType) -> list[str]:
    """Global names that a function and the functions inside it use."""
    return [*code.co_names, *(name for c in code.co_consts if isinstance(c, CodeType) for name in _names(c))]
