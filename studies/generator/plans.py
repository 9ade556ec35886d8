"""Sets of recordings; those of the benchmark vary a little from case to case."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from phnn.errors import InputRefused
from studies.generator.excitation import PEAK, Excitation, Piece, chirp, sine, step
from studies.generator.kinked import KINKED

# The names of recordings that an examination keeps back begin so.
EXAM = "exam_"
_DT = 1e-4  # s, sampling interval of the benchmark
_LEAST = 0.3  # s, shortest sine of the benchmark
_VARIED = 0.1  # each frequency moves by up to this part of itself

Rng = np.random.Generator


def _demo() -> tuple[Excitation, ...]:
    sines = tuple(sine(f) for f in (1.0, 10.0, 25.0, 50.0, 75.0, 100.0, 150.0))
    return (*sines, sine(10.0, 25.0), sine(10.0, 50.0), sine(50.0, 40.0), step(), chirp())


def _short() -> tuple[Excitation, ...]:
    return sine(10.0), sine(100.0), sine(10.0, 50.0), step(before=0.05, hold=0.3, after=0.15)


def _varied_sine(rng: Rng, frequency: float, amplitude: float = PEAK) -> Excitation:
    """Three periods, or as many as last 0.3 s, at 10 kHz; the frequency has three digits, so that names are true."""
    chosen = float(f"{frequency * rng.uniform(1.0 - _VARIED, 1.0 + _VARIED):.3g}")
    duration = max(3, math.ceil(_LEAST * chosen)) / chosen
    piece = Piece(0.0, duration, amplitude=amplitude, frequency=chosen)
    return Excitation(f"sine_{chosen:g}Hz_{amplitude:g}V", (piece,), _DT, math.floor(duration / _DT))


def _full(rng: Rng) -> tuple[Excitation, ...]:
    sines = tuple(_varied_sine(rng, f) for f in (1.0, 10.0, 25.0, 50.0, 75.0, 100.0, 150.0))
    weaker = tuple(_varied_sine(rng, *of) for of in ((10.0, 25.0), (10.0, 50.0), (50.0, 40.0), (1.0, 40.0)))
    return (*sines, *weaker, step(), chirp(dt=_DT))


def _few(rng: Rng) -> tuple[Excitation, ...]:
    return _varied_sine(rng, 10.0), _varied_sine(rng, 100.0, 40.0)


def _one() -> tuple[Excitation, ...]:
    return (chirp(PEAK, duration=1.0),)


def _exam() -> tuple[Excitation, ...]:
    """Recordings that an examination keeps back: other frequencies and amplitudes than any plan has."""
    recordings = (sine(18.0, 65.0), sine(66.0, 35.0), chirp(50.0, 2.0, 140.0, 0.5))
    return tuple(replace(r, name=f"{EXAM}{r.name}") for r in recordings)


PLANS: dict[str, Callable[[], tuple[Excitation, ...]]] = {"demo": _demo, "short": _short, "one": _one}
VARIED: dict[str, Callable[[Rng], tuple[Excitation, ...]]] = {"full": _full, "few": _few}


def _examined(base: str, rng: Rng) -> tuple[Excitation, ...]:
    return (*plan_of(base, rng), *_exam())


def _with(base: str, kind: str, rng: Rng) -> tuple[Excitation, ...]:
    """A plan with another recording instead of the held step; it is drawn last, so that the others stay the same."""
    plan = plan_of(base, rng)
    other = KINKED[kind](rng)
    return tuple(other if excitation.held else excitation for excitation in plan)


VARIED |= {f"{base}_{kind}": partial(_with, base, kind) for base in ("full", "short") for kind in KINKED}
VARIED |= {f"{base}_exam": partial(_examined, base) for base in ("demo", "short", "one")}


def plan_of(name: str, rng: Rng | None = None) -> tuple[Excitation, ...]:
    """The recordings of a plan.

    Args:
        name: "demo" (12 recordings, 41,000 samples), "short" (4, 8,500), "one" (1, 5,000), "full" (13, some 113,000) or
            "few" (2, 6,000); "demo_exam", "short_exam" and "one_exam" have three more, whose names begin with `EXAM`;
            "full_KIND" and "short_KIND" have a recording of `kinked` in the place of the held step, KIND is
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
