"""Start values for the refit of a strong effect: strengths far from those to which the score extrapolates.

A base model that has taken over much of a strong effect is so far off that the score, a first derivative at strength
zero, knows neither its strength nor its shape, and may even have the wrong sign. Finite strengths are asked instead, at
every point of the grid.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from phnn.criteria import REFITS, Refits
from phnn.diagnosis.linearised_fit import LinearisedFit, direction
from phnn.effects import Effect
from phnn.errors import PhnnError
from phnn.recall import recalled
from phnn.setup import Setup

# Multiples of the grid's strengths, which are small ones.
_STRENGTHS = tuple(10.0 ** (0.5 * k) for k in range(1, 10))


def has_large_starts(effect: Effect) -> bool:
    """Whether an effect has a strength to choose, and no frequency that is found elsewhere than in its grid."""
    return effect.strength is not None and effect.searched is None


@recalled
def large_starts(linearised: LinearisedFit, effect: Effect, limits: Refits = REFITS) -> list[dict[str, float]]:
    """Values of the effect's parameters, the most promising shape and sign first.

    Each has the strength at which the change ``P δy`` of the output by the effect, base sensitivities projected out, is
    about as large as the residual ``r``. Promising is what leaves the least ``‖r − P δy‖²`` there.

    Args:
        linearised: of the fit without the effect.
        limits: how many starts, and how large.
    """
    signs = (1.0,) if effect.one_sided else (1.0, -1.0)
    points = effect.grid(linearised.scales)
    found = [_strong(linearised, effect, point, sign, limits) for point in points for sign in signs]
    ranked = sorted((f for f in found if f is not None), key=lambda f: f[0])
    return [values for _, values in ranked[: limits.large_starts]]


def _strong(
    linearised: LinearisedFit, effect: Effect, point: Mapping[str, float], sign: float, limits: Refits
) -> tuple[float, dict[str, float]] | None:
    """What is left beside an effect of a shape at the strength that suits the residual, and its values there.

    None where it changes nothing that is not explained, or cannot be simulated.
    """
    size, best, values = float(np.sum(linearised.residual**2)), None, dict(point)
    for strength in _STRENGTHS:
        weaker, values = values, effect.scaled(point, sign * strength)
        if values == weaker:
            break
        try:
            change = linearised.project(direction(linearised, effect, values))
        except PhnnError:
            break
        share = float(np.sum(change**2)) / size
        if not share <= limits.large_start_most:
            break
        if share == 0.0:
            continue
        off = abs(np.log(share / limits.large_start_share))
        if best is None or off < best[0]:
            best = off, float(np.sum((linearised.residual - change) ** 2)), values
    return None if best is None else best[1:]


def clamped(effect: Effect, setup: Setup, values: Mapping[str, float]) -> Setup:
    """The effect at starting values moved inside the bounds of its parameters."""
    probe = effect.add_to(setup, _defaults(effect, values))
    inside = {}
    for name in effect.parameters:
        p = probe.parameters[name]
        inside[name] = p.value if p.fixed else min(max(values[name], p.lower), p.upper)
    return effect.add_to(setup, inside)


def _defaults(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Values with two-sided strengths at zero, which lies within every bound."""
    if effect.one_sided:
        return dict(values)
    return dict(values) | dict.fromkeys(effect.all_strengths, 0.0)
