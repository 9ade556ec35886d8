"""Formulas of learned forces in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phnn.diagnosis.distil.search import Formula

Array = NDArray[np.float64]

_SPEED = {
    0.0: "friction that does not depend on the speed",
    0.5: "a damping force that grows with the root of the speed",
    1.0: "viscous damping",
    1.5: "a damping force that grows with the power 1.5 of the speed",
    2.0: "drag that grows with the square of the speed",
    3.0: "drag that grows with the cube of the speed",
}
_POWERS = {0.5: "root", 1.0: "first power", 1.5: "power 1.5", 2.0: "square", 3.0: "cube"}
_SIDES = {
    "plain": "",
    "forwards": "in the positive direction only",
    "backwards": "in the negative direction only",
    "right": "and grows in proportion to the displacement, where that is positive",
    "left": "and grows in proportion to the displacement, where that is negative",
}
_SPRINGS = {
    "odd": "a force against the displacement that grows with its {}",
    "even": "a force that grows with the {} of the displacement, in the same direction on both sides",
    "right": "a force against the displacement that grows with its {}, where it is positive",
    "left": "a force against the displacement that grows with its {}, where it is negative",
}


def in_words(formula: Formula, displacement: str) -> str:
    """A sentence that says what the formula says.

    Args:
        displacement: the reference of displacements, with its unit.
    """
    parts, first = [], 0
    for term, size, shapes in formula.by_term:
        texts = [_number(formula, first + k, float(x)) for k, x in enumerate(shapes)]
        first += shapes.size
        if term.kind == "dissipative":
            parts.append(_damper(term.name, shapes, texts))
        else:
            parts.append(_spring(term.name, float(shapes[0]), texts[0], size, displacement))
    text = "; and ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _number(formula: Formula, i: int, value: float) -> str:
    """A value; where it is not a round one, with its interval."""
    low, high = formula.intervals[i]
    return f"{value:g}" if formula.fixed[i] else f"{value:.2f} ({low:.2f} to {high:.2f})"


def _damper(name: str, shapes: Array, texts: list[str]) -> str:
    n = float(shapes[0])
    speed = _SPEED.get(n, f"a damping force that grows with the power {texts[0]} of the speed")
    where = _SIDES.get(name, "")
    if name == "distance":
        power = _POWERS.get(float(shapes[1]), f"power {texts[1]}")
        where = f"and grows with the {power} of the distance from zero"
    # Damping as such does nothing yet to which growing could be added.
    where = where.replace("and grows", "that grows") if n == 1.0 else where
    return f"{speed} {where}".strip()


def _spring(name: str, shape: float, text: str, size: float, displacement: str) -> str:
    if name.startswith("stop"):
        side = "negative" if name.endswith("left") else "positive"
        change = "stiffer" if size > 0.0 else "softer"
        return f"a spring that is {change} beyond {text} of {displacement} on the {side} side"
    said = _SPRINGS[name].format(_POWERS.get(shape, f"power {text}"))
    return said if size > 0.0 else said.replace("against", "along", 1)
