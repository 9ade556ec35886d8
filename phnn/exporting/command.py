"""What the console command `export` does."""

from __future__ import annotations

from pathlib import Path

from phnn.exporting.write import Wanted, write


def export(model: Path, out: Path, wanted: Wanted, outside: bool = False, overwrite: bool = False) -> None:
    """Write a stored model as files of a target, and print their names."""
    for path in write(model, wanted, out, outside, overwrite):
        print(path)
