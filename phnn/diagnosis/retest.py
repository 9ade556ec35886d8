"""Backward deletion: whether effects that were found are still needed, or others in their place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from phnn.criteria import CRITERIA, REFITS, Criteria, Refits
from phnn.diagnose.linearised import tie
from phnn.diagnose.locations import Location
from phnn.diagnosis.finding import Finding, effects_of, own_parameters
from phnn.diagnosis.place import in_place
from phnn.diagnosis.refit import refit
from phnn.diagnosis.steps import tolerance_of
from phnn.diagnosis.trial import Trial, class_of, fair_cost
from phnn.identification.fit import Fit, distinct_optima
from phnn.identification.staged import EVALUATIONS, fit_identified, stated_only
from phnn.parallel import Executor
from phnn.rescue import attempt
from phnn.setup import Setup
from phnn.units import FORCE_UNITS

# Share of what a larger model explains that the base model alone must explain to have been at a local optimum.
_MOST = 0.5
# Added masses that weigh more than this times the first one leave its stated value without a meaning.
_FAR = 10.0


def retested(
    base: Fit,
    location: Location,
    findings: tuple[Finding, ...],
    fitted: Fit,
    executor: Executor,
    criteria: Criteria = CRITERIA,
) -> tuple[tuple[Finding, ...], Fit]:
    """Every finding once more, now that the last one is there: superfluous, or better another one?

    The last one too: together they may have led an earlier one to where it needs no other.

    Returns:
        The findings that are needed, each with the fit of the others alone, and the fit of all of them.
    """
    place, rule = 0, criteria.selection
    # By place, for the effects as they stand: those refits take as long as the search for an effect.
    alone_at: dict[int, Fit] = {}
    while place < len(findings) and len(findings) > 1:
        others = (*findings[:place], *findings[place + 1 :])
        alone = without(base, others, findings[place], fitted, criteria)
        if alone is None:
            place += 1
            continue
        if fair_cost(alone) - fair_cost(fitted) < tie(fitted, rule.tie):
            findings, fitted = others, alone
            alone_at.clear()
            continue
        alone_at[place] = alone
        if place == len(findings) - 1:
            break
        used = {f.effect.name for f in others}
        rivals = [t for t in findings[place].trials[: rule.retested] if t.candidate.effect.name not in used]
        trials = in_place(_refitted(alone, rivals, executor, criteria), location, rule)
        best = trials[0]
        if best.fit is not None and best.cost <= fitted.cost + tie(fitted, rule.tie):
            members = tuple(class_of(trials, rule=rule))
            again = Finding(best, members, tuple(trials), findings[place].naming, level=rule.level)
            if best.candidate.effect is not findings[place].effect:
                alone_at.clear()
            findings, fitted = (*findings[:place], again, *findings[place + 1 :]), best.fit
        place += 1
    return tuple(replace(f, others_alone=alone_at.get(i)) for i, f in enumerate(findings)), fitted


def _refitted(base: Fit, trials: Sequence[Trial], executor: Executor, criteria: Criteria) -> list[Trial]:
    """Effects refitted from where they ended beside others: what those refits say counts more than the scores did."""
    known = {t.candidate.effect: t.candidate for t in trials}
    ended = [(t.candidate, t.fit.setup.values()) for t in trials if t.fit is not None]
    again = [replace(c, values={n: v[n] for n in c.effect.parameters}, score=1.0) for c, v in ended]
    return [Trial(known[t.candidate.effect], t.fit) for t in refit(base, again, executor, criteria=criteria)]


def without(
    base: Fit, others: Sequence[Finding], dropped: Finding, fitted: Fit, criteria: Criteria = CRITERIA
) -> Fit | None:
    """The base model with some of the effects of a fit, fitted from where that one ended.

    Where that explains less, the model may have followed what was dropped, or that has taken the place of something of
    the model's own: it takes a few steps from several starts, and the best ones are carried to convergence.

    Args:
        criteria: the difference of χ² in residual variances below which two fits are equally good, and how far to go.
    """
    values, own, limits = fitted.setup.values(), dropped.effect.equivalents, criteria.refits
    scaled = at_the_mass_of(base.setup, fitted.setup)
    tried: list[Fit] = []
    for moved in ({}, base.setup.values(), *scaled, *(own(values) if own is not None else ())):
        known = {n: v for n, v in moved.items() if n not in stated_only(base.held)}
        found = fit_with(base, others, {**values, **known}, limits.second_evaluations, limits=limits)
        tried += [found] if found is not None else []
        if found is not None and fair_cost(found) - fair_cost(fitted) < tie(fitted, criteria.selection.tie):
            break
    if not tried:
        return None
    best, further = distinct_optima(tried)
    ends = [fit_with(base, others, best.setup.values(), origin=best, limits=limits)]
    ends += [fit_with(base, others, setup.values(), limits=limits) for setup in further]
    return min((f for f in (best, *ends) if f is not None), key=fair_cost)


def at_the_mass_of(base: Setup, fitted: Setup) -> tuple[dict[str, float], ...]:
    """The values of a larger model, all forces and charges scaled as its masses are to those of the base model; empty
    where both have about the same.

    Voltage and displacement leave one factor of all forces and charges open, which a stated mass fixes. A second mass
    that moves with the first sets it free again: one mass then does what both do, at smaller forces.
    """
    masses = [sum(p.value for p in s.parameters.values() if p.unit == "kg") for s in (base, fitted)]
    if min(masses) <= 0.0 or masses[1] < _FAR * masses[0]:
        return ()
    factor = masses[0] / masses[1]
    return ({n: p.value * factor ** FORCE_UNITS.get(p.unit, 0) for n, p in fitted.parameters.items()},)


def better_base(base: Fit, final: Fit) -> Fit | None:
    """The base model fitted from where a larger model has ended, if that explains most of what the larger one does.

    Then the first fit of the base model had stopped at a local optimum, and an element only led the way out of it.
    """
    if final is base:
        return None
    again = fit_with(base, (), final.setup.values(), origin=final)
    if again is None:
        return None
    gain, whole = fair_cost(base) - fair_cost(again), fair_cost(base) - fair_cost(final)
    if gain < max(_MOST * whole, tie(base)):
        return None
    return replace(again, alternatives=(base.setup, *base.alternatives))


def fit_with(
    base: Fit,
    findings: Sequence[Finding],
    values: Mapping[str, float],
    evaluations: int = EVALUATIONS,
    origin: Fit | None = None,
    limits: Refits = REFITS,
) -> Fit | None:
    """The base model with some effects, fitted from parameter values.

    Args:
        evaluations: bound on the simulations of all recordings.
        origin: whose initial states to start from; those of the base model otherwise.
        limits: the tolerance where much is left.
    """

    def fitted() -> Fit:
        setup = base.setup.with_values({n: values[n] for n in base.setup.free})
        for f in findings:
            setup = f.effect.add_to(setup, values)
        held, own, loose = stated_only(base.held), own_parameters(findings), limits.loose_tolerance
        found = fit_identified(setup, base.plan, held, evaluations, origin or base, own, loose)
        left, tolerance = evaluations - found.evaluations, tolerance_of(found, loose)
        if left > 0 and tolerance < loose / 2.0:
            found = fit_identified(found.setup, base.plan, held, left, found, own, tolerance)
        return found

    return attempt(f"fit with {' and '.join(e.name for e in effects_of(findings)) or 'no element'}", fitted, None)
