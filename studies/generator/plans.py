"""Voltages that drive recordings, continuous functions of time, and the named sets of them.

Every jump and kink of the voltages in `KINKED` lies at a drawn fraction of a sampling interval. The actuator follows
the continuous voltage; a recording holds its samples only. So a sampled step does not tell its instant better than to
one sampling interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phnn.errors import InputRefused

Array = NDArray[np.float64]
Rng = np.random.Generator

PEAK = 75.0  # V, largest voltage of every plan
# The names of recordings that an examination keeps back begin so.
EXAM = "exam_"
DT = 1e-4  # s, sampling interval of the benchmark
HEIGHT = 60.0  # V, of every step, ramp, triangle and of the highest stair


@dataclass(frozen=True)
class Piece:
    """A stretch on which the voltage is smooth.

    ``V(t) = level + s t' + A sin(2π (f₀ t' + ½ f' t'²))`` with ``t' = t − shift``.

    Attributes:
        start, end: s; the voltage may jump where one piece follows another.
        level, amplitude: V.
        frequency: ``f₀`` in Hz.
        rate: ``f'`` in Hz/s.
        shift: s.
        slope: ``s`` in V/s.
    """

    start: float
    end: float
    level: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    rate: float = 0.0
    shift: float = 0.0
    slope: float = 0.0

    def voltage(self, t: Array) -> Array:
        """Voltage [V] at times ``t`` [s], shape as ``t``."""
        since = t - self.shift
        phase = 2.0 * math.pi * (self.frequency * since + 0.5 * self.rate * since * since)
        voltage: Array = self.level + self.slope * since + self.amplitude * np.sin(phase)
        return voltage

    @property
    def steepest(self) -> float:
        """Upper bound of the slope [V/s]: the ramp's, and that of a sine of the highest frequency of the piece."""
        highest = max(abs(self.frequency), abs(self.frequency + self.rate * (self.end - self.start)))
        return abs(self.slope) + 2.0 * math.pi * highest * abs(self.amplitude)

    def as_array(self) -> Array:
        """``(level, amplitude, frequency, rate, shift, slope)`` for the right-hand side."""
        return np.array([self.level, self.amplitude, self.frequency, self.rate, self.shift, self.slope])


@dataclass(frozen=True)
class Excitation:
    """One recording to be made: pieces of voltage that follow each other, and how they are sampled.

    Attributes:
        name: of the recording.
        pieces: without gaps, the first one starts at 0; a sample on a border belongs to the later piece.
        dt: sampling interval in s.
        samples: their number.
        held: the voltage comes from a converter that holds each sample (else it is smooth between samples).
    """

    name: str
    pieces: tuple[Piece, ...]
    dt: float
    samples: int
    held: bool = False

    @property
    def t(self) -> Array:
        """Sampling times, (samples,), s."""
        return np.arange(self.samples, dtype=np.float64) * self.dt

    def delayed(self, delay: float) -> Excitation:
        """The same voltage, later by ``delay`` [s] > 0; nothing before that, and the recording is no longer."""
        end = self.pieces[-1].end
        later = [
            replace(p, start=p.start + delay, end=min(p.end + delay, end), shift=p.shift + delay)
            for p in self.pieces
            if p.start + delay < end
        ]
        return replace(self, pieces=(Piece(0.0, min(delay, end)), *later))

    def piece_of(self, t: Array) -> NDArray[np.intp]:
        """Index of the piece that each time lies in, shape as ``t``."""
        return np.searchsorted(np.array([piece.start for piece in self.pieces[1:]]), t, side="right")

    def voltage(self, t: Array) -> Array:
        """Voltage [V] at times ``t`` [s], shape as ``t``."""
        which = self.piece_of(t)
        voltage = np.empty_like(t)
        for i, piece in enumerate(self.pieces):
            voltage[which == i] = piece.voltage(t[which == i])
        return voltage


def sine(frequency: float, amplitude: float = PEAK, periods: int = 3, samples: int = 2500) -> Excitation:
    """Whole periods of a sine that starts from rest at zero."""
    duration = periods / frequency
    piece = Piece(0.0, duration, amplitude=amplitude, frequency=frequency)
    return Excitation(f"sine_{frequency:03.0f}Hz_{amplitude:g}V", (piece,), duration / samples, samples)


def step(amplitude: float = PEAK, before: float = 0.1, hold: float = 2.0, after: float = 0.9) -> Excitation:
    """Rest, a voltage held, and release, sampled at 2 kHz; the durations are rounded to whole samples."""
    dt = 5e-4
    # Borders are multiples of dt in the very arithmetic of the sampling times, so that they coincide exactly.
    up, off, end = (round(time / dt) for time in (before, before + hold, before + hold + after))
    pieces = (Piece(0.0, up * dt), Piece(up * dt, off * dt, level=amplitude), Piece(off * dt, end * dt))
    return Excitation(f"step_{amplitude:.0f}V", pieces, dt, end, held=True)


def chirp(
    amplitude: float = 60.0, low: float = 1.0, high: float = 100.0, duration: float = 2.0, dt: float = 2e-4
) -> Excitation:
    """A sine whose frequency rises linearly, sampled at 5 kHz if nothing else is said."""
    piece = Piece(0.0, duration, amplitude=amplitude, frequency=low, rate=(high - low) / duration)
    return Excitation(f"chirp_{low:.0f}-{high:.0f}Hz_{amplitude:.0f}V", (piece,), dt, round(duration / dt))


_SAMPLES = 10_000  # 1 s
_RAMP = 1e-3  # s, in which a ramp reaches the height
_SMOOTH = 1e-2  # s, in which a smooth step reaches the height
_BEFORE = 0.05  # s of rest before the voltage first moves
_OFF = 0.65  # s, when a held voltage is released
_TRIANGLES = (5.0, 20.0, 60.0)  # Hz
_VARIED = 0.1  # a drawn frequency moves by up to this part of itself
_LEAST = 0.3  # s, shortest sine of the benchmark
_STAIRS = (20.0, 40.0, 60.0, 30.0, 50.0, 10.0, 40.0, 0.0)  # V, with minor loops
_STAIR = 0.1  # s, from one stair to the next


def _between(rng: Rng, time: float) -> float:
    """Draw an instant [s] at a random fraction of the sampling interval that follows ``time``."""
    return (round(time / DT) + float(rng.uniform(0.0, 1.0))) * DT


def _line(start: float, end: float, first: float, last: float) -> Piece:
    """Return a straight piece from ``first`` to ``last`` [V]."""
    return Piece(start, end, level=first, shift=start, slope=(last - first) / (end - start))


def _raised_cosine(start: float, end: float, first: float, last: float) -> Piece:
    """Return ``½ (first + last) + ½ (last − first) sin(π (t − middle)/(end − start))``: both ends have slope zero."""
    half = 0.5 * (end - start)
    return Piece(start, end, 0.5 * (first + last), 0.5 * (last - first), 0.5 / (end - start), shift=start + half)


def _stairs(name: str, instants: Sequence[float], levels: Sequence[float]) -> Excitation:
    """Return rest, then a held voltage after each instant."""
    pairs = pairwise((0.0, *instants, _SAMPLES * DT))
    pieces = tuple(Piece(*pair, level=level) for pair, level in zip(pairs, (0.0, *levels), strict=True))
    return Excitation(name, pieces, DT, _SAMPLES)


def _trapezoid(name: str, rng: Rng, lasts: float, edge: Callable[[float, float, float, float], Piece]) -> Excitation:
    """Return rest, an edge up, a held voltage, an edge down, rest."""
    up, off = _between(rng, _BEFORE), _between(rng, _OFF)
    rise, fall = edge(up, up + lasts, 0.0, HEIGHT), edge(off, off + lasts, HEIGHT, 0.0)
    held, rest = Piece(up + lasts, off, level=HEIGHT), Piece(off + lasts, _SAMPLES * DT)
    return Excitation(name, (Piece(0.0, up), rise, held, fall, rest), DT, _SAMPLES)


def _step(rng: Rng) -> Excitation:
    """Return a jump to 60 V and one back to zero."""
    return _stairs(f"step_{HEIGHT:g}V", [_between(rng, _BEFORE), _between(rng, _OFF)], (HEIGHT, 0.0))


def _triangle(rng: Rng) -> Excitation:
    """Return a triangle of 60 V at 5, 20 or 60 Hz ± 10 % that starts from rest between two samples."""
    frequency = float(f"{rng.choice(_TRIANGLES) * rng.uniform(1.0 - _VARIED, 1.0 + _VARIED):.3g}")
    start, end = _between(rng, _BEFORE), _SAMPLES * DT
    corners = start + (0.25 + 0.5 * np.arange(math.ceil(2.0 * frequency * end))) / frequency
    times = [start, *corners[corners < end].tolist()]
    peaks = [0.0, *(HEIGHT * (-1.0) ** i for i in range(len(times) - 1))]
    # The last line is cut off by the end of the recording.
    slope = 4.0 * HEIGHT * frequency
    lines = [_line(*pair, *values) for pair, values in zip(pairwise(times), pairwise(peaks), strict=True)]
    turn = 1.0 if peaks[-1] <= 0.0 else -1.0
    last = Piece(times[-1], end, level=peaks[-1], shift=times[-1], slope=turn * slope)
    return Excitation(f"triangle_{frequency:g}Hz_{HEIGHT:g}V", (Piece(0.0, start), *lines, last), DT, _SAMPLES)


def _stair(rng: Rng) -> Excitation:
    """Return eight jumps, up, down and up again, each at a fraction of its own."""
    return _stairs(f"stair_{HEIGHT:g}V", [_between(rng, _BEFORE + _STAIR * i) for i in range(len(_STAIRS))], _STAIRS)


KINKED: dict[str, Callable[[Rng], Excitation]] = {
    "step": _step,
    "ramp": lambda rng: _trapezoid(f"ramp_{HEIGHT:g}V", rng, _RAMP, _line),
    "triangle": _triangle,
    "stair": _stair,
    # The control: raised cosines, which samples at 10 kHz determine.
    "smooth": lambda rng: _trapezoid(f"smooth_step_{HEIGHT:g}V", rng, _SMOOTH, _raised_cosine),
}


def _demo() -> tuple[Excitation, ...]:
    sines = tuple(sine(f) for f in (1.0, 10.0, 25.0, 50.0, 75.0, 100.0, 150.0))
    return (*sines, sine(10.0, 25.0), sine(10.0, 50.0), sine(50.0, 40.0), step(), chirp())


def _short() -> tuple[Excitation, ...]:
    return sine(10.0), sine(100.0), sine(10.0, 50.0), step(before=0.05, hold=0.3, after=0.15)


def _varied_sine(rng: Rng, frequency: float, amplitude: float = PEAK) -> Excitation:
    """Return three periods, or as many as last 0.3 s; the frequency has three digits, so that names are true."""
    chosen = float(f"{frequency * rng.uniform(1.0 - _VARIED, 1.0 + _VARIED):.3g}")
    duration = max(3, math.ceil(_LEAST * chosen)) / chosen
    piece = Piece(0.0, duration, amplitude=amplitude, frequency=chosen)
    return Excitation(f"sine_{chosen:g}Hz_{amplitude:g}V", (piece,), DT, math.floor(duration / DT))


def _full(rng: Rng) -> tuple[Excitation, ...]:
    sines = tuple(_varied_sine(rng, f) for f in (1.0, 10.0, 25.0, 50.0, 75.0, 100.0, 150.0))
    weaker = tuple(_varied_sine(rng, *of) for of in ((10.0, 25.0), (10.0, 50.0), (50.0, 40.0), (1.0, 40.0)))
    return (*sines, *weaker, step(), chirp(dt=DT))


def _few(rng: Rng) -> tuple[Excitation, ...]:
    return _varied_sine(rng, 10.0), _varied_sine(rng, 100.0, 40.0)


PLANS: dict[str, Callable[[], tuple[Excitation, ...]]] = {
    "demo": _demo,
    "short": _short,
    "one": lambda: (chirp(PEAK, duration=1.0),),
}
VARIED: dict[str, Callable[[Rng], tuple[Excitation, ...]]] = {"full": _full, "few": _few}


def _examined(base: str, rng: Rng) -> tuple[Excitation, ...]:
    """Return a plan and recordings that an examination keeps back, of frequencies and amplitudes that no plan has."""
    kept = (sine(18.0, 65.0), sine(66.0, 35.0), chirp(50.0, 2.0, 140.0, 0.5))
    return (*plan_of(base, rng), *(replace(r, name=f"{EXAM}{r.name}") for r in kept))


def _with(base: str, kind: str, rng: Rng) -> tuple[Excitation, ...]:
    """Return a plan with another recording, drawn last, instead of the held step."""
    plan = plan_of(base, rng)
    other = KINKED[kind](rng)
    return tuple(other if excitation.held else excitation for excitation in plan)


VARIED |= {f"{base}_{kind}": partial(_with, base, kind) for base in ("full", "short") for kind in KINKED}
VARIED |= {f"{base}_exam": partial(_examined, base) for base in ("demo", "short", "one")}


def plan_of(name: str, rng: Rng | None = None) -> tuple[Excitation, ...]:
    """Return the recordings of a plan.

    Args:
        name: "demo" (12 recordings, 41,000 samples), "short" (4, 8,500), "one" (1, 5,000), "full" (13, some 113,000) or
            "few" (2, 6,000); "demo_exam", "short_exam" and "one_exam" have three more, whose names begin with `EXAM`;
            "full_KIND" and "short_KIND" have a recording of `KINKED` in the place of the held step, KIND is
            "step", "ramp", "triangle", "stair" or "smooth".
        rng: draws frequencies and instants; "demo" and "short" are always the same.

    Raises:
        InputRefused: no plan of this name, or one that varies without ``rng``.
    """
    if name in PLANS:
        return PLANS[name]()
    if rng is None or name not in VARIED:
        known = (*PLANS, *(VARIED if rng is not None else ()))
        raise InputRefused(f"no plan called {name!r}: take one of {', '.join(known)}")
    return VARIED[name](rng)
