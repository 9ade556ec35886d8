"""A smooth stretch of a sampled signal: a spline that can be continued by a sample interval at either end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.interpolate import make_interp_spline

Array = NDArray[np.float64]

_DENSE = 8
_ORDER = {"linear": 1, "cubic": 3, "quintic": 5}


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples ``first, first + 1, …`` of a signal that is smooth there.

    Attributes:
        first: index of the first sample.
        u: (M,) samples.
        method: ``linear``, ``cubic``, ``quintic`` or ``band_limited``.
    """

    first: int
    u: Array
    method: str
    _spline: object = field(init=False, repr=False)

    def __post_init__(self) -> None:
        order = min(_ORDER.get(self.method, 3), self.u.size - 1)
        spline = None
        if self.method == "band_limited" and self.u.size > 32:
            spline = _band_limited(self.u)
        elif order >= 1:
            spline = make_interp_spline(np.arange(self.u.size), self.u, k=order if order % 2 else order - 1)
        object.__setattr__(self, "_spline", spline)

    def __call__(self, positions: Array) -> Array:
        """Values at positions counted in samples of the whole signal, shape as ``positions``."""
        if self._spline is None:
            return np.full(positions.shape, self.u[0])
        return np.asarray(self._spline(positions - self.first))  # type: ignore[operator]


def _band_limited(u: Array) -> object:
    """The spline through a signal resampled eight times as densely."""
    # A straight line is taken out, because the filter assumes zero outside the record.
    line = np.linspace(u[0], u[-1], u.size)
    dense = np.asarray(signal.resample_poly(u - line, _DENSE, 1, window=("kaiser", 14.0)))
    dense = dense[: (u.size - 1) * _DENSE + 1]
    at = np.arange(dense.size) / _DENSE
    return make_interp_spline(at, dense + np.interp(at, np.arange(u.size), line), k=3)
