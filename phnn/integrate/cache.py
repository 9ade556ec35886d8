"""Compile functions to machine code, and keep it between runs, in a folder for each version of the sources.

Loading machine code from a file runs it: the folder is the user's own. A file that cannot be read or written costs a
compilation and nothing else. While a process compiles a function, others that need it wait for what it keeps.

Private parts of numba are used: its `FunctionCache` with ``dispatcher._cache``, to survive damaged files and full
disks; ``get_executable`` and methods of `CPUCodeLibrary`, without which compilation takes twice as long; and the option
``_nrt``, without which loops count references.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba
import numpy as np
import platformdirs
from filelock import FileLock
from numba import _dynfunc, types
from numba.core.caching import FunctionCache
from numba.core.codegen import CPUCodeLibrary
from numba.core.cpu import CPUContext
from numba.extending import intrinsic

import phnn
from phnn.laws.identity import UnknownContent, hash_of_own_laws, registered_outside
from phnn.laws.law import close_tables

# Folders of phnn/ whose functions are compiled into others: numba itself notices changes in a function's own file only.
_SOURCES = ("laws", "integrate", "chain")
_WAIT = 120.0  # s to wait for another process that compiles the same function
# numba's wrappers, by which Python or C call a function, take a third of the compilation: only entries have one.
_INSIDE = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
_ENTRY = {"error_model": "numpy", "no_cfunc_wrapper": True, "nogil": True}


def inline(function: Callable[..., Any]) -> Any:
    """Compile a function that LLVM inlines into its callers, which are compiled themselves."""
    # Inlining is done by the caller only: numba would pass the wish on to every function that is compiled inside.
    return _called_by_compiled(numba.njit(forceinline=True, **_INSIDE)(function))


def plain(function: Callable[..., Any]) -> Any:
    """Compile a function that compiled ones call; LLVM may inline it: see `stay_outside`."""
    return _called_by_compiled(numba.njit(forceinline=False, **_INSIDE)(function))


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls; its machine code is kept for each version of the sources."""
    return compiled(function, **_ENTRY)


def loop_entry(function: Callable[..., Any]) -> Any:
    """Compile a loop over steps that Python calls.

    It allocates no memory: reference counts of arrays would take most of the time.
    """
    return compiled(function, **_ENTRY, _nrt=False)


@intrinsic
def stay_outside(typing_context: Any) -> Any:
    """Keep LLVM from inlining the compiled function that calls this in its body.

    Otherwise LLVM inlines every function with few call sites, level by level, and the compilation takes minutes.
    """

    def mark(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.none(), mark


def compiled(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a function that Python calls, on first use, and keep its machine code where a folder can be written."""
    dispatcher = numba.njit(**options)(function)
    folder = _folder()
    if folder is not None:
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
        try:
            kept = _Kept(function)
            # Where this folder does not serve, numba takes others, which know nothing of this version of the sources.
            if Path(kept.cache_path).is_relative_to(folder):
                dispatcher._cache = kept
        except RuntimeError:
            pass  # numba has no place for a function without a file
        finally:
            numba.config.CACHE_DIR = before
    return dispatcher


class _Kept(FunctionCache):
    """The kept machine code of a function."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return machine code for a signature; None where there is none, and the caller compiles it."""
        machine_code = self._load(sig, target_context)
        if machine_code is None:
            # A new one each time: a lock that a forked process inherits is refused.
            self._lock = FileLock(Path(self.cache_path, f"{self._impl.filename_base}.lock"))
            with suppress(OSError, NotImplementedError):
                self._lock.acquire(timeout=_WAIT)
            machine_code = self._load(sig, target_context)
            if machine_code is not None:
                self._lock.release(force=True)
        return machine_code

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            # A damaged file may raise anything; a law in it may belong to a script that is not running.
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep machine code; where that fails it serves this process alone."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            _warn_not_kept(f"in {self.cache_path}: {error}")
        finally:
            self._lock.release(force=True)


@cache
def fingerprint() -> str:
    """Return a hash of the sources of the kernels, of the laws that a user registered, and of versions of libraries."""
    digest = hashlib.sha256(repr((numba.__version__, np.__version__, sys.version_info[:2])).encode())
    close_tables()
    digest.update(hash_of_own_laws())
    for folder in _SOURCES:
        for path in sorted(Path(phnn.__file__).with_name(folder).glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _folder() -> Path | None:
    """Return the folder for this version of the sources; None, with a warning, where it cannot be written."""
    home = Path(os.environ.get("PHNN_CACHE_DIR") or platformdirs.user_cache_dir()).absolute() / "phnn"
    try:
        folder = home / fingerprint()
        home.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except UnknownContent as error:
        _warn_not_kept(
            f": {error}, whose changes cannot be recognised; let laws use numbers, tuples, arrays and functions by "
            "their own names"
        )
        return None
    except OSError as error:
        _warn_not_kept(f"in {home}: {error}")
        return None
    return folder


def _warn_not_kept(reason: str) -> None:
    warnings.warn(f"compiled code is not kept {reason}; set PHNN_CACHE_DIR to a folder of your own", stacklevel=4)


@cache
def compile_ahead() -> bool:
    """Begin to compile the derivatives in another process, which ends with this one, and return whether that is needed.

    A fit simulates first; this process compiles that meanwhile, and waits where it needs the derivatives earlier.
    """
    folder = _folder()
    if folder is None or any(folder.glob("*/*.sensitivity_steps-*.nbc")):
        return False
    # Another process knows nothing of laws that were registered in this one.
    if not registered_outside():
        # -P: a folder of recordings may hold modules, which are not to be imported.
        command = [sys.executable, "-P", "-c", "from phnn.derivatives import compile_all; compile_all()"]
        with suppress(OSError):
            silent = subprocess.DEVNULL
            atexit.register(subprocess.Popen(command, stdin=silent, stdout=silent, stderr=silent).kill)
    return True


def _called_by_compiled(dispatcher: Any) -> Any:
    """Make a function that only compiled ones call a part of theirs, without machine code of its own.

    It has no wrapper for calls from Python: they would end the process, and are refused here. numba would optimise and
    translate it, with all that it calls, once for itself and once for every function above it.
    """

    def refuse(*_: Any, **__: Any) -> None:
        raise TypeError(f"{dispatcher.py_func.__qualname__} is called by compiled functions only: take its `py_func`")

    dispatcher._insert = _nothing
    dispatcher._compile_for_args = refuse
    _translate_callers_only()
    return dispatcher


@cache
def _translate_callers_only() -> None:
    """Have numba translate, of the functions of this package, only those that Python or C can call."""
    translated = CPUContext.get_executable
    needed = ("_ensure_finalized", "_optimize_final_module", "_finalize_final_module", "_finalize_dynamic_globals")
    if not all(hasattr(CPUCodeLibrary, name) for name in (*needed, "_verify_declare_only_symbols")):
        return  # another version of numba: everything is translated, which takes longer

    def get_executable(self: Any, library: Any, fndesc: Any, env: Any) -> Any:
        wrappers = {fndesc.llvm_cpython_wrapper_name, fndesc.llvm_cfunc_wrapper_name}
        of_package = str(fndesc.modname).startswith("phnn.")
        # What is loaded from files is finalised already, and shows none of its functions.
        called = library._finalized or wrappers & {function.name for function in library._final_module.functions}
        if called or not of_package:
            return translated(self, library, fndesc, env)
        library._optimize_final_module = _nothing
        library._finalize_final_module = partial(_finish, library)
        library._ensure_finalized()
        # What numba makes of a function without a wrapper: an object that stands for it among its callers.
        return _dynfunc.make_function(fndesc.lookup_module(), fndesc.qualname.split(".")[-1], "", 0, env, (library,))

    CPUContext.get_executable = get_executable


def _finish(library: Any) -> None:
    """End a library of code that others link, without giving it to the machine."""
    library._finalize_dynamic_globals()
    library._verify_declare_only_symbols()
    library._finalized = True


def _nothing(*_: Any, **__: Any) -> None:
    """Stand in for steps of numba that are left out."""
