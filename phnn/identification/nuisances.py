"""Nuisances of a recording: its zero, lines of the mains, slow drift of its sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.recordings.recording import Recording, dominant_frequency
from phnn.setup import NOTHING, Own

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
    held = _held(recording, frequencies)
    phase = 2.0 * np.pi * np.outer(recording.t, held)
    return np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(recording.t.size, 2 * len(held))


def _held(recording: Recording, frequencies: Sequence[float]) -> list[float]:
    """The lines that a recording can hold."""
    duration = recording.t.size * recording.dt
    return [f for f in dict.fromkeys(frequencies) if 1.0 / duration <= f < 0.5 / recording.dt]


def drift_columns(recording: Recording, count: int) -> Array:
    """(N, C) drift basis: half-cosines ``cos(πmt/T)`` over a recording, ``m = 1, …``, at most ``count``.

    All are slower than the input, if there is one: a faster drift cannot be told from a response.
    """
    duration, orders = recording.t.size * recording.dt, np.arange(1, _slow(recording, count) + 1)
    return np.asarray(np.cos(np.pi / duration * np.outer(recording.t - recording.t[0], orders)))


def _slow(recording: Recording, count: int) -> int:
    """Number of half-cosines, at most ``count``, that are slower than the input of a recording."""
    if not count or not np.ptp(recording.u) > 0.0:
        return count
    duration = recording.t.size * recording.dt
    return min(count, max(math.ceil(2.0 * dominant_frequency(recording) * duration - 1e-6) - 1, 1))


def own_columns(recording: Recording, own: Own) -> Array:
    """(N, K) basis of all nuisances of a recording but its zero."""
    return np.hstack([line_columns(recording, own.lines), drift_columns(recording, own.drift_terms)])


def own_size(recording: Recording, own: Own) -> int:
    """Number of these columns."""
    return 2 * len(_held(recording, own.lines)) + _slow(recording, own.drift_terms)


def without_nuisances(
    values: Array, mask: NDArray[Any], recording: Recording, own: Own = NOTHING, hidden: NDArray[np.bool_] | None = None
) -> Array:
    """The masked rows of (N, …) without their mean and nuisances.

    The mean stays where the zero of the output is a parameter that recordings share.

    Args:
        hidden: (N,) samples of no weight, see `phnn.identification.nuisances.beyond_limit`; their rows are zero.
    """
    if hidden is not None and hidden.any():
        counted = mask & ~hidden
        out = np.zeros((int(mask.sum()), *values.shape[1:]))
        out[counted[mask]] = without_nuisances(values, counted, recording, own)
        return out
    inside = values[mask]
    if inside.size and recording.offset == "own":
        inside -= inside.mean(axis=0)
    if own == NOTHING or not inside.size:
        return inside
    basis = _own_basis(recording, own, mask.tobytes())
    return np.asarray(inside - basis @ (basis.T @ inside))


@lru_cache(maxsize=32)
def _own_basis(recording: Recording, own: Own, mask: bytes) -> Array:
    """Orthonormal basis of the nuisances on the masked rows, without their means; cached for all models."""
    columns = own_columns(recording, own)[np.frombuffer(mask, dtype=bool)]
    if not columns.size:
        return np.zeros((columns.shape[0], 0))
    left, size, _ = np.linalg.svd(columns - columns.mean(axis=0), full_matrices=False)
    return np.asarray(left[:, size > _RANK * np.sqrt(columns.shape[0])])


def constant_and_own(error: Array, rows: NDArray[np.bool_], recording: Recording, own: Own) -> Array:
    """(N,) zero and nuisances of a recording, fitted to some rows of an error (N,); zero where there are no rows."""
    zero = float(recording.offset == "own")
    if not rows.any():
        return np.zeros(error.size)
    if own == NOTHING:
        return np.full(error.size, zero * error[rows].mean())
    columns = np.column_stack([np.full(recording.t.size, zero), own_columns(recording, own)])
    return np.asarray(columns @ np.linalg.lstsq(columns[rows], error[rows], rcond=_RANK)[0])


def own_parts(error: Array, rows: slice, recording: Recording, own: Own) -> Array:
    """(M,) the nuisances in some rows of an error (N,), fitted to these very rows beside a constant."""
    columns = np.column_stack([np.ones(recording.t.size), own_columns(recording, own)])[rows]
    found = np.linalg.lstsq(columns, error[rows], rcond=_RANK)[0]
    return np.asarray(columns[:, 1:] @ found[1:])


Rows = NDArray[np.bool_]

# Rounds after which the samples that count are taken as they are; two or three settle them.
_ROUNDS = 30


def beyond_limit(recording: Recording, y: Array, mask: NDArray[Any], own: Own = NOTHING) -> Rows | None:
    """(N,) which masked samples sit at a limit while the model lies beyond it; None where none sits at a limit.

    Args:
        y: (N,) the model's output without zero and nuisances.
        mask: (N,) the samples that are scored.
    """
    if not recording.sensor.is_limited:
        return None
    side = recording.sensor.at_limit(recording.y)
    at_limit = (side != 0) & mask
    if not at_limit.any():
        return None
    error, hidden = recording.y - y, at_limit
    for _ in range(_ROUNDS):
        left = error - constant_and_own(error, mask & ~hidden, recording, own)
        now = at_limit & (side * left <= 0.0)
        if np.array_equal(now, hidden):
            break
        hidden = now
    return hidden
