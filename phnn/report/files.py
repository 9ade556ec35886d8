"""Whole files or none: written beside their place, then renamed into it."""

from __future__ import annotations

import os
from pathlib import Path

from phnn.errors import InputRefused


def write_atomic(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` so that a reader, or a run that is interrupted, never meets half a file.

    Raises:
        InputRefused: the folder cannot be made or written to.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.write_bytes(content)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputRefused(f"{path}: cannot be written ({error.strerror}): choose another folder for --out") from error
