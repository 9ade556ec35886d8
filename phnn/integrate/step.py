"""The equations of one power-preserving step, compiled.

One step of size ``h`` under the mean inputs ``ū`` solves, for the junctions ``j``,

    F_j = (z_j − p_j)/h + Σ_l a_lj ē_l + Σ_r b_rj φ_r(b_rᵀ v̄) − Σ_i J_ji v̄_i − Σ_p g_pj ψ_p(ū_p) = 0,

where ``v̄_j`` is the mean effort and ``z_j`` the end state of the junction. ``ē_l`` is the discrete gradient of a
lossless storage, or the mean effort of a dissipative one under the constant current ``i_l = Σ a_lj v̄_j + Σ g_lp ψ_p``.
The unknown ``y_j`` is ``v̄_j`` where the junction's storage is linear and ``z_j`` elsewhere. Multiplied by ``h v̄`` the
equations are the energy balance of the step.

Each modulator state is advanced at the end of a step by the mean powers, efforts or actions in it:

    z⁺ = z + h φ₁(−h d) f(z, s̄),     s̄ = Σ of mean powers, efforts or actions

Laws and ratios read ``z`` at the start of a step. During the step they are therefore fixed, and the step keeps its
power balance. Where ``s̄`` is power that resistors dissipate, it follows from the balance of the step: ``i ē − ΔH/h`` of
a reducible storage, ``ε̄ φ(ε̄)`` on junctions.

Every function here runs on floats and on complex numbers with a tiny imaginary part. The latter yields exact
derivatives of the same step, so that no derivative is written by hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.partition import EXACT, LOSSLESS, PATH, RADAU
from phnn.integrate.roots import make_gradient, make_radau
from phnn.integrate.table import (
    FACTORS,
    FIRST_BRANCH,
    FIRST_INLET,
    FIRST_LINK,
    FIRST_RESISTOR,
    FIRST_SCALED,
    FIRST_SOURCE,
    FROM_PORT,
    GYRATORS,
    IN_MATRIX,
    INTO_JUNCTION,
    IS_LINEAR,
    JUNCTION_INLETS,
    JUNCTION_RESISTORS,
    JUNCTIONS,
    LAST_BRANCH,
    LAST_INLET,
    LAST_LINK,
    LAST_RESISTOR,
    LAST_SCALED,
    LAST_SOURCE,
    LAW,
    LEAVES,
    MODULATOR_STATES,
    OF_JUNCTION,
    OWN_STORAGE,
    PLACE_1,
    PLACE_2,
    RATIO,
    READ,
    READ_JUNCTION,
    READ_LEAF,
    READ_MODULATOR,
    RULE,
    SCALED,
    SIGN,
    SOURCE_EFFORT,
    SOURCE_FLOW,
    SOURCE_LEAF,
    SOURCE_PORT,
    SOURCE_RESISTOR,
    STORAGES,
    TO_JUNCTION,
)
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.law import close_tables
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.namespace import real
from phnn.laws.other import advanced
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, compiled

# The functions below compile the laws that exist now.
close_tables()


def look_up(name: str, laws: Mapping[str, Any], leading: int, wide: Sequence[Any] = ()) -> Any:
    """A compiled ``name(t, r, a_1…a_leading, theta)`` that calls the function ``name`` of the law in row ``r``.

    Args:
        laws: by code; some may lack the function.
        leading: number of arguments before the parameters.
        wide: functions of neural laws, with the codes that follow: ``(a_1…a_leading, theta, first, units)``.
    """
    arguments = ", ".join(f"a{i}" for i in range(leading))
    scope: dict[str, Any] = {"stay_outside": stay_outside, "__name__": __name__}
    branches = []
    for code, law in enumerate(laws.values()):
        if function := getattr(law, name):
            scope[f"f{code}"] = inline(function)
            places = ", ".join(f"theta[t[r, {PLACE_1 + k}]]" for k in range(len(law.example)))
            branches.append((code, ", ".join(filter(None, (arguments, places)))))
    for code, function in enumerate(wide, len(laws)):
        scope[f"f{code}"] = function
        branches.append((code, f"{arguments}, theta, t[r, {PLACE_1}], t[r, {PLACE_2}]"))
    lines = [f"def {name}({', '.join(filter(None, ('t, r', arguments, 'theta')))}):", "    stay_outside()"]
    lines += [f"    if t[r, {LAW}] == {code}:\n        return f{code}({given})" for code, given in branches[:-1]]
    # The last branch needs no test, so that the function returns on every path. The text is built from positions only.
    code, given = branches[-1]
    exec("\n".join([*lines, f"    return f{code}({given})"]), scope)
    # Not inlined: it has many call sites, and the constants of the common laws are computed beforehand.
    return plain(scope[name])


def _unmodulated(flow: Any) -> Any:
    """A flow with an unused read-only argument."""

    def with_read(effort: Any, q: Any, theta: Any, first: Any, units: Any) -> Any:
        return flow(effort, theta, first, units)

    return plain(with_read)


# A state so small that every spring is linear up to it; a power of two, so that a linear one is divided exactly.
NEAR_REST = 2.0**-80

# Of the row of a storage between two states; of a resistor at an effort and what it reads; ``(ρ, lo, hi)`` of what a
# piecewise linear one reads; ``(x⁺, ē)`` of ``x, i, h, s`` of the storage ``E = s x`` of one that depends on the path
# alone; of a modulation of what it reads; of a modulator state at ``z, s``; its decay.
storage_effort = look_up("mean_effort", STORAGE_LAWS, 2, [compiled(x) for x in WIDE_STORAGES.values()])
resistor_flow = look_up("flow", RESISTOR_LAWS, 2, [_unmodulated(compiled(x)) for x in WIDE_RESISTORS.values()])
resistor_thresholds = look_up("thresholds", RESISTOR_LAWS, 1)
resistor_path = look_up("path", RESISTOR_LAWS, 4)
factor = look_up("factor", FACTOR_LAWS, 1)
memory_rate = look_up("rate", MEMORY_LAWS, 2)
memory_decay = look_up("decay", MEMORY_LAWS, 0)


@inline
def count(t: Any, kind: Any) -> Any:
    """Number of rows of a kind."""
    return t[0, kind + 1] - t[0, kind]


@inline
def mean_effort(t: Any, k: Any, a: Any, b: Any, theta: Any) -> Any:
    """``ē`` of storage ``k`` between two states."""
    return storage_effort(t, t[0, STORAGES] + k, a, b, theta)


@inline
def stiffness(t: Any, k: Any, theta: Any) -> Any:
    """``s`` of a linear storage, ``E = s x``, or of another one at rest."""
    small = NEAR_REST + 0.0 * theta[0]
    return mean_effort(t, k, small, small, theta) / NEAR_REST


@inline
def junction_storage(t: Any, j: Any) -> Any:
    """Number of the storage of junction ``j``."""
    return t[t[0, JUNCTIONS] + j, OWN_STORAGE]


@inline
def is_linear(t: Any, j: Any) -> Any:
    """Whether the unknown of junction ``j`` is its mean effort; otherwise it is its end state."""
    return t[t[0, JUNCTIONS] + j, IS_LINEAR] > 0


# Quantities that are the same in all steps of one size: constants of storages and junctions, and gains.
#
# c (L+m, …)  of a reducible storage: s = 1/C of a linear one; ρ, lo, hi of a piecewise linear resistor, at zero of what
#             it reads; the relaxation functions of h (ρ + g) s; g of the leaks in parallel; the relaxation functions of
#             h g s. Of a junction, in the rows after the reducible storages: 1/s, and its row of the matrix of the
#             linear terms with constant factors
# g (rows,)   signed ratio of every row of the table that has a ratio
#
# The third array of a step, a (P,), holds the ports' actions ψ_p(ū_p) from `phnn.integrate.program`.
STIFFNESS, RHO, LOW, HIGH, ONE, TWO, LEAK, LEAK_ONE, LEAK_TWO = range(9)
CAPACITY, MATRIX = range(2)


def shape_of_constants(leaves: int, junctions: int) -> tuple[int, int]:
    """Return the shape of ``c``."""
    return leaves + junctions, max(LEAK_TWO, junctions) + 1


@plain
def fill_constants(t: Any, theta: Any, g: Any, h: Any, c: Any) -> None:
    """Fill ``c`` for steps of size ``h``."""
    stay_outside()
    leaves, m, none = count(t, LEAVES), count(t, JUNCTIONS), 0.0 * theta[0]
    for leaf in range(leaves):
        row = t[0, LEAVES] + leaf
        if t[row, IS_LINEAR] > 0 or t[row, RULE] == PATH:
            c[leaf, STIFFNESS] = stiffness(t, t[row, OWN_STORAGE], theta)
        r, leak = t[row, FIRST_RESISTOR], none
        if t[row, RULE] == EXACT:
            # Under this rule, all resistors of the storage but the first are linear.
            for other in range(r + 1, t[row, LAST_RESISTOR]):
                leak += resistor_flow(t, other, 1.0 + none, none, theta)
        c[leaf, LEAK] = leak
        c[leaf, LEAK_ONE], c[leaf, LEAK_TWO] = relaxation(h * leak * c[leaf, STIFFNESS])
        if t[row, RULE] == EXACT:
            rho, low, high = resistor_thresholds(t, r, none, theta)
            c[leaf, RHO], c[leaf, LOW], c[leaf, HIGH] = rho, low, high
            c[leaf, ONE], c[leaf, TWO] = relaxation(h * (rho + leak) * c[leaf, STIFFNESS])
    for j in range(m):
        if is_linear(t, j):
            c[leaves + j, CAPACITY] = 1.0 / stiffness(t, junction_storage(t, j), theta)
        for i in range(m):
            c[leaves + j, MATRIX + i] = none
    for r in range(t[0, JUNCTION_RESISTORS], t[0, JUNCTION_RESISTORS + 1]):
        if t[r, IN_MATRIX] > 0:
            b = t[r, FIRST_BRANCH]
            j = t[b, TO_JUNCTION]
            c[leaves + j, MATRIX + j] += g[b] * g[b] * resistor_flow(t, r, 1.0 + none, none, theta)
    for r in range(t[0, GYRATORS], t[0, GYRATORS + 1]):
        if t[r, IN_MATRIX] > 0:
            c[leaves + t[r, TO_JUNCTION], MATRIX + t[r, OF_JUNCTION]] -= g[r]


@plain
def fill_gains(t: Any, theta: Any, g: Any) -> None:
    """Fill ``g`` with the unmodulated ratios."""
    stay_outside()
    for r in range(t.shape[0]):
        if t[r, RATIO] >= 0:
            g[r] = t[r, SIGN] * theta[t[r, RATIO]]


# Rows of the work array of the junctions.
FLOW, CHANGE, FORCE, SIZE = range(4)


class Step(NamedTuple):
    """One step, in floats or in complex numbers.

    Attributes:
        theta: (M,) parameters.
        c, g, a: constants, ratios and actions, see above.
        x: (N,) state at its start; y: (m,) unknowns; h: its size [s].
        wj: (4, m) filled with ``v̄``, ``z − p``, ``F`` and the size of its terms.
        ends, means: (N,) filled with the end states, and with the mean efforts and the mean drives.
    """

    theta: Any
    c: Any
    g: Any
    a: Any
    x: Any
    y: Any
    h: Any
    wj: Any
    ends: Any
    means: Any


@inline
def junction_change(t: Any, j: Any, c: Any, x: Any, y: Any) -> Any:
    """``z_j − p_j``; of a linear storage ``2 (v̄/s − p)``, which takes no difference of end states."""
    p = x[junction_storage(t, j)]
    return 2.0 * (y[j] * c[count(t, LEAVES) + j, CAPACITY] - p) if is_linear(t, j) else y[j] - p


@inline
def inertia(t: Any, j: Any, c: Any) -> Any:
    """``d(z_j − p_j)/dy_j``: twice the mass of a linear junction, else one."""
    return 2.0 * c[count(t, LEAVES) + j, CAPACITY] if is_linear(t, j) else 1.0 + 0.0 * c[0, 0]


@inline
def leaf_current(t: Any, row: Any, g: Any, a: Any, wj: Any) -> Any:
    """``i_l`` of the reducible storage in a row."""
    total = 0.0 * g[0]
    for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
        total += g[r] * wj[FLOW, t[r, TO_JUNCTION]]
    for r in range(t[row, FIRST_INLET], t[row, LAST_INLET]):
        total += g[r] * a[t[r, FROM_PORT]]
    return total


@inline
def read(t: Any, r: Any, step: Step) -> Any:
    """Mid-step energy variable, or modulator state, that a law may read; 0 for none.

    The ratios of a reducible storage that is read follow no energy variable. A modulator state is read at the start of
    the step.
    """
    if r < 0:
        return 0.0 * step.g[0]
    leaf, j = t[r, READ_LEAF], t[r, READ_JUNCTION]
    if t[r, READ_MODULATOR] >= 0:
        return step.x[t[r, READ_MODULATOR]]
    if leaf >= 0:
        row = t[0, LEAVES] + leaf
        return step.x[t[row, OWN_STORAGE]] + 0.5 * step.h * leaf_current(t, row, step.g, step.a, step.wj)
    return step.x[junction_storage(t, j)] + 0.5 * junction_change(t, j, step.c, step.x, step.y)


@inline
def branch_effort(t: Any, r: Any, g: Any, wj: Any) -> Any:
    """``b_rᵀ v̄`` of the junction resistor in row ``r``."""
    effort = 0.0 * g[0]
    for b in range(t[r, FIRST_BRANCH], t[r, LAST_BRANCH]):
        effort += g[b] * wj[FLOW, t[b, TO_JUNCTION]]
    return effort


@inline
def junction_flows(t: Any, theta: Any, x: Any, y: Any, wj: Any) -> None:
    """Fill ``v̄``."""
    for j in range(count(t, JUNCTIONS)):
        k = junction_storage(t, j)
        wj[FLOW, j] = y[j] if is_linear(t, j) else mean_effort(t, k, x[k], y[j], theta)


@inline
def add(term: Any, j: Any, wj: Any) -> None:
    """Add a term to ``F`` of junction ``j`` and to the size of its terms."""
    wj[FORCE, j] += term
    wj[SIZE, j] += abs(term.real)


@inline
def _resistor_term(t: Any, r: Any, step: Step) -> None:
    g, wj = step.g, step.wj
    effort = branch_effort(t, r, g, wj)
    flow = resistor_flow(t, r, effort, read(t, t[r, READ], step), step.theta)
    for b in range(t[r, FIRST_BRANCH], t[r, LAST_BRANCH]):
        add(g[b] * flow, t[b, TO_JUNCTION], wj)


@inline
def _gyrator_term(t: Any, r: Any, g: Any, wj: Any) -> None:
    add(-g[r] * wj[FLOW, t[r, OF_JUNCTION]], t[r, TO_JUNCTION], wj)


@inline
def _inlet_term(t: Any, r: Any, g: Any, a: Any, wj: Any) -> None:
    add(-g[r] * a[t[r, FROM_PORT]], t[r, INTO_JUNCTION], wj)


@inline
def junction_term(t: Any, r: Any, step: Step) -> None:
    """Add the force of the junction resistor, gyrator or junction inlet in row ``r``."""
    if r < t[0, JUNCTION_RESISTORS + 1]:
        _resistor_term(t, r, step)
    elif r < t[0, GYRATORS + 1]:
        _gyrator_term(t, r, step.g, step.wj)
    else:
        _inlet_term(t, r, step.g, step.a, step.wj)


@inline
def junction_terms(t: Any, step: Step) -> None:
    """``F`` without the reducible storages, the size of its terms, and ``z − p``."""
    c, wj = step.c, step.wj
    rate, m, own = 1.0 / step.h, count(t, JUNCTIONS), count(t, LEAVES)
    for j in range(m):
        change = junction_change(t, j, c, step.x, step.y)
        force, size = change * rate, (abs(change.real) + abs(step.x[junction_storage(t, j)].real)) * rate
        for i in range(m):
            term = c[own + j, MATRIX + i] * wj[FLOW, i]
            force += term
            size += abs(term.real)
        wj[CHANGE, j], wj[FORCE, j], wj[SIZE, j] = change, force, size
    for r in range(t[0, JUNCTION_RESISTORS], t[0, JUNCTION_RESISTORS + 1]):
        if t[r, IN_MATRIX] <= 0:
            _resistor_term(t, r, step)
    for r in range(t[0, GYRATORS], t[0, GYRATORS + 1]):
        if t[r, IN_MATRIX] <= 0:
            _gyrator_term(t, r, step.g, wj)
    for r in range(t[0, JUNCTION_INLETS], t[0, JUNCTION_INLETS + 1]):
        _inlet_term(t, r, step.g, step.a, wj)


@plain
def modulate(t: Any, step: Step) -> None:
    """Set the modulated gains to their values at mid-step."""
    stay_outside()
    theta, g = step.theta, step.g
    for s in range(t[0, SCALED], t[0, SCALED + 1]):
        g[t[s, 0]] = t[t[s, 0], SIGN] * theta[t[t[s, 0], RATIO]]
    for f in range(t[0, FACTORS], t[0, FACTORS + 1]):
        by = factor(t, f, read(t, t[f, READ], step), theta)
        for s in range(t[f, FIRST_SCALED], t[f, LAST_SCALED]):
            g[t[s, 0]] *= by


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
def is_closed(t: Any, row: Any) -> Any:
    """Whether the equations of the reducible storage in a row have a closed solution."""
    rule = t[row, RULE]
    return (rule == LOSSLESS) | (rule == EXACT) | (rule == PATH)


@plain
def leaf_search(t: Any, leaf: Any, step: Step) -> Any:
    """Solve the equations of a storage without a closed solution, in real numbers: see `phnn.integrate.roots`."""
    stay_outside()
    row = t[0, LEAVES] + leaf
    start, current = real(step.x[t[row, OWN_STORAGE]]), real(leaf_current(t, row, step.g, step.a, step.wj))
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
    current = leaf_current(t, row, step.g, step.a, step.wj)
    if t[row, RULE] == RADAU:
        return _radau_moved(start, current, step.h, step.c[leaf, STIFFNESS], found, context)
    end = _gradient_moved(start, current, step.h, (found[0], found[1]), context)
    return end, mean_effort(t, k, start, end, step.theta)


@inline
def leaf_closed(t: Any, leaf: Any, row: Any, step: Step) -> Any:
    """End state and mean effort of a reducible storage with a closed solution, in its row."""
    theta, c, h, rule = step.theta, step.c[leaf], step.h, t[row, RULE]
    x, current = step.x[t[row, OWN_STORAGE]], leaf_current(t, row, step.g, step.a, step.wj)
    if rule == LOSSLESS:
        gain = h * current
        if t[row, IS_LINEAR] > 0:
            return x + gain, c[STIFFNESS] * (x + 0.5 * gain)
        return x + gain, mean_effort(t, t[row, OWN_STORAGE], x, x + gain, theta)
    r = t[row, FIRST_RESISTOR]
    if rule == PATH:
        return resistor_path(t, r, x, current, h, c[STIFFNESS], theta)
    rho, low, high, one, two = c[RHO], c[LOW], c[HIGH], c[ONE], c[TWO]
    if t[r, READ] >= 0:
        rho, low, high = resistor_thresholds(t, r, read(t, t[r, READ], step), theta)
        if rho != c[RHO]:
            one, two = relaxation(h * (rho + c[LEAK]) * c[STIFFNESS])
    return rc_flow(
        x, current, h, c[STIFFNESS], rho, low, high, c[LEAK], one, two, c[LEAK_ONE], c[LEAK_TWO]
    )  # fmt: skip


@inline
def inlined_balance(t: Any, step: Step) -> None:
    """Evaluate ``F`` at the unknowns of a step, with its modulated gains, its end states and its mean efforts."""
    x, wj = step.x, step.wj
    junction_flows(t, step.theta, x, step.y, wj)
    if count(t, FACTORS) > 0:
        modulate(t, step)
    junction_terms(t, step)
    first = t[0, LEAVES]
    for leaf in range(count(t, LEAVES)):
        row = first + leaf
        if is_closed(t, row):
            end, mean = leaf_closed(t, leaf, row, step)
        else:
            end, mean = leaf_moved(t, leaf, step, leaf_search(t, leaf, step))
        k = t[row, OWN_STORAGE]
        step.ends[k] = end
        step.means[k] = mean
        for r in range(t[row, FIRST_LINK], t[row, LAST_LINK]):
            add(step.g[r] * mean, t[r, TO_JUNCTION], wj)
    for j in range(count(t, JUNCTIONS)):
        k = junction_storage(t, j)
        step.ends[k] = x[k] + wj[CHANGE, j]
        step.means[k] = wj[FLOW, j]


@plain
def balance(t: Any, step: Step) -> None:
    """`inlined_balance` as a call."""
    stay_outside()
    inlined_balance(t, step)


@inline
def source(t: Any, s: Any, step: Step) -> Any:
    """Contribution of the source in row ``s`` to ``s̄``."""
    theta, g, x, wj = step.theta, step.g, step.x, step.wj
    leaf, r = t[s, SOURCE_LEAF], t[s, SOURCE_RESISTOR]
    if leaf >= 0:
        row = t[0, LEAVES] + leaf
        k = t[row, OWN_STORAGE]
        stored = mean_effort(t, k, x[k], step.ends[k], theta) * (step.ends[k] - x[k]) / step.h
        return leaf_current(t, row, g, step.a, wj) * step.means[k] - stored
    if r >= 0:
        effort = branch_effort(t, r, g, wj)
        return effort * resistor_flow(t, r, effort, read(t, t[r, READ], step), theta)
    if t[s, SOURCE_EFFORT] >= 0:
        return step.means[t[s, SOURCE_EFFORT]]
    if t[s, SOURCE_FLOW] >= 0:
        return wj[FLOW, t[s, SOURCE_FLOW]]
    return step.a[t[s, SOURCE_PORT]]


@plain
def advance(t: Any, step: Step) -> None:
    """Fill the end states and the mean drives ``s̄`` of all modulator states, which follow those of the storages."""
    stay_outside()
    first = count(t, STORAGES)
    for k in range(count(t, MODULATOR_STATES)):
        row, z = t[0, MODULATOR_STATES] + k, step.x[first + k]
        total = 0.0 * step.g[0]
        for s in range(t[row, FIRST_SOURCE], t[row, LAST_SOURCE]):
            total += source(t, s, step)
        step.means[first + k] = total
        rate, decay = memory_rate(t, row, z, total, step.theta), memory_decay(t, row, step.theta)
        step.ends[first + k] = advanced(z, step.h, rate, decay)
