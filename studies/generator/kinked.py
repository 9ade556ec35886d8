"""Voltages that jump or change their slope between two samples, and a smooth step to compare them with.

Every jump and every kink lies at a drawn fraction of a sampling interval. The actuator follows the continuous voltage;
a recording holds its samples only. So a sampled step does not tell its instant better than to one sampling interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from studies.generator.excitation import Excitation, Piece

DT = 1e-4  # s, sampling interval
HEIGHT = 60.0  # V, of every step, ramp, triangle and of the highest stair
_SAMPLES = 10_000  # 1 s
_RAMP = 1e-3  # s, in which a ramp reaches the height
_SMOOTH = 1e-2  # s, in which a smooth step reaches the height
_BEFORE = 0.05  # s of rest before the voltage first moves
_OFF = 0.65  # s, when a held voltage is released
_TRIANGLES = (5.0, 20.0, 60.0)  # Hz
_VARIED = 0.1  # the frequency of a triangle moves by up to this part of itself
_STAIRS = (20.0, 40.0, 60.0, 30.0, 50.0, 10.0, 40.0, 0.0)  # V, with minor loops
_STAIR = 0.1  # s, from one stair to the next

Rng = np.random.Generator


def _between(rng: Rng, time: float) -> float:
    """An instant [s] at a random fraction of the sampling interval that follows ``time``."""
    return (round(time / DT) + float(rng.uniform(0.0, 1.0))) * DT


def _line(start: float, end: float, first: float, last: float) -> Piece:
    """A straight piece from ``first`` to ``last`` [V]."""
    return Piece(start, end, level=first, shift=start, slope=(last - first) / (end - start))


def _raised_cosine(start: float, end: float, first: float, last: float) -> Piece:
    """``½ (first + last) + ½ (last − first) sin(π (t − middle)/(end − start))``: both ends have slope zero."""
    duration = end - start
    return Piece(
        start,
        end,
        level=0.5 * (first + last),
        amplitude=0.5 * (last - first),
        frequency=0.5 / duration,
        shift=start + 0.5 * duration,
    )


def _excitation(name: str, pieces: Sequence[Piece]) -> Excitation:
    return Excitation(name, tuple(pieces), DT, _SAMPLES)


def _stairs(name: str, instants: Sequence[float], levels: Sequence[float]) -> Excitation:
    """Rest, then a held voltage after each instant."""
    starts, ends = (0.0, *instants), (*instants, _SAMPLES * DT)
    return _excitation(
        name, [Piece(a, b, level=level) for a, b, level in zip(starts, ends, (0.0, *levels), strict=True)]
    )


def _trapezoid(name: str, rng: Rng, lasts: float, edge: Callable[[float, float, float, float], Piece]) -> Excitation:
    """Rest, an edge up, a held voltage, an edge down, rest."""
    up, off = _between(rng, _BEFORE), _between(rng, _OFF)
    return _excitation(
        name,
        (
            Piece(0.0, up),
            edge(up, up + lasts, 0.0, HEIGHT),
            Piece(up + lasts, off, level=HEIGHT),
            edge(off, off + lasts, HEIGHT, 0.0),
            Piece(off + lasts, _SAMPLES * DT),
        ),
    )


def instantaneous_step(rng: Rng) -> Excitation:
    """A jump to 60 V and one back to zero."""
    return _stairs(f"step_{HEIGHT:g}V", [_between(rng, _BEFORE), _between(rng, _OFF)], (HEIGHT, 0.0))


def ramps(rng: Rng) -> Excitation:
    """A trapezoid whose ramps last 1 ms for 60 V."""
    return _trapezoid(f"ramp_{HEIGHT:g}V", rng, _RAMP, _line)


def smooth_step(rng: Rng) -> Excitation:
    """Raised cosines of 10 ms up to 60 V and back: the control, which samples at 10 kHz determine."""
    return _trapezoid(f"smooth_step_{HEIGHT:g}V", rng, _SMOOTH, _raised_cosine)


def triangle(rng: Rng) -> Excitation:
    """A triangle of 60 V at 5, 20 or 60 Hz ± 10 % that starts from rest between two samples."""
    frequency = float(f"{rng.choice(_TRIANGLES) * rng.uniform(1.0 - _VARIED, 1.0 + _VARIED):.3g}")
    start, end = _between(rng, _BEFORE), _SAMPLES * DT
    corners = start + (0.25 + 0.5 * np.arange(math.ceil(2.0 * frequency * end))) / frequency
    times = [start, *corners[corners < end].tolist()]
    peaks = [0.0, *(HEIGHT * (-1.0) ** i for i in range(len(times) - 1))]
    # The last line is cut off by the end of the recording.
    slope = 4.0 * HEIGHT * frequency
    lines = [_line(*pair, *values) for pair, values in zip(_pairs(times), _pairs(peaks), strict=True)]
    turn = 1.0 if peaks[-1] <= 0.0 else -1.0
    last = Piece(times[-1], end, level=peaks[-1], shift=times[-1], slope=turn * slope)
    return _excitation(f"triangle_{frequency:g}Hz_{HEIGHT:g}V", (Piece(0.0, start), *lines, last))


def stair(rng: Rng) -> Excitation:
    """Eight jumps, up, down and up again, each at a fraction of its own."""
    return _stairs(f"stair_{HEIGHT:g}V", [_between(rng, _BEFORE + _STAIR * i) for i in range(len(_STAIRS))], _STAIRS)


def _pairs(values: Sequence[float]) -> list[tuple[float, float]]:
    return list(pairwise(values))


KINKED: dict[str, Callable[[Rng], Excitation]] = {
    "step": instantaneous_step,
    "ramp": ramps,
    "triangle": triangle,
    "stair": stair,
    "smooth": smooth_step,
}
