"""A finished diagnosis: the whole way from recordings to verdict, as one value."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

from phnn.criteria import Criteria
from phnn.diagnose.formula import Distilled, distil
from phnn.diagnose.linearised import TIE, LinearisedFit, prepare
from phnn.diagnose.locations import Location, locate
from phnn.diagnose.number import Visited, Weighed, is_learned, weigh
from phnn.diagnose.proposal import NextExperiment, Question, propose, refitted_rival
from phnn.diagnose.screen import Candidate, chance
from phnn.diagnose.search import Search, begin, carry_beside, explore, finished, linearised_of, material, refits
from phnn.diagnose.verdict import NONE, UNKNOWN, Claim, Verdict, conclude, denied
from phnn.effects import Effect, catalogue, effect, in_all_forms
from phnn.effects.learned import learned_elements
from phnn.effects.places import attached
from phnn.identification.base import NUMERICAL, NumericalError, Progress, identify_base, numerical_error, quiet
from phnn.identification.evaluate import Evaluation, evaluate
from phnn.identification.fit import Fit
from phnn.identification.identified import Identified, model_of
from phnn.identification.plan import Options, Plan
from phnn.identification.prepare import Gain, gain, single
from phnn.integrate.equations import check
from phnn.model import Model
from phnn.parallel import SERIAL, Executor, executor
from phnn.parameters import quantity
from phnn.recordings.recording import Campaign
from phnn.rescue import Account, Ended, accounted, allow, attempt, deadline, extra, move, needed
from phnn.setup import Setup

# Nearly independent blocks of time below which a gain has no p-value.
_BLOCKS = 8
# Steps of simulation that count as one evaluation of the budget: the same time for short and for long recordings.
_STEPS = 300_000
# Models that compete in the question for the next recording.
_RIVALS = 4


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """A finished diagnosis.

    Attributes:
        campaign: what was diagnosed.
        base: the fitted base model; error: its numerical error.
        visited: all models that the search fitted, with their numbers; chosen: the one that is written.
        outcome: the verdict with its probabilities.
        screened: candidates in the residual of the base model, and those that the chosen model leaves, best first.
        location: where the mismatch is; None for ``none`` and where it could not be found.
        remaining: where what the chosen model leaves is; None where that is no more than chance.
        linearised: base model and chosen model with their trajectories.
        before, after: scores of both on all recordings, held-out ones among them.
        gains: what each element of the chosen model gains on held-out recordings; None where nothing was held out.
        formulas: of the learned elements, by name.
        proposal: the next recording, where effects cannot be told apart or have no name.
        kernel_residual: largest relative residual that the torch module finds in the compiled simulations of both
            models; NaN where it finds a step that is not solved, which is then among the warnings.
        options, seconds: how it was made; criteria: with which thresholds.
        ended: how the search ended, what was not tried, and what failed.
    """

    campaign: Campaign
    base: Fit
    error: NumericalError
    visited: Weighed
    chosen: Visited
    outcome: Verdict
    screened: tuple[tuple[Candidate, ...], tuple[Candidate, ...]]
    location: Location | None
    remaining: Location | None
    linearised: tuple[LinearisedFit, LinearisedFit]
    before: Evaluation
    after: Evaluation
    gains: tuple[Gain | None, ...]
    formulas: dict[str, Distilled]
    proposal: NextExperiment | None
    kernel_residual: float
    options: Options
    seconds: float
    criteria: Criteria
    ended: Ended = field(default_factory=Ended)

    @property
    def verdict(self) -> str:
        """Return ``named``, ``equivalent``, ``unknown`` or ``none``."""
        return self.outcome.word

    @property
    def probability(self) -> dict[str, float]:
        """Return the probability of every effect that some model holds, and of ``none``; the largest first.

        An effect has the probability of all models together that hold it, in any form and at any place.
        """
        return self.outcome.probability

    @property
    def claims(self) -> tuple[Claim, ...]:
        """Return the elements of the final model, in the order in which they were added."""
        return self.outcome.claims

    @property
    def final(self) -> Fit:
        """Return the fit of the final model."""
        return self.chosen.fit

    @property
    def model(self) -> Model:
        """Return the final model: base and every element that helps, whatever the verdict."""
        return model_of(self.final)

    @cached_property
    def places(self) -> tuple[str, ...]:
        """Return where the mismatch is, the likeliest place first; empty for ``none``.

        Of elements whose names are given, and of one that explains nearly all, it is the element's: a refit knows
        better than local functions did before it.
        """
        if self.verdict == NONE:
            return ()
        named = [c.effect.location for c in self.claims if c.claimed]
        acting = named or [c.effect.location for c in sorted(self.claims, key=lambda c: -(c.share or 0.0))][:1]
        tied = [e.location for c in self.claims if c.claimed for e in c.alike]
        located = [] if self.location is None else [self.location.name, *self.location.tied]
        return tuple(dict.fromkeys([*acting, *tied])) or tuple(located)

    @property
    def detail(self) -> str:
        """Return the kind of what is missing at the first of the places; empty for ``none``."""
        if not self.places:
            return ""
        acting = (c.effect for c in self.claims if c.effect.location == self.places[0])
        kinds = (e.kind.name for e in acting)
        return next(kinds, self.location.detail if self.location is not None else "")

    def significance(self, after: bool = False) -> tuple[float, float, str]:
        """Score, p-value and name of the best candidate in the residual of the base model, or of the final one.

        The p-value is that of a normal deviate, times the number of directions that were tried (Bonferroni).
        """
        candidates = self.screened[after]
        if not candidates:
            return 0.0, 1.0, ""
        best = max(candidates, key=lambda c: c.score)
        return best.score, chance(best.score, candidates), best.effect.name


def available(campaign: Campaign, setup: Setup, without: Sequence[Effect] = ()) -> list[Effect]:
    """Return the effects of the catalogue that can exist in a setup, in all forms and at all places, but for those that
    are to be left out; with the input measured where it acts, nothing before it is a culprit."""
    return _possible(campaign, setup, [e for e in catalogue().values() if e not in without])


def _possible(campaign: Campaign, setup: Setup, effects: Iterable[Effect]) -> list[Effect]:
    every = in_all_forms(a for e in effects for a in attached(e, setup) if a.applies(setup))
    return [e for e in every if not (e.needs_command and _input_measured(campaign, setup))]


def _input_measured(campaign: Campaign, setup: Setup) -> bool:
    """Whether what the input does to the network was recorded: at the terminals, or as the motion that is imposed."""
    return campaign.voltage == "terminals" or bool(setup.network.senses)


def diagnose(
    recorded: Campaign | Identified,
    options: Options | None = None,
    progress: Progress = quiet,
    effects: Sequence[Effect] | None = None,
    on_base: Callable[[Fit], None] | None = None,
    learned: Sequence[Effect] | None = None,
    budget: float | None = None,
    answers: bool = False,
) -> Diagnosis:
    """Fit the base model, search for what it misses, weigh all models, and conclude; as `phnn.diagnose`, which tells
    what is not told here.

    Args:
        on_base: called with the base fit as soon as there is one, so that it can be kept whatever comes.
        learned: elements without a name that may be added; all that can exist otherwise.
        answers: an interruption ends the search with the best so far, and `Ended.interruption` holds it; it is raised
            otherwise, as by a study of many diagnoses.
    """
    began, until = time.monotonic(), deadline(budget)
    chosen = options or (recorded.options if isinstance(recorded, Identified) else Options())
    criteria = Criteria().with_values(chosen.criteria)
    workers, left_out = executor(chosen.executor), [effect(name) for name in chosen.without]
    if workers == SERIAL and chosen.workers > 1:
        # Refits side by side use two cores better than the recordings of one.
        workers = Executor("threads", chosen.workers)
    with accounted(until, answers=answers) as account:
        campaign, base, error = _base(recorded, chosen, progress)
        if on_base is not None:
            needed("files of the base model", partial(on_base, base), None)
        progress(f"base model: {base.chi2**0.5:.3g} × noise; look for what it misses")
        allow(chosen.evaluations, _STEPS)

        def ready() -> Search:
            named = list(effects) if effects is not None else available(campaign, base.setup, left_out)
            nameless = _possible(campaign, base.setup, learned_elements().values()) if learned is None else learned
            most = max(1, chosen.max_effects)
            return begin(campaign, base, named, list(nameless), criteria, progress, most, workers, chosen.seed)

        # An interruption is for the search: what the answer needs is done whatever comes.
        search = needed("candidates", ready, None) or ready()
        move("search", partial(explore, search), None)
        diagnosis = _concluded(search, error, chosen, account)
    return replace(diagnosis, seconds=time.monotonic() - began, ended=account.ended(budget))


def _base(
    recorded: Campaign | Identified, options: Options, progress: Progress
) -> tuple[Campaign, Fit, NumericalError]:
    """Return the recordings and their base model, fitted where that has not been done."""
    campaign = recorded.campaign if isinstance(recorded, Identified) else recorded
    single(campaign.recordings, "a diagnosis follows one output", further=True)
    if isinstance(recorded, Identified):
        return campaign, recorded.fit, recorded.error
    return campaign, *identify_base(campaign, options, progress, NUMERICAL)


def _concluded(search: Search, error: NumericalError, options: Options, account: Account) -> Diagnosis:
    """Return the diagnosis of a search that has ended."""
    criteria, model, base = search.criteria, finished(search), search.visited[frozenset()]
    campaign = replace(search.campaign, notes=(*search.campaign.notes, *_noise_of(search)))
    screened = _screened(search, base)
    screened_final = screened if model is base else _screened(search, model)
    remaining = [c for c in screened_final if material(c, model.fit, criteria)]
    nameable = model.left_most <= (criteria.far / criteria.proven) ** 2 and not any(map(is_learned, model.elements))
    if nameable:
        # Names are given only where nothing promises a gain any more.
        carry_beside(search, model, [c.effect for c in remaining])
    promises = [c for c in remaining if not denied(c.effect, model, search.visited, criteria)]
    promising = sum(material(c, base.fit, criteria) for c in screened), len(promises)
    # What the budget has cut off matters where the model may still be a part of the truth, or another one as good.
    early = account.ended().early and bool(promises or not search.is_compared(model))
    exact = None if remaining or early else model
    weighed = weigh(list(search.visited.values()), criteria, exact)
    outcome = conclude(weighed, model, campaign.held_out_is_new, promising, criteria, early)
    if outcome.word == NONE:
        model, screened_final = base, screened
    search.progress(f"verdict {outcome.word}")

    def prepared(part: str, fitted: Fit) -> LinearisedFit:
        return needed(
            f"simulation of the {part} model", partial(prepare, fitted), LinearisedFit(fitted, (), search.scales)
        )

    first = prepared("base", base.fit)
    final = first if model is base else prepared("final", model.fit)
    before = _scores(base.fit, campaign)
    after = before if model is base else _scores(model.fit, campaign)
    location = location_left = None
    if outcome.word != NONE:
        measured = _input_measured(campaign, base.fit.setup)
        location = needed("location of the mismatch", partial(locate, first, measured=measured), None)
        if outcome.word == UNKNOWN and remaining and model is not base:
            location_left = needed("location of what remains", partial(locate, final, measured=measured), None)
    gains = tuple(_gain(c, after, search) for c in outcome.claims)
    formulas = {}
    for claim in outcome.claims:
        if claim.learned:
            part = f"formula of the {claim.effect.name.replace('_', ' ')}"
            without = None if claim.without is None else claim.without.fit
            work = partial(distil, final, claim.effect, without, partial(refits, search, claim.without or base))
            formula: Distilled | None = extra(part, work, None)
            if formula is not None:
                formulas[claim.effect.name] = formula
    residual = max(
        (needed("check of the simulations against the equations", partial(check, t), float("nan"))
         for g in {id(g): g for g in (first, final)}.values() for t in g.trajectories), default=0.0,
    )  # fmt: skip
    proposal = extra("the next recording", lambda: propose(_questions(outcome, model, weighed), first), None)
    if base.fit is not search.base.fit:
        error = numerical_error(base.fit)
    return Diagnosis(
        campaign, base.fit, error, weighed, model, outcome, (screened, screened_final), location, location_left,
        (first, final), before, after, gains, formulas, proposal, residual, options, 0.0, criteria,
    )  # fmt: skip


def _noise_of(search: Search) -> Iterable[str]:
    """Return a sentence for each recording of which more was taken for noise than it states."""
    for r in search.plan.recordings:
        if (ratio := search.noise.get(r.name, 1.0) ** 0.5) > 1.0:
            noise = (
                f"a noise of {quantity(ratio * r.noise, r.units.output)}, {ratio:.3g} times that of {r.noise_source}"
            )
            yield f"{r.name}: {noise}: what the best model leaves is first-order noise alone."


def _screened(search: Search, model: Visited) -> tuple[Candidate, ...]:
    """Return the candidates in the residual of a model."""
    nothing: list[Candidate] = []
    work = partial(search.screen, linearised_of(search, model))
    return tuple(needed(f"scores of {model.words}", work, nothing, ends=True))


def score_on_all(fitted: Fit, campaign: Campaign) -> Evaluation:
    """Return a fit's scores on every recording of a campaign; held-out ones get the finest sub-steps of its plan."""
    known = {r.name: r for r in fitted.plan.recordings}
    recordings = tuple(fitted.variables.timed(known.get(r.name, r), fitted.z) for r in campaign.recordings)
    steps = {r.name: fitted.plan.substeps.get(r.name, fitted.plan.finest) for r in recordings}
    return evaluate(fitted.setup, Plan(recordings, steps, fitted.plan.workers), fitted.initial_states)


def _scores(fitted: Fit, campaign: Campaign) -> Evaluation:
    """Return the same, without the recordings that cannot be simulated."""
    whole = attempt("scores on all recordings", partial(score_on_all, fitted, campaign), None)
    if whole is not None:
        return whole
    nothing = Evaluation({}, ())
    each = [
        needed(f"scores on {r.name}", partial(score_on_all, fitted, replace(campaign, recordings=(r,))), nothing)
        for r in campaign.recordings
    ]
    return Evaluation({n: y for e in each for n, y in e.outputs.items()}, tuple(p for e in each for p in e.parts))


def _gain(claim: Claim, after: Evaluation, search: Search) -> Gain | None:
    """Return what an element gains on held-out recordings."""
    if claim.without is None:
        return None
    without = claim.without

    def compared() -> Gain | None:
        before = score_on_all(without.fit, search.campaign)
        nuisances = without.fit.setup.own, search.visited[without.key].fit.setup.own
        return gain(before, after, search.campaign.recordings, "confirmation", _BLOCKS, nuisances)

    return needed(f"gain of {claim.effect.name}", compared, None)


def _questions(outcome: Verdict, model: Visited, weighed: Weighed) -> list[Question]:
    """The models that compete for each element whose name is not proven alone; another form has the same name."""
    asked = []
    for claim in outcome.claims:
        others = [e for e in model.elements if e not in claim.elements]
        rivals = [
            m for m in weighed.models
            if m.converged and len(m.elements) == len(model.elements) and m.families != model.families
            and all(e in m.elements for e in others) and m.fit.cost < model.fit.cost + TIE * max(1.0, model.left)
        ]  # fmt: skip
        present_model = refitted_rival(claim.effect.name, model.fit, claim.parameters)
        models = [present_model]
        for rival in rivals[: _RIVALS - 1]:
            other = next(e for e in rival.elements if e not in others)
            models.append(refitted_rival(other.name, rival.fit, other.parameters))
        if len(models) > 1 or not claim.claimed:
            asked.append(Question(tuple(models), "" if claim.claimed else claim.effect.name))
    several = [q for q in asked if len(q.models) > 1]
    return several or [q for q in asked if q.models[0].coordinates][:1]
