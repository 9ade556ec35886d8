"""Strengths of learned elements: parameters that multiply fixed functions and start out equal and small."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from phnn.parameters import Parameter
from phnn.setup import Setup

# Strengths that a start does not stress, as a share of the others: not zero, where a bounded optimiser moves slowly.
_FAINT = 0.1
# Lower bound of strengths by which a law divides, as a share of the typical strength: nothing that a recording shows.
NEARLY_ZERO = 1e-9


def strength(name: str, value: float, unit: str, typical: float, description: str, lower: float = 0.0) -> Parameter:
    """A strength that cannot be negative; zero switches its function off."""
    return Parameter(name, value, unit, lower, typical=typical, description=description)


def stiffness_of(setup: Setup) -> float:
    """Stiffness of the base model [N/m], 1 where it has none: the size in which learned forces are measured."""
    found = setup.parameters.get("k")
    return found.value if found is not None and found.value > 0.0 else 1.0


def starts(
    names: Sequence[str],
    value: float,
    stressed: Iterable[Iterable[str]],
    constants: Mapping[str, float],
) -> list[dict[str, float]]:
    """Grid points: all strengths equal, and then each group of them stressed in turn.

    Args:
        names: of the strengths.
        value: their size.
        stressed: groups of names.
        constants: the element's other parameters.
    """
    faint = dict.fromkeys(names, _FAINT * value)
    points = [dict.fromkeys(names, value), *(faint | dict.fromkeys(group, value) for group in stressed)]
    return [{**point, **constants} for point in points]


def each(
    names: Sequence[str], groups: Iterable[Iterable[str]], value: float, constants: Mapping[str, float]
) -> list[dict[str, float]]:
    """Grid points of strengths of either sign: each group of them alone."""
    none = dict.fromkeys(names, 0.0)
    return [{**none, **dict.fromkeys(group, value), **constants} for group in groups]


def within(limits: Mapping[str, tuple[float, float]]) -> Callable[[Mapping[str, float], float], dict[str, float]]:
    """How to multiply strengths: no farther than to their limits.

    Where no strength can be negative, a negative factor leaves them as they are: the data ask for less of their sum,
    which says nothing of each, and from next to its bounds a bounded optimiser hardly moves.

    Args:
        limits: lowest and highest value of every strength.
    """
    one_sided = all(low >= 0.0 for low, _ in limits.values())

    def rescale(values: Mapping[str, float], factor: float) -> dict[str, float]:
        by = 1.0 if one_sided and factor <= 0.0 else factor
        return {**values, **{n: min(max(by * values[n], low), high) for n, (low, high) in limits.items()}}

    return rescale


def of_any_size(names: Iterable[str]) -> Callable[[Mapping[str, float], float], dict[str, float]]:
    """How to multiply strengths that cannot be negative and have no upper limit."""
    return within(dict.fromkeys(names, (0.0, math.inf)))
