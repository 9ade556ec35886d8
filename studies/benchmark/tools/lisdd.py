"""Localised, identifiable, sparse discovery of the discrepancy (LISDD) as a tool.

After Wang (2026, arXiv 2606.23215), whose steps are: identify the known physics in a clean regime that is found
automatically; flag the regimes whose residual energy is too large; select the missing term by exhaustive hold-out over
a library; confirm it by an F-test on samples of their own. The paper's text was not at hand but for its abstract and
summaries, and its examples are static regressions. This implementation carries it over to a dynamic model:

* regimes are recordings, or eighths of a single one; the clean ones hold half of the samples (`regimes`);
* the library is the catalogue at every point of its grids, as responses of the output to first order; pairs are
  built on the two best single terms (`exhaustive`). The names that gain most are refitted by simulation, all where the
  samples are few and 5 otherwise, before they are ranked;
* of every recording, stretches take turns to be fitted, held out, and tested;
* base parameters move freely in both models of the F-test, so that their errors are not taken for missing physics;
  residuals are made white by an autoregression of fourth order; the level is divided by the number of names tried.

Settings were chosen on cases of a benchmark of seed 903 that was written for that purpose.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phnn.diagnosis.diagnosis import available
from phnn.diagnosis.linearised_fit import LinearisedFit
from phnn.diagnosis.starts import clamped
from phnn.effects import Effect, catalogue
from phnn.errors import PhnnError
from phnn.identification.fit import Fit, fit
from phnn.identification.plan import Plan
from phnn.identification.problem import Problem
from phnn.model import Model
from phnn.recordings.recording import Part, Recording
from phnn.setup import Setup
from studies.benchmark.answer import Answer
from studies.benchmark.tools.common import base_of, predictions
from studies.benchmark.tools.exhaustive import Winner, library, products, winners
from studies.benchmark.tools.nested import FTest, autoregression, f_test, filtered
from studies.benchmark.tools.regimes import clean, evaluated, flagged, refitted, whole

Array = NDArray[np.float64]

# What stretches of a recording are for, in turn, and how many there are of each.
_USES, _TURNS = ("identification", "held", "test"), 4
# Simulations of a refit; names that are refitted where the samples are few, and where they are not; how few they are.
_REFIT, _MOST, _FEW, _SMALL = 25, 34, 5, 10_000
# Singles to which a second effect is added where the samples are few, the share of what the base model leaves that they
# may leave, and the mean square of what is held out above which it is tried.
_PAIRED, _FIRST, _NOISE = 2, 0.85, 1.25
# Share of what the best single leaves above the noise that a pair has to explain.
_SECOND = 0.6
# Level of the F-test before it is divided by the number of names.
_LEVEL = 0.01
# Mean square of what is held out, in units of the noise, beyond which a confirmed term is a substitute for the
# mechanism.
_SUBSTITUTE = 2.0
# Gains of hold-out are divided by this and by the mean square that the best model leaves, before they are
# probabilities: candidates are wrong in other ways than by noise.
_TEMPERATURE = 8.0
# Probability that nothing is missing where no term is confirmed; of a confirmed term; that the mechanism is not listed
# where the term is a substitute, and where regimes are flagged and no term is confirmed.
_NONE, _CONFIRMED, _UNLISTED, _FLAGGED = 0.85, 0.95, 0.7, 0.6
_PLACES = 3


@dataclass(frozen=True)
class Tried:
    """A subset of the library, refitted; ``held``: (H,) residual on the held-out samples."""

    names: frozenset[str]
    fit: Fit
    left: float


def answer(folder: Path, seed: int) -> Answer:
    """Identify in the clean regime, select by hold-out, confirm by the F-test."""
    base = base_of(folder, seed)
    effects = available(base.campaign, base.fit.setup)
    plan = whole(base.fit.plan)
    first = evaluated(base.fit, plan)
    chosen = clean(first)
    clear = refitted(base.fit, first, chosen)
    at_clean = evaluated(clear, plan)
    suspicious = flagged(at_clean, chosen, clear.scatter.covariance)
    tried = _selected(at_clean, base.fit, effects)
    return _answered(tried, base.fit, plan, len({e.canonical for e in effects}), bool(suspicious), folder)


def _selected(linearised: LinearisedFit, base: Fit, effects: Sequence[Effect]) -> list[Tried]:
    """The names that predict what is held out best, after a refit; the best one first, the base model among them."""
    uses = _stretches(linearised.plan)
    nothing = _tried(frozenset(), base, base.setup, uses, base.variables.names)
    tried = [nothing, *_with_one_more(linearised, nothing, effects, uses)]
    small = linearised.fit.residual.size <= _SMALL
    for single in sorted(tried, key=lambda t: t.left)[: _PAIRED if small else 1]:
        if single.left <= _FIRST * nothing.left and single.left > _NOISE * _size(single):
            at_single = evaluated(single.fit, linearised.plan)
            others = [e for e in effects if e.canonical not in single.names and e.can_be_added_to(single.fit.setup)]
            tried += _with_one_more(at_single, single, others, uses)
    return sorted(tried, key=lambda t: t.left)


def _with_one_more(linearised: LinearisedFit, beside: Tried, effects: Sequence[Effect], uses: Plan) -> list[Tried]:
    """A model with each of the effects that gain most to first order, refitted."""
    candidates, columns = library(linearised, effects)
    masks = [np.concatenate([r.mask(u) for r in uses.recordings]) for u in _USES]
    found = products(linearised.fit.residual, linearised.fit.jacobian, columns, masks[0], masks[1])
    most = _MOST if linearised.fit.residual.size <= _SMALL and not beside.names else _FEW
    tried = []
    for winner in winners(found, candidates)[:most]:
        try:
            tried.append(_refitted(winner, beside, uses))
        except PhnnError:
            continue
    return tried


def _refitted(winner: Winner, beside: Tried, uses: Plan) -> Tried:
    """A model with one more effect, refitted by simulation from the strength that the first order gives."""
    candidate = winner.candidate
    start = candidate.effect.scaled(candidate.point, winner.coefficient)
    setup = clamped(candidate.effect, beside.fit.setup, start)
    own = [n for n in candidate.effect.parameters if not setup.parameters[n].fixed]
    return _tried(beside.names | {winner.name}, beside.fit, setup, uses, [*beside.fit.variables.names, *own])


def _tried(names: frozenset[str], origin: Fit, setup: Setup, uses: Plan, free: Sequence[str]) -> Tried:
    fitted = fit(setup, uses, list(free), origin.held, _REFIT, origin=origin)
    held = Problem(fitted.setup, uses, fitted.variables, use=_USES[1]).residual(fitted.z)
    return Tried(names, fitted, float(held @ held))


def _size(tried: Tried) -> int:
    """Samples that are held out."""
    return sum(int(r.mask(_USES[1]).sum()) for r in tried.fit.plan.recordings)


def _stretches(plan: Plan) -> Plan:
    """The plan with stretches of every recording that take turns in what they are for."""
    return replace(plan, recordings=tuple(_cut(r) for r in plan.recordings))


def _cut(recording: Recording) -> Recording:
    edges = np.linspace(0, recording.t.size, _TURNS * len(_USES) + 1).astype(int)
    parts = [
        Part(recording.name, int(a), int(b), _USES[i % len(_USES)])
        for i, (a, b) in enumerate(itertools.pairwise(edges))
    ]
    return replace(recording, parts=tuple(parts))


def _tested(smaller: Fit, larger: Fit, plan: Plan) -> FTest:
    """F-test of a refitted model against a smaller one, on the samples kept for it.

    Both are linear in their parameters near their estimates: the larger model has its own columns and the step from
    the smaller one's residual, ``r₀ − r₁``, which is what the terms have changed.
    """
    first, second = evaluated(smaller, plan), evaluated(larger, plan)
    r0, r1, j1 = first.fit.residual, second.fit.residual, second.fit.jacobian
    rows = second.slices
    taps = autoregression(r1, rows)
    test = np.concatenate([r.mask(_USES[2]) for r in _stretches(plan).recordings])
    white = [filtered(x, rows, taps)[test] for x in (r0, first.fit.jacobian, (r0 - r1)[:, None])]
    own = [i for i, n in enumerate(larger.variables.names) if n not in smaller.variables.names]
    more = np.hstack([white[2], filtered(j1[:, own], rows, taps)[test]])
    return f_test(white[0], white[1], more)


def _answered(
    tried: Sequence[Tried], base: Fit, plan: Plan, count: int, suspicious: bool, folder: Path
) -> Answer:  # fmt: skip
    nothing = next(t for t in tried if not t.names)
    best = _best(tried, plan, count)
    confirmed = bool(best.names) and _tested(nothing.fit, best.fit, plan).p_value * count <= _LEVEL
    names: dict[str, float] = dict.fromkeys((n for t in tried for n in t.names), 0.0)
    for one, weight in _weights(tried, best).items():
        for name in tried[one].names:
            names[name] += weight
    if confirmed:
        listed = _CONFIRMED if best.left <= _SUBSTITUTE * _size(best) else 1.0 - _UNLISTED
        none, unlisted, model = 0.0, 1.0 - listed, _all(best.fit, base)
    else:
        none, unlisted = (1.0 - _FLAGGED, _FLAGGED) if suspicious else (_NONE, 0.0)
        listed, model = 1.0 - none - unlisted, base
    shown = {n: min(listed * w, 1.0) for n, w in names.items()}
    return Answer(shown, none, unlisted, _places(names), _of(model, folder))


def _best(tried: Sequence[Tried], plan: Plan, count: int) -> Tried:
    """The subset that predicts best; a pair has to explain much of what its best member leaves, and be confirmed."""
    singles = [t for t in tried if len(t.names) < 2]
    first = singles[0]
    for pair in (t for t in tried if len(t.names) > 1):
        member = next((t for t in singles if t.names and t.names < pair.names), first)
        excess = first.left - _size(first)
        if excess > 0.0 and first.left - pair.left >= _SECOND * excess:
            return pair if _tested(member.fit, pair.fit, plan).p_value * count <= _LEVEL else first
    return first


def _weights(tried: Sequence[Tried], best: Tried) -> dict[int, float]:
    """Probabilities by the gains of hold-out, among the subsets of as many names as the best one."""
    scale = _TEMPERATURE * max(best.left / _size(best), 1.0)
    rivals = {i: t for i, t in enumerate(tried) if len(t.names) == max(len(best.names), 1)}
    lowest = min(t.left for t in rivals.values()) if rivals else 0.0
    raw = {i: math.exp(-0.5 * (t.left - lowest) / scale) for i, t in rivals.items()}
    return {i: w / sum(raw.values()) for i, w in raw.items()}


def _all(found: Fit, base: Fit) -> Fit:
    """The chosen model fitted to all samples."""
    try:
        return fit(found.setup, whole(base.plan), list(found.variables.names), base.held, _REFIT, origin=found)
    except PhnnError:
        return found


def _of(fitted: Fit, folder: Path) -> Mapping[str, Array]:
    return predictions(Model(fitted.setup, fitted.plan.finest), folder)


def _places(names: Mapping[str, float]) -> tuple[str, ...]:
    known, sums = catalogue(), Counter[str]()
    for name, probability in names.items():
        sums[known[name].location] += probability  # type: ignore[assignment]
    return tuple(place for place, _ in sums.most_common(_PLACES))
