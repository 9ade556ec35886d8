"""The menu of recordings to propose: within the input, the displacement and nearly the rate that are in use already."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.linearised import LinearisedFit
from phnn.network.small_signal import linearised_at_rest
from phnn.passage import is_displacement
from phnn.recordings.recording import Part, Recording, Start, Units
from phnn.setup import Setup
from phnn.simulate import simulate
from phnn.units import quantity

Array = NDArray[np.float64]


_SAMPLES = 20_000
_PER_PERIOD = 20  # samples of the fastest period
_FASTER = 2.0  # how much higher than in use the rate may be
_BELOW_RESONANCE, _RING = 0.9, 200
_LINES, _REPEATS = 10, 4
_STEPS, _PERIODS_A_STEP = 5, 4


@dataclass(frozen=True)
class Stretch:
    """``u(t) = level + Σ A sin(2π f (t − start) + φ)`` for ``start ≤ t < end`` [s]; lines are ``(A, f [Hz], φ)``."""

    start: float
    end: float
    level: float = 0.0
    lines: tuple[tuple[float, float, float], ...] = ()

    def input(self, t: Array) -> Array:
        """Return the input at some times within the stretch, shape as ``t``."""
        waves = [a * np.sin(2.0 * np.pi * f * (t - self.start) + phase) for a, f, phase in self.lines]
        return np.asarray(self.level + sum(waves, np.zeros_like(t)))


@dataclass(frozen=True)
class Experiment:
    """A recording to be made, from rest at zero input.

    Attributes:
        kind: its name on the menu; words: what to tell the generator.
        stretches: of the input, one after the other from 0 s on.
        rate: samples per second.
        interpolation: of the input between the samples.
    """

    kind: str
    words: str
    stretches: tuple[Stretch, ...]
    rate: float
    interpolation: str = "cubic"

    @property
    def duration(self) -> float:
        """Its length [s]."""
        return self.stretches[-1].end

    @property
    def t(self) -> Array:
        """(N,) sampling times [s]."""
        return np.arange(math.floor(self.duration * self.rate + 1e-6), dtype=np.float64) / self.rate

    @property
    def u(self) -> Array:
        """(N,) input."""
        t = self.t
        starts = np.array([s.start for s in self.stretches[1:]])
        # A sample on a border belongs to the later stretch, whatever the rounding of its time.
        which = np.searchsorted(starts, t + 1e-9 / self.rate, side="right")
        u = np.empty_like(t)
        for i, stretch in enumerate(self.stretches):
            u[which == i] = stretch.input(t[which == i])
        return u

    def recording(self, noise: float, units: Units) -> Recording:
        """Return it as a recording without an output; white noise of standard deviation ``noise`` is expected."""
        t = self.t
        name = f"menu: {self.kind}"
        part = Part(name, 0, t.size, "identification")
        return Recording(
            name, t, self.u, np.zeros_like(t), Start("rest", 0.0), self.interpolation, (part,), noise, "assumed",
            np.array([1.0]), None, {}, "", units,
        )  # fmt: skip


def menu(linearised: LinearisedFit) -> tuple[Experiment, ...]:
    """Return recordings that a laboratory can make: they differ in time, frequency, amplitude and offset."""
    smooth = (_slow(linearised), _near_resonance(linearised), _sweep(linearised), _multisine(linearised))
    if is_displacement(linearised.fit.setup, linearised.plan.recordings[0]):
        # No rig moves at once from one place to another.
        return smooth
    return (_hold(linearised), *smooth, _offset(linearised))


def resonance(setup: Setup) -> float | None:
    """Return the lowest resonance [Hz] of the network about rest, ``Im λ/2π`` linearised; None without one."""
    network = setup.network
    if network.senses:
        # What is held by an imposed motion does not ring.
        return None
    values = np.linalg.eigvals(linearised_at_rest(network)[0])
    found = values.imag[values.imag > 1e-6 * np.abs(values).max()]
    return float(found.min()) / (2.0 * math.pi) if found.size else None


def _rate(linearised: LinearisedFit, duration: float, faster: float = 1.0) -> float:
    """The highest rate in use, times ``faster``, or what leaves few enough samples; rounded down to 1, 2, 5, 10, …"""
    used = max(1.0 / r.dt for r in linearised.plan.recordings)
    most = min(faster * used, _SAMPLES / duration) * (1.0 + 1e-9)
    decade = 10.0 ** math.floor(math.log10(most))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most)


def _three(value: float) -> float:
    """Three digits, so that the words are exact."""
    return float(f"{value:.3g}")


def _volts(linearised: LinearisedFit, value: float) -> str:
    return quantity(value, linearised.plan.recordings[0].units.input)


def _timed(duration: float, rate: float) -> str:
    return f"{quantity(duration, 's')} in all, {rate:.6g} samples/s"


def _sine(
    linearised: LinearisedFit, kind: str, amplitude: float, frequency: float, periods: int, rate: float
) -> Experiment:
    """Whole periods of a sine."""
    duration = periods / frequency
    words = (
        f"{kind}: {periods} periods of {frequency:.6g} Hz at {_volts(linearised, amplitude)} amplitude; "
        f"{_timed(duration, rate)}"
    )
    return Experiment(kind, words, (Stretch(0.0, duration, lines=((amplitude, frequency, 0.0),)),), rate)


def _hold(linearised: LinearisedFit) -> Experiment:
    scales = linearised.scales
    long, v = _three(max(3.0 * scales.duration, 5.0)), _three(scales.voltage)
    rate = min(_rate(linearised, 1.6 * long), 2_000.0)
    up, off, end = (round(x * rate) / rate for x in (0.1 * long, 1.1 * long, 1.6 * long))
    words = (
        f"hold: 0 for {quantity(up, 's')}, a step to {_volts(linearised, v)} held for {quantity(off - up, 's')}, "
        f"back to 0 for {quantity(end - off, 's')}; {_timed(end, rate)}"
    )
    return Experiment("hold", words, (Stretch(0.0, up), Stretch(up, off, v), Stretch(off, end)), rate, "zero_order")


def _slow(linearised: LinearisedFit) -> Experiment:
    frequency = _three(0.2 * linearised.scales.slowest)
    return _sine(
        linearised, "slow sine", _three(linearised.scales.voltage), frequency, 3, _rate(linearised, 3.0 / frequency)
    )


def _near_resonance(linearised: LinearisedFit) -> Experiment:
    """Just below the resonance, or as near to it as the rate allows; no displacement beyond that in use."""
    scales = linearised.scales
    at = resonance(linearised.fit.setup)
    wanted = _BELOW_RESONANCE * at if at is not None else 2.0 * scales.fastest
    rate = _rate(linearised, _RING / wanted)
    if rate < _PER_PERIOD * wanted:
        rate = _rate(linearised, _RING / wanted, _FASTER)
    # Whole samples a period: noise is then seen in differences of periods, with nothing to interpolate.
    frequency = rate / max(round(rate / wanted), _PER_PERIOD)
    kind = "near-resonance sine" if at is not None and frequency >= 0.5 * at else "fast sine"
    full = _sine(linearised, kind, _three(scales.voltage), frequency, _RING, rate)
    peak = float(
        np.abs(
            simulate(linearised.fit.setup, full.recording(scales.noise, linearised.plan.recordings[0].units), 2).y
        ).max()
    )
    amplitude = _three(scales.voltage * min(1.0, scales.sensed / peak))
    return _sine(linearised, kind, amplitude, frequency, _RING, rate)


def _middle(linearised: LinearisedFit) -> float:
    return _three(math.sqrt(linearised.scales.slowest * linearised.scales.fastest))


def _sweep(linearised: LinearisedFit) -> Experiment:
    """A frequency in use at rising amplitudes, a few periods of each."""
    frequency = _middle(linearised)
    amplitudes = [_three(linearised.scales.voltage * (i + 1) / _STEPS) for i in range(_STEPS)]
    each = _PERIODS_A_STEP / frequency
    rate = _rate(linearised, _STEPS * each)
    words = (
        f"amplitude sweep: {_PERIODS_A_STEP} periods of {frequency:g} Hz at each of the amplitudes "
        f"{', '.join(_volts(linearised, a) for a in amplitudes)}; {_timed(_STEPS * each, rate)}"
    )
    stretches = [Stretch(i * each, (i + 1) * each, lines=((a, frequency, 0.0),)) for i, a in enumerate(amplitudes)]
    return Experiment("amplitude sweep", words, tuple(stretches), rate)


def _multisine(linearised: LinearisedFit) -> Experiment:
    """Harmonics of one frequency, spaced evenly on a logarithmic scale, with Schroeder's phases (1970)."""
    scales = linearised.scales
    first = _three(max(0.5 * scales.slowest, 0.02 * scales.fastest))
    duration = _REPEATS / first
    rate = _rate(linearised, duration)
    last = min(2.0 * scales.fastest, rate / _PER_PERIOD, 0.5 * (resonance(linearised.fit.setup) or np.inf))
    orders = np.unique(np.round(np.geomspace(1.0, max(last / first, 1.0), _LINES)))
    phases = -np.pi * np.arange(orders.size) * np.arange(1, orders.size + 1) / orders.size
    each = zip(orders.tolist(), phases.tolist(), strict=True)
    unit = Stretch(0.0, 1.0 / first, lines=tuple((1.0, first * order, phase) for order, phase in each))
    fine = np.linspace(0.0, unit.end, 20_001)
    wave = unit.input(fine)
    # It begins where the wave crosses zero, so that there is no step from rest.
    begin = fine[int(np.argmin(np.abs(wave)))]
    amplitude = _three(0.995 * scales.voltage / float(np.abs(wave).max()))
    lines = tuple((amplitude, f, float(np.angle(np.exp(1j * (p + 2.0 * np.pi * f * begin))))) for _, f, p in unit.lines)
    words = (
        f"multisine: {_REPEATS} periods of {quantity(1.0 / first, 's')} with lines of "
        f"{_volts(linearised, amplitude)} each at {', '.join(f'{f:g}' for _, f, _ in lines)} Hz, "
        f"phases {', '.join(f'{p:.2f}' for _, _, p in lines)} rad; {_timed(duration, rate)}"
    )
    return Experiment("multisine", words, (Stretch(0.0, duration, lines=lines),), rate)


def _offset(linearised: LinearisedFit) -> Experiment:
    """A sine about half the largest input, where even and odd effects no longer look alike."""
    v, frequency = linearised.scales.voltage, _middle(linearised)
    level, amplitude, duration = _three(0.6 * v), _three(0.4 * v), 10.0 / frequency
    rate = _rate(linearised, duration)
    words = (
        f"offset sine: 10 periods of {frequency:g} Hz at {_volts(linearised, amplitude)} amplitude about "
        f"{_volts(linearised, level)}, with a step to it; {_timed(duration, rate)}"
    )
    return Experiment("offset sine", words, (Stretch(0.0, duration, level, ((amplitude, frequency, 0.0),)),), rate)
