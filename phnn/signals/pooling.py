"""What recordings by one sensor say together of its noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phnn.signals.first_order import correlation_of
from phnn.signals.noise import WHITE, NoiseFloor

# Fewest recordings whose spectra are pooled; how far their coefficients may lie from the median.
_FEWEST, _AGREES = 3, 0.12


def pooled(floors: Sequence[NoiseFloor]) -> list[NoiseFloor]:
    """The floors of recordings by one sensor, those seen in a part of the spectrum only brought to a common word.

    One spectrum hardly tells coloured noise from what the signal leaves there; several that agree do. Where at least
    half of them show first-order noise of about the same coefficient, all get their median; where few do, those get
    the median of the white ones.
    """
    partial = [f for f in floors if f.coefficient is not None]
    coloured = [f for f in partial if f.coefficient]
    if len(partial) < _FEWEST:
        return list(floors)
    if 2 * len(coloured) >= len(partial):
        middle = float(np.median([f.coefficient or 0.0 for f in coloured]))
        agreeing = [f for f in coloured if abs((f.coefficient or 0.0) - middle) <= _AGREES]
        if 2 * len(agreeing) < len(partial):
            return list(floors)
        note, correlation = f"first-order noise of coefficient {middle:.2g}", correlation_of(middle)
    else:
        agreeing = [f for f in partial if not f.coefficient]
        note, correlation = "white noise", WHITE
    value = float(np.median([f.value for f in agreeing]))
    source = f"the spectra of {len(agreeing)} recordings that agree on {note}"
    alone = {id(f) for f in agreeing} if correlation is WHITE else set()
    common = NoiseFloor(value, source, correlation, 0.0)
    return [f if f.coefficient is None or id(f) in alone else common for f in floors]
