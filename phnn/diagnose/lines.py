"""The score of lines whose phase is each recording's own: a subspace instead of a direction.

With an orthonormal basis ``Q`` of the lines of all recordings, base and nuisances projected out, ``‖Qᵀr‖²`` over the
mean noise power along ``Q`` is χ² with as many degrees of freedom as columns, where nothing is missing. The standard
normal deviate of the same tail probability makes it comparable to the score of a direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri_exp
from scipy.stats import chi2

from phnn.diagnose.ground import Ground
from phnn.identify.nuisances import line_columns

Array = NDArray[np.float64]

_RANK = 1e-9


def line_score(ground: Ground, frequencies: Sequence[float], colour: Callable[[Array], Array]) -> float:
    """Normal deviate of the residual's power at some lines; zero where no recording can show them.

    Args:
        frequencies: of the lines [Hz].
        colour: multiplication by the correlation matrix of the noise.
    """
    blocks = [line_columns(r, frequencies) for r in ground.plan.recordings]
    width = sum(b.shape[1] for b in blocks)
    outputs, first = [], 0
    for block in blocks:
        wide = np.zeros((block.shape[0], width))
        wide[:, first : first + block.shape[1]] = block
        outputs.append(wide)
        first += block.shape[1]
    columns = ground.project(ground.stack(outputs))
    if not columns.size:
        return 0.0
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    q = left[:, size > _RANK * size[0]]
    power = float(np.einsum("ij,ij->", q, colour(q))) / q.shape[1]
    saved = float(np.sum((q.T @ ground.residual) ** 2)) / power
    # Far out the tail underflows; what a score means, a sum of squares saved, bounds the deviate in any case.
    return float(min(-ndtri_exp(chi2.logsf(saved, q.shape[1])), np.sqrt(saved)))
