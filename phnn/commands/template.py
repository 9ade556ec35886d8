"""``phnn template``."""

from __future__ import annotations

from pathlib import Path

from phnn.commands.terminal import status
from phnn.template import template as first_manifest
from phnn.template import write_template


def template(folder: Path, out: Path | None, outside: bool = False) -> None:
    """Print a first manifest for a folder of unknown layout, or write it into a new file."""
    with status():
        if out is None:
            text = first_manifest(folder, outside)
        else:
            write_template(folder, out, outside)
    print(text.rstrip() if out is None else f"written: {out}; correct what is marked as guessed")
