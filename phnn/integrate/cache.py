"""Where machine code is kept between runs: a folder of the user's own, files that are checked before they are used.

Loading kept machine code runs it. So the folder must belong to the user and nobody else may write to it, and every
file begins with the hash of its content: one that was damaged counts as absent, and the function is compiled again.
Where nothing can be kept (no home, no rights, a full disk) functions are compiled in memory.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import stat
import sys
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import IndexDataCacheFile

import phnn

# What compiled code is made from; torch modules beside them may be edited without compiling anew.
_SOURCES = (
    "laws/*.py",
    "integrate/cache.py",
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
    "integrate/kernel.py",
    "integrate/sweep.py",
    "modal/elements.py",
    "modal/march.py",
)
_HASH = hashlib.sha256().digest_size
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
        _check_content(dispatcher)
        return dispatcher
    except (RuntimeError, OSError):
        # numba found no way to write there.
        return numba.njit(**options)(function)
    finally:
        numba.config.CACHE_DIR = before


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


def _check_content(dispatcher: Any) -> None:
    """Make numba's cache of a function read and write files that begin with the hash of their content."""
    kept = dispatcher._cache
    given = kept._cache_file
    kept._cache_file = _Checked(
        given._cache_path, given._index_name.removesuffix(".nbi"), source_stamp=given._source_stamp
    )


class _Checked(IndexDataCacheFile):
    """numba's files of a function: an index of signatures, and machine code for each."""

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
            # The caller takes it for a file that was removed.
            raise FileNotFoundError(name)
        return pickle.loads(content)

    def _save_data(self, name: str, data: Any) -> None:
        self._write(self._data_path(name), self._dump(data))

    def _read(self, path: str) -> bytes | None:
        """The content of a file whose hash is right."""
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
