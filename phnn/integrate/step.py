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

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from phnn.integrate import program as at
from phnn.integrate.cache import inline, plain, stay_outside
from phnn.integrate.roots import make_gradient, make_radau
from phnn.integrate.scheme import EXACT, LOSSLESS, NEAR_REST, PATH, RADAU
from phnn.laws import FACTOR_LAWS, MEMORY_LAWS, RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.law import close_tables
from phnn.laws.leaf import rc_flow, relaxation
from phnn.laws.namespace import real
from phnn.laws.other import advanced
from phnn.laws.wide import WIDE_RESISTORS, WIDE_STORAGES, compiled

# The functions below compile the laws that exist now.
close_tables()


# How compiled functions walk along the table ``t``; a junction and a reducible storage are given by their numbers.


@inline
def count(t: Any, kind: Any) -> Any:
    """Return the number of rows of a kind."""
    return t[0, kind + 1] - t[0, kind]


@inline
def rows(t: Any, kind: Any) -> Any:
    """Return the row numbers of a kind."""
    return range(t[0, kind], t[0, kind + 1])


@inline
def junction_storage(t: Any, j: Any) -> Any:
    """Return the number of the storage of junction ``j``."""
    return t[t[0, at.JUNCTIONS] + j, at.OWN_STORAGE]


@inline
def is_linear(t: Any, j: Any) -> Any:
    """Return whether the unknown of junction ``j`` is its mean effort; otherwise it is its end state."""
    return t[t[0, at.JUNCTIONS] + j, at.IS_LINEAR] > 0


@inline
def leaf_storage(t: Any, leaf: Any) -> Any:
    """Return the number of a reducible storage among all storages."""
    return t[t[0, at.LEAVES] + leaf, at.OWN_STORAGE]


@inline
def resistors(t: Any, leaf: Any) -> Any:
    """Return the rows of the resistors of a reducible storage."""
    row = t[0, at.LEAVES] + leaf
    return range(t[row, at.FIRST_RESISTOR], t[row, at.LAST_RESISTOR])


@inline
def links(t: Any, leaf: Any) -> Any:
    """Return the rows that couple a reducible storage to junctions."""
    row = t[0, at.LEAVES] + leaf
    return range(t[row, at.FIRST_LINK], t[row, at.LAST_LINK])


@inline
def inlets(t: Any, leaf: Any) -> Any:
    """Return the rows that couple a reducible storage to ports."""
    row = t[0, at.LEAVES] + leaf
    return range(t[row, at.FIRST_INLET], t[row, at.LAST_INLET])


@inline
def branches(t: Any, r: Any) -> Any:
    """Return the rows that couple the junction resistor in row ``r`` to junctions."""
    return range(t[r, at.FIRST_BRANCH], t[r, at.LAST_BRANCH])


@inline
def sources(t: Any, row: Any) -> Any:
    """Return the rows of the sources of the modulator state in a row."""
    return range(t[row, at.FIRST_SOURCE], t[row, at.LAST_SOURCE])


def _of_law(name: str, leading: int, laws: Mapping[str, Any], wide: Iterable[Callable[..., Any]] = ()) -> Any:
    """Return a compiled ``name(t, r, a_1…a_leading, theta)``: one function of the law of row ``r``, by its code.

    Args:
        name: of the function of a law; a law may lack it.
        leading: number of arguments before the parameters.
        wide: of neural laws, whose codes follow: ``(a_1…a_leading, theta, first, units)``.
    """
    given = [f"a{i}" for i in range(leading)]
    calls: dict[int, str] = {}
    scope: dict[str, Any] = {"stay_outside": stay_outside, "__name__": __name__}
    for code, law in enumerate(laws.values()):
        if getattr(law, name) is not None:
            scope[f"f{code}"] = inline(getattr(law, name))
            parameters = [f"theta[t[r, {at.PLACE_1 + k}]]" for k in range(len(law.example))]
            calls[code] = f"f{code}({', '.join([*given, *parameters])})"
    for code, function in enumerate(wide, len(laws)):
        scope[f"f{code}"] = function
        calls[code] = f"f{code}({', '.join([*given, 'theta', f't[r, {at.PLACE_1}]', f't[r, {at.PLACE_2}]'])})"
    lines = [f"def {name}({', '.join(['t', 'r', *given, 'theta'])}):", "    stay_outside()"]
    lines += [f"    if t[r, {at.LAW}] == {code}:\n        return {call}" for code, call in calls.items()]
    # The last branch needs no test, so that the function returns on every path.
    lines[-1] = f"    return {list(calls.values())[-1]}"
    # The text is built from numbers only.
    exec("\n".join(lines), scope)
    # Not inlined: it has many call sites, and the constants of the common laws are computed beforehand.
    return plain(scope[name])


def _unmodulated(flow: Any) -> Any:
    """Return a flow with an unused read-only argument."""

    def with_read(effort: Any, q: Any, theta: Any, first: Any, units: Any) -> Any:
        return flow(effort, theta, first, units)

    return plain(with_read)


# Of the law in row r: ē(a, b) of a storage; φ(ε, q) of a resistor, (ρ, lo, hi)(q) of a piecewise linear one, and
# (x⁺, ē)(x, i, h, s) of one that depends on the path alone; f(q) of a modulation; f(z, s) and d of a modulator state.
storage_effort = _of_law("mean_effort", 2, STORAGE_LAWS, map(compiled, WIDE_STORAGES.values()))
resistor_flow = _of_law("flow", 2, RESISTOR_LAWS, (_unmodulated(compiled(law)) for law in WIDE_RESISTORS.values()))
resistor_thresholds = _of_law("thresholds", 1, RESISTOR_LAWS)
resistor_path = _of_law("path", 4, RESISTOR_LAWS)
factor = _of_law("factor", 1, FACTOR_LAWS)
memory_rate = _of_law("rate", 2, MEMORY_LAWS)
memory_decay = _of_law("decay", 0, MEMORY_LAWS)


@inline
def mean_effort(t: Any, k: Any, a: Any, b: Any, theta: Any) -> Any:
    """Return ``ē`` of storage ``k`` between two states."""
    return storage_effort(t, t[0, at.STORAGES] + k, a, b, theta)


@inline
def stiffness(t: Any, k: Any, theta: Any) -> Any:
    """Return ``s`` of a linear storage, ``E = s x``, or of another one at rest."""
    small = NEAR_REST + 0.0 * theta[0]
    return mean_effort(t, k, small, small, theta) / NEAR_REST


# Quantities that are the same in all steps of one size: constants of storages and junctions, and gains.
#
# c (L+m, 9)  of a reducible storage: s = 1/C of a linear one; ρ, lo, hi of a piecewise linear resistor that reads no
#             state; the relaxation functions of h (ρ + g) s; g of the leaks in parallel; the relaxation functions of
#             h g s. Of a junction, in the rows after the reducible storages: 1/s
# g (rows,)   signed ratio of every row of the table that has a ratio
#
# The third array of a step, a (P,), holds the ports' actions ψ_p(ū_p) from `phnn.integrate.program`.
STIFFNESS, RHO, LOW, HIGH, ONE, TWO, LEAK, LEAK_ONE, LEAK_TWO = range(9)
CONSTANTS = 9
CAPACITY = 0


@plain
def fill_constants(t: Any, theta: Any, h: Any, c: Any) -> None:
    """Fill ``c`` for steps of size ``h``."""
    stay_outside()
    leaves = count(t, at.LEAVES)
    for leaf in range(leaves):
        row = t[0, at.LEAVES] + leaf
        if t[row, at.IS_LINEAR] > 0 or t[row, at.RULE] == PATH:
            c[leaf, STIFFNESS] = stiffness(t, t[row, at.OWN_STORAGE], theta)
        r, none = t[row, at.FIRST_RESISTOR], 0.0 * theta[0]
        leak = none
        if t[row, at.RULE] == EXACT:
            # Under this rule, all resistors of the storage but the first are linear.
            for other in range(r + 1, t[row, at.LAST_RESISTOR]):
                leak += resistor_flow(t, other, 1.0 + none, none, theta)
        c[leaf, LEAK] = leak
        c[leaf, LEAK_ONE], c[leaf, LEAK_TWO] = relaxation(h * leak * c[leaf, STIFFNESS])
        if t[row, at.RULE] == EXACT and t[r, at.READ] < 0:
            rho, low, high = resistor_thresholds(t, r, none, theta)
            c[leaf, RHO], c[leaf, LOW], c[leaf, HIGH] = rho, low, high
            c[leaf, ONE], c[leaf, TWO] = relaxation(h * (rho + leak) * c[leaf, STIFFNESS])
    for j in range(count(t, at.JUNCTIONS)):
        if is_linear(t, j):
            c[leaves + j, CAPACITY] = 1.0 / stiffness(t, junction_storage(t, j), theta)


@plain
def fill_gains(t: Any, theta: Any, g: Any) -> None:
    """Fill ``g`` with the unmodulated ratios."""
    stay_outside()
    for r in range(t.shape[0]):
        if t[r, at.RATIO] >= 0:
            g[r] = t[r, at.SIGN] * theta[t[r, at.RATIO]]


# Rows of the two work arrays: per junction (4, m) and per storage (2, N).
FLOW, CHANGE, FORCE, SIZE = range(4)
NEXT, EFFORT = range(2)


class Step(NamedTuple):
    """One step, in floats or in complex numbers.

    Attributes:
        theta: (M,) parameters.
        c, g, a: constants, ratios and actions, see above.
        x: (N,) state at its start; y: (m,) unknowns; h: its size [s].
        wj: (4, m) filled with ``v̄``, ``z − p``, ``F`` and the size of its terms.
        wx: (2, N) filled with end states and mean efforts.
    """

    theta: Any
    c: Any
    g: Any
    a: Any
    x: Any
    y: Any
    h: Any
    wj: Any
    wx: Any


@inline
def junction_change(t: Any, j: Any, c: Any, x: Any, y: Any) -> Any:
    """Return ``z_j − p_j``; of a linear storage ``2 (v̄/s − p)``, which takes no difference of end states."""
    p = x[junction_storage(t, j)]
    return 2.0 * (y[j] * c[count(t, at.LEAVES) + j, CAPACITY] - p) if is_linear(t, j) else y[j] - p


@inline
def leaf_current(t: Any, leaf: Any, g: Any, a: Any, wj: Any) -> Any:
    """Return ``i_l``."""
    total = 0.0 * g[0]
    for r in links(t, leaf):
        total += g[r] * wj[FLOW, t[r, at.TO_JUNCTION]]
    for r in inlets(t, leaf):
        total += g[r] * a[t[r, at.FROM_PORT]]
    return total


@inline
def read(t: Any, r: Any, step: Step) -> Any:
    """Return the mid-step energy variable, or modulator state, that a law may read; 0 for none.

    The ratios of a reducible storage that is read follow no energy variable. A modulator state is read at the start of
    the step.
    """
    if r < 0:
        return 0.0 * step.g[0]
    leaf, j = t[r, at.READ_LEAF], t[r, at.READ_JUNCTION]
    if t[r, at.READ_MODULATOR] >= 0:
        return step.x[t[r, at.READ_MODULATOR]]
    if leaf >= 0:
        start = step.x[leaf_storage(t, leaf)]
        return start + 0.5 * step.h * leaf_current(t, leaf, step.g, step.a, step.wj)
    return step.x[junction_storage(t, j)] + 0.5 * junction_change(t, j, step.c, step.x, step.y)


@inline
def branch_effort(t: Any, r: Any, g: Any, wj: Any) -> Any:
    """Return ``b_rᵀ v̄`` of the junction resistor in row ``r``."""
    effort = 0.0 * g[0]
    for b in branches(t, r):
        effort += g[b] * wj[FLOW, t[b, at.TO_JUNCTION]]
    return effort


@inline
def junction_flows(t: Any, theta: Any, x: Any, y: Any, wj: Any) -> None:
    """Fill ``v̄``."""
    for j in range(count(t, at.JUNCTIONS)):
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
    flow = resistor_flow(t, r, effort, read(t, t[r, at.READ], step), step.theta)
    for b in branches(t, r):
        add(g[b] * flow, t[b, at.TO_JUNCTION], wj)


@inline
def _gyrator_term(t: Any, r: Any, g: Any, wj: Any) -> None:
    add(-g[r] * wj[FLOW, t[r, at.OF_JUNCTION]], t[r, at.TO_JUNCTION], wj)


@inline
def _inlet_term(t: Any, r: Any, g: Any, a: Any, wj: Any) -> None:
    add(-g[r] * a[t[r, at.FROM_PORT]], t[r, at.INTO_JUNCTION], wj)


@inline
def junction_term(t: Any, r: Any, step: Step) -> None:
    """Add the force of the junction resistor, gyrator or junction inlet in row ``r``."""
    if r < t[0, at.JUNCTION_RESISTORS + 1]:
        _resistor_term(t, r, step)
    elif r < t[0, at.GYRATORS + 1]:
        _gyrator_term(t, r, step.g, step.wj)
    else:
        _inlet_term(t, r, step.g, step.a, step.wj)


@inline
def junction_terms(t: Any, step: Step) -> None:
    """``F`` without the reducible storages, the size of its terms, and ``z − p``."""
    x, g, wj = step.x, step.g, step.wj
    rate = 1.0 / step.h
    for j in range(count(t, at.JUNCTIONS)):
        change = junction_change(t, j, step.c, x, step.y)
        wj[CHANGE, j] = change
        wj[FORCE, j] = change * rate
        wj[SIZE, j] = (abs(change.real) + abs(x[junction_storage(t, j)].real)) * rate
    for r in rows(t, at.JUNCTION_RESISTORS):
        _resistor_term(t, r, step)
    for r in rows(t, at.GYRATORS):
        _gyrator_term(t, r, g, wj)
    for r in rows(t, at.JUNCTION_INLETS):
        _inlet_term(t, r, g, step.a, wj)


@plain
def modulate(t: Any, step: Step) -> None:
    """Set the modulated ratios to their values in this step."""
    stay_outside()
    theta, g = step.theta, step.g
    for s in rows(t, at.SCALED):
        r = t[s, 0]
        g[r] = t[r, at.SIGN] * theta[t[r, at.RATIO]]
    for f in rows(t, at.FACTORS):
        by = factor(t, f, read(t, t[f, at.READ], step), theta)
        for s in rows(t, at.SCALED):
            r = t[s, 0]
            if t[r, at.RATIO] == t[f, at.RATIO_PLACE]:
                g[r] *= by


def _make_flow(part: Any) -> Any:
    """Return ``Σ_r b_r φ_r(b_r ē)`` of a reducible storage at its mean effort between two states; ``part`` takes a
    ratio or a variable that a law reads with its perturbations or without them, ``theta`` being unperturbed."""

    def flow(start: Any, end: Any, context: Any) -> Any:
        stay_outside()
        t, leaf, step = context
        effort = mean_effort(t, leaf_storage(t, leaf), start, end, step.theta)
        total = 0.0 * effort
        for r in resistors(t, leaf):
            q, ratio = read(t, t[r, at.READ], step), part(step.g[r])
            total += ratio * resistor_flow(t, r, ratio * effort, part(q) + 0.0 * q, step.theta)
        return total

    return plain(flow)


@inline
def _whole(value: Any) -> Any:
    return value


_flow, _plain_flow = _make_flow(_whole), _make_flow(real)
_radau_search, _radau_moved = make_radau(_flow, _plain_flow)
_gradient_search, _gradient_moved = make_gradient(_flow, _plain_flow)


@inline
def is_closed(t: Any, leaf: Any) -> Any:
    """Return whether the equations of a reducible storage have a closed solution."""
    rule = t[t[0, at.LEAVES] + leaf, at.RULE]
    return (rule == LOSSLESS) | (rule == EXACT) | (rule == PATH)


@plain
def leaf_search(t: Any, leaf: Any, step: Step) -> Any:
    """Solve the equations of a storage without a closed solution, in real numbers: see `phnn.integrate.roots`."""
    stay_outside()
    start, current = real(step.x[leaf_storage(t, leaf)]), real(leaf_current(t, leaf, step.g, step.a, step.wj))
    context = (t, leaf, step)
    if t[t[0, at.LEAVES] + leaf, at.RULE] == RADAU:
        return _radau_search(start, current, step.h, context)
    end, slope = _gradient_search(start, current, step.h, context)
    return end, slope, 0.0, 0.0


@plain
def leaf_moved(t: Any, leaf: Any, step: Step, solution: Any) -> Any:
    """Return the end state and mean effort of a reducible storage from the result of `leaf_search`."""
    stay_outside()
    k = leaf_storage(t, leaf)
    context, start = (t, leaf, step), step.x[k]
    current = leaf_current(t, leaf, step.g, step.a, step.wj)
    if t[t[0, at.LEAVES] + leaf, at.RULE] == RADAU:
        return _radau_moved(start, current, step.h, step.c[leaf, STIFFNESS], solution, context)
    end = _gradient_moved(start, current, step.h, (solution[0], solution[1]), context)
    return end, mean_effort(t, k, start, end, step.theta)


@inline
def exact_flow(x: Any, current: Any, h: Any, c: Any, slope: Any) -> Any:
    """Return end state and mean effort under the exact flow, from a storage's constants and ``(ρ, lo, hi, φ₁, φ₂)``."""
    rho, low, high, one, two = slope
    stiffness, leak = c[STIFFNESS], c[LEAK]
    return rc_flow(x, current, h, stiffness, rho, low, high, leak, one, two, c[LEAK_ONE], c[LEAK_TWO])


@inline
def leaf_closed(t: Any, leaf: Any, step: Step) -> Any:
    """Return the end state and mean effort of a reducible storage with a closed solution."""
    theta, c, x, h = step.theta, step.c, step.x, step.h
    row = t[0, at.LEAVES] + leaf
    k, rule = t[row, at.OWN_STORAGE], t[row, at.RULE]
    current = leaf_current(t, leaf, step.g, step.a, step.wj)
    if rule == LOSSLESS:
        gain = h * current
        if t[row, at.IS_LINEAR] > 0:
            return x[k] + gain, c[leaf, STIFFNESS] * (x[k] + 0.5 * gain)
        return x[k] + gain, mean_effort(t, k, x[k], x[k] + gain, theta)
    if rule == PATH:
        return resistor_path(t, t[row, at.FIRST_RESISTOR], x[k], current, h, c[leaf, STIFFNESS], theta)
    constants, r = c[leaf], t[row, at.FIRST_RESISTOR]
    slope = constants[RHO], constants[LOW], constants[HIGH], constants[ONE], constants[TWO]
    if t[r, at.READ] >= 0:
        rho, low, high = resistor_thresholds(t, r, read(t, t[r, at.READ], step), theta)
        one, two = relaxation(h * (rho + constants[LEAK]) * constants[STIFFNESS])
        slope = rho, low, high, one, two
    return exact_flow(x[k], current, h, constants, slope)


@inline
def inlined_balance(t: Any, step: Step) -> None:
    """Evaluate ``F`` at the unknowns of a step, with the modulated ratios, the end states and mean efforts."""
    x, wj, wx = step.x, step.wj, step.wx
    junction_flows(t, step.theta, x, step.y, wj)
    if count(t, at.FACTORS) > 0:
        modulate(t, step)
    junction_terms(t, step)
    for leaf in range(count(t, at.LEAVES)):
        if is_closed(t, leaf):
            end, mean = leaf_closed(t, leaf, step)
        else:
            end, mean = leaf_moved(t, leaf, step, leaf_search(t, leaf, step))
        k = leaf_storage(t, leaf)
        wx[NEXT, k] = end
        wx[EFFORT, k] = mean
        for r in links(t, leaf):
            add(step.g[r] * mean, t[r, at.TO_JUNCTION], wj)
    for j in range(count(t, at.JUNCTIONS)):
        k = junction_storage(t, j)
        wx[NEXT, k] = x[k] + wj[CHANGE, j]
        wx[EFFORT, k] = wj[FLOW, j]


@plain
def balance(t: Any, step: Step) -> None:
    """`inlined_balance` as a call."""
    stay_outside()
    inlined_balance(t, step)


@inline
def source(t: Any, s: Any, step: Step) -> Any:
    """Return the contribution of the source in row ``s`` to ``s̄``."""
    theta, g, x, wj, wx = step.theta, step.g, step.x, step.wj, step.wx
    leaf, r = t[s, at.SOURCE_LEAF], t[s, at.SOURCE_RESISTOR]
    if leaf >= 0:
        k = leaf_storage(t, leaf)
        end = wx[NEXT, k]
        stored = mean_effort(t, k, x[k], end, theta) * (end - x[k]) / step.h
        return leaf_current(t, leaf, g, step.a, wj) * wx[EFFORT, k] - stored
    if r >= 0:
        effort = branch_effort(t, r, g, wj)
        return effort * resistor_flow(t, r, effort, read(t, t[r, at.READ], step), theta)
    if t[s, at.SOURCE_EFFORT] >= 0:
        return wx[EFFORT, t[s, at.SOURCE_EFFORT]]
    if t[s, at.SOURCE_FLOW] >= 0:
        return wj[FLOW, t[s, at.SOURCE_FLOW]]
    return step.a[t[s, at.SOURCE_PORT]]


@plain
def advance(t: Any, step: Step) -> None:
    """Fill the end states and the mean drives ``s̄`` of all modulator states, which follow the storages."""
    stay_outside()
    first, wx = count(t, at.STORAGES), step.wx
    for k in range(count(t, at.MODULATOR_STATES)):
        row, z = t[0, at.MODULATOR_STATES] + k, step.x[first + k]
        total = 0.0 * step.g[0]
        for s in sources(t, row):
            total += source(t, s, step)
        wx[EFFORT, first + k] = total
        rate, decay = memory_rate(t, row, z, total, step.theta), memory_decay(t, row, step.theta)
        wx[NEXT, first + k] = advanced(z, step.h, rate, decay)
