"""The undocumented parts of numba and torchdiffeq that the package uses, each with a fallback.

=============================  =============================================  ======================================
part                           used for                                       without it
=============================  =============================================  ======================================
numba ``dispatcher._cache``,   checking kept machine code before it is run    every function is compiled in memory,
``IndexDataCacheFile``                                                        with a warning
numba ``_insert``,             refusing calls from Python of functions that   such a call ends the process
``_compile_for_args``          only compiled ones call
numba ``get_executable``,      machine code only for functions that Python    compilation takes twice as long
``_finalize_final_module``, …  calls
numba option ``_nrt``          loops without reference counts                 slower loops
torchdiffeq ``SOLVERS``,       our steps as methods of `torchdiffeq`, which   `phnn.integrate.ode.odeint` and
``_PerturbFunc``,              read the system and the solve from the         `compiled_method.sampled_states` take
``_ReverseFunc``, closure of   functions they are given                       the same steps, with gradients by a
the augmented dynamics                                                        graph
=============================  =============================================  ======================================

`missing` names the parts that the installed versions lack.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import pickle
from collections.abc import Mapping
from functools import cache, partial
from typing import Any

import numba

_HASH = hashlib.sha256().digest_size
# Name of each part: its module, and its attribute there.
_PARTS = {
    "numba files of a cache": ("numba.core.caching", "IndexDataCacheFile"),
    "numba executable": ("numba.core.cpu", "CPUContext"),
    "numba library": ("numba.core.codegen", "CPUCodeLibrary"),
    "numba builtin": ("numba._dynfunc", "make_function"),
    "torchdiffeq methods": ("torchdiffeq._impl.odeint", "SOLVERS"),
    "torchdiffeq perturbed function": ("torchdiffeq._impl.misc", "_PerturbFunc"),
    "torchdiffeq reversed function": ("torchdiffeq._impl.misc", "_ReverseFunc"),
}
_CALLS = ("_insert", "_compile_for_args")
_TRANSLATION = (
    "_ensure_finalized", "_optimize_final_module", "_finalize_final_module", "_finalize_dynamic_globals",
    "_verify_declare_only_symbols",
)  # fmt: skip
_CACHE_FILE = ("_cache_path", "_index_name", "_source_stamp")


@cache
def part(name: str) -> Any:
    """A private part of another package; None where it is gone."""
    module, attribute = _PARTS[name]
    try:
        return getattr(importlib.import_module(module), attribute, None)
    except ImportError:
        return None


def missing() -> list[str]:
    """Names of the parts that the installed numba and torchdiffeq do not have."""
    gone = [name for name in _PARTS if part(name) is None]
    gone += [] if _has_calls(_dispatcher_class()) else ["numba calls of a dispatcher"]
    gone += [] if _has_translation() else ["numba translation of a library"]
    return gone + ([] if loop_options() else ["numba option _nrt"])


def called_by_compiled(dispatcher: Any) -> Any:
    """Make a function that only compiled ones call a part of theirs, without machine code of its own.

    It has no wrapper for calls from Python: they would end the process, and are refused here. numba would optimise and
    translate it, with all that it calls, once for itself and once for every function above it. Without numba's private
    parts the function is returned as it is.
    """

    def refuse(*_: Any, **__: Any) -> None:
        raise TypeError(f"{dispatcher.py_func.__qualname__} is called by compiled functions only: take its `py_func`")

    if _has_calls(dispatcher):
        dispatcher._insert = _nothing
        dispatcher._compile_for_args = refuse
    _translate_callers_only()
    return dispatcher


@cache
def _translate_callers_only() -> None:
    """Have numba translate, of the functions of this package, only those that Python or C can call."""
    context, make = part("numba executable"), part("numba builtin")
    if context is None or make is None or not _has_translation():
        return
    translated = context.get_executable

    def get_executable(self: Any, library: Any, fndesc: Any, env: Any) -> Any:
        wrappers = {fndesc.llvm_cpython_wrapper_name, fndesc.llvm_cfunc_wrapper_name}
        own = str(fndesc.modname).startswith("phnn.")
        # What is loaded from files is finalised already, and shows none of its functions.
        called = library._finalized or wrappers & {function.name for function in library._final_module.functions}
        if called or not own:
            return translated(self, library, fndesc, env)
        library._optimize_final_module = _nothing
        library._finalize_final_module = partial(_finish, library)
        library._ensure_finalized()
        # What numba makes of a function without a wrapper: an object that stands for it among its callers.
        return make(fndesc.lookup_module(), fndesc.qualname.split(".")[-1], "", 0, env, (library,))

    context.get_executable = get_executable


def _finish(library: Any) -> None:
    """End a library of code that others link, without giving it to the machine."""
    library._finalize_dynamic_globals()
    library._verify_declare_only_symbols()
    library._finalized = True


def _has_calls(dispatcher: Any) -> bool:
    return all(hasattr(dispatcher, name) for name in _CALLS)


def _has_translation() -> bool:
    library = part("numba library")
    return library is not None and all(hasattr(library, name) for name in _TRANSLATION)


def _dispatcher_class() -> type:
    return type(numba.njit(_nothing))


def _nothing(*_: Any, **__: Any) -> None:
    """Stand in for steps of numba that are left out."""


@cache
def loop_options() -> Mapping[str, bool]:
    """numba's options for a loop that allocates no memory."""
    from numba.core.options import DefaultOptions

    return {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}


def check_content(dispatcher: Any) -> bool:
    """Make numba's cache of a function read and write files that begin with the hash of their content.

    Returns:
        Whether that was possible; otherwise the cached files must not be used.
    """
    kept: Any = getattr(dispatcher, "_cache", None)
    given: Any = getattr(kept, "_cache_file", None)
    if part("numba files of a cache") is None or not all(hasattr(given, name) for name in _CACHE_FILE):
        return False
    kept._cache_file = _checked_files()(
        given._cache_path, given._index_name.removesuffix(".nbi"), source_stamp=given._source_stamp
    )
    return True


@cache
def _checked_files() -> type:
    """The class of numba's files of a function: an index of signatures, and machine code for each."""

    class Checked(part("numba files of a cache")):  # type: ignore[misc]
        def _load_index(self) -> dict[Any, str]:
            content = self._read(self._index_path)
            if content is None:
                return {}
            version, stamp, overloads = pickle.loads(content)
            return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

        def _save_index(self, overloads: dict[Any, str]) -> None:
            self._write(self._index_path, self._dump((self._version, self._source_stamp, overloads)))

        def _load_data(self, name: str) -> Any:
            content = self._read(self._data_path(name))
            if content is None:
                # The caller treats it as a file that was removed.
                raise FileNotFoundError(name)
            try:
                return pickle.loads(content)
            except (ImportError, AttributeError) as error:
                # A law of this code belongs to a module that this process cannot import, such as a script.
                raise FileNotFoundError(name) from error

        def _save_data(self, name: str, data: Any) -> None:
            self._write(self._data_path(name), self._dump(data))

        def _read(self, path: str) -> bytes | None:
            """The content of a file if its hash is right."""
            try:
                with open(path, "rb") as file:
                    content = file.read()
            except OSError:
                return None
            right = hashlib.sha256(content[_HASH:]).digest() == content[:_HASH]
            return content[_HASH:] if right else None

        def _write(self, path: str, content: bytes) -> None:
            """Write a file with its hash; on a full disk the function stays compiled in memory."""
            try:
                with self._open_for_write(path) as file:
                    file.write(hashlib.sha256(content).digest() + content)
            except OSError:
                return

    return Checked


def add_methods(methods: Mapping[str, type]) -> None:
    """Register methods with `torchdiffeq.odeint` and `torchdiffeq.odeint_adjoint`, if they accept any."""
    if takes_methods():
        part("torchdiffeq methods").update(methods)


def takes_methods() -> bool:
    """Whether torchdiffeq accepts methods that read the system which they integrate."""
    return all(part(name) is not None for name in _PARTS if name.startswith("torchdiffeq"))


def behind(func: Any) -> tuple[Any, Any]:
    """The right-hand side behind the function that torchdiffeq gives a method, and the wrapper of ``odeint_adjoint``.

    Every call makes a new wrapper, which lives as long as the graph of its result. Attributes set on it therefore
    belong to this solve alone. Under ``odeint`` there is no wrapper: None.
    """
    inner = func.base_func
    if isinstance(inner, part("torchdiffeq perturbed function")):
        return inner.base_func, inner
    return inner, None


def is_reversed(func: Any) -> bool:
    """Whether a right-hand side runs backwards in time."""
    return isinstance(func, part("torchdiffeq reversed function"))


def augmented(func: Any) -> dict[str, Any]:
    """The closure variables of the augmented dynamics of torchdiffeq's backward pass; empty for any other function."""
    while hasattr(func, "base_func"):
        func = func.base_func
    known = dict(inspect.getclosurevars(func).nonlocals) if inspect.isfunction(func) else {}
    return known if "adjoint_params" in known else {}
