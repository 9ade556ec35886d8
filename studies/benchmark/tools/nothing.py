"""The base model as a tool: nothing is ever missing. Its scores are those of a tool that looks at nothing."""

from __future__ import annotations

from pathlib import Path

from studies.benchmark.answer import Answer
from studies.benchmark.tools.common import base_of, predictions


def answer(folder: Path, seed: int) -> Answer:
    """Nothing is missing, for certain."""
    return Answer({}, none=1.0, predictions=predictions(base_of(folder, seed).model, folder))
