"""From a folder to a first manifest that `phnn check` reads."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from phnn.errors import InputRefused, OutputRefused
from phnn.recordings import checks, read
from phnn.recordings.folder import READERS, Files
from phnn.recordings.manifest import DEFAULT_SETUP, Entry, Manifest
from phnn.results import printable, refusal
from phnn.template.roles import layout_of
from phnn.template.text import Found, manifest_text

MANIFEST = "recordings.yaml"


def template(folder: Path, outside: bool = False) -> str:
    """The text of a first manifest for a folder whose layout nobody has described.

    Files that phnn cannot read, or not with these guesses, are listed in comments with the reason. Without them the
    manifest is one that `phnn check` reads.

    Args:
        folder: is only read; a manifest in it is left alone.
        outside: files in it may lead out of it.

    Raises:
        InputRefused: there is no such folder, or no file in it that may be a recording.
    """
    checks.folder_exists(folder)
    files = Files(folder, Manifest(DEFAULT_SETUP, {}, "command", Entry(), None, None), outside)
    candidates, left = files.possible()
    checks.any_recordings(candidates, left, folder)
    found = _named_apart([_found(files, path.name) for path in candidates])
    actuator = all(f.layout.actuator for f in found if f.layout is not None)
    # Numbers that no piezo actuator gives show only when the recordings are read.
    tried = [_readable(found, folder, kind, outside) for kind in ([True, False] if actuator else [False])]
    best = max(range(len(tried)), key=lambda i: sum(not f.reason for f in tried[i]))
    return manifest_text(tried[best], left, str(folder), actuator and best == 0)


def write_template(folder: Path, out: Path, outside: bool = False) -> None:
    """Write that text into a new file, which may lie in the folder of the recordings.

    Raises:
        InputRefused: as `template`; or there is a file, folder or link of that name, or the new one cannot be written.
        OutputFailed: the disk is full.
    """
    content = template(folder, outside).encode()
    try:
        # Exclusive: nothing is replaced, and no link is followed.
        file = out.open("xb")
    except FileExistsError as error:
        raise OutputRefused(f"{out}: is there already and stays as it is: name a new file for --out") from error
    except (OSError, ValueError) as error:
        cause = getattr(error, "strerror", None) or str(error)
        raise OutputRefused(f"{out}: cannot be written ({cause}): name a file in a folder that exists") from error
    try:
        with file:
            file.write(content)
    except OSError as error:
        out.unlink(missing_ok=True)
        raise refusal(out, error) from error


def _found(files: Files, name: str) -> Found:
    """One file as it stands."""
    try:
        source = files.source(name)
        table = READERS[source.suffix](source)
    except InputRefused as error:
        return Found(name, reason=str(error))
    layout = layout_of(table)
    if layout is None:
        return Found(name, table, reason="fewer than two columns of numbers that change: no input and output in it")
    return Found(name, table, layout)


def _named_apart(found: Sequence[Found]) -> list[Found]:
    """Files that share a name up to their endings get their whole names as those of their recordings."""
    shared = Counter(printable(Path(f.file).stem) for f in found if not f.reason)
    return [replace(f, name=f.file) if shared[printable(Path(f.file).stem)] > 1 else f for f in found]


def _readable(found: Sequence[Found], folder: Path, actuator: bool, outside: bool) -> list[Found]:
    """The files, those with a reason that the reader refuses with the guessed manifest."""
    usable = [f for f in found if not f.reason]
    if usable and not _refusal(usable, folder, actuator, outside):
        return list(found)
    return [f if f.reason else replace(f, reason=_refusal([f], folder, actuator, outside)) for f in found]


def _refusal(found: Sequence[Found], folder: Path, actuator: bool, outside: bool) -> str:
    """Why these files cannot be read with the guessed manifest; empty where they can."""
    text = manifest_text(found, (), str(folder), actuator, with_uses=len(found) > 1)
    with tempfile.TemporaryDirectory() as home:
        path = Path(home) / MANIFEST
        try:
            path.write_text(text, encoding="utf-8")
            read(folder, path, allow_outside=outside)
        except InputRefused as error:
            return str(error)
        except UnicodeEncodeError:
            return "its name is no text: rename it"
    return ""
