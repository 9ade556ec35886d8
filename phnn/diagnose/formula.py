"""The shortest formula that explains the recordings as well as a learned element does.

A formula of a spring or damper takes the element's place in the equations linearised around the fit: its force acts
along the trajectories of the fit, and base parameters and initial states move along. Its forces ``f`` predict

    y = y_fit + B z + R (f − f_element)

with the responses ``R`` of the output to forces on the moving part, the sensitivities ``B`` of all other variables, and
their shift ``z`` with which the formula fits the recordings at hand best. Formulas of the measuring chain are effects,
refitted in the element's place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phnn.diagnose.formula_search import (
    TERMS,
    Formula,
    Target,
    best_formulas,
    element_force,
    forces_of,
    response,
    target,
    tie_of,
)
from phnn.diagnose.linearised import LinearisedFit, tie
from phnn.diagnose.proposal import FAR, Bench, Predicted, Rival, bounded, everything, refitted_rival
from phnn.effects import Effect, Scales
from phnn.effects.formulas import formulas_for
from phnn.identification.fit import Fit
from phnn.identification.nuisances import own_size
from phnn.network.roles import motions
from phnn.units import quantity

Array = NDArray[np.float64]
# Fits of some effects beside a fit without them, those that can be fitted.
Refits = Callable[[Sequence[Effect]], list[tuple[Effect, Fit]]]
# Value and unit by symbol.
Parameters = dict[str, tuple[float, str]]

# A formula of the measuring chain has to take this share of what the learned element takes.
_MOST = 0.8
# What a fit may leave for first order to hold, and for its remainder to be noise [noise rms]; the share of a remainder
# that is not, by which nothing is decided: it may favour either.
_LARGE, _SMALL, _DOUBTFUL = 3.0, 1.1, 0.2
_SPEED = {
    0.0: "friction that does not depend on the speed",
    0.5: "a damping force that grows with the root of the speed",
    1.0: "viscous damping",
    1.5: "a damping force that grows with the power 1.5 of the speed",
    2.0: "drag that grows with the square of the speed",
    3.0: "drag that grows with the cube of the speed",
}
_POWERS = {0.5: "root", 1.0: "first power", 1.5: "power 1.5", 2.0: "square", 3.0: "cube"}
_SIDES = {
    "plain": "",
    "forwards": "in the positive direction only",
    "backwards": "in the negative direction only",
    "right": "and grows in proportion to the displacement, where that is positive",
    "left": "and grows in proportion to the displacement, where that is negative",
}
_SPRINGS = {
    "odd": "a force against the displacement that grows with its {}",
    "even": "a force that grows with the {} of the displacement, in the same direction on both sides",
    "right": "a force against the displacement that grows with its {}, where it is positive",
    "left": "a force against the displacement that grows with its {}, where it is negative",
}


@dataclass(frozen=True)
class Distilled:
    """A formula in the place of a learned element.

    Attributes:
        kind: of the element, ``dissipative`` or ``elastic``.
        equation: LaTeX, the force with which it resists.
        words: a sentence.
        parameters: value and unit by symbol: sizes of the terms and the references of displacement and speed.
        exponents: value and 95 % interval of every exponent and onset, by symbol; a value that stands in the equation
            as a round number lies in its interval.
        learned, formula: residual over noise (root mean square) with the element and, to first order, the formula.
        as_good: whether the formula leaves no more than the element, up to the difference that chance can make.
        first_order: whether the element leaves so little that first order holds, and with it the intervals; else the
            formula is a hint.
        others: equations that these recordings cannot tell from this one.
        models: models with this formula and with the others in the place of the element; empty where the formula is no
            more than a hint.
    """

    kind: str
    equation: str
    words: str
    parameters: Parameters
    exponents: dict[str, tuple[float, tuple[float, float]]]
    learned: float
    formula: float
    as_good: bool
    first_order: bool
    others: tuple[str, ...] = ()
    models: tuple[Rival, ...] = field(default=(), compare=False, repr=False)


def has_grammar(kind: str) -> bool:
    """Return whether there are terms for a learned element of a kind."""
    return kind in TERMS


def distil(linearised: LinearisedFit, element: Effect) -> Distilled | None:
    """Return the shortest formula of the grammar for a learned element of a fitted model.

    Data weigh a formula where the motion was and as far as it shows in the output. Of formulas with one and two terms
    the one with the least sum of squares is chosen, where every number has to save what two refits differ by that count
    as told apart.

    Args:
        linearised: of the fit with the element.
        element: a learned spring or damper.

    Returns:
        None where there is no grammar for the element, or no term explains anything.
    """
    if not has_grammar(element.kind.name) or not element.strengths:
        return None
    goal, few = target(linearised, element), linearised.on_subset()
    formulas = best_formulas(goal, goal if few is linearised else target(few, element), TERMS[element.kind.name])
    if not formulas:
        return None
    best, *rest = formulas
    fit, scales, reach = linearised.fit, linearised.scales, tie_of(goal, best)
    reference = quantity(scales.displacement, "m")
    equation, words, parameters = _beside_the_damper(goal, best) or (
        _equation(best),
        _in_words(best, reference),
        _parameters(best, scales),
    )
    rivals = [f for f in rest if f.price <= best.price + reach and len(f.terms) <= len(best.terms)]
    positive = fit.setup.parameters
    stays_passive = all(v > 0.0 for n, v in goal.base_values(best).items() if positive[n].positive)
    as_good, first_order = best.cost <= fit.cost + reach and stays_passive, fit.chi2 <= _LARGE**2
    models: tuple[Rival, ...] = ()
    if as_good and first_order:
        names = [words, *(_in_words(f, reference) for f in rivals)]
        names = [f"{text[0].lower()}{text[1:]}".removesuffix(".") for text in names]
        models = tuple(_formula_rival(goal, element, f, n) for f, n in zip([best, *rivals], names, strict=True))
    symbols = [f"{s.symbol}_{i + 1}" for i, t in enumerate(best.terms) for s in t.shapes]
    return Distilled(
        kind=element.kind.name,
        equation=equation,
        words=words,
        parameters=parameters,
        exponents={s: (float(v), i) for s, v, i in zip(symbols, best.shapes, best.intervals, strict=True)},
        learned=float(np.sqrt(fit.cost / fit.residual.size)),
        formula=float(np.sqrt(best.cost / fit.residual.size)),
        as_good=as_good,
        first_order=first_order,
        others=tuple(_equation(f) for f in rivals),
        models=models,
    )


def refitted_formula(final: Fit, alone: Fit, element: Effect, refits: Refits) -> Distilled | None:
    """Return the formula that explains most in place of a learned element; among equals, the simplest.

    Args:
        final: the fit with the element; alone: the fit with all other elements of the model.
        element: a learned element of the measuring chain.
        refits: fits effects beside ``alone``.

    Returns:
        None where there is no formula for the element, or none can be fitted.
    """
    effects = [f for f in formulas_for(element) if f.can_be_added_to(alone.setup)]
    fits = refits(effects) if effects else []
    if not fits:
        return None
    doubtful = _DOUBTFUL * final.beyond_noise if final.chi2 > _SMALL**2 else 0.0
    reach = max(tie(final), doubtful)
    least = min(f.cost for _, f in fits)
    simplest = simplest_first([f for _, f in fits if f.cost <= least + reach])[0]
    effect, best = next((e, f) for e, f in fits if f is simplest)
    as_good = best.cost <= final.cost + reach and alone.cost - best.cost >= _MOST * (alone.cost - final.cost)
    tied = [(e, f) for e, f in fits if f is not best and f.cost <= best.cost + reach]
    parameters = {n: best.setup.parameters[n] for n in effect.parameters}
    return Distilled(
        kind=element.kind.name,
        equation=effect.equation,
        words=effect.statement.format(**{n: quantity(p.value, p.unit) for n, p in parameters.items()}),
        parameters={n: (p.value, p.unit) for n, p in parameters.items() if not p.fixed},
        exponents={},
        learned=float(np.sqrt(final.cost / final.residual.size)),
        formula=float(np.sqrt(best.cost / final.residual.size)),
        as_good=as_good,
        first_order=True,
        others=tuple(e.equation for e, _ in tied),
        models=tuple(refitted_rival(e.name, f, e.parameters) for e, f in ((effect, best), *tied) if as_good),
    )


def simplest_first(fits: Sequence[Fit]) -> list[Fit]:
    """Return fits that explain as much, ordered by the sum of squares with a penalty for every parameter, initial state
    and nuisance of a recording.

    The penalty is Schwarz's (1978), with as many samples as the residual is worth: where much is left it is not white
    noise, and a tone, or a mode that rings on from an initial state of its own, takes more of it than parameters would
    take of noise. Of a coloured residual so many are independent: ``(Σλ)²/Σλ²`` over the eigenvalues of its covariance
    (Bayley & Hammersley 1946), from the periodogram, whose ordinates scatter as ``χ²₂``.
    """
    least = min(fits, key=lambda f: f.cost)
    power = np.abs(np.fft.rfft(least.residual)[1:]) ** 2
    samples = float(np.clip(4.0 * power.sum() ** 2 / max(float(power @ power), 1e-300), 4.0, least.residual.size))
    price = least.cost / samples * float(np.log(samples))
    return sorted(fits, key=lambda f: f.cost + price * (f.z.size + own_count(f)))


def own_count(fit: Fit) -> int:
    """Return the number of coefficients of the nuisances of all recordings."""
    return sum(own_size(r, fit.setup.own) for r in fit.plan.recordings)


@dataclass(frozen=True, eq=False)
class FormulaRival(Rival):
    """A formula that stands for a learned element.

    Attributes:
        element: which it replaces; formula: what replaces it; scales: of its reference displacement and speed.
        kept: variables of the fit that do not belong to the element; shift: (K',) by which they move.
    """

    element: Effect
    formula: Formula
    scales: Scales
    kept: tuple[int, ...]
    shift: Array

    def predicted(self, bench: Bench) -> Predicted:
        """See `Rival.predicted`; coordinates are the kept variables, sizes and free shapes."""
        trajectory, moved = bench.simulated(self.fit, self.variables)
        base, formula = moved[:, list(self.kept)], self.formula
        learned = response(trajectory, element_force(self.fit.setup, self.element))[:, 0]
        units, slopes = formula.split(response(trajectory, forces_of(self.scales, [*formula.units, *formula.slopes])))
        sized = units * formula.sizes
        y = trajectory.y + base @ self.shift + sized.sum(axis=1) - learned
        return Predicted(y, np.hstack([base, sized, slopes]))


def _formula_rival(goal: Target, element: Effect, formula: Formula, name: str) -> FormulaRival:
    """A formula as a rival.

    Args:
        goal: what the recordings at hand say of the element's force.
        element: of the fit around which the goal is linear.
        name: the formula in words.
    """
    fit = goal.linearised.fit
    variables, derivatives = everything(fit)
    others = [name not in element.parameters for name in variables.names]
    kept = tuple(i for i in range(derivatives.shape[1]) if i >= len(others) or others[i])
    # The derivatives of the residual are those of the output, with the other sign.
    base = -derivatives[:, list(kept)]
    units, slopes = formula.split(goal.columns([*formula.units, *formula.slopes]))
    sized = units * formula.sizes
    least = np.concatenate([base, np.eye(base.shape[1]) / FAR])
    wanted = np.concatenate([goal.wanted - sized.sum(axis=1), np.zeros(base.shape[1])])
    shift = np.linalg.lstsq(least, wanted, rcond=None)[0]
    known = bounded(np.hstack([base, sized, slopes]))
    own = tuple(range(base.shape[1], known.shape[1]))
    return FormulaRival(name, fit, variables, known, own, element, formula, goal.linearised.scales, kept, shift)


def _equation(formula: Formula) -> str:
    """LaTeX of the force with which a formula resists, its exponents as numbers."""
    text = ""
    for i, (term, size, shapes) in enumerate(formula.by_term):
        sign = "-" if size < 0.0 else "+" if i else ""
        text += rf" {sign} F_{i + 1}\,({term.latex(*(f'{x:.3g}' for x in shapes))})"
    return f"F = {text.strip()}"


def _parameters(formula: Formula, scales: Scales) -> Parameters:
    """Sizes of the terms, and the references of displacement and speed."""
    sizes = {f"F_{i + 1}": (abs(float(size)), "N") for i, size in enumerate(formula.sizes)}
    speed = {"v_0": (scales.velocity, "m/s")} if formula.terms[0].kind == "dissipative" else {}
    return {**sizes, "q_0": (scales.displacement, "m"), **speed}


def _beside_the_damper(goal: Target, formula: Formula) -> tuple[str, str, Parameters] | None:
    """Equation, words and parameters of one viscous term together with the linear damper of the base model; None where
    it is something else."""
    network = goal.linearised.fit.setup.network
    moving = [{m.momentum: 1.0} for m in motions(network)[:1]]
    linear = [r.parameters[0] for r in network.resistors if r.law == "linear" and dict(r.on) in moving]
    (term, size, shapes), *others = formula.by_term
    viscous = term.kind == "dissipative" and formula.fixed[0] and shapes[0] == 1.0
    if others or not viscous or len(linear) != 1 or linear[0] not in goal.names:
        return None
    scales, b = goal.linearised.scales, goal.base_values(formula)[linear[0]]
    more = size / scales.velocity
    if term.name in ("forwards", "backwards"):
        ahead, back = (b + more, b) if term.name == "forwards" else (b, b + more)
        words = f"Viscous damping of {ahead:.3g} N s/m in the positive direction and of {back:.3g} N s/m in the other."
        equation = r"F = b_\pm v, \quad b_+ \; (v > 0), \; b_- \; (v < 0)"
        return equation, words, {"b_+": (ahead, "N s/m"), "b_-": (back, "N s/m")}
    if term.name != "distance" or b <= 0.0:
        return None
    doubled = scales.displacement * (b / more) ** (1.0 / float(shapes[1]))
    power = f"{shapes[1]:.3g}"
    words = _in_words(formula, "").removesuffix(".") + f", and is doubled at {quantity(doubled, 'm')}."
    inside = {"1": r"|q|/q_0", "2": "(q/q_0)^2"}.get(power, rf"|q/q_0|^{{{power}}}")
    return rf"F = b\,(1 + {inside})\,v", words, {"b": (b, "N s/m"), "q_0": (doubled, "m")}


def _in_words(formula: Formula, displacement: str) -> str:
    """A sentence that says what the formula says.

    Args:
        displacement: the reference of displacements, with its unit.
    """
    # A value; where it is not a round one, with its interval.
    numbers = [
        f"{value:g}" if fixed else f"{value:.2f} ({low:.2f} to {high:.2f})"
        for value, fixed, (low, high) in zip(formula.shapes, formula.fixed, formula.intervals, strict=True)
    ]
    parts = []
    for term, size, shapes in formula.by_term:
        texts, numbers = numbers[: shapes.size], numbers[shapes.size :]
        if term.kind == "dissipative":
            parts.append(_damper_in_words(term.name, shapes, texts))
        else:
            parts.append(_spring_in_words(term.name, float(shapes[0]), texts[0], size, displacement))
    text = "; and ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _damper_in_words(name: str, shapes: Array, texts: list[str]) -> str:
    n = float(shapes[0])
    speed = _SPEED.get(n, f"a damping force that grows with the power {texts[0]} of the speed")
    where = _SIDES.get(name, "")
    if name == "distance":
        power = _POWERS.get(float(shapes[1]), f"power {texts[1]}")
        where = f"and grows with the {power} of the distance from zero"
    # Damping as such does nothing yet to which growing could be added.
    where = where.replace("and grows", "that grows") if n == 1.0 else where
    return f"{speed} {where}".strip()


def _spring_in_words(name: str, shape: float, text: str, size: float, displacement: str) -> str:
    if name.startswith("stop"):
        side = "negative" if name.endswith("left") else "positive"
        change = "stiffer" if size > 0.0 else "softer"
        return f"a spring that is {change} beyond {text} of {displacement} on the {side} side"
    sentence = _SPRINGS[name].format(_POWERS.get(shape, f"power {text}"))
    return sentence if size > 0.0 else sentence.replace("against", "along", 1)
