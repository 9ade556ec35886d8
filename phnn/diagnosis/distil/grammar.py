"""The terms of which formulas of a learned force are made: powers of the speed or the displacement with a factor.

A damper's term is ``F |v/v₀|ⁿ sign v`` times 1, a power of the displacement, a ramp on one side of it, or a direction.
A spring's term is a power of the displacement on both sides, odd or even, or on one side, or a ramp with an onset.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phnn.laws import RESISTOR_LAWS

Array = NDArray[Any]

# Values at which an exponent reads as a law that has a name.
NAMED = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
_SPEEDS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
_POSITIONS = (1.0, 2.0, 3.0)
_POWERS = (0.5, 1.5, 2.0, 3.0, 4.0)
_ONSETS = (0.2, 0.4, 0.6, 0.8)
# A power of zero has no derivative by its exponent.
_TINY = 1e-12


@dataclass(frozen=True)
class Shape:
    """A number in a term beside its size.

    Attributes:
        symbol: LaTeX.
        starts: values from which it is fitted; lower, upper: its bounds.
        exponent: whether it is one, else a displacement over the reference.
    """

    symbol: str
    starts: tuple[float, ...]
    lower: float
    upper: float
    exponent: bool = True


@dataclass(frozen=True)
class Term:
    """One term of a formula, a force [N] over its size.

    Attributes:
        name: of the kind of term.
        kind: of the learned element: ``dissipative`` or ``elastic``.
        shapes: its further numbers.
        force: ``(q/q₀, v, v₀, *shapes) -> (n,)``.
        latex: of the texts of its shapes.
        signed: whether its size may be negative.
    """

    name: str
    kind: str
    shapes: tuple[Shape, ...]
    force: Callable[..., Array]
    latex: Callable[..., str]
    signed: bool = False


def _speed(v: Array, v0: float, n: Any, forward: float = 1.0, backward: float = 1.0) -> Array:
    """``±|v/v₀|ⁿ`` as the dampers of the package have it, smoothed near rest."""
    return np.asarray(RESISTOR_LAWS["power_damper"].flow(v + 0.0 * n, 0.0, forward, backward, n, v0))


def _power(s: Array, m: Any) -> Array:
    """``sᵐ`` of ``s ≥ 0``."""
    return np.asarray(np.where(s > _TINY, np.maximum(s, _TINY) ** m, 0.0))


def _right(s: Array) -> Array:
    return np.maximum(s, 0.0)


_N = Shape("n", _SPEEDS, 0.0, 3.0)
_M = Shape("m", _POSITIONS, 0.3, 4.0)
_P = Shape("n", _POWERS, 0.0, 5.0)
_G = Shape("g", _ONSETS, 0.0, 0.95, exponent=False)


def _raised(base: str, text: str, odd: str = "") -> str:
    """LaTeX of a power of a magnitude, times the sign of ``odd`` where that is given."""
    if odd:
        return {"0": rf"\mathrm{{sign}}\,{odd}", "1": base}.get(
            text, rf"\left|{base}\right|^{{{text}}}\mathrm{{sign}}\,{odd}"
        )
    even = rf"\left({base}\right)^{{{text}}}" if text in ("2", "4") else rf"\left|{base}\right|^{{{text}}}"
    return {"0": "1", "1": rf"\left|{base}\right|"}.get(text, even)


_S, _W = r"\frac{q}{q_0}", r"\frac{v}{v_0}"


def _one_sided(text: str, inside: str) -> str:
    return rf"\max({inside}, 0)" + ("" if text == "1" else rf"^{{{text}}}")


_SPEED_TERMS = (
    Term("plain", "dissipative", (_N,), lambda s, v, v0, n: _speed(v, v0, n), lambda n: _raised(_W, n, "v")),
    Term(
        "forwards", "dissipative", (_N,), lambda s, v, v0, n: _speed(v, v0, n, 1.0, 0.0),
        lambda n: _raised(_W, n, "v") + r"\,[v > 0]",
    ),
    Term(
        "backwards", "dissipative", (_N,), lambda s, v, v0, n: _speed(v, v0, n, 0.0, 1.0),
        lambda n: _raised(_W, n, "v") + r"\,[v < 0]",
    ),
    Term(
        "distance", "dissipative", (_N, _M), lambda s, v, v0, n, m: _power(np.abs(s), m) * _speed(v, v0, n),
        lambda n, m: rf"{_raised(_S, m)}\,{_raised(_W, n, 'v')}",
    ),
    Term(
        "right", "dissipative", (_N,), lambda s, v, v0, n: _right(s) * _speed(v, v0, n),
        lambda n: rf"{_one_sided('1', _S)}\,{_raised(_W, n, 'v')}",
    ),
    Term(
        "left", "dissipative", (_N,), lambda s, v, v0, n: _right(-s) * _speed(v, v0, n),
        lambda n: rf"{_one_sided('1', '-' + _S)}\,{_raised(_W, n, 'v')}",
    ),
)  # fmt: skip
_POSITION_TERMS = (
    Term("odd", "elastic", (_P,), lambda s, v, v0, n: np.sign(s) * _power(np.abs(s), n),
         lambda n: _raised(_S, n, "q"), True),
    Term("even", "elastic", (_P,), lambda s, v, v0, n: _power(np.abs(s), n), lambda n: _raised(_S, n), True),
    Term("right", "elastic", (_P,), lambda s, v, v0, n: _power(_right(s), n), lambda n: _one_sided(n, _S), True),
    Term("left", "elastic", (_P,), lambda s, v, v0, n: -_power(_right(-s), n),
         lambda n: "-" + _one_sided(n, "-" + _S), True),
    Term("stop", "elastic", (_G,), lambda s, v, v0, g: _right(s - g), lambda g: _one_sided("1", f"{_S} - {g}"), True),
    Term("stop on the left", "elastic", (_G,), lambda s, v, v0, g: -_right(-s - g),
         lambda g: "-" + _one_sided("1", f"-{_S} - {g}"), True),
)  # fmt: skip

TERMS: Mapping[str, tuple[Term, ...]] = {"dissipative": _SPEED_TERMS, "elastic": _POSITION_TERMS}


def has_grammar(kind: str) -> bool:
    """Whether there are terms for a learned element of a kind."""
    return kind in TERMS
