"""Learned elements: generic one-ports and blocks with a few strengths, for physics that the catalogue does not list.

Each is an ordinary `Effect`: a sum of fixed functions, spaced over the recorded range, with fitted strengths. Bounds on
the strengths keep every fit passive (`J = −Jᵀ`, `D ≥ 0`, `H` bounded below) and the characteristic of every block
increasing.
"""

from __future__ import annotations

from functools import cache

from phnn.effects import Effect, gathered

__all__ = ["learned_elements"]


@cache
def learned_elements() -> dict[str, Effect]:
    """All learned elements by name; none of them is in the catalogue."""
    return gathered(__name__, __path__)
