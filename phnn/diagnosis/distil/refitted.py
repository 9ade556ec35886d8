"""Formulas for learned elements of the measuring chain: each is refitted in the element's place."""

from __future__ import annotations

import numpy as np

from phnn.criteria import CRITERIA, Criteria
from phnn.diagnose.linearised import prepare, tie
from phnn.diagnose.proposal import refitted_rival
from phnn.diagnosis.distil.distilled import Distilled
from phnn.diagnosis.name import score
from phnn.diagnosis.refit import refit
from phnn.diagnosis.trial import Trial, simplest_first
from phnn.effects import Effect
from phnn.effects.formulas import formulas_for
from phnn.identification.fit import Fit
from phnn.parallel import SERIAL, Executor
from phnn.units import quantity

# Of a null that nobody asks for: formulas are ranked, not tested.
_SEED = 0
# A formula has to take this share of what the learned element takes.
_MOST = 0.8


def refitted_formula(
    final: Fit, alone: Fit, element: Effect, executor: Executor = SERIAL, criteria: Criteria = CRITERIA
) -> Distilled | None:
    """Return the formula that explains most in place of a learned element; among equals, the simplest.

    Args:
        final: the fit with the element; alone: that with all other elements of the model.
        element: a learned element.
        executor: where formulas are refitted.

    Returns:
        None where there is no formula for the element, or none can be fitted.
    """
    effects = [f for f in formulas_for(element) if f.can_be_added_to(alone.setup)]
    if not effects:
        return None
    naming = score(prepare(alone).on_subset(), effects, None, _SEED)
    trials = [t for t in refit(alone, naming.candidates, executor, criteria=criteria) if t.fit is not None]
    if not trials:
        return None
    rule, left = criteria.selection, final.beyond_noise
    # A remainder that is no noise may favour either, as in `phnn.diagnosis.trial.class_of`.
    doubtful = rule.tie_of_remainder * left if final.chi2 > rule.small_residual**2 else 0.0
    reach = max(tie(final, rule.tie), doubtful)
    least = min(t.cost for t in trials)
    best = simplest_first([t for t in trials if t.cost <= least + reach])[0]
    return _distilled(best, trials, (alone, final), element, reach)


def _distilled(
    best: Trial, trials: list[Trial], around: tuple[Fit, Fit], element: Effect, reach: float
) -> Distilled | None:
    """A formula as it describes what an element takes between the fits without and with it."""
    alone, final = around
    effect, fit = best.candidate.effect, best.fit
    if fit is None:
        return None
    parameters = {n: fit.setup.parameters[n] for n in effect.parameters}
    shown = {n: quantity(p.value, p.unit) for n, p in parameters.items()}
    size = final.residual.size
    as_good = fit.cost <= final.cost + reach and alone.cost - fit.cost >= _MOST * (alone.cost - final.cost)
    tied = [t for t in trials if t is not best and t.cost <= best.cost + reach]
    models = [(t.candidate.effect, t.fit) for t in (best, *tied) if as_good and t.fit is not None]
    return Distilled(
        kind=element.kind.name,
        equation=effect.equation,
        words=effect.statement.format(**shown),
        parameters={n: (p.value, p.unit) for n, p in parameters.items() if not p.fixed},
        exponents={},
        learned=float(np.sqrt(final.cost / size)),
        formula=float(np.sqrt(fit.cost / size)),
        as_good=as_good,
        first_order=True,
        others=tuple(t.candidate.effect.equation for t in tied),
        models=tuple(refitted_rival(e.name, f, e.parameters) for e, f in models),
    )
