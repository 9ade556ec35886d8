"""Where machine code is kept between runs: a folder of the user's own, files that are checked before they are used.

Loading kept machine code runs it. So the folder must belong to the user and nobody else may write to it, and every
file begins with the hash of its content: one that was damaged counts as absent, and the function is compiled again.
Where nothing can be kept (no home, no rights, a full disk) functions are compiled in memory.
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

import phnn
from phnn.integrate import hooks

# What compiled code is made from; torch modules beside them may be edited without compiling anew.
_SOURCES = (
    "laws/*.py",
    "integrate/cache.py",
    "integrate/hooks.py",
    "integrate/compiled.py",
    "integrate/dispatch.py",
    "integrate/tables.py",
    "integrate/lookups.py",
    "integrate/constants.py",
    "integrate/roots.py",
    "integrate/terms.py",
    "integrate/step.py",
    "integrate/memories.py",
    "integrate/stages.py",
    "integrate/elimination.py",
    "integrate/solve.py",
    "integrate/quick.py",
    "integrate/perturbed.py",
    "integrate/prepared.py",
    "integrate/pieces.py",
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
    """What python calls: a function compiled by numba on first use, its machine code kept where that is safe."""
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
        # numba found no way to write there.
        return numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = before


def has_kept(module: str) -> bool:
    """Whether machine code of a module's functions is kept, or can be kept nowhere."""
    folder = _folder()
    return folder is None or any(folder.glob(f"*/{module}.*.nbi"))


@cache
def fingerprint() -> str:
    """Hash of the sources a kernel is made from, and of what compiles them.

    numba's own cache does not see an edited callee in another file.
    """
    root = Path(phnn.__file__).parent
    digest = hashlib.sha256(repr((numba.__version__, sys.version_info[:2])).encode())
    for pattern in _SOURCES:
        for path in sorted(root.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _folder() -> Path | None:
    """The folder of this version's machine code; None where there is none that is safe and can be written to."""
    try:
        home = os.environ.get("PHNN_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        own = Path(home).resolve() / "phnn"
        folder = own / fingerprint()
        for place in reversed((folder, *folder.parents)):
            if not place.exists():
                place.mkdir(mode=_OWN, exist_ok=True)
        if hasattr(os, "getuid") and own.stat().st_uid == os.getuid() and not own.stat().st_mode & stat.S_IWOTH:
            # Made under a mask that lets a group write.
            own.chmod(_OWN)
        reason = _unsafe(own) or _unsafe(folder)
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
    """Why others could plant code in a folder; empty where they cannot."""
    if not hasattr(os, "getuid"):
        # Windows keeps profiles of users apart by itself.
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
