"""Start values for the refit of a strong effect: strengths far from those to which the score extrapolates.

A base model that has taken over much of a strong effect is so far off that the score, a first derivative at strength
zero, knows neither its strength nor its shape, and may even have the wrong sign. Finite strengths are asked instead, at
every point of the grid.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from phnn.criteria import REFITS, Refits
from phnn.diagnose.linearised import LinearisedFit, direction
from phnn.effects import Effect
from phnn.errors import PhnnError
from phnn.setup import Setup

Array = NDArray[np.float64]

# Multiples of the grid's strengths, which are small ones.
_STRENGTHS = tuple(10.0 ** (0.5 * k) for k in range(1, 10))


def has_large_starts(effect: Effect) -> bool:
    """Whether an effect has a strength to choose, and no frequency that is found elsewhere than in its grid."""
    return effect.strength is not None and effect.searched is None


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

    Two neighbouring strengths are searched, whose changes are smaller and larger than asked. A change that is far too
    small tells how many strengths to leave out, as it grows in proportion; a wrong guess is halved.

    None where it changes nothing that is not explained, or cannot be simulated.
    """
    size, wanted = float(np.sum(linearised.residual**2)), limits.large_start_share
    stronger = _stronger(effect, point, sign)
    best, below, above, at, before = None, -1, len(stronger), 0, 0.0
    while below < at < above:
        change = _unexplained(linearised, effect, stronger[at])
        share = np.inf if change is None else float(np.sum(change**2)) / size
        if change is not None and 0.0 < share <= limits.large_start_most:
            off = abs(np.log(share / wanted))
            if best is None or off < best[0]:
                best = off, float(np.sum((linearised.residual - change) ** 2)), stronger[at]
        # What changes less than a weaker effect does cannot be simulated, or is saturated.
        if before <= share < wanted:
            below, at, before = at, min(at + _left_out(share, wanted), above - 1), share
        else:
            above, at = at, (below + at) // 2
    return None if best is None else best[1:]


def _stronger(effect: Effect, point: Mapping[str, float], sign: float) -> list[dict[str, float]]:
    """Values of the effect at a point of its grid, ever stronger, as far as they can be."""
    found = [dict(point)]
    for strength in _STRENGTHS:
        values = effect.scaled(point, sign * strength)
        if values == found[-1]:
            break
        found.append(values)
    return found[1:]


def _left_out(share: float, wanted: float) -> int:
    """How many strengths further the wanted share is not reached yet, if the change grows in proportion; one at least.

    Shares are squares: half a decade of strength is a decade of them.
    """
    return max(1, int(np.log10(wanted) - np.log10(share))) if share > 0.0 else 1


def _unexplained(linearised: LinearisedFit, effect: Effect, values: Mapping[str, float]) -> Array | None:
    """(N,) the change by an effect that the base parameters cannot make; None where it cannot be simulated."""
    try:
        return linearised.project(direction(linearised, effect, values))
    except PhnnError:
        return None


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
