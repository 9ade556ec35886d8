"""Learned elements: generic one-ports and blocks with a few strengths, for physics that the catalogue does not list.

Each is an ordinary `Effect`: a sum of fixed functions, spaced over what was recorded, with strengths that are fitted.
The strengths are bounded so that no fit can make the network active (`J = −Jᵀ`, `D ≥ 0`, `H` bounded below), or the
characteristic of a block fall.
"""

from __future__ import annotations

from functools import cache

from phnn.effects import Effect, gathered

__all__ = ["learned_elements"]


@cache
def learned_elements() -> dict[str, Effect]:
    """All learned elements by name; none of them is in the catalogue."""
    return gathered(__name__, __path__)
