"""Formulas that can replace learned elements: they describe the physics of an element and never name it.

Each is an ordinary `Effect` with few parameters, at the location and of the kind of the learned element that it may
replace. They are not in the catalogue and take no part in a search.
"""

from __future__ import annotations

from functools import cache

from phnn.effects import Effect, gathered, in_all_forms

__all__ = ["formulas", "formulas_for"]


@cache
def formulas() -> dict[str, Effect]:
    """All formulas by name."""
    return gathered(__name__, __path__)


def formulas_for(element: Effect) -> list[Effect]:
    """The formulas that may replace a learned element, in all forms."""
    return [f for f in in_all_forms(formulas().values()) if f.kind == element.kind]
