"""The noise that a case asks for: ``process:0.1`` is a family and its amount."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from phnn.errors import InputRefused
from studies.generator.noise import FIRST_ORDER, HEAVY, JITTERED, PINK, PROCESS, QUANTISED, Noise

WHITE = "white"
_NANOMETRE = 1e-9

Rng = np.random.Generator


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
    """Family and amount of ``FAMILY`` or ``FAMILY:AMOUNT``; the amount is None where it is to be drawn.

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
    """Noise of the family that is asked for, with deviation and least step of ``plain`` noise.

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
