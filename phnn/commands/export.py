"""``phnn export``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from phnn.exporting.write import Wanted, write


def export(model: Path, out: Path, options: Mapping[str, Any], outside: bool = False, overwrite: bool = False) -> None:
    """Write a stored model as files of a target, and print their names.

    Args:
        options: the fields of `phnn.exporting.Wanted`.
    """
    chosen = {f.name: options[f.name] for f in fields(Wanted)}
    wanted = Wanted(**chosen | {"ports": tuple(chosen["ports"])})
    for path in write(model, wanted, out, outside, overwrite):
        print(path)
