"""Coefficients of the affine pieces of a reducible storage, which many steps share; see `phnn.integrate.affine`."""

from __future__ import annotations

from typing import Any

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.constants import HIGH, LEAK, LEAK_ONE, LEAK_TWO, LOW, ONE, RHO, STIFFNESS, TWO
from phnn.integrate.perturbed import (
    ABOVE,
    CURVED,
    FOLLOWING,
    KIND,
    LEAKS,
    LOWER,
    ONE_PIECE,
    ONLY_LINK,
    PIECEWISE,
    RESTING,
    SHIFTS,
    STIFF,
    STORAGE,
    TIMES,
    UPPER,
    WHOLE,
    parameter,
)
from phnn.integrate.tables import (
    FIRST_INLET,
    FIRST_LINK,
    IS_LINEAR,
    LAST_INLET,
    LAST_LINK,
    LEAVES,
    LOSSLESS,
    OWN_STORAGE,
    RULE,
    TO_JUNCTION,
)
from phnn.laws.leaf import relaxed
from phnn.laws.namespace import TINY


@inline
def _term(piece: Any, h: Any, c: Any, term: Any) -> Any:
    """One coefficient of a piece as complex numbers: end state and mean effort for a unit state, current or
    threshold."""
    none, unit = 0.0 * c[STIFFNESS], 1.0 + 0.0 * c[STIFFNESS]
    x, current, threshold = unit if term == 0 else none, unit if term == 1 else none, unit if term == 2 else none
    if piece == RESTING:
        gain = (current - c[LEAK] * (x * c[STIFFNESS])) * h
        return relaxed(x, gain, c[STIFFNESS], c[LEAK_ONE], c[LEAK_TWO])
    effort = x * c[STIFFNESS]
    gain = (current - c[LEAK] * effort - c[RHO] * (effort - threshold)) * h
    return relaxed(x, gain, c[STIFFNESS], c[ONE], c[TWO])


@inline
def part(z: Any, perturbed: Any) -> Any:
    """The derivative along a perturbation; the value if nothing is perturbed."""
    return z.imag / TINY if perturbed else z.real


@plain
def prepare_leaf(d: Any, k: Any, perturbed: Any, leaf: Any, h: Any) -> None:
    """Fill the coefficients of a reducible storage's pieces with parameter ``k`` perturbed."""
    stay_outside()
    for piece in range(3):
        for term in range(3):
            end, mean = _term(piece, h, d.c[k, leaf], term)
            d.whole[k, leaf, piece, term] = part(end, perturbed)
            d.whole[k, leaf, piece, 3 + term] = part(mean, perturbed)


@plain
def prepare_pairs(t: Any, p: Any, d: Any, leaf: Any) -> None:
    """Fill the constant parts of the derivatives of a storage's pairs; `prepare_values` must come first."""
    stay_outside()
    row, none, n = t[0, LEAVES] + leaf, p.active.shape[0], d.x.shape[0]
    only = d.kinds[leaf, ONLY_LINK] >= 0
    times = d.values[leaf, TIMES] if only else 1.0
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        i = p.input[pair]
        k = parameter(d, i)
        # Derivative of the current by the unknown.
        d.by_current[pair], d.by_ratio[pair] = 0.0, 0.0
        for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
            d.by_current[pair] += d.g[0, r].real if i == n + t[r, TO_JUNCTION] and not p.varies[leaf] else 0.0
        if only and p.shifts[pair]:
            d.by_ratio[pair] = d.g[p.slot[i], t[row, FIRST_LINK]].imag / TINY
        for piece in range(3):
            by, of = d.affine[pair, piece], d.whole[none, leaf, piece]
            threshold = 0.0
            if k >= 0 and piece != RESTING:
                threshold = d.c[k, leaf, HIGH if piece == ABOVE else LOW].imag / TINY
            for out in range(2):
                for term in range(3):
                    by[4 * out + term] = d.whole[k, leaf, piece, 3 * out + term] if k >= 0 else 0.0
                by[4 * out + 1] = by[4 * out + 1] * times + of[3 * out + 1] * d.by_ratio[pair]
                own = of[3 * out] if i == t[row, OWN_STORAGE] else 0.0
                by[4 * out + 3] = own + of[3 * out + 1] * d.by_current[pair] + of[3 * out + 2] * threshold


@plain
def prepare_values(t: Any, p: Any, d: Any, leaf: Any) -> None:
    """Fill the kinds and values of a reducible storage."""
    stay_outside()
    row, c, kind, own = t[0, LEAVES] + leaf, d.c[p.active.shape[0], leaf], d.kinds[leaf], d.values[leaf]
    kind[STORAGE], kind[ONLY_LINK], kind[SHIFTS] = t[row, OWN_STORAGE], -1, 0
    for pair in range(p.first[leaf], p.first[leaf + 1]):
        if p.shifts[pair]:
            kind[SHIFTS] = 1
    if t[row, LAST_LINK] - t[row, FIRST_LINK] == 1 and t[row, LAST_INLET] == t[row, FIRST_INLET] and not p.varies[leaf]:
        # The coefficients already contain the derivatives of the ratio by parameters.
        kind[ONLY_LINK], kind[SHIFTS] = t[t[row, FIRST_LINK], TO_JUNCTION], 0
        own[TIMES] = d.g[0, t[row, FIRST_LINK]].real
    kind[KIND] = WHOLE
    if p.affine[leaf] and t[row, RULE] == LOSSLESS:
        kind[KIND] = ONE_PIECE if t[row, IS_LINEAR] > 0 else CURVED
    elif p.affine[leaf]:
        kind[KIND] = FOLLOWING if p.reads[leaf] else PIECEWISE
    own[STIFF], own[LEAKS], own[LOWER], own[UPPER] = c[STIFFNESS].real, c[LEAK].real, c[LOW].real, c[HIGH].real
