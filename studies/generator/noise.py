"""Noise of the recordings: families, size, what acts before the sensor, and how strong a signal is against it.

Nobody records a random force on the mass or errors of the sampling instants. The force passes through the plant, so
that what it adds to the output has the plant's resonance, and differs where hysterons slip. An error of an instant adds
the speed times that error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from phnn.errors import InputRefused
from studies.generator.plans import Array, Excitation
from studies.generator.world import FORCE_STEP, Disturbance, stuck_stiffness

WHITE = "white"
FIRST_ORDER = "first_order"  # white where its coefficient is 0
PROCESS, PINK, HEAVY, QUANTISED, JITTERED = "process", "pink", "heavy", "quantised", "jittered"
_NANOMETRE = 1e-9

Rng = np.random.Generator


@dataclass(frozen=True)
class Noise:
    """Stationary noise of standard deviation σ, followed by rounding to a least step.

    =========== ==================================================== ===============================================
    family      noise of the sensor                                  amount
    =========== ==================================================== ===============================================
    first_order ``n_t = φ n_{t−1} + √(1 − φ²) σ ε_t``, Gaussian      φ is ``colour``; 0 is white noise
    process     white; the rest passes through the plant as a force  share of that rest in the power σ²
    pink        white, and a part whose spectrum falls as 1/f        share of that part in the power σ²
    heavy       white, Student's t, scaled to the variance σ²        degrees of freedom
    quantised   white                                                least step over σ
    jittered    white; the sampling instants err besides             deviation of the error times the root mean
                                                                     square speed of the fastest recording, over σ
    =========== ==================================================== ===============================================

    Attributes:
        deviation: σ, m: the total of all that is added before rounding, but for the jitter.
        step: least step of the displacement, m; counted as white noise of variance step²/12.
        colour: φ, 0 for white noise.
        family: one of the table.
        amount: see the table; without meaning for first_order.
    """

    deviation: float
    step: float
    colour: float = 0.0
    family: str = FIRST_ORDER
    amount: float = 0.0

    def drawn(self, count: int, rng: Rng) -> Array:
        """Draw noise of the sensor before rounding, (count,), m; without jitter and what passes through the plant."""
        if self.family == PROCESS:
            return math.sqrt(1.0 - self.amount) * self.deviation * rng.standard_normal(count)
        if self.family == PINK:
            white = math.sqrt(1.0 - self.amount) * rng.standard_normal(count)
            return self.deviation * (white + math.sqrt(self.amount) * pink(count, rng))
        if self.family == HEAVY:
            # The variance of Student's t with ν degrees of freedom is ν/(ν − 2).
            return self.deviation * math.sqrt(1.0 - 2.0 / self.amount) * rng.standard_t(self.amount, count)
        white = rng.standard_normal(count)
        if self.colour == 0.0:
            return self.deviation * white
        fresh = math.sqrt(1.0 - self.colour**2)
        white[0] /= fresh  # stationary from the first sample on
        coloured: Array = self.deviation * lfilter([fresh], [1.0, -self.colour], white)
        return coloured

    def whitened(self, y: Array) -> Array:
        """Return ``y`` filtered such that noise and rounding together become white of unit variance, shape as ``y``.

        A first-order process plus white noise is a process of order (1, 1); its innovations have the variance s² and
        the moving-average coefficient θ with ``s² |1 − θ z|² = σ² (1 − φ²) + step²/12 |1 − φ z|²``. The noise of any
        other family counts as white of its total deviation, jitter left out.
        """
        phi, rounding = self.colour, self.step**2 / 12.0
        if phi == 0.0:
            return y / math.sqrt(self.deviation**2 + rounding)
        if rounding == 0.0:
            theta, variance = 0.0, self.deviation**2 * (1.0 - phi**2)
        else:
            sum_of_squares = self.deviation**2 * (1.0 - phi**2) + rounding * (1.0 + phi**2)
            product = rounding * phi
            theta = (sum_of_squares - math.sqrt(sum_of_squares**2 - 4.0 * product**2)) / (2.0 * product)
            variance = product / theta
        filtered: Array = lfilter([1.0, -phi], [1.0, -theta], y, axis=0) / math.sqrt(variance)
        return filtered


def pink(count: int, rng: Rng) -> Array:
    """Draw Gaussian noise of unit variance whose spectrum falls as 1/f, (count,), from twice the duration to Nyquist.

    It is periodic over twice the length, of which one half is returned: its ends do not meet.
    """
    size = 2 * count
    line = np.arange(1, count, dtype=np.float64)  # neither a mean nor Nyquist's line
    lines = rng.standard_normal((2, line.size)) / np.sqrt(line)
    spectrum = np.zeros(count + 1, dtype=np.complex128)
    spectrum[1:-1] = lines[0] + 1j * lines[1]
    # irfft gives each line the variance 4/(k size²).
    scale = size / (2.0 * math.sqrt(float(np.sum(1.0 / line))))
    drawn: Array = scale * np.fft.irfft(spectrum, size)[:count]
    return drawn


@dataclass(frozen=True)
class Family:
    """What the amount of a family is.

    Attributes:
        words: what the amount means; empty where there is none.
        low, high: open range of amounts.
        drawn: the amount where none is asked for.
    """

    words: str
    low: float
    high: float
    drawn: Callable[[Rng], float]


FAMILIES = {
    WHITE: Family("", 0.0, 0.0, lambda rng: 0.0),
    FIRST_ORDER: Family("coefficient", 0.0, 1.0, lambda rng: float(rng.uniform(0.3, 0.8))),
    PROCESS: Family("share of the power that passes through the plant", 0.0, 1.0, lambda rng: 0.1),
    PINK: Family("share of the power that is 1/f", 0.0, 1.0, lambda rng: 0.1),
    HEAVY: Family("degrees of freedom", 2.0, 1e3, lambda rng: 3.0),
    QUANTISED: Family("least step over deviation", 0.0, 100.0, lambda rng: float(rng.uniform(1.0, 3.0))),
    JITTERED: Family(
        "jitter over deviation in the fastest recording", 0.0, 100.0, lambda rng: float(rng.uniform(1.0, 2.0))
    ),
}


def asked(text: str) -> tuple[str, float | None]:
    """Return family and amount of ``FAMILY`` or ``FAMILY:AMOUNT``; the amount is None where it is to be drawn.

    Raises:
        InputRefused: unknown family, or an amount that is no number or out of range.
    """
    name, colon, written = text.partition(":")
    if name not in FAMILIES:
        raise InputRefused(f"noise = {text!r}: take one of {', '.join(FAMILIES)}, with an amount as in process:0.1")
    if not colon:
        return name, None
    family = FAMILIES[name]
    try:
        amount = float(written)
    except ValueError:
        amount = float("nan")
    if not family.low < amount < family.high:
        wanted = f"give a {family.words} between {family.low:g} and {family.high:g}" if family.words else "give none"
        raise InputRefused(f"noise = {text!r}: {wanted}")
    return name, amount


def of_family(text: str, plain: Noise, rng: Rng) -> Noise:
    """Return noise of the family that is asked for, with deviation and least step of ``plain`` noise.

    Only the least step of the family ``quantised`` is its own, a whole number of nanometres.
    """
    name, stated = asked(text)
    amount = FAMILIES[name].drawn(rng) if stated is None else stated
    if name in (WHITE, FIRST_ORDER):
        return replace(plain, colour=amount)
    step = plain.step
    if name == QUANTISED:
        step = max(1, round(amount * plain.deviation / _NANOMETRE)) * _NANOMETRE
        amount = step / plain.deviation
    return Noise(plain.deviation, step, 0.0, name, amount)


Outputs = tuple[Array, ...]


def disturbed(
    noise: Noise,
    base: Mapping[str, float],
    plan: Sequence[Excitation],
    calm: Outputs,
    simulated: Callable[[Sequence[Disturbance]], Outputs],
    streams: Callable[[str, int], Rng],
) -> Outputs:
    """Simulate the recordings once more, with the disturbance of the noise's family; ``calm`` where it has none.

    The force is white samples every 25 µs, straight in between, scaled by one pilot simulation: white force of variance
    ``a²`` and sample time ``h`` gives an oscillator the variance ``a² h/(2 b k)``. Errors of the instants are
    independent and Gaussian, of one size in all recordings.

    Args:
        noise: decides the kind and the size.
        base: parameters of the actuator; they give the force's first guess.
        calm: outputs without disturbance.
        simulated: outputs with disturbances, one per recording.
        streams: random numbers by use and number of the recording.

    Returns:
        Outputs of each recording, (samples,), m.
    """
    if noise.family == PROCESS:
        wanted = noise.amount * noise.deviation**2
        size = math.sqrt(2.0 * base["b"] * stuck_stiffness(base) * wanted / FORCE_STEP)
        counts = [math.ceil(excitation.pieces[-1].end / FORCE_STEP) + 2 for excitation in plan]
        unit = [streams("force", i).standard_normal(count) for i, count in enumerate(counts)]
        pilot = simulated([Disturbance(force=size * force) for force in unit])
        size *= math.sqrt(wanted / added_power(pilot, calm))
        return simulated([Disturbance(force=size * force) for force in unit])
    if noise.family == JITTERED:
        fastest = max(float(np.sqrt(np.mean(np.gradient(q, e.dt) ** 2))) for e, q in zip(plan, calm, strict=True))
        size = noise.amount * noise.deviation / fastest
        late = [size * streams("late", i).standard_normal(e.samples) for i, e in enumerate(plan)]
        return simulated([Disturbance(late=errors) for errors in late])
    return calm


def added_power(outputs: Sequence[Array], calm: Sequence[Array]) -> float:
    """Return the mean square of what was added, each recording without its mean, m²."""
    added = [q - q_0 for q, q_0 in zip(outputs, calm, strict=True)]
    return float(np.mean(np.concatenate([d - d.mean() for d in added]) ** 2))
