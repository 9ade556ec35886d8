"""What many steps of a single-junction network have in common, resolved once: constants and ratios of its leaves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from phnn.integrate.compiled import plain, stay_outside
from phnn.integrate.constants import CAPACITY, CONSTANTS, RHO, fill_constants
from phnn.integrate.lookups import factor, resistor_flow
from phnn.integrate.tables import (
    EXACT,
    FACTORS,
    FIRST_BRANCH,
    FIRST_LINK,
    FIRST_RESISTOR,
    IS_LINEAR,
    JUNCTION_RESISTORS,
    LAST_BRANCH,
    LEAVES,
    LOSSLESS,
    OWN_STORAGE,
    RATIO,
    RATIO_PLACE,
    READ,
    READ_MEMORY,
    RULE,
    SIGN,
)

GAIN = CONSTANTS
# Columns of the leaves' kinds.
KIND, STORAGE, RESISTOR = range(3)
# Beside the rules of the table: a lossless leaf whose law is not linear, a leaf whose thresholds follow something.
CURVED, FOLLOWING = -1, -2


class Leaves(NamedTuple):
    """What is resolved for steps of one size.

    Attributes:
        kinds: (L, 3) the rule and the storage of every leaf, and the row of its first resistor.
        c: (L, 10) its constants, see `phnn.integrate.constants`, and its ratio.
        others: (R,) rows of the junction's resistors that are not linear; ratios: (R,) theirs.
    """

    kinds: Any
    c: Any
    others: Any
    ratios: Any


class Memory(NamedTuple):
    """Memory of a march.

    Attributes:
        g: (rows,) gains; constants: (L+1, 9); leaves: see there.
        perturbed: theta in complex numbers; ends, means: (N,) complex, what a perturbed step leads to.
        y: (1,), wj: (4, 1), wx: (2, N) what the memories of the network follow, see `phnn.integrate.memories`.
        scaled: rows whose ratio follows a memory.
    """

    g: Any
    constants: Any
    leaves: Any
    perturbed: Any
    ends: Any
    means: Any
    y: Any
    wj: Any
    wx: Any
    scaled: Any


@plain
def resolve(t: Any, theta: Any, h: Any, memory: Any) -> Any:
    """Fill the constants of the leaves for steps of size ``h``; returns the junction's ``1/s`` and its damping."""
    stay_outside()
    g, constants = memory.g, memory.constants
    kinds, c, others, ratios = memory.leaves
    fill_constants(t, theta, h, constants)
    for leaf in range(kinds.shape[0]):
        row = t[0, LEAVES] + leaf
        kinds[leaf, KIND], kinds[leaf, STORAGE], kinds[leaf, RESISTOR] = (
            t[row, RULE],
            t[row, OWN_STORAGE],
            t[row, FIRST_RESISTOR],
        )
        for i in range(CONSTANTS):
            c[leaf, i] = constants[leaf, i]
        c[leaf, GAIN] = g[t[row, FIRST_LINK]]
        if t[row, RULE] == LOSSLESS and t[row, IS_LINEAR] <= 0:
            kinds[leaf, KIND] = CURVED
        if t[row, RULE] == EXACT and t[t[row, FIRST_RESISTOR], READ] >= 0:
            kinds[leaf, KIND] = FOLLOWING
            c[leaf, RHO] = np.nan
    damping, other = 0.0, 0
    for r in range(t[0, JUNCTION_RESISTORS], t[0, JUNCTION_RESISTORS + 1]):
        b = 0.0
        for branch in range(t[r, FIRST_BRANCH], t[r, LAST_BRANCH]):
            b += g[branch]
        if other < others.shape[0] and others[other] == r:
            ratios[other] = b
            other += 1
        else:
            damping += b * b * resistor_flow(t, r, 1.0, 0.0, theta)
    return constants[kinds.shape[0], CAPACITY], damping


@plain
def scale(t: Any, theta: Any, x: Any, g: Any, scaled: Any, c: Any) -> None:
    """Set the ratios in some rows to what the memories make of them, and those of the leaves in their constants."""
    stay_outside()
    for place in range(scaled.shape[0]):
        r = scaled[place]
        g[r] = t[r, SIGN] * theta[t[r, RATIO]]
    for f in range(t[0, FACTORS], t[0, FACTORS + 1]):
        by = factor(t, f, x[t[t[f, READ], READ_MEMORY]], theta)
        for place in range(scaled.shape[0]):
            r = scaled[place]
            if t[r, RATIO] == t[f, RATIO_PLACE]:
                g[r] *= by
    for leaf in range(c.shape[0]):
        c[leaf, GAIN] = g[t[t[0, LEAVES] + leaf, FIRST_LINK]]
