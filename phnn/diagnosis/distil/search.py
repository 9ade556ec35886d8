"""Search for a formula: all terms and pairs of terms on a grid of their shapes, then the best of them refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from phnn.diagnose.linearised import tie
from phnn.diagnosis.distil.grammar import NAMED, Term
from phnn.diagnosis.distil.response import Columns, Target
from phnn.effects import Scales
from phnn.identification.covariance import scatter
from phnn.laws.namespace import TINY

Array = NDArray[np.float64]

# Formulas of one and of two terms that are refined after the grid, and steps of a refinement.
_SINGLES, _PAIRS, _STEPS = 3, 4, 15
# Formulas that are fitted to all recordings after a race on few.
_LAST = 3
# Probability that an interval contains its number.
_SHARE = 0.95
# A term of which base parameters leave less than this share of its square is one of theirs.
_TAKEN = 1e-6
# Pairs more alike than this on the grid cannot be told apart.
_ALIKE = 1.0 - 1e-8


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
    def by_term(self) -> list[tuple[Term, float, Array]]:
        """Terms with their size and shapes."""
        ends = np.cumsum([len(t.shapes) for t in self.terms])
        return list(zip(self.terms, map(float, self.sizes), np.split(self.shapes, ends[:-1]), strict=True))


def best_formulas(goal: Target, look: Target, terms: Sequence[Term]) -> list[Formula]:
    """Formulas of one and two terms, least price first; empty where no term explains anything.

    Args:
        look: the target as few recordings show it, on which formulas race for a place among the last.
    """
    begun = [_refined(look, f) for f in _on_grid(look, terms)]
    if look is not goal:
        begun = sorted(begun, key=lambda f: f.cost + tie_of(look, f) * f.numbers)[:_LAST]
        begun = [_refined(goal, f) for f in begun]
    found = [_rounded(goal, f) for f in begun]
    found = [f for f in found if np.all(f.sizes != 0.0)]
    if not found:
        return []
    # Of so many pairs some would save by chance what one number is worth.
    rate = tie_of(goal, min(found, key=lambda f: f.cost))
    return sorted((replace(f, price=f.cost + rate * f.numbers) for f in found), key=lambda f: f.price)


def tie_of(goal: Target, formula: Formula) -> float:
    """Difference of sums of squares below which two formulas are not told apart: as of two refits that leave as much
    as this formula."""
    fit = goal.linearised.fit
    return tie(fit) * max(1.0, formula.cost / formula.left.size) / max(1.0, fit.chi2)


def unit_responses(goal: Target, terms: Sequence[tuple[Term, Array]]) -> Array:
    """(N, T) responses to terms of size one with the given shapes."""
    return goal.columns(forces_of(goal.linearised.scales, terms))


def forces_of(scales: Scales, terms: Sequence[tuple[Term, Array]]) -> Columns:
    """Terms of size one with the given shapes, as forces along displacements and velocities.

    Args:
        scales: of the reference displacement and speed.
    """

    def forces(q: Array, v: Array) -> Array:
        s = q / scales.displacement
        return np.column_stack([term.force(s, v, scales.velocity, *shapes) for term, shapes in terms])

    return forces


def _on_grid(goal: Target, terms: Sequence[Term]) -> list[Formula]:
    """The best single terms and pairs with shapes on a grid, of every kind one."""
    points = [(t, np.array(p)) for t in terms for p in product(*(s.starts for s in t.shapes))]
    columns, wanted = goal.free(unit_responses(goal, points)), goal.free(goal.wanted)
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
    kept = [sorted(best.values(), reverse=True)[:most] for best, most in ((singles, _SINGLES), (pairs, _PAIRS))]
    return [_begun(points, columns, wanted, chosen) for _, chosen in (*kept[0], *kept[1])]


def _begun(points: Sequence[tuple[Term, Array]], columns: Array, wanted: Array, chosen: tuple[int, ...]) -> Formula:
    """A formula at points of the grid."""
    mine = columns[:, chosen]
    sizes: Array = np.linalg.lstsq(mine, wanted, rcond=None)[0].astype(np.float64)
    shapes = np.concatenate([points[i][1] for i in chosen])
    return Formula(tuple(points[i][0] for i in chosen), sizes, shapes, wanted - mine @ sizes, (False,) * shapes.size)


def _with_slopes(goal: Target, formula: Formula) -> tuple[Array, Array]:
    """(N, T) unit responses, and (N, S) derivatives of the whole response by the shapes that are free."""
    found, count = goal.free(unit_responses(goal, in_slopes(formula))), len(formula.terms)
    owners = np.repeat(np.arange(count), [len(t.shapes) for t in formula.terms])
    slopes = found[:, count:] * formula.sizes[owners]
    return found[:, :count], slopes[:, [not f for f in formula.fixed]]


def in_slopes(formula: Formula) -> list[tuple[Term, Array]]:
    """The terms of a formula and, behind them, the derivative of each by each of its shapes; all of size one."""
    moved: list[tuple[Term, Array]] = [(term, shapes) for term, _, shapes in formula.by_term]
    return moved + [(_slope_of(t, k), shapes) for t, _, shapes in formula.by_term for k in range(shapes.size)]


def _slope_of(term: Term, k: int) -> Term:
    """The derivative of a term by one of its shapes, as a term."""

    def force(s: Array, v: Array, v0: float, *shapes: float) -> Array:
        perturbed = [complex(x, TINY) if i == k else x for i, x in enumerate(shapes)]
        return np.imag(term.force(s, v, v0, *perturbed)) / TINY

    return replace(term, force=force)


def _refined(goal: Target, formula: Formula) -> Formula:
    """Sizes and free shapes by least squares."""
    wanted, count = goal.free(goal.wanted), len(formula.terms)
    free = [i for i, f in enumerate(formula.fixed) if not f]
    limits = [s for t in formula.terms for s in t.shapes]
    lower = [-np.inf if t.signed else 0.0 for t in formula.terms] + [limits[i].lower for i in free]
    upper = [np.inf] * count + [limits[i].upper for i in free]
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
    exponents = [s.exponent for t in formula.terms for s in t.shapes]
    shapes, fixed = formula.shapes.copy(), list(formula.fixed)
    for i, (low, high) in enumerate(formula.intervals):
        inside = [n for n in NAMED if low <= n <= high]
        if exponents[i] and inside:
            shapes[i], fixed[i] = inside[int(np.argmin(np.abs(np.array(inside) - shapes[i])))], True
    if not any(fixed):
        return formula
    rounded = _refined(goal, replace(formula, shapes=shapes, fixed=tuple(fixed)))
    return rounded if rounded.cost <= formula.cost + tie_of(goal, formula) else formula


def _intervals(goal: Target, formula: Formula) -> tuple[tuple[float, float], ...]:
    """95 % intervals of the shapes, everything else free beside them, within their bounds."""
    columns, slopes = _with_slopes(goal, formula)
    jacobian = np.hstack([goal.base, columns, slopes])
    found = scatter(formula.left, jacobian, goal.linearised.plan.recordings, goal.linearised.slices)
    first = jacobian.shape[1] - slopes.shape[1]
    limits = [s for t in formula.terms for s in t.shapes]
    out = []
    for i, (value, shape) in enumerate(zip(formula.shapes, limits, strict=True)):
        spread = float(np.sqrt(max(found.covariance[first + i, first + i], 0.0)))
        reach = float(student.ppf(0.5 + 0.5 * _SHARE, found.freedom[first + i])) * spread
        out.append((max(float(value) - reach, shape.lower), min(float(value) + reach, shape.upper)))
    return tuple(out)
