"""The nearest fingerprints as a tool: the features of `studies.benchmark.tools.fingerprints`, no forest."""

from __future__ import annotations

from pathlib import Path

from studies.benchmark.answer import Answer
from studies.benchmark.tools import fingerprints


def answer(folder: Path, seed: int, training: Path) -> Answer:
    """State what the most similar cases of the training conceal."""
    return fingerprints.answer(folder, seed, training, "nearest")
