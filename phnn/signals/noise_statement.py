"""A statement of a recording's noise in words: colour, growth with the speed, steps, outliers.

Each is told where it is significant at one per cent and large enough to matter.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram
from scipy.stats import binom, chi2, kurtosis, norm

from phnn.parameters import quantity
from phnn.signals.first_order import density

Array = NDArray[np.float64]

WHITE, SPECTRUM = "white", "spectrum"
_LEVEL, _FEWEST = 0.01, 200
# Shares of coloured power that are tried, and coefficients of first-order noise.
_SHARES = np.linspace(0.02, 1.0, 50)
_COEFFICIENTS = (-0.8, -0.5, -0.25, -0.1, 0.1, 0.25, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)
_BLOCKS = 20
# Share of the variance that goes with the speed, and step over the noise, from which they are worth a word.
_GROWS, _COARSE = 0.05, 0.3
# Outliers begin at so many standard deviations, these from the median absolute deviation; fewest that make tails heavy.
_OUTLIER, _ROBUST, _TAILS, _HEAVY = 4.0, 1.4826, 4, 0.3


@dataclass(frozen=True)
class NoiseStatement:
    """Attributes:
    rms: standard deviation [unit of the output]; source: where it comes from, in words.
    colour: `WHITE` or `SPECTRUM`; notes: what else it is, in sentences without full stops.
    """

    rms: float
    source: str
    colour: str
    notes: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Return the same as plain data."""
        return asdict(self) | {"notes": list(self.notes)}


@dataclass(frozen=True)
class Sample:
    """What is looked at.

    Attributes:
        noise: (N,) noise alone, in any unit, neighbouring samples in order; dt: sampling interval [s].
        speed: (N,) of the output at the same samples, in the unit of the noise a second; None where it is unknown.
        step: of which the output's values are multiples, in the unit of the noise; 0 where there is none.
        scale: of the unit of the noise in the output's.
        above: frequency [Hz] up to which something other than noise may be left.
    """

    noise: Array
    dt: float
    speed: Array | None = None
    step: float = 0.0
    scale: float = 1.0
    above: float = 0.0


def noise_statement(rms: float, source: str, unit: str, sample: Sample | None) -> NoiseStatement:
    """Return what the noise of one recording is.

    Args:
        rms: its stated standard deviation; source: where that comes from; unit: of the output.
        sample: None where nothing shows the noise alone.
    """
    if sample is None or sample.noise.size < _FEWEST or not np.any(sample.noise):
        return NoiseStatement(rms, source, WHITE, ("assumed, for the noise cannot be seen apart from the motion",))
    x = sample.noise - sample.noise.mean()
    colour = _colour(x, sample)
    jitter = _jitter(x, sample.speed)
    notes = [colour] if colour else []
    level = x
    if jitter is not None and sample.speed is not None:
        notes.append(f"grows with the speed: as {1e6 * jitter:.3g} µs of jitter would make it")
        rest = float(np.mean(x**2) - jitter**2 * np.mean(sample.speed**2))
        level = x / np.sqrt(jitter**2 * sample.speed**2 + max(rest, 1e-3 * float(np.mean(x**2))))
    coarse = sample.step / float(x.std())
    if coarse > _COARSE:
        notes.append(f"quantised: steps of {quantity(sample.step * sample.scale, unit)}, {coarse:.2g} × the noise")
    notes += _outliers(level, sample.step if level is x else 0.0)
    return NoiseStatement(rms, source, SPECTRUM if colour else WHITE, tuple(notes))


def _colour(x: Array, sample: Sample) -> str:
    """Return how a spectrum differs from that of white noise; empty where it does not, to the level.

    Spectra ``(1 − s) + s g(f)`` of some shapes ``g`` with mean one and shares ``s`` are compared with white noise by
    Whittle's (1953) likelihood, whose gain is ``χ²`` of one degree of freedom each under white noise.
    """
    f, power = periodogram(x, 1.0 / sample.dt)
    seen = f > sample.above
    f, power = f[seen], power[seen]
    cycles = 2.0 * np.pi * f * sample.dt
    gains = {"1/f": _gain(power, (1.0 / f) / np.mean(1.0 / f), _SHARES)}
    for phi in _COEFFICIENTS:
        g = density(phi, np.cos(cycles))
        gains[f"{phi:g}"] = _gain(power, g / g.mean(), np.ones(1))
    name, (gain, share) = max(gains.items(), key=lambda item: item[1][0])
    if gain < chi2.isf(_LEVEL / len(gains), 1):
        return ""
    if name == "1/f":
        return f"{100.0 * share:.0f} % of it lies at low frequencies, its spectrum falls as 1/f"
    side = "low" if float(name) > 0.0 else "high"
    return f"more power at {side} frequencies: neighbouring samples are correlated by {float(name):.2g}"


def _gain(power: Array, shape: Array, shares: Array) -> tuple[float, float]:
    """Return twice the log likelihood's gain over white noise of free level, and the share where it is largest."""
    gains = []
    # One by one: all of them together would take some hundred times the memory of the spectrum.
    for share in shares:
        spectrum = 1.0 + share * (shape - 1.0)
        gain = power.size * (np.log(power.mean()) - np.log(np.mean(power / spectrum))) - np.log(spectrum).sum()
        gains.append(2.0 * float(gain))
    best = int(np.argmax(gains))
    return gains[best], float(shares[best])


def _jitter(x: Array, speed: Array | None) -> float | None:
    """Return the deviation of the sampling instants [s] from the slope of ``x² = σ² + τ² v²``.

    Its error is that of White (1980), or as blocks of neighbouring samples show it where that is more: squares of
    coloured noise are correlated.
    """
    if speed is None or not np.ptp(speed) > 0.0:
        return None
    square = speed**2 - np.mean(speed**2)
    spread = float(square @ square)
    slope = float(square @ x**2) / max(spread, 1e-300)
    rest = x**2 - np.mean(x**2) - slope * square
    blocks = [float(b.sum()) for b in np.array_split(square * rest, _BLOCKS)]
    error = max(float(np.linalg.norm(square * rest)), float(np.linalg.norm(blocks))) / max(spread, 1e-300)
    share = slope * float(np.mean(speed**2)) / float(np.mean(x**2))
    if slope <= norm.isf(_LEVEL) * error or share < _GROWS:
        return None
    return float(np.sqrt(slope))


def _outliers(x: Array, step: float) -> list[str]:
    """Return the heavy tails: more samples beyond four robust deviations than Gaussian noise has."""
    # Values on a coarse grid have no robust deviation: spread them evenly over their steps.
    spread = x + step * (np.random.default_rng(0).random(x.size) - 0.5)
    robust = _ROBUST * float(np.median(np.abs(spread - np.median(spread))))
    beyond = int(np.sum(np.abs(spread) > _OUTLIER * robust))
    by_chance = float(binom.sf(beyond - 1, x.size, 2.0 * norm.sf(_OUTLIER)))
    if beyond < _TAILS or by_chance >= _LEVEL or float(kurtosis(spread)) < _HEAVY:
        return []
    share = 100.0 * beyond / x.size
    return [f"outliers: {share:.2g} % of the samples lie beyond {_OUTLIER:g} × its robust deviation"]
