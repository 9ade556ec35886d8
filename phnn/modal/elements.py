"""The elements that may act at a port, by the names of the catalogue.

An element is a sum of parts on the same extension x, each with a weight k ≥ 0. All are passive whatever their weights,
the slow one in a steady cycle only:

    stop         ṡ = ẋ while |s| < r, energy ½ k s²            softens and loses energy, the same at every rate
    softening    s = x / √(1 + (x/r)²), energy k r² (√(1 + (x/r)²) − 1)
    hardening    s = x³, energy ¼ k x⁴
    drag         s = |ẋ| ẋ, no energy
    slow         s = x / (1 + ⟨x²⟩/r²), ⟨x²⟩ of the period before: a spring that is linear within a period and softens
                 with what has gone before, as one does that warms; its energy is ½ k s x while ⟨x²⟩ stays the same,
                 and what that changes when it does not belongs to a store that the model leaves out
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STOP, SOFTENING, HARDENING, DRAG, SLOW = range(5)

# Thresholds over the effective extension at the lowest level, from smallest to largest; the softening springs' number.
_STOPS, _SPRINGS, _SPRING_COUNT, _SLOW = (0.1, 10.0), (0.5, 8.0), 3, 8.0
# How stiff an element is at the start, over the stiffness of its port.
_STIFFNESS = 0.03


@dataclass(frozen=True, eq=False)
class PortElement:
    """An element on the extension of every port.

    Attributes:
        names: effects of the catalogue; none for the linear model.
        kinds: (count,) of its parts; reach: (count,) threshold of each over the extension at the lowest level.
    """

    names: tuple[str, ...]
    kinds: NDArray[np.int64]
    reach: Array

    @property
    def name(self) -> str:
        """In files and tables."""
        return "+".join(self.names) or "linear"

    def __add__(self, other: PortElement) -> PortElement:
        return PortElement(
            self.names + other.names,
            np.concatenate([self.kinds, other.kinds]),
            np.concatenate([self.reach, other.reach]),
        )

    def parts_of(self, name: str) -> NDArray[np.bool_]:
        """(count,) which parts belong to an effect."""
        return np.isin(self.kinds, _KINDS[name])

    def without(self, name: str) -> PortElement:
        """The element less one effect."""
        kept = ~self.parts_of(name)
        return PortElement(tuple(n for n in self.names if n != name), self.kinds[kept], self.reach[kept])

    def start(self, stiffness: Array, x: Array, v: Array) -> Array:
        """(P, count) weights that give a few per cent of a port's own force.

        Args:
            stiffness: (P,) of the ports; x, v: (P,) effective extension and its rate at the highest level.
        """
        size = np.ones((x.size, self.kinds.size))
        size[:, self.kinds == HARDENING] = (1.0 / x**2)[:, None]
        size[:, self.kinds == DRAG] = (x / v**2)[:, None]
        return np.asarray(_STIFFNESS * stiffness[:, None] * size / max(self.kinds.size, 1))


# Parts by the name of their effect.
_KINDS = {
    "extra_hysteron": (STOP,),
    "cubic_stiffness": (SOFTENING, HARDENING),
    "quadratic_drag": (DRAG,),
    "self_heating": (SLOW,),
}

LINEAR = PortElement((), np.zeros(0, dtype=np.int64), np.zeros(0))

STATEMENTS = {
    "extra_hysteron": "hysterons store and lose energy as stops do, the same at every rate: with amplitude they "
    "soften and dissipate",
    "cubic_stiffness": "springs that soften or harden with amplitude, without loss",
    "quadratic_drag": "dampers that grow with the rate",
    "self_heating": "springs that soften slowly with the mean square of their motion and are linear within a period, "
    "as a material does that warms",
}


def elements(stops: int) -> tuple[PortElement, ...]:
    """One for each effect.

    Args:
        stops: of a hysteron element.
    """
    springs = np.geomspace(*_SPRINGS, _SPRING_COUNT)
    return (
        PortElement(("extra_hysteron",), np.full(stops, STOP), np.geomspace(*_STOPS, stops)),
        PortElement(
            ("cubic_stiffness",),
            np.array([SOFTENING] * springs.size + [HARDENING]),
            np.append(springs, 0.0),
        ),
        PortElement(("quadratic_drag",), np.array([DRAG]), np.zeros(1)),
        PortElement(("self_heating",), np.array([SLOW]), np.array([_SLOW])),
    )
