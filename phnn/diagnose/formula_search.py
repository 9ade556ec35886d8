"""Search for a formula of a learned force: all terms and pairs of terms on a grid of their shapes, the best refined.

A damper's term is ``F |v/v₀|ⁿ sign v`` times 1, a power of the displacement, a ramp on one side of it, or a direction.
A spring's term is a power of the displacement on both sides, odd or even, or on one side, or a ramp with an onset.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from phnn.derivatives import output_derivatives
from phnn.diagnose.linearised import LinearisedFit, tie
from phnn.effects import Effect, Scales
from phnn.identification.covariance import scatter
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.laws.namespace import TINY
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.simulate import Trajectory

Array = NDArray[np.float64]
Numbers = NDArray[Any]  # a shape may have an imaginary part, by which derivatives are taken
Force = Callable[[Array, Array], Array]  # (n,) displacements, (n,) velocities -> (n, F) forces

# Values at which an exponent reads as a law that has a name.
_NAMED = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
# A power of zero has no derivative by its exponent.
_LEAST = 1e-12
# Formulas of one and of two terms that are refined after the grid, steps of a refinement, and formulas that are fitted
# to all recordings after a race on few.
_SINGLES, _PAIRS, _STEPS, _LAST = 3, 4, 15, 3
# Probability that an interval contains its number.
_SHARE = 0.95
# A term of which base parameters leave less than this share of its square is one of theirs.
_TAKEN = 1e-6
# Pairs more alike than this on the grid cannot be told apart.
_ALIKE = 1.0 - 1e-8


@dataclass(frozen=True)
class Shape:
    """A number in a term beside its size.

    Attributes:
        symbol: LaTeX.
        starts: values from which it is fitted; lower, upper: its bounds.
        exponent: whether it is one, else a displacement over the reference.
    """

    symbol: str
    starts: tuple[float, ...]
    lower: float
    upper: float
    exponent: bool = True


@dataclass(frozen=True)
class Term:
    """One term of a formula, a force [N] over its size.

    Attributes:
        name: of the kind of term.
        kind: of the learned element: ``dissipative`` or ``elastic``.
        shapes: its further numbers.
        force: ``(q/q₀, v, v₀, *shapes) -> (n,)``.
        latex: of the texts of its shapes.
        signed: whether its size may be negative.
    """

    name: str
    kind: str
    shapes: tuple[Shape, ...]
    force: Callable[..., Numbers]
    latex: Callable[..., str]
    signed: bool = False


def _speed(v: Array, v0: float, n: Any, forward: float = 1.0, backward: float = 1.0) -> Numbers:
    """``±|v/v₀|ⁿ`` as the dampers of the package have it, smoothed near rest."""
    return np.asarray(RESISTOR_LAWS["power_damper"].flow(v + 0.0 * n, 0.0, forward, backward, n, v0))


def _power(s: Array, m: Any) -> Numbers:
    """``sᵐ`` of ``s ≥ 0``."""
    return np.asarray(np.where(s > _LEAST, np.maximum(s, _LEAST) ** m, 0.0))


def _ramp(s: Array) -> Array:
    return np.maximum(s, 0.0)


def _odd(base: str, text: str, variable: str) -> str:
    """LaTeX of a power of a magnitude times the sign of a variable."""
    sign = rf"\mathrm{{sign}}\,{variable}"
    return {"0": sign, "1": base}.get(text, rf"\left|{base}\right|^{{{text}}}{sign}")


def _even(base: str, text: str) -> str:
    """LaTeX of a power of a magnitude."""
    power = rf"\left({base}\right)^{{{text}}}" if text in ("2", "4") else rf"\left|{base}\right|^{{{text}}}"
    return {"0": "1", "1": rf"\left|{base}\right|"}.get(text, power)


def _one_sided(inside: str, text: str = "1") -> str:
    return rf"\max({inside}, 0)" + ("" if text == "1" else rf"^{{{text}}}")


_N = Shape("n", _NAMED, 0.0, 3.0)
_M = Shape("m", (1.0, 2.0, 3.0), 0.3, 4.0)
_P = Shape("n", (0.5, 1.5, 2.0, 3.0, 4.0), 0.0, 5.0)
_G = Shape("g", (0.2, 0.4, 0.6, 0.8), 0.0, 0.95, exponent=False)
_S, _W = r"\frac{q}{q_0}", r"\frac{v}{v_0}"
TERMS: Mapping[str, tuple[Term, ...]] = {
    "dissipative": (
        Term("plain", "dissipative", (_N,), lambda s, v, v0, n: _speed(v, v0, n), lambda n: _odd(_W, n, "v")),
        Term("forwards", "dissipative", (_N,), lambda s, v, v0, n: _speed(v, v0, n, 1.0, 0.0),
             lambda n: _odd(_W, n, "v") + r"\,[v > 0]"),
        Term("backwards", "dissipative", (_N,), lambda s, v, v0, n: _speed(v, v0, n, 0.0, 1.0),
             lambda n: _odd(_W, n, "v") + r"\,[v < 0]"),
        Term("distance", "dissipative", (_N, _M), lambda s, v, v0, n, m: _power(np.abs(s), m) * _speed(v, v0, n),
             lambda n, m: rf"{_even(_S, m)}\,{_odd(_W, n, 'v')}"),
        Term("right", "dissipative", (_N,), lambda s, v, v0, n: _ramp(s) * _speed(v, v0, n),
             lambda n: rf"{_one_sided(_S)}\,{_odd(_W, n, 'v')}"),
        Term("left", "dissipative", (_N,), lambda s, v, v0, n: _ramp(-s) * _speed(v, v0, n),
             lambda n: rf"{_one_sided('-' + _S)}\,{_odd(_W, n, 'v')}"),
    ),
    "elastic": (
        Term("odd", "elastic", (_P,), lambda s, v, v0, n: np.sign(s) * _power(np.abs(s), n),
             lambda n: _odd(_S, n, "q"), True),
        Term("even", "elastic", (_P,), lambda s, v, v0, n: _power(np.abs(s), n), lambda n: _even(_S, n), True),
        Term("right", "elastic", (_P,), lambda s, v, v0, n: _power(_ramp(s), n), lambda n: _one_sided(_S, n), True),
        Term("left", "elastic", (_P,), lambda s, v, v0, n: -_power(_ramp(-s), n),
             lambda n: "-" + _one_sided("-" + _S, n), True),
        Term("stop", "elastic", (_G,), lambda s, v, v0, g: _ramp(s - g), lambda g: _one_sided(f"{_S} - {g}"), True),
        Term("stop on the left", "elastic", (_G,), lambda s, v, v0, g: -_ramp(-s - g),
             lambda g: "-" + _one_sided(f"-{_S} - {g}"), True),
    ),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Formula:
    """A sum of terms with their numbers.

    Attributes:
        terms: one or two.
        sizes: (T,) of the terms [N].
        shapes: (S,) numbers of all terms, in order; fixed: which of them were rounded.
        left: (N,) residual that it leaves, to first order, base parameters moved along.
        intervals: (S,) ends of the 95 % intervals, before rounding.
        price: sum of squares that it leaves, and `tie_of` the best formula for every number.
    """

    terms: tuple[Term, ...]
    sizes: Array
    shapes: Array
    left: Array
    fixed: tuple[bool, ...]
    intervals: tuple[tuple[float, float], ...] = ()
    price: float = np.inf

    @property
    def cost(self) -> float:
        """Weighted sum of squares that it leaves."""
        return float(self.left @ self.left)

    @property
    def numbers(self) -> int:
        """How many numbers were fitted."""
        return self.sizes.size + sum(not f for f in self.fixed)

    @property
    def limits(self) -> list[Shape]:
        """The kinds of all its shapes, in order."""
        return [s for t in self.terms for s in t.shapes]

    @property
    def by_term(self) -> list[tuple[Term, float, Array]]:
        """Terms with their size and shapes."""
        ends = np.cumsum([len(t.shapes) for t in self.terms])
        return list(zip(self.terms, map(float, self.sizes), np.split(self.shapes, ends[:-1]), strict=True))

    @property
    def units(self) -> list[tuple[Term, Array]]:
        """Its terms, all of size one."""
        return [(term, shapes) for term, _, shapes in self.by_term]

    @property
    def slopes(self) -> list[tuple[Term, Array]]:
        """The derivative of each term by each of its shapes, all of size one."""
        return [(_slope_of(term, k), shapes) for term, shapes in self.units for k in range(shapes.size)]

    def split(self, responses: Array) -> tuple[Array, Array]:
        """Return (N, T) responses to `units`, and (N, S) derivatives of the whole response by the shapes that are free.

        Args:
            responses: to `units` and `slopes`.
        """
        count = len(self.terms)
        owners = np.repeat(np.arange(count), [len(t.shapes) for t in self.terms])
        slopes = responses[:, count:] * self.sizes[owners]
        return responses[:, :count], slopes[:, [not f for f in self.fixed]]


def _slope_of(term: Term, k: int) -> Term:
    """The derivative of a term by one of its shapes, as a term."""

    def force(s: Array, v: Array, v0: float, *shapes: float) -> Array:
        perturbed = [complex(x, TINY) if i == k else x for i, x in enumerate(shapes)]
        return np.imag(term.force(s, v, v0, *perturbed)) / TINY

    return replace(term, force=force)


def forces_of(scales: Scales, terms: Sequence[tuple[Term, Array]]) -> Force:
    """Return terms of size one with the given shapes as forces along displacements and velocities.

    Args:
        scales: of the reference displacement and speed.
    """

    def forces(q: Array, v: Array) -> Array:
        s = q / scales.displacement
        return np.column_stack([term.force(s, v, scales.velocity, *shapes) for term, shapes in terms])

    return forces


def element_force(setup: Setup, element: Effect) -> Force:
    """Return the force (n, 1) [N] with which an element of a setup resists.

    Args:
        setup: with the element; its storages and resistors are those that take the element's strengths.
    """
    values, mine = setup.values(), set(element.strengths)

    def force(q: Array, v: Array) -> Array:
        total = np.zeros_like(q)
        for s in (s for s in setup.network.storages if mine & set(s.parameters)):
            total += np.asarray(STORAGE_LAWS[s.law].mean_effort(q, q, *(values[n] for n in s.parameters)))
        for r in (r for r in setup.network.resistors if mine & set(r.parameters)):
            read = q if r.modulated_by else 0.0 * q
            total += np.asarray(RESISTOR_LAWS[r.law].flow(v, read, *(values[n] for n in r.parameters)))
        return total[:, None]

    return force


def response(trajectory: Trajectory, forces: Force) -> Array:
    """Return (N, F) changes of the output [m] by forces that resist the motion of a trajectory."""
    pushes = -forces(trajectory.mid_displacement, trajectory.velocity)
    return output_derivatives(trajectory, (), (), np.ascontiguousarray(pushes))


@dataclass(frozen=True)
class Target:
    """What the data say of a learned force, to first order around the fit that has it.

    A force ``f`` in its place, with base parameters shifted by ``z``, leaves ``wanted − R f − base z``.

    Attributes:
        linearised: of the fit with the element.
        base: (N, K) derivatives of the output by all variables of the fit but the element's strengths.
        names: (K,) of these; a number for an initial state or an instant.
        wanted: (N,) the residual, and the response to the learned force.
        basis: (N, K) orthonormal basis of ``base``.
    """

    linearised: LinearisedFit
    base: Array
    names: tuple[str, ...]
    wanted: Array
    basis: Array

    def columns(self, terms: Sequence[tuple[Term, Array]]) -> Array:
        """Return (N, F) weighted responses of the output to terms of size one."""
        return _weighted(self.linearised, forces_of(self.linearised.scales, terms))

    def base_values(self, formula: Formula) -> dict[str, float]:
        """Return the value [SI] of every base parameter beside a formula."""
        wanted = self.wanted - self.columns(formula.units) @ formula.sizes
        shift = np.linalg.lstsq(self.base, wanted, rcond=None)[0]
        parameters = self.linearised.fit.setup.parameters
        moved = ((parameters[n], float(z)) for n, z in zip(self.names, shift, strict=True) if n in parameters)
        # Forces are linear in the value, not in its logarithm.
        return {p.name: p.value + p.slope(p.value) * z for p, z in moved}

    def free(self, columns: Array) -> Array:
        """Return columns without the part that base parameters can take over."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def target(linearised: LinearisedFit, element: Effect) -> Target:
    """Return the target of a formula for an element of a fitted model."""
    fit = linearised.fit
    named = fit.variables.names
    names = (*named, *map(str, range(len(named), fit.jacobian.shape[1])))
    kept = [n not in element.strengths and bool(np.any(c)) for n, c in zip(names, fit.jacobian.T, strict=True)]
    # The derivatives of the residual are those of the output, with the other sign.
    base = -fit.jacobian[:, kept]
    learned = _weighted(linearised, element_force(fit.setup, element))[:, 0]
    left = tuple(n for n, k in zip(names, kept, strict=True) if k)
    return Target(linearised, base, left, fit.residual + learned, np.linalg.qr(base)[0])


def _weighted(linearised: LinearisedFit, forces: Force) -> Array:
    def one(_: Recording, trajectory: Trajectory) -> Array:
        return response(trajectory, forces)

    return linearised.stack(linearised.plan.each(one, linearised.trajectories))


def best_formulas(goal: Target, few: Target, terms: Sequence[Term]) -> list[Formula]:
    """Return formulas of one and two terms, least price first; empty where no term explains anything.

    Args:
        few: the target as few recordings show it, on which formulas race for a place among the last.
    """
    refined = [_refined(few, f) for f in _on_grid(few, terms)]
    if few is not goal:
        refined = sorted(refined, key=lambda f: f.cost + tie_of(few, f) * f.numbers)[:_LAST]
        refined = [_refined(goal, f) for f in refined]
    rounded = [f for f in (_rounded(goal, f) for f in refined) if np.all(f.sizes != 0.0)]
    if not rounded:
        return []
    # Of so many pairs some would save by chance what one number is worth.
    rate = tie_of(goal, min(rounded, key=lambda f: f.cost))
    return sorted((replace(f, price=f.cost + rate * f.numbers) for f in rounded), key=lambda f: f.price)


def tie_of(goal: Target, formula: Formula) -> float:
    """Return the difference of sums of squares below which two formulas are not told apart: as of two refits that leave
    as much as this formula."""
    fit = goal.linearised.fit
    return tie(fit) * max(1.0, formula.cost / formula.left.size) / max(1.0, fit.chi2)


def _on_grid(goal: Target, terms: Sequence[Term]) -> list[Formula]:
    """The best single terms and pairs with shapes on a grid, of every kind one."""
    points = [(t, np.array(p)) for t in terms for p in product(*(s.starts for s in t.shapes))]
    columns, wanted = goal.free(goal.columns(points)), goal.free(goal.wanted)
    gram, along = columns.T @ columns, columns.T @ wanted
    power = np.diag(gram)
    alive = [i for i in range(len(points)) if power[i] > _TAKEN * power.max()]
    singles: dict[tuple[str, ...], tuple[float, tuple[int, ...]]] = {}
    pairs: dict[tuple[str, ...], tuple[float, tuple[int, ...]]] = {}
    for chosen in [(i,) for i in alive] + list(combinations(alive, 2)):
        block = np.ix_(chosen, chosen)
        if len(chosen) == 2 and gram[chosen] ** 2 > _ALIKE * power[chosen[0]] * power[chosen[1]]:
            continue
        sizes = np.linalg.solve(gram[block], along[list(chosen)])
        if any(size < 0.0 and not points[i][0].signed for i, size in zip(chosen, sizes, strict=True)):
            continue
        saved, kind = float(sizes @ along[list(chosen)]), tuple(points[i][0].name for i in chosen)
        best = singles if len(chosen) == 1 else pairs
        if kind not in best or saved > best[kind][0]:
            best[kind] = saved, chosen

    def formula(chosen: tuple[int, ...]) -> Formula:
        mine = columns[:, chosen]
        sizes: Array = np.linalg.lstsq(mine, wanted, rcond=None)[0].astype(np.float64)
        shapes = np.concatenate([points[i][1] for i in chosen])
        return Formula(
            tuple(points[i][0] for i in chosen), sizes, shapes, wanted - mine @ sizes, (False,) * shapes.size
        )

    kept = [sorted(best.values(), reverse=True)[:most] for best, most in ((singles, _SINGLES), (pairs, _PAIRS))]
    return [formula(chosen) for _, chosen in (*kept[0], *kept[1])]


def _with_slopes(goal: Target, formula: Formula) -> tuple[Array, Array]:
    """(N, T) unit responses without what the base can take over, and (N, S) derivatives by the shapes that are free."""
    return formula.split(goal.free(goal.columns([*formula.units, *formula.slopes])))


def _refined(goal: Target, formula: Formula) -> Formula:
    """Sizes and free shapes by least squares."""
    wanted, count = goal.free(goal.wanted), len(formula.terms)
    free = [i for i, f in enumerate(formula.fixed) if not f]
    lower = [-np.inf if t.signed else 0.0 for t in formula.terms] + [formula.limits[i].lower for i in free]
    upper = [np.inf] * count + [formula.limits[i].upper for i in free]
    known: dict[bytes, tuple[Array, Array]] = {}

    def at(x: Array) -> Formula:
        shapes = formula.shapes.copy()
        shapes[free] = x[count:]
        return replace(formula, sizes=x[:count], shapes=shapes)

    def columns(x: Array) -> tuple[Array, Array]:
        if x.tobytes() not in known:
            known.clear()
            known[x.tobytes()] = _with_slopes(goal, at(x))
        return known[x.tobytes()]

    def residual(x: Array) -> Array:
        return np.asarray(wanted - columns(x)[0] @ x[:count])

    def jacobian(x: Array) -> Array:
        return -np.hstack(columns(x))

    start = np.clip(np.append(formula.sizes, formula.shapes[free]), np.add(lower, 1e-9), np.subtract(upper, 1e-9))
    result = least_squares(residual, start, jacobian, (lower, upper), x_scale="jac", max_nfev=_STEPS)
    return replace(at(result.x), left=residual(result.x))


def _rounded(goal: Target, formula: Formula) -> Formula:
    """Exponents that may have a value with a name get it, unless more is left then; with their intervals before."""
    formula = replace(formula, intervals=_intervals(goal, formula))
    shapes, fixed = formula.shapes.copy(), list(formula.fixed)
    for i, (low, high) in enumerate(formula.intervals):
        inside = [n for n in _NAMED if low <= n <= high]
        if formula.limits[i].exponent and inside:
            shapes[i], fixed[i] = inside[int(np.argmin(np.abs(np.array(inside) - shapes[i])))], True
    if not any(fixed):
        return formula
    rounded = _refined(goal, replace(formula, shapes=shapes, fixed=tuple(fixed)))
    return rounded if rounded.cost <= formula.cost + tie_of(goal, formula) else formula


def _intervals(goal: Target, formula: Formula) -> tuple[tuple[float, float], ...]:
    """95 % intervals of the shapes, everything else free beside them, within their bounds."""
    columns, slopes = _with_slopes(goal, formula)
    jacobian = np.hstack([goal.base, columns, slopes])
    spread = scatter(formula.left, jacobian, goal.linearised.plan.recordings, goal.linearised.slices)
    first = jacobian.shape[1] - slopes.shape[1]
    ends = []
    for i, (value, shape) in enumerate(zip(formula.shapes, formula.limits, strict=True), first):
        deviation = float(np.sqrt(max(spread.covariance[i, i], 0.0)))
        reach = float(student.ppf(0.5 + 0.5 * _SHARE, spread.freedom[i])) * deviation
        ends.append((max(float(value) - reach, shape.lower), min(float(value) + reach, shape.upper)))
    return tuple(ends)
