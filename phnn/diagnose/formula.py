"""The shortest formula that explains the recordings as well as a learned element does.

A formula of a spring or damper is a sum of one or two terms. It takes the element's place in the equations linearised
around the fit: its force acts along the trajectories of the fit, and base parameters and initial states move along. Its
forces ``f`` predict

    y = y_fit + B z + R (f − f_element)

with the responses ``R`` of the output to forces on the moving part, the sensitivities ``B`` of all other variables, and
their shift ``z`` with which the formula fits the recordings at hand best. All terms and pairs of terms are tried on a
grid of their exponents, and the best are refined. Formulas of the measuring chain are effects, refitted in the
element's place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import t as student

from phnn.derivatives import output_derivatives
from phnn.diagnose.linearised import LinearisedFit, simulated, tie, with_few_steps
from phnn.effects import Effect
from phnn.effects.formulas import formulas_for
from phnn.identification.covariance import scatter
from phnn.identification.fit import Fit, Slopes
from phnn.laws import RESISTOR_LAWS, STORAGE_LAWS
from phnn.parameters import quantity
from phnn.recordings.recording import Recording
from phnn.setup import Setup
from phnn.trajectory import Trajectory

Array = NDArray[np.float64]
# Fits of some effects beside a fit without them, those that can be fitted.
Refits = Callable[[Sequence[Effect]], list[tuple[Effect, Fit]]]
# (n,) displacements, (n,) velocities -> (n, F) forces that resist the motion.
Force = Callable[[Array, Array], Array]

# A formula of the measuring chain has to take this share of what the learned element takes.
_MOST = 0.8
# What a fit may leave for first order to hold, and for its remainder to be noise [noise rms]; the share of a remainder
# that is not, by which nothing is decided: it may favour either.
_LARGE, _SMALL, _DOUBTFUL = 3.0, 1.1, 0.2
# Formulas of one and of two terms that are refined after the grid, and steps of a refinement.
_SINGLES, _PAIRS, _STEPS, _GAIN = 3, 4, 15, 1e-5
# Probability that an interval contains its number.
_SHARE = 0.95
# A term of which base parameters leave less than this share of its square is one of theirs; the smallest eigenvalue of
# the inner products of a pair whose terms differ, over the largest.
_TAKEN, _ALIKE = 1e-6, 1e-8
# Half the difference of exponents by which slopes are taken.
_STEP = 1e-6
# Values at which an exponent reads as a law that has a name, and the powers in words.
_NAMED = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
_POWERS = {0.5: "root", 1.0: "first power", 1.5: "power 1.5", 2.0: "square", 3.0: "cube"}


@dataclass(frozen=True)
class Distilled:
    """A formula that leaves no more than a learned element does, up to the difference that chance can make.

    Attributes:
        equation: LaTeX, the force with which it resists.
        words: a sentence.
        parameters: value and unit by symbol: sizes of the terms and the references of displacement and speed.
        exponents: value and 95 % interval of every exponent and onset, by symbol; a value that stands in the equation
            as a round number lies in its interval.
        others: equations that these recordings cannot tell from this one.
    """

    equation: str
    words: str
    parameters: dict[str, tuple[float, str]]
    exponents: dict[str, tuple[float, tuple[float, float]]]
    others: tuple[str, ...] = ()


def distil(linearised: LinearisedFit, element: Effect, without: Fit | None, refits: Refits) -> Distilled | None:
    """Return the shortest formula for a learned element of a fitted model; None where no formula does as well.

    Args:
        linearised: of the fit with the element.
        element: a learned spring, damper or element of the measuring chain.
        without: the fit with all other elements of the model, if there is one.
        refits: fits effects beside ``without``.
    """
    if element.kind.name in TERMS:
        return _of_terms(linearised, element)
    return None if without is None else _refitted(linearised.fit, without, element, refits)


def _refitted(final: Fit, without: Fit, element: Effect, refits: Refits) -> Distilled | None:
    """Return the formula of the measuring chain that explains most; where several do, one with the fewest numbers."""
    effects = [f for f in formulas_for(element) if f.can_be_added_to(without.setup)]
    fits = refits(effects) if effects else []
    if not fits:
        return None
    reach = max(tie(final), _DOUBTFUL * final.beyond_noise if final.chi2 > _SMALL**2 else 0.0)
    least = min(f.cost for _, f in fits)
    effect, best = min((e for e in fits if e[1].cost <= least + reach), key=lambda e: (e[1].z.size, e[1].cost))
    taken, wanted = without.cost - best.cost, without.cost - final.cost
    if best.cost > final.cost + reach or taken < _MOST * wanted:
        return None
    parameters = {n: best.setup.parameters[n] for n in effect.parameters}
    return Distilled(
        equation=effect.equation,
        words=effect.statement.format(**{n: quantity(p.value, p.unit) for n, p in parameters.items()}),
        parameters={n: (p.value, p.unit) for n, p in parameters.items() if not p.fixed},
        exponents={},
        others=tuple(e.equation for e, f in fits if f is not best and f.cost <= best.cost + reach),
    )


class Shape(NamedTuple):
    """A number in a term beside its size.

    Attributes:
        symbol: LaTeX; ``g`` is a displacement over the reference, all others are exponents.
        starts: values from which it is fitted; lower, upper: its bounds.
    """

    symbol: str
    starts: tuple[float, ...]
    lower: float
    upper: float


class Term(NamedTuple):
    """One term of a formula, a force [N] over its size.

    Attributes:
        shapes: its further numbers.
        force: ``(q/q₀, v/v₀, *shapes) -> (n,)``.
        latex: of the texts of its shapes.
        words: with the powers in words as ``{0}`` and ``{1}``, and the further fields of `_in_words`.
        signed: whether its size may be negative.
    """

    name: str
    shapes: tuple[Shape, ...]
    force: Callable[..., Array]
    latex: Callable[..., str]
    words: str
    signed: bool = True


def _speed(w: Array, n: float, forward: float = 1.0, backward: float = 1.0) -> Array:
    """Return ``±|v/v₀|ⁿ`` as the dampers of the package have it, smoothed near rest."""
    return np.asarray(RESISTOR_LAWS["power_damper"].flow(w, 0.0, forward, backward, n, 1.0))


def _power(s: Array, m: float) -> Array:
    """Return ``sᵐ`` of ``s > 0``, else zero."""
    return np.where(s > 0.0, np.maximum(s, 1e-12) ** m, 0.0)


def _odd(base: str, text: str, variable: str) -> str:
    """Return the LaTeX of a power of a magnitude times the sign of a variable."""
    sign = rf"\mathrm{{sign}}\,{variable}"
    return {"0": sign, "1": base}.get(text, rf"\left|{base}\right|^{{{text}}}{sign}")


def _even(base: str, text: str) -> str:
    """Return the LaTeX of a power of a magnitude."""
    power = rf"\left({base}\right)^{{{text}}}" if text in ("2", "4") else rf"\left|{base}\right|^{{{text}}}"
    return {"0": "1", "1": rf"\left|{base}\right|"}.get(text, power)


def _ramp(inside: str, text: str = "1") -> str:
    """Return the LaTeX of a power of what is positive."""
    return rf"\max({inside}, 0)" + ("" if text == "1" else rf"^{{{text}}}")


_N = (Shape("n", _NAMED, 0.0, 3.0),)
_M = (Shape("m", (1.0, 2.0, 3.0), 0.3, 4.0),)
_P = (Shape("n", (0.5, 1.5, 2.0, 3.0, 4.0), 0.0, 5.0),)
_G = (Shape("g", (0.2, 0.4, 0.6, 0.8), 0.0, 0.95),)
_S, _W = r"\frac{q}{q_0}", r"\frac{v}{v_0}"


def _damper_of_side(direction: str, side: str, sign: float, minus: str) -> tuple[Term, Term]:
    """Return the dampers that act in one direction, or on one side."""
    ahead, back = float(sign > 0.0), float(sign < 0.0)
    word, than = ("positive", ">") if sign > 0.0 else ("negative", "<")
    return (
        Term(direction, _N, lambda s, w, n: _speed(w, n, ahead, back),
             lambda n: rf"{_odd(_W, n, 'v')}\,[v {than} 0]", f"{{speed}} in the {word} direction only", False),
        Term(side, _N, lambda s, w, n: np.maximum(sign * s, 0.0) * _speed(w, n),
             lambda n: rf"{_ramp(minus + _S)}\,{_odd(_W, n, 'v')}",
             f"{{speed}} {{that}} grows in proportion to the displacement, where that is {word}", False),
    )  # fmt: skip


def _spring_of_side(side: str, sign: float, minus: str) -> tuple[Term, Term]:
    """Return the springs that act on one side, from rest on and from an onset on."""
    word = "positive" if sign > 0.0 else "negative"
    return (
        Term(side, _P, lambda s, w, n: sign * _power(sign * s, n), lambda n: minus + _ramp(minus + _S, n),
             f"a force {{against}} the displacement that grows with its {{0}}, where it is {word}"),
        Term(f"stop on the {side}", _G, lambda s, w, g: sign * np.maximum(sign * s - g, 0.0),
             lambda g: minus + _ramp(f"{minus}{_S} - {g}"),
             f"a spring that is {{stiffer}} beyond {{gap}} of {{reference}} on the {word} side"),
    )  # fmt: skip


TERMS: Mapping[str, tuple[Term, ...]] = {
    "dissipative": (
        Term("plain", _N, lambda s, w, n: _speed(w, n), lambda n: _odd(_W, n, "v"), "{speed}", False),
        Term("distance", _N + _M, lambda s, w, n, m: _power(np.abs(s), m) * _speed(w, n),
             lambda n, m: rf"{_even(_S, m)}\,{_odd(_W, n, 'v')}",
             "{speed} {that} grows with the {1} of the distance from zero", False),
        *_damper_of_side("forwards", "right", 1.0, ""),
        *_damper_of_side("backwards", "left", -1.0, "-"),
    ),
    "elastic": (
        Term("odd", _P, lambda s, w, n: np.sign(s) * _power(np.abs(s), n), lambda n: _odd(_S, n, "q"),
             "a force {against} the displacement that grows with its {0}"),
        Term("even", _P, lambda s, w, n: _power(np.abs(s), n), lambda n: _even(_S, n),
             "a force that grows with the {0} of the displacement, in the same direction on both sides"),
        *_spring_of_side("right", 1.0, ""),
        *_spring_of_side("left", -1.0, "-"),
    ),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Formula:
    """A sum of terms with their numbers.

    Attributes:
        terms: one or two.
        sizes: (T,) of the terms [N].
        shapes: (S,) numbers of all terms, in order; fixed: which of them were rounded.
        residual: (N,) that it leaves, to first order, base parameters moved along.
        intervals: (S,) ends of the 95 % intervals, before rounding.
    """

    terms: tuple[Term, ...]
    sizes: Array
    shapes: Array
    fixed: tuple[bool, ...]
    residual: Array = field(default_factory=lambda: np.zeros(0))
    intervals: tuple[tuple[float, float], ...] = ()

    @property
    def cost(self) -> float:
        """Return the weighted sum of squares that it leaves."""
        return float(self.residual @ self.residual)

    @property
    def numbers(self) -> int:
        """Return how many numbers were fitted."""
        return self.sizes.size + sum(not f for f in self.fixed)

    @property
    def limits(self) -> list[Shape]:
        """Return the kinds of all its shapes, in order."""
        return [s for t in self.terms for s in t.shapes]

    @property
    def by_term(self) -> list[tuple[Term, float, Array]]:
        """Return the terms with their size and shapes."""
        ends = np.cumsum([len(t.shapes) for t in self.terms])
        return list(zip(self.terms, map(float, self.sizes), np.split(self.shapes, ends[:-1]), strict=True))


def _of_terms(linearised: LinearisedFit, element: Effect) -> Distilled | None:
    """Return the formula of a spring or damper with the least sum of squares, where every number has to save what two
    refits differ by that count as told apart."""
    fit, scales = linearised.fit, linearised.scales
    if fit.chi2 > _LARGE**2 or not element.strengths:
        return None
    names = (*fit.variables.names, *[""] * (fit.jacobian.shape[1] - len(fit.variables.names)))
    kept = [n not in element.strengths for n in names]
    # Directions need few samples and sub-steps.
    plan = replace(with_few_steps(linearised, linearised.plan).plan, rough=True)
    linearised = replace(linearised, trajectories=simulated(fit, plan.derived(fit.setup)))
    # The same fit without the element: a formula has to explain what the element does, and the residual beside it.
    learned = _response(linearised, force_of(fit.setup, element.strengths))[:, 0]
    bare = replace(fit, residual=fit.residual + learned, slopes=Slopes(fit.jacobian[:, kept]))
    target = replace(linearised, fit=bare)
    refined = [_refined(target, f) for f in _on_grid(target, TERMS[element.kind.name])]
    tried = [f for f in (_rounded(target, f) for f in refined) if np.all(f.sizes != 0.0)]
    if not tried:
        return None
    # Of so many pairs some would save by chance what one number is worth.
    rate = _tie(target, min(tried, key=lambda f: f.cost))
    prices = {id(f): f.cost + rate * f.numbers for f in tried}
    best, *rest = sorted(tried, key=lambda f: prices[id(f)])
    reach = _tie(target, best)
    if _with_positive_base(target, best, [n for n, k in zip(names, kept, strict=True) if k]) > fit.cost + reach:
        return None
    rivals = [f for f in rest if prices[id(f)] <= prices[id(best)] + reach and len(f.terms) <= len(best.terms)]
    speed = {"v_0": (scales.velocity, "m/s")} if element.kind.name == "dissipative" else {}
    sizes = {f"F_{i + 1}": (abs(float(size)), "N") for i, size in enumerate(best.sizes)}
    symbols = [f"{s.symbol}_{i + 1}" for i, t in enumerate(best.terms) for s in t.shapes]
    return Distilled(
        equation=_equation(best),
        words=_in_words(best, scales.displacement),
        parameters=sizes | {"q_0": (scales.displacement, "m")} | speed,
        exponents={s: (float(v), i) for s, v, i in zip(symbols, best.shapes, best.intervals, strict=True)},
        others=tuple(_equation(f) for f in rivals),
    )


def _tie(target: LinearisedFit, formula: Formula) -> float:
    """Return the difference of sums of squares below which two formulas are not told apart."""
    return tie(replace(target.fit, residual=formula.residual))


def _response(linearised: LinearisedFit, forces: Force) -> Array:
    """Return the weighted changes (N, F) of the output by forces that resist the motion."""

    def one(recording: Recording, trajectory: Trajectory) -> Array:
        pushes = -forces(trajectory.mid_displacement, trajectory.velocity)
        return recording.from_sparse(output_derivatives(trajectory, (), (), np.ascontiguousarray(pushes)))

    return linearised.stack(linearised.plan.each(one, linearised.trajectories))


def force_of(setup: Setup, strengths: Sequence[str]) -> Force:
    """Return the force (n, 1) [N] with which an element of a setup resists displacement and velocity, by the storages
    and resistors that take its strengths."""
    values, mine = setup.values(), set(strengths)

    def force(q: Array, v: Array) -> Array:
        total = np.zeros_like(q)
        for s in (s for s in setup.network.storages if mine & set(s.parameters)):
            total += np.asarray(STORAGE_LAWS[s.law].mean_effort(q, q, *(values[n] for n in s.parameters)))
        for r in (r for r in setup.network.resistors if mine & set(r.parameters)):
            read = q if r.modulated_by else 0.0 * q
            total += np.asarray(RESISTOR_LAWS[r.law].flow(v, read, *(values[n] for n in r.parameters)))
        return total[:, None]

    return force


def _responses(target: LinearisedFit, terms: Sequence[tuple[Term, Array]]) -> Array:
    """Return the weighted responses (N, F) of the output to terms of size one with the given shapes."""
    scales = target.scales

    def forces(q: Array, v: Array) -> Array:
        s, w = q / scales.displacement, v / scales.velocity
        return np.column_stack([term.force(s, w, *shapes) for term, shapes in terms])

    return _response(target, forces)


def _with_positive_base(target: LinearisedFit, formula: Formula, names: Sequence[str]) -> float:
    """Return the sum of squares of a formula whose base parameters move as well, and keep their signs."""
    wanted = target.fit.residual - _responses(target, [(t, x) for t, _, x in formula.by_term]) @ formula.sizes
    # The derivatives of the residual are those of the output, with the other sign.
    q, square = np.linalg.qr(-target.fit.jacobian)
    along, known = q.T @ wanted, target.fit.setup.parameters
    # Forces are linear in the value, not in its logarithm.
    able = [known[n] if n in known and known[n].positive else None for n in names]
    least = [-np.inf if p is None else -p.value / p.slope(p.value) for p in able]
    return float(wanted @ wanted - along @ along + 2.0 * lsq_linear(square, along, (least, np.inf)).cost)


def _on_grid(target: LinearisedFit, terms: Sequence[Term]) -> list[Formula]:
    """Return the best single terms and pairs with shapes on a grid, of every kind one."""
    points = [(t, np.array(p)) for t in terms for p in product(*(s.starts for s in t.shapes))]
    columns = target.project(_responses(target, points))
    gram, along = columns.T @ columns, columns.T @ target.residual
    power = np.diag(gram)
    alive = [i for i in range(len(points)) if power[i] > _TAKEN * power.max()]
    best: dict[tuple[str, ...], tuple[float, Formula]] = {}
    for chosen in [*combinations(alive, 1), *combinations(alive, 2)]:
        pair, kinds = list(chosen), tuple(points[i][0] for i in chosen)
        sizes: Array = np.linalg.lstsq(gram[np.ix_(pair, pair)], along[pair], rcond=_ALIKE)[0].astype(np.float64)
        saved, name = float(sizes @ along[pair]), tuple(t.name for t in kinds)
        possible = all(size >= 0.0 or t.signed for size, t in zip(sizes, kinds, strict=True))
        if possible and (name not in best or saved > best[name][0]):
            shapes = np.concatenate([points[i][1] for i in chosen])
            best[name] = saved, Formula(kinds, sizes, shapes, (False,) * shapes.size)
    ordered = [f for _, f in sorted(best.values(), key=lambda item: -item[0])]
    counts = ((1, _SINGLES), (2, _PAIRS))
    return [f for count, most in counts for f in [f for f in ordered if len(f.terms) == count][:most]]


def _with_slopes(target: LinearisedFit, formula: Formula) -> tuple[Array, Array]:
    """Return the responses (N, T) to terms of size one, without what the base can take over, and the derivatives (N, S)
    of the whole response by the shapes that are free."""
    parts = formula.by_term
    moved = [(t, x + step) for t, _, x in parts for step in _STEP * np.eye(x.size)]
    columns = target.project(_responses(target, [*((t, x) for t, _, x in parts), *moved]))
    units, ends = columns[:, : len(parts)], columns[:, len(parts) :]
    owner = np.repeat(np.arange(len(parts)), [x.size for _, _, x in parts])
    slopes = (ends - units[:, owner]) * (formula.sizes[owner] / _STEP)
    return units, slopes[:, [not f for f in formula.fixed]]


def _refined(target: LinearisedFit, formula: Formula) -> Formula:
    """Return a formula with sizes and free shapes by least squares."""
    count, free = len(formula.terms), [i for i, f in enumerate(formula.fixed) if not f]
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
            known[x.tobytes()] = _with_slopes(target, at(x))
        return known[x.tobytes()]

    def residual(x: Array) -> Array:
        return np.asarray(target.residual - columns(x)[0] @ x[:count])

    def jacobian(x: Array) -> Array:
        return -np.hstack(columns(x))

    start = np.clip(np.append(formula.sizes, formula.shapes[free]), np.add(lower, 1e-9), np.subtract(upper, 1e-9))
    result = least_squares(residual, start, jacobian, (lower, upper), x_scale="jac", ftol=_GAIN, max_nfev=_STEPS)
    return replace(at(result.x), residual=residual(result.x))


def _rounded(target: LinearisedFit, formula: Formula) -> Formula:
    """Return a formula with 95 % intervals of its shapes, everything else free beside them; exponents whose interval
    holds a value with a name have that value, unless more is left then."""
    jacobian = np.hstack([target.fit.jacobian, *_with_slopes(target, formula)])
    spread = scatter(formula.residual, jacobian, target.plan.recordings, target.slices)
    mine = slice(jacobian.shape[1] - formula.shapes.size, None)
    deviation = np.sqrt(np.maximum(np.diag(spread.covariance)[mine], 0.0))
    reach = student.ppf(0.5 + 0.5 * _SHARE, spread.freedom[mine]) * deviation
    intervals, shapes, fixed = [], formula.shapes.copy(), list(formula.fixed)
    for i, (shape, value, far) in enumerate(zip(formula.limits, formula.shapes, reach, strict=True)):
        low, high = max(float(value - far), shape.lower), min(float(value + far), shape.upper)
        intervals.append((low, high))
        inside = [(abs(n - value), n) for n in _NAMED if low <= n <= high]
        if shape.symbol != "g" and inside:
            shapes[i], fixed[i] = min(inside)[1], True
    formula = replace(formula, intervals=tuple(intervals))
    if not any(fixed):
        return formula
    rounded = _refined(target, replace(formula, shapes=shapes, fixed=tuple(fixed)))
    return rounded if rounded.cost <= formula.cost + _tie(target, formula) else formula


def _equation(formula: Formula) -> str:
    """Return LaTeX of the force with which a formula resists, its exponents as numbers."""
    text = ""
    for i, (term, size, shapes) in enumerate(formula.by_term):
        sign = "-" if size < 0.0 else "+" if i else ""
        text += rf" {sign} F_{i + 1}\,({term.latex(*(f'{x:.3g}' for x in shapes))})"
    return f"F = {text.strip()}"


def _in_words(formula: Formula, displacement: float) -> str:
    """Return a sentence that says what the formula says; ``displacement`` is the reference of displacements [m]."""
    # A value; where it is not a round one, with its interval.
    numbers = [
        f"{value:g}" if fixed else f"{value:.2f} ({low:.2f} to {high:.2f})"
        for value, fixed, (low, high) in zip(formula.shapes, formula.fixed, formula.intervals, strict=True)
    ]
    parts = []
    for term, size, shapes in formula.by_term:
        texts, numbers = numbers[: shapes.size], numbers[shapes.size :]
        powers = [_POWERS.get(float(x), f"power {text}") for x, text in zip(shapes, texts, strict=True)]
        kind = "drag" if shapes[0] in (2.0, 3.0) else "a damping force"
        speed = {0.0: "friction that does not depend on the speed", 1.0: "viscous damping"}
        parts.append(
            term.words.format(
                *powers,
                speed=speed.get(float(shapes[0]), f"{kind} that grows with the {powers[0]} of the speed"),
                # Damping as such does nothing yet to which growing could be added.
                that="that" if shapes[0] == 1.0 else "and",
                against="against" if size > 0.0 else "along",
                stiffer="stiffer" if size > 0.0 else "softer",
                gap=texts[0],
                reference=quantity(displacement, "m"),
            )
        )
    text = "; and ".join(parts)
    return f"{text[0].upper()}{text[1:]}."
