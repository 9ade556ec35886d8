"""What belongs to a recording and to no model: its zero, and the lines of the mains in it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from phnn.recordings.recording import Recording

Array = NDArray[np.float64]

# Directions weaker than this share of the strongest are rounding: two lines that one part cannot tell apart.
_RANK = 1e-9


def line_columns(recording: Recording, frequencies: Sequence[float]) -> Array:
    """(N, 2L) cosine and sine of every line at the samples of a recording.

    Left out are lines at or above the Nyquist frequency, which look like other ones, and lines with less than one
    period in the recording, which look like a zero that moves.

    Args:
        frequencies: of the lines [Hz].
    """
    duration = recording.t.size * recording.dt
    kept = [f for f in dict.fromkeys(frequencies) if 1.0 / duration <= f < 0.5 / recording.dt]
    phase = 2.0 * np.pi * np.outer(recording.t, kept)
    return np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(recording.t.size, 2 * len(kept))


def without_nuisances(values: Array, mask: Array, recording: Recording, lines: tuple[float, ...] = ()) -> Array:
    """The masked rows of (N, …) without their mean and lines: what the recording's nuisances cannot explain."""
    inside = values[mask]
    inside = inside - inside.mean(axis=0) if inside.size else inside
    if not lines or not inside.size:
        return inside
    basis = _line_basis(recording, lines, mask.tobytes())
    return np.asarray(inside - basis @ (basis.T @ inside))


@lru_cache(maxsize=32)
def _line_basis(recording: Recording, lines: tuple[float, ...], mask: bytes) -> Array:
    """Orthonormal basis of the lines on the masked rows, without their means; kept, because every model asks for it."""
    columns = line_columns(recording, lines)[np.frombuffer(mask, dtype=bool)]
    if not columns.size:
        return np.zeros((columns.shape[0], 0))
    left, size, _ = np.linalg.svd(columns - columns.mean(axis=0), full_matrices=False)
    return np.asarray(left[:, size > _RANK * np.sqrt(columns.shape[0])])


def lines_of(error: Array, rows: slice, recording: Recording, lines: tuple[float, ...]) -> Array:
    """(M,) the lines in some rows of an error (N,), fitted to these very rows beside a constant."""
    columns = np.column_stack([np.ones(recording.t.size), line_columns(recording, lines)])[rows]
    found = np.linalg.lstsq(columns, error[rows], rcond=_RANK)[0]
    return np.asarray(columns[:, 1:] @ found[1:])
