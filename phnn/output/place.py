"""A file or folder below a claimed folder: the only way by which results are written."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from phnn.errors import OutputRefused
from phnn.output.files import finite, refusal, write_atomic
from phnn.output.names import file_name
from phnn.output.record import Record, is_empty, sha256

_HERE = PurePosixPath()


@dataclass(frozen=True)
class Place:
    """A name below a folder that was claimed; it crosses processes.

    Attributes:
        root: the claimed folder, without links.
        name: below it, empty for the folder itself.
        overwrite: whether results of phnn that were changed since may be replaced; None where the user cannot say so.
        by: the command that writes.
        record: of the claimed folder; read anew where it is left out.
    """

    root: Path
    name: PurePosixPath = _HERE
    overwrite: bool | None = None
    by: str = ""
    record: Record | None = field(default=None, compare=False, repr=False)

    def __truediv__(self, part: str) -> Place:
        """A file or folder in this one. The part is a name, never a path; labels of people are made names of files."""
        return replace(self, name=self.name / file_name(part))

    @property
    def path(self) -> Path:
        """Path of the folder."""
        return self.root / self.name

    @property
    def _record(self) -> Record:
        return self.record or Record(self.root)

    def __str__(self) -> str:
        return str(self.path)

    def write(self, content: bytes) -> None:
        """Write a file, whole or not at all, and note that it is phnn's.

        Raises:
            OutputRefused: a file that phnn did not write, or one that was changed since, has that name; or the folder
                cannot be written to, or leads elsewhere.
            OutputFailed: the disk is full.
        """
        self._check()
        self._make(self.path.parent)
        self._record.add(self.name, sha256(content), self.by)
        write_atomic(self.path, content)

    def write_json(self, content: Mapping[str, Any]) -> None:
        """The same of a mapping as json; numbers that are not finite become null."""
        self.write((json.dumps(finite(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode())

    def own_folder(self) -> Path:
        """Make a folder whose whole content counts as phnn's, for writers that know no claims; returns its path.

        Raises:
            OutputRefused: a folder or file that phnn did not make has that name.
        """
        record = self._record
        if self.path.exists() and not record.owns(self.name) and not is_empty(self.path):
            raise OutputRefused(f"{self}: is not of phnn's making: move it away, or choose another folder for --out")
        self._make(self.path.parent)
        record.add(self.name, "", self.by)
        self._make(self.path)
        return self.path

    def remove(self) -> None:
        """Remove a file or folder if it is phnn's; what is not, or lies behind a link, stays."""
        path = self.path
        if not path.exists() or path.is_symlink() or path.parent.resolve() != path.parent:
            return
        if not self._record.owns(self.name):
            return
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)

    def _make(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            resolved = folder.resolve()
        except OSError as error:
            raise refusal(folder, error) from error
        if resolved != folder:
            raise OutputRefused(f"{folder}: is a link that leads to {resolved}: remove it, results stay inside --out")

    def _check(self) -> None:
        path = self.path
        if path.is_symlink() or path.is_dir():
            kind = "a link" if path.is_symlink() else "a folder"
            raise OutputRefused(f"{path}: is {kind}, where a result must be written: move it away")
        self._record.check(self.name, self.overwrite)
