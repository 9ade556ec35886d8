"""Refit candidate effects in full, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from phnn.diagnose.name import Candidate
from phnn.effects import Effect
from phnn.ensemble import SERIAL, Executor
from phnn.errors import PhnnError
from phnn.identify.base import released
from phnn.identify.fit import Fit, distinct_optima
from phnn.identify.staged import fit_identified, stated_only
from phnn.setup import Setup

_QUICK, _FULL = 8, 40
_TIE = 12.0
_IMPERFECT = 0.2
# Scores are costs saved to first order; what scores below this share of the best cannot overtake it.
_WITHIN = 0.35
_NEAR = 2.0
_OTHER_STARTS = 1


@dataclass(frozen=True)
class Trial:
    """A candidate with its refit; ``fit`` is None where no start could be simulated."""

    candidate: Candidate
    fit: Fit | None

    @property
    def cost(self) -> float:
        """Weighted sum of squares, infinite where there is no fit."""
        return self.fit.cost if self.fit is not None else float("inf")


def refit(base: Fit, candidates: Sequence[Candidate], executor: Executor = SERIAL) -> list[Trial]:
    """Candidates refitted together with the base parameters, best first.

    All that score within reach of the best are refitted a little from several starts; those that come near are
    carried to convergence.

    Args:
        base: the fit without them.
        candidates: best score first.
        executor: where; away from this thread every refit keeps to one thread, and the results stay the same.

    Raises:
        SolverFailed: a candidate kills every worker process that refits it.
    """
    if not candidates:
        return []
    reach = _WITHIN * candidates[0].score
    tried = [c for c in candidates if c.score >= reach]
    trials = [Trial(c, f) for c, f in zip(tried, _fits(_quick_fit, base, tried, executor), strict=True)]
    best = min(t.cost for t in trials)
    near = [i for i, t in enumerate(trials) if t.cost <= _NEAR * best]
    finished = _fits(_finished, base, [trials[i] for i in near], executor)
    for i, f in zip(near, finished, strict=True):
        trials[i] = Trial(trials[i].candidate, f)
    return sorted(trials, key=_criterion)


def _fits(
    work: Callable[[Fit, Any], Fit | None], base: Fit, items: Sequence[Any], executor: Executor
) -> list[Fit | None]:
    """``work(base, item)`` of every item, on the very recordings of the base fit wherever it was done."""
    # Threads of a refit that runs beside others would only get into each other's way.
    sent = base if executor == SERIAL else replace(base, plan=replace(base.plan, workers=1))
    fits = executor.run(partial(work, sent), items)
    return [f if f is None else replace(f, plan=replace(base.plan, substeps=f.plan.substeps)) for f in fits]


def _criterion(trial: Trial) -> float:
    """Sum of squares with a penalty of ``ln N`` a parameter (Schwarz 1978)."""
    if trial.fit is None:
        return float("inf")
    free = [n for n in trial.candidate.effect.parameters if not trial.fit.setup.parameters[n].fixed]
    return trial.cost + len(free) * max(1.0, trial.fit.chi2) * float(np.log(trial.fit.residual.size))


def _quick_fit(base: Fit, candidate: Candidate) -> Fit | None:
    """A few steps with coarse sub-steps from every start: shapes of the effect, and other optima of the base."""
    effect = candidate.effect
    starts = [(base.setup, v) for v in (candidate.values, *candidate.others[:_OTHER_STARTS])]
    starts += [(setup, candidate.values) for setup in base.alternatives]
    found = []
    for setup, values in starts:
        origin = base if setup is base.setup else None
        try:
            begun = _clamped(effect, setup, values)
            found.append(
                fit_identified(begun, base.plan.coarse(), stated_only(base.held), _QUICK, origin, effect.parameters)
            )
        except PhnnError:
            continue
    if not found:
        return None
    best, alternatives = distinct_optima(found)
    return replace(best, alternatives=alternatives)


def _finished(base: Fit, trial: Trial) -> Fit | None:
    """Carried to convergence with the sub-steps of the base fit; None where it cannot be simulated there."""
    if trial.fit is None:
        return None
    effect = trial.candidate.effect
    try:
        full = fit_identified(trial.fit.setup, base.plan, stated_only(base.held), _FULL, trial.fit, effect.parameters)
        full = released(full, effect.parameters)
    except PhnnError:
        return None
    return replace(full, alternatives=trial.fit.alternatives)


def _clamped(effect: Effect, setup: Setup, values: Mapping[str, float]) -> Setup:
    """The effect at starting values moved inside the bounds of its parameters."""
    probe = effect.add_to(setup, effect_defaults(effect, values))
    inside = {}
    for name in effect.parameters:
        p = probe.parameters[name]
        inside[name] = p.value if p.fixed else min(max(values[name], p.lower), p.upper)
    return effect.add_to(setup, inside)


def effect_defaults(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Values with a two-sided strength at zero, which lies within every bound."""
    if effect.one_sided or effect.strength is None:
        return dict(values)
    return dict(values) | {effect.strength: 0.0}


def class_of(trials: Sequence[Trial], unexplained: bool) -> list[Trial]:
    """The trials that these recordings cannot tell from the best one.

    Two refitted models count as told apart when their sums of squares differ by more than twelve times the residual
    variance: some 3.5 standard deviations for one parameter. Where even the best leaves something real unexplained,
    that remainder may favour either, and a difference of less than a fifth decides nothing.

    An effect of which the best is a special case, and which did not come first, adds nothing: it is no member.

    Args:
        trials: best first.
        unexplained: whether the best refit leaves a significant remainder.
    """
    best = trials[0]
    if best.fit is None:
        return list(trials[:1])
    # Coloured noise inflates differences of sums of squares by the sum of its correlation.
    colour = max(max(1.0, 2.0 * float(np.sum(r.noise_correlation)) - 1.0) for r in best.fit.plan.recordings)
    left = max(best.cost - best.fit.residual.size, 0.0)
    reach = max(_TIE * colour * max(1.0, best.fit.chi2), _IMPERFECT * left if unexplained else 0.0)
    name = best.candidate.effect.name
    return [t for t in trials if t.cost - best.cost <= reach and name not in t.candidate.effect.contains]
