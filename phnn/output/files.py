"""Whole files or none: written beside their place, made durable, then renamed into it."""

from __future__ import annotations

import errno
import math
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phnn.errors import OutputFailed, OutputRefused

_FULL = (errno.ENOSPC, errno.EDQUOT)
PART = ".part"


def write_atomic(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` so that a reader, or a run that is interrupted, never meets half a file.

    The folder must exist. The temporary name is unique, so that two processes cannot mix their parts.

    Raises:
        OutputRefused: the folder cannot be written to.
        OutputFailed: the disk is full.
    """
    temporary = path.with_name(f".{secrets.token_hex(8)}{PART}")
    try:
        try:
            # Exclusive: what another process, or a stranger's link, has put there is never written through.
            handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                # A rename may reach the disk before what it renames.
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise refusal(path, error) from error


def refusal(path: Path, error: OSError) -> OutputRefused | OutputFailed:
    """What is said where a file or folder cannot be written."""
    if error.errno in _FULL:
        return OutputFailed(f"{path}: the disk is full ({error.strerror}): make room and run the same command again")
    return OutputRefused(f"{path}: cannot be written ({error.strerror}): choose another folder for --out")


def finite(value: Any) -> Any:
    """Numbers that are not finite become null, as json demands."""
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
