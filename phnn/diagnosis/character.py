"""The character of a learned curve in words: odd or even, threshold, growth, time of memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Below this part of the range a curve is taken as the straight line that base parameters can absorb.
_INNER = 0.3
# Share of a curve's square that the lesser of its odd and even parts, or of its sides, may have and be left out.
_LITTLE, _OTHER_SIDE = 0.1, 0.05
# How much less an onset or a levelling off must leave than a power, which has no scale of its own.
_CLEARLY = 0.5
# A memory that forgets from a tenth to nine tenths over more than this factor of time has no one time constant.
_DECADES = 100.0


@dataclass(frozen=True)
class Shape:
    """``y ≈ a f(s)`` on ``0 ≤ s ≤ 1`` with the kind of ``f`` that leaves least.

    Attributes:
        kind: ``"power"``: ``s^p``; ``"onset"``: ``max(s − p, 0)``; ``"level"``: ``tanh(s/p)``.
        at: the parameter ``p``.
    """

    kind: str
    at: float


@dataclass(frozen=True)
class Character:
    """What a function of one variable is like.

    Attributes:
        even: share of its square that is even.
        side: 1 or −1 where it acts for one sign of the variable only, else 0.
        shape: on the side, or of the odd or even part, over the range of the variable.
        size: largest value.
    """

    even: float
    side: int
    shape: Shape
    size: float


def without_line(x: Array, y: Array) -> Array:
    """A curve without the straight line through its inner part, which base parameters can absorb.

    Args:
        x: (M,) symmetric about zero; y: (M,).
    """
    inner = np.abs(x) <= _INNER * np.abs(x).max()
    return np.asarray(y - np.polyval(np.polyfit(x[inner], y[inner], 1), x))


def character_of(x: Array, y: Array) -> Character:
    """The character of a curve.

    Args:
        x: (M,) symmetric about zero, increasing; y: (M,), not zero everywhere.
    """
    odd, even = 0.5 * (y - y[::-1]), 0.5 * (y + y[::-1])
    share = float(even @ even / (y @ y))
    up, down = y[x >= 0.0], y[::-1][x >= 0.0]
    above, below = float(up @ up), float(down @ down)
    least = _OTHER_SIDE * (above + below)
    side = 1 if below < least else -1 if above < least else 0
    half = down if side < 0 or (side == 0 and below > above) else up
    if side == 0 and min(share, 1.0 - share) < _LITTLE:
        half = (even if share > 0.5 else odd)[x >= 0.0]
    return Character(share, side, shape_of(x[x >= 0.0] / x[-1], half), float(np.abs(y).max()))


def shape_of(s: Array, y: Array) -> Shape:
    """The kind of function that a half curve follows best.

    Args:
        s: (M,) from 0 to 1; y: (M,).
    """
    powers = [Shape("power", p) for p in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)]
    onsets = [Shape("onset", float(p)) for p in np.arange(0.1, 0.96, 0.025)]
    levels = [Shape("level", float(p)) for p in np.geomspace(1e-3, 0.5, 25)]
    kinds = {id(shape): _left(shape, s, y) for shape in (*powers, *onsets, *levels)}
    power, onset, level = (min(group, key=lambda f: kinds[id(f)]) for group in (powers, onsets, levels))
    other = min((onset, level), key=lambda f: kinds[id(f)])
    return other if kinds[id(other)] < _CLEARLY * kinds[id(power)] else power


def _left(shape: Shape, s: Array, y: Array) -> float:
    """What the shape, scaled, leaves of the curve's square."""
    f = {
        "power": lambda: s**shape.at,
        "onset": lambda: np.maximum(s - shape.at, 0.0),
        "level": lambda: np.tanh(s / shape.at),
    }[shape.kind]()
    rest = y - f * (f @ y) / max(float(f @ f), 1e-300)
    return float(rest @ rest)


def forgetting(t: Array, y: Array) -> tuple[float, float, float] | None:
    """Times after which a tenth, a half and nine tenths of a response to a step are gone; None where it does not decay.

    Args:
        t: (M,) increasing; y: (M,).
    """
    left = np.abs(y) / max(float(np.abs(y[0])), 1e-300)
    if left.max() > 1.5 or left[-1] > 0.5:
        return None
    # What the recordings are too short to see forgotten counts as gone with their end.
    gone = [int(np.argmax(left <= level)) if (left <= level).any() else t.size - 1 for level in (0.9, 0.5, 0.1)]
    return float(t[gone[0]]), float(t[gone[1]]), float(t[gone[2]])


def in_words(found: Character, variable: str, reach: str, size: str, at: str) -> str:
    """The character as a sentence.

    Args:
        variable: what it is a function of; reach: the largest value of that, with unit; size: of the curve, with unit.
        at: the value of the variable at the shape's parameter, with unit.
    """
    if found.side:
        parity = f"acts for {'positive' if found.side > 0 else 'negative'} {variable} only"
    elif found.even > 1.0 - _LITTLE:
        parity = f"is even in the {variable}"
    elif found.even < _LITTLE:
        parity = f"is odd in the {variable}"
    else:
        parity = f"is neither odd nor even in the {variable} ({100 * found.even:.0f} % of its square is even)"
    growth = {
        "power": "is there from the start and " + _growth(found.shape.at),
        "onset": f"sets in at {at} and grows from there",
        "level": f"levels off beyond {at}",
    }[found.shape.kind]
    return f"It {parity}, {growth}; at {reach} it has reached {size}."


def _growth(power: float) -> str:
    words = {1.0: "grows in proportion", 2.0: "grows with the square", 3.0: "grows with the cube"}
    return words.get(power, f"grows with the power {power:g}")


def memory_in_words(times: tuple[float, float, float] | None, spoken: tuple[str, str, str]) -> str:
    """How a response to a step decays, as a sentence.

    Args:
        times: of `forgetting`; spoken: the same with units.
    """
    if times is None:
        return "Its response to a step does not simply decay within the recordings."
    tenth, half, most = spoken
    how = "over decades of time" if times[2] > _DECADES * times[0] else "as with one time constant"
    return f"It forgets a step {how}: a tenth of it in {tenth}, half in {half}, most in {most}."
