"""Strengths of learned elements: parameters that multiply fixed functions, with equal and small start values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from phnn.effects import Declared, Placed, bounded, constant
from phnn.parameters import Parameter
from phnn.setup import Setup

# Start value of strengths that a start does not emphasise, as a share of the others. It is not zero, where a bounded
# optimiser moves slowly.
_FAINT = 0.1
# Lower bound of strengths by which a law divides, as a share of the typical strength: too small to be seen in a
# recording.
NEARLY_ZERO = 1e-9


def strengths(
    names: Iterable[str], unit: str, description: str, most: float = math.inf, typical: float = 1.0
) -> tuple[Declared, ...]:
    """Strengths that cannot be negative, or larger than ``most``; zero switches a function off."""
    return tuple(bounded(n, unit, description, 0.0, most, typical, strength=True) for n in names)


def either(limits: Mapping[str, float], unit: str, description: str, typical: float) -> tuple[Declared, ...]:
    """Strengths of either sign, up to a limit each."""
    return tuple(bounded(n, unit, description, -most, most, typical, strength=True) for n, most in limits.items())


def constants(names: Iterable[str], unit: str, description: str) -> tuple[Declared, ...]:
    """Constant parameters of one sort, which are never estimated."""
    return tuple(constant(n, unit, description) for n in names)


def named(declared: Iterable[Declared]) -> tuple[str, ...]:
    """Names of parameters."""
    return tuple(d.name for d in declared)


def stiffness_of(setup: Setup) -> float:
    """Stiffness of the base model [N/m], 1 if it has none: the scale of learned forces."""
    found = setup.parameters.get("k")
    return found.value if found is not None and found.value > 0.0 else 1.0


def sized(parameters: Placed, typical: float) -> dict[str, Parameter]:
    """The parameters; for the estimated ones, ``typical`` is a noticeable change."""
    return {n: p if p.fixed else replace(p, typical=typical) for n, p in parameters.items()}


def starts(
    strengths: Sequence[Declared],
    value: float,
    stressed: Iterable[Iterable[str]],
    constants: Mapping[str, float],
) -> list[dict[str, float]]:
    """Grid points: all strengths equal, and then each group of them emphasised in turn.

    Args:
        value: size of the strengths.
        stressed: groups of their names.
        constants: the element's other parameters.
    """
    names = named(strengths)
    faint = dict.fromkeys(names, _FAINT * value)
    points = [dict.fromkeys(names, value), *(faint | dict.fromkeys(group, value) for group in stressed)]
    return [{**point, **constants} for point in points]


def each(
    strengths: Sequence[Declared], value: float, constants: Mapping[str, float], groups: Iterable[Iterable[str]] = ()
) -> list[dict[str, float]]:
    """Grid points of strengths of either sign: one for each strength, or for each group of their names."""
    names = named(strengths)
    none = dict.fromkeys(names, 0.0)
    alone = tuple(groups) or tuple((n,) for n in names)
    return [{**none, **dict.fromkeys(group, value), **constants} for group in alone]


@dataclass(frozen=True)
class Within:
    """Multiplication of strengths, limited by their bounds.

    If no strength can be negative, a negative factor leaves them unchanged. The data then ask for a smaller sum, which
    does not determine the single strengths, and a bounded optimiser hardly moves from start values near the bounds.

    Attributes:
        strengths: the strengths to multiply.
        may_vanish: whether a negative factor sets a single strength to zero.
    """

    strengths: tuple[Declared, ...]
    may_vanish: bool = False

    def __call__(self, values: Mapping[str, float], factor: float) -> dict[str, float]:
        one_sided = all(d.lower >= 0.0 for d in self.strengths)
        by = 1.0 if one_sided and factor <= 0.0 and not self.may_vanish else factor
        return {**values, **{d.name: min(max(by * values[d.name], d.lower), d.upper) for d in self.strengths}}
