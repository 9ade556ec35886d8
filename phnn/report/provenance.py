"""The origin of a run: its command line, and hashes of what it read."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from phnn.recordings import Campaign
from phnn.recordings.recording import digest
from phnn.results import printable, sha256_of

_MANIFEST = "recordings.yaml"


@dataclass(frozen=True)
class Provenance:
    """What a reader needs to do a run again.

    Attributes:
        command: as it was typed, quoted for a shell; empty where the run was started from Python.
        folder: of the recordings.
        files: SHA-256 of the manifest and of the recordings, by name; files that are gone have none.
        understood: SHA-256 of all samples, uses and starts as they were understood; the same for the same result.
    """

    command: str
    folder: str
    files: Mapping[str, str]
    understood: str


def command_line(typed: Sequence[str]) -> str:
    """Return a command as one line for a shell; empty where nothing was typed."""
    return printable(shlex.join(["phnn", *typed])) if typed else ""


def provenance(campaign: Campaign, command: str = "", manifest: Path | None = None) -> Provenance:
    """Hash the files of a campaign; call it soon after they were read.

    Args:
        command: how the run was started, see `command_line`.
        manifest: where the manifest lies, if not in the folder.
    """
    folder = Path(campaign.folder)
    stated = _MANIFEST if manifest is None else printable(str(manifest))
    paths = {stated: folder / _MANIFEST if manifest is None else manifest}
    paths |= {name: folder / name for r in campaign.recordings for name in r.source.split(", ") if name}
    hashes = ((name, _hash(path)) for name, path in paths.items())
    return Provenance(command, campaign.folder, {n: h for n, h in hashes if h}, digest(campaign))


def _hash(path: Path) -> str:
    try:
        return sha256_of(path) if path.is_file() else ""
    except (OSError, ValueError):
        return ""
