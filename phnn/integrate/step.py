"""The equations of one power-preserving step, compiled.

One step of size ``h`` under the mean inputs ``ū`` solves, for the junctions ``j``,

    F_j = (z_j − p_j)/h + Σ_l a_lj ē_l + Σ_r b_rj φ_r(b_rᵀ v̄) − Σ_i J_ji v̄_i − Σ_p g_pj ψ_p(ū_p) = 0,

where ``v̄_j`` is the mean effort and ``z_j`` the end state of the junction. ``ē_l`` is the discrete gradient of a
lossless storage, or the mean effort of a dissipative one under the constant current ``i_l = Σ a_lj v̄_j + Σ g_lp ψ_p``.
The unknown ``y_j`` is ``v̄_j`` where the junction's storage is linear and ``z_j`` elsewhere. Multiplied by ``h v̄`` the
equations are the energy balance of the step.

Every function here runs on floats and on complex numbers with a tiny imaginary part. The latter yields exact
derivatives of the same step, so that no derivative is written by hand.
"""

from __future__ import annotations

from typing import Any

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.constants import (
    HIGH,
    LEAK,
    LEAK_ONE,
    LEAK_TWO,
    LOW,
    ONE,
    RHO,
    STIFFNESS,
    TWO,
    fill_gains,
    scale_gains,
)
from phnn.integrate.stages import make_gradient, make_radau
from phnn.integrate.table_access import (
    count,
    factor,
    junction_storage,
    mean_effort,
    resistor_flow,
    resistor_path,
    resistor_thresholds,
)
from phnn.integrate.tables import (
    EXACT,
    FACTORS,
    FIRST_LINK,
    FIRST_RESISTOR,
    IS_LINEAR,
    JUNCTIONS,
    LAST_LINK,
    LAST_RESISTOR,
    LEAVES,
    LOSSLESS,
    OWN_STORAGE,
    PATH,
    RADAU,
    RATIO_PLACE,
    READ,
    RULE,
    TO_JUNCTION,
)
from phnn.integrate.terms import (
    CHANGE,
    EFFORT,
    FLOW,
    NEXT,
    Step,
    add,
    junction_flows,
    junction_terms,
    leaf_current,
    read,
)
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.namespace import real


@plain
def modulate(t: Any, step: Step) -> None:
    """Set the gains to their values at mid-step."""
    stay_outside()
    theta, g = step.theta, step.g
    fill_gains(t, theta, g)
    for r in range(t[0, FACTORS], t[0, FACTORS + 1]):
        scale_gains(t, t[r, RATIO_PLACE], factor(t, r, read(t, t[r, READ], step), theta), g)


@inline
def _lost(context: Any, effort: Any) -> Any:
    """``Σ_r b_r φ_r(b_r ε)`` of a reducible storage at an effort."""
    t, leaf, step = context
    theta, g = step.theta, step.g
    row = t[0, LEAVES] + leaf
    total = 0.0 * effort
    for r in range(t[row, FIRST_RESISTOR], t[row, LAST_RESISTOR]):
        q = read(t, t[r, READ], step)
        total += g[r] * resistor_flow(t, r, g[r] * effort, q, theta)
    return total


@inline
def _plainly_lost(context: Any, effort: Any) -> Any:
    """`_lost` without the perturbations of ratios and of variables that laws read; ``theta`` is unperturbed."""
    t, leaf, step = context
    theta, g = step.theta, step.g
    row = t[0, LEAVES] + leaf
    total = 0.0 * effort
    for r in range(t[row, FIRST_RESISTOR], t[row, LAST_RESISTOR]):
        q = read(t, t[r, READ], step)
        ratio = real(g[r])
        total += ratio * resistor_flow(t, r, ratio * effort, real(q) + 0.0 * q, theta)
    return total


def _at_state(lost: Any) -> Any:
    """The flow lost at a state."""

    def at_state(state: Any, context: Any) -> Any:
        stay_outside()
        t, leaf, step = context
        return lost(context, mean_effort(t, t[t[0, LEAVES] + leaf, OWN_STORAGE], state, state, step.theta))

    return plain(at_state)


def _between_states(lost: Any) -> Any:
    """The flow lost at the mean effort between two states."""

    def between_states(start: Any, end: Any, context: Any) -> Any:
        stay_outside()
        t, leaf, step = context
        return lost(context, mean_effort(t, t[t[0, LEAVES] + leaf, OWN_STORAGE], start, end, step.theta))

    return plain(between_states)


_radau_search, _radau_moved = make_radau(_at_state(_lost), _at_state(_plainly_lost), plain)
_gradient_search, _gradient_moved = make_gradient(_between_states(_lost), _between_states(_plainly_lost), plain)


@inline
def is_closed(t: Any, leaf: Any) -> Any:
    """Whether the equations of a reducible storage have a closed solution."""
    rule = t[t[0, LEAVES] + leaf, RULE]
    return (rule == LOSSLESS) | (rule == EXACT) | (rule == PATH)


@plain
def leaf_search(t: Any, leaf: Any, step: Step) -> Any:
    """Solve the equations of a storage without a closed solution, in real numbers: see `phnn.integrate.stages`."""
    stay_outside()
    row = t[0, LEAVES] + leaf
    start, current = real(step.x[t[row, OWN_STORAGE]]), real(leaf_current(t, leaf, step.g, step.a, step.wj))
    context = (t, leaf, step)
    if t[row, RULE] == RADAU:
        return _radau_search(start, current, step.h, context)
    end, slope = _gradient_search(start, current, step.h, context)
    return end, slope, 0.0, 0.0


@plain
def leaf_moved(t: Any, leaf: Any, step: Step, found: Any) -> Any:
    """End state and mean effort of a reducible storage from the result of `leaf_search`."""
    stay_outside()
    row = t[0, LEAVES] + leaf
    k = t[row, OWN_STORAGE]
    context, start = (t, leaf, step), step.x[k]
    current = leaf_current(t, leaf, step.g, step.a, step.wj)
    if t[row, RULE] == RADAU:
        return _radau_moved(start, current, step.h, step.c[leaf, STIFFNESS], found, context)
    end = _gradient_moved(start, current, step.h, (found[0], found[1]), context)
    return end, mean_effort(t, k, start, end, step.theta)


@inline
def leaf_closed(t: Any, leaf: Any, step: Step) -> Any:
    """End state and mean effort of a reducible storage with a closed solution."""
    theta, c, x, h = step.theta, step.c, step.x, step.h
    row = t[0, LEAVES] + leaf
    k, rule = t[row, OWN_STORAGE], t[row, RULE]
    current = leaf_current(t, leaf, step.g, step.a, step.wj)
    if rule == LOSSLESS:
        gain = h * current
        if t[row, IS_LINEAR] > 0:
            return x[k] + gain, c[leaf, STIFFNESS] * (x[k] + 0.5 * gain)
        return x[k] + gain, mean_effort(t, k, x[k], x[k] + gain, theta)
    if rule == PATH:
        return resistor_path(t, t[row, FIRST_RESISTOR], x[k], current, h, c[leaf, STIFFNESS], theta)
    rho, low, high = c[leaf, RHO], c[leaf, LOW], c[leaf, HIGH]
    one, two, leak = c[leaf, ONE], c[leaf, TWO], c[leaf, LEAK]
    r = t[row, FIRST_RESISTOR]
    if t[r, READ] >= 0:
        rho, low, high = resistor_thresholds(t, r, read(t, t[r, READ], step), theta)
        one, two = relaxation(h * (rho + leak) * c[leaf, STIFFNESS])
    return rc_flow(
        x[k], current, h, c[leaf, STIFFNESS], rho, low, high, leak, one, two,
        c[leaf, LEAK_ONE], c[leaf, LEAK_TWO],
    )  # fmt: skip


@inline
def leaf_step(t: Any, leaf: Any, step: Step) -> Any:
    """End state and mean effort of a reducible storage."""
    if is_closed(t, leaf):
        return leaf_closed(t, leaf, step)
    found = leaf_search(t, leaf, step)
    return leaf_moved(t, leaf, step, found)


@inline
def leaf_forces(t: Any, leaf: Any, g: Any, effort: Any, wj: Any) -> None:
    """Add the forces of a reducible storage on its junctions."""
    row = t[0, LEAVES] + leaf
    for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
        add(g[r] * effort, t[r, TO_JUNCTION], wj)


@inline
def inlined_balance(t: Any, step: Step, wx: Any) -> None:
    """Evaluate ``F`` at the unknowns of a step, with the end states and mean efforts.

    Args:
        t: table; step: its modulated gains are filled in here.
        wx: (2, N) filled with end states and mean efforts.
    """
    x, wj = step.x, step.wj
    junction_flows(t, step.theta, x, step.y, wj)
    if count(t, FACTORS) > 0:
        modulate(t, step)
    junction_terms(t, step)
    for leaf in range(count(t, LEAVES)):
        end, mean = leaf_step(t, leaf, step)
        k = t[t[0, LEAVES] + leaf, OWN_STORAGE]
        wx[NEXT, k] = end
        wx[EFFORT, k] = mean
        leaf_forces(t, leaf, step.g, mean, wj)
    for j in range(count(t, JUNCTIONS)):
        k = junction_storage(t, j)
        wx[NEXT, k] = x[k] + wj[CHANGE, j]
        wx[EFFORT, k] = wj[FLOW, j]


@plain
def balance(t: Any, step: Step, wx: Any) -> None:
    """`inlined_balance` as a call."""
    stay_outside()
    inlined_balance(t, step, wx)
