"""Quantities that are the same in all steps of one size: constants of storages and junctions, and gains.

c (L+m, 9)  of a reducible storage: s = 1/C of a linear one; ρ, lo, hi of a piecewise linear resistor that reads no
            state; the relaxation functions of h (ρ + g) s; g of the leaks in parallel; the relaxation functions of
            h g s. Of a junction, in the rows after the reducible storages: 1/s
g (rows,)   signed ratio of every row of the table that has a ratio

The third array of a step, a (P,), holds the ports' actions ψ_p(ū_p) from `phnn.integrate.actions`.
"""

from __future__ import annotations

from typing import Any

from phnn.integrate.cache import plain, stay_outside
from phnn.integrate.table_access import (
    count,
    is_linear,
    junction_storage,
    resistor_flow,
    resistor_thresholds,
    stiffness,
)
from phnn.integrate.tables import (
    EXACT,
    FIRST_RESISTOR,
    IS_LINEAR,
    JUNCTIONS,
    LAST_RESISTOR,
    LEAVES,
    OWN_STORAGE,
    PATH,
    RATIO,
    READ,
    RULE,
    SIGN,
)
from phnn.laws.leaf import relaxation

STIFFNESS, RHO, LOW, HIGH, ONE, TWO, LEAK, LEAK_ONE, LEAK_TWO = range(9)
CONSTANTS = 9
CAPACITY = 0


@plain
def fill_constants(t: Any, theta: Any, h: Any, c: Any) -> None:
    """Fill ``c`` for steps of size ``h``."""
    stay_outside()
    leaves = count(t, LEAVES)
    for leaf in range(leaves):
        row = t[0, LEAVES] + leaf
        if t[row, IS_LINEAR] > 0 or t[row, RULE] == PATH:
            c[leaf, STIFFNESS] = stiffness(t, t[row, OWN_STORAGE], theta)
        r, none = t[row, FIRST_RESISTOR], 0.0 * theta[0]
        leak = none
        if t[row, RULE] == EXACT:
            # Under this rule, all resistors of the storage but the first are linear.
            for other in range(r + 1, t[row, LAST_RESISTOR]):
                leak += resistor_flow(t, other, 1.0 + none, none, theta)
        c[leaf, LEAK] = leak
        c[leaf, LEAK_ONE], c[leaf, LEAK_TWO] = relaxation(h * leak * c[leaf, STIFFNESS])
        if t[row, RULE] == EXACT and t[r, READ] < 0:
            rho, low, high = resistor_thresholds(t, r, none, theta)
            c[leaf, RHO], c[leaf, LOW], c[leaf, HIGH] = rho, low, high
            c[leaf, ONE], c[leaf, TWO] = relaxation(h * (rho + leak) * c[leaf, STIFFNESS])
    for j in range(count(t, JUNCTIONS)):
        if is_linear(t, j):
            c[leaves + j, CAPACITY] = 1.0 / stiffness(t, junction_storage(t, j), theta)


@plain
def fill_gains(t: Any, theta: Any, g: Any) -> None:
    """Fill ``g`` with the unmodulated ratios."""
    stay_outside()
    for r in range(t.shape[0]):
        if t[r, RATIO] >= 0:
            g[r] = t[r, SIGN] * theta[t[r, RATIO]]


@plain
def scale_gains(t: Any, place: Any, by: Any, g: Any) -> None:
    """Multiply the gains of one ratio."""
    stay_outside()
    for r in range(t.shape[0]):
        if t[r, RATIO] == place:
            g[r] *= by
