"""Where to begin a refit of a strong effect: strengths far from those that the score extrapolates to.

A base model that has taken over much of a strong effect is so far off that the score, a first derivative at strength
zero, knows neither its strength nor its shape. Finite strengths are asked instead, at every point of the grid.
"""

from __future__ import annotations

import numpy as np

from phnn.diagnose.ground import direction, prepare
from phnn.effects import Effect
from phnn.errors import PhnnError
from phnn.identify.fit import Fit

# Multiples of the grid's strengths, which are small ones; how many starts are proposed.
_STRENGTHS = (30.0, 100.0)
_BOLD = 8


def has_bold_starts(effect: Effect) -> bool:
    """Whether an effect has a strength to choose, and no frequency that is found elsewhere than in its grid."""
    return effect.strength is not None and effect.searched is None


def bold_starts(base: Fit, effect: Effect) -> list[dict[str, float]]:
    """Values of the effect's parameters, the most promising shape first, each at the strength that suits it best.

    Promising is what leaves the least ``‖r − P δy‖²``: the change ``δy`` of the output by the effect at that strength,
    base sensitivities projected out. An effect with a single shape gets none.

    Args:
        base: the fit without the effect.
    """
    ground = prepare(base)
    grid = effect.grid(ground.scales)
    if len(grid) == 1:
        return []

    def left(values: dict[str, float]) -> float:
        try:
            change = ground.project(direction(ground, effect, values))
        except PhnnError:
            return float("inf")
        squares = float(np.sum((ground.residual - change) ** 2))
        return squares if change.any() and np.isfinite(squares) else float("inf")

    strengths = _STRENGTHS if effect.one_sided else (*_STRENGTHS, *(-s for s in _STRENGTHS))
    tried = [[effect.scaled(point, s) for s in strengths] for point in grid]
    costs = [[left(values) for values in points] for points in tried]
    order = sorted(range(len(grid)), key=lambda i: min(costs[i]))
    return [tried[i][int(np.argmin(costs[i]))] for i in order[:_BOLD] if np.isfinite(min(costs[i]))]
