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
    """The laws from outside the package, in the order of their tables."""
    return [law for table in TABLES.values() for law in table.values() if not is_of_package(law)]


def register_again(law: Any) -> None:
    """Register a law of another process, unless importing its module has done so."""
    if not any(law.name in table and isinstance(law, kind) for kind, table in TABLES.items()):
        register(law)


def hash_of_own_laws() -> bytes:
    """Hash of the laws from outside the package; empty if there are none.

    It covers the code of their functions, and of the functions and values that these use.

    Raises:
        UnknownContent: they use something else than numbers, arrays, tuples, functions of Python files and of numpy.
    """
    laws = registered_outside()
    content = _Content()
    for law in laws:
        content.say("law", type(law).__name__, law.name, str(len(law.example)))
        for field in fields(law):
            function = getattr(law, field.name)
            if callable(function) or function is None:
                content.say(field.name)
                content.add(function, f"the law {law.name}")
    return content.digest() if laws else b""


class _Content:
    """A hash over values; every part is written with its length, so that no two sequences look alike."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._seen: dict[int, int] = {}

    def digest(self) -> bytes:
        return self._hash.digest()

    def say(self, *parts: str | bytes) -> None:
        for part in parts:
            data = part.encode() if isinstance(part, str) else part
            self._hash.update(len(data).to_bytes(8, "little") + data)

    def add(self, value: Any, owner: str) -> None:
        """Add a value that compiled code may contain."""
        value = getattr(value, "py_func", value)  # of a function that numba has compiled
        if isinstance(value, _NUMBERS):
            self.say(type(value).__name__, repr(value))
        elif isinstance(value, np.generic | np.ndarray) and value.dtype != object:
            self.say("array", str(value.dtype), str(value.shape), value.tobytes())
        elif isinstance(value, tuple):
            self.say("tuple", str(len(value)))
            for item in value:
                self.add(item, owner)
        elif isinstance(value, frozenset):
            self.say("set", *sorted(repr(item) for item in value))
        elif isinstance(value, CodeType):
            self._add_code(value, owner)
        elif _is_known(value):
            self.say("known", str(getattr(value, "__module__", "")), str(getattr(value, "__qualname__", value)))
        elif isinstance(value, FunctionType):
            self._add_function(value)
        else:
            raise UnknownContent(f"{owner} uses {getattr(value, '__name__', type(value).__name__)}")

    def _add_function(self, function: FunctionType) -> None:
        if id(function) in self._seen:
            self.say("again", str(self._seen[id(function)]))
            return
        self._seen[id(function)] = len(self._seen)
        owner = f"{function.__module__}.{function.__qualname__}"
        self.say("function", owner)
        self._add_code(function.__code__, owner)
        for name in _names(function.__code__):
            if name in function.__globals__:
                self.say("global", name)
                self.add(function.__globals__[name], owner)
        for held in ([c.cell_contents for c in function.__closure__ or ()], function.__defaults__ or ()):
            self.add(tuple(held), owner)
        self.add(tuple(sorted((function.__kwdefaults__ or {}).items())), owner)

    def _add_code(self, code: CodeType, owner: str) -> None:
        self.say("code", code.co_code, repr((code.co_names, code.co_varnames, code.co_freevars)))
        self.add(tuple(code.co_consts), owner)


def _is_known(value: Any) -> bool:
    """Whether a value belongs to the package or to a library whose version is known."""
    if isinstance(value, ModuleType):
        return value.__name__.partition(".")[0] in _KNOWN
    if isinstance(value, np.ufunc):
        return str(getattr(np, value.__name__, None)) == str(value)
    if isinstance(value, FunctionType | BuiltinFunctionType | type):
        return str(value.__module__).partition(".")[0] in _KNOWN
    return False


def _names(code: CodeType) -> list[str]:
    """Global names that a function and the functions inside it use."""
    inner = [name for c in code.co_consts if isinstance(c, CodeType) for name in _names(c)]
    return [*code.co_names, *inner]
