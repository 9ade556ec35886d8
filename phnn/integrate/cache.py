"""Storage of compiled machine code between runs, in a private folder of the user; files are checked before use.

Loading machine code from a file runs it. The folder must therefore belong to the user, and nobody else may be able to
write to it. Every file begins with the hash of its content. A damaged file counts as absent, and the function is
compiled again. Where no file can be written (no home, no rights, a full disk), functions are compiled in memory.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np

import phnn
from phnn.integrate import hooks
from phnn.laws.identity import UnknownContent, hash_of_own_laws
from phnn.laws.law import close_tables

# Sources of the compiled code. The torch modules beside them can be edited without recompiling.
_SOURCES = (
    "laws/*.py",
    "integrate/cache.py",
    "integrate/hooks.py",
    "integrate/compiled.py",
    "integrate/dispatch.py",
    "integrate/tables.py",
    "integrate/table_access.py",
    "integrate/constants.py",
    "integrate/roots.py",
    "integrate/terms.py",
    "integrate/step.py",
    "integrate/modulator_states.py",
    "integrate/stages.py",
    "integrate/elimination.py",
    "integrate/scalar.py",
    "integrate/solve.py",
    "integrate/junction.py",
    "integrate/quick.py",
    "integrate/perturbed.py",
    "integrate/prepared.py",
    "integrate/affine.py",
    "integrate/following.py",
    "integrate/drives.py",
    "integrate/linearise.py",
    "integrate/recursion.py",
    "integrate/general.py",
    "integrate/sweep.py",
    "modal/elements.py",
    "modal/step.py",
    "modal/march.py",
)
_OWN = 0o700
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def compiled(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a function that python calls, on first use, and keep its machine code if a safe folder exists."""
    folder = _folder()
    if folder is None:
        return numba.njit(**options)(function)
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder)
    try:
        dispatcher = numba.njit(cache=True, **options)(function)
        if hooks.check_content(dispatcher):
            return dispatcher
        warnings.warn(
            f"compiled code is not kept: numba {numba.__version__} has another cache; take < 0.70", stacklevel=3
        )
        return numba.njit(**options)(function)
    except (RuntimeError, OSError):
        # numba found no folder to which it can write.
        return numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = before


def has_kept(function: str) -> bool:
    """Whether machine code of a function, given as ``module.name``, is kept, or no code can be kept at all."""
    folder = _folder()
    # numba writes the index first, then the machine code.
    return folder is None or any(folder.glob(f"*/{function}-*.nbc"))


@cache
def fingerprint() -> str:
    """Hash of the sources of the kernels, of the laws that a user registered, and of the versions of libraries.

    numba's own cache does not notice an edited callee in another file.
    """
    root = Path(phnn.__file__).parent
    digest = hashlib.sha256(repr((numba.__version__, np.__version__, sys.version_info[:2])).encode())
    close_tables()
    digest.update(hash_of_own_laws())
    for pattern in _SOURCES:
        for path in sorted(root.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _folder() -> Path | None:
    """The folder with the machine code of this version; None if no safe folder can be written to."""
    try:
        home = os.environ.get("PHNN_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        own = Path(home).resolve() / "phnn"
        folder = own / fingerprint()
        for place in reversed((folder, *folder.parents)):
            if not place.exists():
                place.mkdir(mode=_OWN, exist_ok=True)
        if hasattr(os, "getuid") and own.stat().st_uid == os.getuid() and not own.stat().st_mode & stat.S_IWOTH:
            # The folder was made under a mask that lets a group write.
            own.chmod(_OWN)
        reason = _unsafe(own) or _unsafe(folder)
    except UnknownContent as error:
        warnings.warn(
            f"compiled code is not kept: {error}, whose changes cannot be recognised; let laws use numbers, tuples, "
            f"arrays and functions by their own names", stacklevel=4,
        )  # fmt: skip
        return None
    except (OSError, RuntimeError) as error:
        reason = f"it cannot be made ({error})"
        own = Path(os.environ.get("PHNN_CACHE_DIR", "~/.cache"))
    if reason:
        warnings.warn(
            f"compiled code is not kept in {own}: {reason}; set PHNN_CACHE_DIR to a folder of your own", stacklevel=4
        )
        return None
    return folder


def _unsafe(folder: Path) -> str:
    """The reason why others could plant code in a folder; empty if they cannot."""
    if not hasattr(os, "getuid"):
        # Windows itself keeps the profiles of users apart.
        return ""
    found, parent = folder.lstat(), folder.parent.stat()
    if stat.S_ISLNK(found.st_mode):
        return f"{folder.name} is a link"
    if found.st_uid != os.getuid():
        return "it belongs to another user"
    if found.st_mode & _OTHERS_WRITE:
        return "others may write to it"
    if parent.st_mode & stat.S_IWOTH and not parent.st_mode & stat.S_ISVTX:
        return f"others may replace it, for they may write to {folder.parent}"
    return ""
