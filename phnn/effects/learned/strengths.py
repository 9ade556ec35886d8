"""Strengths of learned elements: parameters that multiply fixed functions and start out equal and small."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from phnn.effects import Declared, Placed, bounded, constant
from phnn.parameters import Parameter
from phnn.setup import Setup

# Strengths that a start does not stress, as a share of the others: not zero, where a bounded optimiser moves slowly.
_FAINT = 0.1
# Lower bound of strengths by which a law divides, as a share of the typical strength: nothing that a recording shows.
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
    """Parameters of one sort that are never estimated."""
    return tuple(constant(n, unit, description) for n in names)


def named(declared: Iterable[Declared]) -> tuple[str, ...]:
    """Names of parameters."""
    return tuple(d.name for d in declared)


def stiffness_of(setup: Setup) -> float:
    """Stiffness of the base model [N/m], 1 where it has none: the size in which learned forces are measured."""
    found = setup.parameters.get("k")
    return found.value if found is not None and found.value > 0.0 else 1.0


def sized(parameters: Placed, typical: float) -> dict[str, Parameter]:
    """Parameters of which those that are estimated change noticeably by ``typical``."""
    return {n: p if p.fixed else replace(p, typical=typical) for n, p in parameters.items()}


def starts(
    strengths: Sequence[Declared],
    value: float,
    stressed: Iterable[Iterable[str]],
    constants: Mapping[str, float],
) -> list[dict[str, float]]:
    """Grid points: all strengths equal, and then each group of them stressed in turn.

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
    """Grid points of strengths of either sign: each of them alone, or each group of their names."""
    names = named(strengths)
    none = dict.fromkeys(names, 0.0)
    alone = tuple(groups) or tuple((n,) for n in names)
    return [{**none, **dict.fromkeys(group, value), **constants} for group in alone]


@dataclass(frozen=True)
class Within:
    """How to multiply strengths: no farther than to their bounds.

    Where no strength can be negative, a negative factor leaves them as they are: the data ask for less of their sum,
    which says nothing of each, and from next to its bounds a bounded optimiser hardly moves.

    Attributes:
        strengths: those that are multiplied.
        may_vanish: a negative factor makes them zero all the same: there is one of them alone.
    """

    strengths: tuple[Declared, ...]
    may_vanish: bool = False

    def __call__(self, values: Mapping[str, float], factor: float) -> dict[str, float]:
        one_sided = all(d.lower >= 0.0 for d in self.strengths)
        by = 1.0 if one_sided and factor <= 0.0 and not self.may_vanish else factor
        return {**values, **{d.name: min(max(by * values[d.name], d.lower), d.upper) for d in self.strengths}}
