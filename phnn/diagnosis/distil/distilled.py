"""From a fitted learned element to the shortest formula that explains the recordings as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from phnn.criteria import RACE
from phnn.diagnose.linearised import LinearisedFit
from phnn.diagnose.proposal import Rival
from phnn.diagnosis.distil.grammar import TERMS, has_grammar
from phnn.diagnosis.distil.model import formula_rival
from phnn.diagnosis.distil.response import Target, target
from phnn.diagnosis.distil.search import Formula, best_formulas, tie_of, unit_responses
from phnn.diagnosis.distil.words import in_words
from phnn.effects import Effect
from phnn.network.roles import motions
from phnn.units import quantity


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
    parameters: dict[str, tuple[float, str]]
    exponents: dict[str, tuple[float, tuple[float, float]]]
    learned: float
    formula: float
    as_good: bool
    first_order: bool
    others: tuple[str, ...] = ()
    models: tuple[Rival, ...] = field(default=(), compare=False, repr=False)


def distil(linearised: LinearisedFit, element: Effect) -> Distilled | None:
    """The shortest formula of the grammar for a learned element of a fitted model.

    The formula takes the element's place in the equations linearised around the fit: its force acts along the
    trajectories of the fit, and base parameters and initial states move along. Data weigh it, therefore, where the
    motion was and as far as it shows in the output. Of formulas with one and two terms the one with the least sum of
    squares is chosen, where every number has to save what two refits differ by that count as told apart.

    Args:
        linearised: of the fit with the element.
        element: a learned spring or damper.

    Returns:
        None where there is no grammar for the element, or no term explains anything.
    """
    if not has_grammar(element.kind.name) or not element.strengths:
        return None
    goal, few = target(linearised, element), linearised.on_subset()
    found = best_formulas(goal, goal if few is linearised else target(few, element), TERMS[element.kind.name])
    if not found:
        return None
    best, fit = found[0], linearised.fit
    reach = tie_of(goal, best)
    size = fit.residual.size
    written = _beside_the_damper(goal, best) or Written(
        _equation(best), in_words(best, quantity(linearised.scales.displacement, "m")), _parameters(best, goal)
    )
    rivals = [f for f in found[1:] if f.price <= best.price + reach and len(f.terms) <= len(best.terms)]
    as_good = best.cost <= fit.cost + reach and _stays_passive(goal, best)
    first_order = fit.chi2 <= RACE.large_residual**2
    return Distilled(
        kind=element.kind.name,
        equation=written.equation,
        words=written.words,
        parameters=written.parameters,
        exponents=_exponents(best),
        learned=float(np.sqrt(fit.cost / size)),
        formula=float(np.sqrt(best.cost / size)),
        as_good=as_good,
        first_order=first_order,
        others=tuple(_equation(f) for f in rivals),
        models=_models(goal, element, [best, *rivals], written.words) if as_good and first_order else (),
    )


def _models(goal: Target, element: Effect, formulas: Sequence[Formula], words: str) -> tuple[Rival, ...]:
    """Models with one of the formulas each.

    Args:
        words: of the first formula.
    """
    reference = quantity(goal.linearised.scales.displacement, "m")
    said = [words, *(in_words(f, reference) for f in formulas[1:])]
    names = [f"{text[0].lower()}{text[1:]}".removesuffix(".") for text in said]
    return tuple(formula_rival(goal, element, f, name) for f, name in zip(formulas, names, strict=True))


class Written(NamedTuple):
    """A formula as a person reads it, with the parameters that stand in it."""

    equation: str
    words: str
    parameters: dict[str, tuple[float, str]]


def _stays_passive(goal: Target, formula: Formula) -> bool:
    """Whether every positive parameter of the base model stays positive beside a formula."""
    terms = [(term, shapes) for term, _, shapes in formula.by_term]
    values = goal.moved_base(unit_responses(goal, terms), formula.sizes)
    parameters = goal.linearised.fit.setup.parameters
    return all(value > 0.0 for name, value in values.items() if parameters[name].positive)


def _equation(formula: Formula) -> str:
    """LaTeX of the force with which a formula resists, its exponents as numbers."""
    text = ""
    for i, (term, size, shapes) in enumerate(formula.by_term):
        sign = "-" if size < 0.0 else "+" if i else ""
        text += rf" {sign} F_{i + 1}\,({term.latex(*(f'{x:.3g}' for x in shapes))})"
    return f"F = {text.strip()}"


def _beside_the_damper(goal: Target, formula: Formula) -> Written | None:
    """One viscous term together with the linear damper of the base model; None where it is something else."""
    network = goal.linearised.fit.setup.network
    moving = [{m.momentum: 1.0} for m in motions(network)[:1]]
    linear = [r.parameters[0] for r in network.resistors if r.law == "linear" and dict(r.on) in moving]
    (term, size, shapes), *others = formula.by_term
    viscous = term.kind == "dissipative" and formula.fixed[0] and shapes[0] == 1.0
    if others or not viscous or len(linear) != 1 or linear[0] not in goal.names:
        return None
    scales = goal.linearised.scales
    b = goal.moved(unit_responses(goal, [(term, shapes)]), formula.sizes, linear[0])
    more = size / scales.velocity
    if term.name in ("forwards", "backwards"):
        ahead, back = (b + more, b) if term.name == "forwards" else (b, b + more)
        parameters = {"b_+": (ahead, "N s/m"), "b_-": (back, "N s/m")}
        words = f"Viscous damping of {ahead:.3g} N s/m in the positive direction and of {back:.3g} N s/m in the other."
        return Written(r"F = b_\pm v, \quad b_+ \; (v > 0), \; b_- \; (v < 0)", words, parameters)
    if term.name != "distance" or b <= 0.0:
        return None
    doubled = scales.displacement * (b / more) ** (1.0 / float(shapes[1]))
    power = f"{shapes[1]:.3g}"
    words = in_words(formula, "").removesuffix(".") + f", and is doubled at {quantity(doubled, 'm')}."
    inside = {"1": r"|q|/q_0"}.get(power, rf"|q/q_0|^{{{power}}}" if power != "2" else "(q/q_0)^2")
    return Written(rf"F = b\,(1 + {inside})\,v", words, {"b": (b, "N s/m"), "q_0": (doubled, "m")})


def _parameters(formula: Formula, goal: Target) -> dict[str, tuple[float, str]]:
    sizes = {f"F_{i + 1}": (abs(float(size)), "N") for i, size in enumerate(formula.sizes)}
    scales = goal.linearised.scales
    references = {"q_0": (scales.displacement, "m")}
    if formula.terms[0].kind == "dissipative":
        references["v_0"] = (scales.velocity, "m/s")
    return sizes | references


def _exponents(formula: Formula) -> dict[str, tuple[float, tuple[float, float]]]:
    symbols = [f"{s.symbol}_{i + 1}" for i, t in enumerate(formula.terms) for s in t.shapes]
    values = zip(symbols, formula.shapes, formula.intervals, strict=True)
    return {symbol: (float(value), interval) for symbol, value, interval in values}
