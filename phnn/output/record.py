"""A record of the files that phnn wrote into a folder and of their content, so that it replaces no other file."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from phnn.errors import OutputRefused
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


class Line(NamedTuple):
    """A file that was written: its name below the folder, the hash of its content, and the command."""

    name: str
    digest: str
    by: str

    def text(self) -> str:
        """As it stands in the record."""
        return json.dumps({"file": self.name, "sha256": self.digest, "by": self.by}, ensure_ascii=False) + "\n"


class Record:
    """Names and hashes of the files that phnn wrote below a folder.

    A line is added before each file is renamed into its place, so that after a kill every file of phnn's has a line.
    A folder whose content others write, such as a logger's, is recorded as a whole.

    A record remembers what it has read and reads on from there, for other processes add lines, too.

    Args:
        root: the folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.path = root / FOLDER / _FILE
        # Which file was read, how many of its bytes, and what stood in them.
        self._number, self._end = 0, 0
        self._known: dict[str, set[str]] = {}

    def __reduce__(self) -> tuple[type[Record], tuple[Path]]:
        return Record, (self.root,)

    def add(self, name: PurePosixPath, digest: str, by: str = "") -> None:
        """Note a file that is about to be written; an empty digest notes a folder with all that is in it.

        Raises:
            OutputRefused: the record cannot be written.
            OutputFailed: the disk is full.
        """
        # A line that a full disk has cut off ends here.
        content = ("\n" + Line(str(name), digest, by).text()).encode()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # One write at the end of the file: lines of several processes do not mix.
            handle = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            try:
                if os.write(handle, content) < len(content):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            finally:
                os.close(handle)
        except OSError as error:
            raise refusal(self.path, error) from error

    def lines(self) -> Iterator[Line]:
        """Every file that was noted, in order, as often as it was written; names that lead elsewhere are left out.

        Raises:
            OutputRefused: the record is no file, or cannot be read.
        """
        yield from _parsed(self._read(0))

    def _read(self, begin: int) -> bytes:
        """Content from a byte on; nothing where there is no record."""
        if not self.path.exists():
            return b""
        if not self.path.is_file() or self.path.is_symlink():
            raise OutputRefused(f"{self.path}: is no file: remove it, or choose another folder for --out")
        try:
            with self.path.open("rb") as file:
                file.seek(begin)
                return file.read()
        except OSError as error:
            raise refusal(self.path, error) from error

    def digests(self) -> dict[str, set[str]]:
        """All hashes that were noted, by file; a folder has the empty one."""
        try:
            state = self.path.stat()
            number, size = state.st_ino, state.st_size
        except OSError:
            number, size = 0, 0
        if number != self._number or size < self._end:
            self._number, self._end, self._known = number, 0, {}
        if size > self._end or not self.path.is_file():
            content = self._read(self._end)
            # Of a line that is being written the rest comes later.
            whole = content[: content.rfind(b"\n") + 1]
            for line in _parsed(whole):
                self._known.setdefault(line.name, set()).add(line.digest)
            self._end += len(whole)
        return self._known

    def owns(self, name: PurePosixPath, known: dict[str, set[str]] | None = None) -> bool:
        """Whether the file of that name is as phnn wrote it, or lies in a folder that is phnn's as a whole."""
        known = self.digests() if known is None else known
        if any("" in known.get(str(parent), ()) for parent in (name, *name.parents)):
            return True
        path = self.root / name
        return path.is_file() and not path.is_symlink() and sha256_of(path) in known.get(str(name), ())

    def check(self, name: PurePosixPath, overwrite: bool | None, known: dict[str, set[str]] | None = None) -> None:
        """Refuse to write where a file stands that is not phnn's, or that was changed since.

        Args:
            overwrite: whether phnn's own may be replaced although it was changed; None where there is no such choice.
            known: the digests, where the caller has them.

        Raises:
            OutputRefused: names the file and the remedy.
        """
        path = self.root / name
        if not path.exists():
            return
        known = self.digests() if known is None else known
        if self.owns(name, known):
            return
        if str(name) not in known:
            raise foreign(path)
        if not overwrite:
            choice = ", choose another folder for --out" + (", or give --overwrite" if overwrite is False else "")
            raise OutputRefused(f"{path}: was changed after phnn wrote it: move it away{choice}")

    def adopt(self) -> None:
        """Note what lies here as a run in a folder above has written it: its record knows it by a longer name."""
        known = self.digests()
        for above in self.root.parents:
            if not (above / FOLDER / _FILE).is_file():
                continue
            for line in list(Record(above).lines()):
                path = above / line.name
                if self.root not in path.parents or not path.is_file() or path.is_symlink():
                    continue
                name = path.relative_to(self.root)
                if str(name) not in known and line.digest == sha256_of(path):
                    self.add(PurePosixPath(name), line.digest, line.by)

    def compact(self) -> None:
        """Forget files that are gone and contents that were replaced; called where no other process writes."""
        known = self.digests()
        kept = []
        for line in dict.fromkeys(self.lines()):
            path = self.root / line.name
            now = sha256_of(path) if path.is_file() else ""
            if path.exists() and (line.digest in ("", now) or now not in known[line.name]):
                kept.append(line)
        write_atomic(self.path, "".join(line.text() for line in kept).encode())


def foreign(path: Path) -> OutputRefused:
    """What is said where somebody else's file or folder has the name of a result."""
    return OutputRefused(f"{path}: was not written by phnn: move it away, or choose another folder for --out")


def is_empty(path: Path) -> bool:
    """Whether a folder holds nothing, so that it is nobody's."""
    return path.is_dir() and not path.is_symlink() and next(path.iterdir(), None) is None


def _parsed(content: bytes) -> Iterator[Line]:
    """The lines of a record that are whole and name something below its folder."""
    for line in filter(None, content.decode("utf-8", "replace").split("\n")):
        try:
            entry = json.loads(line)
            found = Line(str(entry["file"]), str(entry["sha256"]), str(entry.get("by", "")))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            # A line that the disk or a kill cut off: its file was never renamed.
            continue
        if _inside(found.name):
            yield found


def _inside(name: str) -> bool:
    """Whether a name is one below the folder."""
    path = PurePosixPath(name)
    return bool(path.parts) and not path.is_absolute() and ".." not in path.parts and path.parts[0] != FOLDER
