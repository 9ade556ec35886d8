"""The one way in which a file that a user names is opened: a regular file, inside its folder, within the limits."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from phnn.errors import InputRefused
from phnn.intake.limits import LIMITS
from phnn.results import printable

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe (FIFO)"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
OUTSIDE = "--allow-outside"


@dataclass(frozen=True)
class Source:
    """A file that may be read: `named_file` has looked at it.

    Attributes:
        path: of the file, links resolved.
        name: as the user calls it, printable, for messages.
        suffix: of the name that the user gave, in small letters.
        size: bytes.
        outside: whether parts of its content may lie in other files (links of HDF5).
    """

    path: Path
    name: str
    suffix: str
    size: int
    outside: bool = False

    def open(self) -> BinaryIO:
        """The file, open for reading.

        Raises:
            InputRefused: it cannot be opened, or is no regular file any more.
        """
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
        try:
            file = os.fdopen(os.open(self.path, flags), "rb")
        except OSError as error:
            raise InputRefused(f"{self.name}: cannot be opened ({error.strerror}): make it readable") from error
        # Between looking and opening another file may have taken its place.
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            file.close()
            raise InputRefused(f"{self.name}: is no file any more: leave the folder alone while it is read")
        return file

    def read(self, most: int, what: str = "a file") -> bytes:
        """The whole content.

        Args:
            most: bytes; what: of a kind of file, for the message.

        Raises:
            InputRefused: it is larger, or cannot be read.
        """
        self.check_size(most, what)
        with self.open() as file:
            try:
                # What is asked for is set aside at once, so not more than there is; a file may have grown since.
                content = file.read(min(self.size, most) + 1)
                if len(content) > self.size:
                    content += file.read(most + 1 - len(content))
            except OSError as error:
                raise InputRefused(f"{self.name}: cannot be read ({error.strerror}): copy it again") from error
        if len(content) > most:
            raise _too_large(self.name, len(content), most, what)
        return content

    def check_size(self, most: int, what: str = "a file") -> None:
        """Refuse a file of more than ``most`` bytes. Raises InputRefused."""
        if self.size > most:
            raise _too_large(self.name, self.size, most, what)

    def check_memory(self, size: int, unpacked: bool = False) -> None:
        """Refuse numbers that would take more memory than there is for one file.

        Args:
            size: bytes of the numbers once they are read.
            unpacked: the file holds them packed, and may claim any number of them.

        Raises:
            InputRefused: they take more.
        """
        most = LIMITS.memory_for_a_file()
        if unpacked:
            most = min(most, LIMITS.unpacked_bytes + self.size)
        if size > most:
            raise InputRefused(
                f"{self.name}: its numbers take {shown_bytes(size)}, at most {shown_bytes(most)} are accepted"
                f"{' of a packed file of this size' if unpacked else ' with the memory that is available'}: split it, "
                f"or export fewer samples"
            )


def named_file(
    path: Path, within: Sequence[Path] = (), where: str = "", absent: str = "check its path", outside: bool = False
) -> Source:
    """Look at a file that a user names, without opening it.

    Args:
        path: of the file.
        within: folders of which one must hold it, links resolved; none where it may lie anywhere.
        where: what names it, for the message.
        absent: the remedy where there is none.
        outside: it may lie, or lead, outside ``within``.

    Raises:
        InputRefused: it is absent, cannot be reached, is no regular file, lies outside, or is larger than any.
    """
    name = printable(path.name)
    said = f"{where}: " if where else ""
    try:
        real = path.resolve(strict=True)
        found = real.stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputRefused(f"{said}{printable(str(path))}: there is no such file: {absent}") from error
    except (OSError, ValueError, RuntimeError) as error:
        cause = getattr(error, "strerror", None) or printable(str(error))
        shown = printable(str(path))[: LIMITS.name_characters]
        raise InputRefused(f"{said}{shown}: cannot be reached ({cause}): {absent}") from error
    for test, kind in _KINDS:
        if test(found.st_mode):
            raise InputRefused(f"{said}{name}: is {kind}, not a file: copy what is to be read into a file")
    if within and not outside and not any(_holds(folder, real) for folder in within):
        raise InputRefused(
            f"{said}{printable(str(path))}: leads out of the folder {printable(str(within[0]))}: copy the file into "
            f"the folder, or give the option {OUTSIDE} if you trust who made the folder"
        )
    source = Source(real, name, path.suffix.lower(), found.st_size, outside or not within)
    source.check_size(LIMITS.file_bytes)
    return source


def list_folder(folder: Path) -> list[Path]:
    """What lies in a folder, sorted by name.

    Raises:
        InputRefused: the folder cannot be read.
    """
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise InputRefused(
            f"folder {printable(str(folder))}: cannot be read ({error.strerror}): make it readable"
        ) from error


def shown_bytes(size: float) -> str:
    """A number of bytes with three digits."""
    for unit in ("bytes", "kB", "MB"):
        if size < 1000.0:
            return f"{size:.3g} {unit}"
        size /= 1000.0
    return f"{size:.3g} GB"


def _holds(folder: Path, real: Path) -> bool:
    try:
        return real.is_relative_to(folder.resolve())
    except (OSError, RuntimeError):
        return False


def _too_large(name: str, size: int, most: int, what: str) -> InputRefused:
    return InputRefused(
        f"{name}: {shown_bytes(size)}, {what} may have at most {shown_bytes(most)}: split it, or export less"
    )
