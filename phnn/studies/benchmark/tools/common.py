"""Common parts of the tools that start from the base model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.identification.identified import Identified, identify
from phnn.identification.options import Options
from phnn.model import Model
from phnn.predictor import of_network
from phnn.recordings import read

Array = NDArray[np.float64]

# Starting points of the base model's fit.
_STARTS = 4


def base_of(folder: Path, seed: int) -> Identified:
    """The base model of a case, identified from all its recordings."""
    return identify(None, read(folder), Options(seed=seed, starts=_STARTS, workers=1))


def predictions(model: Model, folder: Path) -> Mapping[str, Array]:
    """(N,) outputs [m] of a model in the examination of a case, by recording."""
    exam = read(folder / "exam", need_output=False)
    return {p.recording.name: p.y for p in of_network(model.setup, model.substeps, exam)}
