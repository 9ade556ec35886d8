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


def write_new(path: Path, content: bytes) -> None:
    """Write ``content`` to a path at which there is nothing yet, whole or not at all; nothing is ever replaced.

    Raises:
        OutputRefused: there is a file, folder or link of that name, or the folder is absent or cannot be written to.
        OutputFailed: the disk is full.
    """
    taken = OutputRefused(f"{path}: is there already and stays as it is: name a new file for --out")
    if os.path.lexists(path):
        raise taken
    try:
        # Exclusive: a file that appears meanwhile is not replaced, a link not followed.
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError as error:
        raise taken from error
    except (OSError, ValueError) as error:
        cause = getattr(error, "strerror", None) or str(error)
        raise OutputRefused(f"{path}: cannot be written ({cause}): name a file in a folder that exists") from error
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except BaseException as error:
        path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise refusal(path, error) from error
        raise


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
