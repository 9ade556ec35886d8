"""Error indices of a simulated output, with the names and definitions of the package nonlinear_benchmarks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_UNDEFINED = float("nan")


class ErrorIndices(NamedTuple):
    """With y the recorded and ŷ the simulated output of N samples, and s the standard deviation of y over these:

        RMSE = ‖y − ŷ‖ / √N,    NRMSE = RMSE / s,    R² = 1 − NRMSE²,    MAE = Σ |y − ŷ| / N,    fit = 100 (1 − NRMSE)

    RMSE and MAE have the unit of y; the fit index is the fit % of MATLAB. Without samples all are NaN; where y is
    constant, so are those that divide by s.
    """

    rmse: float
    nrmse: float
    r_squared: float
    mae: float
    fit_index: float


def error_indices(recorded: Array, simulated: Array, skipped: int = 0) -> ErrorIndices:
    """The indices of one output.

    Args:
        recorded, simulated: (N,) samples of one unit.
        skipped: samples at the head that are left out, which a benchmark grants to find the initial state.
    """
    y, model = np.asarray(recorded, dtype=float)[skipped:], np.asarray(simulated, dtype=float)[skipped:]
    if not y.size:
        return ErrorIndices(*[_UNDEFINED] * len(ErrorIndices._fields))
    error = y - model
    rmse, spread = float(np.sqrt(np.mean(error**2))), float(np.std(y)) if np.ptp(y) > 0.0 else 0.0
    nrmse = rmse / spread if spread > 0.0 else _UNDEFINED
    return ErrorIndices(rmse, nrmse, 1.0 - nrmse**2, float(np.mean(np.abs(error))), 100.0 * (1.0 - nrmse))
