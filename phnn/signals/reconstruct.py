"""What lies between the samples of an input: its reconstruction on the sub-steps of a simulation.

A linear hold of a 150 Hz sine at 10 kHz is wrong by more than the noise of a good sensor, so smooth inputs are
reconstructed by splines or band-limited. A jump is not smooth: the earlier sample is held until the
instant of the later one, as a digital source does.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.interpolate import make_interp_spline

from phnn.errors import InputRefused

Array = NDArray[np.float64]

METHODS = ("cubic", "quintic", "band_limited", "linear", "zero_order")
_JUMP_SHARE = 0.05
_JUMP_RATIO = 20.0
_JUMP_INTERVALS = 32
_JUMP_FACTOR = 16
_DENSE = 8
_ORDER = {"linear": 1, "cubic": 3, "quintic": 5}


def find_jumps(u: Array) -> NDArray[np.int64]:
    """Indices ``n`` where the input jumps between samples ``n − 1`` and ``n``.

    A jump is a difference above 5 % of the range and above twenty times the typical difference next to it.
    """
    span = float(np.ptp(u))
    if span == 0.0 or u.size < 4:
        return np.zeros(0, np.int64)
    steps = np.abs(np.diff(u))
    # Mirrored at the ends: padding with zeros would make every difference of a short record a jump.
    padded = np.pad(steps, 3, mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 7)
    neighbours = np.delete(around, 3, axis=1)
    typical = np.median(neighbours, axis=1)
    return np.flatnonzero((steps > _JUMP_SHARE * span) & (steps > _JUMP_RATIO * typical)) + 1


def substep_counts(u: Array, before: float, substeps: int) -> NDArray[np.int64]:
    """(N−1,) sub-steps of every sample interval: more of them for a while after each jump, where motion is fastest.

    Args:
        before: input before the first sample.
    """
    counts = np.full(u.size - 1, substeps, dtype=np.int64)
    jumps = find_jumps(u).tolist()
    if abs(u[0] - before) > _JUMP_SHARE * float(np.ptp(u)):
        jumps.append(0)
    for jump in jumps:
        counts[jump : jump + _JUMP_INTERVALS] = substeps * _JUMP_FACTOR
    return counts


def substep_input(u: Array, counts: NDArray[np.int64], method: str) -> Array:
    """The input at the start, middle and end of every sub-step.

    Args:
        u: (N,) samples.
        counts: (N−1,) sub-steps of the sample intervals.
        method: one of ``cubic``, ``quintic``, ``band_limited``, ``linear``, ``zero_order``.

    Returns:
        (Σ counts, 3) values; the end of one row and the start of the next differ at a jump.

    Raises:
        InputRefused: an unknown method.
    """
    if method not in METHODS:
        raise InputRefused(f"input: {method!r} is not a reconstruction; choose {', '.join(METHODS)}")
    if method == "zero_order":
        return np.repeat(np.repeat(u[:-1], counts)[:, None], 3, axis=1)
    nodes = np.concatenate([[0], np.cumsum(counts)])
    interval = np.repeat(np.arange(counts.size), counts)
    # Position of each sub-step's start in units of the sample interval.
    first = interval + (np.arange(nodes[-1]) - nodes[interval]) / counts[interval]
    size = 1.0 / counts[interval]
    positions = np.column_stack([first, first + 0.5 * size, first + size])
    fine = np.empty((int(nodes[-1]), 3))
    # What is band-limited has no jumps: it rings where it sets in, and a piece cut off there is wrong at its ends.
    jumps = [] if method == "band_limited" else find_jumps(u).tolist()
    edges = [0, *jumps, u.size]
    for start, stop in pairwise(edges):
        rows = slice(nodes[start], nodes[stop - 1])
        fine[rows] = _smooth(u[start:stop], positions[rows] - start, method)
        if stop < u.size:
            fine[nodes[stop - 1] : nodes[stop]] = u[stop - 1]
    return fine


def _smooth(u: Array, positions: Array, method: str) -> Array:
    """One smooth stretch at positions counted in samples."""
    if method == "band_limited" and u.size > 32:
        # A straight line is taken out, because the filter assumes zero outside the record.
        line = np.linspace(u[0], u[-1], u.size)
        dense = np.asarray(signal.resample_poly(u - line, _DENSE, 1, window=("kaiser", 14.0)))
        dense = dense[: (u.size - 1) * _DENSE + 1]
        spline = make_interp_spline(np.arange(dense.size) / _DENSE, dense, k=3)
        return np.asarray(spline(positions) + np.interp(positions, np.arange(u.size), line))
    order = min(_ORDER.get(method, 3), u.size - 1)
    if order < 1:
        return np.full(positions.shape, u[0])
    return np.asarray(make_interp_spline(np.arange(u.size), u, k=order if order % 2 else order - 1)(positions))


def mean_input(fine: Array) -> Array:
    """(n,) means over the sub-steps by Simpson's rule."""
    return np.asarray((fine[..., 0] + 4.0 * fine[..., 1] + fine[..., 2]) / 6.0)
