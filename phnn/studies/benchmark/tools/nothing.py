"""The base model as a tool: nothing is ever missing. What it scores is what the cases give away for nothing."""

from __future__ import annotations

from pathlib import Path

from phnn.studies.benchmark.answer import Answer
from phnn.studies.benchmark.tools.common import base_of, predictions


def answer(folder: Path, seed: int) -> Answer:
    """Nothing is missing, with the share of cases of a default benchmark in which that is so."""
    return Answer({}, none=0.125, predictions=predictions(base_of(folder, seed).model, folder))
