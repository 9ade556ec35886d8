"""Voltages of the demonstration: continuous functions of time, sampled only after the simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

PEAK = 75.0  # V, largest voltage of every plan


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

    def voltage(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Voltage [V] at times ``t`` [s], shape as ``t``."""
        since = t - self.shift
        phase = 2.0 * math.pi * (self.frequency * since + 0.5 * self.rate * since * since)
        voltage: NDArray[np.float64] = self.level + self.slope * since + self.amplitude * np.sin(phase)
        return voltage

    @property
    def steepest(self) -> float:
        """Upper bound of the slope [V/s]: the ramp's, and that of a sine of the highest frequency of the piece."""
        highest = max(abs(self.frequency), abs(self.frequency + self.rate * (self.end - self.start)))
        return abs(self.slope) + 2.0 * math.pi * highest * abs(self.amplitude)

    def as_array(self) -> NDArray[np.float64]:
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
    def t(self) -> NDArray[np.float64]:
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

    def piece_of(self, t: NDArray[np.float64]) -> NDArray[np.intp]:
        """Index of the piece that each time lies in, shape as ``t``."""
        return np.searchsorted(np.array([piece.start for piece in self.pieces[1:]]), t, side="right")

    def voltage(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
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
