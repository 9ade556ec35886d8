"""From an address to a file below the folder that is served, and to no other."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from phnn.errors import InputRefused
from phnn.intake.files import Source, named_file

# What is served, and as what: results of phnn. Everything else is not there.
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".csv": "text/csv; charset=utf-8",
    ".md": "text/plain; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
}
_LONGEST = 4096


def relative(address: str) -> PurePosixPath:
    """The path that an address spells, below the folder; where it leads is not known before links are resolved.

    Raises:
        InputRefused: a part of it leads upwards or is hidden, or it is too long.
    """
    text = unquote(address, errors="surrogateescape")
    parts = [part for part in text.split("/") if part]
    if any(p.startswith(".") or "\0" in p for p in parts) or len(text) > _LONGEST:
        raise InputRefused("the address names nothing that is served here")
    return PurePosixPath(*parts)


def served_file(root: Path, address: str) -> Source:
    """A file of results below ``root``, links resolved.

    Raises:
        InputRefused: there is none, it leads out of the folder, or it is of a kind that is not served.
    """
    source = named_file(root / relative(address), (root,))
    if source.suffix not in KINDS or source.path.suffix.lower() not in KINDS or _hidden(source.path, root):
        raise InputRefused(f"{source.name}: is no kind of file that is served")
    return source


def served_folder(root: Path, address: str) -> Path:
    """A folder below ``root``, links resolved; ``root`` itself where the address is empty.

    Raises:
        InputRefused: there is none, or it leads out of the folder.
    """
    path = root / relative(address)
    try:
        found = path.resolve(strict=True)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputRefused("there is no such folder") from error
    if not found.is_dir() or not found.is_relative_to(root) or _hidden(found, root):
        raise InputRefused("there is no such folder")
    return found


def _hidden(path: Path, root: Path) -> bool:
    """Whether a link leads to a file or folder that is hidden."""
    return any(part.startswith(".") for part in path.relative_to(root).parts)
