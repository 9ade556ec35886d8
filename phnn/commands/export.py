"""``phnn export``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from phnn.exporting.write import program_of, write
from phnn.predictor import load

_SETTINGS = ("to", "dt", "substeps", "hold", "name", "ports", "sensor", "initial_input")


def export(model: Path, out: Path, options: Mapping[str, Any], outside: bool = False, overwrite: bool = False) -> None:
    """Write a stored model as files of a target, and print their names.

    Args:
        options: the settings of `phnn.exporting.write.program_of`.
    """
    program = program_of(load(model, outside), **{name: options[name] for name in _SETTINGS})
    for path in write(program, options["to"], out, [model], overwrite):
        print(path)
