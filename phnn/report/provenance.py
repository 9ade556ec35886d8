"""Provenance of a run: command line, versions, seed, and hashes of the files that were read."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Sequence
from pathlib import Path

from phnn.recordings import Campaign
from phnn.recordings.stored import digest
from phnn.report.evidence import FileHash, Provenance
from phnn.results import printable, sha256_of

_MANIFEST = "recordings.yaml"


def command_line(typed: Sequence[str]) -> str:
    """The command as one line for a shell; empty where nothing was typed."""
    return printable(shlex.join(["phnn", *typed])) if typed else ""


def provenance(campaign: Campaign, command: str = "", manifest: Path | None = None) -> Provenance:
    """Hash the files of a campaign; call it soon after they were read. Files that are gone have no hash.

    Args:
        command: how the run was started, see `command_line`.
        manifest: where the manifest lies, if not in the folder.
    """
    folder = Path(campaign.folder)
    names = dict.fromkeys(name for r in campaign.recordings for name in r.source.split(", ") if name)
    found = (_hashed(folder / name, name) for name in names)
    said = manifest if manifest is not None else folder / _MANIFEST
    return Provenance(
        command,
        campaign.folder,
        tuple(f for f in found if f is not None),
        _hashed(said, printable(str(manifest) if manifest is not None else _MANIFEST)),
        digest(campaign),
    )


def _hashed(path: Path, name: str) -> FileHash | None:
    try:
        return FileHash(name, sha256_of(path)) if path.is_file() else None
    except (OSError, ValueError):
        return None


def python_version() -> str:
    """Version of the interpreter."""
    return platform.python_version()
