"""The search: models are grown from the base model, one element at a time, until nothing material is left to add.

    screen   all candidates in the residual of a model, from one linearisation
    heat     the likeliest ones, a few steps each; learned elements where the catalogue leaves something
    race     the best of them go on, as long as they can still end near the best
    forms    an effect that has several copies is compared in its best form
    drop     each earlier element of a better model is left out once
    exchange neighbours and other forms take the place of an effect, laws that of a learned element, before a pair is
             grown and at the end
    converge a model that is grown near the noise, and what a verdict compares, is carried to its end

Every model that is fitted on the way is kept with its χ² in each recording; `phnn.diagnose.number` weighs them.
The search goes on from the best three sets of effects, far from the noise from two of each size too. Each step stands
in its own account (`phnn.rescue`): one that fails, or comes too late, takes nothing away from what was finished.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from phnn.criteria import Criteria
from phnn.diagnose.linearised import LinearisedFit, prepare, with_few_steps
from phnn.diagnose.number import (
    Key,
    Misfit,
    Visited,
    Weighed,
    best_of_each,
    best_to_write,
    family,
    forecast,
    is_learned,
    key_of,
    over,
    weigh,
)
from phnn.diagnose.refit import Wanted, converged, further, large_starts, rebuilt, short
from phnn.diagnose.screen import Candidate, Screen
from phnn.effects import Effect, Scales
from phnn.effects.hysteresis import weakened
from phnn.identification.base import Progress, numerical_error, predicted_step, quiet, substeps_for
from phnn.identification.evaluate import Begun, estimated_start, evaluate
from phnn.identification.fit import Fit
from phnn.identification.plan import Plan
from phnn.identification.problem import own_size
from phnn.identification.starting_points import FORMS, MECHANICAL, OF_GRID, linear_part, random_starts
from phnn.network.roles import hysterons
from phnn.parallel import SERIAL, Executor
from phnn.recordings.recording import Campaign
from phnn.rescue import attempt, late, move, needed, results, spent, untried
from phnn.signals.first_order import is_first_order

# Share of the residual from which on a candidate is large, and over the usual score what it needs then.
_LARGE_SHARE, _LARGE_SCORE = 0.05, 0.6
# Excess over the noise, over that of the best trial, at which another one still goes on.
_RACE = 2.0
# Excess, in mean squares of the noise, up to which no further copy of an effect is tried.
_LEVEL = 0.02
# What a stretch of steps leaves of χ² where a fit still falls.
_FALLS = 0.8
# Trials that enter the race, and learned elements that have a heat.
_RACERS, _LEARNED = 5, 3
# How often the search goes on from what it has compared at its end.
_ROUNDS = 2
# Effects that may take the place of all hysterons.
_FORMS = {form.name for form in FORMS.values()}
# Starts of new hysterons beside a first element that leaves far more than the noise.
_ANEW = 3
# Difference of χ² of one optimum that is fitted twice.
_SAME = 3.0
# Nats behind the best at which a model is no longer grown, or refitted with finer steps.
_GROWN, _FINER = 30.0, 8.0
# Models of each size that are grown in any case where none comes near the noise.
_BESIDE = 2
# The same for models that share the probability: each of them has to be fitted to its end.
_ALIKE = 5.0
# Evaluations of an effect that promises little, where what promises more leaves too much.
_GLANCE = 3
# Share of the largest predicted fall from which a candidate that has not helped begins again from large strengths, and
# of an output's variance that is left, from which all do so: what is missing is far from linear then.
_PROMISING, _MUCH = 0.3, 0.01
# Norm of a numerical error over that of a mismatch that is just material, and over that of what a model leaves.
_OF_MATERIAL, _OF_LEFT = 0.3, 0.05
# By how much less has to be left beyond the noise before the numerical error is asked again; the least that counts.
_FALLEN, _LEAST = 10.0, 0.02
# Models whose derivatives stay in memory; those of a hundred models of a long campaign are gigabytes.
_AT_HAND = 16
# Mean square below which a model is carried to its end before it is grown.
_QUIET = 2.0


@dataclass
class Search:
    """A search for missing elements.

    Attributes:
        campaign: recordings; base: the fitted base model; plan: recordings and sub-steps of every converged fit.
        effects: catalogue entries that can exist in the setup.
        criteria: all numbers that decide something.
        scales: sizes from which effects take their grids.
        screen: directions of all candidates.
        visited: all models, by their elements; grown: those from which the search has gone on; compared: those whose
            alternatives have all been fitted, to the end where they leave so little that they may be named.
        most: elements of a model; executor: where refits are done, with the same results everywhere.
        progress: told what is tried; seed: of random starts.
        begun: where the base model begins held-out recordings whose start is unknown.
        refined_at: what the best model left beyond the noise when its numerical error was bounded last.
        used: the models whose derivatives are in memory, the last used one last.
        noise: power of the noise, by recording, over that which it states, where a model has shown more.
    """

    campaign: Campaign
    base: Visited
    plan: Plan
    effects: Sequence[Effect]
    criteria: Criteria
    scales: Scales
    screen: Screen
    visited: dict[Key, Visited]
    most: int
    executor: Executor
    progress: Progress
    seed: int = 0
    grown: set[Key] = field(default_factory=set)
    compared: set[tuple[Key, bool]] = field(default_factory=set)
    begun: dict[str, Begun] = field(default_factory=dict)
    refined_at: float = np.inf
    used: list[Visited] = field(default_factory=list)
    noise: dict[str, float] = field(default_factory=dict)

    @property
    def weighed(self) -> Weighed:
        """Return all models so far with their numbers."""
        return weigh(list(self.visited.values()), self.criteria)

    @property
    def best(self) -> Visited:
        """Return the most probable model so far."""
        return self.weighed.best

    @property
    def written(self) -> Visited:
        """Return the model that would be written."""
        return best_to_write(list(self.visited.values()), self.criteria)

    def far(self, model: Visited) -> bool:
        """Return whether a model is far from the noise."""
        return model.left > self.criteria.far**2

    def nameable(self, model: Visited) -> bool:
        """Return whether a model leaves so little that its names may stand for all that is missing."""
        return model.left_most <= self.criteria.explained / self.criteria.proven**2

    def is_compared(self, model: Visited) -> bool:
        """Return whether the alternatives of a model have been fitted."""
        return (model.key, self.nameable(model)) in self.compared

    def model(self, elements: Sequence[Effect], fitted: Fit, done: bool = False) -> Visited:
        """Return a model of a fit, with its χ² in each recording."""
        base, recordings = self.base.fit.setup.own, fitted.plan.recordings
        each = [(r.name, fitted.residual[rows]) for r, rows in zip(recordings, fitted.slices, strict=True)]
        misfits = {name: Misfit(float(r @ r), r.size) for name, r in each}
        terms = sum(own_size(r, fitted.setup.own) - own_size(r, base) for r in recordings)
        predicted = held_out(fitted, self.campaign, self.plan.finest, self.begun)
        misfits, predicted = over(misfits, self.noise), over(predicted, self.noise)
        return Visited(tuple(elements), fitted, misfits, predicted, terms, done)

    def visit(self, model: Visited) -> Visited:
        """Keep a model, unless a better fit of the same elements is known; returns the one that is kept."""
        known = self.visited.setdefault(model.key, model)
        # The same optimum carried to its end, or with finer sub-steps, takes the place.
        ended = (model.converged, model.fit.plan.size) > (known.converged, known.fit.plan.size)
        if ended or model.fit.cost < known.fit.cost - _SAME:
            self.visited[model.key] = model
        self.use(self.visited[model.key])
        return self.visited[model.key]

    def use(self, model: Visited) -> None:
        """Keep the derivatives of a model in memory, and let go of those of the models that were used longest ago."""
        self.used = [*(m for m in self.used if m is not model), model]
        for earlier in self.used[:-_AT_HAND]:
            earlier.fit.slopes.forget()
        self.used = self.used[-_AT_HAND:]


def begin(
    campaign: Campaign,
    fitted: Fit,
    effects: Sequence[Effect],
    learned: Sequence[Effect],
    criteria: Criteria,
    progress: Progress = quiet,
    most: int = 4,
    executor: Executor = SERIAL,
    seed: int = 0,
) -> Search:
    """Return a search that knows the base model alone; for the arguments see `Search`."""
    unknown = LinearisedFit(fitted, (), Scales(*(float("nan"),) * 9))
    linearised = needed("simulation of the base model", partial(prepare, fitted), unknown, ends=True)
    bare = Visited((), fitted, {}, {}, 0, True)
    plan = fitted.plan
    screen = Screen(with_few_steps(linearised, plan), [*effects, *learned], criteria)
    scales = linearised.scales
    search = Search(campaign, bare, plan, effects, criteria, scales, screen, {}, most, executor, progress, seed)
    sought = [r for r in campaign.recordings if r.name not in fitted.initial_states and r.mask("nuisance").any()]
    for r in sought:
        if (state := attempt("start", partial(estimated_start, fitted.setup, r, plan.finest), None)) is not None:
            search.begun[r.name] = fitted.setup, state
    search.base = search.visit(search.model((), fitted, True))
    return search


def explore(search: Search) -> None:
    """Grow models until the best one has nothing material left to add, or the budget is used up; then compare
    what a verdict needs, and go on where that has brought up a better model."""
    for _ in range(_ROUNDS):
        _grow_all(search)
        _compare(search)
        if _next(search) is None:
            break


def _grow_all(search: Search) -> None:
    while (model := _next(search)) is not None:
        part = f"what to add to {model.words}"
        if late(part):
            break
        search.grown.add(model.key)
        search.progress(f"look for {part}")
        move(part, partial(_grow, search, model), None)
        best, used = search.best, f"{100.0 * spent():.0f} % of the budget"
        search.progress(f"likeliest so far: {best.words}, {best.left**0.5:.3g} × noise ({used})")


def _next(search: Search) -> Visited | None:
    """Return the model to grow next; None where the search has come to its end.

    First comes the most probable model; then the best one of effects alone, for a learned element may stand for two of
    them; then the one that would be written; then others that predict about as well. Far from the noise probabilities
    say little, and the most probable one comes third. Near the noise a model is carried to its end before it is grown.
    Before either, the numerical error is bounded again where so much less is left that it may be the larger part.
    """
    while True:
        number = partial(forecast, criteria=search.criteria)
        ranked = sorted(search.visited.values(), key=number, reverse=True)
        different = best_of_each(ranked)
        likely = [m for m in different[: search.criteria.beam] if number(ranked[0]) - number(m) < _GROWN]
        nameable = next(m for m in ranked if not any(map(is_learned, m.elements)))
        best = search.best
        leading = [nameable, search.written, best] if search.far(best) else [best, nameable, search.written]
        for size in range(search.most) if search.far(best) else ():
            likely += [m for m in different if len(m.elements) == size][:_BESIDE]
        able = [m for m in (*leading, *likely) if len(m.elements) < search.most and m.key not in search.grown]
        excess = max(_LEAST, min((m.left for m in leading if m.elements), default=np.inf) - 1.0)
        todo = next((m for m in (*leading, *able[:1]) if not m.converged and m.left < _QUIET), None)
        if excess < search.refined_at / _FALLEN:
            search.refined_at = excess
            move("finer steps", partial(_refine, search), None)
        elif todo is None:
            return able[0] if able else None
        elif not _carry(search, todo):
            return None


def _carry(search: Search, model: Visited) -> bool:
    """Carry a model to its end, if there is time; one that cannot be fitted with the search's steps has come to it."""
    if not late(part := f"fit of {model.words} to its end"):
        move(part, partial(_converge, search, [model]), None)
    if not search.visited[model.key].converged and late(part):
        return False
    search.visited[model.key] = replace(search.visited[model.key], converged=True)
    return True


def _grow(search: Search, model: Visited) -> None:
    """Fit the likeliest models with one more element."""
    criteria, samples = search.criteria, model.fit.residual.size
    screened = search.screen(linearised_of(search, model))
    worth = [c for c in screened if material(c, model.fit, criteria)]
    if not worth:
        _take_for_noise(search, model)
        return
    least = (criteria.near_best_far if search.far(model) else criteria.near_best) * worth[0].fall
    named = [c for c in worth if not is_learned(c.effect) and c.fall > least][: criteria.refits]
    trials = _heat(search, model, named)
    enough = max(0.05 * (model.fit.cost - samples), criteria.material**2 * samples)
    if not trials or trials[0].fit.beyond_noise > enough:
        # Near the noise a forecast holds: what promises less than an effect has brought waits until that is added.
        gained = model.fit.cost - trials[0].fit.cost if trials and not search.far(model) else 0.0
        most = max(criteria.near_best * worth[0].fall, gained)
        learned = [c for c in worth if is_learned(c.effect) and c.fall > most]
        trials = sorted([*trials, *_heat(search, model, learned[:_LEARNED])], key=lambda t: t.fit.cost)
    if not trials or search.far(trials[0]):
        little = not trials or trials[0].fit.beyond_noise > 0.5 * model.fit.beyond_noise
        if little and len(model.elements) < 2 and not any(map(is_learned, model.elements)):
            # A law that is far from linear may promise nothing, and still be what is missing.
            rest = [c for c in screened if not (is_learned(c.effect) or c in named or family(c.effect) in _FORMS)]
            begun = _heat(search, model, rest, glance=True)
            trials += _onwards(search, begun[:_RACERS], _GLANCE)
        trials = sorted([*trials, *([] if model.elements else _other_forms(search, model))], key=lambda t: t.fit.cost)
    if not trials:
        return
    for trial in trials:
        search.visit(trial)
    raced = sorted([search.visit(t) for t in _race(search, trials)], key=lambda t: t.fit.cost)
    if not model.elements:
        if search.far(raced[0]) and family(raced[0].elements[0]) not in _FORMS:
            search.visit(_with_new_hysterons(search, raced[0]))
    elif search.weighed.behind(raced[0]) < search.weighed.behind(model):
        _drop_each(search, raced[0], raced[0].elements[:-1])


def _take_for_noise(search: Search, model: Visited) -> None:
    """Take for noise what a model leaves to which nothing can be added, where recordings do not show the colour of
    theirs and it is first-order noise alone: it may be more than their highest frequencies show."""
    recordings = model.fit.plan.recordings
    if not model.elements or search.far(model) or not all(r.colour_unseen for r in recordings):
        return
    _carry(search, model)
    fitted = search.visited[model.key].fit
    pairs = [(r.name, fitted.residual[rows]) for r, rows in zip(recordings, fitted.slices, strict=True)]
    if all(is_first_order(e) for _, e in pairs):
        known = search.noise
        powers = {n: max(float(np.mean(e**2)) / search.criteria.slack, 1.0) for n, e in pairs}
        search.noise = {n: min(known.get(n, power), power) for n, power in powers.items()}
        changed = {n: power / known.get(n, 1.0) for n, power in search.noise.items()}
        for key, m in search.visited.items():
            search.visited[key] = replace(m, fitted=over(m.fitted, changed), held_out=over(m.held_out, changed))
        search.base = search.visited[search.base.key]


def material(candidate: Candidate, fitted: Fit, criteria: Criteria) -> bool:
    """Return whether a candidate is worth a refit.

    What takes a twentieth of the residual need not stand out of its scatter as far, and far from the noise not at all:
    the scatter is that of the mismatch itself there.
    """
    samples = fitted.residual.size
    size = max(candidate.fall / samples, candidate.share)
    large = candidate.fall > _LARGE_SHARE * fitted.cost
    if large and fitted.chi2 > criteria.far**2:
        return True
    return size > criteria.material**2 and candidate.score > criteria.score * (_LARGE_SCORE if large else 1.0)


def _heat(search: Search, model: Visited, candidates: Sequence[Candidate], glance: bool = False) -> list[Visited]:
    """Return the short refits of candidates beside a model, with coarse sub-steps, the best first; far from the noise
    from large strengths too, where one that promises much of the largest fall has not helped, or one that is glanced at
    while much of the motion is unexplained."""
    if not candidates or late(f"refits beside {model.words}"):
        return []
    begun = LinearisedFit(model.fit, (), search.scales)
    promising = _PROMISING * max(candidates[0].fall, 1.0)
    if glance:
        promising = 0.0 if _unexplained(model.fit) > _MUCH else np.inf
    evaluations = _GLANCE if glance else search.criteria.short
    work = partial(_tried, begun, search.plan, promising if search.far(model) else np.inf, evaluations)
    fits = _fits(search, work, candidates, [c.effect.name for c in candidates])
    pairs = zip(candidates, fits, strict=True)
    trials = [search.model((*model.elements, c.effect), f) for c, f in pairs if f is not None]
    return sorted(trials, key=lambda t: t.fit.cost)


def _unexplained(fitted: Fit) -> float:
    """Return the share of an output's variance that a fit leaves, the median of its recordings."""
    pairs = zip(fitted.plan.recordings, fitted.slices, strict=True)
    return float(np.median([np.mean((r.noise * fitted.residual[rows]) ** 2) / np.var(r.y) for r, rows in pairs]))


def _other_forms(search: Search, model: Visited) -> list[Visited]:
    """Return the base model with other forms of hysteresis in the place of its hysterons: beside these, which have
    taken over what they can, another form promises nothing."""
    values = model.fit.setup.values()
    if not (weak := weakened(values)):
        return []
    forms = [e for e in search.effects if e.name in _FORMS and not e.after]
    starts = [[values | weak | e.scaled(p, OF_GRID) for p in e.grid(search.scales)] for e in forms]
    wanted = [Wanted((e,), s) for e, s in zip(forms, starts, strict=True)]
    return _rebuilt(search, wanted, "other forms of hysteresis", search.criteria.short)


def _with_new_hysterons(search: Search, trial: Visited) -> Visited:
    """Return the trial with hysterons that begin anew: without the element the fit may have taken them to where no step
    leads back from. Where there are none, or no time, it is the trial."""
    count, values = len(hysterons(search.base.fit.setup.network)), trial.fit.setup.values()
    if not count or not set(values).issuperset(MECHANICAL):
        return trial
    linear = linear_part(values)
    stated = {n: values[n] for n in search.base.fit.held if n in values}
    starts = random_starts(linear, search.plan, count, stated, _ANEW, search.seed)
    wanted = [Wanted(trial.elements, [values | s.values() | linear.values()]) for s in starts]
    trials = _rebuilt(search, wanted, f"{trial.words} with new hysterons", search.criteria.short)
    best = min(trials, key=lambda t: t.fit.cost, default=None)
    return trial if best is None else _while_the_best_falls(search, _onwards(search, [best]))[0]


def _tried(model: LinearisedFit, plan: Plan, promising: float, evaluations: int, candidate: Candidate) -> Fit | None:
    """Return a short refit of a candidate; from large strengths too, where it promised a lot and has not helped."""
    best = short(model.fit, plan.coarse(), candidate.effect, [candidate.values], evaluations)
    helps = best is not None and best.cost < 0.98 * model.fit.cost
    if helps or candidate.effect.strength is None or candidate.fall < promising:
        return best
    starts = large_starts(with_few_steps(model, plan), candidate.effect)
    again = short(model.fit, plan.coarse(), candidate.effect, starts, evaluations)
    return min((f for f in (best, again) if f is not None), key=lambda f: f.cost, default=None)


def _race(search: Search, trials: Sequence[Visited]) -> list[Visited]:
    """The best trials after further steps, as long as each can still end near the best one, each in its best form."""
    samples = trials[0].fit.residual.size
    first = _onwards(search, trials[:1])
    # Near the noise what the best has reached counts; far from it six steps say little of where a refit ends, and a
    # learned element, which bends to anything, is no measure for effects.
    effects = [t for t in trials if not is_learned(t.elements[-1])]
    most = _RACE * ([*effects, *trials] if search.far(trials[0]) else first)[0].fit.beyond_noise + 0.05 * samples
    # Several copies of an effect may be what a learned element stands for.
    several = trials[0].elements[-1].several_of
    others = [t for t in trials[1:_RACERS] if t.fit.beyond_noise <= most or family(t.elements[-1]) == several]
    going = _while_the_best_falls(search, [*first, *_onwards(search, others)])
    least = min(t.fit.beyond_noise for t in going)
    for trial in list(going):
        near = trial.fit.beyond_noise < 4.0 * least + 0.05 * samples or family(trial.elements[-1]) == several
        if near and trial.fit.beyond_noise > _LEVEL * samples:
            going += _further_forms(search, trial)
    return going


def _while_the_best_falls(search: Search, trials: Sequence[Visited]) -> list[Visited]:
    """Return the trials, the best of them after further steps as long as it is far from the noise and each stretch
    takes a fifth of what is left: what is grown half-fitted is grown by what only stands for the rest of the fit."""
    best, *others = sorted(trials, key=lambda t: t.fit.cost)
    while search.far(best):
        before, best = best, _onwards(search, [best])[0]
        if best.fit.cost > _FALLS * before.fit.cost:
            break
    return [best, *others]


def _onwards(search: Search, trials: Sequence[Visited], before: int = 0) -> list[Visited]:
    """Return the trials after further steps, where they have not ended within those before, or began with coarser steps
    than the present ones."""
    coarse, most = search.plan.coarse(), before or search.criteria.short
    moving = [t for t in trials if t.fit.evaluations >= most or t.fit.plan.size < coarse.size]
    if not moving or late("further steps of " + ", ".join(t.words for t in moving)):
        return list(trials)
    work = partial(further, evaluations=search.criteria.further, plan=coarse)
    fits = _fits(search, work, [t.fit for t in moving], [t.elements[-1].name for t in moving])
    ended = {t.key: search.model(t.elements, f) for t, f in zip(moving, fits, strict=True) if f is not None}
    return [ended.get(t.key, t) for t in trials]


def _fits(search: Search, work: Callable[[Any], Fit | None], items: Sequence[Any], names: Sequence[str]) -> list[Any]:
    """Return ``work(item)`` of every item, on the very recordings of the search wherever it was done."""
    fits: list[Fit | None] = results(search.executor, work, items, names)
    return [f if f is None else f.on(search.plan.recordings) for f in fits]


def _further_forms(search: Search, trial: Visited) -> list[Visited]:
    """Return the trial with one more copy of its last element, and with two, as long as each of them pays."""
    extensions: list[Visited] = []
    while True:
        last = extensions[-1] if extensions else trial
        name = family(last.elements[-1])
        copies = [e for e in search.effects if e.after and family(e) == name and e.can_be_added_to(last.fit.setup)]
        if not copies or late(f"one more {name} in {trial.words}"):
            return extensions
        search.visit(last)
        candidates = _screened(search, last, copies)
        if not candidates or candidates[0].fall < search.criteria.material**2 * last.fit.residual.size:
            return extensions
        first, plan = candidates[0], search.plan.coarse()
        best = short(last.fit, plan, first.effect, [first.values], search.criteria.further)
        if best is None:
            return extensions
        extensions.append(search.model((*last.elements, first.effect), best))
        weighed = weigh([*search.visited.values(), extensions[-1]], search.criteria)
        if weighed.behind(extensions[-1]) > weighed.behind(search.visited[last.key]):
            return extensions


def _drop_each(search: Search, model: Visited, elements: Sequence[Effect]) -> None:
    """Fit a model without each of some of its elements, from where it has ended."""
    wanted: list[Wanted] = []
    for gone in elements:
        rest = tuple(e for e in model.elements if e is not gone and not set(gone.parameters) & set(e.after))
        wanted.append(Wanted(rest, _starts_without(gone, model)))
    better = []
    for less in _rebuilt(search, wanted, f"{model.words} without each element"):
        # Near the noise the element may describe no more than the error of coarse steps.
        gained = less.fit.cost - model.fit.cost
        near = less.left < _QUIET or gained < search.criteria.material**2 * less.fit.residual.size
        if not less.elements:
            better += [less] if less.fit.cost < search.visited[less.key].fit.cost - _SAME else []
        elif search.visit(less) is less:
            # It may be a better optimum of a model that was grown before.
            search.grown.discard(less.key)
            better += [less] if near else []
    _converge(search, better)


def _starts_without(gone: Effect, model: Visited) -> list[dict[str, float]]:
    """Return the values of a model from which it is fitted without an element: as they are, and with the element in the
    place of each part that may stand for it."""
    values = model.fit.setup.values()
    equal = gone.equivalents(values) if gone.equivalents is not None else ()
    return [values, *(values | v for v in equal)]


def _rebuilt(search: Search, wanted: Sequence[Wanted], part: str, evaluations: int | None = None) -> list[Visited]:
    """Models of some elements, fitted with coarse sub-steps from the best of some values, where there is time."""
    if not wanted or late(part):
        return []
    work = partial(rebuilt, search.base.fit, search.plan.coarse(), evaluations or search.criteria.further)
    fits = _fits(search, work, wanted, [" + ".join(e.name for e in w.elements) for w in wanted])
    return [search.model(w.elements, f) for w, f in zip(wanted, fits, strict=True) if f is not None]


def _converge(search: Search, models: Sequence[Visited], brief: bool = False) -> None:
    """Carry models to their end with the sub-steps of the search."""
    todo = [m for m in models if not (m.converged and m.fit.plan.size >= search.plan.size)]
    for model, fitted in zip(todo, _ended(search, todo, brief), strict=True):
        if fitted is not None:
            search.visit(search.model(model.elements, fitted, done=True))


def _ended(search: Search, models: Sequence[Visited], brief: bool = False) -> list[Fit | None]:
    plan, held = search.plan, search.base.fit.held
    items = [(m.fit, [n for e in m.elements for n in e.parameters]) for m in models]
    return _fits(search, lambda i: converged(i[0], plan, held, i[1], brief), items, [m.words for m in models])


def _refine(search: Search) -> None:
    """Bound the numerical error of the best model, and fit its rivals of other effects with the same steps: models are
    compared on the same ones only."""
    weighed = search.weighed
    best = weighed.best
    # Neither a tenth of what is material nor a four-hundredth of what is left is taken for a missing effect: in the
    # number of a model that is less than the price of an element.
    unseen = _OF_MATERIAL * search.criteria.material * best.fit.residual.size**0.5
    bound = max(1.0, unseen, _OF_LEFT * best.fit.beyond_noise**0.5)
    plan = substeps_for(best.fit, search.plan, bound, numerical_error(replace(best.fit, plan=search.plan)))
    if plan.size == search.plan.size:
        return
    search.progress("numerical error too large for what is left: finer steps")
    search.plan = plan
    search.compared.clear()
    rivals = [m for m in best_of_each(weighed.models)[1:] if m.elements and weighed.behind(m) < _FINER]
    _converge(search, [replace(m, converged=False) for m in (best, *rivals[:2])])
    search.grown.discard(best.key)


def _compare(search: Search) -> None:
    """Carry to their end the models that a verdict compares: those near the best, and every member of the class of an
    effect in it."""
    while not (written := search.written).converged and _carry(search, written):
        pass
    weighed = search.weighed
    close = weighed.best.left < _QUIET
    alike = [m for m in weighed.models if close and not m.converged and weighed.behind(m) < _ALIKE]
    move("fits of what is as likely to their end", partial(_converge, search, alike), None)
    for _ in range(_ROUNDS):
        # What has taken the place of an element leads to a model that has to be compared itself.
        for model in dict.fromkeys((search.best, search.written)):
            if not search.is_compared(model):
                _against_others(search, model)


def _against_others(search: Search, model: Visited) -> None:
    """Fit a model without each of its elements, and with another one in the place of each."""
    before = untried()
    move(f"{model.words} without each element", partial(_drop_each, search, model, model.elements), None)
    if model.key not in (search.best.key, search.written.key):
        # It does as well without one: that is compared.
        return
    for element in model.elements:
        move(f"what may be taken for {element.name}", partial(_exchange, search, model, element), None)
    if untried() == before:
        search.compared.add((model.key, search.nameable(model)))


def finished(search: Search) -> Visited:
    """Return the model to write, with the sub-steps of the search, whatever has ended it."""
    if not (model := search.written).converged:
        needed(f"fit of {model.words} with all sub-steps", partial(_converge, search, [model], brief=True), None)
    models, alone = [m for m in search.visited.values() if m.converged], replace(search, begun={})
    while (model := best_to_write(models, search.criteria)).elements and search.begun:
        # Whoever loads the model does not know where the base model begins a recording.
        predicted = needed(f"prediction by {model.words}", partial(alone.model, model.elements, model.fit, True), model)
        if best_to_write([search.base, predicted], search.criteria) is predicted:
            break
        models.remove(model)
    return model


def carry_beside(search: Search, model: Visited, effects: Sequence[Effect]) -> None:
    """Carry to its end what was tried beside a model: before that, held-out recordings cannot deny it."""
    extensions = [search.visited.get(key_of((*model.elements, e))) for e in effects]
    todo = [m for m in extensions if m is not None and not m.converged]
    if todo and not late(part := f"fits beside {model.words} to their end"):
        move(part, partial(_converge, search, todo), None)


def _exchange(search: Search, best: Visited, element: Effect) -> None:
    """Fit the best model with another element in the place of one: neighbours and other forms of an effect, laws at the
    location of a learned element."""
    rest = tuple(e for e in best.elements if e is not element)
    if any(set(element.parameters) & set(e.after) for e in rest):
        return
    begun = [search.visit(t) for t in _in_place_of(search, best, element, rest)]
    able = [t for t in begun if not t.converged and _within_reach(search, t, predicted_step(t.fit)[1])]
    onwards = [search.visit(t) for t in _onwards(search, able)]
    weighed = search.weighed
    # An effect is compared at its best place, in its best form.
    places = {family(m.elements[-1]): m for m in sorted(onwards, key=lambda m: -m.fit.cost)}
    near = [m for m in places.values() if m.left < _QUIET and weighed.behind(m) < _GROWN]
    # Where more is left no name is given, and what is better shows without.
    if near and search.nameable(best) and not late(f"what may be taken for {element.name}"):
        _converge(search, near)


def _in_place_of(search: Search, best: Visited, element: Effect, rest: tuple[Effect, ...]) -> list[Visited]:
    """Return what the search has begun and not ended in the place of an element, and short refits of it in the model
    that the element has led to: the other parameters may have come to where nothing else would lead them."""
    known = {n for e in rest for n in e.parameters}
    others = [e for e in search.effects if known.issuperset(e.after) and e is not element and e not in rest]
    if search.far(best):
        # No name is given far from the noise, but another form may lead on from where the element has led to.
        able = [e for e in others if family(e) == family(element)]
    elif is_learned(element):
        able = [e for e in others if e.location == element.location]
    else:
        able = [e for e in others if family(e) == family(element) or e.is_neighbour_of(element)]
    if not able:
        return []
    begun = [m for e in able if (m := search.visited.get(key_of((*rest, e)))) is not None]
    ended = {m.elements[-1] for m in begun if m.converged}
    wanted = Wanted(rest, _starts_without(element, best))
    trials = [m for m in begun if not m.converged]
    for bare in _rebuilt(search, [wanted], f"what may be taken for {element.name}", evaluations=1):
        screened = _screened(search, bare, [e for e in able if e not in ended])
        first = {family(c.effect): c for c in reversed(screened)}
        # Of neighbours the likeliest form, and all forms of the effect itself.
        tried = [c for c in screened if first[family(c.effect)] is c or family(c.effect) == family(element)]
        trials += _heat(search, bare, tried[:_RACERS])
    return trials


def _within_reach(search: Search, model: Visited, fall: float) -> bool:
    """Return whether a model would be near the best one if its χ² fell by twice what its derivatives predict."""
    share = max(0.0, 1.0 - 2.0 * fall / model.fit.cost)
    reached = replace(model, fitted={r: Misfit(share * m.chi2, m.samples) for r, m in model.fitted.items()})
    return weigh([*search.visited.values(), reached], search.criteria).behind(reached) < _GROWN


def refits(search: Search, base: Visited, effects: Sequence[Effect]) -> list[tuple[Effect, Fit]]:
    """Return a fit with each of some effects beside a model, carried to its end, as far as it can be simulated."""
    trials = _heat(search, base, _screened(search, base, effects))
    return [(t.elements[-1], f) for t, f in zip(trials, _ended(search, trials), strict=True) if f is not None]


def _screened(search: Search, model: Visited, effects: Sequence[Effect]) -> list[Candidate]:
    return replace(search.screen, effects=effects)(linearised_of(search, model))


def linearised_of(search: Search, model: Visited) -> LinearisedFit:
    """Return a model with its residual and sensitivities, as a screen needs it."""
    search.use(model)
    return with_few_steps(LinearisedFit(model.fit, (), search.scales), search.plan)


def held_out(fitted: Fit, campaign: Campaign, steps: int, begun: Mapping[str, Begun]) -> dict[str, Misfit]:
    """What a model leaves of the held-out samples, by recording; empty where there are none, or it cannot predict.

    Args:
        steps: sub-steps of each sample, the same for all models that are compared: coarse ones tell chirps wrongly.
        begun: where the base model begins these recordings.
    """
    held = [r for r in campaign.recordings if r.mask("confirmation").any()]
    recordings = tuple(fitted.variables.timed(r, fitted.z) for r in held)
    if not recordings:
        return {}
    plan = Plan(recordings, {r.name: steps for r in recordings}, fitted.plan.workers)
    predict = partial(evaluate, fitted.setup, plan, fitted.initial_states, begun)
    predicted = attempt("prediction of held-out recordings", predict, None)
    if predicted is None:
        return {r.name: Misfit(1e12, int(r.mask("confirmation").sum())) for r in recordings}
    errors = {r.name: ((r.y - predicted.outputs[r.name]) / r.noise)[r.mask("confirmation")] for r in recordings}
    return {name: Misfit(float(e @ e), e.size) for name, e in errors.items()}
