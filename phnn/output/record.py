"""Which files of a folder phnn wrote, and what they contained: kept beside them, so that no other file is replaced."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from phnn.output.files import refusal, write_atomic

FOLDER = ".phnn"
_FILE = "written.jsonl"
_BLOCK = 1 << 20


def sha256(content: bytes) -> str:
    """Hash of a file's content."""
    return hashlib.sha256(content).hexdigest()


def sha256_of(path: Path) -> str:
    """The same of a file on disk, block by block."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()


class Record:
    """Names and hashes of the files that phnn wrote below a folder.

    A line is added before each file is renamed into its place, so that after a kill every file of phnn's has a line.
    A folder whose content others write, such as a logger's, is recorded as a whole.

    Args:
        root: the folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.path = root / FOLDER / _FILE

    def add(self, name: PurePosixPath, digest: str) -> None:
        """Note a file that is about to be written; an empty digest notes a folder with all that is in it.

        Raises:
            InputRefused: the record cannot be written.
            OutputFailed: the disk is full.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        line = json.dumps({"file": str(name), "sha256": digest}, ensure_ascii=False) + "\n"
        try:
            # One write at the end of the file: lines of several processes do not mix.
            handle = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            try:
                os.write(handle, line.encode())
            finally:
                os.close(handle)
        except OSError as error:
            raise refusal(self.path, error) from error

    def _lines(self) -> Iterator[tuple[str, str]]:
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines()
        except FileNotFoundError:
            return
        for line in lines:
            try:
                entry = json.loads(line)
                yield str(entry["file"]), str(entry["sha256"])
            except (ValueError, KeyError, TypeError):
                # The last line of a run that the disk or a kill cut off: its file was never renamed.
                continue

    def names(self) -> list[str]:
        """Every file that was noted, in order, as often as it was written."""
        return [name for name, _ in self._lines()]

    def digests(self) -> dict[str, set[str]]:
        """All hashes that were noted, by file; a folder has the empty one."""
        found: dict[str, set[str]] = {}
        for name, digest in self._lines():
            found.setdefault(name, set()).add(digest)
        return found

    def owns(self, name: PurePosixPath, known: dict[str, set[str]] | None = None) -> bool:
        """Whether the file of that name is as phnn wrote it, or lies in a folder that is phnn's as a whole."""
        known = self.digests() if known is None else known
        if any("" in known.get(str(parent), ()) for parent in (name, *name.parents)):
            return True
        path = self.root / name
        return path.is_file() and not path.is_symlink() and sha256_of(path) in known.get(str(name), ())

    def wrote(self, name: PurePosixPath) -> bool:
        """Whether phnn wrote a file of that name, whatever it contains by now."""
        known = self.digests()
        return any(str(parent) in known for parent in (name, *name.parents))

    def compact(self) -> None:
        """Forget files that are gone and contents that were replaced; called where no other process writes."""
        known = self.digests()
        kept = {n: d for n, d in known.items() if (self.root / n).exists()}
        lines = []
        for name, digests in kept.items():
            path = self.root / name
            if "" in digests:
                lines.append((name, ""))
                continue
            now = sha256_of(path) if path.is_file() else ""
            lines += [(name, d) for d in sorted(digests) if d == now or now not in digests]
        text = "".join(json.dumps({"file": n, "sha256": d}, ensure_ascii=False) + "\n" for n, d in lines)
        write_atomic(self.path, text.encode())
