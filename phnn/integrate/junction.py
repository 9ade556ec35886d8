"""The force balance of a network with one junction, compiled, and its root: see `phnn.integrate.quick`."""

from __future__ import annotations

from typing import Any

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.constants import CONSTANTS, HIGH, LEAK, LEAK_ONE, LEAK_TWO, LOW, ONE, RHO, STIFFNESS, TWO
from phnn.integrate.roots import make_root
from phnn.integrate.table_access import mean_effort, resistor_flow, resistor_thresholds
from phnn.integrate.tables import LOSSLESS, READ, READ_LEAF, READ_MODULATOR
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.namespace import TINY

# Column of the ratio of a reducible storage, after its constants.
GAIN = CONSTANTS
# Columns of ``kinds``.
RULE_OF, STORAGE_OF, RESISTOR_OF = range(3)
# In addition to the rules of the table: a lossless storage with a nonlinear law, a storage with modulated thresholds.
CURVED, FOLLOWING = -1, -2


@inline
def _read(r: Any, y: Any, context: Any, x: Any) -> Any:
    """`phnn.integrate.step.read`."""
    t, _, kinds, c, capacity, _, _, h, p, _, _ = context
    if r < 0:
        return 0.0 * y
    leaf = t[r, READ_LEAF]
    if t[r, READ_MODULATOR] >= 0:
        return x[t[r, READ_MODULATOR]] + 0.0 * y
    if leaf >= 0:
        return x[kinds[leaf, STORAGE_OF]] + 0.5 * h * c[leaf, GAIN] * y
    return p + (y * capacity - p)


@inline
def _relaxation(c: Any, rho: Any, h: Any) -> Any:
    """The relaxation functions of a reducible storage with slope ``rho``; ``c`` keeps those of the latest slope."""
    one, two = c[ONE] + 0.0 * rho, c[TWO] + 0.0 * rho
    if rho.real != c[RHO]:
        one, two = relaxation(h * (rho + c[LEAK]) * c[STIFFNESS])
        c[RHO], c[ONE], c[TWO] = rho.real, one.real, two.real
    elif rho.imag != 0.0:
        one, two = relaxation(h * (rho + c[LEAK]) * c[STIFFNESS])
    return one, two


@inline
def _total(y: Any, context: Any, x: Any, ends: Any, means: Any) -> Any:
    """``F`` and the size of its terms; fills the end states and mean efforts."""
    t, theta, kinds, c, capacity, damping, drive, h, p, others, ratios = context
    change = 2.0 * (y * capacity - p)
    rate = 1.0 / h
    force = change * rate + damping * y - drive
    size = (abs(change.real) + abs(p)) * rate + abs(damping * y.real) + abs(drive)
    for other in range(others.shape[0]):
        r, ratio = others[other], ratios[other]
        q = _read(t[r, READ], y, context, x)
        lost = ratio * resistor_flow(t, r, ratio * y, q, theta)
        force += lost
        size += abs(lost.real)
    for leaf in range(kinds.shape[0]):
        gain = c[leaf, GAIN]
        if kinds[leaf, RULE_OF] == LOSSLESS:
            moved = h * gain * y
            end = x[kinds[leaf, STORAGE_OF]] + moved
            mean = c[leaf, STIFFNESS] * (x[kinds[leaf, STORAGE_OF]] + 0.5 * moved)
        elif kinds[leaf, RULE_OF] == CURVED:
            start = x[kinds[leaf, STORAGE_OF]] + 0.0 * y
            end = start + h * gain * y
            mean = mean_effort(t, kinds[leaf, STORAGE_OF], start, end, theta)
        elif kinds[leaf, RULE_OF] == FOLLOWING:
            r = kinds[leaf, RESISTOR_OF]
            q = _read(t[r, READ], y, context, x)
            rho, low, high = resistor_thresholds(t, r, q, theta)
            one, two = _relaxation(c[leaf], rho, h)
            end, mean = rc_flow(
                x[kinds[leaf, STORAGE_OF]], gain * y, h, c[leaf, STIFFNESS], rho, low, high, c[leaf, LEAK], one, two,
                c[leaf, LEAK_ONE], c[leaf, LEAK_TWO],
            )  # fmt: skip
        else:
            end, mean = rc_flow(
                x[kinds[leaf, STORAGE_OF]], gain * y, h, c[leaf, STIFFNESS], c[leaf, RHO], c[leaf, LOW], c[leaf, HIGH],
                c[leaf, LEAK], c[leaf, ONE], c[leaf, TWO], c[leaf, LEAK_ONE], c[leaf, LEAK_TWO],
            )  # fmt: skip
        ends[kinds[leaf, STORAGE_OF]] = end
        means[kinds[leaf, STORAGE_OF]] = mean
        force += gain * mean
        size += abs(gain * mean.real)
    return force, size


@inline
def _value_at(y: Any, context: Any) -> Any:
    (t, theta, _), step, x, ends, means, _, _ = context
    return _total(y, (t, theta, *step), x, ends, means)


@plain
def _slope_at(y: Any, context: Any) -> Any:
    stay_outside()
    (t, _, theta), step, x, _, _, ends, means = context
    return _total(complex(y, TINY), (t, theta, *step), x, ends, means)[0].imag / TINY


root = inline(make_root(_value_at, _slope_at))
